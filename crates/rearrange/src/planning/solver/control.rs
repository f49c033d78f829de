//! What a solver is to do: which one, within which limits, and how its plans are judged.
//!
//! In: words of the command line, limits, plans. Out: [`SolverKind`], [`Control`], the cost of a plan in an
//! objective, and whether that cost is the least there can be.

use crate::document::word::{UnknownWord, named};
use crate::planning::plan::{Action, Objective};
use crate::planning::problem::Problem;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The solvers of the paper, and ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
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
    /// All of them, those of the paper first.
    pub const ALL: [SolverKind; 7] = [
        SolverKind::Tbm,
        SolverKind::Rbm,
        SolverKind::Etbm,
        SolverKind::Erbm,
        SolverKind::Mcts,
        SolverKind::Emcts,
        SolverKind::Auto,
    ];

    /// The word on the command line and in files.
    pub fn as_str(self) -> &'static str {
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
}

impl fmt::Display for SolverKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for SolverKind {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<SolverKind, UnknownWord> {
        named(word, &SolverKind::ALL, SolverKind::as_str)
    }
}

/// Estimated seconds of a whole plan.
pub type PlanSeconds<'a> = &'a (dyn Fn(&[Action]) -> f64 + Sync);

/// What limits a search, and what receives its progress.
pub struct Control<'a> {
    /// Deterministic steps (sampled poses, search nodes) after which the search ends.
    pub work_limit: Option<u64>,
    /// Called often; true ends the search: the caller's clock, Ctrl-C.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called with each better plan and its cost, after the plan was checked.
    pub on_plan: &'a (dyn Fn(&[Action], f64) + Sync),
    /// Called with the bound that the search begins with, and when `auto` has proved a higher one.
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
    /// No limit but `stop`, progress not reported.
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

/// Cost of a plan in an objective.
pub fn cost(problem: &Problem, objective: Objective, control: &Control, actions: &[Action]) -> f64 {
    match (objective, control.seconds) {
        (Objective::Ti, _) => actions.iter().map(|action| problem.objects[action.object].impedance).sum(),
        (Objective::Time, Some(seconds)) => seconds(actions),
        (Objective::Pp | Objective::Time, _) => actions.len() as f64,
    }
}

/// No plan is cheaper: the cost is the lower bound, but for the rounding of sums.
pub fn reaches(cost: f64, bound: f64) -> bool {
    cost <= bound + 1e-9 * bound.abs().max(1.0)
}
