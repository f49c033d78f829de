//! How the joints come to rest: how far they are from where a move ends, and what is measured of it.
//!
//! In: how fast each joint moves, frame by frame. Out: how far each one is from its target, and what is
//! measured of its speed. Pure, by seed.
//!
//! As in recordings of a UR10e at 100 Hz: after a move without a load the joints are within 0.1 mrad of
//! their target (0.2 were recorded at times) and creep there in jolts, the last one up to 0.9 s later. The
//! measured speed is filtered: each jolt shows as a peak of about 1 mrad/s (up to 2 were recorded) that
//! falls to a third within 40 ms; the jolts' size is inferred from these peaks, as positions were written
//! to 0.1 mrad. At rest there are peaks of up to 0.3 mrad/s. From below 50 mrad/s to 0.15 s without a speed
//! over 0.5 mrad/s took 0.17 to 1.11 s, the median 0.64 s. How the jolts are spread over joints and time is
//! chosen so that this comes out where all joints move. Not modelled: an arm that swings by 0.6 mrad for
//! 0.25 s after a move, as was recorded with a load of 2.6 kg. The speed of controllers before the e-Series
//! is noisier all the time (up to 2.8 mrad/s, reported once).

use crate::motion::FRAME_SECONDS;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// How the joints stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stop {
    /// Where the move ends, at once, and they stay there.
    #[default]
    Exact,
    /// They creep there, and tremble.
    Creeping,
}

/// What is simulated of the joints at rest; nothing unless set otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RestConfig {
    /// How they stop.
    pub stop: Stop,
    /// Noise of the measured speed in every frame, rad/s.
    pub speed_noise: f64,
    /// Noise of the measured position in every frame, rad.
    pub position_noise: f64,
}

impl RestConfig {
    /// As in the recordings of an e-Series arm.
    pub fn recorded() -> RestConfig {
        RestConfig { stop: Stop::Creeping, ..RestConfig::default() }
    }
}

/// Time constant of the filter of the measured speed, s.
const FILTER_S: f64 = 0.035;

/// A jolt after a move, rad.
const JOLT_RAD: Range<f64> = 2.6e-5..4.4e-5;

/// How many a joint that has moved makes: each of these as often.
const JOLTS: [usize; 4] = [1, 2, 2, 2];

/// The last one comes at most so long after the move, s.
const LAST_JOLT_S: f64 = 0.95;

/// Share of the offset that comes about in a frame of a move.
const SHARE_OF_A_FRAME: f64 = 0.02;

/// At rest a joint goes to and fro by as much, rad, which shows as at most 0.3 mrad/s.
const TREMBLE_RAD: Range<f64> = 3e-6..1.05e-5;

/// So long after one another, s: any joint.
const TREMBLES_AFTER_S: Range<f64> = 0.2..4.0;

/// Speeds below this are none, rad/s.
const LEAST_SPEED: f64 = 1e-9;

/// What a joint still does after a move.
#[derive(Clone, Copy, Debug)]
struct Jolt {
    joint: usize,
    rad: f64,
    /// Frames until it comes.
    frames: u32,
}

/// The joints beside their motion.
#[derive(Clone, Debug)]
pub struct Rest {
    rng: ChaCha8Rng,
    config: RestConfig,
    moves: bool,
    offset: [f64; 6],
    speed: [f64; 6],
    /// Of the move under way, or still to come after the last one.
    jolts: Vec<Jolt>,
    /// The offset of each joint at the end of the move under way, rad.
    end_offset: [f64; 6],
    until_tremble: u32,
    trembles: [f64; 6],
    /// Noise of this frame: position and speed.
    noise: [[f64; 6]; 2],
}

impl Rest {
    /// Joints at rest.
    pub fn new(config: RestConfig, seed: u64) -> Rest {
        Rest {
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x7265_7374),
            config,
            moves: false,
            offset: [0.0; 6],
            speed: [0.0; 6],
            jolts: Vec::new(),
            end_offset: [0.0; 6],
            until_tremble: frames(TREMBLES_AFTER_S.end),
            trembles: [0.0; 6],
            noise: [[0.0; 6]; 2],
        }
    }

    /// Where each joint is, from its target, rad.
    pub fn offset(&self) -> [f64; 6] {
        self.offset
    }

    /// Where each joint is measured to be, from its target, rad.
    pub fn measured(&self) -> [f64; 6] {
        std::array::from_fn(|joint| self.offset[joint] + self.noise[0][joint])
    }

    /// What is measured of each joint's speed beside that of its motion, rad/s.
    pub fn measured_speed(&self) -> [f64; 6] {
        std::array::from_fn(|joint| self.speed[joint] + self.noise[1][joint])
    }

    /// One frame in which each joint moves as fast, rad/s.
    pub fn step(&mut self, qd: &[f64; 6]) {
        let RestConfig { stop, speed_noise, position_noise } = self.config;
        if stop == Stop::Creeping {
            self.creep(qd);
        }
        for (noise, largest) in self.noise.iter_mut().zip([position_noise, speed_noise]) {
            if largest > 0.0 {
                *noise = std::array::from_fn(|_| self.rng.random_range(-largest..=largest));
            }
        }
    }

    /// One frame with closed brakes: the joints stay where they are.
    pub fn brake(&mut self) {
        self.jolts.clear();
        (self.moves, self.speed) = (false, [0.0; 6]);
    }

    fn creep(&mut self, qd: &[f64; 6]) {
        let decay = (-FRAME_SECONDS / FILTER_S).exp();
        for speed in &mut self.speed {
            *speed = if speed.abs() < LEAST_SPEED { 0.0 } else { *speed * decay };
        }
        match (self.moves, qd.iter().any(|speed| speed.abs() > LEAST_SPEED)) {
            (false, true) => self.sets_out(),
            (true, false) => self.stops(),
            (true, true) => self.goes_on(qd),
            (false, false) => self.rests(),
        }
    }

    fn sets_out(&mut self) {
        (self.moves, self.end_offset) = (true, [0.0; 6]);
        self.jolts.clear();
    }

    /// A joint's offset is drawn once it moves.
    fn goes_on(&mut self, qd: &[f64; 6]) {
        for (joint, speed) in qd.iter().enumerate() {
            if speed.abs() > LEAST_SPEED && self.end_offset[joint] == 0.0 {
                let sign = speed.signum();
                for _ in 0..JOLTS[self.rng.random_range(0..JOLTS.len())] {
                    let rad = sign * self.rng.random_range(JOLT_RAD);
                    self.jolts.push(Jolt { joint, rad, frames: 0 });
                    self.end_offset[joint] -= rad;
                }
            }
            self.offset[joint] += (self.end_offset[joint] - self.offset[joint]) * SHARE_OF_A_FRAME;
        }
    }

    fn stops(&mut self) {
        self.moves = false;
        // A short move has not come to its whole offset.
        for joint in 0..6 {
            let reached =
                if self.end_offset[joint] == 0.0 { 0.0 } else { self.offset[joint] / self.end_offset[joint] };
            self.jolts.iter_mut().filter(|jolt| jolt.joint == joint).for_each(|jolt| jolt.rad *= reached);
        }
        let last_s = LAST_JOLT_S * (self.rng.random::<f64>() + self.rng.random::<f64>()) / 2.0;
        for (number, jolt) in self.jolts.iter_mut().enumerate() {
            let share = if number == 0 { 1.0 } else { self.rng.random::<f64>() };
            jolt.frames = frames(share * last_s);
        }
    }

    fn rests(&mut self) {
        let due = |jolt: &mut Jolt| {
            jolt.frames = jolt.frames.saturating_sub(1);
            jolt.frames == 0
        };
        let due: Vec<Jolt> = self.jolts.extract_if(.., due).collect();
        due.iter().for_each(|jolt| self.jerk(jolt.joint, jolt.rad));
        if !due.is_empty() && self.jolts.is_empty() {
            // What rounding leaves.
            self.offset = self.trembles;
        }
        self.until_tremble = self.until_tremble.saturating_sub(1);
        if self.until_tremble == 0 {
            self.until_tremble = frames(self.rng.random_range(TREMBLES_AFTER_S));
            let joint = self.rng.random_range(0..6);
            let to = if self.trembles[joint] == 0.0 { self.rng.random_range(TREMBLE_RAD) } else { 0.0 };
            self.jerk(joint, to - self.trembles[joint]);
            self.trembles[joint] = to;
        }
    }

    fn jerk(&mut self, joint: usize, rad: f64) {
        self.offset[joint] += rad;
        self.speed[joint] += rad / FILTER_S;
    }
}

fn frames(seconds: f64) -> u32 {
    (seconds / FRAME_SECONDS).round().max(1.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A move that brakes at 0.87 rad/s2, as in the recordings, then three seconds: measured speeds and how
    /// far the joints are off, from below 0.05 rad/s on.
    fn stop(rest: &mut Rest) -> Vec<([f64; 6], [f64; 6])> {
        let mut seen = Vec::new();
        let mut speed = 0.4;
        for _ in 0..2000 {
            rest.step(&[speed; 6]);
            if speed < 0.05 {
                seen.push((rest.measured_speed().map(|more| speed + more), rest.measured()));
            }
            speed = f64::max(speed - 0.87 * FRAME_SECONDS, 0.0);
        }
        seen
    }

    /// Seconds until no joint was faster than 0.5 mrad/s for 0.15 s.
    fn quiet_after(seen: &[([f64; 6], [f64; 6])]) -> f64 {
        let loud = |(speed, _): &([f64; 6], [f64; 6])| speed.iter().any(|speed| speed.abs() > 5e-4);
        let mut quiet = 0;
        for (number, frame) in seen.iter().enumerate() {
            quiet = if loud(frame) { 0 } else { quiet + 1 };
            if f64::from(quiet) * FRAME_SECONDS >= 0.15 {
                return (number + 1) as f64 * FRAME_SECONDS;
            }
        }
        f64::INFINITY
    }

    #[test]
    fn the_joints_are_quiet_as_late_as_in_the_recordings() {
        let mut rest = Rest::new(RestConfig::recorded(), 1);
        let mut seconds: Vec<f64> = (0..400).map(|_| quiet_after(&stop(&mut rest))).collect();
        seconds.sort_by(f64::total_cmp);
        let quantile = |share: f64| seconds[(share * (seconds.len() - 1) as f64) as usize];
        assert!((0.55..0.72).contains(&quantile(0.5)), "median {}", quantile(0.5));
        assert!(quantile(0.0) >= 0.17 && quantile(1.0) <= 1.25, "{} to {}", quantile(0.0), quantile(1.0));
        assert!(quantile(0.25) > 0.4 && quantile(0.75) < 0.85, "{} {}", quantile(0.25), quantile(0.75));
    }

    #[test]
    fn at_rest_the_joints_tremble_no_more_than_recorded() {
        let mut rest = Rest::new(RestConfig::recorded(), 3);
        let at_rest: Vec<_> = (0..10).flat_map(|_| stop(&mut rest).split_off(800)).collect();
        let fastest =
            at_rest.iter().flat_map(|(speed, _)| *speed).fold(0.0, |most: f64, v| most.max(v.abs()));
        let off = at_rest.iter().flat_map(|(_, off)| *off).fold(0.0, |most: f64, v| most.max(v.abs()));
        assert!(fastest > 5e-5 && fastest <= 3e-4, "{fastest} rad/s");
        assert!(off > 0.0 && off < 5e-5, "{off} rad");
    }

    #[test]
    fn right_after_a_move_every_joint_is_near_its_target() {
        let mut rest = Rest::new(RestConfig::recorded(), 4);
        let off = (0..50).flat_map(|_| stop(&mut rest)).flat_map(|(_, off)| off);
        let most = off.fold(0.0, |most: f64, v| most.max(v.abs()));
        assert!(most > 5e-5 && most <= 1e-4, "{most} rad");
    }

    #[test]
    fn an_old_controllers_speed_is_noisy_and_its_joints_are_not() {
        let old = RestConfig { speed_noise: 2.8e-3, ..RestConfig::default() };
        let mut rest = Rest::new(old, 5);
        let seen: Vec<_> = (0..500)
            .map(|_| {
                rest.step(&[0.0; 6]);
                (rest.measured_speed(), rest.measured())
            })
            .collect();
        assert!(seen.iter().filter(|(speed, _)| speed.iter().any(|v| v.abs() > 5e-4)).count() > 400);
        assert!(seen.iter().all(|(speed, off)| speed.iter().all(|v| v.abs() <= 2.8e-3) && *off == [0.0; 6]));
    }

    #[test]
    fn joints_that_stop_exactly_are_where_the_move_ends() {
        let mut rest = Rest::new(RestConfig::default(), 6);
        let seen = stop(&mut rest);
        assert!(seen.iter().all(|(_, off)| *off == [0.0; 6]) && rest.measured_speed() == [0.0; 6]);
    }

    #[test]
    fn the_same_seed_comes_to_rest_in_the_same_way() {
        let last = |seed| {
            let seen = stop(&mut Rest::new(RestConfig::recorded(), seed));
            seen.into_iter().map(|(speed, _)| speed[2]).sum::<f64>()
        };
        assert_eq!(last(7), last(7));
        assert_ne!(last(7), last(8));
    }
}
