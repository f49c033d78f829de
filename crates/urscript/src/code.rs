//! The instructions a script is compiled to.
//!
//! In: the compiler's output. Out: plain data that a thread steps through; each instruction knows its place
//! in the text. Operands travel on a stack of values; names are resolved to slots.

use crate::ast::{Binary, FunctionKind, Qualifier, Unary};
use crate::fault::Position;
use crate::host::Builtin;
use crate::scope::Names;
use crate::value::Value;
use std::collections::HashMap;
use std::sync::Arc;

/// A compiled upload.
#[derive(Clone, Debug)]
pub struct Code {
    /// The program's name.
    pub name: Arc<str>,
    /// `def` (the main program) or `sec`.
    pub kind: FunctionKind,
    /// All functions and threads; the program itself is the first.
    pub functions: Vec<Arc<FunctionCode>>,
    /// What its first level names.
    pub scope: ProgramScope,
}

/// Parameters of a function, and whether each may be left out.
pub type Parameters = Vec<(Arc<str>, bool)>;

/// The names of a program's first level, for statements that join it while it runs.
#[derive(Clone, Debug, Default)]
pub struct ProgramScope {
    /// Global variables, each with its slot.
    pub globals: Names,
    /// Functions and threads, by name.
    pub functions: HashMap<Arc<str>, usize>,
    /// Parameters of all functions.
    pub parameters: Vec<Parameters>,
}

/// A compiled function.
#[derive(Clone, Debug)]
pub struct FunctionCode {
    /// Its name.
    pub name: Arc<str>,
    /// Number of local variables; parameters come first.
    pub locals: usize,
    /// What to do.
    pub instructions: Vec<Instruction>,
    /// Where each instruction comes from.
    pub positions: Vec<Position>,
}

/// Where a name may live. A function's plain assignment means an existing local, else an existing global,
/// else makes a local; which of them exists is known only when it runs.
#[derive(Clone, Debug)]
pub struct Variable {
    /// As written, for messages.
    pub name: Arc<str>,
    /// Slot in the function's frame.
    pub local: Option<usize>,
    /// Slot among the globals.
    pub global: Option<usize>,
}

/// A step of [`Instruction::StoreInto`]; indices are taken from the stack.
#[derive(Clone, Debug)]
pub enum PathStep {
    /// `[i]`
    Index,
    /// `.name`
    Member(Arc<str>),
}

/// One instruction; "pops" and "pushes" are about the thread's stack.
#[derive(Clone, Debug)]
pub enum Instruction {
    /// Pushes a value.
    Constant(Value),
    /// Pushes a variable's value.
    Load(Variable),
    /// Pops into a variable.
    Store(Variable, Qualifier),
    /// Pops the value and then the indices of the path; replaces a part of a variable.
    StoreInto(Variable, Qualifier, Vec<PathStep>),
    /// Pops indices, then a value; pushes the element.
    Index(usize),
    /// Pops the arguments and then the indices of the path; changes a part of a variable by a method, pushes
    /// its result.
    Change(Variable, Vec<PathStep>, Arc<str>, usize),
    /// Pops the arguments and then a value; pushes what its method gives.
    Method(Arc<str>, usize),
    /// Pops a struct, pushes its member.
    Member(Arc<str>),
    /// Pops that many values into a list.
    MakeList(usize),
    /// Pops six numbers into a pose.
    MakePose,
    /// Pops a value for each name into a struct.
    MakeStruct(Arc<[Arc<str>]>),
    /// Pops one, pushes the result.
    Unary(Unary),
    /// Pops two, pushes the result.
    Binary(Binary),
    /// Turns the top into a bool.
    Truth,
    /// Goes on elsewhere.
    Jump(usize),
    /// Pops; goes on elsewhere if it was not true.
    JumpUnless(usize),
    /// Of `and`/`or`: if the top's truth is the given one, makes it a bool and jumps; else pops it.
    ShortCircuit(bool, usize),
    /// Goes on elsewhere if the parameter in this local slot was given.
    JumpIfGiven(usize, usize),
    /// Pops into a local slot.
    StoreParameter(usize),
    /// Pops arguments into the parameters listed, calls a function of the script.
    Call(usize, Arc<[usize]>),
    /// The same in a new thread; pushes its handle.
    Run(usize, Arc<[usize]>),
    /// Pops arguments into the parameters listed, calls a built-in.
    CallBuiltin(&'static Builtin, Arc<[usize]>),
    /// Drops the top.
    Pop,
    /// Pops the result and leaves the function.
    Return,
    /// Pops a handle and ends that thread and its children.
    Kill,
    /// Pops a handle and waits for that thread.
    Join,
    /// Takes the critical section.
    EnterCritical,
    /// Hands the critical section on.
    ExitCritical,
    /// Ends the program.
    Halt,
    /// Pauses the program.
    Pause,
}
