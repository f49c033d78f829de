//! Everything of the controller but its programs, so that a running program can act on it.
//!
//! In: what clients and scripts set, and the frames that [`crate::controller::Controller::frame`] makes.
//! Out: state to sample, and messages for the primary interface. The parts have files of their own; this
//! puts them together and says what a frame leaves to be seen. Pure.

use crate::controller::compliance::{Compliance, ForceSettings};
use crate::controller::config::ControllerConfig;
use crate::controller::encoders::Conveyor;
use crate::controller::interpreter_mode::Interpreter;
use crate::controller::modes::Modes;
use crate::controller::pendant::Pendant;
use crate::controller::registers::Registers;
use crate::controller::sensing::Sensing;
use crate::controller::settings::Settings;
use crate::controller::sockets::{NoNetwork, ScriptSockets};
use crate::controller::value_requests::ValueRequests;
use crate::controller::watchdog::Watchdog;
use crate::motion::mover::{MoveId, Mover};
use crate::motion::rest::Rest;
use crate::motion::safety::Clearance;
use crate::motion::{Arm, FRAME_SECONDS};
use cell_values::units::Joints;
use nalgebra::Isometry3;
use std::collections::VecDeque;
use ur_arm::pose::{isometry_from_ur_pose, ur_pose_from_isometry};
use ur_wire::primary_message::MessageBody;
use urscript::value::ThreadId;

/// Controller time at the first frame, s. Client libraries distrust timestamps below 40 s: a real controller
/// restarts its RTDE service once while it boots.
const FIRST_TIMESTAMP: f64 = 41.0;

/// Messages kept for the primary interface until the servers fetch them.
const MAX_MESSAGES: usize = 1000;

/// Braking of moves whose program went away, rad/s2.
pub(super) const DEFAULT_STOP: f64 = 4.0;

/// A payload that changes gradually.
#[derive(Clone, Debug)]
pub(super) struct PayloadChange {
    from: Payload,
    to: Payload,
    frame: u32,
    frames: u32,
}

/// The tool as set in the controller.
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
    /// The commanded arm.
    pub mover: Mover,
    /// The real arm's offset from it, and measurement noise.
    rest: Rest,
    /// `base_from_flange` as it really is.
    flange: Isometry3<f64>,
    /// Tool and gravity.
    pub payload: Payload,
    /// Tool centre point as set, m and rad.
    pub tcp_offset: [f64; 6],
    /// Frames since the start.
    pub step: u64,
    /// Interpreter mode.
    pub interpreter: Interpreter,
    /// Text of a popup on the pendant.
    pub popup: Option<String>,
    /// Forces at the tool and the arm's recent past.
    pub sensing: Sensing,
    /// Force mode or freedrive, if one is on.
    pub compliance: Option<Compliance>,
    /// Damping and gain of force mode.
    pub force_settings: ForceSettings,
    /// What scripts set and read back.
    pub settings: Settings,
    /// The network, for scripts' sockets.
    pub sockets: Box<dyn ScriptSockets>,
    /// What was chosen at the pendant.
    pub pendant: Pendant,
    /// What programs have requested from whoever is there.
    pub requests: ValueRequests,
    messages: VecDeque<MessageBody>,
    tcp_pose: [f64; 6],
    /// Thread and move that have the arm.
    pub(super) owner: Option<(ThreadId, MoveId)>,
    /// A thread was killed in a motion; the arm brakes unless something else commands it in this frame.
    pub(super) orphaned: bool,
    pub(super) watchdogs: Vec<Watchdog>,
    /// How deep the arm was last where its safety system does not let it be, m.
    pub(super) intrusion_m: f64,
    /// The clearance found last.
    pub(super) clearance: Option<Clearance>,
    /// The payload on its way to another.
    pub(super) payload_change: Option<PayloadChange>,
    /// The conveyor that is tracked.
    pub(super) conveyor: Option<Conveyor>,
    /// Error code and reason of a protective stop that this frame ends with.
    pub(super) stop_requested: Option<(i32, String)>,
}

impl Core {
    /// Everything as at the end of booting.
    pub(super) fn new(config: ControllerConfig) -> Core {
        let mut arm = Arm::of(config.arm.joint_speed, config.dh);
        arm.tool_speed = config.safety.tool_speed;
        // Data sheets: wrist 3 of these turns without end.
        arm.endless = matches!(config.arm.name, "UR3" | "UR3e").then_some(5);
        let mut core = Core {
            modes: Modes::new(config.running, config.control),
            registers: Registers::default(),
            rest: Rest::new(config.rest, config.seed),
            mover: Mover::new(arm, config.start),
            flange: Isometry3::identity(),
            payload: Payload {
                mass: config.payload,
                centre: config.payload_centre,
                inertia: [0.0; 6],
                gravity: [0.0, 0.0, cell_values::units::GRAVITY],
            },
            tcp_offset: [0.0; 6],
            step: 0,
            interpreter: Interpreter::default(),
            popup: None,
            sensing: Sensing::default(),
            compliance: None,
            force_settings: ForceSettings::default(),
            settings: Settings::default(),
            sockets: Box::new(NoNetwork),
            pendant: Pendant::default(),
            requests: ValueRequests::default(),
            messages: VecDeque::new(),
            tcp_pose: [0.0; 6],
            owner: None,
            orphaned: false,
            watchdogs: Vec::new(),
            intrusion_m: 0.0,
            clearance: None,
            payload_change: None,
            conveyor: None,
            stop_requested: None,
            config,
            secondary: false,
        };
        core.mover.set_blends(core.config.blends);
        core.set_tcp(core.config.tcp);
        core.refresh();
        core
    }

    /// The payload goes to this one over so many seconds; at once in none.
    pub(super) fn change_payload(&mut self, to: Payload, seconds: f64) {
        let frames = (seconds / FRAME_SECONDS).round() as u32;
        let from = self.payload.clone();
        self.payload_change = (frames > 0).then(|| PayloadChange { from, to: to.clone(), frame: 0, frames });
        if frames == 0 {
            self.payload = to;
        }
    }

    /// The payload has this mass, whatever a program has set, kg.
    pub(crate) fn payload_is(&mut self, mass_kg: f64) {
        (self.payload_change, self.payload.mass) = (None, mass_kg);
    }

    /// One frame of a payload that changes.
    pub(super) fn payload_frame(&mut self) {
        let Some(change) = &mut self.payload_change else { return };
        change.frame += 1;
        let share = f64::from(change.frame) / f64::from(change.frames);
        let (from, to) = (&change.from, &change.to);
        let between = |one: f64, other: f64| one + share * (other - one);
        self.payload = match share < 1.0 {
            true => Payload {
                mass: between(from.mass, to.mass),
                centre: std::array::from_fn(|axis| between(from.centre[axis], to.centre[axis])),
                inertia: std::array::from_fn(|k| between(from.inertia[k], to.inertia[k])),
                gravity: self.payload.gravity,
            },
            false => Payload { gravity: self.payload.gravity, ..to.clone() },
        };
        if share >= 1.0 {
            self.payload_change = None;
        }
    }

    /// Controller time, s.
    pub fn timestamp(&self) -> f64 {
        FIRST_TIMESTAMP + self.step as f64 * FRAME_SECONDS
    }

    /// Software version as reported to clients: major, minor, bug fix, build.
    pub fn version(&self) -> [u32; 4] {
        self.pendant.claimed_version().unwrap_or(self.config.version)
    }

    /// Model as reported to clients, in the dashboard's words: without the "e".
    pub fn model(&self) -> &str {
        self.pendant.claimed_model().unwrap_or(&self.config.model)
    }

    /// TCP in the base frame as of the last frame.
    pub fn tcp_pose(&self) -> [f64; 6] {
        self.tcp_pose
    }

    /// `base_from_flange` as it really is.
    pub fn base_from_flange(&self) -> Isometry3<f64> {
        self.flange
    }

    /// Measured joint positions, rad.
    pub fn actual_q(&self) -> Joints {
        Joints(plus(self.mover.q().0, self.rest.measured()))
    }

    /// Measured joint speeds, rad/s.
    pub fn actual_qd(&self) -> [f64; 6] {
        plus(self.mover.qd(), self.rest.measured_speed())
    }

    /// One frame of coming to rest.
    pub(super) fn come_to_rest(&mut self) {
        if self.modes.brakes_open() {
            self.rest.step(&self.mover.qd());
        } else {
            self.rest.brake();
        }
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

    /// Adds a message for the primary interface; the oldest goes when they are not fetched.
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

    pub(super) fn safety_message(&mut self) {
        let mode = self.modes.safety_mode().code() as u8;
        self.message(MessageBody::SafetyMode { code: 0, argument: 0, mode, data_type: 0, data: 0 });
    }

    pub(super) fn refresh(&mut self) {
        let offset = self.rest.offset();
        self.flange = match offset == [0.0; 6] {
            true => self.mover.flange(),
            false => {
                let actual = Joints(plus(self.mover.q().0, offset));
                self.mover.arm.kinematics.forward(&actual)
            }
        };
        self.tcp_pose = ur_pose_from_isometry(&(self.flange * self.mover.arm.flange_from_tcp));
    }
}

fn plus(one: [f64; 6], other: [f64; 6]) -> [f64; 6] {
    std::array::from_fn(|joint| one[joint] + other[joint])
}
