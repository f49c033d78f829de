//! Estimated seconds of a plan for an arm of which nothing is known but speed and acceleration.
//!
//! In: the actions of a plan. Out: seconds: for every pick-n-place a fixed time for the ways down and up and
//! the gripper, and the ways over the table, loaded and empty, each from rest to rest in a straight line. It
//! serves where no cell is there to say what its own arm needs; a cell passes a cost function of its own.

use crate::geometry::pose::Pose2;
use crate::planning::plan::Action;

/// What the estimate is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TravelTime {
    /// Of the tool over the table, m/s.
    pub speed: f64,
    /// Of the tool over the table, m/s2.
    pub acceleration: f64,
    /// Of the object about the vertical while it is carried, rad/s.
    pub turn_speed: f64,
    /// Down, grip, up, down, release, up, s.
    pub handling: f64,
}

/// An arm of the size of the UR5e, driven gently: it orders plans, and promises no cycle time.
pub const NOMINAL: TravelTime = TravelTime { speed: 0.25, acceleration: 0.5, turn_speed: 1.0, handling: 4.0 };

impl TravelTime {
    /// Seconds of all actions in order. The arm begins over the first object.
    pub fn seconds(&self, actions: &[Action]) -> f64 {
        let carried = |action: &Action| {
            let turn = action.from.angle_difference(&action.to) / self.turn_speed;
            self.handling + self.over(&action.from, &action.to).max(turn)
        };
        let loaded: f64 = actions.iter().map(carried).sum();
        let empty: f64 = actions.windows(2).map(|pair| self.over(&pair[0].to, &pair[1].from)).sum();
        loaded + empty
    }

    /// No action takes less, s.
    pub fn least_move_seconds(&self) -> f64 {
        self.handling
    }

    /// From rest to rest in a straight line, s.
    fn over(&self, from: &Pose2, to: &Pose2) -> f64 {
        let way = from.distance(to);
        let ramps = self.speed * self.speed / self.acceleration;
        if way < ramps {
            2.0 * (way / self.acceleration).sqrt()
        } else {
            way / self.speed + self.speed / self.acceleration
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planning::plan::ActionKind;

    #[test]
    fn loaded_and_empty_ways_count() {
        let arm = TravelTime { speed: 0.5, acceleration: 1.0, turn_speed: 1.0, handling: 4.0 };
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        let action = |from: Pose2, to: Pose2| Action { object: 0, from, to, kind: ActionKind::Goal };
        // 1 m at 0.5 m/s takes 2 s and 0.5 s for the ramps; 0.16 m never reaches the speed: 0.8 s.
        let plan = [action(at(0.0), at(1.0)), action(at(0.84), at(0.84))];
        assert!((arm.seconds(&plan) - (4.0 + 2.5 + 0.8 + 4.0)).abs() < 1e-12);
        let turned = [action(at(0.0), Pose2::new(0.0, 0.0, 3.0))];
        assert!((arm.seconds(&turned) - 7.0).abs() < 1e-12);
        assert_eq!(arm.seconds(&[]), 0.0);
    }
}
