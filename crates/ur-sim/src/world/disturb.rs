//! Faults of the world: air, sticky cups, moved objects, and what the camera suffers; and what the injector
//! of faults needs to see to know when they are due.
//!
//! In: calls of the injector between two frames. Out: changed state, events, glances. Nothing here happens
//! by itself.

use crate::faults::FaultError;
use crate::faults::camera::CameraFaults;
use crate::faults::schedule::Glance;
use crate::render::scene::Cells;
use crate::world::event::{Event, EventKind};
use crate::world::section::Section;
use crate::world::spec::ForeignBody;
use crate::world::vacuum::{Channel, ChannelFaults, VacuumMode};
use crate::world::{Body, BodyState, World};
use rearrange::geometry::pose::Pose2;
use std::sync::Arc;

/// A mug's mass, kg.
const FOREIGN_MASS_KG: f64 = 0.3;
/// A mug's colour.
const FOREIGN_COLOUR: [u8; 3] = [150, 96, 60];

fn foreign_body(index: usize, thing: &ForeignBody) -> Body {
    Body {
        id: format!("foreign-{index}"),
        section: Arc::new(Section::from_footprint(&thing.footprint)),
        height_m: thing.height_m,
        mass_kg: FOREIGN_MASS_KG,
        marker: None,
        grippable: None,
        fixed: false,
        colour: FOREIGN_COLOUR,
        table_from_object: thing.pose.at_height(0.0),
        state: BodyState::Resting { on: Vec::new() },
    }
}

impl World {
    /// Sets what is wrong with a channel; a leak that was there already goes on falling.
    pub fn set_channel_faults(&mut self, channel: Channel, faults: ChannelFaults) {
        let state = &mut self.channels[channel.index()];
        if faults.open && !state.faults.open {
            state.pump.collapse();
        }
        if faults.leak != state.faults.leak {
            state.leak_age_s = 0.0;
        }
        state.faults = faults;
    }

    /// What is held stays on the cups, whatever the vacuum.
    pub fn set_sticky(&mut self, sticky: bool) {
        self.sticky = sticky;
    }

    /// What is wrong with the camera.
    pub fn camera_faults(&self) -> &CameraFaults {
        &self.camera
    }

    /// Sets what is wrong with the camera.
    pub fn set_camera_faults(&mut self, faults: CameraFaults) {
        self.camera = faults;
    }

    /// Keeps in the list of events that a fault was brought about.
    pub fn note_fault(&mut self, name: &str) {
        self.record(EventKind::Fault { name: name.to_owned() });
    }

    /// A person moves an object by `by`: a shift in the table frame and a turn about itself.
    ///
    /// # Errors
    /// [`FaultError::NoSuchObject`], [`FaultError::NotFree`].
    pub fn nudge(&mut self, object: &str, by: &Pose2) -> Result<(), FaultError> {
        let index = self.free_object(object)?;
        let pose = self.bodies[index].pose();
        self.put_down(index, Pose2::new(pose.x + by.x, pose.y + by.y, pose.theta + by.theta));
        Ok(())
    }

    /// A person puts an object to `pose`, also one that has fallen off the table.
    ///
    /// # Errors
    /// [`FaultError::NoSuchObject`], [`FaultError::NotFree`].
    pub fn put(&mut self, object: &str, pose: &Pose2) -> Result<(), FaultError> {
        let fallen = |body: &Body| body.id == object && body.is_fallen() && !body.fixed;
        let index = match self.bodies.iter().position(fallen) {
            Some(index) => index,
            None => self.free_object(object)?,
        };
        self.put_down(index, *pose);
        Ok(())
    }

    /// Puts a thing on the table; one that is there already stays as it is, one that fell is put back.
    pub fn put_foreign(&mut self, thing: &ForeignBody) {
        let is_there = |&index: &usize| self.bodies[index].state != BodyState::Fallen;
        if self.foreign.iter().any(|(known, index)| known == thing && is_there(index)) {
            return;
        }
        // What fell is gone for good, so its place in the list serves the next thing.
        let vacant = self.foreign.iter().position(|(_, index)| !is_there(index));
        let (slot, index) = match vacant {
            Some(slot) => (slot, self.foreign[slot].1),
            None => (self.foreign.len(), self.bodies.len()),
        };
        let body = foreign_body(index, thing);
        match vacant {
            Some(_) => {
                self.bodies[index] = body;
                self.foreign[slot].0 = thing.clone();
            }
            None => {
                self.bodies.push(body);
                self.foreign.push((thing.clone(), index));
            }
        }
    }

    /// Takes away every foreign thing that is not among `wanted`. One that hangs on the gripper is left
    /// there.
    pub fn keep_foreign(&mut self, wanted: &[&ForeignBody]) {
        for slot in 0..self.foreign.len() {
            let (thing, index) = &self.foreign[slot];
            let index = *index;
            if self.bodies[index].is_resting() && !wanted.contains(&thing) {
                self.bodies[index].state = BodyState::Fallen;
                self.drop_what_lay_on(index);
            }
        }
    }

    fn free_object(&self, object: &str) -> Result<usize, FaultError> {
        let found = self.bodies.iter().position(|body| body.id == object);
        let index = found.ok_or_else(|| FaultError::NoSuchObject(object.to_owned()))?;
        match self.bodies[index].is_resting() && !self.bodies[index].fixed {
            true => Ok(index),
            false => Err(FaultError::NotFree(object.to_owned())),
        }
    }

    /// Some print in the cell has this number.
    pub fn has_marker(&self, id: u32) -> bool {
        self.print_of(id).is_some()
    }

    /// Cells and size (m) of the print with this number.
    pub(super) fn print_of(&self, id: u32) -> Option<(Cells, f64)> {
        let on_table = self.reference.iter().map(|(marker, cells)| (marker.id, *cells, marker.size_m));
        let on_objects = self.bodies.iter().filter_map(|body| body.marker.as_ref());
        let on_objects = on_objects.map(|(marker, cells)| (marker.id, *cells, marker.size_m));
        on_table
            .chain(on_objects)
            .find(|(number, ..)| *number == id)
            .map(|(_, cells, size_m)| (cells, size_m))
    }

    /// Events recorded so far, those included that were dropped since.
    pub fn recorded(&self) -> u64 {
        self.recorded
    }

    /// Events after the first `seen`, oldest first.
    pub fn events_after(&self, seen: u64) -> impl Iterator<Item = &Event> + Clone {
        let new = usize::try_from(self.recorded.saturating_sub(seen)).unwrap_or(usize::MAX);
        self.events.iter().skip(self.events.len().saturating_sub(new))
    }

    /// What shows which part of a pick-n-place this is.
    pub fn glance(&self) -> Glance {
        let (tool, velocity) = self.tool.map_or(([0.0; 3], [0.0; 3]), |tool| {
            (tool.table_from_tool.translation.vector.into(), tool.velocity.into())
        });
        let gripping = self.channels.iter().any(|state| state.pump.mode() == VacuumMode::Grip);
        Glance { holds: self.held().next().is_some(), gripping, tool, velocity }
    }
}
