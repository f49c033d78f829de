//! The outline an object has on the table: rectangle, disc, ellipse, or simple polygon.
//!
//! In: lengths in m, checked on construction. Out: areas, extents, outlines, and what collision tests need.
//! Extents are full lengths along the object's own x (length) and y (width); the origin of rectangle, disc
//! and ellipse is their centre, that of a polygon wherever its points put it. An ellipse is exact; only
//! `outline` approximates it, from outside.

use crate::geometry::ellipse::distance_to_ellipse;
use crate::geometry::polygon::{
    Point, Polygon, PolygonFault, centroid, contains, convex_hull, distance_to_outline, perimeter,
};
use crate::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Why numbers do not make a footprint.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FootprintFault {
    /// A length that is zero, negative, not finite, or larger than any table.
    #[error("{name} is {value} m; it has to be over 0 and at most 100")]
    Length {
        /// Which length.
        name: &'static str,
        /// Its value, m.
        value: f64,
    },
    /// The polygon is at fault.
    #[error(transparent)]
    Polygon(#[from] PolygonFault),
}

/// A footprint in the object's frame.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum Footprint {
    /// Centred rectangle: full extents along x and y, m.
    Rectangle {
        /// Along x, m.
        length: f64,
        /// Along y, m.
        width: f64,
    },
    /// Centred disc.
    Disc {
        /// Radius, m.
        radius: f64,
    },
    /// Centred ellipse: full extents along x and y, m.
    Ellipse {
        /// Along x, m.
        length: f64,
        /// Along y, m.
        width: f64,
    },
    /// Simple polygon, convex or not.
    Polygon(Polygon),
}

impl Footprint {
    /// A rectangle.
    ///
    /// # Errors
    /// A length that makes no sense.
    pub fn rectangle(length: f64, width: f64) -> Result<Footprint, FootprintFault> {
        Ok(Footprint::Rectangle { length: checked("length", length)?, width: checked("width", width)? })
    }

    /// A disc.
    ///
    /// # Errors
    /// A radius that makes no sense.
    pub fn disc(radius: f64) -> Result<Footprint, FootprintFault> {
        Ok(Footprint::Disc { radius: checked("radius", radius)? })
    }

    /// An ellipse, by its full extents.
    ///
    /// # Errors
    /// A length that makes no sense.
    pub fn ellipse(length: f64, width: f64) -> Result<Footprint, FootprintFault> {
        Ok(Footprint::Ellipse { length: checked("length", length)?, width: checked("width", width)? })
    }

    /// A simple polygon.
    ///
    /// # Errors
    /// What is wrong with the outline.
    pub fn polygon(points: &[Point]) -> Result<Footprint, FootprintFault> {
        Ok(Footprint::Polygon(Polygon::new(points)?))
    }

    /// The footprint `factor` times as large; `factor` has to be positive.
    ///
    /// # Errors
    /// As the constructors, should the result be too small or too large.
    pub fn scaled(&self, factor: f64) -> Result<Footprint, FootprintFault> {
        match self {
            Footprint::Rectangle { length, width } => Footprint::rectangle(length * factor, width * factor),
            Footprint::Disc { radius } => Footprint::disc(radius * factor),
            Footprint::Ellipse { length, width } => Footprint::ellipse(length * factor, width * factor),
            Footprint::Polygon(polygon) => {
                let points: Vec<Point> =
                    polygon.points().iter().map(|p| [p[0] * factor, p[1] * factor]).collect();
                Footprint::polygon(&points)
            }
        }
    }

    /// Area, m2.
    pub fn area(&self) -> f64 {
        match self {
            Footprint::Rectangle { length, width } => length * width,
            Footprint::Disc { radius } => PI * radius * radius,
            Footprint::Ellipse { length, width } => PI * length * width / 4.0,
            Footprint::Polygon(polygon) => polygon.area(),
        }
    }

    /// Circumference of the footprint, or of its convex hull where it is not convex, m (paper, Algorithm 1;
    /// an ellipse by Ramanujan's second formula, good to 1e-5 for the aspect ratios of tableware).
    pub fn hull_perimeter(&self) -> f64 {
        match self {
            Footprint::Rectangle { length, width } => 2.0 * (length + width),
            Footprint::Disc { radius } => TAU * radius,
            Footprint::Ellipse { length, width } => {
                let (a, b) = (length / 2.0, width / 2.0);
                let h = ((a - b) / (a + b)).powi(2);
                PI * (a + b) * (1.0 + 3.0 * h / (10.0 + (4.0 - 3.0 * h).sqrt()))
            }
            Footprint::Polygon(polygon) => perimeter(&convex_hull(polygon.points())),
        }
    }

    /// Radius of the smallest disc about the origin that covers the footprint, m.
    pub fn bounding_radius(&self) -> f64 {
        match self {
            Footprint::Rectangle { length, width } => length.hypot(*width) / 2.0,
            Footprint::Disc { radius } => *radius,
            Footprint::Ellipse { length, width } => length.max(*width) / 2.0,
            Footprint::Polygon(polygon) => {
                polygon.points().iter().map(|p| p[0].hypot(p[1])).fold(0.0, f64::max)
            }
        }
    }

    /// Centre of area, object frame, m.
    pub fn centroid(&self) -> Point {
        match self {
            Footprint::Polygon(polygon) => centroid(polygon.points()),
            Footprint::Rectangle { .. } | Footprint::Disc { .. } | Footprint::Ellipse { .. } => [0.0, 0.0],
        }
    }

    /// True when the disc of radius `margin` about `p` (object frame) lies on the footprint.
    pub fn contains_point(&self, p: Point, margin: f64) -> bool {
        match self {
            Footprint::Rectangle { length, width } => {
                p[0].abs() + margin <= length / 2.0 && p[1].abs() + margin <= width / 2.0
            }
            Footprint::Disc { radius } => p[0].hypot(p[1]) + margin <= *radius,
            Footprint::Ellipse { length, width } => {
                let semi = [length / 2.0, width / 2.0];
                (p[0] / semi[0]).powi(2) + (p[1] / semi[1]).powi(2) <= 1.0
                    && distance_to_ellipse(semi, p) >= margin
            }
            Footprint::Polygon(polygon) => {
                contains(polygon.points(), p) && distance_to_outline(polygon.points(), p) >= margin
            }
        }
    }

    /// Corners in the object frame, counter-clockwise; a curve becomes a circumscribed polygon of at least
    /// 64 and at least `corners` vertices.
    pub fn outline(&self, corners: usize) -> Vec<Point> {
        let n = corners.max(64);
        let curve = |a: f64, b: f64| {
            let grown = 1.0 / (PI / n as f64).cos();
            (0..n)
                .map(|k| {
                    let angle = TAU * k as f64 / n as f64;
                    [a * grown * angle.cos(), b * grown * angle.sin()]
                })
                .collect()
        };
        match self {
            Footprint::Rectangle { length, width } => rectangle_corners(*length, *width).to_vec(),
            Footprint::Disc { radius } => curve(*radius, *radius),
            Footprint::Ellipse { length, width } => curve(length / 2.0, width / 2.0),
            Footprint::Polygon(polygon) => polygon.points().to_vec(),
        }
    }

    /// Bounding box at `pose`: lowest x and y, highest x and y, m. Exact for every shape.
    pub fn bounds(&self, pose: &Pose2) -> (Point, Point) {
        let (sin, cos) = pose.theta.sin_cos();
        let curve = |a: f64, b: f64| {
            let (x, y) = ((a * cos).hypot(b * sin), (a * sin).hypot(b * cos));
            ([pose.x - x, pose.y - y], [pose.x + x, pose.y + y])
        };
        match self {
            Footprint::Disc { radius } => curve(*radius, *radius),
            Footprint::Ellipse { length, width } => curve(length / 2.0, width / 2.0),
            Footprint::Rectangle { length, width } => {
                points_bounds(&rectangle_corners(*length, *width), pose)
            }
            Footprint::Polygon(polygon) => points_bounds(polygon.points(), pose),
        }
    }
}

/// Corners of a centred rectangle, counter-clockwise.
pub fn rectangle_corners(length: f64, width: f64) -> [Point; 4] {
    let (x, y) = (length / 2.0, width / 2.0);
    [[-x, -y], [x, -y], [x, y], [-x, y]]
}

fn points_bounds(points: &[Point], pose: &Pose2) -> (Point, Point) {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in points {
        let p = pose.transform(*p);
        for k in 0..2 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    (low, high)
}

fn checked(name: &'static str, value: f64) -> Result<f64, FootprintFault> {
    if value > 0.0 && value <= 100.0 { Ok(value) } else { Err(FootprintFault::Length { name, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_4;

    #[test]
    fn lengths_have_to_make_sense() {
        assert!(Footprint::rectangle(0.1, 0.0).is_err());
        assert!(Footprint::disc(f64::NAN).is_err());
        assert!(Footprint::ellipse(-1.0, 1.0).is_err());
        assert!(Footprint::disc(0.1).is_ok());
    }

    #[test]
    fn bounds_of_a_turned_ellipse_are_exact() {
        let ellipse = Footprint::ellipse(0.4, 0.2).expect("valid");
        let (low, high) = ellipse.bounds(&Pose2::new(1.0, 1.0, FRAC_PI_4));
        let half = (0.5f64 * (0.04 + 0.01)).sqrt();
        assert!((high[0] - 1.0 - half).abs() < 1e-12 && (low[1] - 1.0 + half).abs() < 1e-12);
    }

    #[test]
    fn outlines_of_curves_lie_outside() {
        let ellipse = Footprint::ellipse(0.4, 0.2).expect("valid");
        let outline = ellipse.outline(0);
        assert!(outline.len() >= 64);
        let n = outline.len();
        for i in 0..n {
            let (p, q) = (outline[i], outline[(i + 1) % n]);
            let middle = [(p[0] + q[0]) / 2.0, (p[1] + q[1]) / 2.0];
            let level = (middle[0] / 0.2).powi(2) + (middle[1] / 0.1).powi(2);
            assert!((1.0 - 1e-12..1.001).contains(&level), "{level}");
        }
    }

    #[test]
    fn margins_keep_to_every_shape() {
        let shapes = [
            Footprint::rectangle(0.2, 0.1).expect("valid"),
            Footprint::ellipse(0.2, 0.1).expect("valid"),
            Footprint::polygon(&[[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]).expect("valid"),
        ];
        for shape in shapes {
            assert!(shape.contains_point([0.0, 0.0], 0.0499));
            assert!(!shape.contains_point([0.0, 0.0], 0.0501));
            assert!(!shape.contains_point([0.09, 0.049], 0.005));
        }
    }
}
