//! A recording of a real arm against the simulated one: read, carried out again, compared.

pub mod alignment;

pub mod comparison;

pub mod kinematics;

pub mod motions;

pub mod recording;

pub mod replay;

pub mod track;

#[cfg(test)]
mod recorded_arm;
