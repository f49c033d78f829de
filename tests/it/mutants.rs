//! Mutants of the cell: whatever goes wrong between machine and world, the rules of the closed loop notice.
//!
//! Each mutant is planted by an adapter, here and nowhere else; the same drill without one breaks no rule.
//! What a mutant stands for is the fault in celld's own code that would have the same effect at the border.

use celld::cell::device::gripper::{Channels, ModbusRequest};
use celld::cell::device::robot_types::Link;
use celld::cell::event::{Effect, Event, News};
use celld::cell::machine::Machine;
use celld::cell::orders::{Order, Reply};
use celld::cell::supervisor::status::Doing;
use celld::cli::simulate::stage;
use celld::pair::eyes::Eye;
use celld::pair::rules::{Breach, Rule};
use celld::pair::run::{bring_up, true_poses};
use celld::pair::work::job;
use celld::pair::{Adapter, Choice, Pair};
use celld::sim::faults::read::read_posted;
use celld::vision::observe::Observation;
use celld::wire::enumerations::SafetyMode;

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
}

const FAULTS: [(Fault, Rule); 12] = [
    (Fault::CommitNotAwaited, Rule::AcknowledgedNotWritten),
    (Fault::CommitLost, Rule::AcknowledgedNotWritten),
    (Fault::VacuumOpenedInMotion, Rule::VacuumOffInMotion),
    (Fault::VacuumOpenedByStop, Rule::VacuumOffAway),
    (Fault::HeldNotWatched, Rule::HeldUnwatched),
    (Fault::AnswerBeforeDecision, Rule::AnswerNotTrue),
    (Fault::AnsweredTwice, Rule::AnswerWithoutOrder),
    (Fault::DisarmIgnored, Rule::AnswerNotTrue),
    (Fault::ArmsItself, Rule::AnswerWithoutOrder),
    (Fault::StatusOld, Rule::StatusNotTrue),
    (Fault::SightOld, Rule::PickOnOldSight),
    (Fault::UnlocksItself, Rule::SafetyAcknowledged),
];

/// The adapter that plants a fault.
struct Mutant {
    fault: Fault,
    frames: u64,
    seen: Option<Box<Observation>>,
    ignored: Option<u64>,
    read: Option<Vec<u16>>,
    stopped: u64,
}

/// Both channels let the air in.
const VENT: [u16; 2] = [0, 0];

impl Mutant {
    fn new(fault: Fault) -> Mutant {
        Mutant { fault, frames: 0, seen: None, ignored: None, read: None, stopped: 0 }
    }

    fn vent() -> Effect {
        Effect::Registers(ModbusRequest::Write { address: 0, values: VENT.to_vec() })
    }
}

impl Adapter for Mutant {
    fn event(&mut self, event: Event, events: &mut Vec<Event>) {
        match (self.fault, event) {
            (Fault::DisarmIgnored, Event::Order(number, Order::Disarm)) => self.ignored = Some(number),
            (Fault::SightOld, Event::Observed(number, Ok(seen))) => {
                self.seen = Some(seen.clone());
                events.push(Event::Observed(number, Ok(seen)));
            }
            (Fault::HeldNotWatched, Event::Registers(Ok(words))) if words.len() == 2 => {
                self.read = Some(words.clone());
                events.push(Event::Registers(Ok(words)));
            }
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
                let stops = notice.text.starts_with("stopped and disarmed");
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
            effects.push(Effect::Reply { number, reply: Reply::accept("disarmed") });
        }
        match self.fault {
            Fault::VacuumOpenedInMotion if armed && self.frames.is_multiple_of(400) => {
                effects.push(Mutant::vent())
            }
            Fault::ArmsItself if !armed && self.frames == self.stopped + 500 => {
                made_up.push(Event::Order(999_999, Order::Arm));
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
}

/// An operator's afternoon: a job stopped while it carries, one disarmed in the middle, one with a protective
/// stop.
fn drill(fault: Fault) -> Result<(Vec<Breach>, usize), String> {
    let stage = stage(5, Eye::Corners)?;
    let mut pair = Pair::new(stage.clone(), Choice::of(5)).map_err(|error| error.to_string())?;
    pair.adapt(Box::new(Mutant::new(fault)));
    if !bring_up(&mut pair) {
        return Err("the cell does not come up".to_string());
    }
    let submit = |pair: &mut Pair, number: usize| {
        let ended = pair.reports().len();
        pair.submit(job(&stage.model, &true_poses(pair, &stage.model), 5, number));
        ended
    };
    let working = |pair: &Pair, word: &str| {
        pair.status()
            .is_some_and(|status| matches!(&status.doing, Doing::Working(doing, _) if *doing == word))
    };
    pair.order(Order::Arm);
    submit(&mut pair, 0);
    pair.run_until(60.0, |pair| working(pair, "carrying"));
    pair.run_until(0.2, |_| false);
    pair.order(Order::Abort);
    pair.run_until(4.0, |_| false);
    pair.order(Order::Release(Channels::Both));
    pair.run_until(4.0, |_| false);
    // Refused: the cell is disarmed.
    pair.order(Order::Park);
    pair.run_until(0.5, |_| false);
    pair.order(Order::Arm);
    submit(&mut pair, 1);
    pair.run_until(60.0, |pair| working(pair, "carrying"));
    pair.order(Order::Disarm);
    pair.run_until(20.0, |_| false);
    pair.order(Order::Arm);
    pair.run_until(120.0, |pair| pair.store().active().is_none());
    let ended = submit(&mut pair, 2);
    pair.run_until(60.0, |pair| working(pair, "approaching"));
    for planned in read_posted(r#"{"do": "ur.pstop"}"#).map_err(|complaints| complaints.to_string())? {
        pair.fault(planned).map_err(|error| error.to_string())?;
    }
    pair.run_until(120.0, |pair| pair.reports().len() > ended);
    assert_ne!(pair.simulator().core().robot.controller().core.modes.safety_mode(), SafetyMode::Normal);
    Ok((pair.breaches().to_vec(), pair.reports().len()))
}

#[test]
fn the_sound_cell_breaks_no_rule_in_the_drill() {
    let (breaches, reports) = drill(Fault::Sound).unwrap();
    assert_eq!(breaches, []);
    assert_eq!(reports, 3, "every job has an end");
}

#[test]
fn every_mutant_is_found() {
    let mut missed = Vec::new();
    for (fault, rule) in FAULTS {
        let (breaches, _) = drill(fault).unwrap();
        if !breaches.iter().any(|breach| breach.rule == rule) {
            missed
                .push(format!("{fault:?}: found {:?}", breaches.iter().map(|b| b.rule).collect::<Vec<_>>()));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
