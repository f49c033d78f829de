//! Looking at the table: going round the look poses, judging what was seen, deciding what to do about it.
//!
//! A frame counts only if the arm was at rest before and after it was taken. What a look shows is valid
//! until an object is picked, placed or dropped, or the cell was stopped.

use crate::cell::code::{Code, JobStatus};
use crate::cell::device::robot_types::RobotCommand;
use crate::cell::orders::Approval;
use crate::cell::supervisor::cell::Supervisor;
use crate::cell::supervisor::gates;
use crate::cell::supervisor::input::{Action, CameraFault, DeviceSnapshot, PlanAnswer, PlanRequest};
use crate::cell::supervisor::judge::foreign_height;
use crate::cell::supervisor::model::CellObject;
use crate::cell::supervisor::order::RouteAction;
use crate::cell::supervisor::phase::{JobRun, Look, LookStage, Phase};
use crate::cell::supervisor::reason::{Reason, alarm, say};
use crate::cell::supervisor::travel::NoTravel;
use crate::motion::cycle_time::CycleTimes;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::observe::{Observation, View};
use rearrange::geometry::collision::penetration;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::check::CheckedPlan;
use rearrange::planning::plan::{Action as PlanAction, ActionKind};
use rearrange::planning::problem::Problem;
use rearrange::tabletop::instance::{Instance, ObjectSpec};

/// The arm counts as still below this joint speed, rad/s: 0.5 mm/s at the tool.
const STILL_RAD_S: f64 = 5e-4;

/// And as not having moved during a frame below this joint difference, rad.
const SAME_PLACE_RAD: f64 = 2e-4;

/// Part of the planner's clearance that a running plan must still keep after placing errors.
const CLEARANCE_SHARE: f64 = 0.3;

/// Overlap that measured arrangements may have (design, section 3): so many standard deviations of the
/// distance of two objects, and no less than the world's grain.
const OVERLAP_STDS: f64 = 3.0;
const LEAST_OVERLAP_M: f64 = 5e-4;

impl Supervisor {
    /// Sends the arm to look pose `view`.
    pub(crate) fn begin_look(
        &mut self,
        now: Timestamp,
        outside: &DeviceSnapshot,
        view: usize,
        out: &mut Vec<Action>,
    ) {
        let Some(robot) = outside.robot else { return };
        let Some(target) = self.model.look_poses.get(view).copied() else { return };
        let views = match &mut self.phase {
            Phase::Look(look) => std::mem::take(&mut look.views),
            Phase::Ready
            | Phase::BringUp(_)
            | Phase::Plan
            | Phase::Approve
            | Phase::Work(_)
            | Phase::Park
            | Phase::Visit(_)
            | Phase::Recover(_) => Vec::new(),
        };
        match self.transfer_to(&robot.q, target) {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                let look = Look { view, stage: LookStage::Moving, views, fault: None, void: false };
                self.enter(Phase::Look(look), self.model.tolerances.look_deadline);
            }
            Err(fault) => self.no_way_to_look(now, view, (&robot.q, &fault), out),
        }
    }

    /// The look pose cannot be reached from here: a person has to see why.
    fn no_way_to_look(
        &mut self,
        now: Timestamp,
        view: usize,
        (from, fault): (&Joints, &NoTravel),
        out: &mut Vec<Action>,
    ) {
        self.phase = Phase::Ready;
        let message = format!("look pose {} cannot be reached: {fault}", view + 1);
        let advice = self.advice(from, fault);
        if self.back.recovery.is_some() {
            return self.end_recovery(Err(format!("{message}; {advice}")), out);
        }
        self.mode.disarm();
        let in_the_way = fault.meets_layer() && self.foreign_height > self.model.cycle.tallest;
        let reason = if in_the_way && self.foreign_height.is_finite() {
            let height_mm = self.foreign_height * 1e3;
            let what = format!("something without a marker reaches up to {height_mm:.0} mm over the table");
            Code::ForeignObject.because(format!("{message}; {what}"), "take it away, then `celld arm`")
        } else if in_the_way {
            let what =
                "something without a marker is on the table; without a depth camera its height is not known";
            Code::ForeignObject.because(what, "take it away, then `celld arm`")
        } else {
            Code::Unreachable.because(message, format!("{advice}, then `celld arm` and submit again"))
        };
        alarm(out, format!("{}; disarmed; {}", reason.message, reason.hint));
        self.finish(now, JobStatus::Failed, reason, out);
    }

    pub(crate) fn look_pose_reached(&mut self) {
        if let Phase::Look(Look { stage: stage @ LookStage::Moving, .. }) = &mut self.phase {
            *stage = LookStage::Settling { still_since: None };
        }
    }

    /// While settling: requests frames once the arm has been at rest long enough.
    pub(crate) fn watch_settling(&mut self, now: Timestamp, outside: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Phase::Look(Look { stage: LookStage::Settling { still_since }, .. }) = &mut self.phase else {
            return;
        };
        let Some(robot) = outside.robot.filter(|_| outside.robot_fresh) else { return };
        if robot.qd.iter().any(|speed| speed.abs() > STILL_RAD_S) {
            *still_since = None;
            return;
        }
        let since = *still_since.get_or_insert(now);
        if now.since(since) >= self.model.tolerances.settle {
            let table_from_camera = self.model.camera_at(&robot.q);
            out.push(Action::Capture { frames: self.model.frames_per_view, table_from_camera });
            if let Phase::Look(look) = &mut self.phase {
                look.stage = LookStage::Capturing { q: robot.q };
            }
        }
    }

    pub(crate) fn on_captured(
        &mut self,
        now: Timestamp,
        outside: &DeviceSnapshot,
        result: Result<Vec<View>, CameraFault>,
        out: &mut Vec<Action>,
    ) {
        let Phase::Look(look) = &mut self.phase else { return };
        let LookStage::Capturing { q } = &look.stage else { return };
        let moved = outside.robot.is_none_or(|robot| robot.q.max_difference(q) > SAME_PLACE_RAD);
        match result {
            Ok(views) if !moved => {
                if look.fault.take().is_some() {
                    say(out, "the camera gives pictures again");
                }
                look.views.extend(views);
            }
            Ok(_) => {
                say(out, "the arm moved while a frame was taken; taking it again");
                look.stage = LookStage::Settling { still_since: None };
                return;
            }
            Err(fault) => return self.no_picture(now, fault, out),
        }
        let next = look.view + 1;
        if next < self.model.look_poses.len() {
            // Much may have happened since the first pose: a person may have disarmed the cell.
            if gates::any_motion(self.mode.armed(), outside, self.nonce).is_err() {
                self.phase = Phase::Ready;
                return;
            }
            self.begin_look(self.clock(), outside, next, out);
        } else {
            look.stage = LookStage::Observing;
            out.push(Action::Observe(std::mem::take(&mut look.views)));
        }
    }

    /// The arm is at rest and waits for the camera; the look's deadline decides when this has gone on for
    /// too long.
    fn no_picture(&mut self, now: Timestamp, fault: CameraFault, out: &mut Vec<Action>) {
        if self.job.as_ref().is_some_and(|job| job.cancel) {
            // This picture is not awaited any more.
            self.phase = Phase::Ready;
            return;
        }
        if fault.lasting {
            return self.give_up_looking(now, &fault, out);
        }
        let Phase::Look(look) = &mut self.phase else { return };
        look.stage = LookStage::Settling { still_since: None };
        if look.fault.as_ref().is_none_or(|before| before.code != fault.code) {
            alarm(
                out,
                format!(
                    "waiting for the camera ({}): {}; the arm moves on as soon as a picture comes, `celld \
                     disarm` before going to it; {}",
                    fault.code, fault.message, fault.hint
                ),
            );
        }
        look.fault = Some(fault);
    }

    /// Ends the job for want of a picture. The arm is at rest, nothing hangs on it and nothing was stopped,
    /// so the cell stays armed: the next job looks again.
    pub(crate) fn give_up_looking(&mut self, now: Timestamp, fault: &CameraFault, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        self.seen = None;
        if self.back.recovery.is_some() {
            return self.end_recovery(Err(format!("{}; {}", fault.message, fault.hint)), out);
        }
        let reason = fault.code.because(fault.message.clone(), fault.hint);
        self.finish(now, JobStatus::Failed, reason, out);
    }

    pub(crate) fn on_observed(
        &mut self,
        now: Timestamp,
        result: Result<Box<Observation>, String>,
        out: &mut Vec<Action>,
    ) {
        if !matches!(self.phase, Phase::Look(Look { stage: LookStage::Observing, .. })) {
            return;
        }
        self.phase = Phase::Ready;
        let observation = match result {
            Ok(observation) => *observation,
            Err(reason) => {
                let hint = "check the camera's calibration and the markers in the configuration";
                if self.back.recovery.is_some() {
                    return self.end_recovery(Err(format!("{reason}; {hint}")), out);
                }
                self.finish(now, JobStatus::Failed, Code::Observation.because(reason, hint), out);
                return;
            }
        };
        if self.back.recovery.is_some() {
            return self.on_recovery_look(now, observation, out);
        }
        self.back.table = observation.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
        if self.sticks(now, &observation, out) {
            return;
        }
        let fault = self.judge(&observation);
        if let Some(height) = foreign_height(&self.model, &observation) {
            self.foreign_height = height;
        }
        self.report_obstacles(&observation, out);
        if fault.is_none() {
            self.report_drift(&observation, out);
        }
        let Some(job) = &mut self.job else { return };
        for object in &observation.objects {
            job.last_seen.retain(|(id, _)| *id != object.id);
            job.last_seen.push((object.id.clone(), object.pose));
        }
        match fault {
            None => {
                job.look_failures = 0;
                report_absent(job, &observation, out);
                self.seen = Some(observation);
                self.seen_at = now;
            }
            Some(doubt) => self.look_again(now, doubt, out),
        }
    }

    /// What was seen cannot be acted upon: another look, or the end of the job.
    fn look_again(&mut self, now: Timestamp, doubt: Reason, out: &mut Vec<Action>) {
        let goes_on = self.mode.armed() && !self.mode.paused();
        let Some(job) = &mut self.job else { return };
        if job.look_failures >= self.model.tolerances.retries {
            return self.finish(now, JobStatus::Failed, doubt, out);
        }
        job.look_failures += 1;
        let again = if goes_on && !job.cancel { "; the arm looks again now" } else { "" };
        say(out, format!("{}{again}", doubt.message));
    }

    /// The table is known: done, go on with the route, or plan.
    pub(crate) fn compare_and_continue(
        &mut self,
        now: Timestamp,
        outside: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        let (Some(job), Some(seen)) = (&self.job, &self.seen) else { return };
        let there = |(id, goal): &(String, Pose2)| {
            seen.objects.iter().any(|object| object.id == *id && self.model.at_goal(&object.pose, goal))
        };
        if job.order.goals.iter().all(there) {
            self.finish(now, JobStatus::Done, Code::Done.because("every object is at its goal", ""), out);
            return;
        }
        match self.checked_remainder(job, seen) {
            Some(route) => {
                if let Some(job) = &mut self.job {
                    job.route = Some(route);
                }
                self.begin_pick_n_place(now, outside, out);
            }
            None => self.request_plan(now, out),
        }
    }

    /// The rest of the route on the table as it was seen, if the checker still accepts it.
    fn checked_remainder(&self, job: &JobRun, seen: &Observation) -> Option<Vec<RouteAction>> {
        let mut route = job.route.clone().filter(|route| !route.is_empty())?;
        let instance = self.instance(job, seen, self.model.clearance * CLEARANCE_SHARE);
        let problem = Problem::new(&instance).ok()?;
        let mut at: Vec<(String, Pose2)> =
            seen.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
        let mut actions = Vec::with_capacity(route.len());
        for step in &mut route {
            let (_, pose) = at.iter_mut().find(|(id, _)| *id == step.object)?;
            let (position, angle) =
                (self.model.tolerances.expected_position, self.model.tolerances.expected_angle);
            if pose.distance(&step.from) > position || pose.angle_difference(&step.from) > angle {
                return None;
            }
            step.from = *pose;
            *pose = step.to;
            let object = problem.objects.iter().position(|object| object.id == step.object)?;
            let kind = if step.to_goal { ActionKind::Goal } else { ActionKind::Buffer };
            actions.push(PlanAction { object, from: step.from, to: step.to, kind });
        }
        CheckedPlan::new(&problem, &actions).ok().map(|_| route)
    }

    /// The table as seen, with the job's goals, as a planning instance.
    ///
    /// An object that counts as being at its goal is given its present pose as goal: it need not move, and
    /// it must not be nudged for the sake of a tenth of a millimetre. Unless it is then in the goal of
    /// another one: there the millimetre counts, for the other would be put down onto it.
    fn instance(&self, job: &JobRun, seen: &Observation, clearance: f64) -> Instance {
        let worst_std = seen.objects.iter().map(|estimate| estimate.std_xy_m).fold(0.0, f64::max);
        // What touches is measured as overlapping by the errors of two objects.
        let overlap_tolerance = (OVERLAP_STDS * std::f64::consts::SQRT_2 * worst_std).max(LEAST_OVERLAP_M);
        let mut objects = Vec::with_capacity(seen.objects.len());
        for estimate in &seen.objects {
            let Some(object) = self.model.object(&estimate.id) else { continue };
            let wanted = job.order.goals.iter().find(|(id, _)| *id == estimate.id).map(|(_, goal)| *goal);
            let goal = wanted.map(|goal| {
                let stays = self.model.at_goal(&estimate.pose, &goal)
                    && !self.stands_in_a_goal(job, object, &estimate.pose, overlap_tolerance);
                if stays { estimate.pose } else { goal }
            });
            objects.push(ObjectSpec {
                id: object.id.clone(),
                footprint: object.footprint.clone(),
                impedance: object.impedance,
                start: Some(estimate.pose),
                goal,
                fixed: false,
                group: None,
                height: Some(object.height),
                mass: Some(object.mass),
                marker: None,
                grippable: None,
            });
        }
        Instance {
            workspace: self.model.workspace,
            clearance,
            overlap_tolerance,
            keep_out: self.obstacles(seen),
            objects,
        }
    }

    /// True when the object at `pose` reaches into another object's goal by more than `tolerance`, m.
    fn stands_in_a_goal(&self, job: &JobRun, object: &CellObject, pose: &Pose2, tolerance: f64) -> bool {
        let others = job.order.goals.iter().filter(|(id, _)| *id != object.id);
        let mut others = others.filter_map(|(id, goal)| self.model.object(id).map(|known| (known, goal)));
        others.any(|(known, goal)| penetration(&object.footprint, pose, &known.footprint, goal) > tolerance)
    }

    fn request_plan(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let (Some(job), Some(seen)) = (&self.job, &self.seen) else { return };
        if job.replans > 0 && job.replans > self.model.tolerances.retries + job.moves as u32 {
            let message = format!("the table disagreed with the plan {} times", job.replans);
            let hint = "see that nothing else moves the objects, then submit again";
            self.finish(now, JobStatus::Failed, Code::TableDisturbed.because(message, hint), out);
            return;
        }
        let instance = self.instance(job, seen, self.model.clearance);
        let request = PlanRequest {
            instance,
            objective: job.order.objective,
            solver: job.order.solver,
            seed: job.order.seed.wrapping_add(u64::from(job.replans)),
            time_limit: job.order.time_limit,
            times: CycleTimes::new(&self.model.arm, &self.cycle(), self.model.after_a_look()),
            limits: self.plan_limits(seen),
        };
        let limit = request.time_limit + self.model.tolerances.plan_grace;
        if job.route.is_some() {
            say(out, "the table is not as the plan expects; planning again");
        }
        out.push(Action::Plan(Box::new(request)));
        self.enter(Phase::Plan, limit);
    }

    pub(crate) fn on_planned(&mut self, now: Timestamp, answer: PlanAnswer, out: &mut Vec<Action>) {
        if !matches!(self.phase, Phase::Plan) {
            return;
        }
        self.phase = Phase::Ready;
        let PlanAnswer::Found { actions, lower_bound, seconds, .. } = answer else {
            return self.on_no_plan(now, &answer, out);
        };
        let route = actions.iter().map(|action| {
            let to_goal = action.kind == ActionKind::Goal;
            let object = self.listed(action.object)?;
            Some(RouteAction { object, from: action.from, to: action.to, to_goal })
        });
        // Who disarmed the cell meanwhile may have changed the table: after arming it is looked at and
        // planned for anew, and no person is shown this plan.
        let Some(route) = route.collect::<Option<Vec<RouteAction>>>() else { return };
        let Some(job) = &mut self.job else { return };
        let buffers = route.iter().filter(|action| !action.to_goal).count();
        say(
            out,
            format!(
                "plan: {} pick-n-places, {buffers} of them to a temporary place, lower bound {lower_bound}",
                route.len()
            ),
        );
        if job.planned.is_none() {
            job.planned = Some((route.len(), buffers));
            job.lower_bound = Some(lower_bound);
            job.planning_seconds = seconds;
        }
        job.replans += 1;
        job.route = Some(route);
        job.approved = match job.order.approval {
            Approval::Never => true,
            Approval::Job => job.approved,
            Approval::Always => false,
        };
        if !job.approved {
            alarm(out, format!("job {}: the plan waits for approval", job.order.id));
            self.phase = Phase::Approve;
        }
    }

    fn on_no_plan(&mut self, now: Timestamp, answer: &PlanAnswer, out: &mut Vec<Action>) {
        let reason = match answer {
            PlanAnswer::Infeasible(witness) => {
                Code::Infeasible.because(format!("there is no plan: {witness}"), "change the goal")
            }
            PlanAnswer::Refused(cause) => {
                let message = format!("the measured table is no valid start: {cause}");
                Code::BadStart.because(
                    message,
                    "move what is named apart, or onto the table, by hand; then submit again",
                )
            }
            PlanAnswer::Unsolvable(cause) => {
                Code::SolverUnfit.because(cause.clone(), "choose another solver or objective in the job")
            }
            PlanAnswer::OutOfReach(fault) => {
                let hint = match fault.buffer {
                    None => fault.remedy,
                    Some(_) => {
                        "there is too little room to put things aside within reach: clear the table a \
                         little, or give the job a longer time_limit_s"
                    }
                };
                Code::Unreachable.because(fault.message.clone(), hint).of(fault.name.clone())
            }
            PlanAnswer::Timeout | PlanAnswer::Found { .. } => {
                let hint =
                    "give the job a longer time_limit_s; or `celld disarm`, then clear the table a little";
                Code::NoPlan.because("no plan was found in time", hint)
            }
        };
        self.finish(now, JobStatus::Failed, reason, out);
    }
}

/// Names once what is in the catalogue and not seen.
fn report_absent(job: &mut JobRun, seen: &Observation, out: &mut Vec<Action>) {
    if !std::mem::replace(&mut job.absent_reported, true) && !seen.missing.is_empty() {
        let absent = seen.missing.join(", ");
        alarm(out, format!("not seen: {absent}; the plan is made as if they were not on the table"));
    }
}
