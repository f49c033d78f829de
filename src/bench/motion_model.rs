//! What `bench motion` is measured against: a rod in place of the gripper, which both models of the arm
//! have, and another planner.
//!
//! In: the arm's model. Out: the rod, and whether a roadmap finds a way; it uses the swept check for single
//! straight ways only.

use cell_motion::bodies::Room;
use cell_motion::bodies::sweep::Sweep;
use cell_motion::path::ArmModel;
use cell_values::units::Joints;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ur_arm::bodies::Capsule;

/// A rod in place of the gripper, from a little off the flange to the cups: ends and radius, m.
pub fn rod(model: &ArmModel) -> Capsule {
    Capsule { a: [0.0, 0.0, 0.07], b: model.flange_from_tool.translation.vector.into(), radius: 0.04 }
}

/// Points a roadmap's point is joined with.
const NEIGHBOURS: usize = 8;

/// Whether a probabilistic roadmap over all of the joints' ranges finds a way (Kavraki and others, 1996)
/// with at most `steps` checked straight ways.
pub fn roadmap(model: &ArmModel, room: &Room, from: &Joints, to: &Joints, steps: usize, seed: u64) -> bool {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut sweep = Sweep::new(&model.bodies, room);
    let mut points = vec![*from, *to];
    // Which of the two ends a point is joined with: sets that are united.
    let mut parent = vec![0, 1];
    let mut checked = 0;
    while checked < steps {
        let q = Joints(std::array::from_fn(|j| {
            let (low, high) = model.limits.joint_range[j];
            random.random_range(low..high)
        }));
        checked += 1;
        if sweep.way(&q, &q).is_err() {
            continue;
        }
        let mut near: Vec<(f64, usize)> =
            points.iter().enumerate().map(|(k, point)| (point.max_difference(&q), k)).collect();
        let count = NEIGHBOURS.min(near.len());
        near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0));
        points.push(q);
        parent.push(parent.len());
        let new = points.len() - 1;
        for (_, k) in &near[..count] {
            if root(&mut parent, *k) == root(&mut parent, new) {
                continue;
            }
            checked += 1;
            let way = &points[*k];
            let free = if *k == 0 { sweep.way_out(way, &q) } else { sweep.way(way, &q) };
            if free.is_ok() {
                let (a, b) = (root(&mut parent, *k), root(&mut parent, new));
                parent[b] = a;
            }
        }
        if root(&mut parent, 0) == root(&mut parent, 1) {
            return true;
        }
    }
    false
}

fn root(parent: &mut [usize], of: usize) -> usize {
    let mut at = of;
    while parent[at] != at {
        parent[at] = parent[parent[at]];
        at = parent[at];
    }
    at
}
