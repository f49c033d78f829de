//! What of the sessions reaches the supervisor.

use super::*;
use crate::device::gripper_types::GripperParameters;
use crate::device::robot_types::RobotParameters;
use crate::supervisor::tests::set_out::goes_on;

/// A path that was sent after another is what the arm follows: the end of the first, noticed late, is not
/// taken for the tool being on the object.
#[test]
fn the_end_of_a_way_that_goes_on_in_another_is_no_end() {
    let (supervisor, now) = goes_on();
    let gripper = GripperParameters {
        vacuum_min: 0.4,
        vacuum_hold: 0.3,
        grip_within: Duration::from_secs(1),
        release_within: Duration::from_secs(1),
    };
    let robot = RobotParameters::full_rate();
    let mut machine = Machine::new(MachineParameters { robot, gripper, nonce_seed: 1 }).expect("a template");
    machine.supervisor = Some(supervisor);
    let approaches = |machine: &mut Machine, batch: u32| {
        machine.inputs.push_back(Input::Robot(RobotEvent::PathFinished { batch }));
        machine.work_off(now);
        machine.supervisor.as_ref().is_some_and(|cell| cell.status().text() == "approaching b")
    };
    let last = machine.robot.last_batch();
    assert!(approaches(&mut machine, last.wrapping_sub(1)));
    // It is on the object now, with a gripper that is not connected.
    assert!(!approaches(&mut machine, last));
}
