//! Forces and masses of the arm: inverse dynamics by the recursive Newton-Euler equations.
//!
//! In: kinematics, link masses, the payload, joint positions, speeds and accelerations. Out: joint torques,
//! and from them the mass matrix and the torques of Coriolis and centrifugal forces. Pure. Everything is
//! computed in the base frame. Gears, motors and friction are left out: their figures are not published.
//! Source of the figures: the vendor's article on DH parameters (masses, centres) and the inertia tensors of
//! the vendor's public robot description, both in the frame at the end of the link (DH).

use cell_values::units::Joints;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use ur_arm::chain::Chain;
use ur_arm::kinematics::jacobian_at;

/// Mass properties of a link, in its DH frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// kg
    pub mass: f64,
    /// Centre of mass, m.
    pub centre: [f64; 3],
    /// About the centre of mass, kg m2: xx, yy, zz, xy, xz, yz.
    pub inertia: [f64; 6],
}

/// The six links of a UR5e.
pub const UR5E_LINKS: [Link; 6] = [
    Link {
        mass: 3.761,
        centre: [0.0, -0.02561, 0.00193],
        inertia: [0.00700210, 0.00648091, 0.00657286, 0.00000073, -0.00001053, 0.00049994],
    },
    Link {
        mass: 8.058,
        centre: [0.2125, 0.0, 0.11336],
        inertia: [0.01505885, 0.33388086, 0.33247207, -0.00005400, 0.00000563, -0.00000181],
    },
    Link {
        mass: 2.846,
        centre: [0.15, 0.0, 0.0265],
        inertia: [0.00399632, 0.07879254, 0.07848510, -0.00001365, 0.00137272, -0.00000660],
    },
    Link {
        mass: 1.37,
        centre: [0.0, -0.0018, 0.01634],
        inertia: [0.00165491, 0.00135962, 0.00126279, -0.00000282, -0.00000438, 0.00010157],
    },
    Link {
        mass: 1.3,
        centre: [0.0, 0.0018, 0.01634],
        inertia: [0.00135617, 0.00127827, 0.00096614, -0.00000274, 0.00000444, -0.00005048],
    },
    Link {
        mass: 0.365,
        centre: [0.0, 0.0, -0.001159],
        inertia: [0.00018694, 0.00018908, 0.00025756, 0.00000006, -0.00000017, -0.00000092],
    },
];

/// Everything that has mass.
#[derive(Clone, Copy, Debug)]
pub struct Masses<'a> {
    /// The arm's links.
    pub links: &'a [Link; 6],
    /// The payload, in the flange frame.
    pub payload: Link,
}

/// Torque of each joint (Nm) for the motion `q`, `qd` (rad/s), `qdd` (rad/s2). `gravity` (m/s2, base frame)
/// is the acceleration an arm at rest feels: upwards.
pub fn inverse_dynamics(
    chain: &Chain,
    masses: &Masses<'_>,
    q: &Joints,
    qd: &[f64; 6],
    qdd: &[f64; 6],
    gravity: &Vector3<f64>,
) -> [f64; 6] {
    let frames = chain.frames(q);
    let mut before = Isometry3::identity();
    let (mut spin, mut turn, mut acceleration) = (Vector3::zeros(), Vector3::zeros(), *gravity);
    let mut axes = [Vector3::zeros(); 6];
    let mut origins = [Vector3::zeros(); 7];
    let mut loads = [(Vector3::zeros(), Vector3::zeros()); 6];
    for i in 0..6 {
        let axis = before.rotation * Vector3::z();
        turn += axis * qdd[i] + spin.cross(&(axis * qd[i]));
        spin += axis * qd[i];
        (axes[i], origins[i]) = (axis, before.translation.vector);
        let at = |point: Vector3<f64>| acceleration + turn.cross(&point) + spin.cross(&spin.cross(&point));
        for (index, body) in [masses.links[i], masses.payload].iter().enumerate() {
            if index == 0 || i == 5 {
                let (force, moment) = body_load(body, &frames[i], &origins[i], &spin, &turn, &at);
                loads[i].0 += force;
                loads[i].1 += moment;
            }
        }
        let end = frames[i].translation.vector;
        acceleration = at(end - origins[i]);
        before = frames[i];
        origins[i + 1] = end;
    }
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    let mut torques = [0.0; 6];
    for i in (0..6).rev() {
        moment += loads[i].1 + (origins[i + 1] - origins[i]).cross(&force);
        force += loads[i].0;
        torques[i] = axes[i].dot(&moment);
    }
    torques
}

/// Force on a body, and its moment about the joint at `origin`.
fn body_load(
    body: &Link,
    frame: &Isometry3<f64>,
    origin: &Vector3<f64>,
    spin: &Vector3<f64>,
    turn: &Vector3<f64>,
    acceleration_at: &dyn Fn(Vector3<f64>) -> Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let lever = (frame * nalgebra::Point3::from(body.centre)).coords - origin;
    let force = acceleration_at(lever) * body.mass;
    let [xx, yy, zz, xy, xz, yz] = body.inertia;
    let rotation = frame.rotation.to_rotation_matrix();
    let inertia =
        rotation.matrix() * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * rotation.matrix().transpose();
    let moment = inertia * turn + spin.cross(&(inertia * spin)) + lever.cross(&force);
    (force, moment)
}

/// The mass matrix, kg m2.
pub fn mass_matrix(chain: &Chain, masses: &Masses<'_>, q: &Joints) -> Matrix6<f64> {
    let column = |i: usize| {
        let mut unit = [0.0; 6];
        unit[i] = 1.0;
        Vector6::from(inverse_dynamics(chain, masses, q, &[0.0; 6], &unit, &Vector3::zeros()))
    };
    Matrix6::from_columns(&[column(0), column(1), column(2), column(3), column(4), column(5)])
}

/// Torques that Coriolis and centrifugal forces take, Nm.
pub fn velocity_torques(chain: &Chain, masses: &Masses<'_>, q: &Joints, qd: &[f64; 6]) -> [f64; 6] {
    inverse_dynamics(chain, masses, q, qd, &[0.0; 6], &Vector3::zeros())
}

/// Jacobian of the TCP in the base frame: rows 0-2 linear (m), rows 3-5 angular.
pub fn tool_jacobian(chain: &Chain, flange_from_tcp: &Isometry3<f64>, q: &Joints) -> Matrix6<f64> {
    let frames = chain.frames(q);
    let flange = frames[5];
    let lever = flange.rotation * flange_from_tcp.translation.vector;
    let mut matrix = jacobian_at(&frames);
    for mut column in matrix.column_iter_mut() {
        let linear = Vector3::new(column[3], column[4], column[5]).cross(&lever);
        (0..3).for_each(|row| column[row] += linear[row]);
    }
    matrix
}

/// How that Jacobian changes while the joints move at `qd` (rad/s), per second.
pub fn tool_jacobian_derivative(
    chain: &Chain,
    flange_from_tcp: &Isometry3<f64>,
    q: &Joints,
    qd: &[f64; 6],
) -> Matrix6<f64> {
    // Central difference: its error is below 1e-8 of the entries at this step.
    let step = 1e-5;
    let moved = |sign: f64| Joints(std::array::from_fn(|i| q.0[i] + sign * step * qd[i]));
    (tool_jacobian(chain, flange_from_tcp, &moved(1.0)) - tool_jacobian(chain, flange_from_tcp, &moved(-1.0)))
        / (2.0 * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use ur_arm::kinematics::DhParameters;

    const NO_PAYLOAD: Masses<'_> =
        Masses { links: &UR5E_LINKS, payload: Link { mass: 0.0, centre: [0.0; 3], inertia: [0.0; 6] } };
    const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, 9.82);

    fn ur5e() -> Chain {
        Chain::of(&DhParameters::UR5E)
    }

    /// Height of all centres of mass, times mass and gravity, J.
    fn potential(masses: &Masses<'_>, q: &Joints) -> f64 {
        let frames = ur5e().frames(q);
        let of = |link: &Link, frame: &Isometry3<f64>| {
            link.mass * GRAVITY.dot(&(frame * nalgebra::Point3::from(link.centre)).coords)
        };
        masses.links.iter().zip(&frames).map(|(link, frame)| of(link, frame)).sum::<f64>()
            + of(&masses.payload, &frames[5])
    }

    #[test]
    fn the_arm_weighs_what_the_vendor_says_and_hangs_without_torque() {
        let mass: f64 = UR5E_LINKS.iter().map(|link| link.mass).sum();
        assert!((mass - 17.7).abs() < 1e-9, "{mass} kg without the base");
        let upright =
            Joints([0.0, -std::f64::consts::FRAC_PI_2, 0.0, -std::f64::consts::FRAC_PI_2, 0.0, 0.0]);
        let torques = inverse_dynamics(&ur5e(), &NO_PAYLOAD, &upright, &[0.0; 6], &[0.0; 6], &GRAVITY);
        assert!(torques[0].abs() < 1e-9 && torques[1].abs() < 2.0, "{torques:?}");
    }

    proptest! {
        #[test]
        fn gravity_torques_are_the_slope_of_the_potential_energy(
            q in proptest::array::uniform6(-3.0..3.0), mass in 0.0..5.0
        ) {
            let payload = Link { mass, centre: [0.02, -0.01, 0.1], inertia: [0.0; 6] };
            let masses = Masses { payload, ..NO_PAYLOAD };
            let torques = inverse_dynamics(&ur5e(), &masses, &Joints(q), &[0.0; 6], &[0.0; 6], &GRAVITY);
            for i in 0..6 {
                let moved = |step: f64| {
                    let mut q = q;
                    q[i] += step;
                    potential(&masses, &Joints(q))
                };
                let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                prop_assert!((torques[i] - slope).abs() < 1e-6, "joint {i}: {} against {slope}", torques[i]);
            }
        }

        #[test]
        fn the_mass_matrix_is_symmetric_positive_and_gives_the_kinetic_energys_rate(
            q in proptest::array::uniform6(-3.0..3.0), qd in proptest::array::uniform6(-2.0..2.0)
        ) {
            let matrix = mass_matrix(&ur5e(), &NO_PAYLOAD, &Joints(q));
            prop_assert!((matrix - matrix.transpose()).norm() < 1e-12);
            prop_assert!(matrix.cholesky().is_some());
            // Power of the velocity torques is half of qd' dM/dt qd: no energy appears from nowhere.
            let speed = Vector6::from(qd);
            let at = |t: f64| {
                let q = Joints(std::array::from_fn(|i| q[i] + qd[i] * t));
                speed.dot(&(mass_matrix(&ur5e(), &NO_PAYLOAD, &q) * speed))
            };
            let rate = (at(1e-5) - at(-1e-5)) / 2e-5 / 2.0;
            let power = Vector6::from(velocity_torques(&ur5e(), &NO_PAYLOAD, &Joints(q), &qd)).dot(&speed);
            prop_assert!((rate - power).abs() < 1e-6 * (1.0 + rate.abs()), "{rate} against {power}");
        }

        #[test]
        fn the_tool_jacobian_is_the_derivative_of_the_tcp(
            q in proptest::array::uniform6(-3.0..3.0), qd in proptest::array::uniform6(-1.0..1.0)
        ) {
            let tcp = Isometry3::new(Vector3::new(0.03, -0.02, 0.2), Vector3::new(0.1, 0.2, -0.3));
            let at = |t: f64| {
                let q = Joints(std::array::from_fn(|i| q[i] + qd[i] * t));
                (ur5e().forward(&q) * tcp).translation.vector
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            let speed = tool_jacobian(&ur5e(), &tcp, &Joints(q)) * Vector6::from(qd);
            prop_assert!((slope - speed.fixed_rows::<3>(0)).norm() < 1e-7);
            let rate = tool_jacobian_derivative(&ur5e(), &tcp, &Joints(q), &qd) * Vector6::from(qd);
            let bend = (at(1e-3) - 2.0 * at(0.0) + at(-1e-3)) / 1e-6;
            prop_assert!((bend - rate.fixed_rows::<3>(0)).norm() < 1e-4);
        }
    }
}
