//! Whole runs of the closed loop: jobs one after the other, with the operator that they need.
//!
//! In: a stage, a choice, how many jobs, faults. Out: a [`Summary`]. The operator here does what the
//! daemon's sentences request: arms, clears stops at the pendant once faults have ended, arms again; a
//! caller that needs another operator drives [`Pair`] directly.

use crate::pair::rules::Breach;
use crate::pair::stage::Stage;
use crate::pair::work::job;
use crate::pair::{Choice, Pair, PairError};
use cell_machine::code::JobStatus;
use cell_machine::device::gripper_types::Channels;
use cell_machine::orders::Order;
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::model::CellModel;
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeMap;
use ur_sim::faults::Planned;
use ur_sim::world::lock;

/// Number of the plan that was made last.
pub(super) fn last_plan(pair: &Pair) -> u64 {
    pair.machine().supervisor().map_or(0, Supervisor::last_plan)
}

/// Simulated seconds after which a job that has not ended is a fault of celld.
const JOB_WITHIN_S: f64 = 600.0;

/// How often a patient person looks, within that time, whether the cell is still armed.
const PATIENT_TRIES: u32 = 20;

/// Simulated seconds for the cell to come up.
const UP_WITHIN_S: f64 = 60.0;

/// What a run came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Jobs that have ended.
    pub jobs: usize,
    /// Pick-n-places carried out.
    pub moves: usize,
    /// Simulated seconds in which a job was under way.
    pub busy_s: f64,
    /// How the jobs ended, by code.
    pub ends: BTreeMap<String, usize>,
    /// Breaches of the rules.
    pub breaches: Vec<Breach>,
    /// What never ended, in words.
    pub stuck: Vec<String>,
    /// Of the trace.
    pub fingerprint: u64,
}

impl Summary {
    /// True when no rule was broken and every job ended.
    pub fn is_clean(&self) -> bool {
        self.breaches.is_empty() && self.stuck.is_empty()
    }
}

/// Where the objects truly are, of those that lie on the table.
pub fn true_poses(pair: &Pair, model: &CellModel) -> Vec<(String, Pose2)> {
    let world = lock(&pair.simulator().core().world);
    let known = world.objects().iter().filter(|body| !body.is_fallen() && model.object(&body.id).is_some());
    known.map(|body| (body.id.clone(), body.pose())).collect()
}

/// Brings a cell up: links, identity, commission. False when it does not come.
pub fn bring_up(pair: &mut Pair) -> bool {
    pair.run_until(UP_WITHIN_S, |pair| pair.status().is_some())
}

/// A person who sees something in the gripper takes it out.
pub(super) fn release_what_hangs(pair: &mut Pair) {
    if lock(&pair.simulator().core().world).glance().gripping {
        pair.order(Order::Release(Channels::Both));
        pair.run_until(4.0, |_| false);
    }
}

/// A person arms; where the answer says that something may hang on the cups, the person looks, says that it
/// does not, and arms again. A `patient` person, whose link may be silent, does so after any refusal.
pub(super) fn arm_as_the_answer_says(pair: &mut Pair, patient: bool) {
    pair.take_replies();
    let number = pair.order(Order::Arm);
    pair.run_until(0.5, |_| false);
    let refused = pair.take_replies().into_iter().find(|(of, reply)| *of == number && !reply.accepted);
    let Some((_, reply)) = refused else { return };
    let hangs = reply.message.contains("celld release --yes");
    if hangs {
        pair.order(Order::Release(Channels::Both));
        pair.run_until(4.0, |_| false);
    }
    if hangs || patient {
        pair.order(Order::Arm);
    }
}

/// Carries out `jobs` jobs, with faults planned from the beginning; `progress` is called after each.
///
/// # Errors
/// The loop cannot be set up.
pub fn run_jobs(
    stage: &Stage,
    choice: Choice,
    jobs: usize,
    faults: &[Planned],
    progress: &mut dyn FnMut(usize),
) -> Result<(Summary, Pair), PairError> {
    let mut pair = Pair::new(stage.clone(), choice)?;
    let mut summary = Summary::default();
    for fault in faults {
        if let Err(error) = pair.fault(fault.clone()) {
            summary.stuck.push(format!("the fault {} is impossible: {error}", fault.order.name));
        }
    }
    if !bring_up(&mut pair) {
        summary.stuck.push("the cell did not come up".to_string());
    }
    for number in 0..jobs {
        if !summary.stuck.is_empty() {
            break;
        }
        one_job(&mut pair, stage, choice.seed, number, &mut summary);
        progress(number + 1);
    }
    summary.breaches = pair.breaches().to_vec();
    summary.fingerprint = pair.trace.fingerprint();
    Ok((summary, pair))
}

fn one_job(pair: &mut Pair, stage: &Stage, seed: u64, number: usize, summary: &mut Summary) {
    if !pair.status().is_some_and(|status| status.armed) {
        pair.order(Order::Arm);
    }
    let order = job(&stage.model, &true_poses(pair, &stage.model), seed, number);
    let (id, began, ended) = (order.id.clone(), pair.seconds(), pair.reports().len());
    pair.submit(order);
    // A link that may be silent can refuse or end an arming: then the person arms again.
    let tries = if stage.weather.has_gaps() { PATIENT_TRIES } else { 1 };
    let over = (0..tries).any(|_| {
        let over = pair.run_until(JOB_WITHIN_S / f64::from(tries), |pair| pair.reports().len() > ended);
        if !over && tries > 1 && !pair.status().is_some_and(|status| status.armed) {
            release_what_hangs(pair);
            arm_as_the_answer_says(pair, true);
        }
        over
    });
    if !over {
        let doing = pair.status().map(|status| status.text()).unwrap_or_default();
        summary.stuck.push(format!("{id} has not ended in {JOB_WITHIN_S} s: {doing}"));
        return;
    }
    summary.busy_s += pair.seconds() - began;
    if let Some(report) = pair.reports().last() {
        summary.jobs += 1;
        summary.moves += report.moves;
        *summary.ends.entry(report.code.to_string()).or_default() += 1;
        if report.end != JobStatus::Done {
            // The reader of the report looks at the cell before the next job.
            pair.run_until(5.0, |_| false);
        }
    }
}
