//! The supervisor's states, and the one function through which everything comes in.
//!
//! In: time, the devices' last state, one [`Input`]. Out: actions, to be carried out in order.
//! Level-triggered: between two things the supervisor is `Ready` and `pursue` decides from what is known
//! what comes next, so that a lost edge cannot leave it hanging. Every phase has a deadline that runs with
//! the robot's speed slider, and is held while the program is paused. What must be on disk first is a phase
//! too: it waits for the number of its record.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::{Channels, GripperEvent};
use crate::device::program::Nonce;
use crate::device::robot_types::{KnownRobot, RobotCommand, RobotEvent};
use crate::intake::Unreachable;
use crate::orders::Order;
use crate::supervisor::back::{Back, LastStop};
use crate::supervisor::gates::{self, GateClosed, motion_speed};
use crate::supervisor::input::{Action, DeviceSnapshot, Input, Record};
use crate::supervisor::ledger::Ledger;
use crate::supervisor::look_plan::Sight;
use crate::supervisor::mode::Mode;
use crate::supervisor::model::CellModel;
use crate::supervisor::order::{JobOrder, JobReport, ObjectReport, RouteAction};
use crate::supervisor::phase::{Glance, JobRun, LookStage, Meant, Phase, Quiet, UntilItStands, Visit};
use crate::supervisor::reason::{Reason, say};
use crate::supervisor::round::Round;
use crate::times::TimeBook;
use cell_values::time::{Duration, Timestamp};
use cell_vision::observe::Observation;
use serde::{Deserialize, Serialize};

/// What looks have shown, as far as it is still so: until something is dropped or stopped.
pub(crate) type Seen = Observation;

/// The supervisor.
#[derive(Debug, Deserialize, Serialize)]
pub struct Supervisor {
    pub(crate) model: CellModel,
    /// Which robot it is for.
    pub(crate) robot: KnownRobot,
    pub(crate) phase: Phase,
    pub(crate) mode: Mode,
    pub(crate) ledger: Ledger,
    pub(crate) job: Option<JobRun>,
    pub(crate) round: Option<Round>,
    /// Number of the plan that was made last.
    pub(crate) plans: u64,
    pub(crate) seen: Option<Seen>,
    /// When the look behind `seen` was over.
    pub(crate) seen_at: Timestamp,
    /// The last sight of the whole table, for previews.
    pub(crate) glance: Option<Glance>,
    /// How much of `seen` holds.
    pub(crate) sight: Sight,
    /// The pick-n-place that was written down and has not begun.
    pub(crate) meant: Option<Meant>,
    /// Where the time of the active job goes.
    pub(crate) times: TimeBook,
    /// Height of what was last seen without a marker and counts as an obstacle, with its margin, m.
    pub(crate) foreign_height: f64,
    /// A look near the limits of drift was reported since the cell was armed.
    pub(crate) drift_reported: bool,
    /// What came of the last picture that was wanted.
    pub(crate) camera: Option<Result<(), String>>,
    /// Since when the arm has been held in the middle of a motion.
    pub(crate) held_since: Option<Timestamp>,
    /// Nonce of the program uploaded last.
    pub(crate) nonce: Option<Nonce>,
    /// The next nonce is made from this.
    pub(crate) next_nonce: u64,
    /// Time the phase may still take at full speed.
    pub(crate) remaining: Duration,
    last_now: Timestamp,
    /// Reason for waiting that was said last, so that it is said once.
    pub(crate) waiting_for: Option<GateClosed>,
    pub(crate) waiting_since: Timestamp,
    /// Releases whose answer is what the gripper says next.
    pub(crate) release_orders: Vec<(u64, Channels)>,
    /// Orders that are answered, or go on, once the arm is at rest.
    pub(crate) until_it_stands: Vec<UntilItStands>,
    /// The robot has reported standstill since it was last ordered to stop.
    pub(crate) stands: bool,
    /// A state of the robot has come: before that celld can have moved nothing.
    pub(crate) robot_seen: bool,
    /// Ways back after a stop, and what they need to know.
    pub(crate) back: Back,
    /// Neither power nor brakes that a stop took back may still come on.
    pub(crate) arm_settled: bool,
    /// Since when an armed cell has not moved, and where the arm rests.
    pub(crate) quiet: Option<Quiet>,
    /// A simulated cell that is to be armed without a person, once, when the gates first open.
    pub(crate) arms_when_open: bool,
    /// [`Action::End`] was given.
    pub(crate) ended: bool,
    /// Commands to the arm that wait for a paused program.
    pub(crate) held_back: Vec<Action>,
    pub(crate) unreachable: Option<Unreachable>,
}

impl Supervisor {
    /// A disarmed cell without a job. `nonce_seed` must differ from run to run.
    pub fn new(mut model: CellModel, nonce_seed: u64) -> Supervisor {
        let last_stop = model.cut_off.take().map(LastStop::of);
        let plans = model.plans_before;
        Supervisor {
            model,
            robot: KnownRobot::default(),
            phase: Phase::Ready,
            mode: Mode::Disarmed { paused: false },
            ledger: Ledger::default(),
            job: None,
            round: None,
            plans,
            seen: None,
            seen_at: Timestamp::ZERO,
            glance: None,
            sight: Sight::default(),
            meant: None,
            times: TimeBook::default(),
            foreign_height: 0.0,
            drift_reported: false,
            camera: None,
            held_since: None,
            nonce: None,
            next_nonce: nonce_seed,
            remaining: Duration::ZERO,
            last_now: Timestamp::ZERO,
            waiting_for: None,
            waiting_since: Timestamp::ZERO,
            release_orders: Vec::new(),
            until_it_stands: Vec::new(),
            stands: true,
            robot_seen: false,
            back: Back { last_stop, ..Back::default() },
            arm_settled: true,
            quiet: None,
            arms_when_open: false,
            ended: false,
            held_back: Vec::new(),
            unreachable: None,
        }
    }

    /// Arms a simulated cell without a person, once, when everything that arming needs is there. A stop or
    /// an order to disarm before that takes it back.
    pub fn arm_at_start(&mut self) {
        self.arms_when_open = true;
    }

    /// True when a job may be handed over.
    pub fn wants_job(&self) -> bool {
        let works = matches!(self.phase, Phase::Work(_));
        self.job.is_none() && self.round.is_none() && self.ledger.is_clear() && !self.mode.ending() && !works
    }

    /// True when nothing moves, nothing is waited for and nothing is to be done.
    pub fn is_idle(&self) -> bool {
        matches!(self.phase, Phase::Ready) && self.wants_job() && !self.mode.parks()
    }

    /// The measured arrangement, while it is valid.
    pub fn observation(&self) -> Option<&Observation> {
        self.seen.as_ref()
    }

    /// The remaining route of the active job.
    pub fn route(&self) -> Vec<RouteAction> {
        self.job.as_ref().and_then(|job| job.route.clone()).unwrap_or_default()
    }

    /// The cell as configured.
    pub fn model(&self) -> &CellModel {
        &self.model
    }

    /// Number of the plan that was made last: what an approval has to name.
    pub fn last_plan(&self) -> u64 {
        self.plans
    }

    /// The number that identifies the next program.
    pub fn next_nonce(&self) -> u64 {
        self.next_nonce
    }

    /// The program that was uploaded last, while it may still be the one that runs.
    pub fn nonce(&self) -> Option<Nonce> {
        self.nonce
    }

    /// Whether and how the cell may move.
    pub fn mode(&self) -> &Mode {
        &self.mode
    }

    /// The time handed in last.
    pub(crate) fn clock(&self) -> Timestamp {
        self.last_now
    }

    /// Takes one input and says what to do.
    pub fn step(&mut self, now: Timestamp, devices: &DeviceSnapshot, input: Input) -> Vec<Action> {
        let order = match &input {
            Input::Order { number, .. } => Some(*number),
            Input::Tick
            | Input::Robot(_)
            | Input::Gripper(_)
            | Input::Exposed
            | Input::Captured(_)
            | Input::Observed(_)
            | Input::Planned(_)
            | Input::Pictured(_)
            | Input::Committed { .. }
            | Input::StoreLost(_)
            | Input::OrdersReach(_)
            | Input::HeldUp(_)
            | Input::Job(_)
            | Input::Round(_)
            | Input::Shutdown => None,
        };
        self.robot_seen |= devices.robot_fresh && devices.robot.is_some();
        let mut actions = self.decide(now, devices, input);
        let path = |action: &Action| {
            matches!(action, Action::Robot(RobotCommand::Stream(_) | RobotCommand::SetOut(_)))
        };
        if actions.iter().any(path) {
            self.times.begins_path();
        }
        self.watch_standing(now, devices, order, &mut actions);
        self.hold_while_paused(devices, actions)
    }

    fn decide(&mut self, now: Timestamp, devices: &DeviceSnapshot, input: Input) -> Vec<Action> {
        let mut out = Vec::new();
        self.run_deadline(now, devices);
        match input {
            Input::Tick => self.watch(now, devices, &mut out),
            Input::Robot(event) => self.on_robot(now, devices, event, &mut out),
            Input::Gripper(event) => self.on_gripper(now, devices, event, &mut out),
            Input::Exposed => self.on_exposed(now, devices, &mut out),
            Input::Captured(result) => self.on_captured(now, devices, result, &mut out),
            Input::Observed(result) => self.on_observed(now, devices, result, &mut out),
            Input::Pictured(result) => self.on_pictured(result, &mut out),
            Input::Planned(answer) => self.on_planned(now, *answer, &mut out),
            Input::Committed { number, result } => self.on_committed(now, devices, number, result, &mut out),
            Input::StoreLost(fault) => self.on_store_lost(now, fault, &mut out),
            Input::OrdersReach(fault) => self.on_orders_reach(now, fault, &mut out),
            Input::HeldUp(gap) => self.on_held_up(now, gap, &mut out),
            Input::Job(order) => self.on_job(now, *order, &mut out),
            Input::Round(order) => self.on_round(now, devices, *order, &mut out),
            Input::Order { number, order } => return self.on_order(now, devices, number, order),
            Input::Shutdown => self.on_shutdown(now, &mut out),
        }
        self.pursue(now, devices, &mut out);
        out
    }

    /// An order is answered last, by what has become of it; one that waits for the arm to come to
    /// rest, then.
    fn on_order(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        order: Order,
    ) -> Vec<Action> {
        let mut out = Vec::new();
        let refusal = self.take_order(now, devices, number, &order, &mut out);
        self.pursue(now, devices, &mut out);
        let later = self.until_it_stands.iter().any(|waits| waits.number == number);
        let reply = refusal.or_else(|| self.answer(devices, &order).filter(|_| !later));
        out.extend(reply.map(|reply| Action::Reply { number, reply }));
        out
    }

    fn run_deadline(&mut self, now: Timestamp, devices: &DeviceSnapshot) {
        let speed = if self.follows_a_path() { motion_speed(devices) } else { 1.0 };
        let passed = now.since(self.last_now);
        self.book_time(devices, passed);
        self.remaining = self.remaining.saturating_sub(passed.mul_f64(speed));
        self.last_now = now;
    }

    /// True while the phase lasts as long as the arm takes for a path.
    pub(crate) fn follows_a_path(&self) -> bool {
        match &self.phase {
            Phase::Park | Phase::Visit(Visit::Moving) => true,
            Phase::Look(look) => matches!(look.stage, LookStage::Moving) || self.has_set_out(),
            Phase::Work(work) => work.stage.follows_a_path(),
            Phase::Recover(stage) => stage.follows_a_path(),
            Phase::Ready | Phase::BringUp(_) | Phase::Plan | Phase::Approve | Phase::Visit(_) => false,
        }
    }

    pub(crate) fn enter(&mut self, phase: Phase, limit: Duration) {
        self.phase = phase;
        self.remaining = limit;
        self.waiting_for = None;
    }

    pub(crate) fn on_job(&mut self, now: Timestamp, order: JobOrder, out: &mut Vec<Action>) {
        let wanted = match (&order.rule, order.goals.len()) {
            (Some(_), 0) => "its goal follows from what is seen".to_string(),
            (_, goals) => format!("{goals} goals"),
        };
        say(out, format!("job {} taken up: {wanted}", order.id));
        self.waiting_since = now;
        // What was seen for another job was not judged for this one.
        self.seen = None;
        self.meant = None;
        self.times = TimeBook::default();
        self.job = Some(JobRun {
            order,
            settled: false,
            preview: None,
            started: now,
            route: None,
            approved: false,
            improvable: false,
            improving: None,
            moves: 0,
            planned: None,
            lower_bound: None,
            planning_seconds: 0.0,
            replans: 0,
            grip_failures: 0,
            look_failures: 0,
            stops: 0,
            rejection: None,
            gone: Vec::new(),
            absent_reported: false,
            last_seen: Vec::new(),
            cancel: false,
        });
    }

    /// Decides what comes next when nothing is under way.
    fn pursue(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        if !matches!(self.phase, Phase::Ready) || self.mode.ending() {
            return;
        }
        if self.job.as_ref().is_some_and(|job| job.cancel) {
            self.finish(
                now,
                JobStatus::Cancelled,
                Code::Cancelled.because("the operator cancelled the job", ""),
                out,
            );
        }
        if self.back.recovery.is_some() {
            return self.pursue_recovery(now, devices, out);
        }
        if self.job.is_none() && self.round.is_none() && !self.mode.parks() {
            self.waiting_for = None;
            return;
        }
        self.begin_preview(now, out);
        // To park is an order of its own, which a pause does not hold back.
        if self.job.is_some() && self.mode.paused() && !self.mode.parks() {
            // The pause is the reason now, whatever was waited for before.
            self.waiting_for = None;
            return self.withdraw_meant(now, out);
        }
        let open = gates::any_motion(self.mode.armed(), devices, self.nonce);
        // A round only looks: it picks nothing, and the gripper need not be there.
        let open = if self.round.is_some() { open } else { open.and_then(|()| gates::empty_handed(devices)) };
        if let Err(closed) = open {
            self.withdraw_meant(now, out);
            return self.wait_or_bring_up(now, devices, closed, out);
        }
        if self.round.is_some() {
            return self.begin_visit(devices, out);
        }
        if self.seen.is_some() && now.since(self.seen_at) > self.model.tolerances.observation_age {
            say(out, "the table was seen too long ago; looking again");
            self.seen = None;
        }
        if self.mode.parks() {
            self.withdraw_meant(now, out);
            self.begin_park(devices, out);
        } else if !self.is_seen(now) {
            self.begin_look(now, devices, out);
        } else {
            self.compare_and_continue(now, devices, out);
        }
    }

    fn on_robot(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        event: RobotEvent,
        out: &mut Vec<Action>,
    ) {
        self.stands |= matches!(event, RobotEvent::Stopped);
        match event {
            RobotEvent::SegmentFinished { index: 0, .. } if matches!(self.phase, Phase::Work(_)) => {
                self.times.segment_over();
                self.work_segment_finished(now, out);
            }
            RobotEvent::SegmentFinished { .. } => self.times.segment_over(),
            RobotEvent::PathFinished { .. } => match &mut self.phase {
                Phase::Look(_) => self.look_pose_reached(now, out),
                Phase::Visit(visit) => *visit = Visit::Settling { rest: Default::default() },
                Phase::Work(_) => self.work_path_finished(now, out),
                Phase::Recover(stage) => {
                    let stage = *stage;
                    self.recovery_path_finished(devices, stage, out);
                }
                Phase::Park => {
                    self.phase = Phase::Ready;
                    self.mode.set_park(false);
                }
                Phase::Ready | Phase::BringUp(_) | Phase::Plan | Phase::Approve => {}
            },
            other => self.robot_fault_reason(now, devices, other, out),
        }
    }

    fn on_gripper(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        event: GripperEvent,
        out: &mut Vec<Action>,
    ) {
        self.answer_release(&event, out);
        if let Phase::Recover(stage) = self.phase {
            self.recovery_gripper(now, stage, &event, out);
        }
        self.note_vacuum(devices, &event, out);
        self.lost_on_the_way(now, &event, out);
        let silent = match event {
            GripperEvent::Unreachable { .. } => true,
            GripperEvent::GripFailed { .. } | GripperEvent::ReleaseFailed { .. } => !devices.gripper_answers,
            GripperEvent::Gripped { .. }
            | GripperEvent::Released
            | GripperEvent::VacuumWeak { .. }
            | GripperEvent::VacuumLost { .. }
            | GripperEvent::Answering
            | GripperEvent::Refused
            | GripperEvent::Reading { .. } => false,
        };
        if silent && self.gripper_needed() {
            return self.on_gripper_silent(now, devices.gripper_fault, out);
        }
        if matches!(self.phase, Phase::Work(_)) {
            self.work_gripper(now, devices, event, out);
        }
    }

    /// Has `record` written; the number under which the answer comes.
    pub(crate) fn commit(&mut self, now: Timestamp, record: Record, out: &mut Vec<Action>) -> u64 {
        let number = self.ledger.open(now);
        out.push(Action::Commit { number, record });
        number
    }

    /// Ends the active job, if there is one. It is over when its report is on disk.
    pub(crate) fn finish(&mut self, now: Timestamp, end: JobStatus, reason: Reason, out: &mut Vec<Action>) {
        self.waiting_for = None;
        self.withdraw_meant(now, out);
        let Some(job) = self.job.take() else { return };
        // The pause that was promised after a single step comes with the end at the latest: no other job
        // begins instead of it.
        self.mode.step_over();
        // The next job may begin at once: no hint sends hands to an armed arm.
        let first = self.mode.armed() && end == JobStatus::Failed && reason.code.needs_hands();
        let hint = match first && !reason.hint.is_empty() && !reason.hint.contains("celld disarm") {
            true => format!("`celld disarm`, then {}", reason.hint),
            false => reason.hint,
        };
        let object = |(id, goal): &(String, _)| {
            let seen = job.last_seen.iter().find(|seen| seen.id == *id && !seen.moved);
            let measured = seen.map(|seen| (seen.pose, now.since(seen.at)));
            ObjectReport { id: id.clone(), goal: Some(*goal), measured }
        };
        let objects = job.order.goals.iter().map(object).collect();
        say(out, format!("job {}: {}", job.order.id, reason.message));
        let report = JobReport {
            id: job.order.id,
            end,
            code: reason.code,
            object: reason.object,
            message: reason.message,
            hint,
            moves: job.moves,
            lower_bound: job.lower_bound,
            planned: job.planned,
            planning_seconds: job.planning_seconds,
            seconds: now.since(job.started).as_secs_f64(),
            times: self.times.close(),
            links_off_m: self.model.arm.kinematics.farthest_apart(),
            objects,
        };
        self.commit(now, Record::Ended(Box::new(report)), out);
    }
}
