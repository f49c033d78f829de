//! How hard an object is to put out of the way: the weighting heuristics HeCP and HeTI.
//!
//! In: footprints, impedances, the workspace. Out: one positive weight an object. Source: the paper, section
//! "Weighting Heuristics", Algorithm 1. Deviations: the circumference of a non-convex footprint is that of
//! its convex hull (for a disc passing by, that is what it collides with); where the average disc does not
//! fit the workspace the constant denominator, which only scales all weights alike, is left out.

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
    use crate::geometry::footprint::Footprint;
    use crate::geometry::pose::Pose2;
    use crate::planning::random_tables::table;
    use crate::tabletop::instance::{Instance, ObjectSpec};

    fn weights(instance: &Instance) -> Vec<f64> {
        let problem = Problem::new(instance).unwrap();
        collision_probability(&problem, &(0..problem.objects.len()).collect::<Vec<_>>())
    }

    fn shapes(shapes: &[Footprint]) -> Instance {
        let objects = shapes.iter().enumerate().map(|(k, shape)| {
            let mut object = ObjectSpec::new(format!("o{k}"), shape.clone());
            object.start = Some(Pose2::new(0.25 + 0.5 * k as f64, 0.3, 0.0));
            object
        });
        table(objects.collect())
    }

    #[test]
    fn collision_probability_is_algorithm_1() {
        let found = weights(&shapes(&[
            Footprint::rectangle(0.3, 0.1).unwrap(),
            Footprint::disc((0.01 / PI).sqrt()).unwrap(),
        ]));
        // Areas 0.03 and 0.01: the average disc has 0.02, radius 0.0797885 m; (1 - 2 r)^2 = 0.7063101.
        let free = (1.0 - 2.0 * (0.02 / PI).sqrt()).powi(2);
        assert!((free - 0.706_310).abs() < 1e-6);
        let first = (0.03 + 0.02 + (0.02 / PI).sqrt() * 0.8) / free;
        let second = (0.01 + 0.02 + (0.02 / PI).sqrt() * 2.0 * PI * (0.01 / PI).sqrt()) / free;
        assert!((found[0] - first).abs() < 1e-12 && (found[1] - second).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_non_convex_footprint_counts_with_its_area_and_its_hulls_circumference() {
        let l = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.1], [0.1, 0.1], [0.1, 0.2], [0.0, 0.2]];
        let found = weights(&shapes(&[Footprint::polygon(&l).unwrap()]));
        let (area, hull) = (0.03, 0.2 + 0.1 + 0.1 * 2.0_f64.sqrt() + 0.1 + 0.2);
        let radius = (area / PI).sqrt();
        let wanted = (2.0 * area + radius * hull) / (1.0 - 2.0 * radius).powi(2);
        assert!((found[0] - wanted).abs() < 1e-12, "{found:?} not {wanted}");
    }

    #[test]
    fn where_the_average_disc_does_not_fit_the_constant_is_left_out() {
        let mut narrow = shapes(&[Footprint::rectangle(0.4, 0.1).unwrap()]);
        narrow.workspace.height = 0.2;
        narrow.objects[0].start = Some(Pose2::new(0.5, 0.1, 0.0));
        let radius = (0.04 / PI).sqrt();
        assert!((weights(&narrow)[0] - (0.08 + radius)).abs() < 1e-12);
    }

    #[test]
    fn rounding_divides_by_the_smallest() {
        assert_eq!(rounded(&[0.2, 0.32, 1.8, 0.29]), [1, 2, 9, 1]);
        assert_eq!(rounded(&[1e-9, 1e9]), [1, 1_000_000]);
        assert!(rounded(&[]).is_empty());
    }
}
