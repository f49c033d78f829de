//! The state block of the real-time interface (port 30003).
//!
//! In: the controller's state. Out: 1220 bytes, the layout of software 5.10 and later: a length and 152
//! doubles. Source: the vendor's table of the real-time interface (5.9) and the length that later versions
//! send; nothing of celld reads this block. What is not simulated is zero, as in RTDE.

use crate::controller::Controller;
use crate::controller::drives::{actual_currents, target_currents};
use crate::controller::outputs::{elbow, elbow_velocity, joint_mode, speed_scaling};
use ur_arm::pose::ur_pose_from_isometry;
use ur_wire::bytes::Writer;

/// Bytes of the block, the length field included.
pub const LENGTH: usize = 1220;

/// The block of this frame.
pub fn block(controller: &Controller) -> Vec<u8> {
    let core = &controller.core;
    let (q, qd, qdd) = (core.mover.q().0, core.mover.qd(), core.mover.qdd());
    let currents = actual_currents(controller);
    let tcp_speed: [f64; 6] = core.mover.tcp_speed().into();
    let program_state = f64::from(controller.programs.runtime_state().code());
    let safety = f64::from(core.modes.safety_mode().code());
    let mut out = Writer::new();
    out.i32(LENGTH as i32).f64(core.timestamp());
    // Targets: q, qd, qdd, current, moment. Actuals: q, qd, current; control current.
    out.f64s(&q).f64s(&qd).f64s(&qdd).f64s(&target_currents(controller)).f64s(&core.target_moments());
    out.f64s(&core.actual_q().0).f64s(&core.actual_qd()).f64s(&currents).f64s(&currents);
    // Actual TCP pose, speed and force; target TCP pose and speed.
    out.f64s(&core.tcp_pose()).f64s(&tcp_speed).f64s(&core.tcp_force());
    out.f64s(&ur_pose_from_isometry(&core.mover.tcp())).f64s(&tcp_speed);
    out.f64(core.registers.digital_inputs as f64).f64s(&[35.0; 6]);
    // Controller timer, test value, modes.
    out.f64s(&[0.0, 0.0])
        .f64(f64::from(core.modes.robot_mode().code()))
        .f64s(&[f64::from(joint_mode(controller)); 6]);
    // Safety mode, unused, tool accelerometer, unused.
    out.f64(safety).f64s(&[0.0; 6]).f64s(&core.tool_accelerometer()).f64s(&[0.0; 6]);
    // Speed scaling, momentum, unused, voltages and currents.
    out.f64(speed_scaling(controller))
        .f64(core.momentum())
        .f64s(&[0.0; 2])
        .f64s(&[48.0, 48.0, 0.6])
        .f64s(&[48.0; 6]);
    out.f64(core.registers.digital_outputs as f64).f64(program_state);
    // Elbow position and speed, safety status, unused.
    out.f64s(&elbow(controller)).f64s(&elbow_velocity(controller)).f64(safety).f64s(&[0.0; 3]);
    out.f64(core.payload.mass).f64s(&core.payload.centre).f64s(&core.payload.inertia);
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::ControllerConfig;

    /// The double in a column of the vendor's table, which counts from 1 behind the length.
    fn column(bytes: &[u8], number: usize) -> f64 {
        let at = 4 + (number - 1) * 8;
        f64::from_be_bytes(bytes[at..at + 8].try_into().unwrap())
    }

    #[test]
    fn fields_stand_in_the_columns_of_the_table() {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        controller.core.payload.mass = 1.5;
        controller.core.registers.digital_outputs = 5;
        controller.frame();
        let bytes = block(&controller);
        let q = controller.core.mover.q().0;
        assert_eq!(column(&bytes, 1), controller.core.timestamp());
        assert_eq!([column(&bytes, 2), column(&bytes, 32)], [q[0], q[0]]);
        assert_eq!(column(&bytes, 56), controller.core.tcp_pose()[0]);
        assert_eq!([column(&bytes, 95), column(&bytes, 96), column(&bytes, 102)], [7.0, 253.0, 1.0]);
        let (moments, currents) = (controller.core.target_moments(), actual_currents(&controller));
        assert!(moments[1].abs() > 1.0, "{moments:?}");
        assert_eq!([column(&bytes, 27), column(&bytes, 45)], [moments[1], currents[1]]);
        assert_eq!(column(&bytes, 109), controller.core.tool_accelerometer()[0]);
        assert_eq!([column(&bytes, 118), column(&bytes, 131), column(&bytes, 132)], [1.0, 5.0, 1.0]);
        assert_eq!([column(&bytes, 133), column(&bytes, 139)], [elbow(&controller)[0], 1.0]);
        assert_eq!(column(&bytes, 143), 1.5);
    }

    #[test]
    fn the_block_has_the_length_it_names() {
        let bytes = block(&Controller::new(ControllerConfig::ur5e(1)));
        assert_eq!(bytes.len(), LENGTH);
        assert_eq!(bytes[..4], (LENGTH as i32).to_be_bytes());
    }
}
