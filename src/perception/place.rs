//! Where a picture was taken, by the reference markers in it.
//!
//! In: the lens, the surveyed reference markers, the markers of a picture. Out: `table_from_camera`, or what
//! keeps it from being known. For pictures without an arm: in the running cell the joints say where the
//! camera was.

use crate::perception::{Perception, Scene};
use cell_values::image::Image;
use cell_values::time::Timestamp;
use cell_vision::camera::CameraModel;
use cell_vision::detect::Detection;
use cell_vision::observe::{ReferenceMarker, View};
use cell_vision::{cv, marker};
use nalgebra::Isometry3;
use rearrange::document::chain::chain;

/// Fewest reference markers that say where a picture was taken: with these, a wrong one shows.
pub const REFERENCES_MIN: usize = 3;
/// Reference markers that fit worse than this are not where they were surveyed, pixels.
const MISFIT_PX: f64 = 1.0;

/// What a picture shows that says by itself where it was taken.
///
/// # Errors
/// A picture of another size than the lens's, or one in which it cannot be seen.
pub fn placed_view(perception: &mut Perception, image: &Image, time: Timestamp) -> Result<View, String> {
    let Scene { camera, reference, .. } = perception.scene();
    camera.check_picture(image.width, image.height).map_err(|error| error.to_string())?;
    let (camera, reference) = (camera.clone(), reference.clone());
    let detections = perception.detect_known(image).map_err(|error| chain(&error))?;
    let table_from_camera = where_taken(&camera, &reference, &detections)?;
    Ok(View { table_from_camera, detections, time, heights: None })
}

/// Where a picture was taken, by the reference markers in it.
///
/// # Errors
/// Too few reference markers, or they are not where they were surveyed.
pub fn where_taken(
    lens: &CameraModel,
    reference: &[ReferenceMarker],
    detections: &[Detection],
) -> Result<Isometry3<f64>, String> {
    let (mut on_table, mut in_picture) = (Vec::new(), Vec::new());
    for marker in reference {
        let seen: Vec<&Detection> = detections.iter().filter(|seen| seen.id == marker.id).collect();
        let [once] = seen.as_slice() else { continue };
        on_table.extend(marker::corners_m(marker.size).map(|corner| marker.pose.transform(corner)));
        in_picture.extend(once.corners);
    }
    let count = on_table.len() / 4;
    if count < REFERENCES_MIN {
        return Err(format!(
            "{count} of the {} reference markers are in it, {REFERENCES_MIN} are needed to tell where it was \
             taken: uncover them or take the picture from higher up",
            reference.len()
        ));
    }
    let pose = cv::board_pose(lens, &on_table, &in_picture).map_err(|error| chain(&error))?;
    if pose.reprojection_px > MISFIT_PX {
        return Err(format!(
            "its reference markers miss their surveyed places by {:.1} px: one was moved, or the lens is \
             another one",
            pose.reprojection_px
        ));
    }
    Ok(pose.camera_from_target.inverse())
}
