//! Times, limits and geometry of motion.

use crate::controller::Controller;
use crate::facts::rig::{config, evaluated, moving_s, numbers_in, playing, said, stopped, until};
use crate::facts::row::source::{CODES, KINEMATICS, SCRIPT, SHEET};
use crate::facts::row::{Fact, Section, figures, number, numbers, text};
use cell_values::units::Joints;
use ur_arm::kinematics::{DhParameters, forward};
use ur_arm::pose::ur_pose_from_isometry;

/// Move, and how long a trapezoid of its acceleration and speed takes, s.
const TIMES: &[(&str, &str, &[f64])] = &[
    ("movel over 0.5 m, a=1.2, v=0.25 (the defaults)", "movel(pose_add(a, p[0,0.5,0,0,0,0]))", &[2.21]),
    ("movel over 0.1 m, the same", "movel(pose_add(a, p[0,0.1,0,0,0,0]))", &[0.61]),
    ("movel over 0.5 m, a=3, v=1", "movel(pose_add(a, p[0,0.5,0,0,0,0]), a=3, v=1)", &[0.83]),
    ("movej over 90 degrees, a=1.4, v=1.05 (the defaults)", "movej(q + [1.570796,0,0,0,0,0])", &[2.25]),
    ("movej over 90 degrees, a=8, v=3", "movej(q + [1.570796,0,0,0,0,0], a=8, v=3)", &[0.9]),
    ("movej with t=2", "movej(q + [1,0,0,0,0,0], t=2)", &[2.0]),
    ("movel with t=1.5", "movel(pose_add(a, p[0,0.2,0,0,0,0]), t=1.5)", &[1.5]),
    ("stopj(2) from 1 rad/s, speedj's own part left out", STOP, &[0.5]),
];

/// Half a second of speeding up, none of it counted.
const STOP: &str = "speedj([1,0,0,0,0,0], 2, 0.5)\n stopj(2)";

/// Joint positions and the flange's pose.
const POSES: &[(&str, [f64; 6], &[f64])] = &[
    ("UR5e: flange at 0, 0, 0, 0, 0, 0", [0.0; 6], &[-0.8172, -0.2329, 0.0628, HALF, 0.0, 0.0]),
    (
        "UR5e: flange at 0, -pi/2, 0, -pi/2, 0, 0",
        [0.0, -HALF, 0.0, -HALF, 0.0, 0.0],
        &[0.0, -0.2329, 1.0794, 0.0, -2.2214, 2.2214],
    ),
    (
        "UR5e: flange at 0, -pi/2, pi/2, -pi/2, -pi/2, 0",
        [0.0, -HALF, HALF, -HALF, -HALF, 0.0],
        &[-0.4919, -0.1333, 0.4879, 2.2214, 2.2214, 0.0],
    ),
    (
        "UR5e: flange at 0.3, -1.2, 1.7, -2, -1.4, 0.6",
        [0.3, -1.2, 1.7, -2.0, -1.4, 0.6],
        &[-0.519919, -0.318082, 0.265628, 2.385285, 1.747807, 0.015563],
    ),
];

const HALF: f64 = std::f64::consts::FRAC_PI_2;

/// The table.
pub fn section() -> Section {
    let mut rows: Vec<Fact> = TIMES
        .iter()
        .map(|(what, moves, seconds)| {
            let script = format!(
                "def m():\n a = get_actual_tcp_pose()\n q = get_actual_joint_positions()\n {moves}\nend\n"
            );
            let own = if *moves == STOP { 0.5 } else { 0.0 };
            number(what, SCRIPT, figures(seconds, 0.01, "s"), moving_s(&script) - own)
        })
        .collect();
    rows.extend(POSES.iter().map(|(what, q, pose)| {
        let flange = ur_pose_from_isometry(&forward(&DhParameters::UR5E, &Joints(*q)));
        numbers(what, KINEMATICS, figures(pose, 1e-4, "m, rad"), same_half_turn(flange, pose).to_vec())
    }));
    rows.extend([servo(), timed_speed(), steady(), fastest_joint(), joint_range(), tool_limit()]);
    rows.extend([offset_limit(), singularity(), gravity()]);
    Section { title: "Motion", rows }
}

/// A pose with its rotation vector as `like` has it, where it is half a turn: both signs are the same then.
fn same_half_turn(pose: [f64; 6], like: &[f64]) -> [f64; 6] {
    let half_turn =
        (pose.iter().skip(3).map(|axis| axis * axis).sum::<f64>().sqrt() - 2.0 * HALF).abs() < 1e-6;
    let against = pose.iter().zip(like).skip(3).map(|(a, b)| a * b).sum::<f64>() < 0.0;
    let [x, y, z, rx, ry, rz] = pose;
    if half_turn && against { [x, y, z, -rx, -ry, -rz] } else { pose }
}

fn servo() -> Fact {
    let seconds = seconds_of("servoj(q, 0, 0)\n servoj(q, 0, 0)\n servoj(q, 0, 0)");
    number("servoj without t, three of them", SCRIPT, figures(&[0.006], 1e-6, "s"), seconds)
}

fn timed_speed() -> Fact {
    let seconds = seconds_of("speedj([0.2,0.3,0.1,0.05,0,0], 0.5, 0.5)");
    number("speedj with t=0.5 returns after", SCRIPT, figures(&[0.5], 0.002, "s"), seconds)
}

/// Simulated time that statements take, by the controller's clock.
fn seconds_of(statements: &str) -> f64 {
    let script = format!(
        "def m():\n q = get_actual_joint_positions()\n sync()\n b = time()\n {statements}\n e = time()\n \
         textmsg((e.sec - b.sec) + (e.nanosec - b.nanosec) / 1000000000)\nend\n"
    );
    said(&script).first().map_or(f64::NAN, |text| first(&numbers_in(text)))
}

fn first(numbers: &[f64]) -> f64 {
    numbers.first().copied().unwrap_or(f64::NAN)
}

fn steady() -> Fact {
    let mut controller = playing(
        "def m():\n movej(get_actual_joint_positions() + [0.1,0,0,0,0,0])\n while not is_steady():\n  sync()\n \
         end\nend\n",
    );
    until(&mut controller, |c| !c.core.mover.stands());
    until(&mut controller, |c| c.core.mover.stands());
    let seconds = until(&mut controller, stopped);
    number("is_steady() after a move becomes true after", SCRIPT, figures(&[0.5], 0.006, "s"), seconds)
}

fn fastest_joint() -> Fact {
    let mut controller = playing("def m():\n movej([0,-1.57,1.57,-1.57,-1.57,3], a=30, v=20)\nend\n");
    let mut fastest = 0.0f64;
    while !stopped(&controller) && controller.core.step < 5000 {
        controller.frame();
        fastest = controller.core.mover.qd().iter().fold(fastest, |fastest, speed| fastest.max(speed.abs()));
    }
    number(
        "UR5e: fastest joint of a movej with v=20",
        SHEET,
        figures(&[180.0], 0.5, "degrees/s"),
        fastest.to_degrees(),
    )
}

fn joint_range() -> Fact {
    let ended =
        |angle: f64| said(&format!("def m():\n movej([{angle},-1.57,1.57,-1.57,-1.57,0], a=30, v=3)\nend\n"));
    let turned = |angle: f64| ended(angle.to_radians()).is_empty();
    let reach = [359.0, 361.0, -359.0, -361.0].map(|angle| if turned(angle) { "yes" } else { "no" });
    text("UR5e: base at 359, 361, -359, -361 degrees", SHEET, "yes no yes no", reach.join(" "))
}

fn tool_limit() -> Fact {
    let mut controller =
        playing("def m():\n movel(pose_add(get_actual_tcp_pose(), p[0,0.5,0,0,0,0]), a=6, v=3)\nend\n");
    let mut fastest = 0.0f64;
    while !stopped(&controller) && controller.core.step < 5000 {
        controller.frame();
        fastest = fastest.max(controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm());
    }
    number(
        "tool of a movel with v=3, factory safety configuration",
        SHEET,
        figures(&[1.5], 0.02, "m/s"),
        fastest,
    )
}

fn offset_limit() -> Fact {
    let at = evaluated_after(
        "path_offset_enable()\n path_offset_set_alpha_filter(0.01)\n path_offset_set([0,0.5,0,0,0,0], 1)\n \
         sleep(1)",
        "path_offset_get(1)[1]",
    );
    number("path offset of 0.5 m without path_offset_set_max_offset", SCRIPT, figures(&[0.1], 1e-3, "m"), at)
}

fn evaluated_after(statements: &str, expression: &str) -> f64 {
    let script = format!("def m():\n {statements}\n textmsg({expression})\nend\n");
    said(&script).first().map_or(f64::NAN, |text| first(&numbers_in(text)))
}

/// A line through the column of the base.
fn singularity() -> Fact {
    let mut controller = playing(
        "def m():\n a = get_actual_tcp_pose()\n movel(p[0,-0.1333,a[2],a[3],a[4],a[5]], v=0.5)\nend\n",
    );
    until(&mut controller, |c| c.core.modes.protective_stopped() || stopped(c));
    let answer = if controller.core.modes.protective_stopped() { "protective stop" } else { "arrived" };
    text("movel into the singularity above the base", CODES, "protective stop", answer.to_owned())
}

fn gravity() -> Fact {
    let controller = Controller::new(config(true));
    let felt = nalgebra::Vector3::from(controller.core.tool_accelerometer()).norm();
    let set = evaluated("get_gravity()");
    let answer = vec![first(&set), set.get(2).copied().unwrap_or(f64::NAN), felt];
    numbers(
        "get_gravity(), x and z; the tool's accelerometer at rest",
        SCRIPT,
        figures(&[0.0, 9.82, 9.82], 0.02, "m/s2"),
        answer,
    )
}
