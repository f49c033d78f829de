//! What the daemon says about itself in `STATE/status.json`, for `celld status` and other programs.
//!
//! In and out: [`Status`] as JSON. The daemon writes the file whole on every change and every second;
//! whether it is alive says the lock, not this file.

use crate::jobs::record::PlanRecord;
use crate::jobs::utc;
use cell_edge::files::{FileError, read_regular, write_whole};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// The daemon's own words about its state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Name of this run of the daemon; commands carry it.
    pub daemon: String,
    /// Process id.
    pub pid: u32,
    /// The file of its configuration; empty while it waits for the robot.
    #[serde(default)]
    pub config: String,
    /// The shared part of its configuration, in words; none where it runs with its own file alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared: Option<String>,
    /// s since 1970.
    pub started_unix_s: f64,
    /// s since 1970.
    pub written_unix_s: f64,
    /// One word: the supervisor's state.
    pub state: String,
    /// One sentence for the operator.
    pub message: String,
    /// What to do; empty when nothing is known.
    pub hint: String,
    /// Motion is allowed.
    pub armed: bool,
    /// The arm is on its way, or is not known to be at rest, whatever `armed` and `paused` say: what is
    /// under way is finished.
    #[serde(default)]
    pub moving: bool,
    /// Why the table is looked at again.
    #[serde(default)]
    pub because: Option<String>,
    /// The stop that is still to be left.
    #[serde(default)]
    pub stopped: Option<Stopped>,
    /// The ways back that may be taken now; none where there is nothing to leave.
    #[serde(default)]
    pub ways: Vec<String>,
    /// Why an order to arm would be refused now, as it would be answered; none where it would be taken.
    #[serde(default)]
    pub arm_refused: Option<String>,
    /// Why no job is begun although none is active.
    #[serde(default)]
    pub blocked: Option<String>,
    /// Stopped between steps on the operator's order.
    pub paused: bool,
    /// The active job.
    pub job: Option<String>,
    /// Pick-n-places made, and how many the present plan has in all.
    pub step: Option<(u32, u32)>,
    /// What hangs on the gripper, may hang or fell.
    pub holding: Option<String>,
    /// Where the time of the last pick-n-place of the active job went, s, by the word of each use.
    #[serde(default)]
    pub last_move_s: BTreeMap<String, f64>,
    /// What is planned for the active job.
    #[serde(default)]
    pub plan: Option<PlanRecord>,
    /// Jobs whose plan waits for approval.
    pub awaiting_approval: Vec<String>,
    /// Jobs that wait for their turn.
    pub waiting: u32,
    /// Files in `incoming` that have not been read yet: a full queue, or they are still being written.
    #[serde(default)]
    pub unread: u32,
    /// The file that was refused last since the start.
    #[serde(default)]
    pub refused: Option<RefusedFile>,
    /// Robot, gripper, camera and what each is doing.
    pub devices: Vec<DeviceStatus>,
    /// What is wrong with the cell's part in its fleet, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fleet: Vec<String>,
    /// Seconds of the cell per second of the wall's clock, while the clock follows a simulator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_factor: Option<f64>,
}

/// How long a refused file is news, s.
const REFUSED_FOR_S: f64 = 600.0;

/// What another thread has to say in the status, as it is now.
pub type Remarks = Arc<Mutex<Vec<String>>>;

/// A file that is no job.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RefusedFile {
    /// Its name.
    pub name: String,
    /// For programs: why.
    pub code: String,
    /// The first complaint.
    pub message: String,
    /// When it was refused, s since 1970.
    pub unix_s: f64,
}

impl RefusedFile {
    /// One line for people.
    pub fn text(&self) -> String {
        let RefusedFile { name, code, message, .. } = self;
        format!("{name} was refused ({code}): {message}; `celld why {name}` has all of it")
    }
}

/// A stop that is still to be left.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stopped {
    /// For programs: a result code.
    pub code: String,
    /// One sentence.
    pub message: String,
    /// What to do about it.
    pub hint: String,
    /// The job that it ended, or that goes on after it.
    #[serde(default)]
    pub job: Option<String>,
}

impl Stopped {
    /// One line; with the job, where it is not the active one.
    pub fn text(&self, active: Option<&str>) -> String {
        let Stopped { code, message, job, .. } = self;
        match job.as_deref().filter(|job| Some(*job) != active) {
            Some(job) => format!("stopped in job {job}: {message} ({code})"),
            None => format!("stopped: {message} ({code})"),
        }
    }
}

/// One device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceStatus {
    /// "robot", "gripper", "camera".
    pub name: String,
    /// Where it is.
    pub address: String,
    /// Which one it is; empty where that is not known.
    #[serde(default)]
    pub identity: String,
    /// It answers and may be used.
    pub ready: bool,
    /// How long ago it answered last (the camera: gave a picture), s; none since the start.
    #[serde(default)]
    pub age_s: Option<f64>,
    /// One sentence.
    pub message: String,
}

/// The state of a daemon that waits for the robot and takes no orders yet.
pub const STARTING: &str = "starting";

/// Up to this age an answer is one of now: the loop polls more often.
const FRESH_S: f64 = 2.0;

impl DeviceStatus {
    /// One line.
    pub fn text(&self) -> String {
        let word = if self.ready { "ready" } else { "NOT READY" };
        let identity = match self.identity.is_empty() {
            true => String::new(),
            false => format!(" ({})", self.identity),
        };
        // Pictures are wanted now and then; the words say what came of the last one.
        let age = match self.age_s {
            Some(age) if age > FRESH_S => format!(", last answer {age:.0} s ago"),
            _ => String::new(),
        };
        format!("{} at {}: {word}, {}{age}{identity}", self.name, self.address, self.message)
    }
}

impl Status {
    /// A daemon that is not ready for orders, and what it waits for.
    pub fn starting(daemon: String, started_unix_s: f64, unix_s: f64, message: String) -> Status {
        let (pid, state) = (std::process::id(), STARTING.to_string());
        Status { daemon, pid, started_unix_s, written_unix_s: unix_s, state, message, ..Status::default() }
    }

    /// Writes the file whole.
    ///
    /// # Errors
    /// The system refuses to write the file.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let text = serde_json::to_string_pretty(self).expect("a status has string keys only");
        write_whole(path, text.as_bytes())
    }

    /// Reads the file; `None` when there is none or it is of another version.
    ///
    /// # Errors
    /// The file is present, but the system refuses to read it, or it is larger than 1 MiB, no UTF-8 text or
    /// no regular file with one name.
    pub fn read(path: &Path) -> Result<Option<Status>, FileError> {
        match read_regular(path, 1024 * 1024) {
            Err(error) if error.is_absent() => Ok(None),
            other => Ok(serde_json::from_str(&other?.0).ok()),
        }
    }

    /// Armed or not, paused or not; of a cell that no one expects to move, whether it still does.
    pub fn mode(&self) -> String {
        let armed = if self.armed { "armed" } else { "disarmed" };
        let paused = if self.paused { ", paused" } else { "" };
        let moves = if self.moving && (!self.armed || self.paused) { ", THE ARM MAY STILL MOVE" } else { "" };
        format!("{armed}{paused}{moves}")
    }

    /// The arm is known to rest, and no order lets it move. Of a daemon that starts nothing is known.
    pub fn rests(&self) -> bool {
        !self.armed && !self.moving && self.state != STARTING
    }

    /// What is left of it once no daemon runs any more: nothing of this is of now.
    pub fn last_words(&self) -> String {
        let at = utc::text(self.written_unix_s);
        let (state, mode, message) = (&self.state, self.mode(), &self.message);
        let mut lines = vec![format!("its last status, of {at}: {state} ({mode}): {message}")];
        if self.rests() {
            lines.push("  the arm was at rest".to_string());
        }
        if let Some(stopped) = &self.stopped {
            lines.push(format!("  {}", stopped.text(self.job.as_deref())));
        }
        if let Some(job) = &self.job {
            let step = self.step.map(|(step, of)| format!(", step {step} of {of}")).unwrap_or_default();
            lines.push(format!("  job {job}{step}"));
        }
        if let Some(holding) = &self.holding {
            lines.push(format!("  gripper: {holding}"));
        }
        lines.join("\n")
    }

    /// A few lines for the terminal.
    pub fn text(&self) -> String {
        let mut lines = vec![format!("{} ({}): {}", self.state, self.mode(), self.message)];
        if let Some(shared) = &self.shared {
            lines.push(format!("  configuration shared with other cells: {shared}"));
        }
        if let Some(because) = &self.because {
            lines.push(format!("  looks again: {because}"));
        }
        if let Some(stopped) = &self.stopped {
            lines.push(format!("  {}", stopped.text(self.job.as_deref())));
        }
        if !self.hint.is_empty() {
            lines.push(format!("  to do: {}", self.hint));
        }
        if let Some(job) = &self.job {
            let step = self.step.map(|(step, of)| format!(", step {step} of {of}")).unwrap_or_default();
            lines.push(format!("  job {job}{step}"));
        }
        if let Some(plan) = &self.plan {
            lines.push(format!("  plan: {}", plan.summary()));
            if !self.awaiting_approval.is_empty() {
                lines.extend(plan.moves().iter().map(|line| format!("    {line}")));
            }
        }
        if let Some(holding) = &self.holding {
            lines.push(format!("  gripper: {holding}"));
        }
        for id in &self.awaiting_approval {
            lines.push(format!("  waits for `celld approve {id}`"));
        }
        let unread = match self.unread {
            0 => String::new(),
            files => format!(", {files} in incoming not read yet"),
        };
        lines.push(format!("  {} waiting{unread}", self.waiting));
        let lately = |refused: &&RefusedFile| self.written_unix_s - refused.unix_s < REFUSED_FOR_S;
        lines.extend(self.refused.as_ref().filter(lately).map(|refused| format!("  {}", refused.text())));
        for device in &self.devices {
            lines.push(format!("  {}", device.text()));
        }
        lines.extend(self.fleet.iter().map(|sentence| format!("  fleet: {sentence}")));
        lines.extend(self.time_factor.map(|factor| format!("  simulated: {factor:.2} times real time")));
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::record::{JobRecord, JobResult};
    use cell_machine::code::JobStatus;
    use std::collections::BTreeSet;

    /// The keys of a table of docs/files.md, in the section of this name.
    fn keys_of(section: &str) -> BTreeSet<String> {
        let page = include_str!("../../docs/files.md");
        let start = page.find(&format!("\n## {section}\n")).expect("the section");
        let body = &page[start + 4..];
        let body = &body[..body.find("\n## ").unwrap_or(body.len())];
        let rows = body.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next());
        rows.flat_map(|cell| cell.split('`').step_by(2).filter(|key| !key.is_empty() && *key != ", "))
            .map(str::to_string)
            .collect()
    }

    #[test]
    fn the_page_names_every_key_of_status_and_result_and_no_other() {
        let (fleet, shared) = (vec!["a sentence".into()], Some("fragment 3".into()));
        let status = Status { fleet, shared, time_factor: Some(1.0), ..Status::default() };
        let status = serde_json::to_value(status).unwrap();
        let keys = status.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
        assert_eq!(keys_of("status.json"), keys);

        let result = JobResult {
            id: "a".into(),
            status: JobStatus::Done,
            code: "done".into(),
            message: String::new(),
            hint: String::new(),
            moves: 1,
            lower_bound: None,
            seconds: 1.0,
            times: BTreeMap::new(),
            links_off_mm: None,
            objects: Vec::new(),
        };
        let job = JobRecord::sample("a");
        let text = result.to_yaml() + &job.times_yaml();
        assert!(text.ends_with("started: null\nended: \"1970-01-01T00:01:00Z\"\n"), "{text}");
        let keys = text.lines().filter_map(|line| line.split_once(':')).map(|(key, _)| key.to_string());
        assert_eq!(keys_of("result.yaml"), keys.collect::<BTreeSet<_>>());
    }

    #[test]
    fn a_status_reads_back_and_speaks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("status.json");
        assert_eq!(Status::read(&path).unwrap(), None);
        let status = Status {
            daemon: "d1".into(),
            state: "executing".into(),
            armed: true,
            moving: true,
            job: Some("tidy".into()),
            step: Some((2, 7)),
            devices: vec![DeviceStatus {
                name: "gripper".into(),
                address: "127.0.0.2:5020".into(),
                identity: "confirmed by a person".into(),
                ready: false,
                age_s: Some(7.04),
                message: "no answer for 300 ms".into(),
            }],
            ..Status::default()
        };
        status.write(&path).unwrap();
        assert_eq!(Status::read(&path).unwrap(), Some(status.clone()));
        insta::assert_snapshot!(status.text(), @r"
        executing (armed): 
          job tidy, step 2 of 7
          0 waiting
          gripper at 127.0.0.2:5020: NOT READY, no answer for 300 ms, last answer 7 s ago (confirmed by a person)
        ");
        std::fs::write(&path, "{").unwrap();
        assert_eq!(Status::read(&path).unwrap(), None);
    }

    #[test]
    fn a_disarmed_or_paused_cell_that_finishes_its_move_says_that_the_arm_moves() {
        let of = |armed, paused, moving| Status { armed, paused, moving, ..Status::default() }.mode();
        assert_eq!(of(false, false, true), "disarmed, THE ARM MAY STILL MOVE");
        assert_eq!(of(true, true, true), "armed, paused, THE ARM MAY STILL MOVE");
        assert_eq!((of(true, false, true), of(false, false, false)), ("armed".into(), "disarmed".into()));
    }

    #[test]
    fn the_last_words_say_what_was_held_and_of_when_they_are() {
        let status = Status {
            written_unix_s: 1_795_248_000.0,
            state: "idle".into(),
            message: "ending".into(),
            holding: Some("holds lid".into()),
            stopped: Some(Stopped {
                code: "aborted".into(),
                message: "the operator stopped the cell".into(),
                hint: String::new(),
                job: None,
            }),
            hint: "`celld arm`".into(),
            ..Status::default()
        };
        insta::assert_snapshot!(status.last_words(), @r"
        its last status, of 2026-11-21T08:00:00Z: idle (disarmed): ending
          the arm was at rest
          stopped: the operator stopped the cell (aborted)
          gripper: holds lid
        ");
    }
}
