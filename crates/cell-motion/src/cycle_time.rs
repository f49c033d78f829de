//! How long the arm takes for a sequence of pick-n-places, estimated before any path is planned.
//!
//! In: the arm, the heights and speeds of a cycle, and poses of objects' footprints before and after, in
//! order. Out: seconds. Planning by time compares thousands of orders and buffer places, so this is an
//! estimate from a few joint positions: ways at travel height take what their slowest joint takes, from rest
//! to rest; the tool's yaw is free while nothing hangs on it and turns with the object while something does;
//! straight parts and the gripper take the same for every object. Pure.

use crate::path::ArmModel;
use crate::pick_n_place::{CycleParameters, tool_down};
pub use crate::ramp::rest_to_rest;
use cell_values::units::Joints;
use rearrange::geometry::pose::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

/// Until the vacuum holds, s; the same for every object, as is what follows.
const GRIP_S: f64 = 0.5;

/// Until it has gone, s.
const RELEASE_S: f64 = 0.3;

/// Until a picture is taken, s.
const PICTURE_S: f64 = 0.1;

/// What is this far from the middle of all that has to be seen is looked at from the greatest height, m.
const SPREAD_M: f64 = 0.25;

/// What an arm takes for its moves.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct CycleTimes {
    model: ArmModel,
    cycle: CycleParameters,
    start: Joints,
    /// Heights of the tool at a look at a part of the table, m: at a small part, and at all of it.
    look: Option<[f64; 2]>,
}

impl CycleTimes {
    /// Of an arm that begins at `start`.
    pub fn new(model: &ArmModel, cycle: &CycleParameters, start: Joints) -> CycleTimes {
        CycleTimes { model: model.clone(), cycle: cycle.clone(), start, look: None }
    }

    /// The same with a look before every pick but the first, from these heights of the tool over the
    /// table, m: the lower, the nearer together all is that has to be seen.
    pub fn looking(self, heights: [f64; 2]) -> CycleTimes {
        CycleTimes { look: Some(heights), ..self }
    }

    /// Seconds of these pick-n-places, one after the other: poses before and after, in the table frame.
    pub fn seconds(&self, moves: impl IntoIterator<Item = (Pose2, Pose2)>) -> f64 {
        let mut at = self.start;
        let mut sum = 0.0;
        let mut before: Option<(Pose2, Pose2)> = None;
        for (from, to) in moves {
            let turn = wrap_angle(to.theta - from.theta);
            let looked = before.and_then(|before| self.look(&at, [before.0, before.1, from, to]));
            if let Some((view, way)) = looked {
                (at, sum) = (view, sum + way);
            }
            let (pick, empty) = self.way(&at, &from, 0.0, 5);
            let (place, carried) = self.way(&pick, &to, turn, 6);
            sum += empty + carried + self.least_move_seconds();
            at = place;
            before = Some((from, to));
        }
        sum
    }

    /// No pick-n-place takes less: four straight parts and the gripper, s.
    pub fn least_move_seconds(&self) -> f64 {
        let straight = rest_to_rest(self.cycle.approach, self.cycle.tool_speed, self.cycle.tool_acceleration);
        4.0 * straight + GRIP_S + RELEASE_S
    }

    /// Where the arm looks at these places from, about, and the seconds until it is there: over their
    /// middle, the higher the farther they are apart.
    fn look(&self, from: &Joints, places: [Pose2; 4]) -> Option<(Joints, f64)> {
        let [low, high] = self.look?;
        let mean = |of: fn(&Pose2) -> f64| places.iter().map(of).sum::<f64>() / 4.0;
        let middle = Pose2::new(mean(|pose| pose.x), mean(|pose| pose.y), 0.0);
        let spread = places.iter().map(|pose| pose.distance(&middle)).fold(0.0, f64::max);
        let height = low + (high - low) * (spread / SPREAD_M).min(1.0);
        let over = tool_down(middle.x, middle.y, height, 0.0);
        let q = self.model.joints_in_work_posture(&over, from)?;
        let longest = (0..5).map(|joint| (q.0[joint] - from.0[joint]).abs()).fold(0.0, f64::max);
        let way = rest_to_rest(longest, self.cycle.joint_speed, self.cycle.joint_acceleration);
        Some((q, way + PICTURE_S))
    }

    /// Joint positions over a pose, and the seconds until they are reached by the first `joints` of them.
    fn way(&self, from: &Joints, to: &Pose2, yaw: f64, joints: usize) -> (Joints, f64) {
        let high = self.cycle.tallest + self.cycle.air + self.cycle.approach;
        let over = tool_down(to.x, to.y, high, yaw);
        let Some(q) = self.model.joints_in_work_posture(&over, from) else {
            // Whether it can be reached at all is for the path planner to say, in words.
            return (*from, 0.0);
        };
        let delta = |joint: usize| (q.0[joint] - from.0[joint]).abs();
        let longest = (0..joints).map(delta).fold(0.0, f64::max);
        (q, rest_to_rest(longest, self.cycle.joint_speed, self.cycle.joint_acceleration))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{cycle, home, model};

    fn at(x: f64, y: f64, theta: f64) -> Pose2 {
        Pose2::new(x, y, theta)
    }

    #[test]
    fn farther_and_turned_takes_longer_and_nothing_takes_less_than_the_least() {
        let model = model(0.5);
        let times = CycleTimes::new(&model, &cycle(), home(&model, 0.5));
        let one = |from: Pose2, to: Pose2| times.seconds([(from, to)]);
        let start = at(0.1, 0.1, 0.0);
        let near = one(start, at(0.15, 0.1, 0.0));
        assert!(near < one(start, at(0.4, 0.4, 0.0)), "a long way");
        assert!(near < one(start, at(0.15, 0.1, 2.5)), "a turn");
        assert!(times.least_move_seconds() < near && times.seconds([]) == 0.0);
    }

    #[test]
    fn the_order_counts_where_it_saves_empty_ways() {
        let model = model(0.5);
        let times = CycleTimes::new(&model, &cycle(), home(&model, 0.5));
        let left = |y: f64| (at(0.05, y, 0.0), at(0.1, y, 0.0));
        let right = |y: f64| (at(0.4, y, 0.0), at(0.45, y, 0.0));
        let sorted = times.seconds([left(0.1), left(0.2), right(0.1), right(0.2)]);
        let mixed = times.seconds([left(0.1), right(0.1), left(0.2), right(0.2)]);
        assert!(sorted + 0.3 < mixed, "{sorted} {mixed}");
    }
}
