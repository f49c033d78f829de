//! The answer to a plan request: the one way in which the daemon and the closed loop in virtual time plan.
//!
//! In: the request, and what ends the search: the caller's clock, its stop flag, or a number of
//! deterministic steps. Out: a plan that passed the independent checker and that the arm can carry out, or
//! why there is none. Pure.

use crate::cell::plan_check::OutOfReach;
use crate::cell::supervisor::input::{PlanAnswer, PlanRequest};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::{Control, solve};

/// Plans that are tried where the arm cannot carry the first one out for a buffer that it chose.
const TRIES: u64 = 4;

/// One planning run. `over` ends it, and so does the work limit; `seconds` says how long it has taken.
pub fn answer(
    request: &PlanRequest,
    work_limit: Option<u64>,
    over: &(dyn Fn() -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> PlanAnswer {
    let mut request = request.clone();
    if let Err(fault) = request.limits.restrict(&mut request.instance) {
        return unreachable(fault);
    }
    let mut bad: Vec<(usize, Pose2)> = Vec::new();
    let mut last = None;
    for attempt in 0..TRIES {
        let answer = solved(&request, &bad, attempt, work_limit, over, seconds);
        let PlanAnswer::Found { actions, .. } = &answer else {
            // What is left without the places that did not do is no proof of anything.
            return last.map_or(answer, unreachable);
        };
        match request.limits.carry_out(actions) {
            Ok(()) => return answer,
            Err(fault @ OutOfReach { buffer: Some(pose), object, .. }) => {
                bad.push((object, pose));
                last = Some(fault);
            }
            Err(fault) => return unreachable(fault),
        }
    }
    last.map_or(PlanAnswer::Timeout, unreachable)
}

fn unreachable(fault: OutOfReach) -> PlanAnswer {
    PlanAnswer::OutOfReach(Box::new(fault))
}

/// One run of the solver, with buffers away from `bad` ones.
fn solved(
    request: &PlanRequest,
    bad: &[(usize, Pose2)],
    attempt: u64,
    work_limit: Option<u64>,
    over: &(dyn Fn() -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> PlanAnswer {
    let table = [request.instance.workspace.width, request.instance.workspace.height];
    let problem = match Problem::new(&request.instance) {
        Ok(problem) => problem.within(request.limits.reach(table, bad.to_vec())),
        Err(error) => return PlanAnswer::Refused(error.to_string()),
    };
    let travel = |actions: &[Action]| request.times.seconds(actions.iter().map(|a| (a.from, a.to)));
    let control = Control {
        work_limit,
        seconds: Some(&travel),
        least_move_seconds: request.times.least_move_seconds(),
        ..Control::until(over)
    };
    let seed = request.seed.wrapping_add(attempt);
    let outcome = match solve(&problem, request.solver, request.objective, &control, seed) {
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
