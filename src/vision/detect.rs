//! Finds tag36h11 markers in a grey picture, with sub-pixel corners.
//!
//! In: [`GrayImage`], [`DetectSettings`]. Out: [`Detection`]s, sorted by id. Wraps the AprilTag C library 3.2 (crate `apriltag`), the
//! only place that calls it. Its corners put the centre of the first pixel at (0.5, 0.5); half a pixel is taken off
//! here, once, because OpenCV and everything after this counts from (0, 0) (0.4 mm at 0.5 m if forgotten). The
//! library's edge refinement is the sub-pixel step: OpenCV's `cornerSubPix` on top of it makes corners worse.

use crate::vision::image::{GrayImage, MAX_EDGE};
use crate::vision::marker;
use serde::Serialize;

/// What the detector looks for and how hard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectSettings {
    /// Quads are searched on a picture this much smaller; 1.0 finds most, 1.5 is three times as fast at the same
    /// corner accuracy, above 2 markers get lost.
    pub decimate: f32,
    /// Threads of the library, 1 to 16.
    pub threads: u8,
    /// Wrong bits repaired, 0 to 2; 2 brings false ids.
    pub bits_corrected: u8,
    /// Detections with less contrast between their bits and the threshold are dropped (grey levels).
    pub decision_margin_min: f64,
    /// Detections with shorter edges are dropped, pixels: 3 px a module and less is guesswork.
    pub edge_min_px: f64,
}

impl Default for DetectSettings {
    fn default() -> DetectSettings {
        DetectSettings {
            decimate: 1.0,
            threads: 2,
            bits_corrected: 1,
            decision_margin_min: 20.0,
            edge_min_px: 14.0,
        }
    }
}

/// A marker seen in a picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Detection {
    /// Always `tag36h11` so far.
    pub family: String,
    /// Number within the family.
    pub id: u32,
    /// Corners of the black square, pixels (column, row; (0, 0) is the centre of the first pixel), in the marker frame
    /// (x right, y up as one reads the print): (-,-), (+,-), (+,+), (-,+).
    pub corners: [[f64; 2]; 4],
    /// Mean contrast of the bits against the decision threshold, grey levels.
    pub decision_margin: f64,
    /// Bits that had to be repaired.
    pub hamming: u8,
}

impl Detection {
    /// Where the marker's centre appears: the crossing of the diagonals, pixels.
    pub fn centre(&self) -> [f64; 2] {
        let [a, b, c, d] = self.corners;
        let (ac, bd) = ([c[0] - a[0], c[1] - a[1]], [d[0] - b[0], d[1] - b[1]]);
        let cross = ac[0] * bd[1] - ac[1] * bd[0];
        let along = ((b[0] - a[0]) * bd[1] - (b[1] - a[1]) * bd[0]) / cross;
        if along.is_finite() {
            return [a[0] + along * ac[0], a[1] + along * ac[1]];
        }
        [0, 1].map(|axis| self.corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0)
    }

    /// Length of the shortest edge, pixels.
    pub fn edge_min_px(&self) -> f64 {
        let edge = |i: usize| {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % 4]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        (0..4).map(edge).fold(f64::INFINITY, f64::min)
    }
}

/// Why there is no detector or no answer.
#[derive(Debug, thiserror::Error)]
pub enum DetectError {
    /// A setting is outside its range.
    #[error("detector setting {name} = {value} is outside {range}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// The library could not make what it needs (out of memory).
    #[error("the AprilTag library could not {what}")]
    Library {
        /// What was tried.
        what: &'static str,
        /// What the crate says.
        #[source]
        source: apriltag::Error,
    },
    /// The picture is smaller than any marker, larger than the library can address, or not as long as it says.
    #[error(
        "a {width} x {height} picture of {bytes} bytes cannot be searched (32 x 32 to {MAX_EDGE} x {MAX_EDGE})"
    )]
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes of pixels.
        bytes: usize,
    },
}

/// The marker detector with its decoding tables; make one and keep it.
#[derive(Debug)]
pub struct Detector {
    settings: DetectSettings,
    library: apriltag::Detector,
}

// SAFETY: the C detector is owned by this value alone (never cloned, its pointer never leaves this module), keeps
// no thread-local state between calls, and its worker threads end before `apriltag_detector_detect` returns.
#[allow(unsafe_code)]
unsafe impl Send for Detector {}

impl Detector {
    /// A detector with these settings.
    ///
    /// # Errors
    /// `Setting` for a value outside its range, `Library` when the library has no memory.
    pub fn new(settings: DetectSettings) -> Result<Detector, DetectError> {
        check(settings)?;
        let mut library = apriltag::Detector::builder()
            .add_family_bits(apriltag::Family::tag_36h11(), usize::from(settings.bits_corrected))
            .build()
            .map_err(|source| DetectError::Library { what: "make a detector", source })?;
        library.set_decimation(settings.decimate);
        library.set_thread_number(settings.threads);
        library.set_refine_edges(true);
        Ok(Detector { settings, library })
    }

    /// The settings it was made with.
    pub fn settings(&self) -> DetectSettings {
        self.settings
    }

    /// All markers in the picture that pass the filters, sorted by id, then by margin (best first).
    ///
    /// # Errors
    /// `Picture` if there is nothing to search, `Library` when the library has no memory.
    pub fn detect(&mut self, picture: &GrayImage) -> Result<Vec<Detection>, DetectError> {
        let image = library_image(picture)?;
        let mut found: Vec<Detection> = self.library.detect(&image).iter().map(convert).collect();
        found.retain(|detection| self.passes(detection));
        found.sort_by(|a, b| a.id.cmp(&b.id).then(b.decision_margin.total_cmp(&a.decision_margin)));
        Ok(found)
    }

    fn passes(&self, detection: &Detection) -> bool {
        detection.corners.iter().flatten().all(|value| value.is_finite())
            && detection.hamming <= self.settings.bits_corrected
            && detection.decision_margin >= self.settings.decision_margin_min
            && detection.edge_min_px() >= self.settings.edge_min_px
    }
}

fn check(settings: DetectSettings) -> Result<(), DetectError> {
    let checks = [
        ("decimate", f64::from(settings.decimate), 1.0, 4.0, "1 to 4"),
        ("threads", f64::from(settings.threads), 1.0, 16.0, "1 to 16"),
        ("bits_corrected", f64::from(settings.bits_corrected), 0.0, 2.0, "0 to 2"),
        ("decision_margin_min", settings.decision_margin_min, 0.0, 255.0, "0 to 255"),
        ("edge_min_px", settings.edge_min_px, 0.0, 1000.0, "0 to 1000"),
    ];
    for (name, value, low, high, range) in checks {
        if !(low..=high).contains(&value) {
            return Err(DetectError::Setting { name, value, range });
        }
    }
    Ok(())
}

/// The picture in the library's own buffer, whose rows are padded.
fn library_image(picture: &GrayImage) -> Result<apriltag::Image, DetectError> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let edges = 32..=MAX_EDGE;
    let whole = picture.data.len() == width * height;
    if !whole || !edges.contains(&picture.width) || !edges.contains(&picture.height) {
        return Err(DetectError::Picture {
            width: picture.width,
            height: picture.height,
            bytes: picture.data.len(),
        });
    }
    let alignment = apriltag::image_buf::DEFAULT_ALIGNMENT_U8;
    let mut image = apriltag::Image::zeros_with_alignment(width, height, alignment)
        .map_err(|source| DetectError::Library { what: "hold the picture", source })?;
    let stride = image.stride();
    let rows = image.as_slice_mut().chunks_exact_mut(stride);
    for (row, pixels) in rows.zip(picture.data.chunks_exact(width)) {
        row[..width].copy_from_slice(pixels);
    }
    Ok(image)
}

/// The library's detection in our conventions: corner order stays, half a pixel comes off.
fn convert(found: &apriltag::Detection) -> Detection {
    Detection {
        family: marker::FAMILY.to_owned(),
        id: u32::try_from(found.id()).unwrap_or(u32::MAX),
        corners: found.corners().map(|[x, y]| [x - 0.5, y - 0.5]),
        decision_margin: f64::from(found.decision_margin()),
        hamming: u8::try_from(found.hamming()).unwrap_or(u8::MAX),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::Pose2;
    use crate::vision::image::tag36h11;
    use crate::vision::testing::{self, Print, USUAL};

    /// Twelve markers of 25 mm spread over a 640 x 480 picture, every angle.
    fn scene(first_id: u32) -> Vec<Print> {
        (0..12)
            .map(|i| {
                let (column, row) = (f64::from(i % 4), f64::from(i / 4));
                let pose = Pose2::new(0.062 * (column - 1.5), 0.066 * (row - 1.0), 0.55 * f64::from(i));
                Print::level(first_id + i, 0.025, pose, 0.0)
            })
            .collect()
    }

    #[test]
    fn every_marker_is_found_with_corners_better_than_an_eighth_of_a_pixel() {
        let camera = testing::camera(640, 480);
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let mut errors = Vec::new();
        for trial in 0..4 {
            let prints = scene(12 * trial);
            let table_from_camera =
                testing::looking_down(0.0, 0.0, 0.4, [0.1, -0.15], 0.3 * f64::from(trial));
            let picture = testing::render(&camera, &table_from_camera, &prints, USUAL, u64::from(trial));
            let found = detector.detect(&picture).unwrap();
            let ids: Vec<u32> = found.iter().map(|detection| detection.id).collect();
            assert_eq!(ids, (12 * trial..12 * trial + 12).collect::<Vec<_>>());
            for (detection, print) in found.iter().zip(&prints) {
                let truth = print.corners(&camera, &table_from_camera);
                for (a, b) in detection.corners.iter().zip(truth) {
                    errors.push((a[0] - b[0]).hypot(a[1] - b[1]));
                }
            }
        }
        errors.sort_by(f64::total_cmp);
        let (median, high) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
        println!("corner error px: median {median:.3}, p95 {high:.3}, max {:.3}", errors[errors.len() - 1]);
        // Half a pixel forgotten would be 0.7.
        assert!(median < 0.08 && high < 0.15, "median {median}, p95 {high}");
    }

    #[test]
    fn corners_come_in_the_documented_order() {
        let camera = testing::camera(640, 480);
        // Camera level above the table: the marker's x goes right, its y up in the picture.
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0);
        let prints = [Print::level(3, 0.04, Pose2::default(), 0.0)];
        let picture = testing::render(&camera, &table_from_camera, &prints, USUAL, 1);
        let found = Detector::new(DetectSettings::default()).unwrap().detect(&picture).unwrap();
        let [a, b, c, d] = found[0].corners;
        assert!(a[0] < b[0] && (a[1] - b[1]).abs() < 1.0, "lower left, lower right");
        assert!(c[0] > d[0] && c[1] < b[1] && d[1] < a[1], "upper right, upper left");
        let centre = found[0].centre();
        // Edges along the pixel grid are the library's worst case: up to 0.2 px.
        assert!((centre[0] - camera.cx).hypot(centre[1] - camera.cy) < 0.2, "{centre:?}");
    }

    #[test]
    fn the_pattern_table_is_the_librarys() {
        for id in 0..tag36h11::COUNT {
            let ours = tag36h11::tag36h11_bitmap(id).unwrap();
            assert_eq!(ours, library_bitmap(id), "marker {id}");
        }
        assert_eq!(library_count(), tag36h11::COUNT);
    }

    /// The marker as the C library draws it.
    #[allow(unsafe_code)]
    fn library_bitmap(id: u32) -> [[bool; 10]; 10] {
        let mut white = [[false; 10]; 10];
        // SAFETY: the family and the image are made and freed here, the id is below the family's count, and reading
        // stays within the 10 rows of `stride` bytes that the library allocates.
        unsafe {
            let family = apriltag_sys::tag36h11_create();
            let image = apriltag_sys::apriltag_to_image(family, id as i32);
            for (row, line) in white.iter_mut().enumerate() {
                for (column, bit) in line.iter_mut().enumerate() {
                    *bit = *(*image).buf.add(row * (*image).stride as usize + column) > 127;
                }
            }
            apriltag_sys::image_u8_destroy(image);
            apriltag_sys::tag36h11_destroy(family);
        }
        white
    }

    #[allow(unsafe_code)]
    fn library_count() -> u32 {
        // SAFETY: the family is made, read and freed here.
        unsafe {
            let family = apriltag_sys::tag36h11_create();
            let count = (*family).ncodes;
            apriltag_sys::tag36h11_destroy(family);
            count
        }
    }

    #[test]
    fn a_drawn_marker_is_found_and_noise_is_not() {
        let drawn = marker::draw(123, 12).unwrap();
        let found = Detector::new(DetectSettings::default()).unwrap().detect(&drawn).unwrap();
        assert_eq!(found.iter().map(|detection| detection.id).collect::<Vec<_>>(), [123]);
        let camera = testing::camera(320, 240);
        let noise = testing::Degrade { blur_px: 1.0, noise: 60.0, gradient: 1.0 };
        let picture = testing::render(&camera, &nalgebra::Isometry3::identity(), &[], noise, 5);
        assert!(Detector::new(DetectSettings::default()).unwrap().detect(&picture).unwrap().is_empty());
    }

    #[test]
    fn broken_pictures_and_settings_are_errors() {
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        for (width, height, bytes) in [(0, 0, 0), (8, 8, 64), (640, 480, 100), (u32::MAX, 1, 5)] {
            let picture = GrayImage { width, height, data: vec![0; bytes] };
            assert!(matches!(detector.detect(&picture), Err(DetectError::Picture { .. })), "{picture:?}");
        }
        let slow = DetectSettings { decimate: f32::NAN, ..DetectSettings::default() };
        assert!(Detector::new(slow).unwrap_err().to_string().contains("decimate"));
        assert!(Detector::new(DetectSettings { threads: 0, ..DetectSettings::default() }).is_err());
    }
}
