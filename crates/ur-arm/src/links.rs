//! Where the links of one arm are: how far from those of a nominal arm, which arm it is, and its DH table.
//!
//! In: calibrated DH parameters, or links by their poses. Out: the nearest of [`ARM_MODELS`], the deviation
//! of each link, DH parameters. Pure. m and rad.
//!
//! A DH table describes joint axes only. Two tables of one arm can differ by hundreds of metres in d2 and d3
//! and by radians in theta, so the settled frames of [`Chain`] are compared instead.

use crate::chain::{Chain, PARALLEL_JOINTS, TWISTS, untilted};
use crate::models::{ARM_MODELS, ArmModel, DhParameters};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// No part of a link near its next joint is farther from the origin of its frame, m (UR30: 0.363).
const BEARING_M: f64 = 0.4;

/// Positions of the arm that are compared.
const POSITIONS: usize = 500;

/// Axes at an angle with a smaller sine have no common normal of their own.
const MIN_AXIS_SINE: f64 = 1e-9;

/// Axes nearer to each other coincide, m.
const MIN_OFFSET_M: f64 = 1e-9;

/// A flange farther from where four DH parameters can put it is refused, m and rad.
const FLANGE_TOLERANCE: f64 = 1e-6;

/// The arm that calibrated parameters belong to.
pub fn model_of(dh: &DhParameters) -> &'static ArmModel {
    if let Some(nominal) = ARM_MODELS.iter().find(|model| model.dh == *dh) {
        return nominal;
    }
    let links = *Chain::of(dh).links();
    let distance = |model: &DhParameters| -> f64 {
        let each = links.iter().enumerate().map(|(i, link)| {
            let at = link.translation;
            (at.x.hypot(at.y) - model.a[i].abs()).abs() + (at.z - model.d[i]).abs()
        });
        each.sum()
    };
    ARM_MODELS.iter().min_by(|a, b| distance(&a.dh).total_cmp(&distance(&b.dh))).unwrap_or(&ARM_MODELS[0])
}

/// Upper bound of how far the surface of each link is from where [`Chain::placed`] has it, m. The body is
/// that of a nominal arm, and the next joint's axis is elsewhere, and tilted. The table has one sum of the
/// offsets of upper arm, forearm and wrist 1 along their parallel axes: all three may be off by it. Offsets
/// that cancel each other are in no table.
pub fn misfits(dh: &DhParameters, nominal: &DhParameters) -> [f64; 6] {
    let (links, ideal) = (Chain::of(dh), Chain::of(nominal));
    let along = (links.links()[3].translation.z - ideal.links()[3].translation.z).abs();
    std::array::from_fn(|i| {
        let (link, ideal) = (&links.links()[i], &ideal.links()[i]);
        // Where the encoder has its zero does not shape the body.
        let turn = untilted(&link.rotation, nominal.alpha[i]);
        let at = turn * ideal.rotation.inverse() * ideal.translation.vector;
        let hidden = if PARALLEL_JOINTS.contains(&i) { along } else { 0.0 };
        (link.translation.vector - at).norm() + hidden + link.rotation.angle_to(&turn) * BEARING_M
    })
}

/// How far the frames of an arm are from those of a nominal one at most, m, among positions all over its
/// range: a figure for people, not a bound.
pub fn farthest_apart(dh: &DhParameters, nominal: &DhParameters) -> f64 {
    let (arm, ideal) = (Chain::of(dh), Chain::of(nominal));
    let apart = |q: Joints| {
        let pairs = arm.frames(&q).into_iter().zip(ideal.frames(&q));
        pairs.map(|(a, b)| (a.translation.vector - b.translation.vector).norm()).fold(0.0, larger)
    };
    all_over(POSITIONS).map(apart).fold(0.0, larger)
}

/// The larger of two figures; what is no number stays.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// Joint positions all over, by the fractional parts of multiples of roots: as even as random ones, and the
/// same each time.
pub(crate) fn all_over(count: usize) -> impl Iterator<Item = Joints> {
    let roots = [2.0_f64, 3.0, 5.0, 7.0, 11.0, 13.0].map(f64::sqrt);
    (1..=count).map(move |k| {
        Joints(roots.map(|root| {
            let angle = TAU * (k as f64 * root).fract();
            if angle > PI { angle - TAU } else { angle }
        }))
    })
}

/// The DH parameters of an arm whose links (`joint_from_link`, joints at zero) are these; `None` if its
/// flange is not where four parameters can put it. Joint i turns about z of the link before. The common
/// normals of the axes decide, as in Hartenberg and Denavit's convention, so the parallel axes of a real arm
/// get the large offsets that its controller reports.
pub fn dh_of(links: &[Isometry3<f64>; 6]) -> Option<DhParameters> {
    let mut base_from_link = Isometry3::identity();
    let base_from_links = links.map(|link| {
        base_from_link *= link;
        base_from_link
    });
    let mut dh = DhParameters { a: [0.0; 6], d: [0.0; 6], alpha: [0.0; 6], theta: [0.0; 6] };
    let mut base_from_frame = Isometry3::identity();
    for (i, base_from_link) in base_from_links.iter().enumerate() {
        let next = base_from_frame.inverse() * base_from_link;
        let step = if i == 5 { last_step(&next)? } else { step(&next, TWISTS[i]) };
        [dh.theta[i], dh.d[i], dh.a[i], dh.alpha[i]] = step;
        base_from_frame *= product(step);
    }
    Some(dh)
}

/// Rz(theta) Tz(d) Tx(a) Rx(alpha).
fn product([theta, d, a, alpha]: [f64; 4]) -> Isometry3<f64> {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    about(Vector3::z_axis(), theta) * Isometry3::translation(a, 0.0, d) * about(Vector3::x_axis(), alpha)
}

/// theta, d, a, alpha that lead from the z axis to that of `next`; `twist` is the nominal alpha.
fn step(next: &Isometry3<f64>, twist: f64) -> [f64; 4] {
    let (axis, point) = (next.rotation * Vector3::z(), next.translation.vector);
    let normal = Vector3::z().cross(&axis);
    if normal.norm() < MIN_AXIS_SINE {
        let theta = if point.xy().norm() > MIN_OFFSET_M { (-point.y).atan2(-point.x) } else { 0.0 };
        return [theta, 0.0, -point.xy().norm(), normal.norm().atan2(axis.z)];
    }
    // Both directions of the normal describe the same axes. Controllers report alpha with its nominal sign.
    let towards = if twist == 0.0 { normal.x } else { twist };
    let x = normal.normalize().scale(1.0_f64.copysign(towards));
    let y = Vector3::z().cross(&x);
    let along = -point.dot(&y) / axis.dot(&y);
    [x.y.atan2(x.x), point.z + along * axis.z, point.dot(&x), (-axis.dot(&y)).atan2(axis.z)]
}

/// The same to the flange, whose x axis is given too.
fn last_step(next: &Isometry3<f64>) -> Option<[f64; 4]> {
    let turn: Matrix3<f64> = next.rotation.to_rotation_matrix().into_inner();
    let theta = turn[(1, 0)].atan2(turn[(0, 0)]);
    let x = Vector3::new(theta.cos(), theta.sin(), 0.0);
    let found =
        [theta, next.translation.z, next.translation.vector.dot(&x), turn[(2, 1)].atan2(turn[(2, 2)])];
    let off = product(found).inverse() * next;
    (off.translation.vector.norm() + off.rotation.angle() < FLANGE_TOLERANCE).then_some(found)
}

/// The links of an arm whose joints are given as the public robot descriptions give them: `joints` are the
/// six poses of a joint in the frame of the link before it. `None` if the first axis is not the base's z
/// axis.
pub fn links_of_description(joints: &[Isometry3<f64>; 6]) -> Option<[Isometry3<f64>; 6]> {
    let [shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3] = *joints;
    let z = shoulder.rotation * Vector3::z();
    let first_is_z = (z - Vector3::z()).norm() + shoulder.translation.vector.xy().norm() < FLANGE_TOLERANCE;
    // What turns about an axis before the first joint may as well turn after it.
    first_is_z.then_some([shoulder * upper_arm, forearm, wrist_1, wrist_2, wrist_3, Isometry3::identity()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::capsules;
    use crate::kinematics::{Kinematics, forward, jacobian, link_frames};
    use crate::testing::{PUBLISHED, PUBLISHED_UR5E, described};
    use nalgebra::{Point3, Vector6};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn published() -> impl Iterator<Item = DhParameters> {
        let ur5e = dh_of(&links_of_description(&described(&PUBLISHED_UR5E)).unwrap()).unwrap();
        PUBLISHED.into_iter().chain([ur5e])
    }

    #[test]
    fn the_model_is_found_from_links_despite_large_offsets() {
        let names: Vec<&str> = published().map(|dh| model_of(&dh).name).collect();
        assert_eq!(names, ["UR10", "UR10", "UR10", "UR5e"]);
        for model in ARM_MODELS {
            assert_eq!(model_of(&model.dh).name, model.name);
        }
    }

    #[test]
    fn frames_of_real_arms_are_millimetres_from_nominal_ones() {
        for dh in published() {
            let nominal = model_of(&dh).dh;
            let apart_m = farthest_apart(&dh, &nominal);
            assert!((1e-3..8e-3).contains(&apart_m), "{apart_m} m: {dh:?}");
            let misfit_m = misfits(&dh, &nominal).into_iter().fold(0.0, f64::max);
            assert!((1e-4..8e-3).contains(&misfit_m), "{misfit_m} m: {dh:?}");
        }
        assert_eq!(farthest_apart(&DhParameters::UR5E, &DhParameters::UR5E), 0.0);
        assert!(misfits(&DhParameters::UR5E, &DhParameters::UR5E).iter().all(|misfit| *misfit < 1e-12));
    }

    /// The flange is that of the table as it stands, and the speeds of the flange are those of the joints.
    #[test]
    fn settled_frames_change_neither_axes_nor_flange() {
        for dh in published() {
            for q in all_over(200) {
                let plain = (0..6).fold(Isometry3::identity(), |at, i| {
                    at * product([q.0[i] + dh.theta[i], dh.d[i], dh.a[i], dh.alpha[i]])
                });
                let found = forward(&dh, &q);
                let off = plain.inverse() * found;
                assert!(off.translation.vector.norm() + off.rotation.angle() < 1e-10, "{off}");
                let moved = Joints(std::array::from_fn(|i| q.0[i] + 1e-7 * (1.0 + i as f64)));
                let way = Vector6::from_fn(|i, _| 1e-7 * (1.0 + i as f64));
                let there = forward(&dh, &moved).translation.vector - found.translation.vector;
                let told = (jacobian(&dh, &q) * way).fixed_rows::<3>(0).into_owned();
                assert!((there - told).norm() < 1e-9, "{there} {told}");
            }
        }
    }

    /// A body is where its frame is, turned as little as its joint lets it.
    #[test]
    fn bodies_lie_at_their_frames_and_are_not_tilted() {
        for dh in published() {
            let (chain, nominal) = (Chain::of(&dh), Chain::of(&model_of(&dh).dh));
            for q in all_over(50) {
                let (placed, frames) = (chain.placed(&q), chain.frames(&q));
                assert_eq!(placed.frames, frames);
                for (i, (body, frame)) in placed.bodies.iter().zip(&frames).enumerate() {
                    assert!((body.translation.vector - frame.translation.vector).norm() < 1e-12);
                    let axis = i.checked_sub(1).map_or(Vector3::z(), |i| frames[i].rotation * Vector3::z());
                    let ideal = nominal.links()[i].rotation.inverse() * Vector3::z();
                    let off = (body.rotation * ideal).angle(&axis);
                    assert!(off < if i == 5 { 2e-3 } else { 1e-7 }, "link {i}: {off} rad");
                }
            }
        }
        let nominal = Chain::of(&DhParameters::UR5E);
        let q = Joints([0.3, -1.2, 1.7, -2.0, -1.4, 0.6]);
        let pairs = nominal.placed(&q).bodies.into_iter().zip(nominal.frames(&q));
        assert!(pairs.into_iter().all(|(body, frame)| body.rotation.angle_to(&frame.rotation) < 1e-12));
    }

    /// Arms whose links are nominal bodies with their next joint a little elsewhere and tilted. Along the
    /// parallel axes one link at a time is off.
    #[test]
    fn no_point_of_a_link_is_farther_from_its_place_than_the_misfit() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let mut most: f64 = 0.0;
        for case in 0..60 {
            let model =
                ARM_MODELS.iter().filter(|model| capsules(model.name).is_some()).nth(case % 6).unwrap();
            let ideal = *Chain::of(&model.dh).links();
            let mut links = ideal;
            for (i, link) in links[..5].iter_mut().enumerate() {
                let mut small = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
                let (mut shift, mut tilt) = (small(2e-3), small(3e-3));
                // About its joint a link is where the encoder has its zero.
                tilt.z = 0.0;
                if PARALLEL_JOINTS.contains(&i) {
                    shift.y = 0.0;
                }
                // The shoulder's offset along the next axis counts among them.
                match i {
                    0 if case % 4 != 0 => shift.y = 0.0,
                    1..4 if case % 4 != i => shift.z = 0.0,
                    // As wrist 1's does along its own.
                    4 => shift.z = 0.0,
                    _ => (),
                }
                let turn = UnitQuaternion::from_scaled_axis(tilt) * link.rotation;
                *link = Isometry3::from_parts((link.translation.vector + shift).into(), turn);
            }
            let dh = dh_of(&links).unwrap();
            let (chain, misfits) = (Chain::of(&dh), misfits(&dh, &model.dh));
            for q in all_over(20) {
                let placed = chain.placed(&q).bodies;
                let mut base_from_joint = Isometry3::identity();
                for i in 0..5 {
                    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q.0[i]);
                    let body = base_from_joint * turn * ideal[i];
                    base_from_joint *= turn * links[i];
                    for end in capsules(model.name).unwrap()[i + 1].iter().flat_map(|one| [one.a, one.b]) {
                        let off = (placed[i] * Point3::from(end) - body * Point3::from(end)).norm();
                        assert!(off <= misfits[i] + 2e-5, "case {case}, link {i}: {off} of {} m", misfits[i]);
                        most = most.max(off / misfits[i]);
                    }
                }
            }
        }
        assert!(most > 0.5, "a bound that is never reached is no use: {most}");
    }

    #[test]
    fn the_joints_of_real_arms_are_found_again() {
        for dh in published() {
            let near = |q: &Joints| q.0[4].sin().abs() < 0.1 || q.0[2].sin().abs() < 0.3;
            for q in all_over(300).filter(|q| !near(q)) {
                let target = forward(&dh, &q);
                let wrist = link_frames(&dh, &q)[3].translation;
                if wrist.x.hypot(wrist.y) < 0.25 {
                    continue;
                }
                let found = Kinematics::of(&dh).inverse(&target);
                assert!(found.iter().any(|s| s.max_difference(&q) < 1e-7), "{q:?}: {found:?}");
            }
        }
    }

    /// A real controller's table is one of the many that describe an arm: the one of the common normals.
    #[test]
    fn links_become_a_table_that_describes_the_same_arm() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut farthest_d: f64 = 0.0;
        for case in 0..200 {
            let mut links = *Chain::of(&ARM_MODELS[case % ARM_MODELS.len()].dh).links();
            // Four parameters put the flange on its axis.
            for link in &mut links[..5] {
                let mut small = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
                *link = Isometry3::new(small(2e-3), small(3e-3)) * *link;
            }
            let dh = dh_of(&links).unwrap();
            farthest_d = farthest_d.max(dh.d[1].abs());
            assert_eq!(model_of(&dh).name, ARM_MODELS[case % ARM_MODELS.len()].name);
            for q in all_over(20) {
                let told = links.iter().zip(q.0).fold(Isometry3::identity(), |at, (link, angle)| {
                    at * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle) * link
                });
                let off = told.inverse() * forward(&dh, &q);
                assert!(off.translation.vector.norm() + off.rotation.angle() < 1e-9, "case {case}: {off}");
            }
        }
        assert!(farthest_d > 10.0, "as large as those of real arms: {farthest_d} m");
        assert_eq!(dh_of(Chain::of(&DhParameters::UR5E).links()).map(|dh| model_of(&dh).name), Some("UR5e"));
    }

    #[test]
    fn a_flange_off_its_axis_is_refused() {
        let mut links = *Chain::of(&DhParameters::UR5E).links();
        links[5] = Isometry3::new(Vector3::zeros(), Vector3::new(0.0, 0.1, 0.0)) * links[5];
        assert_eq!(dh_of(&links), None);
        let mut joints = described(&PUBLISHED_UR5E);
        joints[0] = Isometry3::new(Vector3::zeros(), Vector3::new(0.1, 0.0, 0.0)) * joints[0];
        assert_eq!(links_of_description(&joints), None);
    }

    #[test]
    fn a_description_and_its_table_put_the_flange_in_the_same_place() {
        let joints = described(&PUBLISHED_UR5E);
        let dh = dh_of(&links_of_description(&joints).unwrap()).unwrap();
        for q in all_over(100) {
            let described = joints.iter().zip(q.0).fold(Isometry3::identity(), |at, (joint, angle)| {
                at * joint * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
            });
            let off = described.inverse() * forward(&dh, &q);
            assert!(off.translation.vector.norm() + off.rotation.angle() < 1e-9, "{off}");
        }
        // What a body is fixed to is where the description has it.
        let elbow = link_frames(&dh, &Joints([0.0; 6]))[1] * Point3::origin();
        let told = joints[..3].iter().fold(Isometry3::identity(), |at, joint| at * joint) * Point3::origin();
        assert!((elbow - told).norm() < 1e-3, "{elbow} {told}");
    }
}
