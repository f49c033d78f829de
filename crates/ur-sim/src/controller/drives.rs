//! What the drives feel: joint moments, the currents that go with them, accelerations and momentum of the
//! arm.
//!
//! In: the controller's motion, payload and forces of this frame. Out: values of RTDE, the real-time and the
//! primary interface. Moments come from the published masses of a UR5e. Currents are moments over a torque
//! constant of the right size: the vendor publishes none, and clients look at currents for change, not for
//! value. With brakes closed the drives do nothing.

use crate::controller::Controller;
use crate::controller::core::Core;
use crate::motion::dynamics::{self, Link, Masses, UR5E_LINKS};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Point3, Vector3, Vector6};

/// Joint moment per ampere, Nm/A: larger drives carry base to elbow, smaller ones the wrist.
const TORQUE_PER_AMPERE: [f64; 6] = [13.0, 13.0, 13.0, 9.0, 9.0, 9.0];

/// Step of differences over time, s: no rounding spoils it.
const STEP_S: f64 = 1e-5;

impl Core {
    /// Arm and payload.
    pub fn masses(&self) -> Masses<'static> {
        let payload =
            Link { mass: self.payload.mass, centre: self.payload.centre, inertia: self.payload.inertia };
        Masses { links: &UR5E_LINKS, payload }
    }

    /// Moments with which the joints should hold and move arm and payload, Nm.
    pub fn target_moments(&self) -> [f64; 6] {
        if !self.modes.brakes_open() {
            return [0.0; 6];
        }
        let mover = &self.mover;
        let gravity = self.felt_gravity();
        let (q, qd, qdd) = (mover.q(), mover.qd(), mover.qdd());
        dynamics::inverse_dynamics(mover.arm.kinematics.chain(), &self.masses(), &q, &qd, &qdd, &gravity)
    }

    /// What an arm at rest feels, m/s2: gravity, and the acceleration of a base that moves.
    fn felt_gravity(&self) -> Vector3<f64> {
        Vector3::from(self.payload.gravity) + Vector3::from(self.settings.base_acceleration)
    }

    /// Moments with which they do, Nm: those and what holds against the world.
    pub fn joint_moments(&self) -> [f64; 6] {
        if !self.modes.brakes_open() {
            return [0.0; 6];
        }
        // A drive feels the world itself, not what a sensor makes of it.
        let (own, added) = (self.target_moments(), self.torques_against(self.sensing.contact()));
        std::array::from_fn(|i| own[i] + added[i])
    }

    /// Currents of the joints, A.
    pub fn joint_currents(&self) -> [f64; 6] {
        amperes(self.joint_moments())
    }

    /// What the measured forces at the tool require of the joints, Nm.
    pub fn contact_torques(&self) -> [f64; 6] {
        self.torques_against(self.tcp_force())
    }

    /// Moments that hold against a force and torque (N, Nm) on the TCP in the base frame.
    fn torques_against(&self, wrench: [f64; 6]) -> [f64; 6] {
        let arm = &self.mover.arm;
        let jacobian = dynamics::tool_jacobian(arm.kinematics.chain(), &arm.flange_from_tcp, &self.mover.q());
        (-(jacobian.transpose() * Vector6::from(wrench))).into()
    }

    /// Acceleration of the tool in the base frame, m/s2 and rad/s2.
    pub fn tcp_acceleration(&self) -> [f64; 6] {
        self.acceleration_of(&self.mover.arm.flange_from_tcp)
    }

    /// Acceleration of a frame that is fixed to the flange, in the base frame, m/s2 and rad/s2.
    fn acceleration_of(&self, flange_from_it: &Isometry3<f64>) -> [f64; 6] {
        let mover = &self.mover;
        let (arm, q, qd) = (&mover.arm, mover.q(), mover.qd());
        let jacobian = dynamics::tool_jacobian(arm.kinematics.chain(), flange_from_it, &q);
        let change = dynamics::tool_jacobian_derivative(arm.kinematics.chain(), flange_from_it, &q, &qd);
        (jacobian * Vector6::from(mover.qdd()) + change * Vector6::from(qd)).into()
    }

    /// What an accelerometer in the flange reads, m/s2 in the flange frame; gravity shows as upwards.
    pub fn tool_accelerometer(&self) -> [f64; 3] {
        let mover = &self.mover;
        let flange = mover.flange();
        let [x, y, z, ..] = self.acceleration_of(&Isometry3::identity());
        let felt = Vector3::new(x, y, z) + self.felt_gravity();
        (flange.rotation.inverse() * felt).into()
    }

    /// Magnitude of the momentum of arm and payload, kg m/s.
    pub fn momentum(&self) -> f64 {
        let (q, qd) = (self.mover.q(), self.mover.qd());
        let ahead = Joints(std::array::from_fn(|i| q.0[i] + qd[i] * STEP_S));
        let (now, then) = (self.mass_moment(&q), self.mass_moment(&ahead));
        (then - now).norm() / STEP_S
    }

    /// Mechanical work that the tool does to what it touches, W.
    pub fn power(&self) -> f64 {
        let felt = Vector6::from(self.sensing.contact());
        (-felt.dot(&self.mover.tcp_speed())).max(0.0)
    }

    /// Mass times place of the centre of mass, base frame, kg m.
    fn mass_moment(&self, q: &Joints) -> Vector3<f64> {
        let (frames, masses) = (self.mover.arm.kinematics.chain().frames(q), self.masses());
        let links = masses.links.iter().zip(&frames).chain(std::iter::once((&masses.payload, &frames[5])));
        links.map(|(link, frame)| (frame * Point3::from(link.centre)).coords * link.mass).sum()
    }
}

/// Currents that go with the target moments, A.
pub fn target_currents(controller: &Controller) -> [f64; 6] {
    amperes(controller.core.target_moments())
}

/// Currents that flow, A.
pub fn actual_currents(controller: &Controller) -> [f64; 6] {
    controller.core.joint_currents()
}

fn amperes(moments: [f64; 6]) -> [f64; 6] {
    std::array::from_fn(|i| moments[i] / TORQUE_PER_AMPERE[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::ControllerConfig;
    use crate::controller::builtins::compile_program;

    fn running(script: &str, frames: usize) -> Controller {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        controller.programs.upload(compile_program(script));
        (0..frames).for_each(|_| controller.frame());
        controller
    }

    #[test]
    fn a_standing_arm_holds_its_weight_and_the_payload_and_what_presses_on_it() {
        let mut controller = running("def m():\n sleep(10)\nend\n", 10);
        let empty = controller.core.target_moments();
        assert!(empty[0].abs() < 1e-9, "gravity does not turn the base: {empty:?}");
        controller.core.payload.mass = 2.0;
        let loaded = controller.core.target_moments();
        // Against the potential energy: the moment of gravity is how it changes with the joint.
        let reach = {
            let arm = &controller.core.mover.arm;
            let height = |q: f64| {
                let mut joints = controller.core.mover.q();
                joints.0[1] += q;
                (arm.kinematics.chain().frames(&joints)[5] * Point3::from(controller.core.payload.centre)).z
            };
            (height(1e-5) - height(-1e-5)) / 2e-5
        };
        let gravity = controller.core.payload.gravity[2];
        let [before, after] = [empty[1], loaded[1]];
        assert!((after - before - 2.0 * gravity * reach).abs() < 1e-4, "{before} {after} {reach}");
        assert_eq!(controller.core.joint_moments(), loaded, "nothing touches the arm");
        controller.core.sensing.set_contact_wrench([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]);
        let pressed = controller.core.joint_moments();
        let arm = &controller.core.mover.arm;
        let jacobian =
            dynamics::tool_jacobian(arm.kinematics.chain(), &arm.flange_from_tcp, &controller.core.mover.q());
        assert!((pressed[1] - loaded[1] + 10.0 * jacobian[(2, 1)]).abs() < 1e-6, "{pressed:?}");
        assert_eq!(actual_currents(&controller)[1] * TORQUE_PER_AMPERE[1], pressed[1]);
        // The sensor forgets what presses when it is zeroed; the drives hold against it all the same.
        let raw = controller.core.raw_wrench();
        controller.core.sensing.zero(raw);
        assert_eq!(controller.core.joint_moments(), pressed);
        controller.power_off();
        assert_eq!(actual_currents(&controller), [0.0; 6]);
    }

    #[test]
    fn accelerations_and_momentum_are_those_of_a_turn_about_the_base() {
        let mut controller = running("def m():\n speedj([0.5,0,0,0,0,0], 40, 10)\nend\n", 200);
        let core = &controller.core;
        let (omega, [x, y, z, ..]) = (core.mover.qd()[0], core.tcp_pose());
        let [ax, ay, az, ..] = core.tcp_acceleration();
        assert!((omega - 0.5).abs() < 1e-6);
        assert!((ax + omega * omega * x).abs() < 1e-5 && (ay + omega * omega * y).abs() < 1e-5, "{ax} {ay}");
        assert!(az.abs() < 1e-6, "{az} at {z}");
        let felt = Vector3::from(core.tool_accelerometer()).norm();
        let expected = Vector3::new(ax, ay, az + core.payload.gravity[2]).norm();
        assert!((felt - expected).abs() < 1e-9);
        // A payload in the flange adds its mass times the flange's speed, in the direction the links move
        // in.
        let empty = core.momentum();
        controller.core.payload.mass = 1000.0;
        let added = controller.core.momentum() - empty;
        let speed = omega * x.hypot(y);
        assert!((added / 1000.0 / speed - 1.0).abs() < 0.02, "{added} at {speed}");
        // The accelerometer sits in the flange wherever the TCP is.
        controller.core.payload.mass = 0.0;
        let before = controller.core.tool_accelerometer();
        controller.core.mover.arm.flange_from_tcp = Isometry3::translation(0.0, 0.1, 0.2);
        assert_eq!(controller.core.tool_accelerometer(), before);
    }
}
