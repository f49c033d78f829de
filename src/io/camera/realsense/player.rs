//! A RealSense camera or a recording of one, as the process that loads the SDK has it.
//!
//! In: settings. Out: colour pictures with the camera's own count and time, depth laid over the colour
//! picture. `stream` starts it, `picture` turns what the SDK sends into our values. Each picture of a live
//! camera is one whose exposure began after it was requested; of a recording, every frame comes once.

use crate::io::camera::realsense::picture::{Heads, frame_of, heads_of};
use crate::io::camera::realsense::sdk::{self, Frames, Intrinsics, Sdk, SdkError};
use crate::io::camera::realsense::stream::{RealSenseSettings, Running, begin, place_of};
use crate::io::camera::{CameraError, Frame};
use std::time::{Duration, Instant};

/// How long the SDK is waited for at a time.
const WAIT: Duration = Duration::from_millis(200);
/// Colour pictures passed over before the one that counts: one that was waiting, one whose exposure had
/// begun.
const BEFORE_ASKED: u32 = 2;

/// A camera that streams, or a recording that plays.
pub(super) struct Player {
    settings: RealSenseSettings,
    limit: Duration,
    running: Running,
    taken: u64,
}

impl Player {
    /// Loads the SDK and starts the stream. A set of frames may take up to `limit`.
    ///
    /// # Errors
    /// `RealSense` with what is missing or refused, `Recording`, `NotConnected`, `Setting`, `Incomplete`.
    pub fn start(settings: RealSenseSettings, limit: Duration) -> Result<Player, CameraError> {
        let place = place_of(&settings);
        let sdk = Sdk::load(settings.library.as_deref())
            .map_err(|source| CameraError::RealSense { place, source })?;
        let running = begin(&sdk, &settings)?;
        Ok(Player { settings, limit, running, taken: 0 })
    }

    /// Its serial number.
    pub fn serial(&self) -> &str {
        &self.running.serial
    }

    /// Lens and size of the colour picture, where it has them.
    pub fn lens(&self) -> Option<Intrinsics> {
        self.running.colour.intrinsics
    }

    fn refused(&self) -> impl Fn(SdkError) -> CameraError + use<> {
        let place = place_of(&self.settings);
        move |source| CameraError::RealSense { place: place.clone(), source }
    }

    /// The next set of frames, whatever its age.
    fn next_set(&mut self) -> Result<Frames, CameraError> {
        let place = place_of(&self.settings);
        let refused = self.refused();
        let begun = Instant::now();
        loop {
            if let Some(frames) = self.running.pipeline.wait(WAIT).map_err(&refused)? {
                return Ok(frames);
            }
            if self.settings.file.is_some() && self.running.device.has_ended().map_err(&refused)? {
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
    fn whole_set(&mut self, begun: Instant) -> Result<Frames, CameraError> {
        loop {
            let set = self.next_set()?;
            let heads = heads_of(&set).map_err(self.refused())?;
            let over = begun.elapsed() > self.limit;
            let running = &mut self.running;
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

    /// The next picture.
    ///
    /// # Errors
    /// `EndOfRecording`, `Silent`, `Incomplete`, `RealSense`, `Picture`.
    pub fn grab(&mut self) -> Result<Frame, CameraError> {
        let stale = match self.settings.file {
            Some(_) => 0,
            None => BEFORE_ASKED + std::mem::take(&mut self.running.warming),
        };
        let begun = Instant::now();
        for _ in 0..stale {
            self.whole_set(begun)?;
        }
        let set = self.whole_set(begun)?;
        let set = match &self.running.align {
            Some(align) => align.apply(set).map_err(self.refused())?,
            None => set,
        };
        let place = place_of(&self.settings);
        let frame = frame_of(&set, self.running.unit_m, self.settings.depth, &place)?;
        self.taken += 1;
        Ok(frame)
    }
}

/// Restarts the camera with the serial number of the settings; without one, the only camera connected. It is
/// gone for some seconds.
///
/// # Errors
/// `RealSense` with what is missing or refused.
pub(super) fn restart(settings: &RealSenseSettings) -> Result<(), CameraError> {
    let refused = |source| CameraError::RealSense { place: place_of(settings), source };
    let sdk = Sdk::load(settings.library.as_deref()).map_err(refused)?;
    let context = sdk.context().map_err(refused)?;
    let devices = context.devices().map_err(refused)?;
    let alone = devices.len() == 1;
    for device in devices {
        let own = device.info(sdk::INFO_SERIAL).map_err(refused)?;
        if own == settings.serial || settings.serial.is_none() && alone {
            device.reset().map_err(refused)?;
        }
    }
    Ok(())
}
