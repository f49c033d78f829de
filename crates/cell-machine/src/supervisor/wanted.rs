//! What a job wants, once its first look has shown the table: poses from its rule, and a word of what it
//! found.
//!
//! In: the job's goals or rule, the table as it was seen. Out: goals that hold for the rest of the job,
//! written down before anything moves: after a restart a swap must not be turned back. And whether a plan is
//! one that a person has agreed to.

use crate::code::{Code, JobStatus};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, Record};
use crate::supervisor::model::CellModel;
use crate::supervisor::order::{JobOrder, RouteAction};
use crate::supervisor::reason::{Reason, say};
use crate::supervisor::route::overlap_tolerance;
use cell_values::time::Timestamp;
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::ObjectSpec;
use rearrange::tabletop::rule::{GoalRule, RuleFault, RuleTable};

impl Supervisor {
    /// Once a job: its goals are known and written down from here on. False when the job has ended instead.
    pub(crate) fn settle_goals(&mut self, now: Timestamp, out: &mut Vec<Action>) -> bool {
        let (Some(job), Some(seen)) = (&self.job, &self.seen) else { return false };
        if job.settled {
            return true;
        }
        let objects: Vec<_> = seen.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
        let goals = match self.goals_on(&job.order, seen) {
            Ok(goals) => goals,
            Err(reason) => {
                self.finish(now, JobStatus::Failed, reason, out);
                return false;
            }
        };
        if job.order.rule.is_some() {
            say(out, format!("its goal on this table: {} objects", goals.len()));
        }
        if let Some(job) = &mut self.job {
            job.settled = true;
            job.order.goals.clone_from(&goals);
        }
        self.commit(now, Record::Found { objects, goals }, out);
        true
    }

    /// The goals of a job on the table as it was seen; each of its objects has to be there.
    pub(crate) fn goals_on(
        &self,
        order: &JobOrder,
        seen: &Observation,
    ) -> Result<Vec<(String, Pose2)>, Reason> {
        let at: Vec<_> = seen.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
        let goals = match &order.rule {
            Some(rule) if order.goals.is_empty() => self.poses_of(rule, seen, &at, order.seed)?,
            Some(_) | None => order.goals.clone(),
        };
        match goals.iter().find(|(id, _)| !at.iter().any(|(seen, _)| seen == id)) {
            Some((id, _)) => Err(absent(id, seen)),
            None => Ok(goals),
        }
    }

    /// The poses that a rule gives on the table as it is.
    fn poses_of(
        &self,
        rule: &GoalRule,
        seen: &Observation,
        at: &[(String, Pose2)],
        seed: u64,
    ) -> Result<Vec<(String, Pose2)>, Reason> {
        // A group is those of it that are there; who is named has to be.
        let named = rule.named();
        let is_seen = |id: &str| at.iter().any(|(seen, _)| seen == id);
        let meant = self.model.objects.iter().filter(|o| !named.is_empty() || is_seen(&o.id));
        let objects: Vec<ObjectSpec> = meant
            .map(|object| ObjectSpec {
                group: object.group.clone(),
                ..ObjectSpec::new(&object.id, object.footprint.clone())
            })
            .collect();
        let table = RuleTable {
            objects: &objects,
            workspace: self.model.workspace,
            clearance: self.model.clearance,
            overlap_tolerance: overlap_tolerance(seen),
            keep_out: &self.obstacles(seen),
            at,
        };
        rule.resolve(&table, seed).map_err(|fault| match &fault {
            RuleFault::NotSeen(id) => absent(id, seen),
            RuleFault::NoRoom(_)
            | RuleFault::UnknownGroup(_)
            | RuleFault::Unknown(_)
            | RuleFault::Fixed(_) => reason_of(&fault),
        })
    }
}

/// Why an object that is needed where it lies has no pose: it lies askew, or is not seen.
fn absent(id: &str, seen: &Observation) -> Reason {
    match seen.suspicious.iter().find(|suspicious| suspicious.id == id) {
        Some(suspicious) => {
            let message = format!("{id} does not lie flat on the table: {}", suspicious.reason);
            Code::ObjectTilted.because(message, "put it right by hand, submit again").of(id)
        }
        None => reason_of(&RuleFault::NotSeen(id.to_string())),
    }
}

fn reason_of(fault: &RuleFault) -> Reason {
    match fault {
        RuleFault::NotSeen(id) => Code::ObjectMissing
            .because(fault.to_string(), "put it where the camera sees it, submit again")
            .of(id),
        RuleFault::NoRoom(_) => Code::NoArrangement
            .because(fault.to_string(), "make the region larger, or take something out of it; submit again"),
        RuleFault::UnknownGroup(group) => Code::NoArrangement.because(
            format!("no object of group {group:?} is seen on the table"),
            "put one there, submit again",
        ),
        RuleFault::Unknown(_) | RuleFault::Fixed(_) => {
            let hint = "the catalogue is another one since the job came: correct the job, submit again";
            Code::NoArrangement.because(fault.to_string(), hint)
        }
    }
}

impl CellModel {
    /// True when `route` is what is left of a plan that a person `agreed` to: the same objects in the same
    /// order from and to the same places, as near as a running plan may be off.
    pub(crate) fn is_rest_of(&self, route: &[RouteAction], agreed: &[RouteAction]) -> bool {
        let Some(skipped) = agreed.len().checked_sub(route.len()) else { return false };
        let near = |a: &Pose2, b: &Pose2| {
            let limits = (self.tolerances.expected_position, self.tolerances.expected_angle);
            a.distance(b) <= limits.0 && a.angle_difference(b) <= limits.1
        };
        let same = |a: &RouteAction, b: &RouteAction| {
            a.object == b.object && a.to_goal == b.to_goal && near(&a.from, &b.from) && near(&a.to, &b.to)
        };
        !route.is_empty() && route.iter().zip(&agreed[skipped..]).all(|(a, b)| same(a, b))
    }
}
