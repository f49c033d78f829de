//! One thread of a running script: its calls, its stack, and what it waits for.
//!
//! In: the compiled code, the global variables and the host. Out: an `Event` whenever the thread needs the
//! scheduler (time passes, another thread is concerned, it ended). Bounded: instructions per frame, depth of
//! calls, size of values (`bounds`).

use crate::ast::Unary;
use crate::bounds::bounded;
use crate::code::{Code, Instruction};
use crate::fault::{Position, RuntimeException};
use crate::host::{Builtin, Call, Host, REMOTE_CALL, Reply};
use crate::library::{self, Random};
use crate::methods;
use crate::operators;
use crate::value::{ThreadId, Value};
use std::sync::Arc;

/// Deepest nesting of calls.
const MAX_CALLS: usize = 200;

/// Calls that let time pass as a rule, of which a thread makes no more in a frame when they let none pass.
const MAX_WAITS: u32 = 100;

/// Length of a controller frame, s.
pub const FRAME_SECONDS: f64 = 0.002;

/// What a program's threads have in common.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) code: Arc<Code>,
    pub(crate) globals: Vec<Option<Value>>,
    pub(crate) random: Random,
}

/// Why a thread came back to the scheduler.
#[derive(Debug)]
pub(crate) enum Event {
    /// Sleeps for that many frames.
    Sleep(u64),
    /// A built-in is not done; it is in the thread's `pending`.
    Waiting,
    /// A new thread with this function and its parameters.
    Spawn(usize, Vec<Option<Value>>),
    Kill(ThreadId),
    Join(ThreadId),
    EnterCritical,
    ExitCritical,
    Halt,
    Pause,
    /// The thread's function returned.
    Finished,
    /// The slice is used up.
    Exhausted,
}

/// A call of the host that is not answered yet.
#[derive(Debug)]
pub(crate) struct Pending {
    pub(crate) builtin: &'static Builtin,
    arguments: Vec<Option<Value>>,
    frames: u64,
    note: u64,
}

#[derive(Debug)]
struct Activation {
    function: usize,
    next: usize,
    locals: Vec<Option<Value>>,
}

/// A thread's own state.
#[derive(Debug)]
pub(crate) struct Thread {
    pub(crate) id: ThreadId,
    pub(crate) parent: Option<ThreadId>,
    pub(crate) pending: Option<Pending>,
    /// Calls in this frame that let time pass as a rule.
    pub(crate) waits: u32,
    calls: Vec<Activation>,
    stack: Vec<Value>,
    /// Memory of arguments that is used again.
    spare: Vec<Option<Value>>,
}

impl Thread {
    /// A thread at the start of `function`.
    pub(crate) fn new(
        id: ThreadId,
        parent: Option<ThreadId>,
        code: &Code,
        function: usize,
        parameters: Vec<Option<Value>>,
    ) -> Thread {
        let mut thread = Thread { parent, ..Thread::idle(id) };
        thread.enter(code, function, parameters);
        thread
    }

    /// A thread that has nothing to do yet.
    pub(crate) fn idle(id: ThreadId) -> Thread {
        let (calls, stack, spare) = (Vec::new(), Vec::new(), Vec::new());
        Thread { id, parent: None, pending: None, waits: 0, calls, stack, spare }
    }

    /// Where the instruction that runs comes from.
    pub(crate) fn position(&self, code: &Code) -> Position {
        let call = self.calls.last();
        call.and_then(|call| code.functions.get(call.function)?.positions.get(call.next.saturating_sub(1)))
            .copied()
            .unwrap_or(Position::START)
    }

    /// Calls a function of a thread that is done with the last one.
    pub(crate) fn order(&mut self, code: &Code, function: usize) {
        self.stack.clear();
        self.enter(code, function, Vec::new());
    }

    /// It is within a function with this number or a higher one.
    pub(crate) fn within(&self, function: usize) -> bool {
        self.calls.iter().any(|call| call.function >= function)
    }

    /// Hands a value to the thread as the result of what it waited for.
    pub(crate) fn push(&mut self, value: Value) {
        self.stack.push(value);
    }

    /// Runs until an event, at most `budget` instructions.
    pub(crate) fn run(
        &mut self,
        shared: &mut Shared,
        host: &mut dyn Host,
        budget: &mut u32,
    ) -> Result<Event, RuntimeException> {
        let code = shared.code.clone();
        self.run_inner(&code, shared, host, budget)
            .map_err(|message| RuntimeException { at: self.position(&code), message })
    }

    fn run_inner(
        &mut self,
        code: &Code,
        shared: &mut Shared,
        host: &mut dyn Host,
        budget: &mut u32,
    ) -> Result<Event, String> {
        if self.pending.is_some() && !self.poll(host)? {
            return Ok(Event::Waiting);
        }
        loop {
            if *budget == 0 || self.waits >= MAX_WAITS {
                return Ok(Event::Exhausted);
            }
            *budget -= 1;
            let Some(call) = self.calls.last_mut() else { return Ok(Event::Finished) };
            let instruction = code.functions.get(call.function).and_then(|f| f.instructions.get(call.next));
            let Some(instruction) = instruction else { return Ok(Event::Finished) };
            call.next += 1;
            if let Some(event) = self.execute(instruction, code, shared, host)? {
                return Ok(event);
            }
        }
    }

    /// Polls the host again; true if it answered.
    fn poll(&mut self, host: &mut dyn Host) -> Result<bool, String> {
        let Some(mut pending) = self.pending.take() else { return Ok(true) };
        let call = Call {
            name: pending.builtin.name,
            arguments: &pending.arguments,
            thread: self.id,
            frames: pending.frames,
            note: &mut pending.note,
        };
        let value = match host.call(call)? {
            Reply::Value(value) => value,
            Reply::Waited(value) => {
                self.waits += 1;
                value
            }
            Reply::Wait => {
                pending.frames += 1;
                self.pending = Some(pending);
                return Ok(false);
            }
        };
        self.stack.push(value);
        self.keep(pending.arguments);
        Ok(true)
    }

    fn execute(
        &mut self,
        instruction: &Instruction,
        code: &Code,
        shared: &mut Shared,
        host: &mut dyn Host,
    ) -> Result<Option<Event>, String> {
        match instruction {
            Instruction::Constant(value) => self.stack.push(value.clone()),
            Instruction::Load(variable) => {
                let value = self.load(variable, shared)?;
                self.stack.push(value);
            }
            Instruction::Store(variable, qualifier) => self.store(variable, *qualifier, shared)?,
            Instruction::StoreInto(variable, qualifier, path) => {
                self.store_into(variable, *qualifier, path, shared)?;
            }
            Instruction::Call(function, slots) => {
                self.call(code, *function, slots)?;
            }
            Instruction::Run(function, slots) => {
                return Ok(Some(Event::Spawn(*function, self.take_arguments(slots, 0))));
            }
            Instruction::CallBuiltin(builtin, slots) => {
                return self.call_builtin(builtin, slots, shared, host);
            }
            Instruction::Return => return Ok(self.leave()),
            Instruction::Kill => return Ok(self.handle()?.map(Event::Kill)),
            Instruction::Join => return Ok(self.handle()?.map(Event::Join)),
            Instruction::EnterCritical => return Ok(Some(Event::EnterCritical)),
            Instruction::ExitCritical => return Ok(Some(Event::ExitCritical)),
            Instruction::Halt => return Ok(Some(Event::Halt)),
            Instruction::Pause => return Ok(Some(Event::Pause)),
            Instruction::Change(variable, path, name, count) => {
                self.change(variable, path, (name, *count), shared)?;
            }
            Instruction::Jump(_)
            | Instruction::JumpUnless(_)
            | Instruction::ShortCircuit(..)
            | Instruction::JumpIfGiven(..)
            | Instruction::StoreParameter(_) => self.control(instruction)?,
            Instruction::Method(m, count) if self.is_remote(*count) => {
                return self.call_remote(m, *count, host);
            }
            Instruction::Index(_)
            | Instruction::Member(_)
            | Instruction::Method(..)
            | Instruction::MakeList(_)
            | Instruction::MakePose
            | Instruction::MakeStruct(_)
            | Instruction::Unary(_)
            | Instruction::Binary(_)
            | Instruction::Truth
            | Instruction::Pop => self.compute(instruction)?,
        }
        Ok(None)
    }

    /// Leaves a function; the thread is over with its last one.
    #[inline]
    fn leave(&mut self) -> Option<Event> {
        if let Some(call) = self.calls.pop() {
            self.keep(call.locals);
        }
        self.calls.is_empty().then_some(Event::Finished)
    }

    /// Calls a function of the program.
    #[inline]
    fn call(&mut self, code: &Code, function: usize, slots: &[usize]) -> Result<(), String> {
        if self.calls.len() >= MAX_CALLS {
            return Err(format!("calls are nested deeper than {MAX_CALLS} levels"));
        }
        let parameters = self.take_arguments(slots, 0);
        self.enter(code, function, parameters);
        Ok(())
    }

    /// Instructions that only move within the function.
    fn control(&mut self, instruction: &Instruction) -> Result<(), String> {
        let target = match instruction {
            Instruction::Jump(to) => Some(*to),
            Instruction::JumpUnless(to) => (!self.pop().truth()?).then_some(*to),
            Instruction::ShortCircuit(decided_by, to) => {
                let truth = self.pop().truth()?;
                (truth == *decided_by).then(|| {
                    self.stack.push(Value::Bool(truth));
                    *to
                })
            }
            Instruction::JumpIfGiven(slot, to) => {
                self.local(*slot).is_some_and(|v| v.is_some()).then_some(*to)
            }
            Instruction::StoreParameter(slot) => {
                let value = self.pop();
                if let Some(local) = self.local(*slot) {
                    *local = Some(value);
                }
                None
            }
            _ => None,
        };
        if let (Some(target), Some(call)) = (target, self.calls.last_mut()) {
            call.next = target;
        }
        Ok(())
    }

    /// Instructions that only work on the stack.
    fn compute(&mut self, instruction: &Instruction) -> Result<(), String> {
        let result = match instruction {
            Instruction::Index(count) => {
                let indices = self.pop_many(*count);
                let value = self.pop();
                indices.iter().try_fold(value, |value, index| operators::index(&value, index))?
            }
            Instruction::Member(name) => operators::member(&self.pop(), name)?,
            Instruction::Method(name, count) => {
                let arguments = self.pop_many(*count);
                let mut of = self.pop();
                // What is no variable changes and is gone.
                let changes = methods::changes(name);
                bounded(if changes {
                    methods::change(&mut of, name, arguments)?
                } else {
                    methods::call(&of, name, &arguments)?
                })?
            }
            Instruction::MakeList(count) => bounded(Value::list(self.pop_many(*count)))?,
            Instruction::MakePose => {
                let numbers: Vec<f64> =
                    self.pop_many(6).iter().map(Value::number).collect::<Result<_, String>>()?;
                Value::Pose(numbers.try_into().unwrap_or_default())
            }
            Instruction::MakeStruct(names) => {
                let values = self.pop_many(names.len());
                bounded(Value::Struct(Arc::new(names.iter().cloned().zip(values).collect())))?
            }
            Instruction::Unary(Unary::Not) | Instruction::Truth => {
                let negate = matches!(instruction, Instruction::Unary(_));
                Value::Bool(self.pop().truth()? != negate)
            }
            Instruction::Unary(operator) => operators::unary(*operator, &self.pop())?,
            Instruction::Binary(operator) => {
                let right = self.pop();
                let left = self.pop();
                operators::binary(*operator, &left, &right)?
            }
            _ => {
                self.pop();
                return Ok(());
            }
        };
        self.stack.push(result);
        Ok(())
    }

    fn call_builtin(
        &mut self,
        builtin: &'static Builtin,
        slots: &[usize],
        shared: &mut Shared,
        host: &mut dyn Host,
    ) -> Result<Option<Event>, String> {
        let arguments = self.take_arguments(slots, builtin.parameters.len());
        let mut pending = Pending { builtin, arguments, frames: 0, note: 0 };
        let call = Call {
            name: builtin.name,
            arguments: &pending.arguments,
            thread: self.id,
            frames: 0,
            note: &mut pending.note,
        };
        match builtin.name {
            "sync" => {
                self.stack.push(Value::Nothing);
                self.keep(pending.arguments);
                return Ok(Some(Event::Sleep(1)));
            }
            "sleep" => {
                let frames = sleep_frames(call.required(0)?.number()?)?;
                self.stack.push(Value::Nothing);
                return Ok(Some(Event::Sleep(frames)));
            }
            _ => {}
        }
        if let Some(result) = library::call(&call, &mut shared.random) {
            self.stack.push(bounded(result?)?);
            self.keep(pending.arguments);
            return Ok(None);
        }
        self.pending = Some(pending);
        Ok(if self.poll(host)? { None } else { Some(Event::Waiting) })
    }

    /// Below that many arguments is a handle of calls to a server.
    fn is_remote(&self, arguments: usize) -> bool {
        let of = self.stack.len().checked_sub(arguments + 1).and_then(|index| self.stack.get(index));
        matches!(of, Some(Value::Remote(_)))
    }

    fn call_remote(
        &mut self,
        method: &Arc<str>,
        count: usize,
        host: &mut dyn Host,
    ) -> Result<Option<Event>, String> {
        let list = Value::list(self.pop_many(count));
        let arguments = [self.pop(), Value::Text(method.clone()), list].map(Some).to_vec();
        self.pending = Some(Pending { builtin: &REMOTE_CALL, arguments, frames: 0, note: 0 });
        Ok(if self.poll(host)? { None } else { Some(Event::Waiting) })
    }

    fn enter(&mut self, code: &Code, function: usize, mut parameters: Vec<Option<Value>>) {
        let locals = code.functions.get(function).map_or(0, |function| function.locals);
        parameters.resize(locals, None);
        self.calls.push(Activation { function, next: 0, locals: parameters });
    }

    /// Pops one value for each slot; at least `count` places.
    fn take_arguments(&mut self, slots: &[usize], count: usize) -> Vec<Option<Value>> {
        let places = slots.iter().map(|slot| slot + 1).max().unwrap_or(0).max(count);
        let mut arguments = std::mem::take(&mut self.spare);
        arguments.resize(places, None);
        let first = self.stack.len().saturating_sub(slots.len());
        for (value, slot) in self.stack.drain(first..).zip(slots) {
            arguments[*slot] = Some(value);
        }
        arguments
    }

    /// Keeps the memory of arguments that are not needed any more.
    fn keep(&mut self, mut arguments: Vec<Option<Value>>) {
        arguments.clear();
        self.spare = arguments;
    }

    fn pop(&mut self) -> Value {
        self.stack.pop().unwrap_or(Value::Nothing)
    }

    fn pop_many(&mut self, count: usize) -> Vec<Value> {
        self.stack.split_off(self.stack.len().saturating_sub(count))
    }

    fn local(&mut self, slot: usize) -> Option<&mut Option<Value>> {
        self.calls.last_mut()?.locals.get_mut(slot)
    }

    /// A popped thread handle; `None` for 0.
    fn handle(&mut self) -> Result<Option<ThreadId>, String> {
        match self.pop() {
            Value::Thread(id) => Ok(Some(id)),
            Value::Int(0) => Ok(None),
            Value::Int(id) => Ok(Some(ThreadId(id))),
            other => Err(format!("expected a thread handle, found {}", other.type_name())),
        }
    }
}

/// Frames that `sleep(seconds)` takes: up to the next multiple of a frame, at least one.
fn sleep_frames(seconds: f64) -> Result<u64, String> {
    if !(0.0..=1e9).contains(&seconds) {
        return Err(format!("cannot sleep for {seconds} s"));
    }
    Ok(((seconds / FRAME_SECONDS - 1e-6).ceil() as u64).max(1))
}

mod variables;
