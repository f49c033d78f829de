//! A better rest of the plan, searched for while the arm moves.
//!
//! In: the route, and the table as it will be after the pick-n-place under way. Out: a plan request that
//! names the rest as it is; what is found before that pick-n-place is over takes its place. A plan that is
//! proved to be the best is left as it is. So is one of which a person approves every change: the arm would
//! have to wait for that, and the person has agreed to this one.

use crate::orders::Approval;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, PlanAnswer, PlanRequest};
use crate::supervisor::order::RouteAction;
use crate::supervisor::phase::{Improving, Phase};
use crate::supervisor::reason::say;
use cell_values::time::{Duration, Timestamp};
use cell_vision::observe::Observation;
use rearrange::planning::plan::{Action as PlanAction, ActionKind};
use rearrange::planning::solver::reaches;

/// The search takes this share of a pick-n-place: after it the order and the paths of what was found are
/// tried, and from the release on the answer is of no use.
const SEARCHED: f64 = 0.5;

impl Supervisor {
    /// The arm sets out for a pick-n-place: meanwhile what comes after it is planned again.
    pub(crate) fn begin_improving(&mut self, out: &mut Vec<Action>) {
        let improvement = self.improvement();
        let Some(job) = &mut self.job else { return };
        job.improving = None;
        if let Some((improving, request)) = improvement {
            job.improving = Some(improving);
            out.push(Action::Plan(Box::new(request)));
        }
    }

    fn improvement(&self) -> Option<(Improving, PlanRequest)> {
        let (job, seen) = (self.job.as_ref()?, self.seen.as_ref()?);
        let [under_way, rest @ ..] = job.route.as_deref()? else { return None };
        // A single pick-n-place has no order, and nothing shorter.
        if !job.improvable || rest.len() < 2 || job.order.approval == Approval::Always {
            return None;
        }
        let mut expected = seen.clone();
        expected.objects.iter_mut().find(|object| object.id == under_way.object)?.pose = under_way.to;
        let known_plan = self.actions_of(rest, &expected)?;
        // Another seed for every pick-n-place.
        let attempt = job.replans.saturating_add(job.moves as u32);
        let request = self.plan_request(&job.order, attempt, &job.order.goals, &expected);
        let lasts_s = self.seconds_of(std::slice::from_ref(under_way));
        let time_limit = request.time_limit.min(Duration::from_secs_f64(SEARCHED * lasts_s));
        let request = PlanRequest { known_plan, time_limit, ..request };
        Some((Improving { step: job.moves, expected }, request))
    }

    /// A route as a planner has it, on the table as it will be.
    fn actions_of(&self, route: &[RouteAction], expected: &Observation) -> Option<Vec<PlanAction>> {
        let action = |action: &RouteAction| {
            let mut listed = (0..expected.objects.len()).map_while(|index| self.listed(expected, index));
            let object = listed.position(|id| id == action.object)?;
            let kind = if action.to_goal { ActionKind::Goal } else { ActionKind::Buffer };
            Some(PlanAction { object, from: action.from, to: action.to, kind })
        };
        route.iter().map(action).collect()
    }

    /// The planner's word on the rest of the plan. What comes too late, or is none, changes nothing, and
    /// nothing changes where the job does not go on by itself.
    pub(crate) fn on_improved(
        &mut self,
        now: Timestamp,
        improving: Improving,
        answer: &PlanAnswer,
        out: &mut Vec<Action>,
    ) {
        let under_way = matches!(&self.phase, Phase::Work(work) if !work.over) && self.mode.runs();
        let PlanAnswer::Found { actions, cost, lower_bound, .. } = answer else { return };
        let Some(rest) = self.route_of(actions, &improving.expected) else { return };
        let Some(job) = &mut self.job else { return };
        if !under_way || job.cancel || job.moves != improving.step {
            return;
        }
        job.improvable = !reaches(*cost, *lower_bound);
        let Some([first, old @ ..]) = job.route.as_deref() else { return };
        if old == rest {
            return;
        }
        let (first, old) = (first.clone(), old.to_vec());
        let text = format!(
            "a better rest of the plan: {} pick-n-places in about {:.1} s, in place of {} in {:.1} s",
            rest.len(),
            self.seconds_of(&rest),
            old.len(),
            self.seconds_of(&old),
        );
        say(out, text);
        // For people the plan begins with what is under way, on the table before that.
        let mut table = improving.expected;
        if let Some(object) = table.objects.iter_mut().find(|object| object.id == first.object) {
            object.pose = first.from;
        }
        let route: Vec<RouteAction> = std::iter::once(first).chain(rest).collect();
        let note = self.plan_note(&route, *lower_bound, &table, None);
        if let Some(job) = &mut self.job {
            job.route = Some(route);
        }
        self.commit_plan(now, note, out);
    }

    fn seconds_of(&self, route: &[RouteAction]) -> f64 {
        self.cycle_times().seconds(route.iter().map(|action| (action.from, action.to)))
    }
}
