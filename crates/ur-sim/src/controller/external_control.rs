//! A program of the External Control URCap: its script is fetched from a PC when it is played.
//!
//! In: the PC's address, then one step a frame. Out: the text of the program to run. As the URCap's source
//! does: `request_program` and a line end go to the PC, and what comes back until nothing more is
//! there is the script. Lines from `# HEADER_BEGIN` to `# HEADER_END` come first in the program, what is
//! behind them is the node's own part, and what is before them is left out; without both marks all of it is
//! the node's part. A PC that cannot be reached makes a program of a popup that waits to be closed.
//! Assumed: the time without a byte after which an answer is whole, the time that a PC has for its first
//! byte (the URCap has no limit there), and that the program does not begin again at its end.

use crate::controller::sockets::{ScriptSockets, SocketState};
use crate::motion::FRAMES_PER_SECOND;

/// Frames without a byte after which the answer is whole.
const QUIET_FRAMES: u64 = FRAMES_PER_SECOND / 10;

/// Frames that a PC has for its first byte.
const PATIENCE_FRAMES: u64 = 5 * FRAMES_PER_SECOND;

/// Longest answer, bytes.
const MAX_SCRIPT: usize = 1 << 20;

/// Name of the request's socket, which no script gives one of its own.
const SOCKET: &str = "the request of the External Control node";

/// A request to a PC.
#[derive(Debug)]
pub struct ScriptRequest {
    host: String,
    port: u16,
    answer: Vec<u8>,
    sent: bool,
    /// Frames since the last byte, or since the beginning.
    quiet: u64,
}

impl ScriptRequest {
    /// Begins to connect.
    pub fn new(host: &str, port: u16, sockets: &mut dyn ScriptSockets) -> ScriptRequest {
        sockets.open(SOCKET, host, port);
        ScriptRequest { host: host.to_owned(), port, answer: Vec::new(), sent: false, quiet: 0 }
    }

    /// One frame; the text of the program called `name` once it is there.
    pub fn step(&mut self, name: &str, sockets: &mut dyn ScriptSockets) -> Option<String> {
        let state = sockets.state(SOCKET);
        if state == SocketState::Open && !self.sent {
            // A peer that has gone already shows as closed in the next frame.
            sockets.send(SOCKET, b"request_program\n");
            self.sent = true;
        }
        self.quiet += 1;
        if let Some(arrived) = sockets.received(SOCKET).filter(|arrived| !arrived.is_empty()) {
            self.answer.append(arrived);
            self.quiet = 0;
        }
        let closed = state == SocketState::Closed;
        let reason = match self.answer.len() {
            0 if closed && !self.sent => "Connection refused or timed out",
            0 if closed => "Connection closed without an answer",
            0 if self.quiet >= PATIENCE_FRAMES => "Read timed out",
            0 => return None,
            too_long if too_long > MAX_SCRIPT => "The answer is too long",
            _ if self.quiet < QUIET_FRAMES && !(closed && self.quiet > 0) => return None,
            _ => {
                self.cancel(sockets);
                return Some(program(name, &String::from_utf8_lossy(&self.answer)));
            }
        };
        self.cancel(sockets);
        tracing::warn!(host = self.host, port = self.port, reason, "no script from the PC");
        Some(self.complaint(name, reason))
    }

    /// Hangs up.
    pub fn cancel(&self, sockets: &mut dyn ScriptSockets) {
        sockets.close(SOCKET);
    }

    /// What the URCap makes of a PC that does not answer.
    fn complaint(&self, name: &str, reason: &str) -> String {
        let ScriptRequest { host, port, .. } = self;
        let text = format!(
            "popup(\"The connection to the remote PC at {host}:{port} could not be established. Reason: \
             {reason}\", \"Receive program failed\", False, True, blocking=True)\nsync()\n"
        );
        program(name, &text)
    }
}

/// The script of a program whose file has this name, around an answer.
fn program(file: &str, answer: &str) -> String {
    let (header, node) = split(answer);
    format!("def {}():\n{header}{node}\nend\n", identifier(file))
}

/// Header and the node's own part.
fn split(answer: &str) -> (String, String) {
    let mut parts = (String::new(), String::new());
    let (mut within, mut behind) = (false, false);
    for line in answer.lines() {
        let begins = line.trim() == "# HEADER_BEGIN";
        let ends = within && line.trim() == "# HEADER_END";
        within = (within || begins) && !ends;
        if begins || within || ends {
            parts.0.extend([line, "\n"]);
        } else if behind {
            parts.1.extend([line, "\n"]);
        }
        behind |= ends;
    }
    if behind { parts } else { (String::new(), answer.to_owned()) }
}

/// The name of a program's file as a script can bear it.
pub fn identifier(file: &str) -> String {
    let stem = file.strip_suffix(".urpx").or_else(|| file.strip_suffix(".urp")).unwrap_or(file);
    let plain = |character: char| if character.is_ascii_alphanumeric() { character } else { '_' };
    let name: String = stem.chars().map(plain).collect();
    if name.starts_with(|first: char| first.is_ascii_alphabetic()) { name } else { format!("p_{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_comes_first_and_what_is_before_it_is_left_out() {
        let answer = "lost()\n  # HEADER_BEGIN\na = 1\n# HEADER_END\nb = 2\n# HEADER_END\nc = 3\n";
        let (header, node) = split(answer);
        assert_eq!(header, "  # HEADER_BEGIN\na = 1\n# HEADER_END\n");
        assert_eq!(node, "b = 2\n# HEADER_END\nc = 3\n");
        for whole in ["# HEADER_BEGIN\na = 1\n", "a = 1\n# HEADER_END\n", "a = 1"] {
            assert_eq!(split(whole), (String::new(), whole.to_owned()), "{whole:?}");
        }
    }

    #[test]
    fn any_file_name_gives_a_name_for_the_program() {
        assert_eq!(program("my prog-1.urp", "x = 1"), "def my_prog_1():\nx = 1\nend\n");
        assert_eq!(identifier("1.urp"), "p_1");
        assert_eq!(identifier(""), "p_");
    }
}
