//! What the status says of the arm's motion where the cell is disarmed or paused, and what it says last; the
//! payload that the arm moves with.

use super::faults::working;
use super::standing::moving_arm;
use super::*;
use crate::code::Code;
use crate::device::gripper_types::{GripperCommand, GripperEvent};
use crate::device::robot_types::ProgramEnd;
use crate::notified::{Notified, RESTS_AFTER};
use crate::supervisor::input::CameraFault;
use crate::supervisor::status::Doing;

#[test]
fn a_paused_look_that_waits_for_the_camera_is_about_to_go_on() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(order(Order::Pause));
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.ticks(10);
    bench.feed(Input::Captured(Err(CameraFault {
        code: Code::CameraDark,
        message: "dark".into(),
        hint: "light".into(),
        lasting: false,
    })));
    let status = bench.cell.status();
    assert!(matches!(status.doing, Doing::Looking(_, _, Some(Code::CameraDark))), "{:?}", status.doing);
    assert!(status.paused && status.moving, "{status:?}");
}

#[test]
fn a_paused_cell_that_will_park_may_move() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.feed(order(Order::Pause));
    assert!(!bench.cell.status().moving, "it waits for approval");
    bench.robot.q = Joints([0.5; 6]);
    bench.feed_once(order(Order::Park));
    let status = bench.cell.status();
    assert!(status.paused && status.moving, "{status:?}");
}

#[test]
fn a_stop_under_way_counts_in_every_phase() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    assert_eq!(bench.cell.status().doing, Doing::AwaitingApproval);
    assert!(!bench.cell.status().moving);
    bench.arm_settled = false;
    bench.ticks(1);
    let status = bench.cell.status();
    assert!(status.moving && status.doing == Doing::AwaitingApproval, "{status:?}");
}

#[test]
fn the_last_status_of_an_arm_that_rests_says_so() {
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(Input::Shutdown);
    assert!(bench.cell.status().moving, "it brakes");
    bench.robot.qd = [0.0; 6];
    bench.feed(Input::Robot(RobotEvent::Stopped));
    let all = bench.ticks(100);
    assert!(all.iter().any(|action| matches!(action, Action::End(_))), "{all:?}");
    let status = bench.cell.status();
    assert!(status.doing == Doing::Ending && !status.moving, "{status:?}");
}

#[test]
fn a_robot_that_was_never_seen_was_not_moved() {
    let mut bench = Bench::new();
    bench.silent = true;
    bench.ticks(3);
    bench.feed(Input::Shutdown);
    assert!(!bench.cell.status().moving);
    let mut bench = Bench::new();
    bench.ticks(3);
    bench.silent = true;
    bench.feed(Input::Shutdown);
    assert!(bench.cell.status().moving, "its program may still run");
}

#[test]
fn the_end_of_celld_does_not_take_the_place_of_a_stop_that_is_still_to_be_left() {
    let mut bench = working();
    bench.feed(order(Order::Abort));
    bench.feed(Input::Shutdown);
    let stopped = bench.cell.status().stopped.expect("a stop");
    assert_eq!(stopped.code, Code::Aborted, "{stopped:?}");
    let mut bench = working();
    bench.feed(Input::Shutdown);
    assert_eq!(bench.cell.status().stopped.map(|stop| stop.code), Some(Code::Shutdown));
}

/// Whoever presses Stop to be sure does not make the cell forget why it stopped, and in which job.
#[test]
fn an_abort_of_a_cell_that_rests_leaves_the_stop_before_it() {
    let mut bench = working();
    bench.robot.safety_mode = SafetyMode::ProtectiveStop;
    let stopped = bench.feed(Input::Robot(RobotEvent::Safety { mode: SafetyMode::ProtectiveStop }));
    assert!(ended(&stopped).is_some(), "{stopped:?}");
    let stop_of = |bench: &Bench| {
        let stop = bench.cell.status().stopped.expect("a stop");
        (stop.code, stop.job)
    };
    let expected = (Code::ProtectiveStop, Some("j".to_string()));
    assert_eq!(stop_of(&bench), expected);
    bench.feed(Input::Robot(RobotEvent::Stopped));
    bench.ticks(100);
    bench.feed(order(Order::Abort));
    assert_eq!(stop_of(&bench), expected, "nothing was left to stop");
    bench.job(false);
    bench.feed(order(Order::Abort));
    assert_eq!(stop_of(&bench), (Code::Aborted, Some("j".to_string())), "a job ended by it");
}

/// A job that a missed heartbeat had left ends with both reasons.
#[test]
fn an_abort_of_a_job_that_a_stop_has_left_names_that_stop() {
    let mut bench = working();
    bench.cell.model.tolerances.stop_retries = 1;
    bench.feed(Input::Robot(RobotEvent::ProgramEnded { reason: ProgramEnd::HeartbeatLost }));
    bench.feed(Input::Robot(RobotEvent::Stopped));
    bench.ticks(100);
    let before = bench.cell.status().stopped.expect("a stop").message;
    let report = bench.feed(order(Order::Abort)).into_iter().find_map(|action| match action {
        Action::Commit { record: Record::Ended(report), .. } => Some(report),
        _ => None,
    });
    let message = report.expect("the job has ended").message;
    assert_eq!(message, format!("the operator stopped the cell; before that, {before}"));
}

/// A person guides the arm, and the robot becomes silent: it is not called at rest before it was seen so
/// for a while; near the limit a speed goes to and fro.
#[test]
fn an_arm_rests_once_it_was_seen_at_rest_for_a_while() {
    let mut bench = Bench::new();
    let mut shown = Notified::default();
    let mut moves = |bench: &Bench, ms: u64| {
        let now = Timestamp::from_secs_f64(1.0) + Duration::from_millis(ms);
        shown.moves(now, &bench.devices(&bench.robot), RESTS_AFTER)
    };
    assert!(!moves(&bench, 0));
    moving_arm(&mut bench);
    assert!(moves(&bench, 100));
    bench.robot.qd = [0.0; 6];
    bench.silent = true;
    assert!(moves(&bench, 60_000), "nothing is known of it");
    bench.silent = false;
    assert!(moves(&bench, 60_100), "one state at rest is the turning point of a hand");
    moving_arm(&mut bench);
    assert!(moves(&bench, 60_200));
    bench.robot.qd = [0.0; 6];
    assert!(moves(&bench, 60_300) && moves(&bench, 60_790) && !moves(&bench, 60_800));
}

/// What is requested of gripper and arm, in order; payloads in grams beside those of the gripper.
fn requested(actions: &[Action], gripper_kg: f64) -> Vec<String> {
    let word = |action: &Action| match action {
        Action::Gripper(GripperCommand::Grip { .. }) => Some("grip".to_string()),
        Action::Gripper(GripperCommand::Release { .. }) => Some("release".to_string()),
        Action::Robot(RobotCommand::SetPayload { mass_kg, .. }) => {
            Some(format!("payload {:.0} g", 1e3 * (mass_kg - gripper_kg)))
        }
        Action::Robot(RobotCommand::Stream(_)) => Some("path".to_string()),
        _ => None,
    };
    actions.iter().filter_map(word).collect()
}

#[test]
fn the_payload_is_that_of_what_counts_as_held_before_the_arm_moves_on() {
    let gripper_kg = model().grip.tool_mass;
    let mut bench = working();
    let arrived = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    assert_eq!(requested(&arrived, gripper_kg), ["grip", "payload 100 g"]);
    bench.vacuum = [0.6, 0.6];
    let gripped = bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
    assert_eq!(requested(&gripped, gripper_kg), ["path"]);
    let placed = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 2 }));
    assert_eq!(requested(&placed, gripper_kg), ["release", "payload 0 g"], "it stands on its place");
    bench.vacuum = [0.0, 0.0];
    let released = bench.feed(Input::Gripper(GripperEvent::Released));
    assert_eq!(requested(&released, gripper_kg), ["path"]);

    let mut bench = working();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    let failed = bench.feed(Input::Gripper(GripperEvent::GripFailed { vacuum: 0.05 }));
    assert_eq!(requested(&failed, gripper_kg), ["release", "payload 0 g"]);
    let released = bench.feed(Input::Gripper(GripperEvent::Released));
    assert_eq!(requested(&released, gripper_kg), ["path"]);
}

/// The pump goes on after a stop; whether anything hangs on the cups shows by its vacuum alone.
#[test]
fn a_grip_that_a_stop_cut_off_is_not_reported_as_held() {
    let unsealed = "a may hang on the cups: the grip did not seal";
    for (sealed, held) in [(true, "holds a"), (false, unsealed)] {
        let mut bench = working();
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
        bench.feed(order(Order::Abort));
        let vacuum = if sealed { 0.6 } else { 0.05 };
        bench.vacuum = [vacuum; 2];
        bench.feed(Input::Gripper(match sealed {
            true => GripperEvent::Gripped { vacuum },
            false => GripperEvent::GripFailed { vacuum },
        }));
        assert_eq!(bench.cell.status().held.as_deref(), Some(held));
        assert!(bench.cell.object_on_the_gripper().is_some() == sealed);
        // A vacuum that comes late holds it.
        bench.vacuum = [0.6; 2];
        bench.feed(Input::Gripper(GripperEvent::Reading { vacuum: [0.6; 2] }));
        assert_eq!(bench.cell.status().held.as_deref(), Some("holds a"));
    }
}

/// The plug was pulled while the cups closed: nothing is known of the grip, and the object may hang there.
#[test]
fn a_grip_that_ends_without_an_answer_counts_as_held() {
    let mut bench = working();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.feed(order(Order::Abort));
    bench.gripper_answers = false;
    bench.feed(Input::Gripper(GripperEvent::GripFailed { vacuum: 0.0 }));
    assert_eq!(bench.cell.status().held.as_deref(), Some("holds a"));
}
