//! Interpreter mode: statements that a client adds to the running program.
//!
//! In: lines of clients on port 30020, and the script functions that belong to the mode. Out: one reply a
//! line: `ack: ID: STATEMENT` for a statement that was taken, `discard: REASON: STATEMENT` for one that was
//! not, `state: ID: WORD` to a question. A statement is taken while a program runs, and carried out once the
//! program is in `interpreter_mode()` and those before it are done; it sees and changes the variables of the
//! program's first level. Assumed where the manual's words are not at hand: reasons, the replies to
//! `skipbuffer` and `abort`, that identifiers begin at 1 with each program, and the number of statements
//! between two calls of `clear_interpreter()`.

use crate::controller::builtins::compile_statement;
use crate::controller::core::{Core, DEFAULT_STOP};
use crate::controller::interpreter_mode::Interpreter;
use std::sync::Arc;
use urscript::code::Code;
use urscript::extend::forget;
use urscript::host::{Call, Reply};
use urscript::program::Program;
use urscript::value::{ThreadId, Value};

/// Statements that are taken until `clear_interpreter()`.
pub const MAX_STATEMENTS: usize = 2000;

/// The statement after which new ones see the program as it was without any.
const CLEAR: &str = "clear_interpreter()";

/// The thread of the program's own function, which alone may enter the mode.
const MAIN: ThreadId = ThreadId(1);

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Reply, String>> {
    let mode = &mut core.interpreter;
    let done = || Some(Ok(Reply::Value(Value::Nothing)));
    match call.name {
        "interpreter_mode" if core.secondary || call.thread != MAIN => {
            Some(Err("interpreter_mode: only the main thread may enter interpreter mode".to_owned()))
        }
        "interpreter_mode" if call.frames == 0 => {
            let flag = |index: usize| call.argument(index).map_or(Ok(true), Value::truth);
            Some(flag(0).and_then(|skip| {
                *mode = Interpreter { active: true, skip, clear_on_end: flag(1)?, ..Interpreter::default() };
                Ok(Reply::Wait)
            }))
        }
        "interpreter_mode" if mode.ending => {
            *mode = Interpreter { clear: mode.clear_on_end, ..Interpreter::default() };
            done()
        }
        "interpreter_mode" => Some(Ok(Reply::Wait)),
        "end_interpreter" => {
            mode.ending = mode.active;
            done()
        }
        "clear_interpreter" => {
            mode.clear = true;
            done()
        }
        _ => None,
    }
}

/// The statements that have joined a running program.
#[derive(Debug)]
pub struct Joined {
    /// The program without them.
    base: Arc<Code>,
    /// What the next one is added to.
    scope: Arc<Code>,
    last: u64,
    cleared: u64,
    since_clear: usize,
}

impl Joined {
    /// None yet.
    pub fn to(program: &Program) -> Joined {
        let base = program.code().clone();
        Joined { scope: base.clone(), base, last: 0, cleared: 0, since_clear: 0 }
    }

    /// Carries out a client's line; the reply.
    pub fn line(&mut self, text: &str, program: &mut Program, core: &mut Core) -> String {
        let (begun, waiting) = program.statements();
        match text {
            "skipbuffer" => {
                program.skip_statements();
                format!("ack: {}: {text}", self.last)
            }
            "abort" => {
                if core.mover.busy() {
                    core.mover.stop_joints(DEFAULT_STOP);
                }
                format!("ack: {}: {text}", self.last)
            }
            "statelastexecuted" => format!("state: {begun}: {text}"),
            "statelastinterpreted" => format!("state: {}: {text}", self.last),
            "statelastcleared" => format!("state: {}: {text}", self.cleared),
            "stateunexecuted" => format!("state: {waiting}: {text}"),
            statement => self.statement(statement, program),
        }
    }

    fn statement(&mut self, text: &str, program: &mut Program) -> String {
        // One that makes room may wait behind the others, until it is carried out.
        let full = self.since_clear >= MAX_STATEMENTS && text != CLEAR;
        if full || program.statements().1 > MAX_STATEMENTS {
            return discard("too many statements, clear_interpreter() makes room", text);
        }
        let (code, function) = match compile_statement(&self.scope, text) {
            Ok(joined) => joined,
            Err(error) => return discard(&error.kind.to_string(), text),
        };
        self.since_clear += 1;
        self.last += 1;
        let next = if text == CLEAR { Arc::new(forget(&code, &self.base)) } else { Arc::new(code) };
        self.scope = next.clone();
        program.join(next, self.last, function);
        format!("ack: {}: {text}", self.last)
    }

    /// Carries out what scripts have requested in a frame.
    pub fn settle(&mut self, program: &mut Program, core: &mut Core) {
        if std::mem::take(&mut core.interpreter.skip) {
            program.skip_statements();
        }
        if std::mem::take(&mut core.interpreter.clear) {
            self.cleared = program.statements().0;
            program.end_started(core);
            let over = program.forget_statements(&self.base);
            self.scope = if over { self.base.clone() } else { Arc::new(forget(&self.scope, &self.base)) };
            self.since_clear = program.statements().1;
        }
    }
}

/// The reply to a line that is not taken.
pub fn discard(reason: &str, text: &str) -> String {
    format!("discard: {}: {text}", reason.replace(": ", ", "))
}
