//! The controller and the connections to it, as sessions, frames and faults share them.
//!
//! In: a [`Controller`], and one call of [`RobotShared::frame`] per controller frame from the code that
//! keeps the time. Out: guarded access. The controller is locked for single requests, so an input package
//! takes effect as a whole in the frame that follows; the outputs are sampled under the same lock at the
//! frame's end.

use crate::controller::Controller;
use crate::faults::link::Links;
use crate::robot_server::latency::LatencyHistogram;
use crate::robot_server::lateness::Lateness;
use crate::robot_server::publisher::Publisher;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

/// The controller and the connections to it.
#[derive(Debug)]
pub struct RobotShared {
    controller: Mutex<Controller>,
    publisher: Mutex<Publisher>,
    /// What is wrong with the connections, those of gripper and camera included.
    pub links: Links,
    /// How late RTDE packages leave.
    pub latency: LatencyHistogram,
    /// How late the simulator's own tasks are.
    pub lateness: Arc<Lateness>,
}

impl RobotShared {
    /// Around a controller.
    pub fn new(controller: Controller) -> Arc<RobotShared> {
        Arc::new(RobotShared {
            controller: Mutex::new(controller),
            publisher: Mutex::new(Publisher::default()),
            links: Links::default(),
            latency: LatencyHistogram::default(),
            lateness: Arc::default(),
        })
    }

    /// The controller. A panic while it was locked leaves it in a state between two requests, which is fit
    /// to go on with.
    pub fn controller(&self) -> MutexGuard<'_, Controller> {
        self.controller.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// The connections.
    pub fn publisher(&self) -> MutexGuard<'_, Publisher> {
        self.publisher.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// One controller frame, and its outputs to all connections; packages record how late after `due` they
    /// leave.
    pub fn frame(&self, due: Option<Instant>) {
        let mut controller = self.controller();
        controller.frame();
        self.publisher().publish(&mut controller, due, &self.latency);
    }
}
