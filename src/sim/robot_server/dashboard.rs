//! Connections to the dashboard server: a greeting, then one reply per command.
//!
//! In: lines. Out: replies; they mean "accepted", and the state follows in later frames. Commands that act
//! are refused in local mode and, until it is reopened, on a connection made before the last switch.

use crate::sim::controller::Controller;
use crate::sim::faults::link::LinkStream;
use crate::sim::robot_server::RobotShared;
use crate::wire::dashboard::{Command, GREETING, LineSplitter, ProgramState, Reply};
use crate::wire::enumerations::RuntimeState;
use std::sync::Arc;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Name that stands where no program has one.
const NO_PROGRAM: &str = "<unnamed>";

/// Serves one connection to its end.
pub async fn connection(shared: Arc<RobotShared>, mut stream: LinkStream) {
    let switches = shared.controller().core.modes.switches();
    if stream.write_all(format!("{GREETING}\n").as_bytes()).await.is_err() {
        return;
    }
    let mut splitter = LineSplitter::default();
    let mut buffer = vec![0; 4096];
    loop {
        let count = match stream.read(&mut buffer).await {
            Ok(0) | Err(_) => return,
            Ok(count) => count,
        };
        splitter.push(&buffer[..count]);
        loop {
            let line = match splitter.next_line() {
                Ok(Some(line)) => line,
                Ok(None) => break,
                Err(_) => return,
            };
            let command = Command::parse(&line);
            let reply = answer(&mut shared.controller(), &command, &line, switches).line(&command);
            if stream.write_all(reply.as_bytes()).await.is_err() || command == Command::Quit {
                return;
            }
        }
    }
}

/// Carries out one command.
pub fn answer(controller: &mut Controller, command: &Command, line: &str, switches: u64) -> Reply {
    let modes = &controller.core.modes;
    if command.needs_remote_control() && (!modes.remote() || modes.switches() != switches) {
        return Reply::NotAllowed;
    }
    if let Some(reply) = question(controller, command) {
        return reply;
    }
    let accepted = Reply::accepted(command);
    let refused = |verb: &str| Reply::Refused(format!("Failed to execute: {verb}"));
    match command {
        Command::PowerOn => controller.core.modes.power_on(),
        Command::PowerOff | Command::Shutdown => controller.power_off(),
        Command::BrakeRelease => controller.core.modes.release_brakes(),
        Command::Play if !controller.programs.play(&mut controller.core) => return refused("play"),
        Command::Stop if !controller.programs.stop(&mut controller.core) => return refused("stop"),
        Command::Pause if !controller.programs.pause() => return refused("pause"),
        Command::Load(name) | Command::LoadInstallation(name) => {
            // The simulated controller has no file store; programs come over the script ports.
            return Reply::Refused(format!("File not found: {name}"));
        }
        Command::UnlockProtectiveStop => {
            if let Err(sentence) = controller.unlock_protective_stop() {
                return Reply::Refused(sentence);
            }
        }
        Command::Popup(text) => controller.core.popup = Some(text.clone()),
        Command::ClosePopup => controller.core.popup = None,
        Command::RestartSafety => controller.restart_safety(),
        Command::Unknown(_) => return Reply::not_understood(line),
        _ => {}
    }
    accepted
}

/// Commands that only ask.
fn question(controller: &Controller, command: &Command) -> Option<Reply> {
    let core = &controller.core;
    let [major, minor, bugfix, build] = core.config.version;
    let program = controller.programs.name();
    Some(match command {
        Command::Running => Reply::Flag(controller.programs.playing()),
        Command::ProgramState => Reply::ProgramState {
            state: match controller.programs.runtime_state() {
                RuntimeState::Playing => ProgramState::Playing,
                RuntimeState::Paused => ProgramState::Paused,
                _ => ProgramState::Stopped,
            },
            program: program.unwrap_or(NO_PROGRAM).to_owned(),
        },
        Command::GetLoadedProgram => Reply::Text(match program {
            Some(name) => format!("Loaded program: {name}"),
            None => "No program loaded".to_owned(),
        }),
        Command::IsProgramSaved => Reply::Text(format!("true {}", program.unwrap_or(NO_PROGRAM))),
        Command::RobotMode => Reply::RobotMode(core.modes.robot_mode()),
        Command::SafetyMode | Command::SafetyStatus => Reply::SafetyMode(core.modes.safety_mode()),
        Command::IsInRemoteControl => Reply::Flag(core.modes.remote()),
        Command::PolyscopeVersion => {
            Reply::Text(format!("URSoftware {major}.{minor}.{bugfix}.{build} (Jan 01 2026)"))
        }
        Command::Version => Reply::Text(format!("{major}.{minor}.{bugfix}.{build}")),
        Command::GetSerialNumber => Reply::Text(core.config.serial_number.clone()),
        Command::GetRobotModel => Reply::Text(core.config.model.clone()),
        Command::GetOperationalMode => Reply::Text("NONE".to_owned()),
        Command::GetUserRole => Reply::Text("PROGRAMMER".to_owned()),
        _ => return None,
    })
}
