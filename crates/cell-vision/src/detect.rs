//! Finds markers in a grey picture, with sub-pixel corners.
//!
//! In: [`GrayImage`], [`DetectSettings`], the [`Family`]s looked for. Out: [`Detection`]s, sorted by id.
//! Wraps the AprilTag C library 3.2 (crate `apriltag`), with `family` the only place that calls it. Its
//! corners put the centre of the first pixel at (0.5, 0.5); half a pixel is taken off here, once, because
//! OpenCV and everything after this counts from (0, 0) (0.4 mm at 0.5 m if forgotten). `refine` then finds
//! the corners three times as exactly as the library's own refinement; OpenCV's `cornerSubPix` makes them
//! worse.

mod agreement;
pub mod detection;
pub mod family;
mod levels;
mod library;
mod piece;
mod plain;
pub mod roi;
pub mod second;

pub use detection::{DetectError, Detection};
pub use family::Family;
pub use plain::PlainLibrary;

use crate::detect::agreement::agreement;
use crate::detect::detection::sort;
use crate::detect::library::{Library, Way};
use crate::refine;
use cell_values::image::GrayImage;

/// What the detector looks for and how hard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectSettings {
    /// Quads are searched on a picture this much smaller: 1.5 halves the time, and `sharpen_px` makes good
    /// what it loses. Corners are as exact with any.
    pub decimate: f32,
    /// Unsharp mask before quads are searched, standard deviation, pixels of the smaller picture; 0 for
    /// none. It keeps a marker's white ring apart from its black square where something bright or dark lies
    /// close by.
    pub sharpen_px: f32,
    /// Exponent of a curve over the grey levels before anything is searched, 0.25 to 2; below 1 it lifts the
    /// dark ones. The library parts black from white half-way between the darkest and the brightest pixel
    /// near by. Where a sheet of paper brighter than the marker's white lies at its ring, half-way is above
    /// the ring; it is not on a curve that separates dark greys better than bright ones, as the eye does.
    /// The library's own corners, which remain where ours find no clear step, lie a fraction of a pixel
    /// inside the square's on it.
    pub tone: f32,
    /// Threads of the library, 1 to 16.
    pub threads: u8,
    /// Wrong bits repaired, 0 to 2; 2 brings false ids: one in 44,000 framed squares of other systems.
    pub bits_corrected: u8,
    /// Places where brightest and darkest differ less than this are not searched, grey levels on the curve:
    /// about the noise's range (5 standard deviations) and below the contrast of any marker worth reading.
    /// Five times as fast as searching noise.
    pub contrast_min: u8,
    /// Detections with less contrast between their bits and the threshold are dropped, grey levels of the
    /// stretched picture on the curve. It prevents hardly a false id: margins of what was read in cluttered
    /// pictures without markers reach 67, those of real markers in motion begin at 20. What does is how well
    /// the picture agrees with the print (`Rule`), so this one only drops what is within the rounding.
    pub decision_margin_min: f64,
    /// Detections with shorter edges are dropped, pixels: 3 px a module and less is guesswork.
    pub edge_min_px: f64,
    /// Corners by our own fit to the sides (`refine`); without it they are the library's.
    pub sub_pixel: bool,
}

impl Default for DetectSettings {
    fn default() -> DetectSettings {
        DetectSettings {
            decimate: 1.5,
            sharpen_px: 1.1,
            tone: 0.75,
            threads: 2,
            bits_corrected: 1,
            contrast_min: 24,
            decision_margin_min: 5.0,
            edge_min_px: 14.0,
            sub_pixel: true,
        }
    }
}

/// Nearer to the picture's border than this a corner may be where the border cuts a side, pixels.
const BORDER_PX: f64 = 3.0;

/// The marker detector with its decoding tables; make one and keep it.
#[derive(Debug)]
pub struct Detector {
    settings: DetectSettings,
    library: Library,
}

/// What the library read, and how well the picture agrees with that print.
struct Seen {
    detection: Detection,
    family: Family,
    agreement: f64,
}

impl Detector {
    /// A detector of the cell's own family with these settings.
    ///
    /// # Errors
    /// `Setting` for a value outside its range, `Library` when the library has no memory.
    pub fn new(settings: DetectSettings) -> Result<Detector, DetectError> {
        Detector::of(&[Family::Tag36h11], settings)
    }

    /// A detector of several families. Those with tables of millions of codes (52h13, 49h12, 48h12) take a
    /// while to make.
    ///
    /// # Errors
    /// As [`Detector::new`]; `Library` also for no family at all.
    pub fn of(families: &[Family], settings: DetectSettings) -> Result<Detector, DetectError> {
        check(settings)?;
        let library = Library::new(families, settings.bits_corrected, settings.threads)?;
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
        let mut seen = self.pass(picture, self.settings.way())?;
        seen.retain(|one| self.passes(one, Rule::ANY));
        let stretched = levels::stretched(picture);
        let picture = stretched.as_ref().unwrap_or(picture);
        let mut found: Vec<Detection> =
            seen.into_iter().filter_map(|one| self.refined(one, picture)).collect();
        sort(&mut found);
        Ok(found)
    }

    /// How many markers the library alone finds, before our filters: what a benchmark compares the whole
    /// with.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn library_alone(&mut self, picture: &GrayImage) -> Result<usize, DetectError> {
        self.library.search_in(self.settings.way());
        Ok(self.library.read(picture, &levels::curve(picture, self.settings.tone))?.len())
    }

    /// What the library reads in a picture that is searched in this way.
    fn pass(&mut self, picture: &GrayImage, way: Way) -> Result<Vec<Seen>, DetectError> {
        self.library.search_in(way);
        let read = self.library.read(picture, &levels::curve(picture, way.tone))?.into_iter();
        Ok(read.map(|(detection, family)| Seen::new(picture, detection, family)).collect())
    }

    /// The detection with our own corners, where its sides show a clear step; `None` where the picture's
    /// border cuts it.
    fn refined(&self, Seen { detection, family, .. }: Seen, picture: &GrayImage) -> Option<Detection> {
        let modules = family.square_modules() as f64;
        let refined = self.settings.sub_pixel.then(|| refine::corners(picture, &detection.corners, modules));
        let refined = Detection { corners: refined.flatten().unwrap_or(detection.corners), ..detection };
        inside(picture, &refined).then_some(refined)
    }

    fn passes(&self, Seen { detection, agreement, .. }: &Seen, rule: Rule) -> bool {
        detection.corners.iter().flatten().all(|value| value.is_finite())
            && detection.hamming <= self.settings.bits_corrected.min(rule.hamming_max)
            && detection.decision_margin >= self.settings.decision_margin_min
            && detection.edge_min_px() >= self.settings.edge_min_px
            && *agreement >= rule.agreement_min
    }
}

/// When a reading counts.
#[derive(Clone, Copy, Debug)]
struct Rule {
    /// Bits that may be repaired, at most.
    hamming_max: u8,
    /// Agreement with the print, at least.
    agreement_min: f64,
}

/// Evidence: in 10 pictures with 152 markers, degraded in 25 ways and searched in five, no real one agreed
/// with its print by less than 0.81 (motion of 9 px, covered borders), and all but one in a hundred by 0.89
/// and more in every other way. In 60 cluttered pictures without markers, read as tag16h5, which has so few
/// bits that something is always read, 957 false readings agreed by less than 0.4 in half of the cases and
/// by less than 0.75 in five of six. What agrees like a marker are framed squares of random modules: against
/// them only the number of bits helps, and 36 of them with one repaired are read by chance once in 800,000
/// such squares.
impl Rule {
    /// The first pass, and whatever is expected.
    const ANY: Rule = Rule { hamming_max: 2, agreement_min: 0.75 };
    /// What is not expected and only the second pass finds.
    const STRANGER: Rule = Rule { hamming_max: 1, agreement_min: 0.85 };
}

impl DetectSettings {
    /// How the first pass searches.
    fn way(&self) -> Way {
        let DetectSettings { decimate, sharpen_px, tone, contrast_min, edge_min_px, .. } = *self;
        Way { decimate, sharpen_px, tone, contrast_min, edge_min_px }
    }
}

impl Seen {
    fn new(picture: &GrayImage, detection: Detection, family: Family) -> Seen {
        let pattern = family.is_full().then(|| family.pattern(detection.id)).flatten();
        let agreement = pattern.map_or(1.0, |print| agreement(picture, &detection.corners, &print));
        Seen { detection, family, agreement }
    }
}

/// True when the corners are far enough from the picture's border to be the marker's and not the border's: a
/// square that the border cuts is read all the same, with two corners that are none.
fn inside(picture: &GrayImage, detection: &Detection) -> bool {
    let (right, below) = (f64::from(picture.width) - 1.0, f64::from(picture.height) - 1.0);
    let within = |value: f64, high: f64| (BORDER_PX..=high - BORDER_PX).contains(&value);
    detection.corners.iter().all(|[x, y]| within(*x, right) && within(*y, below))
}

fn check(settings: DetectSettings) -> Result<(), DetectError> {
    let checks = [
        ("decimate", f64::from(settings.decimate), 1.0, 4.0, "1 to 4"),
        ("sharpen_px", f64::from(settings.sharpen_px), 0.0, 3.0, "0 to 3"),
        ("tone", f64::from(settings.tone), 0.25, 2.0, "0.25 to 2"),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker;
    use crate::testing::{self, Print, USUAL};
    use rearrange::geometry::pose::Pose2;

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
        // Half a pixel forgotten would be 0.7; the library's own refinement has 0.05 and 0.12.
        assert!(median < 0.05 && high < 0.1, "median {median}, p95 {high}");
    }

    /// The cell looks from so high (`cell/views`) that a module of the smallest marker has 3.2 pixels.
    #[test]
    fn markers_of_three_pixels_a_module_are_all_found_with_corners_to_an_eighth_of_a_pixel() {
        let camera = testing::camera(1280, 720);
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let height = camera.fx * 0.025 / (8.0 * 3.0);
        let mut errors = Vec::new();
        for trial in 0..6 {
            let prints = scene(12 * trial);
            let at = testing::looking_down(0.0, 0.0, height, [0.1, -0.15], 0.3 * f64::from(trial));
            let picture = testing::render(&camera, &at, &prints, USUAL, u64::from(trial));
            let found = detector.detect(&picture).unwrap();
            assert_eq!(found.len(), prints.len(), "trial {trial}");
            for (detection, print) in found.iter().zip(&prints) {
                for (a, b) in detection.corners.iter().zip(print.corners(&camera, &at)) {
                    errors.push((a[0] - b[0]).hypot(a[1] - b[1]));
                }
            }
        }
        errors.sort_by(f64::total_cmp);
        let high = errors[errors.len() * 95 / 100];
        assert!(high < 0.125, "p95 {high}");
    }

    /// The picture in so little light, rounded to whole grey levels as a sensor does.
    fn dimmed(picture: &GrayImage, light: f64, veil: f64) -> GrayImage {
        let data =
            picture.data.iter().map(|&level| (light * f64::from(level) + veil).round() as u8).collect();
        GrayImage { data, ..*picture }
    }

    #[test]
    fn markers_in_a_twenty_fifth_of_the_light_and_in_fog_are_all_found() {
        let (camera, at) =
            (testing::camera(640, 480), testing::looking_down(0.0, 0.0, 0.4, [0.1, -0.15], 0.3));
        let prints = scene(24);
        let picture = testing::render(&camera, &at, &prints, USUAL, 3);
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        for (light, veil) in [(0.08, 0.0), (0.04, 0.0), (0.5, 102.0), (0.2, 164.0)] {
            let poor = dimmed(&picture, light, veil);
            let found = detector.detect(&poor).unwrap();
            let ids: Vec<u32> = found.iter().map(|detection| detection.id).collect();
            assert_eq!(ids, (24..36).collect::<Vec<_>>(), "light {light}, veil {veil}");
            for (detection, print) in found.iter().zip(&prints) {
                for (a, b) in detection.corners.iter().zip(print.corners(&camera, &at)) {
                    let off = (a[0] - b[0]).hypot(a[1] - b[1]);
                    assert!(off < 0.6, "light {light}, veil {veil}, marker {}: {off} px", print.id);
                }
            }
        }
    }

    #[test]
    fn the_plain_library_reads_what_it_reads_without_our_filters() {
        let drawn = marker::draw(123, 12).unwrap();
        let mut library = PlainLibrary::new(&[Family::Tag36h11], 1.0).unwrap();
        let found = library.detect(&drawn).unwrap();
        assert_eq!(found.iter().map(|detection| detection.id).collect::<Vec<_>>(), [123]);
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
        // Edges along the pixel grid are the library's own worst case: up to 0.2 px.
        assert!((centre[0] - camera.cx).hypot(centre[1] - camera.cy) < 0.08, "{centre:?}");
    }

    /// A dark print on ground as grey as its ring, 5 pixels a module, with white paper from `column` on.
    fn beside_paper(column: usize) -> GrayImage {
        let drawn = marker::draw(137, 5).unwrap();
        let (edge, at, width) = (drawn.width as usize, 40, 130);
        let mut data: Vec<u8> =
            (0..width * width).map(|i| if i % width >= column { 255 } else { 110 }).collect();
        for (row, pixels) in drawn.data.chunks_exact(edge).enumerate() {
            let from = (at + row) * width + at;
            for (pixel, &white) in data[from..from + edge].iter_mut().zip(pixels) {
                *pixel = if white > 0 { 110 } else { 30 };
            }
        }
        GrayImage { width: 130, height: 130, data }
    }

    #[test]
    fn bright_paper_at_a_dark_markers_ring_does_not_hide_it() {
        // Where the black square ends: 40 px, the ring and the eight modules of the square, to the middle of
        // a pixel.
        let is_read = |tone: f32, column: usize| {
            let settings = DetectSettings { tone, ..DetectSettings::default() };
            let found = Detector::new(settings).unwrap().detect(&beside_paper(column)).unwrap();
            let right = found.iter().flat_map(|one| one.corners).map(|[x, _]| x).fold(0.0, f64::max);
            found.len() == 1 && (right - 84.5).abs() < 1.0
        };
        for column in 88..98 {
            assert!(is_read(DetectSettings::default().tone, column), "paper from column {column} on");
        }
        let hidden: Vec<usize> = (88..98).filter(|&column| !is_read(1.0, column)).collect();
        println!("without the curve it is not read with paper from columns {hidden:?}");
        assert!(!hidden.is_empty(), "without the curve it is read as well: nothing is shown here");
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
        let flat = DetectSettings { tone: 0.0, ..DetectSettings::default() };
        assert!(Detector::new(flat).unwrap_err().to_string().contains("tone = 0 is outside 0.25 to 2"));
    }
}
