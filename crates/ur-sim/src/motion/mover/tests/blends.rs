//! Blends that the arm does not brake for, each reading of the controller.

use super::*;
use crate::motion::rounding::{BlendConfig, EntrySpeed};

/// Speeds of two moves and how far the second goes, in its unit.
const FIRST: f64 = 0.25;
const SECOND: f64 = 0.4;
const ACCELERATION: f64 = 1.2;

/// Measurements of one corner.
struct Seen {
    /// The tool's speed before the corner and at its end, m/s.
    speeds: [f64; 2],
    /// The smallest distance of the tool from the corner, m.
    nearest: f64,
    /// Frames in the corner.
    frames: u32,
    /// The tool's largest acceleration after it, m/s2.
    after: f64,
    /// How far the tool gets beyond its end, m.
    beyond: f64,
    /// The largest step in a joint's speed, rad/s.
    step: f64,
}

fn speed(mover: &Mover) -> f64 {
    mover.tcp_speed().fixed_rows::<3>(0).norm()
}

/// Down by a line, then so far sideways by another one.
fn corner(entry_speed: EntrySpeed, seed: u64, sideways: f64, pace: f64) -> Seen {
    let mut mover = mover();
    mover.set_blends(BlendConfig { entry_speed, seed });
    let corner = lifted(&mover, &HOME, 0.0, 0.0, -0.15);
    let end = lifted(&mover, &HOME, 0.0, sideways, -0.15);
    let first = mover.move_tool(&corner, &limits(ACCELERATION, FIRST, 0.05)).unwrap();
    for _ in 0..100 {
        mover.step(pace).unwrap();
    }
    while !mover.released(first) {
        mover.step(pace).unwrap();
    }
    let mut seen =
        Seen { speeds: [speed(&mover); 2], nearest: 1.0, frames: 0, after: 0.0, beyond: 0.0, step: 0.0 };
    mover.move_tool(&end, &limits(ACCELERATION, SECOND, 0.0)).unwrap();
    let mut before = mover.clone();
    while !matches!(mover.task, Task::Stand) {
        mover.step(pace).unwrap();
        let steps: [f64; 6] = std::array::from_fn(|joint| mover.qd()[joint] - before.qd()[joint]);
        seen.step = seen.step.max(fastest(&steps));
        let apart = mover.tcp().translation.vector - corner.translation.vector;
        seen.nearest = seen.nearest.min(apart.norm());
        seen.beyond = seen.beyond.max(apart.y - sideways);
        if mover.rounds_corner() {
            (seen.frames, seen.speeds[1]) = (seen.frames + 1, speed(&mover));
        } else {
            let change = (mover.tcp_speed() - before.tcp_speed()).fixed_rows::<3>(0).norm();
            seen.after = seen.after.max(change / FRAME_SECONDS);
        }
        before = mover.clone();
    }
    let off = mover.tcp().translation.vector - end.translation.vector;
    assert!(off.norm() < 1e-6, "it ends at its target: {off}");
    seen
}

#[test]
fn a_blend_is_passed_at_the_speed_of_its_reading() {
    for seed in 0..8 {
        for (reading, sideways, ends_at) in [
            (EntrySpeed::Kept, 0.2, FIRST),
            (EntrySpeed::Scaled, 0.2, FIRST),
            (EntrySpeed::Raised, 0.2, SECOND),
        ] {
            let seen = corner(reading, seed, sideways, 1.0);
            let [came, goes] = seen.speeds;
            assert!((came - FIRST).abs() < 0.005, "{reading:?}, seed {seed}: comes at {came} m/s");
            assert!((goes - ends_at).abs() < 0.02, "{reading:?}, seed {seed}: leaves at {goes} m/s");
            assert!(seen.nearest > 0.001 && seen.nearest < 0.05, "{} m from the corner", seen.nearest);
            assert!(seen.after < 1.05 * ACCELERATION, "{} m/s2 after the corner", seen.after);
            assert!(seen.step < 0.05, "a joint's speed jumps by {} rad/s", seen.step);
        }
    }
}

/// 15 mm from a corner whose blend is as long, an arm that kept 0.25 m/s needs 26 mm to brake.
#[test]
fn where_the_next_move_is_short_a_kept_speed_overruns_its_end_and_a_scaled_one_does_not() {
    let short = |reading| corner(reading, 3, 0.03, 1.0);
    let kept = short(EntrySpeed::Kept);
    let beyond = FIRST * FIRST / (2.0 * ACCELERATION) - 0.015;
    assert!((kept.speeds[1] - FIRST).abs() < 0.02, "{} m/s", kept.speeds[1]);
    assert!((kept.beyond - beyond).abs() < 2e-3, "{} m beyond the end", kept.beyond);
    assert!(kept.after < 1.05 * ACCELERATION, "{} m/s2", kept.after);
    let scaled = short(EntrySpeed::Scaled);
    let brakes = (2.0 * ACCELERATION * 0.015_f64).sqrt();
    assert!((scaled.speeds[1] - brakes).abs() < 0.02, "{} m/s", scaled.speeds[1]);
    assert!(scaled.after < 1.05 * ACCELERATION && scaled.beyond < 1e-4, "{} m/s2", scaled.after);
}

#[test]
fn the_slider_slows_a_corner_once() {
    let (whole, half) = (corner(EntrySpeed::Kept, 1, 0.2, 1.0), corner(EntrySpeed::Kept, 1, 0.2, 0.5));
    let times = f64::from(half.frames) / f64::from(whole.frames);
    assert!((times - 2.0).abs() < 0.1, "{times} times as long");
    assert!((half.speeds[1] / whole.speeds[1] - 0.5).abs() < 0.05, "{:?}", half.speeds);
}

/// From a joint move into a line and back, as celld's paths go.
#[test]
fn joint_moves_and_lines_follow_each_other_at_the_tools_speed() {
    let mut mover = mover();
    mover.set_blends(BlendConfig { entry_speed: EntrySpeed::Kept, seed: 2 });
    let over = Joints([0.5, -1.57, 1.57, -1.57, -1.57, 0.0]);
    let down = mover.arm.follow(&lifted(&mover, &over, 0.0, 0.0, -0.1), &over).unwrap();
    let (low, back) = (mover.arm.tcp(&down), Joints([0.0, -1.4, 1.4, -1.57, -1.57, 0.0]));
    let first = mover.move_joints(&over, &limits(1.4, 0.6, 0.03)).unwrap();
    while !mover.released(first) {
        mover.step(1.0).unwrap();
    }
    let mut came = speed(&mover);
    let second = mover.move_tool(&low, &limits(1.2, 0.25, 0.03)).unwrap();
    let mut goes = 0.0;
    while !mover.released(second) {
        mover.step(1.0).unwrap();
        goes = if mover.rounds_corner() { speed(&mover) } else { goes };
    }
    assert!(came > 0.2 && (goes - came).abs() < 0.02, "{came} m/s, then {goes}");
    (goes, came) = (0.0, speed(&mover));
    mover.move_joints(&back, &limits(1.4, 0.6, 0.0)).unwrap();
    finish(&mut mover, |mover| goes = if mover.rounds_corner() { speed(mover) } else { goes });
    assert!((goes - came).abs() < 0.02, "{came} m/s, then {goes}");
    assert_eq!(mover.q(), back);
}

/// From a fast move into a slow one and the other way round, the tool stays between the two and its corner.
#[test]
fn a_corner_is_cut_and_neither_passed_nor_begun_backwards() {
    for reading in [EntrySpeed::Kept, EntrySpeed::Scaled, EntrySpeed::Raised] {
        for (seed, (first, second)) in (0..).zip([(0.5, 0.05), (0.05, 0.5), (0.3, 0.05), (0.8, 0.8)]) {
            let mut mover = mover();
            mover.set_blends(BlendConfig { entry_speed: reading, seed });
            let corner = lifted(&mover, &HOME, 0.0, 0.0, -0.2);
            let end = lifted(&mover, &HOME, 0.0, 0.2, -0.2);
            let id = mover.move_tool(&corner, &limits(4.0, first, 0.03)).unwrap();
            while !mover.released(id) {
                mover.step(1.0).unwrap();
            }
            mover.move_tool(&end, &limits(4.0, second, 0.0)).unwrap();
            let mut above = f64::INFINITY;
            finish(&mut mover, |mover| {
                let at = mover.tcp().translation.vector - corner.translation.vector;
                let case = format!("{reading:?}, {first} to {second} m/s: {at}");
                assert!(at.z > -1e-3 && at.y > -1e-3 && at.y < 0.201, "{case}");
                assert!(at.z < above + 1e-4, "it goes up again: {case}");
                above = at.z;
            });
        }
    }
}

/// A line at a usual speed into a joint move that turns the wrist far and hardly moves the tool: no joint
/// gets faster than it can be.
#[test]
fn a_speed_that_is_kept_into_a_turn_of_the_wrist_is_as_high_as_the_joint_allows() {
    for entry_speed in [EntrySpeed::Kept, EntrySpeed::Raised] {
        let mut mover = mover();
        mover.set_blends(BlendConfig { entry_speed, seed: 4 });
        let down = lifted(&mover, &HOME, 0.0, 0.0, -0.15);
        let first = mover.move_tool(&down, &limits(1.2, 0.25, 0.03)).unwrap();
        while !mover.released(first) {
            mover.step(1.0).unwrap();
        }
        let mut turned = mover.arm.follow(&down, &mover.q()).unwrap();
        (turned.0[0], turned.0[5]) = (turned.0[0] + 0.1, turned.0[5] + 3.0);
        mover.move_joints(&turned, &limits(3.0, 3.0, 0.0)).unwrap();
        finish(&mut mover, |mover| assert!(fastest(&mover.qd()) < 1.001 * std::f64::consts::PI));
        assert_eq!(mover.q(), turned);
    }
}

/// The tool turns on the spot, or goes back the way it came: there is no corner to round.
#[test]
fn what_is_no_corner_is_not_rounded() {
    let turned = Joints([0.0, -1.57, 1.57, -1.57, -1.57, 1.0]);
    for back in [false, true] {
        let mut mover = mover();
        mover.set_blends(BlendConfig { entry_speed: EntrySpeed::Raised, seed: 1 });
        let (away, home) = (lifted(&mover, &HOME, 0.0, 0.0, -0.15), mover.tcp());
        let first = mover.move_tool(&away, &limits(1.2, 0.25, 0.05)).unwrap();
        while !mover.released(first) {
            mover.step(1.0).unwrap();
        }
        match back {
            true => mover.move_tool(&home, &limits(1.2, 0.25, 0.0)).unwrap(),
            false => {
                let mut there = mover.arm.follow(&away, &mover.q()).unwrap();
                there.0[5] = turned.0[5];
                mover.move_joints(&there, &limits(1.4, 1.0, 0.0)).unwrap()
            }
        };
        assert!(!mover.rounds_corner());
        finish(&mut mover, |_| {});
    }
}
