//! Whether a plan can be carried out as written, and whether what its file says of itself is true.
//!
//! In: a problem, a plan file, its actions. Out: the first fault, and the given overlaps that were taken as
//! they are. The plan is judged by the independent checker; cost and moves are counted afresh, and a lower
//! bound is believed only as far as it can be proved here. Pure.

use crate::planning::check::{CheckedPlan, Exempt};
use crate::planning::object_set::ObjectSet;
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
}

/// The first thing that is wrong with the plan or with what the file claims, and the given overlaps.
pub fn examine(problem: &Problem, file: &PlanFile, actions: &[Action]) -> Examined {
    let refused = |fault: String| Examined { fault: Some(fault), exempt: Vec::new() };
    match file.status {
        Status::Optimal | Status::Solved => {}
        Status::Infeasible | Status::Timeout => {
            return refused("the file holds no plan: its status says that none was found".to_string());
        }
    }
    match CheckedPlan::new(problem, actions) {
        Err(fault) => refused(fault.to_string()),
        Ok(plan) => Examined { fault: false_claim(problem, file, actions), exempt: plan.exempt().to_vec() },
    }
}

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
    let bound = provable_bound(problem, file)?;
    if file.lower_bound > bound && !same(file.lower_bound, bound) {
        return Some(format!("`lower_bound` says {}; what can be proved is {bound}", file.lower_bound));
    }
    None
}

/// The bound computed afresh; None for more objects than that is made for.
fn provable_bound(problem: &Problem, file: &PlanFile) -> Option<f64> {
    let few = problem.objects.len() <= ObjectSet::CAPACITY;
    few.then(|| solver::provable_bound(&Scene::new(problem), file.objective, file.lower_bound))
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * a.abs().max(b.abs()).max(1.0)
}
