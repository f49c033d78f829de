//! The kinematics of the arm that was recorded, from a file.
//!
//! In: the `calibration.yaml` that the vendor's ROS driver writes (`ur_calibration`), or bytes as they came
//! from port 30001 of the controller, which sends its kinematics once to each connection. Out: DH
//! parameters. Pure.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder};
use ur_arm::kinematics::DhParameters;
use ur_arm::links::{dh_of, links_of_description};
use ur_wire::primary::{Package, Splitter};
use ur_wire::primary_state::SubPackage;

/// The joints of a description, base to flange.
const JOINTS: [&str; 6] = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];

/// Limits of a description: offsets in m, angles in rad.
const MAX_OFFSET_M: f64 = 10.0;
const MAX_ANGLE_RAD: f64 = 10.0;

/// No controller reports a larger number, m or rad.
const LARGEST: f64 = 1e6;

/// Reads the file called `name`.
///
/// # Errors
/// What is wrong with it, or that it is neither.
pub fn read_kinematics(bytes: &[u8], name: &str) -> Result<DhParameters, String> {
    match std::str::from_utf8(bytes) {
        Ok(text) => described(text, name),
        Err(_) => sent(bytes).ok_or_else(|| {
            format!("{name}: neither a calibration.yaml nor what port 30001 sends with its first state")
        }),
    }
}

/// Of the robot states the first one has them.
fn sent(bytes: &[u8]) -> Option<DhParameters> {
    let mut splitter = Splitter::default();
    splitter.push(bytes);
    while let Some(package) = splitter.next_package().ok()? {
        let Package::RobotState(parts) = package else { continue };
        let found = parts.into_iter().find_map(|part| match part {
            SubPackage::Kinematics(data) => Some(data),
            _ => None,
        });
        if let Some(data) = found {
            let all = [data.a, data.d, data.alpha, data.theta];
            let plausible = all.iter().flatten().all(|value| value.abs() <= LARGEST);
            return plausible.then_some(DhParameters {
                a: data.a,
                d: data.d,
                alpha: data.alpha,
                theta: data.theta,
            });
        }
    }
    None
}

fn described(text: &str, name: &str) -> Result<DhParameters, String> {
    let joints = read_joints(text, name).map_err(|complaints| complaints.to_string())?;
    links_of_description(&joints).and_then(|links| dh_of(&links)).ok_or_else(|| {
        format!("{name}: no arm of the vendor: the first joint has to turn about z of the base, and the last about z of the flange")
    })
}

fn read_joints(text: &str, name: &str) -> Result<[Isometry3<f64>; 6], Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, name)?;
    let top = decoder.open_map(&At::top(&node));
    let kinematics = top.and_then(|top| top.required("kinematics", &mut decoder));
    let fields = kinematics.and_then(|at| decoder.open_map(&at));
    let joints = fields.map(|fields| {
        JOINTS.map(|joint| fields.required(joint, &mut decoder).and_then(|at| pose(&mut decoder, &at)))
    });
    let joints = joints.map(|joints| joints.into_iter().collect::<Option<Vec<_>>>());
    let joints = joints.flatten().and_then(|joints| <[Isometry3<f64>; 6]>::try_from(joints).ok());
    decoder.finish(joints)
}

/// x, y, z in m, roll, pitch, yaw in rad.
fn pose(decoder: &mut Decoder, at: &At) -> Option<Isometry3<f64>> {
    let fields = decoder.map(at, &["x", "y", "z", "roll", "pitch", "yaw"])?;
    let [x, y, z] = ["x", "y", "z"].map(|key| {
        let at = fields.required(key, decoder)?;
        decoder.number_in(&at, -MAX_OFFSET_M..=MAX_OFFSET_M, "m")
    });
    let [roll, pitch, yaw] = ["roll", "pitch", "yaw"].map(|key| {
        let at = fields.required(key, decoder)?;
        decoder.number_in(&at, -MAX_ANGLE_RAD..=MAX_ANGLE_RAD, "rad")
    });
    let turn = UnitQuaternion::from_euler_angles(roll?, pitch?, yaw?);
    Some(Isometry3::from_parts(Translation3::new(x?, y?, z?), turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Controller;
    use crate::controller::ControllerConfig;
    use crate::controller::robot_state::once;
    use cell_values::units::Joints;
    use ur_arm::kinematics::forward;
    use ur_arm::links::model_of;
    use ur_arm::testing::{PUBLISHED_UR5E, described as poses};

    fn yaml() -> String {
        let rows = JOINTS.iter().zip(PUBLISHED_UR5E).map(|(joint, [x, y, z, roll, pitch, yaw])| {
            format!("  {joint}:\n    x: {x}\n    y: {y}\n    z: {z}\n    roll: {roll}\n    pitch: {pitch}\n    yaw: {yaw}\n")
        });
        format!("kinematics:\n{}  hash: calib_14698139022496758595\n", rows.collect::<String>())
    }

    #[test]
    fn a_published_description_is_the_arm_that_it_describes() {
        let dh = read_kinematics(yaml().as_bytes(), "arm.yaml").unwrap();
        assert_eq!(model_of(&dh).name, "UR5e");
        let q = Joints([0.3, -1.2, 1.7, -2.0, -1.4, 0.6]);
        let turned =
            poses(&PUBLISHED_UR5E).into_iter().zip(q.0).fold(Isometry3::identity(), |at, (joint, q)| {
                at * joint * UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), q)
            });
        assert!((forward(&dh, &q).translation.vector - turned.translation.vector).norm() < 1e-9);
    }

    #[test]
    fn what_a_controller_sends_is_read_as_it_came() {
        let config = ControllerConfig::ur5e(3);
        let dh = config.dh;
        let controller = Controller::new(config);
        let other = Package::Other { kind: 25, payload: vec![0xff, 1] };
        let bytes: Vec<u8> =
            [other, Package::RobotState(once(&controller))].iter().flat_map(Package::encode).collect();
        assert_eq!(read_kinematics(&bytes, "sent.bin"), Ok(dh));
        let refused = read_kinematics(&bytes[..40], "sent.bin").unwrap_err();
        assert!(refused.contains("sent.bin: neither a calibration.yaml"), "{refused}");
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let refused = |text: &str| read_kinematics(text.as_bytes(), "arm.yaml").unwrap_err();
        let spoilt = yaml().replace("roll: 1.570799538115874", "roll: much");
        assert!(refused(&spoilt).contains("\"much\" is not a number"), "{}", refused(&spoilt));
        assert!(refused("kinematics: {}").contains("shoulder"), "{}", refused("kinematics: {}"));
        let leaning = yaml().replacen("roll: 0\n", "roll: 0.1\n", 1);
        assert!(refused(&leaning).contains("no arm of the vendor"), "{}", refused(&leaning));
    }
}
