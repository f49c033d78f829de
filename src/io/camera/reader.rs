//! Pictures that `celld-video` reads: videos and USB cameras, in a process of its own.
//!
//! In: what is to be read ([`Source`]). Out: its pictures, one for each request, over the [`wire`]. OpenCV's
//! videoio loads FFmpeg and GDAL, 219 shared libraries, which would cost each start of celld 0.15 s; and a
//! video that breaks a decoder, or a driver that does not answer, ends that process and not the daemon.
//!
//! [`wire`]: crate::io::camera::wire

use crate::io::camera::CameraError;
use crate::io::camera::wire::{Reply, Request, Source, WIRE};
use cell_values::image::Image;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serde::Serialize;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The program's name.
const PROGRAM: &str = "celld-video";
/// Names the program where it is not beside celld.
const PROGRAM_KEY: &str = "CELLD_VIDEO";
/// Time for the first answer at least: libraries are loaded, and a camera agrees on its stream.
const START_LIMIT: Duration = Duration::from_secs(10);
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

    /// How it ended; `None` while it lives.
    pub fn ended(&self) -> Option<ExitStatus> {
        self.child().try_wait().ok().flatten()
    }

    /// The same, when it ends soon.
    fn ends(&self) -> Option<ExitStatus> {
        let until = Instant::now() + END_LIMIT;
        loop {
            match self.ended() {
                None if Instant::now() < until => std::thread::sleep(Duration::from_millis(2)),
                ended => return ended,
            }
        }
    }
}

/// A source that is open; the process ends with the value.
#[derive(Debug)]
pub(super) struct Reader {
    path: PathBuf,
    limit: Duration,
    process: Process,
    requests: ChildStdin,
    replies: BufReader<ChildStdout>,
    /// An answer did not come in time.
    late: bool,
}

impl Drop for Reader {
    fn drop(&mut self) {
        // It may wait for a driver, which would keep the camera from whoever opens it next. One that the
        // driver does not let go is not waited for.
        self.process.kill();
        let _ = self.process.ends();
    }
}

/// Why not, on the way through the other process.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Cause(String);

impl Reader {
    /// Starts the program and opens the source. An answer may take `limit`, each.
    ///
    /// # Errors
    /// `NoReader` without the program, `Setting` and `Video` for what it cannot open, `Silent` if it does
    /// not answer in time.
    pub fn open(source: &Source, limit: Duration) -> Result<Reader, CameraError> {
        let mut reader = Reader::start(Command::new(program()), source, limit.max(START_LIMIT))?;
        reader.limit = limit;
        Ok(reader)
    }

    fn start(mut command: Command, source: &Source, limit: Duration) -> Result<Reader, CameraError> {
        let (Source::Video { path } | Source::Device { path, .. }) = source;
        let program = PathBuf::from(command.get_program());
        let no_reader = |source| CameraError::NoReader { place: path.display().to_string(), program, source };
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
        let mut reader = Reader { path: path.clone(), limit, process, requests, replies, late: false };
        match reader.request(source)? {
            Reply::Open { wire: WIRE } => Ok(reader),
            Reply::Open { .. } => Err(reader.of_another_version()),
            other => Err(reader.unexpected(other)),
        }
    }

    /// The process, which a driver may keep after the value is gone.
    pub fn process(&self) -> Process {
        self.process.clone()
    }

    /// Takes the next picture: when it was taken, ms, as in [`Reply::Grabbed`]; `None` at the end of a
    /// video, and where a device gives nothing.
    ///
    /// # Errors
    /// `Video` for what cannot be read, `Silent` without an answer in time: it is of no further use then.
    pub fn grab(&mut self) -> Result<Option<f64>, CameraError> {
        match self.request(&Request::Grab)? {
            Reply::Grabbed { time_ms } => Ok(Some(time_ms)),
            Reply::End => Ok(None),
            other => Err(self.unexpected(other)),
        }
    }

    /// The picture that was taken last.
    ///
    /// # Errors
    /// As [`Reader::grab`].
    pub fn picture(&mut self) -> Result<Image, CameraError> {
        let (width, height) = match self.request(&Request::Picture)? {
            Reply::Picture { width, height } => (width, height),
            other => return Err(self.unexpected(other)),
        };
        // No room is made for pixels that do not come.
        let bytes = 3_usize.saturating_mul(width as usize).saturating_mul(height as usize);
        let (mut rgb, until) = (Vec::new(), Instant::now() + self.limit);
        while rgb.len() < bytes {
            let read = self.fill(until)?;
            let part = &read[..read.len().min(bytes - rgb.len())];
            rgb.extend_from_slice(part);
            let used = part.len();
            self.replies.consume(used);
        }
        Image::from_rgb(width, height, rgb)
            .map_err(|error| self.failed("what is read of it is no picture", error))
    }

    fn request(&mut self, request: &impl Serialize) -> Result<Reply, CameraError> {
        let mut line =
            serde_json::to_vec(request).map_err(|error| self.failed("its path is no text", error))?;
        line.push(b'\n');
        if self.late || self.requests.write_all(&line).is_err() {
            return Err(self.ended());
        }
        let (mut line, until) = (Vec::new(), Instant::now() + self.limit);
        while line.last() != Some(&b'\n') {
            let read = self.fill(until)?;
            let end = read.iter().position(|&byte| byte == b'\n').map_or(read.len(), |at| at + 1);
            line.extend_from_slice(&read[..end]);
            self.replies.consume(end);
            if line.len() > LINE_MAX {
                return Err(self.of_another_version());
            }
        }
        serde_json::from_slice(&line).map_err(|_| self.of_another_version())
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
                    let place = self.path.display().to_string();
                    return Err(CameraError::Silent { place, limit: self.limit });
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

    fn unexpected(&self, reply: Reply) -> CameraError {
        match reply {
            Reply::Failed { what, setting: true, .. } => {
                CameraError::Setting { place: self.path.display().to_string(), what }
            }
            Reply::Failed { what, setting: false, cause } => CameraError::Video {
                path: self.path.clone(),
                what,
                source: cause.map(|cause| Cause(cause).into()),
            },
            Reply::Open { .. } | Reply::End | Reply::Grabbed { .. } | Reply::Picture { .. } => {
                self.of_another_version()
            }
        }
    }

    fn of_another_version(&self) -> CameraError {
        let what = "celld-video, which reads it, is of another version than celld: start celld anew".into();
        CameraError::Setting { place: self.path.display().to_string(), what }
    }

    fn ended(&mut self) -> CameraError {
        let how =
            self.process.ends().map_or_else(|| "its output ended".to_string(), |status| status.to_string());
        self.failed("celld-video, which reads it, ended", Cause(how))
    }

    fn failed(&self, what: &str, error: impl std::error::Error + Send + Sync + 'static) -> CameraError {
        CameraError::Video { path: self.path.clone(), what: what.into(), source: Some(error.into()) }
    }

    /// With another program in its place, in POSIX shell; what it reads is any video.
    ///
    /// # Errors
    /// As [`Reader::open`].
    #[cfg(test)]
    pub fn scripted(script: &str, limit: Duration) -> Result<Reader, CameraError> {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", &format!("read source\n{script}")]);
        Reader::start(command, &Source::Video { path: "looks.avi".into() }, limit)
    }
}

/// The program: as the environment has it, or beside celld. Cargo puts tests one folder further down.
fn program() -> PathBuf {
    if let Some(named) = std::env::var_os(PROGRAM_KEY).filter(|named| !named.is_empty()) {
        return named.into();
    }
    let own = std::env::current_exe().unwrap_or_default();
    let beside = own.with_file_name(PROGRAM);
    let above =
        own.parent().filter(|folder| folder.ends_with("deps")).map(|deps| deps.with_file_name(PROGRAM));
    above.filter(|_| !beside.exists()).unwrap_or(beside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;

    const LIMIT: Duration = Duration::from_secs(20);
    const OPEN: &str = "echo '{\"open\":{\"wire\":1}}'; read request";

    fn error_of(script: &str) -> CameraError {
        Reader::scripted(script, LIMIT).map(drop).unwrap_err()
    }

    #[test]
    fn without_the_program_it_is_named() {
        let source = Source::Video { path: "looks.avi".into() };
        let error =
            Reader::start(Command::new("/nowhere/celld-video"), &source, LIMIT).map(drop).unwrap_err();
        assert!(matches!(error, CameraError::NoReader { .. }));
        assert!(error.to_string().contains("/nowhere/celld-video"), "{error}");
    }

    #[test]
    fn an_answer_that_does_not_come_ends_the_program() {
        // `read` ends with its input alone, as the program does that waits for a driver.
        for script in [OPEN, &format!("{OPEN}; printf '{{\"grab'")] {
            let mut reader = Reader::scripted(&format!("{script}; read never"), LIMIT).unwrap();
            reader.limit = Duration::from_millis(50);
            assert!(matches!(reader.grab(), Err(CameraError::Silent { .. })));
            assert!(reader.process.ends().is_some_and(|status| !status.success()), "it was killed");
            let error = reader.grab().unwrap_err();
            assert!(error.to_string().contains("ended"), "an answer that came late is of no use: {error}");
        }
    }

    #[test]
    fn a_program_of_another_version_is_named() {
        for script in [
            "echo hello",
            "echo '{\"open\":{\"wire\":2}}'",
            "echo '{\"picture\":{\"width\":1,\"height\":1}}'",
            "head -c 100000 /dev/zero",
        ] {
            let error = error_of(script);
            assert!(matches!(error, CameraError::Setting { .. }), "{script}: {error}");
            assert!(error.to_string().contains("start celld anew"), "{script}: {error}");
        }
    }

    #[test]
    fn how_a_program_ended_is_said() {
        let cause = |error: &CameraError| error.source().map(ToString::to_string).unwrap_or_default();
        let error = error_of("exit 127");
        assert!(cause(&error).contains("127"), "{error}: {}", cause(&error));
        // In the middle of the pixels, of which there are more than there is memory for.
        let size = "{\"picture\":{\"width\":4000000000,\"height\":4000000000}}";
        let script = format!("{OPEN}; echo '{size}'; echo x; kill -SEGV $$");
        let error = Reader::scripted(&script, LIMIT).unwrap().picture().unwrap_err();
        assert!(cause(&error).contains("signal: 11"), "{error}: {}", cause(&error));
    }

    #[test]
    fn what_the_program_cannot_do_is_a_setting_or_a_fault() {
        let failed = |setting: bool, cause: &str| {
            let what = "\"what\":\"its rate is 15\"";
            error_of(&format!("echo '{{\"failed\":{{{what},\"setting\":{setting},\"cause\":{cause}}}}}'"))
        };
        let error = failed(true, "null");
        assert!(matches!(error, CameraError::Setting { .. }), "{error}");
        let error = failed(false, "\"no codec\"");
        assert_eq!(error.source().map(ToString::to_string).as_deref(), Some("no codec"));
    }
}
