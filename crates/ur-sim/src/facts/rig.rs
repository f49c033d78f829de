//! A simulated controller for the measurement of one fact.
//!
//! In: scripts, lines, packets. Out: what the clients of a controller would see, or nothing where there is
//! nothing; nothing here panics, for a row without an answer is one that does not agree.

use crate::controller::builtins::compile_program;
use crate::controller::{Controller, ControllerConfig};
use crate::motion::FRAME_SECONDS;
use crate::session::Port;
use crate::simulator::{ConnectionId, Simulator, Transmission};
use crate::world::spec::{GripperSpec, WorldSpec};
use nalgebra::Isometry3;
use ur_arm::kinematics::DhParameters;
use ur_wire::enumerations::RuntimeState;
use ur_wire::primary_message::MessageBody;

/// Longest that a script may take, frames: a simulated minute.
const PATIENCE: usize = 30_000;

/// A UR5e with nominal kinematics.
pub fn config(running: bool) -> ControllerConfig {
    ControllerConfig { running, dh: DhParameters::UR5E, ..ControllerConfig::ur5e(1) }
}

/// A controller that runs a script.
pub fn playing(script: &str) -> Controller {
    let mut controller = Controller::new(config(true));
    controller.programs.upload(compile_program(script));
    controller.frame();
    controller
}

/// Frames until `done`, at most [`PATIENCE`].
pub fn until(controller: &mut Controller, done: impl Fn(&Controller) -> bool) -> f64 {
    let mut frames = 0;
    while !done(controller) && frames < PATIENCE {
        controller.frame();
        frames += 1;
    }
    if frames < PATIENCE { frames as f64 * FRAME_SECONDS } else { f64::NAN }
}

/// No program runs.
pub fn stopped(controller: &Controller) -> bool {
    controller.programs.runtime_state() == RuntimeState::Stopped
}

/// Seconds during which a script moves the arm.
pub fn moving_s(script: &str) -> f64 {
    let mut controller = playing(script);
    let mut frames = 0;
    for _ in 0..PATIENCE {
        frames += usize::from(!controller.core.mover.stands());
        if stopped(&controller) && controller.core.mover.stands() {
            return frames as f64 * FRAME_SECONDS;
        }
        controller.frame();
    }
    f64::NAN
}

/// What a script says by `textmsg`, and its runtime exception.
pub fn said(script: &str) -> Vec<String> {
    let mut controller = playing(script);
    let mut said = Vec::new();
    for _ in 0..PATIENCE {
        said.extend(controller.core.take_messages().into_iter().filter_map(|message| match message {
            MessageBody::Text(text) => Some(text),
            MessageBody::RuntimeException { text, .. } => Some(format!("exception: {text}")),
            _ => None,
        }));
        if stopped(&controller) {
            break;
        }
        controller.frame();
    }
    said
}

/// The text of an expression.
pub fn value(expression: &str) -> String {
    said(&format!("def f():\n textmsg({expression})\nend\n")).concat()
}

/// The numbers in the text of an expression.
pub fn evaluated(expression: &str) -> Vec<f64> {
    numbers_in(&value(expression))
}

/// The numbers in a text.
pub fn numbers_in(text: &str) -> Vec<f64> {
    let parts = text.split(|c: char| !(c.is_ascii_digit() || matches!(c, '-' | '.' | 'e')));
    parts.filter_map(|part| part.parse().ok()).collect()
}

/// What becomes of a statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ran {
    /// The statement after it was reached.
    Through,
    /// A runtime exception.
    Exception,
    /// Neither: it was not loaded, or does not end.
    Neither,
}

/// Runs one statement.
pub fn ran(statement: &str) -> Ran {
    let said = said(&format!("def f():\n {statement}\n textmsg(\"after\")\nend\n"));
    match said.last().map(String::as_str) {
        Some("after") => Ran::Through,
        Some(text) if text.starts_with("exception: ") => Ran::Exception,
        _ => Ran::Neither,
    }
}

/// A whole cell with sessions.
pub struct Cell {
    /// The cell.
    pub simulator: Simulator,
}

impl Cell {
    /// With this controller and gripper; `None` if there is no such cell.
    pub fn new(config: ControllerConfig, gripper: GripperSpec) -> Option<Cell> {
        let world = WorldSpec::bare(Isometry3::translation(-0.75, -0.4, -0.5), gripper);
        Some(Cell { simulator: Simulator::new(config, world, 1, Vec::new()).ok()? })
    }

    /// An ordinary one.
    pub fn ordinary(running: bool) -> Option<Cell> {
        Cell::new(config(running), GripperSpec::one_cup(0.2))
    }

    /// A new connection and what it is greeted with.
    pub fn connect(&mut self, port: Port) -> Option<(ConnectionId, Vec<u8>)> {
        let id = self.simulator.connect(port)?;
        Some((id, self.sent(id)))
    }

    /// What is sent on a connection since the last call.
    pub fn sent(&mut self, id: ConnectionId) -> Vec<u8> {
        let mut bytes = Vec::new();
        while let Some(transmission) = self.simulator.transmit() {
            match transmission {
                Transmission::Bytes(to, part) if to == id => bytes.extend_from_slice(&part),
                Transmission::Bytes(..) | Transmission::Closed(_) => {}
            }
        }
        bytes
    }

    /// What a request is answered.
    pub fn request(&mut self, id: ConnectionId, request: &[u8]) -> Vec<u8> {
        self.simulator.receive(id, request);
        self.sent(id)
    }

    /// Simulated time goes on.
    pub fn wait(&mut self, seconds: f64) {
        (0..(seconds / FRAME_SECONDS).round() as usize).for_each(|_| self.simulator.advance());
    }

    /// Runs a script.
    pub fn run(&mut self, script: &str) {
        self.simulator.core().robot.controller().programs.upload(compile_program(script));
        self.simulator.advance();
    }

    /// Answers of a connection of its own to lines, each on a line.
    pub fn lines(&mut self, port: Port, lines: &[&str]) -> String {
        let Some((id, _)) = self.connect(port) else { return "no connection".to_owned() };
        let answers: Vec<String> = lines
            .iter()
            .map(|line| {
                String::from_utf8_lossy(&self.request(id, format!("{line}\n").as_bytes())).trim().to_owned()
            })
            .collect();
        self.simulator.hang_up(id);
        answers.join(" / ")
    }
}

/// Bytes in hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}
