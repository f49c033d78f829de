//! What interrupts the cell: safety stops, lost links, ended programs, deadlines, the operator's stop, the
//! disk, shutdown.
//!
//! One rule: the arm is stopped first, the vacuum stays as it is, the job gets a named end, the cell is
//! disarmed, and nothing continues until a person has armed it and the table has been seen again.

use crate::code::{Code, JobStatus};
use crate::device::robot_types::{RobotCommand, RobotEvent};
use crate::supervisor::back::{BackStage, LastStop};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::motion_speed;
use crate::supervisor::input::{Action, CameraFault, DeviceSnapshot};
use crate::supervisor::ledger::{Disk, SILENT_AFTER};
use crate::supervisor::mode::{EndFault, Mode};
use crate::supervisor::phase::{LookStage, Phase, Visit, Work, WorkStage};
use crate::supervisor::reason::{Reason, STOP_ORDERED, alarm, say};
use crate::supervisor::round::RoundFault;
use cell_values::time::{Duration, Timestamp};

/// After this long a held motion is given up: what happened on the table meanwhile is unknown.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// Reports that come within this time after a stop are about the same.
const SAME_STOP: Duration = Duration::from_secs(5);

/// How long the arm may take to stop after the order to end.
const STOP_WITHIN: Duration = Duration::from_secs(3);

/// The way on with a journal that cannot be used.
const REPAIR_HINT: &str = "stop celld, then `celld journal repair`, then start celld again";

/// How long the end waits for the gripper's word on a release that a person ordered.
const RELEASE_WITHIN: Duration = Duration::from_secs(6);

impl Supervisor {
    /// Runs on every tick: settling, bring-up, deadlines, the disk, and the robot's state while something
    /// moves.
    pub(crate) fn watch(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        self.watch_disk(now, out);
        self.watch_end(now, devices, out);
        self.watch_settling(now, devices, out);
        self.watch_visit(now, devices, out);
        self.watch_unlocking(now, devices, out);
        self.arm_when_open(devices, out);
        self.note_power(devices);
        self.bring_up(devices, out);
        if let Some(reason) = self.motion_reason(now, devices).filter(|_| self.moving()) {
            return self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        }
        let held = self.held_for(now, devices);
        if held > Duration::ZERO && !self.mode.armed() {
            let message = "the arm was held after the cell was disarmed: it does not go on by itself later";
            let reason = Code::Aborted.because(message, "");
            return self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        }
        if held > LONGEST_PAUSE {
            let reason = self.held_too_long(devices);
            return self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        }
        self.watch_arming(now, devices, out);
        if self.remaining.is_zero() {
            self.on_deadline(now, out);
        }
    }

    fn arm_when_open(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let open = self.arms_when_open && self.under_way(devices).is_none() && self.may_arm(devices).is_ok();
        if open && matches!(self.mode, Mode::Disarmed { .. }) {
            say(out, "armed at start, as configured for the simulation");
            self.mode.arm();
            self.armed_now(devices, out);
        }
    }

    fn watch_disk(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        match self.ledger.judge(now) {
            Disk::Fine => {}
            Disk::Slow => alarm(
                out,
                "the state folder's disk has been writing an entry for 1 s; no motion begins before it is \
                 written",
            ),
            Disk::Silent => self.on_store_lost(now, EndFault::Silent(SILENT_AFTER.as_secs()), out),
        }
    }

    /// The daemon may end when the arm is at rest, the gripper has confirmed what was ordered and everything
    /// is written; and when that was waited for long enough.
    fn watch_end(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Mode::Ending { since, fault } = &self.mode else { return };
        let stands = self.stands || devices.robot.is_none() || now.since(*since) >= STOP_WITHIN;
        let written = self.ledger.is_clear() || fault.is_some();
        let released = self.release_orders.is_empty() || now.since(*since) >= RELEASE_WITHIN;
        if stands && written && released && !self.ended {
            let end = fault.clone().map_or(Ok(()), Err);
            self.ended = true;
            self.answer_at_the_end(devices, out);
            out.push(Action::End(end));
        }
    }

    /// How long the arm has been held in the middle of a motion, by pause or by a slider at zero.
    fn held_for(&mut self, now: Timestamp, devices: &DeviceSnapshot) -> Duration {
        let held = self.moving() && motion_speed(devices) == 0.0;
        self.held_since = if held { self.held_since.or(Some(now)) } else { None };
        self.held_since.map_or(Duration::ZERO, |since| now.since(since))
    }

    /// True while the arm may be in motion or an object may hang on it.
    pub(crate) fn moving(&self) -> bool {
        match self.phase {
            Phase::Look(_) | Phase::Work(_) | Phase::Park | Phase::Visit(_) => true,
            Phase::Recover(stage) => !matches!(stage, BackStage::Unlocking { .. }),
            Phase::Ready | Phase::BringUp(_) | Phase::Plan | Phase::Approve => false,
        }
    }

    fn on_deadline(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        if let Phase::Look(look) = &self.phase {
            let silent = || CameraFault {
                code: Code::CameraUnplugged,
                message: "the camera gave no picture in the time of a look".to_string(),
                hint: "look at the camera's cable and power, submit again".into(),
                lasting: false,
            };
            let capturing = matches!(look.stage, LookStage::Capturing { .. });
            if let Some(fault) = look.fault.clone().or_else(|| capturing.then(silent)) {
                return self.give_up_looking(now, &fault, out);
            }
        }
        let (code, message) = match &self.phase {
            Phase::Ready | Phase::Approve => return,
            Phase::BringUp(bring_up) => {
                let late = || "the robot did not come up in time".to_string();
                (Code::RobotNotStarted, bring_up.rest.restless(now).unwrap_or_else(late))
            }
            Phase::Look(look) => {
                let restless = match &look.stage {
                    LookStage::Settling { rest } => rest.restless(now),
                    LookStage::Moving | LookStage::Capturing { .. } | LookStage::Observing => None,
                };
                let late = || "the look was not finished in time".to_string();
                (Code::LookTimeout, restless.unwrap_or_else(late))
            }
            Phase::Plan => (Code::PlannerStuck, "the planner did not answer within its budget".to_string()),
            Phase::Work(work) => {
                (Code::WorkTimeout, format!("{} {} took too long", work.stage.step().as_str(), work.object))
            }
            Phase::Park => (Code::ParkTimeout, "the park pose was not reached in time".to_string()),
            Phase::Recover(stage) => {
                (Code::WorkTimeout, format!("the way back took too long: {}", stage.words()))
            }
            Phase::Visit(visit) => {
                let restless = match visit {
                    Visit::Settling { rest } => rest.restless(now),
                    Visit::Moving | Visit::Picturing => None,
                };
                let late = || "the calibration pose was not reached in time".to_string();
                (Code::WorkTimeout, restless.unwrap_or_else(late))
            }
        };
        self.stop_what_has_begun(now, JobStatus::Failed, code.because(message, ""), out);
    }

    /// Everything the robot reports besides a finished path.
    pub(crate) fn robot_fault_reason(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        event: RobotEvent,
        out: &mut Vec<Action>,
    ) {
        match event {
            RobotEvent::ProgramRunning { .. } => return self.bring_up(devices, out),
            RobotEvent::Paused if self.moving() => {
                let seconds = LONGEST_PAUSE.as_secs();
                return alarm(
                    out,
                    format!(
                        "the program is paused in the middle of a motion: `celld abort`, then \
                         `celld recover`; the motion goes on if the program is resumed within {seconds} s"
                    ),
                );
            }
            RobotEvent::Paused
            | RobotEvent::RtdeReady
            | RobotEvent::RtdeLost
            | RobotEvent::Identity { .. }
            | RobotEvent::Kinematics { .. }
            | RobotEvent::SafetyChecksum { .. }
            | RobotEvent::RemoteControl { .. }
            | RobotEvent::ProgramEnded { .. }
            | RobotEvent::SegmentFinished { .. }
            | RobotEvent::PathFinished { .. }
            | RobotEvent::PayloadSet
            | RobotEvent::TcpSet
            | RobotEvent::Stopped
            | RobotEvent::Resumed
            | RobotEvent::Safety { .. }
            | RobotEvent::Mode { .. }
            | RobotEvent::Completed { .. }
            | RobotEvent::Refused { .. }
            | RobotEvent::InputInUse { .. }
            | RobotEvent::RuntimeException { .. }
            | RobotEvent::ErrorCode { .. }
            | RobotEvent::Message { .. }
            | RobotEvent::LinkSilent { .. }
            | RobotEvent::ArmStalled { .. }
            | RobotEvent::JointJump { .. }
            | RobotEvent::ProtocolFault { .. } => {}
        }
        self.note_for_the_way_back(now, &event);
        let Some(reason) = self.fault_of(devices, event) else { return };
        // Nobody can say of an arm whose position jumps that it rests.
        let jumped = reason.code == Code::JointJump && self.mode.armed();
        let moves = jumped || self.moving() || matches!(self.phase, Phase::BringUp(_));
        if reason.code == Code::HeartbeatLost {
            self.interrupt(now, reason, out);
        } else if moves {
            self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        } else {
            self.stand_down(now, reason, out);
        }
    }

    /// Something happened to the robot while nothing moved: people who were in the cell since then have to
    /// arm it again before it moves.
    pub(crate) fn stand_down(&mut self, now: Timestamp, reason: Reason, out: &mut Vec<Action>) {
        self.seen = None;
        self.mode.set_park(false);
        let locked = matches!(self.mode, Mode::Locked(_));
        if !self.mode.armed() && !locked {
            self.end_recovery(Err(reason.message.clone()), out);
            // What follows a stop at once is its consequence; what comes later is another.
            let follows = |stop: &LastStop| stop.at.is_some_and(|at| now.since(at) < SAME_STOP);
            if !self.mode.ending() && !self.back.last_stop.as_ref().is_some_and(follows) {
                let (reason, job) = (reason.clone(), None);
                self.back.last_stop = Some(LastStop { at: Some(now), reason, job, keeps_job: false });
            }
            return say(out, reason.message);
        }
        self.mode.disarm();
        self.phase = Phase::Ready;
        let waits = self.job_waits_for_a_round();
        let reason = self.with_a_hint(reason, waits);
        alarm(out, format!("disarmed: {}; {}", reason.message, reason.hint));
        self.end_what_moves(now, &reason, out);
        if !waits {
            self.finish(now, JobStatus::Interrupted, reason, out);
        }
    }

    pub(crate) fn on_abort(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let message = match self.back.last_stop.as_ref().filter(|stop| stop.keeps_job && self.job.is_some()) {
            // Of a job that a stop had left, that stop is what a person looks for later.
            Some(stop) => format!("the operator stopped the cell; before that, {}", stop.reason.message),
            None => "the operator stopped the cell".to_string(),
        };
        // Where nothing was left to stop, the stop before stays what is to be left.
        let before = if self.rests_disarmed() { self.back.last_stop.take() } else { None };
        self.stop_all(now, JobStatus::Interrupted, Code::Aborted.because(message, ""), out);
        if before.is_some() {
            self.back.last_stop = before;
        }
    }

    /// No job, nothing under way, and the arm is known to be at rest.
    fn rests_disarmed(&self) -> bool {
        let quiet = self.job.is_none() && self.round.is_none() && self.back.recovery.is_none();
        let rests = matches!(self.phase, Phase::Ready) && self.stands && self.arm_settled;
        quiet && rests && !self.mode.armed()
    }

    pub(crate) fn on_shutdown(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let reason = Code::Shutdown.because("a person ended celld", "");
        // A stop that is still to be left is what the last status has to say, not the end that followed it.
        let before = self.back.last_stop.take().map(|stop| match stop.keeps_job {
            // The job that would have gone on ends here.
            true => {
                let hint = format!("{}; {}", stop.reason.hint, self.then_with(false));
                LastStop { keeps_job: false, reason: Reason { hint, ..stop.reason }, ..stop }
            }
            false => stop,
        });
        self.stop_all(now, JobStatus::Interrupted, reason, out);
        self.back.last_stop = before.or(self.back.last_stop.take());
        if !self.mode.ending() {
            self.mode = Mode::Ending { since: now, fault: None };
        }
    }

    /// Nothing can be written any more: without the journal no motion may be ordered.
    pub(crate) fn on_store_lost(&mut self, now: Timestamp, fault: EndFault, out: &mut Vec<Action>) {
        if matches!(self.mode, Mode::Ending { fault: Some(_), .. }) || self.ledger.is_given_up() {
            return;
        }
        if let EndFault::Damaged(what) = fault {
            // celld keeps running: it watches a held object, and the page shows why nothing moves.
            self.ledger.give_up();
            let reason = Code::JournalFailed.because(what, REPAIR_HINT);
            let locked = format!("{}; {REPAIR_HINT}", reason.message);
            self.stop_all(now, JobStatus::Interrupted, reason, out);
            return self.mode.lock(locked);
        }
        let reason = Code::JournalFailed.because(fault.to_string(), "check the disk, then start celld again");
        self.stop_all(now, JobStatus::Interrupted, reason, out);
        self.mode = Mode::Ending { since: now, fault: Some(fault) };
    }

    /// A record is on disk, or could not be written.
    pub(crate) fn on_committed(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        result: Result<(), String>,
        out: &mut Vec<Action>,
    ) {
        self.ledger.close(number);
        match result {
            Ok(()) => self.work_noted(now, devices, number, out),
            Err(cause) => self.on_store_lost(now, EndFault::Journal(cause), out),
        }
    }

    /// Stops the arm and takes back what was wanted of power, brakes and program.
    pub(crate) fn stop_robot(&mut self, out: &mut Vec<Action>) {
        out.push(Action::Robot(RobotCommand::Stop));
        self.stands = !self.robot_seen;
        // The program ends or is stopped; its number in the registers proves nothing any more.
        self.nonce = None;
    }

    /// A reason without a hint gets what always holds after a stop; `waits`: a job goes on waiting after it.
    fn with_a_hint(&self, reason: Reason, waits: bool) -> Reason {
        let general = || format!("see that the cell is safe; {}", self.then_with(waits));
        let hint = if reason.hint.is_empty() { general() } else { reason.hint.clone() };
        Reason { hint, ..reason }
    }

    fn stop_and_disarm(&mut self, out: &mut Vec<Action>) {
        self.stop_robot(out);
        self.phase = Phase::Ready;
        self.seen = None;
        self.mode.disarm();
        self.arms_when_open = false;
    }

    /// Stops the arm, keeps the vacuum, ends the job, disarms.
    pub(crate) fn stop_all(&mut self, now: Timestamp, end: JobStatus, reason: Reason, out: &mut Vec<Action>) {
        let reason = self.stop_what_moves(now, reason, false, out);
        self.finish(now, end, reason, out);
    }

    /// The same, but for a job that came during a calibration round: it has not begun, and waits.
    pub(crate) fn stop_what_has_begun(
        &mut self,
        now: Timestamp,
        end: JobStatus,
        reason: Reason,
        out: &mut Vec<Action>,
    ) {
        let waits = self.job_waits_for_a_round();
        let reason = self.stop_what_moves(now, reason, waits, out);
        if !waits {
            self.finish(now, end, reason, out);
        }
    }

    /// Stops the arm and disarms; the reason with its hint.
    fn stop_what_moves(
        &mut self,
        now: Timestamp,
        reason: Reason,
        waits: bool,
        out: &mut Vec<Action>,
    ) -> Reason {
        self.stop_and_disarm(out);
        let reason = self.with_a_hint(reason, waits);
        alarm(out, format!("{STOP_ORDERED}: {}; {}", reason.message, reason.hint));
        self.end_what_moves(now, &reason, out);
        reason
    }

    /// A job came during a calibration round: it has not begun.
    pub(crate) fn job_waits_for_a_round(&self) -> bool {
        self.round.is_some() && self.job.is_some()
    }

    /// The job may go on after an object that was lost or a heartbeat that was missed.
    pub(crate) fn job_outlives_a_stop(&self) -> bool {
        let limit = self.model.tolerances.stop_retries;
        self.job.as_ref().is_some_and(|job| job.stops < limit && !job.cancel)
    }

    /// Stops the arm, keeps the vacuum and the job, disarms: the job goes on with a new look and a new plan
    /// once a person has armed the cell. The arm does not go on by itself.
    pub(crate) fn stop_and_keep_the_job(&mut self, now: Timestamp, reason: Reason, out: &mut Vec<Action>) {
        let placed = |work: &Work| work.stage == WorkStage::Retreating && !work.over;
        if matches!(&self.phase, Phase::Work(work) if placed(work)) {
            self.note_done(now, out);
        }
        self.stop_and_disarm(out);
        self.withdraw_meant(now, out);
        let Some(job) = &mut self.job else { return };
        job.stops += 1;
        let (stops, limit) = (job.stops, self.model.tolerances.stop_retries);
        let id = Some(job.order.id.clone());
        let stop = LastStop { at: Some(now), reason: reason.clone(), job: id, keeps_job: true };
        let hint = self.stop_hint(&stop);
        alarm(out, format!("{STOP_ORDERED}: {}; {hint} (stop {stops} of {limit})", reason.message));
        self.end_what_moves(now, &reason, out);
        self.back.last_stop = Some(stop);
    }

    /// What to do about a stop, as it is now: the job that it left may have been cancelled since.
    pub(crate) fn stop_hint(&self, stop: &LastStop) -> String {
        let first = &stop.reason.hint;
        match &self.job {
            _ if !stop.keeps_job => first.clone(),
            None => format!("{first}; {}", self.then()),
            Some(job) => {
                let held = if self.may_be_held() { self.then() } else { "" };
                let then = if held.is_empty() { "" } else { "; " };
                let id = &job.order.id;
                format!("{first}{then}{held}; `celld arm` has job {id} look, plan anew and go on")
            }
        }
    }

    /// A round or a way back ends with a stop, which is remembered for `celld recover`.
    fn end_what_moves(&mut self, now: Timestamp, reason: &Reason, out: &mut Vec<Action>) {
        let job = self.job.as_ref().filter(|_| !self.job_waits_for_a_round());
        let (reason_kept, job) = (reason.clone(), job.map(|job| job.order.id.clone()));
        self.back.last_stop = Some(LastStop { at: Some(now), reason: reason_kept, job, keeps_job: false });
        self.end_round(Err(RoundFault::Robot(reason.message.clone())), out);
        self.end_recovery(Err(reason.message.clone()), out);
    }
}
