//! The status file out of what the supervisor says and what the state folder knows.
//!
//! In: the supervisor's status, journal, spool, what the devices last said. Out: `status.json`, whole, with
//! the time. The supervisor's words change when the cell does; ages and queues are of the moment of writing.

use super::StateKeeper;
use crate::config::sessions::gripper_address;
use crate::jobs::status;
use cell_edge::clock::unix_now_s;
use cell_edge::files::remove;
use cell_machine::intake::HELD_UP_AFTER;
use cell_machine::orders::ConfirmedGripper;
use cell_machine::supervisor::status::{Device, DeviceNote, Doing, Status};
use cell_values::time::Duration;
use rearrange::document::chain::chain;

impl StateKeeper {
    /// Writes the status; a disk that does not take it is logged.
    pub(super) fn write_status(&mut self, status: &Status) {
        let status = self.status_file(status);
        (self.publish)(&status);
        let written = status.write(&self.state.status());
        self.status_is_old = written.is_err();
        if let Err(error) = written {
            tracing::warn!(error = %chain(&error), "the status file could not be written");
        }
    }

    /// celld ends: a status of before, which may say that the cell is armed, must not stay behind it.
    pub(super) fn leave_no_old_status(&self) {
        if self.status_is_old
            && let Err(error) = remove(&self.state.status())
        {
            tracing::error!(error = %chain(&error), "an old status stays behind");
        }
    }

    fn status_file(&self, status: &Status) -> status::Status {
        let total = status.moves + status.remaining_moves;
        let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let disk = self.disk.low().filter(|_| status.job.is_none());
        let late = loop_late(self.last_answers.loop_age());
        let hint = match (&late, &disk) {
            (Some(_), _) => LOOP_LATE_HINT,
            (None, Some(_)) if status.hint.is_empty() => {
                "make room on that disk; then jobs go on by themselves"
            }
            (None, _) => &status.hint,
        };
        let message = match (&late, &disk) {
            (Some(late), _) => format!("{late}; before that: {}", status.text()),
            (None, Some(low)) => format!("{}; no job is begun: {low}", status.text()),
            (None, None) => status.text(),
        };
        status::Status {
            daemon: self.daemon.clone(),
            pid: std::process::id(),
            started_unix_s: self.started_unix_s,
            written_unix_s: unix_now_s(),
            state: if is_working(status) { "working" } else { "idle" }.to_string(),
            blocked: late.or(disk),
            message,
            armed: status.armed,
            moving: status.moving,
            paused: status.paused,
            job: status.job.clone(),
            holding: status.held.clone(),
            last_move_s: status.last_move.as_ref().map(super::in_words).unwrap_or_default(),
            step: status.job.as_ref().filter(|_| total > 0).map(|_| (number(status.moves), number(total))),
            awaiting_approval: status.job.iter().filter(|_| status.awaits_approval).cloned().collect(),
            plan: self.plan.clone(),
            config: self.config_file.clone(),
            shared: self.shared.clone(),
            waiting: self.journal.waiting().map_or(0, |count| number(count as usize)),
            unread: self.spool.unread().map_or(0, number),
            because: status.because.clone(),
            hint: hint.to_string(),
            stopped: status.stopped.as_ref().map(|stop| status::Stopped {
                code: stop.code.to_string(),
                message: stop.message.clone(),
                hint: stop.hint.clone(),
                job: stop.job.clone(),
            }),
            ways: status.ways.iter().map(|way| way.as_str().to_string()).collect(),
            arm_refused: status.arm_refused.clone(),
            refused: self.refused.clone(),
            devices: status.devices.iter().map(|device| self.device(device)).collect(),
            fleet: self.remarks.lock().map(|remarks| remarks.clone()).unwrap_or_default(),
            time_factor: self.last_answers.time_factor(),
        }
    }

    /// A device with its address, which one it is, and how long ago it answered.
    fn device(&self, DeviceNote { device, ready, message }: &DeviceNote) -> status::DeviceStatus {
        let devices = &self.config.devices;
        let (address, identity) = match *device {
            Device::Robot => (devices.robot_host.clone(), self.identities.robot.clone()),
            Device::Gripper => {
                let address = gripper_address(devices);
                let identity = match self.state.confirmed_gripper(&address) {
                    ConfirmedGripper::Serial(serial) => {
                        format!("a person confirmed serial number {serial}")
                    }
                    ConfirmedGripper::AtAddress => "confirmed by a person".to_string(),
                    ConfirmedGripper::None | ConfirmedGripper::NotNeeded => String::new(),
                };
                (address, identity)
            }
            Device::Camera => (devices.camera.address(), self.identities.camera.clone()),
        };
        let age_s = self.last_answers.age_s(*device);
        let (name, message) = (device.as_str().to_string(), message.clone());
        status::DeviceStatus { name, address, identity, ready: *ready, age_s, message }
    }
}

/// What to do about a loop that hangs: no order reaches the machine.
const LOOP_LATE_HINT: &str = "use the emergency stop if the arm moves, then restart celld";

/// The loop has not come round for too long: what the status says of the cell is old.
fn loop_late(age: Duration) -> Option<String> {
    (age > HELD_UP_AFTER)
        .then(|| format!("celld does not respond: its loop has stood still for {} s", age.as_secs()))
}

/// A job is active, or the arm is on the way without one, or will be as soon as a gate opens.
fn is_working(status: &Status) -> bool {
    let will_be = status.armed && matches!(status.doing, Doing::Waiting(_));
    status.job.is_some() || status.doing.is_under_way() || will_be
}
