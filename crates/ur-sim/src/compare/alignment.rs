//! Which moment of a simulated track belongs to which of a recorded one. Pure.
//!
//! In: the motions of both. Out: [`Alignment`]: the n-th motions begin together, whatever the pauses before.

use crate::compare::motions::Motion;
use crate::compare::track::{Track, apart};

/// When in each of the motions that both arms made a joint had left its place, s after the first one:
/// recorded and simulated. Speeds show a beginning less exactly.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alignment(Vec<(f64, f64)>);

/// Motions that begin farther from each other are not the same one, rad.
const SAME_POSE_RAD: f64 = 0.1;

/// When a joint has left its place in each of the motions of a track; all times after `origin_s`.
fn left(track: &Track, origin_s: f64, motions: &[Motion]) -> Vec<f64> {
    let each = motions.iter().map(|motion| track.motion_after_s(motion.begins_s + origin_s));
    each.map_while(|left| left.map(|left| left - origin_s)).collect()
}

impl Alignment {
    /// Of a recorded and of a simulated arm: each with its origin and its motions.
    pub fn of(recorded: (&Track, f64, &[Motion]), simulated: (&Track, f64, &[Motion])) -> Alignment {
        let at = |(track, origin, _): &(&Track, f64, &[Motion]), time_s: f64| track.at(time_s + origin);
        let same = |pair: &(f64, f64)| {
            let poses = (at(&recorded, pair.0), at(&simulated, pair.1));
            matches!(poses, (Some(a), Some(b)) if apart(&a, &b) < SAME_POSE_RAD)
        };
        let [left, simulated_left] =
            [recorded, simulated].map(|(track, origin, all)| left(track, origin, all));
        Alignment(left.into_iter().zip(simulated_left).take_while(same).collect())
    }

    /// When by the recording's clock the simulated motion of this index begins that begins at `simulated_s`.
    pub fn begins_s(&self, index: usize, simulated_s: f64) -> f64 {
        simulated_s - self.ahead_s(self.0.len().min(index + 1))
    }

    /// The simulated moment of a recorded one. Before a motion begins, the simulated one has not begun
    /// either.
    pub fn simulated_s(&self, recorded_s: f64) -> f64 {
        let next = self.0.partition_point(|(recorded, _)| *recorded <= recorded_s);
        let not_yet = self.0.get(next).map_or(f64::INFINITY, |(_, simulated)| *simulated);
        (recorded_s + self.ahead_s(next)).min(not_yet)
    }

    /// The recorded moment of a simulated one.
    pub fn recorded_s(&self, simulated_s: f64) -> f64 {
        let next = self.0.partition_point(|(_, simulated)| *simulated <= simulated_s);
        let not_yet = self.0.get(next).map_or(f64::INFINITY, |(recorded, _)| *recorded);
        (simulated_s - self.ahead_s(next)).min(not_yet)
    }

    /// By how much the simulated motion before the `next` one begins later than the recorded.
    fn ahead_s(&self, next: usize) -> f64 {
        let pair = next.checked_sub(1).and_then(|last| self.0.get(last));
        pair.map_or(0.0, |(recorded, simulated)| simulated - recorded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_begin_together_whatever_the_pauses() {
        let alignment = Alignment(vec![(0.0, 0.0), (2.0, 1.5)]);
        assert_eq!([0.0, 1.0, 1.9, 2.0, 3.0].map(|at| alignment.simulated_s(at)), [0.0, 1.0, 1.5, 1.5, 2.5]);
        assert_eq!([0.0, 1.2, 1.5, 2.5].map(|at| alignment.recorded_s(at)), [0.0, 1.2, 2.0, 3.0]);
        assert_eq!([alignment.begins_s(1, 1.4), alignment.begins_s(2, 4.5)], [1.9, 5.0]);
        assert_eq!(Alignment::default().simulated_s(3.0), 3.0);
    }
}
