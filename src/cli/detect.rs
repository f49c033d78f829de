//! `celld detect IMAGE`: the markers in a picture, as a table or as JSON, and drawn on a copy.
//!
//! In: a PNG or JPEG file; optionally the camera's calibration, which adds a size check, and with the
//! markers' size the distance and tilt of each; or the cell's configuration, which adds the objects on the
//! table, and with a depth picture what carries no marker. Out: stdout, and the annotated picture. Exit
//! codes: 0 markers found, 1 none found, 2 bad input.

mod table;

use crate::config::pictures::{read_camera, read_picture};
use cell_edge::files;
use cell_values::image::Image;
use cell_values::units::{deg_from_rad, mm_from_m};
use cell_vision::annotate;
use cell_vision::camera::CameraModel;
use cell_vision::cv;
use cell_vision::detect::second::Expected;
use cell_vision::detect::{DetectSettings, Detection, Detector, Family};
use cell_vision::observe::Observation;
use nalgebra::Vector3;
use rearrange::document::chain::chain;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `celld detect`.
#[derive(Debug, clap::Args)]
pub struct DetectArgs {
    /// The picture (PNG or JPEG).
    image: PathBuf,
    /// The camera's calibration (camera.yaml); its picture size must be the picture's.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Edge of the markers' black squares in m; with --camera, adds distance and tilt.
    #[arg(long, value_name = "M", requires = "camera", value_parser = positive)]
    size: Option<f64>,
    /// The cell's configuration: adds which object lies where, by its markers and calibration.
    #[arg(long, value_name = "FILE", conflicts_with = "camera")]
    config: Option<PathBuf>,
    /// Depth picture of the same moment (16-bit PNG, 0.1 mm a unit): adds what carries no marker.
    #[arg(long, value_name = "FILE", requires = "config")]
    depth: Option<PathBuf>,
    /// Families looked for, comma-separated.
    #[arg(long, value_delimiter = ',', default_value = "tag36h11")]
    family: Vec<Family>,
    /// Search on a picture this much smaller (1 finds the smallest markers, 1.5 is twice as fast).
    #[arg(long, value_name = "F", default_value_t = DetectSettings::default().decimate)]
    decimate: f32,
    /// Markers that should be in it, comma-separated: they are believed more readily in a poor picture.
    #[arg(long, value_delimiter = ',', value_name = "ID")]
    expect: Vec<u32>,
    /// Search once, as the first pass of a look does, instead of in every way.
    #[arg(long, conflicts_with = "expect")]
    one_pass: bool,
    /// Write a copy with the detections drawn on it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// How to print what was found.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// How results are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// A table for people.
    Text,
    /// One JSON object.
    Json,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err(format!("{text:?} is not a size over 0 in m")),
    }
}

/// One marker as printed.
#[derive(Debug, Serialize)]
struct Found {
    #[serde(flatten)]
    detection: Detection,
    #[serde(skip_serializing_if = "Option::is_none")]
    pose: Option<Pose>,
}

/// A marker before the camera.
#[derive(Debug, Serialize)]
struct Pose {
    /// Centre in the camera frame, m.
    camera_from_marker_m: [f64; 3],
    /// Angle between the marker's normal and the line of sight to it, degrees.
    tilt_deg: f64,
    /// How well the corners fit, pixels.
    reprojection_px: f64,
}

/// Runs the subcommand and returns the exit code.
pub fn run(args: &DetectArgs) -> u8 {
    match detect(args) {
        Ok((text, found)) => {
            cell_edge::terminal::print(&text);
            u8::from(found == 0)
        }
        Err(message) => {
            eprintln!("celld detect: {message}");
            2
        }
    }
}

/// The text to print and the number of markers found.
fn detect(args: &DetectArgs) -> Result<(String, usize), String> {
    let image = read_picture(&args.image)?;
    let cell = args.config.as_deref().map(table::Cell::read).transpose()?;
    let camera = match &cell {
        Some(cell) => Some(cell.lens.clone()),
        None => args.camera.as_deref().map(read_camera).transpose()?,
    };
    if let Some(camera) = &camera {
        let fits = camera.check_picture(image.width, image.height);
        fits.map_err(|error| format!("{}: {error}", args.image.display()))?;
    }
    let settings = DetectSettings { decimate: args.decimate, ..DetectSettings::default() };
    let mut detector = Detector::of(&args.family, settings).map_err(|error| chain(&error))?;
    let grey = image.gray();
    let detections = if args.one_pass {
        detector.detect(&grey)
    } else {
        let expected = expected(args, cell.as_ref());
        detector.detect_thoroughly(&grey, &expected)
    };
    let detections = detections.map_err(|error| format!("{}: {}", args.image.display(), chain(&error)))?;
    let on_table = cell.map(|cell| cell.look(&detections, args.depth.as_deref())).transpose();
    let on_table = on_table.map_err(|error| format!("{}: {error}", args.image.display()))?;
    if let Some(out) = &args.out {
        let mut drawn = image.clone();
        annotate::draw_detections(&mut drawn, &detections);
        if let Some(on_table) = &on_table {
            on_table.draw(&mut drawn)?;
        }
        let bytes = drawn.encode_png().map_err(|error| chain(&error))?;
        files::write_atomic(out, &bytes).map_err(|error| chain(&error))?;
    }
    let found: Vec<Found> = detections
        .into_iter()
        .map(|detection| {
            let pose =
                camera.as_ref().zip(args.size).and_then(|(camera, size)| pose(camera, &detection, size));
            Found { detection, pose }
        })
        .collect();
    let text = match args.format {
        Format::Text => {
            let objects = on_table.map(|on_table| on_table.reported()).unwrap_or_default();
            table(&args.image, &image, &found) + &objects
        }
        Format::Json => json(&args.image, &image, &found, on_table.map(|on_table| on_table.seen).as_ref())?,
    };
    Ok((text, found.len()))
}

/// The markers named on the command line, in each family looked for, and those of the cell.
fn expected(args: &DetectArgs, cell: Option<&table::Cell>) -> Vec<Expected> {
    let named =
        args.family.iter().flat_map(|family| args.expect.iter().map(|id| Expected::anywhere(*family, *id)));
    let own = cell.into_iter().flat_map(table::Cell::markers);
    named.chain(own.map(|id| Expected::anywhere(Family::Tag36h11, id))).collect()
}

fn pose(camera: &CameraModel, detection: &Detection, size_m: f64) -> Option<Pose> {
    let best = cv::square_poses(camera, &detection.corners, size_m).ok()?.into_iter().next()?;
    let centre = best.camera_from_target.translation.vector;
    let normal = best.camera_from_target.rotation * Vector3::z();
    let tilt_deg = deg_from_rad(normal.angle(&-centre));
    let reprojection_px = best.reprojection_px;
    Some(Pose { camera_from_marker_m: centre.into(), tilt_deg, reprojection_px })
}

fn table(path: &Path, image: &Image, found: &[Found]) -> String {
    let mut text = String::new();
    let name = path.display();
    let _ = writeln!(text, "{name}: {} x {}, {} markers", image.width, image.height, found.len());
    if found.is_empty() {
        text.push_str(
            "no marker of the families looked for: too small (under 3 px a module), too dark, \
                       blurred, or without its white ring?\n",
        );
        return text;
    }
    let placed = found.iter().any(|found| found.pose.is_some());
    text.push_str("   id     column        row    edge px  margin  repaired bits");
    text.push_str(if placed { "    distance mm   tilt deg\n" } else { "\n" });
    for Found { detection, pose } in found {
        let [x, y] = detection.centre();
        let (edge, margin) = (detection.edge_min_px(), detection.decision_margin);
        let _ = write!(
            text,
            "{:>5} {x:>10.2} {y:>10.2} {edge:>10.1} {margin:>7.0} {:>14}",
            detection.id, detection.hamming
        );
        if let Some(pose) = pose {
            let distance = Vector3::from(pose.camera_from_marker_m).norm();
            let _ = write!(text, " {:>14.1} {:>10.1}", mm_from_m(distance), pose.tilt_deg);
        }
        text.push('\n');
    }
    text
}

fn json(path: &Path, image: &Image, found: &[Found], seen: Option<&Observation>) -> Result<String, String> {
    let mut report = serde_json::json!({
        "image": path.display().to_string(),
        "width": image.width,
        "height": image.height,
        "detections": found,
    });
    if let Some(seen) = seen {
        report["table"] = serde_json::to_value(seen).map_err(|error| chain(&error))?;
    }
    serde_json::to_string(&report).map(|text| text + "\n").map_err(|error| chain(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_calibration::files::camera::CameraCalibration;
    use cell_values::image::depth::DepthImage;
    use cell_values::image::depth::UNIT_M;
    use cell_vision::marker;
    use rearrange::geometry::pose::Pose2;

    fn args(image: PathBuf) -> DetectArgs {
        DetectArgs {
            image,
            camera: None,
            size: None,
            config: None,
            depth: None,
            family: vec![Family::Tag36h11],
            decimate: 1.0,
            expect: Vec::new(),
            one_pass: false,
            out: None,
            format: Format::Text,
        }
    }

    fn camera(width: u32, height: u32) -> String {
        let model = CameraModel {
            serial: "1".into(),
            width,
            height,
            fx: 200.0,
            fy: 200.0,
            cx: f64::from(width) / 2.0 - 0.5,
            cy: f64::from(height) / 2.0 - 0.5,
            distortion: [0.0; 5],
        };
        let (source, date) = ("factory".to_owned(), "2026-11-21".to_owned());
        CameraCalibration { model, source, date, reprojection_px: None, measured: None }.to_yaml()
    }

    #[test]
    fn a_marker_is_reported_drawn_and_placed() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("m.png"), marker::draw(9, 10).unwrap().encode_png().unwrap()).unwrap();
        std::fs::write(path("camera.yaml"), camera(100, 100)).unwrap();
        let args = DetectArgs {
            camera: Some(path("camera.yaml")),
            size: Some(0.04),
            out: Some(path("drawn.png")),
            format: Format::Json,
            ..args(path("m.png"))
        };
        let (text, found) = detect(&args).unwrap();
        let report: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!((found, &report["detections"][0]["id"]), (1, &serde_json::json!(9)));
        // 80 px of a 40 mm square at a focal length of 200 px: 100 mm away.
        let away = report["detections"][0]["pose"]["camera_from_marker_m"][2].as_f64().unwrap();
        assert!((away - 0.1).abs() < 1e-3, "{away}");
        let drawn = Image::decode(&std::fs::read(path("drawn.png")).unwrap()).unwrap();
        assert!(drawn.rgb.chunks_exact(3).any(|p| p[0] != p[2]), "colour on a grey picture");
        let (table, _) = detect(&DetectArgs { format: Format::Text, ..args }).unwrap();
        assert!(table.contains("1 markers") && table.contains("    9 ") && table.contains("tilt"), "{table}");
        let (table, _) = detect(&self::args(path("m.png"))).unwrap();
        assert!(!table.contains("tilt"), "no heading over nothing: {table}");
    }

    /// The example cell's table with its block at (0.15, 0.3), and a mug at (0.35, 0.2): picture and depth.
    fn drawn_table(folder: &Path) -> (PathBuf, PathBuf) {
        use cell_values::image::tag36h11_bitmap;
        use std::sync::Arc;
        use ur_sim::render::Renderer;
        use ur_sim::render::lens::CameraTruth;
        use ur_sim::render::scene::{Print, Prism, Scene, look_at};
        use ur_sim::render::sensor::Exposure;
        use ur_sim::world::section::Section;
        let config = crate::config::load::load_cell(&example()).unwrap();
        let lens = read_camera(&config.calibration.camera).unwrap();
        let print =
            |id: u32, size_m: f64, pose: Pose2| Print { cells: tag36h11_bitmap(id).unwrap(), size_m, pose };
        let prism = |section: Section, pose: Pose2, height_m: f64, print: Option<Print>| Prism {
            table_from_prism: pose.at_height(0.0),
            section: Arc::new(section),
            height_m,
            colour: [130; 3],
            prints: print.into_iter().collect(),
        };
        let on_block = print(2, 0.05, Pose2::default());
        let scene = Scene {
            board: [-0.1, -0.1, 0.6, 0.6],
            table_from_flange: nalgebra::Isometry3::identity(),
            prisms: vec![
                prism(Section::rectangle(0.08, 0.08), Pose2::new(0.15, 0.3, 0.2), 0.03, Some(on_block)),
                prism(Section::ellipse(0.07, 0.07), Pose2::new(0.35, 0.2, 0.0), 0.09, None),
            ],
            prints: config.reference_markers.iter().map(|m| print(m.id, m.size_m, m.pose)).collect(),
        };
        let truth = CameraTruth {
            fx: lens.fx,
            fy: lens.fy,
            cx: lens.cx,
            cy: lens.cy,
            distortion: lens.distortion,
            ..CameraTruth::ideal(&lens.serial, lens.width, lens.height, lens.fx)
        };
        let renderer = Renderer::new(truth);
        let eye = look_at([0.25, 0.22, 0.72], [0.25, 0.25, 0.0], [1.0, 0.0, 0.0]);
        let (colour, depth) = (folder.join("colour.png"), folder.join("depth.png"));
        std::fs::write(&colour, renderer.render(&scene, &eye, 1, 1).encode_png().unwrap()).unwrap();
        let found = renderer.expose_depth(&scene, &eye, &Exposure::default(), [1, 1]);
        let found = DepthImage::from_units(lens.width, lens.height, &found.units, UNIT_M).unwrap();
        std::fs::write(&depth, found.encode_png(UNIT_M).unwrap()).unwrap();
        (colour, depth)
    }

    fn example() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")
    }

    #[test]
    fn with_the_cell_and_depth_objects_are_placed_and_a_mug_is_reported_and_outlined() {
        let folder = tempfile::tempdir().unwrap();
        let (colour, depth) = drawn_table(folder.path());
        let out = folder.path().join("drawn.png");
        let args = DetectArgs {
            config: Some(example()),
            depth: Some(depth.clone()),
            out: Some(out),
            ..args(colour)
        };
        let (text, _) = detect(&args).unwrap();
        assert!(text.contains("block: x 0.15") && text.contains("plank-1: not seen"), "{text}");
        assert!(text.contains("foreign: something") && text.contains("1 foreign, depth on"), "{text}");
        let drawn = Image::decode(&std::fs::read(folder.path().join("drawn.png")).unwrap()).unwrap();
        let red = drawn.rgb.chunks_exact(3).filter(|p| p == &annotate::BAD.as_slice()).count();
        assert!(red > 200, "{red} pixels of the mug's outline");
        let (json, _) = detect(&DetectArgs { format: Format::Json, ..args }).unwrap();
        let report: serde_json::Value = serde_json::from_str(&json).unwrap();
        let mug = &report["table"]["foreign"]["objects"][0];
        assert!((mug["height_m"].as_f64().unwrap() - 0.09).abs() < 0.01, "{mug}");
        assert!((mug["centre"][0].as_f64().unwrap() - 0.35).abs() < 0.01, "{mug}");
    }

    #[test]
    fn markers_of_other_families_are_not_the_cell_s_though_their_numbers_are() {
        let folder = tempfile::tempdir().unwrap();
        let (colour, _) = drawn_table(folder.path());
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let mut seen = detector.detect(&read_picture(&colour).unwrap().gray()).unwrap();
        let block = seen.iter().find(|detection| detection.id == 2).unwrap();
        let mut other = Detection { family: Family::Tag25h9.name().into(), ..block.clone() };
        other.corners.iter_mut().for_each(|corner| corner[0] += 100.0);
        seen.push(other);
        let table = table::Cell::read(&example()).unwrap().look(&seen, None).unwrap();
        let block = table.seen.objects.iter().find(|object| object.id == "block");
        assert!(block.is_some_and(|block| (block.pose.x - 0.15).abs() < 0.002), "{:?}", table.seen.objects);
    }

    #[test]
    fn depth_of_another_kind_or_size_is_bad_input() {
        let folder = tempfile::tempdir().unwrap();
        let (colour, _) = drawn_table(folder.path());
        let small = folder.path().join("small.png");
        let picture = DepthImage::from_units(2, 2, &[4000; 4], UNIT_M).unwrap();
        std::fs::write(&small, picture.encode_png(UNIT_M).unwrap()).unwrap();
        let with = |depth: PathBuf| {
            let args = DetectArgs { config: Some(example()), depth: Some(depth), ..args(colour.clone()) };
            detect(&args).unwrap_err()
        };
        assert!(with(colour.clone()).contains("no depth picture"));
        assert!(with(small).contains("aligned to the colour picture"));
        assert!(with(folder.path().join("gone.png")).contains("gone.png"));
    }

    #[test]
    fn exit_codes_distinguish_nothing_found_from_bad_input() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("empty.png"), Image::filled(64, 64, [90; 3]).encode_png().unwrap()).unwrap();
        std::fs::write(path("broken.png"), b"\x89PNG\r\n\x1a\nrest").unwrap();
        std::fs::write(path("camera.yaml"), camera(640, 480)).unwrap();
        assert_eq!(run(&args(path("empty.png"))), 1);
        assert_eq!(run(&args(path("broken.png"))), 2);
        assert_eq!(run(&args(path("gone.png"))), 2);
        let other = DetectArgs { camera: Some(path("camera.yaml")), ..args(path("empty.png")) };
        assert!(detect(&other).unwrap_err().contains("empty.png: the picture is 64 x 64"));
        let missing = DetectArgs { camera: Some(path("no.yaml")), ..args(path("empty.png")) };
        assert!(detect(&missing).unwrap_err().contains("no.yaml"));
    }
}
