//! Cameras behind one interface: RealSense, UVC, the simulator's address, any snapshot address, folders,
//! videos.
//!
//! Out: [`Frame`]s with time, sequence number and source, each checked by [`validator`]: a picture that
//! repeats the last one, by number or by content, is an error and not a picture, because a frozen camera
//! must not look like a table at rest. [`monitored`] puts a camera that fails back to work, step by step,
//! and names the fault when that does not help. Calls block, up to the time limit given; the daemon makes
//! them from a worker thread.

pub mod fault;
pub mod folder;
mod helper;
pub mod http;
pub mod late;
pub mod monitored;
mod reader;
pub mod realsense;
pub mod recovery;
pub mod snapshot;
pub mod uvc;
pub mod validator;
pub mod video;
pub mod wire;

pub use fault::{CameraError, FaultKind};

use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_vision::camera::CameraModel;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is requested of a USB camera.
#[derive(Clone, Debug, PartialEq)]
pub struct UvcSettings {
    /// Its device file; one under `/dev/v4l/by-id` stays the same camera after a restart.
    pub device: PathBuf,
    /// Its serial number: compared with the USB device's, where that has one.
    pub serial: String,
    /// Pixels per row and rows.
    pub size: [u32; 2],
    /// Pictures a second.
    pub rate: u32,
    /// Exposure.
    pub exposure: Exposure,
}

/// A picture as it came from a camera.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The picture.
    pub image: Image,
    /// The camera's own count, growing from frame to frame.
    pub sequence: u64,
    /// When the picture was taken, s, on the camera's clock.
    pub time_s: f64,
    /// Which camera or file it came from.
    pub source: String,
    /// How far away what each pixel shows is, where the camera measures that and it was requested.
    pub depth: Option<DepthImage>,
}

/// How long a pixel gathers light.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Exposure {
    /// The camera decides, picture by picture.
    #[default]
    Auto,
    /// Microseconds.
    Fixed(f64),
}

/// Something pictures come from.
pub trait CameraSource: Send {
    /// The lens: from the camera itself where it knows, otherwise the calibration the source was opened
    /// with.
    ///
    /// # Errors
    /// Where the camera does not answer or knows no lens.
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError>;

    /// The next picture, new and of the size the lens was calibrated for.
    ///
    /// # Errors
    /// Anything else; a recording that has ended is `EndOfRecording`.
    fn grab(&mut self) -> Result<Frame, CameraError>;

    /// The next picture for people to look at: one try, and nothing is restarted when it fails.
    ///
    /// # Errors
    /// As [`CameraSource::grab`].
    fn glimpse(&mut self) -> Result<Frame, CameraError> {
        self.grab()
    }

    /// Whether the next pictures shall carry depth, for a camera that was opened with it: they do unless set
    /// otherwise. A hint that saves time; others take no notice.
    fn want_depth(&mut self, _wanted: bool) {}

    /// The camera's serial number.
    ///
    /// # Errors
    /// As [`CameraSource::intrinsics`].
    fn serial(&mut self) -> Result<String, CameraError> {
        self.intrinsics().map(|lens| lens.serial)
    }

    /// True for what shows the table as it is now, false for recordings.
    fn is_live(&self) -> bool;

    /// Connects anew; a camera that counts from the beginning again is fine then, an old picture is not.
    ///
    /// # Errors
    /// Why it cannot be connected to.
    fn reopen(&mut self) -> Result<(), CameraError>;

    /// True when the device itself can be restarted from here.
    fn can_reset(&self) -> bool {
        false
    }

    /// Restarts the device, where that can be done, and connects to it anew.
    ///
    /// # Errors
    /// Why it could not be restarted, or did not come back.
    fn reset(&mut self) -> Result<(), CameraError> {
        self.reopen()
    }
}

/// That a lens is this camera's.
///
/// # Errors
/// `OtherSerial`.
fn same_serial(place: &str, serial: &str, lens: Option<&CameraModel>) -> Result<(), CameraError> {
    match lens {
        Some(lens) if lens.serial != serial => Err(CameraError::OtherSerial {
            address: place.to_string(),
            found: serial.to_string(),
            wanted: lens.serial.clone(),
        }),
        _ => Ok(()),
    }
}
