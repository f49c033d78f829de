//! What an arm did over time: joint positions and states, recorded or simulated. Pure.
//!
//! In: samples in the order of time. Out: [`Track`], positions between its samples, the moment of its first
//! motion, and how its states changed.

/// Names of the states that are compared, as RTDE has them.
pub const STATES: [&str; 3] = ["robot_mode", "safety_mode", "runtime_state"];

/// How far a joint is from where it was at first when the arm counts as moved, rad: far more than encoders
/// are uneasy, far less than any motion.
pub const MOVED_RAD: f64 = 1e-3;

/// What an arm did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Controller time of each sample, s, ascending.
    pub times_s: Vec<f64>,
    /// Joint positions at each sample, rad.
    pub joints: Vec<[f64; 6]>,
    /// For each of [`STATES`] its number at each sample; `None` where it was not recorded.
    pub states: [Option<Vec<i32>>; 3],
}

/// A state's new number, and when, s after the first motion.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Change {
    /// When, s.
    pub at_s: f64,
    /// The number from then on.
    pub state: i32,
}

/// The largest difference of a joint between two poses, rad.
pub fn apart(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

impl Track {
    /// From the first sample to the last, s; 0 where there are none.
    pub fn length_s(&self) -> f64 {
        match (self.times_s.first(), self.times_s.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }

    /// The usual time between two samples, s: the middle one of all.
    pub fn interval_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Joint positions at a time, in a straight line between samples; before the first sample and after the
    /// last those of that sample. `None` where there are none.
    pub fn at(&self, time_s: f64) -> Option<[f64; 6]> {
        let after = self.times_s.partition_point(|time| *time <= time_s);
        let Some(before) = after.checked_sub(1) else { return self.joints.first().copied() };
        let (from, Some(to)) = (self.joints.get(before)?, self.joints.get(after)) else {
            return self.joints.last().copied();
        };
        let (began, ends) = (self.times_s.get(before)?, self.times_s.get(after)?);
        let share = (time_s - began) / (ends - began);
        Some(std::array::from_fn(|joint| from[joint] + (to[joint] - from[joint]) * share))
    }

    /// When a joint is [`MOVED_RAD`] from where it was at first, s; `None` if none ever is.
    pub fn first_motion_s(&self) -> Option<f64> {
        self.motion_after_s(*self.times_s.first()?)
    }

    /// When after `time_s` a joint is [`MOVED_RAD`] from where it was then, s; `None` if none ever is.
    pub fn motion_after_s(&self, time_s: f64) -> Option<f64> {
        let rest = self.at(time_s)?;
        let later = self.times_s.partition_point(|time| *time <= time_s);
        let moved = later + self.joints.get(later..)?.iter().position(|q| apart(q, &rest) > MOVED_RAD)?;
        let (began, ends) = (self.times_s.get(moved - 1)?.max(time_s), self.times_s.get(moved)?);
        let (before, after) = (apart(&self.at(began)?, &rest), apart(self.joints.get(moved)?, &rest));
        Some(began + (ends - began) * (MOVED_RAD - before) / (after - before))
    }

    /// The numbers that a state had from `origin_s` on, times from there; `None` if it was not recorded.
    pub fn changes(&self, state: usize, origin_s: f64) -> Option<Vec<Change>> {
        let numbers = self.states.get(state)?.as_ref()?;
        let mut changes: Vec<Change> = Vec::new();
        for (time_s, number) in self.times_s.iter().zip(numbers) {
            let at_s = (time_s - origin_s).max(0.0);
            match changes.last_mut() {
                Some(last) if last.state == *number => (),
                // What was before the first motion.
                Some(last) if *time_s <= origin_s => *last = Change { at_s, state: *number },
                _ => changes.push(Change { at_s, state: *number }),
            }
        }
        Some(changes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turning() -> Track {
        let joints = [0.0, 0.0, 0.002, 0.004, 0.004].map(|base| [base, 1.0, 0.0, 0.0, 0.0, 0.0]);
        Track {
            times_s: vec![10.0, 10.1, 10.2, 10.3, 10.4],
            joints: joints.to_vec(),
            states: [Some(vec![3, 7, 7, 7, 7]), None, Some(vec![1, 2, 2, 2, 1])],
        }
    }

    #[test]
    fn positions_lie_on_lines_between_samples_and_stay_beyond_them() {
        let base = |time| turning().at(time).unwrap()[0];
        assert!((base(10.15) - 0.001).abs() < 1e-12 && (base(10.225) - 0.0025).abs() < 1e-12);
        assert_eq!((base(0.0), base(10.4), base(99.0)), (0.0, 0.004, 0.004));
        assert_eq!(Track::default().at(1.0), None);
    }

    #[test]
    fn the_first_motion_is_where_a_joint_has_left_its_place() {
        assert!((turning().first_motion_s().unwrap() - 10.15).abs() < 1e-9);
        let still = Track { joints: vec![[1.0; 6]; 5], ..turning() };
        assert_eq!(still.first_motion_s(), None);
        assert_eq!(Track::default().first_motion_s(), None);
    }

    #[test]
    fn a_later_motion_is_one_from_where_the_arm_was_then() {
        let after = |time| turning().motion_after_s(time);
        assert!((after(10.0).unwrap() - 10.15).abs() < 1e-9 && (after(10.2).unwrap() - 10.25).abs() < 1e-9);
        assert!((after(10.15).unwrap() - 10.2).abs() < 1e-9, "{:?}", after(10.15));
        assert_eq!((after(10.3), after(99.0)), (None, None));
    }

    #[test]
    fn of_the_states_before_the_first_motion_the_last_one_counts() {
        let track = turning();
        let change = |at_s: f64, state| Change { at_s, state };
        assert_eq!(track.changes(0, 10.15), Some(vec![change(0.0, 7)]));
        assert_eq!(track.changes(1, 10.15), None);
        let program = track.changes(2, 10.15).unwrap();
        assert_eq!(program.iter().map(|change| change.state).collect::<Vec<_>>(), [2, 1]);
        assert!((program[1].at_s - 0.25).abs() < 1e-9);
    }

    #[test]
    fn length_and_interval_are_those_of_the_samples() {
        assert!((turning().length_s() - 0.4).abs() < 1e-9 && (turning().interval_s() - 0.1).abs() < 1e-9);
        assert_eq!((Track::default().length_s(), Track::default().interval_s()), (0.0, 0.0));
    }
}
