//! Tests of the robot state codec. A failure of a golden string or length here means the wire changed.

use super::*;
use crate::primary_masterboard::EuromapData;

pub(crate) fn kinematics() -> KinematicsData {
    KinematicsData {
        checksum: [1, 2, 3, 4, 5, 6],
        d: [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996],
        ..Default::default()
    }
}

pub(crate) fn all_kinds() -> Vec<SubPackage> {
    let joint = JointData { q_actual: 1.0, mode: 253, ..JointData::default() };
    vec![
        SubPackage::RobotMode(RobotModeData { power_on: true, robot_mode: 7, ..Default::default() }),
        SubPackage::Joints([joint; 6]),
        SubPackage::Tool(ToolData { output_voltage: 24, ..ToolData::default() }),
        SubPackage::Masterboard(MasterboardData { safety_mode: 1, ..Default::default() }),
        SubPackage::Cartesian(CartesianData { tcp_pose: [1.0; 6], tcp_offset: [0.5; 6] }),
        SubPackage::Kinematics(kinematics()),
        SubPackage::Configuration(ConfigurationData { robot_type: 1, ..Default::default() }),
        SubPackage::Other { kind: 9, payload: vec![1, 2, 3] },
    ]
}

#[test]
fn sizes_are_those_of_the_guide() {
    let sizes: Vec<usize> = all_kinds().iter().map(|part| part.encode().len()).collect();
    assert_eq!(sizes, [47, 251, 37, 75, 101, 225, 445, 8], "the wire changed");
}

#[test]
fn golden_robot_mode() {
    let data = RobotModeData {
        timestamp: 5,
        real_robot_connected: true,
        program_running: true,
        robot_mode: -1,
        control_mode: 2,
        target_speed_fraction: 1.0,
        speed_scaling: 0.5,
        ..RobotModeData::default()
    };
    let hex: String = SubPackage::RobotMode(data).encode().iter().map(|b| format!("{b:02x}")).collect();
    let golden =
        "0000002f00000000000000000501000000000100ff023ff00000000000003fe0000000000000000000000000000000";
    assert_eq!(hex, golden, "the wire changed");
}

#[test]
fn all_kinds_survive_the_wire() {
    let with_euromap = MasterboardData {
        euromap: Some(EuromapData { input_bits: 7, ..Default::default() }),
        ..Default::default()
    };
    let mut parts = all_kinds();
    parts.push(SubPackage::Masterboard(with_euromap));
    let bytes: Vec<u8> = parts.iter().flat_map(SubPackage::encode).collect();
    assert_eq!(SubPackage::decode_all(&bytes).unwrap(), parts);
    for cut in 1..bytes.len() {
        if let Ok(fewer) = SubPackage::decode_all(&bytes[..cut]) {
            assert_eq!(fewer, parts[..fewer.len()], "cut at {cut}");
        }
    }
}

#[test]
fn fields_of_newer_versions_are_skipped() {
    let mut bytes = SubPackage::Cartesian(CartesianData::default()).encode();
    bytes.extend_from_slice(&[1, 2, 3]);
    bytes[3] += 3;
    assert_eq!(SubPackage::decode_all(&bytes).unwrap(), [SubPackage::Cartesian(CartesianData::default())]);
}

#[test]
fn errors_name_the_field() {
    let error = SubPackage::decode_all(&[0, 0, 0, 7, 5, 0, 0]).unwrap_err();
    assert!(error.to_string().contains("kinematics checksum"), "{error}");
    let error = SubPackage::decode_all(&[0, 0, 0, 4, 5]).unwrap_err();
    assert!(error.to_string().contains("sub-package length"), "{error}");
}
