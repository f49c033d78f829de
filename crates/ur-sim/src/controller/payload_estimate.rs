//! `estimate_payload`: mass and centre of what hangs on the flange, from the forces in several postures.
//!
//! In: at least four postures (poses of the tool, or joint positions) and what `get_tcp_force` gave in each.
//! Out: `struct(mass, cog)`, the centre in the flange frame. Pure. The sensor may have been zeroed anywhere:
//! a force and a torque that are fixed to the flange are solved for as well, by least squares. Assumed: that
//! the active payload is not added to the result, and the bounds of a result that is none.

use crate::controller::core::Core;
use cell_values::units::Joints;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Vector3};
use std::f64::consts::PI;
use ur_arm::pose::isometry_from_ur_pose;
use urscript::host::Call;
use urscript::value::Value;

/// Fewest postures.
const FEWEST: usize = 4;

/// Most postures; a script that gives more has made a mistake.
const MOST: usize = 1000;

/// Most iterations for the singular values: numbers that overflow never come to an end.
const MAX_ITERATIONS: usize = 10_000;

/// Unknowns: mass, mass times centre, force and torque of the sensor's zero.
const UNKNOWNS: usize = 10;

/// Carries out the built-in.
///
/// # Errors
/// Too few postures, too much alike, or forces that no payload has.
pub fn estimate(core: &Core, call: &Call<'_>) -> Result<Value, String> {
    let wrong = |what: &str| format!("{}: {what}", call.name);
    let (poses, wrenches) = (call.required(0)?.elements()?, call.required(1)?.elements()?);
    if poses.len() != wrenches.len() {
        return Err(wrong("there must be as many wrenches as poses"));
    }
    if !(FEWEST..=MOST).contains(&poses.len()) {
        return Err(wrong("at least four poses are needed, and a thousand will do"));
    }
    let flanges = poses.iter().map(|pose| flange(core, pose)).collect::<Result<Vec<_>, _>>()?;
    let wrenches = wrenches.iter().map(Value::array::<6>).collect::<Result<Vec<_>, _>>()?;
    if wrenches.iter().flatten().any(|number| !number.is_finite()) {
        return Err(wrong("the wrenches have numbers that are not finite"));
    }
    let least = PI / (2.0 * flanges.len() as f64);
    let alike = (0..flanges.len())
        .any(|a| (0..a).any(|b| flanges[a].rotation.angle_to(&flanges[b].rotation) < least));
    if alike {
        return Err(wrong("two of the poses are turned too little against each other"));
    }
    let tcp = core.mover.arm.flange_from_tcp.translation.vector;
    // Weight pulls against the acceleration that an arm at rest feels.
    let pull = -Vector3::from(core.payload.gravity);
    let (mass, centre) = solve(&flanges, &wrenches, &tcp, &pull)
        .ok_or_else(|| wrong("the forces are not those of a payload in these poses"))?;
    let member = |name: &str, value: Value| (name.into(), value);
    Ok(Value::Struct(std::sync::Arc::new(vec![
        member("mass", Value::Float(mass)),
        member("cog", Value::numbers([centre.x, centre.y, centre.z])),
    ])))
}

/// `base_from_flange` of a posture.
fn flange(core: &Core, pose: &Value) -> Result<Isometry3<f64>, String> {
    let numbers = pose.array::<6>()?;
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err("estimate_payload: the poses have numbers that are not finite".to_owned());
    }
    let arm = &core.mover.arm;
    Ok(match pose {
        Value::Pose(_) => isometry_from_ur_pose(numbers) * arm.flange_from_tcp.inverse(),
        _ => arm.kinematics.forward(&Joints(numbers)),
    })
}

/// Mass, and centre in the flange frame: the force `f` is `m p + R f0` and the torque about the TCP
/// `R (c - t) x m p + R t0`, with `p` what pulls.
fn solve(
    flanges: &[Isometry3<f64>],
    wrenches: &[[f64; 6]],
    tcp: &Vector3<f64>,
    pull: &Vector3<f64>,
) -> Option<(f64, Vector3<f64>)> {
    let mut rows = DMatrix::<f64>::zeros(6 * flanges.len(), UNKNOWNS);
    let mut known = DVector::<f64>::zeros(6 * flanges.len());
    for (index, (flange, wrench)) in flanges.iter().zip(wrenches).enumerate() {
        // In the flange frame the two constants are constants.
        let back = flange.rotation.inverse();
        let pull = back * pull;
        let (force, torque) = (row(wrench, 0), row(wrench, 3));
        let at = 6 * index;
        known.fixed_rows_mut::<3>(at).copy_from(&(back * force));
        known.fixed_rows_mut::<3>(at + 3).copy_from(&(back * torque));
        rows.fixed_view_mut::<3, 1>(at, 0).copy_from(&pull);
        rows.fixed_view_mut::<3, 3>(at, 4).copy_from(&Matrix3::identity());
        rows.fixed_view_mut::<3, 1>(at + 3, 0).copy_from(&-tcp.cross(&pull));
        rows.fixed_view_mut::<3, 3>(at + 3, 1).copy_from(&-pull.cross_matrix());
        rows.fixed_view_mut::<3, 3>(at + 3, 7).copy_from(&Matrix3::identity());
    }
    let solved = rows.try_svd(true, true, 5.0 * f64::EPSILON, MAX_ITERATIONS)?.solve(&known, 1e-9).ok()?;
    let mass = solved[0];
    let first = Vector3::new(solved[1], solved[2], solved[3]);
    if mass.abs() < 1e-3 && first.norm() < 1e-3 {
        return Some((0.0, Vector3::zeros()));
    }
    let centre = first / mass;
    let plausible = (1e-3..1000.0).contains(&mass) && centre.iter().all(|axis| axis.abs() < 10.0);
    plausible.then_some((mass, centre))
}

fn row(wrench: &[f64; 6], first: usize) -> Vector3<f64> {
    Vector3::new(wrench[first], wrench[first + 1], wrench[first + 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::builtins::compile_program;
    use crate::controller::{Controller, ControllerConfig};
    use ur_wire::primary_message::MessageBody;

    const POSTURES: [[f64; 6]; 4] = [
        [0.0, -1.5, 1.5, -1.5, -1.5, 0.0],
        [0.0, -1.5, 1.5, -0.7, -1.5, 0.0],
        [0.0, -1.5, 1.5, -1.5, -0.7, 0.5],
        [0.0, -1.5, 1.5, -2.4, -1.0, -0.9],
    ];

    /// What a sensor in the flange that was zeroed somewhere reads with 2.5 kg on it.
    fn readings(core: &Core) -> Vec<[f64; 6]> {
        let (mass, centre) = (2.5, Vector3::new(0.01, -0.02, 0.08));
        let (force0, torque0) = (Vector3::new(3.0, -1.0, 2.0), Vector3::new(0.1, 0.2, -0.3));
        let of = |q: &[f64; 6]| {
            let flange = core.mover.arm.kinematics.forward(&Joints(*q));
            let weight = Vector3::new(0.0, 0.0, -mass * core.payload.gravity[2]);
            let lever = flange.rotation * (centre - core.mover.arm.flange_from_tcp.translation.vector);
            let force = weight + flange.rotation * force0;
            let torque = lever.cross(&weight) + flange.rotation * torque0;
            [force.x, force.y, force.z, torque.x, torque.y, torque.z]
        };
        POSTURES.iter().map(of).collect()
    }

    fn said(script: &str) -> Vec<MessageBody> {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        controller.programs.upload(compile_program(script));
        (0..10).for_each(|_| controller.frame());
        controller.core.take_messages()
    }

    fn literal(numbers: &[[f64; 6]], kind: &str) -> String {
        let each = numbers.iter().map(|numbers| {
            let numbers: Vec<String> = numbers.iter().map(|number| format!("{number:.12}")).collect();
            format!("{kind}[{}]", numbers.join(","))
        });
        format!("[{}]", each.collect::<Vec<_>>().join(","))
    }

    #[test]
    fn mass_and_centre_are_found_from_forces_in_four_postures_by_joints_and_by_poses() {
        let controller = Controller::new(ControllerConfig::ur5e(1));
        let mut core = controller.core;
        core.set_tcp([0.0, 0.05, 0.1, 0.0, 0.3, 0.0]);
        let wrenches = literal(&readings(&core), "p");
        let poses: Vec<[f64; 6]> = POSTURES
            .iter()
            .map(|q| ur_arm::pose::ur_pose_from_isometry(&core.mover.arm.tcp(&Joints(*q))))
            .collect();
        for postures in [literal(&POSTURES, ""), literal(&poses, "p")] {
            let said = said(&format!(
                "def e():\n set_tcp(p[0,0.05,0.1,0,0.3,0])\n e = estimate_payload({postures}, {wrenches})\n \
                 textmsg(abs(e.mass - 2.5) < 0.00001)\n textmsg(norm(e.cog - [0.01, -0.02, 0.08]) < \
                 0.00001)\nend\n"
            ));
            let right = said.iter().filter(|message| **message == MessageBody::Text("True".to_owned()));
            assert_eq!(right.count(), 2, "{said:?}");
        }
    }

    #[test]
    fn postures_that_say_too_little_are_refused() {
        let alike = literal(&[POSTURES[0], POSTURES[1], POSTURES[2], POSTURES[0]], "");
        let (three, four) = (literal(&POSTURES[..3], ""), literal(&POSTURES, ""));
        let none = literal(&[[0.0; 6]; 4], "p");
        let heavy = literal(&[[0.0, 0.0, 1e6, 0.0, 0.0, 0.0]; 4], "p");
        for (poses, wrenches, complaint) in [
            (&alike, &none, "turned too little"),
            (&three, &none, "as many wrenches"),
            (&three, &literal(&[[0.0; 6]; 3], "p"), "at least four"),
            (&four, &heavy, "not those of a payload"),
        ] {
            let said = said(&format!("def e():\n estimate_payload({poses}, {wrenches})\nend\n"));
            let refused = |message: &MessageBody| matches!(message, MessageBody::RuntimeException { text, .. } if text.contains(complaint));
            assert!(said.iter().any(refused), "{complaint}: {said:?}");
        }
        let controller = Controller::new(ControllerConfig::ur5e(1));
        let flanges: Vec<Isometry3<f64>> =
            POSTURES.iter().map(|q| controller.core.mover.arm.kinematics.forward(&Joints(*q))).collect();
        let endless = Vector3::new(f64::NAN, 0.0, 0.0);
        assert!(solve(&flanges, &[[0.0; 6]; 4], &Vector3::zeros(), &endless).is_none());
        let said = said(&format!("def e():\n textmsg(estimate_payload({four}, {none}))\nend\n"));
        assert!(said.iter().any(|message| matches!(message, MessageBody::Text(_))), "{said:?}");
    }
}
