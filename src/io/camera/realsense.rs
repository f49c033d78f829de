//! A RealSense camera, or a recording of one, through librealsense2.
//!
//! In: settings (which camera or file, size, rate, exposure, depth or not). Out: colour pictures with the
//! camera's own count and time, depth laid over the colour picture, the factory's lens.
//!
//! The SDK runs in a process of its own (`process`), because it sometimes corrupts its heap: version 2.59
//! crashes once in some thousands of recordings on a busy computer, also when a C program plays them. In the
//! daemon that would end the control loop. Files of that process: `sdk` loads the library, `stream` starts
//! it, `player` waits for pictures, `picture` converts them.

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
use std::ffi::{OsStr, OsString};
use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};
use stream::place_of;

/// The first argument with which celld's binary becomes that process.
pub const COMMAND: &str = "realsense";
/// Its name in messages.
const NAME: &str = "the RealSense process";
/// Time to load the SDK and to start the streams of a camera.
const STARTS_WITHIN: Duration = Duration::from_secs(14);
/// The same for a recording: the SDK reads its index, on any disk.
const OPENS_WITHIN: Duration = Duration::from_secs(60);
/// Time beyond the process's own limits before it counts as hung.
const HUNG_AFTER: Duration = Duration::from_secs(2);
/// Time to stop the streams: a camera that is cut off may need a restart.
const STOPS_WITHIN: Duration = Duration::from_secs(3);
/// Crashes in a row before they are reported.
const CRASHES_MAX: u32 = 3;
/// Time for a camera to come back after a restart.
const BACK_WITHIN: Duration = Duration::from_secs(12);
/// Before the next try to open it.
const PAUSE: Duration = Duration::from_millis(200);

/// A RealSense camera.
pub struct RealSenseCamera {
    /// Program and arguments of the process.
    program: Vec<OsString>,
    settings: RealSenseSettings,
    limit: Duration,
    lens: Option<CameraModel>,
    /// While it streams.
    helper: Option<Helper>,
    /// The last process that was started; a driver may keep it alive after its end was ordered.
    process: Option<Process>,
    /// Serial number and lens as the camera reports them, once it was opened.
    own: Option<(String, Option<Intrinsics>)>,
    watch: FrameValidator,
    taken: u64,
    /// Number of the last picture.
    last: Option<u64>,
    /// Number up to which a restarted recording repeats what was returned before.
    skip_to: Option<u64>,
}

impl RealSenseCamera {
    /// Starts the stream. A picture may take up to `limit`.
    ///
    /// # Errors
    /// `File` without the recording, `OtherSerial`, `Model` when the lens is for another size, `Reported`
    /// with the SDK's error, `Silent` when the process hangs, `Crashed` when it crashes three times.
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
        let mut camera = RealSenseCamera {
            program,
            settings,
            limit,
            lens,
            helper: None,
            process: None,
            own: None,
            watch: FrameValidator::default(),
            taken: 0,
            last: None,
            skip_to: None,
        };
        camera.retry(CRASHES_MAX, RealSenseCamera::start)?;
        Ok(camera)
    }

    fn place(&self) -> String {
        place_of(&self.settings)
    }

    fn start(&mut self) -> Result<(), CameraError> {
        let mut helper = self.new_process()?;
        let task = Task::Stream { settings: self.settings.clone(), limit: self.limit };
        let (serial, lens) = match helper.request(&task)? {
            Some(Reply::Open { serial, lens }) => (serial, lens),
            other => return Err(self.unexpected(other)),
        };
        let wanted = self.lens.as_ref().map(|lens| &lens.serial).or(self.settings.serial.as_ref());
        if let Some(wanted) = wanted.filter(|wanted| **wanted != serial) {
            let wanted = wanted.clone();
            return Err(CameraError::OtherSerial { address: self.place(), found: serial, wanted });
        }
        if let (Some(lens), Some(own)) = (&self.lens, lens) {
            lens.check_picture(own.width.unsigned_abs(), own.height.unsigned_abs())?;
        }
        // The process waits once for a picture and once for it to be whole.
        helper.set_limit(self.limit * 2 + HUNG_AFTER);
        self.helper = Some(helper);
        self.own = Some((serial, lens));
        if self.is_live() {
            self.watch.restarted();
        } else {
            self.skip_to = self.last;
        }
        Ok(())
    }

    /// The process, just started. Only one at a time has the camera.
    fn new_process(&mut self) -> Result<Helper, CameraError> {
        self.helper = None;
        if self.process.as_ref().is_some_and(|process| process.ended().is_none()) {
            return Err(CameraError::Silent { place: self.place(), limit: self.limit });
        }
        let mut words = self.program.iter();
        let mut command = Command::new(words.next().map_or(OsStr::new(""), OsString::as_os_str));
        command.args(words);
        let limit = if self.is_live() { STARTS_WITHIN } else { OPENS_WITHIN };
        let role = Role { name: NAME, place: self.place().into(), limit, stops_within: STOPS_WITHIN };
        let helper = Helper::start(command, role)?;
        self.process = Some(helper.process());
        Ok(helper)
    }

    /// Tries `go` again after a crash of the process, up to `tries` times in all.
    fn retry<T>(
        &mut self,
        tries: u32,
        go: impl Fn(&mut RealSenseCamera) -> Result<T, CameraError>,
    ) -> Result<T, CameraError> {
        let mut crashes = 0;
        loop {
            let error = match go(self) {
                Err(error) => error,
                done => return done,
            };
            let Some(how) = self.crash_behind(&error) else { return Err(error) };
            crashes += 1;
            let crash = CameraError::Crashed { place: self.place(), how };
            if crashes >= tries {
                return Err(crash);
            }
            tracing::warn!("{crash}; restarting it");
        }
    }

    /// How the process crashed, if this error is due to that.
    fn crash_behind(&mut self, error: &CameraError) -> Option<ExitStatus> {
        // Other errors come from a process that answered, or that we killed.
        let CameraError::Video { .. } = error else { return None };
        let status = self.process.as_ref()?.ended()?;
        (!status.success()).then_some(status)
    }

    /// The next picture. Starts the process if there is none.
    fn next(&mut self) -> Result<Frame, CameraError> {
        if self.helper.is_none() {
            self.start()?;
        }
        let place = self.place();
        let Some(mut helper) = self.helper.take() else {
            return Err(CameraError::Silent { place, limit: self.limit });
        };
        let frame = match helper.request(&GRAB)? {
            Some(Reply::Picture { width, height, sequence, time_s, depth }) => {
                let broken = |source| CameraError::Picture { place: place.clone(), source };
                let pixels = (width as usize).saturating_mul(height as usize);
                let rgb = helper.bytes(pixels.saturating_mul(3))?;
                let image = Image::from_rgb(width, height, rgb).map_err(broken)?;
                let depth = match depth {
                    true => Some(helper.bytes(pixels.saturating_mul(4))?),
                    false => None,
                };
                let depth = depth.map(|bytes| depth_of(width, height, &bytes).map_err(broken)).transpose()?;
                Ok(Frame { image, sequence, time_s, source: place, depth })
            }
            Some(Reply::End) => Err(CameraError::EndOfRecording { place, frames: self.taken }),
            Some(failed @ Reply::Failed { .. }) => Err(self.unexpected(Some(failed))),
            // The helper ends here: the next answer might belong to this request.
            other => return Err(self.unexpected(other)),
        };
        self.helper = Some(helper);
        frame
    }

    /// The next picture that was not returned before.
    fn next_new(&mut self) -> Result<Frame, CameraError> {
        loop {
            let frame = self.next()?;
            if self.skip_to.is_none_or(|last| frame.sequence > last) {
                self.skip_to = None;
                return Ok(frame);
            }
        }
    }

    fn restart(&mut self) -> Result<(), CameraError> {
        let mut settings = self.settings.clone();
        let lens = self.lens.as_ref().map(|lens| lens.serial.clone());
        let own = self.own.as_ref().map(|(serial, _)| serial.clone());
        settings.serial = lens.or(settings.serial).or(own);
        let mut helper = self.new_process()?;
        match helper.request(&Task::Restart { settings })? {
            Some(Reply::Restarted) => Ok(()),
            other => Err(self.unexpected(other)),
        }
    }

    fn unexpected(&self, reply: Option<Reply>) -> CameraError {
        if let Some(Reply::Failed { kind, what, cause }) = reply {
            return CameraError::Reported { kind, what, source: cause.map(|cause| Cause(cause).into()) };
        }
        let what = format!("{NAME} sent an unexpected answer: {reply:?}");
        CameraError::Video { path: self.place().into(), what, source: None }
    }
}

fn depth_of(width: u32, height: u32, bytes: &[u8]) -> Result<DepthImage, cell_values::image::ImageError> {
    let floats = bytes.chunks_exact(4).map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
    DepthImage::from_metres(width, height, floats.collect())
}

/// The running binary, even if its file was replaced. A test runs celld's.
fn own_program() -> Vec<OsString> {
    let own = std::env::current_exe().unwrap_or_default();
    let deps = own.parent().filter(|folder| folder.ends_with("deps"));
    let celld = deps.map(|deps| deps.with_file_name("celld"));
    vec![celld.unwrap_or_else(|| "/proc/self/exe".into()).into(), COMMAND.into()]
}

impl CameraSource for RealSenseCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        if let Some(lens) = &self.lens {
            return Ok(lens.clone());
        }
        let place = self.place();
        let Some((serial, own)) = &self.own else {
            return Err(CameraError::Silent { place, limit: self.limit });
        };
        let own = own.ok_or(CameraError::NoIntrinsics { place })?;
        Ok(factory_lens(serial, &own).model()?)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        // A live camera is left to whoever supervises it.
        let tries = if self.is_live() { 1 } else { CRASHES_MAX };
        let frame = self.retry(tries, RealSenseCamera::next_new)?;
        self.taken += 1;
        self.last = Some(frame.sequence);
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        let own = self.own.as_ref().map(|(serial, _)| serial.clone());
        own.ok_or_else(|| CameraError::Silent { place: self.place(), limit: self.limit })
    }

    fn is_live(&self) -> bool {
        self.settings.file.is_none()
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        if self.is_live() { self.retry(1, RealSenseCamera::start) } else { Ok(()) }
    }

    fn can_reset(&self) -> bool {
        self.is_live()
    }

    fn reset(&mut self) -> Result<(), CameraError> {
        // An unplugged camera cannot be restarted; it may still come back in this time.
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
