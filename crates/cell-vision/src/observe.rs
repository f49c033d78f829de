//! From marker corners to an arrangement: where each object lies, how sure that is, and what cannot be
//! trusted.
//!
//! In: the objects and reference markers that exist, the lens, [`View`]s (camera pose and detections),
//! [`ObserveLimits`]. Out: [`Observation`]. The lens is taken out of each view's corners (`sighting`), which
//! are laid on the known plane of the marker (`planar`), the views are fused with outliers out (`fuse`), and
//! all views together must agree that the marker lies level at its height (`level`): an object that landed
//! on another one is *suspicious* and never among the trusted ones. Poses are in the table frame.

pub mod arrangement;
pub mod fuse;
pub mod input;
pub mod level;
pub mod planar;
pub mod pnp;
pub mod reference;
pub mod sighting;

pub use arrangement::{Duplicate, ObjectEstimate, Observation, Suspicious};
pub use input::{MarkedObject, ObserveLimits, PartialLook, ReferenceMarker, View};

use crate::camera::CameraModel;
use crate::cv::CvError;
use rearrange::geometry::pose::Pose2;
use std::collections::{BTreeMap, BTreeSet};

/// Why there is no observation.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// Two objects or references share a marker id.
    #[error("marker {marker_id} belongs to both {first} and {second}; give one of them another marker")]
    SharedMarker {
        /// The id.
        marker_id: u32,
        /// Who has it.
        first: String,
        /// Who has it too.
        second: String,
    },
    /// The camera's numbers are broken.
    #[error("the camera's calibration cannot be used")]
    Camera(#[from] crate::camera::CameraModelError),
    /// OpenCV failed.
    #[error("the marker corners could not be undistorted")]
    Cv(#[from] CvError),
}

/// Works out the arrangement from one or more pictures.
///
/// Every detection whose marker belongs to no object and no reference is reported as unknown.
///
/// # Errors
/// `SharedMarker`, `Camera`, `Cv`; what is seen or not seen is never an error.
pub fn observe(
    objects: &[MarkedObject],
    reference: &[ReferenceMarker],
    camera: &CameraModel,
    views: &[View],
    limits: &ObserveLimits,
) -> Result<Observation, ObserveError> {
    camera.check()?;
    let owners = owners(objects, reference)?;
    let sightings = sighting::sightings(camera, views)?;
    let mut observation = Observation::default();
    for object in objects {
        let seen = sightings.get(&object.marker_id).map_or(&[][..], Vec::as_slice);
        place(object, seen, views, limits, &mut observation);
    }
    let unknown: BTreeSet<u32> = sightings.keys().copied().filter(|id| !owners.contains_key(id)).collect();
    observation.unknown = unknown.into_iter().collect();
    observation.reference = reference::check(reference, &sightings, views, limits);
    observation.reference_residual_m = observation.reference.as_ref().map(|check| check.residual_rms_m);
    Ok(observation)
}

/// Who owns each marker id.
fn owners(
    objects: &[MarkedObject],
    reference: &[ReferenceMarker],
) -> Result<BTreeMap<u32, String>, ObserveError> {
    let mut owners = BTreeMap::new();
    let named = objects.iter().map(|object| (object.marker_id, format!("object {:?}", object.id)));
    let fixed = reference.iter().map(|marker| (marker.id, "the reference markers".to_owned()));
    for (marker_id, name) in named.chain(fixed) {
        if let Some(first) = owners.insert(marker_id, name.clone()) {
            return Err(ObserveError::SharedMarker { marker_id, first, second: name });
        }
    }
    Ok(owners)
}

/// Decides where one object lies and files it under the right heading of the observation.
fn place(
    object: &MarkedObject,
    seen: &[sighting::Sighting],
    views: &[View],
    limits: &ObserveLimits,
    observation: &mut Observation,
) {
    if seen.is_empty() {
        observation.missing.push(object.id.clone());
        return;
    }
    let target = planar::Target {
        size_m: object.marker_size,
        height_m: object.height,
        height_std_m: limits.height_std_m,
        tilt_std_rad: limits.tilt_std_rad,
    };
    let mut placed: Vec<planar::Placed> =
        seen.iter().filter_map(|sighting| planar::place(sighting, target, views, limits)).collect();
    placed.retain(|p| p.shape_residual_px <= limits.shape_residual_max_px);
    let misread = seen.len() - placed.len();
    let suspicious = |reason, estimate| Suspicious { id: object.id.clone(), reason, estimate };
    if placed.is_empty() {
        let reason = "the corners of its marker form no square in front of the camera: bent or half covered";
        observation.suspicious.push(suspicious(reason.to_owned(), None));
        return;
    }
    if let Some(clash) = fuse::apart_in_one_view(&placed, limits.duplicate_m) {
        observation.duplicates.push(duplicate(object, &clash));
        return;
    }
    let level = level::fit(&placed, target, views, limits);
    let complaint = match &level {
        Some(level) => level.complaint(limits),
        None => Some("its marker's pose cannot be worked out".to_owned()),
    };
    match (fuse::fuse(&placed, target, views, limits), complaint) {
        (Ok(fused), None) => {
            observation.objects.push(estimate(object, &fused, misread, level.as_ref(), views));
        }
        (Ok(fused), Some(reason)) => {
            let estimate = estimate(object, &fused, misread, level.as_ref(), views);
            observation.suspicious.push(suspicious(reason, Some(estimate)));
        }
        // Seen from two sides, what lies too high seems to lie at two places: the height explains it.
        (Err(_), Some(reason)) => observation.suspicious.push(suspicious(reason, None)),
        (Err(clash), None) if clash.apart_m > limits.duplicate_m => {
            observation.duplicates.push(duplicate(object, &clash));
        }
        (Err(clash), None) => {
            let reason = format!(
                "the pictures disagree by {:.2} mm about where it is: it moved, or the camera's pose is \
                 wrong",
                cell_values::units::mm_from_m(clash.apart_m)
            );
            observation.suspicious.push(suspicious(reason, None));
        }
    }
}

fn duplicate(object: &MarkedObject, clash: &fuse::Disagreement) -> Duplicate {
    let poses = clash.poses.iter().map(|marker| object_pose(object, marker)).collect();
    Duplicate { id: object.id.clone(), marker_id: object.marker_id, poses }
}

/// The object's pose from its marker's.
fn object_pose(object: &MarkedObject, table_from_marker: &Pose2) -> Pose2 {
    let theta = table_from_marker.theta - object.offset.theta;
    let turned = Pose2::new(0.0, 0.0, theta).transform([object.offset.x, object.offset.y]);
    Pose2::new(
        table_from_marker.x - turned[0],
        table_from_marker.y - turned[1],
        rearrange::geometry::pose::wrap_angle(theta),
    )
}

fn estimate(
    object: &MarkedObject,
    fused: &fuse::Fused,
    misread: usize,
    level: Option<&level::Level>,
    views: &[View],
) -> ObjectEstimate {
    let time = fused.views.iter().filter_map(|&view| views.get(view)).map(|view| view.time).max();
    // The marker's angle error swings the object's origin about the marker.
    let lever = object.offset.x.hypot(object.offset.y) * fused.std_theta_rad;
    ObjectEstimate {
        id: object.id.clone(),
        pose: object_pose(object, &fused.pose),
        std_xy_m: fused.std_xy_m.hypot(lever),
        std_theta_rad: fused.std_theta_rad,
        views: fused.views.len(),
        rejected_views: misread + fused.rejected,
        tilt_rad: level.map_or(0.0, level::Level::tilt_rad),
        tilt_std_rad: level.map_or(f64::INFINITY, |level| level.tilt_std_rad),
        height_error_m: level.map_or(0.0, |level| level.height_error_m),
        height_std_m: level.map_or(f64::INFINITY, |level| level.height_std_m),
        time: time.unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::{DetectSettings, Detector};
    use crate::testing::{self, Print, USUAL};
    use cell_values::time::Timestamp;
    use nalgebra::Isometry3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn object(index: u32) -> MarkedObject {
        MarkedObject {
            id: format!("plank-{index}"),
            marker_id: index,
            marker_size: 0.025,
            height: 0.02,
            offset: Pose2::new(0.004, -0.003, 0.5),
        }
    }

    /// Where object `index` of a scene lies.
    fn truth(index: u32, turn: f64) -> Pose2 {
        let (column, row) = (f64::from(index % 4), f64::from(index / 4));
        Pose2::new(0.065 * (column - 1.5), 0.068 * (row - 1.0), turn + 0.61 * f64::from(index))
    }

    fn print(object: &MarkedObject, pose: Pose2) -> Print {
        Print::level(object.marker_id, object.marker_size, pose.compose(&object.offset), object.height)
    }

    /// One view of perfect knowledge but noisy corners.
    fn noisy(prints: &[Print], tilt: [f64; 2], seed: u64) -> View {
        let camera = testing::camera(640, 480);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, tilt, 0.2);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let noise = ObserveLimits::default().corner_std_px();
        let detections = testing::detections(&camera, &table_from_camera, prints, noise, &mut random);
        View { table_from_camera, detections, time: Timestamp::from_nanos(seed), heights: None }
    }

    fn observed(objects: &[MarkedObject], views: &[View]) -> Observation {
        observe(objects, &[], &testing::camera(640, 480), views, &ObserveLimits::default()).unwrap()
    }

    #[test]
    fn poses_from_pictures_are_right_to_a_third_of_a_millimetre_and_know_it() {
        let camera = testing::camera(640, 480);
        let limits = ObserveLimits {
            systematic_xy_m: 0.0,
            systematic_theta_rad: 0.0,
            height_std_m: 0.0,
            tilt_std_rad: 0.0,
            ..Default::default()
        };
        let objects: Vec<MarkedObject> = (0..12).map(object).collect();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let (mut errors, mut normalised, mut normalised_angle) = (Vec::new(), Vec::new(), Vec::new());
        // Half of the markers lie along the pixel grid, as tidied objects do: the detector's worst case.
        let lies = |index: u32, turn: f64| {
            let pose = truth(index, turn);
            let aligned = f64::from(index % 4) * std::f64::consts::FRAC_PI_2 - 0.5;
            if index.is_multiple_of(2) { pose } else { Pose2 { theta: aligned, ..pose } }
        };
        for trial in 0..6 {
            let turn = 0.37 * trial as f64;
            let prints: Vec<Print> =
                objects.iter().map(|object| print(object, lies(object.marker_id, turn))).collect();
            let table_from_camera = testing::looking_down(0.001 * turn, 0.0, 0.42, [0.02, -0.02], 0.0);
            let picture = testing::render(&camera, &table_from_camera, &prints, USUAL, trial);
            let detections = detector.detect(&picture).unwrap();
            let views = [View { table_from_camera, detections, time: Timestamp::ZERO, heights: None }];
            let observation = observe(&objects, &[], &camera, &views, &limits).unwrap();
            assert!(observation.complete(), "{observation:?}");
            for (object, estimate) in objects.iter().zip(&observation.objects) {
                let truth = lies(object.marker_id, turn);
                errors.push(estimate.pose.distance(&truth));
                let off = [estimate.pose.x - truth.x, estimate.pose.y - truth.y];
                normalised.extend(off.map(|value| (value / estimate.std_xy_m).powi(2)));
                normalised_angle
                    .push((estimate.pose.angle_difference(&truth) / estimate.std_theta_rad).powi(2));
            }
        }
        errors.sort_by(f64::total_cmp);
        let mean = |values: &[f64]| (values.iter().sum::<f64>() / values.len() as f64).sqrt();
        let (xy, angle) = (mean(&normalised), mean(&normalised_angle));
        let (median, worst) = (errors[errors.len() / 2] * 1e3, errors[errors.len() - 1] * 1e3);
        println!("position mm: median {median:.3}, max {worst:.3}; normalised xy {xy:.2}, angle {angle:.2}");
        assert!(median < 0.1 && worst < 0.3, "median {median} mm, max {worst} mm");
        assert!((0.5..2.0).contains(&xy) && (0.5..2.0).contains(&angle), "normalised {xy}, {angle}");
    }

    #[test]
    fn half_a_pixel_matters() {
        let objects = [object(5)];
        let mut view = noisy(&[print(&objects[0], truth(5, 0.0))], [0.0; 2], 1);
        for corner in view.detections[0].corners.iter_mut().flatten() {
            *corner += 0.5;
        }
        let observation = observed(&objects, &[view]);
        assert!(observation.objects[0].pose.distance(&truth(5, 0.0)) > 3e-4);
    }

    #[test]
    fn missing_unknown_and_duplicate_markers_are_named() {
        let objects: Vec<MarkedObject> = (0..4).map(object).collect();
        let mut prints: Vec<Print> =
            objects.iter().take(3).map(|o| print(o, truth(o.marker_id, 0.0))).collect();
        prints.push(print(&objects[1], truth(9, 0.0)));
        prints.push(Print::level(77, 0.02, truth(11, 0.0), 0.0));
        let observation = observed(&objects, &[noisy(&prints, [0.0; 2], 1)]);
        assert_eq!(observation.missing, ["plank-3"]);
        assert_eq!(observation.unknown, [77]);
        assert_eq!(observation.duplicates.len(), 1);
        assert_eq!(
            (observation.duplicates[0].id.as_str(), observation.duplicates[0].poses.len()),
            ("plank-1", 2)
        );
        let ids: Vec<&str> = observation.objects.iter().map(|o| o.id.as_str()).collect();
        assert_eq!(ids, ["plank-0", "plank-2"]);
        assert!(!observation.complete());
    }

    #[test]
    fn one_marker_in_two_views_at_two_places_is_a_duplicate() {
        let objects = [object(0)];
        let views = [
            noisy(&[print(&objects[0], truth(0, 0.0))], [0.0; 2], 1),
            noisy(&[print(&objects[0], truth(7, 0.0))], [0.0, 0.2], 2),
        ];
        let observation = observed(&objects, &views);
        assert!(observation.objects.is_empty());
        assert_eq!(observation.duplicates.len() + observation.suspicious.len(), 1);
    }

    #[test]
    fn an_object_on_top_of_another_is_never_trusted() {
        let objects: Vec<MarkedObject> = (0..12).map(object).collect();
        for (degrees, raised_m) in [(4.8, 0.004), (8.0, 0.006), (15.0, 0.010), (0.0, 0.02), (0.0, -0.006)] {
            for seed in 0..12_u64 {
                let index = seed as u32;
                let level = print(&objects[index as usize], truth(index, 0.3));
                let direction = 0.52 * seed as f64;
                let axis = nalgebra::Vector3::new(direction.cos(), direction.sin(), 0.0);
                let turn = nalgebra::UnitQuaternion::from_scaled_axis(axis * f64::to_radians(degrees));
                let mut tipped = level.clone();
                tipped.table_from_marker.rotation = turn * tipped.table_from_marker.rotation;
                tipped.table_from_marker.translation.z += raised_m;
                let prints = [tipped];
                let views = [noisy(&prints, [0.15, 0.0], seed), noisy(&prints, [-0.1, 0.15], seed + 100)];
                let observation = observed(&objects[index as usize..=index as usize], &views);
                assert_eq!(
                    observation.suspicious.len(),
                    1,
                    "{degrees} deg, {raised_m} m, {seed}: {observation:?}"
                );
            }
        }
    }

    #[test]
    fn level_objects_raise_no_alarm() {
        let objects: Vec<MarkedObject> = (0..12).map(object).collect();
        for seed in 0..150 {
            let turn = 0.1 * seed as f64;
            let mut prints: Vec<Print> = objects.iter().map(|o| print(o, truth(o.marker_id, turn))).collect();
            for (i, print) in prints.iter_mut().enumerate() {
                // Level within 1 degree and 0.2 mm, as real tops are.
                let slope = nalgebra::Vector3::new((seed as f64).sin(), (i as f64).cos(), 0.0) * 0.012;
                let turn = nalgebra::UnitQuaternion::from_scaled_axis(slope);
                print.table_from_marker.rotation = turn * print.table_from_marker.rotation;
                print.table_from_marker.translation.z += 2e-4;
            }
            let views = [noisy(&prints, [0.0, 0.0], seed)];
            let observation = observed(&objects, &views);
            assert_eq!(
                observation.objects.len(),
                observation.objects.len().max(12 - observation.missing.len())
            );
            assert!(observation.suspicious.is_empty(), "{seed}: {:?}", observation.suspicious);
        }
    }

    #[test]
    fn more_pictures_help_and_an_outlier_does_not_hurt() {
        let objects = [object(6)];
        let pose = truth(6, 0.0);
        let prints = [print(&objects[0], pose)];
        let tilts = [[0.0, 0.0], [0.2, 0.0], [0.0, 0.2], [-0.2, 0.1], [0.1, -0.2]];
        let mut views: Vec<View> =
            tilts.iter().enumerate().map(|(i, &t)| noisy(&prints, t, i as u64)).collect();
        let good = observed(&objects, &views);
        let single = observed(&objects, &views[..1]);
        assert!(good.objects[0].std_xy_m < single.objects[0].std_xy_m);
        assert_eq!((good.objects[0].views, good.objects[0].time), (5, Timestamp::from_nanos(4)));
        views[2].table_from_camera.translation.x += 4e-3;
        let pulled = observed(&objects, &views);
        assert_eq!((pulled.objects[0].views, pulled.objects[0].rejected_views), (4, 1));
        assert!(pulled.objects[0].pose.distance(&pose) < 2e-4);
    }

    #[test]
    fn pictures_from_one_place_do_not_pretend_to_be_independent() {
        let objects = [object(6)];
        let prints = [print(&objects[0], truth(6, 0.0))];
        let limits = ObserveLimits {
            systematic_xy_m: 0.0,
            height_std_m: 0.0,
            tilt_std_rad: 0.0,
            ..Default::default()
        };
        let std = |views: &[View]| {
            let camera = testing::camera(640, 480);
            observe(&objects, &[], &camera, views, &limits).unwrap().objects[0].std_xy_m
        };
        let same: Vec<View> = (0..9).map(|seed| noisy(&prints, [0.1, 0.0], seed)).collect();
        let ratio = std(&same) / std(&same[..1]);
        // Were they independent, it would be a third.
        assert!((0.6..0.8).contains(&ratio), "{ratio}");
    }

    #[test]
    fn reference_markers_show_how_far_the_camera_was_bumped() {
        let reference: Vec<ReferenceMarker> =
            (0..4).map(|i| ReferenceMarker { id: 500 + i, size: 0.03, pose: truth(i * 3, 0.0) }).collect();
        let prints: Vec<Print> =
            reference.iter().map(|marker| Print::level(marker.id, marker.size, marker.pose, 0.0)).collect();
        let mut view = noisy(&prints, [0.1, 0.0], 3);
        let camera = testing::camera(640, 480);
        let check = |view: &View| {
            let views = std::slice::from_ref(view);
            let observation = observe(&[], &reference, &camera, views, &ObserveLimits::default()).unwrap();
            assert!(observation.unknown.is_empty());
            (observation.reference_residual_m.unwrap(), observation.reference.unwrap())
        };
        let (residual, fine) = check(&view);
        assert!(residual < 2e-4 && fine.markers.len() == 4);
        view.table_from_camera.translation.y += 2e-3;
        let (residual, bumped) = check(&view);
        assert!((residual - 2e-3).abs() < 2e-4 && (bumped.shift_m[1] - 2e-3).abs() < 2e-4, "{bumped:?}");
        assert!(bumped.turn_rad.abs() < 2e-3);
    }

    #[test]
    fn a_bump_in_any_direction_is_drift_and_two_looks_cannot_cancel_it() {
        let places = [(-0.12, -0.1), (0.12, -0.1), (0.12, 0.1), (-0.12, 0.1), (0.0, 0.1)];
        let marker = |(i, (x, y)): (usize, &(f64, f64))| ReferenceMarker {
            id: 500 + i as u32,
            size: 0.03,
            pose: Pose2::new(*x, *y, 0.3),
        };
        let reference: Vec<ReferenceMarker> = places.iter().enumerate().map(marker).collect();
        let prints: Vec<Print> =
            reference.iter().map(|marker| Print::level(marker.id, marker.size, marker.pose, 0.0)).collect();
        let camera = testing::camera(1280, 720);
        let limits =
            reference::DriftLimits { residual_m: 2e-3, shift_m: 1e-3, turn_rad: 0.15_f64.to_radians() };
        let check = |bump: Isometry3<f64>| {
            // From two sides: what a bump shifts to the right in one is shifted to the left in the other.
            let views: Vec<View> = [0.0, std::f64::consts::PI]
                .iter()
                .map(|turn| {
                    let believed = testing::looking_down(0.0, 0.0, 0.5, [0.05, 0.0], *turn);
                    let mut random = ChaCha8Rng::seed_from_u64(5);
                    let detections =
                        testing::detections(&camera, &(believed * bump), &prints, 0.03, &mut random);
                    View { table_from_camera: believed, detections, time: Timestamp::ZERO, heights: None }
                })
                .collect();
            observe(&[], &reference, &camera, &views, &ObserveLimits::default()).unwrap().reference.unwrap()
        };
        let fine = check(Isometry3::identity());
        assert!(!fine.drifted(&limits) && fine.looks.len() == 2, "{fine:?}");
        let mut mean_hides = false;
        for axis in 0..3 {
            let (mut moved, mut turned) = (nalgebra::Vector3::zeros(), nalgebra::Vector3::zeros());
            moved[axis] = 2e-3;
            turned[axis] = 0.3_f64.to_radians();
            for bump in [Isometry3::new(moved, nalgebra::zero()), Isometry3::new(nalgebra::zero(), turned)] {
                let bumped = check(bump);
                assert!(bumped.drifted(&limits), "{axis}: {bumped:?}");
                mean_hides |= bumped.shift_m[0].hypot(bumped.shift_m[1]) < 5e-4;
            }
        }
        assert!(mean_hides, "the mean over both looks would have shown nothing");
        let lifted = check(Isometry3::translation(0.0, 0.0, 2e-3));
        let (worst, excess) = lifted.worst_look(&limits).unwrap();
        assert!((worst.lift_m - 2e-3).abs() < 2e-4 && (excess - 2.0).abs() < 0.2, "{worst:?}");
        let broken = reference::ReferenceCheck {
            looks: vec![reference::LookShift { lift_m: f64::NAN, ..worst.clone() }],
            ..fine
        };
        assert!(broken.drifted(&limits));
    }

    #[test]
    fn a_marker_owned_twice_is_refused() {
        let camera = testing::camera(640, 480);
        let mut twin = object(1);
        twin.id = "twin".into();
        let error = observe(&[object(1), twin], &[], &camera, &[], &ObserveLimits::default()).unwrap_err();
        assert!(error.to_string().contains("plank-1") && error.to_string().contains("twin"));
    }
}
