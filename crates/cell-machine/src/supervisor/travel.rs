//! Moves over the table that carry nothing to a place: to a look pose, to the park pose, straight up.
//!
//! In: where the arm is, what hangs on it, how tall things on the table are. Out: checked paths. From
//! wherever the arm was left: where the straight joint move is not free, a way round is searched for, and
//! where there is none, the arm does not move and the sentence says what it is too near to.

use crate::device::robot_types::RobotCommand;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::phase::Phase;
use crate::supervisor::reason::alarm;
use cell_motion::bodies::sweep::{Meeting, Sweep};
use cell_motion::bodies::{LAYER, Room};
use cell_motion::jog::jog_free;
use cell_motion::path::{CheckedPath, Leg, PathFault, Segment, out_of_reach};
use cell_motion::way::{NoWay, Search, THERE, find};
use cell_values::units::Joints;

/// The search for a way: the same every time, and short enough that the robot's watchdog does not run out
/// meanwhile.
const SEARCH: Search = Search { seed: 1, steps: 1500 };

/// Why the arm cannot go somewhere.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum NoTravel {
    #[error(transparent)]
    Path(#[from] PathFault),
    #[error(transparent)]
    Way(#[from] NoWay),
    /// Between the objects there is no room but upwards, and there it would meet something.
    #[error("straight above where the arm is, {} and {} would be too near to each other", .0.one, .0.other)]
    Above(Meeting),
}

impl NoTravel {
    /// What the arm would meet is what may lie on the table, or it cannot rise over that.
    pub(crate) fn meets_layer(&self) -> bool {
        match self {
            NoTravel::Path(PathFault::OutOfReach { .. } | PathFault::TooLow { .. }) => true,
            NoTravel::Path(fault) => fault.names(LAYER),
            NoTravel::Above(meeting)
            | NoTravel::Way(
                NoWay::Start(meeting) | NoWay::Target(meeting) | NoWay::NotFound { meeting, .. },
            ) => meeting.one == LAYER || meeting.other == LAYER,
            NoTravel::Way(NoWay::Range { .. }) => false,
        }
    }
}

impl Supervisor {
    /// A checked way over everything that may be on the table. Full turns of the joints are left as they
    /// are, where the joints' ranges allow it.
    pub(crate) fn transfer_to(&self, from: &Joints, target: Joints) -> Result<CheckedPath, NoTravel> {
        let arm = &self.model.arm;
        let target = arm.unwound(&target, from).unwrap_or(target);
        let room = self.unseen_room();
        let mut legs = Vec::new();
        let mut at = *from;
        // After a stop the arm may be between the objects: straight up first, for there is no room aside.
        if self.is_low(from, &room) {
            let up = self.straight_up(from)?;
            at = up.segment.target();
            legs.push(up);
        }
        let floor = self.tip_floor();
        let raised = !legs.is_empty();
        let points = find(arm, &room, &at, &target, SEARCH).map_err(|why| match why {
            NoWay::Start(meeting) if raised => NoTravel::Above(meeting),
            other => NoTravel::Way(other),
        })?;
        let cycle = self.cycle();
        legs.extend(points.into_iter().map(|target| {
            let (speed, acceleration) = (cycle.joint_speed, cycle.joint_acceleration);
            Leg::over(Segment::Joint { target, speed, acceleration, blend: 0.0 }, floor).holding(self.hold())
        }));
        Ok(CheckedPath::new(arm, from, &legs, &room)?)
    }

    /// What a person does where there was no way from here. In Remote Control the pendant moves nothing.
    pub(crate) fn advice(&self, from: &Joints, fault: &NoTravel) -> String {
        let jog = jog_free(&self.model.arm, &self.unseen_room(), from);
        let what = match (fault, jog) {
            (NoTravel::Way(NoWay::Target(_) | NoWay::Range { place: THERE, .. }), _) => {
                return "teach that pose again with more room".to_string();
            }
            (_, Some(jog)) => jog.to_string(),
            (NoTravel::Way(NoWay::Range { joint, .. }), None) => {
                format!("jog joint {joint} back into its range")
            }
            (
                NoTravel::Way(NoWay::NotFound { .. } | NoWay::Start(_))
                | NoTravel::Above(_)
                | NoTravel::Path(_),
                None,
            ) => "jog the arm to where it is high over the table and clear of everything".to_string(),
        };
        format!("{what} at the pendant in Local Control, then switch it back to Remote Control")
    }

    /// The tool, or what is round it, is lower than things on the table may reach.
    fn is_low(&self, from: &Joints, room: &Room) -> bool {
        let tip = self.model.arm.tool_at(from).translation.vector.z;
        // What is low although the tool is high does not get out of there by going up.
        if tip >= self.height_over_all() {
            return false;
        }
        tip < self.tip_floor() || Sweep::new(&self.model.arm.bodies, room).is_low(from)
    }

    /// Lowest height of the tool on a joint move: over everything on the table, with what is held below it.
    fn travel_floor(&self) -> f64 {
        let cycle = self.cycle();
        cycle.layer() + self.held_depth()
    }

    /// The same where how it hangs is not known; else the bodies say it better.
    fn tip_floor(&self) -> f64 {
        let unknown = match &self.back.held {
            Some(held) => held.grasp.is_none(),
            None => self.back.grips,
        };
        if unknown { self.travel_floor() } else { f64::NEG_INFINITY }
    }

    /// Height at which the tool, with what is held, is over everything that may be on the table.
    fn height_over_all(&self) -> f64 {
        let cycle = self.cycle();
        cycle.tallest + cycle.air + self.held_depth()
    }

    /// A path straight up to where there is nothing any more; `None` where the tool is that high already.
    pub(crate) fn straight_up_path(&self, from: &Joints) -> Result<Option<CheckedPath>, PathFault> {
        let room = self.unseen_room();
        if !self.is_low(from, &room) {
            return Ok(None);
        }
        CheckedPath::new(&self.model.arm, from, &[self.straight_up(from)?], &room).map(Some)
    }

    /// Vertically to where there is nothing any more.
    fn straight_up(&self, from: &Joints) -> Result<Leg, PathFault> {
        let cycle = self.cycle();
        let here = self.model.arm.tool_at(from);
        let mut above = here;
        above.translation.vector.z = self.height_over_all();
        let target = self.model.arm.joints_at(&above, from);
        let target = target.ok_or_else(|| out_of_reach("straight up", &above))?;
        let segment = Segment::Linear {
            target,
            speed: cycle.tool_speed,
            acceleration: cycle.tool_acceleration,
            blend: 0.0,
        };
        Ok(Leg::between(segment, here.translation.vector.z - 1e-3).holding(self.hold()))
    }

    pub(crate) fn begin_park(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some(robot) = devices.robot else { return };
        match self.transfer_to(&robot.q, self.model.park) {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                self.enter(Phase::Park, self.model.tolerances.look_deadline);
            }
            Err(fault) => {
                self.mode.set_park(false);
                let advice = self.advice(&robot.q, &fault);
                alarm(
                    out,
                    format!("cannot park: {fault}; the cell stays armed: `celld disarm`, then {advice}"),
                );
            }
        }
    }
}
