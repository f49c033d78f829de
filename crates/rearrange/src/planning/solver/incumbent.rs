//! Between the solvers and the caller: the best checked plan, and how `auto` is set up.
//!
//! In: a scene with a valid goal arrangement, solver, objective, control, seed. Out: the best checked plan
//! and its cost, left in [`Incumbent`]. `auto` gets the costs of moves by objective, and two of the paper's
//! solvers to call.

use crate::geometry::pose::Pose2;
use crate::planning::auto::worker::PortfolioTask;
use crate::planning::auto::{self, Audience};
use crate::planning::bound::Parts;
use crate::planning::check::CheckedPlan;
use crate::planning::effort::{Effort, Watch};
use crate::planning::mcts::Verdict;
use crate::planning::plan::{Action, ActionKind, Objective};
use crate::planning::problem::{Problem, ProblemObject};
use crate::planning::scene::Scene;
use crate::planning::solver::control::{Control, SolverKind, cost, reaches};
use crate::planning::solver::fallback;
use crate::planning::solver::search::{self, Setting};
use crate::planning::trlb::Move;

/// Ticks of work for which a plan is checked after the search has to end: some hundredths of a second,
/// enough for a thousand simple objects. What was found in time is not thrown away.
const CHECK_GRACE: u64 = 4_000_000;

/// The best plan so far, and who decides whether another one is better.
pub(super) struct Incumbent<'a> {
    problem: &'a Problem,
    objective: Objective,
    control: &'a Control<'a>,
    /// No plan is cheaper.
    pub(super) lower_bound: f64,
    /// Plan and cost.
    pub(super) best: Option<(CheckedPlan, f64)>,
}

impl<'a> Incumbent<'a> {
    /// No plan yet.
    pub(super) fn new(
        problem: &'a Problem,
        objective: Objective,
        control: &'a Control<'a>,
        lower_bound: f64,
    ) -> Incumbent<'a> {
        Incumbent { problem, objective, control, lower_bound, best: None }
    }
}

impl Audience for Incumbent<'_> {
    /// Takes a plan if the independent checker does, keeps it if cheaper, and reports it to the caller then.
    fn offer(&mut self, moves: &[Move]) -> Verdict {
        let mut watch = Watch::with_grace(self.control.stop, CHECK_GRACE);
        let actions = actions(self.problem, moves);
        let Ok(plan) = CheckedPlan::within(self.problem, &actions, &mut watch) else {
            return Verdict::Refused;
        };
        let cost = cost(self.problem, self.objective, self.control, plan.actions());
        if self.best.as_ref().is_none_or(|(_, least)| cost < *least) {
            (self.control.on_plan)(plan.actions(), cost);
            self.best = Some((plan, cost));
        }
        let enough = self.control.first || reaches(cost, self.lower_bound);
        if enough { Verdict::Enough } else { Verdict::Accepted }
    }

    fn prove(&mut self, bound: f64) -> bool {
        if bound > self.lower_bound {
            self.lower_bound = bound;
            (self.control.on_bound)(bound);
        }
        self.best.as_ref().is_some_and(|(_, cost)| reaches(*cost, self.lower_bound))
    }
}

/// What moves cost, and what the bound says of them.
pub(super) struct Moves {
    /// Cost of one move of each object.
    pub(super) costs: Vec<f64>,
    /// What the bound is put together from, by these costs.
    pub(super) parts: Parts,
}

/// Searches until the solver's rule, the control or the effort ends it; the plan is left in `incumbent`.
pub(super) fn run(
    scene: &Scene,
    solver: SolverKind,
    seed: u64,
    moves: &Moves,
    incumbent: &mut Incumbent,
    effort: &mut Effort,
) {
    if solver == SolverKind::Auto {
        return auto(scene, seed, moves, incumbent, effort);
    }
    let setting = Setting { objective: incumbent.objective, strict_paper: incumbent.control.strict_paper };
    search::run(scene, solver, seed, setting, &mut |moves| incumbent.offer(moves), effort);
}

/// Our own solver. It counts moves, weighted by impedance under TI; under `time` the caller judges whole
/// plans.
fn auto(scene: &Scene, seed: u64, moves: &Moves, incumbent: &mut Incumbent, effort: &mut Effort) {
    let (problem, objective, control) = (scene.problem, incumbent.objective, incumbent.control);
    let fallback = |worker, seed| fallback::fallback(scene, objective, worker, seed);
    let judge = |moves: &[Move]| cost(problem, objective, control, &actions(problem, moves));
    let is_known = |action: &&Action| {
        problem.objects.get(action.object).is_some_and(|o| !o.fixed) && action.to.is_finite()
    };
    let known = control.known_plan.iter().filter(is_known).map(|action| (action.object, action.to));
    let task = PortfolioTask {
        scene,
        costs: &moves.costs,
        bound: &moves.parts,
        judge: if objective == Objective::Time { Some(&judge) } else { None },
        worth: if objective == Objective::Time { control.least_move_seconds } else { 1.0 },
        fallback: &fallback,
        known: &known.collect::<Vec<_>>(),
    };
    let search = auto::Search { task: &task, pool: control.pool, seed };
    search.run(incumbent, effort);
}

fn actions(problem: &Problem, moves: &[Move]) -> Vec<Action> {
    moves
        .iter()
        .map(|m| {
            let kind =
                if is_goal_of(problem, m.object, &m.to.pose) { ActionKind::Goal } else { ActionKind::Buffer };
            Action { object: m.object, from: m.from.pose, to: m.to.pose, kind }
        })
        .collect()
}

/// Is the pose the object's goal, or one of its group's?
fn is_goal_of(problem: &Problem, object: usize, pose: &Pose2) -> bool {
    let group = &problem.objects[object].group;
    let shared = |o: &ProblemObject| group.is_some() && o.group == *group;
    let may_take = problem.objects.iter().enumerate().filter(|(k, o)| *k == object || shared(o));
    may_take.into_iter().any(|(_, o)| o.goal == Some(*pose))
}
