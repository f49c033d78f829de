//! `celld demo`.

pub mod teach;
