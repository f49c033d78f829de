//! Whether the running program is in interpreter mode, and what scripts have requested of it in this frame.
//!
//! In: the functions of `interpreter`. Out: whether statements may begin. Apart from them because it is a
//! part of the controller's state. Pure.

/// What scripts have requested of the mode.
#[derive(Clone, Debug, Default)]
pub struct Interpreter {
    /// The main thread is in `interpreter_mode()`.
    pub(super) active: bool,
    pub(super) ending: bool,
    pub(super) clear_on_end: bool,
    /// Waiting statements go before anything else begins.
    pub(super) skip: bool,
    /// What was declared goes before anything else begins.
    pub(super) clear: bool,
}

impl Interpreter {
    /// A frame ends in which there were no statements to skip or clear.
    pub fn nothing_to_settle(&mut self) {
        (self.skip, self.clear) = (false, false);
    }

    /// Statements may begin now.
    pub fn takes_statements(&self) -> bool {
        self.active && !self.ending && !self.skip && !self.clear
    }
}
