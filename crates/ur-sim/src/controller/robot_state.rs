//! The robot state package of the primary and secondary interface.
//!
//! In: the controller's state. Out: sub-packages 0 to 4, 7, 8, 11 and 12, which go out ten times a second,
//! and 5 and 6, which a connection gets once (9 and 10 are the vendor's own and have no published meaning).
//! Sub-package 5 is this arm's calibration, as a real controller reports it: it is the only way in which a
//! client learns the simulated arm's true parameters.

use crate::controller::Controller;
use crate::controller::drives::actual_currents;
use crate::controller::outputs::{joint_mode, speed_scaling};
use sha2::{Digest, Sha256};
use ur_wire::enumerations::SafetyMode;
use ur_wire::primary_arm::{ConfigurationData, KinematicsData};
use ur_wire::primary_masterboard::MasterboardData;
use ur_wire::primary_state::{CartesianData, JointData, RobotModeData, SubPackage, ToolData};
use ur_wire::primary_tool::{AdditionalData, ForceModeData, ToolCommunicationData, ToolModeData};

/// `robot type` by the dashboard's name of the model.
const ROBOT_TYPES: [(&str, i32); 7] =
    [("UR5", 1), ("UR10", 2), ("UR3", 3), ("UR16", 4), ("UR20", 7), ("UR30", 8), ("UR15", 9)];

/// Calibration status of a calibrated arm.
const CALIBRATED: u32 = 0;

/// Sub-package of the safety configuration, and its size here: what follows the checksum is not published.
const SAFETY_DATA: u8 = 10;
const SAFETY_DATA_BYTES: usize = 38;

/// The tool's serial line as it is until a script enables it.
const TOOL_LINE: ToolCommunicationData = ToolCommunicationData {
    enabled: false,
    baud_rate: 115_200,
    parity: 0,
    stop_bits: 1,
    rx_idle_chars: 1.5,
    tx_idle_chars: 3.5,
};

/// What changes.
pub fn periodic(controller: &Controller) -> Vec<SubPackage> {
    vec![
        SubPackage::RobotMode(robot_mode(controller)),
        SubPackage::Joints(joints(controller)),
        SubPackage::Tool(tool(controller)),
        SubPackage::Masterboard(masterboard(controller)),
        SubPackage::Cartesian(CartesianData {
            tcp_pose: controller.core.tcp_pose(),
            tcp_offset: controller.core.tcp_offset,
        }),
        SubPackage::ForceMode(ForceModeData { wrench: controller.core.tcp_force(), dexterity: 0.0 }),
        SubPackage::Additional(AdditionalData {
            teach_button: u8::from(controller.core.pendant.freedrive),
            freedrive_enabled: true,
            ..AdditionalData::default()
        }),
        SubPackage::Other { kind: SAFETY_DATA, payload: safety_data(controller) },
        SubPackage::ToolCommunication(tool_line(controller)),
        SubPackage::ToolMode(ToolModeData::default()),
    ]
}

fn tool(controller: &Controller) -> ToolData {
    ToolData {
        voltage_48v: 48.0,
        output_voltage: u8::try_from(controller.core.registers.tool_voltage).unwrap_or_default(),
        temperature: 35.0,
        mode: 253,
        ..ToolData::default()
    }
}

fn tool_line(controller: &Controller) -> ToolCommunicationData {
    controller.core.settings.tool_line.map_or(TOOL_LINE, |line| ToolCommunicationData {
        enabled: true,
        baud_rate: line.baud,
        parity: line.parity,
        stop_bits: line.stop_bits,
        rx_idle_chars: line.idle_chars[0] as f32,
        tx_idle_chars: line.idle_chars[1] as f32,
    })
}

/// Sub-package 10: the checksum of the safety configuration, then bytes that the guide does not name.
fn safety_data(controller: &Controller) -> Vec<u8> {
    let mut payload = controller.core.pendant.safety_checksum.to_be_bytes().to_vec();
    payload.resize(SAFETY_DATA_BYTES, 0);
    payload
}

/// What a connection gets once: kinematics and configuration.
pub fn once(controller: &Controller) -> Vec<SubPackage> {
    let arm = &controller.core.mover.arm;
    let dh = arm.kinematics.dh();
    vec![
        SubPackage::Kinematics(KinematicsData {
            checksum: checksum(controller),
            theta: dh.theta,
            a: dh.a,
            d: dh.d,
            alpha: dh.alpha,
            calibration_status: CALIBRATED,
        }),
        SubPackage::Configuration(ConfigurationData {
            joint_limits: [[-arm.joint_range, arm.joint_range]; 6],
            joint_maxima: arm.joint_speed.map(|speed| [speed, arm.joint_acceleration]),
            defaults: [1.05, 1.4, 0.25, 1.2],
            equivalent_radius: 0.2,
            a: dh.a,
            d: dh.d,
            alpha: dh.alpha,
            theta: dh.theta,
            masterboard_version: 0,
            controller_box_type: 0,
            robot_type: robot_type(controller.core.model()),
            robot_sub_type: 0,
        }),
    ]
}

/// The number of a model; that of the UR5 for a name that the table does not have.
fn robot_type(model: &str) -> i32 {
    let known = ROBOT_TYPES.iter().find(|(name, _)| name.eq_ignore_ascii_case(model.trim_end_matches('e')));
    known.map_or(ROBOT_TYPES[0].1, |(_, number)| *number)
}

/// One number per joint that changes with its calibration.
fn checksum(controller: &Controller) -> [u32; 6] {
    let dh = controller.core.mover.arm.kinematics.dh();
    std::array::from_fn(|joint| {
        let mut hash = Sha256::new();
        [dh.theta[joint], dh.a[joint], dh.d[joint], dh.alpha[joint]]
            .into_iter()
            .for_each(|value| hash.update(value.to_be_bytes()));
        hash.finalize().iter().take(4).fold(0, |word, byte| word << 8 | u32::from(*byte))
    })
}

fn robot_mode(controller: &Controller) -> RobotModeData {
    let modes = &controller.core.modes;
    RobotModeData {
        timestamp: (controller.core.timestamp() * 1e6) as u64,
        real_robot_connected: true,
        real_robot_enabled: true,
        power_on: modes.powered(),
        emergency_stopped: modes.emergency_stopped(),
        protective_stopped: modes.protective_stopped(),
        program_running: controller.programs.playing(),
        program_paused: controller.programs.paused(),
        robot_mode: modes.robot_mode().code() as i8,
        control_mode: control_mode(controller),
        target_speed_fraction: controller.core.registers.speed_fraction(),
        speed_scaling: speed_scaling(controller),
        target_speed_fraction_limit: 1.0,
        reserved: 0,
    }
}

/// What the joints are controlled by: position, hand guiding, force or torque (client interface guide).
pub fn control_mode(controller: &Controller) -> u8 {
    let compliance = controller.core.compliance.as_ref();
    match compliance.map(|compliance| compliance.freedrive) {
        _ if controller.core.mover.is_driven() => 3,
        Some(true) => 1,
        Some(false) => 2,
        None => 0,
    }
}

fn joints(controller: &Controller) -> [JointData; 6] {
    let (q, qd) = (controller.core.actual_q(), controller.core.actual_qd());
    let target = controller.core.mover.q();
    let mode = joint_mode(controller) as u8;
    let currents = actual_currents(controller);
    std::array::from_fn(|joint| JointData {
        q_actual: q.0[joint],
        q_target: target.0[joint],
        qd_actual: qd[joint],
        current: currents[joint] as f32,
        voltage: 48.0,
        motor_temperature: 35.0,
        micro_temperature: 0.0,
        mode,
    })
}

fn masterboard(controller: &Controller) -> MasterboardData {
    let registers = &controller.core.registers;
    MasterboardData {
        digital_input_bits: registers.digital_inputs as u32,
        digital_output_bits: registers.digital_outputs as u32,
        analog_output_domain: registers.analog_output_voltage.map(u8::from),
        analog_output: registers.analog_outputs,
        temperature: 40.0,
        robot_voltage_48v: 48.0,
        robot_current: 0.6,
        safety_mode: controller.core.modes.safety_mode().code() as u8,
        reduced_mode: u8::from(controller.core.modes.safety_mode() == SafetyMode::Reduced),
        operational_mode_selector: controller.core.pendant.operational_mode.selector(),
        ..MasterboardData::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::ControllerConfig;
    use crate::controller::builtins::compile_program;

    #[test]
    fn the_model_decides_the_robot_type() {
        for (model, number) in [("UR5", 1), ("UR3", 3), ("UR10", 2), ("UR10e", 2), ("UR30", 8), ("UR15", 9)] {
            let config = ControllerConfig { model: model.to_owned(), ..ControllerConfig::ur5e(1) };
            let parts = once(&Controller::new(config));
            let found = parts.iter().find_map(|part| match part {
                SubPackage::Configuration(data) => Some(data.robot_type),
                _ => None,
            });
            assert_eq!(found, Some(number), "{model}");
        }
    }

    #[test]
    fn what_scripts_set_of_the_tool_is_shown() {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        let script =
            "def t():\n set_tool_voltage(24)\n set_tool_communication(True, 9600, 2, 2, 1.5, 4)\nend\n";
        controller.programs.upload(compile_program(script));
        (0..10).for_each(|_| controller.frame());
        let line = ToolCommunicationData {
            enabled: true,
            baud_rate: 9600,
            parity: 2,
            stop_bits: 2,
            rx_idle_chars: 1.5,
            tx_idle_chars: 4.0,
        };
        let parts = periodic(&controller);
        assert!(parts.contains(&SubPackage::ToolCommunication(line)));
        assert!(
            parts.iter().any(|part| matches!(part, SubPackage::Tool(ToolData { output_voltage: 24, .. })))
        );
    }

    #[test]
    fn every_published_sub_package_is_sent() {
        let controller = Controller::new(ControllerConfig::ur5e(1));
        let parts: Vec<SubPackage> = periodic(&controller).into_iter().chain(once(&controller)).collect();
        let mut kinds: Vec<u8> = parts.iter().map(|part| part.encode()[4]).collect();
        kinds.sort_unstable();
        assert_eq!(kinds, [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12]);
        let bytes: Vec<u8> = parts.iter().flat_map(SubPackage::encode).collect();
        assert_eq!(SubPackage::decode_all(&bytes), Ok(parts));
    }
}
