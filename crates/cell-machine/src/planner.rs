//! The answer to a plan request: the one way in which the daemon and the closed loop in virtual time plan.
//!
//! In: the request, and what ends the search: the caller's clock, its stop flag, or a number of
//! deterministic steps. Out: a plan that passed the independent checker and that the arm can carry out, or
//! why there is none. Pure.

use crate::plan_check::OutOfReach;
use crate::quickest::quickest;
use crate::supervisor::input::{PlanAnswer, PlanRequest};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, Objective, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::{Control, cost, solve};

/// Plans that are tried where the arm cannot carry the first one out for a buffer that it chose.
const TRIES: u32 = 4;

/// A quicker order is searched for this long at most, s: the arm waits for it.
const ORDERING_S: f64 = 0.5;

/// A plan that takes so much less time is worth a change, s.
const WORTH_S: f64 = 0.5;

/// Costs that differ by less are equal but for the rounding of sums.
const ROUNDING: f64 = 1e-9;

/// One planning run. `over` ends each of its tries, which it gets the number of (from 0), and so does the
/// work limit; `seconds` says how long the run has taken.
pub fn answer(
    request: &PlanRequest,
    work_limit: Option<u64>,
    over: &(dyn Fn(u32) -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> PlanAnswer {
    let found = search(request, work_limit, over, seconds);
    if request.known_plan.is_empty() { found } else { better(request, found) }
}

/// The answer where it is worth leaving the known plan for it, else that one. Whether that can still be
/// carried out is for others to judge: what was measured may be nearer together than a new plan would bring
/// it, and still do.
fn better(request: &PlanRequest, answer: PlanAnswer) -> PlanAnswer {
    let PlanAnswer::Found { actions, lower_bound, seconds, .. } = &answer else { return answer };
    let known = &request.known_plan;
    let Ok(problem) = Problem::new(&request.instance) else { return answer };
    let travel = |actions: &[Action]| request.times.seconds(actions.iter().map(|a| (a.from, a.to)));
    let control = Control { seconds: Some(&travel), ..Control::until(&|| true) };
    let price = |actions: &[Action]| cost(&problem, request.objective, &control, actions);
    let gain = price(known) - price(actions);
    let worth = if request.objective == Objective::Time { WORTH_S } else { ROUNDING };
    if gain > worth || gain > -ROUNDING && travel(known) - travel(actions) > WORTH_S {
        return answer;
    }
    let (lower_bound, seconds) = (*lower_bound, *seconds);
    PlanAnswer::Found { actions: known.clone(), cost: price(known), lower_bound, seconds }
}

fn search(
    request: &PlanRequest,
    work_limit: Option<u64>,
    over: &(dyn Fn(u32) -> bool + Sync),
    seconds: &dyn Fn() -> f64,
) -> PlanAnswer {
    let mut request = request.clone();
    let stay = match request.limits.restrict(&mut request.instance) {
        Ok(stay) => stay,
        Err(fault) => return unreachable(fault),
    };
    let mut bad: Vec<(usize, Pose2)> = Vec::new();
    let mut last = None;
    for attempt in 0..TRIES {
        let answer = solved(&request, &bad, attempt, work_limit, &|| over(attempt), seconds);
        let PlanAnswer::Found { actions, .. } = &answer else {
            // What is left without the places that did not do is no proof of anything.
            return last.map_or_else(|| explained(answer, &stay), unreachable);
        };
        let ordered = ordered(&request, &bad, actions, seconds);
        if let Some(ordered) = ordered.filter(|ordered| request.limits.carry_out(ordered).is_ok()) {
            return with_actions(answer, ordered, seconds());
        }
        match request.limits.carry_out(actions) {
            Ok(()) => return answer,
            Err(fault @ OutOfReach { buffer: Some(place), .. }) => {
                bad.push(place);
                last = Some(fault);
            }
            Err(fault) => return unreachable(fault),
        }
    }
    last.map_or(PlanAnswer::Timeout, unreachable)
}

/// A proof that there is no plan rests on what is out of reach and therefore stays.
fn explained(answer: PlanAnswer, stay: &[String]) -> PlanAnswer {
    match answer {
        PlanAnswer::Infeasible(witness) if !stay.is_empty() => {
            let stay = stay.join(", ");
            PlanAnswer::Infeasible(format!("{witness}; out of the arm's reach, and therefore fixed: {stay}"))
        }
        other => other,
    }
}

fn unreachable(fault: OutOfReach) -> PlanAnswer {
    PlanAnswer::OutOfReach(Box::new(fault))
}

/// The same pick-n-places in an order that takes less time; `None` where none is found.
fn ordered(
    request: &PlanRequest,
    bad: &[(usize, Pose2)],
    actions: &[Action],
    now_s: &dyn Fn() -> f64,
) -> Option<Vec<Action>> {
    let began_s = now_s();
    let over = || now_s() - began_s > ORDERING_S;
    let table = [request.instance.workspace.width, request.instance.workspace.height];
    let problem = Problem::new(&request.instance).ok()?.within(request.limits.reach(table, bad.to_vec()));
    let seconds = |actions: &[Action]| request.times.seconds(actions.iter().map(|a| (a.from, a.to)));
    let ordered = quickest(&problem, actions.to_vec(), &seconds, &over);
    (ordered != actions).then_some(ordered)
}

fn with_actions(answer: PlanAnswer, actions: Vec<Action>, seconds: f64) -> PlanAnswer {
    match answer {
        PlanAnswer::Found { cost, lower_bound, .. } => {
            PlanAnswer::Found { actions, cost, lower_bound, seconds }
        }
        other => other,
    }
}

/// One run of the solver, with buffers away from `bad` ones.
fn solved(
    request: &PlanRequest,
    bad: &[(usize, Pose2)],
    attempt: u32,
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
        known_plan: &request.known_plan,
        ..Control::until(over)
    };
    let seed = request.seed.wrapping_add(u64::from(attempt));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan_check::PlanLimits;
    use cell_motion::bodies::Standing;
    use cell_motion::cycle_time::CycleTimes;
    use cell_motion::pick_n_place::PickNPlace;
    use cell_motion::testing::{cycle, home, model, task};
    use cell_values::time::Duration;
    use rearrange::geometry::footprint::Footprint;
    use rearrange::planning::plan::ActionKind;
    use rearrange::planning::solver::SolverKind;
    use rearrange::tabletop::instance::{Instance, ObjectSpec, Workspace};
    use std::sync::{Arc, Mutex};

    const LEFT: Pose2 = Pose2 { x: 0.15, y: 0.25, theta: 0.0 };
    const RIGHT: Pose2 = Pose2 { x: 0.35, y: 0.25, theta: 0.0 };

    /// Two discs that have to change places, between posts of which the solver does not know.
    fn swap(posts: bool) -> PlanRequest {
        let arm = model(0.5);
        let disc = |id: &str, start: Pose2, goal: Pose2| ObjectSpec {
            id: id.to_string(),
            footprint: Footprint::Disc { radius: 0.02 },
            impedance: None,
            start: Some(start),
            goal: Some(goal),
            fixed: false,
            group: None,
            height: Some(0.02),
            mass: Some(0.05),
            marker: None,
            grippable: None,
        };
        let objects = [("a", LEFT, RIGHT), ("b", RIGHT, LEFT)];
        let grid = (0..121).map(|k| Pose2::new(0.05 * (k % 11) as f64, 0.05 * (k / 11) as f64, 0.0));
        let away = |pose: &Pose2| [LEFT, RIGHT].iter().all(|end| end.distance(pose) > 0.06);
        let post = |pose| Standing {
            name: "a post".to_string(),
            footprint: Footprint::Disc { radius: 0.005 },
            pose,
            height: 0.12,
        };
        let start = home(&arm, 0.5);
        PlanRequest {
            instance: Instance {
                workspace: Workspace { width: 0.5, height: 0.5 },
                clearance: 0.002,
                overlap_tolerance: 1e-4,
                keep_out: Vec::new(),
                objects: objects.map(|(id, start, goal)| disc(id, start, goal)).to_vec(),
            },
            objective: Objective::Pp,
            solver: SolverKind::Auto,
            seed: 3,
            time_limit: Duration::from_secs(1),
            times: CycleTimes::new(&arm, &cycle(), start),
            limits: PlanLimits {
                cycle: cycle(),
                objects: objects
                    .map(|(id, start, _)| PickNPlace {
                        object: id.to_string(),
                        ..task(start, start, [0.0, 0.0])
                    })
                    .to_vec(),
                obstacles: if posts { grid.filter(away).map(post).collect() } else { Vec::new() },
                start,
                mask: Arc::default(),
                arm,
            },
            known_plan: Vec::new(),
        }
    }

    /// What is known is left for a plan with fewer pick-n-places, or that takes less time, and for no other.
    #[test]
    fn a_known_plan_is_left_for_a_better_one_alone() {
        let of = |request: &PlanRequest| match answer(request, Some(20_000), &|_| false, &|| 0.0) {
            PlanAnswer::Found { actions, cost, .. } => (actions, cost),
            other => panic!("{other:?}"),
        };
        let (best, _) = of(&swap(false));
        let [aside, ..] = best[..] else { panic!("{best:?}") };
        // Once more aside, a little farther.
        let farther = Pose2 { y: aside.to.y + 0.02, ..aside.to };
        let moved = |action: Action| {
            let again = action.object == aside.object && action.from == aside.to;
            if again { Action { from: farther, ..action } } else { action }
        };
        let known: Vec<Action> = [aside, Action { from: aside.to, to: farther, ..aside }]
            .into_iter()
            .chain(best[1..].iter().copied().map(moved))
            .collect();
        let (found, cost) = of(&PlanRequest { known_plan: known.clone(), ..swap(false) });
        assert!(found.len() == 3 && cost == 3.0 && known.len() == 4, "{found:?}");
        let (found, cost) = of(&PlanRequest { known_plan: best.clone(), ..swap(false) });
        assert_eq!((found, cost), (best.clone(), 3.0));
    }

    /// As many pick-n-places are a change where they take clearly less time.
    #[test]
    fn of_plans_of_the_same_cost_the_quicker_one_is_taken_where_it_is_worth_it() {
        let buffered = |to: Pose2| {
            let action = |object, from, to, kind| Action { object, from, to, kind };
            let (goal, buffer) = (ActionKind::Goal, ActionKind::Buffer);
            vec![action(0, LEFT, to, buffer), action(1, RIGHT, LEFT, goal), action(0, to, RIGHT, goal)]
        };
        let at = |x, y| Pose2::new(x, y, 0.0);
        let [quick, slow, alike] = [at(0.25, 0.25), at(0.25, 0.46), at(0.25, 0.252)].map(buffered);
        let taken = |known: &[Action], found: &[Action]| {
            let request = PlanRequest { known_plan: known.to_vec(), ..swap(false) };
            let actions = found.to_vec();
            match better(&request, PlanAnswer::Found { actions, cost: 3.0, lower_bound: 3.0, seconds: 0.1 }) {
                PlanAnswer::Found { actions, .. } => actions,
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(taken(&slow, &quick), quick);
        assert_eq!(taken(&quick, &slow), quick);
        assert_eq!(taken(&alike, &quick), alike, "not worth a change");
    }

    #[test]
    fn each_try_of_another_buffer_has_a_budget_of_its_own() {
        let tries = Mutex::new(Vec::new());
        let over = |attempt: u32| {
            tries.lock().expect("no thread has died").push(attempt);
            false
        };
        let found = answer(&swap(false), Some(20_000), &over, &|| 0.0);
        assert!(matches!(&found, PlanAnswer::Found { actions, .. } if actions.len() == 3), "{found:?}");
        let answer = answer(&swap(true), Some(20_000), &over, &|| 0.0);
        let PlanAnswer::OutOfReach(fault) = &answer else { panic!("{answer:?}") };
        assert!(fault.buffer.is_some() && fault.message.contains("a post"), "{fault:?}");
        let mut tries = tries.into_inner().expect("no thread has died");
        tries.dedup();
        assert!(tries.ends_with(&[0, 1, 2, 3]), "{tries:?}");
    }
}
