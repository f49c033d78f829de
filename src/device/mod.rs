//! Sans-IO sessions with the robot controller and the gripper.
