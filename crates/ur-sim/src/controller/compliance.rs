//! How the tool gives way to forces in force mode and freedrive.
//!
//! In: what the script requested, the force felt at the tool. Out: the speed of the tool. Modelled, not
//! measured: a compliant axis moves at a speed in proportion to the force that is missing, up to its limit.
//! Free in the air it so runs at its limit, and against a stiff wall it comes to rest at the requested
//! force. In freedrive the requested force is zero: the arm is at rest until something pushes it. Pure.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3, Vector6};

/// Speed of a compliant axis for each newton or newton metre that is missing, at gain 1: m/s and rad/s.
const LINEAR_GAIN: f64 = 0.005;
const ANGULAR_GAIN: f64 = 0.05;

/// Fastest tool in freedrive, m/s and rad/s.
const FREEDRIVE_LIMITS: [f64; 6] = [0.5, 0.5, 0.5, 1.5, 1.5, 1.5];

/// Where the axes of a [`Compliance`] point.
#[derive(Clone, Copy, Debug)]
pub enum TaskFrame {
    /// As given in the base frame.
    Fixed(Isometry3<f64>),
    /// y towards the given origin (type 1 of the manual).
    Point(Isometry3<f64>),
    /// x along the tool's motion in the given plane (type 3).
    Motion(Isometry3<f64>),
    /// The tool's own axes.
    Tool,
}

/// How the tool gives way.
#[derive(Clone, Copy, Debug)]
pub struct Compliance {
    /// Where its axes point.
    pub frame: TaskFrame,
    /// Which axes give way.
    pub free: [bool; 6],
    /// What is requested along them, N and Nm.
    pub wrench: [f64; 6],
    /// Fastest along them, m/s and rad/s.
    pub limits: [f64; 6],
    /// Guided by hand, instead of a force mode.
    pub freedrive: bool,
}

impl Compliance {
    /// Given way by hand along the `free` axes.
    pub fn hand_guided(free: [bool; 6], frame: TaskFrame) -> Compliance {
        Compliance { frame, free, wrench: [0.0; 6], limits: FREEDRIVE_LIMITS, freedrive: true }
    }

    /// Tool speed in the base frame, m/s and rad/s, for what is felt there (N, Nm), where the tool is and
    /// how fast it moves.
    pub fn giving(
        &self,
        settings: &ForceSettings,
        force: &Vector6<f64>,
        tcp: &Isometry3<f64>,
        tcp_speed: &Vector6<f64>,
    ) -> Vector6<f64> {
        let axes = self.frame.axes(tcp, tcp_speed);
        let (linear, angular) = (force.fixed_rows::<3>(0), force.fixed_rows::<3>(3));
        let felt = [axes.inverse() * linear, axes.inverse() * angular];
        let scaling = match self.freedrive {
            true => 1.0,
            false => settings.gain * (1.0 - 0.5 * settings.damping),
        };
        let speed = |i: usize| {
            let gain = if i < 3 { LINEAR_GAIN } else { ANGULAR_GAIN } * scaling;
            let limit = self.limits[i];
            let missing = self.wrench[i] + felt[i / 3][i % 3];
            if self.free[i] { (missing * gain).clamp(-limit, limit) } else { 0.0 }
        };
        let linear = axes * Vector3::new(speed(0), speed(1), speed(2));
        let angular = axes * Vector3::new(speed(3), speed(4), speed(5));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }
}

impl TaskFrame {
    /// Its axes in the base frame.
    fn axes(&self, tcp: &Isometry3<f64>, tcp_speed: &Vector6<f64>) -> UnitQuaternion<f64> {
        match self {
            TaskFrame::Fixed(frame) => frame.rotation,
            TaskFrame::Tool => tcp.rotation,
            TaskFrame::Point(frame) => {
                let towards = frame.translation.vector - tcp.translation.vector;
                let z = frame.rotation * Vector3::z();
                axes_of(&towards.cross(&z), &towards).unwrap_or(frame.rotation)
            }
            TaskFrame::Motion(frame) => {
                let z = frame.rotation * Vector3::z();
                let along = tcp_speed.fixed_rows::<3>(0) - z * z.dot(&tcp_speed.fixed_rows::<3>(0));
                axes_of(&along, &z.cross(&along)).unwrap_or(frame.rotation)
            }
        }
    }
}

/// Settings that outlive a force mode.
#[derive(Clone, Copy, Debug)]
pub struct ForceSettings {
    /// Of force mode, 0 to 1.
    pub damping: f64,
    /// Of force mode, 0 to 2.
    pub gain: f64,
}

impl Default for ForceSettings {
    /// The manual's defaults.
    fn default() -> ForceSettings {
        ForceSettings { damping: 0.005, gain: 1.0 }
    }
}

/// The rotation whose x and y axes point along two vectors at a right angle; `None` if one of them vanishes.
fn axes_of(x: &Vector3<f64>, y: &Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let (x, y) = (x.try_normalize(1e-6)?, y.try_normalize(1e-6)?);
    let matrix = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
}
