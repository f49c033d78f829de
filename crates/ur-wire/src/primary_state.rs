//! Robot state (package type 16): its sub-packages.
//!
//! In: the payload behind the package header. Out: [`SubPackage`]s, and bytes again. Unknown sub-packages
//! are kept as bytes; bytes behind the fields known here are skipped, as newer controllers append fields.
//! Joints are in the order base to wrist 3; m, rad, A, V, degrees Celsius. Source: the vendor's
//! client-interface guide (reference on UR interfaces, 3.3).

use crate::bytes::{Reader, WireError, Writer};
use crate::primary_arm::{ConfigurationData, KinematicsData};
use crate::primary_masterboard::MasterboardData;
use crate::primary_tool::{AdditionalData, ForceModeData, ToolCommunicationData, ToolModeData};

const HEADER: usize = 5;

/// Part of a robot state package.
#[derive(Clone, Debug, PartialEq)]
pub enum SubPackage {
    /// Type 0.
    RobotMode(RobotModeData),
    /// Type 1, base to wrist 3.
    Joints([JointData; 6]),
    /// Type 2.
    Tool(ToolData),
    /// Type 3.
    Masterboard(MasterboardData),
    /// Type 4.
    Cartesian(CartesianData),
    /// Type 5: the calibrated arm.
    Kinematics(KinematicsData),
    /// Type 6.
    Configuration(ConfigurationData),
    /// Type 7.
    ForceMode(ForceModeData),
    /// Type 8.
    Additional(AdditionalData),
    /// Type 11.
    ToolCommunication(ToolCommunicationData),
    /// Type 12.
    ToolMode(ToolModeData),
    /// Any other type; 9 (calibration) and 10 (safety) are the vendor's own and published without a layout.
    Other {
        /// Type byte.
        kind: u8,
        /// What follows the sub-package's header.
        payload: Vec<u8>,
    },
}

/// Sub-package 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotModeData {
    /// Microseconds since the controller started.
    pub timestamp: u64,
    /// A real arm (not a simulation) is connected.
    pub real_robot_connected: bool,
    /// And enabled.
    pub real_robot_enabled: bool,
    /// Arm power.
    pub power_on: bool,
    /// Emergency stop.
    pub emergency_stopped: bool,
    /// Protective stop.
    pub protective_stopped: bool,
    /// A program runs.
    pub program_running: bool,
    /// A program is paused.
    pub program_paused: bool,
    /// Number of the robot mode.
    pub robot_mode: i8,
    /// Number of the control mode.
    pub control_mode: u8,
    /// Speed slider, 0 to 1.
    pub target_speed_fraction: f64,
    /// Momentary scaling by the trajectory limiter, 0 to 1.
    pub speed_scaling: f64,
    /// Upper end of the slider.
    pub target_speed_fraction_limit: f64,
    /// Not used.
    pub reserved: u8,
}

/// One joint of sub-package 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointData {
    /// Actual position, rad.
    pub q_actual: f64,
    /// Target position, rad.
    pub q_target: f64,
    /// Actual speed, rad/s.
    pub qd_actual: f64,
    /// Current, A.
    pub current: f32,
    /// Voltage, V.
    pub voltage: f32,
    /// Motor temperature.
    pub motor_temperature: f32,
    /// Obsolete.
    pub micro_temperature: f32,
    /// Number of the joint mode.
    pub mode: u8,
}

/// Sub-package 2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolData {
    /// Ranges of the two analog inputs.
    pub analog_input_range: [u8; 2],
    /// The two analog inputs.
    pub analog_input: [f64; 2],
    /// 48 V rail, V.
    pub voltage_48v: f32,
    /// Tool output voltage, V.
    pub output_voltage: u8,
    /// Tool current, A.
    pub current: f32,
    /// Temperature.
    pub temperature: f32,
    /// Number of the tool mode.
    pub mode: u8,
}

/// Sub-package 4.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CartesianData {
    /// TCP pose in the base frame: m and rotation vector in rad.
    pub tcp_pose: [f64; 6],
    /// TCP in the flange frame, same form.
    pub tcp_offset: [f64; 6],
}

impl SubPackage {
    fn kind(&self) -> u8 {
        match self {
            SubPackage::RobotMode(_) => 0,
            SubPackage::Joints(_) => 1,
            SubPackage::Tool(_) => 2,
            SubPackage::Masterboard(_) => 3,
            SubPackage::Cartesian(_) => 4,
            SubPackage::Kinematics(_) => 5,
            SubPackage::Configuration(_) => 6,
            SubPackage::ForceMode(_) => 7,
            SubPackage::Additional(_) => 8,
            SubPackage::ToolCommunication(_) => 11,
            SubPackage::ToolMode(_) => 12,
            SubPackage::Other { kind, .. } => *kind,
        }
    }

    /// Header and fields.
    pub fn encode(&self) -> Vec<u8> {
        let mut body = Writer::new();
        match self {
            SubPackage::RobotMode(data) => encode_robot_mode(data, &mut body),
            SubPackage::Joints(joints) => joints.iter().for_each(|joint| encode_joint(joint, &mut body)),
            SubPackage::Tool(data) => encode_tool(data, &mut body),
            SubPackage::Masterboard(data) => data.encode(&mut body),
            SubPackage::Cartesian(data) => {
                body.f64s(&data.tcp_pose).f64s(&data.tcp_offset);
            }
            SubPackage::Kinematics(data) => data.encode(&mut body),
            SubPackage::Configuration(data) => data.encode(&mut body),
            SubPackage::ForceMode(data) => data.encode(&mut body),
            SubPackage::Additional(data) => data.encode(&mut body),
            SubPackage::ToolCommunication(data) => data.encode(&mut body),
            SubPackage::ToolMode(data) => data.encode(&mut body),
            SubPackage::Other { payload, .. } => {
                body.bytes(payload);
            }
        }
        let body = body.finish();
        let mut out = Writer::new();
        out.u32((body.len() + HEADER) as u32).u8(self.kind()).bytes(&body);
        out.finish()
    }

    /// Reads all sub-packages of a robot state.
    ///
    /// # Errors
    /// A sub-package's length is below 5 or beyond the end, it ends inside a field, or a yes/no in it is
    /// neither 0 nor 1.
    pub fn decode_all(payload: &[u8]) -> Result<Vec<SubPackage>, WireError> {
        let mut reader = Reader::new(payload);
        let mut parts = Vec::new();
        while reader.left() > 0 {
            let offset = reader.offset();
            let length = reader.u32("sub-package length")?;
            let kind = reader.u8("sub-package type")?;
            let body = usize::try_from(length).ok().and_then(|length| length.checked_sub(HEADER));
            let Some(body) = body else {
                return Err(WireError::Unexpected {
                    field: "sub-package length",
                    offset,
                    found: length.to_string(),
                    expected: "at least 5",
                });
            };
            parts.push(SubPackage::decode(kind, reader.bytes("sub-package", body)?)?);
        }
        Ok(parts)
    }

    fn decode(kind: u8, body: &[u8]) -> Result<SubPackage, WireError> {
        let mut reader = Reader::new(body);
        Ok(match kind {
            0 => SubPackage::RobotMode(decode_robot_mode(&mut reader)?),
            1 => SubPackage::Joints(reader.array(decode_joint)?),
            2 => SubPackage::Tool(decode_tool(&mut reader)?),
            3 => SubPackage::Masterboard(MasterboardData::decode(&mut reader)?),
            4 => SubPackage::Cartesian(CartesianData {
                tcp_pose: reader.array(|r| r.f64("TCP pose"))?,
                tcp_offset: reader.array(|r| r.f64("TCP offset"))?,
            }),
            5 => SubPackage::Kinematics(KinematicsData::decode(&mut reader)?),
            6 => SubPackage::Configuration(ConfigurationData::decode(&mut reader)?),
            7 => SubPackage::ForceMode(ForceModeData::decode(&mut reader)?),
            8 => SubPackage::Additional(AdditionalData::decode(&mut reader)?),
            11 => SubPackage::ToolCommunication(ToolCommunicationData::decode(&mut reader)?),
            12 => SubPackage::ToolMode(ToolModeData::decode(&mut reader)?),
            kind => SubPackage::Other { kind, payload: body.to_vec() },
        })
    }
}

fn encode_robot_mode(data: &RobotModeData, out: &mut Writer) {
    out.u64(data.timestamp)
        .bool(data.real_robot_connected)
        .bool(data.real_robot_enabled)
        .bool(data.power_on)
        .bool(data.emergency_stopped)
        .bool(data.protective_stopped)
        .bool(data.program_running)
        .bool(data.program_paused)
        .i8(data.robot_mode)
        .u8(data.control_mode)
        .f64(data.target_speed_fraction)
        .f64(data.speed_scaling)
        .f64(data.target_speed_fraction_limit)
        .u8(data.reserved);
}

fn decode_robot_mode(reader: &mut Reader) -> Result<RobotModeData, WireError> {
    Ok(RobotModeData {
        timestamp: reader.u64("timestamp")?,
        real_robot_connected: reader.bool("real robot connected")?,
        real_robot_enabled: reader.bool("real robot enabled")?,
        power_on: reader.bool("power on")?,
        emergency_stopped: reader.bool("emergency stopped")?,
        protective_stopped: reader.bool("protective stopped")?,
        program_running: reader.bool("program running")?,
        program_paused: reader.bool("program paused")?,
        robot_mode: reader.i8("robot mode")?,
        control_mode: reader.u8("control mode")?,
        target_speed_fraction: reader.f64("target speed fraction")?,
        speed_scaling: reader.f64("speed scaling")?,
        target_speed_fraction_limit: reader.f64("target speed fraction limit")?,
        // The last byte came with a later version.
        reserved: if reader.left() > 0 { reader.u8("reserved")? } else { 0 },
    })
}

fn encode_joint(joint: &JointData, out: &mut Writer) {
    out.f64(joint.q_actual)
        .f64(joint.q_target)
        .f64(joint.qd_actual)
        .f32(joint.current)
        .f32(joint.voltage)
        .f32(joint.motor_temperature)
        .f32(joint.micro_temperature)
        .u8(joint.mode);
}

fn decode_joint(reader: &mut Reader) -> Result<JointData, WireError> {
    Ok(JointData {
        q_actual: reader.f64("joint position")?,
        q_target: reader.f64("joint target")?,
        qd_actual: reader.f64("joint speed")?,
        current: reader.f32("joint current")?,
        voltage: reader.f32("joint voltage")?,
        motor_temperature: reader.f32("motor temperature")?,
        micro_temperature: reader.f32("micro temperature")?,
        mode: reader.u8("joint mode")?,
    })
}

fn encode_tool(data: &ToolData, out: &mut Writer) {
    out.bytes(&data.analog_input_range)
        .f64s(&data.analog_input)
        .f32(data.voltage_48v)
        .u8(data.output_voltage)
        .f32(data.current)
        .f32(data.temperature)
        .u8(data.mode);
}

fn decode_tool(reader: &mut Reader) -> Result<ToolData, WireError> {
    Ok(ToolData {
        analog_input_range: reader.array(|r| r.u8("tool analog input range"))?,
        analog_input: reader.array(|r| r.f64("tool analog input"))?,
        voltage_48v: reader.f32("tool 48 V")?,
        output_voltage: reader.u8("tool output voltage")?,
        current: reader.f32("tool current")?,
        temperature: reader.f32("tool temperature")?,
        mode: reader.u8("tool mode")?,
    })
}

#[cfg(test)]
pub(crate) mod tests;
