//! How far a simulated arm was from a recorded one. Pure.
//!
//! In: both tracks. Out: [`Comparison`]: joint positions over time from the first motion on, the pause
//! before each motion and its length, changes of the states; and what of it is beyond given tolerances, in
//! sentences. Each motion is compared from its own beginning (`alignment`): a pause that is longer on one
//! side is said once, not again as a distance of all that follows.

use crate::compare::alignment::Alignment;
use crate::compare::motions::{Motion, REST_S, motions};
use crate::compare::track::{Change, STATES, Track};
use serde::Serialize;

/// What is still agreement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tolerances {
    /// Of a joint's position at any time, rad.
    pub joint_rad: f64,
    /// Of the pause before a motion, of its length, and of when a state changes, s.
    pub time_s: f64,
}

/// Why two tracks cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompareError {
    /// Nothing to align by.
    #[error("the recorded arm never moves")]
    RecordedRests,
    /// Nothing to align by.
    #[error("the simulated arm never moves")]
    SimulatedRests,
}

/// One joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct JointError {
    /// Largest difference, rad.
    pub largest_rad: f64,
    /// When, s after the first motion.
    pub at_s: f64,
    /// Root of the mean square, rad.
    pub rms_rad: f64,
}

/// A motion of both arms, or of one alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MotionPair {
    /// The real one; absent: the simulated arm alone moved.
    pub recorded: Option<Motion>,
    /// The simulated one.
    pub simulated: Option<Motion>,
    /// How much longer the simulated arm rested before it, s; absent for the first one.
    pub pause_longer_s: Option<f64>,
    /// Largest difference of a joint while either moved, both from its beginning on, rad.
    pub largest_rad: f64,
    /// When it begins by the recording's clock, s.
    #[serde(skip)]
    at_s: f64,
}

/// A state over time; times after the first motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StatePair {
    /// As RTDE names it.
    pub name: &'static str,
    /// What was recorded.
    pub recorded: Vec<Change>,
    /// What the simulated controller had, as long as the recording lasts; times of the recording, by the
    /// motions.
    pub simulated: Vec<Change>,
}

/// All differences.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Samples of the recording that were compared.
    pub samples: usize,
    /// Usual time between them, s.
    pub interval_s: f64,
    /// Time compared, s.
    pub length_s: f64,
    /// Base to wrist 3.
    pub joints: [JointError; 6],
    /// In order.
    pub motions: Vec<MotionPair>,
    /// Those that were recorded.
    pub states: Vec<StatePair>,
}

/// Compares from the first motion of each to the end of the recording.
///
/// # Errors
/// [`CompareError`].
pub fn compare(recorded: &Track, simulated: &Track) -> Result<Comparison, CompareError> {
    let began = recorded.first_motion_s().ok_or(CompareError::RecordedRests)?;
    let sim_began = simulated.first_motion_s().ok_or(CompareError::SimulatedRests)?;
    let interval_s = recorded.interval_s();
    let length_s = recorded.times_s.last().map_or(0.0, |last| last - began);
    let real = motions(recorded, began, interval_s);
    let mut ours = motions(simulated, sim_began, interval_s);
    let alignment = Alignment::of((recorded, began, &real), (simulated, sim_began, &ours));
    let mut index = 0..;
    ours.retain(|motion| index.next().is_some_and(|n| alignment.begins_s(n, motion.begins_s) <= length_s));
    let samples = recorded.times_s.iter().zip(&recorded.joints).filter(|(time, _)| **time >= began);
    let error = |(time, q): (&f64, &[f64; 6])| {
        let at_s = time - began;
        let other = simulated.at(alignment.simulated_s(at_s) + sim_began)?;
        Some((at_s, std::array::from_fn(|joint| other[joint] - q[joint])))
    };
    let errors: Vec<(f64, [f64; 6])> = samples.filter_map(error).collect();
    Ok(Comparison {
        samples: errors.len(),
        interval_s,
        length_s,
        joints: std::array::from_fn(|joint| joint_error(&errors, joint)),
        motions: pairs(&real, &ours, &errors, &alignment),
        states: states(recorded, simulated, (began, sim_began), (&alignment, length_s)),
    })
}

fn joint_error(errors: &[(f64, [f64; 6])], joint: usize) -> JointError {
    let mut found = JointError::default();
    for (at_s, error) in errors {
        if error[joint].abs() > found.largest_rad {
            (found.largest_rad, found.at_s) = (error[joint].abs(), *at_s);
        }
    }
    let squares: f64 = errors.iter().map(|(_, error)| error[joint] * error[joint]).sum();
    found.rms_rad = (squares / errors.len().max(1) as f64).sqrt();
    found
}

fn pairs(
    real: &[Motion],
    ours: &[Motion],
    errors: &[(f64, [f64; 6])],
    alignment: &Alignment,
) -> Vec<MotionPair> {
    let pause = |motions: &[Motion], index: usize| {
        let before = motions.get(index.checked_sub(1)?)?;
        Some(motions.get(index)?.begins_s - before.ends_s())
    };
    let pair = |index: usize| {
        let (recorded, simulated) = (real.get(index).copied(), ours.get(index).copied());
        let aligned = simulated.map(|motion| {
            let begins_s = alignment.begins_s(index, motion.begins_s);
            Motion { begins_s, ..motion }
        });
        let both = [recorded, aligned];
        let begins = both.iter().flatten().map(|motion| motion.begins_s).fold(f64::INFINITY, f64::min);
        let ends = both.iter().flatten().map(Motion::ends_s).fold(f64::NEG_INFINITY, f64::max);
        let within = errors.iter().filter(|(at_s, _)| (begins..=ends).contains(at_s));
        let largest_rad = within.flat_map(|(_, error)| error).fold(0.0, |most, error| error.abs().max(most));
        let pauses = pause(real, index).zip(pause(ours, index));
        MotionPair {
            recorded,
            simulated,
            pause_longer_s: pauses.map(|(real, ours)| ours - real),
            largest_rad,
            at_s: begins,
        }
    };
    (0..real.len().max(ours.len())).map(pair).collect()
}

fn states(
    recorded: &Track,
    simulated: &Track,
    origins: (f64, f64),
    (alignment, length_s): (&Alignment, f64),
) -> Vec<StatePair> {
    let pair = |(index, name): (usize, &'static str)| {
        let recorded = recorded.changes(index, origins.0)?;
        let mut simulated = simulated.changes(index, origins.1).unwrap_or_default();
        simulated.iter_mut().for_each(|change| change.at_s = alignment.recorded_s(change.at_s));
        simulated.retain(|change| change.at_s <= length_s);
        Some(StatePair { name, recorded, simulated })
    };
    STATES.into_iter().enumerate().filter_map(pair).collect()
}

impl StatePair {
    /// The first difference, in a sentence. What changes within `time_s` of `length_s` may be missing on the
    /// other side: the recording ended meanwhile.
    fn difference(&self, time_s: f64, length_s: f64) -> Option<String> {
        let counted = |change: &&Change| change.at_s <= length_s - time_s;
        for (real, ours) in self.recorded.iter().zip(&self.simulated) {
            let late_s = ours.at_s - real.at_s;
            if real.state != ours.state || late_s.abs() > time_s {
                return Some(format!(
                    "{}: recorded {} at {:.3} s, simulated {} at {:.3} s",
                    self.name, real.state, real.at_s, ours.state, ours.at_s
                ));
            }
        }
        let both = self.recorded.len().min(self.simulated.len());
        let further = |changes: &[Change], side| {
            let change = changes.get(both..)?.iter().find(counted)?;
            Some(format!("{}: {side} alone became {} at {:.3} s", self.name, change.state, change.at_s))
        };
        further(&self.recorded, "recorded").or_else(|| further(&self.simulated, "simulated"))
    }
}

impl MotionPair {
    /// The first thing that differs by more than `time_s`, in a sentence. What the end of the recording at
    /// `length_s` cuts off is not judged.
    fn difference(&self, number: usize, time_s: f64, length_s: f64) -> Option<String> {
        let (real, ours) = match (self.recorded, self.simulated) {
            (None, Some(_)) if self.at_s > length_s - time_s => return None,
            (Some(real), Some(ours)) => (real, ours),
            (Some(real), None) => {
                return Some(format!("motion {number}: recorded alone, at {:.3} s", real.begins_s));
            }
            (None, _) => return Some(format!("motion {number}: simulated alone, at {:.3} s", self.at_s)),
        };
        let longer_s = ours.lasts_s - real.lasts_s;
        if let Some(pause_s) = self.pause_longer_s.filter(|pause_s| pause_s.abs() > time_s) {
            let by = longer_or_shorter(pause_s);
            return Some(format!(
                "motion {number}: the simulated pause before it is {by} than the recorded one"
            ));
        }
        let by = longer_or_shorter(longer_s);
        let sentence = format!("motion {number}: the simulated one is {by} than the recorded one");
        let cut = real.ends_s() > length_s - REST_S && longer_s > 0.0;
        (longer_s.abs() > time_s && !cut).then_some(sentence)
    }
}

fn longer_or_shorter(seconds: f64) -> String {
    format!("{:.3} s {}", seconds.abs(), if seconds > 0.0 { "longer" } else { "shorter" })
}

impl Comparison {
    /// What is beyond the tolerances, in sentences.
    pub fn breaches(&self, tolerances: &Tolerances) -> Vec<String> {
        let joints = self.joints.iter().enumerate();
        let joints =
            joints.filter(|(_, error)| error.largest_rad > tolerances.joint_rad).map(|(joint, error)| {
                format!("joint {joint}: {:.4} rad apart at {:.3} s", error.largest_rad, error.at_s)
            });
        let motions = self.motions.iter().zip(1..);
        let motions =
            motions.filter_map(|(pair, number)| pair.difference(number, tolerances.time_s, self.length_s));
        let states = self.states.iter();
        let states = states.filter_map(|pair| pair.difference(tolerances.time_s, self.length_s));
        joints.chain(motions).chain(states).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCES: Tolerances = Tolerances { joint_rad: 0.01, time_s: 0.05 };

    /// Rests for `rest_s`, then turns the elbow by 0.4 rad within `lasts_s`, and rests again until `end_s`.
    fn turning(rest_s: f64, lasts_s: f64, end_s: f64) -> Track {
        let times_s: Vec<f64> = (0..=(end_s * 500.0) as usize).map(|frame| frame as f64 * 0.002).collect();
        let turned = |time: &f64| ((time - rest_s) / lasts_s).clamp(0.0, 1.0) * 0.4;
        let playing = |time: &f64| if *time < rest_s || *time > rest_s + lasts_s { 1 } else { 2 };
        Track {
            joints: times_s.iter().map(|time| [0.0, 0.0, turned(time), 0.0, 0.0, 0.0]).collect(),
            states: [Some(vec![7; times_s.len()]), None, Some(times_s.iter().map(playing).collect())],
            times_s,
        }
    }

    fn breaches(recorded: &Track, simulated: &Track) -> Vec<String> {
        compare(recorded, simulated).unwrap().breaches(&TOLERANCES)
    }

    #[test]
    fn the_same_motion_agrees_whenever_it_began() {
        let comparison = compare(&turning(1.0, 2.0, 5.0), &turning(0.25, 2.0, 6.0)).unwrap();
        assert!(comparison.breaches(&TOLERANCES).is_empty(), "{comparison:?}");
        assert!(comparison.joints[2].largest_rad < 1e-6, "{comparison:?}");
        assert_eq!((comparison.motions.len(), comparison.states.len()), (1, 2));
        assert!((comparison.length_s - 4.0).abs() < 0.01 && comparison.samples > 1990);
    }

    #[test]
    fn a_slower_arm_is_apart_meanwhile_and_its_motion_longer() {
        let recorded = turning(1.0, 2.0, 5.0);
        let comparison = compare(&recorded, &turning(1.0, 2.5, 6.0)).unwrap();
        let elbow = comparison.joints[2];
        assert!((elbow.largest_rad - 0.08).abs() < 1e-3 && (elbow.at_s - 2.0).abs() < 0.05, "{elbow:?}");
        let (Some(real), Some(ours)) = (comparison.motions[0].recorded, comparison.motions[0].simulated)
        else {
            panic!("{comparison:?}")
        };
        assert!((ours.lasts_s - real.lasts_s - 0.5).abs() < 0.01);
        let said = comparison.breaches(&TOLERANCES).join("\n");
        assert!(said.contains("joint 2: 0.0798 rad apart") && said.contains("is 0.500 s longer"), "{said}");
        assert!(said.contains("runtime_state: recorded 1"), "{said}");
        let wide = Tolerances { joint_rad: 0.1, time_s: 0.6 };
        assert!(comparison.breaches(&wide).is_empty());
    }

    #[test]
    fn a_motion_of_one_arm_alone_is_said() {
        let mut longer = turning(1.0, 2.0, 8.0);
        for (time, joints) in longer.times_s.iter().zip(&mut longer.joints) {
            joints[0] = ((time - 5.0) * 0.2).clamp(0.0, 0.1);
        }
        let said = breaches(&longer, &turning(1.0, 2.0, 8.0)).join("\n");
        assert!(said.contains("motion 2: recorded alone, at 3.9"), "{said}");
        let said = breaches(&turning(1.0, 2.0, 8.0), &longer).join("\n");
        assert!(said.contains("motion 2: simulated alone, at 3.9"), "{said}");
    }

    /// A real controller rests for a moment longer between two moves: that is one difference, not one of
    /// every position after it.
    #[test]
    fn a_longer_pause_is_said_once() {
        let twice = |pause_s: f64| {
            let mut track = turning(1.0, 1.0, 6.0);
            for (time, joints) in track.times_s.iter().zip(&mut track.joints) {
                joints[0] = ((time - 2.0 - pause_s) * 0.4).clamp(0.0, 0.4);
            }
            // Its program ends with the second motion.
            let playing = |time: &f64| if *time < 3.0 + pause_s { 2 } else { 1 };
            let states = [None, None, Some(track.times_s.iter().map(playing).collect())];
            Track { states, ..track }
        };
        let comparison = compare(&twice(0.05), &twice(0.35)).unwrap();
        assert!(comparison.joints[0].largest_rad < 0.01, "{comparison:?}");
        let said = comparison.breaches(&TOLERANCES);
        assert!(said.len() == 1 && said[0].contains("pause before it is 0.30"), "{said:?}");
        assert_eq!(breaches(&twice(0.05), &twice(0.09)), [""; 0], "within the tolerance");
    }

    #[test]
    fn what_comes_after_the_recording_s_end_is_not_judged() {
        let mut two = turning(1.0, 2.0, 8.0);
        for (time, joints) in two.times_s.iter().zip(&mut two.joints) {
            joints[0] = ((time - 5.0) * 0.2).clamp(0.0, 0.1);
        }
        let cut = |end_s: f64| {
            let mut track = two.clone();
            let samples = (end_s * 500.0) as usize;
            track.times_s.truncate(samples);
            track.joints.truncate(samples);
            for state in track.states.iter_mut().flatten() {
                state.truncate(samples);
            }
            track
        };
        assert_eq!(breaches(&cut(4.0), &two), [""; 0], "before the second motion");
        assert_eq!(breaches(&cut(5.3), &two), [""; 0], "in the middle of it");
        let said = breaches(&cut(6.5), &turning(1.0, 2.0, 8.0)).join("\n");
        assert!(said.contains("motion 2: recorded alone"), "{said}");
    }

    #[test]
    fn states_have_to_follow_each_other_at_the_same_time() {
        let recorded = turning(1.0, 2.0, 5.0);
        let mut stopped = recorded.clone();
        stopped.states[0] =
            Some(recorded.times_s.iter().map(|time| if *time < 4.0 { 7 } else { 3 }).collect());
        assert_eq!(breaches(&recorded, &stopped), ["robot_mode: simulated alone became 3 at 2.995 s"]);
        assert_eq!(breaches(&stopped, &recorded), ["robot_mode: recorded alone became 3 at 2.995 s"]);
        let mut other = recorded.clone();
        other.states[0] = Some(vec![5; recorded.times_s.len()]);
        assert!(breaches(&recorded, &other)[0].starts_with("robot_mode: recorded 7 at 0.000 s, simulated 5"));
        // The recording ends as the program does.
        let cut = turning(1.0, 2.0, 3.0);
        assert_eq!(breaches(&cut, &recorded), [""; 0]);
    }

    #[test]
    fn arms_that_rest_cannot_be_aligned() {
        let still = Track { joints: vec![[0.0; 6]; 2501], ..turning(1.0, 2.0, 5.0) };
        assert_eq!(compare(&still, &turning(1.0, 2.0, 5.0)), Err(CompareError::RecordedRests));
        assert_eq!(compare(&turning(1.0, 2.0, 5.0), &still), Err(CompareError::SimulatedRests));
    }
}
