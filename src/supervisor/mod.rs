//! What the cell does next: a pure state machine from inputs to actions.
