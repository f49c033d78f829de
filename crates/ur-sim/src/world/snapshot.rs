//! The true state as JSON, for the control server and the final report.
//!
//! In: the world. Out: one JSON object with time, objects, gripper, contact and events. Truth: no part of
//! the daemon reads it.

use crate::world::vacuum::{Channel, VacuumMode};
use crate::world::{Body, BodyState, World};
use serde_json::{Value, json};

impl World {
    /// The true state as a JSON object: lengths m, angles rad, vacuum as fractions.
    pub fn snapshot_json(&self) -> Value {
        let channels: Vec<Value> =
            Channel::ALL.into_iter().map(|channel| self.channel_json(channel)).collect();
        json!({
            "time_s": self.now_s,
            "seed": self.seed,
            "camera_on": self.camera_on(),
            "objects": self.bodies.iter().map(|body| self.body_json(body)).collect::<Vec<_>>(),
            "channels": channels,
            "contact": self.contact,
            "events": self.events,
        })
    }

    fn channel_json(&self, channel: Channel) -> Value {
        let state = &self.channels[channel.index()];
        let mode = match state.pump.mode() {
            VacuumMode::Release => "release",
            VacuumMode::Grip => "grip",
            VacuumMode::Idle => "idle",
        };
        json!({
            "mode": mode,
            "target": state.pump.target(),
            "vacuum": state.pump.vacuum(),
            "sealed": state.sealed,
            "holds": state.holds.map(|index| &self.bodies[index].id),
        })
    }

    fn body_json(&self, body: &Body) -> Value {
        let (state, on) = match &body.state {
            BodyState::Resting { on } => {
                ("resting", on.iter().map(|index| &self.bodies[*index].id).collect())
            }
            BodyState::Held { .. } => ("held", Vec::new()),
            BodyState::Fallen => ("fallen", Vec::new()),
        };
        json!({
            "id": body.id,
            "state": state,
            "on": on,
            "pose": body.pose(),
            "z_m": body.table_from_object.translation.z,
            "tilt_rad": body.tilt_rad(),
        })
    }
}
