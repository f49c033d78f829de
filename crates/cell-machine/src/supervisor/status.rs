//! How the cell looks for others: for the status file, a page, the demo's progress.
//!
//! In: the supervisor's state. Out: [`Status`], in values that programs compare and in words for people.

use crate::code::Code;
use crate::orders::WayBack;
use crate::supervisor::back::LastStop;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::GateClosed;
use crate::supervisor::input::DeviceSnapshot;
pub use crate::supervisor::phase::WorkStep;
use crate::supervisor::phase::{JobRun, Phase, WorkStage};
use crate::supervisor::reason::Reason;
use crate::supervisor::round::Round;
use crate::times::TimeSplit;
use cell_motion::path::CheckedPath;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A pick-n-place under way, for who judges it from outside.
#[derive(Clone, Copy, Debug)]
pub struct UnderWay<'a> {
    /// Of what.
    pub object: &'a str,
    /// Where it was seen.
    pub from: Pose2,
    /// The cups are at the object, and it does not hang yet.
    pub gripping: bool,
    /// From the pick to the place.
    pub carry: &'a CheckedPath,
}

/// What is going on, for programs; [`Status::text`] says it in words.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Doing {
    /// The arm was ordered to stop, and is not known to be at rest with its program ended.
    Stopping,
    /// No job.
    Idle,
    /// A gate is closed.
    Waiting(GateClosed),
    /// A pause is in force.
    Paused,
    /// The last record of a job or a step is being written.
    Writing,
    /// About to go on.
    Ready,
    /// Power, brakes, program.
    StartingRobot,
    /// Look pose, from 1, and how many; the code of what keeps the camera from giving a picture.
    Looking(usize, usize, Option<Code>),
    /// The planner works.
    Planning,
    /// A person has to approve the plan.
    AwaitingApproval,
    /// A pick-n-place: what, and with which object.
    Working(WorkStep, String),
    /// On the way to the park pose.
    Parking,
    /// A way back after a stop.
    Recovering(Cow<'static, str>),
    /// Calibration pose, from 1, and how many.
    Visiting(usize, usize),
    /// The daemon ends.
    Ending,
}

impl Doing {
    /// The arm, its power or a job is on the way somewhere: not over yet, whether with a job or without one.
    pub fn is_under_way(&self) -> bool {
        match self {
            Doing::Stopping
            | Doing::StartingRobot
            | Doing::Looking(..)
            | Doing::Planning
            | Doing::AwaitingApproval
            | Doing::Working(..)
            | Doing::Parking
            | Doing::Recovering(_)
            | Doing::Visiting(..)
            | Doing::Ending => true,
            Doing::Idle | Doing::Waiting(_) | Doing::Paused | Doing::Writing | Doing::Ready => false,
        }
    }
}

impl Doing {
    /// The arm is on its way, or will be without another order: also in a cell that is disarmed or paused,
    /// which finishes what is under way. A look that waits for the camera goes on to its next pose.
    pub fn may_move(&self) -> bool {
        match self {
            Doing::Stopping
            | Doing::StartingRobot
            | Doing::Looking(..)
            | Doing::Working(..)
            | Doing::Parking
            | Doing::Recovering(_)
            | Doing::Visiting(..) => true,
            Doing::Ending
            | Doing::Idle
            | Doing::Waiting(_)
            | Doing::Paused
            | Doing::Writing
            | Doing::Ready
            | Doing::Planning
            | Doing::AwaitingApproval => false,
        }
    }
}

/// How the cell looks from outside.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Status {
    /// Motion is allowed.
    pub armed: bool,
    /// A pause is in force.
    pub paused: bool,
    /// The arm is on its way, is about to be, or is not known to be at rest, whoever moves it.
    pub moving: bool,
    /// What is going on.
    pub doing: Doing,
    /// The active job.
    pub job: Option<String>,
    /// Its plan, or a preview of it, waits for a person.
    pub awaits_approval: bool,
    /// What hangs on the gripper, may hang or fell, in a few words.
    pub held: Option<String>,
    /// Pick-n-places carried out in it.
    pub moves: usize,
    /// Pick-n-places its present plan still has.
    pub remaining_moves: usize,
    /// Where the time of the last one went.
    pub last_move: Option<TimeSplit>,
    /// Why the table is looked at again: what a person sees there, such as a thing without a marker.
    pub because: Option<String>,
    /// What a person is to do; empty where nothing is.
    pub hint: String,
    /// The stop that is still to be left, and why it came.
    pub stopped: Option<StopNote>,
    /// The ways back that may be taken now, where there is something to leave or to get rid of.
    pub ways: Vec<WayBack>,
    /// Why an order to arm would be refused now, as it would be answered.
    pub arm_refused: Option<String>,
    /// Robot, gripper, camera.
    pub devices: Vec<DeviceNote>,
}

/// A stop that is still to be left.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct StopNote {
    /// For programs.
    pub code: Code,
    /// One sentence.
    pub message: String,
    /// What to do about it.
    pub hint: String,
    /// The job that it ended or left.
    pub job: Option<String>,
}

/// Which device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Device {
    /// Its sign of life is a state package of the controller.
    Robot,
    /// A reading of the vacuum.
    Gripper,
    /// A picture.
    Camera,
}

impl Device {
    /// As in the status file.
    pub fn as_str(self) -> &'static str {
        match self {
            Device::Robot => "robot",
            Device::Gripper => "gripper",
            Device::Camera => "camera",
        }
    }
}

/// How a device is.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct DeviceNote {
    /// Which.
    pub device: Device,
    /// It answers and may be used.
    pub ready: bool,
    /// One sentence.
    pub message: String,
}

impl Status {
    /// A disarmed cell that does nothing.
    pub fn idle() -> Status {
        Status {
            armed: false,
            paused: false,
            moving: false,
            doing: Doing::Idle,
            job: None,
            awaits_approval: false,
            held: None,
            moves: 0,
            remaining_moves: 0,
            last_move: None,
            because: None,
            hint: String::new(),
            stopped: None,
            ways: Vec::new(),
            arm_refused: None,
            devices: Vec::new(),
        }
    }

    /// What is going on, in a few words.
    pub fn text(&self) -> String {
        match &self.doing {
            Doing::Stopping => "stopping".to_string(),
            Doing::Idle => "idle".to_string(),
            Doing::Waiting(reason) => format!("waiting: {reason}"),
            Doing::Paused => "paused".to_string(),
            Doing::Writing => "writing the journal".to_string(),
            Doing::Ready => "ready".to_string(),
            Doing::StartingRobot => "starting the robot".to_string(),
            Doing::Looking(view, of, None) => format!("looking {view}/{of}"),
            Doing::Looking(view, of, Some(code)) => format!("looking {view}/{of}, waiting: {code}"),
            Doing::Planning => "planning".to_string(),
            Doing::AwaitingApproval => "waiting for approval".to_string(),
            Doing::Working(step, object) => format!("{} {object}", step.as_str()),
            Doing::Parking => "parking".to_string(),
            Doing::Recovering(what) => format!("on a way back: {what}"),
            Doing::Visiting(pose, of) => format!("calibration pose {pose}/{of}"),
            Doing::Ending => "ending".to_string(),
        }
    }
}

impl Supervisor {
    /// The pick-n-place under way, if the cell is at one.
    pub fn pick_n_place(&self) -> Option<UnderWay<'_>> {
        let Phase::Work(work) = &self.phase else { return None };
        Some(UnderWay {
            object: &work.object,
            from: work.from,
            gripping: work.stage == WorkStage::Gripping,
            carry: &work.paths.carry,
        })
    }

    /// Disarmed, and nothing is under way, held or waited for by a job: nothing is lost when it ends now.
    pub fn is_quiet(&self) -> bool {
        let doing = self.doing();
        let rests = !doing.is_under_way() && !matches!(doing, Doing::Writing | Doing::Waiting(_));
        !self.mode.armed() && rests && self.job.is_none() && self.holding_words().is_none()
    }

    /// How the cell looks from outside.
    pub fn status(&self) -> Status {
        let job = self.job.as_ref();
        Status {
            armed: self.mode.armed(),
            paused: self.mode.paused(),
            moving: self.may_move(),
            doing: self.doing(),
            job: job.map(|job| job.order.id.clone()),
            awaits_approval: matches!(self.phase, Phase::Approve) || self.preview_waits(),
            held: self.holding_words(),
            moves: job.map_or(0, |job| job.moves),
            last_move: job.and_then(|_| self.times.last_move()),
            remaining_moves: job.and_then(|job| job.route.as_ref()).map_or(0, Vec::len),
            because: job
                .and_then(|job| job.rejection.clone())
                .filter(|_| matches!(self.phase, Phase::Look(_))),
            hint: self.hint(),
            stopped: self.back.last_stop.as_ref().map(|stop| {
                let Reason { code, message, .. } = stop.reason.clone();
                StopNote { code, message, hint: self.stop_hint(stop), job: stop.job.clone() }
            }),
            ways: Vec::new(),
            arm_refused: None,
            devices: Vec::new(),
        }
    }

    /// The same with what the devices' present state allows: how each is, the ways back that may be taken,
    /// whether the cell may be armed, and what has to be done before an arming that would be refused.
    pub fn status_with(&self, devices: &DeviceSnapshot) -> Status {
        let status = self.status();
        let (ways, notes) = (self.ways_now(devices), self.device_notes(devices));
        let hint = self.hint_with(devices, status.hint);
        Status { ways, arm_refused: self.arm_refusal(devices), devices: notes, hint, ..status }
    }

    /// The hint; where it leads to an arming that would be refused, behind what has to be done first.
    fn hint_with(&self, devices: &DeviceSnapshot, hint: String) -> String {
        if self.mode.armed() || !hint.contains("`celld arm`") {
            return hint;
        }
        match self.may_arm(devices) {
            // What may hang on the gripper has its hint already.
            Ok(()) | Err(GateClosed::Holding | GateClosed::MayHang(_)) => hint,
            Err(closed) => match self.before_arming(&closed) {
                first if hint.contains(&first) => hint,
                first => format!("{first}; {hint}"),
            },
        }
    }

    /// What is under way, a stop that is not confirmed whatever the phase, the way to the park pose that a
    /// pause does not hold up.
    fn may_move(&self) -> bool {
        self.doing().may_move() || !self.stands || !self.arm_settled || self.mode.parks()
    }

    /// What a person is to do now.
    fn hint(&self) -> String {
        let stopped = self.back.last_stop.as_ref().filter(|_| !self.mode.armed());
        match &self.phase {
            Phase::Approve => self.job.as_ref().map_or_else(String::new, |job| {
                let id = &job.order.id;
                format!("look at the plan, then `celld approve {id}` or `celld reject {id}`")
            }),
            Phase::Look(look) => {
                look.fault.as_ref().map_or_else(String::new, |fault| self.hands_off_first(&fault.hint))
            }
            Phase::Ready if self.mode.ending() => String::new(),
            Phase::Ready if !self.stands || !self.arm_settled => "wait until the arm is at rest".to_string(),
            Phase::Ready if self.back.recovery.is_some() => String::new(),
            // Where more than the arming is missing, that comes first.
            Phase::Ready
                if self.preview_waits()
                    && stopped.is_none()
                    && self.waiting_for == Some(GateClosed::Disarmed) =>
            {
                let id = self.job.as_ref().map_or("", |job| &job.order.id);
                format!(
                    "`celld arm` once the cell is clear; the preview of the plan can be approved before: `celld \
                     approve {id}`"
                )
            }
            Phase::Ready => match (self.locked(), stopped, &self.waiting_for) {
                (Some(closed), ..) => closed.hint().to_string(),
                (None, Some(stop), _) => format!("{}{}", self.stop_hint(stop), self.next_after(stop)),
                (None, None, Some(GateClosed::Disarmed))
                    if self.holding_words().is_some() || self.back.grips =>
                {
                    "something may hang on the gripper: `celld recover` shows the ways back, then `celld arm`"
                        .to_string()
                }
                (None, None, Some(GateClosed::Disarmed)) if self.plan_is_agreed_to() => format!(
                    "{}: after a look the arm carries out what was approved",
                    GateClosed::Disarmed.hint()
                ),
                (None, None, Some(reason)) => self.hands_off_first(reason.hint()),
                (None, None, None) if self.mode.armed() && self.mode.paused() => {
                    "`celld resume` goes on".to_string()
                }
                (None, None, None) => String::new(),
            },
            Phase::BringUp(_)
            | Phase::Plan
            | Phase::Work(_)
            | Phase::Park
            | Phase::Recover(_)
            | Phase::Visit(_) => String::new(),
        }
    }

    /// What the arming after a stop begins, where that is another job than the one that was stopped.
    fn next_after(&self, stop: &LastStop) -> String {
        let other = |job: &&JobRun| !stop.keeps_job && stop.job.as_ref() != Some(&job.order.id);
        let Some(job) = self.job.as_ref().filter(other) else { return String::new() };
        let then = match self.mode.paused() {
            true => "a pause is in force, `celld resume` ends it".to_string(),
            false => format!("the arm moves to look at the table{}", self.after_the_look()),
        };
        format!("; `celld arm` begins job {}: {then}", job.order.id)
    }

    /// An armed cell goes on by itself as soon as it can: no person is sent to it before it is disarmed.
    fn hands_off_first(&self, hint: &str) -> String {
        match self.mode.armed() && !hint.is_empty() {
            true => format!("`celld disarm` before going to it; {hint}"),
            false => hint.to_string(),
        }
    }

    fn doing(&self) -> Doing {
        match &self.phase {
            Phase::Ready if self.mode.ending() => Doing::Ending,
            Phase::Ready if !self.stands || !self.arm_settled => Doing::Stopping,
            Phase::Ready if self.back.recovery.is_some() => Doing::Recovering("about to go on".into()),
            Phase::Ready => match (&self.job, &self.waiting_for) {
                (None, _) if !self.ledger.is_clear() => Doing::Writing,
                // A round or the way to the park pose was ordered, and begins as soon as the gate is open.
                (None, Some(reason)) if self.round.is_some() || self.mode.parks() => {
                    Doing::Waiting(reason.clone())
                }
                (None, _) => self.locked().map_or(Doing::Idle, Doing::Waiting),
                (Some(_), Some(reason)) => Doing::Waiting(reason.clone()),
                (Some(_), None) if self.mode.paused() => Doing::Paused,
                (Some(_), None) => Doing::Ready,
            },
            Phase::BringUp(_) => Doing::StartingRobot,
            Phase::Look(look) if self.back.recovery.is_some() && look.fault.is_none() => {
                Doing::Recovering(format!("looking {}/{}", look.at + 1, look.poses.len()).into())
            }
            Phase::Look(look) => {
                let fault = look.fault.as_ref().map(|fault| fault.code);
                Doing::Looking(look.at + 1, look.poses.len(), fault)
            }
            Phase::Plan => Doing::Planning,
            Phase::Approve => Doing::AwaitingApproval,
            Phase::Work(work) => Doing::Working(work.stage.step(), work.object.clone()),
            Phase::Park => Doing::Parking,
            Phase::Recover(stage) => Doing::Recovering(stage.words().into()),
            Phase::Visit(_) => {
                let (pose, of) = self.round.as_ref().map_or((0, 0), Round::progress);
                Doing::Visiting(pose, of)
            }
        }
    }
}
