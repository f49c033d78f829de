//! Plans for goals that a person sets by hand and has not submitted: what would be done, and how long it
//! would take.
//!
//! In: the cell, a job as it would be, the table as it was seen last, what ends the search. Out: the plan as
//! the cell itself would make it, or why there is none. Nothing of it is ever carried out: the cell that
//! carries a job out looks and plans for itself. Pure.

use crate::code::Code;
use crate::planner::answer;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{PlanAnswer, PlanNote};
use crate::supervisor::model::CellModel;
use crate::supervisor::order::JobOrder;
use crate::supervisor::reason::Reason;
use crate::supervisor::route::why_no_plan;
use cell_values::time::{Duration, Timestamp};
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq)]
pub struct NoDraft {
    /// For programs.
    pub code: Code,
    /// One sentence.
    pub message: String,
    /// What to do about it.
    pub hint: String,
}

impl From<Reason> for NoDraft {
    fn from(reason: Reason) -> NoDraft {
        NoDraft { code: reason.code, message: reason.message, hint: reason.hint }
    }
}

/// A plan, and the poses that it leads to where they follow from a rule.
#[derive(Clone, Debug, PartialEq)]
pub struct Draft {
    /// The plan, with the age of the sight.
    pub plan: PlanNote,
    /// Where each object with a goal is wanted.
    pub goals: Vec<(String, Pose2)>,
    /// What the cell would refuse the job for if it saw the same again.
    pub rejection: Option<NoDraft>,
}

/// The table as it was seen last.
#[derive(Clone, Copy, Debug)]
pub struct Glimpse<'a> {
    /// What was seen.
    pub seen: &'a Observation,
    /// All of the table was looked at.
    pub whole: bool,
    /// How long ago.
    pub age: Duration,
}

/// Plans for `order` on what was seen last. `over` ends each try of the planner, `seconds` is how
/// long it has taken.
///
/// # Errors
/// Why there is no plan: an object was not seen, the goal cannot be reached, no plan was found in time.
pub fn draft(
    model: CellModel,
    order: &JobOrder,
    Glimpse { seen, whole, age }: Glimpse,
    over: &(dyn Fn(u32) -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> Result<Draft, NoDraft> {
    // A supervisor of its own, which is never connected to anything.
    let mut planner = Supervisor::new(model, 0);
    planner.on_job(Timestamp::ZERO, order.clone(), &mut Vec::new());
    let goals = planner.goals_on(order, seen)?;
    let request = planner.plan_request(order, 0, &goals, seen);
    let answer = answer(&request, None, over, seconds);
    let PlanAnswer::Found { actions, lower_bound, .. } = &answer else {
        return Err(why_no_plan(&answer).into());
    };
    let route = planner.route_of(actions, seen);
    let route = route.ok_or_else(|| {
        Code::NoPlan.because("the plan names what was not seen", "look again, then try again")
    })?;
    let rejection = planner.rejection_of_sight(seen, whole).map(NoDraft::from);
    Ok(Draft { plan: planner.plan_note(&route, *lower_bound, seen, Some(age)), goals, rejection })
}
