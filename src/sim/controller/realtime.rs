//! The state block of the real-time interface (port 30003).
//!
//! In: the controller's state. Out: 1220 bytes, the layout of software 5.10 and later: a length and 152
//! doubles. Source: the vendor's client-interface table; the length is confirmed, single fields are from
//! memory and marked so in the interface notes, so nothing of celld reads this block.

use crate::sim::controller::Controller;
use crate::sim::controller::outputs::{joint_mode, speed_scaling};
use crate::wire::bytes::Writer;

/// Bytes of the block, the length field included.
pub const LENGTH: usize = 1220;

/// The block of this frame.
pub fn block(controller: &Controller) -> Vec<u8> {
    let core = &controller.core;
    let (q, qd, qdd) = (core.mover.q().0, core.mover.qd(), core.mover.qdd());
    let tcp_speed: [f64; 6] = core.mover.tcp_speed().into();
    let program_state = f64::from(controller.programs.runtime_state().code());
    let safety = f64::from(core.modes.safety_mode().code());
    let mut out = Writer::new();
    out.i32(LENGTH as i32).f64(core.timestamp());
    // Targets: q, qd, qdd, current, moment. Actuals: q, qd, current; control current.
    out.f64s(&q).f64s(&qd).f64s(&qdd).f64s(&[0.0; 12]);
    out.f64s(&q).f64s(&qd).f64s(&[0.0; 12]);
    // Actual TCP pose, speed and force; target TCP pose and speed.
    out.f64s(&core.tcp_pose()).f64s(&tcp_speed).f64s(&core.registers.external_force);
    out.f64s(&core.tcp_pose()).f64s(&tcp_speed);
    out.f64(core.registers.digital_inputs as f64).f64s(&[35.0; 6]);
    // Controller timer, test value, modes.
    out.f64s(&[0.0, 0.0])
        .f64(f64::from(core.modes.robot_mode().code()))
        .f64s(&[f64::from(joint_mode(controller)); 6]);
    // Safety mode, unused, tool accelerometer, unused.
    out.f64(safety).f64s(&[0.0; 6]).f64s(&[0.0, 0.0, 9.8]).f64s(&[0.0; 6]);
    // Speed scaling, momentum, unused, voltages and currents.
    out.f64(speed_scaling(controller)).f64s(&[0.0; 3]).f64s(&[48.0, 48.0, 0.6]).f64s(&[48.0; 6]);
    out.f64(core.registers.digital_outputs as f64).f64(program_state);
    // Elbow position and speed, safety status, unused.
    out.f64s(&[0.0; 6]).f64(safety).f64s(&[0.0; 3]);
    out.f64(core.payload.mass).f64s(&core.payload.centre).f64s(&core.payload.inertia);
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::controller::ControllerConfig;

    #[test]
    fn the_block_has_the_length_it_names() {
        let bytes = block(&Controller::new(ControllerConfig::ur5e(1)));
        assert_eq!(bytes.len(), LENGTH);
        assert_eq!(bytes[..4], (LENGTH as i32).to_be_bytes());
    }
}
