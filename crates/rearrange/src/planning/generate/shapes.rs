//! The outlines of a random instance, scaled to its density.
//!
//! In: a recipe and random numbers. Out: footprints whose areas add up to the density times the table's
//! area. Laws (the paper, section Evaluation): RAND draws ellipse or rectangle with equal chance, a side
//! ratio, and an area uniform in [0.05, 1]; SQ has two large squares, then small ones of a ninth of their
//! area.

use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::planning::generate::recipe::{RatioLaw, Recipe, Scenario, TABLE};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Area of a large square over that of a small one.
const LARGE_OVER_SMALL: f64 = 9.0;

/// Number of large squares.
const LARGE: usize = 2;

/// Draws the outlines of one instance.
///
/// # Errors
/// An object too small to be one.
pub fn draw_shapes(recipe: &Recipe, rng: &mut ChaCha8Rng) -> Result<Vec<Footprint>, FootprintFault> {
    let outlines: Vec<Outline> = (0..recipe.objects)
        .map(|k| match recipe.scenario {
            Scenario::Rand => Outline::random(recipe.ratios, rng),
            Scenario::Sq => Outline::square(if k < LARGE { LARGE_OVER_SMALL } else { 1.0 }),
        })
        .collect();
    let sum: f64 = outlines.iter().map(|outline| outline.area).sum();
    let wanted = recipe.density * TABLE.width * TABLE.height;
    outlines.iter().map(|outline| outline.footprint(wanted / sum)).collect()
}

/// An outline before its size is known.
struct Outline {
    round: bool,
    area: f64,
    /// Extent along the object's x over that along its y.
    ratio: f64,
}

impl Outline {
    fn random(law: RatioLaw, rng: &mut ChaCha8Rng) -> Outline {
        let round = rng.random_bool(0.5);
        let area = rng.random_range(0.05..=1.0);
        let ratio = match law {
            RatioLaw::Paper => rng.random_range(1.0..=3.0),
            RatioLaw::Public => rng.random_range(0.33..=1.0),
        };
        Outline { round, area, ratio }
    }

    fn square(area: f64) -> Outline {
        Outline { round: false, area, ratio: 1.0 }
    }

    fn footprint(&self, scale: f64) -> Result<Footprint, FootprintFault> {
        let area = self.area * scale;
        if self.round {
            let extents = area * 4.0 / PI;
            Footprint::ellipse((extents * self.ratio).sqrt(), (extents / self.ratio).sqrt())
        } else {
            Footprint::rectangle((area * self.ratio).sqrt(), (area / self.ratio).sqrt())
        }
    }
}
