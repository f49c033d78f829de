//! Built-ins on poses: composition, inversion, interpolation, distances and notations of rotation.
//!
//! In: arguments bound to parameters; a pose is x, y, z in m and a rotation vector in rad. Out: a value or
//! the message of a runtime exception. `pose_add` adds positions and multiplies rotations (`p_2` first), as
//! the manual defines it; `pose_sub` is its opposite.

use crate::host::Call;
use crate::value::Value;
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(call: &Call<'_>) -> Option<Result<Value, String>> {
    Some(match call.name {
        "pose_trans" => two(call).map(|(from, to)| value(from * to)),
        "pose_inv" => call.required(0).and_then(inverse),
        "pose_add" => two(call).map(|(a, b)| {
            value(Isometry3::from_parts(
                Translation3::from(a.translation.vector + b.translation.vector),
                a.rotation * b.rotation,
            ))
        }),
        "pose_sub" => two(call).map(|(to, from)| {
            value(Isometry3::from_parts(
                Translation3::from(to.translation.vector - from.translation.vector),
                to.rotation * from.rotation.inverse(),
            ))
        }),
        "pose_dist" => two(call).map(|(a, b)| {
            let turn = a.rotation.angle_to(&b.rotation);
            Value::Float(point_distance(&a, &b).hypot(turn))
        }),
        "point_dist" => two(call).map(|(a, b)| Value::Float(point_distance(&a, &b))),
        "interpolate_pose" => interpolate(call),
        "rotvec2rpy" => vector(call).map(|v| {
            let (roll, pitch, yaw) = UnitQuaternion::from_scaled_axis(v).euler_angles();
            Value::numbers([roll, pitch, yaw])
        }),
        "rpy2rotvec" => vector(call).map(|rpy| {
            Value::numbers(Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z).scaled_axis().iter().copied())
        }),
        "wrench_trans" => wrench(call),
        _ => return None,
    })
}

/// The inverse of a pose.
///
/// # Errors
/// The value is no pose.
pub fn inverse(pose: &Value) -> Result<Value, String> {
    Ok(value(isometry(pose)?.inverse()))
}

fn isometry(pose: &Value) -> Result<Isometry3<f64>, String> {
    let p = pose.pose()?;
    Ok(Isometry3::new(Vector3::new(p[0], p[1], p[2]), Vector3::new(p[3], p[4], p[5])))
}

fn value(transform: Isometry3<f64>) -> Value {
    let (t, r) = (transform.translation.vector, transform.rotation.scaled_axis());
    Value::Pose([t.x, t.y, t.z, r.x, r.y, r.z])
}

fn two(call: &Call<'_>) -> Result<(Isometry3<f64>, Isometry3<f64>), String> {
    Ok((isometry(call.required(0)?)?, isometry(call.required(1)?)?))
}

fn vector(call: &Call<'_>) -> Result<Vector3<f64>, String> {
    call.required(0)?.array::<3>().map(Vector3::from)
}

fn point_distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

/// Straight position, shortest rotation; `alpha` outside [0, 1] extrapolates.
fn interpolate(call: &Call<'_>) -> Result<Value, String> {
    let (from, to) = two(call)?;
    let alpha = call.required(2)?.number()?;
    let turn = (from.rotation.inverse() * to.rotation).scaled_axis() * alpha;
    Ok(value(Isometry3::from_parts(
        Translation3::from(from.translation.vector.lerp(&to.translation.vector, alpha)),
        from.rotation * UnitQuaternion::from_scaled_axis(turn),
    )))
}

/// A force and torque seen from another frame.
fn wrench(call: &Call<'_>) -> Result<Value, String> {
    let transform = isometry(call.required(0)?)?;
    let w = call.required(1)?.array::<6>()?;
    let force = transform.rotation.inverse() * Vector3::new(w[0], w[1], w[2]);
    let moved =
        Vector3::new(w[3], w[4], w[5]) - transform.translation.vector.cross(&Vector3::new(w[0], w[1], w[2]));
    let torque = transform.rotation.inverse() * moved;
    Ok(Value::numbers(force.iter().chain(torque.iter()).copied()))
}
