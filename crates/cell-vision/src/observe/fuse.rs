//! Several views of one marker become one pose; a view that disagrees is left out, two places are not one.
//!
//! In: the placed sightings of one marker. Out: [`Fused`], or [`Disagreement`]. The median decides which is
//! an outlier; one square is fitted to the corners of all the rest, so that views from several sides also
//! determine height and tilt. Corner errors that repeat while the camera is at rest (the bias of the pixel
//! grid) are counted once for each place the camera was at, not once for each picture: five pictures from
//! one place are hardly better than one, and the standard deviation says so. Pure.

use crate::observe::input::{ObserveLimits, View};
use crate::observe::planar::{self, Placed, Target};
use crate::observe::pnp;
use crate::observe::sighting::Sighting;
use nalgebra::{Matrix2, Matrix3, Vector3};
use rearrange::geometry::pose::{Pose2, wrap_angle};

/// The common pose of one marker.
#[derive(Clone, Debug)]
pub struct Fused {
    /// The marker in the table frame.
    pub pose: Pose2,
    /// Covariance of x, y (m2) and theta (rad2), what no number of pictures improves included.
    pub covariance: Matrix3<f64>,
    /// Standard deviation along the worse axis, m.
    pub std_xy_m: f64,
    /// Standard deviation of the angle, rad.
    pub std_theta_rad: f64,
    /// Views that contributed, ascending.
    pub views: Vec<usize>,
    /// Views left out as outliers.
    pub rejected: usize,
}

/// Views of one marker that cannot be the same thing.
#[derive(Clone, Debug)]
pub struct Disagreement {
    /// What each view says, table frame.
    pub poses: Vec<Pose2>,
    /// Largest distance between two of them, m.
    pub apart_m: f64,
}

/// Two or more sightings in one and the same view that lie apart, or `None`.
pub fn apart_in_one_view(placed: &[Placed], limit_m: f64) -> Option<Disagreement> {
    let same_view = |a: &Placed, b: &Placed| a.sighting.view == b.sighting.view;
    let clash = placed.iter().enumerate().any(|(i, a)| {
        placed.iter().skip(i + 1).any(|b| same_view(a, b) && a.pose.distance(&b.pose) > limit_m)
    });
    clash.then(|| disagreement(placed))
}

/// Fuses the views.
///
/// # Errors
/// [`Disagreement`] when no majority agrees, or when an outlier lies further off than `duplicate_m`.
pub fn fuse(
    placed: &[Placed],
    target: Target,
    views: &[View],
    limits: &ObserveLimits,
) -> Result<Fused, Disagreement> {
    let Some(middle) = middle(placed) else { return Err(disagreement(placed)) };
    let sigmas = |p: &Placed| {
        let off = difference(&p.pose, &middle);
        let information = (p.covariance + systematic(limits)).try_inverse();
        information.map_or(f64::INFINITY, |w| (off.transpose() * w * off)[(0, 0)].max(0.0).sqrt())
    };
    let (inliers, outliers): (Vec<&Placed>, Vec<&Placed>) =
        placed.iter().partition(|p| sigmas(p) <= limits.outlier_sigmas);
    let far = outliers.iter().any(|p| p.pose.distance(&middle) > limits.duplicate_m);
    if far || 2 * inliers.len() <= placed.len() {
        return Err(disagreement(placed));
    }
    let rejected = outliers.len();
    together(&inliers, &middle, target, views, limits)
        .map(|fused| Fused { rejected, ..fused })
        .ok_or_else(|| disagreement(placed))
}

/// The component-wise median of the poses, angles taken relative to the first; `None` for no poses.
pub fn middle(placed: &[Placed]) -> Option<Pose2> {
    let first = placed.first()?.pose;
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let half = values.len() / 2;
        if values.len() % 2 == 1 { values[half] } else { 0.5 * (values[half - 1] + values[half]) }
    };
    Some(Pose2::new(
        median(placed.iter().map(|p| p.pose.x).collect()),
        median(placed.iter().map(|p| p.pose.y).collect()),
        wrap_angle(
            first.theta + median(placed.iter().map(|p| wrap_angle(p.pose.theta - first.theta)).collect()),
        ),
    ))
}

/// The sightings grouped by where the camera was (within 1 mm and 2 mrad), as indices into `placed`.
pub fn places<P: std::borrow::Borrow<Placed>>(placed: &[P], views: &[View]) -> Vec<Vec<usize>> {
    let stood = |i: usize| views.get(placed[i].borrow().sighting.view).map(|view| view.table_from_camera);
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for i in 0..placed.len() {
        let near = groups.iter_mut().find(|group| match (stood(group[0]), stood(i)) {
            (Some(a), Some(b)) => {
                (a.translation.vector - b.translation.vector).norm() < 1e-3
                    && a.rotation.angle_to(&b.rotation) < 2e-3
            }
            _ => false,
        });
        match near {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}

/// What no number of pictures improves.
fn systematic(limits: &ObserveLimits) -> Matrix3<f64> {
    let xy = limits.systematic_xy_m.powi(2);
    Matrix3::from_diagonal(&Vector3::new(xy, xy, limits.systematic_theta_rad.powi(2)))
}

/// One square fitted to all inliers, and its covariance.
fn together(
    inliers: &[&Placed],
    about: &Pose2,
    target: Target,
    views: &[View],
    limits: &ObserveLimits,
) -> Option<Fused> {
    let prior = target.prior(limits);
    let start = about.at_height(target.height_m);
    let fit =
        |seen: &[Sighting]| pnp::fit(seen, target.size_m, views, start, pnp::Freedom::All, Some(&prior));
    let sightings: Vec<Sighting> = inliers.iter().map(|p| p.sighting.clone()).collect();
    let joint = fit(&sightings)?;
    // The part of the corner error that is new in each picture averages out, the rest only between places.
    let (fresh, shared) = (limits.corner_noise_px.powi(2), limits.corner_bias_px.powi(2));
    let mut scatter = prior.information() * limits.corner_std_px().powi(2);
    for place in places(inliers, views) {
        let seen: Vec<Sighting> = place.iter().map(|&i| sightings[i].clone()).collect();
        let at = joint.table_from_marker;
        scatter += pnp::information(&seen, target.size_m, views, at)? * (fresh + shared * place.len() as f64);
    }
    let spread = joint.information.try_inverse()?;
    let covariance = planar::in_plane(&(spread * scatter * spread)) + systematic(limits);
    let plane = Matrix2::from_fn(|i, j| covariance[(i, j)]);
    let mut used: Vec<usize> = inliers.iter().map(|p| p.sighting.view).collect();
    used.sort_unstable();
    used.dedup();
    let pose = planar::flat(&joint.table_from_marker);
    pose.is_finite().then_some(Fused {
        pose,
        covariance,
        std_xy_m: plane.symmetric_eigenvalues().max().max(0.0).sqrt(),
        std_theta_rad: covariance[(2, 2)].max(0.0).sqrt(),
        views: used,
        rejected: 0,
    })
}

fn difference(pose: &Pose2, about: &Pose2) -> Vector3<f64> {
    Vector3::new(pose.x - about.x, pose.y - about.y, wrap_angle(pose.theta - about.theta))
}

fn disagreement(placed: &[Placed]) -> Disagreement {
    let poses: Vec<Pose2> = placed.iter().map(|p| p.pose).collect();
    let apart = |(i, a): (usize, &Pose2)| poses.iter().skip(i + 1).map(|b| a.distance(b)).fold(0.0, f64::max);
    let apart_m = poses.iter().enumerate().map(apart).fold(0.0, f64::max);
    Disagreement { poses, apart_m }
}
