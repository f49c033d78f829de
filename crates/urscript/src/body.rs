//! A function under construction: instructions, their places in the text, and jumps that have no target yet.
//!
//! In: what the compiler emits. Out: the parts of a [`crate::code::FunctionCode`].

use crate::code::Instruction;
use crate::fault::Position;
use crate::scope::Names;

/// A function under construction.
#[derive(Default)]
pub(crate) struct Body {
    pub(crate) locals: Names,
    pub(crate) instructions: Vec<Instruction>,
    pub(crate) positions: Vec<Position>,
    /// Per open loop: where `continue` goes, and the jumps that `break` left open.
    pub(crate) loops: Vec<(usize, Vec<usize>)>,
}

impl Body {
    pub(crate) fn emit(&mut self, instruction: Instruction, at: Position) -> usize {
        self.instructions.push(instruction);
        self.positions.push(at);
        self.instructions.len() - 1
    }

    /// Lets the jump at `index` go to the next instruction.
    pub(crate) fn land(&mut self, index: usize) {
        let here = self.instructions.len();
        if let Some(
            Instruction::Jump(to)
            | Instruction::JumpUnless(to)
            | Instruction::ShortCircuit(_, to)
            | Instruction::JumpIfGiven(_, to),
        ) = self.instructions.get_mut(index)
        {
            *to = here;
        }
    }
}
