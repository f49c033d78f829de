//! Putting down what hangs on the gripper, wherever the arm was stopped with it.
//!
//! In: the joints at which an object was picked, its pose then, where the arm is, where the object is to go.
//! Out: where the object hangs now, and the two checked paths down onto the place and up again. Pure. The
//! tool points straight down, as it does in every pick-n-place; an arm that was moved by hand may have
//! tilted it, and then nothing is put down.

use crate::bodies::{Load, Room, Standing, Tabletop};
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, Segment, out_of_reach};
use crate::pick_n_place::{CycleParameters, tool_down};
use cell_values::units::Joints;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// The tool counts as pointing straight down within this angle, rad.
const UPRIGHT_RAD: f64 = 0.02;

/// How an object hangs on the tool.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Grasp {
    /// The object, below the cups.
    load: Load,
    /// Largest acceleration of the tool that the vacuum holds it at, m/s2.
    hold: f64,
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
    /// An object that lay like this when it was picked with the arm at `pick`, and that the vacuum holds at
    /// accelerations up to `hold` (m/s2); `None` when the tool did not point straight down.
    pub fn new(model: &ArmModel, pick: &Joints, object: &Standing, hold: f64) -> Option<Grasp> {
        let tool_from_object = seen_from_above(model, pick)?.inverse().compose(&object.pose);
        let Standing { name, footprint, height, .. } = object.clone();
        Some(Grasp { load: Load { name, footprint, tool_from_object, height }, hold })
    }

    /// An object that hangs as it was written down when it was picked.
    pub fn remembered(load: Load, hold: f64) -> Grasp {
        Grasp { load, hold }
    }

    /// The object as a body below the cups.
    pub fn load(&self) -> &Load {
        &self.load
    }

    /// Largest acceleration of the tool that the vacuum holds it at, m/s2.
    pub fn hold(&self) -> f64 {
        self.hold
    }

    /// Where the object hangs with the arm at `q`, table frame, seen from above; `None` when the tool does
    /// not point straight down.
    pub fn object_at(&self, model: &ArmModel, q: &Joints) -> Option<Pose2> {
        seen_from_above(model, q).map(|tool| tool.compose(&self.load.tool_from_object))
    }

    /// Paths from `start`, which is over everything on the table, that put the object down at `to`; `table`
    /// is what lies on it.
    ///
    /// # Errors
    /// The place is out of reach, or the way there is not free of limits and floors.
    pub fn put_down(
        &self,
        model: &ArmModel,
        start: &Joints,
        to: &Pose2,
        cycle: &CycleParameters,
        table: &Tabletop,
    ) -> Result<PutDown, PathFault> {
        let tool = to.compose(&self.load.tool_from_object.inverse());
        let height = self.load.height;
        let low = height - cycle.press;
        let high = cycle.tallest + cycle.air + self.load.depth().max(cycle.approach);
        let empty = Room::new(&model.bodies, table, None);
        let placed = Room::new(&model.bodies, table, Some(&self.placed_at(*to)));
        let rooms = [empty.holding(&model.bodies, Some(&self.load)), placed];
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
            match self.paths(model, start, [over, place], cycle, &rooms) {
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
        [over, place]: [Joints; 2],
        cycle: &CycleParameters,
        [loaded, placed]: &[Room; 2],
    ) -> Result<PutDown, PathFault> {
        let near_table = self.load.height - cycle.press - 1e-3;
        let floor = cycle.layer() + self.load.height;
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
            let legs = [Leg::over(transfer, floor), Leg::between(straight(place), near_table)];
            CheckedPath::new(model, start, &legs.map(|leg| leg.holding(self.hold)), loaded)
        };
        let down = with(transfer).or_else(|_| with(straight(over)))?;
        let up = CheckedPath::new(model, &place, &[Leg::between(straight(over), near_table)], placed)?;
        Ok(PutDown { down, up })
    }

    fn placed_at(&self, pose: Pose2) -> Standing {
        let Load { name, footprint, height, .. } = self.load.clone();
        Standing { name, footprint, pose, height }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick_n_place::plan;
    use crate::testing::{cycle, home, model, table, task};
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
            let task = task(from, goal, [0.01, 0.0]);
            let paths = plan(&model, &home(&model, 0.5), &task, &cycle(), &table()).expect("reachable");
            let grasp =
                Grasp::new(&model, &paths.carry.start(), &task.lying_at(from), 20.0).expect("upright");
            let hangs = grasp.object_at(&model, &paths.carry.end()).expect("upright");
            assert!(
                hangs.distance(&goal) < 1e-6 && hangs.angle_difference(&goal) < 1e-6,
                "{case}: {hangs:?}"
            );
            // Stopped over the place; it is to go somewhere else.
            let over = paths.retreat.end();
            let put = grasp.put_down(&model, &over, &elsewhere, &cycle(), &table()).expect("reachable");
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
        let lies = task(Pose2::default(), Pose2::default(), [0.0; 2]).lying_at(Pose2::default());
        assert!(Grasp::new(&model, &tilted, &lies, 20.0).is_some());
        tilted.0[3] += 0.05;
        assert!(Grasp::new(&model, &tilted, &lies, 20.0).is_none());
    }

    #[test]
    fn a_place_out_of_reach_is_refused() {
        let model = model(0.5);
        let start = home(&model, 0.5);
        let at = Pose2::new(0.25, 0.25, 0.0);
        let grasp = Grasp::new(&model, &start, &task(at, at, [0.0; 2]).lying_at(at), 20.0).expect("upright");
        let fault = grasp.put_down(&model, &start, &Pose2::new(0.25, 1.3, 0.0), &cycle(), &table());
        assert!(fault.expect_err("too far").to_string().contains("place"));
    }
}
