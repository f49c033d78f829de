//! How robot, gripper and camera are, for the status.
//!
//! In: what the devices last said, what came of the last picture. Out: a [`DeviceNote`] for each, in words
//! that change only when a device does: no age, no reading.

use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::GateClosed;
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::safety_words::{mode_words, safety_words};
use crate::supervisor::status::{Device, DeviceNote};
use ur_wire::enumerations::{RobotMode, SafetyMode};

impl Supervisor {
    /// Robot, gripper, camera.
    pub fn device_notes(&self, devices: &DeviceSnapshot) -> Vec<DeviceNote> {
        vec![robot(devices), gripper(devices), self.camera_note()]
    }

    fn camera_note(&self) -> DeviceNote {
        let (ready, message) = match &self.camera {
            None => (false, "not known: no picture was wanted yet".to_string()),
            Some(Ok(())) => (true, "gave a picture when one was wanted last".to_string()),
            Some(Err(fault)) => (false, format!("at the last picture: {fault}")),
        };
        DeviceNote { device: Device::Camera, ready, message }
    }
}

fn robot(devices: &DeviceSnapshot) -> DeviceNote {
    let (ready, message) = match (devices.link_down, devices.robot.filter(|_| devices.robot_fresh)) {
        (Some(link), _) => (false, GateClosed::Link(link).to_string()),
        (None, None) => (false, GateClosed::Stale.to_string()),
        (None, Some(robot)) => {
            let safe = matches!(robot.safety_mode, SafetyMode::Normal | SafetyMode::Reduced);
            let running = robot.robot_mode == RobotMode::Running;
            let remote = robot.remote_control == Some(true);
            let mut words = Vec::new();
            if !safe {
                words.push(safety_words(robot.safety_mode));
            }
            words.push(mode_words(robot.robot_mode));
            words.push(if remote { "remote control" } else { "remote control is off" }.to_string());
            (safe && running && remote, words.join(", "))
        }
    };
    DeviceNote { device: Device::Robot, ready, message }
}

fn gripper(devices: &DeviceSnapshot) -> DeviceNote {
    let (ready, message) = match (devices.gripper_answers, devices.gripper_holds) {
        (false, _) => (false, devices.gripper_fault.to_string()),
        (true, true) => (true, "answers, and holds something".to_string()),
        (true, false) => (true, "answers".to_string()),
    };
    DeviceNote { device: Device::Gripper, ready, message }
}
