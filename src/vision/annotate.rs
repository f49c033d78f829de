//! A picture for people: detections with their ids, object outlines with their axes, drawn over what the camera saw.
//!
//! In: an [`Image`], detections in pixels, [`Overlay`]s in the table frame with the camera's pose. Out: a new [`Image`]. Points on the table go
//! through the lens like everything else, so that an outline that does not cover its object shows a wrong
//! calibration at once. Pure; a small line and letter rasteriser of its own (`raster`).

pub mod raster;

use crate::geometry::pose::Pose2;
use crate::vision::camera::CameraModel;
use crate::vision::cv::{self, CvError};
use crate::vision::detect::Detection;
use crate::vision::image::Image;
use nalgebra::{Isometry3, Point3};

/// Green: fine.
pub const GOOD: [u8; 3] = [40, 220, 60];
/// Red: something to look at.
pub const BAD: [u8; 3] = [255, 50, 40];
/// Yellow: for information, as a goal.
pub const HINT: [u8; 3] = [255, 215, 0];
const MARKER: [u8; 3] = [0, 200, 255];
const X_AXIS: [u8; 3] = [255, 60, 60];
const Y_AXIS: [u8; 3] = [60, 230, 60];

/// Something on the table to be outlined.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// Written beside it.
    pub label: String,
    /// Its pose in the table frame.
    pub pose: Pose2,
    /// Height at which the outline is drawn (the object's top), m.
    pub height_m: f64,
    /// Outline in the object's frame, m; closed by itself.
    pub outline: Vec<[f64; 2]>,
    /// Colour of the outline and the label.
    pub colour: [u8; 3],
}

/// Draws the detections: the black square's edges, a dot at its lower left corner, its id.
pub fn draw_detections(image: &mut Image, detections: &[Detection]) {
    for detection in detections {
        for i in 0..4 {
            raster::line(image, detection.corners[i], detection.corners[(i + 1) % 4], MARKER, 2);
        }
        raster::dot(image, detection.corners[0], 3, BAD);
        let [x, y] = detection.centre();
        raster::text(image, [x, y], &detection.id.to_string(), MARKER, 2);
    }
}

/// Draws outlines with axes (x red, y green) and labels, as the camera at that pose sees them.
///
/// # Errors
/// What OpenCV reports; points behind the camera are left out.
pub fn draw_overlays(
    image: &mut Image,
    overlays: &[Overlay],
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
) -> Result<(), CvError> {
    for overlay in overlays {
        let mut draw = |from: [f64; 2], to: [f64; 2], colour, thick| {
            path(overlay, from, to, camera, table_from_camera).map(|pixels| {
                for pair in pixels.windows(2) {
                    raster::line(image, pair[0], pair[1], colour, thick);
                }
            })
        };
        for (i, &from) in overlay.outline.iter().enumerate() {
            let to = overlay.outline[(i + 1) % overlay.outline.len()];
            draw(from, to, overlay.colour, 2)?;
        }
        let reach = overlay.outline.iter().map(|p| p[0].hypot(p[1])).fold(0.01, f64::max) * 0.6;
        draw([0.0, 0.0], [reach, 0.0], X_AXIS, 1)?;
        draw([0.0, 0.0], [0.0, reach], Y_AXIS, 1)?;
        let centre = path(overlay, [0.0, 0.0], [0.0, 0.0], camera, table_from_camera)?;
        if let Some(&[x, y]) = centre.first() {
            raster::text(image, [x, y + 14.0], &overlay.label, overlay.colour, 2);
        }
    }
    Ok(())
}

/// A straight line on the object as a chain of pixels: the lens bends it.
fn path(
    overlay: &Overlay,
    from: [f64; 2],
    to: [f64; 2],
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
) -> Result<Vec<[f64; 2]>, CvError> {
    const PIECES: u32 = 8;
    let camera_from_table = table_from_camera.inverse();
    let on_table = |i: u32| {
        let t = f64::from(i) / f64::from(PIECES);
        let p = overlay.pose.transform([from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]);
        camera_from_table * Point3::new(p[0], p[1], overlay.height_m)
    };
    let points: Vec<[f64; 3]> = (0..=PIECES)
        .map(on_table)
        .filter(|point| point.z > 0.01 && point.x.abs() < 3.0 * point.z && point.y.abs() < 3.0 * point.z)
        .map(|point| [point.x, point.y, point.z])
        .collect();
    cv::project(camera, &Isometry3::identity(), &points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::testing::{self, Print};

    #[test]
    fn outlines_lie_where_the_camera_sees_the_object() {
        let camera = testing::camera(640, 480);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, [0.2, -0.1], 0.3);
        let pose = Pose2::new(0.05, -0.03, 0.4);
        let overlay = Overlay {
            label: "plank-1".into(),
            pose,
            height_m: 0.02,
            outline: vec![[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]],
            colour: GOOD,
        };
        let mut image = Image::filled(640, 480, [0; 3]);
        draw_overlays(&mut image, &[overlay], &camera, &table_from_camera).unwrap();
        for [x, y] in Print::level(0, 0.04, pose, 0.02).corners(&camera, &table_from_camera) {
            assert_eq!(image.pixel(x.round() as u32, y.round() as u32), Some(GOOD), "{x} {y}");
        }
    }

    #[test]
    fn detections_are_drawn_and_nothing_outside_breaks() {
        let mut image = Image::filled(100, 80, [0; 3]);
        let detection = Detection {
            family: "tag36h11".into(),
            id: 42,
            corners: [[20.0, 60.0], [60.0, 60.0], [60.0, 20.0], [20.0, 20.0]],
            decision_margin: 50.0,
            hamming: 0,
        };
        let mut outside = detection.clone();
        outside.corners = [[-1e9, 1e9], [f64::NAN, 60.0], [1e12, -1e12], [f64::INFINITY, 0.0]];
        draw_detections(&mut image, &[detection, outside]);
        assert_eq!(image.pixel(40, 60), Some(MARKER));
        assert_eq!(image.pixel(20, 60), Some(BAD));
        assert_eq!(image.pixel(90, 70), Some([0; 3]));
    }
}
