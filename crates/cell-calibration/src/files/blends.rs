//! `blends.yaml`: the paths on which an arm's blends were recorded, of which controller, with which
//! software.
//!
//! In: text. Out: [`BlendRecording`], or complaints with line and column; and the text of a new file. The
//! joints of the arm are in the recording beside it. Whether they let corners be cut is found out from both
//! each time (`crate::blends`): there is no word in here that says so. Pure.

use crate::blends::SentPath;
use crate::files;
use cell_motion::path::Segment;
use cell_values::units::Joints;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, read};
use rearrange::document::write::Out;

/// What was recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct BlendRecording {
    /// The paths, in the order of the recording.
    pub paths: Vec<SentPath>,
    /// The limits of the configuration they were made with.
    pub limits: RecordedLimits,
    /// The controller's serial number.
    pub robot_serial: String,
    /// Its software, as the dashboard reports it.
    pub software: String,
    /// When.
    pub date: String,
}

/// Limits with which paths were recorded; a cell with larger ones needs another recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordedLimits {
    /// Largest blend radius, m.
    pub blend_m: f64,
    /// Joint speed, degrees/s.
    pub joint_speed_deg_s: f64,
    /// Joint acceleration, degrees/s2.
    pub joint_acceleration_deg_s2: f64,
    /// Tool speed, m/s.
    pub tool_speed_m_s: f64,
    /// Tool acceleration, m/s2.
    pub tool_acceleration_m_s2: f64,
}

/// Rounding of a limit that was written.
const SAME: f64 = 1.0 + 1e-6;

impl RecordedLimits {
    /// Each with its key, as the configuration has it.
    fn keyed(&self) -> [(&'static str, f64); 5] {
        [
            ("blend_m", self.blend_m),
            ("joint_speed_deg_s", self.joint_speed_deg_s),
            ("joint_acceleration_deg_s2", self.joint_acceleration_deg_s2),
            ("tool_speed_m_s", self.tool_speed_m_s),
            ("tool_acceleration_m_s2", self.tool_acceleration_m_s2),
        ]
    }

    fn decode(at: &At, decoder: &mut Decoder) -> Option<RecordedLimits> {
        let keys = RecordedLimits::default().keyed().map(|(key, _)| key);
        let fields = decoder.map(at, &keys)?;
        let numbers = keys.map(|key| {
            let at = fields.required(key, decoder)?;
            decoder.number_in(&at, 0.0..=1e4, "")
        });
        let [blend, joint_speed, joint_acceleration, tool_speed, tool_acceleration] = numbers;
        Some(RecordedLimits {
            blend_m: blend?,
            joint_speed_deg_s: joint_speed?,
            joint_acceleration_deg_s2: joint_acceleration?,
            tool_speed_m_s: tool_speed?,
            tool_acceleration_m_s2: tool_acceleration?,
        })
    }
}

/// Farthest that a joint can be turned, rad.
const TURNED_RAD: f64 = 7.0;

impl BlendRecording {
    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<BlendRecording, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let text = |value: &String| Out::Text(value.clone());
        let pairs = vec![
            ("version", Out::Integer(files::VERSION)),
            ("blends", Out::List(self.paths.iter().map(path_out).collect())),
            ("limits", Out::map(self.limits.keyed().map(|(key, value)| (key, Out::Number(value))).to_vec())),
            ("robot_serial", text(&self.robot_serial)),
            ("software", text(&self.software)),
            ("date", text(&self.date)),
        ];
        let header = "# Paths on which this arm's blends were recorded, by celld calibrate blends: rad, m, s.\n\
                      # The joints are in the .csv beside it; both are judged at each start.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(3))
    }

    /// Checks that it is of this controller as it is now; `name` is for the complaint.
    ///
    /// # Errors
    /// What differs.
    pub fn check_robot(&self, name: &str, serial: &str, software: &str) -> Result<(), String> {
        if self.robot_serial != serial {
            return Err(format!("{name}: recorded with robot {}, now it is {serial}", self.robot_serial));
        }
        if self.software != software {
            return Err(format!("{name}: recorded with {}, now it is {software}", self.software));
        }
        Ok(())
    }

    /// Checks that the limits of the cell are no larger than those recorded; `name` is for the complaint.
    ///
    /// # Errors
    /// The first limit that is larger now.
    pub fn check_limits(&self, name: &str, now: &RecordedLimits) -> Result<(), String> {
        let pairs = now.keyed().into_iter().zip(self.limits.keyed());
        let larger = |((_, now), (_, then)): &((&str, f64), (&str, f64))| *now > SAME * then;
        match pairs.into_iter().find(larger) {
            Some(((key, now), (_, then))) => {
                Err(format!("{name}: recorded with limits.{key} {then}, now it is {now}"))
            }
            None => Ok(()),
        }
    }
}

fn path_out(path: &SentPath) -> Out {
    let segments = path.segments.iter().map(segment_out).collect();
    Out::map(vec![("start", Out::numbers(&path.start.0)), ("segments", Out::List(segments))])
}

fn segment_out(segment: &Segment) -> Out {
    let (kind, speed, acceleration) = match *segment {
        Segment::Joint { speed, acceleration, .. } => ("movej", speed, acceleration),
        Segment::Linear { speed, acceleration, .. } => ("movel", speed, acceleration),
    };
    Out::map(vec![
        (kind, Out::numbers(&segment.target().0)),
        ("speed", Out::Number(speed)),
        ("acceleration", Out::Number(acceleration)),
        ("blend_m", Out::Number(segment.blend())),
    ])
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<BlendRecording> {
    let fields = decoder.map(top, &["version", "blends", "limits", "robot_serial", "software", "date"])?;
    let version = files::check_version(&fields, decoder);
    let paths = fields.required("blends", decoder).and_then(|at| {
        let items = decoder.sequence(&at)?;
        let paths: Vec<_> = items.iter().map(|item| path(item, decoder)).collect();
        paths.into_iter().collect::<Option<Vec<_>>>()
    });
    let limits = fields.required("limits", decoder).and_then(|at| RecordedLimits::decode(&at, decoder));
    let [robot_serial, software, date] =
        ["robot_serial", "software", "date"].map(|key| files::short_text(&fields, key, decoder));
    version?;
    Some(BlendRecording {
        paths: paths?,
        limits: limits?,
        robot_serial: robot_serial?,
        software: software?,
        date: date?,
    })
}

fn path(at: &At, decoder: &mut Decoder) -> Option<SentPath> {
    let fields = decoder.map(at, &["start", "segments"])?;
    let start = fields.required("start", decoder).and_then(|at| joints(&at, decoder));
    let segments = fields.required("segments", decoder).and_then(|at| {
        let items = decoder.sequence(&at)?;
        let segments: Vec<_> = items.iter().map(|item| segment(item, decoder)).collect();
        segments.into_iter().collect::<Option<Vec<_>>>()
    });
    Some(SentPath { start: start?, segments: segments? })
}

fn segment(at: &At, decoder: &mut Decoder) -> Option<Segment> {
    let straight = at.node.get("movel").is_some();
    let (kind, unit) = if straight { ("movel", "m") } else { ("movej", "rad") };
    let fields = decoder.map(at, &[kind, "speed", "acceleration", "blend_m"])?;
    let target = fields.required(kind, decoder).and_then(|at| joints(&at, decoder));
    let mut number = |key, most, unit: &str| {
        fields.required(key, decoder).and_then(|at| decoder.number_in(&at, 0.0..=most, unit))
    };
    let speed = number("speed", 10.0, &format!("{unit}/s"))?;
    let acceleration = number("acceleration", 100.0, &format!("{unit}/s2"))?;
    let blend = number("blend_m", 0.1, "m")?;
    let target = target?;
    Some(match straight {
        true => Segment::Linear { target, speed, acceleration, blend },
        false => Segment::Joint { target, speed, acceleration, blend },
    })
}

fn joints(at: &At, decoder: &mut Decoder) -> Option<Joints> {
    decoder.numbers_in::<6>(at, -TURNED_RAD..=TURNED_RAD, "rad").map(Joints)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorded() -> BlendRecording {
        let (one, other) = (Joints([0.1, -1.5, 1.5, -1.5, -1.5, 0.25]), Joints([0.5; 6]));
        BlendRecording {
            paths: vec![SentPath {
                start: one,
                segments: vec![
                    Segment::Linear { target: other, speed: 0.25, acceleration: 1.0, blend: 0.03 },
                    Segment::Joint { target: one, speed: 1.5, acceleration: 3.0, blend: 0.0 },
                ],
            }],
            limits: RecordedLimits {
                blend_m: 0.03,
                joint_speed_deg_s: 60.0,
                joint_acceleration_deg_s2: 120.0,
                tool_speed_m_s: 0.25,
                tool_acceleration_m_s2: 1.0,
            },
            robot_serial: "20235500001".to_string(),
            software: "URSoftware 5.13.0.0 (Oct 01 2022)".to_string(),
            date: "2026-11-30T10:00:00Z".to_string(),
        }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let text = recorded().to_yaml();
        assert_eq!(BlendRecording::parse(&text, "blends.yaml").unwrap(), recorded(), "{text}");
    }

    #[test]
    fn another_robot_or_software_and_broken_files_are_named() {
        let file = recorded();
        let said =
            |serial: &str, software: &str| file.check_robot("blends.yaml", serial, software).unwrap_err();
        assert!(said("1", &file.software).contains("robot 20235500001, now it is 1"));
        assert!(said(&file.robot_serial, "URSoftware 5.14").contains("now it is URSoftware 5.14"));
        file.check_robot("blends.yaml", &file.robot_serial, &file.software).unwrap();
        let faster = RecordedLimits { tool_speed_m_s: 0.3, ..file.limits };
        let said = file.check_limits("blends.yaml", &faster).unwrap_err();
        assert_eq!(said, "blends.yaml: recorded with limits.tool_speed_m_s 0.25, now it is 0.3");
        file.check_limits("blends.yaml", &file.limits).unwrap();
        file.check_limits("blends.yaml", &RecordedLimits { blend_m: 0.01, ..file.limits }).unwrap();
        let text = file.to_yaml();
        let wrong = |from: &str, to: &str| {
            assert!(text.contains(from), "{from} in {text}");
            BlendRecording::parse(&text.replace(from, to), "blends.yaml").unwrap_err().to_string()
        };
        assert!(wrong("movej", "movep").contains("movej"));
        assert!(wrong("blend_m: 0.03}", "blend_m: 30}").contains("blend_m"));
        assert!(wrong("1.5, 0.25", "150, 0.25").contains("rad"));
        assert!(wrong("software", "sofware").contains("sofware"));
    }
}
