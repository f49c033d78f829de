//! `celld doctor`: what is between this computer and a moving robot, on one page.
//!
//! In: what the probes found ([`probe`]), as plain facts. Out: a [`Sheet`] of [`Line`]s, each with what was
//! found and, where something is missing, what to do about it; as text or as JSON. The judging is pure, so
//! that every line can be tested without the device it is about; only `probe` opens sockets, files and the
//! camera. Nothing here moves the arm or writes to a device: the controller's registers are claimed for two
//! seconds, as celld will claim them, and let go.

pub mod camera;
pub mod computer;
pub mod files;
pub mod gripper;
pub mod probe;
pub mod robot;
#[cfg(test)]
mod tests;

use crate::jobs::utc;
use cell_machine::supervisor::gates::GateClosed;
use serde::Serialize;

/// Columns of the text, and where what was found begins.
const COLUMNS: usize = 110;
const INDENT: usize = 27;

/// What one line says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// Worth knowing; the cell works all the same.
    Note,
    /// The cell does not work like this.
    Problem,
}

impl Verdict {
    fn mark(self) -> &'static str {
        match self {
            Verdict::Ok => "ok",
            Verdict::Note => "note",
            Verdict::Problem => "MISSING",
        }
    }
}

/// What a line is about; the sheet is in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Area {
    /// Configuration and calibration files.
    Files,
    /// The controller and the arm.
    Robot,
    /// The gripper.
    Gripper,
    /// The camera.
    Camera,
    /// This computer.
    Computer,
    /// What `celld arm` would answer.
    Arming,
}

impl Area {
    /// All of them.
    pub const ALL: [Area; 6] =
        [Area::Files, Area::Robot, Area::Gripper, Area::Camera, Area::Computer, Area::Arming];

    fn title(self) -> &'static str {
        match self {
            Area::Files => "files",
            Area::Robot => "robot",
            Area::Gripper => "gripper",
            Area::Camera => "camera",
            Area::Computer => "this computer",
            Area::Arming => "arming",
        }
    }
}

/// One line of the sheet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// What part of the cell.
    pub area: Area,
    /// What of it.
    pub item: &'static str,
    /// How it is.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do; empty where there is nothing to do.
    pub hint: String,
}

impl Line {
    /// As it should be.
    pub fn ok(area: Area, item: &'static str, found: impl Into<String>) -> Line {
        Line { area, item, verdict: Verdict::Ok, found: found.into(), hint: String::new() }
    }

    /// Worth knowing.
    pub fn note(area: Area, item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
        Line { area, item, verdict: Verdict::Note, found: found.into(), hint: hint.into() }
    }

    /// Missing.
    pub fn problem(
        area: Area,
        item: &'static str,
        found: impl Into<String>,
        hint: impl Into<String>,
    ) -> Line {
        Line { area, item, verdict: Verdict::Problem, found: found.into(), hint: hint.into() }
    }
}

/// What `celld arm` would answer.
pub fn arming(gates: Result<(), GateClosed>) -> Line {
    let Err(closed) = gates else { return Line::ok(Area::Arming, "`celld arm`", "would be accepted") };
    Line::problem(Area::Arming, "`celld arm`", format!("would be refused: {closed}"), closed.hint())
}

/// The page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sheet {
    /// The configuration it is about.
    pub config: String,
    /// When it was made, UTC.
    pub at: String,
    /// Nothing is missing.
    pub ready: bool,
    /// Its lines, by area.
    pub lines: Vec<Line>,
}

impl Sheet {
    /// The lines, sorted by area; what was first in an area stays so.
    pub fn new(config: String, unix_s: f64, mut lines: Vec<Line>) -> Sheet {
        lines.sort_by_key(|line| line.area);
        let ready = lines.iter().all(|line| line.verdict < Verdict::Problem);
        Sheet { config, at: utc::text(unix_s), ready, lines }
    }

    /// How many lines have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.lines.iter().filter(|line| line.verdict == verdict).count()
    }

    /// For people.
    pub fn text(&self) -> String {
        let mut text = format!("celld doctor, {}, {}\n", self.config, self.at);
        for area in Area::ALL {
            let lines: Vec<&Line> = self.lines.iter().filter(|line| line.area == area).collect();
            if lines.is_empty() {
                continue;
            }
            text.push_str(&format!("\n{}\n", area.title()));
            for Line { item, verdict, found, hint, .. } in lines {
                let head = format!("  {:<8} {item:<15} ", verdict.mark());
                wrapped(&mut text, &head, found);
                if !hint.is_empty() {
                    wrapped(&mut text, &format!("{:INDENT$}-> ", ""), hint);
                }
            }
        }
        text.push_str(&format!("\n{}\n", self.verdict()));
        text
    }

    fn verdict(&self) -> String {
        let counted = |count: usize, what: &str| match count {
            1 => format!("1 {what}"),
            _ => format!("{count} {what}s"),
        };
        let notes = counted(self.count(Verdict::Note), "note");
        match self.count(Verdict::Problem) {
            0 => format!("nothing is missing ({notes}); `celld run`, then `celld arm` lets the arm move"),
            missing => format!("{} missing, {notes}", counted(missing, "thing")),
        }
    }
}

/// Adds `words` after `head`; what goes beyond the page goes below it.
fn wrapped(text: &mut String, head: &str, words: &str) {
    let indent = head.chars().count();
    text.push_str(head);
    let mut column = indent;
    for (index, word) in words.split_whitespace().enumerate() {
        let width = word.chars().count();
        if index > 0 && column + 1 + width > COLUMNS {
            text.push_str(&format!("\n{:indent$}", ""));
            column = indent;
        } else if index > 0 {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += width;
    }
    text.push('\n');
}
