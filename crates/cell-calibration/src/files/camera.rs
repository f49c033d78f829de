//! `camera.yaml`: focal lengths, principal point and distortion of one camera at one picture size.
//!
//! In: text. Out: [`CameraCalibration`], or complaints with line and column; and the text of a new file. The
//! serial number decides whose calibration it is: the daemon refuses a camera with another one. Pure.

use crate::files;
use crate::fit::lens::{LensSample, LensSolution};
use cell_vision::camera::CameraModel;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, Fields, read};
use rearrange::document::write::Out;

/// A camera's numbers and where they come from.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibration {
    /// The numbers.
    pub model: CameraModel,
    /// Where they come from: `factory`, or the board and software they were measured with.
    pub source: String,
    /// When they were read or measured.
    pub date: String,
    /// Mean reprojection error, pixels, where they were measured.
    pub reprojection_px: Option<f64>,
    /// What says how good a measurement it was; `None` for a factory's numbers.
    pub measured: Option<Measured>,
}

/// How good measured numbers are.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Error of pictures that were predicted without having been used, pixels.
    pub held_out_px: f64,
    /// Standard deviations of fx, fy, cx, cy, pixels.
    pub std_px: [f64; 4],
    /// One entry for each picture.
    pub samples: Vec<LensSample>,
}

const MODEL_KEYS: [&str; 6] = ["serial", "width", "height", "focal_px", "principal_point_px", "distortion"];

impl CameraCalibration {
    /// The file's content from a solution; `source` says with what it was measured.
    pub fn from_solution(
        solution: LensSolution,
        serial: &str,
        source: String,
        date: String,
    ) -> CameraCalibration {
        CameraCalibration {
            model: CameraModel { serial: serial.to_owned(), ..solution.camera },
            source,
            date,
            reprojection_px: Some(solution.reprojection_px),
            measured: Some(Measured {
                held_out_px: solution.held_out_px,
                std_px: solution.std_px,
                samples: solution.samples,
            }),
        }
    }

    /// That these numbers are of the camera that reports `own` about itself, at its picture size; `name` is
    /// the file's.
    ///
    /// # Errors
    /// A sentence that says how they differ.
    pub fn check_camera(&self, name: &str, own: &CameraModel) -> Result<(), String> {
        let known = &self.model;
        let same = (known.serial.as_str(), known.width, known.height)
            == (own.serial.as_str(), own.width, own.height);
        if same {
            return Ok(());
        }
        Err(format!(
            "{name}: measured for camera {} at {} x {}, but this is {} at {} x {}: run `celld calibrate \
             camera` for it, or delete the file to work with the camera's own numbers",
            known.serial, known.width, known.height, own.serial, own.width, own.height
        ))
    }

    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<CameraCalibration, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let model = &self.model;
        let mut pairs = vec![
            ("version", Out::Integer(files::VERSION)),
            (
                "camera",
                Out::map(vec![
                    ("serial", Out::Text(model.serial.clone())),
                    ("width", Out::Integer(i64::from(model.width))),
                    ("height", Out::Integer(i64::from(model.height))),
                    ("focal_px", Out::numbers(&[model.fx, model.fy])),
                    ("principal_point_px", Out::numbers(&[model.cx, model.cy])),
                    ("distortion", Out::numbers(&model.distortion)),
                ]),
            ),
            ("source", Out::Text(self.source.clone())),
            ("date", Out::Text(self.date.clone())),
        ];
        files::push_number(&mut pairs, "reprojection_px", self.reprojection_px);
        if let Some(measured) = &self.measured {
            pairs.push((
                "residuals",
                Out::map(vec![
                    ("held_out_px", files::finite(measured.held_out_px)),
                    ("std_px", Out::numbers(&measured.std_px)),
                ]),
            ));
            pairs.push(("samples", Out::List(measured.samples.iter().map(sample_out).collect())));
        }
        let header = "# Lens of the camera: pixels with (0, 0) in the centre of the first pixel, distortion \
                      k1, k2, p1, p2, k3.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<CameraCalibration> {
    let known = ["version", "camera", "source", "date", "reprojection_px", "residuals", "samples"];
    let fields = decoder.map(top, &known)?;
    let version = files::check_version(&fields, decoder);
    let camera = fields.required("camera", decoder);
    let model = camera.and_then(|at| model(&at, decoder));
    let source = files::short_text(&fields, "source", decoder);
    let date = files::short_text(&fields, "date", decoder);
    let reprojection_px = files::optional_size(&fields, "reprojection_px", files::FIT_PX, decoder);
    let measured = match fields.optional("residuals") {
        Some(at) => measured(&at, &fields, decoder).map(Some),
        None => Some(None),
    };
    version?;
    let (reprojection_px, measured) = (reprojection_px?, measured?);
    Some(CameraCalibration { model: model?, source: source?, date: date?, reprojection_px, measured })
}

fn measured(at: &At, top: &Fields, decoder: &mut Decoder) -> Option<Measured> {
    let fields = decoder.map(at, &["held_out_px", "std_px"])?;
    let held_out_px = files::size(&fields, "held_out_px", files::FIT_PX, decoder);
    let std_px =
        fields.required("std_px", decoder).and_then(|at| decoder.numbers_in::<4>(&at, 0.0..=1e4, "px"));
    let items = top.required("samples", decoder).and_then(|at| decoder.sequence(&at));
    let samples: Vec<_> = items?.iter().map(|item| sample(item, decoder)).collect();
    Some(Measured {
        held_out_px: held_out_px?,
        std_px: std_px?,
        samples: samples.into_iter().collect::<Option<_>>()?,
    })
}

fn sample(at: &At, decoder: &mut Decoder) -> Option<LensSample> {
    let fields = decoder.map(at, &["name", "corners", "residual_px", "held_out_px", "rejected"])?;
    let name = files::short_text(&fields, "name", decoder);
    let corners = fields.required("corners", decoder).and_then(|at| decoder.integer(&at, 0..=1_000_000));
    let rejected = fields.required("rejected", decoder).and_then(|at| decoder.boolean(&at));
    let most = files::SAMPLE_PX;
    let most = if rejected == Some(false) { most } else { files::unlimited(most) };
    let residual_px = files::size(&fields, "residual_px", most, decoder);
    let held_out_px = files::optional_size(&fields, "held_out_px", most, decoder);
    Some(LensSample {
        name: name?,
        corners: usize::try_from(corners?).ok()?,
        residual_px: residual_px?,
        held_out_px: held_out_px?,
        rejected: rejected?,
    })
}

fn sample_out(sample: &LensSample) -> Out {
    let mut pairs = vec![
        ("name", Out::Text(sample.name.clone())),
        ("corners", files::counted(sample.corners)),
        ("residual_px", files::finite(sample.residual_px)),
    ];
    files::push_number(&mut pairs, "held_out_px", sample.held_out_px);
    pairs.push(("rejected", Out::Boolean(sample.rejected)));
    Out::map(pairs)
}

fn model(at: &At, decoder: &mut Decoder) -> Option<CameraModel> {
    let fields = decoder.map(at, &MODEL_KEYS)?;
    let serial = files::short_text(&fields, "serial", decoder);
    let width = edge(&fields, "width", decoder);
    let height = edge(&fields, "height", decoder);
    let focal = fields.required("focal_px", decoder).and_then(|at| decoder.numbers::<2>(&at));
    let centre = fields.required("principal_point_px", decoder).and_then(|at| decoder.numbers::<2>(&at));
    let distortion = fields.required("distortion", decoder).and_then(|at| decoder.numbers::<5>(&at));
    let ([fx, fy], [cx, cy]) = (focal?, centre?);
    let (serial, width, height, distortion) = (serial?, width?, height?, distortion?);
    let model = CameraModel { serial, width, height, fx, fy, cx, cy, distortion };
    match model.check() {
        Ok(()) => Some(model),
        Err(fault) => {
            decoder.complain_at(at, fault.to_string(), "measure it again or read it from the camera");
            None
        }
    }
}

fn edge(fields: &Fields, key: &str, decoder: &mut Decoder) -> Option<u32> {
    let at = fields.required(key, decoder)?;
    decoder.integer(&at, 16..=16384).and_then(|value| u32::try_from(value).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::testing;

    fn measured() -> CameraCalibration {
        CameraCalibration {
            model: testing::camera(1280, 720),
            source: "factory".into(),
            date: "2026-11-21T06:00:00Z".into(),
            reprojection_px: Some(0.12),
            measured: Some(Measured {
                held_out_px: 0.13,
                std_px: [0.4, 0.4, 0.2, 0.3],
                samples: vec![sample()],
            }),
        }
    }

    fn sample() -> LensSample {
        let name = "01.png".to_owned();
        LensSample { name, corners: 120, residual_px: 0.1, held_out_px: Some(0.11), rejected: false }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let text = measured().to_yaml();
        assert_eq!(CameraCalibration::parse(&text, "camera.yaml").unwrap(), measured(), "{text}");
        let factory = CameraCalibration { reprojection_px: None, measured: None, ..measured() };
        assert_eq!(CameraCalibration::parse(&factory.to_yaml(), "camera.yaml").unwrap(), factory);
    }

    #[test]
    fn every_fault_is_reported_with_its_line() {
        let text = measured().to_yaml().replace("focal_px: [650", "focal_px: [650 mm").replace("date", "dat");
        let reported = CameraCalibration::parse(&text, "camera.yaml").unwrap_err().to_string();
        assert!(reported.contains("camera.yaml:7:") && reported.contains("is not a number"), "{reported}");
        assert!(
            reported.contains("dat: unknown key; did you mean \"date\"?")
                && reported.contains("\"date\" is missing")
        );
        let text = measured().to_yaml().replace("principal_point_px: [646.3", "principal_point_px: [2646.3");
        let reported = CameraCalibration::parse(&text, "camera.yaml").unwrap_err().to_string();
        assert!(reported.contains("cx = 2646.3 is outside the picture"), "{reported}");
        let text = measured().to_yaml().replace("version: 1", "version: 2");
        assert!(CameraCalibration::parse(&text, "camera.yaml").is_err());
    }
}
