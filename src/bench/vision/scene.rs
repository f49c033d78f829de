//! Tables for the vision benchmark: marked tops that are not quite level, cameras over them, clutter that is
//! not ours.
//!
//! In: a seed. Out: [`Scene`]s with their truth, [`Sheet`]s of wood grain and printed words, cameras.
//! Figures as the benchmark requires: 30 mm markers 0.5 m from the camera, tops level within 1 degree and
//! 0.2 mm, contrast 50 to 100 %; every other scene lies on a printed sheet among markers of other families
//! and squares of random modules.

use crate::perception;
use crate::report::raster;
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use cell_vision::detect::Family;
use cell_vision::detect::family::Pattern;
use cell_vision::observe::ObserveLimits;
use cell_vision::observe::reference::DriftLimits;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use vision_pictures::render::{Ground, Lens, Print, Sheet};

pub use vision_pictures::view::{DEGRADE, bench_camera, looking_down};

/// Edge of a marker's square, m.
pub const SIZE_M: f64 = 0.03;
/// Height at which the tops should lie, m.
pub const HEIGHT_M: f64 = 0.02;
/// How far the real height may be off, m, and the real tilt, rad.
pub const HEIGHT_OFF_M: f64 = 2e-4;
/// See [`HEIGHT_OFF_M`].
pub const TILT_RAD: f64 = PI / 180.0;
/// From the camera to the plane of the markers, m.
pub const DISTANCE_M: f64 = 0.5;
/// Views of one scene.
pub const VIEWS: usize = 5;
/// Markers in one scene.
pub const MARKERS: usize = 20;
/// How far the camera is beside the middle in each view, m: a second look is from another place.
const LOOK_AROUND_M: f64 = 0.08;
/// Sides of a sheet, pixels, and their size, m.
const SHEET_EDGE: usize = 1200;
const SHEET_PIXEL_M: f64 = 2.5e-4;

/// What the cell's perception knows of a table on which nothing is expected: the lens.
pub(super) fn bare(camera: &CameraModel) -> perception::Scene {
    perception::Scene {
        camera: camera.clone(),
        objects: Vec::new(),
        reference: Vec::new(),
        limits: ObserveLimits::default(),
        foreign: None,
        drift: DriftLimits { residual_m: f64::INFINITY, shift_m: f64::INFINITY, turn_rad: f64::INFINITY },
    }
}

/// One of our markers and where it really is.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Its number.
    pub id: u32,
    /// x, y and turn, table frame.
    pub pose: Pose2,
    /// Its place among the scene's prints.
    pub print: usize,
}

/// A table, what lies on it, and the cameras that look at it.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// Under the prints.
    pub ground: Ground<'a>,
    /// Ours and foreign ones.
    pub prints: Vec<Print>,
    /// Ours.
    pub truths: Vec<Truth>,
    /// Where the cameras are, table frame.
    pub views: Vec<Isometry3<f64>>,
}

impl<'a> Scene<'a> {
    /// A scene of its own; with sheets it is a cluttered one.
    pub fn random(lens: &Lens, sheets: &'a [Sheet], random: &mut ChaCha8Rng) -> Scene<'a> {
        let views: Vec<_> = (0..VIEWS).map(|_| view(random)).collect();
        let ground = if sheets.is_empty() {
            Ground::Plain(random.random_range(60.0..200.0))
        } else {
            let sheet = &sheets[random.random_range(0..sheets.len())];
            let origin = [random.random_range(-0.3..0.3), random.random_range(-0.3..0.3)];
            Ground::Sheet(sheet, origin, random.random_range(0.0..TAU))
        };
        let mut scene = Scene { ground, prints: Vec::new(), truths: Vec::new(), views };
        let foreign = if sheets.is_empty() { 0 } else { 8 };
        while scene.truths.len() < MARKERS {
            let id = random.random_range(0..Family::Tag36h11.count());
            if scene.truths.iter().any(|truth| truth.id == id) {
                continue;
            }
            let Some(pattern) = Family::Tag36h11.pattern(id) else { continue };
            let Some((print, pose)) = scene.placed(lens, pattern, SIZE_M, random) else { break };
            scene.truths.push(Truth { id, pose, print: scene.prints.len() });
            scene.prints.push(print);
        }
        for _ in 0..foreign {
            let (pattern, size_m) = stranger(random);
            if let Some((print, _)) = scene.placed(lens, pattern, size_m, random) {
                scene.prints.push(print);
            }
        }
        scene
    }

    /// A print somewhere in the first view where there is room; `None` when there is none.
    fn placed(
        &self,
        lens: &Lens,
        pattern: Pattern,
        size_m: f64,
        random: &mut ChaCha8Rng,
    ) -> Option<(Print, Pose2)> {
        let greys = greys(random);
        let rim = (random.random_range(0.001..0.006), random.random_range(40.0..220.0));
        let mut print = Print { pattern, size_m, table_from_marker: Isometry3::identity(), greys, rim };
        for _ in 0..2000 {
            let pose = Pose2::new(
                random.random_range(-0.55..0.55),
                random.random_range(-0.55..0.55),
                random.random_range(-PI..PI),
            );
            let free = |other: &Print| {
                let at = other.table_from_marker.translation;
                (at.x - pose.x).hypot(at.y - pose.y) > 1.45 * (other.reach_m() + print.reach_m())
            };
            if !self.prints.iter().all(free) {
                continue;
            }
            print.table_from_marker = uneven(pose, random);
            if whole(&print, lens, &self.views[0]) {
                return Some((print, pose));
            }
        }
        None
    }
}

/// True when the whole top is in the picture.
pub fn whole(print: &Print, lens: &Lens, table_from_camera: &Isometry3<f64>) -> bool {
    let (width, height) = (f64::from(lens.camera.width), f64::from(lens.camera.height));
    print.outline(lens, table_from_camera).is_some_and(|corners| {
        corners.iter().all(|[x, y]| (1.0..width - 2.0).contains(x) && (1.0..height - 2.0).contains(y))
    })
}

fn view(random: &mut ChaCha8Rng) -> Isometry3<f64> {
    let mut within = |reach: f64| random.random_range(-reach..reach);
    let at = [within(LOOK_AROUND_M), within(LOOK_AROUND_M)];
    let tilt = [within(0.035), within(0.035)];
    looking_down(at, DISTANCE_M + HEIGHT_M, tilt, within(PI))
}

/// A pose on a top that is not quite level nor quite at its height.
fn uneven(pose: Pose2, random: &mut ChaCha8Rng) -> Isometry3<f64> {
    let (direction, share): (f64, f64) = (random.random_range(0.0..TAU), random.random());
    let slope = Vector3::new(direction.cos(), direction.sin(), 0.0) * TILT_RAD * share.sqrt();
    let mut at = pose.at_height(HEIGHT_M + random.random_range(-HEIGHT_OFF_M..HEIGHT_OFF_M));
    at.rotation = UnitQuaternion::from_scaled_axis(slope) * at.rotation;
    at
}

/// Black and white 50 to 100 % of the printer's range apart.
fn greys(random: &mut ChaCha8Rng) -> [f32; 2] {
    let span = 200.0 * random.random_range(0.5..1.0_f32);
    let black = 30.0 + random.random_range(0.0..1.0_f32) * (200.0 - span);
    [black, black + span]
}

/// A marker of another family, or a framed square of random modules such as other marker systems print.
fn stranger(random: &mut ChaCha8Rng) -> (Pattern, f64) {
    let families = [Family::Tag25h9, Family::Tag16h5, Family::TagStandard41h12];
    let size_m = random.random_range(0.015..0.035);
    let kind = random.random_range(0..families.len() + 2);
    let known = families.get(kind).and_then(|family| family.pattern(random.random_range(0..family.count())));
    if let Some(pattern) = known {
        return (pattern, size_m);
    }
    let white = |i: usize| {
        let (x, y) = (i % 10, i / 10);
        let ring = x.min(y).min(9 - x).min(9 - y);
        ring == 0 || ring > 1 && random.random()
    };
    (Pattern { modules: 10, square_modules: 8, white: (0..100).map(white).collect() }, size_m)
}

/// Sheets of wood grain with labels of printed words and ruled boxes.
///
/// # Errors
/// What the drawing library says.
pub fn sheets(count: usize, random: &mut ChaCha8Rng) -> Result<Vec<Sheet>, String> {
    (0..count).map(|_| sheet(random)).collect()
}

fn sheet(random: &mut ChaCha8Rng) -> Result<Sheet, String> {
    let edge = SHEET_EDGE as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{edge}\" height=\"{edge}\" \
         font-family=\"sans-serif\"><rect width=\"{edge}\" height=\"{edge}\" fill=\"#b0b0b0\"/>"
    );
    for _ in 0..260 {
        let (y, bow) = (random.random_range(-60.0..edge), random.random_range(-80.0..80.0));
        let (grey, wide) = (random.random_range(70..200), random.random_range(0.7..6.0));
        let _ = write!(
            svg,
            "<path d=\"M0 {y:.1} C{:.1} {:.1} {:.1} {:.1} {edge} {:.1}\" fill=\"none\" \
             stroke=\"rgb({grey},{grey},{grey})\" stroke-width=\"{wide:.1}\"/>",
            edge / 3.0,
            y + bow,
            edge / 1.5,
            y - bow,
            y + random.random_range(-20.0..20.0)
        );
    }
    for _ in 0..7 {
        label(&mut svg, random);
    }
    svg.push_str("</svg>");
    let png = raster::png(&svg, 1.0).map_err(|fault| fault.to_string())?;
    let picture = Image::decode(&png).map_err(|fault| fault.to_string())?;
    Ok(Sheet { greys: picture.gray().data, edge: SHEET_EDGE, pixel_m: SHEET_PIXEL_M })
}

/// A white label with lines of made-up words and a box.
fn label(svg: &mut String, random: &mut ChaCha8Rng) {
    let (x, y) = (random.random_range(0.0..1000.0), random.random_range(0.0..1000.0));
    let (width, size) = (random.random_range(150.0..400.0), random.random_range(9.0..48.0_f64));
    let turn = random.random_range(0.0..360.0);
    let _ = write!(svg, "<g transform=\"translate({x:.0} {y:.0}) rotate({turn:.0})\">");
    let _ = write!(svg, "<rect width=\"{width:.0}\" height=\"{:.0}\" fill=\"#fff\"/>", 7.5 * size);
    for line in 1..=5 {
        let letters = (width / size * 1.6) as usize;
        let word = |_| match random.random_range(0..32_u8) {
            letter @ 0..26 => char::from(b'a' + letter),
            _ => ' ',
        };
        let text: String = (0..letters).map(word).collect();
        let at = f64::from(line) * 1.2 * size;
        let _ =
            write!(svg, "<text x=\"8\" y=\"{at:.0}\" font-size=\"{size:.0}\" fill=\"#101010\">{text}</text>");
    }
    let stroke = size / 4.0;
    let _ = write!(
        svg,
        "<rect x=\"10\" y=\"{:.0}\" width=\"{:.0}\" height=\"{size:.0}\" fill=\"none\" stroke=\"#000\" \
         stroke-width=\"{stroke:.1}\"/></g>",
        6.2 * size,
        1.1 * size
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn scenes_are_as_the_figures_request_and_repeat() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let lens = Lens::new(bench_camera(), &mut random);
        let one = Scene::random(&lens, &[], &mut ChaCha8Rng::seed_from_u64(7));
        let two = Scene::random(&lens, &[], &mut ChaCha8Rng::seed_from_u64(7));
        assert_eq!(one.truths.len(), MARKERS);
        for (a, b) in one.truths.iter().zip(&two.truths) {
            assert_eq!((a.id, a.pose), (b.id, b.pose));
            let at = one.prints[a.print].table_from_marker;
            assert!((at.translation.z - HEIGHT_M).abs() <= HEIGHT_OFF_M);
            assert!((at.rotation * Vector3::z()).angle(&Vector3::z()) <= TILT_RAD + 1e-9);
            assert!(whole(&one.prints[a.print], &lens, &one.views[0]));
        }
    }

    #[test]
    fn sheets_carry_something() {
        let sheets = sheets(1, &mut ChaCha8Rng::seed_from_u64(2)).unwrap();
        let (low, high) = (sheets[0].greys.iter().min().unwrap(), sheets[0].greys.iter().max().unwrap());
        assert!(*low < 40 && *high > 240);
        assert_eq!(sheets[0].greys.len(), SHEET_EDGE * SHEET_EDGE);
    }
}
