//! Fits a square of known size, free in space or held level, to its corners in any number of views.
//!
//! In: sightings, views, a start pose, which degrees of freedom may move. Out: [`SquareFit`] with the sum of squared pixel
//! errors. Levenberg-Marquardt on pixels. Comparing the costs of fits with more and less freedom tells whether a marker is
//! really tilted: near a frontal view a tilt's own standard deviation lies, a difference of costs does not.

use crate::vision::marker;
use crate::vision::observe::View;
use crate::vision::observe::planar::Sighting;
use nalgebra::{Isometry3, Matrix2x3, Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector2, Vector3, Vector6};

/// What a fit may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// x, y and the turn about the vertical.
    Plane,
    /// The same and the height.
    PlaneAndHeight,
    /// Everything.
    All,
}

impl Freedom {
    /// Which of x, y, z, turns about x, y, z may move.
    fn mask(self) -> [bool; 6] {
        match self {
            Freedom::Plane => [true, true, false, false, false, true],
            Freedom::PlaneAndHeight => [true, true, true, false, false, true],
            Freedom::All => [true; 6],
        }
    }
}

/// A square fitted to its corners.
#[derive(Clone, Copy, Debug)]
pub struct SquareFit {
    /// Where it is.
    pub table_from_marker: Isometry3<f64>,
    /// Sum of the squared corner errors, pixels squared.
    pub cost_px2: f64,
    /// J^T J of x, y, z (1/m2) and the turns about the table's axes (1/rad2), for 1 px of noise.
    pub information: Matrix6<f64>,
}

/// Fits the square; `None` if some corner would lie behind a camera or the numbers break down.
pub fn fit(
    sightings: &[Sighting],
    size_m: f64,
    views: &[View],
    start: Isometry3<f64>,
    freedom: Freedom,
) -> Option<SquareFit> {
    let mut best = linearise(sightings, size_m, views, start)?;
    let mut damping = 1e-4;
    for _ in 0..60 {
        let Some(next) = step(&best, damping, freedom).and_then(|p| linearise(sightings, size_m, views, p))
        else {
            damping *= 10.0;
            continue;
        };
        if next.cost_px2 < best.cost_px2 {
            let gained = best.cost_px2 - next.cost_px2;
            best = next;
            damping = (damping * 0.2).max(1e-12);
            if gained < 1e-10 + 1e-8 * best.cost_px2 {
                break;
            }
        } else {
            damping *= 5.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    Some(SquareFit {
        table_from_marker: best.table_from_marker,
        cost_px2: best.cost_px2,
        information: best.information,
    })
}

/// The problem linearised at a pose.
struct Linear {
    table_from_marker: Isometry3<f64>,
    cost_px2: f64,
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
}

fn linearise(
    sightings: &[Sighting],
    size_m: f64,
    views: &[View],
    table_from_marker: Isometry3<f64>,
) -> Option<Linear> {
    let mut linear = Linear {
        table_from_marker,
        cost_px2: 0.0,
        information: Matrix6::zeros(),
        gradient: Vector6::zeros(),
    };
    for sighting in sightings {
        let camera_from_table = views.get(sighting.view)?.table_from_camera.inverse();
        let axes = camera_from_table.rotation.to_rotation_matrix().into_inner();
        for (corner, [x, y]) in marker::corners_m(size_m).into_iter().enumerate() {
            let arm = table_from_marker.rotation * Vector3::new(x, y, 0.0);
            let point =
                camera_from_table * nalgebra::Point3::from(table_from_marker.translation.vector + arm);
            if point.z <= 1e-3 {
                return None;
            }
            let seen = Vector2::new(point.x / point.z, point.y / point.z);
            let pixels = sighting.pixels_by_normalised[corner];
            let miss = pixels * (sighting.normalised[corner] - seen);
            let project = Matrix2x3::new(1.0, 0.0, -seen.x, 0.0, 1.0, -seen.y) / point.z;
            let by_shift: Matrix2x3<f64> = pixels * project * axes;
            let by_turn: Matrix2x3<f64> = -by_shift * cross(&arm);
            let mut slope = SMatrix::<f64, 2, 6>::zeros();
            slope.fixed_columns_mut::<3>(0).copy_from(&by_shift);
            slope.fixed_columns_mut::<3>(3).copy_from(&by_turn);
            linear.cost_px2 += miss.norm_squared();
            linear.information += slope.transpose() * slope;
            linear.gradient += slope.transpose() * miss;
        }
    }
    linear.cost_px2.is_finite().then_some(linear)
}

/// A damped step from a linearised pose.
fn step(linear: &Linear, damping: f64, freedom: Freedom) -> Option<Isometry3<f64>> {
    let mut matrix = linear.information;
    let mut gradient = linear.gradient;
    for (i, free) in freedom.mask().into_iter().enumerate() {
        if free {
            matrix[(i, i)] *= 1.0 + damping;
        } else {
            matrix.row_mut(i).fill(0.0);
            matrix.column_mut(i).fill(0.0);
            matrix[(i, i)] = 1.0;
            gradient[i] = 0.0;
        }
    }
    let change = matrix.cholesky()?.solve(&gradient);
    let turn = Vector3::new(change[3], change[4], change[5]);
    // A flip is reached by many small steps or not at all.
    if turn.norm() > 0.7 {
        return None;
    }
    let mut pose = linear.table_from_marker;
    pose.translation.vector += Vector3::new(change[0], change[1], change[2]);
    pose.rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    Some(pose)
}

/// The matrix of the cross product with `v` from the left.
pub fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}
