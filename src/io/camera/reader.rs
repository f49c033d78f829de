//! Pictures that `celld-video` reads: videos and USB cameras, in a process of its own.
//!
//! In: what is to be read ([`Source`]). Out: its pictures, one for each request. OpenCV's videoio loads
//! FFmpeg and GDAL, 219 shared libraries, which would cost each start of celld 0.15 s; and a video that
//! breaks a decoder, or a driver that blocks for ever, ends that process and not the daemon.
//!
//! The wire: a line of JSON for each request, [`Source`] first, then [`Request`]s; a line of JSON for each
//! answer ([`Reply`]), and after that of a picture its pixels: 3 bytes each, red, green, blue, row by row.

use crate::io::camera::CameraError;
use cell_values::image::Image;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

/// The program's name.
pub const PROGRAM: &str = "celld-video";
/// Names the program where it is not beside celld.
const PROGRAM_KEY: &str = "CELLD_VIDEO";
/// Time for the first answer at least: libraries are loaded, and a camera agrees on its stream.
const START_LIMIT: Duration = Duration::from_secs(10);
/// An answer's line has at most so many bytes.
const LINE_MAX: u64 = 1 << 16;

/// What is to be read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Source {
    /// A video file.
    Video {
        /// Which.
        path: PathBuf,
    },
    /// A camera of the kernel's (V4L2).
    Device {
        /// Its device file.
        path: PathBuf,
        /// Pixels per row and rows.
        size: [u32; 2],
        /// Pictures a second.
        rate: u32,
        /// Microseconds of exposure; none: the camera decides.
        exposure_us: Option<f64>,
    },
}

impl Source {
    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            Source::Video { path } | Source::Device { path, .. } => path,
        }
    }
}

/// What is requested after the source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// The next picture.
    Next,
}

/// What is answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Reply {
    /// The source is open.
    Open,
    /// A picture; its pixels follow.
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Milliseconds: of a video since its beginning, of a device the driver's stamp; 0 without one.
        time_ms: f64,
    },
    /// A video is over, or a device gave nothing.
    End,
    /// It does not work.
    Failed {
        /// What does not, and what to do.
        what: String,
        /// True when other settings would mend it.
        setting: bool,
        /// What OpenCV says, if anything.
        cause: Option<String>,
    },
}

/// A picture of a source.
#[derive(Debug)]
pub(super) struct Picture {
    /// The picture.
    pub image: Image,
    /// As in [`Reply::Picture`].
    pub time_ms: f64,
}

/// A source that is open; the process ends with the value.
#[derive(Debug)]
pub(super) struct Reader {
    path: PathBuf,
    limit: Duration,
    child: Child,
    requests: ChildStdin,
    replies: BufReader<ChildStdout>,
    /// An answer did not come in time.
    late: bool,
}

impl Drop for Reader {
    fn drop(&mut self) {
        // It may wait for a driver, which would keep the camera from whoever opens it next.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What OpenCV says, on the way through the other process.
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
        let program = PathBuf::from(command.get_program());
        let place = source.path().display().to_string();
        let no_reader = |source| CameraError::NoReader { place, program, source };
        let mut child = match command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn() {
            Ok(child) => child,
            Err(error) => return Err(no_reader(error)),
        };
        let (Some(requests), Some(replies)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(no_reader(std::io::Error::other("it has no pipes")));
        };
        let (path, replies) = (source.path().to_owned(), BufReader::new(replies));
        let mut reader = Reader { path, limit, child, requests, replies, late: false };
        match reader.ask(source)? {
            Reply::Open => Ok(reader),
            other => Err(reader.unexpected(other)),
        }
    }

    /// The next picture; `None` at the end of a video, and where a device gives nothing.
    ///
    /// # Errors
    /// `Video` for what cannot be decoded, `Silent` without an answer in time: it is of no further
    /// use then.
    pub fn next(&mut self) -> Result<Option<Picture>, CameraError> {
        let (width, height, time_ms) = match self.ask(&Request::Next)? {
            Reply::Picture { width, height, time_ms } => (width, height, time_ms),
            Reply::End => return Ok(None),
            other => return Err(self.unexpected(other)),
        };
        let bytes = u64::from(width).saturating_mul(3).saturating_mul(height.into());
        let mut rgb = Vec::new();
        match (&mut self.replies).take(bytes).read_to_end(&mut rgb) {
            Ok(read) if read as u64 == bytes => {}
            Ok(_) => return Err(self.ended(std::io::ErrorKind::UnexpectedEof.into())),
            Err(error) => return Err(self.ended(error)),
        }
        let image = Image::from_rgb(width, height, rgb)
            .map_err(|error| self.failed("what is read of it is no picture", error))?;
        Ok(Some(Picture { image, time_ms }))
    }

    fn ask(&mut self, request: &impl Serialize) -> Result<Reply, CameraError> {
        let mut line =
            serde_json::to_vec(request).map_err(|error| self.failed("its path is no text", error))?;
        line.push(b'\n');
        if self.late {
            return Err(self.ended(std::io::ErrorKind::TimedOut.into()));
        }
        if let Err(error) = self.requests.write_all(&line) {
            return Err(self.ended(error));
        }
        self.wait()?;
        let mut line = Vec::new();
        match (&mut self.replies).take(LINE_MAX).read_until(b'\n', &mut line) {
            Ok(0) => Err(self.ended(std::io::ErrorKind::UnexpectedEof.into())),
            Ok(_) => serde_json::from_slice(&line)
                .map_err(|error| self.failed("celld-video is of another version than celld", error)),
            Err(error) => Err(self.ended(error)),
        }
    }

    /// Waits for an answer's first byte. One that comes late would be taken for that of the next request:
    /// the process ends.
    fn wait(&mut self) -> Result<(), CameraError> {
        let limit = Timespec::try_from(self.limit).ok();
        match poll(&mut [PollFd::new(self.replies.get_ref(), PollFlags::IN)], limit.as_ref()) {
            Ok(0) => {
                self.late = true;
                let _ = self.child.kill();
                Err(CameraError::Silent { place: self.path.display().to_string(), limit: self.limit })
            }
            // An interrupted wait, too: reading waits as well.
            _ => Ok(()),
        }
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
            Reply::Open | Reply::End | Reply::Picture { .. } => CameraError::Video {
                path: self.path.clone(),
                what: "celld-video gave another answer than was requested".into(),
                source: None,
            },
        }
    }

    fn ended(&self, error: std::io::Error) -> CameraError {
        self.failed("celld-video, which reads it, ended", error)
    }

    fn failed(&self, what: &str, error: impl std::error::Error + Send + Sync + 'static) -> CameraError {
        CameraError::Video { path: self.path.clone(), what: what.into(), source: Some(error.into()) }
    }
}

/// The program: as the environment has it, or beside celld. Cargo puts tests one folder further down.
fn program() -> PathBuf {
    if let Some(named) = std::env::var_os(PROGRAM_KEY).filter(|named| !named.is_empty()) {
        return named.into();
    }
    let own = std::env::current_exe().unwrap_or_default();
    let beside = own.with_file_name(PROGRAM);
    let above = own.parent().map(|folder| folder.with_file_name(PROGRAM));
    match above {
        Some(above) if !beside.exists() && above.exists() => above,
        _ => beside,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Another program in its place, in POSIX shell; the source is any.
    fn opened(script: &str, limit_ms: u64) -> Result<Reader, CameraError> {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", &format!("read source\n{script}")]);
        started(command, limit_ms)
    }

    fn started(command: Command, limit_ms: u64) -> Result<Reader, CameraError> {
        let source = Source::Video { path: "looks.avi".into() };
        Reader::start(command, &source, Duration::from_millis(limit_ms))
    }

    fn error_of(opened: Result<Reader, CameraError>) -> CameraError {
        opened.map(drop).unwrap_err()
    }

    #[test]
    fn without_the_program_it_is_named() {
        let error = error_of(started(Command::new("/nowhere/celld-video"), 1000));
        assert!(matches!(error, CameraError::NoReader { .. }));
        assert!(error.to_string().contains("/nowhere/celld-video"), "{error}");
    }

    #[test]
    fn an_answer_that_does_not_come_ends_the_program() {
        // `read` ends with its input alone, as the program does that waits for a driver.
        let error = error_of(opened("read never", 50));
        assert!(matches!(error, CameraError::Silent { .. }), "{error}");
        let mut reader = opened("echo '\"open\"'; read next; read never", 300).unwrap();
        assert!(matches!(reader.next(), Err(CameraError::Silent { .. })));
        assert!(!reader.child.wait().unwrap().success(), "it was killed");
        let error = reader.next().unwrap_err();
        assert!(error.to_string().contains("ended"), "an answer that came late is of no use: {error}");
    }

    #[test]
    fn a_program_that_ends_or_does_not_answer_as_agreed_is_an_error() {
        for (script, words) in [
            ("", "ended"),
            ("echo hello", "another version"),
            ("echo '{\"picture\":{\"width\":1,\"height\":1,\"time_ms\":0}}'", "another answer"),
            ("head -c 100000 /dev/zero", "another version"),
        ] {
            let error = error_of(opened(script, 10_000));
            assert!(error.to_string().contains(words), "{script}: {error}");
        }
        // More pixels than there is memory for, and too few of them.
        let size = "{\"picture\":{\"width\":4000000000,\"height\":4000000000,\"time_ms\":0}}";
        let mut reader =
            opened(&format!("echo '\"open\"'; read next; echo '{size}'; echo x"), 10_000).unwrap();
        assert!(reader.next().unwrap_err().to_string().contains("ended"));
    }

    #[test]
    fn what_the_program_cannot_do_is_a_setting_or_a_fault() {
        let failed = |setting: bool, cause: &str| {
            let reply =
                format!("{{\"failed\":{{\"what\":\"its rate is 15\",\"setting\":{setting},{cause}}}}}");
            error_of(opened(&format!("echo '{reply}'"), 10_000))
        };
        let error = failed(true, "\"cause\":null");
        assert!(matches!(error, CameraError::Setting { .. }), "{error}");
        let error = failed(false, "\"cause\":\"no codec\"");
        assert_eq!(std::error::Error::source(&error).map(ToString::to_string).as_deref(), Some("no codec"));
    }
}
