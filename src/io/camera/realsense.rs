//! A RealSense camera, or a recording of one, through librealsense2.
//!
//! In: settings (which camera or file, size, rate, exposure, depth or not). Out: colour pictures with the
//! camera's own count and time, depth laid over the colour picture, the factory's lens. The SDK is loaded
//! when such a camera is opened and not before (`sdk`). Each picture of a live camera is one whose exposure
//! began after it was requested; of a recording, every frame comes once.

pub mod sdk;

use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Exposure, Frame};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_vision::camera::{CameraModel, FactoryDistortion, FactoryLens};
use sdk::{Align, Context, Device, Frames, Pipeline, Sdk, SdkError, Stream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What is requested of the camera.
#[derive(Clone, Debug, PartialEq)]
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

/// How long the SDK is waited for at a time.
const WAIT: Duration = Duration::from_millis(200);
/// Colour pictures passed over before the one that counts: one that was waiting, one whose exposure had
/// begun.
const BEFORE_ASKED: u32 = 2;
/// And after the start: exposure control settles within half a second.
const AFTER_START: u32 = 15;
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

/// A camera that streams.
struct Running {
    align: Option<Align>,
    device: Device,
    /// Metres in a unit of depth.
    unit_m: f64,
    colour: Stream,
    serial: String,
    pipeline: Pipeline,
    /// Pictures still to be passed over because the stream has just begun.
    warming: u32,
    /// Number of the colour picture handed out last.
    last: Option<u64>,
    // Last, so that it outlives what was made from it.
    _context: Context,
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
                    let what = "its sets of frames lack the colour or the depth picture; if that stays so, set both \
                                streams to the same rate, or set `depth: false`"
                        .to_string();
                    return Err(CameraError::Incomplete { place: place_of(&self.settings), what });
                }
                _ => {}
            }
        }
    }
}

/// Number and time of the pictures in a set.
struct Heads {
    colour: Option<(u64, f64)>,
    depth_s: Option<f64>,
}

fn heads_of(set: &Frames) -> Result<Heads, SdkError> {
    let mut heads = Heads { colour: None, depth_s: None };
    for picture in set.all()? {
        match picture.stream()? {
            Stream { kind: sdk::STREAM_COLOUR, format: sdk::FORMAT_RGB8, .. } => {
                heads.colour = Some((picture.number()?, picture.time_s()?));
            }
            Stream { kind: sdk::STREAM_DEPTH, format: sdk::FORMAT_Z16, .. } => {
                heads.depth_s = Some(picture.time_s()?);
            }
            _ => {}
        }
    }
    Ok(heads)
}

fn place_of(settings: &RealSenseSettings) -> String {
    match (&settings.file, &settings.serial) {
        (Some(file), _) => file.display().to_string(),
        (None, Some(serial)) => format!("RealSense camera {serial}"),
        (None, None) => "RealSense camera".to_string(),
    }
}

/// Finds the camera and starts its streams.
fn begin(sdk: &Sdk, settings: &RealSenseSettings) -> Result<Running, CameraError> {
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

/// Why the streams do not start: a recording that is none, a camera that has gone, or sizes and rates it does
/// not have.
fn not_started(settings: &RealSenseSettings, source: SdkError) -> CameraError {
    let place = place_of(settings);
    match (&settings.file, source) {
        (Some(file), source) => unplayable(file, source),
        (None, SdkError::Call { message, disconnected: false, .. }) => {
            let ([width, height], rate) = (settings.size, settings.rate);
            let what = format!(
                "it does not start streams of {width} x {height} at {rate} a second ({message}): see that no other program \
                 uses it, and that it has that size and rate (rs-enumerate-devices lists them)"
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

/// Colour and depth out of a set.
fn frame_of(set: &Frames, unit_m: f64, with_depth: bool, place: &str) -> Result<Frame, CameraError> {
    let refused = |source| CameraError::RealSense { place: place.to_string(), source };
    let broken = |source| CameraError::Picture { place: place.to_string(), source };
    let (mut colour, mut depth) = (None, None);
    for picture in set.all().map_err(refused)? {
        let stream = picture.stream().map_err(refused)?;
        match (stream.kind, stream.format) {
            (sdk::STREAM_COLOUR, sdk::FORMAT_RGB8) => {
                let rows = picture.rows(3).map_err(refused)?;
                let image = Image::from_rgb(rows.width, rows.height, rows.data).map_err(broken)?;
                let (sequence, time_s) =
                    (picture.number().map_err(refused)?, picture.time_s().map_err(refused)?);
                colour = Some((image, sequence, time_s));
            }
            (sdk::STREAM_DEPTH, sdk::FORMAT_Z16) if with_depth => {
                let rows = picture.rows(2).map_err(refused)?;
                let units: Vec<u16> =
                    rows.data.chunks_exact(2).map(|pair| u16::from_ne_bytes([pair[0], pair[1]])).collect();
                depth =
                    Some(DepthImage::from_units(rows.width, rows.height, &units, unit_m).map_err(broken)?);
            }
            _ => {}
        }
    }
    let nonsense = |what: &str| {
        let (function, what) = ("rs2_process_frame", what.to_string());
        refused(SdkError::Nonsense { function, what })
    };
    let (image, sequence, time_s) = colour.ok_or_else(|| nonsense("no colour picture"))?;
    let fits = |depth: &DepthImage| (depth.width, depth.height) == (image.width, image.height);
    if with_depth && !depth.as_ref().is_some_and(fits) {
        return Err(nonsense("no depth of the colour picture's size"));
    }
    Ok(Frame { image, sequence, time_s, source: place.to_string(), depth })
}

/// The SDK's numbers as a factory's lens.
fn factory_lens(serial: &str, own: &sdk::Intrinsics) -> FactoryLens {
    let pinhole = CameraModel {
        serial: serial.to_string(),
        width: own.width.unsigned_abs(),
        height: own.height.unsigned_abs(),
        fx: f64::from(own.fx),
        fy: f64::from(own.fy),
        cx: f64::from(own.ppx),
        cy: f64::from(own.ppy),
        distortion: [0.0; 5],
    };
    let form = match own.model {
        0 => FactoryDistortion::None,
        1 | 2 => FactoryDistortion::TangentialAfterRadial,
        4 => FactoryDistortion::BrownConrady,
        _ => FactoryDistortion::Fisheye,
    };
    FactoryLens { pinhole, form, coefficients: own.coefficients.map(f64::from) }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A pipeline that has stopped by itself refuses, which is as good.
        if let Err(error) = self.pipeline.stop() {
            tracing::debug!(%error, "RealSense pipeline");
        }
    }
}

#[cfg(test)]
mod tests;
