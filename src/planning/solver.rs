//! One shape for all solvers: a problem, a control, a seed in; an outcome with its lower bound out.
//!
//! In: [`Problem`], the kind of solver, the objective, [`Control`]. Out: [`Outcome`]: optimal, solved,
//! infeasible with a witness, or no plan found. Every plan has passed the independent checker before anybody
//! sees it. Deterministic: the same seed and work limit give the same outcome; no clock is read here.

use crate::planning::bound::room::RoomBound;
use crate::planning::bound::{self, LowerBound};
use crate::planning::check::CheckedPlan;
use crate::planning::effort::Effort;
use crate::planning::object_set::ObjectSet;
use crate::planning::plan::{Action, Objective, Status};
use crate::planning::problem::{Problem, ProblemObject, Witness};
use crate::planning::scene::Scene;
use crate::planning::solver::incumbent::Incumbent;

mod aid;
mod incumbent;
mod search;

/// The solvers of the paper, and ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SolverKind {
    /// Total buffer minimisation.
    Tbm,
    /// Running buffer minimisation.
    Rbm,
    /// Total buffer minimisation with object weights.
    Etbm,
    /// Running buffer minimisation with object weights.
    Erbm,
    /// Monte Carlo tree search.
    Mcts,
    /// Monte Carlo tree search with object weights.
    Emcts,
    /// Our own anytime solver.
    Auto,
}

impl SolverKind {
    /// The word on the command line and in files.
    pub fn word(self) -> &'static str {
        match self {
            SolverKind::Tbm => "tbm",
            SolverKind::Rbm => "rbm",
            SolverKind::Etbm => "etbm",
            SolverKind::Erbm => "erbm",
            SolverKind::Mcts => "mcts",
            SolverKind::Emcts => "emcts",
            SolverKind::Auto => "auto",
        }
    }

    /// The kind of that word.
    pub fn from_word(word: &str) -> Option<SolverKind> {
        use SolverKind::{Auto, Emcts, Erbm, Etbm, Mcts, Rbm, Tbm};
        [Tbm, Rbm, Etbm, Erbm, Mcts, Emcts, Auto].into_iter().find(|kind| kind.word() == word)
    }
}

/// Estimated seconds of a whole plan.
pub type PlanSeconds<'a> = &'a (dyn Fn(&[Action]) -> f64 + Sync);

/// What limits a search, and who hears of its progress.
pub struct Control<'a> {
    /// Deterministic steps (sampled poses, search nodes) after which the search ends.
    pub work_limit: Option<u64>,
    /// Asked often; true ends the search: the caller's clock, Ctrl-C.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called with each better plan and its cost, after the plan was checked.
    pub on_plan: &'a (dyn Fn(&[Action], f64) + Sync),
    /// Called when `auto` has proved a higher bound.
    pub on_bound: &'a (dyn Fn(f64) + Sync),
    /// Stop at the first plan. Those built on TRLB (TBM, RBM, ETBM, ERBM) always do.
    pub first: bool,
    /// RBM and ERBM take the first primitive plan of minimum peak, however many objects it buffers; TRLB
    /// clears no places for objects that find none.
    pub strict_paper: bool,
    /// Where `auto` searches on several threads; the others use the caller's alone. No result depends on it,
    /// unless the clock ends the search.
    pub pool: Option<&'a rayon::ThreadPool>,
    /// A plan made before, when objects may have lain elsewhere; empty for none. `auto` begins with what is
    /// still possible of it, in order, and the shortest way from there; the others take no notice.
    pub known_plan: &'a [Action],
    /// For the objective `time`: seconds of a plan.
    pub seconds: Option<PlanSeconds<'a>>,
    /// For the objective `time`: seconds that no single move can undercut; 0 is always valid.
    pub least_move_seconds: f64,
}

impl<'a> Control<'a> {
    /// No limit but `stop`, nobody listening.
    pub fn until(stop: &'a (dyn Fn() -> bool + Sync)) -> Control<'a> {
        Control {
            work_limit: None,
            stop,
            on_plan: &|_, _| (),
            on_bound: &|_| (),
            first: false,
            strict_paper: false,
            pool: None,
            known_plan: &[],
            seconds: None,
            least_move_seconds: 0.0,
        }
    }
}

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
    /// The objective `time` without anybody who knows times.
    #[error("the objective time needs a cell that knows how long its moves take; use pp or ti here")]
    NoTimes,
}

/// Cost of a plan in an objective.
pub fn cost(problem: &Problem, objective: Objective, control: &Control, actions: &[Action]) -> f64 {
    match (objective, control.seconds) {
        (Objective::Ti, _) => actions.iter().map(|action| problem.objects[action.object].impedance).sum(),
        (Objective::Time, Some(seconds)) => seconds(actions),
        (Objective::Pp | Objective::Time, _) => actions.len() as f64,
    }
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
    let mut proof = RoomBound::new(scene, &costs);
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

/// Equal but for the rounding of sums.
fn reaches(cost: f64, bound: f64) -> bool {
    cost <= bound + 1e-9 * bound.abs().max(1.0)
}

#[cfg(test)]
mod auto_properties;

#[cfg(test)]
mod properties;

#[cfg(test)]
mod tests;
