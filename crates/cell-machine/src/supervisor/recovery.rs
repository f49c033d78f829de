//! Ways back after a stop: `celld recover`.
//!
//! In: the operator's choice, what hangs on the gripper, a look. Out: a protective stop unlocked after the
//! choice and the controller's 5 s; the arm straight up; the object put down at its goal or the nearest free
//! place that the look shows; and the cell disarmed again, whatever came of it. These are the only motions
//! with an object held after a stop (design, section 7, rule 1), and every one of them is a person's order.
//! A way back that meets a fault is stopped like any motion, and the object stays held.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::{Channels, GripperCommand, GripperEvent};
use crate::device::robot_types::{RobotCommand, RobotState};
use crate::orders::{Reply, WayBack};
use crate::supervisor::back::{BackStage, Held, Placing, Recovery};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::free_place::Searched;
use crate::supervisor::gates;
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::judge::foreign_height;
use crate::supervisor::phase::Phase;
use crate::supervisor::reason::{Reason, alarm, say};
use crate::supervisor::travel::NoTravel;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;
use ur_wire::enumerations::{RobotMode, SafetyMode};

/// The controller refuses to unlock within 5 s of a protective stop, counted by its own clock.
const UNLOCK_AFTER: Duration = Duration::from_millis(5500);

/// From the choice to the unlocked arm.
const UNLOCK_WITHIN: Duration = Duration::from_secs(20);

impl Supervisor {
    /// Begins a way back; the refusal, if it is refused.
    pub(crate) fn on_recover(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        way: WayBack,
        out: &mut Vec<Action>,
    ) -> Option<Reply> {
        if way == WayBack::Show {
            return Some(Reply::accept(self.situation(now, devices)));
        }
        if let Err(why) = self.may_recover(devices, way) {
            return Some(Reply::refuse(format!("nothing was done: {why}")));
        }
        self.arms_when_open = false;
        if way == WayBack::Release {
            // Hands are at the gripper: a protective stop stays, `--hold` unlocks it afterwards.
            self.on_release_order(now, devices, number, Channels::Both, out);
            return None;
        }
        let stopped = protective(devices);
        say(out, format!("way back by the operator's order: {}", self.announce(devices, way)));
        self.back.ended = None;
        self.back.recovery = Some(Recovery { way, raised: false, below: None, search: None, place: None });
        if stopped {
            self.enter(Phase::Recover(BackStage::Unlocking { ordered: false }), UNLOCK_WITHIN);
        } else {
            self.unlocked(now, out);
        }
        None
    }

    /// Why a way back cannot be taken now, and what to do first.
    pub(crate) fn may_recover(&self, devices: &DeviceSnapshot, way: WayBack) -> Result<(), String> {
        use crate::supervisor::mode::Mode;
        match &self.mode {
            Mode::Ending { .. } => return Err("celld is ending".to_string()),
            Mode::Locked(reason) => return Err(reason.clone()),
            Mode::Armed { .. } if self.back.recovery.is_none() => {
                return Err("the cell is armed: `celld disarm` or `celld abort` first".to_string());
            }
            Mode::Armed { .. } | Mode::Disarmed { .. } => {}
        }
        if self.back.recovery.is_some() {
            return Err("a way back is under way; `celld abort` stops it".to_string());
        }
        if let Some(why) = self.under_way(devices) {
            return Err(format!("{why}; try again"));
        }
        if !matches!(self.phase, Phase::Ready | Phase::Approve) {
            return Err("a motion or a plan is under way: wait for its end, or `celld abort`".to_string());
        }
        let moves = matches!(way, WayBack::Place | WayBack::Retreat);
        let reached = if moves { self.orders_reach() } else { Ok(()) };
        reached
            .and_then(|()| gates::recovering(devices))
            .map_err(|closed| format!("{}; {}", self.place(&closed), closed.hint_to_try_again()))?;
        if !devices.robot.is_some_and(RobotState::stands_still) {
            return Err("the arm moves, and not by celld: see what moves it".to_string());
        }
        self.suits(devices, way)
    }

    /// Whether a way fits what is held.
    fn suits(&self, devices: &DeviceSnapshot, way: WayBack) -> Result<(), String> {
        let holds = match gates::empty_handed(devices) {
            Ok(()) => false,
            Err(gates::GateClosed::Holding) => true,
            Err(closed) => return Err(format!("{}; {}", self.place(&closed), closed.hint())),
        };
        match way {
            WayBack::Show => Ok(()),
            WayBack::Hold if !protective(devices) => {
                Err("there is no protective stop to unlock, and the vacuum does not change".to_string())
            }
            WayBack::Hold | WayBack::Retreat => Ok(()),
            // Without vacuum something may hang all the same, and a person takes it off.
            WayBack::Release if holds || self.back.held.is_some() => Ok(()),
            WayBack::Place | WayBack::Release if !holds => Err("no vacuum holds anything".to_string()),
            WayBack::Release => Ok(()),
            WayBack::Place => self.can_be_placed(devices),
        }
    }

    /// Whether what is held can be put down at all: known, watched, and hanging straight down.
    fn can_be_placed(&self, devices: &DeviceSnapshot) -> Result<(), String> {
        let by_hand = "`celld recover --retreat`, then hold it and `celld recover --release`";
        let grasp = self.back.held.as_ref().and_then(|held| held.grasp.as_ref());
        let Some((grasp, robot)) = grasp.zip(devices.robot) else {
            return Err(format!("what hangs on the gripper, or how, is not known: {by_hand}"));
        };
        if self.back.fell.is_some() || !devices.gripper_holds {
            return Err(format!("the vacuum does not hold it as it should: {by_hand}"));
        }
        if grasp.object_at(&self.model.arm, &robot.q).is_none() {
            return Err(format!("the tool does not point straight down: {by_hand}"));
        }
        Ok(())
    }

    /// What a way back will do, in the order in which it does it.
    pub(crate) fn announce(&self, devices: &DeviceSnapshot, way: WayBack) -> String {
        let object = self.back.held.as_ref().map_or("what is held", |held| held.object.as_str());
        let off =
            devices.robot.is_some_and(|r| matches!(r.robot_mode, RobotMode::PowerOff | RobotMode::Idle));
        let first = match (protective(devices), off) {
            (true, _) => "the protective stop is unlocked, then ",
            (false, true) if way != WayBack::Hold => "the arm is powered and its brakes released, then ",
            (false, _) => "",
        };
        match way {
            WayBack::Show => "nothing".to_string(),
            WayBack::Hold => {
                format!("{first}nothing moves: {object} stays held and watched, and the cell disarmed")
            }
            WayBack::Release if protective(devices) => {
                format!(
                    "the vacuum goes off where the arm is: hold {object} by hand; then `--hold` unlocks the \
                     stop"
                )
            }
            WayBack::Release => format!("the vacuum goes off where the arm is: hold {object} by hand"),
            WayBack::Retreat => format!(
                "{first}the arm goes straight up; where it is high enough over the table already, it does \
                 not move"
            ),
            WayBack::Place => {
                let meant = self.back.held.as_ref().map_or_else(String::new, |held| place_words(&held.to));
                format!(
                    "{first}the arm goes straight up, looks at the table and puts {object} down where it was \
                     to go{meant}, or at the nearest free place"
                )
            }
        }
    }

    /// The answer to a choice that was taken.
    pub(crate) fn recovering(&self, devices: &DeviceSnapshot, way: WayBack) -> Reply {
        match &self.back.ended {
            Some(Ok(said)) => return Reply::accept(format!("{said}; the cell is disarmed")),
            Some(Err(why)) => return Reply::refuse(format!("the way back ended: {why}")),
            None => {}
        }
        Reply::accept(format!(
            "{}; `celld abort` stops it, `celld status` shows it",
            self.announce(devices, way)
        ))
    }

    /// On every tick: unlocks as soon as the controller allows it.
    pub(crate) fn watch_unlocking(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        let Phase::Recover(BackStage::Unlocking { ordered }) = self.phase else { return };
        let Some(robot) = devices.robot.filter(|_| devices.robot_fresh) else { return };
        if robot.safety_mode.allows_motion() {
            return self.unlocked(now, out);
        }
        let since = *self.back.protective_since.get_or_insert(now);
        if !ordered && now.since(since) >= UNLOCK_AFTER {
            self.phase = Phase::Recover(BackStage::Unlocking { ordered: true });
            out.push(Action::Robot(RobotCommand::CloseSafetyPopup));
            out.push(Action::Robot(RobotCommand::UnlockProtectiveStop));
        }
    }

    /// No protective stop is in the way any more.
    fn unlocked(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        let Some(recovery) = &self.back.recovery else { return };
        // Whoever has ordered a release meanwhile has hands at the gripper.
        if !self.release_orders.is_empty() || !self.until_it_stands.is_empty() {
            return self.end_recovery(Err("a release was ordered meanwhile".to_string()), out);
        }
        match recovery.way {
            WayBack::Place | WayBack::Retreat => {
                self.seen = None;
                self.waiting_since = now;
                // For this way alone: it ends with the cell disarmed.
                self.mode.arm();
            }
            WayBack::Show | WayBack::Hold | WayBack::Release => {
                self.end_recovery(Ok("the protective stop is unlocked".to_string()), out);
            }
        }
    }

    /// Decides what comes next on a way back.
    pub(crate) fn pursue_recovery(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        if !self.mode.armed() {
            return self.end_recovery(Err("the cell was disarmed".to_string()), out);
        }
        if let Err(closed) = gates::any_motion(true, devices, self.nonce) {
            return self.wait_or_bring_up(now, devices, closed, out);
        }
        let Some(recovery) = &self.back.recovery else { return };
        if !recovery.raised {
            return self.raise(devices, out);
        }
        if recovery.way == WayBack::Retreat {
            return self
                .end_recovery(Ok("the arm is high enough over everything on the table".to_string()), out);
        }
        match self.seen.take() {
            None => self.begin_whole_look(now, devices, out),
            Some(seen) => self.put_down(devices, seen, out),
        }
    }

    fn raise(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some(robot) = devices.robot else { return };
        match self.straight_up_path(&robot.q) {
            Ok(Some(path)) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                self.enter(Phase::Recover(BackStage::Raising), self.model.tolerances.look_deadline);
            }
            Ok(None) => {
                let below = self.below(robot);
                if let Some(recovery) = &mut self.back.recovery {
                    (recovery.raised, recovery.below) = (true, below);
                }
                self.pursue_recovery(self.clock(), devices, out);
            }
            Err(fault) => {
                let advice = self.advice(&robot.q, &NoTravel::Path(fault.clone()));
                let why = format!("the arm cannot go straight up from here: {fault}; {advice}");
                self.end_recovery(Err(why), out);
            }
        }
    }

    /// Where what is held hangs over, before the arm goes round to look.
    fn below(&self, robot: &RobotState) -> Option<Pose2> {
        self.back.held.as_ref()?.grasp.as_ref()?.object_at(&self.model.arm, &robot.q)
    }

    fn put_down(&mut self, devices: &DeviceSnapshot, seen: Observation, out: &mut Vec<Action>) {
        let Some(robot) = devices.robot else { return };
        match self.place_sought(devices, &robot.q, &seen) {
            // One path at a time: heartbeats go out between them.
            Searched::NotYet => self.seen = Some(seen),
            Searched::Found(to, meant, paths) => {
                if let Some(recovery) = &mut self.back.recovery {
                    let why = recovery.search.take().and_then(|search| search.not_where_meant);
                    let elsewhere = (!meant).then(|| why.unwrap_or_default());
                    recovery.place = Some(Placing { to, elsewhere, up: paths.up });
                }
                out.push(Action::Robot(RobotCommand::Stream(paths.down)));
                self.enter(Phase::Recover(BackStage::Placing), self.model.tolerances.phase_deadline);
            }
            Searched::Nowhere(why) => {
                // Whoever tries again has made room: what is not seen now is not there then.
                self.back.table =
                    seen.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
                self.end_recovery(Err(why), out);
            }
        }
    }

    /// One step of the search for a place.
    fn place_sought(&mut self, devices: &DeviceSnapshot, q: &Joints, seen: &Observation) -> Searched {
        let below = self.back.recovery.as_ref().and_then(|recovery| recovery.below);
        let held = self.back.fell.is_none() && devices.gripper_holds;
        let Some(below) = below.filter(|_| held) else {
            return Searched::Nowhere("what is held is not held as it should".to_string());
        };
        let search = self.back.recovery.as_mut().and_then(|recovery| recovery.search.take());
        let mut search = match search.map_or_else(|| self.places_for_held(below, seen), Ok) {
            Ok(search) => search,
            Err(why) => return Searched::Nowhere(why),
        };
        let searched = self.try_place(self.clock(), q, seen, &mut search);
        if let Some(recovery) = &mut self.back.recovery {
            recovery.search = Some(search);
        }
        searched
    }

    /// The table was looked at on a way back.
    pub(crate) fn on_recovery_look(
        &mut self,
        now: Timestamp,
        observation: Observation,
        out: &mut Vec<Action>,
    ) {
        let observation = self.without_hidden(observation);
        if let Some(height) = foreign_height(&self.model, &observation) {
            self.foreign_height = height;
        }
        match self.rejection_on_the_way(&observation) {
            Some(rejection) => {
                let Reason { message, hint, .. } = rejection;
                self.end_recovery(
                    Err(format!(
                        "no free place can be seen: {message}; {hint}; for what is held, `celld recover \
                         --place` again"
                    )),
                    out,
                );
            }
            None => {
                self.seen = Some(observation);
                self.seen_at = now;
                if let Some(recovery) = &mut self.back.recovery {
                    recovery.search = None;
                }
            }
        }
    }

    /// The arm has followed its path on a way back.
    pub(crate) fn recovery_path_finished(
        &mut self,
        devices: &DeviceSnapshot,
        stage: BackStage,
        out: &mut Vec<Action>,
    ) {
        match stage {
            BackStage::Raising => {
                self.phase = Phase::Ready;
                let below = devices.robot.and_then(|robot| self.below(robot));
                if let Some(recovery) = &mut self.back.recovery {
                    (recovery.raised, recovery.below) = (true, below);
                }
            }
            BackStage::Placing => {
                let channels = Channels::Both;
                out.push(Action::Gripper(GripperCommand::Release { channels }));
                self.enter(Phase::Recover(BackStage::Releasing), self.model.tolerances.phase_deadline);
            }
            BackStage::Leaving => {
                let place = self.back.recovery.as_ref().and_then(|recovery| recovery.place.as_ref());
                let said = place.map_or_else(String::new, |place| {
                    let at = place_words(&place.to);
                    match &place.elsewhere {
                        Some(why) => format!("the object was put down at the nearest free place{at}: {why}"),
                        None => format!("the object was put down where it was to go{at}"),
                    }
                });
                self.end_recovery(Ok(said), out);
            }
            BackStage::Unlocking { .. } | BackStage::Releasing => {}
        }
    }

    /// The gripper reports on a way back.
    pub(crate) fn recovery_gripper(
        &mut self,
        now: Timestamp,
        stage: BackStage,
        event: &GripperEvent,
        out: &mut Vec<Action>,
    ) {
        let lost = |this: &mut Supervisor, code: Code, message: String, out: &mut Vec<Action>| {
            this.stop_all(now, JobStatus::Interrupted, code.because(message, ""), out);
        };
        match event {
            GripperEvent::Released if stage == BackStage::Releasing => {
                self.set_payload(0.0, out);
                let place = self.back.recovery.as_ref().and_then(|recovery| recovery.place.as_ref());
                if let Some(place) = place {
                    out.push(Action::Robot(RobotCommand::Stream(place.up.clone())));
                }
                self.enter(Phase::Recover(BackStage::Leaving), self.model.tolerances.phase_deadline);
            }
            GripperEvent::ReleaseFailed { vacuum } if stage == BackStage::Releasing => {
                let message =
                    format!("the vacuum does not fall: {:.0} % at the last reading", vacuum * 100.0);
                lost(self, Code::GripperUnreachable, message, out);
            }
            GripperEvent::Refused => {
                lost(self, Code::GripperUnreachable, "the gripper takes no order".to_string(), out);
            }
            GripperEvent::Unreachable { .. } => {
                lost(self, Code::GripperUnreachable, "gripper not responding".to_string(), out);
            }
            GripperEvent::Gripped { .. }
            | GripperEvent::GripFailed { .. }
            | GripperEvent::Released
            | GripperEvent::ReleaseFailed { .. }
            | GripperEvent::VacuumWeak { .. }
            | GripperEvent::VacuumLost { .. }
            | GripperEvent::Answering
            | GripperEvent::Reading { .. } => {}
        }
    }

    /// What is carried on a way back was lost, whatever the arm does at the moment: nothing is put down any
    /// more.
    pub(crate) fn lost_on_the_way(&mut self, now: Timestamp, event: &GripperEvent, out: &mut Vec<Action>) {
        let leaves = matches!(self.phase, Phase::Recover(BackStage::Leaving));
        if let GripperEvent::VacuumLost { vacuum } = event
            && self.back.recovery.is_some()
            && !leaves
        {
            let message = format!("what was held was lost on the way back: vacuum {:.0} %", vacuum * 100.0);
            let hint =
                "see where it lies, or whether it still hangs: `celld recover` says what the gripper reads";
            self.stop_all(now, JobStatus::Interrupted, Code::VacuumLost.because(message, hint), out);
        }
    }

    /// Ends a way back: the program ends, the cell is disarmed, and a person reads how it went.
    pub(crate) fn end_recovery(&mut self, result: Result<String, String>, out: &mut Vec<Action>) {
        if self.back.recovery.take().is_none() {
            return;
        }
        self.phase = self.after_bring_up();
        self.waiting_for = None;
        if self.mode.armed() {
            self.mode.disarm();
            out.push(Action::Robot(RobotCommand::EndProgram));
        }
        if result.is_ok() {
            (self.back.last_stop, self.back.error) = (None, None);
        }
        self.back.ended = Some(result.clone());
        match result {
            Ok(said) => alarm(out, format!("{said}; the cell is disarmed")),
            Err(why) => alarm(
                out,
                format!(
                    "the way back ended: {why}; the cell is disarmed, `celld recover` shows what is left"
                ),
            ),
        }
    }

    /// How far what is held may reach below the cups, m: what was held when celld started may be any object;
    /// 0 where nothing hangs.
    pub(crate) fn held_depth(&self) -> f64 {
        let depth = |held: &Held| held.grasp.as_ref().map_or(held.height, |grasp| grasp.load().depth());
        let unknown = if self.back.grips { self.model.cycle.tallest } else { 0.0 };
        self.back.held.as_ref().map_or(unknown, depth)
    }

    /// Height of what is held, m; 0 where nothing is known to be.
    pub(crate) fn held_height(&self) -> f64 {
        self.back.held.as_ref().map_or(0.0, |held| held.height)
    }

    /// Mass of what the vacuum holds, kg; what was let go counts no more.
    pub(crate) fn held_mass(&self) -> f64 {
        self.back.held.as_ref().filter(|held| !held.let_go).map_or(0.0, |held| held.mass)
    }
}

/// The arm is in a protective stop.
pub(crate) fn protective(devices: &DeviceSnapshot) -> bool {
    devices.robot.is_some_and(|robot| robot.safety_mode == SafetyMode::ProtectiveStop)
}
/// A place on the table, as what follows the name of it.
fn place_words(Pose2 { x, y, theta }: &Pose2) -> String {
    // Without the sign of what rounds to 0.
    let [x, y, degrees] = [x * 1e3, y * 1e3, theta.to_degrees()].map(|value| value.round() + 0.0);
    format!(" (x {x} mm, y {y} mm, {degrees} degrees)")
}
