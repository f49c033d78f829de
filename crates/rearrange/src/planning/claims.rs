//! Whether a plan can be carried out as written, and whether what its file says of itself is true.
//!
//! In: a problem, a plan file, its actions. Out: the first fault, and the given overlaps that were taken as
//! they are. The plan is judged by the independent checker; cost and moves are counted afresh, and a lower
//! bound is believed only as far as it can be proved here. Pure.

use crate::planning::check::{CheckedPlan, Exempt, PlanFault};
use crate::planning::effort::{StopFunction, Watch};
use crate::planning::plan::{Action, Objective, PlanFile, Status};
use crate::planning::problem::Problem;
use crate::planning::scene::Scene;
use crate::planning::solver;

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Examined {
    /// The first thing that is wrong.
    pub fault: Option<String>,
    /// Given overlaps that are exempt.
    pub exempt: Vec<Exempt>,
    /// False where the caller ended the work: then the fault says what is not known yet.
    pub finished: bool,
}

/// The first thing that is wrong with the plan or with what the file claims, and the given overlaps. Where
/// `stop` ends the work, the fault says how far it came.
pub fn examine(problem: &Problem, file: &PlanFile, actions: &[Action], stop: StopFunction) -> Examined {
    let refused =
        |fault: String, finished: bool| Examined { fault: Some(fault), exempt: Vec::new(), finished };
    match file.status {
        Status::Optimal | Status::Solved => {}
        Status::Infeasible | Status::Timeout => {
            let fault = "the file holds no plan: its status says that none was found";
            return refused(fault.to_string(), true);
        }
    }
    let plan = match CheckedPlan::within(problem, actions, &mut Watch::new(stop)) {
        Err(PlanFault::Unfinished) => return refused("not every action is checked yet".to_string(), false),
        Err(fault) => return refused(fault.to_string(), true),
        Ok(plan) => plan,
    };
    let exempt = plan.exempt().to_vec();
    if let Some(fault) = false_claim(problem, file, actions) {
        return Examined { fault: Some(fault), exempt, finished: true };
    }
    if file.objective == Objective::Time {
        return Examined { fault: None, exempt, finished: true };
    }
    let claimed = file.lower_bound;
    let bound = solver::provable_bound(&Scene::new(problem), file.objective, claimed, stop);
    let fault = (claimed > bound && !same(claimed, bound)).then(|| match stop() {
        true => format!(
            "the plan can be carried out, but of its `lower_bound` {claimed} only {bound} is proved yet"
        ),
        false => format!("`lower_bound` says {claimed}; what can be proved is {bound}"),
    });
    let finished = fault.is_none() || !stop();
    Examined { fault, exempt, finished }
}

/// Moves, cost and status of the file against its actions.
fn false_claim(problem: &Problem, file: &PlanFile, actions: &[Action]) -> Option<String> {
    if file.moves != Some(actions.len()) {
        return Some(match file.moves {
            Some(claimed) => format!("`moves` says {claimed}, the plan has {}", actions.len()),
            None => format!("`moves` is not given, the plan has {}", actions.len()),
        });
    }
    let cost = match file.objective {
        Objective::Pp => actions.len() as f64,
        Objective::Ti => actions.iter().map(|action| problem.objects[action.object].impedance).sum(),
        // Seconds depend on a robot that the instance does not describe.
        Objective::Time => return None,
    };
    if !file.cost.is_some_and(|claimed| same(claimed, cost)) {
        return Some(match file.cost {
            Some(claimed) => format!("`cost` says {claimed}, the plan costs {cost}"),
            None => format!("`cost` is not given, the plan costs {cost}"),
        });
    }
    if file.status == Status::Optimal && !same(cost, file.lower_bound) {
        return Some(format!(
            "`status` says optimal, but the plan costs {cost}, the bound {}",
            file.lower_bound
        ));
    }
    None
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * a.abs().max(b.abs()).max(1.0)
}
