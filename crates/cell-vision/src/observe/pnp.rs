//! Fits a square of known size, free in space or held level, to its corners in any number of views.
//!
//! In: sightings, views, a start pose, which degrees of freedom may move. Out: [`SquareFit`] with the sum of
//! squared pixel errors. Levenberg-Marquardt on pixels; a [`Prior`] holds the marker nearly level at nearly
//! its height. Comparing the costs of fits with more and less freedom shows whether a marker is really
//! tilted: near a frontal view a tilt's own standard deviation lies, a difference of costs does not.

use crate::marker;
use crate::observe::input::View;
use crate::observe::sighting::Sighting;
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

/// What is known before looking: the marker lies level at its height, within these standard deviations.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Height above the table, m.
    pub height_m: f64,
    /// Of the height, m.
    pub height_std_m: f64,
    /// Of the tilt about either axis of the table, rad.
    pub tilt_std_rad: f64,
    /// Of a corner along each axis, pixels: what the other two are weighed against.
    pub corner_std_px: f64,
}

impl Prior {
    /// Square roots of the weights of height (pixels per m) and tilt (pixels per rad).
    fn stiffness(&self) -> (f64, f64) {
        // Exactly known still is a number.
        let of = |std: f64| self.corner_std_px.max(1e-4) / std.max(1e-6);
        (of(self.height_std_m), of(self.tilt_std_rad))
    }

    /// What the prior adds to `SquareFit::information`.
    pub fn information(&self) -> Matrix6<f64> {
        let (height, tilt) = self.stiffness();
        let weights = [0.0, 0.0, height * height, tilt * tilt, tilt * tilt, 0.0];
        Matrix6::from_diagonal(&Vector6::from_column_slice(&weights))
    }

    /// Adds the prior's cost, slope and weight at the pose.
    fn add_to(&self, linear: &mut Linear) {
        let (height, tilt) = self.stiffness();
        let normal = linear.table_from_marker.rotation * Vector3::z();
        let raised = linear.table_from_marker.translation.z - self.height_m;
        // A small turn w moves the normal of a nearly level marker by (w_y, -w_x).
        let misses = [(2, -height * raised, height), (3, tilt * normal.y, tilt), (4, -tilt * normal.x, tilt)];
        for (axis, miss, slope) in misses {
            linear.cost_px2 += miss * miss;
            linear.information[(axis, axis)] += slope * slope;
            linear.gradient[axis] += slope * miss;
        }
    }
}

/// A square fitted to its corners.
#[derive(Clone, Copy, Debug)]
pub struct SquareFit {
    /// Where it is.
    pub table_from_marker: Isometry3<f64>,
    /// Sum of the squared corner errors, and of the prior's misses in the same unit, pixels squared.
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
    prior: Option<&Prior>,
) -> Option<SquareFit> {
    let mut best = linearise(sightings, size_m, views, start, prior)?;
    let mut damping = 1e-4;
    for _ in 0..60 {
        let Some(next) =
            step(&best, damping, freedom).and_then(|p| linearise(sightings, size_m, views, p, prior))
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

/// What these views say about the pose of a square that is there: `SquareFit::information` without a fit.
pub fn information(
    sightings: &[Sighting],
    size_m: f64,
    views: &[View],
    table_from_marker: Isometry3<f64>,
) -> Option<Matrix6<f64>> {
    linearise(sightings, size_m, views, table_from_marker, None).map(|linear| linear.information)
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
    prior: Option<&Prior>,
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
    if let Some(prior) = prior {
        prior.add_to(&mut linear);
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
