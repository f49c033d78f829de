//! A program that reads a camera or a file for celld, in a process of its own.
//!
//! In: a command, requests. Out: answers, a line of JSON each, and bytes where an answer announces some. A
//! library that crashes ends that process and not the daemon. A process that hangs is killed.

use crate::io::camera::CameraError;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time for the program to end once it is killed, or has closed its output; tests run on busy computers.
const END_LIMIT: Duration = Duration::from_secs(if cfg!(test) { 20 } else { 1 });
/// An answer's line has at most so many bytes.
const LINE_MAX: usize = 1 << 16;

/// The process that reads.
#[derive(Clone, Debug)]
pub(super) struct Process(Arc<Mutex<Child>>);

impl Process {
    fn child(&self) -> MutexGuard<'_, Child> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn kill(&self) {
        // One that has ended cannot be killed, and needs not be.
        let _ = self.child().kill();
    }

    /// Sends it a signal and waits for its end.
    #[cfg(test)]
    pub fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_child(&self.child());
        rustix::process::kill_process(pid, signal).expect("it runs");
        assert!(self.ends(END_LIMIT).is_some());
    }

    /// How it ended; `None` while it lives.
    pub fn ended(&self) -> Option<ExitStatus> {
        self.child().try_wait().ok().flatten()
    }

    /// The same, when it ends within that time.
    pub(super) fn ends(&self, within: Duration) -> Option<ExitStatus> {
        let until = Instant::now() + within;
        loop {
            match self.ended() {
                None if Instant::now() < until => std::thread::sleep(Duration::from_millis(2)),
                ended => return ended,
            }
        }
    }
}

/// Names for messages, and time limits.
#[derive(Clone, Debug)]
pub(super) struct Role {
    /// The program's name, for messages.
    pub name: &'static str,
    /// What it reads.
    pub place: PathBuf,
    /// How long an answer may take.
    pub limit: Duration,
    /// How long it may take to close its camera at the end of its input; then it is killed.
    pub stops_within: Duration,
}

/// A program that runs; it ends with the value.
#[derive(Debug)]
pub(super) struct Helper {
    role: Role,
    process: Process,
    requests: Option<ChildStdin>,
    replies: BufReader<ChildStdout>,
    /// An answer did not come in time.
    late: bool,
}

impl Drop for Helper {
    fn drop(&mut self) {
        self.requests = None;
        if self.late || self.process.ends(self.role.stops_within).is_none() {
            // If it hangs in a driver, the camera stays busy. We do not wait for it: the driver may never
            // return.
            self.process.kill();
            let _ = self.process.ends(END_LIMIT);
        }
    }
}

/// A cause that the process reported, as text.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Cause(pub String);

impl Helper {
    /// Starts the program.
    ///
    /// # Errors
    /// `NoReader` without the program.
    pub fn start(mut command: Command, role: Role) -> Result<Helper, CameraError> {
        let program = PathBuf::from(command.get_program());
        let no_reader =
            |source| CameraError::NoReader { place: role.place.display().to_string(), program, source };
        // A group of its own: Ctrl-C at a terminal is celld's alone, which ends it when it needs no more
        // pictures.
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).process_group(0);
        let mut child = match command.spawn() {
            Ok(child) => child,
            Err(error) => return Err(no_reader(error)),
        };
        let (Some(requests), Some(replies)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(no_reader(std::io::Error::other("it has no pipes")));
        };
        let replies = BufReader::with_capacity(1 << 16, replies);
        let process = Process(Arc::new(Mutex::new(child)));
        Ok(Helper { role, process, requests: Some(requests), replies, late: false })
    }

    /// The process, which a driver may keep after the value is gone.
    pub fn process(&self) -> Process {
        self.process.clone()
    }

    /// From now on an answer may take `limit`.
    pub fn set_limit(&mut self, limit: Duration) {
        self.role.limit = limit;
    }

    /// Its answer; `None` if that cannot be read.
    ///
    /// # Errors
    /// `Silent` without an answer in time: the process is killed then. `Video` when it has ended.
    pub fn request<A: DeserializeOwned>(
        &mut self,
        request: &impl Serialize,
    ) -> Result<Option<A>, CameraError> {
        let mut line =
            serde_json::to_vec(request).map_err(|error| self.failed("its path is no text", error))?;
        line.push(b'\n');
        let sent = self.requests.as_mut().is_some_and(|requests| requests.write_all(&line).is_ok());
        if self.late || !sent {
            return Err(self.ended());
        }
        let (mut line, until) = (Vec::new(), Instant::now() + self.role.limit);
        while line.last() != Some(&b'\n') {
            let read = self.fill(until)?;
            let end = read.iter().position(|&byte| byte == b'\n').map_or(read.len(), |at| at + 1);
            line.extend_from_slice(&read[..end]);
            self.replies.consume(end);
            if line.len() > LINE_MAX {
                return Ok(None);
            }
        }
        Ok(serde_json::from_slice(&line).ok())
    }

    /// So many bytes that its last answer announced.
    ///
    /// # Errors
    /// As [`Helper::request`].
    pub fn bytes(&mut self, count: usize) -> Result<Vec<u8>, CameraError> {
        // No room is made for what does not come.
        let (mut bytes, until) = (Vec::new(), Instant::now() + self.role.limit);
        while bytes.len() < count {
            let read = self.fill(until)?;
            let part = &read[..read.len().min(count - bytes.len())];
            bytes.extend_from_slice(part);
            let used = part.len();
            self.replies.consume(used);
        }
        Ok(bytes)
    }

    /// What has come of the answers, at least a byte. One that comes late would be taken for that of the
    /// next request: the process ends.
    fn fill(&mut self, until: Instant) -> Result<&[u8], CameraError> {
        while self.replies.buffer().is_empty() {
            let left = Timespec::try_from(until.saturating_duration_since(Instant::now())).ok();
            match poll(&mut [PollFd::new(self.replies.get_ref(), PollFlags::IN)], left.as_ref()) {
                Ok(0) => {
                    self.late = true;
                    self.process.kill();
                    let place = self.role.place.display().to_string();
                    return Err(CameraError::Silent { place, limit: self.role.limit });
                }
                Ok(_) => {}
                Err(Errno::INTR) => continue,
                Err(error) => return Err(self.failed("its pictures cannot be waited for", error)),
            }
            match self.replies.fill_buf() {
                Ok([]) => return Err(self.ended()),
                Err(error) if error.kind() != ErrorKind::Interrupted => {
                    return Err(self.failed("its pictures cannot be read", error));
                }
                Ok(_) | Err(_) => {}
            }
        }
        Ok(self.replies.buffer())
    }

    fn ended(&mut self) -> CameraError {
        let how = self
            .process
            .ends(END_LIMIT)
            .map_or_else(|| "its output ended".to_string(), |status| status.to_string());
        self.failed(&format!("{} ended", self.role.name), Cause(how))
    }

    /// That it cannot be read, and why.
    pub fn failed(&self, what: &str, error: impl std::error::Error + Send + Sync + 'static) -> CameraError {
        CameraError::Video { path: self.role.place.clone(), what: what.into(), source: Some(error.into()) }
    }
}
