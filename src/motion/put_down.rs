//! Putting down what hangs on the gripper, wherever the arm was stopped with it.
//!
//! In: the joints at which an object was picked, its pose then, where the arm is, where the object is to go.
//! Out: where the object hangs now, and the two checked paths down onto the place and up again. Pure. The
//! tool points straight down, as it does in every pick-n-place; an arm that was moved by hand may have tilted
//! it, and then nothing is put down.

use crate::motion::path::{ArmModel, CheckedPath, Leg, PathFault, Segment, out_of_reach};
use crate::motion::pick_n_place::{CycleParameters, tool_down};
use cell_values::units::Joints;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::TAU;

/// The tool counts as pointing straight down within this angle, rad.
const UPRIGHT_RAD: f64 = 0.02;

/// How an object hangs on the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Its pose in the tool's frame, seen from above.
    tool_from_object: Pose2,
    /// Its height, m.
    height: f64,
}

/// Down onto a place, and straight up from it.
#[derive(Clone, Debug, PartialEq)]
pub struct PutDown {
    /// Over the place and down, with the object.
    pub down: CheckedPath,
    /// Straight up, without it.
    pub up: CheckedPath,
}

impl Grasp {
    /// An object of this height (m) that lay at `object` (table frame) when it was picked with the arm at
    /// `pick`; `None` when the tool did not point straight down.
    pub fn new(model: &ArmModel, pick: &Joints, object: &Pose2, height: f64) -> Option<Grasp> {
        let tool = seen_from_above(model, pick)?;
        Some(Grasp { tool_from_object: inverse(&tool).compose(object), height })
    }

    /// Where the object hangs with the arm at `q`, table frame, seen from above; `None` when the tool does
    /// not point straight down.
    pub fn object_at(&self, model: &ArmModel, q: &Joints) -> Option<Pose2> {
        seen_from_above(model, q).map(|tool| tool.compose(&self.tool_from_object))
    }

    /// Paths from `start`, which is over everything on the table, that put the object down at `to`.
    ///
    /// # Errors
    /// The place is out of reach, or the way there is not free of limits and floors.
    pub fn put_down(
        &self,
        model: &ArmModel,
        start: &Joints,
        to: &Pose2,
        cycle: &CycleParameters,
    ) -> Result<PutDown, PathFault> {
        let tool = to.compose(&inverse(&self.tool_from_object));
        let low = self.height - cycle.press;
        let high = cycle.tallest + cycle.air + self.height.max(cycle.approach);
        let mut fault = None;
        for turn in [0.0, -TAU, TAU] {
            let mut near = *start;
            near.0[5] += turn;
            let at = |z, near: &Joints| {
                let pose = tool_down(tool.x, tool.y, z, tool.theta);
                model.joints_in_work_posture(&pose, near)
            };
            let Some(over) = at(high, &near) else { continue };
            let Some(place) = at(low, &over) else { continue };
            match self.paths(model, start, over, place, cycle) {
                Ok(paths) => return Ok(paths),
                Err(found) => fault = fault.or(Some(found)),
            }
        }
        let pose = tool_down(tool.x, tool.y, low, tool.theta);
        Err(fault.unwrap_or_else(|| out_of_reach("place", &pose)))
    }

    fn paths(
        &self,
        model: &ArmModel,
        start: &Joints,
        over: Joints,
        place: Joints,
        cycle: &CycleParameters,
    ) -> Result<PutDown, PathFault> {
        let near_table = self.height - cycle.press - 1e-3;
        let floor = cycle.tallest + 0.5 * cycle.air + self.height;
        let straight = |target| Segment::Linear {
            target,
            speed: cycle.tool_speed,
            acceleration: cycle.tool_acceleration,
            blend: 0.0,
        };
        let transfer = Segment::Joint {
            target: over,
            speed: cycle.joint_speed,
            acceleration: cycle.joint_acceleration,
            blend: 0.0,
        };
        let with = |transfer| {
            let legs =
                [Leg { segment: transfer, floor }, Leg { segment: straight(place), floor: near_table }];
            CheckedPath::new(model, start, &legs)
        };
        let down = with(transfer).or_else(|_| with(straight(over)))?;
        let up = CheckedPath::new(model, &place, &[Leg { segment: straight(over), floor: near_table }])?;
        Ok(PutDown { down, up })
    }
}

/// Position and yaw of a tool that points straight down.
fn seen_from_above(model: &ArmModel, q: &Joints) -> Option<Pose2> {
    let tool = model.tool_at(q);
    let axes = tool.rotation.to_rotation_matrix();
    let upright = (-axes[(2, 2)]).clamp(-1.0, 1.0).acos() <= UPRIGHT_RAD;
    let place = tool.translation.vector;
    upright.then(|| Pose2::new(place.x, place.y, axes[(1, 0)].atan2(axes[(0, 0)])))
}

fn inverse(pose: &Pose2) -> Pose2 {
    let [x, y] = pose.inverse_transform([0.0, 0.0]);
    Pose2::new(x, y, -pose.theta)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::pick_n_place::tests::{cycle, home, model};
    use crate::motion::pick_n_place::{PickNPlace, plan};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn an_object_is_put_down_where_it_is_wanted_from_wherever_it_hangs() {
        let model = model(0.5);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        for case in 0..100 {
            let mut pose = || {
                let (x, y) = (rng.random_range(0.05..0.45), rng.random_range(0.05..0.45));
                Pose2::new(x, y, rng.random_range(-3.1..3.1))
            };
            let (from, goal, elsewhere) = (pose(), pose(), pose());
            let task = PickNPlace { from, to: goal, grip_point: [0.01, 0.0], grip_yaw: None, height: 0.02 };
            let paths = plan(&model, &home(&model, 0.5), &task, &cycle()).expect("reachable");
            let grasp = Grasp::new(&model, &paths.carry.start(), &from, 0.02).expect("upright");
            let hangs = grasp.object_at(&model, &paths.carry.end()).expect("upright");
            assert!(
                hangs.distance(&goal) < 1e-6 && hangs.angle_difference(&goal) < 1e-6,
                "{case}: {hangs:?}"
            );
            // Stopped over the place; it is to go somewhere else.
            let over = paths.retreat.end();
            let put = grasp.put_down(&model, &over, &elsewhere, &cycle()).expect("reachable");
            let lies = grasp.object_at(&model, &put.down.end()).expect("upright");
            assert!(lies.distance(&elsewhere) < 1e-6 && lies.angle_difference(&elsewhere) < 1e-6, "{case}");
            let cups = model.tool_at(&put.down.end()).translation.z;
            assert!((cups - 0.019).abs() < 1e-6 && put.up.end().max_difference(&put.down.end()) > 0.01);
        }
    }

    #[test]
    fn a_tilted_tool_puts_nothing_down() {
        let model = model(0.5);
        let mut tilted = home(&model, 0.5);
        assert!(Grasp::new(&model, &tilted, &Pose2::default(), 0.02).is_some());
        tilted.0[3] += 0.05;
        assert!(Grasp::new(&model, &tilted, &Pose2::default(), 0.02).is_none());
    }

    #[test]
    fn a_place_out_of_reach_is_refused() {
        let model = model(0.5);
        let start = home(&model, 0.5);
        let grasp = Grasp::new(&model, &start, &Pose2::new(0.25, 0.25, 0.0), 0.02).expect("upright");
        let fault = grasp.put_down(&model, &start, &Pose2::new(0.25, 1.3, 0.0), &cycle());
        assert!(fault.expect_err("too far").to_string().contains("place"));
    }
}
