//! Why a path was refused, in words that name the place.
//!
//! In: what the check found. Out: [`PathFault`], whose text goes into sentences for the operator. Pure.

use cell_values::units::mm_from_m;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use ur_arm::pose::ur_pose_from_isometry;

/// Why a path was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Deserialize, Serialize)]
pub enum PathFault {
    /// No joint solution, or none inside the joint range.
    #[error("{what}: tool pose ({x:.3}, {y:.3}, {z:.3}) m over the table is out of the arm's reach")]
    OutOfReach {
        /// Which pose.
        what: String,
        /// Position in the table frame, m.
        x: f64,
        /// Position in the table frame, m.
        y: f64,
        /// Position in the table frame, m.
        z: f64,
    },
    /// A joint leaves its range.
    #[error("joint {joint} would be at {at_deg:.1} degrees, outside its range")]
    JointRange {
        /// Joint number, 1 to 6.
        joint: usize,
        /// Where it would be, degrees.
        at_deg: f64,
    },
    /// The tool would go too low.
    #[error("the tool would be {height_mm:.1} mm over the table, where {floor_mm:.1} mm is the least")]
    TooLow {
        /// Height reached, mm.
        height_mm: f64,
        /// Height allowed, mm.
        floor_mm: f64,
    },
    /// A linear segment passes too near to a singularity, or jumps between branches.
    #[error("a straight line here passes too near to a {which} singularity")]
    Singular {
        /// wrist, elbow or shoulder.
        which: Cow<'static, str>,
    },
    /// Speed, acceleration or blend is not a number in its limits.
    #[error("the {what} is {value:.3}; it has to be over 0 and at most {limit:.3} (m, rad, s)")]
    Limit {
        /// Which number.
        what: Cow<'static, str>,
        /// Its value, SI.
        value: f64,
        /// Its limit, SI.
        limit: f64,
    },
    /// Two bodies would meet, or come nearer than they may.
    #[error("{one} {how} {other}, with the tool at {place}",
            how = nearness(*.distance_mm, *.at_start), place = place(.tool))]
    Meets {
        /// One of them.
        one: String,
        /// The other.
        other: String,
        /// Their distance there, mm.
        distance_mm: f64,
        /// Where the tool is then, table frame, m.
        tool: [f64; 3],
        /// Whether the arm is there already, at the start of the path.
        at_start: bool,
    },
    /// What goes down between the objects has to go straight.
    #[error("the way between the objects is not vertical: it goes {aside_mm:.1} mm aside")]
    Aside {
        /// How far, mm.
        aside_mm: f64,
    },
    /// Nor does the tool turn there.
    #[error("the way between the objects turns the tool by {turn_deg:.1} degrees")]
    Turning {
        /// How far, degrees.
        turn_deg: f64,
    },
    /// A straight line that the joints cannot follow at any useful speed.
    #[error(
        "joint {joint} can follow a straight line here at {speed_mm_s:.1} mm/s only, too near to the edge \
         of reach"
    )]
    TooSlow {
        /// Joint number, 1 to 6.
        joint: usize,
        /// Speed of the tool at which it can, mm/s.
        speed_mm_s: f64,
    },
    /// A path has to have at least one leg.
    #[error("the path is empty")]
    Empty,
}

impl PathFault {
    /// True where this body would meet something.
    pub fn names(&self, body: &str) -> bool {
        matches!(self, PathFault::Meets { one, other, .. } if one == body || other == body)
    }

    /// What a person does about a pick or a place that is refused for this. A place may be out of reach for
    /// being too far away, or too near to the arm's own base.
    pub fn hint(&self) -> &'static str {
        match self {
            PathFault::OutOfReach { .. } | PathFault::TooSlow { .. } => {
                "put the object or its goal where the arm reaches without being stretched out"
            }
            PathFault::Singular { .. } | PathFault::JointRange { .. } => {
                "put the object or its goal where the arm is neither stretched out nor folded over its base"
            }
            PathFault::Meets { .. } => {
                "take what would be met aside by hand, or give the job a goal with more room"
            }
            PathFault::TooLow { .. }
            | PathFault::Limit { .. }
            | PathFault::Aside { .. }
            | PathFault::Turning { .. }
            | PathFault::Empty => "see `motion:` and the object's height and grip in the configuration",
        }
    }

    /// The two bodies that are too near to each other before the arm has moved.
    pub fn met_at_start(&self) -> Option<(&str, &str)> {
        match self {
            PathFault::Meets { one, other, at_start: true, .. } => Some((one, other)),
            _ => None,
        }
    }
}

/// How near two bodies come, or are.
fn nearness(distance_mm: f64, at_start: bool) -> String {
    match (distance_mm > 0.0, at_start) {
        (true, false) => format!("would come within {distance_mm:.0} mm of"),
        (false, false) => "would meet".to_string(),
        (true, true) => format!("is within {distance_mm:.0} mm of"),
        (false, true) => "touches".to_string(),
    }
}

/// A place of the tool, for people.
fn place([x, y, z]: &[f64; 3]) -> String {
    format!("x {x:.3} m, y {y:.3} m, {:.0} mm over the table", mm_from_m(*z))
}

/// Names the position of a pose that no joint solution reaches.
pub fn out_of_reach(what: &str, table_from_tool: &Isometry3<f64>) -> PathFault {
    let [x, y, z, ..] = ur_pose_from_isometry(table_from_tool);
    PathFault::OutOfReach { what: what.to_string(), x, y, z }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_pick_names_what_a_person_can_change() {
        let what = String::new;
        let meets = |at_start| PathFault::Meets {
            one: "a".into(),
            other: "b".into(),
            distance_mm: 0.0,
            tool: [0.0; 3],
            at_start,
        };
        let cases = [
            (PathFault::OutOfReach { what: what(), x: 2.0, y: 0.0, z: 0.0 }, "stretched out"),
            (PathFault::TooSlow { joint: 1, speed_mm_s: 1.0 }, "stretched out"),
            (meets(false), "aside by hand"),
            (meets(true), "aside by hand"),
            (PathFault::Aside { aside_mm: 3.0 }, "configuration"),
            (PathFault::Turning { turn_deg: 3.0 }, "configuration"),
            (PathFault::Empty, "configuration"),
        ];
        for (fault, part) in cases {
            assert!(fault.hint().contains(part), "{fault}: {}", fault.hint());
        }
    }
}
