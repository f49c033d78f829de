//! How hard an object is to put out of the way: the weighting heuristics HeCP and HeTI.
//!
//! In: footprints, impedances, the workspace. Out: one positive weight an object. Source: the paper, section
//! "Weighting Heuristics", Algorithm 1. Deviations: the circumference of a non-convex footprint is that of its
//! convex hull (for a disc passing by, that is what it collides with); where the average disc does not fit
//! the workspace the constant denominator, which only scales all weights alike, is left out.

use crate::planning::problem::Problem;
use std::f64::consts::PI;

/// HeCP: estimated probability that the object collides with an average disc thrown on the table.
///
/// One weight for each object of `objects`; the average is taken over these.
pub fn collision_probability(problem: &Problem, objects: &[usize]) -> Vec<f64> {
    let footprints = || objects.iter().map(|&i| &problem.objects[i].footprint);
    let mean_area = footprints().map(|f| f.area()).sum::<f64>() / objects.len().max(1) as f64;
    let radius = (mean_area / PI).sqrt();
    let (free_width, free_height) =
        (problem.workspace.width - 2.0 * radius, problem.workspace.height - 2.0 * radius);
    let free_area = if free_width > 0.0 && free_height > 0.0 { free_width * free_height } else { 1.0 };
    footprints().map(|f| (f.area() + mean_area + radius * f.hull_perimeter()) / free_area).collect()
}

/// HeTI: the object's impedance.
pub fn task_impedance(problem: &Problem, objects: &[usize]) -> Vec<f64> {
    objects.iter().map(|&i| problem.objects[i].impedance).collect()
}

/// Weights divided by the smallest and rounded to integers, as ERBM needs them: at least 1, and small enough
/// that no sum of them overflows.
pub fn rounded(weights: &[f64]) -> Vec<u32> {
    const LARGEST: f64 = 1e6;
    let smallest = weights.iter().copied().fold(f64::INFINITY, f64::min);
    weights.iter().map(|w| (w / smallest).round().clamp(1.0, LARGEST) as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_divides_by_the_smallest() {
        assert_eq!(rounded(&[0.2, 0.32, 1.8, 0.29]), [1, 2, 9, 1]);
        assert_eq!(rounded(&[1e-9, 1e9]), [1, 1_000_000]);
        assert!(rounded(&[]).is_empty());
    }
}
