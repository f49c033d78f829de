//! Boxes and cylinders of the cell's equipment, as the rules see them.
//!
//! In: the corners of a shape as it is drawn. Out: whether a point is inside. By projection on the edges:
//! another way than the distances that paths are checked with. Pure.

use cell_motion::bodies::shape::Outline;
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// Corners of a box, in the order of its x, y and z edges.
const BOX_CORNERS: usize = 8;

/// A box or a cylinder in the base frame.
#[derive(Clone, Debug)]
pub(super) enum Solid {
    /// A corner, and the edges from there.
    Box(Point3<f64>, [Vector3<f64>; 3]),
    /// The middle of the lower face, the axis with its length, the radius.
    Cylinder(Point3<f64>, Vector3<f64>, f64),
}

impl Solid {
    /// A box has eight corners; a cylinder is drawn as a prism round it, the corners of lower and upper face
    /// by turns. `None` for anything else.
    pub fn of(outline: &Outline) -> Option<Solid> {
        let points: Vec<Point3<f64>> = outline.points.iter().map(|point| Point3::from(*point)).collect();
        let origin = *points.first()?;
        if points.len() == BOX_CORNERS {
            return Some(Solid::Box(origin, [4, 2, 1].map(|corner| points[corner] - origin)));
        }
        let lower: Vec<&Point3<f64>> = points.iter().step_by(2).collect();
        if lower.len() < 3 || !points.len().is_multiple_of(2) {
            return None;
        }
        let sum: Vector3<f64> = lower.iter().map(|point| point.coords).sum();
        let middle = Point3::from(sum / lower.len() as f64);
        let radius = (origin - middle).norm() * (PI / lower.len() as f64).cos();
        Some(Solid::Cylinder(middle, points[1] - origin, radius))
    }

    /// How deep a point lies inside, m; negative outside.
    pub fn depth_m(&self, point: &Point3<f64>) -> f64 {
        match self {
            Solid::Box(origin, edges) => {
                let along = |edge: &Vector3<f64>| {
                    let (length, offset) = (edge.norm(), point - origin);
                    let place = offset.dot(edge) / length;
                    place.min(length - place)
                };
                edges.iter().map(along).fold(f64::INFINITY, f64::min)
            }
            Solid::Cylinder(middle, axis, radius) => {
                let (length, offset) = (axis.norm(), point - middle);
                let place = offset.dot(axis) / length;
                let beside = (offset - axis * (place / length)).norm();
                place.min(length - place).min(radius - beside)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_motion::bodies::shape::Shape;
    use nalgebra::Isometry3;

    #[test]
    fn depth_in_a_turned_box_and_in_a_cylinder() {
        let frame = Isometry3::new(Vector3::new(1.0, 0.0, 0.5), Vector3::new(0.0, 0.0, PI / 2.0));
        let solid = Solid::of(&Shape::cuboid([0.4, 0.2, 0.1], &frame).outline().unwrap()).unwrap();
        let depth = |x, y, z| solid.depth_m(&Point3::new(x, y, z));
        assert!((depth(1.0, 0.0, 0.5) - 0.05).abs() < 1e-9, "the middle");
        assert!((depth(1.0, 0.19, 0.5) - 0.01).abs() < 1e-9, "its long edge lies along y");
        assert!((depth(1.15, 0.0, 0.5) + 0.05).abs() < 1e-9, "beside its short edge");
        let solid = Solid::of(&Shape::cylinder(0.1, 0.3, &frame).outline().unwrap()).unwrap();
        let depth = |x, y, z| solid.depth_m(&Point3::new(x, y, z));
        assert!((depth(1.0, 0.0, 0.65) - 0.1).abs() < 1e-9 && (depth(1.08, 0.0, 0.6) - 0.02).abs() < 1e-9);
        assert!(depth(1.0, 0.0, 0.49) < 0.0 && depth(1.11, 0.0, 0.6) < 0.0);
    }
}
