//! By what share a stereo camera reads too far, as a smooth function of the direction, learnt from surfaces
//! whose distance is known.
//!
//! In: [`Sample`]s: direction, share by which a point reads too far. Out: [`Field`]. What is on the table
//! reads too near and never too far, and it may cover more of the view than the table does. So the fit
//! starts from a camera without error, drops what is clearly nearer than the fit so far, and follows the
//! rest; far points are dropped less readily. Pure.

use nalgebra::{Matrix4, Vector4};

/// A point this much nearer than the field so far is no longer the table, as a share: 4 mm from half a
/// metre.
const NEARER: f64 = 0.008;
/// The distance up to which that holds, m; the noise's share grows with the distance.
const NEARER_UP_TO_M: f64 = 0.5;
/// Points this many times farther than that are no longer the table: at first, and once the field is roughly
/// known.
const FARTHER: [f64; 2] = [3.0, 1.5];
/// Most that depths are corrected by, as a share: what covers the whole table must not pass for it.
const CORRECTION_MAX: f64 = 0.015;
/// Fewest samples on the table without which nothing is corrected.
const SAMPLES_MIN: usize = 300;
/// Rounds of fitting and dropping.
const ROUNDS: usize = 8;
/// How strongly each term is drawn to 0, against the samples' mean square: nothing where the table is seen
/// all over, much where a strip of it has to serve for all of the picture.
const DRAWN: [f64; 4] = [6e-4, 2.4e-3, 2.4e-3, 2e-4];

/// A point of a surface whose distance is known.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    terms: Vector4<f64>,
    share: f64,
    nearer: f64,
}

/// By what share depths read too far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Field {
    weights: Vector4<f64>,
}

impl Sample {
    /// A point in direction `ray` (x and y at distance 1) that reads too far by `share`; its surface is
    /// `distance_m` away.
    pub fn new(ray: [f64; 2], share: f64, distance_m: f64) -> Sample {
        Sample { terms: terms(ray), share, nearer: NEARER * (distance_m / NEARER_UP_TO_M).max(1.0) }
    }
}

impl Field {
    /// The field that explains the table's samples; none at all where too few are the table's.
    pub fn fitted(samples: &[Sample]) -> Field {
        let mut field = Field::default();
        for round in 0..ROUNDS {
            let farther = FARTHER[usize::from(round > ROUNDS / 2)];
            let on_table = |sample: &&Sample| {
                let off = sample.share - field.at(&sample.terms);
                off > -sample.nearer && off < farther * sample.nearer
            };
            let used: Vec<&Sample> = samples.iter().filter(on_table).collect();
            let Some(weights) = least_squares(&used) else { return Field::default() };
            field = Field { weights };
        }
        field
    }

    /// The share in direction `ray`.
    pub fn error(&self, ray: [f64; 2]) -> f64 {
        self.at(&terms(ray))
    }

    fn at(&self, terms: &Vector4<f64>) -> f64 {
        self.weights.dot(terms).clamp(-CORRECTION_MAX, CORRECTION_MAX)
    }
}

fn terms([x, y]: [f64; 2]) -> Vector4<f64> {
    Vector4::new(1.0, x, y, x * x + y * y)
}

fn least_squares(samples: &[&Sample]) -> Option<Vector4<f64>> {
    if samples.len() < SAMPLES_MIN {
        return None;
    }
    let mut normal = Matrix4::from_diagonal(&Vector4::from(DRAWN)) * samples.len() as f64;
    let mut right = Vector4::zeros();
    for Sample { terms, share, .. } in samples {
        normal += terms * terms.transpose();
        right += terms * *share;
    }
    Some(normal.cholesky()?.solve(&right))
}
