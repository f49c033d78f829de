//! `samples.yaml`: a recorded calibration round: which picture was taken with the flange where, on which
//! robot.
//!
//! In: text. Out: [`Round`], or complaints with line and column; and the text of a new file. The pictures
//! lie beside it and are opened by the caller. A round can be solved again at leisure, with samples dropped,
//! without moving the arm. Pure.

use crate::files::{self, hand_eye::Provenance};
use nalgebra::Isometry3;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, read};
use rearrange::document::write::Out;

/// A recorded round.
#[derive(Clone, Debug, PartialEq)]
pub struct Round {
    /// Camera, robot and date.
    pub provenance: Provenance,
    /// In the order they were taken.
    pub samples: Vec<RecordedSample>,
}

/// One stop of the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSample {
    /// Name of the picture's file, beside this one.
    pub image: String,
    /// The flange in the robot's base.
    pub base_from_flange: Isometry3<f64>,
}

/// No arm of this kind reaches further, m.
const REACH_M: f64 = 3.0;

impl Round {
    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<Round, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let mut pairs = vec![("version", Out::Integer(files::VERSION))];
        self.provenance.write(&mut pairs);
        let sample = |sample: &RecordedSample| {
            Out::map(vec![
                ("image", Out::Text(sample.image.clone())),
                ("base_from_flange", files::transform_out(&sample.base_from_flange)),
            ])
        };
        pairs.push(("samples", Out::List(self.samples.iter().map(sample).collect())));
        let header = "# A calibration round: the flange in the robot's base (m, quaternion x, y, z, w) at \
                      each picture.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<Round> {
    let mut known = vec!["version", "samples"];
    known.extend(Provenance::KEYS);
    let fields = decoder.map(top, &known)?;
    let version = files::check_version(&fields, decoder);
    let provenance = Provenance::decode(&fields, decoder);
    let items = fields.required("samples", decoder).and_then(|at| decoder.sequence(&at));
    let samples: Vec<_> = items?.iter().map(|item| sample(item, decoder)).collect();
    version?;
    Some(Round { provenance: provenance?, samples: samples.into_iter().collect::<Option<_>>()? })
}

fn sample(at: &At, decoder: &mut Decoder) -> Option<RecordedSample> {
    let fields = decoder.map(at, &["image", "base_from_flange"])?;
    let flange = fields.required("base_from_flange", decoder);
    let flange = flange.and_then(|at| files::transform(&at, REACH_M, decoder));
    let image = files::short_text(&fields, "image", decoder)?;
    // A file beside this one and nowhere else.
    if image.contains(['/', '\\']) || image == ".." {
        decoder.complain_at(
            at,
            format!("{image:?} is no plain file name"),
            "the pictures lie beside this file",
        );
        return None;
    }
    Some(RecordedSample { image, base_from_flange: flange? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn round() -> Round {
        let flange = Isometry3::new(Vector3::new(0.4, -0.1, 0.6), Vector3::new(3.0, 0.1, -0.2));
        Round {
            provenance: Provenance {
                camera_serial: "405".into(),
                robot_serial: "20235500001".into(),
                kinematics_checksum: "7fe4".into(),
                date: "2026-11-21T06:00:00Z".into(),
            },
            samples: vec![RecordedSample { image: "01.png".into(), base_from_flange: flange }],
        }
    }

    #[test]
    fn a_round_is_read_back_as_it_was_written() {
        let text = round().to_yaml();
        assert_eq!(Round::parse(&text, "samples.yaml").unwrap(), round(), "{text}");
    }

    #[test]
    fn pictures_elsewhere_and_broken_poses_are_refused() {
        let text = round().to_yaml();
        for (from, to, reported) in [
            ("01.png", "../01.png", "no plain file name"),
            ("0.6]", "600]", "metres"),
            ("samples:", "sample:", "did you mean"),
            ("version: 1", "version: 7", "version"),
        ] {
            let broken = text.replace(from, to);
            assert_ne!(broken, text);
            let complaint = Round::parse(&broken, "samples.yaml").unwrap_err().to_string();
            assert!(complaint.contains(reported) && complaint.contains("samples.yaml:"), "{complaint}");
        }
    }
}
