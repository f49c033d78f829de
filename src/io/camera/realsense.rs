//! A RealSense camera, or a recording of one, through librealsense2.
//!
//! In: settings (which camera or file, size, rate, exposure, depth or not). Out: colour pictures with the
//! camera's own count and time, depth laid over the colour picture, the factory's lens. The SDK runs in a
//! process of its own (`process`), which is celld's own binary: now and then the SDK corrupts its heap
//! (2.59: one recording in some thousands on a busy computer, also when a C program plays it), and in the
//! daemon that would end the control loop. In that process `sdk` loads the library, `stream` starts it,
//! `player` waits for pictures and `picture` turns what comes into our values.

mod picture;
mod player;
mod process;
pub mod sdk;
mod stream;

pub use process::serve;
pub use stream::RealSenseSettings;

use crate::io::camera::helper::{Cause, Helper, Process, Role};
use crate::io::camera::realsense::process::{GRAB, Reply, Task};
use crate::io::camera::realsense::sdk::Intrinsics;
use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_vision::camera::CameraModel;
use picture::factory_lens;
use rearrange::document::chain::chain;
use rustix::process::Signal;
use std::ffi::{OsStr, OsString};
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::time::{Duration, Instant};
use stream::place_of;

/// The process's name in messages.
const NAME: &str = "the process of the RealSense SDK";
/// What the process may take longer than a set of frames: the SDK loads and starts its streams, and the
/// first pictures are passed over.
const HUNG_AFTER: Duration = Duration::from_secs(10);
/// Time to stop the streams at an orderly end: a camera that is cut off may have to be restarted.
const FAREWELL: Duration = Duration::from_secs(3);
/// How often the process is started again in a row when it crashes.
const STARTS: u32 = 3;
/// How long a camera that was restarted may take to come back.
const BACK_WITHIN: Duration = Duration::from_secs(12);
/// Before the next try to open it.
const PAUSE: Duration = Duration::from_millis(200);

/// A RealSense camera.
pub struct RealSenseCamera {
    /// What is started to read it, with its arguments.
    program: Vec<OsString>,
    settings: RealSenseSettings,
    limit: Duration,
    lens: Option<CameraModel>,
    running: Option<Running>,
    /// The process before, while a driver keeps it: it has the camera.
    process: Option<Process>,
    watch: FrameValidator,
    taken: u64,
    /// Number of the picture handed out last.
    last: Option<u64>,
}

/// A process that streams.
struct Running {
    helper: Helper,
    serial: String,
    lens: Option<Intrinsics>,
}

impl RealSenseCamera {
    /// Starts the stream. A picture may take up to `limit`.
    ///
    /// # Errors
    /// `File` without the recording, `OtherSerial`, `Model` when the lens is for another size, `Reported`
    /// with what the SDK or its process says, `Silent` and `Video` when the process hangs or ends.
    pub fn open(
        settings: RealSenseSettings,
        limit: Duration,
        lens: Option<CameraModel>,
    ) -> Result<RealSenseCamera, CameraError> {
        if let Some(path) = &settings.file {
            std::fs::File::open(path).map_err(|source| CameraError::File { path: path.clone(), source })?;
        }
        RealSenseCamera::read_by(own_program(), settings, limit, lens)
    }

    fn read_by(
        program: Vec<OsString>,
        settings: RealSenseSettings,
        limit: Duration,
        lens: Option<CameraModel>,
    ) -> Result<RealSenseCamera, CameraError> {
        let (running, process, watch) = (None, None, FrameValidator::default());
        let mut camera =
            RealSenseCamera { program, settings, limit, lens, running, process, watch, taken: 0, last: None };
        camera.start()?;
        Ok(camera)
    }

    fn start(&mut self) -> Result<(), CameraError> {
        // One process at a time has the camera.
        self.running = None;
        let place = place_of(&self.settings);
        if self.process.as_ref().is_some_and(|process| process.ended().is_none()) {
            return Err(CameraError::Silent { place, limit: self.limit });
        }
        let running = self.again_after_crashes(RealSenseCamera::process_that_streams)?;
        let wanted = self.lens.as_ref().map(|lens| &lens.serial).or(self.settings.serial.as_ref());
        if let Some(wanted) = wanted.filter(|wanted| **wanted != running.serial) {
            let (found, wanted) = (running.serial, wanted.clone());
            return Err(CameraError::OtherSerial { address: place, found, wanted });
        }
        if let (Some(lens), Some(own)) = (&self.lens, running.lens) {
            lens.check_picture(own.width.unsigned_abs(), own.height.unsigned_abs())?;
        }
        self.running = Some(running);
        Ok(())
    }

    fn process_that_streams(&mut self) -> Result<Running, CameraError> {
        let task = Task::Stream { settings: self.settings.clone(), limit: self.limit };
        let mut helper = self.helper()?;
        self.process = Some(helper.process());
        match helper.request(&task)? {
            Reply::Open { serial, lens } => Ok(Running { helper, serial, lens }),
            other => Err(unexpected(&helper, other)),
        }
    }

    /// What comes of it, tried again while the process crashes.
    fn again_after_crashes<T>(
        &mut self,
        mut go: impl FnMut(&mut RealSenseCamera) -> Result<T, CameraError>,
    ) -> Result<T, CameraError> {
        let mut starts = 1;
        loop {
            match go(self) {
                Err(error) if starts < STARTS && self.has_crashed() => {
                    tracing::warn!(error = chain(&error), "camera: started again");
                    starts += 1;
                }
                done => return done,
            }
        }
    }

    /// True when a signal ended the process, and none of ours.
    fn has_crashed(&self) -> bool {
        let ended = self.process.as_ref().and_then(Process::ended);
        ended.and_then(|status| status.signal()).is_some_and(|signal| signal != Signal::KILL.as_raw())
    }

    fn helper(&self) -> Result<Helper, CameraError> {
        let mut words = self.program.iter();
        let mut command = Command::new(words.next().map_or(OsStr::new(""), OsString::as_os_str));
        command.args(words);
        let (place, limit) = (place_of(&self.settings).into(), self.limit + HUNG_AFTER);
        Helper::start(command, Role { name: NAME, place, limit, farewell: FAREWELL })
    }

    /// The next picture, of a process that may have to be started first.
    fn next(&mut self) -> Result<Frame, CameraError> {
        if self.running.is_none() {
            if self.is_live() {
                self.watch.restarted();
            }
            self.start()?;
        }
        let place = place_of(&self.settings);
        let Some(mut running) = self.running.take() else {
            return Err(CameraError::Silent { place, limit: Duration::ZERO });
        };
        let frame = match running.helper.request(&GRAB)? {
            Reply::Picture { width, height, sequence, time_s, depth } => {
                let broken = |source| CameraError::Picture { place: place.clone(), source };
                let pixels = (width as usize).saturating_mul(height as usize);
                let rgb = running.helper.bytes(pixels.saturating_mul(3))?;
                let image = Image::from_rgb(width, height, rgb).map_err(broken)?;
                let depth = match depth {
                    true => Some(running.helper.bytes(pixels.saturating_mul(4))?),
                    false => None,
                };
                let depth = depth.map(|bytes| depth_of(width, height, &bytes).map_err(broken)).transpose()?;
                Ok(Frame { image, sequence, time_s, source: place.clone(), depth })
            }
            Reply::End => Err(CameraError::EndOfRecording { place, frames: self.taken }),
            other => Err(unexpected(&running.helper, other)),
        };
        // One that answers is kept, whatever it says; one that does not ends with the value.
        self.running = Some(running);
        frame
    }

    /// The same; of a recording none that was handed out before. It plays from its beginning when its
    /// process had to be started again.
    fn next_new(&mut self) -> Result<Frame, CameraError> {
        loop {
            let frame = match self.is_live() {
                true => self.next()?,
                false => self.again_after_crashes(RealSenseCamera::next)?,
            };
            if self.is_live() || self.last.is_none_or(|last| frame.sequence > last) {
                return Ok(frame);
            }
        }
    }

    fn restart(&self) -> Result<(), CameraError> {
        let lens = self.lens.as_ref().map(|lens| lens.serial.clone());
        let settings =
            RealSenseSettings { serial: lens.or(self.settings.serial.clone()), ..self.settings.clone() };
        let mut helper = self.helper()?;
        match helper.request(&Task::Restart { settings })? {
            Reply::Restarted => Ok(()),
            other => Err(unexpected(&helper, other)),
        }
    }
}

fn unexpected(helper: &Helper, reply: Reply) -> CameraError {
    match reply {
        Reply::Failed { kind, what, cause } => {
            CameraError::Reported { kind, what, source: cause.map(|cause| Cause(cause).into()) }
        }
        Reply::Open { .. } | Reply::Picture { .. } | Reply::End | Reply::Restarted => {
            helper.of_another_version()
        }
    }
}

fn depth_of(width: u32, height: u32, bytes: &[u8]) -> Result<DepthImage, cell_values::image::ImageError> {
    let floats = bytes.chunks_exact(4).map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
    DepthImage::from_metres(width, height, floats.collect())
}

/// This binary, also when another has taken its place on the disk; beside a test, celld's.
fn own_program() -> Vec<OsString> {
    let own = std::env::current_exe().unwrap_or_default();
    let deps = own.parent().filter(|folder| folder.ends_with("deps"));
    let celld = deps.map(|deps| deps.with_file_name("celld"));
    vec![celld.unwrap_or_else(|| "/proc/self/exe".into()).into(), "realsense".into()]
}

impl CameraSource for RealSenseCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        if let Some(lens) = &self.lens {
            return Ok(lens.clone());
        }
        let place = place_of(&self.settings);
        let Some(running) = &self.running else {
            return Err(CameraError::Silent { place, limit: Duration::ZERO });
        };
        let own = running.lens.ok_or(CameraError::NoIntrinsics { place })?;
        Ok(factory_lens(&running.serial, &own).model()?)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let frame = self.next_new()?;
        self.taken += 1;
        self.last = Some(frame.sequence);
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        let place = place_of(&self.settings);
        let running = self.running.as_ref().map(|running| running.serial.clone());
        running.ok_or(CameraError::Silent { place, limit: Duration::ZERO })
    }

    fn is_live(&self) -> bool {
        self.settings.file.is_none()
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        if self.is_live() {
            self.watch.restarted();
            self.start()?;
        }
        Ok(())
    }

    fn can_reset(&self) -> bool {
        self.is_live()
    }

    fn reset(&mut self) -> Result<(), CameraError> {
        // One process at a time has the camera. A camera that has gone away altogether cannot be commanded
        // to restart; waiting for it is all that is left.
        self.running = None;
        self.restart()?;
        let begun = Instant::now();
        loop {
            match self.reopen() {
                Err(_) if begun.elapsed() < BACK_WITHIN => std::thread::sleep(PAUSE),
                done => return done,
            }
        }
    }
}

#[cfg(test)]
mod scripted;
#[cfg(test)]
mod tests;
