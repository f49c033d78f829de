//! A video or a camera of the kernel's, open in OpenCV.
//!
//! In: what is to be read. Out: replies of the wire, with the pixels of pictures. Of the readers of videos
//! only FFmpeg's is used: the others guess at file names and write their guesses to the log.

use crate::wire::{Reply, Source};
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual};
use opencv::videoio::{
    CAP_FFMPEG, CAP_PROP_AUTO_EXPOSURE, CAP_PROP_BUFFERSIZE, CAP_PROP_EXPOSURE, CAP_PROP_FPS,
    CAP_PROP_FRAME_HEIGHT, CAP_PROP_FRAME_WIDTH, CAP_PROP_POS_MSEC, CAP_V4L2, VideoCapture,
    VideoCaptureTrait, VideoCaptureTraitConst,
};
use std::path::Path;

/// The driver's words for exposure by hand and by itself (V4L2_CID_EXPOSURE_AUTO).
const EXPOSURE_MANUAL: f64 = 1.0;
const EXPOSURE_AUTO: f64 = 3.0;
/// A unit of its exposure, microseconds (V4L2_CID_EXPOSURE_ABSOLUTE).
const EXPOSURE_UNIT_US: f64 = 100.0;

/// What is open.
pub struct Capture {
    capture: VideoCapture,
    /// The last picture.
    mat: Mat,
    is_video: bool,
}

impl Capture {
    /// Opens it, and sets a device up.
    ///
    /// # Errors
    /// The reply that says what does not work.
    pub fn open(source: &Source) -> Result<Capture, Reply> {
        match source {
            Source::Video { path } => {
                let capture = VideoCapture::from_file(path, CAP_FFMPEG)
                    .map_err(|error| failed("OpenCV refuses it", Some(&error)))?;
                if !capture.is_opened().unwrap_or(false) {
                    return Err(failed("it is no video of a known kind", None));
                }
                Ok(Capture { capture, mat: Mat::default(), is_video: true })
            }
            Source::Device { path, size, rate, exposure_us } => {
                let capture = device(path, *size, *rate, *exposure_us)?;
                Ok(Capture { capture, mat: Mat::default(), is_video: false })
            }
        }
    }

    /// Takes the next picture. Each is decoded, requested or not: OpenCV's reader of cameras decodes into
    /// the picture before, so that what cannot be decoded shows that one, and not one of long ago.
    pub fn grab(&mut self) -> Reply {
        match self.capture.read(&mut self.mat) {
            Ok(true) => Reply::Grabbed { time_ms: self.time_ms() },
            Err(error) if self.is_video => failed("a frame cannot be decoded", Some(&error)),
            // OpenCV waits ten seconds for a driver; a camera that was pulled out fails at once.
            Ok(false) | Err(_) => Reply::End,
        }
    }

    /// The last picture, with its pixels.
    ///
    /// # Errors
    /// The reply that says why there is none.
    pub fn picture(&self) -> Result<(Reply, Vec<u8>), Reply> {
        picture(&self.mat)
    }

    /// When the last picture was taken.
    fn time_ms(&self) -> f64 {
        self.capture.get(CAP_PROP_POS_MSEC).ok().filter(|time_ms| time_ms.is_finite()).unwrap_or(0.0)
    }
}

fn failed(what: &str, cause: Option<&opencv::Error>) -> Reply {
    Reply::Failed { what: what.into(), setting: false, cause: cause.map(ToString::to_string) }
}

fn setting(what: impl Into<String>) -> Reply {
    Reply::Failed { what: what.into(), setting: true, cause: None }
}

/// OpenCV's blue, green, red in our order.
fn picture(mat: &Mat) -> Result<(Reply, Vec<u8>), Reply> {
    if mat.typ() != opencv::core::CV_8UC3 || !mat.is_continuous() {
        return Err(failed("a frame is not 8 bit colour", None));
    }
    let no_pixels = |error: &opencv::Error| failed("a frame has no pixels", Some(error));
    let bytes = mat.data_bytes().map_err(|error| no_pixels(&error))?;
    let pixels = bytes.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect();
    match (u32::try_from(mat.cols()), u32::try_from(mat.rows())) {
        (Ok(width), Ok(height)) => Ok((Reply::Picture { width, height }, pixels)),
        _ => Err(failed("a frame has no size", None)),
    }
}

fn device(path: &Path, size: [u32; 2], rate: u32, exposure_us: Option<f64>) -> Result<VideoCapture, Reply> {
    let mut capture = VideoCapture::from_file(path, CAP_V4L2)
        .map_err(|error| failed("OpenCV refuses the device", Some(&error)))?;
    if !capture.is_opened().unwrap_or(false) {
        return Err(setting(
            "it cannot be opened: another program has it, this user may not (group video), or it takes no \
             pictures",
        ));
    }
    let [width, height] = size.map(f64::from);
    let mut wanted = vec![
        (CAP_PROP_FRAME_WIDTH, width, true, "its width is"),
        (CAP_PROP_FRAME_HEIGHT, height, true, "its height is"),
        (CAP_PROP_FPS, f64::from(rate), true, "its rate is"),
        // Fewer pictures to pass over where the driver allows it; nothing depends on it.
        (CAP_PROP_BUFFERSIZE, 1.0, false, ""),
    ];
    match exposure_us {
        None => wanted.push((CAP_PROP_AUTO_EXPOSURE, EXPOSURE_AUTO, false, "")),
        Some(exposure_us) => wanted.extend([
            (CAP_PROP_AUTO_EXPOSURE, EXPOSURE_MANUAL, true, "its exposure mode is"),
            (CAP_PROP_EXPOSURE, (exposure_us / EXPOSURE_UNIT_US).round(), true, "its exposure in 100 us is"),
        ]),
    }
    for &(property, value, ..) in &wanted {
        // Whether it took the value is checked below, when all are set: some change each other.
        let _ = capture.set(property, value);
    }
    for (property, value, must, words) in wanted {
        let found = capture.get(property).unwrap_or(f64::NAN);
        if must && (found - value).abs() > 0.5 {
            return Err(setting(format!(
                "{words} {found}, {value} was requested: request what `v4l2-ctl --list-formats-ext` lists"
            )));
        }
    }
    Ok(capture)
}
