//! Small random problems for property tests, and their optimum when objects may also wait beside the table.
//!
//! In: random numbers, a number of objects. Out: instances with valid start and goal arrangements; the least
//! cost of any plan that may use places outside the table, by exhaustive search. Contact is decided with the
//! plan checker's polygons, not with the kernel of the code under test. Tests only.

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::overlap::{Body, TOUCH_M};
use crate::planning::problem::Problem;
use crate::tabletop::instance::{Instance, ObjectSpec, Workspace};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Objects of mixed shapes on a table of 1 m x 1 m, all with goals.
pub fn random_instance(rng: &mut ChaCha8Rng, count: usize) -> Instance {
    loop {
        let mut objects: Vec<ObjectSpec> = (0..count)
            .map(|k| {
                let (length, width) = (rng.random_range(0.2..0.45), rng.random_range(0.12..0.3));
                let shape = match rng.random_range(0..3) {
                    0 => Footprint::rectangle(length, width),
                    1 => Footprint::ellipse(length, width),
                    _ => Footprint::disc(width / 1.6),
                };
                let mut object = ObjectSpec::new(format!("o{k}"), shape.expect("valid sizes"));
                object.impedance = Some(f64::from(rng.random_range(1..5u32)));
                object
            })
            .collect();
        let shapes: Vec<Footprint> = objects.iter().map(|o| o.footprint.clone()).collect();
        let (Some(starts), Some(goals)) = (arrangement(rng, &shapes), arrangement(rng, &shapes)) else {
            continue;
        };
        for (object, (start, goal)) in objects.iter_mut().zip(starts.into_iter().zip(goals)) {
            (object.start, object.goal) = (Some(start), Some(goal));
        }
        return table(objects);
    }
}

/// Objects on a table of 1 m x 1 m without clearance.
pub fn table(objects: Vec<ObjectSpec>) -> Instance {
    Instance {
        workspace: Workspace { width: 1.0, height: 1.0 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    }
}

/// Random poses without contact; None when one object finds no place.
fn arrangement(rng: &mut ChaCha8Rng, shapes: &[Footprint]) -> Option<Vec<Pose2>> {
    let mut placed: Vec<(Body, Pose2)> = Vec::new();
    for shape in shapes {
        let fitting = (0..200).find_map(|_| {
            let (x, y, theta) =
                (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0), rng.random_range(-3.1..3.1));
            let pose = Pose2::new(x, y, theta);
            let body = Body::new(shape, &pose);
            let free = !body.reaches_over(1.0, 1.0, 0.0)
                && placed.iter().all(|(other, _)| !body.overlaps_deeper(other, TOUCH_M));
            free.then_some((body, pose))
        });
        placed.push(fitting?);
    }
    Some(placed.into_iter().map(|(_, pose)| pose).collect())
}

/// Where one object can be: its start first, then the goals it may take, then beside the table (None).
struct Options {
    poses: Vec<Option<Pose2>>,
    bodies: Vec<Option<Body>>,
}

/// Least cost of carrying the start to a goal arrangement, with the problem's clearance, if any number of
/// objects may wait beside the table, and objects without a goal may end there. `costs`: one move of each
/// object.
pub fn optimum_with_outside(problem: &Problem, costs: &[f64]) -> f64 {
    let options: Vec<Options> = (0..problem.objects.len()).map(|i| options(problem, i)).collect();
    let sizes: Vec<usize> = options.iter().map(|o| o.bodies.len()).collect();
    let states: usize = sizes.iter().product();
    let decode = |mut code: usize| -> Vec<usize> {
        let digit = |size: &usize| {
            let digit = code % size;
            code /= size;
            digit
        };
        sizes.iter().map(digit).collect()
    };
    let encode =
        |at: &[usize]| at.iter().zip(&sizes).rev().fold(0, |code, (digit, size)| code * size + digit);
    let clearance = problem.clearance;
    let meet = |i: usize, a: usize, j: usize, b: usize| match (&options[i].bodies[a], &options[j].bodies[b]) {
        (Some(mine), Some(theirs)) => {
            // Number 0 is the start. Given neighbours may be nearer than the clearance.
            let given = (a == 0 && b == 0) || (a > 0 && b > 0);
            mine.overlaps_deeper(theirs, TOUCH_M)
                || (clearance > 0.0 && !given && mine.nearer_than(theirs, clearance))
        }
        _ => false,
    };
    let mut least = vec![f64::INFINITY; states];
    least[0] = 0.0;
    let mut open = VecDeque::from([0]);
    let mut best = f64::INFINITY;
    while let Some(code) = open.pop_front() {
        let at = decode(code);
        if is_goal(problem, &options, &at) {
            best = best.min(least[code]);
        }
        for i in (0..at.len()).filter(|&i| !problem.objects[i].fixed) {
            for to in (0..sizes[i]).filter(|&to| to != at[i]) {
                if (0..at.len()).any(|j| j != i && meet(i, to, j, at[j])) {
                    continue;
                }
                let mut next = at.clone();
                next[i] = to;
                let (next, cost) = (encode(&next), least[code] + costs[i]);
                if cost < least[next] - 1e-12 {
                    least[next] = cost;
                    open.push_back(next);
                }
            }
        }
    }
    best
}

fn same_group(problem: &Problem, i: usize, j: usize) -> bool {
    let group = &problem.objects[i].group;
    i == j || (group.is_some() && problem.objects[j].group == *group)
}

fn options(problem: &Problem, i: usize) -> Options {
    let object = &problem.objects[i];
    let members = (0..problem.objects.len()).filter(|&j| same_group(problem, i, j));
    let goals = members.filter_map(|j| problem.objects[j].goal).map(Some);
    let poses: Vec<Option<Pose2>> = [Some(object.start)].into_iter().chain(goals).chain([None]).collect();
    let bodies = poses.iter().map(|pose| pose.map(|pose| Body::new(&object.footprint, &pose))).collect();
    Options { poses, bodies }
}

/// Every object with a goal of its own is there, and each goal of a group has a member on it.
fn is_goal(problem: &Problem, options: &[Options], at: &[usize]) -> bool {
    (0..at.len()).all(|i| {
        let Some(goal) = problem.objects[i].goal else { return true };
        let stands_there = |j: usize| options[j].poses[at[j]] == Some(goal);
        (0..at.len()).any(|j| same_group(problem, i, j) && stands_there(j))
    })
}
