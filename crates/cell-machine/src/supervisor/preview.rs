//! Plans for people: what is planned, with all that a person needs to judge it, and previews of it.
//!
//! In: a job of a disarmed cell, the last sight of the whole table. Out: a plan that is shown and never
//! carried out. It can be approved before and without arming; once armed, the cell looks, plans for what it
//! sees and needs a new approval where a move differs (`wanted`). What was seen counts for a preview until
//! the arm picks something; that a person has moved something since cannot be known, which is why the age
//! of the sight goes with it.

use crate::orders::Approval;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, PlanAnswer, PlanNote, PlanRequest, Record};
use crate::supervisor::order::RouteAction;
use crate::supervisor::phase::{Glance, JobRun, Phase, Preview};
use crate::supervisor::reason::{Reason, alarm, say};
use crate::supervisor::route::why_no_plan;
use cell_values::time::{Duration, Timestamp};
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;

impl Supervisor {
    /// Plans for a job of a disarmed cell on what was seen last, once.
    pub(crate) fn begin_preview(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let (Some(job), Some(glance)) = (&self.job, &self.glance) else { return };
        let shown = job.preview.is_some() || job.route.is_some();
        if self.mode.armed() || shown || self.back.recovery.is_some() {
            return;
        }
        let requested = match self.preview_request(job, glance) {
            Ok(request) => {
                out.push(Action::Plan(Box::new(request)));
                Preview::Requested
            }
            Err(reason) => {
                let (age, id) = (age_words(now, glance.at), &job.order.id);
                say(out, format!("job {id}: no preview from what was seen {age}: {}", reason.message));
                Preview::Never
            }
        };
        if let Some(job) = &mut self.job {
            // The next answer is the preview's.
            (job.preview, job.improving) = (Some(requested), None);
        }
    }

    fn preview_request(&self, job: &JobRun, glance: &Glance) -> Result<PlanRequest, Reason> {
        let goals = self.goals_on(&job.order, &glance.seen)?;
        Ok(self.plan_request(&job.order, 0, &goals, &glance.seen))
    }

    /// The planner's word on a preview.
    pub(crate) fn on_preview(&mut self, now: Timestamp, answer: &PlanAnswer, out: &mut Vec<Action>) {
        let (Some(job), Some(glance)) = (&self.job, &self.glance) else { return };
        if job.preview != Some(Preview::Requested) {
            return;
        }
        let (id, age) = (job.order.id.clone(), age_words(now, glance.at));
        let found = match answer {
            PlanAnswer::Found { actions, lower_bound, .. } => {
                let route = self.route_of(actions, &glance.seen);
                let age = now.since(glance.at);
                route.map(|route| (self.plan_note(&route, *lower_bound, &glance.seen, Some(age)), route))
            }
            PlanAnswer::Infeasible(_)
            | PlanAnswer::Timeout
            | PlanAnswer::Refused(_)
            | PlanAnswer::Unsolvable(_)
            | PlanAnswer::OutOfReach(_)
            | PlanAnswer::Failed(_) => None,
        };
        let Some((note, route)) = found else {
            let reason = why_no_plan(answer);
            say(out, format!("job {id}: no preview from what was seen {age}: {}", reason.message));
            self.set_preview(Preview::Never);
            return;
        };
        say(out, format!("job {id}: preview from what was seen {age}: {} pick-n-places", route.len()));
        self.set_preview(Preview::Made(route));
        self.commit_plan(now, note, out);
        if self.preview_waits() {
            alarm(out, format!("job {id}: the preview can be approved before the cell is armed"));
        }
    }

    /// Gives a plan its number and has it written down: from now on a person may agree to it, and to no
    /// earlier one.
    pub(crate) fn commit_plan(&mut self, now: Timestamp, note: PlanNote, out: &mut Vec<Action>) {
        self.plans += 1;
        let note = PlanNote { number: self.plans, ..note };
        self.commit(now, Record::Planned(Box::new(note)), out);
    }

    fn set_preview(&mut self, preview: Preview) {
        if let Some(job) = &mut self.job {
            job.preview = Some(preview);
        }
    }

    /// A preview is there that a person may approve, and none has been.
    pub(crate) fn preview_waits(&self) -> bool {
        let Some(job) = &self.job else { return false };
        let requests = job.order.approval != Approval::Never && !job.approved && job.order.agreed.is_empty();
        let made = matches!(&job.preview, Some(Preview::Made(route)) if !route.is_empty());
        matches!(self.phase, Phase::Ready) && !self.mode.armed() && made && requests
    }

    /// The cell is armed: it looks, and plans for what it sees.
    pub(crate) fn preview_over(&mut self) {
        if let Some(job) = self.job.as_mut().filter(|job| job.preview == Some(Preview::Requested)) {
            job.preview = None;
        }
    }

    /// A plan with what a person needs to judge it; for a preview with the age of what was seen.
    pub(crate) fn plan_note(
        &self,
        route: &[RouteAction],
        lower_bound: f64,
        seen: &Observation,
        preview_of: Option<Duration>,
    ) -> PlanNote {
        let moves = route.iter().map(|action| (action.from, action.to));
        let table: Vec<(String, Pose2)> = seen.objects.iter().map(|o| (o.id.clone(), o.pose)).collect();
        PlanNote {
            number: 0,
            actions: route.to_vec(),
            made: self.job.as_ref().map_or(0, |job| job.moves),
            lower_bound,
            seconds: self.cycle_times().seconds(moves),
            table,
            preview: preview_of.is_some(),
            sight_age_s: preview_of.map_or(0.0, |age| age.as_secs_f64()),
        }
    }
}

/// How long ago something was seen.
fn age_words(now: Timestamp, at: Timestamp) -> String {
    let seconds = now.since(at).as_secs_f64();
    match seconds {
        s if s < 120.0 => format!("{s:.0} s ago"),
        s if s < 7200.0 => format!("{:.0} min ago", s / 60.0),
        s => format!("{:.0} h ago", s / 3600.0),
    }
}
