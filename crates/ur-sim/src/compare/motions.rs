//! When an arm moved: the spans of a track between rests. Pure.
//!
//! In: a track and the grid it is looked at. Out: [`Motion`]s, times after an origin. Speeds are taken over
//! a window, because encoders are uneasy. A controller rests for 30 to 50 ms between two moves without a
//! blend, and some only pass through zero: the speed drops far below what it is before and after. There a
//! motion ends.

use crate::compare::track::{MOVED_RAD, Track, apart};
use serde::Serialize;

/// Below this an arm rests, rad/s.
const RESTS_RAD_S: f64 = 0.01;

/// Over how long speeds are taken, s.
const WINDOW_S: f64 = 0.02;

/// Two motions are apart where the speed falls below this share of the slower one's highest.
const SPLIT_SPEED_RATIO: f64 = 0.1;

/// A rest as long as this parts two motions whatever their speed, s.
pub(super) const REST_S: f64 = 0.1;

/// From rest to rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Motion {
    /// Beginning, s.
    pub begins_s: f64,
    /// How long, s.
    pub lasts_s: f64,
}

impl Motion {
    /// Its end, s.
    pub fn ends_s(&self) -> f64 {
        self.begins_s + self.lasts_s
    }
}

/// Speeds of the fastest joint at equal intervals.
struct Speeds {
    first_s: f64,
    interval_s: f64,
    rad_s: Vec<f64>,
}

/// The motions of a track, looked at every `interval_s` seconds; times after `origin_s`.
pub fn motions(track: &Track, origin_s: f64, interval_s: f64) -> Vec<Motion> {
    let Some(speeds) = Speeds::of(track, interval_s) else { return Vec::new() };
    let mut parts = Vec::new();
    speeds.spans().into_iter().for_each(|span| speeds.part(span, &mut parts));
    let times = |(from, to): (usize, usize)| (speeds.time_s(from), speeds.time_s(to));
    let half = 0.5 * WINDOW_S.max(2.0 * interval_s);
    let moved = |(begins, ends): &(f64, f64)| {
        let (from, to) = (begins - half, ends + half);
        let [first, end] = [from, to].map(|at| track.times_s.partition_point(|time| *time < at));
        let within = track.joints.get(first..end).unwrap_or_default();
        track.at(from).is_some_and(|rest| within.iter().any(|q| apart(q, &rest) > MOVED_RAD))
    };
    let whole = parts.into_iter().map(times).filter(moved);
    whole.map(|(begins, ends)| Motion { begins_s: begins - origin_s, lasts_s: ends - begins }).collect()
}

impl Speeds {
    fn of(track: &Track, interval_s: f64) -> Option<Speeds> {
        let (first, last) = (track.times_s.first()?, track.times_s.last()?);
        let half = 0.5 * WINDOW_S.max(2.0 * interval_s);
        let count = if interval_s > 0.0 { ((last - first) / interval_s) as usize } else { 0 };
        let at = |step: usize| {
            let time_s = first + step as f64 * interval_s;
            Some(apart(&track.at(time_s - half)?, &track.at(time_s + half)?) / (2.0 * half))
        };
        let rad_s = (0..=count).map(|step| at(step).unwrap_or_default()).collect();
        Some(Speeds { first_s: *first, interval_s, rad_s })
    }

    fn time_s(&self, step: usize) -> f64 {
        self.first_s + step as f64 * self.interval_s
    }

    /// First and last step of each span without a long rest.
    fn spans(&self) -> Vec<(usize, usize)> {
        let mut spans: Vec<(usize, usize)> = Vec::new();
        let longest = (REST_S / self.interval_s).max(1.5);
        for (step, _) in self.rad_s.iter().enumerate().filter(|(_, speed)| **speed >= RESTS_RAD_S) {
            match spans.last_mut() {
                Some((_, to)) if ((step - *to) as f64) < longest => *to = step,
                _ => spans.push((step, step)),
            }
        }
        spans
    }

    /// Parts a span wherever the speed drops far enough below what it is before and after. What rests
    /// belongs to no part.
    fn part(&self, (from, to): (usize, usize), parts: &mut Vec<(usize, usize)>) {
        let (mut begins, mut before) = (from, 0.0_f64);
        let mut lowest = (f64::INFINITY, from);
        for (step, speed) in self.rad_s.iter().copied().enumerate().take(to + 1).skip(from) {
            let slower = before.min(speed);
            if slower >= RESTS_RAD_S && lowest.0 < SPLIT_SPEED_RATIO * slower {
                parts.push(self.trimmed(begins, lowest.1));
                (begins, before, lowest) = (lowest.1, speed, (f64::INFINITY, step));
            } else if speed > before {
                (before, lowest) = (speed, (f64::INFINITY, step));
            } else if speed < lowest.0 {
                lowest = (speed, step);
            }
        }
        parts.push(self.trimmed(begins, to));
    }

    /// Without what rests at both ends.
    fn trimmed(&self, from: usize, to: usize) -> (usize, usize) {
        let moves = |step: &usize| self.rad_s.get(*step).is_some_and(|speed| *speed >= RESTS_RAD_S);
        ((from..=to).find(moves).unwrap_or(from), (from..=to).rev().find(moves).unwrap_or(to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A base joint that turns at 0.5 rad/s in these spans, backwards where the second speed says so,
    /// sampled every 2 ms, with uneasy encoders.
    fn turning(spans: &[(f64, f64, f64)], length_s: f64) -> Track {
        let turned = |time: f64| {
            let done =
                spans.iter().map(|(from, to, speed)| (time.min(*to) - from).max(0.0) * speed).sum::<f64>();
            done + if (time * 500.0).round() as i64 % 2 == 0 { 2e-5 } else { 0.0 }
        };
        let times_s: Vec<f64> = (0..(length_s * 500.0) as usize).map(|frame| frame as f64 * 0.002).collect();
        let joints = times_s.iter().map(|time| [turned(*time), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        Track { times_s, joints, ..Track::default() }
    }

    /// The base goes there and back with ramps of 1 rad/s2, without any rest.
    fn there_and_back() -> Track {
        let times_s: Vec<f64> = (0..2500).map(|frame| f64::from(frame) * 0.002).collect();
        let ramp = |t: f64| if t < 1.0 { 0.5 * t * t } else { 1.0 - 0.5 * (2.0 - t) * (2.0 - t) };
        let at = |time: f64| match time - 0.5 {
            t if t < 0.0 => 0.0,
            t if t < 2.0 => ramp(t),
            t if t < 4.0 => 1.0 - ramp(t - 2.0),
            _ => 0.0,
        };
        let joints = times_s.iter().map(|time| [at(*time), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        Track { times_s, joints, ..Track::default() }
    }

    #[test]
    fn a_rest_of_a_moment_parts_two_motions() {
        let track = turning(&[(0.5, 1.5, 0.5), (1.54, 2.5, 0.5), (3.0, 3.4, 0.5)], 4.0);
        let found = motions(&track, 0.5, 0.002);
        assert_eq!(found.len(), 3, "{found:?}");
        for (motion, (begins, lasts)) in found.iter().zip([(0.0, 1.0), (1.04, 0.96), (2.5, 0.4)]) {
            assert!((motion.begins_s - begins).abs() < 0.015, "{motion:?}");
            assert!((motion.lasts_s - lasts).abs() < 0.03, "{motion:?}");
        }
    }

    #[test]
    fn a_passage_through_zero_parts_two_motions() {
        for interval_s in [0.002, 0.01] {
            let found = motions(&there_and_back(), 0.5, interval_s);
            assert_eq!(found.len(), 2, "{found:?}");
            assert!((found[1].begins_s - 2.0).abs() < 0.025, "{found:?}");
            assert!(found.iter().all(|motion| (motion.lasts_s - 2.0).abs() < 0.05), "{found:?}");
        }
    }

    #[test]
    fn an_arm_that_slows_down_on_its_way_is_in_one_motion() {
        let track = turning(&[(0.5, 1.5, 0.5), (1.5, 1.6, 0.1), (1.6, 2.6, 0.5)], 4.0);
        assert_eq!(motions(&track, 0.0, 0.002).len(), 1);
        let slow = turning(&[(0.5, 3.5, 0.012)], 4.0);
        assert_eq!(motions(&slow, 0.0, 0.002).len(), 1, "{:?}", motions(&slow, 0.0, 0.002));
    }

    #[test]
    fn an_arm_that_rests_has_no_motions() {
        assert_eq!(motions(&turning(&[], 2.0), 0.0, 0.002), []);
        assert_eq!(motions(&Track::default(), 0.0, 0.002), []);
    }

    #[test]
    fn slow_recordings_have_the_same_motions() {
        let track = turning(&[(0.5, 1.5, 0.5), (3.0, 3.4, 0.5)], 4.0);
        let slow = motions(&track, 0.5, 0.04);
        assert_eq!(slow.len(), 2);
        assert!((slow[0].lasts_s - 1.0).abs() < 0.1, "{slow:?}");
    }
}
