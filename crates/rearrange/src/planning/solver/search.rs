//! Runs the paper's solvers: which weights and which search each of them is made of.
//!
//! In: a scene with a valid goal arrangement, solver, objective, seed. Out: plans, offered to the caller.
//! TBM, RBM and MCTS search alike under every objective; ETBM, ERBM and EMCTS weigh objects by HeCP, and by
//! HeTI under TI. TRLB ends with its first plan that is accepted, as the paper does; the tree searches go on
//! for better ones until the limit, or until the caller has enough.

use crate::planning::buffers::Arrangement;
use crate::planning::completion;
use crate::planning::effort::Effort;
use crate::planning::graph::DependencyGraph;
use crate::planning::mcts::{FIRST_TREE, LARGEST_TREE, Rule, TreeSearch, Verdict};
use crate::planning::plan::Objective;
use crate::planning::primitive::Step;
use crate::planning::primitive::{Preference, RunningBuffer};
use crate::planning::scene::Scene;
use crate::planning::solver::control::SolverKind;
use crate::planning::total_buffers::TotalBuffers;
use crate::planning::trlb::{Move, Planner, Trlb};
use crate::planning::weights;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Takes plans, unchecked, and says whether the search goes on.
pub(super) type Offer<'a> = dyn FnMut(&[Move]) -> Verdict + 'a;

/// What the paper's solvers have to know beside the scene.
#[derive(Clone, Copy)]
pub(super) struct Setting {
    /// The objective, which decides about weights.
    pub(super) objective: Objective,
    /// As [`crate::planning::solver::control::Control::strict_paper`].
    pub(super) strict_paper: bool,
}

/// Searches until the solver's rule, `offer` or the effort ends it. `Auto` is none of these solvers.
pub(super) fn run(
    scene: &Scene,
    solver: SolverKind,
    seed: u64,
    setting: Setting,
    offer: &mut Offer,
    effort: &mut Effort,
) {
    let objective = setting.objective;
    let count = scene.problem.objects.len();
    match solver {
        SolverKind::Tbm => total_buffers(scene, &vec![1.0; count], setting, seed, offer, effort),
        SolverKind::Etbm => total_buffers(scene, &heuristic(scene, objective), setting, seed, offer, effort),
        SolverKind::Rbm => {
            let setting = Setting { objective: Objective::Pp, ..setting };
            running_buffer(scene, &vec![1; count], setting, seed, offer, effort);
        }
        SolverKind::Erbm => {
            let weights = rounded(scene, objective);
            running_buffer(scene, &weights, setting, seed, offer, effort);
        }
        SolverKind::Mcts => tree_search(scene, Rule::plain(count), seed, offer, effort),
        SolverKind::Emcts => {
            let weights = heuristic(scene, objective);
            let rule = match objective {
                Objective::Ti => Rule::rewarding(&weights),
                Objective::Pp | Objective::Time => Rule::exploring(&weights),
            };
            tree_search(scene, rule, seed, offer, effort);
        }
        SolverKind::Auto => {}
    }
}

/// HeTI under TI, else HeCP, for every object of the problem; 0 for those that never move.
pub(super) fn heuristic(scene: &Scene, objective: Objective) -> Vec<f64> {
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
fn total_buffers(
    scene: &Scene,
    weights: &[f64],
    setting: Setting,
    seed: u64,
    offer: &mut Offer,
    effort: &mut Effort,
) {
    trlb(scene, &total_buffers_planner(weights), setting, seed, offer, effort);
}

/// Primitive plans of least total buffer weight; one weight for every object of the problem.
pub(super) fn total_buffers_planner(
    weights: &[f64],
) -> impl Fn(&DependencyGraph, &[usize], &mut ChaCha8Rng, &mut Effort) -> Option<Vec<Step>> {
    |graph, objects, rng, effort| {
        let weights: Vec<f64> = objects.iter().map(|&o| weights[o]).collect();
        TotalBuffers { graph, weights: &weights }.plan(rng, effort)
    }
}

/// RBM and ERBM. Under TI the cost of a buffered object is its impedance, else 1.
fn running_buffer(
    scene: &Scene,
    weights: &[u32],
    setting: Setting,
    seed: u64,
    offer: &mut Offer,
    effort: &mut Effort,
) {
    let preference = if setting.strict_paper { Preference::FirstFound } else { Preference::FewerBuffers };
    let cost =
        |o: usize| if setting.objective == Objective::Ti { scene.problem.objects[o].impedance } else { 1.0 };
    let planner = |graph: &DependencyGraph, objects: &[usize], rng: &mut ChaCha8Rng, effort: &mut Effort| {
        let weights: Vec<u32> = objects.iter().map(|&o| weights[o]).collect();
        let costs: Vec<f64> = objects.iter().map(|&o| cost(o)).collect();
        RunningBuffer { graph, weights: &weights, costs: &costs, preference }.plan(rng, effort)
    };
    trlb(scene, &planner, setting, seed, offer, effort);
}

/// Calls `search` with the start and a complete goal until it says that it is over, or the effort is spent.
fn repeat(
    scene: &Scene,
    seed: u64,
    effort: &mut Effort,
    mut search: impl FnMut(&Arrangement, Arrangement, &mut ChaCha8Rng, &mut Effort) -> bool,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let goals = completion::assigned_goals(scene, effort.watch());
    let start = scene.starts().to_vec();
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
fn trlb(
    scene: &Scene,
    planner: &Planner,
    setting: Setting,
    seed: u64,
    offer: &mut Offer,
    effort: &mut Effort,
) {
    let trlb = Trlb { scene, planner, detours: !setting.strict_paper };
    repeat(scene, seed, effort, |start, goal, rng, effort| {
        let moves = trlb.search(start.clone(), goal, rng, effort);
        moves.is_some_and(|moves| offer(&moves) != Verdict::Refused)
    });
}

/// MCTS and EMCTS: trees that keep the best plan.
fn tree_search(scene: &Scene, rule: Rule, seed: u64, offer: &mut Offer, effort: &mut Effort) {
    let (rule, mut ceiling) = (Arc::new(rule), f64::INFINITY);
    let mut most = FIRST_TREE;
    repeat(scene, seed, effort, |start, goal, rng, effort| {
        let Some(mut search) = TreeSearch::new(scene, rule.clone(), start, goal, most, effort.watch()) else {
            return false;
        };
        let enough = search.grow(&mut ceiling, rng, effort, &mut |moves| offer(&moves));
        most = LARGEST_TREE.min(2 * most);
        enough
    });
}
