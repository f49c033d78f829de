//! `touches.yaml`: which points of the table the tool's tip touched, and where the arm was then.
//!
//! In: text. Out: [`Touches`], or complaints with line and column; and the text of a new file. A point is a
//! reference marker's middle or one of its black corners, whose place the survey says at the time of
//! solving, or a point of the table. Where the tip was is given by the flange's pose and the tip's offset
//! from it, or by what the pendant shows with the tip as its TCP, so that a file can also be typed from a
//! notebook. Pure.

use crate::files;
use crate::files::hand_eye::Provenance;
use crate::fit::touch::Touch;
use cell_vision::marker;
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Point3};
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, read};
use rearrange::document::word::{UnknownWord, named};
use rearrange::document::write::Out;
use std::str::FromStr;

/// A point that can be touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Of a reference marker.
    Marker {
        /// Its number.
        id: u32,
        /// Which point of it.
        at: Spot,
    },
    /// A point in the table frame, m.
    Point([f64; 3]),
}

/// A point of a marker's black square, seen upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spot {
    /// Its middle.
    Centre,
    /// A corner.
    LowerLeft,
    /// A corner.
    LowerRight,
    /// A corner.
    UpperRight,
    /// A corner.
    UpperLeft,
}

impl Spot {
    /// All of them.
    pub const ALL: [Spot; 5] =
        [Spot::Centre, Spot::LowerLeft, Spot::LowerRight, Spot::UpperRight, Spot::UpperLeft];

    /// The word in files and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Spot::Centre => "centre",
            Spot::LowerLeft => "lower_left",
            Spot::LowerRight => "lower_right",
            Spot::UpperRight => "upper_right",
            Spot::UpperLeft => "upper_left",
        }
    }

    /// Where it is on a marker, m.
    fn on_marker(self, size_m: f64) -> [f64; 2] {
        let [lower_left, lower_right, upper_right, upper_left] = marker::corners_m(size_m);
        match self {
            Spot::Centre => [0.0, 0.0],
            Spot::LowerLeft => lower_left,
            Spot::LowerRight => lower_right,
            Spot::UpperRight => upper_right,
            Spot::UpperLeft => upper_left,
        }
    }
}

impl FromStr for Spot {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Spot, UnknownWord> {
        named(word, &Spot::ALL, Spot::as_str)
    }
}

impl Target {
    /// Where it is in the table frame, m; `None` when the survey has no such marker.
    pub fn on_table(&self, survey: &[ReferenceMarker]) -> Option<Point3<f64>> {
        match *self {
            Target::Point(point) => Some(Point3::from(point)),
            Target::Marker { id, at } => {
                let marker = survey.iter().find(|marker| marker.id == id)?;
                let [x, y] = marker.pose.transform(at.on_marker(marker.size));
                Some(Point3::new(x, y, 0.0))
            }
        }
    }
}

/// As people write it: a marker's number, a number with a spot of its square, or x/y in m.
impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Target, String> {
        let help = || {
            let words = Spot::ALL.map(Spot::as_str).join(", ");
            format!("give a marker's number, number:spot ({words}), or x/y in m")
        };
        if text.contains('/') {
            let numbers: Option<Vec<f64>> = text
                .split('/')
                .map(|part| part.trim().parse().ok().filter(|v: &f64| v.abs() <= 3.0))
                .collect();
            return match numbers.as_deref() {
                Some(&[x, y]) => Ok(Target::Point([x, y, 0.0])),
                Some(&[x, y, z]) => Ok(Target::Point([x, y, z])),
                _ => Err(help()),
            };
        }
        let (id, spot) = text.split_once(':').unwrap_or((text, "centre"));
        let at = spot.parse::<Spot>().map_err(|_| help())?;
        Ok(Target::Marker { id: id.trim().parse().map_err(|_| help())?, at })
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Target::Marker { id, at } => {
                write!(f, "marker {id}, {}", at.as_str().replace('_', " "))
            }
            Target::Point([x, y, z]) => write!(f, "point ({x}, {y}, {z}) m"),
        }
    }
}

/// Where the tip was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Where the flange was, base frame; the tip is `flange_from_tip_m` of the file away.
    Flange(Isometry3<f64>),
    /// Where the tip itself was, base frame, m.
    Tip([f64; 3]),
}

/// One point touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedTouch {
    /// The point.
    pub target: Target,
    /// Where the arm was.
    pub place: Place,
}

/// A round of touches.
#[derive(Clone, Debug, PartialEq)]
pub struct Touches {
    /// Serial number of the robot.
    pub robot_serial: String,
    /// Checksum of its calibrated kinematics.
    pub kinematics_checksum: String,
    /// When.
    pub date: String,
    /// The tip in the flange frame, m; needed where a touch says only where the flange was.
    pub flange_from_tip_m: Option<[f64; 3]>,
    /// In the order they were made.
    pub touches: Vec<RecordedTouch>,
}

/// No tip is further from the flange, no arm reaches further, and no point of a table is further from its
/// corner, m.
const TIP_M: f64 = 0.6;
const REACH_M: f64 = 3.0;

impl Touches {
    /// The points by the survey and where the tip met them.
    ///
    /// # Errors
    /// The first marker that the survey does not have.
    pub fn resolve(&self, survey: &[ReferenceMarker]) -> Result<Vec<Touch>, String> {
        let tip = Point3::from(self.flange_from_tip_m.unwrap_or_default());
        let resolve = |touch: &RecordedTouch| {
            let on_table = touch
                .target
                .on_table(survey)
                .ok_or_else(|| format!("{}: the configuration has no such reference marker", touch.target))?;
            let in_base = match touch.place {
                Place::Flange(base_from_flange) => base_from_flange * tip,
                Place::Tip(point) => Point3::from(point),
            };
            Ok(Touch { on_table, in_base })
        };
        self.touches.iter().map(resolve).collect()
    }

    /// That the robot that touched is the one of the pictures; `name` is the file's.
    ///
    /// # Errors
    /// It is another one, or its kinematics were measured anew.
    pub fn check_robot(&self, name: &str, taken: &Provenance) -> Result<(), String> {
        let Touches { robot_serial, kinematics_checksum, .. } = self;
        if (robot_serial, kinematics_checksum) == (&taken.robot_serial, &taken.kinematics_checksum) {
            return Ok(());
        }
        Err(format!(
            "{name}: touched with robot {robot_serial} (kinematics {kinematics_checksum}), but the pictures \
             are of {} ({})",
            taken.robot_serial, taken.kinematics_checksum
        ))
    }

    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<Touches, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let mut pairs = vec![
            ("version", Out::Integer(files::VERSION)),
            ("robot_serial", Out::Text(self.robot_serial.clone())),
            ("kinematics_checksum", Out::Text(self.kinematics_checksum.clone())),
            ("date", Out::Text(self.date.clone())),
        ];
        if let Some(tip) = &self.flange_from_tip_m {
            pairs.push(("flange_from_tip_m", Out::numbers(tip)));
        }
        pairs.push(("touches", Out::List(self.touches.iter().map(touch_out).collect())));
        let header = "# Points of the table that the tool's tip touched, and where the arm was: lengths m.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

fn touch_out(touch: &RecordedTouch) -> Out {
    let mut pairs = match touch.target {
        Target::Marker { id, at } => {
            vec![("marker", Out::Integer(i64::from(id))), ("at", Out::Text(at.as_str().to_owned()))]
        }
        Target::Point(point) => vec![("point_m", Out::numbers(&point))],
    };
    pairs.push(match &touch.place {
        Place::Flange(flange) => ("base_from_flange", files::transform_out(flange)),
        Place::Tip(tip) => ("tip_m", Out::numbers(tip)),
    });
    Out::map(pairs)
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<Touches> {
    let known = ["version", "robot_serial", "kinematics_checksum", "date", "flange_from_tip_m", "touches"];
    let fields = decoder.map(top, &known)?;
    let version = files::check_version(&fields, decoder);
    let [robot, kinematics, date] =
        ["robot_serial", "kinematics_checksum", "date"].map(|key| files::short_text(&fields, key, decoder));
    let tip = match fields.optional("flange_from_tip_m") {
        Some(at) => point(&at, TIP_M, decoder).map(Some),
        None => Some(None),
    };
    let items = fields.required("touches", decoder).and_then(|at| decoder.sequence(&at))?;
    let touches: Vec<_> = items.iter().map(|item| touch(item, tip == Some(None), decoder)).collect();
    version?;
    Some(Touches {
        robot_serial: robot?,
        kinematics_checksum: kinematics?,
        date: date?,
        flange_from_tip_m: tip?,
        touches: touches.into_iter().collect::<Option<_>>()?,
    })
}

fn touch(at: &At, no_tip: bool, decoder: &mut Decoder) -> Option<RecordedTouch> {
    let fields = decoder.map(at, &["marker", "at", "point_m", "base_from_flange", "tip_m"])?;
    let target = match (fields.optional("marker"), fields.optional("point_m")) {
        (Some(at), None) => {
            let id = decoder.integer(&at, 0..=i64::from(u16::MAX));
            let spot = match fields.optional("at") {
                Some(at) => decoder.word(&at),
                None => Some(Spot::Centre),
            };
            id.zip(spot).map(|(id, at)| Target::Marker { id: id as u32, at })
        }
        (None, Some(at)) => point(&at, REACH_M, decoder).map(Target::Point),
        _ => {
            decoder.complain_at(at, "which point was touched?", "give `marker` (and `at`), or `point_m`");
            None
        }
    };
    let place = match (fields.optional("base_from_flange"), fields.optional("tip_m")) {
        (Some(place), None) => {
            if no_tip {
                let help = "add flange_from_tip_m: [x, y, z], or give `tip_m` instead";
                decoder.complain_at(&place, "the flange says nothing without the tip's offset from it", help);
            }
            files::transform(&place, REACH_M, decoder).map(Place::Flange)
        }
        (None, Some(at)) => point(&at, REACH_M, decoder).map(Place::Tip),
        _ => {
            decoder.complain_at(at, "where was the tip?", "give `base_from_flange`, or `tip_m`");
            None
        }
    };
    Some(RecordedTouch { target: target?, place: place? })
}

fn point(at: &At, reach_m: f64, decoder: &mut Decoder) -> Option<[f64; 3]> {
    let point @ [x, y, z] = decoder.numbers::<3>(at)?;
    let far = x.hypot(y).hypot(z);
    if far <= reach_m {
        return Some(point);
    }
    let help = format!("at most {reach_m} m is plausible here: lengths are in metres, not millimetres");
    decoder.complain_at(at, format!("{far:.3} m away"), help);
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rearrange::geometry::pose::Pose2;

    fn touches() -> Touches {
        let flange = Isometry3::new(Vector3::new(0.2, 0.5, 0.15), Vector3::new(3.0, 0.1, 0.0));
        let marker = Target::Marker { id: 500, at: Spot::UpperRight };
        Touches {
            robot_serial: "20235500001".into(),
            kinematics_checksum: "7fe4".into(),
            date: "2026-11-21".into(),
            flange_from_tip_m: Some([0.0, 0.0, 0.15]),
            touches: vec![
                RecordedTouch { target: marker, place: Place::Flange(flange) },
                RecordedTouch {
                    target: Target::Point([0.1, 0.2, 0.0]),
                    place: Place::Tip([-0.15, 0.38, 0.003]),
                },
            ],
        }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let text = touches().to_yaml();
        let back = Touches::parse(&text, "touches.yaml").unwrap();
        let (Place::Flange(there), Place::Flange(here)) = (back.touches[0].place, touches().touches[0].place)
        else {
            panic!("{text}")
        };
        assert!(there.rotation.angle_to(&here.rotation) < 1e-12);
        assert_eq!((back.touches[1], back.flange_from_tip_m), (touches().touches[1], Some([0.0, 0.0, 0.15])));
        assert_eq!(back.touches[0].target, touches().touches[0].target);
    }

    #[test]
    fn a_corner_is_where_the_survey_puts_the_marker() {
        let survey = [ReferenceMarker {
            id: 500,
            size: 0.03,
            pose: Pose2::new(0.1, 0.2, std::f64::consts::FRAC_PI_2),
        }];
        let found = touches().resolve(&survey).unwrap();
        assert!((found[0].on_table - Point3::new(0.085, 0.215, 0.0)).norm() < 1e-12, "{found:?}");
        let Place::Flange(flange) = touches().touches[0].place else { panic!() };
        assert!((found[0].in_base - flange * Point3::new(0.0, 0.0, 0.15)).norm() < 1e-12);
        assert_eq!(found[1].in_base, Point3::new(-0.15, 0.38, 0.003));
        assert!(touches().resolve(&[]).unwrap_err().contains("marker 500, upper right"));
    }

    #[test]
    fn touches_that_say_too_little_or_millimetres_are_refused_at_their_place() {
        let text = touches().to_yaml();
        for (from, to, reported) in [
            ("tip_m: [-0.15, 0.38, 0.003]", "tip_m: [-150, 380, 3]", "not millimetres"),
            ("flange_from_tip_m: [0.0, 0.0, 0.15]\n", "", "tip's offset"),
            ("at: upper_right", "at: upper_middle", "upper_middle"),
            ("marker: 500", "marker: 500, point_m: [0, 0, 0]", "which point"),
            (", tip_m: [-0.15, 0.38, 0.003]", "", "where was the tip"),
        ] {
            let broken = text.replace(from, to);
            assert_ne!(broken, text, "{from} in {text}");
            let complaint = Touches::parse(&broken, "touches.yaml").unwrap_err().to_string();
            assert!(complaint.contains(reported) && complaint.contains("touches.yaml:"), "{complaint}");
        }
    }
}
