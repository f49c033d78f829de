//! From what is seen to what is done: the rest of the route, a plan, or the end of the job.
//!
//! In: the table as it was seen, the job's goals, the planner's answer. Out: the next pick-n-place, a plan
//! request, a job that is done or has failed. A route goes on only while the independent checker accepts its
//! rest on the table as it is.

use crate::code::{Code, JobStatus};
use crate::orders::Approval;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, DeviceSnapshot, PlanAnswer, PlanRequest};
use crate::supervisor::model::CellObject;
use crate::supervisor::order::{JobOrder, RouteAction};
use crate::supervisor::phase::{JobRun, Phase};
use crate::supervisor::reason::{Reason, alarm, say};
use cell_motion::cycle_time::CycleTimes;
use cell_values::time::Timestamp;
use cell_vision::observe::Observation;
use rearrange::geometry::collision::penetration;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::check::CheckedPlan;
use rearrange::planning::plan::{Action as PlanAction, ActionKind};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::reaches;
use rearrange::tabletop::instance::{Instance, ObjectSpec};

/// Part of the planner's clearance that a running plan must still keep after placing errors.
const CLEARANCE_SHARE: f64 = 0.3;

/// Overlap that measured arrangements may have (design, section 3): so many standard deviations of the
/// distance of two objects, and no less than the world's grain.
const OVERLAP_STDS: f64 = 3.0;
const LEAST_OVERLAP_M: f64 = 5e-4;

/// What touches is measured as overlapping by the errors of two objects, m.
pub(crate) fn overlap_tolerance(seen: &Observation) -> f64 {
    let worst_std = seen.objects.iter().map(|estimate| estimate.std_xy_m).fold(0.0, f64::max);
    (OVERLAP_STDS * std::f64::consts::SQRT_2 * worst_std).max(LEAST_OVERLAP_M)
}

impl Supervisor {
    /// The table is known: done, go on with the route, or plan.
    pub(crate) fn compare_and_continue(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        if !self.settle_goals(now, out) {
            return;
        }
        let (Some(job), Some(seen)) = (&self.job, &self.seen) else { return };
        let done = self.all_at_goals(job, seen);
        if done && self.sight.whole {
            let what = match job.order.goals.is_empty() {
                true => "the table was looked at",
                false => "every object is at its goal",
            };
            self.finish(now, JobStatus::Done, Code::Done.because(what, ""), out);
            return;
        }
        match self.checked_remainder(job, seen) {
            Some(route) if !done => {
                if let Some(job) = &mut self.job {
                    job.route = Some(route);
                }
                self.begin_pick_n_place(now, devices, out);
            }
            // A job ends, and a plan is made, on a look at the whole table.
            Some(_) | None if !self.sight.whole => self.begin_whole_look(now, devices, out),
            Some(_) | None => self.request_plan(now, out),
        }
    }

    /// Every object of a job is where the job wants it.
    pub(crate) fn all_at_goals(&self, job: &JobRun, seen: &Observation) -> bool {
        let there = |(id, goal): &(String, Pose2)| {
            seen.objects.iter().any(|object| object.id == *id && self.model.at_goal(&object.pose, goal))
        };
        job.order.goals.iter().all(there)
    }

    /// The rest of the route on the table as it was seen, if the checker still accepts it.
    pub(crate) fn checked_remainder(&self, job: &JobRun, seen: &Observation) -> Option<Vec<RouteAction>> {
        let mut route = job.route.clone().filter(|route| !route.is_empty())?;
        let instance = self.instance(&job.order.goals, seen, self.model.clearance * CLEARANCE_SHARE);
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
    fn instance(&self, goals: &[(String, Pose2)], seen: &Observation, clearance: f64) -> Instance {
        let overlap_tolerance = overlap_tolerance(seen);
        let mut objects = Vec::with_capacity(seen.objects.len());
        for estimate in &seen.objects {
            let Some(object) = self.model.object(&estimate.id) else { continue };
            let wanted = goals.iter().find(|(id, _)| *id == estimate.id).map(|(_, goal)| *goal);
            let goal = wanted.map(|goal| {
                let stays = self.model.at_goal(&estimate.pose, &goal)
                    && !self.stands_in_a_goal(goals, object, &estimate.pose, overlap_tolerance);
                if stays { estimate.pose } else { goal }
            });
            objects.push(ObjectSpec {
                impedance: object.impedance,
                start: Some(estimate.pose),
                goal,
                height: Some(object.height),
                mass: Some(object.mass),
                ..ObjectSpec::new(&object.id, object.footprint.clone())
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
    fn stands_in_a_goal(
        &self,
        goals: &[(String, Pose2)],
        object: &CellObject,
        pose: &Pose2,
        tolerance: f64,
    ) -> bool {
        let others = goals.iter().filter(|(id, _)| *id != object.id);
        let mut others = others.filter_map(|(id, goal)| self.model.object(id).map(|known| (known, goal)));
        others.any(|(known, goal)| penetration(&object.footprint, pose, &known.footprint, goal) > tolerance)
    }

    /// What the arm takes for pick-n-places, looks between them included.
    pub(crate) fn cycle_times(&self) -> CycleTimes {
        let times = CycleTimes::new(&self.model.arm, &self.cycle(), self.model.after_a_look());
        match self.model.views() {
            Some(views) => times.looking(views.tool_heights(&self.model.arm)),
            None => times,
        }
    }

    fn request_plan(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.withdraw_meant(now, out);
        let (Some(job), Some(seen)) = (&self.job, &self.seen) else { return };
        if job.replans > 0 && job.replans > self.model.tolerances.retries + job.moves as u32 {
            let message = format!("the table disagreed with the plan {} times", job.replans);
            let hint = "see that nothing else moves the objects, then submit again";
            self.finish(now, JobStatus::Failed, Code::TableDisturbed.because(message, hint), out);
            return;
        }
        let request = self.plan_request(&job.order, job.replans, &job.order.goals, seen);
        let limit = request.time_limit + self.model.tolerances.plan_grace;
        if job.route.is_some() {
            say(out, "the table is not as the plan expects; planning again");
        }
        out.push(Action::Plan(Box::new(request)));
        self.enter(Phase::Plan, limit);
    }

    /// The problem of a job on the table as it was seen.
    pub(crate) fn plan_request(
        &self,
        order: &JobOrder,
        replans: u32,
        goals: &[(String, Pose2)],
        seen: &Observation,
    ) -> PlanRequest {
        PlanRequest {
            instance: self.instance(goals, seen, self.model.clearance),
            objective: order.objective,
            solver: order.solver,
            seed: order.seed.wrapping_add(u64::from(replans)),
            time_limit: order.time_limit,
            times: self.cycle_times(),
            limits: self.plan_limits(seen),
            known_plan: Vec::new(),
        }
    }

    /// The actions of an answer by the names of what they move.
    pub(crate) fn route_of(&self, actions: &[PlanAction], seen: &Observation) -> Option<Vec<RouteAction>> {
        let route = actions.iter().map(|action| {
            let to_goal = action.kind == ActionKind::Goal;
            let object = self.listed(seen, action.object)?;
            Some(RouteAction { object, from: action.from, to: action.to, to_goal })
        });
        route.collect()
    }

    pub(crate) fn on_planned(&mut self, now: Timestamp, answer: PlanAnswer, out: &mut Vec<Action>) {
        if !matches!(self.phase, Phase::Plan) {
            return match self.job.as_mut().and_then(|job| job.improving.take()) {
                Some(improving) => self.on_improved(now, improving, &answer, out),
                None => self.on_preview(now, &answer, out),
            };
        }
        self.phase = Phase::Ready;
        let PlanAnswer::Found { actions, cost, lower_bound, seconds } = answer else {
            let reason = why_no_plan(&answer);
            return self.finish(now, JobStatus::Failed, reason, out);
        };
        // Who disarmed the cell meanwhile may have changed the table: after arming it is looked at and
        // planned for anew, and no person is shown this plan.
        let Some(seen) = &self.seen else { return };
        let Some(route) = self.route_of(&actions, seen) else { return };
        let note = self.plan_note(&route, lower_bound, seen, None);
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
        job.improvable = !reaches(cost, lower_bound);
        job.approved = match job.order.approval {
            Approval::Never => true,
            Approval::Job => job.approved || !job.order.agreed.is_empty(),
            Approval::Always => self.model.is_rest_of(&route, &job.order.agreed),
        };
        job.route = Some(route);
        self.commit_plan(now, note, out);
        let Some(job) = &self.job else { return };
        if !job.approved {
            alarm(out, format!("job {}: the plan waits for approval", job.order.id));
            self.phase = Phase::Approve;
        }
    }
}

/// Why a search came to no plan, and what a person can do.
pub(crate) fn why_no_plan(answer: &PlanAnswer) -> Reason {
    match answer {
        PlanAnswer::Infeasible(witness) => {
            Code::Infeasible.because(format!("there is no plan: {witness}"), "change the goal")
        }
        PlanAnswer::Refused(cause) => {
            let message = format!("the measured table is no valid start: {cause}");
            Code::BadStart
                .because(message, "move what is named apart, or onto the table, by hand; then submit again")
        }
        PlanAnswer::Unsolvable(cause) => {
            Code::SolverUnfit.because(cause.clone(), "choose another solver or objective in the job")
        }
        PlanAnswer::Failed(cause) => {
            let hint =
                "submit the job again with another seed or solver, and report this as a fault of celld";
            Code::PlannerStuck.because(format!("the planner failed: {cause}"), hint)
        }
        PlanAnswer::OutOfReach(fault) => {
            let hint = match fault.buffer {
                None => fault.hint.as_ref(),
                Some(_) => {
                    "there is too little room to put things aside within reach: clear the table a \
                         little, or give the job a longer time_limit_s"
                }
            };
            Code::Unreachable.because(fault.message.clone(), hint).of(fault.name.clone())
        }
        PlanAnswer::Timeout | PlanAnswer::Found { .. } => {
            let hint = "give the job a longer time_limit_s; or `celld disarm`, then clear the table a little";
            Code::NoPlan.because("no plan was found in time", hint)
        }
    }
}
