//! Limits, straightness and blends of the simulated arm's motion, frame by frame.

use super::*;
use crate::motion::MotionFault;
use crate::motion::segment::MoveLimits;
use nalgebra::Translation3;
use proptest::prelude::*;
use ur_arm::kinematics::DhParameters;

mod blends;

const HOME: Joints = Joints([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]);

fn mover() -> Mover {
    Mover::new(Arm::ur5e(DhParameters::UR5E), HOME)
}

fn limits(acceleration: f64, speed: f64, blend: f64) -> MoveLimits {
    MoveLimits { acceleration, speed, seconds: 0.0, blend, keeps: false }
}

/// Steps until the arm is at rest, calling `each` after every frame; the number of frames.
fn finish(mover: &mut Mover, mut each: impl FnMut(&Mover)) -> u32 {
    for frame in 1..100_000 {
        mover.step(1.0).unwrap();
        each(mover);
        if matches!(mover.task, Task::Stand) {
            return frame;
        }
    }
    panic!("the arm never came to rest");
}

fn lifted(mover: &Mover, q: &Joints, x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Translation3::new(x, y, z) * mover.arm.tcp(q)
}

fn fastest(values: &[f64; 6]) -> f64 {
    values.iter().fold(0.0, |fastest: f64, value| fastest.max(value.abs()))
}

#[test]
fn a_joint_move_keeps_its_limits_and_arrives_exactly() {
    let mut mover = mover();
    let target = Joints([1.0, -1.0, 1.2, -1.8, -1.5, 0.4]);
    let id = mover.move_joints(&target, &limits(1.4, 1.05, 0.0)).unwrap();
    let frames = finish(&mut mover, |mover| {
        assert!(fastest(&mover.qd) <= 1.05 + 1e-9, "{:?}", mover.qd);
        assert!(fastest(&mover.qdd) <= 1.4 + 1e-6, "{:?}", mover.qdd);
    });
    assert!(mover.released(id) && mover.q() == target);
    let seconds = f64::from(frames) * FRAME_SECONDS;
    let expected = 1.0 / 1.05 + 1.05 / 1.4;
    assert!((seconds - expected).abs() < 0.01, "{seconds} instead of {expected}");
}

#[test]
fn a_tool_move_stays_on_its_line() {
    let mut mover = mover();
    let start = mover.arm.tcp(&HOME).translation.vector;
    let target = lifted(&mover, &HOME, 0.05, 0.1, -0.2);
    mover.move_tool(&target, &limits(1.2, 0.25, 0.0)).unwrap();
    let direction = (target.translation.vector - start).normalize();
    let mut before = start;
    finish(&mut mover, |mover| {
        let here = mover.arm.tcp(&mover.q).translation.vector;
        let off = (here - start) - direction * (here - start).dot(&direction);
        assert!(off.norm() < 1e-4, "{} m off the line", off.norm());
        assert!((here - before).norm() / FRAME_SECONDS <= 0.25 + 1e-6);
        before = here;
    });
    assert!((mover.arm.tcp(&mover.q).translation.vector - target.translation.vector).norm() < 1e-8);
}

/// Runs moves after each other as a program does: the next is given in the frame in which the one before
/// lets go. Slowest speed between the first move's release and the second's, and frames in all.
fn chain(mover: &mut Mover, moves: &mut [&mut dyn FnMut(&mut Mover) -> MoveId]) -> f64 {
    let mut slowest = f64::INFINITY;
    let count = moves.len();
    for (index, start) in moves.iter_mut().enumerate() {
        let id = start(mover);
        let mut frames = 0;
        while !mover.released(id) {
            mover.step(1.0).unwrap();
            frames += 1;
            assert!(frames < 100_000);
            if index > 0 && index + 1 < count {
                slowest = slowest.min(mover.tcp_speed().fixed_rows::<3>(0).norm());
            }
        }
    }
    finish(mover, |_| {});
    slowest
}

#[test]
fn blended_joint_moves_do_not_stop() {
    let mut mover = mover();
    let [a, b, c] = [0.6, 1.2, 1.8].map(|turn| Joints([turn, -1.57, 1.57, -1.57, -1.57, 0.0]));
    let slowest = chain(
        &mut mover,
        &mut [
            &mut |m: &mut Mover| m.move_joints(&a, &limits(2.0, 1.0, 0.1)).unwrap(),
            &mut |m: &mut Mover| m.move_joints(&b, &limits(2.0, 1.0, 0.1)).unwrap(),
            &mut |m: &mut Mover| m.move_joints(&c, &limits(2.0, 1.0, 0.0)).unwrap(),
        ],
    );
    let radius = mover.arm.tcp(&HOME).translation.vector.xy().norm();
    assert!(slowest > 0.6 * radius, "slowed down to {slowest} m/s");
    assert_eq!(mover.q(), c);
}

#[test]
fn blended_tool_moves_cut_the_corner_and_keep_moving() {
    let mut mover = mover();
    let corner = lifted(&mover, &HOME, 0.0, 0.0, -0.15);
    let end = lifted(&mover, &HOME, 0.0, 0.2, -0.15);
    let far = lifted(&mover, &HOME, 0.0, 0.2, 0.0);
    let nearest = std::cell::Cell::new(f64::INFINITY);
    let slowest = chain(
        &mut mover,
        &mut [
            &mut |m: &mut Mover| m.move_tool(&corner, &limits(1.2, 0.25, 0.03)).unwrap(),
            &mut |m: &mut Mover| m.move_tool(&end, &limits(1.2, 0.25, 0.03)).unwrap(),
            &mut |m: &mut Mover| {
                let gap = (m.arm.tcp(&m.q).translation.vector - end.translation.vector).norm();
                nearest.set(gap);
                m.move_tool(&far, &limits(1.2, 0.25, 0.0)).unwrap()
            },
        ],
    );
    assert!(slowest > 0.1, "slowed down to {slowest} m/s");
    assert!(nearest.get() < 0.032 && nearest.get() > 0.02, "released {} m before", nearest.get());
    assert!((mover.arm.tcp(&mover.q).translation.vector - far.translation.vector).norm() < 1e-7);
}

#[test]
fn the_corner_is_passed_within_the_blend_radius() {
    let mut mover = mover();
    let corner = lifted(&mover, &HOME, 0.0, 0.0, -0.15);
    let end = lifted(&mover, &HOME, 0.0, 0.2, -0.15);
    let first = mover.move_tool(&corner, &limits(1.2, 0.25, 0.05)).unwrap();
    while !mover.released(first) {
        mover.step(1.0).unwrap();
    }
    mover.move_tool(&end, &limits(1.2, 0.25, 0.0)).unwrap();
    let (mut nearest, mut sharpest) = (f64::INFINITY, 0.0f64);
    let mut before = mover.tcp_speed();
    finish(&mut mover, |m| {
        let here = m.arm.tcp(&m.q).translation.vector;
        nearest = nearest.min((here - corner.translation.vector).norm());
        let change = (m.tcp_speed() - before).fixed_rows::<3>(0).norm() / FRAME_SECONDS;
        sharpest = sharpest.max(change);
        before = m.tcp_speed();
    });
    assert!(nearest > 0.005 && nearest < 0.05, "{nearest} m from the corner");
    assert!(sharpest < 1.2 * 1.45, "{sharpest} m/s2");
}

#[test]
fn a_move_without_successor_stops_at_its_target_despite_the_blend() {
    let mut mover = mover();
    let target = Joints([0.5, -1.57, 1.57, -1.57, -1.57, 0.0]);
    mover.move_joints(&target, &limits(1.4, 1.05, 0.05)).unwrap();
    finish(&mut mover, |_| {});
    assert_eq!(mover.q(), target);
}

#[test]
fn scaling_slows_along_the_path_and_pausing_holds() {
    let mut mover = mover();
    let target = Joints([0.5, -1.57, 1.57, -1.57, -1.57, 0.0]);
    mover.move_joints(&target, &limits(1.4, 1.05, 0.0)).unwrap();
    for _ in 0..100 {
        mover.step(1.0).unwrap();
    }
    for _ in 0..200 {
        mover.step(0.0).unwrap();
    }
    assert!(mover.stands() && mover.q().0[0] > 0.01 && mover.q().0[0] < 0.5);
    finish(&mut mover, |_| {});
    assert_eq!(mover.q(), target);
}

#[test]
fn half_the_slider_takes_twice_the_time() {
    let frames = |scaling: f64| {
        let mut mover = mover();
        mover.scaling = scaling;
        mover.move_joints(&Joints([1.0, -1.57, 1.57, -1.57, -1.57, 0.0]), &limits(1.4, 1.05, 0.0)).unwrap();
        (1..).find(|_| {
            mover.step(scaling).unwrap();
            matches!(mover.task, Task::Stand)
        })
    };
    let (full, half) = (frames(1.0).unwrap(), frames(0.5).unwrap());
    assert!((f64::from(half) / f64::from(full) - 2.0).abs() < 0.01, "{full} {half}");
}

#[test]
fn stopping_brakes_as_commanded() {
    let mut mover = mover();
    mover.move_joints(&Joints([2.0, -1.57, 1.57, -1.57, -1.57, 0.0]), &limits(4.0, 1.0, 0.0)).unwrap();
    for _ in 0..300 {
        mover.step(1.0).unwrap();
    }
    mover.stop_joints(2.0);
    assert!(mover.busy());
    let frames = finish(&mut mover, |m| assert!(fastest(&m.qdd) <= 2.0 + 1e-6));
    assert!((f64::from(frames) * FRAME_SECONDS - 0.5).abs() < 0.01, "{frames} frames");
    assert!(!mover.busy());
}

#[test]
fn a_new_move_during_a_speed_takes_over_smoothly() {
    let mut mover = mover();
    mover.joint_speed([0.5, 0.0, 0.0, 0.0, 0.0, 0.0], 2.0);
    for _ in 0..300 {
        mover.step(1.0).unwrap();
    }
    assert!(mover.at_speed());
    mover.move_joints(&HOME, &limits(2.0, 1.0, 0.0)).unwrap();
    finish(&mut mover, |m| assert!(fastest(&m.qdd) <= 4.0 + 1e-6, "{:?}", m.qdd));
    assert_eq!(mover.q(), HOME);
}

#[test]
fn servoing_converges_on_the_target() {
    let mut mover = mover();
    let target = Joints([0.1, -1.5, 1.6, -1.5, -1.5, 0.1]);
    for _ in 0..1000 {
        mover.servo(&target, 0.1, FRAME_SECONDS).unwrap();
        mover.step(1.0).unwrap();
    }
    assert!(mover.q().max_difference(&target) < 1e-6);
    finish(&mut mover, |_| {});
}

#[test]
fn a_tool_speed_goes_straight_and_stops() {
    let mut mover = mover();
    let start = mover.arm.tcp(&HOME);
    mover.tool_speed(Vector6::new(0.0, 0.0, -0.1, 0.0, 0.0, 0.0), 0.5, 1.0);
    for _ in 0..500 {
        mover.step(1.0).unwrap();
    }
    assert!(mover.at_speed());
    mover.stop_tool(0.5, 2.0);
    finish(&mut mover, |_| {});
    let moved = mover.arm.tcp(&mover.q).translation.vector - start.translation.vector;
    assert!(moved.xy().norm() < 1e-6 && (moved.z + 0.1).abs() < 2e-3, "{moved}");
}

#[test]
fn what_cannot_be_done_is_refused() {
    let mut mover = mover();
    for bad in [7.0, f64::NAN, f64::INFINITY] {
        let target = Joints([bad, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(matches!(
            mover.move_joints(&target, &limits(1.0, 1.0, 0.0)),
            Err(MotionFault::JointRange { joint: 0, .. })
        ));
    }
    let far = lifted(&mover, &HOME, -2.0, 0.0, 0.0);
    assert_eq!(mover.move_tool(&far, &limits(1.0, 1.0, 0.0)), Err(MotionFault::Unreachable));
    let inside = Translation3::new(0.0, 0.0, 0.3) * mover.arm.tcp(&HOME).rotation;
    let through = mover.move_tool(&inside, &limits(1.0, 1.0, 0.0));
    assert!(through.is_err(), "a line into the shoulder must fail");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_chain_of_joint_moves_stays_within_twice_the_acceleration(
        targets in proptest::collection::vec((-2.0..2.0f64, -2.0..-1.0f64, 1.0..2.0f64, 0.0..0.2f64), 1..5)
    ) {
        let mut mover = mover();
        let mut last = HOME;
        let mut over_before = false;
        for (a, b, c, blend) in targets {
            last = Joints([a, b, c, -1.57, -1.57, a]);
            let id = mover.move_joints(&last, &limits(2.0, 1.0, blend)).unwrap();
            let mut frames = 0;
            while !mover.released(id) {
                mover.step(1.0).unwrap();
                // A short move's own blend may begin in the frame in which the one before ends: three then
                // overlap in it.
                let over = fastest(&mover.qdd) > 4.0 * (1.0 + 1e-3);
                prop_assert!(!(over && over_before), "{:?}", mover.qdd);
                prop_assert!(fastest(&mover.qdd) <= 6.0 * (1.0 + 1e-3), "{:?}", mover.qdd);
                over_before = over;
                prop_assert!(fastest(&mover.qd) <= 1.0 + 0.01, "{:?}", mover.qd);
                frames += 1;
                prop_assert!(frames < 100_000);
            }
        }
        finish(&mut mover, |_| {});
        prop_assert!(mover.q() == last);
    }
}

#[test]
fn the_flange_is_that_of_the_joints_wherever_they_are() {
    let agrees = |mover: &Mover| assert_eq!(mover.flange(), mover.arm.kinematics.forward(&mover.q));
    let mut mover = mover();
    agrees(&mover);
    mover.place(Joints([0.3, -1.2, 1.4, -1.8, -1.5, 0.2]));
    agrees(&mover);
    mover.move_joints(&HOME, &limits(1.4, 1.05, 0.0)).unwrap();
    finish(&mut mover, agrees);
    mover.step(1.0).unwrap();
    agrees(&mover);
}
