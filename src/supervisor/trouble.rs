//! What interrupts the cell: safety stops, lost links, ended programs, deadlines, the operator's stop, shutdown.
//!
//! One rule: the arm is told to stop first, the vacuum stays as it is, the job gets a named end, the cell is
//! disarmed, and nothing continues until a person has armed it and the table has been seen again.

use crate::device::gripper::{Channels, GripperCommand};
use crate::device::robot_types::{RobotCommand, RobotEvent};
use crate::supervisor::cell::{Cell, Phase, alarm, say};
use crate::supervisor::input::{Action, Outside};
use crate::supervisor::order::JobEnd;
use crate::time::Timestamp;
use crate::wire::enumerations::{RobotMode, SafetyMode};

impl Cell {
    /// Runs on every tick: settling, bring-up, deadlines, and the robot's state while something moves.
    pub(crate) fn watch(&mut self, now: Timestamp, outside: &Outside, out: &mut Vec<Action>) {
        self.watch_settling(now, outside, out);
        self.bring_up(outside, out);
        if let Some(message) = motion_trouble(outside).filter(|_| self.moving()) {
            return self.stop_all(now, JobEnd::Interrupted, "robot_stopped", &message, out);
        }
        if self.remaining.is_zero() {
            self.on_deadline(now, out);
        }
    }

    /// True while the arm may be in motion or an object may hang on it.
    fn moving(&self) -> bool {
        matches!(self.phase, Phase::Look(_) | Phase::Work(_) | Phase::Park)
    }

    fn on_deadline(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let (code, message) = match &self.phase {
            Phase::Ready | Phase::Approve => return,
            Phase::BringUp(_) => ("robot_not_started", "the robot did not come up in time".to_string()),
            Phase::Look(_) => ("look_timeout", "the look was not finished in time".to_string()),
            Phase::Plan => ("planner_stuck", "the planner did not answer within its budget".to_string()),
            Phase::Work(work) => ("work_timeout", format!("{:?} {} took too long", work.stage, work.object)),
            Phase::Park => ("park_timeout", "the park pose was not reached in time".to_string()),
        };
        self.stop_all(now, JobEnd::Failed, code, &message, out);
    }

    /// Everything the robot says besides a finished path.
    pub(crate) fn on_robot_trouble(
        &mut self,
        now: Timestamp,
        outside: &Outside,
        event: RobotEvent,
        out: &mut Vec<Action>,
    ) {
        let message = match event {
            RobotEvent::ProgramEnded { reason } => format!("the on-robot program ended: {reason}"),
            RobotEvent::RuntimeException { line, column, text } => {
                format!("the on-robot program failed at line {line}, column {column}: {text}")
            }
            RobotEvent::ProtocolFault { link, detail, .. } => format!("{link}: {detail}"),
            RobotEvent::RtdeLost => "the RTDE link was lost".to_string(),
            RobotEvent::Refused { what, reply } => format!("the controller refused {what}: {reply}"),
            RobotEvent::Safety { mode } if !matches!(mode, SafetyMode::Normal | SafetyMode::Reduced) => {
                format!("safety mode {mode:?}")
            }
            RobotEvent::ProgramRunning { .. } => {
                self.bring_up(outside, out);
                return;
            }
            _ => return,
        };
        if self.moving() || matches!(self.phase, Phase::BringUp(_)) {
            self.stop_all(now, JobEnd::Interrupted, "robot_stopped", &message, out);
        } else {
            self.seen = None;
            say(out, message);
        }
    }

    pub(crate) fn on_abort(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.stop_all(now, JobEnd::Interrupted, "aborted", "the operator stopped the cell", out);
    }

    pub(crate) fn on_release_order(&mut self, out: &mut Vec<Action>) {
        say(out, "vacuum off by the operator's order");
        self.seen = None;
        out.push(Action::Gripper(GripperCommand::Release { channels: Channels::Both }));
    }

    pub(crate) fn on_shutdown(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.shutting_down = true;
        self.stop_all(now, JobEnd::Interrupted, "shutdown", "the daemon was told to end", out);
    }

    /// Stops the arm, keeps the vacuum, ends the job, disarms.
    pub(crate) fn stop_all(
        &mut self,
        now: Timestamp,
        end: JobEnd,
        code: &str,
        message: &str,
        out: &mut Vec<Action>,
    ) {
        out.push(Action::Robot(RobotCommand::Stop));
        self.phase = Phase::Ready;
        self.seen = None;
        self.park_wanted = false;
        self.armed = false;
        alarm(out, format!("stopped and disarmed: {message}"));
        let remedy = "see that the cell is safe and nothing hangs on the gripper, then `celld arm`";
        self.finish(now, end, code, message, remedy, out);
    }
}

/// What in the robot's state forbids going on with a motion.
fn motion_trouble(outside: &Outside) -> Option<String> {
    let Some(robot) = outside.robot else { return Some("the robot was never heard of".to_string()) };
    if outside.robot_silent {
        Some("the robot's state stopped coming".to_string())
    } else if !matches!(robot.safety_mode, SafetyMode::Normal | SafetyMode::Reduced) {
        Some(format!("safety mode {:?}", robot.safety_mode))
    } else if robot.robot_mode != RobotMode::Running {
        Some(format!("robot mode {:?}", robot.robot_mode))
    } else {
        None
    }
}
