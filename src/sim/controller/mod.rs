//! The simulated UR controller without its sockets: modes, programs, registers and the arm, in 2 ms frames.
//!
//! In: what clients ask for (methods), and [`Controller::frame`] every 2 ms of simulated time. Out: state for
//! the servers to sample, and messages for the primary interface. Pure: it has no clock and no thread; time
//! is the number of frames. Order in a frame, as on the controller: inputs that have arrived are in effect,
//! the modes advance, programs run, the arm moves, and the state that is then left is what clients see.
//! Source: the interface notes; what is modelled instead of known is said where it is modelled.

pub mod builtins;

pub mod drives;

pub mod force_functions;

pub mod functions;

pub mod io_functions;

pub mod modes;

pub mod motion_functions;

pub mod outputs;

pub mod pendant;

pub mod programs;

pub mod realtime;

pub mod registers;

pub mod robot_state;

pub mod sensing;

pub mod setting_functions;

pub mod settings;

pub mod socket_functions;

pub mod sockets;

use crate::geometry::pose::{isometry_from_ur_pose, ur_pose_from_isometry};
use crate::motion::kinematics::{ARM_MODELS, ArmModel, DhParameters, forward};
use crate::sim::controller::force_functions::{Compliance, ForceSettings};
use crate::sim::controller::modes::Modes;
use crate::sim::controller::pendant::Pendant;
use crate::sim::controller::programs::Programs;
use crate::sim::controller::registers::Registers;
use crate::sim::controller::sensing::Sensing;
use crate::sim::controller::settings::Settings;
use crate::sim::controller::sockets::{NoNetwork, ScriptSockets};
use crate::sim::motion::mover::{HARD_RAMP_SECONDS, MoveId, Mover, SOFT_RAMP_SECONDS};
use crate::sim::motion::{Arm, FRAME_SECONDS, MotionFault};
use crate::units::Joints;
use crate::urscript::value::ThreadId;
use crate::wire::primary_message::MessageBody;
use nalgebra::Isometry3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::TAU;

/// Frames per second of simulated time.
pub const FRAMES_PER_SECOND: u64 = 500;

/// Controller time at the first frame, s. Client libraries distrust timestamps below 40 s: a real controller
/// restarts its RTDE service once while it boots.
const FIRST_TIMESTAMP: f64 = 41.0;

/// Messages kept for the primary interface until the servers fetch them.
const MAX_MESSAGES: usize = 1000;

/// Standard deviation of the arm's calibrated parameters about the nominal ones unless asked otherwise: m,
/// rad.
const CALIBRATION_STD_M: f64 = 5e-4;
const CALIBRATION_STD_RAD: f64 = 0.05 / 360.0 * TAU;

/// Braking of moves whose program went away, rad/s2.
const DEFAULT_STOP: f64 = 4.0;

/// What kind of controller is simulated.
#[derive(Clone, Debug)]
pub struct ControllerConfig {
    /// Which arm.
    pub arm: ArmModel,
    /// Calibrated kinematics of this arm.
    pub dh: DhParameters,
    /// Where the arm stands at first.
    pub start: Joints,
    /// Digits.
    pub serial_number: String,
    /// As the dashboard names it, without the "e".
    pub model: String,
    /// Software version: major, minor, bug fix, build.
    pub version: [u32; 4],
    /// Arm powered and brakes open at the start; else powered off.
    pub running: bool,
    /// Remote control at the start.
    pub remote: bool,
    /// Tool centre point of the installation, in the flange frame.
    pub tcp: [f64; 6],
    /// Payload of the installation, kg.
    pub payload: f64,
    /// Seed of `random()`.
    pub seed: u64,
    /// Programs that `load` finds: name of the `.urp` file without its ending, and its script.
    pub programs: BTreeMap<String, String>,
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
            version: [5, 26, 0, 1_234_567],
            running: false,
            remote: true,
            tcp: [0.0; 6],
            payload: 0.0,
            seed,
            programs: BTreeMap::new(),
        }
    }
}

/// Nominal parameters with the deltas of one arm: normal, with standard deviations `std_m` (m) of each length
/// and `std_rad` (rad) of each angle.
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
    dh
}

/// The tool as the controller is told about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Payload {
    /// kg
    pub mass: f64,
    /// In the flange frame, m.
    pub centre: [f64; 3],
    /// kg m2: xx, yy, zz, xy, xz, yz.
    pub inertia: [f64; 6],
    /// Gravity in the base frame, m/s2.
    pub gravity: [f64; 3],
}

/// Everything but the programs, so that a running program can act on it.
#[derive(Debug)]
pub struct Core {
    /// What does not change.
    pub config: ControllerConfig,
    /// A secondary program is being carried out.
    pub secondary: bool,
    /// Power, brakes, safety, remote control.
    pub modes: Modes,
    /// Registers, inputs and outputs.
    pub registers: Registers,
    /// The arm.
    pub mover: Mover,
    /// Tool and gravity.
    pub payload: Payload,
    /// Tool centre point as set, m and rad.
    pub tcp_offset: [f64; 6],
    /// Frames since the start.
    pub step: u64,
    /// Text of a popup on the pendant.
    pub popup: Option<String>,
    /// Forces at the tool and the arm's recent past.
    pub sensing: Sensing,
    /// Force mode or freedrive, if one is on.
    pub compliance: Option<Compliance>,
    /// Damping and gain of force mode.
    pub force_settings: ForceSettings,
    /// What scripts set and ask back.
    pub settings: Settings,
    /// The network, for scripts' sockets.
    pub sockets: Box<dyn ScriptSockets>,
    /// What was chosen at the pendant.
    pub pendant: Pendant,
    messages: VecDeque<MessageBody>,
    tcp_pose: [f64; 6],
    /// Thread and move that have the arm.
    owner: Option<(ThreadId, MoveId)>,
    /// A thread was killed in a motion; the arm brakes unless something else commands it in this frame.
    orphaned: bool,
    watchdogs: Vec<functions::Watchdog>,
    stop_asked: Option<String>,
}

/// The controller.
#[derive(Debug)]
pub struct Controller {
    /// Everything but the programs.
    pub core: Core,
    /// The programs.
    pub programs: Programs,
}

impl Controller {
    /// A controller just booted.
    pub fn new(config: ControllerConfig) -> Controller {
        let arm = Arm::of(config.arm.joint_speed, config.dh);
        let core = Core {
            modes: Modes::new(config.running, config.remote),
            registers: Registers::default(),
            mover: Mover::new(arm, config.start),
            payload: Payload {
                mass: config.payload,
                centre: [0.0; 3],
                inertia: [0.0; 6],
                gravity: [0.0, 0.0, crate::units::GRAVITY],
            },
            tcp_offset: [0.0; 6],
            step: 0,
            popup: None,
            sensing: Sensing::default(),
            compliance: None,
            force_settings: ForceSettings::default(),
            settings: Settings::default(),
            sockets: Box::new(NoNetwork),
            pendant: Pendant::default(),
            messages: VecDeque::new(),
            tcp_pose: [0.0; 6],
            owner: None,
            orphaned: false,
            watchdogs: Vec::new(),
            stop_asked: None,
            config,
            secondary: false,
        };
        let seed = core.config.seed;
        let mut controller = Controller { core, programs: Programs::new(seed) };
        controller.core.set_tcp(controller.core.config.tcp);
        controller.core.refresh();
        controller
    }

    /// 2 ms of simulated time.
    pub fn frame(&mut self) {
        self.core.step += 1;
        self.core.modes.advance();
        self.programs.run(&mut self.core);
        if let Some(reason) = self.core.stop_asked.take() {
            self.protective_stop(&reason);
        }
        self.core.sockets.flush();
        if !self.core.modes.brakes_open() {
            self.core.mover.freeze();
        } else if let Err(fault) = self.move_arm() {
            self.protective_stop(&fault.to_string());
        }
        self.core.refresh();
        let (q, force) = (self.core.mover.q(), self.core.tcp_force());
        self.core.sensing.remember(q, force);
    }

    fn move_arm(&mut self) -> Result<(), MotionFault> {
        let safe = self.core.modes.motion_allowed();
        self.core.mover.set_ramp(if safe { SOFT_RAMP_SECONDS } else { HARD_RAMP_SECONDS });
        let held = self.programs.paused() || !safe;
        let scaling = if held { 0.0 } else { self.core.registers.speed_fraction() };
        self.core.yield_to_forces();
        self.core.mover.step(scaling)
    }

    /// Stops the arm as its safety system does on a violated limit: on its path, the program paused.
    pub fn protective_stop(&mut self, reason: &str) {
        if self.core.modes.protective_stop(self.core.step) {
            self.programs.pause();
            self.core.pendant.safety_popup = true;
            self.core.error_message(modes::PATH_SANITY_CODE, 0, reason);
            self.core.safety_message();
        }
    }

    /// Ends a protective stop.
    ///
    /// # Errors
    /// The sentence of the dashboard, within 5 s of the stop or without one.
    pub fn unlock_protective_stop(&mut self) -> Result<(), String> {
        self.core.modes.unlock(self.core.step)?;
        self.core.pendant.safety_popup = false;
        self.core.safety_message();
        Ok(())
    }

    /// Presses or releases the emergency stop: the arm loses power, programs end.
    pub fn emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.programs.stop(&mut self.core);
            self.core.mover.freeze();
        }
        self.core.modes.emergency_stop(pressed);
        self.core.safety_message();
    }

    /// Opens or closes the safeguard circuit; programs pause and go on by themselves.
    pub fn safeguard_stop(&mut self, open: bool) {
        if self.core.modes.safeguard_stop(open) {
            if open {
                self.programs.pause_for_safeguard();
            } else {
                self.programs.resume_after_safeguard();
            }
            self.core.safety_message();
        }
    }

    /// Shows a safety mode by its number and pauses the program unless the mode allows motion; absent: back
    /// to normal, and the program goes on.
    pub fn show_safety(&mut self, number: Option<i32>) {
        self.core.modes.show_safety(number);
        if !self.core.modes.motion_allowed() {
            self.programs.pause_for_safeguard();
        } else {
            self.programs.resume_after_safeguard();
        }
        self.core.safety_message();
    }

    /// A fault of the safety system: the arm loses power, programs end.
    pub fn safety_fault(&mut self) {
        self.power_off();
        self.core.modes.fault();
        self.core.safety_message();
    }

    /// Boots anew, powered off, the arm where it is; with another serial number or another arm's calibration
    /// if given.
    pub fn reboot(&mut self, serial: Option<String>, kinematics: Option<u64>) {
        let mut config = self.core.config.clone();
        config.start = self.core.mover.q();
        config.running = false;
        config.serial_number = serial.unwrap_or(config.serial_number);
        if let Some(seed) = kinematics {
            config.dh = calibrated(&config.arm.dh, seed, CALIBRATION_STD_M, CALIBRATION_STD_RAD);
        }
        self.core.sockets.close_all();
        let sockets = std::mem::replace(&mut self.core.sockets, Box::new(NoNetwork));
        *self = Controller::new(config);
        self.core.sockets = sockets;
    }

    /// Arm power off; a running program ends.
    pub fn power_off(&mut self) {
        self.programs.stop(&mut self.core);
        self.core.mover.freeze();
        self.core.modes.power_off();
    }

    /// Restart of the safety system after a fault; ends powered off.
    pub fn restart_safety(&mut self) {
        self.power_off();
        self.core.modes.restart_safety();
        self.core.safety_message();
    }
}

impl Core {
    /// Controller time, s.
    pub fn timestamp(&self) -> f64 {
        FIRST_TIMESTAMP + self.step as f64 * FRAME_SECONDS
    }

    /// TCP in the base frame as of the last frame.
    pub fn tcp_pose(&self) -> [f64; 6] {
        self.tcp_pose
    }

    /// `base_from_flange` as it really is.
    pub fn base_from_flange(&self) -> Isometry3<f64> {
        forward(&self.mover.arm.dh, &self.mover.q())
    }

    /// Pose the active move leads to; the present one when the arm is in none.
    pub fn target_waypoint(&self) -> [f64; 6] {
        self.mover.waypoint().map_or(self.tcp_pose, |pose| ur_pose_from_isometry(&pose))
    }

    /// Sets the tool centre point.
    pub fn set_tcp(&mut self, pose: [f64; 6]) {
        self.tcp_offset = pose;
        self.mover.arm.flange_from_tcp = isometry_from_ur_pose(pose);
    }

    /// Fetches the messages that have come up since the last call.
    pub fn take_messages(&mut self) -> Vec<MessageBody> {
        self.messages.drain(..).collect()
    }

    /// Adds a message for the primary interface; the oldest goes when nobody fetches them.
    pub fn message(&mut self, body: MessageBody) {
        if self.messages.len() >= MAX_MESSAGES {
            self.messages.pop_front();
        }
        self.messages.push_back(body);
    }

    /// An error code at level warning.
    pub fn error_message(&mut self, code: i32, argument: i32, text: &str) {
        let text = text.to_owned();
        self.message(MessageBody::Error { code, argument, level: 2, data_type: 0, data: 0, text });
    }

    fn safety_message(&mut self) {
        let mode = self.modes.safety_mode().code() as u8;
        self.message(MessageBody::SafetyMode { code: 0, argument: 0, mode, data_type: 0, data: 0 });
    }

    fn refresh(&mut self) {
        self.tcp_pose = ur_pose_from_isometry(&self.mover.arm.tcp(&self.mover.q()));
    }
}

#[cfg(test)]
mod tests;
