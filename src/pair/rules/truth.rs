//! One controller frame of the simulated cell, as the rules judge it.
//!
//! In: the simulator, after the frame. Out: [`Truth`]: what the arm does, what the controller's modes are.
//! Read once a frame, so that every rule judges the same moment.

use cell_machine::machine::Machine;
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::status::Status;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use std::time::Duration;
use ur_sim::faults::link::LinkName;
use ur_sim::simulator::Simulator;
use ur_wire::enumerations::RobotMode;

/// Controller frames a second.
pub(super) const FRAMES_PER_S: f64 = 500.0;

/// After this long celld has to know of what has happened, 0.5 s.
pub(super) const KNOWN_FRAMES: u64 = 250;

/// A gripper that answers later than this counts as silent.
const ANSWER_WITHIN: Duration = Duration::from_millis(200);

/// The arm counts as moving above this joint speed, rad/s.
const MOVES_RAD_S: f64 = 0.005;

/// Output registers (hardware/ur5e/README.md): the running program's number, the last command it has taken,
/// and the last that it has carried out.
const NONCE: usize = 24;
const ACCEPTED: usize = 25;
const FINISHED: usize = 26;

/// What is true in this frame.
pub(super) struct Truth<'a> {
    /// Controller frame.
    pub frame: u64,
    /// Joint positions, rad.
    pub q: Joints,
    /// Joint speeds, rad/s.
    pub qd: [f64; 6],
    /// Joint accelerations, rad/s2.
    pub qdd: [f64; 6],
    /// The controller rounds a corner at a speed that celld does not command.
    pub rounds: bool,
    /// The flange in the base frame.
    pub flange: Isometry3<f64>,
    /// A joint moves.
    pub moves: bool,
    /// The number that the running program shows.
    pub nonce: i32,
    /// The program that is loaded is celld's, or none is.
    pub ours: bool,
    /// The program plays at full speed: nothing slows it down or stops it from outside.
    pub follows: bool,
    /// The program is paused.
    pub paused: bool,
    /// Speed of the tool, m/s.
    pub tool_speed: f64,
    /// The ordered speed of the line that the tool follows, m/s; none in corners and for other moves.
    pub line_speed: Option<f64>,
    /// Share of its speed at which the arm follows its path.
    pub speed: f64,
    /// The safety system allows motion.
    pub safe: bool,
    /// The pendant is in local control.
    pub local: bool,
    /// A person holds the freedrive button.
    pub guided: bool,
    /// The link that brings the arm's states works.
    pub shown: bool,
    /// The last command that the running program has taken.
    pub accepted: i32,
    /// No program moves the arm. If it moves, a hand or another force does it.
    pub yields: bool,
    /// A program plays that has something to carry out.
    pub carries_out: bool,
    /// The controller's robot mode.
    pub mode: RobotMode,
    /// The cell as the machine has it; none before it is commissioned.
    pub supervisor: Option<&'a Supervisor>,
    /// What people are shown.
    pub status: Option<&'a Status>,
}

/// The gripper answers in time.
pub(super) fn gripper_answers(simulator: &Simulator) -> bool {
    let link = simulator.link(LinkName::Gripper);
    let prompt = link.latency < ANSWER_WITHIN;
    prompt && !link.silent && !link.down && link.exception.is_none() && !link.wrong_transaction
}

/// How late the gripper's answers are, controller frames.
pub(super) fn gripper_latency_frames(simulator: &Simulator) -> u64 {
    (simulator.link(LinkName::Gripper).latency.as_secs_f64() * FRAMES_PER_S) as u64
}

impl<'a> Truth<'a> {
    /// Reads it.
    pub fn of(
        frame: u64,
        simulator: &Simulator,
        machine: &'a Machine,
        status: Option<&'a Status>,
    ) -> Truth<'a> {
        let controller = simulator.core().robot.controller();
        let (core, programs) = (&controller.core, &controller.programs);
        let qd = core.mover.qd();
        // A stalled arm (a fault) slows down like one with a lower speed slider.
        let full =
            core.mover.scaling().min(core.mover.pace()) >= 1.0 && core.registers.speed_fraction() >= 1.0;
        let safe = core.modes.motion_allowed();
        let outputs = &core.registers.output_ints;
        let rtde = simulator.link(LinkName::Rtde);
        let ours = programs.name().is_some_and(|name| name.starts_with("celld_"));
        let idle = ours && outputs[ACCEPTED] == outputs[FINISHED];
        let carries_out = programs.playing() && !idle;
        Truth {
            frame,
            q: core.mover.q(),
            qd,
            qdd: core.mover.qdd(),
            rounds: core.mover.rounds_corner(),
            flange: core.mover.flange(),
            moves: qd.iter().any(|speed| speed.abs() > MOVES_RAD_S),
            nonce: core.registers.output_ints[NONCE],
            ours: programs.name().is_none_or(|name| name.starts_with("celld_")),
            follows: full && safe && programs.playing(),
            paused: programs.paused(),
            tool_speed: core.mover.tcp_speed().fixed_rows::<3>(0).norm(),
            line_speed: core.mover.line_speed(),
            speed: core.registers.speed_fraction(),
            safe,
            local: !core.modes.remote(),
            guided: core.pendant.freedrive,
            shown: !(rtde.silent || rtde.down),
            accepted: outputs[ACCEPTED],
            yields: core.mover.has_braked(),
            carries_out,
            mode: core.modes.robot_mode(),
            supervisor: machine.supervisor(),
            status,
        }
    }

    /// The cell is armed.
    pub fn armed(&self) -> bool {
        self.supervisor.is_some_and(|cell| cell.mode().armed())
    }
}
