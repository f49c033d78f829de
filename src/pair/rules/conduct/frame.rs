//! The rules that are held after every controller frame: arm, vacuum, gates, late answers, status.
//!
//! In: the machine, the simulated cell and the status of this frame, and what [`Conduct`] has recorded of
//! the messages before. Out: breaches. Apart from the rules about single messages because these judge a
//! state and its age: most of them have a time after which celld has to have noticed.

use crate::pair::rules::conduct::Conduct;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::{KNOWN_FRAMES, Truth, gripper_answers, gripper_latency_frames};
use cell_machine::machine::Machine;
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::status::{Doing, Status};
use ur_sim::simulator::Simulator;
use ur_sim::world::lock;
use ur_sim::world::vacuum::{Channel, VacuumMode};

/// Frames from one look at the tool's height to the next, 20 ms.
const DESCENT_EVERY: u64 = 10;

/// A tool that is so much lower than it was goes down, m.
const DOWN_M: f64 = 5e-4;

/// A state may be this old when a motion begins: 100 ms at the order, then network and program.
const STATE_AGE_FRAMES: u64 = 75;

/// A stop may take this long.
const STOP_FRAMES: u64 = 1250;

/// The status says within this, 50 ms, that the arm may move.
const SHOWN_FRAMES: u64 = 25;

/// An arm that has not moved for so long has been at rest.
const STOOD_FRAMES: u64 = 10;

/// What began while its stop was on the way may last this long.
const OVERTAKEN_FRAMES: u64 = 500;

/// The on-robot program's watchdog and the stop after it.
const WATCHDOG_FRAMES: u64 = 350;

/// Below this share of its speed a program stands where it is.
const HELD_UP: f64 = 0.02;

/// The arm stands in a corner of its path for 200 ms at most.
const CORNER_FRAMES: u64 = 100;

/// Something held is read at least this often; a lost gripper is noticed first.
const WATCH_FRAMES: u64 = 500;

/// What was sent has arrived after this long: network and one frame of the program, 100 ms.
const ON_ITS_WAY_FRAMES: u64 = 50;

/// An order is answered within this, the slowest being the release of a gripper that does not answer.
const ANSWER_FRAMES: u64 = 5000;

/// After this long celld has to know of local control: it polls the dashboard once a second.
const LOCAL_FRAMES: u64 = 1000;

/// Height over its place at which an object may be let go, m: press and noise.
const PLACED_WITHIN_M: f64 = 0.004;

impl Conduct {
    /// One controller frame is over.
    pub fn frame(&mut self, truth: &Truth, machine: &Machine, simulator: &Simulator) {
        let (frame, status, moves) = (truth.frame, truth.status, truth.moves);
        self.frame = frame;
        let (stranger, safe, local) = (!truth.ours, truth.safe, truth.local);
        if std::mem::replace(&mut self.paused, truth.paused) && !truth.paused {
            self.played_at = Some(frame).filter(|_| self.unreached());
        }
        // A motion that begins by hand and goes on with a program begins when the program moves the arm.
        // Without one the arm only comes to rest.
        self.by_hand = truth.yields && (truth.guided || self.by_hand && moves);
        let driven = moves && !self.by_hand;
        if driven && self.still >= STOOD_FRAMES {
            self.began_at = frame;
        }
        self.still = if driven { 0 } else { self.still + 1 };
        let works = status.is_some_and(|status| matches!(status.doing, Doing::Working(..)));
        if works && !std::mem::replace(&mut self.works, works) {
            self.picking |= self.meant;
        }
        self.works = works;
        self.picking &= moves || works;
        self.local_since = if local { self.local_since.or(Some(frame)) } else { None };
        self.way_chosen &= !safe;
        self.watch_gates(simulator, safe);
        self.check_lost(machine);
        self.check_answers(machine);
        let began = driven && !self.moved;
        self.moved = driven;
        if self.moved && !self.silent() {
            self.moved_at = frame;
        }
        if truth.carries_out && truth.speed < HELD_UP && !self.silent() {
            self.held_up_at = frame;
        }
        if began && self.goes_on_unreached() {
            self.unreached_until = self.state_before_silence() + WATCHDOG_FRAMES;
        }
        if began && !stranger && !self.stranger {
            self.check_begin(machine, truth);
        }
        if truth.armed() {
            self.stopped_at = None;
            self.armed_at = Some(frame);
        }
        if self.armed_just_now() {
            self.accepted = Some(truth.accepted);
        }
        if frame.is_multiple_of(DESCENT_EVERY) {
            self.check_descent(machine, simulator);
        }
        self.check_stopped(driven);
        self.check_vacuum(frame, simulator, machine.supervisor().is_none_or(|cell| !cell.mode().ending()));
        self.check_status(machine, status);
        self.check_rest(moves && !stranger && !self.stranger, status);
        self.note_picture(simulator);
        self.check_picked(machine, simulator);
    }

    /// An empty tool goes down among the objects only for a pick on a sight of the table as it is now.
    fn check_descent(&mut self, machine: &Machine, simulator: &Simulator) {
        let Some(model) = machine.supervisor().map(Supervisor::model) else { return };
        let height = lock(&simulator.core().world).glance().tool[2];
        let picks = self.meant && !self.gripped;
        let goes_down = height < self.height - DOWN_M;
        if goes_down || height > self.height || !picks {
            self.height = height;
        }
        if goes_down && height < model.cycle.tallest && picks && self.sight <= self.disturbed {
            let detail = format!("{:.0} mm over the table on the way down", 1e3 * height);
            self.breach(Rule::PickOnOldSight, detail);
        }
    }

    /// After a stop nothing moves before the cell is armed.
    fn check_stopped(&mut self, moves: bool) {
        let Some(at) = self.stopped_at else { return };
        let detail = if self.began_at > at + ON_ITS_WAY_FRAMES {
            "it began after its stop"
        } else if self.frame > at + STOP_FRAMES {
            "it never stood"
        } else if self.began_at > at && self.frame > self.began_at + OVERTAKEN_FRAMES {
            "it began while the stop was on its way, and went on"
        } else {
            return;
        };
        let unreached = self.played_unreached() || self.frame <= self.unreached_until;
        if moves && !self.stranger && !unreached {
            self.breach(Rule::MotionAfterStop, detail.to_string());
            self.stopped_at = None;
        }
    }

    /// No stop has reached the program: celld or its link was gone before there was a reason for one.
    fn unreached(&self) -> bool {
        self.cut_off() || self.restarted_at.is_some_and(|at| self.armed_at.is_none_or(|armed| armed <= at))
    }

    /// The link was gone before there was a reason for a stop.
    fn cut_off(&self) -> bool {
        let reachable = self.stopped_at.is_some_and(|at| at < self.state_before_silence());
        (self.silent() || self.just_back()) && !reachable
    }

    /// What was streamed before the link was gone goes on until the program's watchdog ends it, after a stop
    /// in a corner too, or once the slider that held it up is moved.
    fn goes_on_unreached(&self) -> bool {
        let gone = self.state_before_silence();
        let on_its_way = gone <= self.moved_at.max(self.held_up_at) + CORNER_FRAMES;
        self.cut_off() && on_its_way && self.frame <= gone + WATCHDOG_FRAMES
    }

    /// A link that has just come back has not brought the stop yet.
    fn just_back(&self) -> bool {
        self.back_at.is_some_and(|back| self.frame <= back + ON_ITS_WAY_FRAMES)
    }

    fn state_before_silence(&self) -> u64 {
        if self.just_back() { self.silent_since } else { self.last_state }
    }

    /// A person has pressed play on a program that no stop could reach: it moves until its own watchdog
    /// stops it, or the link is back and the stop arrives.
    fn played_unreached(&self) -> bool {
        self.played_at.is_some_and(|at| {
            let back = self.back_at.is_some_and(|back| back >= at && self.frame > back + ON_ITS_WAY_FRAMES);
            self.frame <= at + WATCHDOG_FRAMES && !back
        })
    }

    fn watch_gates(&mut self, simulator: &Simulator, safe: bool) {
        let holds = lock(&simulator.core().world).glance().holds;
        let gate = if self.frame > self.last_state + STATE_AGE_FRAMES {
            Some("no state of the robot comes")
        } else if !safe {
            Some("the safety system forbids motion")
        } else if holds {
            Some("something is held")
        } else {
            None
        };
        self.closed = gate.map(|gate| (self.closed.map_or(self.frame, |(since, _)| since), gate));
    }

    fn check_answers(&mut self, machine: &Machine) {
        if machine.supervisor().is_some_and(|cell| cell.mode().ending()) {
            return;
        }
        let late = self.orders.iter().find(|(_, (at, _))| self.frame > at + ANSWER_FRAMES);
        if let Some((number, (_, order))) = late.map(|(number, given)| (*number, given.clone())) {
            self.orders.remove(&number);
            self.breach(Rule::OrderUnanswered, format!("{order:?}"));
        }
    }

    fn check_lost(&mut self, machine: &Machine) {
        let Some((since, link)) = self.lost else { return };
        if !machine.supervisor().is_some_and(|supervisor| supervisor.mode().armed()) {
            self.lost = None;
        } else if self.frame > since + KNOWN_FRAMES {
            self.breach(Rule::ArmedThroughLinkLoss, link.to_string());
            self.lost = None;
        }
    }

    /// The arm begins to move.
    fn check_begin(&mut self, machine: &Machine, truth: &Truth) {
        let restarted = self.restarted_at.is_some_and(|at| self.frame <= at + WATCHDOG_FRAMES);
        // What was streamed before celld was gone goes on until the program's watchdog ends it.
        if self.played_unreached() || restarted || self.goes_on_unreached() {
            return;
        }
        let Some(supervisor) = machine.supervisor() else {
            return self.breach(Rule::MotionWhileDisarmed, "before the cell was commissioned".into());
        };
        // A path that the program took while the cell was armed may stand in a corner and go on.
        let goes_on = self.armed_just_now() || truth.carries_out && self.accepted == Some(truth.accepted);
        if !supervisor.mode().armed() && !self.picking && !goes_on {
            self.breach(Rule::MotionWhileDisarmed, format!("command {}", truth.accepted));
        }
        let state = self.last_state.min(self.given_state);
        if self.frame > state + STATE_AGE_FRAMES {
            self.breach(Rule::MotionOnStaleState, format!("{} frames", self.frame - state));
        }
        if self.local_since.is_some_and(|since| self.frame > since + LOCAL_FRAMES) {
            self.breach(Rule::MotionInLocalControl, String::new());
        }
        let ours = supervisor.nonce().is_some_and(|ours| ours.number() == truth.nonce);
        if !ours && supervisor.mode().armed() {
            self.breach(Rule::MotionOfOldProgram, format!("nonce {}", truth.nonce));
        }
    }

    /// What was sent while the cell was armed may only arrive now.
    fn armed_just_now(&self) -> bool {
        self.armed_at.is_some_and(|at| self.frame <= at + ON_ITS_WAY_FRAMES)
    }

    fn check_vacuum(&mut self, frame: u64, simulator: &Simulator, machine_lives: bool) {
        let core = simulator.core();
        let world = lock(&core.world);
        let glance = world.glance();
        let mut off = Vec::new();
        for channel in Channel::ALL {
            let (mode, _) = world.vacuum_command(channel);
            let before = self.vacuum[channel.index()].replace(mode);
            if before == Some(VacuumMode::Grip) && mode != VacuumMode::Grip {
                off.push(channel);
            }
        }
        let over = world.held_over_place();
        let held = glance.holds;
        drop(world);
        if !off.is_empty() && self.moved {
            self.breach(Rule::VacuumOffInMotion, format!("{off:?}"));
        }
        let ordered = self.releases > 0 || self.released_at.is_some_and(|at| frame <= at + ON_ITS_WAY_FRAMES);
        if !off.is_empty() && !ordered && over.is_some_and(|height| height > PLACED_WITHIN_M) {
            self.breach(Rule::VacuumOffAway, format!("{:.0} mm over its place", over.unwrap_or(0.0) * 1e3));
        }
        self.held_since = if held { self.held_since.or(Some(frame)) } else { None };
        // The gripper's late answers hold up those behind them, also after the fault.
        if !gripper_answers(simulator) {
            self.held_up_until = frame + gripper_latency_frames(simulator);
        }
        if frame <= self.held_up_until {
            self.last_read = self.last_read.max(frame);
        }
        let since = self.held_since.map_or(frame, |since| since.max(self.last_read));
        if frame > since + WATCH_FRAMES && machine_lives {
            self.breach(Rule::HeldUnwatched, format!("{} frames", frame - since));
            self.last_read = frame;
        }
    }

    /// An object is about to be gripped: what is meant is on disk, and the table was seen since it was last
    /// disturbed. A grip that was on its way when a stop came is none of a pick-n-place.
    pub(super) fn check_grip(&mut self) {
        if let Some((number, _)) = self.open.iter().find(|(_, waits)| **waits && self.meant) {
            self.breach(Rule::GripBeforeCommit, format!("record {number}"));
        }
        if self.picking && self.sight <= self.disturbed {
            self.breach(Rule::PickOnOldSight, format!("{} frames", self.disturbed - self.sight));
        }
    }

    /// Where the status says disarmed or paused and does not say that the arm may move, it rests.
    fn check_rest(&mut self, moves: bool, status: Option<&Status>) {
        let rests = status.is_some_and(|status| (!status.armed || status.paused) && !status.moving);
        // What celld does not reach, or does not know of after a start, it cannot show.
        let restarted = self.restarted_at.is_some_and(|at| self.frame <= at + WATCHDOG_FRAMES);
        let shown = !moves || !rests || restarted || self.played_unreached();
        self.unshown = if shown { 0 } else { self.unshown + 1 };
        if self.unshown == SHOWN_FRAMES {
            let doing = status.map(Status::text).unwrap_or_default();
            self.breach(
                Rule::StatusNotTrue,
                format!("the arm moves, and the status says that it rests, and {doing:?}"),
            );
        }
    }

    fn check_status(&mut self, machine: &Machine, status: Option<&Status>) {
        let (Some(status), Some(supervisor)) = (status, machine.supervisor()) else { return };
        if status.armed != supervisor.mode().armed() {
            self.breach(Rule::StatusNotTrue, format!("the status says armed: {}", status.armed));
        }
    }
}
