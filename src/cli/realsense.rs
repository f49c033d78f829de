//! `celld realsense`: the process in which the RealSense SDK runs. Only celld starts it, so neither the help
//! nor the completions have it.
//!
//! In: requests on standard input, a pipe. Out: replies on standard output. Exit code 0 at the end of its
//! input, 2 at a terminal.

use crate::io::camera::realsense::serve;
use cell_edge::terminal::complain;
use std::io::IsTerminal;

/// Runs the command; the exit code.
pub fn run() -> u8 {
    if std::io::stdin().is_terminal() {
        complain("celld starts this command itself. To take a picture, run `celld capture`.");
        return 2;
    }
    match serve() {
        Ok(()) => 0,
        Err(error) => {
            complain(&format!("celld realsense: {error}"));
            1
        }
    }
}
