//! What goes wrong with cameras: every error with place and cause, and the kind of fault that it is.
//!
//! In: nothing. Out: [`CameraError`], and [`FaultKind`], by which the recovery policy chooses its steps and
//! by which the cell names the fault in a job's result.

use crate::io::camera::realsense::sdk::SdkError;
use cell_values::image::ImageError;
use cell_values::image::quality::PictureFault;
use cell_vision::camera::CameraModelError;
use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::Duration;

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// It does not answer, or is not there.
    Unplugged,
    /// It gives the same frame again.
    Frozen,
    /// It gives the same picture as a new frame.
    Repeated,
    /// What it sends is no picture.
    Broken,
    /// Too little light.
    Dark,
    /// Too much light.
    Overexposed,
    /// Nothing to be seen: a lid, fog.
    Flat,
    /// Out of focus or in motion.
    Blurred,
    /// Not the camera, the size or the settings that are configured: nothing helps but a person.
    Misfit,
    /// A recording is over.
    Ended,
}

impl FaultKind {
    /// Stable word, as in results of jobs.
    pub fn code(self) -> &'static str {
        match self {
            FaultKind::Unplugged => "camera_unplugged",
            FaultKind::Frozen => "camera_frozen",
            FaultKind::Repeated => "camera_repeats",
            FaultKind::Broken => "camera_broken_picture",
            FaultKind::Dark => "camera_dark",
            FaultKind::Overexposed => "camera_overexposed",
            FaultKind::Flat => "camera_sees_nothing",
            FaultKind::Blurred => "camera_blurred",
            FaultKind::Misfit => "camera_misfit",
            FaultKind::Ended => "recording_ended",
        }
    }

    /// What a person can do.
    pub fn hint(self) -> &'static str {
        match self {
            FaultKind::Unplugged => "look at the camera's cable and power",
            FaultKind::Frozen | FaultKind::Repeated | FaultKind::Broken => {
                "unplug the camera and plug it in again; if it comes back, change the cable"
            }
            FaultKind::Dark => "switch the light on or give the camera a longer exposure",
            FaultKind::Overexposed => "shade the table or give the camera a shorter exposure",
            FaultKind::Flat => "uncover and clean the lens",
            FaultKind::Blurred => "clean the lens, see that it is in focus and mounted firmly",
            FaultKind::Misfit => "correct `devices.camera` or the calibration files as the message says",
            FaultKind::Ended => "name a live camera, or a longer recording",
        }
    }
}

/// Why there is no picture or no lens.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// No answer within the time limit.
    #[error(
        "camera at {address} does not answer within {limit:?}; look at its cable and power and at the \
         address in the config (for the simulator: is `celld sim` running?), then try: curl -I {address}"
    )]
    Unreachable {
        /// The address requested.
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
        /// The address requested.
        address: String,
        /// HTTP status.
        status: u16,
    },
    /// The answer lacks a header or has a broken one.
    #[error("camera at {address}: header {name} is {found:?}, a {wanted} is wanted")]
    Header {
        /// The address requested.
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
        "{place} has no intrinsics: give the camera's calibration file (--camera camera.yaml), nothing \
         measured has a default"
    )]
    NoIntrinsics {
        /// Folder or file.
        place: String,
    },
    /// The picture comes from another camera than the calibration.
    #[error(
        "{address} is camera {found:?}, the calibration is of camera {wanted:?}: connect that one or \
         calibrate this one"
    )]
    OtherSerial {
        /// The address requested.
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
    #[error("{place} gave frame {sequence} after frame {last}: the camera is frozen, or was restarted")]
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
    /// An address whose picture stayed the same.
    #[error("{address} went on giving the same picture for {:.1} s: the camera is frozen, or the address \
             renews too seldom", .within.as_secs_f64())]
    NotRenewed {
        /// The address.
        address: String,
        /// How long it was polled.
        within: Duration,
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
    /// A camera of this kind is not connected.
    #[error("{wanted} is not connected; {found}")]
    NotConnected {
        /// What was looked for.
        wanted: String,
        /// What there is instead, and what to do.
        found: String,
    },
    /// Nothing came in time.
    #[error("{place} sent no picture within {limit:?}; look at its cable, and that no other program uses it")]
    Silent {
        /// The camera.
        place: String,
        /// The time limit.
        limit: Duration,
    },
    /// The camera does not do what the configuration requests.
    #[error("{place}: {what}")]
    Setting {
        /// The camera.
        place: String,
        /// What it does not do, and what to change.
        what: String,
    },
    /// Pictures come, but not all that were requested.
    #[error("{place}: {what}")]
    Incomplete {
        /// The camera.
        place: String,
        /// What is missing, and what may help.
        what: String,
    },
    /// A recording that the RealSense SDK cannot play.
    #[error("recording {} cannot be played: record it again", path.display())]
    Recording {
        /// Which.
        path: PathBuf,
        /// What the SDK says.
        #[source]
        source: SdkError,
    },
    /// The RealSense SDK says no.
    #[error("{place}")]
    RealSense {
        /// The camera or recording.
        place: String,
        /// What it says.
        #[source]
        source: SdkError,
    },
    /// There is a picture, but nothing can be measured in it.
    #[error("{place}, frame {sequence}: {fault}")]
    Unusable {
        /// The camera.
        place: String,
        /// Number of the frame.
        sequence: u64,
        /// What is wrong with it.
        fault: PictureFault,
    },
    /// Everything that can be done from here was done.
    #[error("no picture; tried: {tried}")]
    GivenUp {
        /// What was done.
        tried: String,
        /// What it ended with.
        #[source]
        last: Box<CameraError>,
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
    /// A video or USB camera that cannot be opened or decoded.
    #[error("{} cannot be read: {what}", path.display())]
    Video {
        /// Which.
        path: PathBuf,
        /// What went wrong.
        what: String,
        /// What OpenCV says, if anything.
        #[source]
        source: Option<Box<dyn std::error::Error + Send + Sync>>,
    },
    /// An error that the RealSense process reported.
    #[error("{what}")]
    Reported {
        /// The kind of fault.
        kind: FaultKind,
        /// What went wrong, with its place.
        what: String,
        /// Why.
        #[source]
        source: Option<Box<dyn std::error::Error + Send + Sync>>,
    },
    /// The RealSense process crashed.
    #[error("{place}: the RealSense SDK crashed ({how})")]
    Crashed {
        /// The camera or recording.
        place: String,
        /// Signal or exit status.
        how: ExitStatus,
    },
    /// The program that reads it cannot be started.
    #[error(
        "cannot start {}, which reads {place}",
        program.display()
    )]
    NoReader {
        /// Device or file.
        place: String,
        /// The program.
        program: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
}

impl CameraError {
    /// True for a crash of the RealSense SDK.
    pub fn is_crash(&self) -> bool {
        matches!(self, CameraError::Crashed { .. })
    }

    /// The kind of fault.
    pub fn kind(&self) -> FaultKind {
        match self {
            CameraError::Unreachable { .. }
            | CameraError::Status { .. }
            | CameraError::NotConnected { .. }
            | CameraError::Silent { .. } => FaultKind::Unplugged,
            CameraError::RealSense { source: SdkError::Call { disconnected: true, .. }, .. } => {
                FaultKind::Unplugged
            }
            CameraError::RealSense { source: SdkError::Call { .. } | SdkError::Nonsense { .. }, .. } => {
                FaultKind::Broken
            }
            CameraError::RepeatedSequence { .. } => FaultKind::Frozen,
            CameraError::RepeatedPicture { .. } | CameraError::NotRenewed { .. } => FaultKind::Repeated,
            CameraError::Header { .. }
            | CameraError::Incomplete { .. }
            | CameraError::Picture { .. }
            | CameraError::Time { .. }
            | CameraError::Video { .. }
            | CameraError::Crashed { .. } => FaultKind::Broken,
            CameraError::NoReader { source, .. } if is_short_of_means(source) => FaultKind::Unplugged,
            CameraError::Unusable { fault, .. } => match fault {
                PictureFault::Dark { .. } => FaultKind::Dark,
                PictureFault::Overexposed { .. } => FaultKind::Overexposed,
                PictureFault::Flat { .. } => FaultKind::Flat,
                PictureFault::Blurred { .. } => FaultKind::Blurred,
            },
            CameraError::Intrinsics { .. }
            | CameraError::Model(_)
            | CameraError::NoIntrinsics { .. }
            | CameraError::OtherSerial { .. }
            | CameraError::Setting { .. }
            | CameraError::NoReader { .. }
            | CameraError::Recording { .. }
            | CameraError::RealSense { .. }
            | CameraError::File { .. }
            | CameraError::NoPictures { .. } => FaultKind::Misfit,
            CameraError::EndOfRecording { .. } => FaultKind::Ended,
            CameraError::GivenUp { last, .. } => last.kind(),
            CameraError::Reported { kind, .. } => *kind,
        }
    }
}

/// True where the system could not start a process now and may do so later.
fn is_short_of_means(error: &std::io::Error) -> bool {
    let short = [Errno::AGAIN, Errno::NOMEM, Errno::NFILE, Errno::MFILE];
    short.iter().any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_could_not_be_started_now_is_tried_again_and_a_missing_program_is_not() {
        let kind = |errno: Errno| {
            let (place, program) = ("looks.avi".to_string(), "/usr/bin/celld-video".into());
            CameraError::NoReader { place, program, source: errno.into() }.kind()
        };
        assert_eq!([Errno::MFILE, Errno::AGAIN].map(kind), [FaultKind::Unplugged; 2]);
        assert_eq!([Errno::NOENT, Errno::ACCESS].map(kind), [FaultKind::Misfit; 2]);
    }
}
