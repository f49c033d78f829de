//! Cuts what arrives on the script ports into programs and commands.
//!
//! In: bytes in any chunks. Out: [`Upload`]s. The first line that is neither blank nor a comment decides: a
//! `def` or `sec` goes on until what is open at its own indentation is closed; a known command is one;
//! anything else is a program of one line. A program with an `end` too few in its body arrives all the same
//! and is complained about: deeper lines alone keep none open, and a command ends what is open. Programs
//! that clients really send have all lines in column 0, or the whole program indented. Comments and blank
//! lines before a program belong to its text, so that line numbers in messages count from what was sent.
//! Pure.

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
    open: Option<Open>,
}

/// A program that has begun.
#[derive(Clone, Copy, Debug)]
struct Open {
    /// Columns before its `def`.
    indentation: usize,
    /// Blocks open in lines of no more than that.
    blocks: i32,
    /// Blocks open in all lines.
    depth: i32,
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
                let line = String::from_utf8_lossy(&line);
                if self.open.is_some() && command(line.trim()).is_some() {
                    // Clients must be able to stop the arm, whatever they sent before: what is open has an
                    // error.
                    self.open = None;
                    done.push(Upload::Program(std::mem::take(&mut self.text)));
                }
                done.extend(self.take_line(&line));
            }
        }
        Ok(done)
    }

    /// The connection has ended: a last line without a line end counts as complete.
    pub fn finish(&mut self) -> Option<Upload> {
        let line = std::mem::take(&mut self.line);
        self.take_line(&String::from_utf8_lossy(&line))
    }

    /// A line of a program, its first included.
    fn go_on(&mut self, mut open: Open, line: &str) -> Option<Upload> {
        let change = blocks(line);
        open.depth += change;
        let outermost = indentation(line) <= open.indentation;
        if outermost {
            open.blocks += change;
        }
        let goes_on = !outermost || (open.blocks > 0 && open.depth > 0);
        self.open = goes_on.then_some(open);
        if goes_on { None } else { Some(Upload::Program(std::mem::take(&mut self.text))) }
    }

    fn take_line(&mut self, line: &str) -> Option<Upload> {
        self.text.push_str(line);
        let words = line.trim();
        if let Some(open) = self.open {
            return self.go_on(open, line);
        }
        if words.is_empty() || words.starts_with('#') {
            return None;
        }
        let first = words.split([' ', '\t']).next().unwrap_or_default();
        if first == "def" || first == "sec" {
            return self.go_on(Open { indentation: indentation(line), blocks: 0, depth: 0 }, line);
        }
        let text = std::mem::take(&mut self.text);
        Some(command(words).unwrap_or(Upload::Program(text)))
    }
}

/// A command that is no program.
fn command(line: &str) -> Option<Upload> {
    Some(match line {
        "power on" => Upload::PowerOn,
        "power off" => Upload::PowerOff,
        "set robotmode run" => Upload::ReleaseBrakes,
        "set unlock protective stop" => Upload::Unlock,
        "stop program" => Upload::StopProgram,
        _ => return None,
    })
}

fn indentation(line: &str) -> usize {
    line.chars().take_while(|character| character.is_whitespace()).count()
}

/// Blocks that a line opens, less those that it closes.
fn blocks(line: &str) -> i32 {
    let code = without_strings(line);
    let words = code.split(|character: char| !character.is_alphanumeric() && character != '_');
    let counted = words.map(|word| match word {
        "def" | "sec" | "thread" | "if" | "while" => 1,
        "end" => -1,
        _ => 0,
    });
    counted.sum()
}

/// A line without its strings and its comment.
fn without_strings(line: &str) -> String {
    let mut quote = None;
    let mut code = String::new();
    for character in line.chars() {
        match (quote, character) {
            (None, '#' | '$') => break,
            (None, '"' | '\'') => quote = Some(character),
            (None, _) => code.push(character),
            (Some(begun), _) if begun == character => quote = None,
            (Some(_), _) => {}
        }
    }
    code
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
        for whole in [
            "  def a():\n    if x:\n    end\n  end\n",
            "def a():\nthread b():\nwhile (True):\n# end\nsync()\nend\nend\nrun b()\nend\n",
            "def a():\nif x: y = \"end\" end\nend\n",
            "def a():\n  if x:\nend\n",
            "def a():\nif x:\n  y()\n  end\nend\n",
            "def a():\nif x:\ny()\nend\n",
        ] {
            check(&format!("{whole}stop program\n"), &[program(whole), Upload::StopProgram]);
        }
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
