//! The sub-packages of a robot state that say which arm it is: kinematics (5) and configuration (6).
//!
//! In: the fields behind a sub-package's header. Out: values, and bytes again. Apart from `primary_state`
//! because they stay the same while the controller runs. Joints are in the order base to wrist 3. Source:
//! the vendor's client-interface guide.

use crate::bytes::{Reader, WireError, Writer};
use serde::{Deserialize, Serialize};

/// Sub-package 5: Denavit-Hartenberg parameters of the arm at hand, with its calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct KinematicsData {
    /// One checksum per joint; together they name this arm's calibration.
    pub checksum: [u32; 6],
    /// Joint angle offsets, rad.
    pub theta: [f64; 6],
    /// Link lengths, m.
    pub a: [f64; 6],
    /// Link offsets, m.
    pub d: [f64; 6],
    /// Link twists, rad.
    pub alpha: [f64; 6],
    /// Calibration status.
    pub calibration_status: u32,
}

/// Sub-package 6.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConfigurationData {
    /// Joint limits (least, greatest), rad.
    pub joint_limits: [[f64; 2]; 6],
    /// Largest speed (rad/s) and acceleration (rad/s2) per joint.
    pub joint_maxima: [[f64; 2]; 6],
    /// Default joint speed, joint acceleration, tool speed, tool acceleration.
    pub defaults: [f64; 4],
    /// Equivalent radius, m.
    pub equivalent_radius: f64,
    /// Link lengths, m.
    pub a: [f64; 6],
    /// Link offsets, m.
    pub d: [f64; 6],
    /// Link twists, rad.
    pub alpha: [f64; 6],
    /// Joint angle offsets, rad.
    pub theta: [f64; 6],
    /// Masterboard version.
    pub masterboard_version: i32,
    /// Controller box type.
    pub controller_box_type: i32,
    /// UR5 = 1, UR10 = 2, UR3 = 3, UR16 = 4, UR20 = 7, UR30 = 8, UR15 = 9.
    pub robot_type: i32,
    /// Sub type.
    pub robot_sub_type: i32,
}

impl KinematicsData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        for checksum in self.checksum {
            out.u32(checksum);
        }
        out.f64s(&self.theta).f64s(&self.a).f64s(&self.d).f64s(&self.alpha).u32(self.calibration_status);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<KinematicsData, WireError> {
        Ok(KinematicsData {
            checksum: reader.array(|r| r.u32("kinematics checksum"))?,
            theta: reader.array(|r| r.f64("DH theta"))?,
            a: reader.array(|r| r.f64("DH a"))?,
            d: reader.array(|r| r.f64("DH d"))?,
            alpha: reader.array(|r| r.f64("DH alpha"))?,
            calibration_status: reader.u32("calibration status")?,
        })
    }
}

impl ConfigurationData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        for pair in self.joint_limits.iter().chain(&self.joint_maxima) {
            out.f64s(pair);
        }
        out.f64s(&self.defaults).f64(self.equivalent_radius);
        out.f64s(&self.a).f64s(&self.d).f64s(&self.alpha).f64s(&self.theta);
        out.i32(self.masterboard_version)
            .i32(self.controller_box_type)
            .i32(self.robot_type)
            .i32(self.robot_sub_type);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<ConfigurationData, WireError> {
        Ok(ConfigurationData {
            joint_limits: reader.array(|r| r.array(|r| r.f64("joint limit")))?,
            joint_maxima: reader.array(|r| r.array(|r| r.f64("joint maximum")))?,
            defaults: reader.array(|r| r.f64("default speed or acceleration"))?,
            equivalent_radius: reader.f64("equivalent radius")?,
            a: reader.array(|r| r.f64("DH a"))?,
            d: reader.array(|r| r.f64("DH d"))?,
            alpha: reader.array(|r| r.f64("DH alpha"))?,
            theta: reader.array(|r| r.f64("DH theta"))?,
            masterboard_version: reader.i32("masterboard version")?,
            controller_box_type: reader.i32("controller box type")?,
            robot_type: reader.i32("robot type")?,
            robot_sub_type: reader.i32("robot sub type")?,
        })
    }
}
