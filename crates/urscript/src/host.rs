//! The border between the language and whatever it runs on: built-ins that touch the robot.
//!
//! In: calls with their arguments bound to parameters. Out: a value, "not yet" (the calling thread stays
//! where it is and the call is repeated each frame), or a message that becomes a runtime exception.

use crate::value::{ThreadId, Value};

/// A parameter of a built-in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuiltinParameter {
    /// Name for keyword arguments.
    pub name: &'static str,
    /// May be left out.
    pub optional: bool,
}

/// The signature of a built-in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Builtin {
    /// As scripts call it.
    pub name: &'static str,
    /// Its parameters in order.
    pub parameters: &'static [BuiltinParameter],
}

/// Declares signatures: `name(a, b; c, d)`, those after the semicolon being optional.
#[macro_export]
macro_rules! urscript_builtins {
    ($($name:ident($($required:ident),* $(; $($optional:ident),+)?)),* $(,)?) => {
        &[$($crate::host::Builtin {
            name: stringify!($name),
            parameters: &[
                $($crate::host::BuiltinParameter { name: stringify!($required), optional: false },)*
                $($($crate::host::BuiltinParameter { name: stringify!($optional), optional: true },)+)?
            ],
        }),*]
    };
}
pub use crate::urscript_builtins;

/// What the host is called with for `handle.method(arguments)` on a [`Value::Remote`]: the handle, the
/// method's name, the list of arguments. No script can write this name.
pub static REMOTE_CALL: Builtin = Builtin { name: "a call of a handle", parameters: &[] };

/// One call of a built-in, repeated until it is answered.
#[derive(Debug)]
pub struct Call<'a> {
    /// Which built-in.
    pub name: &'static str,
    /// By parameter; `None` where an optional one was left out.
    pub arguments: &'a [Option<Value>],
    /// The calling thread.
    pub thread: ThreadId,
    /// Frames since the call was first made; 0 at first.
    pub frames: u64,
    /// The host's own note about this call; 0 at first.
    pub note: &'a mut u64,
}

impl Call<'_> {
    /// The argument of parameter `index`, if it was given.
    pub fn argument(&self, index: usize) -> Option<&Value> {
        self.arguments.get(index).and_then(Option::as_ref)
    }

    /// The argument of a required parameter.
    ///
    /// # Errors
    /// When it is missing, which the compiler rules out for signatures that say so.
    pub fn required(&self, index: usize) -> Result<&Value, String> {
        self.argument(index).ok_or_else(|| format!("{}: argument {} is missing", self.name, index + 1))
    }

    /// A number with a default.
    ///
    /// # Errors
    /// When something else than a number was given.
    pub fn number_or(&self, index: usize, default: f64) -> Result<f64, String> {
        self.argument(index).map_or(Ok(default), Value::number)
    }
}

/// The answer to a [`Call`].
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// The call is done.
    Value(Value),
    /// The call is done, and is one that lets time pass as a rule: a thread that makes such calls all the
    /// time goes on in the next frame when its slice of this one is used up.
    Waited(Value),
    /// Call again in the next frame; the thread waits.
    Wait,
}

/// What a program runs on.
pub trait Host {
    /// Carries out a call.
    ///
    /// # Errors
    /// The message of a runtime exception.
    fn call(&mut self, call: Call<'_>) -> Result<Reply, String>;

    /// Statements that joined the program may begin now.
    fn takes_statements(&self) -> bool {
        false
    }

    /// A thread was killed while it waited in the built-in `name`.
    fn abandoned(&mut self, thread: ThreadId, name: &'static str);
}
