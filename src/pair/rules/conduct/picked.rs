//! The rule about objects that a hand has moved: they are not gripped where they were, if a picture since
//! then could show it.
//!
//! In: where the arm was at its pictures, the machine's pick, the world's truth. Out: breaches. A picture
//! shows an object by its marker: all of it lies in the picture and not behind the gripper, at its true
//! place or at the one that the pick rests on. A hand that comes after the last such picture cannot be
//! noticed before the cups come down.

use crate::pair::rules::conduct::Conduct;
use crate::pair::rules::rule::Rule;
use cell_machine::machine::Machine;
use cell_machine::supervisor::model::{CellModel, CellObject};
use cell_values::units::Joints;
use cell_vision::marker::corners_m;
use nalgebra::Point3;
use rearrange::geometry::pose::Pose2;
use ur_sim::simulator::Simulator;
use ur_sim::world::lock;

/// A picture reaches celld so long after its exposure at most, with one frame on the way: 40 ms.
const EXPOSED_FRAMES: u64 = 20;

/// An object is picked so near to where it is, m.
const PICKED_WITHIN_M: f64 = 0.005;

/// Pictures that are kept: more than a look has before its pick.
const PICTURES: usize = 16;

impl Conduct {
    /// Keeps where the arm is when a picture is exposed.
    pub(super) fn note_picture(&mut self, simulator: &Simulator) {
        if std::mem::take(&mut self.exposed) {
            self.pictures.push_back((self.frame, simulator.core().robot.controller().core.mover.q()));
            let over = self.pictures.len().saturating_sub(PICTURES);
            self.pictures.drain(..over);
        }
    }

    /// Where the cups come down, the object is where it was picked for, unless a hand moved it after the
    /// last picture that shows it.
    pub(super) fn check_picked(&mut self, machine: &Machine, simulator: &Simulator) {
        let Some(supervisor) = machine.supervisor().filter(|_| !self.moved_by_hand.is_empty()) else {
            return;
        };
        let Some(work) = supervisor.pick_n_place() else {
            self.gripping = false;
            return;
        };
        if std::mem::replace(&mut self.gripping, work.gripping) || !work.gripping {
            return;
        }
        let Some(moved_at) = self.moved_by_hand.get(work.object).copied() else { return };
        let world = lock(&simulator.core().world);
        let truth = world.objects().iter().find(|body| body.id == work.object).map(|body| body.pose());
        drop(world);
        let off = truth.as_ref().map_or(f64::INFINITY, |pose| pose.distance(&work.from));
        if off <= PICKED_WITHIN_M {
            return;
        }
        let model = supervisor.model();
        let Some(object) = model.object(work.object) else { return };
        let places: Vec<Pose2> = truth.into_iter().chain([work.from]).collect();
        let mut since = self.pictures.iter().filter(|(at, _)| moved_at + EXPOSED_FRAMES <= *at);
        if since.any(|(_, q)| places.iter().any(|place| shows(model, object, place, q))) {
            self.breach(Rule::PickOfMoved, format!("{}: {:.0} mm off", work.object, off * 1e3));
        }
    }
}

/// Whether a picture from `q` shows the marker of an object at `pose`, with the gripper where it is; true
/// where the lens is not known.
fn shows(model: &CellModel, object: &CellObject, pose: &Pose2, q: &Joints) -> bool {
    let marker = pose.compose(&object.marker.offset);
    let corners = corners_m(object.marker.size).map(|corner| {
        let [x, y] = marker.transform(corner);
        Point3::new(x, y, object.height)
    });
    model.views().is_none_or(|views| views.show(&model.rig().camera_at(q), &corners))
}
