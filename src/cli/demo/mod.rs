//! `celld demo`.

pub mod cell;
pub mod teach;
