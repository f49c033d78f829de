//! Every fault of the table in every phase of a pick-n-place in which it can occur.
//!
//! In: the rows of [`ROWS`] (numbers as in the reference's fault table) and the phases. Out: for each an
//! [`Outcome`]: how the job ended, what the operator read, whether the vacuum stayed, whether the cell
//! stayed armed, and whether work went on afterwards; and every breach of a rule. [`judge`] holds that
//! against the page of reactions. A case runs until the phase is there, brings the fault about, lets it
//! last, approves what requires it, then ends the fault, does at the pendant what a person would do, arms,
//! and hands in another job, which has to end in a named state.

use crate::pair::disk::Mood;
use crate::pair::outcome::{Outcome, Phase};
use crate::pair::page::{reaction, title};
use crate::pair::reactions::{Cause, ROWS, Row};
use crate::pair::rules::Rule;
use crate::pair::run::{arm_as_the_answer_says, bring_up, last_plan, release_what_hangs, true_poses};
use crate::pair::stage::Stage;
use crate::pair::work::job;
use crate::pair::{Adapter, Choice, Loss, Pair};
use cell_machine::code::Code;
use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_machine::orders::{Approval, Order};
use cell_machine::supervisor::gates::GateClosed;
use cell_machine::supervisor::input::PlanAnswer;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::status::{Doing, WorkStep};
use std::collections::BTreeMap;
use ur_sim::faults::read::read_posted;
use ur_sim::faults::{Fault, Order as FaultOrder, Phase as WorldPhase, RobotFault};
use ur_sim::world::lock;

/// Below this height over the table the tool is coming down onto an object, m.
const DESCENDS_BELOW_M: f64 = 0.05;

/// Simulated seconds for a phase to come, for a fault to show, for a job to end, for the job after it.
const PHASE_WITHIN_S: f64 = 60.0;
const SETTLED_AFTER_S: f64 = 8.0;
const END_WITHIN_S: f64 = 150.0;

/// A disk that is silent for this long ends celld.
const DISK_GIVEN_UP_S: f64 = 16.0;

/// Plans for which a job may request approval after a fault.
const APPROVALS: usize = 12;

/// Where the cell is.
fn phase_of(pair: &Pair) -> Option<Phase> {
    let status = pair.status()?;
    let core = pair.simulator().core();
    Some(match &status.doing {
        Doing::StartingRobot => Phase::BringUp,
        Doing::Looking(..) => Phase::Look,
        Doing::Planning => Phase::Plan,
        Doing::AwaitingApproval => Phase::Approve,
        Doing::Parking => Phase::Park,
        Doing::Working(WorkStep::Approaching, _) => {
            let low = lock(&core.world).glance().tool[2] < DESCENDS_BELOW_M;
            if low { Phase::Descend } else { Phase::Approach }
        }
        Doing::Working(WorkStep::Gripping, _) => Phase::Grip,
        Doing::Working(WorkStep::Carrying, _) => match core.injector.phase().1 {
            WorldPhase::Lift | WorldPhase::Grip => Phase::Lift,
            WorldPhase::Place => Phase::Place,
            WorldPhase::Approach | WorldPhase::Carry | WorldPhase::Retreat => Phase::Carry,
        },
        Doing::Working(WorkStep::Releasing, _) => Phase::Release,
        Doing::Working(WorkStep::Retreating, _) => Phase::Retreat,
        Doing::Idle
        | Doing::Stopping
        | Doing::Recovering(_)
        | Doing::Waiting(_)
        | Doing::Paused
        | Doing::Writing
        | Doing::Ready
        | Doing::Working(..)
        | Doing::Visiting(..)
        | Doing::Ending => return None,
    })
}

/// Turns a found plan into one that the checker must refuse.
struct BadPlans;

impl Adapter for BadPlans {
    fn event(&mut self, event: Event, events: &mut Vec<Event>) {
        events.push(match event {
            Event::Planned(number, answer) => Event::Planned(number, Box::new(spoilt(*answer))),
            other => other,
        });
    }

    fn effect(&mut self, effect: Effect, effects: &mut Vec<Effect>, _made_up: &mut Vec<Event>) {
        effects.push(effect);
    }

    fn frame(&mut self, _machine: &Machine, _effects: &mut Vec<Effect>, _made_up: &mut Vec<Event>) {}
}

fn spoilt(answer: PlanAnswer) -> PlanAnswer {
    match answer {
        PlanAnswer::Found { mut actions, cost, lower_bound, seconds } => {
            for action in &mut actions {
                action.to.x = 0.001;
            }
            PlanAnswer::Found { actions, cost, lower_bound, seconds }
        }
        other => other,
    }
}

/// Runs one case.
///
/// # Errors
/// The loop cannot be set up.
pub fn case(
    stage: &Stage,
    row: &Row,
    phase: Phase,
    seed: u64,
    keep: bool,
) -> Result<(Outcome, Pair), String> {
    let choice = Choice { keep_trace: keep, ..choice_for(row, seed) };
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    if matches!(row.cause, Cause::BadPlan) {
        pair.adapt(Box::new(BadPlans));
    }
    let mut outcome = Outcome::default();
    if let Some(why) = reach(&mut pair, stage, row, phase, seed) {
        outcome.impossible = Some(why);
        return Ok((outcome, pair));
    }
    let held = lock(&pair.simulator().core().world).glance().holds;
    let (said, ended) = (pair.notices().len(), pair.reports().len());
    bring_about(&mut pair, row);
    pair.run_until(SETTLED_AFTER_S, |_| false);
    for _ in 0..APPROVALS {
        let waits = row.seconds + END_WITHIN_S;
        pair.run_until(waits, |pair| settled(pair, ended) || phase_of(pair) == Some(Phase::Approve));
        if !approve(&mut pair) {
            break;
        }
    }
    outcome.armed = pair.status().is_some_and(|status| status.armed);
    outcome.kept = held.then(|| lock(&pair.simulator().core().world).glance().holds);
    outcome.daemon_ended = pair.ended().is_some();
    if let Some(report) = pair.reports().get(ended) {
        (outcome.end, outcome.code) = (Some(report.end), Some(report.code));
        outcome.hint.clone_from(&report.hint);
    }
    let mut alarms = pair.notices().iter().skip(said).filter(|notice| notice.alarm);
    outcome.sentence = alarms.next_back().map(|notice| notice.text.clone()).unwrap_or_default();
    if let Some(report) = pair.reports().get(ended).filter(|report| report.code != Code::Done) {
        outcome.sentence.clone_from(&report.message);
    }
    outcome.has_job = phase != Phase::Park;
    if outcome.code == Some(Code::Done) {
        outcome.kept = None;
    }
    arm_meanwhile(&mut pair, row);
    outcome.next = after(&mut pair, stage, seed);
    let mut breaches: Vec<Rule> = pair.breaches().iter().map(|breach| breach.rule).collect();
    breaches.sort_unstable();
    breaches.dedup();
    outcome.breaches = breaches;
    Ok((outcome, pair))
}

/// The loop's choices for a cause that is one of them.
fn choice_for(row: &Row, seed: u64) -> Choice {
    match row.cause {
        Cause::PlanWork(steps) => Choice { plan_work: steps, ..Choice::of(seed) },
        Cause::Faults(_)
        | Cause::Disk(_)
        | Cause::Lost(_)
        | Cause::AllPower
        | Cause::Garbage(_)
        | Cause::OverlappingGoals
        | Cause::BadPlan
        | Cause::Flipped
        | Cause::Ordered(_) => Choice::of(seed),
    }
}

/// A person arms while the fault lasts: refused where a gate is closed that no person can see past, as the
/// rules check.
fn arm_meanwhile(pair: &mut Pair, row: &Row) {
    if !matches!(row.cause, Cause::Faults(_)) || row.seconds == 0.0 {
        return;
    }
    bring_about(pair, row);
    pair.run_until(1.5, |_| false);
    pair.order(Order::Arm);
    pair.run_until(0.5, |_| false);
    pair.order(Order::Abort);
}

/// Approves the plan that waits; false where none does.
fn approve(pair: &mut Pair) -> bool {
    let Some(job) = pair.store().active().map(str::to_string) else { return false };
    if phase_of(pair) != Some(Phase::Approve) {
        return false;
    }
    let plan = last_plan(pair);
    pair.order(Order::Approve { id: job, plan });
    pair.run_until(2.0, |pair| phase_of(pair) != Some(Phase::Approve));
    true
}

/// The case is over when its job is, or when the daemon is, or when a person has to arm the cell.
pub(super) fn settled(pair: &Pair, ended: usize) -> bool {
    let doing = |wanted: Doing| pair.status().is_some_and(|status| status.doing == wanted);
    let idle = doing(Doing::Idle) && pair.store().active().is_none();
    let waits = doing(Doing::Waiting(GateClosed::Disarmed));
    pair.reports().len() > ended || pair.ended().is_some() || idle || waits
}

/// Until the phase is there; why it does not come.
fn reach(pair: &mut Pair, stage: &Stage, row: &Row, phase: Phase, seed: u64) -> Option<String> {
    if !bring_up(pair) {
        return Some("the cell does not come up".to_string());
    }
    pair.order(Order::Arm);
    if phase == Phase::Park {
        // A cell just switched on is parked: the arm has to be away first.
        let mut order = job(&stage.model, &true_poses(pair, &stage.model), seed, 0);
        order.approval = Approval::Always;
        pair.submit(order);
        pair.run_until(PHASE_WITHIN_S, |pair| phase_of(pair) == Some(Phase::Approve));
        pair.order(Order::Cancel(pair.store().active().unwrap_or_default().to_string()));
        pair.run_until(2.0, |pair| pair.store().active().is_none());
        pair.order(Order::Park);
    } else {
        let mut order = job(&stage.model, &true_poses(pair, &stage.model), seed, 0);
        if phase == Phase::Approve {
            order.approval = Approval::Always;
        }
        if matches!(row.cause, Cause::OverlappingGoals) {
            overlap(&mut order);
        }
        pair.submit(order);
    }
    let there = pair.run_until(PHASE_WITHIN_S, |pair| phase_of(pair) == Some(phase));
    if !there {
        return Some(format!("{} does not come", phase.name()));
    }
    // Into the phase, not onto its border.
    let middle = 0.04 + 0.06 * (seed % 5) as f64;
    match phase {
        Phase::Plan | Phase::Grip | Phase::Release | Phase::Retreat => {}
        Phase::BringUp
        | Phase::Look
        | Phase::Approve
        | Phase::Approach
        | Phase::Descend
        | Phase::Lift
        | Phase::Carry
        | Phase::Place
        | Phase::Park => {
            pair.run_until(middle, |pair| phase_of(pair) != Some(phase));
        }
    }
    None
}

fn overlap(order: &mut JobOrder) {
    if let [first, .., last] = order.goals.as_mut_slice() {
        last.1 = first.1;
        last.1.x += 0.01;
    }
}

pub(super) fn bring_about(pair: &mut Pair, row: &Row) {
    match row.cause {
        Cause::Faults(texts) => {
            for text in texts {
                let planned = read_posted(text).map(|mut plans| plans.remove(0));
                if let Ok(mut planned) = planned {
                    planned.order.seconds = planned.order.seconds.or(Some(row.seconds).filter(|s| *s > 0.0));
                    // What is impossible now (a second stop, say) is no fault.
                    let _ = pair.fault(planned);
                }
            }
        }
        Cause::Disk(mood) => pair.disk().mood = mood,
        Cause::Lost(loss) => lose(pair, loss),
        Cause::AllPower => {
            reboot(pair);
            lose(pair, Loss::PowerCut);
        }
        Cause::Garbage(link) => pair.garble(link),
        Cause::Flipped => pair.camera_view().flip(true),
        Cause::Ordered(order) => {
            pair.order(order());
        }
        Cause::PlanWork(_) | Cause::OverlappingGoals | Cause::BadPlan => {}
    }
}

fn reboot(pair: &mut Pair) {
    let fault = Fault::Robot(RobotFault::Reboot { serial: None, kinematics: None });
    let _ = pair.fault_now(FaultOrder { name: "ur.reboot", fault, seconds: Some(5.0) });
    let both = Fault::Vacuum(ur_sim::faults::VacuumFault::Drop(None));
    let _ = pair.fault_now(FaultOrder { name: "vacuum.drop", fault: both, seconds: Some(2.0) });
}

fn lose(pair: &mut Pair, loss: Loss) {
    // The program was a template before, so it is one now.
    let _ = pair.restart(loss);
}

/// The fault is over; a person clears what has to be cleared at the pendant, releases what is held, arms,
/// and hands in another job. Its code.
pub(super) fn after(pair: &mut Pair, stage: &Stage, seed: u64) -> Option<Code> {
    let swallows = pair.disk().swallows();
    pair.disk().mood = Mood::Fine;
    pair.camera_view().flip(false);
    let clear = Fault::Clear { fault: None };
    let _ = pair.fault_now(FaultOrder { name: "clear", fault: clear, seconds: None });
    if swallows {
        // An entry that it has swallowed still ends celld.
        pair.run_until(DISK_GIVEN_UP_S, |pair| pair.ended().is_some());
    }
    if pair.ended().is_some() {
        lose(pair, Loss::Killed);
    }
    pair.run_until(8.0, |_| false);
    at_the_pendant(pair);
    bring_up(pair);
    pair.run_until(4.0, |_| false);
    if let Some(active) = pair.store().active().map(str::to_string) {
        pair.order(Order::Cancel(active));
        pair.run_until(2.0, |_| false);
    }
    pair.order(Order::Abort);
    pair.run_until(4.0, |_| false);
    release_what_hangs(pair);
    let patient = stage.weather.has_gaps();
    arm_as_the_answer_says(pair, patient);
    pair.order(Order::Resume);
    let ended = pair.reports().len();
    // One object is enough to see that work goes on.
    let mut order = job(&stage.model, &true_poses(pair, &stage.model), seed, 1);
    order.goals.truncate(1);
    pair.submit(order);
    let over = |pair: &mut Pair| pair.run_until(END_WITHIN_S, |pair| pair.reports().len() > ended);
    let waits = |pair: &mut Pair| pair.status().is_some_and(|status| !status.armed);
    if !over(pair) && patient && waits(pair) {
        arm_as_the_answer_says(pair, patient);
        over(pair);
    }
    pair.reports().get(ended).map(|report| report.code)
}

/// What a person does at the pendant after a stop.
fn at_the_pendant(pair: &mut Pair) {
    let mut controller = pair.simulator().core().robot.controller();
    // Refused where there is nothing to unlock.
    let _ = controller.unlock_protective_stop();
    if !controller.core.modes.motion_allowed() {
        controller.restart_safety();
    }
}

/// What breaks a promise in an outcome whatever the row, and differs from the page where there is one for
/// this seed.
pub fn judge(
    row: &Row,
    phase: Phase,
    outcome: &Outcome,
    page: Option<&BTreeMap<String, String>>,
) -> Vec<String> {
    if let Some(why) = &outcome.impossible {
        return vec![why.clone()];
    }
    let mut faults = Vec::new();
    faults.extend(outcome.breaches.iter().map(|breach| format!("{breach:?} was broken")));
    if outcome.code.is_some_and(|code| code != Code::Done) && outcome.hint.is_empty() {
        faults.push("the report has no hint".to_string());
    }
    let refused = outcome.hint.contains("`celld arm`") && !outcome.hint.contains("celld release");
    if outcome.kept == Some(true) && refused {
        faults.push("the hint names `celld arm`, which is refused while something is held".to_string());
    }
    if outcome.next.is_none() && !row.ends_work {
        faults.push("the job after it never ended".to_string());
    }
    if let Some(page) = page {
        let (found, wanted) = (reaction(outcome), page.get(&title(row, phase)));
        if wanted != Some(&found) {
            let wanted = wanted.map_or("nothing", String::as_str);
            faults.push(format!("found    {found}\n    expected {wanted}"));
        }
    }
    faults
}

/// All cases: rows with the phases in which they can occur.
pub fn cases() -> impl Iterator<Item = (&'static Row, Phase)> {
    ROWS.iter().flat_map(|row| row.phases.iter().map(move |phase| (row, *phase)))
}
