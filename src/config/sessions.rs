//! What the sessions with the devices are made with, from the cell's configuration.
//!
//! In: a [`CellConfig`]. Out: clock, parameters of the machine and its sessions, and what a person confirms
//! the gripper by.

use crate::config::cell::{CellConfig, Devices, SimulationConfig};
use cell_edge::clock::Clock;
use cell_machine::device::gripper_types::GripperParameters;
use cell_machine::device::robot_types::RobotParameters;
use cell_machine::machine::MachineParameters;
use cell_values::time::Duration;
use std::net::SocketAddr;

/// States a second requested of the robot: a state every 8 ms is fresh enough for the 100 ms limit.
pub const RTDE_HZ: f64 = 125.0;

/// The cell's clock; `rtde` is where the robot listens. Only a cell that is configured as simulated follows
/// a simulator, whatever is at that address.
pub fn clock(simulation: Option<SimulationConfig>, rtde: SocketAddr) -> Clock {
    match simulation {
        Some(SimulationConfig { clock_factor }) => Clock::simulated(rtde, clock_factor),
        None => Clock::new(1.0),
    }
}

/// What the machine is made with; `nonce_seed` differs from run to run.
pub fn machine_parameters(config: &CellConfig, nonce_seed: u64) -> MachineParameters {
    let robot = RobotParameters { frequency_hz: RTDE_HZ, ..RobotParameters::full_rate() };
    MachineParameters { robot, gripper: gripper_parameters(config), nonce_seed }
}

/// Share of `vacuum_min` below which an object counts as lost: what is held at it is held for as long.
pub const HELD_SHARE: f64 = 0.8;

/// The gripper session's thresholds.
pub fn gripper_parameters(config: &CellConfig) -> GripperParameters {
    GripperParameters {
        vacuum_min: config.gripper.vacuum_min,
        vacuum_hold: HELD_SHARE * config.gripper.vacuum_min,
        grip_within: Duration::from_secs(2),
        release_within: Duration::from_secs(2),
    }
}

/// Host, port and Modbus unit of the gripper: what a person confirms to be it.
pub fn gripper_address(devices: &Devices) -> String {
    let Devices { gripper_host, gripper_port, gripper_unit, .. } = devices;
    format!("{gripper_host}:{gripper_port}, unit {gripper_unit}")
}
