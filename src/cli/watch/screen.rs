//! `celld watch --full`: the cell on one screen of the terminal.
//!
//! In: the last status (none: no daemon), what has changed lately, the time. Out: a screen drawn into a
//! frame: what it does and what to do, the job with its moves, the devices, the last changes. It only
//! shows; orders are commands of their own, so that no key moves an arm. Pure: a test draws into a buffer.

use crate::jobs::status::{DeviceStatus, Status};
use crate::jobs::utc;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Gauge, Paragraph, Wrap};
use std::collections::VecDeque;

/// A status older than this is no longer what is, s.
const STALE_S: f64 = 3.0;

/// Changes that are kept.
const CHANGES: usize = 200;

/// Lines of a screen below which the changes are left out for the rest.
const SMALL: u16 = 18;

/// What the screen is of.
#[derive(Default)]
pub struct Screen {
    status: Option<Status>,
    changes: VecDeque<String>,
}

impl Screen {
    /// The status now; `None`: no daemon.
    pub fn set(&mut self, status: Option<Status>) {
        self.status = status;
    }

    /// What was known before.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// A change, the newest last.
    pub fn note(&mut self, unix_s: f64, text: &str) {
        self.changes.push_back(format!("{}  {text}", utc::text(unix_s)));
        while self.changes.len() > CHANGES {
            self.changes.pop_front();
        }
    }

    /// Draws all of it.
    pub fn draw(&self, frame: &mut Frame, unix_s: f64) {
        let area = frame.area();
        let Some(status) = &self.status else {
            let [middle, changes] = Layout::vertical([Constraint::Length(3), Constraint::Min(0)]).areas(area);
            let text = "no daemon runs on this state folder; waiting for one";
            frame.render_widget(Paragraph::new(text).block(Block::bordered().title(TITLE)), middle);
            self.changes(frame, changes);
            return;
        };
        let devices = u16::try_from(status.devices.len()).unwrap_or(u16::MAX).saturating_add(2).min(8);
        let changes = if area.height < SMALL { 0 } else { 6 };
        let words = now_of(status, unix_s);
        let [now, job, device_area, change_area] = Layout::vertical([
            Constraint::Length(tall(&words, area.width).clamp(5, (area.height / 2).max(5))),
            Constraint::Min(3),
            Constraint::Length(devices),
            Constraint::Length(changes),
        ])
        .areas(area);
        let words = Paragraph::new(words).wrap(Wrap { trim: false });
        frame.render_widget(words.block(Block::bordered().title(TITLE)), now);
        self.job(frame, job, status);
        frame.render_widget(devices_of(&status.devices), device_area);
        self.changes(frame, change_area);
    }

    fn job(&self, frame: &mut Frame, area: Rect, status: &Status) {
        let name = status.job.as_deref().unwrap_or("no job");
        let block = Block::bordered().title(format!(" {name}; {} waiting ", status.waiting));
        let inner = block.inner(area);
        frame.render_widget(block, area);
        let [gauge, moves] = Layout::vertical([Constraint::Length(1), Constraint::Min(0)]).areas(inner);
        let done = status.step.map_or(0, |(step, _)| step);
        if let Some((step, of)) = status.step {
            let ratio = (f64::from(step) / f64::from(of.max(1))).clamp(0.0, 1.0);
            let label = format!("{step} of {of} moves made");
            frame.render_widget(Gauge::default().gauge_style(Color::Blue).ratio(ratio).label(label), gauge);
        }
        let Some(plan) = &status.plan else { return };
        let mut lines = vec![Line::from(plan.summary())];
        let over = plan.carried_out(usize::try_from(done).unwrap_or(0));
        lines.extend(plan.moves().into_iter().skip(over).map(Line::from));
        frame.render_widget(Paragraph::new(lines), moves);
    }

    fn changes(&self, frame: &mut Frame, area: Rect) {
        let shown = usize::from(area.height.saturating_sub(2));
        let from = self.changes.len().saturating_sub(shown);
        let lines: Vec<Line> = self.changes.iter().skip(from).map(|line| Line::from(line.as_str())).collect();
        frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(" changes ")), area);
    }
}

const TITLE: &str = " celld (q or Ctrl-C leaves; nothing here moves the arm) ";

/// Rows of a bordered block with these lines, wrapped at words.
fn tall(lines: &[Line], width: u16) -> u16 {
    let inside = usize::from(width.saturating_sub(2)).max(1);
    // A word that does not fit at a line's end goes to the next: at most half a line is lost to that.
    let rows = lines.iter().map(|line| match line.width() {
        fits if fits <= inside => 1,
        long => (long * 5).div_ceil(inside * 4),
    });
    u16::try_from(rows.sum::<usize>() + 2).unwrap_or(u16::MAX)
}

/// What it does, and what a person is to do, which comes first: the room may not do for all.
fn now_of(status: &Status, unix_s: f64) -> Vec<Line<'_>> {
    let strong = Style::new().add_modifier(Modifier::BOLD);
    let armed = match status.armed {
        true => Span::styled("ARMED: the arm may move", strong.fg(Color::Red)),
        false if status.moving => Span::styled("disarmed, THE ARM MAY STILL MOVE", strong.fg(Color::Red)),
        false => Span::styled("disarmed", strong),
    };
    let paused = match (status.paused, status.moving) {
        (true, true) => ", pausing, THE ARM MAY STILL MOVE",
        (true, false) => ", paused",
        (false, _) => "",
    };
    let mut lines = Vec::new();
    let age = unix_s - status.written_unix_s;
    if age > STALE_S {
        let text = format!("this is {age:.0} s old: the daemon does not report any more");
        lines.push(Line::styled(text, strong.fg(Color::Red)));
    }
    lines.push(Line::from(vec![armed, Span::raw(format!("{paused}; {}", status.message))]));
    if !status.hint.is_empty() {
        lines.push(Line::styled(format!("to do: {}", status.hint), strong));
    }
    for id in &status.awaiting_approval {
        lines.push(Line::styled(format!("waits for `celld approve {id}` or `celld reject {id}`"), strong));
    }
    if let Some(stopped) = &status.stopped {
        lines.push(Line::styled(stopped.text(status.job.as_deref()), Color::Red));
    }
    if let Some(because) = &status.because {
        lines.push(Line::from(format!("looks again: {because}")));
    }
    if let Some(holding) = &status.holding {
        lines.push(Line::from(format!("gripper: {holding}")));
    }
    lines
}

fn devices_of(devices: &[DeviceStatus]) -> Paragraph<'_> {
    let line = |device: &DeviceStatus| {
        let style = if device.ready { Style::new() } else { Style::new().fg(Color::Red) };
        Line::styled(device.text(), style)
    };
    Paragraph::new(devices.iter().map(line).collect::<Vec<_>>()).block(Block::bordered().title(" devices "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::status::Stopped;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    /// The screen as text, a line each.
    fn drawn(screen: &Screen, [width, height]: [u16; 2], unix_s: f64) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
        terminal.draw(|frame| screen.draw(frame, unix_s)).expect("drawn");
        let buffer = terminal.backend().buffer();
        let cell = |x: u16, y: u16| buffer.cell((x, y)).map_or(" ", |cell| cell.symbol()).to_string();
        (0..height).map(|y| (0..width).map(|x| cell(x, y)).collect()).collect()
    }

    fn shows(lines: &[String], text: &str) -> bool {
        lines.iter().any(|line| line.contains(text))
    }

    fn working() -> Status {
        let device = |name: &str, ready| DeviceStatus {
            name: name.to_string(),
            address: "10.0.0.2".to_string(),
            identity: String::new(),
            ready,
            age_s: None,
            message: "connected".to_string(),
        };
        Status {
            armed: true,
            message: "carrying plank-1".to_string(),
            hint: "keep clear".to_string(),
            job: Some("tidy-1".to_string()),
            step: Some((1, 4)),
            written_unix_s: 1000.0,
            stopped: Some(Stopped {
                code: "slip".into(),
                message: "it fell".into(),
                hint: String::new(),
                job: None,
            }),
            awaiting_approval: vec!["tidy-2".to_string()],
            devices: vec![device("robot", true), device("camera", false)],
            ..Status::default()
        }
    }

    #[test]
    fn what_the_status_says_is_on_the_screen() {
        let mut screen = Screen::default();
        screen.set(Some(working()));
        screen.note(1000.0, "job tidy-1 is taken up");
        let lines = drawn(&screen, [100, 30], 1001.0);
        for text in [
            "ARMED: the arm may move; carrying plank-1",
            "to do: keep clear",
            "stopped: it fell (slip)",
            "celld approve tidy-2",
            "tidy-1; 0 waiting",
            "1 of 4 moves made",
            "robot at 10.0.0.2: ready",
            "camera at 10.0.0.2: NOT READY",
            "job tidy-1 is taken up",
        ] {
            assert!(shows(&lines, text), "{text}:\n{}", lines.join("\n"));
        }
        assert!(!shows(&lines, "s old"), "a second is no age");
    }

    #[test]
    fn what_a_person_is_to_do_is_there_on_a_narrow_screen() {
        let mut screen = Screen::default();
        let mut status = working();
        status.message = "a sentence that goes on and on ".repeat(4);
        status.stopped = Some(Stopped { message: "as long as that ".repeat(9), ..Stopped::default() });
        status.awaiting_approval = ["one", "two", "three"].map(str::to_string).to_vec();
        screen.set(Some(status));
        let lines = drawn(&screen, [80, 24], 2000.0);
        for text in ["s old", "to do: keep clear", "celld approve one", "celld approve three"] {
            assert!(shows(&lines, text), "{text}:\n{}", lines.join("\n"));
        }
    }

    #[test]
    fn an_old_status_and_no_daemon_are_not_taken_for_the_present() {
        let mut screen = Screen::default();
        assert!(shows(&drawn(&screen, [80, 24], 0.0), "no daemon runs"));
        screen.set(Some(working()));
        assert!(shows(&drawn(&screen, [80, 24], 1010.0), "this is 10 s old"));
        screen.set(None);
        assert!(!shows(&drawn(&screen, [80, 24], 1010.0), "ARMED"));
    }

    #[test]
    fn any_size_is_drawn_and_control_characters_are_not() {
        let mut screen = Screen::default();
        let mut status = working();
        status.message = "a\u{1b}[2Jb\nc".to_string();
        screen.set(Some(status));
        for size in [[1, 1], [3, 2], [20, 5], [80, 12], [300, 100]] {
            let lines = drawn(&screen, size, 1001.0);
            assert!(!lines.concat().contains(|c: char| c.is_control()), "{size:?}");
        }
    }
}
