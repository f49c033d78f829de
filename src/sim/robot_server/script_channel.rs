//! Cuts what arrives on the script ports into programs and commands.
//!
//! In: bytes in any chunks. Out: [`Upload`]s. The first line that is neither blank nor a comment decides: a
//! `def` or `sec` goes on until a line that is `end` in column 0 (other lines may be in column 0 too, in
//! programs that clients really send); a known command is one; anything else is a program of one line.
//! Comments and blank lines before a program belong to its text, so that line numbers in messages count from
//! what was sent. Pure.

/// Longest program, bytes; the largest known one has 51 kB.
const MAX_PROGRAM: usize = 4 << 20;

/// Something a client wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Upload {
    /// The text of a program.
    Program(String),
    /// `power on`
    PowerOn,
    /// `power off`
    PowerOff,
    /// `set robotmode run`
    ReleaseBrakes,
    /// `set unlock protective stop`
    Unlock,
    /// `stop program`
    StopProgram,
}

/// The client sent a program that is too long.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a program of more than {MAX_PROGRAM} bytes is not taken")]
pub struct TooLong;

/// The unfinished rest of what a connection has sent.
#[derive(Debug, Default)]
pub struct ScriptChannel {
    line: Vec<u8>,
    text: String,
    in_function: bool,
}

impl ScriptChannel {
    /// Takes what arrived; what became complete with it.
    ///
    /// # Errors
    /// When a program exceeds the bound; the channel is then empty again.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<Upload>, TooLong> {
        let mut done = Vec::new();
        for part in bytes.split_inclusive(|byte| *byte == b'\n') {
            if self.line.len() + self.text.len() + part.len() > MAX_PROGRAM {
                *self = ScriptChannel::default();
                return Err(TooLong);
            }
            self.line.extend_from_slice(part);
            if part.ends_with(b"\n") {
                let line = std::mem::take(&mut self.line);
                done.extend(self.take_line(&String::from_utf8_lossy(&line)));
            }
        }
        Ok(done)
    }

    /// The connection has ended: a last line without a line end counts as complete.
    pub fn finish(&mut self) -> Option<Upload> {
        let line = std::mem::take(&mut self.line);
        self.take_line(&String::from_utf8_lossy(&line))
    }

    fn take_line(&mut self, line: &str) -> Option<Upload> {
        self.text.push_str(line);
        let words = line.trim();
        if self.in_function {
            if line.trim_end() != "end" {
                return None;
            }
            self.in_function = false;
            return Some(Upload::Program(std::mem::take(&mut self.text)));
        }
        if words.is_empty() || words.starts_with('#') {
            return None;
        }
        let first = words.split([' ', '\t']).next().unwrap_or_default();
        if first == "def" || first == "sec" {
            self.in_function = !ends_on_its_line(words);
            return if self.in_function {
                None
            } else {
                Some(Upload::Program(std::mem::take(&mut self.text)))
            };
        }
        let text = std::mem::take(&mut self.text);
        Some(match words {
            "power on" => Upload::PowerOn,
            "power off" => Upload::PowerOff,
            "set robotmode run" => Upload::ReleaseBrakes,
            "set unlock protective stop" => Upload::Unlock,
            "stop program" => Upload::StopProgram,
            _ => Upload::Program(text),
        })
    }
}

/// A whole function on one line, as people type into a terminal.
fn ends_on_its_line(line: &str) -> bool {
    line.ends_with(" end") && line.contains(':')
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn program(text: &str) -> Upload {
        Upload::Program(text.to_owned())
    }

    #[track_caller]
    fn check(text: &str, expected: &[Upload]) {
        let whole = ScriptChannel::default().push(text.as_bytes()).unwrap();
        assert_eq!(whole, expected, "{text:?}");
        let mut channel = ScriptChannel::default();
        let bytewise: Vec<Upload> =
            text.as_bytes().iter().flat_map(|byte| channel.push(&[*byte]).unwrap()).collect();
        assert_eq!(bytewise, expected, "{text:?} byte by byte");
    }

    #[test]
    fn programs_commands_and_lines() {
        check("def a():\n  if x:\n  end\nend\n", &[program("def a():\n  if x:\n  end\nend\n")]);
        check("stop program\ndef a():\nend\n", &[Upload::StopProgram, program("def a():\nend\n")]);
        check("# c\n\nsec s():\r\n x=1\r\nend \r\n", &[program("# c\n\nsec s():\r\n x=1\r\nend \r\n")]);
        check("textmsg(1)\n", &[program("textmsg(1)\n")]);
        check(
            "power on\nset robotmode run\nset unlock protective stop\npower off\n",
            &[Upload::PowerOn, Upload::ReleaseBrakes, Upload::Unlock, Upload::PowerOff],
        );
        check("def a(): textmsg(1) end\n", &[program("def a(): textmsg(1) end\n")]);
        check("def a():\nx = 1\n# end\n  end\nend\n", &[program("def a():\nx = 1\n# end\n  end\nend\n")]);
        check("def unfinished():\n", &[]);
    }

    #[test]
    fn the_last_line_counts_without_its_end() {
        let mut channel = ScriptChannel::default();
        assert_eq!(channel.push(b"textmsg(1)"), Ok(vec![]));
        assert_eq!(channel.finish(), Some(program("textmsg(1)")));
        assert_eq!(channel.finish(), None);
    }

    #[test]
    fn endless_programs_are_cut_off() {
        let mut channel = ScriptChannel::default();
        channel.push(b"def a():\n").unwrap();
        let line = vec![b'x'; MAX_PROGRAM];
        assert_eq!(channel.push(&line), Err(TooLong));
        assert_eq!(channel.push(b"stop program\n"), Ok(vec![Upload::StopProgram]));
    }

    proptest! {
        #[test]
        fn foreign_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut channel = ScriptChannel::default();
            let _ = channel.push(&bytes);
            let _ = channel.finish();
        }
    }
}
