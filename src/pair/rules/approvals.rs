//! The rule about approval: no object is gripped for a plan that no person has agreed to, in a job that
//! requires it.
//!
//! In: jobs as they were handed out, plans as they were written down, persons' orders with their answers.
//! Out: why a pick has no approval. What the machine believes of the job does not count: the job is the one
//! that was submitted, and the approval is an order that a person gave.

use cell_machine::orders::{Approval, Order};
use cell_machine::supervisor::input::PlanNote;
use cell_machine::supervisor::order::{JobOrder, RouteAction};
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeMap;

/// Plans kept: a person approves one of the last.
const PLANS: usize = 32;

/// A plan made for a new look differs from the approved one by what the camera measures anew, m and rad.
const SAME: (f64, f64) = (0.01, 0.1);

/// The job under way.
#[derive(Debug)]
struct Job {
    id: String,
    approval: Approval,
    /// A person has approved a plan of this job, and this is the last one.
    approved: Option<Vec<RouteAction>>,
}

/// What persons have agreed to. See the module.
#[derive(Debug, Default)]
pub(super) struct Approvals {
    plans: BTreeMap<u64, Vec<RouteAction>>,
    job: Option<Job>,
    /// Orders to approve without an answer: the job and the number of the plan.
    given: BTreeMap<u64, (String, u64)>,
    /// The pick-n-place that is about to be carried out.
    next: Option<RouteAction>,
}

impl Approvals {
    /// A job goes to the machine.
    pub fn handed_out(&mut self, job: &JobOrder) {
        let approved = Some(job.agreed.clone()).filter(|agreed| !agreed.is_empty());
        self.job = Some(Job { id: job.id.clone(), approval: job.approval, approved });
    }

    /// A plan is written down.
    pub fn planned(&mut self, note: &PlanNote) {
        if note.number > 0 {
            self.plans.insert(note.number, note.actions.clone());
        }
        while self.plans.len() > PLANS {
            self.plans.pop_first();
        }
    }

    /// A pick-n-place is written down.
    pub fn intends(&mut self, object: &str, from: Pose2, to: Pose2) {
        self.next = Some(RouteAction { object: object.to_string(), from, to, to_goal: false });
    }

    /// A person gives an order.
    pub fn ordered(&mut self, number: u64, order: &Order) {
        let Order::Approve { id, plan } = order else { return };
        self.given.insert(number, (id.clone(), *plan));
    }

    /// An order is answered.
    pub fn answered(&mut self, number: u64, accepted: bool) {
        let Some((id, plan)) = self.given.remove(&number) else { return };
        if let Some(job) = self.job.as_mut().filter(|job| accepted && job.id == id) {
            job.approved = self.plans.get(&plan).cloned();
        }
    }

    /// The daemon is gone and comes back.
    pub fn restarted(&mut self) {
        *self = Approvals::default();
    }

    /// Why the pick that begins now has no approval.
    pub fn missing(&self) -> Option<String> {
        let (job, next) = (self.job.as_ref()?, self.next.as_ref()?);
        let agreed = |actions: &Vec<RouteAction>| actions.iter().any(|action| is_same(action, next));
        let fine = match job.approval {
            Approval::Never => true,
            Approval::Job => job.approved.is_some(),
            Approval::Always => job.approved.as_ref().is_some_and(agreed),
        };
        (!fine).then(|| format!("{} of {}, approval: {}", next.object, job.id, job.approval))
    }
}

/// A plan's action is the one that is carried out.
fn is_same(planned: &RouteAction, carried_out: &RouteAction) -> bool {
    let near = |a: &Pose2, b: &Pose2| a.distance(b) <= SAME.0 && a.angle_difference(b) <= SAME.1;
    planned.object == carried_out.object
        && near(&planned.from, &carried_out.from)
        && near(&planned.to, &carried_out.to)
}
