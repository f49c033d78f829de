//! Connections to the dashboard server: a greeting, then one reply per command.
//!
//! In: lines. Out: replies; they mean "accepted", and the state follows in later frames. Commands that act
//! are refused in local mode and, until it is reopened, on a connection made before the last switch. The
//! table of all commands is docs/simulator-states.md.

use crate::controller::Controller;
use crate::controller::core::Core;
use crate::controller::pendant::{INSTALLATION, LoadError, OperationalMode};
use crate::controller::program_files::bare_name;
use crate::robot_server::shared::RobotShared;
use ur_wire::bytes::WireError;
use ur_wire::dashboard::{Command, GREETING, LineSplitter, Reply};

/// Name given where no program has one.
const NO_PROGRAM: &str = "<unnamed>";

/// One connection, without its socket.
pub struct Session {
    splitter: LineSplitter,
    switches: u64,
    over: bool,
}

impl Session {
    /// A connection made now.
    pub fn new(controller: &Controller) -> Session {
        let switches = controller.core.modes.switches();
        Session { splitter: LineSplitter::default(), switches, over: false }
    }

    /// What a client receives first.
    pub fn greeting() -> String {
        format!("{GREETING}\n")
    }

    /// Carries out what arrived, one command at a time under the controller's lock; the replies.
    ///
    /// # Errors
    /// A line without an end; the connection ends.
    pub fn receive(&mut self, shared: &RobotShared, bytes: &[u8]) -> Result<String, WireError> {
        self.splitter.push(bytes);
        let mut replies = String::new();
        while let Some(line) = self.splitter.next_line()?.filter(|_| !self.over) {
            let command = Command::parse(&line);
            let reply = answer(&mut shared.controller(), &command, &line, self.switches);
            replies.push_str(&reply.line(&command));
            self.over = command == Command::Quit;
        }
        Ok(replies)
    }

    /// The client has taken its leave.
    pub fn over(&self) -> bool {
        self.over
    }
}

/// Carries out one command.
pub fn answer(controller: &mut Controller, command: &Command, line: &str, switches: u64) -> Reply {
    let modes = &controller.core.modes;
    if command.needs_remote_control() && (!modes.takes_commands() || modes.switches() != switches) {
        return Reply::NotAllowed;
    }
    if let Some(reply) = question(controller, command).or_else(|| at_the_pendant(controller, command)) {
        return reply;
    }
    let refused = |verb: &str| Reply::Refused(format!("Failed to execute: {verb}"));
    match command {
        Command::PowerOn => controller.core.modes.power_on(),
        Command::PowerOff | Command::Shutdown => controller.power_off(),
        Command::BrakeRelease => controller.core.modes.release_brakes(),
        Command::Play if !controller.programs.play(&mut controller.core) => return refused("play"),
        // Without a program too: clients stop what may have ended a moment ago, and expect no other answer.
        Command::Stop => drop(controller.programs.cancel(&mut controller.core)),
        Command::Pause if !controller.programs.pause() => return refused("pause"),
        Command::Load(name) => return load(controller, name),
        Command::UnlockProtectiveStop => {
            if let Err(sentence) = controller.unlock_protective_stop() {
                return Reply::Refused(sentence);
            }
        }
        Command::RestartSafety => controller.restart_safety(),
        Command::Unknown(_) => return Reply::not_understood(line),
        // Played or paused; what else there is was answered above, or is accepted without an effect.
        Command::Play
        | Command::Pause
        | Command::LoadInstallation(_)
        | Command::Running
        | Command::ProgramState
        | Command::GetLoadedProgram
        | Command::IsProgramSaved
        | Command::RobotMode
        | Command::SafetyMode
        | Command::SafetyStatus
        | Command::CloseSafetyPopup
        | Command::ClosePopup
        | Command::Popup(_)
        | Command::IsInRemoteControl
        | Command::PolyscopeVersion
        | Command::Version
        | Command::GetSerialNumber
        | Command::GetRobotModel
        | Command::SetOperationalMode(_)
        | Command::GetOperationalMode
        | Command::ClearOperationalMode
        | Command::SetUserRole(_)
        | Command::GetUserRole
        | Command::AddToLog(_)
        | Command::SaveLog
        | Command::GenerateFlightReport(_)
        | Command::GenerateSupportFile(_)
        | Command::Quit => {}
    }
    Reply::accepted(command)
}

fn load(controller: &mut Controller, name: &str) -> Reply {
    match controller.core.open_program(name) {
        Ok(program) => {
            controller.programs.load(program, &mut controller.core);
            let path = controller.core.pendant.program.as_deref().unwrap_or(name);
            Reply::Accepted(format!("Loading program: {path}"))
        }
        Err(LoadError::NotFound) => Reply::Refused(format!("File not found: {name}")),
        Err(LoadError::Wrong) => Reply::Refused(format!("Error while loading program: {name}")),
    }
}

/// Commands that change what is on the pendant.
fn at_the_pendant(controller: &mut Controller, command: &Command) -> Option<Reply> {
    let core = &mut controller.core;
    match command {
        Command::Popup(text) => core.popup = Some(text.clone()),
        Command::ClosePopup => core.popup = None,
        Command::CloseSafetyPopup => core.pendant.safety_popup = false,
        Command::LoadInstallation(name) => {
            let folder = core.config.programs.folder();
            let file = name.strip_prefix(folder).unwrap_or(name);
            return Some(match file {
                INSTALLATION => Reply::Accepted(format!("Loading installation: {folder}{file}")),
                _ => Reply::Refused(format!("File not found: {name}")),
            });
        }
        Command::SetOperationalMode(name) => match OperationalMode::from_name(name) {
            Some(mode) => core.pendant.operational_mode = mode,
            None => return Some(Reply::Refused(format!("Failed setting operational mode: {name}"))),
        },
        Command::ClearOperationalMode => {
            core.pendant.operational_mode = OperationalMode::None;
            let sentence = "No longer controlling the operational mode. Current operational mode: 'NONE'.";
            return Some(Reply::Text(sentence.to_owned()));
        }
        Command::SetUserRole(name) if !core.pendant.set_role(name) => {
            return Some(Reply::Refused(format!("Failed setting user role: {name}")));
        }
        Command::AddToLog(text) => tracing::info!(text, "log message of a dashboard client"),
        Command::GenerateFlightReport(kind) => return Some(flight_report(core, kind)),
        Command::GenerateSupportFile(folder) => return Some(support_file(core, folder)),
        _ => return None,
    }
    Some(Reply::accepted(command))
}

/// The number of a report that is not made: it would be of files that only a real controller has.
fn flight_report(core: &mut Core, kind: &str) -> Reply {
    if !matches!(kind, "" | "controller" | "software" | "system") {
        return Reply::Text(format!("Error generating flight report: unknown type {kind}"));
    }
    core.pendant.flight_reports += 1;
    Reply::Text(format!("Flight Report generated with id:{}", core.pendant.flight_reports))
}

/// The name that a support file would have in a folder of the programs; none is written.
fn support_file(core: &mut Core, folder: &str) -> Reply {
    let place = folder.trim_end_matches('/');
    let programs = core.config.programs.folder().trim_end_matches('/');
    if !matches!(place, "" | ".") && place != programs {
        return Reply::Text(format!("Error: {folder} is not a folder of the programs"));
    }
    core.pendant.flight_reports += 1;
    let (serial, number) = (&core.config.serial_number, core.pendant.flight_reports);
    Reply::Text(format!("Completed successfully: ur_{serial}_{number}.zip"))
}

/// Commands that only query.
fn question(controller: &Controller, command: &Command) -> Option<Reply> {
    let core = &controller.core;
    let [major, minor, bugfix, build] = core.version();
    Some(match command {
        Command::Running => Reply::Flag(controller.programs.playing()),
        Command::ProgramState => Reply::ProgramState {
            state: controller.programs.program_state(),
            program: program_name(controller).to_owned(),
        },
        Command::GetLoadedProgram => Reply::Text(match &core.pendant.program {
            Some(path) => format!("Loaded program: {path}"),
            None => "No program loaded".to_owned(),
        }),
        Command::IsProgramSaved => Reply::Text(format!("true {}", program_name(controller))),
        Command::RobotMode => Reply::RobotMode(core.modes.robot_mode()),
        Command::SafetyMode | Command::SafetyStatus => Reply::SafetyMode(core.modes.safety_mode()),
        Command::IsInRemoteControl => Reply::Flag(core.modes.remote()),
        Command::PolyscopeVersion => {
            Reply::Text(format!("URSoftware {major}.{minor}.{bugfix}.{build} (Jan 01 2026)"))
        }
        Command::Version => Reply::Text(format!("{major}.{minor}.{bugfix}.{build}")),
        Command::GetSerialNumber => Reply::Text(core.config.serial_number.clone()),
        Command::GetRobotModel => Reply::Text(core.model().to_owned()),
        Command::GetOperationalMode => Reply::Text(core.pendant.operational_mode.name().to_owned()),
        Command::GetUserRole => Reply::Text(core.pendant.role().to_owned()),
        _ => return None,
    })
}

/// The file of the loaded program, or the name of the script that ran last if it came over a socket.
fn program_name(controller: &Controller) -> &str {
    let file = controller.core.pendant.program.as_deref().map(bare_name);
    let name = controller.programs.name();
    match (file, controller.programs.is_loaded()) {
        (Some(file), true) => file,
        _ => name.unwrap_or(NO_PROGRAM),
    }
}

#[cfg(test)]
mod tests;
