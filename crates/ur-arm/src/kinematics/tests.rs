//! Forward and inverse kinematics against each other, and against published figures.

use super::*;
use crate::pose::ur_pose_from_isometry;
use nalgebra::UnitQuaternion;
use rand::RngExt;
use rand::SeedableRng;

/// Check values of the reference for the vendor's nominal table.
#[test]
fn forward_agrees_with_published_poses() {
    let check = |q: [f64; 6], expected: [f64; 6]| {
        let pose = ur_pose_from_isometry(&forward(&DhParameters::UR5E, &Joints(q)));
        let wrong = pose.iter().zip(expected).any(|(a, b)| (a - b).abs() > 6e-5);
        assert!(!wrong, "{q:?}: {pose:?}, expected {expected:?}");
    };
    check([0.0; 6], [-0.8172, -0.2329, 0.0628, FRAC_PI_2, 0.0, 0.0]);
    check(
        [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0],
        [-0.4919, -0.1333, 0.4879, 2.2214, 2.2214, 0.0],
    );
    check([0.3, -1.2, 1.7, -2.0, -1.4, 0.6], [-0.519919, -0.318082, 0.265628, 2.385285, 1.747807, 0.015563]);
}

/// The exact figures of the published table: sums of the DH lengths where the axes are at right angles.
#[test]
fn forward_is_exact_to_a_micrometre() {
    let dh = DhParameters::UR5E;
    let check = |q: [f64; 6], expected: [f64; 3]| {
        let found = forward(&dh, &Joints(q)).translation.vector;
        assert!((found - Vector3::from(expected)).norm() < 1e-9, "{q:?}: {found}");
    };
    check([0.0; 6], [-0.8172, -(0.1333 + 0.0996), 0.1625 - 0.0997]);
    check([0.0, -FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0, 0.0], [0.0, -0.2329, 0.1625 + 0.425 + 0.3922 + 0.0997]);
    check(
        [0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0],
        [-(0.3922 + 0.0997), -0.1333, 0.1625 + 0.425 - 0.0996],
    );
    let [x, y, z, ..] = ur_pose_from_isometry(&forward(&dh, &Joints([0.3, -1.2, 1.7, -2.0, -1.4, 0.6])));
    let wrong = [x + 0.519919, y + 0.318082, z - 0.265628].iter().any(|error| error.abs() > 1e-6);
    assert!(!wrong, "{x} {y} {z}");
}

#[test]
fn the_flange_is_at_the_product_of_all_steps() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    for case in 0..10_000 {
        let mut dh = DhParameters::UR5E;
        let i = case % 6;
        if case % 2 == 0 {
            // Of the parallel axes the twist is small.
            let twist = if i == 1 || i == 2 { 0.01 } else { 4.0 };
            dh.alpha[i] += rng.random_range(-twist..twist);
            (dh.theta[i], dh.a[i]) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        }
        let q = Joints(std::array::from_fn(|_| rng.random_range(-7.0..7.0)));
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let steps = (0..6).fold(Isometry3::identity(), |at, i| {
            at * about(Vector3::z_axis(), q.0[i] + dh.theta[i])
                * Isometry3::translation(dh.a[i], 0.0, dh.d[i])
                * about(Vector3::x_axis(), dh.alpha[i])
        });
        assert!(pose_error(&forward(&dh, &q), &steps).norm() < 1e-13, "case {case}");
    }
}

#[test]
fn every_model_finds_its_way_back_with_its_calibration() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    for model in ARM_MODELS {
        let mut dh = model.dh;
        for i in 0..6 {
            dh.a[i] += rng.random_range(-5e-4..5e-4);
            dh.d[i] += rng.random_range(-5e-4..5e-4);
        }
        (dh.d[1], dh.d[2]) = (dh.d[1] + 0.7, dh.d[2] - 0.7);
        for q in [[0.3, -1.2, 1.7, -2.0, -1.4, 0.6], [-1.0, -1.9, -1.3, 0.5, 1.1, 2.0]] {
            let found = Kinematics::of(&dh).inverse(&forward(&dh, &Joints(q)));
            assert!(found.iter().any(|s| s.max_difference(&Joints(q)) < 1e-7), "{}: {found:?}", model.name);
        }
    }
}

/// Bit for bit, also near the singularities: of all solutions those of the family.
#[test]
fn solutions_of_one_family_are_those_among_all_solutions() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(17);
    let mut dh = DhParameters::UR5E;
    for i in 0..6 {
        dh.a[i] += rng.random_range(-1e-3..1e-3);
        dh.alpha[i] += rng.random_range(-2e-3..2e-3);
        dh.theta[i] += rng.random_range(-2e-3..2e-3);
    }
    (dh.d[1], dh.d[2]) = (dh.d[1] + 0.7, dh.d[2] - 0.7);
    let mut found = 0;
    for case in 0..3000 {
        let mut q = Joints(std::array::from_fn(|_| rng.random_range(-3.1..3.1)));
        if case % 3 == 0 {
            let joint = [2, 4][case % 2];
            q.0[joint] = rng.random_range(-0.3..0.3);
        }
        let pose = forward(&dh, &q);
        let wanted = Kinematics::of(&dh).posture(&q);
        let all = Kinematics::of(&dh).inverse(&pose).into_iter();
        let of_family: Vec<Joints> =
            all.filter(|solution| Kinematics::of(&dh).posture(solution) == wanted).collect();
        assert_eq!(Kinematics::of(&dh).inverse_in(&pose, wanted), of_family, "case {case}: {q:?}");
        found += of_family.len();
    }
    assert!(found > 2800, "{found}");
}

#[test]
fn inverse_finds_all_eight_branches() {
    for q in [[0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0], [0.3, -1.2, 1.7, -2.0, -1.4, 0.6]] {
        let target = forward(&DhParameters::UR5E, &Joints(q));
        let solutions = Kinematics::of(&DhParameters::UR5E).inverse(&target);
        assert_eq!(solutions.len(), 8, "{solutions:?}");
        for solution in &solutions {
            assert!(pose_error(&forward(&DhParameters::UR5E, solution), &target).norm() < 1e-9);
        }
        assert!(solutions.iter().any(|s| s.max_difference(&Joints(q)) < 1e-9));
    }
}

#[test]
fn inverse_returns_the_joints_of_a_calibrated_arm() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let mut dh = DhParameters::UR5E;
    for i in 0..6 {
        dh.a[i] += rng.random_range(-5e-4..5e-4);
        dh.d[i] += rng.random_range(-5e-4..5e-4);
        dh.alpha[i] += rng.random_range(-1e-3..1e-3);
        dh.theta[i] += rng.random_range(-1e-3..1e-3);
    }
    // The parallel axes of a real table trade large opposite offsets.
    dh.d[1] += 1.0;
    dh.d[2] -= 1.0;
    let mut tried = 0;
    while tried < 500 {
        let q = Joints(std::array::from_fn(|_| rng.random_range(-3.0..3.0)));
        if q.0[4].sin().abs() < 0.1 || q.0[2].sin().abs() < 0.3 {
            continue;
        }
        let target = forward(&dh, &q);
        let wrist = target * nalgebra::Point3::new(0.0, 0.0, -dh.d[5]);
        if wrist.x.hypot(wrist.y) < 0.2 {
            continue;
        }
        tried += 1;
        let found = Kinematics::of(&dh).inverse(&target);
        assert!(found.iter().any(|s| s.max_difference(&q) < 1e-7), "{q:?}: {found:?}");
    }
}

#[test]
fn jacobian_is_the_derivative_of_forward() {
    let q = Joints([0.3, -1.2, 1.7, -2.0, -1.4, 0.6]);
    let j = jacobian(&DhParameters::UR5E, &q);
    for i in 0..6 {
        let mut moved = q;
        moved.0[i] += 1e-6;
        let dh = DhParameters::UR5E;
        let slope = pose_error(&forward(&dh, &q), &forward(&dh, &moved)) / 1e-6;
        assert!((slope - j.column(i)).norm() < 1e-5, "column {i}: {slope} against {}", j.column(i));
    }
}

#[test]
fn out_of_reach_has_no_solution() {
    let far = Isometry3::translation(1.5, 0.0, 0.3);
    assert!(Kinematics::of(&DhParameters::UR5E).inverse(&far).is_empty());
    let at_axis = Isometry3::translation(0.0, 0.0, 0.5);
    assert!(Kinematics::of(&DhParameters::UR5E).inverse(&at_axis).is_empty());
}

#[test]
fn unwinding_keeps_to_the_range() {
    let near = Joints([3.0; 6]);
    let unwound = unwind(&Joints([-3.0; 6]), &near, (-TAU, TAU)).expect("fits");
    assert!((unwound.0[0] - (TAU - 3.0)).abs() < 1e-12);
    assert!(unwind(&Joints([-3.0; 6]), &near, (-1.0, 1.0)).is_none());
}

/// Parameters off by what a calibration leaves between an arm and its model.
fn off_nominal(model: &ArmModel, rng: &mut rand_chacha::ChaCha8Rng) -> DhParameters {
    let mut dh = model.dh;
    for i in 0..6 {
        dh.a[i] += rng.random_range(-5e-4..5e-4);
        dh.d[i] += rng.random_range(-5e-4..5e-4);
        dh.alpha[i] += rng.random_range(-1e-3..1e-3);
        dh.theta[i] += rng.random_range(-1e-3..1e-3);
    }
    dh
}

/// Where two singularities meet the closed form of the nominal arm is far off; each of these poses was
/// once without joints.
#[test]
fn poses_at_two_singularities_have_joints_too() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let (mut tried, mut folded) = (0, 0);
    for model in ARM_MODELS {
        let mut dh = off_nominal(model, &mut rng);
        (dh.d[1], dh.d[2]) = (dh.d[1] + 0.7, dh.d[2] - 0.7);
        for _ in 0..300 {
            let mut q: [f64; 6] = std::array::from_fn(|_| rng.random_range(-3.1..3.1));
            q[4] = [0.0, PI][tried % 2] + rng.random_range(-0.05..0.05);
            q[2] = [0.0, PI, q[2]][tried % 3] + rng.random_range(-0.05..0.05);
            tried += 1;
            folded += usize::from(q[2].sin().abs() < 0.05);
            let target = forward(&dh, &Joints(q));
            let found = Kinematics::of(&dh).inverse(&target);
            assert!(!found.is_empty(), "{}: {q:?}", model.name);
            for joints in found {
                assert!(pose_error(&forward(&dh, &joints), &target).norm() < 1e-9, "{q:?}");
            }
        }
    }
    assert!(folded > 1000, "{folded} of {tried}");
}

/// A few are missed, all near a singularity: there the nominal arm may not reach at all.
#[test]
fn joints_of_a_calibrated_arm_are_found_again_beside_its_singularities() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (mut tried, mut missed) = (0, 0);
    for model in ARM_MODELS {
        let dh = off_nominal(model, &mut rng);
        let arm = Kinematics::of(&dh);
        for _ in 0..10_000 {
            let q = Joints(std::array::from_fn(|_| rng.random_range(-3.1..3.1)));
            let [wrist, elbow] = [4, 2].map(|joint| q.0[joint].sin().abs());
            if wrist < 0.02 || elbow < 0.02 {
                continue;
            }
            tried += 1;
            let pose = arm.forward(&q);
            let found = arm.inverse(&pose);
            assert!(found.len() <= 8, "{}: {q:?}: {found:?}", model.name);
            let worst = found.iter().map(|q| pose_error(&arm.forward(q), &pose).norm()).fold(0.0, f64::max);
            assert!(worst < 1e-9, "{}: {q:?}: {worst}", model.name);
            if found.iter().all(|found| found.max_difference(&q) > 1e-3) {
                missed += 1;
                let shoulder = family(arm.chain(), &q)[0].abs() / dh.d[3];
                assert!(wrist.min(elbow).min(shoulder) < 0.45, "{}: {q:?}", model.name);
            }
        }
    }
    assert!(missed * 2_000 < tried, "{missed} of {tried}");
}
