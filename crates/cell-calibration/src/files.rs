//! Calibration files: what was measured, how well, with which devices, when.
//!
//! In: YAML (or JSON) text. Out: checked values, or every complaint with line and column; and the text of a
//! new file. Distinguished by their top-level key: `camera` (the lens), `hand_eye` (where the camera sits),
//! `table` (table under the robot), `blends` (how the arm passes corners). Lengths in m, angles in rad,
//! rotations as unit quaternions [x, y, z, w]. Nothing measured has a default, and a rotation that is none,
//! or a camera half a metre off the flange, is refused. Pure: files are opened by the caller.

pub mod blends;
pub mod camera;
pub mod hand_eye;
pub mod joints;
pub mod round;
pub mod set;
pub mod table;
pub mod touches;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::document::tree::Node;
use rearrange::document::write::Out;

/// The version of all formats.
pub const VERSION: i64 = 1;

/// Kinds of calibration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The lens.
    Camera,
    /// Where the camera sits.
    HandEye,
    /// The table under the robot.
    Table,
    /// Points of the table that the tool's tip touched.
    Touches,
    /// A recorded round.
    Round,
    /// Recorded blends.
    Blends,
}

/// Gives the kind by the top-level key, `None` if it is no calibration file.
pub fn kind(top: &Node) -> Option<Kind> {
    // The results come first: they keep what they were made of under the other keys.
    let kinds = [
        ("camera", Kind::Camera),
        ("hand_eye", Kind::HandEye),
        ("table", Kind::Table),
        ("blends", Kind::Blends),
        ("touches", Kind::Touches),
        ("samples", Kind::Round),
    ];
    let measured = top.get("version").is_some() && top.get("date").is_some();
    kinds.into_iter().find(|(key, _)| measured && top.get(key).is_some()).map(|(_, kind)| kind)
}

/// Complains unless `version` is there and known.
fn check_version(fields: &Fields, decoder: &mut Decoder) -> Option<()> {
    let at = fields.required("version", decoder)?;
    decoder.integer(&at, VERSION..=VERSION).map(|_| ())
}

/// A text of 1 to 100 characters.
fn short_text(fields: &Fields, key: &str, decoder: &mut Decoder) -> Option<String> {
    let at = fields.required(key, decoder)?;
    let text = decoder.text(&at)?;
    if (1..=100).contains(&text.chars().count()) {
        return Some(text);
    }
    decoder.complain_at(&at, "the text is empty or longer than 100 characters", "");
    None
}

/// How large an error may be, and its unit. A calibration that is worse is of no use to a cell that places
/// within a millimetre or two, and a file that says so was not meant to be worked with: it is refused where
/// it is read.
#[derive(Clone, Copy, Debug)]
struct Most(f64, &'static str);

/// Standard deviations and fit errors of lengths: 5 mm.
const FIT_M: Most = Most(0.005, "m");
/// Of angles: a degree, 5 mm at the lever of 0.3 m with which the solver weighs them.
const FIT_RAD: Most = Most(0.0175, "rad");
/// Root mean square corner error of a whole fit.
const FIT_PX: Most = Most(5.0, "px");
/// Error of a single sample that was used, on the table.
const SAMPLE_M: Most = Most(0.02, "m");
/// The same in the picture.
const SAMPLE_PX: Most = Most(20.0, "px");

/// Of a sample that was left out: any error will do, for it has no part in the result.
fn unlimited(Most(_, unit): Most) -> Most {
    Most(f64::INFINITY, unit)
}

/// An error that may be absent.
fn optional_size(fields: &Fields, key: &str, most: Most, decoder: &mut Decoder) -> Option<Option<f64>> {
    match fields.optional(key) {
        Some(at) => at_most(&at, most, decoder).map(Some),
        None => Some(None),
    }
}

/// An error that has to be there.
fn size(fields: &Fields, key: &str, most: Most, decoder: &mut Decoder) -> Option<f64> {
    let at = fields.required(key, decoder)?;
    at_most(&at, most, decoder)
}

fn at_most(at: &At, Most(most, unit): Most, decoder: &mut Decoder) -> Option<f64> {
    let value = decoder.non_negative(at, unit)?;
    if value <= most {
        return Some(value);
    }
    let message = format!("{value:.3e} {unit} is too large an error to work with, at most {most} {unit}");
    decoder.complain_at(at, message, "calibrate again: celld calibrate --config FILE");
    None
}

/// A transform: `{translation_m: [x, y, z], rotation_xyzw: [x, y, z, w]}`, no further than `reach_m`.
fn transform(at: &At, reach_m: f64, decoder: &mut Decoder) -> Option<Isometry3<f64>> {
    let fields = decoder.map(at, &["translation_m", "rotation_xyzw"])?;
    let translation = fields.required("translation_m", decoder);
    let rotation = fields.required("rotation_xyzw", decoder);
    let translation = translation.and_then(|at| {
        let [x, y, z] = decoder.numbers::<3>(&at)?;
        let far = x.hypot(y).hypot(z);
        if far > reach_m {
            let help =
                format!("at most {reach_m} m is plausible here: lengths are in metres, not millimetres");
            decoder.complain_at(&at, format!("{far:.3} m away"), help);
            return None;
        }
        Some(Translation3::new(x, y, z))
    });
    let rotation = rotation.and_then(|at| {
        let [x, y, z, w] = decoder.numbers::<4>(&at)?;
        let quaternion = Quaternion::new(w, x, y, z);
        if (quaternion.norm() - 1.0).abs() > 1e-6 {
            let message = format!("a quaternion of length {:.6} is no rotation", quaternion.norm());
            decoder.complain_at(&at, message, "its length has to be 1; the order is x, y, z, w");
            return None;
        }
        Some(UnitQuaternion::from_quaternion(quaternion))
    });
    Some(Isometry3::from_parts(translation?, rotation?))
}

/// The transform as [`transform`] reads it.
fn transform_out(transform: &Isometry3<f64>) -> Out {
    let t = transform.translation.vector;
    let q = transform.rotation.coords;
    Out::map(vec![
        ("translation_m", Out::numbers(&[t.x, t.y, t.z])),
        ("rotation_xyzw", Out::numbers(&[q.x, q.y, q.z, q.w])),
    ])
}

/// Adds a number if there is one.
fn push_number(pairs: &mut Vec<(&str, Out)>, key: &'static str, value: Option<f64>) {
    if let Some(value) = value.filter(|value| value.is_finite()) {
        pairs.push((key, Out::Number(value)));
    }
}

/// A number to be written; what is not finite becomes a number so large that [`at_most`] refuses the file.
fn finite(value: f64) -> Out {
    Out::Number(if value.is_finite() { value } else { f64::MAX })
}

fn counted(value: usize) -> Out {
    Out::Integer(i64::try_from(value).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::document::parse;

    fn read(text: &str) -> Result<Isometry3<f64>, String> {
        let node = parse(text, "t.yaml").unwrap();
        let mut decoder = Decoder::new("t.yaml");
        let value = transform(&At::top(&node), 0.5, &mut decoder);
        decoder.finish(value).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn a_transform_keeps_every_digit() {
        let pose =
            Isometry3::new(nalgebra::Vector3::new(0.1, -0.07, 0.03), nalgebra::Vector3::new(0.1, 2.0, -0.4));
        let back = read(&transform_out(&pose).to_yaml(1)).unwrap();
        assert!((back.translation.vector - pose.translation.vector).norm() == 0.0);
        assert!(back.rotation.angle_to(&pose.rotation) < 1e-15);
    }

    #[test]
    fn millimetres_and_stretched_rotations_are_refused_at_their_place() {
        let reported = read("translation_m: [0, -70, 30]\nrotation_xyzw: [0, 0, 0, 2]\n").unwrap_err();
        assert!(
            reported.contains("t.yaml:1:16: translation_m: 76.158 m away")
                && reported.contains("not millimetres"),
            "{reported}"
        );
        assert!(reported.contains("t.yaml:2:16: rotation_xyzw: a quaternion of length 2.0"), "{reported}");
        let reported = read("translation_m: [0, 0]\n").unwrap_err();
        assert!(
            reported.contains("2 values, 3 are wanted") && reported.contains("\"rotation_xyzw\" is missing"),
            "{reported}"
        );
    }

    #[test]
    fn the_keys_determine_the_kind() {
        let reported = |text: &str| kind(&parse(text, "f").unwrap());
        assert_eq!(reported("version: 1\ndate: d\ntable: {}\n"), Some(Kind::Table));
        assert_eq!(reported("version: 1\ndate: d\nhand_eye: {}\n"), Some(Kind::HandEye));
        assert_eq!(reported("version: 1\ndate: d\ntable: {}\ntouches: {}\n"), Some(Kind::Table));
        assert_eq!(reported("version: 1\ndate: d\ntouches: []\n"), Some(Kind::Touches));
        assert_eq!(reported("version: 1\ndate: d\nhand_eye: {}\nsamples: []\n"), Some(Kind::HandEye));
        assert_eq!(reported("version: 1\ndate: d\nsamples: []\n"), Some(Kind::Round));
        assert_eq!(reported("version: 1\ncamera: {address: x}\n"), None);
        assert_eq!(reported("objects: []\n"), None);
    }
}
