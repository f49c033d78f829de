//! Between a closed gate and the first motion: waiting with a bound, powering the arm, starting the on-robot
//! program.

use crate::code::{Code, JobStatus};
use crate::device::program::Nonce;
use crate::device::robot_types::RobotCommand;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::GateClosed;
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::mode::Mode;
use crate::supervisor::phase::{BringUp, JobRun, Phase};
use crate::supervisor::reason::{alarm, say};
use crate::supervisor::round::RoundFault;
use cell_values::time::{Duration, Timestamp};
use ur_arm::pose::ur_pose_from_isometry;
use ur_wire::enumerations::RobotMode;

/// How long a closed gate, other than a disarmed cell, may hold up a job before it fails.
const NOT_READY_LIMIT: Duration = Duration::from_secs(60);

/// How long powering up or starting the program may take.
const BRING_UP_LIMIT: Duration = Duration::from_secs(30);

impl Supervisor {
    /// The robot is not ready to move: bring it up if that is what is missing, else wait, but not for ever.
    pub(crate) fn wait_or_bring_up(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        closed: GateClosed,
        out: &mut Vec<Action>,
    ) {
        if self.power_was_switched(devices) {
            // Arming lapses on the next tick.
            return;
        }
        let can_start = self.mode.armed()
            && devices.robot_fresh
            && devices.robot.is_some_and(|robot| robot.remote_control == Some(true));
        if can_start && opens_by_bring_up(&closed) {
            return self.begin_bring_up(devices, out);
        }
        self.wait(now, closed, out);
    }

    pub(crate) fn begin_bring_up(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        self.enter(Phase::BringUp(BringUp::default()), BRING_UP_LIMIT);
        self.bring_up(devices, out);
    }

    /// Where the cell is once the robot is up, or is not wanted any more: a plan that waited for a person
    /// waits on.
    pub(crate) fn after_bring_up(&self) -> Phase {
        let waits = |job: &JobRun| job.route.is_some() && !job.approved && !job.cancel;
        if self.back.recovery.is_none() && self.job.as_ref().is_some_and(waits) {
            Phase::Approve
        } else {
            Phase::Ready
        }
    }

    /// What keeps a gate closed, with the address of the device that is to blame.
    pub(crate) fn place(&self, closed: &GateClosed) -> String {
        match closed {
            GateClosed::Link(_) | GateClosed::Stale => format!("{closed} ({})", self.model.addresses.robot),
            GateClosed::Gripper(_)
            | GateClosed::GripperUnknown
            | GateClosed::GripperUnconfirmed
            | GateClosed::GripperByAddress
            | GateClosed::GripperOther => {
                format!("{closed} ({})", self.model.addresses.gripper)
            }
            GateClosed::Safety(_)
            | GateClosed::Mode(_)
            | GateClosed::Guided
            | GateClosed::Local
            | GateClosed::Program
            | GateClosed::Paused
            | GateClosed::NotPlaying(_)
            | GateClosed::Orders(_)
            | GateClosed::Disarmed
            | GateClosed::Locked(_)
            | GateClosed::Holding
            | GateClosed::MayHang(_)
            | GateClosed::NotObserved
            | GateClosed::NotApproved => closed.to_string(),
        }
    }

    /// Why the cell cannot be armed any more, if it is locked.
    pub(crate) fn locked(&self) -> Option<GateClosed> {
        match &self.mode {
            Mode::Locked(reason) => Some(GateClosed::Locked(reason.clone())),
            Mode::Disarmed { .. } | Mode::Armed { .. } | Mode::Ending { .. } => None,
        }
    }

    /// Waits for a gate to open; not for ever, unless a person has to arm the cell.
    pub(crate) fn wait(&mut self, now: Timestamp, closed: GateClosed, out: &mut Vec<Action>) {
        let closed = match self.locked() {
            Some(locked) if closed == GateClosed::Disarmed => locked,
            _ => closed,
        };
        let kind = std::mem::discriminant(&closed);
        if self.waiting_for.as_ref().map(std::mem::discriminant) != Some(kind) {
            say(out, format!("waiting: {}; {}", self.place(&closed), closed.hint()));
            self.waiting_since = now;
        }
        let (message, hint) = (self.place(&closed), closed.hint());
        let patient = matches!(closed, GateClosed::Disarmed | GateClosed::Locked(_));
        self.waiting_for = Some(closed);
        if !patient && now.since(self.waiting_since) > NOT_READY_LIMIT {
            // No person shall be surprised by a cell that comes to life when its device does.
            self.mode.disarm();
            alarm(out, format!("disarmed: {message} for {} s", NOT_READY_LIMIT.as_secs()));
            let (seconds, waits) = (NOT_READY_LIMIT.as_secs(), self.job_waits_for_a_round());
            self.end_round(Err(RoundFault::NotReady { what: message.clone(), seconds }), out);
            if self.back.recovery.is_some() {
                return self.end_recovery(Err(format!("{message} for {seconds} s")), out);
            }
            if waits {
                return;
            }
            let hint = match hint.contains("celld arm") {
                true => format!("{hint} and submit again"),
                false => format!("{hint}; then `celld arm` and submit again"),
            };
            self.finish(now, JobStatus::Failed, Code::NotReady.because(message, hint), out);
        }
    }

    /// One turn of the bring-up: requests what is missing, once.
    pub(crate) fn bring_up(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let switched_off = self.power_was_switched(devices);
        let (Phase::BringUp(bring_up), Some(robot)) = (&mut self.phase, devices.robot) else { return };
        if !self.mode.armed() {
            self.phase = self.after_bring_up();
            return;
        }
        if switched_off {
            // By a person. Arming lapses on the next tick; celld does not switch the power on again.
            return;
        }
        match robot.robot_mode {
            RobotMode::PowerOff if bring_up.requested != Some(RobotMode::PowerOff) => {
                bring_up.requested = Some(RobotMode::PowerOff);
                out.push(Action::Robot(RobotCommand::PowerOn));
            }
            RobotMode::Idle if bring_up.requested != Some(RobotMode::Idle) => {
                bring_up.requested = Some(RobotMode::Idle);
                out.push(Action::Robot(RobotCommand::ReleaseBrakes));
            }
            RobotMode::Running
                if bring_up.program_requested
                    && self.nonce.is_some_and(|nonce| robot.nonce == nonce.number()) =>
            {
                // An arm that shakes too much for a picture is reported before it moves. Recovery needs no
                // picture.
                let rested = bring_up.rest.note(robot.received, &robot.q);
                if rested < self.model.tolerances.settle && self.back.recovery.is_none() {
                    let report = bring_up.rest.report(robot.received);
                    return report.into_iter().for_each(|why| say(out, why));
                }
                self.phase = self.after_bring_up();
                let tcp = ur_pose_from_isometry(&self.model.arm.flange_from_tool);
                out.push(Action::Robot(RobotCommand::SetTcp(tcp)));
                self.set_payload(self.held_mass(), out);
            }
            RobotMode::Running if !bring_up.program_requested && devices.program_settled => {
                bring_up.program_requested = true;
                let nonce = Nonce::new(self.next_nonce);
                self.next_nonce = self.next_nonce.wrapping_add(1);
                self.nonce = Some(nonce);
                out.push(Action::Robot(RobotCommand::StartProgram { nonce }));
            }
            RobotMode::PowerOff
            | RobotMode::Idle
            | RobotMode::Running
            | RobotMode::NoController
            | RobotMode::Disconnected
            | RobotMode::ConfirmSafety
            | RobotMode::Booting
            | RobotMode::PowerOn
            | RobotMode::Backdrive
            | RobotMode::UpdatingFirmware
            | RobotMode::Unknown(_) => {}
        }
    }

    /// Sends the controller what hangs on the flange: the gripper and `mass` kg below the cups.
    pub(crate) fn set_payload(&self, mass: f64, out: &mut Vec<Action>) {
        let grip = &self.model.grip;
        let tool = self.model.arm.flange_from_tool.translation.vector;
        let total = grip.tool_mass + mass;
        let centre = (grip.tool_centre * grip.tool_mass + tool * mass) / total;
        let centre_of_gravity_m = [centre.x, centre.y, centre.z];
        out.push(Action::Robot(RobotCommand::SetPayload { mass_kg: total, centre_of_gravity_m }));
    }
}

/// True where power, brakes or the program are all that is missing.
fn opens_by_bring_up(closed: &GateClosed) -> bool {
    match closed {
        GateClosed::Mode(_) | GateClosed::Program => true,
        GateClosed::Link(_)
        | GateClosed::Stale
        | GateClosed::Safety(_)
        | GateClosed::Guided
        | GateClosed::Local
        | GateClosed::Paused
        | GateClosed::NotPlaying(_)
        | GateClosed::Orders(_)
        | GateClosed::Disarmed
        | GateClosed::Locked(_)
        | GateClosed::Gripper(_)
        | GateClosed::GripperUnknown
        | GateClosed::GripperUnconfirmed
        | GateClosed::GripperByAddress
        | GateClosed::GripperOther
        | GateClosed::Holding
        | GateClosed::MayHang(_)
        | GateClosed::NotObserved
        | GateClosed::NotApproved => false,
    }
}
