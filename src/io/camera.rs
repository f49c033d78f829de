//! Cameras behind one interface: the simulator's (or any) HTTP address, a folder of pictures, a video file.
//!
//! Out: [`Frame`]s with time, sequence number and source, each checked by [`watch`]: a picture that repeats the last one, by
//! number or by content, is an error and not a picture, because a frozen camera must not look like a table at
//! rest. Calls block, up to the time limit given; the daemon makes them from a worker thread.

pub mod folder;
pub mod http;
pub mod video;
pub mod watch;

use crate::vision::camera::{CameraModel, CameraModelError};
use crate::vision::image::{DepthImage, Image, ImageError};
use std::path::PathBuf;
use std::time::Duration;

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
    /// The depth of the same moment, aligned to the picture pixel by pixel; `None` from cameras without it, and where it
    /// was not asked for.
    pub depth: Option<DepthImage>,
}

/// Something pictures come from.
pub trait CameraSource: Send {
    /// The lens: from the camera itself where it knows, otherwise the calibration the source was opened with.
    ///
    /// # Errors
    /// Where the camera does not answer or knows no lens.
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError>;

    /// The next picture, new and of the size the lens was calibrated for.
    ///
    /// # Errors
    /// Anything else; a recording that has ended is `EndOfRecording`.
    fn grab(&mut self) -> Result<Frame, CameraError>;

    /// Whether the next frames shall carry depth. Cameras without it take no notice.
    fn want_depth(&mut self, _wanted: bool) {}
}

/// Why there is no picture or no lens.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// No answer within the time limit.
    #[error(
        "camera at {address} does not answer within {limit:?}; look at its cable and power and at the address in the config \
         (for the simulator: is `celld sim` running?), then try: curl -I {address}"
    )]
    Unreachable {
        /// The address asked.
        address: String,
        /// The time limit.
        limit: Duration,
        /// What the connection said.
        #[source]
        source: Box<ureq::Error>,
    },
    /// It answered that it has no picture.
    #[error("camera at {address} answered with status {status} instead of a picture")]
    Status {
        /// The address asked.
        address: String,
        /// HTTP status.
        status: u16,
    },
    /// The answer lacks a header or has a broken one.
    #[error("camera at {address}: header {name} is {found:?}, a {wanted} is wanted")]
    Header {
        /// The address asked.
        address: String,
        /// Which header.
        name: &'static str,
        /// What it holds; empty when it is not there.
        found: String,
        /// What it should hold.
        wanted: &'static str,
    },
    /// The answer is no list of intrinsics.
    #[error("{place} does not hold the intrinsics of a camera")]
    Intrinsics {
        /// Address or file.
        place: String,
        /// What is wrong.
        #[source]
        source: serde_json::Error,
    },
    /// There are intrinsics, but no camera has them, or they are for another picture size.
    #[error("the camera's numbers do not fit")]
    Model(#[from] CameraModelError),
    /// Nothing says what lens the pictures were taken with.
    #[error(
        "{place} has no intrinsics: give the camera's calibration file (--camera camera.yaml), nothing measured has a default"
    )]
    NoIntrinsics {
        /// Folder or file.
        place: String,
    },
    /// The picture comes from another camera than the calibration.
    #[error(
        "{address} is camera {found:?}, the calibration is of camera {wanted:?}: connect that one or calibrate this one"
    )]
    OtherSerial {
        /// The address asked.
        address: String,
        /// Its serial number.
        found: String,
        /// The calibrated one.
        wanted: String,
    },
    /// The bytes are no picture.
    #[error("{place} gave no usable picture")]
    Picture {
        /// Address or file.
        place: String,
        /// What is wrong.
        #[source]
        source: ImageError,
    },
    /// The sequence number did not grow.
    #[error("{place} gave frame {sequence} after frame {last}: the camera is frozen or was restarted")]
    RepeatedSequence {
        /// Address or file.
        place: String,
        /// The number it gave.
        sequence: u64,
        /// The number before.
        last: u64,
    },
    /// The content is that of the frame before, to the last bit.
    #[error("{place} gave the same picture as frame {sequence} and as frame {last}: the camera is frozen")]
    RepeatedPicture {
        /// Address or file.
        place: String,
        /// Number of the new frame.
        sequence: u64,
        /// Number of the frame it repeats.
        last: u64,
    },
    /// The time is no number, or runs backwards.
    #[error("{place} gave frame {sequence} with time {time_s} s after {last_s} s")]
    Time {
        /// Address or file.
        place: String,
        /// Number of the frame.
        sequence: u64,
        /// Its time.
        time_s: f64,
        /// The time before.
        last_s: f64,
    },
    /// A file or folder could not be read.
    #[error("{} cannot be read", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// A folder without pictures.
    #[error("folder {} holds no .png, .jpg or .jpeg file", path.display())]
    NoPictures {
        /// Which.
        path: PathBuf,
    },
    /// A recording is over.
    #[error("{place} has ended after {frames} frames")]
    EndOfRecording {
        /// Folder or file.
        place: String,
        /// Frames it gave.
        frames: u64,
    },
    /// A video that cannot be opened or decoded.
    #[error("video {} cannot be read: {what}", path.display())]
    Video {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        what: &'static str,
        /// What OpenCV says, if anything.
        #[source]
        source: Option<opencv::Error>,
    },
}
