//! Power cuts after every single effect of a job (rows 36 and 38 of the fault table).
//!
//! In: a seed, the number of an effect. Out: how many effects a job has ([`moments`]), and what became of
//! the job whose daemon was gone right after one of them, and of the job after it ([`cut`]). Controller,
//! gripper and table go on meanwhile, what was not acknowledged by the disk may or may not be there, and the
//! daemon is started anew. Nothing may move before a person arms, and the job ends once. Signs of life and
//! readings are no moments: between two of them nothing differs.

use crate::pair::run::{bring_up, true_poses};
use crate::pair::stage::Stage;
use crate::pair::storm::{Aftermath, aftermath};
use crate::pair::work::approved_job;
use crate::pair::{Adapter, Choice, Loss, Pair};
use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event};
use cell_machine::orders::Order;
use std::cell::Cell;
use std::rc::Rc;

/// A job has ended within this time, s.
const JOB_WITHIN_S: f64 = 600.0;

/// What the adapter does with effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counting {
    /// They pass, and are not counted.
    Off,
    /// They pass; so many were counted.
    On(usize),
    /// The process is gone: nothing passes.
    Gone,
}

/// Counts effects, and ends the process after one of them.
struct Counter {
    counting: Rc<Cell<Counting>>,
    /// The last one that passes.
    last: Option<usize>,
}

impl Adapter for Counter {
    fn effect(&mut self, effect: Effect, effects: &mut Vec<Effect>, _made_up: &mut Vec<Event>) {
        match self.counting.get() {
            // What is only said goes nowhere, and the rules compare it with the machine.
            Counting::Gone if matches!(effect, Effect::Notify(_)) => {}
            Counting::Gone => return,
            Counting::On(count) if is_moment(&effect) => {
                let gone = self.last == Some(count);
                self.counting.set(if gone { Counting::Gone } else { Counting::On(count + 1) });
            }
            Counting::On(_) | Counting::Off => {}
        }
        effects.push(effect);
    }
}

/// Effects after which something differs.
fn is_moment(effect: &Effect) -> bool {
    match effect {
        // Data packages of the first and the last input recipe: signs of life.
        Effect::Send(Link::Rtde, bytes) => !matches!(bytes.get(2..4), Some([b'U', 1 | 3])),
        Effect::Registers(request) => !matches!(request, ModbusRequest::Read { .. }),
        _ => true,
    }
}

/// How many moments a job of this seed has, undisturbed.
///
/// # Errors
/// The loop cannot be set up, or the job does not end.
pub fn moments(stage: &Stage, seed: u64) -> Result<usize, String> {
    let (mut pair, counting) = begun(stage, seed, None, false)?;
    if !pair.run_until(JOB_WITHIN_S, |pair| !pair.reports().is_empty()) {
        return Err(format!("the job of seed {seed} does not end"));
    }
    match counting.get() {
        Counting::On(count) => Ok(count),
        Counting::Off | Counting::Gone => Err("nothing was counted".to_string()),
    }
}

/// A job whose daemon is gone right after this moment, and the job after it.
///
/// # Errors
/// The loop cannot be set up.
pub fn cut(stage: &Stage, seed: u64, moment: usize, keep: bool) -> Result<(Aftermath, Pair), String> {
    let (mut pair, counting) = begun(stage, seed, Some(moment), keep)?;
    if !pair.run_until(JOB_WITHIN_S, |_| counting.get() == Counting::Gone) {
        return Err(format!("the job of seed {seed} has no effect {moment}"));
    }
    counting.set(Counting::Off);
    pair.restart(Loss::PowerCut).map_err(|error| error.to_string())?;
    let known = pair.store().active().is_some() || pair.store().waiting() > 0 || !pair.reports().is_empty();
    let armed_again = pair.run_until(5.0, |pair| pair.status().is_some_and(|status| status.armed));
    let mut found = aftermath(&mut pair, stage, seed, true);
    if !known {
        found.faults.push("the job is lost".to_string());
    }
    if armed_again {
        found.faults.push("the cell is armed after a restart, and no person armed it".to_string());
    }
    let id = pair.reports().first().map(|report| report.id.clone());
    let ends = pair.reports().iter().filter(|report| Some(&report.id) == id.as_ref()).count();
    if ends > 1 {
        found.faults.push(format!("the job has ended {ends} times"));
    }
    Ok((found, pair))
}

/// An armed cell that is given a job.
fn begun(
    stage: &Stage,
    seed: u64,
    last: Option<usize>,
    keep: bool,
) -> Result<(Pair, Rc<Cell<Counting>>), String> {
    let choice = Choice { keep_trace: keep, ..Choice::of(seed) };
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    let counting = Rc::new(Cell::new(Counting::Off));
    pair.adapt(Box::new(Counter { counting: Rc::clone(&counting), last }));
    if !bring_up(&mut pair) {
        return Err("the cell does not come up".to_string());
    }
    counting.set(Counting::On(0));
    pair.order(Order::Arm);
    pair.approve_plans();
    pair.submit(approved_job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    Ok((pair, counting))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair::camera_view::SightKind;
    use crate::pair::table::stage;

    #[test]
    fn signs_of_life_and_readings_are_no_moments_and_everything_else_is() {
        let rtde = |bytes: &[u8]| is_moment(&Effect::Send(Link::Rtde, bytes.to_vec()));
        assert!(!rtde(&[0, 8, b'U', 1, 0, 0, 0, 7]) && rtde(&[0, 8, b'U', 2]) && rtde(&[0, 3, b'S']));
        assert!(!is_moment(&Effect::Registers(ModbusRequest::Read { address: 0, count: 1 })));
        assert!(is_moment(&Effect::Registers(ModbusRequest::Write { address: 0, values: vec![1] })));
        assert!(is_moment(&Effect::WantJob));
    }

    #[test]
    fn a_power_cut_at_a_few_moments_of_a_job_loses_and_repeats_nothing() {
        const SEED: u64 = 4;
        let stage = stage(SEED, SightKind::Corners).unwrap();
        let all = moments(&stage, SEED).unwrap();
        assert!(all > 40, "{all} moments");
        for moment in (0..all).step_by(all / 5) {
            let (found, pair) = cut(&stage, SEED, moment, false).unwrap();
            assert_eq!(
                found.faults,
                Vec::<String>::new(),
                "after moment {moment}: {:?}",
                pair.notices().last()
            );
        }
    }
}
