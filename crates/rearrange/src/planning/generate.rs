//! The paper's random scenarios, RAND and SQ: objects, a start and a goal arrangement, from a seed.
//!
//! In: a [`Recipe`] (scenario, number of objects, density, law of the side ratios), a seed and the number of
//! the case. Out: an [`Instance`] on a table of 1 m x 1 m whose two arrangements are free of contact for the
//! true shapes, and how they were found; or an error that names the density. Source: the paper, section
//! Evaluation. Case k of a seed does not depend on how many cases are requested, and nothing here reads a
//! clock.

mod arrange;
mod recipe;
mod shapes;

use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::planning::generate::arrange::{Arranged, arrange};
use crate::planning::generate::shapes::draw_shapes;
use crate::tabletop::instance::{Instance, ObjectSpec};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub use crate::planning::generate::arrange::{DENSEST_REJECTION, Method};
pub use crate::planning::generate::recipe::{RatioLaw, Recipe, Scenario, TABLE};

/// Most objects of one instance: what an instance file may hold.
pub const MOST_OBJECTS: usize = crate::tabletop::parts::MAX_OBJECTS;

/// Times the outlines of a case are drawn anew when they find no arrangement.
const MOST_DRAWS: usize = 4;

/// An instance and how it was found.
#[derive(Clone, Debug)]
pub struct Generated {
    /// The task.
    pub instance: Instance,
    /// One line that says how to make it again and by which method start and goal were found.
    pub origin: String,
    /// How the start was found.
    pub start: Method,
    /// How the goal was found.
    pub goal: Method,
}

/// Why there is no instance.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GenerateError {
    /// Too few or too many objects.
    #[error("{found} objects; {scenario} takes {least} to {MOST_OBJECTS}")]
    Objects {
        /// Number requested.
        found: usize,
        /// Scenario.
        scenario: &'static str,
        /// Smallest number.
        least: usize,
    },
    /// No density at all.
    #[error("density {0}: has to be over 0 and under 1")]
    Density(f64),
    /// Outlines too small for a footprint.
    #[error("density {density}: {fault}")]
    Footprint {
        /// Density requested.
        density: f64,
        /// What is wrong.
        fault: FootprintFault,
    },
    /// The search for an arrangement gave up.
    #[error(
        "density {density}: no {arrangement} arrangement of {objects} objects was found, neither by \
         rejection sampling nor by push-apart, for {MOST_DRAWS} draws of outlines; lower the density, take \
         another number of objects or another seed"
    )]
    NoArrangement {
        /// Density requested.
        density: f64,
        /// Number of objects.
        objects: usize,
        /// Start or goal.
        arrangement: &'static str,
    },
}

impl Recipe {
    /// Checks what can be checked before anything is drawn.
    ///
    /// # Errors
    /// A number of objects or a density that makes no sense.
    pub fn check(&self) -> Result<(), GenerateError> {
        let least = if self.scenario == Scenario::Sq { 3 } else { 1 };
        if !(least..=MOST_OBJECTS).contains(&self.objects) {
            let scenario = self.scenario.as_str();
            return Err(GenerateError::Objects { found: self.objects, scenario, least });
        }
        if self.density > 0.0 && self.density < 1.0 {
            Ok(())
        } else {
            Err(GenerateError::Density(self.density))
        }
    }
}

/// Makes case number `case` of `seed`.
///
/// Start and goal are drawn independently. Where no arrangement is found the outlines are drawn anew, a
/// bounded number of times: the paper repeats "the sampling process for a single test case".
///
/// # Errors
/// A recipe that makes no sense, or a density at which no arrangement was found.
pub fn generate(recipe: &Recipe, seed: u64, case: u64) -> Result<Generated, GenerateError> {
    recipe.check()?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(case);
    let mut missing = "start";
    for draw in 1..=MOST_DRAWS {
        let shapes = draw_shapes(recipe, &mut rng)
            .map_err(|fault| GenerateError::Footprint { density: recipe.density, fault })?;
        let Some(start) = arrange(&shapes, recipe.density, &mut rng) else { continue };
        missing = "goal";
        let Some(goal) = arrange(&shapes, recipe.density, &mut rng) else { continue };
        return Ok(Generated {
            origin: origin(recipe, seed, case, draw, (&start, &goal)),
            start: start.method,
            goal: goal.method,
            instance: instance(&shapes, &start, &goal),
        });
    }
    let Recipe { density, objects, .. } = *recipe;
    Err(GenerateError::NoArrangement { density, objects, arrangement: missing })
}

fn origin(recipe: &Recipe, seed: u64, case: u64, draw: usize, found: (&Arranged, &Arranged)) -> String {
    let Recipe { scenario, objects, density, ratios } = recipe;
    let ratios = match scenario {
        Scenario::Rand => format!(" --ratios {ratios}"),
        Scenario::Sq => String::new(),
    };
    format!(
        "celld generate {scenario} --objects {objects} --density {density}{ratios} --seed {seed}, case \
         {case}: start by {}, goal by {}, outlines of draw {draw}",
        found.0.how(),
        found.1.how()
    )
}

/// Impedance is area over the smallest area, as in the public instances, so that TI costs compare with
/// theirs.
fn instance(shapes: &[Footprint], start: &Arranged, goal: &Arranged) -> Instance {
    let smallest = shapes.iter().map(Footprint::area).fold(f64::INFINITY, f64::min);
    let object = |(k, shape): (usize, &Footprint)| {
        let kind = if matches!(shape, Footprint::Ellipse { .. }) { "ellipse" } else { "rectangle" };
        let mut object = ObjectSpec::new(format!("{kind}-{k}"), shape.clone());
        object.impedance = Some(shape.area() / smallest);
        object.start = Some(start.poses[k]);
        object.goal = Some(goal.poses[k]);
        object
    };
    Instance {
        workspace: TABLE,
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects: shapes.iter().enumerate().map(object).collect(),
    }
}

#[cfg(test)]
mod tests;
