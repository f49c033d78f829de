//! Connections to the primary, secondary and real-time interface: programs in, state and messages out.
//!
//! In: a stream. Out: uploads to the controller. Without remote control, and on a connection made before the
//! last switch to it, uploads are refused with error C210, as the read-only connections of the controller do.

use crate::sim::controller::{builtins, robot_state};
use crate::sim::faults::link::LinkStream;
use crate::sim::robot_server::RobotShared;
use crate::sim::robot_server::outlets::{Feed, Inlet, encode_message, encode_state};
use crate::sim::robot_server::script_channel::{ScriptChannel, Upload};
use crate::wire::primary_message::{MessageBody, READ_ONLY};
use std::sync::Arc;
use tokio::io::{AsyncReadExt, AsyncWriteExt, ReadHalf, WriteHalf};

/// Serves one connection to its end.
pub async fn connection(shared: Arc<RobotShared>, stream: LinkStream, feed: Feed) {
    let (reader, writer) = tokio::io::split(stream);
    let (inlet, switches) = open(&shared, feed);
    let id = inlet.id;
    let dropped = inlet.dropped.clone();
    let replies = inlet.replies.clone();
    let mut writing = tokio::spawn(write_all(inlet, writer));
    let reading = read_all(&shared, reader, feed, switches, &replies);
    tokio::select! {
        () = reading => {}
        () = dropped.notified() => {}
        _ = &mut writing => {}
    }
    shared.outlets().close(id);
    writing.abort();
}

/// Adds the connection to the outlets with its greeting: version, then what is sent once.
fn open(shared: &RobotShared, feed: Feed) -> (Inlet, u64) {
    let controller = shared.controller();
    let inlet = shared.outlets().open(feed);
    if feed != Feed::Realtime {
        let [major, minor, bugfix, build] = controller.core.config.version;
        let version = MessageBody::Version {
            project: "URControl".to_owned(),
            major: major as u8,
            minor: minor as u8,
            bugfix: bugfix as i32,
            build: build as i32,
            date: "01-01-2026, 00:00:00".to_owned(),
        };
        let state =
            robot_state::periodic(&controller).into_iter().chain(robot_state::once(&controller)).collect();
        // The queue of a new connection has room.
        let _ = inlet.replies.try_send(encode_message(&controller, version));
        let _ = inlet.replies.try_send(encode_state(state));
    }
    (inlet, controller.core.modes.switches())
}

/// Writes what is queued until the connection breaks.
pub async fn write_all(mut inlet: Inlet, mut writer: WriteHalf<LinkStream>) {
    // The own handle for replies would keep the queue open after the outlet is gone.
    drop(inlet.replies);
    while let Some(bytes) = inlet.queue.recv().await {
        if writer.write_all(&bytes).await.is_err() {
            return;
        }
    }
}

async fn read_all(
    shared: &RobotShared,
    mut reader: ReadHalf<LinkStream>,
    feed: Feed,
    switches: u64,
    replies: &tokio::sync::mpsc::Sender<crate::sim::robot_server::outlets::Bytes>,
) {
    let mut channel = ScriptChannel::default();
    let mut buffer = vec![0; 64 * 1024];
    loop {
        let count = match reader.read(&mut buffer).await {
            Ok(0) | Err(_) => break,
            Ok(count) => count,
        };
        let Ok(uploads) = channel.push(&buffer[..count]) else { return };
        for upload in uploads {
            carry_out(shared, upload, feed, switches, replies);
        }
    }
    if let Some(upload) = channel.finish() {
        carry_out(shared, upload, feed, switches, replies);
    }
}

fn carry_out(
    shared: &RobotShared,
    upload: Upload,
    feed: Feed,
    switches: u64,
    replies: &tokio::sync::mpsc::Sender<crate::sim::robot_server::outlets::Bytes>,
) {
    // Compiling takes milliseconds for a large program: not under the lock that the frames need.
    let code = match &upload {
        Upload::Program(text) => Some(builtins::compile_program(text)),
        _ => None,
    };
    let mut controller = shared.controller();
    let modes = &controller.core.modes;
    if !modes.remote() || modes.switches() != switches {
        let text = "connection is read-only: switch to remote control and reconnect".to_owned();
        let body = MessageBody::Error { code: READ_ONLY, argument: 0, level: 2, data_type: 0, data: 0, text };
        if feed == Feed::Primary {
            // A client that does not read does not see why; nothing waits for it.
            let _ = replies.try_send(encode_message(&controller, body));
        }
        return;
    }
    let controller = &mut *controller;
    match upload {
        Upload::Program(_) => {
            if let Some(code) = code {
                controller.programs.upload(code);
            }
        }
        Upload::PowerOn => controller.core.modes.power_on(),
        Upload::PowerOff => controller.power_off(),
        Upload::ReleaseBrakes => controller.core.modes.release_brakes(),
        Upload::Unlock => {
            // This channel has no reply; the client sees the mode change or not.
            let _ = controller.unlock_protective_stop();
        }
        Upload::StopProgram => {
            controller.programs.stop(&mut controller.core);
        }
    }
}
