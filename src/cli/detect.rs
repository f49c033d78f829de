//! `celld detect IMAGE`: the markers in a picture, as a table or as JSON, and drawn on a copy.
//!
//! In: a PNG or JPEG file; optionally the camera's calibration, which adds a size check, and with the markers' size
//! the distance and tilt of each. Out: stdout, and the annotated picture. Exit codes: 0 markers found, 1 none found,
//! 2 bad input.

use crate::io::files;
use crate::units::{deg_from_rad, mm_from_m};
use crate::vision::annotate;
use crate::vision::calibration::camera::CameraCalibration;
use crate::vision::camera::CameraModel;
use crate::vision::cv;
use crate::vision::detect::{DetectSettings, Detection, Detector, Family};
use crate::vision::image::Image;
use nalgebra::Vector3;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Largest picture file read, bytes.
const PICTURE_MAX: u64 = 256 << 20;

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
    /// Families looked for, comma-separated.
    #[arg(long, value_delimiter = ',', default_value = "tag36h11")]
    family: Vec<Family>,
    /// Search on a picture this much smaller (1 finds the smallest markers, 1.5 is twice as fast).
    #[arg(long, value_name = "F", default_value_t = DetectSettings::default().decimate)]
    decimate: f32,
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
            crate::cli::task::print(&text);
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
    let camera = args.camera.as_deref().map(read_camera).transpose()?;
    if let Some(camera) = &camera {
        let fits = camera.check_picture(image.width, image.height);
        fits.map_err(|error| format!("{}: {error}", args.image.display()))?;
    }
    let settings = DetectSettings { decimate: args.decimate, ..DetectSettings::default() };
    let mut detector = Detector::of(&args.family, settings).map_err(chain)?;
    let detections = detector
        .detect(&image.gray())
        .map_err(|error| format!("{}: {}", args.image.display(), chain(error)))?;
    if let Some(out) = &args.out {
        let mut drawn = image.clone();
        annotate::draw_detections(&mut drawn, &detections);
        let bytes = drawn.encode_png().map_err(chain)?;
        files::write_atomic(out, &bytes).map_err(chain)?;
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
        Format::Text => table(&args.image, &image, &found),
        Format::Json => json(&args.image, &image, &found)?,
    };
    Ok((text, found.len()))
}

pub(super) fn read_picture(path: &Path) -> Result<Image, String> {
    let failed = |error: std::io::Error| format!("{} cannot be read: {error}", path.display());
    let size = std::fs::metadata(path).map_err(failed)?.len();
    if size > PICTURE_MAX {
        return Err(format!("{} has {size} bytes, more than any picture", path.display()));
    }
    let bytes = std::fs::read(path).map_err(failed)?;
    Image::decode(&bytes).map_err(|error| format!("{}: {}", path.display(), chain(error)))
}

pub(super) fn read_camera(path: &Path) -> Result<CameraModel, String> {
    let (text, _) = files::read_regular(path, 1 << 20).map_err(chain)?;
    let calibration = CameraCalibration::parse(&text, &path.display().to_string());
    calibration.map(|calibration| calibration.model).map_err(|complaints| complaints.to_string())
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
        text.push_str("no marker of the families looked for: too small (under 3 px a module), too dark, blurred, or without its white ring?\n");
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

fn json(path: &Path, image: &Image, found: &[Found]) -> Result<String, String> {
    let report = serde_json::json!({
        "image": path.display().to_string(),
        "width": image.width,
        "height": image.height,
        "detections": found,
    });
    serde_json::to_string(&report).map(|text| text + "\n").map_err(chain)
}

/// An error with its causes on one line.
pub(super) fn chain(error: impl std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let _ = write!(text, ": {inner}");
        cause = inner.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::marker;

    fn args(image: PathBuf) -> DetectArgs {
        DetectArgs {
            image,
            camera: None,
            size: None,
            family: vec![Family::Tag36h11],
            decimate: 1.0,
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
    fn a_marker_is_told_drawn_and_placed() {
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

    #[test]
    fn exit_codes_tell_nothing_found_from_bad_input() {
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
