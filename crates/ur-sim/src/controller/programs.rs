//! The controller's program engine: one main program, secondary programs beside it, their start and end.
//!
//! In: compiled uploads, play, pause and stop. Out: runtime state, and the key, error and exception messages
//! of the primary interface. A new main program replaces the running one, whose STOPPED message comes first;
//! a runtime exception comes before the STOPPED of its program. A secondary program has one frame. A program
//! whose script a PC hands out is stopped, as clients see it, until the script is there.

use crate::controller::builtins;
use crate::controller::core::{Core, DEFAULT_STOP};
use crate::controller::external_control::ScriptRequest;
use crate::controller::interpreter::{Joined, discard};
use crate::controller::interpreter_mode::Interpreter;
use crate::controller::pendant::LoadError;
use crate::controller::program_files::{ProgramSource, bare_name};
use crate::controller::watchdog::WatchdogAction;
use crate::motion::FRAME_SECONDS;
use crate::motion::path_offset::OffsetWish;
use std::collections::VecDeque;
use std::sync::Arc;
use ur_wire::dashboard::ProgramState;
use ur_wire::enumerations::RuntimeState;
use ur_wire::primary_message::{MessageBody, PROGRAM_STARTED, PROGRAM_STOPPED};
use urscript::ast::FunctionKind;
use urscript::code::Code;
use urscript::fault::{CompileError, RuntimeException};
use urscript::program::{Program, Progress};

/// Uploads that may wait for the next frame.
const MAX_UPLOADS: usize = 16;

/// Code of the error message for a program that cannot be started now.
const NOT_STARTED_CODE: i32 = 169;

#[derive(Debug)]
enum Run {
    Stopped,
    /// A PC hands out the loaded program's script.
    Fetching(ScriptRequest),
    Playing(Program),
    Paused {
        program: Program,
        by_safeguard: bool,
    },
}

/// What `play` starts.
#[derive(Clone, Debug)]
pub enum Loaded {
    /// This program.
    Script(Arc<Code>),
    /// What a PC hands out.
    ExternalControl {
        /// Its file without folders.
        file: String,
        /// Name or address of the PC.
        host: String,
        /// Its port.
        port: u16,
    },
}

/// The engine.
#[derive(Debug)]
pub struct Programs {
    run: Run,
    /// Each with the frame after which it starts.
    uploads: VecDeque<(u64, Result<Code, CompileError>)>,
    loaded: Option<Loaded>,
    /// Name of the main program that ran last or was loaded.
    last: Option<Arc<str>>,
    /// That one is the loaded one.
    is_loaded: bool,
    /// Statements of clients in the running one.
    joined: Option<Joined>,
    seed: u64,
    starts: u64,
    /// Frames so far, and frames that a main program takes to load.
    frame: u64,
    loads_for: u64,
    /// A fault: uploads do not start.
    deaf: bool,
}

impl Programs {
    /// Nothing loaded.
    pub fn new(seed: u64, loads_for_s: f64) -> Programs {
        let (run, uploads) = (Run::Stopped, VecDeque::new());
        let (loaded, last, joined) = (None, None, None);
        let loads_for = (loads_for_s / FRAME_SECONDS).round() as u64;
        let (is_loaded, starts, frame, deaf) = (false, 0, 0, false);
        Programs { run, uploads, loaded, last, is_loaded, joined, seed, starts, frame, loads_for, deaf }
    }

    /// Loads a program for `play`, as from the controller's files; one that runs ends.
    pub fn load(&mut self, program: Loaded, core: &mut Core) {
        self.stop(core);
        self.last = match &program {
            Loaded::Script(code) => Some(code.name.clone()),
            Loaded::ExternalControl { file, .. } => Some(file.as_str().into()),
        };
        self.loaded = Some(program);
        self.is_loaded = true;
    }

    /// Hands over an upload; it starts in the next frame, a main program once it is loaded. False if too
    /// many wait.
    pub fn upload(&mut self, code: Result<Code, CompileError>) -> bool {
        let room = self.uploads.len() < MAX_UPLOADS;
        if room && !self.deaf {
            let is_main = code.as_ref().is_ok_and(|code| code.kind != FunctionKind::Sec);
            self.uploads.push_back((self.frame + if is_main { self.loads_for } else { 0 }, code));
        }
        room
    }

    /// Lets uploads vanish without a word (a fault), or takes them again.
    pub fn set_deaf(&mut self, deaf: bool) {
        self.deaf = deaf;
    }

    /// Ends the main program with a runtime exception where it is (a fault); false if there is none.
    pub fn fail(&mut self, core: &mut Core) -> bool {
        if let Run::Playing(program) | Run::Paused { program, .. } = &self.run {
            let (at, message) = (program.position(), "runtime exception by the fault injector".to_owned());
            core.message(exception_message(&RuntimeException { at, message }));
        }
        self.stop(core)
    }

    /// A main program is being stepped.
    pub fn playing(&self) -> bool {
        matches!(self.run, Run::Playing(_))
    }

    /// A main program waits.
    pub fn paused(&self) -> bool {
        matches!(self.run, Run::Paused { .. })
    }

    /// As clients see it.
    pub fn runtime_state(&self) -> RuntimeState {
        match self.run {
            Run::Stopped | Run::Fetching(_) => RuntimeState::Stopped,
            Run::Playing(_) => RuntimeState::Playing,
            Run::Paused { .. } => RuntimeState::Paused,
        }
    }

    /// The same in the three words of dashboard and Robot API.
    pub fn program_state(&self) -> ProgramState {
        match self.run {
            Run::Stopped | Run::Fetching(_) => ProgramState::Stopped,
            Run::Playing(_) => ProgramState::Playing,
            Run::Paused { .. } => ProgramState::Paused,
        }
    }

    /// Name of the main program, if there is one.
    pub fn name(&self) -> Option<&str> {
        match &self.run {
            Run::Playing(program) | Run::Paused { program, .. } => Some(program.name()),
            Run::Stopped | Run::Fetching(_) => self.last.as_deref(),
        }
    }

    /// The main program, running or the last that ran, is the one that was loaded.
    pub fn is_loaded(&self) -> bool {
        self.is_loaded
    }

    /// Line the main thread is in; 0 without a program.
    pub fn line(&self) -> u32 {
        match &self.run {
            Run::Playing(program) | Run::Paused { program, .. } => program.position().line,
            Run::Stopped | Run::Fetching(_) => 0,
        }
    }

    /// Pauses a running program; false if none runs.
    pub fn pause(&mut self) -> bool {
        self.pause_by(false)
    }

    /// Pauses a running program until the safeguard closes.
    pub fn pause_for_safeguard(&mut self) {
        self.pause_by(true);
    }

    fn pause_by(&mut self, by_safeguard: bool) -> bool {
        match std::mem::replace(&mut self.run, Run::Stopped) {
            Run::Playing(program) => {
                self.run = Run::Paused { program, by_safeguard };
                true
            }
            other => {
                self.run = other;
                false
            }
        }
    }

    /// Goes on with a program that the safeguard has paused.
    pub fn resume_after_safeguard(&mut self) {
        if matches!(self.run, Run::Paused { by_safeguard: true, .. }) {
            self.resume();
        }
    }

    fn resume(&mut self) -> bool {
        match std::mem::replace(&mut self.run, Run::Stopped) {
            Run::Paused { program, .. } => {
                self.run = Run::Playing(program);
                true
            }
            other => {
                self.run = other;
                false
            }
        }
    }

    /// The dashboard's `play`: goes on with a paused program or starts the loaded one. False if there is
    /// none or the arm is not ready. A script that came over a socket is not loaded, as on the controller.
    pub fn play(&mut self, core: &mut Core) -> bool {
        if !core.modes.brakes_open() || !core.modes.motion_allowed() {
            return false;
        }
        if self.resume() {
            return true;
        }
        match (&self.run, self.loaded.clone()) {
            (Run::Stopped, Some(Loaded::Script(code))) => {
                self.is_loaded = true;
                self.start(code, core);
                true
            }
            (Run::Stopped, Some(Loaded::ExternalControl { host, port, .. })) => {
                self.is_loaded = true;
                self.run = Run::Fetching(ScriptRequest::new(&host, port, &mut *core.sockets));
                true
            }
            _ => false,
        }
    }

    /// Ends the main program, and those that were sent before this and have not begun; false if none runs.
    pub fn cancel(&mut self, core: &mut Core) -> bool {
        let stays = |(_, upload): &(u64, Result<Code, CompileError>)| {
            upload.as_ref().map_or(true, |code| code.kind == FunctionKind::Sec)
        };
        self.uploads.retain(stays);
        self.stop(core)
    }

    /// Ends the main program; false if there is none.
    pub fn stop(&mut self, core: &mut Core) -> bool {
        match std::mem::replace(&mut self.run, Run::Stopped) {
            Run::Playing(mut program) | Run::Paused { mut program, .. } => {
                program.stop(core);
                ended(&program, core);
                true
            }
            Run::Fetching(request) => {
                request.cancel(&mut *core.sockets);
                true
            }
            Run::Stopped => false,
        }
    }

    /// A client's line for interpreter mode; the reply.
    pub fn interpret(&mut self, text: &str, core: &mut Core) -> String {
        let (Run::Playing(program) | Run::Paused { program, .. }) = &mut self.run else {
            return discard("no program is running", text);
        };
        self.joined.get_or_insert_with(|| Joined::to(program)).line(text, program, core)
    }

    /// One frame: starts what was uploaded, then steps the main program.
    pub fn run(&mut self, core: &mut Core) {
        self.frame += 1;
        let due = self.frame;
        while self.uploads.front().is_some_and(|(from, _)| *from < due)
            && let Some((_, upload)) = self.uploads.pop_front()
        {
            match upload {
                Ok(code) if code.kind == FunctionKind::Sec => self.run_secondary(code, core),
                Ok(code) => self.replace(code, core),
                Err(error) => complain(&error, core),
            }
        }
        self.fetch(core);
        let Run::Playing(program) = &mut self.run else { return };
        let progress = program.frame(core);
        core.settle_orphaned_motion();
        match &mut self.joined {
            Some(joined) => joined.settle(program, core),
            None => core.interpreter.nothing_to_settle(),
        }
        match progress {
            Progress::Running => self.watch(core),
            Progress::Paused => {
                self.pause();
            }
            Progress::Finished => {
                self.stop(core);
            }
            Progress::Failed(exception) => {
                core.message(exception_message(&exception));
                self.stop(core);
            }
        }
    }

    /// Starts what a PC has handed out once it is there.
    fn fetch(&mut self, core: &mut Core) {
        let Run::Fetching(request) = &mut self.run else { return };
        let Some(Loaded::ExternalControl { file, .. }) = &self.loaded else { return };
        let Some(text) = request.step(file, &mut *core.sockets) else { return };
        self.run = Run::Stopped;
        match builtins::compile_program(&text) {
            Ok(code) => self.replace(code, core),
            Err(error) => complain(&error, core),
        }
        self.is_loaded = true;
    }

    fn watch(&mut self, core: &mut Core) {
        match core.watchdog_action() {
            None => {}
            Some(WatchdogAction::Pause) => {
                self.pause();
            }
            Some(WatchdogAction::Stop) => {
                self.stop(core);
            }
        }
    }

    fn replace(&mut self, code: Code, core: &mut Core) {
        if !core.modes.brakes_open() || !core.modes.motion_allowed() {
            core.error_message(NOT_STARTED_CODE, 0, "the program was not started: the robot is not running");
            return;
        }
        self.stop(core);
        self.is_loaded = false;
        self.start(Arc::new(code), core);
    }

    fn start(&mut self, code: Arc<Code>, core: &mut Core) {
        self.starts += 1;
        core.message(key_message(PROGRAM_STARTED, &code.name));
        self.last = Some(code.name.clone());
        self.joined = None;
        self.run = Run::Playing(Program::new(code, self.seed.wrapping_add(self.starts)));
    }

    fn run_secondary(&mut self, code: Code, core: &mut Core) {
        self.starts += 1;
        let mut program = Program::new(Arc::new(code), self.seed.wrapping_add(self.starts));
        core.secondary = true;
        let progress = program.frame(core);
        let at = program.position();
        program.stop(core);
        core.secondary = false;
        match progress {
            Progress::Finished => {}
            Progress::Failed(exception) => core.message(exception_message(&exception)),
            Progress::Running | Progress::Paused => {
                let message = "a secondary program must not take time".to_owned();
                core.message(exception_message(&RuntimeException { at, message }));
            }
        }
    }
}

impl Core {
    /// Finds the program of a `.urp` file and compiles its script, if it has one.
    ///
    /// # Errors
    /// There is no file of that name, or its script cannot be compiled.
    pub fn open_program(&mut self, file: &str) -> Result<Loaded, LoadError> {
        let (path, source) = self.config.programs.find(file).ok_or(LoadError::NotFound)?;
        let program = open_source(path, source)?;
        self.pendant.program = Some(path.to_owned());
        Ok(program)
    }
}

/// Compiles the script of a program's file, if it has one.
///
/// # Errors
/// The script cannot be compiled.
pub fn open_source(path: &str, source: &ProgramSource) -> Result<Loaded, LoadError> {
    Ok(match source {
        ProgramSource::Script(text) => {
            Loaded::Script(Arc::new(builtins::compile_program(text).map_err(|_| LoadError::Wrong)?))
        }
        ProgramSource::ExternalControl { host, port } => {
            Loaded::ExternalControl { file: bare_name(path).to_owned(), host: host.clone(), port: *port }
        }
    })
}

/// What follows the end of a main program, however it came: the arm brakes, waits end.
fn ended(program: &Program, core: &mut Core) {
    core.message(key_message(PROGRAM_STOPPED, program.name()));
    core.owner = None;
    core.orphaned = false;
    core.interpreter = Interpreter::default();
    core.watchdogs.clear();
    core.requests.clear();
    core.compliance = None;
    core.sockets.close_all();
    core.conveyor = None;
    let away = core.mover.tracks() || core.mover.is_offset();
    *core.mover.offset() = OffsetWish::default();
    if away && !core.mover.stands() {
        core.mover.leave_carrier(DEFAULT_STOP);
    } else if core.mover.stands() {
        // A move that was paused must not go on under the next program.
        core.mover.freeze();
    } else {
        core.mover.stop_joints(DEFAULT_STOP);
    }
}

fn complain(error: &CompileError, core: &mut Core) {
    let exception = RuntimeException { at: error.at, message: error.controller_text() };
    core.message(exception_message(&exception));
}

fn key_message(title: &str, name: &str) -> MessageBody {
    MessageBody::Key { code: 0, argument: 0, title: title.to_owned(), text: name.to_owned() }
}

fn exception_message(exception: &RuntimeException) -> MessageBody {
    MessageBody::RuntimeException {
        line: i32::try_from(exception.at.line).unwrap_or(i32::MAX),
        column: i32::try_from(exception.at.column).unwrap_or(i32::MAX),
        text: exception.message.clone(),
    }
}
