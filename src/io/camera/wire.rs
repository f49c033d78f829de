//! What celld and `celld-video` write to each other.
//!
//! A line of JSON for each request: [`Source`] first, then [`Request`]s. A line of JSON for each answer
//! ([`Reply`]); after that of a picture its pixels: 3 bytes each, red, green, blue, row by row. This file is
//! part of both programs, so that the one does not link the other.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Another number with each change of this file: an updated `celld-video` may meet a celld that still runs.
pub const WIRE: u32 = 1;

/// What is to be read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Source {
    /// A video file.
    Video {
        /// Which.
        path: PathBuf,
    },
    /// A camera of the kernel's (V4L2).
    Device {
        /// Its device file.
        path: PathBuf,
        /// Pixels per row and rows.
        size: [u32; 2],
        /// Pictures a second.
        rate: u32,
        /// Microseconds of exposure; none: the camera decides.
        exposure_us: Option<f64>,
    },
}

/// What is requested after the source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// The next picture, without its pixels.
    Grab,
    /// The pixels of the last one.
    Picture,
}

/// What is answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Reply {
    /// The source is open.
    Open {
        /// [`WIRE`] of the program.
        wire: u32,
    },
    /// A picture was taken.
    Grabbed {
        /// Milliseconds: of a video since its beginning, of a device the driver's stamp; 0 without one.
        time_ms: f64,
    },
    /// Its pixels follow.
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A video is over, or a device gave nothing.
    End,
    /// It does not work.
    Failed {
        /// What does not, and what to do.
        what: String,
        /// True when other settings would mend it.
        setting: bool,
        /// What OpenCV says, if anything.
        cause: Option<String>,
    },
}
