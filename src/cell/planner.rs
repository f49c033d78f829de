//! The answer to a plan request: the one way in which the daemon and the closed loop in virtual time plan.
//!
//! In: the request, and what ends the search: the caller's clock, its stop flag, or a number of deterministic
//! steps. Out: a plan that passed the independent checker, or why there is none. Pure.

use crate::cell::supervisor::input::{PlanAnswer, PlanRequest};
use rearrange::planning::plan::{Action, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::{Control, solve};

/// One planning run. `over` ends it, and so does the work limit; `seconds` says how long it has taken.
pub fn answer(
    request: &PlanRequest,
    work_limit: Option<u64>,
    over: &(dyn Fn() -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> PlanAnswer {
    let problem = match Problem::new(&request.instance) {
        Ok(problem) => problem,
        Err(error) => return PlanAnswer::Refused(error.to_string()),
    };
    let travel = |actions: &[Action]| request.times.seconds(actions.iter().map(|a| (a.from, a.to)));
    let control = Control {
        work_limit,
        seconds: Some(&travel),
        least_move_seconds: request.times.least_move_seconds(),
        ..Control::until(over)
    };
    let outcome = match solve(&problem, request.solver, request.objective, &control, request.seed) {
        Ok(outcome) => outcome,
        Err(error) => return PlanAnswer::Unsolvable(error.to_string()),
    };
    match (outcome.status, outcome.plan, outcome.cost) {
        (Status::Optimal | Status::Solved, Some(plan), Some(cost)) => PlanAnswer::Found {
            actions: plan.actions().to_vec(),
            cost,
            lower_bound: outcome.lower_bound,
            seconds: seconds(),
        },
        (Status::Infeasible, ..) => {
            PlanAnswer::Infeasible(outcome.witness.map(|w| w.to_string()).unwrap_or_default())
        }
        (Status::Optimal | Status::Solved | Status::Timeout, ..) => PlanAnswer::Timeout,
    }
}
