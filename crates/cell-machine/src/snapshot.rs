//! What the sessions know of the devices at one moment.
//!
//! In: the sessions of robot and gripper, the connections, the time. Out: the [`DeviceSnapshot`] with
//! which the supervisor decides and describes the devices.

use crate::device::gripper::Gripper;
use crate::device::robot::Robot;
use crate::device::robot_types::Link;
use crate::links::Connections;
use crate::supervisor::input::DeviceSnapshot;
use cell_values::time::{Duration, Timestamp};

/// A vacuum read longer ago than this says nothing: idle channels are read ten times a second.
const VACUUM_AGE: Duration = Duration::from_millis(500);

/// The devices as their sessions know them.
pub struct Sessions<'a> {
    pub robot: &'a Robot,
    pub gripper: &'a Gripper,
    pub connections: &'a Connections,
}

/// Their present state. `gripper_answers`: within its deadline.
pub fn snapshot<'a>(now: Timestamp, sessions: &Sessions<'a>, gripper_answers: bool) -> DeviceSnapshot<'a> {
    let Sessions { robot, gripper, connections } = *sessions;
    DeviceSnapshot {
        link_down: Link::ALL.into_iter().find(|link| !connections.is_up(*link)),
        link_lost: Link::ALL.into_iter().find(|link| connections.is_lost(*link)),
        all_links_lost: Link::ALL.into_iter().all(|link| connections.is_lost(link)),
        robot: robot.state(),
        robot_fresh: robot.fresh(now),
        program_settled: robot.program_settled(),
        arm_settled: robot.arm_settled(),
        gripper_holds: gripper.holding(),
        gripper_answers,
        gripper_fault: sessions.gripper.fault().unwrap_or_default(),
        gripper_identity: sessions.gripper.identity(),
        vacuum: gripper.reading().filter(|(at, _)| now.since(*at) <= VACUUM_AGE).map(|(_, v)| v),
    }
}
