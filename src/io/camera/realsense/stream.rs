//! A RealSense camera's settings, and how its streams are started.
//!
//! In: settings, the SDK. Out: a camera or recording that streams, or what prevents it and what a person can
//! do about that. Everything that happens once, before the first picture, is here: which camera it is, its
//! streams, its exposure, its unit of depth.

use crate::io::camera::realsense::sdk::{self, Align, Context, Device, Pipeline, Sdk, SdkError, Stream};
use crate::io::camera::{CameraError, Exposure};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What is requested of the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RealSenseSettings {
    /// Which camera; the only one connected if absent. Of a recording: which camera it must be of.
    pub serial: Option<String>,
    /// A recording (.bag, .db3) instead of a camera.
    pub file: Option<PathBuf>,
    /// Where the SDK's library is; looked for among the installed ones if absent.
    pub library: Option<PathBuf>,
    /// Pixels per row and rows of the colour picture; a recording has its own.
    pub size: [u32; 2],
    /// Pictures a second.
    pub rate: u32,
    /// Exposure of the colour picture.
    pub exposure: Exposure,
    /// Measure depth too.
    pub depth: bool,
}

/// Colour pictures passed over after the start: exposure control settles within half a second.
const AFTER_START: u32 = 15;

/// A camera that streams.
pub(super) struct Running {
    pub(super) align: Option<Align>,
    pub(super) device: Device,
    /// Metres in a unit of depth.
    pub(super) unit_m: f64,
    pub(super) colour: Stream,
    pub(super) serial: String,
    pub(super) pipeline: Pipeline,
    /// Pictures still to be passed over because the stream has just begun.
    pub(super) warming: u32,
    /// Number of the colour picture handed out last.
    pub(super) last: Option<u64>,
    // Last, so that it outlives what was made from it.
    _context: Context,
}

/// The camera or recording, for messages.
pub(super) fn place_of(settings: &RealSenseSettings) -> String {
    match (&settings.file, &settings.serial) {
        (Some(file), _) => file.display().to_string(),
        (None, Some(serial)) => format!("RealSense camera {serial}"),
        (None, None) => "RealSense camera".to_string(),
    }
}

/// Finds the camera and starts its streams.
pub(super) fn begin(sdk: &Sdk, settings: &RealSenseSettings) -> Result<Running, CameraError> {
    let place = place_of(settings);
    let refused = |source| CameraError::RealSense { place: place.clone(), source };
    let context = sdk.context().map_err(refused)?;
    let config = sdk.config().map_err(refused)?;
    match &settings.file {
        Some(file) => config.file(file).map_err(|source| unplayable(file, source))?,
        None => {
            let serial = connected(&context, settings)?;
            config.device(&serial).map_err(refused)?;
            let stream = |kind, format| config.stream(kind, format, settings.size, settings.rate);
            stream(sdk::STREAM_COLOUR, sdk::FORMAT_RGB8).map_err(refused)?;
            if settings.depth {
                stream(sdk::STREAM_DEPTH, sdk::FORMAT_Z16).map_err(refused)?;
            }
        }
    }
    let pipeline = context.pipeline().map_err(refused)?;
    let profile = pipeline.start(&config).map_err(|source| not_started(settings, source))?;
    let device = profile.device().map_err(refused)?;
    if settings.file.is_some() {
        device.play_every_frame().map_err(refused)?;
    }
    let serial = device.info(sdk::INFO_SERIAL).map_err(refused)?.unwrap_or_default();
    let streams = profile.streams().map_err(refused)?;
    let has = |kind| streams.iter().find(|stream| stream.kind == kind).cloned();
    let setting = |what: &str| CameraError::Setting { place: place.clone(), what: what.to_string() };
    let colour = has(sdk::STREAM_COLOUR)
        .filter(|stream| stream.format == sdk::FORMAT_RGB8)
        .ok_or_else(|| setting("it has no colour stream of 8 bit red, green and blue: record that stream"))?;
    if settings.depth && has(sdk::STREAM_DEPTH).is_none() {
        return Err(setting("it has no depth stream: record it too, or set `depth: false`"));
    }
    let unit_m = if settings.depth { depth_unit(&device, &place)? } else { 0.0 };
    expose(&device, settings, &place)?;
    let align = settings.depth.then(|| sdk.align_to_colour()).transpose().map_err(refused)?;
    let warming = if settings.file.is_some() { 0 } else { AFTER_START };
    Ok(Running { align, device, unit_m, colour, serial, pipeline, warming, last: None, _context: context })
}

fn unplayable(file: &Path, source: SdkError) -> CameraError {
    CameraError::Recording { path: file.to_owned(), source }
}

/// Why the streams do not start: a recording that is none, a camera that has gone, or sizes and rates it
/// does not have.
fn not_started(settings: &RealSenseSettings, source: SdkError) -> CameraError {
    let place = place_of(settings);
    match (&settings.file, source) {
        (Some(file), source) => unplayable(file, source),
        (None, SdkError::Call { message, disconnected: false, .. }) => {
            let ([width, height], rate) = (settings.size, settings.rate);
            let what = format!(
                "it does not start streams of {width} x {height} at {rate} a second ({message}): see that no \
                 other program uses it, and that it has that size and rate (rs-enumerate-devices lists them)"
            );
            CameraError::Incomplete { place, what }
        }
        (None, source) => CameraError::RealSense { place, source },
    }
}

/// Serial number of the camera to use, when it is connected.
fn connected(context: &Context, settings: &RealSenseSettings) -> Result<String, CameraError> {
    let place = place_of(settings);
    let refused = |source| CameraError::RealSense { place: place.clone(), source };
    let mut there = Vec::new();
    for device in context.devices().map_err(refused)? {
        let serial = device.info(sdk::INFO_SERIAL).map_err(refused)?.unwrap_or_default();
        let name = device.info(sdk::INFO_NAME).map_err(refused)?.unwrap_or_default();
        there.push((serial, name));
    }
    let listed: Vec<String> = there.iter().map(|(serial, name)| format!("{name} {serial}")).collect();
    match (&settings.serial, there.as_slice()) {
        (Some(wanted), there) if there.iter().any(|(serial, _)| serial == wanted) => Ok(wanted.clone()),
        (None, [(serial, _)]) => Ok(serial.clone()),
        (None, [_, _, ..]) => {
            let what = format!("several are connected ({}): say which in `serial`", listed.join(", "));
            Err(CameraError::Setting { place, what })
        }
        (_, []) => Err(CameraError::NotConnected {
            wanted: place,
            found:
                "no RealSense camera is: look at its cable (USB 3), and that this user may read the device \
                    (librealsense's udev rules)"
                    .to_string(),
        }),
        (Some(_), _) => {
            let found = format!("connected: {}; correct `serial`", listed.join(", "));
            Err(CameraError::NotConnected { wanted: place, found })
        }
    }
}

fn depth_unit(device: &Device, place: &str) -> Result<f64, CameraError> {
    let refused = |source| CameraError::RealSense { place: place.to_string(), source };
    for sensor in device.sensors().map_err(refused)? {
        if sensor.is_depth().map_err(refused)? {
            let unit_m = sensor.depth_unit_m().map_err(refused)?;
            if (1e-7..=0.1).contains(&unit_m) {
                return Ok(unit_m);
            }
            let what = format!("a unit of depth of {unit_m} m is none");
            return Err(CameraError::Setting { place: place.to_string(), what });
        }
    }
    let what = "no sensor says what a unit of its depth is".to_string();
    Err(CameraError::Setting { place: place.to_string(), what })
}

/// Sets the exposure of the sensor that takes the colour picture; a recording has had its exposure.
fn expose(device: &Device, settings: &RealSenseSettings, place: &str) -> Result<(), CameraError> {
    if settings.file.is_some() {
        return Ok(());
    }
    let refused = |source| CameraError::RealSense { place: place.to_string(), source };
    for sensor in device.sensors().map_err(refused)? {
        let can = sensor.has(sdk::OPTION_EXPOSURE).map_err(refused)?;
        if !can || !sensor.gives_colour().map_err(refused)? {
            continue;
        }
        let automatic = sensor.has(sdk::OPTION_AUTO_EXPOSURE).map_err(refused)?;
        let Exposure::Fixed(exposure_us) = settings.exposure else {
            return if automatic {
                sensor.set(sdk::OPTION_AUTO_EXPOSURE, 1.0).map_err(refused)
            } else {
                Ok(())
            };
        };
        // Depth sensors count in microseconds, colour sensors of their own in hundreds of them.
        let unit_us = if sensor.is_depth().map_err(refused)? { 1.0 } else { 100.0 };
        let [least, most] = sensor.range(sdk::OPTION_EXPOSURE).map_err(refused)?.map(f64::from);
        let value = exposure_us / unit_us;
        if !(least..=most).contains(&value) {
            let (least, most) = (least * unit_us, most * unit_us);
            let what = format!("exposure_us {exposure_us} is outside its {least} to {most}");
            return Err(CameraError::Setting { place: place.to_string(), what });
        }
        if automatic {
            sensor.set(sdk::OPTION_AUTO_EXPOSURE, 0.0).map_err(refused)?;
        }
        return sensor.set(sdk::OPTION_EXPOSURE, value as f32).map_err(refused);
    }
    match settings.exposure {
        Exposure::Auto => Ok(()),
        Exposure::Fixed(_) => {
            let what = "its exposure cannot be set: leave `exposure_us` out".to_string();
            Err(CameraError::Setting { place: place.to_string(), what })
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A pipeline that has stopped by itself refuses, which is as good.
        if let Err(error) = self.pipeline.stop() {
            tracing::debug!(%error, "RealSense pipeline");
        }
    }
}
