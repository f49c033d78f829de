//! Built-ins of force: force mode, freedrive, force sensor, contact, masses and Jacobians.
//!
//! In: calls from running programs. Out: values, or the message of a runtime exception; and for force mode
//! and freedrive a [`Compliance`] that `Core::yield_to_forces` turns into tool speed each frame, taken up
//! with a time constant of 50 ms.

use crate::controller::compliance::{Compliance, TaskFrame};
use crate::controller::core::Core;
use crate::controller::sensing::ExternalSensor;
use crate::motion::FRAME_SECONDS;
use crate::motion::dynamics;
use cell_values::units::Joints;
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
use ur_arm::pose::isometry_from_ur_pose;
use urscript::host::Call;
use urscript::value::Value;

/// Time in which a compliant axis takes up its speed, s.
const RISE_SECONDS: f64 = 0.05;

/// Smallest singular value of the Jacobian at which freedrive is called near, and too near, to a
/// singularity.
const NEAR_SINGULAR: f64 = 0.06;
const TOO_NEAR_SINGULAR: f64 = 0.03;

/// Most iterations for the singular values: some 10 will do, and numbers that are none never come to an end.
const MAX_ITERATIONS: usize = 1000;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let done = match call.name {
        "force_mode" => force_mode(core, call),
        "freedrive_mode" => freedrive(core, call),
        "teach_mode" | "freedrive_mode_no_incorrect_payload_check" => {
            core.compliance =
                Some(Compliance::hand_guided([true; 6], TaskFrame::Fixed(Isometry3::identity())));
            Ok(())
        }
        "end_force_mode" | "end_freedrive_mode" | "end_teach_mode" | "end_screw_driving" => {
            core.compliance = None;
            Ok(())
        }
        "screw_driving" => screw_driving(core, call),
        "force_mode_set_damping" => setting(call, 1.0).map(|damping| core.force_settings.damping = damping),
        "force_mode_set_gain_scaling" => setting(call, 2.0).map(|gain| core.force_settings.gain = gain),
        "zero_ftsensor" => {
            let raw = core.raw_wrench();
            core.sensing.zero(raw);
            Ok(())
        }
        "ft_rtde_input_enable" | "enable_external_ft_sensor" => external_sensor(core, call),
        _ => return readings(core, call).or_else(|| matrices(core, call)),
    };
    Some(done.map(|()| Value::Nothing))
}

/// A setting between 0 and `most`.
fn setting(call: &Call<'_>, most: f64) -> Result<f64, String> {
    let value = call.required(0)?.number()?;
    match (0.0..=most).contains(&value) {
        true => Ok(value),
        false => Err(format!("{}: {value} is not between 0 and {most}", call.name)),
    }
}

fn numbers<const N: usize>(call: &Call<'_>, index: usize) -> Result<[f64; N], String> {
    let numbers = call.required(index)?.array::<N>()?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(format!("{}: argument {} has numbers that are not finite", call.name, index + 1)),
    }
}

fn force_mode(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let frame = isometry_from_ur_pose(numbers(call, 0)?);
    let free = numbers::<6>(call, 1)?.map(|axis| axis != 0.0);
    let (wrench, limits) = (numbers(call, 2)?, numbers::<6>(call, 4)?.map(f64::abs));
    let frame = match call.required(3)?.integer()? {
        1 => TaskFrame::Point(frame),
        2 => TaskFrame::Fixed(frame),
        3 => TaskFrame::Motion(frame),
        other => return Err(format!("force_mode: there is no type {other}")),
    };
    core.compliance = Some(Compliance { frame, free, wrench, limits, freedrive: false });
    Ok(())
}

fn freedrive(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let free = match call.argument(0) {
        Some(_) => numbers::<6>(call, 0)?.map(|axis| axis != 0.0),
        None => [true; 6],
    };
    let frame = match call.argument(1) {
        None => TaskFrame::Fixed(Isometry3::identity()),
        Some(Value::Text(name)) if &**name == "tool" => TaskFrame::Tool,
        Some(Value::Text(name)) if &**name == "base" => TaskFrame::Fixed(Isometry3::identity()),
        Some(_) => TaskFrame::Fixed(isometry_from_ur_pose(numbers(call, 1)?)),
    };
    core.compliance = Some(Compliance::hand_guided(free, frame));
    Ok(())
}

/// Presses along the tool's axis, at most at the given speed.
fn screw_driving(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let (force, limit) = (call.required(0)?.number()?, call.required(1)?.number()?);
    if !force.is_finite() || !limit.is_finite() {
        return Err("screw_driving: force and speed must be finite".to_owned());
    }
    let mut compliance = Compliance::hand_guided([false, false, true, false, false, false], TaskFrame::Tool);
    (compliance.wrench[2], compliance.limits[2], compliance.freedrive) = (force, limit.abs(), false);
    core.compliance = Some(compliance);
    Ok(())
}

fn external_sensor(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let enabled = call.required(0)?.truth()?;
    let offset = call.argument(2).map_or(Ok([0.0; 3]), |offset| offset.array::<3>())?;
    core.sensing.external = enabled.then_some(ExternalSensor { offset });
    Ok(())
}

fn readings(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    Some(match call.name {
        "get_tcp_force" => Ok(Value::numbers(core.tcp_force())),
        "force" => {
            let [x, y, z, ..] = core.tcp_force();
            Ok(Value::Float(Vector3::new(x, y, z).norm()))
        }
        "tool_contact" => tool_contact(core, call),
        "get_actual_joint_positions_history" => history(core, call),
        "get_freedrive_status" => Ok(Value::Int(freedrive_status(core))),
        // What the world adds to the torques that move the arm itself.
        "get_joint_torques" => Ok(Value::numbers(core.contact_torques())),
        _ => return None,
    })
}

fn tool_contact(core: &Core, call: &Call<'_>) -> Result<Value, String> {
    let direction = match call.argument(0) {
        Some(_) => numbers::<6>(call, 0)?,
        None => [0.0; 6],
    };
    let frames = core.sensing.contact_frames(&Vector3::new(direction[0], direction[1], direction[2]));
    Ok(Value::Int(i32::try_from(frames).unwrap_or(i32::MAX)))
}

fn history(core: &Core, call: &Call<'_>) -> Result<Value, String> {
    let steps = call.argument(0).map_or(Ok(0), Value::integer)?;
    let positions = match usize::try_from(steps) {
        Ok(0) => Some(core.mover.q()),
        Ok(steps) => core.sensing.positions(steps),
        Err(_) => None,
    };
    let missing = || format!("get_actual_joint_positions_history: {steps} steps ago is not remembered");
    positions.map(|q| Value::numbers(q.0)).ok_or_else(missing)
}

fn freedrive_status(core: &Core) -> i32 {
    let arm = &core.mover.arm;
    nearness(dynamics::tool_jacobian(arm.kinematics.chain(), &arm.flange_from_tcp, &core.mover.q()))
}

/// 0 free to move, 1 near a singularity, 2 too near, or a Jacobian that has no singular values.
fn nearness(jacobian: Matrix6<f64>) -> i32 {
    let values = jacobian.try_svd(false, false, 5.0 * f64::EPSILON, MAX_ITERATIONS);
    let smallest = values.map(|values| values.singular_values.min());
    let smallest = smallest.filter(|smallest| smallest.is_finite()).unwrap_or_default();
    i32::from(smallest < NEAR_SINGULAR) + i32::from(smallest < TOO_NEAR_SINGULAR)
}

fn matrices(core: &Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let joints = |index: usize, otherwise: [f64; 6]| match call.argument(index) {
        Some(_) => numbers::<6>(call, index),
        None => Ok(otherwise),
    };
    let arm = &core.mover.arm;
    let q = || joints(0, core.mover.q().0).map(Joints);
    let tcp = |index: usize| match call.argument(index) {
        Some(pose) => pose.array::<6>().map(isometry_from_ur_pose),
        None => Ok(arm.flange_from_tcp),
    };
    let qd = || joints(1, core.mover.qd());
    Some(match call.name {
        "get_jacobian" => {
            q().and_then(|q| Ok(matrix(&dynamics::tool_jacobian(arm.kinematics.chain(), &tcp(1)?, &q))))
        }
        "get_jacobian_time_derivative" => q().and_then(|q| {
            Ok(matrix(&dynamics::tool_jacobian_derivative(arm.kinematics.chain(), &tcp(2)?, &q, &qd()?)))
        }),
        "get_mass_matrix" => {
            q().map(|q| matrix(&dynamics::mass_matrix(arm.kinematics.chain(), &core.masses(), &q)))
        }
        "get_coriolis_and_centrifugal_torques" => q().and_then(|q| {
            Ok(Value::numbers(dynamics::velocity_torques(arm.kinematics.chain(), &core.masses(), &q, &qd()?)))
        }),
        _ => return None,
    })
}

fn matrix(matrix: &Matrix6<f64>) -> Value {
    Value::list(matrix.row_iter().map(|row| Value::numbers(row.iter().copied())).collect())
}

impl Core {
    /// Force and torque at the TCP in the base frame as the sensor sees them: N, Nm.
    pub fn raw_wrench(&self) -> [f64; 6] {
        let tcp = self.mover.arm.flange_from_tcp.translation.vector;
        self.sensing.raw(&self.registers.external_force, &self.base_from_flange(), &tcp)
    }

    /// The same after zeroing.
    pub fn tcp_force(&self) -> [f64; 6] {
        self.sensing.measured(&self.raw_wrench())
    }

    /// Force mode and freedrive: how fast the tool gives way in this frame; `drawn`: how fast a person draws
    /// it who holds the freedrive button, m/s and rad/s in the base frame.
    pub(crate) fn yield_to_forces(&mut self, drawn: [f64; 6]) {
        let wanted = Vector6::from(drawn);
        let wanted = wanted
            + self.compliance.as_ref().map_or(Vector6::zeros(), |compliance| {
                let (tcp, speed) = (self.mover.tcp(), self.mover.tcp_speed());
                compliance.giving(&self.force_settings, &Vector6::from(self.tcp_force()), &tcp, &speed)
            });
        let now = self.mover.drift();
        let part = (FRAME_SECONDS / RISE_SECONDS).min(1.0);
        let next = now + (wanted - now) * part;
        let rests = self.compliance.is_none() && next.norm() < 1e-6;
        self.mover.set_drift(if rests { Vector6::zeros() } else { next });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jacobian_that_is_none_is_too_near_a_singularity() {
        let mut jacobian = Matrix6::identity();
        assert_eq!(nearness(jacobian), 0);
        jacobian[(0, 0)] = 0.05;
        assert_eq!(nearness(jacobian), 1);
        jacobian[(2, 3)] = f64::NAN;
        assert_eq!(nearness(jacobian), 2);
    }
}
