//! One shape for all solvers: a problem, a control, a seed in; an outcome with its lower bound out.
//!
//! In: [`Problem`], the kind of solver, the objective, [`Control`]. Out: [`Outcome`]: optimal, solved,
//! infeasible with a witness, or no plan found. Every plan has passed the independent checker before the
//! caller gets it. Deterministic: the same seed and work limit give the same outcome; no clock is read here.

use crate::planning::bound::buffer_space::BufferSpaceBound;
use crate::planning::bound::{LowerBound, Parts};
use crate::planning::check::CheckedPlan;
use crate::planning::effort::{Effort, StopFunction, Watch};
use crate::planning::plan::{Objective, Status};
use crate::planning::problem::{Problem, Witness};
use crate::planning::scene::Scene;
use crate::planning::solver::incumbent::{Incumbent, Moves};

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
    /// The objective `time` without a source of move times.
    #[error("the objective time needs a cell that knows how long its moves take; use pp or ti here")]
    NoTimes,
}

/// What one move of each object costs where moves are counted: its impedance under TI, else 1.
fn move_costs(problem: &Problem, objective: Objective) -> Vec<f64> {
    let weighs = objective == Objective::Ti;
    problem.objects.iter().map(|object| if weighs { object.impedance } else { 1.0 }).collect()
}

/// What a unit of these costs is worth at least in the objective.
fn worth(objective: Objective, least_move_seconds: f64) -> f64 {
    if objective == Objective::Time { least_move_seconds } else { 1.0 }
}

/// The lower bound on the cost of every plan in an objective.
pub fn lower_bound(
    scene: &Scene,
    objective: Objective,
    least_move_seconds: f64,
    watch: &mut Watch,
) -> LowerBound {
    let worth = worth(objective, least_move_seconds);
    let bound = Parts::new(scene, &move_costs(scene.problem, objective), watch).bound();
    LowerBound {
        value: bound.value * worth,
        required_moves: bound.required_moves,
        required_cost: bound.required_cost * worth,
        cycle_cost: bound.cycle_cost * worth,
    }
}

/// The bound that can be proved for the objectives that need no caller, with what `auto` proves about room;
/// no longer than needed to reach `claimed`, or than `stop` allows.
pub fn provable_bound(scene: &Scene, objective: Objective, claimed: f64, stop: StopFunction) -> f64 {
    let mut effort = Effort::new(None, stop).with_ticks(scene.row_ticks());
    let costs = move_costs(scene.problem, objective);
    let parts = Parts::new(scene, &costs, effort.watch());
    let simple = parts.bound().value * worth(objective, 0.0);
    if objective == Objective::Time || simple >= claimed {
        return simple;
    }
    let mut proof = BufferSpaceBound::new(scene, &costs, parts, effort.watch());
    proof.work(claimed, &mut effort);
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
    if objective == Objective::Time && control.seconds.is_none() {
        return Err(SolveError::NoTimes);
    }
    let scene = Scene::new(problem);
    let mut effort = Effort::new(control.work_limit, control.stop).with_ticks(scene.row_ticks());
    let costs = move_costs(problem, objective);
    let parts = Parts::new(&scene, &costs, effort.watch());
    let lower_bound = parts.bound().value * worth(objective, control.least_move_seconds);
    (control.on_bound)(lower_bound);
    if let Some(witness) = problem.goal_conflict() {
        let status = Status::Infeasible;
        return Ok(Outcome { status, plan: None, cost: None, lower_bound, witness: Some(witness), work: 0 });
    }
    let mut incumbent = Incumbent::new(problem, objective, control, lower_bound);
    incumbent::run(&scene, solver, seed, &Moves { costs, parts }, &mut incumbent, &mut effort);
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
