//! Slow checked moves for calibration: at most 0.1 m/s at the tool, inside the taught box where there is
//! one.
//!
//! In: the arm with its nominal table, the box, where the arm is and where it is to go. Out: a checked path,
//! or who would be outside of what (design, section 7, rule 1, class *calibrate*). Pure.

use crate::bodies::Room;
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, Segment};
use cell_values::units::{Joints, mm_from_m};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Highest tool speed while calibrating, m/s (design, section 7, rule 1).
const TOOL_SPEED: f64 = 0.1;

/// Pieces a move is cut into to find where its tool is fastest.
const TRAVEL_SAMPLES: usize = 200;

/// Lowest height of the cups over the nominal table while calibrating, m.
const FLOOR: f64 = 0.05;

/// Where the flange stays while calibrating: a box in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct CalibrationBox {
    /// The corner with the smallest coordinates, m.
    pub low_m: [f64; 3],
    /// The opposite corner, m.
    pub high_m: [f64; 3],
}

impl CalibrationBox {
    /// The smallest box round some places; `None` round none.
    pub fn around(places: impl Iterator<Item = [f64; 3]>) -> Option<CalibrationBox> {
        places.fold(None, |found: Option<CalibrationBox>, place| {
            let found = found.unwrap_or(CalibrationBox { low_m: place, high_m: place });
            Some(CalibrationBox {
                low_m: std::array::from_fn(|i| found.low_m[i].min(place[i])),
                high_m: std::array::from_fn(|i| found.high_m[i].max(place[i])),
            })
        })
    }

    /// How far a place lies outside, m; 0 inside.
    pub fn outside_m(&self, place: &Vector3<f64>) -> f64 {
        let beyond = |i: usize| (self.low_m[i] - place[i]).max(place[i] - self.high_m[i]).max(0.0);
        beyond(0).hypot(beyond(1)).hypot(beyond(2))
    }
}

/// Why a slow move is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Deserialize, Serialize)]
pub enum SlowFault {
    /// The pose cannot be reached safely.
    #[error("calibration pose {pose}")]
    Path {
        /// Its number, from 1.
        pose: usize,
        /// Why.
        #[source]
        fault: PathFault,
    },
    /// The arm would leave the taught box, or is outside of it.
    #[error(
        "{what} {outside_mm:.0} mm outside the calibration box: jog the arm into it at the pendant in Local \
         Control, then switch it back to Remote Control; or widen `calibration_box` as far as the arm's \
         reach is free of people and things"
    )]
    OutsideBox {
        /// Who is outside.
        what: String,
        /// How far, mm.
        outside_mm: f64,
    },
}

/// The check that every move of a calibration passes: reach, limits and heights of the arm, what may lie on
/// the table (`over`), and that the flange stays in the taught box where there is one. `pose` is the number
/// that faults name.
///
/// # Errors
/// [`SlowFault`].
pub fn slow_move(
    model: &ArmModel,
    room: Option<&CalibrationBox>,
    over: &Room,
    pose: usize,
    from: &Joints,
    target: Joints,
) -> Result<CheckedPath, SlowFault> {
    let speed = slow_enough(model, from, &target);
    let segment = Segment::Joint { target, speed, acceleration: model.limits.joint_acceleration, blend: 0.0 };
    let path = CheckedPath::new(model, from, &[Leg::over(segment, FLOOR)], over)
        .map_err(|fault| SlowFault::Path { pose, fault })?;
    let Some(room) = room else { return Ok(path) };
    for k in 0..=TRAVEL_SAMPLES {
        let q = from.lerp(&target, k as f64 / TRAVEL_SAMPLES as f64);
        let outside_m = room.outside_m(&model.kinematics.forward(&q).translation.vector);
        if outside_m > 0.0 {
            let what = match k {
                0 => "the flange is".to_string(),
                TRAVEL_SAMPLES => format!("calibration pose {pose} is"),
                _ => format!("on the way to calibration pose {pose} the flange would be"),
            };
            return Err(SlowFault::OutsideBox { what, outside_mm: mm_from_m(outside_m) });
        }
    }
    Ok(path)
}

/// Speed of the leading joint (rad/s) at which the tool stays below [`TOOL_SPEED`] all along the move.
fn slow_enough(model: &ArmModel, from: &Joints, to: &Joints) -> f64 {
    let travel = from.max_difference(to);
    let at = |k: usize| model.tool_at(&from.lerp(to, k as f64 / TRAVEL_SAMPLES as f64)).translation.vector;
    let steps = (0..TRAVEL_SAMPLES).map(|k| (at(k + 1) - at(k)).norm());
    let metres_per_rad = steps.fold(0.0, f64::max) * TRAVEL_SAMPLES as f64 / travel.max(1e-9);
    // A move that hardly moves the tool needs no limit of ours.
    model.limits.joint_speed.min(TOOL_SPEED / metres_per_rad.max(1e-3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::Bodies;
    use crate::path::{ArmLimits, BlendSpeed};
    use nalgebra::Isometry3;
    use std::f64::consts::TAU;
    use ur_arm::kinematics::{DhParameters, Kinematics};

    fn model() -> ArmModel {
        let limits = ArmLimits {
            joint_range: [(-TAU, TAU); 6],
            joint_speed: 2.0,
            joint_acceleration: 4.0,
            tool_speed: 0.5,
            tool_acceleration: 2.0,
        };
        ArmModel {
            kinematics: Kinematics::of(&DhParameters::UR5E),
            base_from_table: Isometry3::identity(),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
            home: Joints([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]),
            limits,
            blend_speed: BlendSpeed::Unknown,
            bodies: Bodies::bare(&DhParameters::UR5E),
        }
    }

    #[test]
    fn no_move_leaves_the_box_at_its_ends_or_on_its_way() {
        let model = model();
        // The base turns: the way swings out beyond the line between its ends.
        let turned = |turn: f64| Joints([turn, -1.4, 1.2, -1.4, -1.5, 0.0]);
        let (from, to) = (turned(-0.8), turned(0.8));
        let at = |q: &Joints| -> [f64; 3] { model.kinematics.forward(q).translation.vector.into() };
        let around = |places: &[Joints]| {
            let wide = CalibrationBox::around(places.iter().map(at)).unwrap();
            CalibrationBox { low_m: wide.low_m.map(|v| v - 0.01), high_m: wide.high_m.map(|v| v + 0.01) }
        };
        let move_in = |room: &CalibrationBox, from: &Joints, to: Joints| {
            slow_move(&model, Some(room), &Room::empty(), 7, from, to)
                .map(|_| ())
                .map_err(|error| error.to_string())
        };
        let steps: Vec<Joints> = (-8..=8).map(|k| turned(0.1 * f64::from(k))).collect();
        move_in(&around(&steps), &from, to).unwrap();
        let ends = around(&[from, to]);
        let reported = move_in(&ends, &from, to).unwrap_err();
        assert!(reported.contains("on the way to calibration pose 7"), "{reported}");
        let near = around(&[from, turned(-0.7)]);
        let reported = move_in(&near, &to, from).unwrap_err();
        assert!(
            reported.starts_with("the flange is") && reported.contains("outside the calibration box"),
            "{reported}"
        );
        // All of the way is in this one, but for its last half step.
        let (before, end) = (from.lerp(&to, 1.0 - 0.5 / TRAVEL_SAMPLES as f64), at(&to));
        let mut short = CalibrationBox { low_m: [-2.0; 3], high_m: [2.0; 3] };
        let axis = usize::from((end[1] - at(&from)[1]).abs() > (end[0] - at(&from)[0]).abs());
        let bound = if end[axis] > at(&from)[axis] { &mut short.high_m } else { &mut short.low_m };
        bound[axis] = at(&before)[axis];
        let reported = move_in(&short, &from, to).unwrap_err();
        assert!(reported.starts_with("calibration pose 7 is"), "{reported}");
        slow_move(&model, None, &Room::empty(), 7, &from, to).unwrap();
    }

    #[test]
    fn the_tool_stays_slow_with_all_joints_moving_and_the_arm_stretched() {
        let model = model();
        let (from, to) =
            (Joints([0.0, -0.9, 0.2, -0.7, -1.5, 0.0]), Joints([0.6, -0.4, 0.1, -0.9, -1.2, 0.3]));
        let speed = slow_enough(&model, &from, &to);
        // At that speed the leading joint needs so long for a thousandth of the way:
        let seconds = from.max_difference(&to) / speed / 1000.0;
        let mut fastest: f64 = 0.0;
        let at = |k: usize| {
            let mut q = from;
            (0..6).for_each(|j| q.0[j] += (to.0[j] - from.0[j]) * k as f64 / 1000.0);
            model.tool_at(&q).translation.vector
        };
        for k in 0..1000 {
            fastest = fastest.max((at(k + 1) - at(k)).norm() / seconds);
        }
        assert!((0.09..=0.1005).contains(&fastest), "{fastest} m/s");
        assert_eq!(slow_enough(&model, &from, &from), 2.0, "no way, no limit");
    }
}
