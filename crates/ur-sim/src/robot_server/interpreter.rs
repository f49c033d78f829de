//! Connections to the interpreter socket (30020): one reply per line.
//!
//! In: lines. Out: replies of the controller's interpreter mode. Local mode makes no difference (assumed:
//! what decides is the program that runs). A line that is too long is discarded like one that is wrong.

use crate::controller::interpreter::discard;
use crate::robot_server::shared::RobotShared;
use ur_wire::dashboard::LineSplitter;

/// One connection, without its socket.
#[derive(Default)]
pub struct Session(LineSplitter);

impl Session {
    /// Carries out what arrived; the replies.
    pub fn receive(&mut self, shared: &RobotShared, bytes: &[u8]) -> String {
        self.0.push(bytes);
        let mut replies = String::new();
        loop {
            let reply = match self.0.next_line() {
                Ok(Some(line)) if line.trim().is_empty() => continue,
                Ok(Some(line)) => {
                    let mut controller = shared.controller();
                    let controller = &mut *controller;
                    controller.programs.interpret(line.trim(), &mut controller.core)
                }
                Ok(None) => return replies,
                Err(_) => discard("the statement is too long", ""),
            };
            replies.push_str(&reply);
            replies.push('\n');
        }
    }
}
