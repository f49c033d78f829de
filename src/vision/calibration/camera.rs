//! `camera.yaml`: focal lengths, principal point and distortion of one camera at one picture size.
//!
//! In: text. Out: [`CameraCalibration`], or complaints with line and column; and the text of a new file. The serial number decides
//! whose calibration it is: the daemon refuses a camera with another one. Pure.

use crate::document::decode::{At, Decoder, Fields};
use crate::document::write::Out;
use crate::document::{Complaints, parse};
use crate::vision::calibration;
use crate::vision::camera::CameraModel;

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
}

const MODEL_KEYS: [&str; 6] = ["serial", "width", "height", "focal_px", "principal_point_px", "distortion"];

impl CameraCalibration {
    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<CameraCalibration, Complaints> {
        let node = parse(text, name)?;
        let mut decoder = Decoder::new(name);
        let value = decode(&At::top(&node), &mut decoder);
        decoder.finish(value)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let model = &self.model;
        let mut pairs = vec![
            ("version", Out::Integer(calibration::VERSION)),
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
        calibration::push_number(&mut pairs, "reprojection_px", self.reprojection_px);
        let header = "# Lens of the camera: pixels with (0, 0) in the centre of the first pixel, distortion k1, k2, p1, p2, k3.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<CameraCalibration> {
    let fields = decoder.map(top, &["version", "camera", "source", "date", "reprojection_px"])?;
    let version = calibration::check_version(&fields, decoder);
    let camera = fields.required("camera", decoder);
    let model = camera.and_then(|at| model(&at, decoder));
    let source = calibration::short_text(&fields, "source", decoder);
    let date = calibration::short_text(&fields, "date", decoder);
    let reprojection_px =
        calibration::optional_size(&fields, "reprojection_px", calibration::FIT_PX, decoder);
    version?;
    Some(CameraCalibration { model: model?, source: source?, date: date?, reprojection_px: reprojection_px? })
}

fn model(at: &At, decoder: &mut Decoder) -> Option<CameraModel> {
    let fields = decoder.map(at, &MODEL_KEYS)?;
    let serial = calibration::short_text(&fields, "serial", decoder);
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
    use crate::vision::testing;

    fn measured() -> CameraCalibration {
        CameraCalibration {
            model: testing::camera(1280, 720),
            source: "factory".into(),
            date: "2026-11-21T06:00:00Z".into(),
            reprojection_px: Some(0.12),
        }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let text = measured().to_yaml();
        assert_eq!(CameraCalibration::parse(&text, "camera.yaml").unwrap(), measured(), "{text}");
        let factory = CameraCalibration { reprojection_px: None, ..measured() };
        assert_eq!(CameraCalibration::parse(&factory.to_yaml(), "camera.yaml").unwrap(), factory);
    }

    #[test]
    fn every_fault_is_told_with_its_line() {
        let text = measured().to_yaml().replace("focal_px: [650", "focal_px: [650 mm").replace("date", "dat");
        let told = CameraCalibration::parse(&text, "camera.yaml").unwrap_err().to_string();
        assert!(told.contains("camera.yaml:7:") && told.contains("is not a number"), "{told}");
        assert!(
            told.contains("dat: unknown key; did you mean \"date\"?") && told.contains("\"date\" is missing")
        );
        let text = measured().to_yaml().replace("principal_point_px: [646.3", "principal_point_px: [2646.3");
        let told = CameraCalibration::parse(&text, "camera.yaml").unwrap_err().to_string();
        assert!(told.contains("cx = 2646.3 is outside the picture"), "{told}");
        let text = measured().to_yaml().replace("version: 1", "version: 2");
        assert!(CameraCalibration::parse(&text, "camera.yaml").is_err());
    }
}
