//! A picture for people: detections with their ids, object outlines with their axes, drawn over what the
//! camera saw.
//!
//! In: an [`Image`], detections in pixels, [`Overlay`]s in the table frame with the camera's pose. Out: a
//! new [`Image`]. Points on the table go through the lens like everything else, so that an outline that does
//! not cover its object shows a wrong calibration at once. Pure; a small line and letter rasteriser of its
//! own (`raster`).

pub mod moves;
pub mod raster;

use crate::camera::CameraModel;
use crate::cv::{self, CvError};
use crate::detect::Detection;
use crate::foreign::ForeignObject;
use crate::observe::ReferenceMarker;
use crate::observe::reference::LookShift;
use cell_values::image::Image;
use nalgebra::{Isometry3, Point3};
use rearrange::geometry::pose::Pose2;

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

/// Outlines of what nothing explains, at its height.
pub fn foreign_overlays(objects: &[ForeignObject]) -> Vec<Overlay> {
    let overlay = |object: &ForeignObject| {
        let [x, y] = object.centre;
        Overlay {
            label: match object.height_m.is_finite() {
                true => format!("foreign {:.0} mm", object.height_m * 1e3),
                false => "foreign".to_string(),
            },
            pose: Pose2::new(x, y, 0.0),
            // What is known by its colour alone was placed as if it lay flat.
            height_m: if object.height_m.is_finite() { object.height_m } else { 0.0 },
            outline: object.outline.iter().map(|p| [p[0] - x, p[1] - y]).collect(),
            colour: BAD,
        }
    };
    objects.iter().map(overlay).collect()
}

/// How many times as long as it is a drift's arrow is drawn: a millimetre is hardly a pixel.
const ARROW_SCALE: f64 = 20.0;

/// Draws at each reference marker an arrow from where it was surveyed towards where it seems to have gone as
/// seen from this picture's place, twenty times as long as that, red beyond `limit_m`; and in words how far
/// the camera seems to be off there.
///
/// # Errors
/// What OpenCV reports.
pub fn draw_drift(
    image: &mut Image,
    look: &LookShift,
    reference: &[ReferenceMarker],
    limit_m: f64,
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
) -> Result<(), CvError> {
    let camera_from_table = table_from_camera.inverse();
    let pixel = |x: f64, y: f64| {
        let point = camera_from_table * Point3::new(x, y, 0.0);
        let seen = point.z > 0.01 && point.x.abs() < 3.0 * point.z && point.y.abs() < 3.0 * point.z;
        let points = if seen { vec![[point.x, point.y, point.z]] } else { Vec::new() };
        cv::project(camera, &Isometry3::identity(), &points).map(|pixels| pixels.first().copied())
    };
    for error in &look.errors {
        let Some(marker) = reference.iter().find(|marker| marker.id == error.id) else { continue };
        let [dx, dy] = error.error_m;
        let (x, y) = (marker.pose.x, marker.pose.y);
        let (Some(from), Some(to)) = (pixel(x, y)?, pixel(x + ARROW_SCALE * dx, y + ARROW_SCALE * dy)?)
        else {
            continue;
        };
        let colour = if dx.hypot(dy) > limit_m { BAD } else { GOOD };
        arrow(image, from, to, colour);
        raster::text(image, [from[0], from[1] + 12.0], &format!("{:.1} mm", dx.hypot(dy) * 1e3), colour, 2);
    }
    let shift_mm = look.shift_m[0].hypot(look.shift_m[1]) * 1e3;
    let (lift_mm, turn_deg) = (look.lift_m * 1e3, look.turn_rad.to_degrees());
    let words = format!("shift {shift_mm:.1} mm lift {lift_mm:.1} mm turn {turn_deg:.2} deg");
    raster::text(image, [f64::from(image.width) / 2.0, 14.0], &words, HINT, 2);
    Ok(())
}

fn arrow(image: &mut Image, from: [f64; 2], to: [f64; 2], colour: [u8; 3]) {
    raster::line(image, from, to, colour, 3);
    let along = (to[1] - from[1]).atan2(to[0] - from[0]);
    let barb = 0.3 * (to[0] - from[0]).hypot(to[1] - from[1]).clamp(4.0, 40.0);
    for side in [-0.5, 0.5] {
        let back = along + std::f64::consts::PI + side;
        raster::line(image, to, [to[0] + barb * back.cos(), to[1] + barb * back.sin()], colour, 3);
    }
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
        draw_outline(image, overlay, camera, table_from_camera)?;
        let reach = overlay.outline.iter().map(|p| p[0].hypot(p[1])).fold(0.01, f64::max) * 0.6;
        for (to, colour) in [([reach, 0.0], X_AXIS), ([0.0, reach], Y_AXIS)] {
            chain(image, &path(overlay, [0.0, 0.0], to, camera, table_from_camera)?, colour, 1);
        }
        let centre = path(overlay, [0.0, 0.0], [0.0, 0.0], camera, table_from_camera)?;
        if let Some(&[x, y]) = centre.first() {
            raster::text(image, [x, y + 14.0], &overlay.label, overlay.colour, 2);
        }
    }
    Ok(())
}

/// Draws the outline alone.
fn draw_outline(
    image: &mut Image,
    overlay: &Overlay,
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
) -> Result<(), CvError> {
    for (i, &from) in overlay.outline.iter().enumerate() {
        let to = overlay.outline[(i + 1) % overlay.outline.len()];
        chain(image, &path(overlay, from, to, camera, table_from_camera)?, overlay.colour, 2);
    }
    Ok(())
}

fn chain(image: &mut Image, pixels: &[[f64; 2]], colour: [u8; 3], thick: i64) {
    for pair in pixels.windows(2) {
        raster::line(image, pair[0], pair[1], colour, thick);
    }
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
    use crate::testing::{self, Print};

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
    fn a_drift_points_from_where_a_marker_was_surveyed_to_where_it_went() {
        use crate::observe::reference::ReferenceError;
        let camera = testing::camera(640, 480);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0);
        let reference = [ReferenceMarker { id: 7, size: 0.03, pose: Pose2::new(0.02, 0.01, 0.4) }];
        let look = |error_m: [f64; 2]| LookShift {
            view: 0,
            markers: 1,
            shift_m: error_m,
            turn_rad: 0.0,
            lift_m: 0.0,
            errors: vec![ReferenceError { id: 7, error_m, error_rad: 0.0, views: 1 }],
        };
        let drawn = |error_m: [f64; 2]| {
            let mut image = Image::filled(640, 480, [0; 3]);
            draw_drift(&mut image, &look(error_m), &reference, 1e-3, &camera, &table_from_camera).unwrap();
            image
        };
        let seen = |x: f64, y: f64| {
            let [u, v] = testing::project(&camera, &(table_from_camera.inverse() * Point3::new(x, y, 0.0)));
            (u.round() as u32, v.round() as u32)
        };
        // 2 mm to the right are drawn 40 mm long.
        let image = drawn([2e-3, 0.0]);
        for x in [0.02, 0.03, 0.058] {
            let (u, v) = seen(x, 0.01);
            assert_eq!(image.pixel(u, v), Some(BAD), "{x}");
        }
        let (u, v) = seen(0.07, 0.01);
        assert_eq!(image.pixel(u, v), Some([0; 3]));
        let words = (0..640 * 24).filter(|at| image.pixel(at % 640, at / 640) == Some(HINT)).count();
        assert!(words > 200, "the shift in words: {words}");
        let (u, v) = seen(0.03, 0.01);
        assert_eq!(drawn([9e-4, 0.0]).pixel(u, v), Some(GOOD));
        drawn([f64::NAN, 1e9]);
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
