//! Controller, world and faults of the simulated cell, in step: what all sessions act on.
//!
//! In: [`Core::advance`] for 2 ms of simulated time. Out: the three parts, each behind its own lock, so that
//! a client's request waits for no more than it concerns. Nothing here opens a socket or starts a thread:
//! time is the number of calls.

use crate::compute_box::{self, ComputeBox, Over, SharedBox};
use crate::controller::Controller;
use crate::faults::injector::FaultInjector;
use crate::faults::link::LinkName;
use crate::gripper_server;
use crate::motion::FRAME_SECONDS;
use crate::robot_server::shared::RobotShared;
use crate::world::event::Contact;
use crate::world::{SharedWorld, World, lock};
use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::Instant;
use ur_wire::bytes::WireError;

/// Depth of a contact at which the arm's safety system stops it, m: cups and flange give way by some mm
/// first.
const STOP_DEPTH_M: f64 = 0.006;

/// Controller, world and faults, in step.
#[derive(Clone)]
pub struct Core {
    /// The controller and what it sends.
    pub robot: Arc<RobotShared>,
    /// The table, the objects, the gripper.
    pub world: SharedWorld,
    /// Whom the gripper's box serves.
    pub compute_box: SharedBox,
    /// Faults planned and in force.
    pub injector: Arc<FaultInjector>,
}

impl fmt::Debug for Core {
    /// As its name: it is long.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Core")
    }
}

impl Core {
    /// The world has its arm from the beginning. `factor`: simulated seconds per second, for delays of real
    /// sockets.
    pub fn new(controller: Controller, mut world: World, factor: f64) -> Core {
        world.set_conveyors(controller.core.config.belts.clone());
        let robot = RobotShared::new(controller);
        let compute_box = Arc::new(Mutex::new(ComputeBox::new(world.box_config())));
        let world: SharedWorld = Arc::new(Mutex::new(world));
        let injector = Arc::new(FaultInjector::new(robot.clone(), world.clone(), factor));
        let core = Core { robot, world, compute_box, injector };
        core.step_world();
        core
    }

    /// One controller frame, 2 ms; `due`: when it was, for how late packages leave.
    pub fn advance(&self, due: Option<Instant>) {
        self.robot.frame(due);
        self.step_world();
        self.serve_who_waited();
        self.injector.frame();
    }

    /// Requests to the gripper, however they came.
    ///
    /// # Errors
    /// The bytes are no Modbus TCP.
    pub fn gripper_receives(
        &self,
        session: &mut gripper_server::Session,
        bytes: &[u8],
    ) -> Result<Vec<u8>, WireError> {
        let faults = self.robot.links.get(LinkName::Gripper).state();
        session.receive(&mut lock(&self.world), &faults, bytes)
    }

    /// Bytes of a client of the gripper's box; the answers.
    ///
    /// # Errors
    /// Its connection is over.
    pub fn box_receives(&self, number: u64, bytes: &[u8]) -> Result<Vec<u8>, Over> {
        let now_s = lock(&self.world).now_s();
        let carry_out =
            |session: &mut gripper_server::Session, bytes: &[u8]| self.gripper_receives(session, bytes);
        compute_box::lock(&self.compute_box).receive(now_s, number, bytes, carry_out)
    }

    fn serve_who_waited(&self) {
        let now_s = lock(&self.world).now_s();
        let carry_out =
            |session: &mut gripper_server::Session, bytes: &[u8]| self.gripper_receives(session, bytes);
        compute_box::lock(&self.compute_box).frame(now_s, carry_out);
    }

    /// The world follows the arm, which feels what it touches; where it presses too hard, its safety system
    /// stops it.
    fn step_world(&self) {
        let (now, base_from_flange, moving, outputs) = {
            let core = &self.robot.controller().core;
            let moving = !core.mover.stands();
            (core.timestamp(), core.base_from_flange(), moving, core.registers.digital_outputs)
        };
        let (force, pressed, switch) = {
            let mut world = lock(&self.world);
            let switch = world.drive_ejector(outputs);
            let before = world.contact().map_or(0.0, |contact| contact.depth_m);
            world.step(now, FRAME_SECONDS, &base_from_flange);
            // Only what gets deeper: after the stop the arm must be able to retreat.
            let too_deep = |contact: &&Contact| moving && contact.depth_m > STOP_DEPTH_M.max(before);
            let force = world.base_from_table().rotation * world.contact_force();
            (force, world.contact().filter(too_deep).cloned(), switch)
        };
        let wrench = [force.x, force.y, force.z, 0.0, 0.0, 0.0];
        let mut controller = self.robot.controller();
        controller.core.sensing.set_contact_wrench(wrench);
        if let Some((pin, level)) = switch {
            let inputs = &mut controller.core.registers.digital_inputs;
            *inputs = *inputs & !(1 << pin) | u64::from(level) << pin;
        }
        if let Some(contact) = pressed {
            controller.protective_stop(&format!("{} presses on {}", contact.moving, contact.against));
        }
    }
}
