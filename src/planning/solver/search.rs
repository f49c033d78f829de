//! Runs the solvers: which weights and which search each of them is made of.
//!
//! In: a scene whose goal arrangement stands, solver, objective, control, seed. Out: the best checked plan and its
//! cost. TBM, RBM and MCTS search alike under every objective; ETBM, ERBM and EMCTS weigh objects by HeCP, and by
//! HeTI under TI. TRLB ends with its first plan, as the paper does; the tree searches go on for better ones until
//! the limit, unless the control asks for the first, and so does `auto`.

use crate::geometry::pose::Pose2;
use crate::planning::auto;
use crate::planning::buffers::Arrangement;
use crate::planning::check::CheckedPlan;
use crate::planning::completion;
use crate::planning::effort::Effort;
use crate::planning::graph::DependencyGraph;
use crate::planning::mcts::{FIRST_TREE, LARGEST_TREE, Rule, TreeSearch, Verdict};
use crate::planning::plan::{Action, ActionKind, Objective};
use crate::planning::primitive::{Preference, RunningBuffer};
use crate::planning::problem::{Problem, ProblemObject};
use crate::planning::scene::Scene;
use crate::planning::solver::{Control, SolverKind, cost, reaches};
use crate::planning::total_buffers::TotalBuffers;
use crate::planning::trlb::{Move, Planner, Trlb};
use crate::planning::weights;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The best plan so far, and who decides whether another one is better.
pub(super) struct Incumbent<'a> {
    problem: &'a Problem,
    objective: Objective,
    control: &'a Control<'a>,
    lower_bound: f64,
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

    /// Takes a plan if the independent checker does, keeps it if it is cheaper, and tells the caller then.
    fn offer(&mut self, moves: &[Move]) -> Verdict {
        let Ok(plan) = CheckedPlan::new(self.problem, &actions(self.problem, moves)) else {
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
}

/// Searches until the solver's rule, the control or the effort ends it; the plan is left in `incumbent`.
pub(super) fn run(
    scene: &Scene,
    solver: SolverKind,
    seed: u64,
    incumbent: &mut Incumbent,
    effort: &mut Effort,
) {
    let objective = incumbent.objective;
    let count = scene.problem.objects.len();
    match solver {
        SolverKind::Tbm => total_buffers(scene, &vec![1.0; count], seed, incumbent, effort),
        SolverKind::Etbm => total_buffers(scene, &heuristic(scene, objective), seed, incumbent, effort),
        SolverKind::Rbm => running_buffer(scene, &vec![1; count], Objective::Pp, seed, incumbent, effort),
        SolverKind::Erbm => {
            let weights = rounded(scene, objective);
            running_buffer(scene, &weights, objective, seed, incumbent, effort);
        }
        SolverKind::Mcts => tree_search(scene, &Rule::plain(count), seed, incumbent, effort),
        SolverKind::Emcts => {
            let weights = heuristic(scene, objective);
            let rule = match objective {
                Objective::Ti => Rule::rewarding(&weights),
                Objective::Pp | Objective::Time => Rule::exploring(&weights),
            };
            tree_search(scene, &rule, seed, incumbent, effort);
        }
        SolverKind::Auto => auto(scene, seed, incumbent, effort),
    }
}

/// Our own solver. It counts moves, weighted by impedance under TI.
fn auto(scene: &Scene, seed: u64, incumbent: &mut Incumbent, effort: &mut Effort) {
    let weigh = |o: &ProblemObject| if incumbent.objective == Objective::Ti { o.impedance } else { 1.0 };
    let costs: Vec<f64> = scene.problem.objects.iter().map(weigh).collect();
    auto::search(scene, &costs, seed, &mut |moves| incumbent.offer(moves), effort);
}

/// HeTI under TI, else HeCP, for every object of the problem; 0 for those that never move.
fn heuristic(scene: &Scene, objective: Objective) -> Vec<f64> {
    let values = match objective {
        Objective::Ti => weights::task_impedance(scene.problem, &scene.movable),
        Objective::Pp | Objective::Time => weights::collision_probability(scene.problem, &scene.movable),
    };
    let mut all = vec![0.0; scene.problem.objects.len()];
    for (&object, value) in scene.movable.iter().zip(values) {
        all[object] = value;
    }
    all
}

/// The heuristic divided by its smallest value and rounded, as ERBM needs it.
fn rounded(scene: &Scene, objective: Objective) -> Vec<u32> {
    let values = heuristic(scene, objective);
    let movable: Vec<f64> = scene.movable.iter().map(|&o| values[o]).collect();
    let mut all = vec![0; values.len()];
    for (&object, value) in scene.movable.iter().zip(weights::rounded(&movable)) {
        all[object] = value;
    }
    all
}

/// TBM and ETBM.
fn total_buffers(scene: &Scene, weights: &[f64], seed: u64, incumbent: &mut Incumbent, effort: &mut Effort) {
    let planner = |graph: &DependencyGraph, objects: &[usize], rng: &mut ChaCha8Rng, effort: &mut Effort| {
        let weights: Vec<f64> = objects.iter().map(|&o| weights[o]).collect();
        TotalBuffers { graph, weights: &weights }.plan(rng, effort)
    };
    trlb(scene, &planner, seed, incumbent, effort);
}

/// RBM and ERBM. Under TI the cost of a buffered object is its impedance, else 1.
fn running_buffer(
    scene: &Scene,
    weights: &[u32],
    objective: Objective,
    seed: u64,
    incumbent: &mut Incumbent,
    effort: &mut Effort,
) {
    let preference =
        if incumbent.control.strict_paper { Preference::FirstFound } else { Preference::FewerBuffers };
    let cost = |o: usize| if objective == Objective::Ti { scene.problem.objects[o].impedance } else { 1.0 };
    let planner = |graph: &DependencyGraph, objects: &[usize], rng: &mut ChaCha8Rng, effort: &mut Effort| {
        let weights: Vec<u32> = objects.iter().map(|&o| weights[o]).collect();
        let costs: Vec<f64> = objects.iter().map(|&o| cost(o)).collect();
        RunningBuffer { graph, weights: &weights, costs: &costs, preference }.plan(rng, effort)
    };
    trlb(scene, &planner, seed, incumbent, effort);
}

/// Calls `search` with the start and a complete goal until it says that it is over, or the effort is spent.
fn repeat(
    scene: &Scene,
    seed: u64,
    effort: &mut Effort,
    mut search: impl FnMut(&Arrangement, Arrangement, &mut ChaCha8Rng, &mut Effort) -> bool,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let goals = completion::assigned_goals(scene);
    let start: Arrangement = (0..scene.problem.objects.len()).map(|i| scene.start(i).clone()).collect();
    while !effort.is_over() {
        // Found anew each time: where an object without a goal ends may decide whether there is a plan.
        let goal = completion::complete(scene, &goals, &mut rng, effort);
        if goal.is_some_and(|goal| search(&start, goal, &mut rng, effort)) {
            return;
        }
        effort.step();
    }
}

/// TRLB with the given primitive planner, until its first plan that passes the check.
fn trlb(scene: &Scene, planner: &Planner, seed: u64, incumbent: &mut Incumbent, effort: &mut Effort) {
    let trlb = Trlb { scene, planner, detours: !incumbent.control.strict_paper };
    repeat(scene, seed, effort, |start, goal, rng, effort| {
        let moves = trlb.search(start.clone(), goal, rng, effort);
        moves.is_some_and(|moves| incumbent.offer(&moves) != Verdict::Refused)
    });
}

/// MCTS and EMCTS: trees that keep the best plan.
fn tree_search(scene: &Scene, rule: &Rule, seed: u64, incumbent: &mut Incumbent, effort: &mut Effort) {
    let mut ceiling = f64::INFINITY;
    let mut most = FIRST_TREE;
    repeat(scene, seed, effort, |start, goal, rng, effort| {
        let search = TreeSearch { scene, rule, start, goal: &goal };
        let enough = search.grow(most, &mut ceiling, rng, effort, &mut |moves| incumbent.offer(&moves));
        most = LARGEST_TREE.min(2 * most);
        enough
    });
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
