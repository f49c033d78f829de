//! The tree search on tables small enough to know what it has to do.

use super::*;
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::problem::Problem;
use crate::planning::random_tables::table;
use crate::tabletop::instance::ObjectSpec;
use rand::SeedableRng;
use std::sync::Arc;

type Place = (f64, f64, f64);

fn object(name: &str, (length, width): (f64, f64), start: Place, goal: Place) -> ObjectSpec {
    let mut object = ObjectSpec::new(name, Footprint::rectangle(length, width).unwrap());
    object.start = Some(Pose2::new(start.0, start.1, start.2));
    object.goal = Some(Pose2::new(goal.0, goal.1, goal.2));
    object
}

fn problem(objects: Vec<ObjectSpec>) -> Problem {
    Problem::new(&table(objects)).unwrap()
}

fn ends(scene: &Scene) -> (Arrangement, Arrangement) {
    let all = 0..scene.problem.objects.len();
    let start = all.clone().map(|o| scene.start(o).clone()).collect();
    (start, all.map(|o| scene.goal(o).expect("all have goals").clone()).collect())
}

fn tree_search<'a>(
    scene: &'a Scene<'a>,
    rule: &Rule,
    start: &Arrangement,
    goal: Arrangement,
    most: usize,
) -> TreeSearch<'a> {
    let mut watch = Watch::new(&|| false);
    TreeSearch::new(scene, Arc::new(rule.clone()), start, goal, most, &mut watch).expect("nothing stops it")
}

/// Every plan that a search of so much work offers, in order.
fn plans(problem: &Problem, rule: &Rule, work: u64, seed: u64) -> Vec<Vec<Move>> {
    let scene = Scene::new(problem);
    let (start, goal) = ends(&scene);
    let mut search = tree_search(&scene, rule, &start, goal, usize::MAX);
    let mut found = Vec::new();
    let mut effort = Effort::new(Some(work), &|| false);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut offer = |plan| {
        found.push(plan);
        Verdict::Accepted
    };
    search.grow(&mut f64::INFINITY.clone(), &mut rng, &mut effort, &mut offer);
    found
}

const SMALL: (f64, f64) = (0.1, 0.1);

#[test]
fn who_is_relocated_really_blocks() {
    // The centre of `near` is nearer to the goal of `mover`, but `long` lies on it.
    let problem = problem(vec![
        object("mover", SMALL, (0.1, 0.9, 0.0), (0.3, 0.5, 0.0)),
        object("near", SMALL, (0.3, 0.63, 0.0), (0.9, 0.9, 0.0)),
        object("long", (0.6, 0.1), (0.6, 0.5, 0.0), (0.5, 0.1, 0.0)),
    ]);
    let scene = Scene::new(&problem);
    let (start, goal) = ends(&scene);
    for seed in 0..20 {
        let mut effort = Effort::new(None, &|| false);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut known =
            Table::new(&scene, &start, &goal, &mut Watch::new(&|| false)).expect("nothing stops it");
        let state = known.start();
        let (moved, place) = known.act(&state, 0, &goal, &mut rng, &mut effort).expect("there is room");
        assert_eq!(moved, 2);
        assert!(scene.clear(known.spot(place), &goal[0]), "the goal is open afterwards");
        assert_eq!(known.act(&state, 1, &goal, &mut rng, &mut effort), Some((1, 4)), "its goal is open");
    }
}

#[test]
fn a_wrong_angle_is_not_home() {
    let turned = problem(vec![object("o", (0.3, 0.1), (0.5, 0.5, 0.0), (0.5, 0.5, 1.0))]);
    let found = plans(&turned, &Rule::plain(1), 100, 0);
    assert_eq!(found[0].len(), 1);
    assert_eq!(found[0][0].to.pose.theta, 1.0);
}

#[test]
fn who_is_home_stays_there() {
    let problem = problem(vec![
        object("a", SMALL, (0.2, 0.5, 0.0), (0.5, 0.5, 0.0)),
        object("b", SMALL, (0.5, 0.5, 0.0), (0.2, 0.5, 0.0)),
        object("home", SMALL, (0.5, 0.63, 0.0), (0.5, 0.63, 0.0)),
    ]);
    for seed in 0..20 {
        let found = plans(&problem, &Rule::plain(3), 2000, seed);
        assert!(!found.is_empty());
        assert!(found.iter().flatten().all(|m| m.object != 2), "seed {seed}");
        assert_eq!(found[found.len() - 1].len(), 3, "the shortest plan of a swap");
        assert!(found.windows(2).all(|pair| pair[1].len() < pair[0].len()), "only better ones are offered");
    }
}

#[test]
fn two_orders_of_the_same_moves_share_a_state() {
    let rule = Rule::plain(2);
    let mut tree = Tree::new(Arc::new(rule.clone()), &[0, 1], ObjectSet::EMPTY);
    let home = |objects: &[usize]| objects.iter().copied().collect::<ObjectSet>();
    let a = tree.link(0, 0, 0, &[2, 1], home(&[0])).node;
    let b = tree.link(0, 1, 1, &[0, 3], home(&[1])).node;
    let both = tree.link(a, 1, 1, &[2, 3], home(&[0, 1]));
    let again = tree.link(b, 0, 0, &[2, 3], home(&[0, 1]));
    assert_eq!((tree.len(), both.node), (4, again.node));
    assert!(both.improved && !again.improved);
    assert!(tree.is_goal(both.node) && !tree.is_goal(a));
    assert_eq!(tree.way_to(both.node), [0, a, both.node]);
}

#[test]
fn a_full_table_exhausts_the_tree() {
    let problem = problem(vec![
        object("left", (0.5, 1.0), (0.25, 0.5, 0.0), (0.75, 0.5, 0.0)),
        object("right", (0.5, 1.0), (0.75, 0.5, 0.0), (0.25, 0.5, 0.0)),
    ]);
    let scene = Scene::new(&problem);
    let (start, goal) = ends(&scene);
    let mut search = tree_search(&scene, &Rule::plain(2), &start, goal, 100);
    let mut effort = Effort::new(Some(10_000), &|| false);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut ceiling = f64::INFINITY;
    assert!(!search.grow(&mut ceiling, &mut rng, &mut effort, &mut |_| Verdict::Enough));
    assert!(search.is_over());
    assert!(effort.done() < 1000, "{} steps", effort.done());
}

#[test]
fn the_bound_prefers_reward_then_the_unvisited() {
    let mut rule = Rule::plain(2);
    let child = |rule: &Rule, rewards: [f64; 2], visits: [usize; 2]| {
        let mut tree = Tree::new(Arc::new(rule.clone()), &[0, 1], ObjectSet::EMPTY);
        let a = tree.link(0, 0, 0, &[2, 1], ObjectSet::EMPTY.with(0)).node;
        let b = tree.link(0, 1, 1, &[0, 3], ObjectSet::EMPTY.with(1)).node;
        for (node, (reward, visits)) in [a, b].into_iter().zip(rewards.into_iter().zip(visits)) {
            (0..visits).for_each(|_| tree.reward(&[0, node], reward));
        }
        tree.best_child(0, f64::INFINITY).map(|node| usize::from(node == b))
    };
    assert_eq!(child(&rule, [0.5, 0.6], [10, 10]), Some(1));
    assert_eq!(child(&rule, [0.5, 0.5], [20, 2]), Some(1), "seldom visited");
    // ln 22 = 3.1: with C the first child has 0.5 + C 2.49 / sqrt 20, the second 0.45 + C 2.49 / sqrt 2.
    rule.exploration = vec![0.01, 0.01];
    assert_eq!(child(&rule, [0.5, 0.45], [20, 2]), Some(0));
    rule.exploration = vec![0.01, 0.2];
    assert_eq!(child(&rule, [0.5, 0.45], [20, 2]), Some(1), "a heavy object's action is explored more");
}

#[test]
fn emcts_weighs_exploration_or_reward() {
    let weights = [1.0, 3.0];
    let pp = Rule::exploring(&weights);
    assert_eq!(pp.exploration, [EMCTS_EXPLORATION * 1.25, EMCTS_EXPLORATION * 1.75]);
    assert_eq!((pp.rewards, pp.costs), (vec![0.5, 0.5], vec![1.0, 1.0]));
    let ti = Rule::rewarding(&weights);
    assert_eq!(ti.exploration, [EMCTS_EXPLORATION; 2]);
    assert_eq!((ti.rewards, ti.costs), (vec![0.25, 0.75], vec![1.0, 3.0]));
}
