//! What the operator may order, what each order does in which state of the cell, and what is answered.
//!
//! In: an order. Out: what changes, and a [`Reply`] made after the decision from the state that it led to.
//! An order that changes nothing says so.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::{Channels, GripperCommand, GripperEvent};
use crate::orders::{Approval, ConfirmedGripper, Order, Reply};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::{self, GateClosed, motion_speed};
use crate::supervisor::input::{Action, DeviceSnapshot, Record};
use crate::supervisor::mode::{Mode, Pace};
use crate::supervisor::phase::{Phase, Preview, Then, WorkStage};
use crate::supervisor::reason::say;
use cell_values::time::Timestamp;
use ur_wire::enumerations::{RobotMode, RuntimeState};

/// To `resume` while something else than celld's own pause holds the arm.
const PROGRAM_PAUSED: &str = "celld was not paused: the robot's program is paused, and celld never resumes it; `celld \
                              abort`, then `celld recover`";
const SLIDER_AT_ZERO: &str =
    "celld was not paused: the robot's speed slider is at zero; the motion goes on once it is raised";

impl Supervisor {
    /// Carries an order out; the refusal, if it is refused.
    pub(crate) fn take_order(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        order: &Order,
        out: &mut Vec<Action>,
    ) -> Option<Reply> {
        match order {
            Order::Arm => return self.on_arm(devices, out),
            Order::Disarm => self.on_disarm(now, devices, number, out),
            Order::Approve { id, plan } if *plan != self.plans => {
                return Some(self.another_plan(id));
            }
            Order::Approve { id, .. } => return self.on_verdict(now, id, true, out),
            Order::Reject(id) => return self.on_verdict(now, id, false, out),
            Order::Cancel(id) => return self.on_cancel(id),
            Order::Pause | Order::Step | Order::Park if self.has_no_pace().is_some() => {
                return self.has_no_pace();
            }
            Order::Pause => return self.on_pause(devices),
            Order::Resume if !self.mode.paused() && self.moving() && motion_speed(devices) == 0.0 => {
                let paused = devices.robot.is_none_or(|robot| robot.runtime_state != RuntimeState::Playing);
                return Some(Reply::refuse(if paused { PROGRAM_PAUSED } else { SLIDER_AT_ZERO }));
            }
            Order::Resume if self.mode.pauses_after_this_move() => {
                self.mode.set_pace(Pace::Running);
                return Some(Reply::accept("goes on: no pause follows this pick-n-place"));
            }
            Order::Resume if !self.mode.paused() => return Some(Reply::accept("nothing was paused")),
            Order::Resume => self.mode.set_pace(Pace::Running),
            Order::Step if !self.mode.armed() => return Some(self.not_armed(devices, "no step")),
            Order::Step => self.mode.set_pace(Pace::OneMove),
            Order::Park if !self.mode.armed() => return Some(self.not_armed(devices, "not parked")),
            Order::Park if self.is_parked(devices) && !self.moving() => {
                return Some(Reply::accept("the arm is at its park pose already"));
            }
            Order::Park => {
                self.mode.set_park(true);
                self.waiting_since = now;
            }
            Order::Abort => {
                self.on_abort(now, out);
                self.answer_when_it_stands(now, number, Then::Say);
            }
            Order::Release(channels) => self.on_release_order(now, devices, number, *channels, out),
            Order::Recover(way) => return self.on_recover(now, devices, number, *way, out),
            Order::ConfirmGripper => return Some(self.on_confirm_gripper(devices, out)),
            Order::Calibrate => return self.on_calibrate(now, devices),
        }
        None
    }

    /// A way back and a calibration round take no pace; they are ended.
    fn has_no_pace(&self) -> Option<Reply> {
        let what = match (self.back.recovery.is_some(), self.round.is_some()) {
            (true, _) => "way back",
            (false, true) => "calibration round",
            (false, false) => return None,
        };
        Some(Reply::refuse(format!("no: a {what} is under way; `celld abort` ends it")))
    }

    fn on_pause(&mut self, devices: &DeviceSnapshot) -> Option<Reply> {
        let parks = matches!(self.phase, Phase::Park);
        if self.mode.paused() && !parks {
            let said = match self.mode.parks() {
                true => "paused already; the arm is not parked any more",
                false => "paused already",
            };
            self.mode.set_park(false);
            return Some(Reply::accept(said));
        }
        self.mode.set_pace(Pace::Paused);
        if !parks {
            self.mode.set_park(false);
        }
        (!self.mode.paused()).then(|| self.not_armed(devices, "not paused, and nothing moves"))
    }

    pub(crate) fn not_armed(&self, devices: &DeviceSnapshot, what: &str) -> Reply {
        Reply::refuse(match &self.mode {
            Mode::Ending { .. } => format!("{what}: celld is ending"),
            Mode::Locked(reason) => format!("{what}: {reason}"),
            Mode::Disarmed { .. } | Mode::Armed { .. } => match self.may_arm(devices) {
                Ok(()) => format!("{what}: the cell is disarmed; `celld arm` first"),
                Err(closed) => {
                    let why = self.place(&closed);
                    format!("{what}: the cell is disarmed, and cannot be armed now: {why}; {}", closed.hint())
                }
            },
        })
    }

    /// What a person has ordered for safe access and that is not over yet.
    pub(crate) fn under_way(&self, devices: &DeviceSnapshot) -> Option<&'static str> {
        if self.stopping(devices) {
            Some("a stop is under way, and the arm is not known to stand yet")
        } else if !self.release_orders.is_empty() {
            Some("a release is under way, and the gripper has not confirmed it yet")
        } else {
            None
        }
    }

    fn on_arm(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) -> Option<Reply> {
        if let Some(refusal) = self.arm_refusal(devices) {
            return Some(Reply::refuse(refusal));
        }
        if self.mode.armed() {
            return Some(Reply::accept("armed already"));
        }
        self.mode.arm();
        say(out, "armed");
        self.armed_now(devices, out);
        None
    }

    /// Why an order to arm is refused now, as it is answered; `None` where it is not.
    pub(crate) fn arm_refusal(&self, devices: &DeviceSnapshot) -> Option<String> {
        if self.back.recovery.is_some() {
            let why = "not armed: a way back is under way, and the arm may move; `celld abort` stops it";
            return Some(why.to_string());
        }
        match &self.mode {
            Mode::Armed { .. } => None,
            Mode::Locked(reason) => Some(format!("not armed: {reason}")),
            Mode::Ending { .. } => Some("not armed: celld is ending".to_string()),
            Mode::Disarmed { .. } => match self.under_way(devices) {
                Some(why) => Some(format!("not armed: {why}; try again")),
                None => self.may_arm(devices).err().map(|closed| match (&closed, &self.phase) {
                    // It holds what it is to hold.
                    (GateClosed::Holding | GateClosed::MayHang(_), Phase::Work(_)) => {
                        "not armed: the pick-n-place under way is finished first; then `celld arm`"
                            .to_string()
                    }
                    _ => self.not_armed_for(&closed),
                }),
            },
        }
    }

    /// The cell has just been armed. The person who arms has been at the table: what was on it may be gone,
    /// and only a look can show it; a plan that is being made rests on what was there.
    pub(crate) fn armed_now(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        self.arms_when_open = false;
        self.note_power(devices);
        (self.back.fell, self.back.last_stop, self.back.error) = (None, None, None);
        self.back.weak = None;
        self.seen = None;
        self.job.iter_mut().for_each(|job| job.gone.clear());
        self.foreign_height = 0.0;
        self.drift_reported = false;
        self.preview_over();
        if matches!(self.phase, Phase::Plan) {
            self.phase = Phase::Ready;
        }
        // At once: a person has to see what comes of the order, not minutes later.
        let off =
            devices.robot.is_some_and(|r| matches!(r.robot_mode, RobotMode::PowerOff | RobotMode::Idle));
        if off && matches!(self.phase, Phase::Ready | Phase::Approve) {
            self.begin_bring_up(devices, out);
        }
    }

    /// What is missing, and what to do before the next try.
    fn not_armed_for(&self, closed: &GateClosed) -> String {
        if let Some(taken) = self.taken_from(closed) {
            return format!("not armed: {taken}, then `celld arm`");
        }
        let hint = closed.hint();
        let again = if hint.contains("celld arm") { "" } else { "; then `celld arm`" };
        format!("not armed: {}; {hint}{again}", self.place(closed))
    }

    /// What a person does before an arming that this gate refuses.
    pub(crate) fn before_arming(&self, closed: &GateClosed) -> String {
        self.taken_from(closed).unwrap_or_else(|| closed.hint_before_arming().to_string())
    }

    /// The robot sends no state to a client that waits for inputs which another one has.
    fn taken_from(&self, closed: &GateClosed) -> Option<String> {
        let taken = self.registers_taken().filter(|_| *closed == GateClosed::Stale)?;
        Some(format!("{taken}; end it or take the registers from it"))
    }

    /// A pick-n-place under way is finished, then nothing moves; the person who disarms may put hands on the
    /// table. What is held in the middle of a motion does not go on by itself later: it is stopped. So is a
    /// robot that is being started: power, brakes and program would come after the answer.
    fn on_disarm(&mut self, now: Timestamp, devices: &DeviceSnapshot, number: u64, out: &mut Vec<Action>) {
        let held = self.moving() && motion_speed(devices) == 0.0;
        if held || self.round.is_some() || self.back.recovery.is_some() {
            let what = match (held, self.round.is_some()) {
                (true, _) => "while the arm was held",
                (false, true) => "in a calibration round",
                (false, false) => "on a way back",
            };
            let reason = Code::Aborted.because(format!("the operator disarmed the cell {what}"), "");
            self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
            return self.answer_when_it_stands(now, number, Then::Say);
        }
        let goes_on = self.disarm_after_this_motion(now, devices, out);
        if self.stopping(devices) {
            self.answer_when_it_stands(now, number, Then::Say);
        }
        say(
            out,
            if goes_on {
                "disarmed; what is under way is finished first, `celld abort` stops it now"
            } else {
                "disarmed"
            },
        );
    }

    /// Disarms; a robot that is being started is stopped, and so is a way to a look pose or to the park pose
    /// on which the arm has not set out. True while a motion under way is finished first.
    pub(crate) fn disarm_after_this_motion(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) -> bool {
        let rests = devices.robot.is_some_and(|robot| devices.robot_fresh && robot.stands_still());
        let travels = matches!(self.phase, Phase::Look(_) | Phase::Park) && self.follows_a_path();
        let not_set_out = travels && rests;
        if not_set_out || matches!(self.phase, Phase::BringUp(_)) {
            self.stop_robot(out);
        }
        self.mode.disarm();
        self.arms_when_open = false;
        self.note_power(devices);
        self.seen = None;
        let begun = match &self.phase {
            Phase::BringUp(_) => false,
            Phase::Work(work) => !matches!(work.stage, WorkStage::NotingIntent(_)),
            Phase::Ready
            | Phase::Look(_)
            | Phase::Plan
            | Phase::Approve
            | Phase::Park
            | Phase::Visit(_)
            | Phase::Recover(_) => self.follows_a_path() && !not_set_out,
        };
        match &mut self.phase {
            Phase::Park if !begun => self.phase = Phase::Ready,
            Phase::BringUp(_) => self.phase = self.after_bring_up(),
            Phase::Work(_) if !begun => self.not_begun(now, out),
            Phase::Look(_) if !begun => self.phase = Phase::Ready,
            Phase::Look(look) => look.void = true,
            Phase::Ready
            | Phase::Plan
            | Phase::Approve
            | Phase::Work(_)
            | Phase::Park
            | Phase::Visit(_)
            | Phase::Recover(_) => {}
        }
        begun
    }

    /// What a person agrees to is not what waits.
    fn another_plan(&self, id: &str) -> Reply {
        if self.job.as_ref().is_none_or(|job| job.order.id != id) {
            return self.not_active(id);
        }
        Reply::refuse("not approved: the plan has changed since it was shown; look at the new one")
    }

    /// A person has seen the plan.
    fn on_verdict(
        &mut self,
        now: Timestamp,
        id: &str,
        approved: bool,
        out: &mut Vec<Action>,
    ) -> Option<Reply> {
        if self.job.as_ref().is_none_or(|job| job.order.id != id) {
            return Some(self.not_active(id));
        }
        let preview = self.preview_waits();
        if !preview && !matches!(self.phase, Phase::Approve) {
            return Some(Reply::refuse(format!("job {id} does not wait for approval")));
        }
        if let Some(job) = self.job.as_mut().filter(|_| approved) {
            // A preview is no plan that may be carried out: the one that is made after the look is compared.
            job.approved = !preview || job.order.approval == Approval::Job;
            job.order.agreed = match (&job.preview, &job.route) {
                (Some(Preview::Made(route)), _) if preview => route.clone(),
                (_, route) => route.clone().unwrap_or_default(),
            };
        }
        self.phase = Phase::Ready;
        if approved {
            self.commit(now, Record::Approved, out);
        } else {
            self.finish(
                now,
                JobStatus::Cancelled,
                Code::PlanRejected.because("the plan was rejected", ""),
                out,
            );
        }
        None
    }

    /// Once for each gripper: nothing that could be read from the device proves that it is on this arm.
    fn on_confirm_gripper(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) -> Reply {
        let address = &self.model.addresses.gripper;
        let Some(identity) = devices.gripper_identity.filter(|_| devices.gripper_answers) else {
            let closed = match devices.gripper_answers {
                true => GateClosed::GripperUnknown,
                false => GateClosed::Gripper(devices.gripper_fault),
            };
            return Reply::refuse(format!("not confirmed: {}; {}", self.place(&closed), closed.hint()));
        };
        let confirmed = ConfirmedGripper::of(&identity);
        if gates::confirmed(&self.model.confirmed, Some(&identity)).is_ok() {
            let reply = Reply::accept(format!("confirmed already: the gripper is at {address}"));
            // The disk may have been full before. Of a simulated gripper nothing is remembered.
            let needed = self.model.confirmed != ConfirmedGripper::NotNeeded;
            return Reply { confirmed: needed.then_some(confirmed), ..reply };
        }
        let reply = Reply::accept(match &confirmed {
            ConfirmedGripper::Serial(serial) => {
                format!("confirmed: the gripper with serial number {serial} is at {address}")
            }
            _ => format!("confirmed: the gripper is at {address}"),
        });
        say(out, reply.message.clone());
        self.model.confirmed = confirmed.clone();
        Reply { confirmed: Some(confirmed), ..reply }
    }

    fn not_active(&self, id: &str) -> Reply {
        Reply::refuse(match &self.job {
            Some(job) => format!("job {id} is not the active one; job {} is under way", job.order.id),
            None => format!("job {id} is not the active one: there is none"),
        })
    }

    fn on_cancel(&mut self, id: &str) -> Option<Reply> {
        match &mut self.job {
            Some(job) if job.order.id == id => job.cancel = true,
            Some(_) | None => return Some(self.not_active(id)),
        }
        if matches!(self.phase, Phase::Plan | Phase::Approve) {
            self.phase = Phase::Ready;
        }
        None
    }

    /// What is let go in motion flies, and a carry must not go on without its object: the arm is stopped
    /// first. The person who orders it has hands at the gripper: an armed cell, which could begin a motion
    /// at any time, is stopped and disarmed.
    pub(crate) fn on_release_order(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        channels: Channels,
        out: &mut Vec<Action>,
    ) {
        self.seen = None;
        self.arms_when_open = false;
        self.note_power(devices);
        if self.moving() || self.mode.armed() || self.back.recovery.is_some() {
            let reason = Code::Released.because(
                "the operator releases the vacuum",
                "if something was held, see where it lies; then `celld arm` and submit again",
            );
            self.stop_all(now, JobStatus::Interrupted, reason, out);
        } else if self.arm_stands(devices) || (self.stands && !devices.robot_fresh) {
            return self.release(number, channels, out);
        }
        self.answer_when_it_stands(now, number, Then::Release(channels));
    }

    /// Switches the vacuum off; the answer is what the gripper says.
    pub(crate) fn release(&mut self, number: u64, channels: Channels, out: &mut Vec<Action>) {
        self.release_orders.push((number, channels));
        say(out, format!("vacuum off by the operator's order, {channels}"));
        out.push(Action::Gripper(GripperCommand::Release { channels }));
    }

    /// The gripper's word on the releases that a person ordered; an event that is none leaves them waiting.
    pub(crate) fn answer_release(&mut self, event: &GripperEvent, out: &mut Vec<Action>) {
        let reply = |channels: Channels| match event {
            GripperEvent::Released => Some(Reply::accept(match channels {
                Channels::Both => "vacuum off; the cell is disarmed".to_string(),
                one => format!("vacuum off, {one} only; the cell is disarmed"),
            })),
            GripperEvent::ReleaseFailed { vacuum } => Some(Reply::refuse(format!(
                "not released: the vacuum was {:.0} % at the last reading; the object may still be held, \
                 see the gripper",
                vacuum * 100.0
            ))),
            GripperEvent::Refused => Some(Reply::refuse("the gripper takes no order: it does not answer")),
            GripperEvent::Gripped { .. }
            | GripperEvent::GripFailed { .. }
            | GripperEvent::VacuumWeak { .. }
            | GripperEvent::VacuumLost { .. }
            | GripperEvent::Unreachable { .. }
            | GripperEvent::Answering
            | GripperEvent::Reading { .. } => None,
        };
        for (number, channels) in std::mem::take(&mut self.release_orders) {
            match reply(channels) {
                Some(reply) => out.push(Action::Reply { number, reply }),
                None => self.release_orders.push((number, channels)),
            }
        }
    }
}
