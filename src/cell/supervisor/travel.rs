//! Moves over the table that carry nothing to a place: to a look pose, to the park pose, straight up.
//!
//! In: where the arm is, what hangs on it, how tall things on the table are. Out: checked paths.

use crate::cell::device::robot_types::RobotCommand;
use crate::cell::supervisor::cell::Supervisor;
use crate::cell::supervisor::input::{Action, DeviceSnapshot};
use crate::cell::supervisor::phase::Phase;
use crate::cell::supervisor::reason::alarm;
use crate::motion::path::{CheckedPath, Leg, PathFault, Segment, out_of_reach};
use cell_values::units::Joints;

impl Supervisor {
    /// A checked joint move, over everything that is on the table.
    pub(crate) fn transfer_to(&self, from: &Joints, target: Joints) -> Result<CheckedPath, PathFault> {
        let cycle = self.cycle();
        let segment = Segment::Joint {
            target,
            speed: cycle.joint_speed,
            acceleration: cycle.joint_acceleration,
            blend: 0.0,
        };
        let floor = self.travel_floor();
        let mut legs = Vec::new();
        // After a stop the arm may be between the objects: straight up first, for there is no room aside.
        if self.model.arm.tool_at(from).translation.vector.z < floor {
            legs.push(self.straight_up(from)?);
        }
        legs.push(Leg { segment, floor });
        CheckedPath::new(&self.model.arm, from, &legs)
    }

    /// Lowest height of the tool on a joint move: over everything on the table, with what is held below it.
    fn travel_floor(&self) -> f64 {
        let cycle = self.cycle();
        cycle.tallest + 0.5 * cycle.air + self.held_height()
    }

    /// A path straight up to where there is nothing any more; `None` where the tool is that high already.
    pub(crate) fn straight_up_path(&self, from: &Joints) -> Result<Option<CheckedPath>, PathFault> {
        if self.model.arm.tool_at(from).translation.vector.z >= self.travel_floor() {
            return Ok(None);
        }
        CheckedPath::new(&self.model.arm, from, &[self.straight_up(from)?]).map(Some)
    }

    /// Vertically to where there is nothing any more.
    fn straight_up(&self, from: &Joints) -> Result<Leg, PathFault> {
        let cycle = self.cycle();
        let here = self.model.arm.tool_at(from);
        let mut above = here;
        above.translation.vector.z = cycle.tallest + cycle.air + self.held_height();
        let target = self.model.arm.joints_at(&above, from);
        let target = target.ok_or_else(|| out_of_reach("straight up", &above))?;
        let segment = Segment::Linear {
            target,
            speed: cycle.tool_speed,
            acceleration: cycle.tool_acceleration,
            blend: 0.0,
        };
        Ok(Leg { segment, floor: here.translation.vector.z - 1e-3 })
    }

    pub(crate) fn begin_park(&mut self, outside: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some(robot) = outside.robot else { return };
        match self.transfer_to(&robot.q, self.model.park) {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                self.enter(Phase::Park, self.model.tolerances.look_deadline);
            }
            Err(fault) => {
                self.mode.set_park(false);
                alarm(out, format!("cannot park: {fault}"));
            }
        }
    }
}
