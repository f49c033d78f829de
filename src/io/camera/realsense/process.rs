//! The process that loads the RealSense SDK: what celld and it write to each other, and what it does.
//!
//! In: a [`Task`], then a line of [`GRAB`] for each picture. Out: a line of JSON each ([`Reply`]), after
//! that of a picture its bytes. It is celld's own binary, started once more (`celld realsense`), so that
//! both ends are of one version.

use crate::io::camera::realsense::player::{Player, restart};
use crate::io::camera::realsense::sdk::Intrinsics;
use crate::io::camera::realsense::stream::RealSenseSettings;
use crate::io::camera::{CameraError, FaultKind, Frame};
use cell_edge::requests::{replies, requests};
use rearrange::document::chain::chain;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::io::Write;
use std::sync::mpsc::Receiver;
use std::time::Duration;

/// What is requested after the task.
pub(super) const GRAB: &str = "grab";

/// The first request: the job of this process.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Task {
    /// Open, then send a picture for each request.
    Stream {
        /// Which camera or recording.
        settings: RealSenseSettings,
        /// How long a set of frames may take.
        limit: Duration,
    },
    /// Restart the camera.
    Restart {
        /// Which.
        settings: RealSenseSettings,
    },
}

/// Answers.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Reply {
    /// It streams.
    Open {
        /// The camera's serial number.
        serial: String,
        /// Lens and size of its colour picture.
        lens: Option<Intrinsics>,
    },
    /// A picture; its bytes follow: 3 for each pixel, red, green, blue, row by row; then, with depth, 4 for
    /// each pixel, metres as a little-endian float.
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// The camera's count.
        sequence: u64,
        /// The camera's time, s.
        time_s: f64,
        /// Depth follows too.
        depth: bool,
    },
    /// The recording is over.
    End,
    /// The camera restarts.
    Restarted,
    /// It does not work.
    Failed {
        /// The kind of fault.
        kind: FaultKind,
        /// What, with the place.
        what: String,
        /// Why, if that is known.
        cause: Option<String>,
    },
}

/// Reads a camera for the daemon that started this process, until that closes its end.
///
/// # Errors
/// What the system says of standard input and output.
pub fn serve() -> std::io::Result<()> {
    // The daemon may run at a high priority, which this process would inherit.
    cell_edge::priority::lower();
    cell_edge::memory::keep_large_blocks_apart();
    let mut to = replies()?;
    let requests = requests();
    let Ok(task) = requests.recv() else { return Ok(()) };
    match serde_json::from_str(&task)? {
        Task::Restart { settings } => {
            let reply = restart(&settings).map_or_else(|error| failed(&error), |()| Reply::Restarted);
            write(&mut to, &reply, &[])
        }
        Task::Stream { settings, limit } => match Player::start(settings, limit) {
            Ok(player) => stream(player, &requests, &mut to),
            Err(error) => write(&mut to, &failed(&error), &[]),
        },
    }
}

fn stream(mut player: Player, requests: &Receiver<String>, to: &mut impl Write) -> std::io::Result<()> {
    write(to, &Reply::Open { serial: player.serial().to_string(), lens: player.lens() }, &[])?;
    while requests.recv().is_ok() {
        match player.grab() {
            Ok(frame) => picture(to, frame)?,
            Err(CameraError::EndOfRecording { .. }) => write(to, &Reply::End, &[])?,
            Err(error) => write(to, &failed(&error), &[])?,
        }
    }
    Ok(())
}

fn picture(to: &mut impl Write, frame: Frame) -> std::io::Result<()> {
    let Frame { image, sequence, time_s, depth, .. } = frame;
    let (width, height) = (image.width, image.height);
    let mut bytes = image.rgb;
    if let Some(depth) = &depth {
        bytes.extend(depth.metres.iter().flat_map(|metres| metres.to_le_bytes()));
    }
    write(to, &Reply::Picture { width, height, sequence, time_s, depth: depth.is_some() }, &bytes)
}

fn failed(error: &CameraError) -> Reply {
    Reply::Failed { kind: error.kind(), what: error.to_string(), cause: error.source().map(chain) }
}

fn write(to: &mut impl Write, reply: &Reply, bytes: &[u8]) -> std::io::Result<()> {
    serde_json::to_writer(&mut *to, reply)?;
    to.write_all(b"\n")?;
    to.write_all(bytes)?;
    to.flush()
}
