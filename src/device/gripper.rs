//! Gripper.
