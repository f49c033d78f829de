//! How the joints come to rest: their offset from the target, and the measured speed.
//!
//! In: the joint speeds of each frame. Out: offset and measured speed of each joint. Pure, by seed.
//!
//! From recordings of an unloaded UR10e at 100 Hz: after a move the joints are within 0.1 mrad of their
//! target (0.2 mrad at times). They creep there in jolts for up to a second. The measured speed is
//! filtered: a jolt shows as a peak of about 1 mrad/s (2 mrad/s at most) that falls to a third within 40
//! ms. At rest there are peaks of up to 0.3 mrad/s. Speeds took 0.17 to 1.11 s, in the median 0.64 s, from
//! below 50 mrad/s to 0.15 s without a peak over 0.5 mrad/s. Older controllers report noise of up to 2.8
//! mrad/s (one report).
//!
//! Inferred: the size of a jolt, from its peak of speed, as the recorded positions have 0.1 mrad. Chosen:
//! which joints jolt and when, so that the recorded times come out if all joints move. Not modelled: the
//! swing of a loaded arm, which was 0.6 mrad for 0.25 s with 2.6 kg.

use crate::motion::FRAME_SECONDS;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// How the joints stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stop {
    /// At the target, at once.
    #[default]
    Exact,
    /// They creep to the target, and tremble.
    Creeping,
}

/// Behaviour at rest. Default: exact, without noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RestConfig {
    /// How they stop.
    pub stop: Stop,
    /// Largest noise of the measured speed, rad/s.
    pub speed_noise: f64,
    /// Largest noise of the measured position, rad.
    pub position_noise: f64,
}

impl RestConfig {
    /// As recorded of an e-Series arm.
    pub fn recorded() -> RestConfig {
        RestConfig { stop: Stop::Creeping, ..RestConfig::default() }
    }
}

/// Time constant of the speed filter, s.
const FILTER_S: f64 = 0.035;

/// Size of a jolt, rad.
const JOLT_RAD: Range<f64> = 2.6e-5..4.4e-5;

/// Jolts of a joint after a move, drawn from these.
const JOLTS: [usize; 4] = [1, 2, 2, 2];

/// Latest jolt after a move, s.
const LAST_JOLT_S: f64 = 0.95;

/// Share of the offset that builds up in each frame of a move.
const SHARE_OF_A_FRAME: f64 = 0.02;

/// Amplitude of a tremble at rest, rad: at most 0.3 mrad/s of measured speed.
const TREMBLE_RAD: Range<f64> = 3e-6..1.05e-5;

/// Time between two trembles, of any joint, s.
const TREMBLES_AFTER_S: Range<f64> = 0.2..4.0;

/// Slower counts as standstill, rad/s.
const LEAST_SPEED: f64 = 1e-9;

/// A joint's jump towards its target.
#[derive(Clone, Copy, Debug)]
struct Jolt {
    joint: usize,
    rad: f64,
    /// Frames until then.
    frames: u32,
}

/// The joints' offsets and measured speeds.
#[derive(Clone, Debug)]
pub struct Rest {
    rng: ChaCha8Rng,
    config: RestConfig,
    moves: bool,
    offset: [f64; 6],
    speed: [f64; 6],
    /// Due after the move under way, or after the last one.
    jolts: Vec<Jolt>,
    /// Offset of each joint at the end of the move, rad.
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

    /// Real offset of each joint from its target, rad.
    pub fn offset(&self) -> [f64; 6] {
        self.offset
    }

    /// Measured offset of each joint from its target, rad.
    pub fn measured(&self) -> [f64; 6] {
        std::array::from_fn(|joint| self.offset[joint] + self.noise[0][joint])
    }

    /// Measured speed of each joint minus its commanded speed, rad/s.
    pub fn measured_speed(&self) -> [f64; 6] {
        std::array::from_fn(|joint| self.speed[joint] + self.noise[1][joint])
    }

    /// One frame with these commanded joint speeds, rad/s.
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

    /// Draws the offset of a joint when it starts to move.
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
        // A short move has not reached its full offset.
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
            // Removes rounding errors.
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

    /// Measured speeds and offsets of a stop, from 0.05 rad/s on. It brakes at 0.87 rad/s2, as recorded.
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
    fn after_a_move_every_joint_is_within_a_tenth_of_a_milliradian() {
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

    /// Time and fastest joint of each line of a recording of positions and speeds.
    fn recording(text: &str) -> Vec<(f64, f64)> {
        let numbers = |line: &str| line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>();
        let line = |line: &str| {
            let numbers = numbers(line).unwrap();
            (numbers[0], numbers[7..13].iter().fold(0.0f64, |most, speed| most.max(speed.abs())))
        };
        text.lines().skip(1).map(line).collect()
    }

    /// Seconds of each stop from 0.05 rad/s until no joint was faster than 0.5 mrad/s for 0.15 s; and the
    /// fastest joint in each rest, from 1.2 s after it began.
    fn stops_and_rests(seen: &[(f64, f64)]) -> (Vec<f64>, Vec<f64>) {
        let (mut settled, mut rests) = (Vec::new(), Vec::new());
        let (mut moved, mut slow, mut quiet, mut still) = (false, None, None, None);
        for &(time, speed) in seen {
            moved |= speed > 0.2;
            slow = if speed < 0.05 { slow.or(Some(time)) } else { None };
            quiet = if speed <= 5e-4 { quiet.or(Some(time)) } else { None };
            still = if speed < 2e-3 { still.or(Some((time, rests.len()))) } else { None };
            if let (true, Some(since), Some(first)) = (moved, slow, quiet)
                && time - first >= 0.15
            {
                settled.push(time - since);
                moved = false;
            }
            if let Some((_, number)) = still.filter(|(since, _)| time - since > 1.2) {
                rests.resize(number + 1, 0.0);
                rests[number] = speed.max(rests[number]);
            }
        }
        (settled, rests)
    }

    /// The recordings at hand have few stops; each is one that the simulated arm could have made.
    #[test]
    fn the_simulated_arm_comes_to_rest_and_trembles_as_in_the_recordings() {
        let Some(data) = std::env::var_os("CELLD_DATA") else {
            eprintln!("SKIPPED: no recordings of a real UR10e (set CELLD_DATA)");
            return;
        };
        let folder = std::path::PathBuf::from(data).join("real/ur10e");
        let files = std::fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
        let texts = files.map(|file| std::fs::read_to_string(file).unwrap());
        let (mut settled, mut trembles) = (Vec::new(), Vec::new());
        for (stops, rests) in texts.map(|text| stops_and_rests(&recording(&text))) {
            settled.extend(stops);
            trembles.extend(rests);
        }
        assert!(settled.len() >= 4 && trembles.len() >= 6, "{settled:?} {trembles:?}");
        let mut rest = Rest::new(RestConfig::recorded(), 8);
        let (mut ours, mut our_trembles) = (Vec::new(), Vec::new());
        for _ in 0..400 {
            let speeds = (0..5000u32).map(|frame| {
                let commanded = f64::max(0.4 - 0.87 * FRAME_SECONDS * f64::from(frame), 0.0);
                rest.step(&[commanded; 6]);
                let fastest =
                    rest.measured_speed().iter().fold(0.0f64, |most, v| most.max((commanded + v).abs()));
                (f64::from(frame) * FRAME_SECONDS, fastest)
            });
            // Every fifth frame, as often as the recordings.
            let (stops, rests) = stops_and_rests(&speeds.step_by(5).collect::<Vec<_>>());
            ours.extend(stops);
            our_trembles.extend(rests);
        }
        ours.sort_by(f64::total_cmp);
        settled.sort_by(f64::total_cmp);
        let (least, most) = (ours[0], ours[ours.len() - 1]);
        assert!(settled.iter().all(|s| (least..=most).contains(s)), "{settled:?}, ours {least} to {most}");
        let median = ours[ours.len() / 2];
        assert!((settled[0] - 0.1..=settled[settled.len() - 1]).contains(&median), "{median} s, {settled:?}");
        let most = |all: &[f64]| all.iter().fold(0.0f64, |most, one| most.max(*one));
        let (recorded, simulated) = (most(&trembles), most(&our_trembles));
        assert!(
            simulated >= recorded && simulated < 1.6 * recorded,
            "{simulated}, recorded {recorded} rad/s"
        );
    }
}
