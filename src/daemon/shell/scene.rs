//! What the loop shows: to viewers, recordings and calibration rounds.

use crate::daemon::messages::Displayed;
use cell_calibration::visit::{Samples, Stop};
use cell_machine::device::robot_types::RobotState;
use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_machine::supervisor::input::Notice;
use cell_machine::supervisor::order::{JobReport, RouteAction};
use cell_machine::supervisor::status::Status;
use cell_values::time::Timestamp;

/// What happens, for people and records.
#[derive(Debug)]
pub enum Scene<'a> {
    /// The status changed.
    Status(&'a Status),
    /// A sentence.
    Notice(&'a Notice),
    /// From a worker.
    Displayed(&'a Displayed),
    /// A new route.
    Route(&'a [RouteAction]),
    /// The loop has come round.
    Turn,
    /// The machine between two turns.
    Machine(&'a Machine),
    /// The machine takes this in now.
    Event(&'a Event),
    /// It has decided this.
    Effect(&'a Effect),
    /// The robot's state, as often as it comes.
    Robot(&'a RobotState),
    /// Relative vacuum of the gripper's channels A and B, 0 to 1, as often as it comes.
    Vacuum([f64; 2]),
    /// A job ended.
    Ended(&'a JobReport),
}

/// Is shown everything; must not block.
pub trait Observer {
    /// One thing at the cell's time `now`.
    fn on(&mut self, now: Timestamp, scene: Scene);
}

impl Observer for Samples<'_> {
    fn on(&mut self, _now: Timestamp, scene: Scene) {
        if let Scene::Displayed(Displayed::Sample { pose, image, sample }) = scene {
            self.add(&Stop { pose: *pose, image, sample });
        }
    }
}

/// An observer that shows nothing.
pub(super) struct NoObserver;

impl Observer for NoObserver {
    fn on(&mut self, _now: Timestamp, _scene: Scene) {}
}
