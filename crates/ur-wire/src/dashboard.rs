//! Dashboard server (TCP 29999): one command per line, one reply line per command.
//!
//! In: lines of text. Out: [`Command`]s and [`Reply`]s, and lines again. A reply means *accepted*, never
//! *done*: the sender of the command waits for the state to change. A reply can only be read with the
//! command it answers, so the command is an argument. Source: the vendor's dashboard guide and the texts
//! client libraries match on (reference on UR interfaces, 2.2).

use crate::bytes::{Pending, WireError, cut_text};
use crate::enumerations::{RobotMode, SafetyMode};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Sent by the server as soon as it accepts a connection.
pub const GREETING: &str = "Connected: Universal Robots Dashboard Server";

/// What every reply to a refused command starts with while the pendant is in local mode.
pub const NOT_ALLOWED: &str = "Command is not allowed";

/// The whole refusal, as the controller words it.
pub const NOT_ALLOWED_TEXT: &str = "Command is not allowed due to safety reasons, please switch robot to \
                                    Remote Control mode and reconnect to port 29999";

/// Longest line accepted in either direction.
pub const MAX_LINE: usize = 4096;

/// Splits a stream into lines; `\r\n` is tolerated, bytes that are not UTF-8 are replaced.
#[derive(Default, Deserialize, Serialize)]
pub struct LineSplitter(Pending);

impl LineSplitter {
    /// Appends what arrived; then call [`LineSplitter::next_line`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next whole line, without its end.
    ///
    /// # Errors
    /// More than [`MAX_LINE`] bytes without an end; what waits is dropped.
    pub fn next_line(&mut self) -> Result<Option<String>, WireError> {
        let waiting = self.0.waiting();
        let end = waiting.iter().take(MAX_LINE + 1).position(|byte| *byte == b'\n');
        let Some(end) = end else {
            if waiting.len() > MAX_LINE {
                self.0.clear();
                return Err(WireError::LineTooLong { max: MAX_LINE });
            }
            return Ok(None);
        };
        let line = self.0.take(end + 1).unwrap_or_default();
        let line = String::from_utf8_lossy(line);
        Ok(Some(line.trim_end_matches(['\n', '\r']).to_string()))
    }
}

/// State of the loaded program in the reply to `programState`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum ProgramState {
    /// STOPPED.
    Stopped,
    /// PLAYING.
    Playing,
    /// PAUSED.
    Paused,
}

impl ProgramState {
    /// The word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            ProgramState::Stopped => "STOPPED",
            ProgramState::Playing => "PLAYING",
            ProgramState::Paused => "PAUSED",
        }
    }
}

impl fmt::Display for ProgramState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// What a client requests. Texts in it must not contain line ends; [`Command::line`] cuts them there.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Command {
    /// `power on`.
    PowerOn,
    /// `power off`.
    PowerOff,
    /// `brake release`.
    BrakeRelease,
    /// `load installation NAME`.
    LoadInstallation(String),
    /// `load NAME.urp`.
    Load(String),
    /// `play`.
    Play,
    /// `stop`.
    Stop,
    /// `pause`.
    Pause,
    /// `running`.
    Running,
    /// `programState`.
    ProgramState,
    /// `get loaded program`.
    GetLoadedProgram,
    /// `isProgramSaved`.
    IsProgramSaved,
    /// `robotmode`.
    RobotMode,
    /// `safetymode`.
    SafetyMode,
    /// `safetystatus`.
    SafetyStatus,
    /// `unlock protective stop`.
    UnlockProtectiveStop,
    /// `close safety popup`.
    CloseSafetyPopup,
    /// `close popup`.
    ClosePopup,
    /// `popup TEXT`.
    Popup(String),
    /// `restart safety`.
    RestartSafety,
    /// `is in remote control`.
    IsInRemoteControl,
    /// `PolyscopeVersion`.
    PolyscopeVersion,
    /// `version`.
    Version,
    /// `get serial number`.
    GetSerialNumber,
    /// `get robot model`.
    GetRobotModel,
    /// `set operational mode MODE`.
    SetOperationalMode(String),
    /// `get operational mode`.
    GetOperationalMode,
    /// `clear operational mode`.
    ClearOperationalMode,
    /// `setUserRole ROLE`.
    SetUserRole(String),
    /// `getUserRole`.
    GetUserRole,
    /// `addToLog TEXT`.
    AddToLog(String),
    /// `saveLog`.
    SaveLog,
    /// `generate flight report TYPE`.
    GenerateFlightReport(String),
    /// `generate support file DIR`.
    GenerateSupportFile(String),
    /// `quit`.
    Quit,
    /// `shutdown`.
    Shutdown,
    /// Anything else, as received.
    Unknown(String),
}

/// Commands without an argument, and the sentence that accepts them (empty: answered with data).
const PLAIN: &[(&str, Command, &str)] = &[
    ("power on", Command::PowerOn, "Powering on"),
    ("power off", Command::PowerOff, "Powering off"),
    ("brake release", Command::BrakeRelease, "Brake releasing"),
    ("play", Command::Play, "Starting program"),
    ("stop", Command::Stop, "Stopped"),
    ("pause", Command::Pause, "Pausing program"),
    ("running", Command::Running, ""),
    ("programState", Command::ProgramState, ""),
    ("get loaded program", Command::GetLoadedProgram, ""),
    ("isProgramSaved", Command::IsProgramSaved, ""),
    ("robotmode", Command::RobotMode, ""),
    ("safetymode", Command::SafetyMode, ""),
    ("safetystatus", Command::SafetyStatus, ""),
    ("unlock protective stop", Command::UnlockProtectiveStop, "Protective stop releasing"),
    ("close safety popup", Command::CloseSafetyPopup, "closing safety popup"),
    ("close popup", Command::ClosePopup, "closing popup"),
    ("restart safety", Command::RestartSafety, "Restarting safety"),
    ("is in remote control", Command::IsInRemoteControl, ""),
    ("PolyscopeVersion", Command::PolyscopeVersion, ""),
    ("version", Command::Version, ""),
    ("get serial number", Command::GetSerialNumber, ""),
    ("get robot model", Command::GetRobotModel, ""),
    ("get operational mode", Command::GetOperationalMode, ""),
    ("clear operational mode", Command::ClearOperationalMode, ""),
    ("getUserRole", Command::GetUserRole, ""),
    ("saveLog", Command::SaveLog, "Log saved to disk"),
    ("quit", Command::Quit, "Disconnected"),
    ("shutdown", Command::Shutdown, "Shutting down"),
];

/// A verb, and the command of the text behind it.
type Verb = (&'static str, fn(String) -> Command);

/// Commands with an argument, longest verb first where one starts like another.
const WITH_TEXT: &[Verb] = &[
    ("load installation", Command::LoadInstallation),
    ("load", Command::Load),
    ("popup", Command::Popup),
    ("set operational mode", Command::SetOperationalMode),
    ("setUserRole", Command::SetUserRole),
    ("addToLog", Command::AddToLog),
    ("generate flight report", Command::GenerateFlightReport),
    ("generate support file", Command::GenerateSupportFile),
];

impl Command {
    /// The command in a line without its end; verbs in any case.
    pub fn parse(line: &str) -> Command {
        let line = line.trim();
        if let Some((_, command, _)) = PLAIN.iter().find(|(verb, ..)| verb.eq_ignore_ascii_case(line)) {
            return command.clone();
        }
        let with_text = WITH_TEXT.iter().find_map(|(verb, make)| {
            let (head, rest) = line.split_at_checked(verb.len())?;
            let separate = rest.is_empty() || rest.starts_with(' ');
            (head.eq_ignore_ascii_case(verb) && separate).then(|| make(rest.trim().to_string()))
        });
        with_text.unwrap_or_else(|| Command::Unknown(line.to_string()))
    }

    /// The line to send, with its end.
    pub fn line(&self) -> String {
        let one_line = |text: &str| text.split(['\n', '\r']).next().unwrap_or_default().to_string();
        let text = match self {
            Command::LoadInstallation(name) => format!("load installation {}", one_line(name)),
            Command::Load(name) => format!("load {}", one_line(name)),
            Command::Popup(text) => format!("popup {}", one_line(text)),
            Command::SetOperationalMode(mode) => format!("set operational mode {}", one_line(mode)),
            Command::SetUserRole(role) => format!("setUserRole {}", one_line(role)),
            Command::AddToLog(text) => format!("addToLog {}", one_line(text)),
            Command::GenerateFlightReport(kind) => format!("generate flight report {}", one_line(kind)),
            Command::GenerateSupportFile(dir) => format!("generate support file {}", one_line(dir)),
            Command::Unknown(text) => one_line(text),
            plain => plain.plain().map(|(verb, _)| verb.to_string()).unwrap_or_default(),
        };
        format!("{}\n", cut_text(&text, MAX_LINE - 1))
    }

    /// True if the controller refuses the command while the pendant is in local mode.
    pub fn needs_remote_control(&self) -> bool {
        matches!(
            self,
            Command::PowerOn
                | Command::PowerOff
                | Command::BrakeRelease
                | Command::Load(_)
                | Command::LoadInstallation(_)
                | Command::Play
                | Command::Stop
                | Command::Pause
                | Command::UnlockProtectiveStop
                | Command::CloseSafetyPopup
                | Command::RestartSafety
        )
    }

    /// Verb and accepting sentence of a command without argument.
    fn plain(&self) -> Option<(&'static str, &'static str)> {
        PLAIN.iter().find(|(_, command, _)| command == self).map(|(verb, _, sentence)| (*verb, *sentence))
    }

    /// The start of the line that accepts the command; `None` if the answer is data.
    fn acceptance(&self) -> Option<&'static str> {
        match self {
            Command::Load(_) => Some("Loading program:"),
            Command::LoadInstallation(_) => Some("Loading installation:"),
            Command::Popup(_) => Some("showing popup"),
            Command::AddToLog(_) => Some("Added log message"),
            Command::SetUserRole(_) => Some("Setting user role:"),
            Command::SetOperationalMode(_) => Some("Operational mode"),
            plain => plain.plain().map(|(_, sentence)| sentence).filter(|sentence| !sentence.is_empty()),
        }
    }
}

/// What the server answers.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Reply {
    /// The command was taken; what it requests has yet to happen. The text is the whole line, which for
    /// `load` names the file.
    Accepted(String),
    /// The pendant is in local mode.
    NotAllowed,
    /// The command was understood and not taken; the whole line.
    Refused(String),
    /// `could not understand`: the whole line.
    NotUnderstood(String),
    /// Answer of `running` and `is in remote control`.
    Flag(bool),
    /// Answer of `robotmode`.
    RobotMode(RobotMode),
    /// Answer of `safetymode` and `safetystatus`.
    SafetyMode(SafetyMode),
    /// Answer of `programState`.
    ProgramState {
        /// State.
        state: ProgramState,
        /// Program name, `<unnamed>` if it has none.
        program: String,
    },
    /// Answer of the other questions: version, serial number, model, loaded program, ...
    Text(String),
}

impl Reply {
    /// The sentence with which a controller accepts `command`.
    pub fn accepted(command: &Command) -> Reply {
        let sentence = command.acceptance().unwrap_or_default();
        Reply::Accepted(match command {
            Command::Load(name) | Command::LoadInstallation(name) | Command::SetUserRole(name) => {
                format!("{sentence} {name}")
            }
            Command::SetOperationalMode(mode) => format!("{sentence} {} is set", mode.to_uppercase()),
            _ => sentence.to_string(),
        })
    }

    /// The answer to a line that is no command.
    pub fn not_understood(line: &str) -> Reply {
        Reply::NotUnderstood(format!("could not understand: {line}"))
    }

    /// Reads the reply line to `command`.
    ///
    /// # Errors
    /// The reply is no valid mode, yes or no, serial number, model or version; celld does not guess.
    pub fn parse(command: &Command, line: &str) -> Result<Reply, WireError> {
        let line = line.trim();
        if starts_with(line, NOT_ALLOWED) {
            return Ok(Reply::NotAllowed);
        }
        if starts_with(line, "could not understand") {
            return Ok(Reply::NotUnderstood(line.to_string()));
        }
        match command {
            Command::Running => flag(strip(line, "Program running:")),
            Command::IsInRemoteControl => flag(Some(line)),
            Command::RobotMode => mode(line, "Robotmode:", RobotMode::from_name).map(Reply::RobotMode),
            Command::SafetyMode => mode(line, "Safetymode:", SafetyMode::from_name).map(Reply::SafetyMode),
            Command::SafetyStatus => {
                mode(line, "Safetystatus:", SafetyMode::from_name).map(Reply::SafetyMode)
            }
            Command::ProgramState => program_state(line),
            // These identify the robot: garbage must not look like another one.
            Command::GetSerialNumber => text(line, "a serial number", is_serial),
            Command::GetRobotModel => text(line, "a model", is_model),
            Command::PolyscopeVersion | Command::Version => text(line, "a software version", is_version),
            other => Ok(match other.acceptance() {
                None => Reply::Text(line.to_string()),
                Some(sentence) if starts_with(line, sentence) => Reply::Accepted(line.to_string()),
                Some(_) => Reply::Refused(line.to_string()),
            }),
        }
    }

    /// The line to send in answer to `command`, with its end.
    pub fn line(&self, command: &Command) -> String {
        let text = match self {
            Reply::Accepted(text) | Reply::Refused(text) | Reply::NotUnderstood(text) | Reply::Text(text) => {
                text.clone()
            }
            Reply::NotAllowed => NOT_ALLOWED_TEXT.to_string(),
            Reply::Flag(flag) if *command == Command::Running => format!("Program running: {flag}"),
            Reply::Flag(flag) => flag.to_string(),
            Reply::RobotMode(mode) => format!("Robotmode: {}", mode.name()),
            Reply::SafetyMode(mode) if *command == Command::SafetyStatus => {
                format!("Safetystatus: {}", mode.name())
            }
            Reply::SafetyMode(mode) => format!("Safetymode: {}", mode.name()),
            Reply::ProgramState { state, program } => format!("{state} {program}"),
        };
        format!("{}\n", cut_text(text.split(['\n', '\r']).next().unwrap_or_default(), MAX_LINE - 1))
    }
}

fn starts_with(line: &str, start: &str) -> bool {
    line.get(..start.len()).is_some_and(|head| head.eq_ignore_ascii_case(start))
}

fn strip<'a>(line: &'a str, start: &str) -> Option<&'a str> {
    starts_with(line, start).then(|| line[start.len()..].trim())
}

fn unexpected(field: &'static str, line: &str, expected: &'static str) -> WireError {
    WireError::Unexpected { field, offset: 0, found: format!("{:?}", cut_text(line, 80)), expected }
}

fn flag(text: Option<&str>) -> Result<Reply, WireError> {
    match text {
        Some(text) if text.eq_ignore_ascii_case("true") => Ok(Reply::Flag(true)),
        Some(text) if text.eq_ignore_ascii_case("false") => Ok(Reply::Flag(false)),
        other => Err(unexpected("reply", other.unwrap_or_default(), "true or false")),
    }
}

fn mode<T>(line: &str, prefix: &str, from_name: fn(&str) -> Option<T>) -> Result<T, WireError> {
    strip(line, prefix).and_then(from_name).ok_or_else(|| unexpected("reply", line, "the name of a mode"))
}

fn text(line: &str, expected: &'static str, is_one: fn(&str) -> bool) -> Result<Reply, WireError> {
    let printable = !line.is_empty() && line.chars().all(|c| c.is_ascii_graphic() || c == ' ');
    match printable && is_one(line) {
        true => Ok(Reply::Text(line.to_string())),
        false => Err(unexpected("reply", line, expected)),
    }
}

fn is_serial(line: &str) -> bool {
    let digits = line.contains(|c: char| c.is_ascii_digit());
    digits
        && !starts_with(line, "UR")
        && line.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

/// Rejects a version that arrives as the answer to this question.
fn is_model(line: &str) -> bool {
    starts_with(line, "UR") && !starts_with(line, "URSoftware")
}

fn is_version(line: &str) -> bool {
    let has_parts = |pair: &[u8]| pair[0].is_ascii_digit() && pair[1] == b'.';
    line.as_bytes().windows(2).any(has_parts)
}

fn program_state(line: &str) -> Result<Reply, WireError> {
    let states = [ProgramState::Stopped, ProgramState::Playing, ProgramState::Paused];
    let (word, program) = line.split_once(' ').unwrap_or((line, ""));
    match states.into_iter().find(|state| state.as_str().eq_ignore_ascii_case(word)) {
        Some(state) => Ok(Reply::ProgramState { state, program: program.to_string() }),
        None => Err(unexpected("program state", line, "STOPPED, PLAYING or PAUSED")),
    }
}

#[cfg(test)]
mod tests {
    //! A failure of a golden line here means the wire changed.
    use super::*;
    use proptest::prelude::*;

    #[track_caller]
    fn check(line: &str, command: Command, reply_line: &str, reply: Reply) {
        assert_eq!(Command::parse(line), command, "the wire changed");
        assert_eq!(command.line(), format!("{line}\n"), "the wire changed");
        assert_eq!(Reply::parse(&command, reply_line).unwrap(), reply, "the wire changed");
        assert_eq!(reply.line(&command), format!("{reply_line}\n"), "the wire changed");
    }

    #[test]
    fn golden_lines() {
        for (verb, command, sentence) in PLAIN {
            if !sentence.is_empty() {
                check(verb, command.clone(), sentence, Reply::accepted(command));
            }
        }
        check("robotmode", Command::RobotMode, "Robotmode: POWER_OFF", Reply::RobotMode(RobotMode::PowerOff));
        check("safetymode", Command::SafetyMode, "Safetymode: NORMAL", Reply::SafetyMode(SafetyMode::Normal));
        check(
            "safetystatus",
            Command::SafetyStatus,
            "Safetystatus: FAULT",
            Reply::SafetyMode(SafetyMode::Fault),
        );
        check("running", Command::Running, "Program running: false", Reply::Flag(false));
        check("is in remote control", Command::IsInRemoteControl, "true", Reply::Flag(true));
        let state = Reply::ProgramState { state: ProgramState::Stopped, program: "<unnamed>".into() };
        check("programState", Command::ProgramState, "STOPPED <unnamed>", state);
        let serial = Reply::Text("20235500001".into());
        check("get serial number", Command::GetSerialNumber, "20235500001", serial);
        let load = Command::Load("a b.urp".into());
        let loading = "Loading program: /programs/a b.urp";
        check("load a b.urp", load.clone(), loading, Reply::Accepted(loading.into()));
        let missing = "File not found: a b.urp";
        check("load a b.urp", load, missing, Reply::Refused(missing.into()));
        let unlock = "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of \
                      protective stop before unlocking";
        check("unlock protective stop", Command::UnlockProtectiveStop, unlock, Reply::Refused(unlock.into()));
        check("power on", Command::PowerOn, NOT_ALLOWED_TEXT, Reply::NotAllowed);
        let sentence = "could not understand: dance";
        check("dance", Command::Unknown("dance".into()), sentence, Reply::not_understood("dance"));
    }

    #[test]
    fn verbs_come_in_any_case_and_do_not_run_into_words() {
        assert_eq!(Command::parse("POWER ON\r"), Command::PowerOn);
        assert_eq!(Command::parse("polyscopeversion"), Command::PolyscopeVersion);
        assert_eq!(Command::parse("loadx"), Command::Unknown("loadx".into()));
        assert_eq!(Command::parse("load installation x"), Command::LoadInstallation("x".into()));
        assert_eq!(Command::Popup("a\nstop".into()).line(), "popup a\n");
    }

    #[test]
    fn unknown_modes_are_errors() {
        assert!(Reply::parse(&Command::SafetyMode, "Safetymode: PARTY").is_err());
        assert!(Reply::parse(&Command::IsInRemoteControl, "maybe").is_err());
        assert!(Reply::parse(&Command::ProgramState, "DANCING x").is_err());
        assert!(Reply::parse(&Command::RobotMode, "").is_err());
    }

    #[test]
    fn garbage_and_the_answer_to_another_question_are_no_identity() {
        let answers = [
            (Command::GetSerialNumber, "20235500001"),
            (Command::GetRobotModel, "UR16"),
            (Command::PolyscopeVersion, "URSoftware 5.11.0.1031110 (Sep 30 2020)"),
            (Command::Version, "5.11"),
        ];
        let garbage = ["\u{fffd}7\u{fffd}.5y", "']y\u{1}", "", "true", "STOPPED", "Robotmode: RUNNING"];
        for (command, good) in &answers {
            assert_eq!(Reply::parse(command, good), Ok(Reply::Text((*good).into())));
            let versions = |of: &Command| matches!(of, Command::PolyscopeVersion | Command::Version);
            let others =
                answers.iter().filter(|(of, _)| of != command && !(versions(of) && versions(command)));
            for bad in others.map(|(_, answer)| answer).chain(&garbage) {
                assert!(Reply::parse(command, bad).is_err(), "{bad:?} to {command:?}");
            }
        }
    }

    #[test]
    fn lines_come_out_whole_and_bounded() {
        let mut splitter = LineSplitter::default();
        for byte in b"power on\r\n\nstop\n" {
            splitter.push(&[*byte]);
        }
        let mut lines = Vec::new();
        while let Some(line) = splitter.next_line().unwrap() {
            lines.push(line);
        }
        assert_eq!(lines, ["power on", "", "stop"]);
        splitter.push(&[b'x'; MAX_LINE + 1]);
        assert_eq!(splitter.next_line(), Err(WireError::LineTooLong { max: MAX_LINE }));
        assert_eq!(splitter.next_line(), Ok(None));
    }

    proptest! {
        #[test]
        fn foreign_lines_never_panic(line in "\\PC{0,60}", bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            let command = Command::parse(&line);
            let _ = command.line();
            let _ = Reply::parse(&command, &line).map(|reply| reply.line(&command));
            for (_, command, _) in PLAIN {
                let _ = Reply::parse(command, &line);
            }
            let mut splitter = LineSplitter::default();
            splitter.push(&bytes);
            while let Ok(Some(_)) = splitter.next_line() {}
        }
    }
}
