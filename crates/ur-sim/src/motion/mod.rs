//! How the simulated arm moves: trapezoidal joint and Cartesian motion at 500 Hz, with blends.
//!
//! In: move, servo, speed and stop commands, and one step per 2 ms frame. Out: joint positions and speeds,
//! or a [`MotionFault`] that the controller turns into a protective stop. Pure. The real controller's
//! profiles are not published; modelled here: speed over the path is a trapezoid ([`profile`]), a path is a
//! line in joint space or a line, circle or rounded corner in tool space ([`segment`], [`tool_path`]), and
//! a blend is the end of one segment and the start of the next running at the same time ([`mover`]), or the
//! arm rounds the corner at a speed that it does not brake for it ([`rounding`]). After a
//! move the joints creep to their target ([`rest`]).

pub mod belt;

pub mod carrier;

pub mod dynamics;

pub mod mover;

pub mod path_offset;

pub mod profile;

pub mod rest;

pub mod rounding;

pub mod safety;

pub mod segment;

pub mod tool_path;

use cell_values::units::Joints;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector6};
use ur_arm::kinematics::{DhParameters, Kinematics, jacobian_at, pose_error};

/// Length of a controller frame, s.
pub const FRAME_SECONDS: f64 = 0.002;

/// Frames per second of simulated time.
pub const FRAMES_PER_SECOND: u64 = 500;

/// Position that a joint without a range still counts to, rad.
const MOST_TURNS: f64 = 1000.0 * std::f64::consts::TAU;

/// The arm as its controller knows it.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Calibrated kinematics.
    pub kinematics: Kinematics,
    /// Tool centre point.
    pub flange_from_tcp: Isometry3<f64>,
    /// Joint range to either side, rad.
    pub joint_range: f64,
    /// A joint without a range: wrist 3 of the smallest arms.
    pub endless: Option<usize>,
    /// Fastest speed of each joint, rad/s.
    pub joint_speed: [f64; 6],
    /// Fastest joint acceleration in servo and stop modes, rad/s2.
    pub joint_acceleration: f64,
    /// Fastest TCP that the safety configuration allows, m/s; motion is slowed down to it.
    pub tool_speed: f64,
}

impl Arm {
    /// A UR5e.
    pub fn ur5e(dh: DhParameters) -> Arm {
        Arm::of([std::f64::consts::PI; 6], dh)
    }

    /// An arm with these joint speeds (rad/s). The other limits are the same for all models: +-360 degrees
    /// (data sheets); the acceleration is not published, 40 rad/s2 is what client libraries let pass; 1.5
    /// m/s is the usual safety configuration.
    pub fn of(joint_speed: [f64; 6], dh: DhParameters) -> Arm {
        Arm {
            kinematics: Kinematics::of(&dh),
            flange_from_tcp: Isometry3::identity(),
            joint_range: std::f64::consts::TAU,
            endless: None,
            joint_speed,
            joint_acceleration: 40.0,
            tool_speed: 1.5,
        }
    }

    /// `base_from_tcp` at joint positions `q`.
    pub fn tcp(&self, q: &Joints) -> Isometry3<f64> {
        self.kinematics.forward(q) * self.flange_from_tcp
    }

    /// The TCP at `q` after a small step in the base frame: m and a rotation vector in rad.
    pub fn moved(&self, q: &Joints, step: &Vector6<f64>) -> Isometry3<f64> {
        let pose = self.tcp(q);
        let turned = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        let moved = Translation3::from(pose.translation.vector + step.fixed_rows::<3>(0));
        Isometry3::from_parts(moved, turned * pose.rotation)
    }

    /// Joint positions near `near` that put the TCP at `base_from_tcp`: Newton steps from `near`, for poses
    /// a frame's travel away. `None` at a singularity or out of reach.
    pub fn follow(&self, base_from_tcp: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        let target = base_from_tcp * self.flange_from_tcp.inverse();
        let chain = self.kinematics.chain();
        let mut q = *near;
        for _ in 0..8 {
            let frames = chain.frames(&q);
            let error = pose_error(&frames[5], &target);
            if error.norm() < 1e-10 {
                return Some(q);
            }
            let step = jacobian_at(&frames).lu().solve(&error)?;
            if !step.iter().all(|value| value.abs() < 0.5) {
                return None;
            }
            q.0.iter_mut().zip(step.iter()).for_each(|(value, step)| *value += step);
        }
        (pose_error(&chain.forward(&q), &target).norm() < 1e-7).then_some(q)
    }

    /// The joint that is out of range or not a number, if there is one.
    pub fn outside(&self, q: &Joints) -> Option<usize> {
        q.0.iter().enumerate().position(|(joint, value)| {
            let most = if self.endless == Some(joint) { MOST_TURNS } else { self.joint_range };
            value.is_nan() || value.abs() > most + 1e-9
        })
    }
}

/// Why the arm cannot carry out its command; the controller stops protectively.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MotionFault {
    /// A joint would leave its range.
    #[error("joint {joint} would leave its range: {position} rad")]
    JointRange {
        /// Joint, 0 is the base.
        joint: usize,
        /// Where it would go, rad.
        position: f64,
    },
    /// A joint would be too fast; near singularities of Cartesian moves.
    #[error("joint {joint} would move at {speed} rad/s")]
    JointSpeed {
        /// Joint, 0 is the base.
        joint: usize,
        /// Speed, rad/s.
        speed: f64,
    },
    /// The tool cannot get there, or not on a straight line.
    #[error("the tool's path leads out of reach or through a singularity")]
    Unreachable,
}
