//! Jumps: a joint that two states in a row show farther apart than it can turn between them.
//!
//! In: two states of one connection. Out: the joint and how far it jumped. The time between them is the
//! controller's, so that packages that were lost or came late make no jump; it counts for 0.5 s at most, so
//! that a wrong time does not excuse every position. Only an arm that is ready in both states is judged:
//! without power a controller may show positions from before, and the true ones come with the power.

use crate::device::robot_types::RobotState;
use cell_values::units::JOINT_NAMES;
use std::f64::consts::PI;
use ur_wire::enumerations::RobotMode;

/// No joint of a UR5e turns faster than 180 degrees per second (data sheet); a quarter more for a joint that
/// overshoots or is pushed.
const FASTEST_RAD_S: f64 = 1.25 * PI;
/// For noise, and for a time that is rounded: 3 controller frames at full speed.
const MARGIN_RAD: f64 = 0.02;
/// Without a state for longer nothing of ours moves: the program's watchdog has stopped the arm.
const LONGEST_STEP_S: f64 = 0.5;

/// A joint that is where it cannot have turned to.
#[derive(Clone, Debug, PartialEq)]
pub struct Jump {
    /// From 0, base to wrist 3.
    pub joint: usize,
    /// How far, rad, without a sign.
    pub by_rad: f64,
    /// Controller time between the two states, s.
    pub within_s: f64,
}

impl Jump {
    /// The largest jump between two states, if there is one.
    pub fn between(before: &RobotState, after: &RobotState) -> Option<Jump> {
        let ready = |state: &RobotState| state.robot_mode == RobotMode::Running;
        if !ready(before) || !ready(after) {
            return None;
        }
        farthest(&before.q.0, &after.q.0, after.controller_time_s - before.controller_time_s)
    }
}

impl std::fmt::Display for Jump {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let joint = JOINT_NAMES.get(self.joint).copied().unwrap_or("a joint");
        write!(f, "{joint} by {:.1} degrees in {:.0} ms", self.by_rad.to_degrees(), self.within_s * 1e3)
    }
}

/// The joint that turned farthest, if that is more than it can in this time.
fn farthest(before: &[f64; 6], after: &[f64; 6], within_s: f64) -> Option<Jump> {
    let possible = FASTEST_RAD_S * within_s.clamp(0.0, LONGEST_STEP_S) + MARGIN_RAD;
    let turned = before.iter().zip(after).map(|(before, after)| (after - before).abs());
    let (joint, by_rad) = turned.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    (by_rad > possible).then_some(Jump { joint, by_rad, within_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::recordings::{self, Sample};
    use cell_values::units::Joints;
    use ur_wire::rtde_ranges::check;
    use ur_wire::rtde_values::Value;

    const FRAME_S: f64 = 0.002;

    fn turned(joint: usize, by_rad: f64) -> [f64; 6] {
        std::array::from_fn(|k| if k == joint { by_rad } else { 0.0 })
    }

    #[test]
    fn the_joint_and_the_size_of_a_jump_are_named() {
        let jump = farthest(&[0.0; 6], &turned(2, -0.2), FRAME_S).unwrap();
        assert_eq!(jump.to_string(), "elbow by 11.5 degrees in 2 ms");
        assert_eq!(farthest(&[0.0; 6], &turned(5, 0.2), FRAME_S).unwrap().joint, 5);
    }

    #[test]
    fn full_speed_is_no_jump_however_many_packages_are_lost() {
        for lost in 0..250 {
            let step_s = FRAME_S * f64::from(lost + 1);
            assert_eq!(farthest(&[0.0; 6], &turned(0, PI * step_s), step_s), None, "{lost}");
        }
    }

    #[test]
    fn a_long_step_of_time_does_not_excuse_every_position() {
        assert_eq!(farthest(&[0.0; 6], &turned(1, 1.9), 1e6), None);
        assert!(farthest(&[0.0; 6], &turned(1, 2.0), 1e6).is_some());
        assert!(farthest(&[0.0; 6], &turned(1, 0.03), 0.0).is_some(), "in no time at all");
    }

    /// Positions and speeds of a real UR10e with light and heavy loads.
    #[test]
    fn recordings_of_a_real_arm_have_no_jump_and_no_implausible_number() {
        let Some(recordings) = recordings::ur10e() else { return };
        let mut rows = 0;
        for (name, samples) in recordings {
            let mut last: Option<(f64, [f64; 6])> = None;
            for Sample { time_s, q: Joints(q), qd } in samples {
                for (variable, value) in [
                    ("timestamp", Value::Double(time_s)),
                    ("actual_q", Value::Vector6D(q)),
                    ("actual_qd", Value::Vector6D(qd)),
                ] {
                    assert_eq!(check(variable, &value), Ok(()), "{name}, {time_s} s");
                }
                if let Some((before_s, from)) = last.replace((time_s, q)) {
                    assert_eq!(farthest(&from, &q, time_s - before_s), None, "{name}, {time_s} s");
                }
                rows += 1;
            }
        }
        assert!(rows > 1000, "{rows}");
    }
}
