//! Connections to the primary, secondary and real-time interface: programs in, state and messages out.
//!
//! In: a client's bytes. Out: uploads to the controller. Without remote control, and on a connection made
//! before the last switch to it, uploads are refused with error C210, as the read-only connections of the
//! controller do. The read-only ports send the same and throw away what they are sent.

use crate::controller::registers::ClientId;
use crate::controller::{builtins, robot_state};
use crate::robot_server::line::{Inlet, Line};
use crate::robot_server::publisher::{Feed, encode_message, encode_state};
use crate::robot_server::script_channel::{ScriptChannel, TooLong, Upload};
use crate::robot_server::shared::RobotShared;
use ur_wire::primary_message::{MessageBody, READ_ONLY};

/// What a port sends, and whether it takes scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Port {
    /// What it sends.
    pub feed: Feed,
    /// It takes no scripts.
    pub read_only: bool,
}

/// One connection, without its socket.
pub struct Session {
    id: ClientId,
    channel: ScriptChannel,
    port: Port,
    switches: u64,
    replies: Line,
}

impl Session {
    /// Adds the connection to the outlets with its greeting: version, then what is sent once.
    pub fn open(shared: &RobotShared, port: Port) -> (Session, Inlet) {
        let controller = shared.controller();
        let (id, inlet) = shared.publisher().open(port.feed, port.read_only, None);
        if port.feed != Feed::Realtime {
            let [major, minor, bugfix, build] = controller.core.version();
            let version = MessageBody::Version {
                project: "URControl".to_owned(),
                major: major as u8,
                minor: minor as u8,
                bugfix: bugfix as i32,
                build: build as i32,
                date: "01-01-2026, 00:00:00".to_owned(),
            };
            let state = robot_state::periodic(&controller)
                .into_iter()
                .chain(robot_state::once(&controller))
                .collect();
            // The queue of a new connection has room.
            let _ = inlet.replies.try_send(encode_message(&controller, version).into());
            let _ = inlet.replies.try_send(encode_state(state).into());
        }
        let (switches, replies) = (controller.core.modes.switches(), inlet.replies.clone());
        (Session { id, channel: ScriptChannel::default(), port, switches, replies }, inlet)
    }

    /// The connection's number.
    pub fn id(&self) -> ClientId {
        self.id
    }

    /// Hands what arrived to the controller.
    ///
    /// # Errors
    /// A program without an end; the connection ends.
    pub fn receive(&mut self, shared: &RobotShared, bytes: &[u8]) -> Result<(), TooLong> {
        if self.port.read_only {
            return Ok(());
        }
        for upload in self.channel.push(bytes)? {
            self.carry_out(shared, upload);
        }
        Ok(())
    }

    /// The client has sent its last byte.
    pub fn finish(&mut self, shared: &RobotShared) {
        if let Some(upload) = self.channel.finish() {
            self.carry_out(shared, upload);
        }
    }

    /// Removes the connection from the outlets.
    pub fn close(&self, shared: &RobotShared) {
        shared.publisher().close(self.id);
    }

    fn carry_out(&self, shared: &RobotShared, upload: Upload) {
        // Compiling takes milliseconds for a large program: not under the lock that the frames need.
        let code = match &upload {
            Upload::Program(text) => Some(builtins::compile_program(text)),
            _ => None,
        };
        let mut controller = shared.controller();
        let modes = &controller.core.modes;
        if !modes.takes_commands() || modes.switches() != self.switches {
            let text = "connection is read-only: switch to remote control and reconnect".to_owned();
            let body =
                MessageBody::Error { code: READ_ONLY, argument: 0, level: 2, data_type: 0, data: 0, text };
            if self.port.feed == Feed::Primary {
                // A client that does not read does not see why; nothing waits for it.
                let _ = self.replies.try_send(encode_message(&controller, body).into());
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
            // Assumed: there is no reply to refuse with, and clients wait for 0.1 to 5 s before.
            Upload::Unlock => controller.unlock_at_once(),
            Upload::StopProgram => {
                controller.programs.cancel(&mut controller.core);
            }
        }
    }
}
