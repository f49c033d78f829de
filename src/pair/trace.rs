//! What was done in a closed loop, for comparison: a fingerprint of every event and effect, and lines for
//! people.
//!
//! In: events and effects with the frame in which they passed. Out: a number that differs as soon as
//! anything differs, and on request the lines. One seed gives one trace on any machine and any number of
//! threads.

use cell_machine::event::{Effect, Event, News};
use cell_machine::supervisor::input::Record;

/// Start and prime of the 64-bit Fowler-Noll-Vo hash, as published.
const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0100_0000_01b3;

/// The trace. See the module.
#[derive(Debug)]
pub struct Trace {
    fingerprint: u64,
    lines: Option<Vec<String>>,
}

impl Trace {
    /// An empty trace; `keep` keeps its lines.
    pub fn new(keep: bool) -> Trace {
        Trace { fingerprint: OFFSET, lines: keep.then(Vec::new) }
    }

    /// Differs as soon as anything differs.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// The lines, if they are kept.
    pub fn lines(&self) -> &[String] {
        self.lines.as_deref().unwrap_or_default()
    }

    fn mix(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.fingerprint = (self.fingerprint ^ u64::from(*byte)).wrapping_mul(PRIME);
        }
    }

    /// A line of its own.
    pub fn line(&mut self, frame: u64, text: impl FnOnce() -> String) {
        let text = format!("{:10.3} {}", frame as f64 * 0.002, text());
        self.mix(text.as_bytes());
        if let Some(lines) = &mut self.lines {
            lines.push(text);
        }
    }

    /// Something went into the machine.
    pub fn event(&mut self, frame: u64, event: &Event) {
        match event {
            Event::Received(link, bytes) => {
                self.mix(&frame.to_le_bytes());
                self.mix(&[*link as u8]);
                self.mix(bytes);
            }
            Event::Registers(Ok(words)) => {
                self.mix(&frame.to_le_bytes());
                words.iter().for_each(|word| self.mix(&word.to_le_bytes()));
            }
            Event::Looked(number, Ok(views)) => {
                let markers = views.iter().map(|view| view.detections.len()).sum::<usize>();
                let corners = views.iter().flat_map(|view| &view.detections).flat_map(|found| found.corners);
                let corners: Vec<u8> = corners.flatten().flat_map(f64::to_le_bytes).collect();
                self.mix(&corners);
                self.line(frame, || format!("< looked {number}: {} views, {markers} markers", views.len()));
            }
            Event::Observed(number, Ok(seen)) => {
                self.line(frame, || format!("< observed {number}: {} objects", seen.objects.len()));
            }
            Event::Commission { .. } => self.line(frame, || "< commission".to_string()),
            Event::Job(job) => self.line(frame, || format!("< job {}", job.id)),
            Event::Time => {}
            other => self.line(frame, || format!("< {other:?}")),
        }
    }

    /// Something came out of it.
    pub fn effect(&mut self, frame: u64, effect: &Effect) {
        match effect {
            Effect::Send(link, bytes) => {
                self.mix(&frame.to_le_bytes());
                self.mix(&[*link as u8]);
                self.mix(bytes);
            }
            Effect::Registers(request) => {
                self.mix(&frame.to_le_bytes());
                self.mix(format!("{request:?}").as_bytes());
            }
            Effect::Look { number, frames, .. } => {
                self.line(frame, || format!("> look {number}, {frames} frames"));
            }
            Effect::Observe { number, views, .. } => {
                self.line(frame, || format!("> observe {number}, {} views", views.len()));
            }
            Effect::Plan { number, request } => {
                self.line(frame, || format!("> plan {number}, {} objects", request.instance.objects.len()));
            }
            Effect::Commit { number, record: Record::Ended(report) } => self.line(frame, || {
                format!("> commit {number}, job {} {:?} {}", report.id, report.end, report.code_text())
            }),
            Effect::Notify(News::Status(status)) => self.line(frame, || {
                let armed = if status.armed { "armed" } else { "disarmed" };
                format!("> status {armed} {}", status.text())
            }),
            Effect::Notify(News::Notice(notice)) => self.line(frame, || format!("> says {}", notice.text)),
            Effect::Notify(News::Identified(arm)) => self.line(frame, || format!("> arm {}", arm.serial)),
            Effect::Notify(News::Route(route)) => self.line(frame, || format!("> route {}", route.len())),
            Effect::Notify(News::Ended(_)) => {}
            other => self.line(frame, || format!("> {other:?}")),
        }
    }
}
