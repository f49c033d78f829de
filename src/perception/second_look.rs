//! What a look should have shown and did not: where the detector's second pass has to search.
//!
//! In: what is known of the cell, the views of a look. Out: for each view the markers that no view shows,
//! with their place in it where that is known. Reference markers are where they were surveyed, remembered
//! objects where they were seen last; any other object may be anywhere, so its absence has every picture
//! of the look searched again whole. A look that shows everything costs nothing more. Pure but for OpenCV's
//! projection.

use cell_vision::camera::CameraModel;
use cell_vision::detect::Family;
use cell_vision::detect::second::Expected;
use cell_vision::observe::{MarkedObject, PartialLook, ReferenceMarker, View};
use cell_vision::{cv, marker};
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeSet;

/// Nearer to the picture's border than this nothing is expected, pixels: the white ring has to be in it.
const BORDER_PX: f64 = 8.0;

/// A marker that no view shows.
pub(super) struct Missing {
    id: u32,
    /// Its corners in the table frame, m, where they are known.
    corners: Option<[[f64; 3]; 4]>,
}

impl Missing {
    /// Its number.
    pub(super) fn id(&self) -> u32 {
        self.id
    }

    /// Its place is known.
    pub(super) fn is_somewhere(&self) -> bool {
        self.corners.is_some()
    }
}

/// What no view shows of objects and reference markers.
pub(super) fn missing(
    objects: &[MarkedObject],
    reference: &[ReferenceMarker],
    views: &[View],
    partial: Option<&PartialLook>,
) -> Vec<Missing> {
    let seen: BTreeSet<u32> =
        views.iter().flat_map(|view| view.detections.iter().map(|seen| seen.id)).collect();
    let reference = reference
        .iter()
        .map(|known| Missing { id: known.id, corners: Some(corners(known.size, &known.pose, 0.0)) });
    let remembered = |object: &MarkedObject| {
        let known = partial?.remembered.iter().find(|(id, _)| *id == object.id);
        known.map(|(_, pose)| corners(object.marker_size, &pose.compose(&object.offset), object.height))
    };
    let objects = objects.iter().map(|object| Missing { id: object.marker_id, corners: remembered(object) });
    reference.chain(objects).filter(|one| !seen.contains(&one.id)).collect()
}

/// Those that should be in a picture taken from there.
pub(super) fn expected(
    camera: &CameraModel,
    missing: &[Missing],
    table_from_camera: &Isometry3<f64>,
) -> Vec<Expected> {
    let one = |missing: &Missing| {
        let (family, id) = (Family::Tag36h11, missing.id);
        match &missing.corners {
            None => Some(Expected::anywhere(family, id)),
            Some(corners) => {
                let corners = Some(in_picture(camera, corners, table_from_camera)?);
                Some(Expected { family, id, corners })
            }
        }
    };
    missing.iter().filter_map(one).collect()
}

/// Corners of a marker in the table frame.
fn corners(size_m: f64, pose: &Pose2, height_m: f64) -> [[f64; 3]; 4] {
    marker::corners_m(size_m).map(|corner| {
        let [x, y] = pose.transform(corner);
        [x, y, height_m]
    })
}

/// Where they are in a picture taken from there; `None` when they are not wholly in it.
fn in_picture(
    camera: &CameraModel,
    corners: &[[f64; 3]; 4],
    table_from_camera: &Isometry3<f64>,
) -> Option<[[f64; 2]; 4]> {
    let camera_from_table = table_from_camera.inverse();
    let before = |corner: &[f64; 3]| (camera_from_table * nalgebra::Point3::from(*corner)).z > 0.0;
    if !corners.iter().all(before) {
        return None;
    }
    let pixels: [[f64; 2]; 4] = cv::project(camera, &camera_from_table, corners).ok()?.try_into().ok()?;
    let (wide, high) = (f64::from(camera.width), f64::from(camera.height));
    let inside = |[x, y]: &[f64; 2]| {
        (BORDER_PX..wide - BORDER_PX).contains(x) && (BORDER_PX..high - BORDER_PX).contains(y)
    };
    pixels.iter().all(inside).then_some(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::{Perception, Scene};
    use cell_values::time::Timestamp;
    use cell_vision::detect::DetectSettings;
    use cell_vision::observe::ObserveLimits;
    use cell_vision::observe::reference::DriftLimits;
    use cell_vision::testing::{self, Degrade, Print};

    fn pose(i: u32) -> Pose2 {
        let (column, row) = (f64::from(i % 3), f64::from(i / 3));
        Pose2::new(0.06 * (column - 1.0), 0.07 * (row - 0.5), 0.55 * f64::from(i))
    }

    fn scene() -> Scene {
        let object = |i: u32| MarkedObject {
            id: format!("object {i}"),
            marker_id: i,
            marker_size: 0.025,
            height: 0.0,
            offset: Pose2::default(),
        };
        Scene {
            camera: testing::camera(640, 480),
            objects: (0..5).map(object).collect(),
            reference: vec![ReferenceMarker { id: 5, size: 0.025, pose: pose(5) }],
            limits: ObserveLimits::default(),
            foreign: None,
            drift: DriftLimits { residual_m: 1.0, shift_m: 1.0, turn_rad: 1.0 },
        }
    }

    /// In so much noise that one pass overlooks some of the markers.
    #[test]
    fn what_a_look_misses_is_searched_again_before_it_is_called_missing() {
        let (scene, at) = (scene(), testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0));
        let prints: Vec<Print> = (0..6).map(|i| Print::level(i, 0.025, pose(i), 0.0)).collect();
        let noise = Degrade { blur_px: 0.8, noise: 60.0, gradient: 0.7 };
        let picture = testing::render(&scene.camera, &at, &prints, noise, 11);
        let mut perception = Perception::new(scene, DetectSettings::default()).unwrap();
        let view = perception.grey_view(picture, at, Timestamp::ZERO, None).unwrap();
        assert!(view.detections.len() < 6, "one pass finds all: nothing is shown here");
        let seen = perception.observe(std::slice::from_ref(&view), None).unwrap();
        let trusted = seen.objects.len() + seen.suspicious.len();
        assert_eq!((trusted, seen.missing.len(), seen.reference.is_some()), (5, 0, true), "{seen:?}");
        // The picture is gone with its look: a second search of the same view finds what the view shows.
        let again = perception.observe(&[view], None).unwrap();
        assert!(!again.missing.is_empty() || again.reference.is_none(), "{again:?}");
    }

    /// The catalogue has an object that is not on the table: its absence costs two looks a second pass, and
    /// the others nothing.
    #[test]
    fn what_is_not_there_is_not_searched_for_at_every_look() {
        let (scene, at) = (scene(), testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0));
        let prints: Vec<Print> = (1..6).map(|i| Print::level(i, 0.025, pose(i), 0.0)).collect();
        let picture = testing::render(&scene.camera, &at, &prints, testing::USUAL, 11);
        let mut perception = Perception::new(scene, DetectSettings::default()).unwrap();
        let look = |perception: &mut Perception, picture: &cell_values::image::GrayImage| {
            let view = perception.grey_view(picture.clone(), at, Timestamp::ZERO, None).unwrap();
            perception.looked_again(&[view], None).unwrap().is_some()
        };
        let again: Vec<bool> = (0..4).map(|_| look(&mut perception, &picture)).collect();
        assert_eq!(again, [true, true, false, false]);
        // Once it has been there, it is missed anew.
        let whole: Vec<Print> = (0..6).map(|i| Print::level(i, 0.025, pose(i), 0.0)).collect();
        let whole = testing::render(&testing::camera(640, 480), &at, &whole, testing::USUAL, 11);
        assert!(!look(&mut perception, &whole));
        assert!(look(&mut perception, &picture));
    }

    #[test]
    fn reference_markers_and_remembered_objects_are_expected_where_they_lie() {
        let (scene, over) = (scene(), testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0));
        let partial = PartialLook {
            region: cell_vision::region::Region::disc([0.0, 0.0], 0.01),
            remembered: vec![
                ("object 2".to_owned(), pose(2)),
                ("object 3".to_owned(), Pose2::new(2.0, 0.0, 0.0)),
            ],
        };
        let lost = missing(&scene.objects, &scene.reference, &[], Some(&partial));
        let there = expected(&scene.camera, &lost, &over);
        let known: Vec<(u32, bool)> = there.iter().map(|one| (one.id, one.corners.is_some())).collect();
        assert_eq!(known, [(5, true), (0, false), (1, false), (2, true), (4, false)], "object 3 is outside");
        let print = Print::level(5, 0.025, pose(5), 0.0).corners(&scene.camera, &over);
        let found = there[0].corners.unwrap();
        assert!((0..4).all(|i| (found[i][0] - print[i][0]).hypot(found[i][1] - print[i][1]) < 0.1));
        // From behind the table nothing is.
        let behind = testing::looking_down(0.0, 0.0, -0.4, [0.0, 0.0], 0.0);
        assert!(expected(&scene.camera, &lost, &behind).iter().all(|one| one.corners.is_none()));
    }
}
