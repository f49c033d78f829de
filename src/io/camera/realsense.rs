//! A RealSense camera, or a recording of one, through librealsense2.
//!
//! In: settings (which camera or file, size, rate, exposure, depth or not). Out: colour pictures with the
//! camera's own count and time, depth laid over the colour picture, the factory's lens. The SDK is loaded
//! when such a camera is opened and not before (`sdk`); `stream` starts it, `picture` turns what it sends
//! into our values. Each picture of a live camera is one whose exposure began after it was requested; of a
//! recording, every frame comes once.

mod picture;
pub mod sdk;
mod stream;

pub use stream::RealSenseSettings;

use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_vision::camera::CameraModel;
use picture::{Heads, factory_lens, frame_of, heads_of};
use sdk::{Frames, Sdk, SdkError};
use std::time::{Duration, Instant};
use stream::{Running, begin, place_of};

/// How long the SDK is waited for at a time.
const WAIT: Duration = Duration::from_millis(200);
/// Colour pictures passed over before the one that counts: one that was waiting, one whose exposure had
/// begun.
const BEFORE_ASKED: u32 = 2;
/// How long a camera that was restarted may take to come back.
const BACK_WITHIN: Duration = Duration::from_secs(12);

/// A RealSense camera.
pub struct RealSenseCamera {
    settings: RealSenseSettings,
    limit: Duration,
    lens: Option<CameraModel>,
    sdk: Sdk,
    running: Option<Running>,
    watch: FrameValidator,
    taken: u64,
}

impl RealSenseCamera {
    /// Starts the stream. A picture may take up to `limit`.
    ///
    /// # Errors
    /// `RealSense` with what is missing or refused, `File` without the recording, `NotConnected`,
    /// `OtherSerial`, `Setting`, `Model` when the lens is for another camera or size.
    pub fn open(
        settings: RealSenseSettings,
        limit: Duration,
        lens: Option<CameraModel>,
    ) -> Result<RealSenseCamera, CameraError> {
        if let Some(path) = &settings.file {
            std::fs::File::open(path).map_err(|source| CameraError::File { path: path.clone(), source })?;
        }
        let place = place_of(&settings);
        let sdk = Sdk::load(settings.library.as_deref())
            .map_err(|source| CameraError::RealSense { place, source })?;
        let (running, watch) = (None, FrameValidator::default());
        let mut camera = RealSenseCamera { settings, limit, lens, sdk, running, watch, taken: 0 };
        camera.start()?;
        Ok(camera)
    }

    fn start(&mut self) -> Result<(), CameraError> {
        self.running = None;
        let running = begin(&self.sdk, &self.settings)?;
        let place = place_of(&self.settings);
        let wanted = self.lens.as_ref().map(|lens| &lens.serial).or(self.settings.serial.as_ref());
        if let Some(wanted) = wanted.filter(|wanted| **wanted != running.serial) {
            let (found, wanted) = (running.serial.clone(), wanted.clone());
            return Err(CameraError::OtherSerial { address: place, found, wanted });
        }
        if let (Some(lens), Some(own)) = (&self.lens, running.colour.intrinsics) {
            lens.check_picture(own.width.unsigned_abs(), own.height.unsigned_abs())?;
        }
        self.running = Some(running);
        Ok(())
    }

    fn refused(&self) -> impl Fn(SdkError) -> CameraError + use<> {
        let place = place_of(&self.settings);
        move |source| CameraError::RealSense { place: place.clone(), source }
    }

    /// The next set of frames, whatever its age.
    fn next_set(&mut self) -> Result<Frames, CameraError> {
        let place = place_of(&self.settings);
        let refused = self.refused();
        let Some(running) = &mut self.running else {
            return Err(CameraError::Silent { place, limit: Duration::ZERO });
        };
        let begun = Instant::now();
        loop {
            if let Some(frames) = running.pipeline.wait(WAIT).map_err(&refused)? {
                return Ok(frames);
            }
            if self.settings.file.is_some() && running.device.has_ended().map_err(&refused)? {
                return Err(CameraError::EndOfRecording { place, frames: self.taken });
            }
            if begun.elapsed() > self.limit {
                return Err(CameraError::Silent { place, limit: self.limit });
            }
        }
    }

    /// The next set with everything in it, of one moment, with a new colour picture. The SDK hands out a set
    /// whenever one of its streams has something new; a camera that never has is let through in the end, for
    /// the watch to report.
    fn whole_set(&mut self) -> Result<Frames, CameraError> {
        let begun = Instant::now();
        loop {
            let set = self.next_set()?;
            let heads = heads_of(&set).map_err(self.refused())?;
            let over = begun.elapsed() > self.limit;
            let Some(running) = &mut self.running else { continue };
            let apart_s = 0.75 / f64::from(running.colour.rate.max(1));
            match heads {
                Heads { colour: Some((number, time_s)), depth_s }
                    if (!self.settings.depth
                        || depth_s.is_some_and(|depth_s| (depth_s - time_s).abs() < apart_s))
                        && (running.last != Some(number) || over) =>
                {
                    running.last = Some(number);
                    return Ok(set);
                }
                _ if over => {
                    let what = "its sets of frames lack the colour or the depth picture; if that stays so, \
                                set both streams to the same rate, or set `depth: false`"
                        .to_string();
                    return Err(CameraError::Incomplete { place: place_of(&self.settings), what });
                }
                _ => {}
            }
        }
    }
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
        let own = running.colour.intrinsics.ok_or(CameraError::NoIntrinsics { place })?;
        Ok(factory_lens(&running.serial, &own).model()?)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        if self.running.is_none() {
            self.start()?;
        }
        let live = self.is_live();
        let stale = match &mut self.running {
            Some(running) if live => BEFORE_ASKED + std::mem::take(&mut running.warming),
            _ => 0,
        };
        for _ in 0..stale {
            self.whole_set()?;
        }
        let set = self.whole_set()?;
        let refused = self.refused();
        let place = place_of(&self.settings);
        let Some(running) = &self.running else {
            return Err(CameraError::Silent { place, limit: Duration::ZERO });
        };
        let set = match &running.align {
            Some(align) => align.apply(set).map_err(&refused)?,
            None => set,
        };
        let frame = frame_of(&set, running.unit_m, self.settings.depth, &place)?;
        self.taken += 1;
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
        let refused = self.refused();
        // A camera that has gone away altogether cannot be commanded to restart; waiting for it is all that
        // is left.
        if let Some(running) = self.running.take() {
            running.device.reset().map_err(&refused)?;
        } else {
            let context = self.sdk.context().map_err(&refused)?;
            let serial = self.lens.as_ref().map(|lens| &lens.serial).or(self.settings.serial.as_ref());
            for device in context.devices().map_err(&refused)? {
                let own = device.info(sdk::INFO_SERIAL).map_err(&refused)?;
                // The one that is meant, or the only one that there is to mean.
                if serial.is_none() || own.as_ref() == serial {
                    device.reset().map_err(&refused)?;
                }
            }
        }
        let begun = Instant::now();
        loop {
            match self.reopen() {
                Err(_) if begun.elapsed() < BACK_WITHIN => std::thread::sleep(WAIT),
                done => return done,
            }
        }
    }
}

#[cfg(test)]
mod tests;
