//! The hue of an object by its number, the same in every drawing and in the simulated world.
//!
//! In: its place in the catalogue or world. Out: degrees round the circle of hues, red at 0. Hues lie a
//! golden angle apart, so that neighbours differ however many there are.

/// Golden angle, degrees.
const STEP_DEG: f64 = 137.508;

/// The first object is blue.
const FIRST_DEG: f64 = 210.0;

/// Degrees, 0 to 360.
pub fn hue_deg(index: usize) -> f64 {
    (FIRST_DEG + STEP_DEG * index as f64) % 360.0
}
