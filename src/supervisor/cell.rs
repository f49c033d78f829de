//! The cell's state machine: its states, and the one function through which everything comes in.
//!
//! In: time, the devices' last word, one [`Input`]. Out: actions, to be carried out in order. Level-triggered:
//! between two things the machine is `Ready` and `pursue` decides from what is known what comes next, so a
//! lost edge cannot leave it hanging. Every phase has a deadline that runs with the robot's speed slider, and
//! stands still while the program is paused.

use crate::device::gripper::GripperEvent;
use crate::device::program::Nonce;
use crate::device::robot_types::RobotEvent;
use crate::geometry::pose::Pose2;
use crate::motion::pick_n_place::PickNPlacePaths;
use crate::supervisor::gates::{self, Closed};
use crate::supervisor::input::{Action, CameraTrouble, Input, Notice, Outside};
use crate::supervisor::model::CellModel;
use crate::supervisor::order::{JobEnd, JobOrder, JobReport, ObjectResult};
use crate::supervisor::trouble::motion_speed;
use crate::time::{Duration, Timestamp};
use crate::units::Joints;
use crate::vision::observe::{Observation, View};
use crate::wire::enumerations::RobotMode;

/// What the cell is doing.
#[derive(Debug)]
pub(crate) enum Phase {
    /// Between two things.
    Ready,
    /// Powering the arm and starting the on-robot program.
    BringUp(BringUp),
    /// Going round the look poses.
    Look(Look),
    /// Waiting for the planner.
    Plan,
    /// Waiting for a person.
    Approve,
    /// One pick-n-place.
    Work(Box<Work>),
    /// Going to the park pose.
    Park,
}

/// Bring-up of the robot: which request is out, if any.
#[derive(Debug, Default)]
pub(crate) struct BringUp {
    pub asked: Option<RobotMode>,
    pub program_asked: bool,
}

/// A look at the table.
#[derive(Debug)]
pub(crate) struct Look {
    pub view: usize,
    pub stage: LookStage,
    pub views: Vec<View>,
    /// Why there is no picture from here yet.
    pub trouble: Option<CameraTrouble>,
}

/// Where a look stands.
#[derive(Debug)]
pub(crate) enum LookStage {
    /// On the way to a look pose.
    Moving,
    /// Arrived; still since.
    Settling { still_since: Option<Timestamp> },
    /// Frames are being taken with the arm at these joints.
    Capturing { q: Joints },
    /// All views are in.
    Observing,
}

/// A pick-n-place under way.
#[derive(Debug)]
pub(crate) struct Work {
    pub object: String,
    pub paths: PickNPlacePaths,
    pub stage: WorkStage,
}

/// Where a pick-n-place stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WorkStage {
    Approaching,
    Gripping,
    Carrying,
    Releasing,
    Retreating,
    /// The grip failed: letting go.
    GivingUp,
    /// The grip failed: going up empty.
    Withdrawing,
}

/// One remaining action of the route.
#[derive(Clone, Debug)]
pub(crate) struct RouteAction {
    pub object: String,
    pub from: Pose2,
    pub to: Pose2,
    pub to_goal: bool,
}

/// The job being carried out.
#[derive(Debug)]
pub(crate) struct JobRun {
    pub order: JobOrder,
    pub started: Timestamp,
    /// What remains to be done; `None` before planning or when the table disagreed.
    pub route: Option<Vec<RouteAction>>,
    pub approved: bool,
    pub moves: usize,
    pub planned: Option<(usize, usize)>,
    pub lower_bound: Option<f64>,
    pub planning_seconds: f64,
    pub replans: u32,
    pub grip_failures: u32,
    pub look_failures: u32,
    /// The operator was told which objects of the catalogue are not to be seen.
    pub absent_told: bool,
    pub last_seen: Vec<(String, Pose2)>,
    pub cancel: bool,
}

/// What a look told, valid until something is picked, placed, dropped or stopped.
pub(crate) type Seen = Observation;

/// The supervisor.
#[derive(Debug)]
pub struct Cell {
    pub(crate) model: CellModel,
    pub(crate) phase: Phase,
    pub(crate) armed: bool,
    pub(crate) paused: bool,
    /// Pause again after one pick-n-place.
    pub(crate) single_step: bool,
    pub(crate) park_wanted: bool,
    pub(crate) shutting_down: bool,
    pub(crate) job: Option<JobRun>,
    pub(crate) seen: Option<Seen>,
    /// When the look behind `seen` was over.
    pub(crate) seen_at: Timestamp,
    /// Height of what was last seen without a marker and counts as an obstacle, with its margin, m.
    pub(crate) foreign_height: f64,
    /// A look near the limits of drift was told of since the cell was armed.
    pub(crate) drift_told: bool,
    /// Since when the arm has been held in the middle of a motion.
    pub(crate) held_since: Option<Timestamp>,
    /// Why the cell cannot be armed until the daemon is started anew.
    pub(crate) locked: Option<String>,
    /// Nonce of the program uploaded last.
    pub(crate) nonce: Option<Nonce>,
    /// The next nonce is made from this.
    pub(crate) next_nonce: u64,
    /// Time the phase may still take at full speed.
    pub(crate) remaining: Duration,
    last_now: Timestamp,
    /// Reason for waiting that was said last, so that it is said once.
    pub(crate) waiting_for: Option<Closed>,
    pub(crate) waiting_since: Timestamp,
}

/// How the cell looks from outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Motion is allowed.
    pub armed: bool,
    /// A pause is in force.
    pub paused: bool,
    /// What is going on, in a few words.
    pub phase: String,
    /// The active job.
    pub job: Option<String>,
    /// Pick-n-places carried out in it.
    pub moves: usize,
    /// Pick-n-places its present plan still has.
    pub remaining_moves: usize,
}

impl Cell {
    /// A disarmed cell without a job. `nonce_seed` must differ from run to run.
    pub fn new(model: CellModel, nonce_seed: u64) -> Cell {
        Cell {
            model,
            phase: Phase::Ready,
            armed: false,
            paused: false,
            single_step: false,
            park_wanted: false,
            shutting_down: false,
            job: None,
            seen: None,
            seen_at: Timestamp::ZERO,
            foreign_height: 0.0,
            drift_told: false,
            held_since: None,
            locked: None,
            nonce: None,
            next_nonce: nonce_seed,
            remaining: Duration::ZERO,
            last_now: Timestamp::ZERO,
            waiting_for: None,
            waiting_since: Timestamp::ZERO,
        }
    }

    /// Arms the cell without a person: for simulated cells only, as the configuration checks.
    pub fn arm_at_start(&mut self) {
        self.armed = true;
    }

    /// True when a job may be handed over.
    pub fn wants_job(&self) -> bool {
        self.job.is_none() && !self.shutting_down
    }

    /// True when nothing is moving and nothing is held up, so that the daemon may end.
    pub fn is_quiet(&self) -> bool {
        matches!(self.phase, Phase::Ready) && self.job.is_none()
    }

    /// How the cell looks from outside.
    pub fn status(&self) -> Status {
        let phase = match &self.phase {
            Phase::Ready => match (&self.job, &self.waiting_for) {
                (None, _) => "idle".to_string(),
                (Some(_), Some(reason)) => format!("waiting: {reason}"),
                (Some(_), None) if self.paused => "paused".to_string(),
                (Some(_), None) => "ready".to_string(),
            },
            Phase::BringUp(_) => "starting the robot".to_string(),
            Phase::Look(look) => {
                let waits = look.trouble.as_ref().map(|trouble| format!(", waiting: {}", trouble.code));
                let waits = waits.unwrap_or_default();
                format!("looking {}/{}{waits}", look.view + 1, self.model.look_poses.len())
            }
            Phase::Plan => "planning".to_string(),
            Phase::Approve => "waiting for approval".to_string(),
            Phase::Work(work) => format!("{} {}", work.stage.verb(), work.object),
            Phase::Park => "parking".to_string(),
        };
        Status {
            armed: self.armed,
            paused: self.paused,
            phase,
            job: self.job.as_ref().map(|job| job.order.id.clone()),
            moves: self.job.as_ref().map_or(0, |job| job.moves),
            remaining_moves: self
                .job
                .as_ref()
                .and_then(|job| job.route.as_ref())
                .map_or(0, std::vec::Vec::len),
        }
    }

    /// The measured arrangement, while it is valid.
    pub fn observation(&self) -> Option<&Observation> {
        self.seen.as_ref()
    }

    /// The remaining route of the active job: object, from, to, whether `to` is its goal.
    pub fn route(&self) -> Vec<(String, Pose2, Pose2, bool)> {
        let route = self.job.as_ref().and_then(|job| job.route.as_ref());
        route.map_or_else(Vec::new, |route| {
            route.iter().map(|a| (a.object.clone(), a.from, a.to, a.to_goal)).collect()
        })
    }

    /// The cell as configured.
    pub fn model(&self) -> &CellModel {
        &self.model
    }

    /// The time handed in last.
    pub(crate) fn clock(&self) -> Timestamp {
        self.last_now
    }

    /// Takes one input and says what to do.
    pub fn step(&mut self, now: Timestamp, outside: &Outside, input: Input) -> Vec<Action> {
        let mut out = Vec::new();
        self.run_deadline(now, outside);
        match input {
            Input::Tick => self.watch(now, outside, &mut out),
            Input::Robot(event) => self.on_robot(now, outside, event, &mut out),
            Input::Gripper(event) => self.on_gripper(now, event, &mut out),
            Input::Captured(result) => self.on_captured(now, outside, result, &mut out),
            Input::Observed(result) => self.on_observed(now, result, &mut out),
            Input::Planned(answer) => self.on_planned(now, *answer, &mut out),
            Input::Job(order) => self.on_job(now, *order, &mut out),
            Input::Operator(command) => self.on_operator(now, command, &mut out),
            Input::Shutdown => self.on_shutdown(now, &mut out),
        }
        self.pursue(now, outside, &mut out);
        out
    }

    fn run_deadline(&mut self, now: Timestamp, outside: &Outside) {
        let speed = if self.follows_a_path() { motion_speed(outside) } else { 1.0 };
        self.remaining = self.remaining.saturating_sub(now.since(self.last_now).mul_f64(speed));
        self.last_now = now;
    }

    /// True while the phase lasts as long as the arm takes for a path.
    pub(crate) fn follows_a_path(&self) -> bool {
        match &self.phase {
            Phase::Park | Phase::Look(Look { stage: LookStage::Moving, .. }) => true,
            Phase::Work(work) => {
                !matches!(work.stage, WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp)
            }
            Phase::Ready | Phase::BringUp(_) | Phase::Look(_) | Phase::Plan | Phase::Approve => false,
        }
    }

    pub(crate) fn enter(&mut self, phase: Phase, limit: Duration) {
        self.phase = phase;
        self.remaining = limit;
        self.waiting_for = None;
    }

    fn on_job(&mut self, now: Timestamp, order: JobOrder, out: &mut Vec<Action>) {
        say(out, format!("job {} taken up: {} goals", order.id, order.goals.len()));
        self.waiting_since = now;
        // What was seen for another job was not judged for this one.
        self.seen = None;
        self.job = Some(JobRun {
            order,
            started: now,
            route: None,
            approved: false,
            moves: 0,
            planned: None,
            lower_bound: None,
            planning_seconds: 0.0,
            replans: 0,
            grip_failures: 0,
            look_failures: 0,
            absent_told: false,
            last_seen: Vec::new(),
            cancel: false,
        });
    }

    /// Decides what comes next when nothing is under way.
    fn pursue(&mut self, now: Timestamp, outside: &Outside, out: &mut Vec<Action>) {
        if !matches!(self.phase, Phase::Ready) || self.shutting_down {
            return;
        }
        if self.job.as_ref().is_some_and(|job| job.cancel) {
            self.finish(now, JobEnd::Cancelled, "cancelled", "the operator cancelled the job", "", out);
        }
        if self.job.is_none() && !self.park_wanted {
            self.waiting_for = None;
            return;
        }
        if self.job.is_some() && self.paused {
            return;
        }
        let open =
            gates::any_motion(self.armed, outside, self.nonce).and_then(|()| gates::empty_handed(outside));
        if let Err(closed) = open {
            return self.wait_or_bring_up(now, outside, closed, out);
        }
        if self.seen.is_some() && now.since(self.seen_at) > self.model.tolerances.observation_age {
            say(out, "the table was seen too long ago; looking again");
            self.seen = None;
        }
        if self.park_wanted {
            self.begin_park(outside, out);
        } else if self.seen.is_none() {
            self.begin_look(now, outside, 0, out);
        } else {
            self.compare_and_continue(now, outside, out);
        }
    }

    fn on_robot(&mut self, now: Timestamp, outside: &Outside, event: RobotEvent, out: &mut Vec<Action>) {
        match event {
            RobotEvent::PathFinished { .. } => match &self.phase {
                Phase::Look(_) => self.look_pose_reached(),
                Phase::Work(_) => self.work_path_finished(out),
                Phase::Park => {
                    self.phase = Phase::Ready;
                    self.park_wanted = false;
                }
                Phase::Ready | Phase::BringUp(_) | Phase::Plan | Phase::Approve => {}
            },
            other => self.on_robot_trouble(now, outside, other, out),
        }
    }

    fn on_gripper(&mut self, now: Timestamp, event: GripperEvent, out: &mut Vec<Action>) {
        if matches!(self.phase, Phase::Work(_)) {
            self.work_gripper(now, event, out);
        }
    }

    /// Ends the active job, if there is one, with this report.
    pub(crate) fn finish(
        &mut self,
        now: Timestamp,
        end: JobEnd,
        code: &str,
        message: &str,
        remedy: &str,
        out: &mut Vec<Action>,
    ) {
        self.waiting_for = None;
        let Some(job) = self.job.take() else { return };
        let objects = job
            .order
            .goals
            .iter()
            .map(|(id, goal)| ObjectResult {
                id: id.clone(),
                goal: Some(*goal),
                measured: job.last_seen.iter().find(|(seen, _)| seen == id).map(|(_, pose)| *pose),
            })
            .collect();
        say(out, format!("job {}: {message}", job.order.id));
        out.push(Action::Finish(Box::new(JobReport {
            id: job.order.id,
            end,
            code: code.to_string(),
            message: message.to_string(),
            remedy: remedy.to_string(),
            moves: job.moves,
            lower_bound: job.lower_bound,
            planned: job.planned,
            planning_seconds: job.planning_seconds,
            seconds: now.since(job.started).as_secs_f64(),
            objects,
        })));
    }
}

impl WorkStage {
    fn verb(self) -> &'static str {
        match self {
            WorkStage::Approaching => "approaching",
            WorkStage::Gripping => "gripping",
            WorkStage::Carrying => "carrying",
            WorkStage::Releasing => "releasing",
            WorkStage::Retreating => "retreating from",
            WorkStage::GivingUp | WorkStage::Withdrawing => "giving up",
        }
    }
}

/// An ordinary sentence for the operator.
pub(crate) fn say(out: &mut Vec<Action>, text: impl Into<String>) {
    out.push(Action::Say(Notice { alarm: false, text: text.into() }));
}

/// A sentence that asks somebody to act.
pub(crate) fn alarm(out: &mut Vec<Action>, text: impl Into<String>) {
    out.push(Action::Say(Notice { alarm: true, text: text.into() }));
}
