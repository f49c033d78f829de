//! What kind of controller is simulated: arm, calibration, software, installation.
//!
//! In: an arm model and a seed. Out: [`ControllerConfig`], whose calibrated kinematics differ from the
//! nominal ones as those of real arms do. Pure.

use crate::controller::modes::Control;
use crate::controller::program_files::ProgramFiles;
use crate::motion::belt::TableBelt;
use crate::motion::rest::RestConfig;
use crate::motion::rounding::BlendConfig;
use crate::motion::safety::SafetyLimits;
use cell_values::units::Joints;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use ur_arm::chain::Chain;
use ur_arm::kinematics::{ARM_MODELS, ArmModel, DhParameters};
use ur_arm::links::dh_of;

/// Standard deviation of the arm's calibrated parameters about the nominal ones unless set otherwise: m,
/// rad.
const CALIBRATION_STD_M: f64 = 5e-4;
const CALIBRATION_STD_RAD: f64 = 0.05 / 360.0 * TAU;

/// Software unless the configuration names another: major, minor, bug fix, build.
pub const SOFTWARE: [u32; 4] = [5, 26, 0, 1_234_567];

/// First major version of PolyScope X.
const POLYSCOPE_X: u32 = 10;

/// What kind of controller is simulated.
#[derive(Clone, Debug)]
pub struct ControllerConfig {
    /// Which arm.
    pub arm: ArmModel,
    /// Calibrated kinematics of this arm.
    pub dh: DhParameters,
    /// Where the arm is at first.
    pub start: Joints,
    /// Digits.
    pub serial_number: String,
    /// As the dashboard names it, without the "e".
    pub model: String,
    /// Software version: major, minor, bug fix, build.
    pub version: [u32; 4],
    /// Arm powered and brakes open at the start; else powered off.
    pub running: bool,
    /// From where the arm is commanded at the start.
    pub control: Control,
    /// Safety configuration.
    pub safety: SafetyLimits,
    /// At which speed and where it passes blends.
    pub blends: BlendConfig,
    /// How the joints come to rest.
    pub rest: RestConfig,
    /// Tool centre point of the installation, in the flange frame.
    pub tcp: [f64; 6],
    /// Payload of the installation, kg.
    pub payload: f64,
    /// Its centre of gravity in the flange frame, m.
    pub payload_centre: [f64; 3],
    /// Ticks a second that come from the wires of the two encoders, negative backwards.
    pub encoders: [f64; 2],
    /// Belts in the table that these encoders count.
    pub belts: Vec<TableBelt>,
    /// From the upload of a program to its start, s.
    pub loads_for_s: f64,
    /// Seed of `random()`.
    pub seed: u64,
    /// Programs that `load` finds.
    pub programs: ProgramFiles,
}

impl ControllerConfig {
    /// A UR5e with software 5.26, calibrated by `seed`, powered off, in remote control, arm in a work pose.
    pub fn ur5e(seed: u64) -> ControllerConfig {
        ControllerConfig::of(&ARM_MODELS[0], seed)
    }

    /// The same with another arm.
    pub fn of(arm: &ArmModel, seed: u64) -> ControllerConfig {
        ControllerConfig {
            arm: *arm,
            dh: calibrated(&arm.dh, seed, CALIBRATION_STD_M, CALIBRATION_STD_RAD),
            start: Joints([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]),
            serial_number: "20235500001".to_owned(),
            model: arm.name.trim_end_matches('e').to_owned(),
            version: SOFTWARE,
            running: false,
            control: Control::Remote,
            safety: SafetyLimits::default(),
            blends: BlendConfig::default(),
            rest: RestConfig::default(),
            tcp: [0.0; 6],
            payload: 0.0,
            payload_centre: [0.0; 3],
            encoders: [0.0; 2],
            belts: Vec::new(),
            loads_for_s: 0.0,
            seed,
            programs: ProgramFiles::default(),
        }
    }

    /// The software is PolyScope X: the Robot API is in place of the dashboard server.
    pub fn is_polyscope_x(&self) -> bool {
        self.version[0] >= POLYSCOPE_X
    }

    /// The calibration of another arm of this model.
    pub fn recalibrate(&mut self, seed: u64) {
        self.dh = calibrated(&self.arm.dh, seed, CALIBRATION_STD_M, CALIBRATION_STD_RAD);
    }
}

/// The table of one arm as its controller reports it: the deviations of its links from nominal ones are
/// normal, with standard deviations `std_m` (m) of each length and `std_rad` (rad) of each angle. Shoulder,
/// elbow and wrist 1 are not quite parallel, so d2 and d3 become large.
pub fn calibrated(nominal: &DhParameters, seed: u64, std_m: f64, std_rad: f64) -> DhParameters {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5572_3565);
    // The sum of twelve uniform numbers is normal enough and needs no further crate.
    let mut normal = |std: f64| (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>() * std;
    let mut dh = *nominal;
    for i in 0..6 {
        dh.a[i] += normal(std_m);
        dh.d[i] += normal(std_m);
        dh.alpha[i] += normal(std_rad);
        dh.theta[i] += normal(std_rad);
    }
    if std_rad == 0.0 {
        return dh;
    }
    let mut links = *Chain::of(&dh).links();
    for link in &mut links[1..3] {
        *link *= UnitQuaternion::from_axis_angle(&Vector3::y_axis(), normal(std_rad));
    }
    dh_of(&links).unwrap_or(dh)
}
