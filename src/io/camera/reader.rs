//! Pictures that `celld-video` reads: videos and USB cameras, in a process of its own.
//!
//! In: what is to be read ([`Source`]). Out: its pictures, one for each request, over the [`wire`]. OpenCV's
//! videoio loads FFmpeg and GDAL, 219 shared libraries, which would cost each start of celld 0.15 s; and a
//! video that breaks a decoder, or a driver that does not answer, ends that process and not the daemon
//! (`helper`).
//!
//! [`wire`]: crate::io::camera::wire

use crate::io::camera::CameraError;
use crate::io::camera::helper::{Cause, Helper, Process, Role};
use crate::io::camera::wire::{Reply, Request, Source, WIRE};
use cell_values::image::Image;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// The program's name.
const PROGRAM: &str = "celld-video";
/// Names the program where it is not beside celld.
const PROGRAM_KEY: &str = "CELLD_VIDEO";
/// Time for the first answer at least: libraries are loaded, and a camera agrees on its stream.
const START_LIMIT: Duration = Duration::from_secs(10);

/// A source that is open; the process ends with the value.
#[derive(Debug)]
pub(super) struct Reader {
    path: PathBuf,
    helper: Helper,
}

impl Reader {
    /// Starts the program and opens the source. An answer may take `limit`, each.
    ///
    /// # Errors
    /// `NoReader` without the program, `Setting` and `Video` for what it cannot open, `Silent` if it does
    /// not answer in time.
    pub fn open(source: &Source, limit: Duration) -> Result<Reader, CameraError> {
        let mut reader = Reader::start(Command::new(program()), source, limit.max(START_LIMIT))?;
        reader.helper.set_limit(limit);
        Ok(reader)
    }

    fn start(command: Command, source: &Source, limit: Duration) -> Result<Reader, CameraError> {
        let (Source::Video { path } | Source::Device { path, .. }) = source;
        // The kernel ends the stream of a process that is killed.
        let role = Role { name: PROGRAM, place: path.clone(), limit, stops_within: Duration::ZERO };
        let mut reader = Reader { path: path.clone(), helper: Helper::start(command, role)? };
        match reader.helper.request(source)? {
            Some(Reply::Open { wire: WIRE }) => Ok(reader),
            other => Err(reader.unexpected(other)),
        }
    }

    /// The process, which a driver may keep after the value is gone.
    pub fn process(&self) -> Process {
        self.helper.process()
    }

    /// Takes the next picture: when it was taken, ms, as in [`Reply::Grabbed`]; `None` at the end of a
    /// video, and where a device gives nothing.
    ///
    /// # Errors
    /// `Video` for what cannot be read, `Silent` without an answer in time: it is of no further use then.
    pub fn grab(&mut self) -> Result<Option<f64>, CameraError> {
        match self.helper.request(&Request::Grab)? {
            Some(Reply::Grabbed { time_ms }) => Ok(Some(time_ms)),
            Some(Reply::End) => Ok(None),
            other => Err(self.unexpected(other)),
        }
    }

    /// The picture that was taken last.
    ///
    /// # Errors
    /// As [`Reader::grab`].
    pub fn picture(&mut self) -> Result<Image, CameraError> {
        let (width, height) = match self.helper.request(&Request::Picture)? {
            Some(Reply::Picture { width, height }) => (width, height),
            other => return Err(self.unexpected(other)),
        };
        let rgb =
            self.helper.bytes(3_usize.saturating_mul(width as usize).saturating_mul(height as usize))?;
        Image::from_rgb(width, height, rgb)
            .map_err(|error| self.helper.failed("what is read of it is no picture", error))
    }

    fn unexpected(&self, reply: Option<Reply>) -> CameraError {
        match reply {
            Some(Reply::Failed { what, setting: true, .. }) => {
                CameraError::Setting { place: self.path.display().to_string(), what }
            }
            Some(Reply::Failed { what, setting: false, cause }) => CameraError::Video {
                path: self.path.clone(),
                what,
                source: cause.map(|cause| Cause(cause).into()),
            },
            Some(Reply::Open { .. } | Reply::End | Reply::Grabbed { .. } | Reply::Picture { .. }) | None => {
                let what = "celld-video, which reads it, is of another version than celld: restart celld";
                CameraError::Setting { place: self.path.display().to_string(), what: what.into() }
            }
        }
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
            reader.helper.set_limit(Duration::from_millis(50));
            assert!(matches!(reader.grab(), Err(CameraError::Silent { .. })));
            let ended = reader.process().ends(LIMIT);
            assert!(ended.is_some_and(|status| !status.success()), "it was killed");
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
            assert!(error.to_string().contains("restart celld"), "{script}: {error}");
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
