//! Standstill detection for pictures, from joint positions.
//!
//! In: the joint positions of successive robot states. Out: how long every joint has stayed within
//! [`STILL_RAD`], and the joint that last moved more. Pure.
//!
//! Measured joint speeds are no measure of standstill. In recordings of a UR10e they have peaks of 1 to 2
//! mrad/s for up to a second after a move. Older controllers report up to 2.8 mrad/s all the time
//! (ur_modern_driver#271). The positions of an unloaded arm settle at once. An arm with 2.6 kg swung by 0.6
//! mrad for a quarter of a second; at each turning point it looked still for about 50 ms.

use cell_values::time::{Duration, Timestamp};
use cell_values::units::{JOINT_NAMES, Joints};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// How far a joint may move while a picture is taken, rad. Chosen: one joint turned by this moves a camera
/// at 0.85 m by 0.17 mm. It is also how noisy the positions at rest may be.
pub const STILL_RAD: f64 = 2e-4;

/// Shortest rest before a picture, whatever the configuration says. A real arm may swing: in the recordings
/// 150 ms are enough. The simulated one only creeps.
pub const LEAST_REST: Duration = Duration::from_millis(150);
pub const SIMULATED_LEAST_REST: Duration = Duration::from_millis(48);

/// Least time between two stored states. All states are compared, stored or not.
const KEPT_EVERY: Duration = Duration::from_millis(6);

/// A longer gap between states restarts the window.
const LONGEST_GAP: Duration = Duration::from_millis(100);

/// The arm is reported as restless after this long.
const REPORTED_AFTER: Duration = Duration::from_secs(2);

/// An older motion is not reported.
const LATELY: Duration = Duration::from_secs(1);

/// A joint and its peak-to-peak motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct Sway {
    /// From 0, base to wrist 3.
    pub joint: usize,
    /// rad
    pub by_rad: f64,
}

impl Sway {
    /// The joint with the largest motion among some positions.
    pub fn among<'a>(positions: impl Iterator<Item = &'a Joints>) -> Sway {
        let (mut low, mut high) = ([f64::INFINITY; 6], [f64::NEG_INFINITY; 6]);
        for Joints(q) in positions {
            low = std::array::from_fn(|joint| low[joint].min(q[joint]));
            high = std::array::from_fn(|joint| high[joint].max(q[joint]));
        }
        let sways = (0..6).map(|joint| Sway { joint, by_rad: high[joint] - low[joint] });
        sways.fold(Sway::default(), |most, sway| if sway.by_rad > most.by_rad { sway } else { most })
    }
}

impl std::fmt::Display for Sway {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let joint = JOINT_NAMES.get(self.joint).copied().unwrap_or("a joint");
        let (by, most) = (self.by_rad * 1e3, STILL_RAD * 1e3);
        write!(f, "{joint} moves by {by:.2} mrad (limit {most:.2})")
    }
}

/// A window of joint positions.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct Stillness {
    /// Positions within [`STILL_RAD`] of one another, oldest first.
    within: VecDeque<(Timestamp, Joints)>,
    /// The joint that last moved more, and when.
    farther: Option<(Timestamp, Sway)>,
    since: Option<Timestamp>,
    reported: bool,
}

impl Stillness {
    /// Adds a state. Returns how long the arm has been at rest.
    pub fn note(&mut self, at: Timestamp, q: &Joints) -> Duration {
        self.since.get_or_insert(at);
        if self.within.back().is_some_and(|(last, _)| at.since(*last) > LONGEST_GAP) {
            self.within.clear();
        }
        self.within.push_back((at, *q));
        loop {
            let sway = Sway::among(self.within.iter().map(|(_, q)| q));
            if sway.by_rad <= STILL_RAD {
                break;
            }
            self.farther = Some((at, sway));
            self.within.pop_front();
        }
        if let [.., (before, _), (last, _)] = self.within.make_contiguous()
            && last.since(*before) < KEPT_EVERY
        {
            self.within.pop_back();
        }
        self.within.front().map_or(Duration::ZERO, |(since, _)| at.since(*since))
    }

    /// A message about a restless arm, once, after two seconds.
    pub fn report(&mut self, now: Timestamp) -> Option<String> {
        let long = self.since.is_some_and(|since| now.since(since) >= REPORTED_AFTER);
        let why = self.restless(now).filter(|_| long && !self.reported)?;
        self.reported = true;
        Some(format!("{why}; the picture waits; if this goes on, check what shakes the arm"))
    }

    /// Which joint still moves, as a message.
    pub fn restless(&self, now: Timestamp) -> Option<String> {
        let (at, sway) = self.farther?;
        (now.since(at) <= LATELY).then(|| format!("the arm is not at rest: {sway}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::recordings::{self, Sample};

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_secs_f64(10.0) + Duration::from_millis(ms)
    }

    /// Adds positions of one joint at 8 ms intervals. Returns how long the arm has been at rest.
    fn rest(stillness: &mut Stillness, from_ms: u64, positions: &[f64]) -> Duration {
        let mut rested = Duration::ZERO;
        for (k, position) in positions.iter().enumerate() {
            let mut q = Joints([0.3; 6]);
            q.0[3] += position;
            rested = stillness.note(ms(from_ms + 8 * k as u64), &q);
        }
        rested
    }

    #[test]
    fn an_arm_rests_once_its_joints_stay_where_they_are() {
        let mut stillness = Stillness::default();
        assert_eq!(
            rest(&mut stillness, 0, &[0.0, 0.01, 0.015, 0.0171, 0.018, 0.01805]),
            Duration::from_millis(8)
        );
        assert_eq!(rest(&mut stillness, 48, &[0.0181; 5]), Duration::from_millis(48));
        assert_eq!(rest(&mut stillness, 88, &[0.019]), Duration::ZERO, "it moves again");
        assert!(stillness.restless(ms(1000)).is_some_and(|why| why.contains("wrist 1 moves by")));
        assert_eq!(stillness.restless(ms(1100)), None, "long ago");
    }

    #[test]
    fn a_creeping_joint_does_not_rest() {
        let creeping: Vec<f64> = (0..100).map(|k| 4e-5 * f64::from(k)).collect();
        assert!(rest(&mut Stillness::default(), 0, &creeping) < SIMULATED_LEAST_REST);
    }

    #[test]
    fn noise_within_the_limit_is_rest() {
        let noisy: Vec<f64> = (0..100).map(|k| 1.9e-4 * f64::from(k % 2)).collect();
        assert_eq!(rest(&mut Stillness::default(), 0, &noisy), Duration::from_millis(8 * 99));
    }

    #[test]
    fn a_gap_restarts_the_window() {
        let mut stillness = Stillness::default();
        rest(&mut stillness, 0, &[0.0; 50]);
        assert_eq!(rest(&mut stillness, 392 + 101, &[0.0]), Duration::ZERO);
        let mut steady = Stillness::default();
        rest(&mut steady, 0, &[0.0; 50]);
        assert_eq!(rest(&mut steady, 392 + 100, &[0.0]), Duration::from_millis(492));
    }

    /// Seconds until the arm counts as at rest, and the largest joint motion in the 0.1 s after that, rad.
    fn rests(stop: &[Sample], needed: Duration) -> (f64, f64) {
        let mut stillness = Stillness::default();
        let rested = stop.iter().position(|sample| {
            // The file has four digits: a difference of 0.2 mrad is read as slightly more.
            let q = Joints(sample.q.0.map(|q| 0.999 * q));
            stillness.note(Timestamp::from_secs_f64(sample.time_s), &q) >= needed
        });
        let from = &stop[rested.expect("it rests")];
        let later = stop.iter().filter(|one| (0.0..=0.1).contains(&(one.time_s - from.time_s)));
        let moved = later.map(|one| one.q.max_difference(&from.q)).fold(0.0, f64::max);
        (from.time_s - stop[0].time_s, moved)
    }

    /// Every recorded stop that lasts a second or more.
    #[test]
    fn a_recorded_arm_stays_where_it_counts_as_at_rest() {
        let Some(recordings) = recordings::ur10e() else { return };
        let slow = |sample: &Sample| sample.qd.iter().all(|speed| speed.abs() < 0.05);
        let (mut stops, mut swings) = (0, 0);
        for (name, samples) in recordings {
            let begins = (1..samples.len()).filter(|k| !slow(&samples[k - 1]) && slow(&samples[*k]));
            for begin in begins {
                let stop = &samples[begin..];
                let stop = &stop[..stop.iter().position(|sample| !slow(sample)).unwrap_or(stop.len())];
                if stop.last().is_none_or(|last| last.time_s - stop[0].time_s < 1.0) {
                    continue;
                }
                stops += 1;
                let (after_s, moved) = rests(stop, LEAST_REST);
                assert!(after_s < 0.75 && moved < STILL_RAD + 1e-5, "{name}: {after_s} s, {moved} rad");
                swings += usize::from(rests(stop, SIMULATED_LEAST_REST).1 > 2.0 * STILL_RAD);
            }
        }
        assert!(stops >= 4 && swings >= 1, "{stops} stops, {swings} of an arm that swings");
    }

    #[test]
    fn a_restless_joint_is_reported_once_after_two_seconds() {
        let mut stillness = Stillness::default();
        rest(&mut stillness, 0, &[0.0; 4]);
        assert_eq!(stillness.report(ms(2000)), None, "nothing has moved");
        rest(&mut stillness, 1984, &[0.0, 5e-4]);
        assert_eq!(stillness.report(ms(1999)), None);
        let text = stillness.report(ms(2000)).unwrap();
        assert!(text.contains("wrist 1 moves by 0.50 mrad (limit 0.20)"), "{text}");
        assert_eq!(stillness.report(ms(5000)), None);
    }
}
