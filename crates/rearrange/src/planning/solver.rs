//! One shape for all solvers: a problem, a control, a seed in; an outcome with its lower bound out.
//!
//! In: [`Problem`], the kind of solver, the objective, [`Control`]. Out: [`Outcome`]: optimal, solved,
//! infeasible with a witness, or no plan found. Every plan has passed the independent checker before the
//! caller gets it. Deterministic: the same seed and work limit give the same outcome; no clock is read here.

use crate::planning::bound::buffer_space::BufferSpaceBound;
use crate::planning::bound::{self, LowerBound};
use crate::planning::check::CheckedPlan;
use crate::planning::effort::Effort;
use crate::planning::object_set::ObjectSet;
use crate::planning::plan::{Objective, Status};
use crate::planning::problem::{Problem, ProblemObject, Witness};
use crate::planning::scene::Scene;
use crate::planning::solver::incumbent::Incumbent;

pub use crate::planning::solver::control::{Control, PlanSeconds, SolverKind, cost, reaches};

mod control;
mod fallback;
mod incumbent;
mod search;

/// How a search ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Optimal, solved, infeasible, timeout.
    pub status: Status,
    /// The plan, if there is one; it may be empty when nothing has to move.
    pub plan: Option<CheckedPlan>,
    /// Cost of the plan in the objective.
    pub cost: Option<f64>,
    /// No plan is cheaper.
    pub lower_bound: f64,
    /// Why there can be no plan.
    pub witness: Option<Witness>,
    /// Steps spent.
    pub work: u64,
}

/// Why a solver cannot even start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// More objects than the bitsets hold.
    #[error("{found} objects; the planner takes at most {most}")]
    TooManyObjects {
        /// Objects of the problem.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// The objective `time` without a source of move times.
    #[error("the objective time needs a cell that knows how long its moves take; use pp or ti here")]
    NoTimes,
}

/// The lower bound on the cost of every plan in an objective.
pub fn lower_bound(scene: &Scene, objective: Objective, least_move_seconds: f64) -> LowerBound {
    let objects = &scene.problem.objects;
    match objective {
        Objective::Pp => bound::lower_bound(scene, &vec![1.0; objects.len()]),
        Objective::Ti => {
            let impedances: Vec<f64> = objects.iter().map(|object| object.impedance).collect();
            bound::lower_bound(scene, &impedances)
        }
        Objective::Time => {
            let moves = bound::lower_bound(scene, &vec![1.0; objects.len()]);
            LowerBound {
                value: moves.value * least_move_seconds,
                required_moves: moves.required_moves,
                required_cost: moves.required_cost * least_move_seconds,
                cycle_cost: moves.cycle_cost * least_move_seconds,
            }
        }
    }
}

/// The bound that can be proved for the objectives that need no caller, with what `auto` proves about room;
/// no longer than needed to reach `claimed`.
pub fn provable_bound(scene: &Scene, objective: Objective, claimed: f64) -> f64 {
    let simple = lower_bound(scene, objective, 0.0).value;
    if objective == Objective::Time || simple >= claimed {
        return simple;
    }
    let weigh = |o: &ProblemObject| if objective == Objective::Ti { o.impedance } else { 1.0 };
    let costs: Vec<f64> = scene.problem.objects.iter().map(weigh).collect();
    let mut proof = BufferSpaceBound::new(scene, &costs);
    proof.work(claimed, &mut Effort::new(None, &|| false));
    proof.value.max(simple)
}

/// Solves the problem as far as the control allows.
///
/// # Errors
/// What makes the question itself impossible; that no plan was found is an [`Outcome`].
pub fn solve(
    problem: &Problem,
    solver: SolverKind,
    objective: Objective,
    control: &Control,
    seed: u64,
) -> Result<Outcome, SolveError> {
    if problem.objects.len() > ObjectSet::CAPACITY {
        let (found, most) = (problem.objects.len(), ObjectSet::CAPACITY);
        return Err(SolveError::TooManyObjects { found, most });
    }
    if objective == Objective::Time && control.seconds.is_none() {
        return Err(SolveError::NoTimes);
    }
    let scene = Scene::new(problem);
    let lower_bound = lower_bound(&scene, objective, control.least_move_seconds).value;
    if let Some(witness) = problem.goal_conflict() {
        let status = Status::Infeasible;
        return Ok(Outcome { status, plan: None, cost: None, lower_bound, witness: Some(witness), work: 0 });
    }
    let mut effort = Effort::new(control.work_limit, control.stop);
    let mut incumbent = Incumbent::new(problem, objective, control, lower_bound);
    incumbent::run(&scene, solver, seed, &mut incumbent, &mut effort);
    let Incumbent { best, lower_bound, .. } = incumbent;
    let (plan, cost) = best.unzip();
    let status = match cost {
        Some(cost) if reaches(cost, lower_bound) => Status::Optimal,
        Some(_) => Status::Solved,
        None => Status::Timeout,
    };
    Ok(Outcome { status, plan, cost, lower_bound, witness: None, work: effort.done() })
}

#[cfg(test)]
mod auto_properties;

#[cfg(test)]
mod properties;

#[cfg(test)]
mod tests;
