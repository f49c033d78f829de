//! Where the arm can pick and place: what the planner may count on before any path is planned.
//!
//! In: the arm's model, an object's height and grip, a pose on the table. Out: whether some yaw of the tool
//! brings the cups down on the object there with every joint in its range, no singularity near and nothing
//! of the arm meeting the cell, from travel height straight down; or why not. Pure.
//!
//! It is what every pick and every place of a pick-n-place needs by itself. That pick and place can be
//! joined (a yaw for both, a free transfer, the neighbours) is checked with the plan. The solvers try
//! thousands of places: for them a mask of the table is made once.

use crate::bodies::{Room, Tabletop};
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, Segment, out_of_reach};
use crate::pick_n_place::{CycleParameters, PickNPlace, YAWS, tool_down, travel_height};
use cell_values::units::Joints;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::TAU;

/// Whether the object of `task` can be picked or placed at `pose`, whatever else lies on the table.
///
/// # Errors
/// The fault of the first yaw that has joints at all, or that none has.
pub fn reaches(
    model: &ArmModel,
    task: &PickNPlace,
    pose: &Pose2,
    cycle: &CycleParameters,
) -> Result<(), PathFault> {
    let heights = Heights::of(std::slice::from_ref(task), cycle);
    let at = pose.transform(task.grip_point);
    let room = Room::new(&model.bodies, &Tabletop::default(), None);
    any_yaw(yaws(task, pose), |yaw| descends(model, at, yaw, heights, cycle, &room))
}

/// Heights of the tool between which it goes straight down and up.
#[derive(Clone, Copy, Debug)]
struct Heights {
    low: f64,
    high: f64,
}

impl Heights {
    /// From the highest that any of these objects is carried at, to the lowest that one is picked at.
    fn of(objects: &[PickNPlace], cycle: &CycleParameters) -> Heights {
        let lowest = objects.iter().map(|object| object.height).fold(f64::INFINITY, f64::min);
        let high = objects.iter().map(|object| travel_height(object, cycle)).fold(0.0, f64::max);
        Heights { low: lowest.min(cycle.tallest) - cycle.press, high }
    }
}

/// The first yaw that does, or the fault of the first that does not.
fn any_yaw(yaws: Vec<f64>, does: impl Fn(f64) -> Result<(), PathFault>) -> Result<(), PathFault> {
    let mut fault = None;
    for yaw in yaws {
        match does(yaw) {
            Ok(()) => return Ok(()),
            // What would meet says more than a pose without joints.
            Err(found @ PathFault::OutOfReach { .. }) => fault = fault.or(Some(found)),
            Err(found) => fault = Some(found),
        }
    }
    fault.map_or(Ok(()), Err)
}

/// Straight down at a place with this yaw.
fn descends(
    model: &ArmModel,
    [x, y]: [f64; 2],
    yaw: f64,
    Heights { low, high }: Heights,
    cycle: &CycleParameters,
    room: &Room,
) -> Result<(), PathFault> {
    let at = |z: f64, near: &Joints| {
        let tool = tool_down(x, y, z, yaw);
        model.joints_in_work_posture(&tool, near).ok_or_else(|| out_of_reach("pick or place", &tool))
    };
    let over = at(high, &model.home)?;
    let target = at(low, &over)?;
    let (speed, acceleration) = (cycle.tool_speed, cycle.tool_acceleration);
    let segment = Segment::Linear { target, speed, acceleration, blend: 0.0 };
    CheckedPath::new(model, &over, &[Leg::between(segment, low - 1e-3)], room).map(|_| ())
}

/// The yaw the cups need, or a ring of them.
fn yaws(task: &PickNPlace, pose: &Pose2) -> Vec<f64> {
    match task.grip_yaw {
        Some(yaw) => vec![pose.theta + yaw],
        None => ring(),
    }
}

fn ring() -> Vec<f64> {
    (0..YAWS).map(|k| TAU * k as f64 / YAWS as f64).collect()
}

/// Nodes of a mask along each side of the table.
const NODES: usize = 15;

/// Where on the table any of some objects can be picked and placed: looked up in no time, and never more
/// than is true at the nodes round a place.
#[derive(Clone, Debug)]
pub struct ReachMask {
    table: [f64; 2],
    /// For each node, row by row, which yaws of the ring serve it.
    nodes: Vec<u32>,
}

impl ReachMask {
    /// For these objects on a table of this width and depth, m.
    pub fn new(
        model: &ArmModel,
        cycle: &CycleParameters,
        objects: &[PickNPlace],
        table: [f64; 2],
    ) -> ReachMask {
        let heights = Heights::of(objects, cycle);
        let room = Room::new(&model.bodies, &Tabletop::default(), None);
        // A cup that fits at any yaw needs one only.
        let one_is_enough = objects.iter().all(|object| object.grip_yaw.is_none());
        let node = |index: usize| {
            let at = [index % NODES, index / NODES].map(|k| k as f64 / (NODES - 1) as f64);
            let at = [at[0] * table[0], at[1] * table[1]];
            let mut served = 0;
            for (k, yaw) in ring().into_iter().enumerate() {
                if descends(model, at, yaw, heights, cycle, &room).is_ok() {
                    served |= 1 << k;
                    if one_is_enough {
                        return u32::MAX;
                    }
                }
            }
            served
        };
        ReachMask { table, nodes: (0..NODES * NODES).map(node).collect() }
    }

    /// Whether an object with this grip can be served at a pose.
    pub fn serves(&self, object: &PickNPlace, pose: &Pose2) -> bool {
        let at = pose.transform(object.grip_point);
        let cell = [0, 1].map(|i: usize| {
            let along = at[i] / self.table[i] * (NODES - 1) as f64;
            (along.floor().clamp(0.0, (NODES - 2) as f64)) as usize
        });
        let node = |dx: usize, dy: usize| self.nodes[(cell[1] + dy) * NODES + cell[0] + dx];
        let around = [node(0, 0), node(1, 0), node(0, 1), node(1, 1)];
        let Some(yaw) = object.grip_yaw else { return around.iter().all(|yaws| *yaws != 0) };
        let turn = (pose.theta + yaw).rem_euclid(TAU) / TAU * YAWS as f64;
        let bits = 1 << (turn.floor() as usize % YAWS) | 1 << ((turn.floor() as usize + 1) % YAWS);
        around.iter().all(|yaws| yaws & bits == bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick_n_place::plan;
    use crate::testing::{cycle, home, model, table, task};
    use nalgebra::Isometry3;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn what_is_out_of_reach_is_so_for_the_pick_n_place_too() {
        let model = model(0.5);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        let (mut reached, mut refused) = (0, 0);
        for _ in 0..150 {
            let pose = Pose2::new(random.random_range(-0.3..0.8), random.random_range(-0.1..0.9), 0.3);
            let task = task(pose, Pose2::new(0.25, 0.25, 0.0), [0.0, 0.0]);
            let planned = plan(&model, &home(&model, 0.5), &task, &cycle(), &table());
            match reaches(&model, &task, &pose, &cycle()) {
                Ok(()) => reached += 1,
                Err(fault) => {
                    refused += 1;
                    assert!(planned.is_err(), "{pose:?}: {fault}, but it is planned");
                }
            }
        }
        assert!(reached > 30 && refused > 10, "{reached} reached, {refused} refused");
    }

    #[test]
    fn a_mask_promises_nothing_that_is_out_of_reach() {
        let mut model = model(0.5);
        // A table that reaches beyond the arm.
        model.base_from_table = Isometry3::translation(-0.25, 0.5, 0.0);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        for grip_yaw in [None, Some(0.4)] {
            let mut object = task(Pose2::default(), Pose2::default(), [0.02, 0.01]);
            object.grip_yaw = grip_yaw;
            let mask = ReachMask::new(&model, &cycle(), std::slice::from_ref(&object), [0.5, 0.5]);
            let (mut served, mut missed) = (0, 0);
            for _ in 0..150 {
                let mut number = |to: f64| random.random_range(0.0..to);
                let pose = Pose2::new(number(0.5), number(0.5), number(6.0));
                let reached = reaches(&model, &object, &pose, &cycle()).is_ok();
                match mask.serves(&object, &pose) {
                    true => {
                        served += 1;
                        assert!(reached, "{pose:?}");
                    }
                    false => missed += usize::from(reached),
                }
            }
            assert!(served > 20 && missed < 40 && served < 140, "{served} served, {missed} missed");
        }
    }
}
