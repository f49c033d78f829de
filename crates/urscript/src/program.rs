//! A running program: its threads, the scheduler that gives each a slice of every frame, and the critical
//! section.
//!
//! In: compiled code, a host, and one call of [`Program::frame`] per controller frame (2 ms). Out: whether
//! it runs on, ended, or failed with a runtime exception. Threads take turns in the order in which they were
//! started; a thread that becomes ready in a frame (joined, handed the critical section, just started) still
//! runs in it. A slice longer than [`SLICE`] instructions without a call that waits is an endless loop
//! and an exception, as the controller aborts a program that does not let time pass; with one the thread
//! goes on in the next frame: what it reads may come in faster than it can read. The critical section is
//! a lock that is handed on in the order of request, with sleeping allowed inside. While its holder waits
//! in a built-in (a motion, a socket) or joins a thread the section is lent to a thread that requests it:
//! deployed scripts run whole trajectories within it and still read their orders, a cancellation among
//! them, in another one, and wait within it for the end of a thread that has one more round in it to go.

use crate::code::Code;
use crate::fault::{Position, RuntimeException};
use crate::host::Host;
use crate::library::Random;
use crate::thread::{Event, Shared, Thread};
use crate::value::{ThreadId, Value};
use std::collections::VecDeque;
use std::sync::Arc;

/// Instructions a thread may take in one frame.
pub const SLICE: u32 = 100_000;

/// Instructions that all threads of a program may take together in one frame: a thread that starts others
/// and joins them gets no more of the frame with each of them.
const FRAME_SLICE: u32 = 10 * SLICE;

/// Threads that may live at once.
const MAX_THREADS: usize = 64;

/// The thread of the program's own function.
const MAIN: ThreadId = ThreadId(1);

/// What became of a program in a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// It goes on.
    Running,
    /// It came to `pause`; its next frame goes on behind it.
    Paused,
    /// It came to its end or to `halt`.
    Finished,
    /// It broke off.
    Failed(RuntimeException),
}

/// What a thread waits for.
#[derive(Debug, PartialEq)]
enum Wait {
    Nothing,
    Frames(u64),
    Thread(ThreadId),
    Critical,
    /// The host's answer, polled once per frame.
    Host,
    /// The next statement that joins the program.
    Statement,
}

#[derive(Debug)]
struct Scheduled {
    thread: Thread,
    wait: Wait,
    /// Had its turn in this frame and let time pass.
    done: bool,
    budget: u32,
    /// How often it had entered the critical section that it lent when it began to wait.
    lent: u32,
}

impl Scheduled {
    /// Runs the thread within its own budget and what the frame has `left` for all.
    fn run(
        &mut self,
        shared: &mut Shared,
        host: &mut dyn Host,
        left: &mut u32,
    ) -> Result<Event, RuntimeException> {
        let most = self.budget.min(*left);
        let mut budget = most;
        let event = self.thread.run(shared, host, &mut budget);
        let used = most - budget;
        self.budget -= used;
        *left -= used;
        event
    }
}

/// A program and its threads.
#[derive(Debug)]
pub struct Program {
    shared: Shared,
    threads: Vec<Scheduled>,
    last_id: i32,
    /// Holder of the critical section, how often it entered, and who waits.
    holder: Option<(ThreadId, u32)>,
    queue: VecDeque<ThreadId>,
    /// A thread came to `pause` in this frame.
    pausing: bool,
    /// Instructions that this frame has left for all threads.
    left: u32,
    statements: Statements,
}

/// Statements that joined the program while it runs.
#[derive(Debug, Default)]
struct Statements {
    /// Number of a statement, and its function; the next first.
    waiting: VecDeque<(u64, usize)>,
    /// The last one that began.
    begun: u64,
    /// The thread that carries them out.
    thread: Option<ThreadId>,
}

impl Program {
    /// A program at its beginning. `seed` is that of `random()`.
    pub fn new(code: Arc<Code>, seed: u64) -> Program {
        let main = Thread::new(MAIN, None, &code, 0, Vec::new());
        let globals = vec![None; code.scope.globals.count()];
        let shared = Shared { code, globals, random: Random::new(seed) };
        let main = Scheduled { thread: main, wait: Wait::Nothing, done: false, budget: SLICE, lent: 0 };
        Program {
            shared,
            threads: vec![main],
            last_id: 1,
            holder: None,
            queue: VecDeque::new(),
            pausing: false,
            left: FRAME_SLICE,
            statements: Statements::default(),
        }
    }

    /// The code that it runs.
    pub fn code(&self) -> &Arc<Code> {
        &self.shared.code
    }

    /// Lets a statement join: `function` of `code`, which has all that the program's code has. It begins
    /// when those before it are done and the host takes statements.
    pub fn join(&mut self, code: Arc<Code>, statement: u64, function: usize) {
        let globals = code.scope.globals.count().max(self.shared.globals.len());
        self.shared.globals.resize(globals, None);
        self.shared.code = code;
        self.statements.waiting.push_back((statement, function));
    }

    /// Number of the last statement that began, 0 for none; and how many wait.
    pub fn statements(&self) -> (u64, usize) {
        (self.statements.begun, self.statements.waiting.len())
    }

    /// Drops the statements that wait.
    pub fn skip_statements(&mut self) {
        self.statements.waiting.clear();
    }

    /// Ends the threads that statements have started, and those that these have.
    pub fn end_started(&mut self, host: &mut dyn Host) {
        let Some(statements) = self.statements.thread else { return };
        let by_statements = |scheduled: &&Scheduled| scheduled.thread.parent == Some(statements);
        let started: Vec<ThreadId> = self.threads.iter().filter(by_statements).map(|s| s.thread.id).collect();
        started.into_iter().for_each(|id| self.kill(id, host));
    }

    /// Empties the variables that `base`, the program without statements, does not have. True if the program
    /// is `base` again: nothing that statements have declared runs or waits.
    pub fn forget_statements(&mut self, base: &Arc<Code>) -> bool {
        let own = base.scope.globals.count();
        self.shared.globals.iter_mut().skip(own).for_each(|variable| *variable = None);
        let used = |scheduled: &Scheduled| scheduled.thread.within(base.functions.len());
        let over = self.statements.waiting.is_empty() && !self.threads.iter().any(used);
        if over {
            self.shared.code = base.clone();
            self.shared.globals.truncate(own);
        }
        over
    }

    /// The program's name.
    pub fn name(&self) -> &Arc<str> {
        &self.shared.code.name
    }

    /// Where the main thread is.
    pub fn position(&self) -> Position {
        self.threads.first().map_or(Position::START, |main| main.thread.position(&self.shared.code))
    }

    /// Threads alive, the main one included.
    pub fn thread_count(&self) -> usize {
        self.threads.len()
    }

    /// Gives every thread its slice of one frame.
    pub fn frame(&mut self, host: &mut dyn Host) -> Progress {
        self.left = FRAME_SLICE;
        for scheduled in &mut self.threads {
            scheduled.done = false;
            scheduled.budget = SLICE;
            scheduled.thread.waits = 0;
            if let Wait::Frames(left) = &mut scheduled.wait {
                *left = left.saturating_sub(1);
            }
        }
        loop {
            match self.round(host) {
                Ok(Round::Moved) => {}
                Ok(Round::Still) if std::mem::take(&mut self.pausing) => return Progress::Paused,
                Ok(Round::Still) => return Progress::Running,
                Ok(Round::Ended) => {
                    self.stop(host);
                    return Progress::Finished;
                }
                Err(exception) => {
                    self.stop(host);
                    return Progress::Failed(exception);
                }
            }
        }
    }

    /// Ends all threads.
    pub fn stop(&mut self, host: &mut dyn Host) {
        for scheduled in std::mem::take(&mut self.threads) {
            abandon(&scheduled, host);
        }
        self.holder = None;
        self.queue.clear();
    }

    /// One turn for each thread that can run.
    fn round(&mut self, host: &mut dyn Host) -> Result<Round, RuntimeException> {
        let mut moved = host.takes_statements() && self.begin_statement();
        let mut index = 0;
        while let Some(id) = self.threads.get(index).map(|scheduled| scheduled.thread.id) {
            if self.ready(index) {
                moved = true;
                if self.turn(index, host)? {
                    return Ok(Round::Ended);
                }
            }
            // A kill may have shortened the list: go on behind the thread that just ran.
            index = self.threads.iter().position(|s| s.thread.id > id).unwrap_or(self.threads.len());
        }
        Ok(if moved { Round::Moved } else { Round::Still })
    }

    /// The thread of statements takes the next one, if it is done with the last; true if it does.
    fn begin_statement(&mut self) -> bool {
        let Some(&(number, function)) = self.statements.waiting.front() else { return false };
        let id = *self.statements.thread.get_or_insert_with(|| {
            self.last_id = self.last_id.wrapping_add(1).max(2);
            ThreadId(self.last_id)
        });
        let place = self.threads.iter().position(|scheduled| scheduled.thread.id == id);
        let index = place.unwrap_or_else(|| {
            let thread = Thread::idle(id);
            let wait = Wait::Statement;
            self.threads.push(Scheduled { thread, wait, done: false, budget: SLICE, lent: 0 });
            self.threads.len() - 1
        });
        let Some(scheduled) = self.threads.get_mut(index) else { return false };
        // A slice that is used up by many short statements is no endless loop.
        if scheduled.wait != Wait::Statement || scheduled.done || scheduled.budget < SLICE / 2 {
            return false;
        }
        scheduled.thread.order(&self.shared.code, function);
        scheduled.wait = Wait::Nothing;
        self.statements.waiting.pop_front();
        self.statements.begun = number;
        true
    }

    fn ready(&self, index: usize) -> bool {
        let Some(scheduled) = self.threads.get(index).filter(|scheduled| !scheduled.done) else {
            return false;
        };
        match &scheduled.wait {
            Wait::Nothing | Wait::Frames(0) => true,
            Wait::Host => scheduled.lent == 0 || self.holder.is_none(),
            Wait::Frames(_) | Wait::Statement => false,
            Wait::Thread(other) => !self.alive(*other) && (scheduled.lent == 0 || self.holder.is_none()),
            Wait::Critical => self.holder.is_some_and(|(holder, _)| holder == scheduled.thread.id),
        }
    }

    fn alive(&self, id: ThreadId) -> bool {
        self.threads.iter().any(|scheduled| scheduled.thread.id == id)
    }

    /// Runs one thread until it lets time pass, waits or ends; true if the program ended.
    fn turn(&mut self, index: usize, host: &mut dyn Host) -> Result<bool, RuntimeException> {
        let Some(id) = self.threads.get(index).map(|scheduled| scheduled.thread.id) else { return Ok(false) };
        // Events that let no time pass keep the turn; a kill may move the thread within the list.
        while let Some(index) = self.threads.iter().position(|scheduled| scheduled.thread.id == id) {
            match self.run_to_event(index, host)? {
                Turn::Kept => {}
                Turn::Over => return Ok(false),
                Turn::ProgramEnded => return Ok(true),
            }
        }
        Ok(false)
    }

    fn run_to_event(&mut self, index: usize, host: &mut dyn Host) -> Result<Turn, RuntimeException> {
        let Some(scheduled) = self.threads.get_mut(index) else { return Ok(Turn::Over) };
        scheduled.wait = Wait::Nothing;
        let id = scheduled.thread.id;
        if scheduled.lent > 0 {
            self.holder = Some((id, std::mem::take(&mut scheduled.lent)));
        }
        match scheduled.run(&mut self.shared, host, &mut self.left)? {
            Event::Sleep(frames) => {
                scheduled.wait = Wait::Frames(frames);
                scheduled.done = true;
                return Ok(Turn::Over);
            }
            Event::Waiting => {
                scheduled.wait = Wait::Host;
                scheduled.done = true;
                self.lend(index);
                return Ok(Turn::Over);
            }
            Event::Join(other) => {
                scheduled.wait = Wait::Thread(other);
                if self.alive(other) {
                    self.lend(index);
                }
                return Ok(Turn::Over);
            }
            Event::Spawn(function, parameters) => self.spawn(index, function, parameters)?,
            Event::Kill(other) => {
                self.kill(other, host);
                return Ok(if self.alive(MAIN) { Turn::Kept } else { Turn::ProgramEnded });
            }
            Event::EnterCritical => {
                return Ok(if self.enter_critical(index) { Turn::Kept } else { Turn::Over });
            }
            Event::ExitCritical => return self.exit_critical(index),
            Event::Halt => return Ok(Turn::ProgramEnded),
            // The other threads have the rest of this frame, as with a pause from outside.
            Event::Pause => {
                self.pausing = true;
                scheduled.done = true;
                return Ok(Turn::Over);
            }
            Event::Finished if self.statements.thread == Some(id) => {
                scheduled.wait = Wait::Statement;
                return Ok(Turn::Over);
            }
            Event::Finished => {
                self.kill(id, host);
                return Ok(if id == MAIN { Turn::ProgramEnded } else { Turn::Over });
            }
            Event::Exhausted if scheduled.thread.waits > 0 => {
                scheduled.done = true;
                return Ok(Turn::Over);
            }
            Event::Exhausted => return Err(self.endless(index)),
        }
        Ok(Turn::Kept)
    }

    fn endless(&self, index: usize) -> RuntimeException {
        let most = if self.left == 0 { FRAME_SLICE } else { SLICE };
        self.exception(index, format!("endless loop: {most} instructions without letting time pass"))
    }

    fn exception(&self, index: usize, message: String) -> RuntimeException {
        let at = self.threads.get(index).map_or(Position::START, |s| s.thread.position(&self.shared.code));
        RuntimeException { at, message }
    }

    fn spawn(
        &mut self,
        parent: usize,
        function: usize,
        parameters: Vec<Option<Value>>,
    ) -> Result<(), RuntimeException> {
        if self.threads.len() >= MAX_THREADS {
            return Err(self.exception(parent, format!("more than {MAX_THREADS} threads")));
        }
        let Some(by) = self.threads.get_mut(parent) else { return Ok(()) };
        self.last_id = self.last_id.wrapping_add(1).max(2);
        let id = ThreadId(self.last_id);
        by.thread.push(Value::Thread(id));
        let thread = Thread::new(id, Some(by.thread.id), &self.shared.code, function, parameters);
        self.threads.push(Scheduled { thread, wait: Wait::Nothing, done: false, budget: SLICE, lent: 0 });
        Ok(())
    }

    /// Ends a thread and, first, its children; a thread that is not alive is none of our business.
    fn kill(&mut self, id: ThreadId, host: &mut dyn Host) {
        let mut doomed = vec![id];
        while let Some(victim) = doomed.pop() {
            let children = self.threads.iter().filter(|s| s.thread.parent == Some(victim));
            doomed.extend(children.map(|s| s.thread.id));
            let Some(index) = self.threads.iter().position(|s| s.thread.id == victim) else { continue };
            abandon(&self.threads.remove(index), host);
            self.queue.retain(|waiting| *waiting != victim);
            if self.holder.is_some_and(|(holder, _)| holder == victim) {
                self.holder = None;
                self.hand_on();
            }
        }
    }

    /// True if the thread holds the section now; else it queues.
    fn enter_critical(&mut self, index: usize) -> bool {
        let Some(scheduled) = self.threads.get_mut(index) else { return false };
        let id = scheduled.thread.id;
        match &mut self.holder {
            None => self.holder = Some((id, 1)),
            Some((holder, depth)) if *holder == id => *depth = depth.saturating_add(1),
            Some(_) => {
                scheduled.wait = Wait::Critical;
                self.queue.push_back(id);
                return false;
            }
        }
        true
    }

    /// Lends the section, if this thread holds it, until the thread goes on.
    fn lend(&mut self, index: usize) {
        let Some(scheduled) = self.threads.get_mut(index) else { return };
        let id = scheduled.thread.id;
        if let Some((_, depth)) = self.holder.filter(|(holder, _)| *holder == id) {
            scheduled.lent = depth;
            self.hand_on();
        }
    }

    /// The thread leaves the section, or one of its nestings.
    fn exit_critical(&mut self, index: usize) -> Result<Turn, RuntimeException> {
        let id = self.threads.get(index).map(|scheduled| scheduled.thread.id);
        match &mut self.holder {
            Some((holder, depth)) if Some(*holder) == id && *depth > 1 => *depth -= 1,
            Some((holder, _)) if Some(*holder) == id => {
                self.holder = None;
                self.hand_on();
            }
            _ => return Err(self.exception(index, "exit_critical without enter_critical".to_owned())),
        }
        // The lender goes on as soon as it is free: not only if no thread takes it again at once.
        let lender_waits = self.holder.is_none() && self.threads.iter().any(|other| other.lent > 0);
        Ok(if lender_waits { Turn::Over } else { Turn::Kept })
    }

    fn hand_on(&mut self) {
        self.holder = self.queue.pop_front().map(|id| (id, 1));
    }
}

/// How a thread's turn went on.
enum Turn {
    Kept,
    Over,
    ProgramEnded,
}

enum Round {
    Moved,
    Still,
    Ended,
}

fn abandon(scheduled: &Scheduled, host: &mut dyn Host) {
    if let Some(pending) = &scheduled.thread.pending {
        host.abandoned(scheduled.thread.id, pending.builtin.name);
    }
}

#[cfg(test)]
pub(crate) mod tests;
