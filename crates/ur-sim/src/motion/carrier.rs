//! What takes the arm away from the path of its tasks: a conveyor, or an offset that is laid over it.
//!
//! In: a belt or an offset. Out: the state that the mover keeps of it. Pure.

use crate::motion::belt::Belt;
use crate::motion::path_offset::PathOffset;
use cell_values::units::Joints;

/// What takes the arm away from its path, and where to.
#[derive(Clone, Debug)]
pub struct Carried {
    /// What it is.
    pub by: Carrier,
    /// Joint positions where the arm really is.
    pub q: Joints,
}

/// What takes the arm away from its path.
#[derive(Clone, Debug)]
pub enum Carrier {
    /// A conveyor.
    Belt(Belt),
    /// An offset.
    Offset(PathOffset),
}
