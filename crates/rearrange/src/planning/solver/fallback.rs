//! The paper's solvers as fallback solvers of `auto`: first plans where it is crowded, in searches that can
//! be left and gone on with.
//!
//! In: a scene with a valid goal arrangement, the number of a worker of the portfolio, a seed. Out: an
//! [`Fallback`] for some members. On the public instances of density 0.6, ETBM comes to short plans of discs
//! in a fraction of a second, and MCTS to plans of shapes that nothing else finds in seconds, long ones, but
//! a plan to shorten. A step of theirs takes an eighth of one of the roll-outs'; MCTS has twice as many, for
//! what it finds it finds in seconds of its own.

use crate::planning::auto::worker::{Fallback, Search};
use crate::planning::completion;
use crate::planning::mcts::{FIRST_TREE, LARGEST_TREE, Rule, TreeSearch, Verdict};
use crate::planning::plan::Objective;
use crate::planning::scene::Scene;
use crate::planning::solver::search::{heuristic, total_buffers_planner};
use crate::planning::trlb::{Trees, Trlb};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Movable objects up to which a first plan is left to the roll-outs for some rounds. With more of them a
/// roll-out takes long, and TBM has a plan sooner where there is room.
const FEW: usize = 64;

/// The fallback solver of the worker of this number.
pub(super) fn fallback<'a>(
    scene: &'a Scene<'a>,
    objective: Objective,
    worker: u64,
    seed: u64,
) -> Option<Fallback<'a>> {
    let many = scene.movable.len() > FEW;
    match worker {
        // Where there is room for many, the plain sets are found soonest.
        3 if many => Some(Fallback {
            search: total_buffers(scene, vec![1.0; scene.problem.objects.len()], seed),
            from_round: 1,
            steps: 64,
            betters: true,
        }),
        // Its plans are worth a look where ours are long.
        3 => Some(Fallback {
            search: total_buffers(scene, heuristic(scene, objective), seed),
            from_round: 9,
            steps: 8,
            betters: true,
        }),
        // Long plans, late: where nothing else has come to one in half a second.
        2 => Some(Fallback { search: tree_search(scene, seed), from_round: 13, steps: 16, betters: false }),
        _ => None,
    }
}

/// ETBM; with equal weights TBM.
fn total_buffers<'a>(scene: &'a Scene<'a>, weights: Vec<f64>, seed: u64) -> Box<Search<'a>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (start, mut goals) = (scene.starts().to_vec(), None);
    let mut trees: Option<Trees> = None;
    Box::new(move |effort| {
        let goals = goals.get_or_insert_with(|| completion::assigned_goals(scene, effort.watch()));
        let planner = total_buffers_planner(&weights);
        let trlb = Trlb { scene, planner: &planner, detours: true };
        while effort.step() {
            let growing = trees.take().filter(|both| !both.are_full());
            let mut new = || completion::complete(scene, goals, &mut rng, effort);
            let both = growing.or_else(|| new().map(|goal| Trees::new(start.clone(), goal)));
            let Some(mut both) = both else { continue };
            let plan = trlb.go_on(&mut both, &mut rng, effort);
            if plan.is_some() {
                return plan;
            }
            trees = Some(both);
        }
        None
    })
}

/// MCTS, whose trees grow as those of the solver do.
fn tree_search<'a>(scene: &'a Scene<'a>, seed: u64) -> Box<Search<'a>> {
    let rule = Arc::new(Rule::plain(scene.problem.objects.len()));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (start, mut goals) = (scene.starts().to_vec(), None);
    let mut most = FIRST_TREE;
    let mut tree: Option<TreeSearch> = None;
    Box::new(move |effort| {
        let goals = goals.get_or_insert_with(|| completion::assigned_goals(scene, effort.watch()));
        let mut found = None;
        while found.is_none() && effort.step() {
            let mut growing = match tree.take().filter(|tree| !tree.is_over()) {
                Some(growing) => growing,
                None => {
                    let goal = completion::complete(scene, goals, &mut rng, effort);
                    let Some(goal) = goal else { continue };
                    let watch = effort.watch();
                    let new = TreeSearch::new(scene, rule.clone(), &start, goal, most, watch);
                    most = LARGEST_TREE.min(2 * most);
                    let Some(new) = new else { continue };
                    new
                }
            };
            growing.grow(&mut f64::INFINITY.clone(), &mut rng, effort, &mut |moves| {
                found = Some(moves);
                Verdict::Enough
            });
            tree = Some(growing);
        }
        found
    })
}
