//! Every order of the operator in every state of the cell and its links: the answer equals what happens.
//!
//! In: nothing. Out: for each pair of [`STATES`] and [`ORDERS`] a [`Found`]: the answer, and what the arm,
//! its power, the vacuum, arming and the jobs truly did afterwards. [`judge`] holds the two against each
//! other, with a rule for each order: a refusal changes nothing, "now" means that something moves, "nothing
//! moves" that nothing does, "stopped" that the arm rests. `docs/orders.md` is written from it
//! (`pair::orders_page`).

use crate::pair::run::{bring_up, last_plan, true_poses};
use crate::pair::stage::Stage;
use crate::pair::work::job;
use crate::pair::{Choice, Pair};
use cell_machine::code::Code;
use cell_machine::device::gripper_types::Channels;
use cell_machine::orders::{Approval, Order, Reply, WayBack};
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::round::RoundOrder;
use cell_machine::supervisor::status::Doing;
use cell_values::units::Joints;
use ur_sim::faults::read::read_posted;
use ur_sim::world::lock;

/// Seed of the page.
pub const ORDERS_SEED: u64 = 0;

/// Attempts where a link may be silent: to reach a state that every undisturbed job passes through, and to
/// see what an order does.
const TRIES: usize = 3;

/// A state of the cell, and how it is reached; false where it is not.
#[derive(Clone, Copy)]
pub struct State {
    /// In a few words.
    pub name: &'static str,
    reach: fn(&mut Pair, &Stage) -> bool,
}

/// An order, by its command; the job is the active one.
#[derive(Clone, Copy)]
pub struct Given {
    /// As typed.
    pub command: &'static str,
    /// Of the active job and the plan that was made last.
    order: fn(String, u64) -> Order,
}

/// Every order.
pub static ORDERS: &[Given] = &[
    Given { command: "arm", order: |_, _| Order::Arm },
    Given { command: "disarm", order: |_, _| Order::Disarm },
    Given { command: "approve", order: |id, plan| Order::Approve { id, plan } },
    Given { command: "reject", order: |id, _| Order::Reject(id) },
    Given { command: "cancel", order: |id, _| Order::Cancel(id) },
    Given { command: "pause", order: |_, _| Order::Pause },
    Given { command: "resume", order: |_, _| Order::Resume },
    Given { command: "step", order: |_, _| Order::Step },
    Given { command: "park", order: |_, _| Order::Park },
    Given { command: "abort", order: |_, _| Order::Abort },
    Given { command: "release --yes", order: |_, _| Order::Release(Channels::Both) },
    Given { command: "confirm-gripper", order: |_, _| Order::ConfirmGripper },
    Given { command: "calibrate (at the page)", order: |_, _| Order::Calibrate },
    Given { command: "recover", order: |_, _| Order::Recover(WayBack::Show) },
    Given { command: "recover --place", order: |_, _| Order::Recover(WayBack::Place) },
    Given { command: "recover --hold", order: |_, _| Order::Recover(WayBack::Hold) },
    Given { command: "recover --release", order: |_, _| Order::Recover(WayBack::Release) },
    Given { command: "recover --retreat", order: |_, _| Order::Recover(WayBack::Retreat) },
];

/// Every state: what the cell does, what of it is missing, what keeps it.
pub static STATES: &[State] = &[
    State { name: "off, disarmed", reach: |_, _| true },
    State { name: "ready, disarmed", reach: |pair, _| armed(pair) && disarmed(pair) },
    State {
        name: "ready, disarmed, a job waits",
        reach: |pair, stage| submitted(pair, stage) && rests(pair),
    },
    State { name: "ready, armed", reach: |pair, _| armed(pair) },
    State { name: "starting the robot", reach: |pair, stage| works(pair, stage, "starting the robot") },
    State { name: "looking", reach: |pair, stage| works(pair, stage, "looking") },
    State { name: "planning", reach: |pair, stage| works(pair, stage, "planning") },
    State { name: "waiting for approval", reach: |pair, stage| requests(pair, stage) },
    State {
        name: "waiting for approval, disarmed",
        reach: |pair, stage| requests(pair, stage) && disarmed(pair),
    },
    State { name: "set out for the next object, the picture being searched", reach: sets_out },
    State { name: "approaching", reach: |pair, stage| works(pair, stage, "approaching") },
    State { name: "carrying", reach: |pair, stage| works(pair, stage, "carrying") },
    State { name: "retreating", reach: |pair, stage| works(pair, stage, "retreating") },
    State { name: "paused, a job under way", reach: paused },
    State { name: "paused after the last pick-n-place", reach: paused_after_the_last },
    State { name: "parking", reach: parks },
    State { name: "on a calibration round", reach: rounds },
    State {
        name: "carrying, the program paused by another client",
        reach: |pair, stage| with(pair, stage, "ur.pause", 60),
    },
    State { name: "carrying, speed slider at zero", reach: slider },
    State { name: "stopping", reach: stopping },
    State { name: "stopped while carrying", reach: |pair, stage| stopped(pair, stage) },
    State { name: "protective stop while carrying", reach: |pair, stage| with(pair, stage, "ur.pstop", 0) },
    State { name: "emergency stop pressed", reach: |pair, _| faulty(pair, "ur.estop") },
    State { name: "safeguard open", reach: |pair, _| faulty(pair, "ur.safeguard") },
    State { name: "local control", reach: |pair, _| faulty(pair, "ur.local") },
    State { name: "freedrive button held", reach: |pair, _| faulty(pair, "ur.freedrive") },
    State { name: "controller off", reach: |pair, _| faulty(pair, "ur.reboot") },
    State { name: "controller silent", reach: |pair, _| silent(pair, "rtde") },
    State { name: "gripper silent", reach: |pair, _| silent(pair, "gripper") },
    State { name: "another robot answers", reach: |pair, _| other_robot(pair) },
    State { name: "on a way back, unlocking", reach: unlocking },
    State { name: "on a way back, looking", reach: way_back },
];

/// What came of an order.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// The state did not come.
    pub impossible: bool,
    /// The answer.
    pub reply: Option<Reply>,
    /// The cell was armed when the order was given, and is after the answer.
    pub armed: (bool, bool),
    /// Why the status said an order to arm would be refused, when the order was given.
    pub arm_refused: Option<String>,
    /// Of the plan nothing was left but the last look.
    pub last_look_left: bool,
    /// A pause was in force after the answer.
    pub paused: bool,
    /// And is at the end of what was watched.
    pub stays_paused: bool,
    /// The arm was at rest when the order was given, and nothing ordered before was about to move it.
    pub rested: bool,
    /// The arm moved after the answer.
    pub moves: bool,
    /// And is at rest at the end.
    pub rests: bool,
    /// It was at the park pose.
    pub parked: bool,
    /// Power or brakes changed after the answer.
    pub powers: bool,
    /// Something was held when the order was given, and is at the end.
    pub held: (bool, bool),
    /// How a job ended after the order, if one did.
    pub ended: Option<String>,
    /// After the answer the controller was silent, and the cell stopped for it.
    pub cut_off: bool,
    /// Rules that were broken.
    pub breaches: Vec<String>,
}

/// Simulated seconds for an answer, and after it.
const ANSWER_WITHIN_S: f64 = 12.0;
const AFTER_S: f64 = 30.0;

/// The arm counts as having moved beyond this joint angle, rad.
const MOVED_RAD: f64 = 2e-3;

/// Runs one case. If an accepted order moved less than it should because the controller was silent, the case
/// is run again with other delays; an order that stops or lets go gets no second run.
///
/// # Errors
/// The loop cannot be set up.
pub fn case(stage: &Stage, state: &State, given: &Given) -> Result<Found, String> {
    let mut found = attempt(stage, state, given, ORDERS_SEED)?;
    let moves = !(given.order)(String::new(), 0).ends_leave();
    for again in 1..tries(stage) {
        let accepted = moves && found.reply.as_ref().is_some_and(|reply| reply.accepted);
        let cut_off = accepted && found.cut_off && found.breaches.is_empty();
        if !cut_off || judge(given, &found).is_empty() {
            break;
        }
        let other = attempt(stage, state, given, ORDERS_SEED + again as u64)?;
        found = if other.impossible { found } else { other };
    }
    Ok(found)
}

/// Only a network with gaps makes a link silent by itself.
fn tries(stage: &Stage) -> usize {
    if stage.weather.has_gaps() { TRIES } else { 1 }
}

/// One run of a case with the delays of a seed.
fn attempt(stage: &Stage, state: &State, given: &Given, seed: u64) -> Result<Found, String> {
    let mut pair = Pair::new(stage.clone(), Choice::of(seed)).map_err(|error| error.to_string())?;
    if !bring_up(&mut pair) || !(state.reach)(&mut pair, stage) {
        return Ok(Found { impossible: true, ..Found::default() });
    }
    let mut found = Found {
        armed: (is_armed(&pair), false),
        rested: stands(&pair) && !recovers(&pair),
        held: (holds(&pair), false),
        ..Found::default()
    };
    found.last_look_left = pair.status().is_some_and(|status| {
        status.doing == Doing::Paused && status.moves > 0 && status.remaining_moves == 0
    });
    found.arm_refused = pair.status().and_then(|status| status.arm_refused.clone());
    let was_silent = stopped_by_silence(&pair);
    let ended = pair.reports().len();
    let active = pair.store().active().unwrap_or("none").to_string();
    pair.take_replies();
    let plan = last_plan(&pair);
    let number = pair.order((given.order)(active, plan));
    let mut reply = None;
    let end = pair.seconds() + ANSWER_WITHIN_S;
    while reply.is_none() && pair.seconds() < end {
        pair.run_until(0.002, |_| false);
        reply = pair.take_replies().into_iter().find(|(of, _)| *of == number).map(|(_, reply)| reply);
    }
    found.reply = reply;
    found.armed.1 = is_armed(&pair);
    found.paused = pair.status().is_some_and(|status| status.paused);
    watch(&mut pair, &mut found);
    found.stays_paused = pair.status().is_some_and(|status| status.paused);
    found.held.1 = holds(&pair);
    found.ended = pair.reports().get(ended).map(|report| report.code.to_string());
    found.cut_off = !was_silent && stopped_by_silence(&pair);
    found.breaches = pair.breaches().iter().map(|breach| format!("{:?}", breach.rule)).collect();
    found.breaches.dedup();
    Ok(found)
}

fn stopped_by_silence(pair: &Pair) -> bool {
    let stopped = pair.status().and_then(|status| status.stopped.as_ref());
    stopped.is_some_and(|note| note.code == Code::LinkSilent)
}

/// What arm and power do after the answer.
fn watch(pair: &mut Pair, found: &mut Found) {
    let (from, mode, park) = (joints(pair), robot_mode(pair), pair.stage.model.park);
    pair.run_until(AFTER_S, |pair| {
        found.moves |= joints(pair).max_difference(&from) > MOVED_RAD;
        found.powers |= robot_mode(pair) != mode;
        // Full turns are left as they are (`Supervisor::transfer_to`).
        let (at, arm) = (joints(pair), &pair.stage.model.arm);
        found.parked |= arm.unwound(&park, &at).is_some_and(|park| at.max_difference(&park) < MOVED_RAD);
        false
    });
    let at = joints(pair);
    pair.run_until(0.5, |_| false);
    found.rests = joints(pair).max_difference(&at) < MOVED_RAD;
}

/// Where the answer is not what happens.
pub fn judge(given: &Given, found: &Found) -> Vec<String> {
    let mut faults: Vec<String> = found.breaches.iter().map(|rule| format!("{rule} was broken")).collect();
    let Some(reply) = &found.reply else {
        faults.push(if found.impossible { "the state did not come" } else { "no answer" }.to_string());
        return faults;
    };
    let mut must = |holds: bool, what: &str| {
        if !holds {
            faults.push(format!("{what}: {:?}", reply.message));
        }
    };
    let says = |word: &str| reply.message.contains(word);
    if given.command == "arm" {
        let foretold = found.arm_refused.as_ref().is_none_or(|said| *said == reply.message);
        must(foretold && found.arm_refused.is_none() == reply.accepted, "the status says otherwise");
    }
    if !reply.accepted {
        must(found.armed.1 <= found.armed.0, "refused, and armed all the same");
        must(found.armed.0 || !found.rested || !found.moves, "refused, and the arm sets off");
        must(reply.message.len() > 12, "refused without a word why");
        return faults;
    }
    must(!says("nothing moves") || !found.moves, "nothing moves, it says, and the arm does");
    must(!reply.message.starts_with("stopped") || !found.moves, "stopped, it says, and the arm moves");
    must(reply.message != "disarmed" || !found.moves, "disarmed, it says, and the arm moves");
    match given.command {
        "arm" => {
            must(found.armed.1, "armed, it says");
            let acts = found.moves || found.powers;
            must(!says(" now") || acts, "something moves now, it says");
        }
        "approve" => must(!says(" now") || found.moves, "the arm moves now, it says"),
        "disarm" => {
            must(!found.armed.1 && found.rests, "a disarmed cell comes to rest");
            must(!says("finished first") || found.moves, "the move is finished first, it says");
        }
        "abort" => must(!found.armed.1 && !found.moves, "an abort ends all motion"),
        "release --yes" | "recover --release" => {
            must(!found.armed.1 && !found.moves && !found.held.1, "a release lets go and nothing moves");
        }
        "pause" => must(found.paused && found.rests, "a pause brings the arm to rest"),
        "resume" => must(!found.paused, "no pause is left"),
        "step" => {
            must(found.armed.1, "a step is of an armed cell");
            let last = found.last_look_left;
            must(says("a last look") == last && (!last || found.stays_paused), "a last look, then a pause");
        }
        "park" => {
            must(found.parked || says("approved") || says("held now") || says("already"), "the arm is parked")
        }
        "reject" => must(found.ended.as_deref() == Some("plan_rejected"), "the job has ended"),
        "cancel" => must(found.ended.is_some(), "the job ends"),
        "calibrate (at the page)" => must(found.moves || says("already"), "the arm goes round"),
        "recover --place" => must(!found.held.1 && found.rests, "what was held is put down"),
        "recover --hold" => must(!found.moves && found.held.0 == found.held.1, "the vacuum does not change"),
        "recover --retreat" => must(found.rests && found.held.0 == found.held.1, "the arm goes up and rests"),
        _ => must(!found.moves || !found.rested || found.armed.0, "showing moves nothing"),
    }
    faults
}

/// Every case.
pub fn cases() -> impl Iterator<Item = (&'static State, &'static Given)> {
    STATES.iter().flat_map(|state| ORDERS.iter().map(move |given| (state, given)))
}

fn joints(pair: &Pair) -> Joints {
    pair.simulator().core().robot.controller().core.mover.q()
}

fn robot_mode(pair: &Pair) -> ur_wire::enumerations::RobotMode {
    pair.simulator().core().robot.controller().core.modes.robot_mode()
}

fn stands(pair: &Pair) -> bool {
    pair.simulator().core().robot.controller().core.mover.stands()
}

/// A way back is under way.
fn recovers(pair: &Pair) -> bool {
    pair.status().is_some_and(|status| matches!(status.doing, Doing::Recovering(_)))
}

fn holds(pair: &Pair) -> bool {
    lock(&pair.simulator().core().world).glance().holds
}

fn is_armed(pair: &Pair) -> bool {
    pair.status().is_some_and(|status| status.armed)
}

fn rests(pair: &mut Pair) -> bool {
    pair.run_until(0.5, |_| false);
    true
}

fn shows(pair: &mut Pair, words: &str) -> bool {
    pair.run_until(90.0, |pair| pair.status().is_some_and(|status| status.text().starts_with(words)))
}

/// Powered, with its program, no job.
fn armed(pair: &mut Pair) -> bool {
    pair.order(Order::Arm);
    pair.run_until(20.0, |pair| {
        let idle = pair.status().is_some_and(|status| status.doing == Doing::Idle);
        idle && pair.simulator().core().robot.controller().programs.playing()
    }) && rests(pair)
}

fn disarmed(pair: &mut Pair) -> bool {
    pair.order(Order::Disarm);
    rests(pair)
}

fn submit(pair: &mut Pair, stage: &Stage, approval: Approval) {
    let mut order = job(&stage.model, &true_poses(pair, &stage.model), ORDERS_SEED, 0);
    order.approval = approval;
    pair.submit(order);
}

fn submitted(pair: &mut Pair, stage: &Stage) -> bool {
    let ready = armed(pair) && disarmed(pair);
    submit(pair, stage, Approval::Never);
    ready
}

/// A job under way, the arm on its way to an object before a look has shown it. If a silent link ended the
/// last job, the person arms again.
fn sets_out(pair: &mut Pair, stage: &Stage) -> bool {
    (0..tries(stage)).any(|number| {
        armed(pair);
        let mut order = job(&stage.model, &true_poses(pair, &stage.model), ORDERS_SEED, number);
        order.approval = Approval::Never;
        pair.submit(order);
        pair.run_until(120.0, |pair| {
            // celld knows of the motion too.
            let moves = pair.machine().robot_state().is_some_and(|robot| !robot.stands_still());
            moves && pair.machine().supervisor().is_some_and(Supervisor::has_set_out)
        })
    })
}

/// A job under way, as far as these words of the status.
fn works(pair: &mut Pair, stage: &Stage, words: &str) -> bool {
    submit(pair, stage, Approval::Never);
    pair.order(Order::Arm);
    let there = shows(pair, words);
    if there && !matches!(words, "planning" | "retreating") {
        let words = words.to_string();
        pair.run_until(0.2, |pair| !pair.status().is_some_and(|now| now.text().starts_with(&words)));
    }
    there
}

fn requests(pair: &mut Pair, stage: &Stage) -> bool {
    submit(pair, stage, Approval::Always);
    pair.order(Order::Arm);
    shows(pair, "waiting for approval") && rests(pair)
}

fn paused(pair: &mut Pair, stage: &Stage) -> bool {
    let carries = works(pair, stage, "carrying");
    pair.order(Order::Pause);
    carries && shows(pair, "paused") && rests(pair)
}

fn paused_after_the_last(pair: &mut Pair, stage: &Stage) -> bool {
    let mut there = paused(pair, stage);
    while there && pair.status().is_some_and(|status| status.remaining_moves > 0) {
        pair.order(Order::Step);
        there = rests(pair) && shows(pair, "paused");
    }
    there && rests(pair)
}

fn parks(pair: &mut Pair, stage: &Stage) -> bool {
    let away = paused(pair, stage);
    pair.order(Order::Park);
    away && shows(pair, "parking") && !pair.run_until(0.2, |_| false)
}

fn rounds(pair: &mut Pair, stage: &Stage) -> bool {
    let poses = [stage.model.look_poses.clone(), vec![stage.model.park]].concat();
    pair.visit(RoundOrder::pictures(poses, None));
    shows(pair, "calibration pose 2") && !pair.run_until(0.2, |_| false)
}

fn bring_about(pair: &mut Pair, text: &str) -> bool {
    let Ok(plans) = read_posted(text) else { return false };
    plans.into_iter().all(|planned| pair.fault(planned).is_ok())
}

/// A fault that lasts for so many seconds, while something is carried; 0: as the fault says.
fn with(pair: &mut Pair, stage: &Stage, name: &str, seconds: u32) -> bool {
    let lasts = if seconds > 0 { format!(r#", "args": {{"seconds": {seconds}}}"#) } else { String::new() };
    let carries = works(pair, stage, "carrying");
    let done = bring_about(pair, &format!(r#"{{"do": "{name}"{lasts}}}"#));
    pair.run_until(2.0, |_| false);
    carries && done
}

fn slider(pair: &mut Pair, stage: &Stage) -> bool {
    let carries = works(pair, stage, "carrying");
    let zero = r#"{"do": "ur.slider", "args": {"fraction": 0, "seconds": 60}}"#;
    let done = bring_about(pair, zero);
    pair.run_until(2.0, |_| false);
    carries && done
}

fn stopping(pair: &mut Pair, stage: &Stage) -> bool {
    let carries = works(pair, stage, "carrying");
    pair.order(Order::Abort);
    carries && shows(pair, "stopping")
}

fn stopped(pair: &mut Pair, stage: &Stage) -> bool {
    let carries = works(pair, stage, "carrying");
    pair.order(Order::Abort);
    carries && shows(pair, "idle") && rests(pair)
}

/// A fault that lasts, in an armed cell.
fn faulty(pair: &mut Pair, name: &str) -> bool {
    let ready = armed(pair);
    let done = bring_about(pair, &format!(r#"{{"do": "{name}", "args": {{"seconds": 120}}}}"#));
    pair.run_until(3.0, |_| false);
    ready && done
}

fn silent(pair: &mut Pair, link: &str) -> bool {
    let ready = armed(pair);
    let text = format!(r#"{{"do": "net.timeout", "args": {{"link": "{link}", "seconds": 120}}}}"#);
    let done = bring_about(pair, &text);
    pair.run_until(3.0, |_| false);
    ready && done
}

fn other_robot(pair: &mut Pair) -> bool {
    let ready = armed(pair);
    let done = bring_about(pair, r#"{"do": "ur.safety_checksum", "args": {"checksum": 7, "seconds": 120}}"#);
    pair.run_until(1.0, |_| false);
    ready && done
}

fn unlocking(pair: &mut Pair, stage: &Stage) -> bool {
    let stopped = with(pair, stage, "ur.pstop", 0);
    pair.order(Order::Recover(WayBack::Place));
    stopped && shows(pair, "on a way back: unlocking") && rests(pair)
}

fn way_back(pair: &mut Pair, stage: &Stage) -> bool {
    let stopped = with(pair, stage, "ur.pstop", 0);
    pair.order(Order::Recover(WayBack::Place));
    stopped && shows(pair, "on a way back: looking") && rests(pair)
}
