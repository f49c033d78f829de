//! One marker in one picture, laid on the plane its height puts it on: x, y, theta and their covariance.
//!
//! In: a detection, the camera's pose, the marker's size and height. Out: [`Placed`]. The rays through the
//! undistorted corners meet the plane z = height, which starts the fit of the square of known size to the
//! corners. With the height known, a tenth of a pixel is a tenth of a millimetre at 0.5 m, where a free pose
//! would be off by several in depth; how well height and level are known enters as a prior, because a degree
//! of tilt seen from the side turns a marker by half as much in the picture. Pure.

use crate::marker;
use crate::observe::input::{ObserveLimits, View};
use crate::observe::pnp;
use crate::observe::sighting::Sighting;
use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, Matrix6, Vector2, Vector3};
use rearrange::geometry::pose::Pose2;

/// A square whose size is known, on a plane that is known.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Height of the marker above the table, m.
    pub height_m: f64,
    /// Standard deviation of that height, m.
    pub height_std_m: f64,
    /// Standard deviation of its tilt about either axis of the table, rad.
    pub tilt_std_rad: f64,
}

impl Target {
    /// What is known of it before looking.
    pub fn prior(&self, limits: &ObserveLimits) -> pnp::Prior {
        pnp::Prior {
            height_m: self.height_m,
            height_std_m: self.height_std_m,
            tilt_std_rad: self.tilt_std_rad,
            corner_std_px: limits.corner_std_px(),
        }
    }
}

/// A marker laid on its plane by one view.
#[derive(Clone, Debug)]
pub struct Placed {
    /// What was seen.
    pub sighting: Sighting,
    /// The marker's pose in the table frame.
    pub pose: Pose2,
    /// Covariance of x, y (m2) and theta (rad2): one picture's corner noise and bias, height and tilt.
    pub covariance: Matrix3<f64>,
    /// How badly the corners fit a square of the known size in any pose at all, rms, pixels.
    pub shape_residual_px: f64,
}

/// Lays a sighting on the target's plane; `None` if the rays do not meet it in front of the camera.
pub fn place(sighting: &Sighting, target: Target, views: &[View], limits: &ObserveLimits) -> Option<Placed> {
    let table_from_camera = views.get(sighting.view)?.table_from_camera;
    let landed = land(sighting, &table_from_camera, target.height_m)?;
    let start = fit_square(&landed, target.size_m)?.at_height(target.height_m);
    let alone = std::slice::from_ref(sighting);
    let fit = |start, prior: Option<&pnp::Prior>| {
        pnp::fit(alone, target.size_m, views, start, pnp::Freedom::All, prior)
    };
    let prior = target.prior(limits);
    let likely = fit(start, Some(&prior))?;
    let free = fit(likely.table_from_marker, None)?;
    let covariance = in_plane(&likely.information.try_inverse()?) * limits.corner_std_px().powi(2);
    let shape_residual_px = (free.cost_px2 / 4.0).sqrt();
    let pose = flat(&likely.table_from_marker);
    Some(Placed { sighting: sighting.clone(), pose, covariance, shape_residual_px })
}

/// x, y and the turn about the vertical of a marker that may be slightly tilted.
pub fn flat(table_from_marker: &Isometry3<f64>) -> Pose2 {
    let x_axis = table_from_marker.rotation * Vector3::x();
    let y_axis = table_from_marker.rotation * Vector3::y();
    let at = table_from_marker.translation.vector;
    // Both axes: a tilt about one of them does not turn the mean.
    Pose2::new(at.x, at.y, (x_axis.y - y_axis.x).atan2(x_axis.x + y_axis.y))
}

/// The part of a covariance of x, y, z and the turns about x, y, z that belongs to x, y and the turn about
/// z.
pub fn in_plane(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    const PLANE: [usize; 3] = [0, 1, 5];
    Matrix3::from_fn(|i, j| covariance[(PLANE[i], PLANE[j])])
}

/// The four corners on the plane z = `height_m` of the table, m; `None` if the rays do not meet it.
pub fn corners_on_plane(
    sighting: &Sighting,
    table_from_camera: &Isometry3<f64>,
    height_m: f64,
) -> Option<[[f64; 2]; 4]> {
    Some(land(sighting, table_from_camera, height_m)?.map(|landed| [landed.point.x, landed.point.y]))
}

/// A corner on the plane and how pixel noise moves it there.
#[derive(Clone, Copy)]
struct Landed {
    point: Vector2<f64>,
    /// Inverse covariance for 1 px of noise along each axis, 1/m2.
    weight: Matrix2<f64>,
}

/// Meets the rays through the corners with the plane z = `height_m`.
fn land(sighting: &Sighting, table_from_camera: &Isometry3<f64>, height_m: f64) -> Option<[Landed; 4]> {
    let origin = table_from_camera.translation.vector;
    let axes = table_from_camera.rotation.to_rotation_matrix().into_inner();
    let mut landed = [Landed { point: Vector2::zeros(), weight: Matrix2::zeros() }; 4];
    for (corner, place) in landed.iter_mut().enumerate() {
        let seen = sighting.normalised[corner];
        let ray = axes * Vector3::new(seen.x, seen.y, 1.0);
        let along = (height_m - origin.z) / ray.z;
        if !along.is_finite() || along <= 0.0 {
            return None;
        }
        let hit = origin + along * ray;
        // d hit / d seen: the ray turns, and its length to the plane changes.
        let turn = axes.fixed_columns::<2>(0).into_owned();
        let slide = Matrix2x3::new(1.0, 0.0, -ray.x / ray.z, 0.0, 1.0, -ray.y / ray.z);
        let plane_by_normalised = along * slide * turn;
        let pixels_by_plane = sighting.pixels_by_normalised[corner] * plane_by_normalised.try_inverse()?;
        *place = Landed {
            point: Vector2::new(hit.x, hit.y),
            weight: pixels_by_plane.transpose() * pixels_by_plane,
        };
    }
    Some(landed)
}

/// Least squares pose of the square on the plane.
fn fit_square(landed: &[Landed; 4], size_m: f64) -> Option<Pose2> {
    let model = marker::corners_m(size_m);
    let centre = landed.iter().map(|l| l.point).sum::<Vector2<f64>>() / 4.0;
    let (mut sin, mut cos) = (0.0, 0.0);
    for (place, corner) in landed.iter().zip(model) {
        let out = place.point - centre;
        cos += corner[0] * out.x + corner[1] * out.y;
        sin += corner[0] * out.y - corner[1] * out.x;
    }
    let mut pose = Pose2::new(centre.x, centre.y, sin.atan2(cos));
    for _ in 0..5 {
        let mut information = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for (place, corner) in landed.iter().zip(model) {
            let at = pose.transform(corner);
            let arm = Vector2::new(at[0] - pose.x, at[1] - pose.y);
            let slope = Matrix2x3::new(1.0, 0.0, -arm.y, 0.0, 1.0, arm.x);
            let miss = place.point - Vector2::new(at[0], at[1]);
            information += slope.transpose() * place.weight * slope;
            gradient += slope.transpose() * place.weight * miss;
        }
        let step = information.cholesky()?.solve(&gradient);
        pose = Pose2::new(pose.x + step.x, pose.y + step.y, pose.theta + step.z);
        if step.norm() < 1e-12 {
            break;
        }
    }
    pose.theta = rearrange::geometry::pose::wrap_angle(pose.theta);
    pose.is_finite().then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::observe::sighting::sightings;
    use crate::testing::{self, Print};
    use cell_values::time::Timestamp;
    use rand::SeedableRng;

    const TARGET: Target = Target { size_m: 0.03, height_m: 0.02, height_std_m: 0.0, tilt_std_rad: 0.0 };

    fn placed(camera: &CameraModel, seen_by: &CameraModel, noise_px: f64, seed: u64) -> (Pose2, Placed) {
        let truth = Pose2::new(0.13, -0.06, 0.7);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, [0.2, 0.1], 0.4);
        let prints = [Print::level(1, TARGET.size_m, truth, TARGET.height_m)];
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let detections = testing::detections(camera, &table_from_camera, &prints, noise_px, &mut random);
        let views = [View { table_from_camera, detections, time: Timestamp::ZERO, heights: None }];
        let seen = sightings(seen_by, &views).unwrap();
        (truth, place(&seen[&1][0], TARGET, &views, &ObserveLimits::default()).unwrap())
    }

    #[test]
    fn exact_corners_give_the_exact_pose() {
        let camera = testing::camera(1280, 720);
        let (truth, placed) = placed(&camera, &camera, 0.0, 0);
        assert!(placed.pose.distance(&truth) < 1e-8 && placed.pose.angle_difference(&truth) < 1e-7);
        assert!(placed.shape_residual_px < 1e-4);
    }

    #[test]
    fn a_lens_taken_for_perfect_costs_millimetres() {
        let camera = testing::camera(1280, 720);
        let pinhole = CameraModel { distortion: [0.0; 5], ..camera.clone() };
        let (truth, placed) = placed(&camera, &pinhole, 0.0, 0);
        assert!(placed.pose.distance(&truth) > 4e-4, "{:?}", placed.pose);
    }

    #[test]
    fn the_covariance_is_that_of_the_errors() {
        let camera = testing::camera(1280, 720);
        let noise = ObserveLimits::default().corner_std_px();
        let mut normalised = 0.0;
        let trials = 300;
        for seed in 0..trials {
            let (truth, placed) = placed(&camera, &camera, noise, seed);
            let off = Vector3::new(
                placed.pose.x - truth.x,
                placed.pose.y - truth.y,
                placed.pose.theta - truth.theta,
            );
            normalised += (off.transpose() * placed.covariance.try_inverse().unwrap() * off)[(0, 0)];
        }
        // Chi squared with 3 degrees of freedom: its mean is 3, the mean of 300 within 0.5 of it.
        let mean = normalised / trials as f64;
        assert!((mean - 3.0).abs() < 0.5, "{mean}");
    }

    /// A marker raised and tilted as its prior allows, seen from the side; the pose found, normalised by its
    /// covariance.
    fn normalised_off(prior_m: f64, prior_rad: f64, seed: u64) -> f64 {
        let camera = testing::camera(1280, 720);
        let limits = ObserveLimits::default();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.5, [0.0, 0.0], 0.4);
        let truth = Pose2::new(0.3, -0.1, 0.3 * seed as f64);
        let mut print =
            Print::level(1, TARGET.size_m, truth, TARGET.height_m + 2e-4 * testing::normal(&mut random));
        let slope = Vector3::new(testing::normal(&mut random), testing::normal(&mut random), 0.0) * 0.01;
        let tilt = nalgebra::UnitQuaternion::from_scaled_axis(slope);
        print.table_from_marker.rotation = tilt * print.table_from_marker.rotation;
        let noise = limits.corner_std_px();
        let prints = [print];
        let detections = testing::detections(&camera, &table_from_camera, &prints, noise, &mut random);
        let views = [View { table_from_camera, detections, time: Timestamp::ZERO, heights: None }];
        let seen = sightings(&camera, &views).unwrap();
        let target = Target { height_std_m: prior_m, tilt_std_rad: prior_rad, ..TARGET };
        let placed = place(&seen[&1][0], target, &views, &limits).unwrap();
        let turned = rearrange::geometry::pose::wrap_angle(placed.pose.theta - truth.theta);
        let off = Vector3::new(placed.pose.x - truth.x, placed.pose.y - truth.y, turned);
        (off.transpose() * placed.covariance.try_inverse().unwrap() * off)[(0, 0)]
    }

    #[test]
    fn height_and_tilt_that_are_not_exact_are_in_the_covariance() {
        let mean = |prior_m, prior_rad| {
            (0..200).map(|seed| normalised_off(prior_m, prior_rad, seed)).sum::<f64>() / 200.0
        };
        let (reported, unstated) = (mean(2e-4, 0.01), mean(0.0, 0.0));
        assert!((reported - 3.0).abs() < 0.6, "{reported}");
        assert!(unstated > 6.0, "a degree of tilt seen from the side is no small thing: {unstated}");
    }

    #[test]
    fn a_plane_behind_the_camera_is_no_place() {
        let camera = testing::camera(1280, 720);
        let (_, placed) = placed(&camera, &camera, 0.0, 0);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, [0.2, 0.1], 0.4);
        let views = [View { table_from_camera, detections: vec![], time: Timestamp::ZERO, heights: None }];
        let above = Target { height_m: 1.0, ..TARGET };
        assert!(place(&placed.sighting, above, &views, &ObserveLimits::default()).is_none());
    }
}
