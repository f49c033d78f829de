//! When an arm moved: the spans of a track between rests. Pure.
//!
//! In: a track and the grid it is looked at. Out: [`Motion`]s, times after an origin. Speeds are taken
//! over a window, because encoders are uneasy, and short rests belong to a motion, because whether an
//! arm comes to rest between two moves for a moment depends on how its samples fall.

use crate::compare::track::{MOVED_RAD, Track, apart};
use serde::Serialize;

/// Below this an arm rests, rad/s.
const RESTS_RAD_S: f64 = 0.01;

/// Over how long speeds are taken, s.
const WINDOW_S: f64 = 0.04;

/// Rests shorter than this are part of a motion, s.
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

/// The motions of a track, looked at every `interval_s` seconds; times after `origin_s`.
pub fn motions(track: &Track, origin_s: f64, interval_s: f64) -> Vec<Motion> {
    let (Some(first), Some(last)) = (track.times_s.first(), track.times_s.last()) else { return Vec::new() };
    let half = WINDOW_S.max(2.0 * interval_s) / 2.0;
    let count = if interval_s > 0.0 { ((last - first) / interval_s) as usize } else { 0 };
    let mut spans: Vec<(f64, f64)> = Vec::new();
    for step in 0..=count {
        let time_s = first + step as f64 * interval_s;
        let (Some(before), Some(after)) = (track.at(time_s - half), track.at(time_s + half)) else {
            continue;
        };
        if apart(&before, &after) / (2.0 * half) < RESTS_RAD_S {
            continue;
        }
        match spans.last_mut() {
            Some((_, ends)) if time_s - *ends < REST_S.max(1.5 * interval_s) => *ends = time_s,
            _ => spans.push((time_s, time_s)),
        }
    }
    let moved = |(begins, ends): &(f64, f64)| {
        let (from, to) = (begins - half, ends + half);
        let samples =
            track.times_s.iter().zip(&track.joints).filter(|(time, _)| **time >= from && **time <= to);
        track.at(from).is_some_and(|rest| samples.into_iter().any(|(_, q)| apart(q, &rest) > MOVED_RAD))
    };
    let whole = spans.iter().filter(|span| moved(span));
    // The window sees a motion before it begins, and as long after its end.
    let motion = |(begins, ends): &(f64, f64)| Motion { begins_s: begins - origin_s, lasts_s: ends - begins };
    whole.map(motion).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A base joint that turns at 0.5 rad/s in these spans, sampled every 2 ms, with uneasy encoders.
    fn turning(spans: &[(f64, f64)], length_s: f64) -> Track {
        let turned = |time: f64| {
            let done = spans.iter().map(|(from, to)| (time.min(*to) - from).max(0.0) * 0.5).sum::<f64>();
            done + if (time * 500.0).round() as i64 % 2 == 0 { 2e-5 } else { 0.0 }
        };
        let times_s: Vec<f64> = (0..(length_s * 500.0) as usize).map(|frame| frame as f64 * 0.002).collect();
        let joints = times_s.iter().map(|time| [turned(*time), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        Track { times_s, joints, ..Track::default() }
    }

    #[test]
    fn motions_are_between_rests_and_moments_of_rest_belong_to_them() {
        let track = turning(&[(0.5, 1.5), (1.55, 2.5), (3.0, 3.4)], 4.0);
        let found = motions(&track, 0.5, 0.002);
        assert_eq!(found.len(), 2, "{found:?}");
        for (motion, (begins, lasts)) in found.iter().zip([(0.0, 2.0), (2.5, 0.4)]) {
            assert!((motion.begins_s - begins).abs() < 0.025, "{motion:?}");
            assert!((motion.lasts_s - lasts).abs() < 0.05, "{motion:?}");
        }
    }

    #[test]
    fn an_arm_that_rests_has_no_motions() {
        assert_eq!(motions(&turning(&[], 2.0), 0.0, 0.002), []);
        assert_eq!(motions(&Track::default(), 0.0, 0.002), []);
    }

    #[test]
    fn slow_recordings_have_the_same_motions() {
        let track = turning(&[(0.5, 1.5), (3.0, 3.4)], 4.0);
        let slow = motions(&track, 0.5, 0.04);
        assert_eq!(slow.len(), 2);
        assert!((slow[0].lasts_s - 1.0).abs() < 0.1, "{slow:?}");
    }
}
