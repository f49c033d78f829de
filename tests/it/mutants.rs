//! Mutants of the cell: whatever goes wrong between machine and world, the rules of the closed loop notice.
//!
//! Each mutant is planted by an adapter, here and nowhere else; the same drill without one breaks no rule.
//! What a mutant represents is the fault in celld's own code that would have the same effect at the border.

use cell_machine::device::gripper_types::{Channels, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event, News};
use cell_machine::intake::Origin;
use cell_machine::machine::Machine;
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::status::{Doing, WorkStep};
use cell_vision::observe::Observation;
use celld::pair::camera_view::SightKind;
use celld::pair::rules::{Breach, Rule};
use celld::pair::run::{bring_up, true_poses};
use celld::pair::stage::Stage;
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Adapter, Choice, Pair};
use ur_sim::faults::read::read_posted;
use ur_wire::enumerations::SafetyMode;

/// What is wrong with the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// Nothing: the control.
    Sound,
    /// Motion does not wait for the disk.
    CommitNotAwaited,
    /// The journal is never written.
    CommitLost,
    /// The vacuum is opened while the arm moves.
    VacuumOpenedInMotion,
    /// A stop opens the vacuum.
    VacuumOpenedByStop,
    /// What is held is not watched: the last reading counts for ever.
    HeldNotWatched,
    /// The answer comes before the decision, and the decision is another.
    AnswerBeforeDecision,
    /// An order is answered twice.
    AnsweredTwice,
    /// Disarming does nothing.
    DisarmIgnored,
    /// The cell arms itself.
    ArmsItself,
    /// The status is an old one.
    StatusOld,
    /// What was seen once is taken for what is there.
    SightOld,
    /// A protective stop is unlocked by celld.
    UnlocksItself,
    /// One gate is left out: remote control counts as on, and so does the connection that a switch to local
    /// control closes.
    GateLeftOut,
    /// The number of an earlier program is taken for that of the present one.
    OldNonceAccepted,
    /// A job that was handed out is forgotten.
    JobLost,
    /// An abort is answered while the arm still brakes.
    StoppedTooSoon,
    /// A release is called done, and the vacuum stays.
    ReleaseSaid,
    /// The robot is powered on in a disarmed cell.
    StartsDisarmed,
}

/// By what a fault is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// A breach of this rule.
    By(Rule),
    /// A job without an end.
    ByMissingEnd,
}

const FAULTS: [(Fault, Found); 18] = [
    (Fault::CommitNotAwaited, Found::By(Rule::AcknowledgedNotWritten)),
    (Fault::CommitLost, Found::By(Rule::AcknowledgedNotWritten)),
    (Fault::VacuumOpenedInMotion, Found::By(Rule::VacuumOffInMotion)),
    (Fault::VacuumOpenedByStop, Found::By(Rule::VacuumOffAway)),
    (Fault::HeldNotWatched, Found::By(Rule::HeldUnwatched)),
    (Fault::AnswerBeforeDecision, Found::By(Rule::AnswerNotTrue)),
    (Fault::AnsweredTwice, Found::By(Rule::AnswerWithoutOrder)),
    (Fault::DisarmIgnored, Found::By(Rule::AnswerNotTrue)),
    (Fault::ArmsItself, Found::By(Rule::AnswerWithoutOrder)),
    (Fault::StatusOld, Found::By(Rule::StatusNotTrue)),
    (Fault::SightOld, Found::By(Rule::PickOnOldSight)),
    (Fault::UnlocksItself, Found::By(Rule::SafetyAcknowledged)),
    (Fault::GateLeftOut, Found::By(Rule::MotionInLocalControl)),
    (Fault::OldNonceAccepted, Found::By(Rule::MotionOfOldProgram)),
    (Fault::JobLost, Found::ByMissingEnd),
    (Fault::StoppedTooSoon, Found::By(Rule::AnswerNotTrue)),
    (Fault::ReleaseSaid, Found::By(Rule::AnswerNotTrue)),
    (Fault::StartsDisarmed, Found::By(Rule::StartedWhileDisarmed)),
];

/// The adapter that plants a fault.
struct Mutant {
    fault: Fault,
    frames: u64,
    seen: Option<Box<Observation>>,
    ignored: Option<u64>,
    answered: Option<u64>,
    read: Option<Vec<u16>>,
    stopped: u64,
    /// The primary interface is gone, and seems not to be.
    deaf: bool,
    /// Numbers of the first program and of the one that celld means.
    nonces: Option<(i32, i32)>,
}

/// Jobs of the drill.
const JOBS: usize = 4;

/// A robot state without sub-packages.
const EMPTY_STATE: [u8; 5] = [0, 0, 0, 5, 16];

/// Both channels let the air in.
const VENT: [u16; 2] = [0, 0];

impl Mutant {
    fn new(fault: Fault) -> Mutant {
        Mutant {
            fault,
            frames: 0,
            seen: None,
            ignored: None,
            answered: None,
            read: None,
            stopped: 0,
            deaf: false,
            nonces: None,
        }
    }

    fn vent() -> Effect {
        Effect::Registers(ModbusRequest::Write { address: 0, values: VENT.to_vec() })
    }
}

impl Adapter for Mutant {
    fn event(&mut self, event: Event, events: &mut Vec<Event>) {
        match (self.fault, event) {
            (Fault::DisarmIgnored, Event::Order(number, Order::Disarm, _)) => self.ignored = Some(number),
            (Fault::StoppedTooSoon, Event::Order(number, Order::Abort, origin)) => {
                (self.ignored, self.answered) = (Some(number), Some(number));
                events.push(Event::Order(number, Order::Abort, origin));
            }
            (Fault::SightOld, Event::Observed(number, Ok(seen))) => {
                self.seen = Some(seen.clone());
                events.push(Event::Observed(number, Ok(seen)));
            }
            (Fault::HeldNotWatched, Event::Registers(Ok(words))) if words.len() == 2 => {
                self.read = Some(words.clone());
                events.push(Event::Registers(Ok(words)));
            }
            (Fault::GateLeftOut, Event::Received(Link::Dashboard, bytes)) => {
                let on = if bytes == b"false\n" { b"true\n".to_vec() } else { bytes };
                events.push(Event::Received(Link::Dashboard, on));
            }
            (Fault::GateLeftOut, Event::Disconnected(Link::Primary, _)) => self.deaf = true,
            (Fault::OldNonceAccepted, Event::Received(Link::Rtde, bytes)) => {
                events.push(Event::Received(Link::Rtde, self.with_the_wanted_nonce(bytes)));
            }
            (Fault::JobLost, Event::Job(job)) if job.id == "job-1" => {}
            (_, event) => events.push(event),
        }
    }

    fn effect(&mut self, effect: Effect, effects: &mut Vec<Effect>, made_up: &mut Vec<Event>) {
        match (self.fault, effect) {
            (Fault::CommitNotAwaited, Effect::Commit { number, record }) => {
                made_up.push(Event::Committed(number, Ok(())));
                effects.push(Effect::Commit { number, record });
            }
            (Fault::CommitLost, Effect::Commit { number, .. }) => {
                made_up.push(Event::Committed(number, Ok(())))
            }
            (Fault::HeldNotWatched, Effect::Registers(ModbusRequest::Read { .. })) if self.read_again() => {
                made_up.push(Event::Registers(Ok(self.read.clone().unwrap_or_default())));
            }
            (Fault::SightOld, Effect::Observe { number, .. }) if self.seen.is_some() => {
                made_up.extend(self.seen.clone().map(|seen| Event::Observed(number, Ok(seen))));
            }
            (Fault::OldNonceAccepted, Effect::Send(Link::Primary, bytes)) => {
                effects.push(Effect::Send(Link::Primary, self.with_the_old_nonce(bytes)));
            }
            (Fault::StoppedTooSoon, Effect::Reply { number, .. }) if self.answered == Some(number) => {}
            (Fault::ReleaseSaid, Effect::Registers(ModbusRequest::Write { values, .. }))
                if values[..] == VENT =>
            {
                made_up.push(Event::Registers(Ok(Vec::new())));
            }
            (Fault::ReleaseSaid, Effect::Reply { number, reply })
                if reply.message.contains("not released") =>
            {
                effects.push(Effect::Reply { number, reply: Reply::accept("vacuum off") });
            }
            (Fault::AnsweredTwice, Effect::Reply { number, reply }) => {
                effects.push(Effect::Reply { number, reply: reply.clone() });
                effects.push(Effect::Reply { number, reply });
            }
            (Fault::AnswerBeforeDecision, Effect::Reply { number, .. }) => {
                effects.push(Effect::Reply { number, reply: Reply::accept("done") });
            }
            (Fault::StatusOld, Effect::Notify(News::Status(mut status))) => {
                status.armed = false;
                effects.push(Effect::Notify(News::Status(status)));
            }
            (fault, Effect::Notify(News::Notice(notice))) => {
                let stops = notice.text.starts_with("disarmed, a stop is ordered");
                self.stopped = if stops { self.frames } else { self.stopped };
                if stops && fault == Fault::VacuumOpenedByStop {
                    effects.push(Mutant::vent());
                }
                if stops && fault == Fault::UnlocksItself {
                    effects.push(Effect::Send(Link::Dashboard, b"unlock protective stop\n".to_vec()));
                }
                effects.push(Effect::Notify(News::Notice(notice)));
            }
            (_, effect) => effects.push(effect),
        }
    }

    fn frame(&mut self, machine: &Machine, effects: &mut Vec<Effect>, made_up: &mut Vec<Event>) {
        self.frames += 1;
        let armed = machine.supervisor().is_some_and(|cell| cell.mode().armed());
        if let Some(number) = self.ignored.take() {
            let word = if self.fault == Fault::DisarmIgnored { "disarmed" } else { "stopped and disarmed" };
            effects.push(Effect::Reply { number, reply: Reply::accept(word) });
        }
        match self.fault {
            Fault::VacuumOpenedInMotion if armed && self.frames.is_multiple_of(400) => {
                effects.push(Mutant::vent())
            }
            Fault::StartsDisarmed if !armed && self.frames == self.stopped + 500 => {
                effects.push(Effect::Send(Link::Dashboard, b"power on\n".to_vec()));
            }
            Fault::GateLeftOut if self.deaf && self.frames.is_multiple_of(50) => {
                made_up.push(Event::Received(Link::Primary, EMPTY_STATE.to_vec()));
            }
            Fault::ArmsItself if !armed && self.frames == self.stopped + 500 => {
                made_up.push(Event::Order(999_999, Order::Arm, Origin::OWN));
            }
            _ => {}
        }
    }
}

impl Mutant {
    /// After the first hundred readings none is made any more.
    fn read_again(&mut self) -> bool {
        self.frames > 5000 && self.read.is_some()
    }

    /// Every upload after the first is named and numbered as the first was.
    fn with_the_old_nonce(&mut self, bytes: Vec<u8>) -> Vec<u8> {
        let text = String::from_utf8_lossy(&bytes).to_string();
        let digits = text.strip_prefix("def celld_").and_then(|rest| rest.split('(').next());
        let Some(wanted) = digits.and_then(|digits| digits.parse().ok()) else { return bytes };
        let (first, _) = *self.nonces.get_or_insert((wanted, wanted));
        self.nonces = Some((first, wanted));
        text.replace(&wanted.to_string(), &first.to_string()).into_bytes()
    }

    /// The register with the program's number reads as celld wishes.
    fn with_the_wanted_nonce(&self, mut bytes: Vec<u8>) -> Vec<u8> {
        let Some((first, wanted)) = self.nonces else { return bytes };
        let pattern = first.to_be_bytes();
        if let Some(at) = bytes.windows(4).position(|window| window == pattern) {
            bytes[at..at + 4].copy_from_slice(&wanted.to_be_bytes());
        }
        bytes
    }
}

fn bring_about(pair: &mut Pair, text: &str) -> Result<(), String> {
    for planned in read_posted(text).map_err(|complaints| complaints.to_string())? {
        pair.fault(planned).map_err(|error| error.to_string())?;
    }
    Ok(())
}

fn submit(pair: &mut Pair, stage: &Stage, number: usize) {
    pair.submit(job(&stage.model, &true_poses(pair, &stage.model), 5, number));
}

fn until_working(pair: &mut Pair, step: WorkStep) {
    pair.run_until(60.0, |pair| {
        let doing = pair.status().map(|status| &status.doing);
        matches!(doing, Some(Doing::Working(doing, _)) if *doing == step)
    });
}

fn until_no_job(pair: &mut Pair) {
    pair.run_until(120.0, |pair| pair.store().active().is_none());
}

/// An operator's afternoon: a job stopped while it carries, one disarmed in the middle, one during which the
/// pendant is switched to local control, one with a protective stop.
fn drill(fault: Fault) -> Result<(Vec<Breach>, usize), String> {
    let mut stage = stage(5, SightKind::Corners)?;
    // Long enough not to be found in bytes that mean something else.
    stage.parameters.nonce_seed = 1_234_567_890;
    let mut pair = Pair::new(stage.clone(), Choice::of(5)).map_err(|error| error.to_string())?;
    pair.adapt(Box::new(Mutant::new(fault)));
    if !bring_up(&mut pair) {
        return Err("the cell does not come up".to_string());
    }
    pair.order(Order::Arm);
    submit(&mut pair, &stage, 0);
    until_working(&mut pair, WorkStep::Carrying);
    pair.run_until(0.2, |_| false);
    pair.order(Order::Abort);
    pair.run_until(4.0, |_| false);
    pair.order(Order::Release(Channels::Both));
    pair.run_until(4.0, |_| false);
    // Refused: the cell is disarmed.
    pair.order(Order::Park);
    pair.run_until(0.5, |_| false);
    pair.order(Order::Arm);
    submit(&mut pair, &stage, 1);
    until_working(&mut pair, WorkStep::Carrying);
    pair.order(Order::Disarm);
    pair.run_until(20.0, |_| false);
    pair.order(Order::Arm);
    until_no_job(&mut pair);
    submit(&mut pair, &stage, 2);
    until_working(&mut pair, WorkStep::Approaching);
    bring_about(&mut pair, r#"{"do": "ur.local", "args": {"seconds": 6}}"#)?;
    pair.run_until(9.0, |_| false);
    pair.order(Order::Arm);
    until_no_job(&mut pair);
    submit(&mut pair, &stage, 3);
    until_working(&mut pair, WorkStep::Approaching);
    bring_about(&mut pair, r#"{"do": "ur.pstop"}"#)?;
    let stops = |pair: &Pair| pair.simulator().core().robot.controller().core.modes.safety_mode();
    assert!(pair.run_until(1.0, |pair| stops(pair) != SafetyMode::Normal), "the stop comes");
    pair.run_until(120.0, |pair| pair.reports().len() >= JOBS);
    Ok((pair.breaches().to_vec(), pair.reports().len()))
}

#[test]
fn the_sound_cell_breaks_no_rule_in_the_drill() {
    let (breaches, reports) = drill(Fault::Sound).unwrap();
    assert_eq!(breaches, []);
    assert_eq!(reports, JOBS, "every job has an end");
}

/// Before anything is gripped.
#[test]
fn an_old_sight_is_found_as_the_tool_goes_down() {
    let (breaches, _) = drill(Fault::SightOld).unwrap();
    let first = breaches.iter().find(|breach| breach.rule == Rule::PickOnOldSight);
    assert!(first.is_some_and(|breach| breach.detail.ends_with("on the way down")), "{first:?}");
}

#[test]
fn every_mutant_is_found() {
    let mut missed = Vec::new();
    for (fault, wanted) in FAULTS {
        let (breaches, reports) = drill(fault).unwrap();
        let found = match wanted {
            Found::By(rule) => breaches.iter().any(|breach| breach.rule == rule),
            Found::ByMissingEnd => reports < JOBS,
        };
        if !found {
            let rules: Vec<_> = breaches.iter().map(|breach| breach.rule).collect();
            missed.push(format!("{fault:?}: {reports} ends, found {rules:?}"));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
