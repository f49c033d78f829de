//! What interrupts the cell: safety stops, lost links, ended programs, deadlines, the operator's stop, shutdown.
//!
//! One rule: the arm is told to stop first, the vacuum stays as it is, the job gets a named end, the cell is
//! disarmed, and nothing continues until a person has armed it and the table has been seen again.

use crate::device::gripper::{Channels, GripperCommand};
use crate::device::robot_types::{ProgramEnd, RobotCommand, RobotEvent};
use crate::supervisor::cell::{Cell, Look, LookStage, Phase, alarm, say};
use crate::supervisor::input::{Action, CameraTrouble, Outside};
use crate::supervisor::order::JobEnd;
use crate::time::{Duration, Timestamp};
use crate::wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

/// After this long a held motion is given up: nobody can say what happened on the table meanwhile.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

impl Cell {
    /// Runs on every tick: settling, bring-up, deadlines, and the robot's state while something moves.
    pub(crate) fn watch(&mut self, now: Timestamp, outside: &Outside, out: &mut Vec<Action>) {
        self.watch_settling(now, outside, out);
        self.bring_up(outside, out);
        if let Some(message) = motion_trouble(now, outside).filter(|_| self.moving()) {
            return self.stop_all(now, JobEnd::Interrupted, "robot_stopped", &message, out);
        }
        if self.held_for(now, outside) > LONGEST_PAUSE {
            let message = "the program was paused for too long: the table may have changed";
            return self.stop_all(now, JobEnd::Interrupted, "paused_too_long", message, out);
        }
        if self.remaining.is_zero() {
            self.on_deadline(now, out);
        }
    }

    /// How long the arm has been held in the middle of a motion, by pause or by a slider at zero.
    fn held_for(&mut self, now: Timestamp, outside: &Outside) -> Duration {
        let held = self.moving() && motion_speed(outside) == 0.0;
        self.held_since = if held { self.held_since.or(Some(now)) } else { None };
        self.held_since.map_or(Duration::ZERO, |since| now.since(since))
    }

    /// True while the arm may be in motion or an object may hang on it.
    fn moving(&self) -> bool {
        matches!(self.phase, Phase::Look(_) | Phase::Work(_) | Phase::Park)
    }

    fn on_deadline(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        if let Phase::Look(Look { trouble: Some(trouble), .. }) = &self.phase {
            let trouble = trouble.clone();
            return self.give_up_looking(now, &trouble, out);
        }
        if matches!(self.phase, Phase::Look(Look { stage: LookStage::Capturing { .. }, .. })) {
            let trouble = CameraTrouble {
                code: "camera_unplugged",
                message: "the camera gave no picture in the time of a look".to_string(),
                remedy: "look at the camera's cable and power, submit again",
                lasting: false,
            };
            return self.give_up_looking(now, &trouble, out);
        }
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
            RobotEvent::ProgramEnded { reason } => {
                // Whatever ran before ours is stopped on the way to starting ours.
                if matches!((&self.phase, &reason), (Phase::BringUp(_), ProgramEnd::AsAsked)) {
                    return;
                }
                self.nonce = None;
                format!("the on-robot program ended: {reason}")
            }
            RobotEvent::RuntimeException { line, column, text } => {
                format!("the on-robot program failed at line {line}, column {column}: {text}")
            }
            RobotEvent::ProtocolFault { link, detail, .. } => format!("{link}: {detail}"),
            RobotEvent::RtdeLost => "the RTDE link was lost".to_string(),
            RobotEvent::Refused { what, reply } => format!("the controller refused {what}: {reply}"),
            RobotEvent::Safety { mode } if !matches!(mode, SafetyMode::Normal | SafetyMode::Reduced) => {
                format!("safety mode {mode:?}")
            }
            RobotEvent::RemoteControl { on: false } => {
                "the pendant was switched to local control".to_string()
            }
            RobotEvent::Kinematics { dh, .. } if dh != self.model.arm.dh => {
                let message = "another arm answers, or it was calibrated anew: its kinematics differ from those \
                               celld started with";
                self.locked = Some(message.to_string());
                message.to_string()
            }
            RobotEvent::ProgramRunning { .. } => return self.bring_up(outside, out),
            _ => return,
        };
        if self.moving() || matches!(self.phase, Phase::BringUp(_)) {
            self.stop_all(now, JobEnd::Interrupted, "robot_stopped", &message, out);
        } else {
            self.stand_down(now, &message, out);
        }
    }

    /// Something happened to the robot while nothing moved: whoever was in the cell since then must be asked before it
    /// moves by itself again.
    fn stand_down(&mut self, now: Timestamp, message: &str, out: &mut Vec<Action>) {
        self.seen = None;
        self.park_wanted = false;
        if !self.armed {
            return say(out, message);
        }
        self.armed = false;
        self.phase = Phase::Ready;
        alarm(out, format!("disarmed: {message}"));
        let remedy = "see that the cell is safe, then `celld arm` and submit again";
        self.finish(now, JobEnd::Interrupted, "robot_stopped", message, remedy, out);
    }

    pub(crate) fn on_abort(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.stop_all(now, JobEnd::Interrupted, "aborted", "the operator stopped the cell", out);
    }

    pub(crate) fn on_release_order(&mut self, now: Timestamp, channels: Channels, out: &mut Vec<Action>) {
        if self.moving() {
            // What is let go in motion flies; and a carry must not go on without its object.
            let message = "the operator released the vacuum";
            self.stop_all(now, JobEnd::Interrupted, "released", message, out);
        }
        say(out, format!("vacuum off by the operator's order, {}", channels.word()));
        self.seen = None;
        out.push(Action::Gripper(GripperCommand::Release { channels }));
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
        // The program ends or stands; its number in the registers proves nothing any more.
        self.nonce = None;
        alarm(out, format!("stopped and disarmed: {message}"));
        let remedy = "see that the cell is safe and nothing hangs on the gripper, then `celld arm`";
        self.finish(now, end, code, message, remedy, out);
    }
}

/// Share of its speed at which the arm follows its path now: the slider's, nothing while the program does not play.
pub(crate) fn motion_speed(outside: &Outside) -> f64 {
    outside.robot.map_or(0.0, |robot| {
        let playing = robot.runtime_state == RuntimeState::Playing;
        if playing { robot.target_speed_fraction.clamp(0.0, 1.0) } else { 0.0 }
    })
}

/// What in the robot's state forbids going on with a motion.
fn motion_trouble(now: Timestamp, outside: &Outside) -> Option<String> {
    let Some(robot) = outside.robot else { return Some("the robot was never heard of".to_string()) };
    if outside.robot_silent {
        Some(format!("the robot's state stopped coming {:.2} s ago", now.since(robot.received).as_secs_f64()))
    } else if !matches!(robot.safety_mode, SafetyMode::Normal | SafetyMode::Reduced) {
        Some(format!("safety mode {:?}", robot.safety_mode))
    } else if robot.robot_mode != RobotMode::Running {
        Some(format!("robot mode {:?}", robot.robot_mode))
    } else if robot.remote_control == Some(false) {
        Some("the pendant was switched to local control".to_string())
    } else {
        None
    }
}
