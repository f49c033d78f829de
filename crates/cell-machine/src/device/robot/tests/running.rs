//! The program: start, nonce, heartbeat, streaming, deadlines, stops.

use super::{Rig, path};
use crate::device::program::Nonce;
use crate::device::robot::tests::HOME;
use crate::device::robot_types::{Link, ProgramEnd, Refused, RobotCommand, RobotEvent};
use cell_values::time::Duration;
use cell_values::units::Joints;

pub(super) fn turned(by: f64) -> Joints {
    let mut q = HOME;
    q.0[0] += by;
    q
}

#[test]
fn a_path_is_followed_segment_by_segment() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::SetPayload { mass_kg: 1.2, centre_of_gravity_m: [0.0, 0.01, 0.05] });
    rig.command(RobotCommand::SetTcp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]));
    rig.command(RobotCommand::Stream(path(HOME, 12)));
    rig.command(RobotCommand::Stream(path(turned(1.2), 2)));
    rig.run_ms(2000);
    assert_eq!(rig.events[..2], [RobotEvent::PayloadSet, RobotEvent::TcpSet]);
    let mut expected: Vec<RobotEvent> =
        (0..12).map(|index| RobotEvent::SegmentFinished { batch: 1, index }).collect();
    expected.push(RobotEvent::PathFinished { batch: 1 });
    expected.extend((0..2).map(|index| RobotEvent::SegmentFinished { batch: 2, index }));
    expected.push(RobotEvent::PathFinished { batch: 2 });
    assert_eq!(rig.events[2..], expected);
    let sequences: Vec<i32> = rig.fake.taken.iter().map(|(sequence, _)| *sequence).collect();
    assert_eq!(sequences, (1..=16).collect::<Vec<_>>());
    assert!(rig.robot.state().unwrap().q.max_difference(&turned(1.4)) < 1e-12);
}

#[test]
fn slicing_makes_no_difference_to_a_stream() {
    let mut rig = Rig::running();
    rig.slice = 5;
    rig.command(RobotCommand::Stream(path(HOME, 3)));
    rig.run_ms(400);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 1 }), "{:?}", rig.events);
}

#[test]
fn segments_are_on_the_robot_before_they_are_needed() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(60);
    assert_eq!(rig.fake.taken.len(), 8, "eight ahead while the first is under way");
    assert_eq!(rig.fake.out_int(26), 0);
}

#[test]
fn the_heartbeat_comes_every_20_ms_from_the_upload_on() {
    let mut rig = Rig::running();
    rig.fake.heartbeats.clear();
    rig.run_ms(1000);
    let beats = &rig.fake.heartbeats;
    assert!((49..=51).contains(&beats.len()), "{}", beats.len());
    assert!(beats.windows(2).all(|pair| pair[1].since(pair[0]) <= Duration::from_millis(22)));
    rig.command(RobotCommand::EndProgram);
    rig.run_ms(50);
    rig.fake.heartbeats.clear();
    rig.run_ms(200);
    assert_eq!(rig.fake.heartbeats, []);
}

#[test]
fn old_numbers_in_the_registers_are_gone_on_from() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 3)));
    rig.run_ms(400);
    rig.command(RobotCommand::EndProgram);
    rig.run_ms(50);
    assert_eq!(rig.ended().unwrap(), "ended as asked");
    rig.events.clear();
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(8) });
    rig.run_ms(50);
    rig.command(RobotCommand::Stream(path(turned(0.3), 1)));
    rig.run_ms(200);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 2 }), "{:?}", rig.events);
    assert_eq!(rig.fake.taken.last().unwrap().0, 5);
}

#[test]
fn nothing_is_streamed_unless_everything_holds() {
    let mut rig = Rig::ready();
    let refused =
        |rig: &mut Rig| rig.robot.command(rig.now, RobotCommand::Stream(path(HOME, 1))).unwrap_err();
    assert_eq!(refused(&mut rig), Refused::NoProgram);
    let mut rig = Rig::running();
    let elsewhere = RobotCommand::Stream(path(turned(0.05), 1));
    let wrong = rig.robot.command(rig.now, elsewhere).unwrap_err();
    assert!(matches!(wrong, Refused::WrongStart { difference_rad } if (difference_rad - 0.05).abs() < 1e-9));
    rig.fake.runtime_state = 4;
    rig.run_ms(4);
    assert_eq!(refused(&mut rig), Refused::Busy("the program is paused"));
    rig.fake.runtime_state = 2;
    rig.run_ms(4);
    rig.fake.mute_rtde = true;
    rig.run_ms(120);
    assert_eq!(refused(&mut rig), Refused::Stale);
    let mut rig = Rig::running();
    rig.fake.remote = false;
    rig.run_ms(1500);
    assert_eq!(refused(&mut rig), Refused::LocalMode);
    for (mass_kg, cog) in [(f64::NAN, 0.0), (9.0, 0.0), (-0.1, 0.0), (1.0, f64::INFINITY)] {
        let mut rig = Rig::running();
        let command = RobotCommand::SetPayload { mass_kg, centre_of_gravity_m: [0.0, cog, 0.0] };
        assert!(matches!(rig.robot.command(rig.now, command), Err(Refused::BadNumber { .. })));
    }
}

#[test]
fn a_path_waits_for_the_payload_to_be_reported_and_not_for_ever() {
    let mut rig = Rig::running();
    rig.fake.wrong_payload = true;
    rig.command(RobotCommand::SetPayload { mass_kg: 2.0, centre_of_gravity_m: [0.0; 3] });
    rig.command(RobotCommand::Stream(path(HOME, 1)));
    rig.run_ms(900);
    assert_eq!(rig.fake.taken.len(), 1, "no motion with a wrong payload");
    rig.run_ms(300);
    assert!(rig.ended().unwrap().contains("payload reads 0.000 kg"), "{:?}", rig.ended());
}

#[test]
fn no_path_begins_on_an_old_answer_about_remote_control() {
    for (answers, taken) in [(true, 1), (false, 0)] {
        let mut rig = Rig::running();
        rig.run_ms(100);
        rig.fake.mute_dashboard = !answers;
        rig.run_ms(1700);
        rig.command(RobotCommand::Stream(path(HOME, 1)));
        rig.run_ms(100);
        assert_eq!((rig.fake.taken.len(), rig.ended()), (taken, None), "answers: {answers}");
    }
}

#[test]
fn an_old_program_is_stopped_first() {
    let mut rig = Rig::ready();
    rig.fake.runtime_state = 2;
    rig.run_ms(4);
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
    rig.run_ms(50);
    assert!(rig.fake.dashboard_lines.contains(&"stop".to_string()));
    assert!(rig.saw(&RobotEvent::ProgramRunning { nonce: Nonce::new(3) }), "{:?}", rig.events);
}

#[test]
fn a_program_that_does_not_show_its_nonce_does_not_run() {
    for foreign_program_plays in [false, true] {
        let mut rig = Rig::ready();
        rig.fake.set_out(24, 999);
        rig.fake.ignore_uploads = true;
        rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
        if foreign_program_plays {
            rig.fake.runtime_state = 2;
        }
        rig.run_ms(5100);
        assert!(rig.ended().unwrap().contains("identify itself"), "{:?}", rig.events);
        assert!(!rig.events.iter().any(|event| matches!(event, RobotEvent::ProgramRunning { .. })));
    }
}

#[test]
fn a_program_that_fails_is_reported_with_its_line() {
    let mut rig = Rig::ready();
    rig.fake.fail_uploads = true;
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
    rig.run_ms(10);
    assert!(rig.saw(&RobotEvent::RuntimeException { line: 3, column: 9, text: "no".into() }));
    assert!(rig.ended().unwrap().contains("line 3"), "{:?}", rig.events);
}

#[test]
fn a_read_only_link_is_made_anew_once() {
    let mut rig = Rig::ready();
    rig.fake.read_only_uploads = 1;
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
    rig.run_ms(300);
    assert!(rig.saw(&RobotEvent::ProgramRunning { nonce: Nonce::new(3) }), "{:?}", rig.events);
    assert_eq!(rig.fake.uploads.len(), 2);
    let mut rig = Rig::ready();
    rig.fake.read_only_uploads = 9;
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
    rig.run_ms(1000);
    assert!(rig.ended().unwrap().contains("C210"), "{:?}", rig.events);
    assert_eq!(rig.fake.uploads.len(), 2);
}

#[test]
fn stop_stops_and_ends_the_program() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(130);
    rig.events.clear();
    rig.command(RobotCommand::Stop);
    rig.run_ms(10);
    let ended = RobotEvent::ProgramEnded { reason: ProgramEnd::StoppedByUs };
    assert_eq!(rig.events, [RobotEvent::Stopped, ended]);
    assert_eq!(rig.fake.taken.last().unwrap().1, 5);
    let count = rig.fake.taken.len();
    rig.run_ms(1000);
    assert_eq!(rig.fake.taken.len(), count);
    let refused = rig.robot.command(rig.now, RobotCommand::Stream(path(HOME, 1))).unwrap_err();
    assert_eq!(refused, Refused::NoProgram);
}

#[test]
fn a_stop_is_over_when_the_program_is_gone_and_not_when_the_arm_is_at_rest() {
    let mut rig = Rig::running();
    rig.fake.stays_after_its_stop = true;
    rig.command(RobotCommand::Stop);
    rig.run_ms(1900);
    assert!(!rig.saw(&RobotEvent::Stopped), "the program could go on: {:?}", rig.events);
    rig.run_ms(300);
    assert!(rig.fake.dashboard_lines.contains(&"stop".to_string()));
    assert!(rig.saw(&RobotEvent::Stopped), "{:?}", rig.events);
}

#[test]
fn a_paused_program_of_an_earlier_daemon_finds_a_stop_in_its_registers() {
    let mut rig = Rig::ready();
    rig.drop_link(Link::Rtde);
    for (number, value) in [(24, 4711), (25, 7), (26, 6), (27, 1)] {
        rig.fake.set_out(number, value);
    }
    rig.fake.runtime_state = 4;
    rig.connect(Link::Rtde);
    rig.run_ms(200);
    assert_eq!(rig.fake.opcode(), 5, "in its first frame after play");
    assert!(!rig.fake.dashboard_lines.contains(&"stop".to_string()), "it may be a program of others");
}

#[test]
fn a_stop_that_the_program_does_not_receive_goes_to_the_dashboard_and_to_silence() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(50);
    rig.fake.deaf_program = true;
    rig.command(RobotCommand::Stop);
    rig.run_ms(1900);
    assert!(!rig.saw(&RobotEvent::Stopped));
    rig.run_ms(300);
    assert!(rig.saw(&RobotEvent::Stopped), "{:?}", rig.events);
    assert!(rig.fake.dashboard_lines.contains(&"stop".to_string()));
    let mut rig = Rig::running();
    rig.fake.answers.insert("stop".into(), "Failed to execute: stop".into());
    rig.fake.deaf_program = true;
    rig.command(RobotCommand::Stop);
    rig.run_ms(2100);
    rig.fake.heartbeats.clear();
    rig.run_ms(3100);
    assert_eq!(rig.fake.heartbeats, [], "silence is the last way to stop");
    assert!(rig.refusals().iter().any(|text| text.contains("no sign")), "{:?}", rig.refusals());
}

#[test]
fn stop_is_taken_in_every_state() {
    let mut rig = Rig::ready();
    rig.command(RobotCommand::Stop);
    assert!(rig.saw(&RobotEvent::Stopped), "nothing runs");
    let mut rig = Rig::ready();
    rig.fake.runtime_state = 2;
    rig.run_ms(4);
    rig.command(RobotCommand::Stop);
    rig.run_ms(10);
    assert!(rig.saw(&RobotEvent::Stopped), "a foreign program");
    let mut rig = Rig::ready();
    rig.drop_link(Link::Rtde);
    rig.command(RobotCommand::Stop);
    rig.run_ms(10);
    assert!(!rig.saw(&RobotEvent::Stopped), "the dashboard's word says nothing of the arm");
    let mut rig = Rig::ready();
    rig.fake.ignore_uploads = true;
    rig.command(RobotCommand::StartProgram { nonce: Nonce::new(3) });
    rig.command(RobotCommand::Stop);
    rig.run_ms(10);
    assert!(rig.saw(&RobotEvent::Stopped), "while it starts");
    let mut rig = Rig::running();
    rig.fake.runtime_state = 4;
    rig.run_ms(4);
    rig.command(RobotCommand::Stop);
    rig.run_ms(10);
    assert!(rig.saw(&RobotEvent::Stopped), "a paused program does not read registers");
}

#[test]
fn a_safety_stop_ends_the_program_and_is_not_acknowledged() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(50);
    rig.fake.safety_mode = 3;
    rig.fake.runtime_state = 4;
    rig.run_ms(20);
    assert!(rig.saw(&RobotEvent::Stopped) && rig.saw(&RobotEvent::Paused), "{:?}", rig.events);
    assert_eq!(rig.ended().unwrap(), "stopped by celld");
    rig.run_ms(10_000);
    let acknowledged =
        rig.fake.dashboard_lines.iter().any(|line| line.contains("unlock") || line.contains("popup"));
    assert!(!acknowledged, "a person's work");
}

#[test]
fn a_pause_suspends_deadlines() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 2)));
    rig.run_ms(50);
    rig.fake.runtime_state = 4;
    rig.run_ms(60_000);
    assert!(rig.saw(&RobotEvent::Paused) && rig.ended().is_none(), "{:?}", rig.events);
    rig.fake.runtime_state = 2;
    rig.run_ms(300);
    assert!(rig.saw(&RobotEvent::Resumed) && rig.saw(&RobotEvent::PathFinished { batch: 1 }));
}

#[test]
fn deadlines_stretch_with_the_speed_and_still_end() {
    for (scaling, done_ms) in [(1.0, 6_000), (0.25, 24_000)] {
        let mut rig = Rig::running();
        rig.fake.speed_scaling = scaling;
        rig.fake.segment_frames = u32::MAX;
        rig.command(RobotCommand::Stream(path(HOME, 2)));
        rig.run_ms(done_ms / 4);
        assert_eq!(rig.ended(), None, "at {scaling}");
        rig.run_ms(done_ms);
        assert!(rig.ended().unwrap().contains("part 1 of the motion"), "{:?}", rig.ended());
    }
}

#[test]
fn a_command_that_is_not_taken_is_overdue() {
    let mut rig = Rig::running();
    rig.fake.deaf_program = true;
    rig.command(RobotCommand::Stream(path(HOME, 1)));
    rig.run_ms(700);
    assert!(rig.ended().is_some(), "{:?}", rig.events);
    assert!(!rig.faults().is_empty() || rig.ended().unwrap().contains("echo"));
}

#[test]
fn a_program_that_ends_by_itself_is_noticed() {
    let mut rig = Rig::running();
    rig.fake.end_program();
    rig.run_ms(4);
    assert!(rig.ended().unwrap().contains("outside"));
    let mut rig = Rig::running();
    rig.fake.set_out(24, 4711);
    rig.run_ms(4);
    assert_eq!(rig.ended().unwrap(), "another program took over");
    let mut rig = Rig::running();
    rig.fake.set_out(27, 2);
    rig.fake.end_program();
    rig.run_ms(4);
    assert!(rig.ended().unwrap().contains("heartbeat"));
    let mut rig = Rig::running();
    rig.fake.set_out(27, 3);
    rig.run_ms(20);
    assert_eq!(rig.ended().unwrap(), "the robot refused command 1");
    let mut rig = Rig::running();
    rig.fake.set_out(27, 77);
    rig.run_ms(20);
    assert!(rig.ended().unwrap().contains("77"));
}

#[test]
fn numbers_the_program_cannot_have_are_a_fault() {
    let mut rig = Rig::running();
    rig.fake.set_out(26, -5);
    rig.run_ms(20);
    assert!(rig.ended().unwrap().contains("finished") || !rig.faults().is_empty(), "{:?}", rig.events);
    let mut rig = Rig::running();
    rig.fake.set_out(25, 12);
    rig.fake.deaf_program = true;
    rig.run_ms(20);
    assert!(rig.faults()[0].contains("12"), "{:?}", rig.faults());
}

#[test]
fn a_lost_link_voids_the_program() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(50);
    rig.drop_link(Link::Rtde);
    assert!(rig.ended().unwrap().contains("RTDE"), "{:?}", rig.events);
    rig.connect(Link::Rtde);
    let taken = rig.fake.taken.len();
    rig.run_ms(1000);
    assert_eq!(rig.fake.taken.len(), taken, "nothing is sent to a program that was given up");
    assert_eq!(rig.fake.program, None);
}

#[test]
fn the_programs_watchdog_sees_a_dead_pc() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    for _ in 0..150 {
        rig.now += Duration::from_millis(2);
        rig.fake.frame(rig.now);
    }
    assert_eq!((rig.fake.program, rig.fake.out_int(27)), (None, 2));
}

#[test]
fn commands_held_back_for_long_end_the_program() {
    let mut rig = Rig::running();
    rig.reconnect = None;
    rig.command(RobotCommand::Stream(path(HOME, 20)));
    rig.run_ms(50);
    rig.drop_link(Link::Dashboard);
    rig.run_ms(4500);
    assert_eq!(
        (rig.fake.taken.len(), rig.ended()),
        (8, None),
        "remote control is unknown: nothing more goes out"
    );
    rig.run_ms(600);
    assert!(rig.refusals().is_empty());
    rig.run_ms(3000);
    assert!(rig.ended().unwrap().contains("remote control"), "{:?}", rig.events);
}

#[test]
fn a_pc_that_was_held_up_reads_first_and_reports_no_fault() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 6)));
    rig.run_ms(50);
    // Longer than a state may be old, shorter than the robot's own watchdog: states pile up in the socket.
    for _ in 0..75 {
        rig.now += crate::device::robot::tests::FRAME;
        rig.fake.frame(rig.now);
    }
    assert!(!rig.robot.fresh(rig.now));
    rig.take_arrived();
    rig.robot.tick(rig.now);
    assert!(rig.robot.fresh(rig.now), "what had arrived counts");
    rig.run_ms(700);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 1 }), "{:?}", rig.events);
    assert_eq!((rig.ended(), rig.faults()), (None, vec![]));
}

#[test]
fn a_pc_that_finds_nothing_after_it_was_held_up_trusts_nothing_old() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 6)));
    rig.run_ms(50);
    rig.now += Duration::from_millis(700);
    rig.robot.tick(rig.now);
    rig.exchange();
    assert!(!rig.robot.fresh(rig.now), "{:?}", rig.events);
    let path = RobotCommand::Stream(path(HOME, 1));
    assert_eq!(rig.robot.command(rig.now, path), Err(Refused::Stale));
}

/// Paused in the middle of a path, and no dashboard to end the program by.
fn paused_without_dashboard() -> Rig {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 12)));
    rig.run_ms(60);
    rig.fake.runtime_state = 4;
    rig.run_ms(20);
    rig.drop_link(Link::Dashboard);
    rig
}

#[test]
fn a_paused_program_that_cannot_be_ended_finds_a_stop_in_its_registers() {
    let mut rig = paused_without_dashboard();
    rig.command(RobotCommand::Stop);
    rig.run_ms(20);
    assert_eq!(rig.fake.opcode(), 5, "the program reads it in the first frame after play");
}

#[test]
fn a_paused_program_that_was_left_behind_is_stopped_when_the_link_is_back() {
    let mut rig = paused_without_dashboard();
    rig.drop_link(Link::Rtde);
    assert!(rig.ended().is_some(), "{:?}", rig.events);
    assert_ne!(rig.fake.opcode(), 5);
    for _ in 0..2 {
        rig.connect(Link::Rtde);
        rig.run_ms(200);
        assert_eq!(rig.fake.opcode(), 5, "as long as it has not been seen to end");
        rig.drop_link(Link::Rtde);
        rig.fake.clear_inputs();
    }
}

#[test]
fn a_stop_takes_back_what_was_wanted_of_power_and_brakes() {
    let mut rig = Rig::ready();
    rig.fake.robot_mode = 3;
    for (line, reply) in [("power on", "Powering on"), ("power off", "Powering off")] {
        rig.fake.answers.insert(line.into(), reply.into());
    }
    rig.run_ms(4);
    rig.command(RobotCommand::PowerOn);
    rig.fake.robot_mode = 4;
    rig.command(RobotCommand::Stop);
    rig.run_ms(100);
    assert!(rig.fake.dashboard_lines.contains(&"power off".to_string()), "{:?}", rig.fake.dashboard_lines);
    assert!(!rig.robot.arm_settled(), "it boots");
    rig.fake.robot_mode = 3;
    rig.run_ms(900);
    assert!(!rig.robot.arm_settled(), "it may be a state from before");
    rig.run_ms(200);
    assert!(rig.robot.arm_settled());
    rig.run_ms(31_000);
    assert!(!rig.events.iter().any(|event| matches!(event, RobotEvent::Refused { .. })), "{:?}", rig.events);
}

#[test]
fn a_stop_in_the_same_turn_takes_back_the_line_before_it_is_sent() {
    let mut rig = Rig::ready();
    rig.fake.robot_mode = 5;
    rig.fake.answers.insert("brake release".into(), "Brake releasing".into());
    rig.run_ms(4);
    rig.robot.command(rig.now, RobotCommand::ReleaseBrakes).expect("it is connected");
    rig.command(RobotCommand::Stop);
    rig.run_ms(2_000);
    let sent = |line: &str| rig.fake.dashboard_lines.iter().filter(|sent| *sent == line).count();
    assert_eq!((sent("brake release"), sent("power off")), (0, 0), "{:?}", rig.fake.dashboard_lines);
    assert!(sent("robotmode") > 1, "the session goes on: {:?}", rig.fake.dashboard_lines);
}

#[test]
fn power_that_cannot_be_taken_back_is_waited_for() {
    let mut rig = Rig::ready();
    rig.fake.robot_mode = 5;
    rig.fake.answers.insert("brake release".into(), "Brake releasing".into());
    rig.run_ms(4);
    rig.command(RobotCommand::ReleaseBrakes);
    rig.drop_link(Link::Dashboard);
    rig.command(RobotCommand::Stop);
    rig.run_ms(1000);
    let lost = rig.robot.arm_settled();
    rig.fake.robot_mode = 7;
    rig.run_ms(13_000);
    assert!(!lost && !rig.robot.arm_settled(), "the brakes may open");
    rig.run_ms(2_000);
    assert!(rig.robot.arm_settled());
}

#[test]
fn power_is_taken_back_however_late_and_never_from_an_arm_that_works() {
    let power_off = |rig: &Rig| rig.fake.dashboard_lines.contains(&"power off".to_string());
    let mut rig = Rig::ready();
    rig.fake.robot_mode = 3;
    rig.fake.answers.insert("power on".into(), "Powering on".into());
    rig.run_ms(4);
    rig.command(RobotCommand::PowerOn);
    rig.run_ms(31_000);
    rig.command(RobotCommand::Stop);
    rig.run_ms(20);
    assert!(power_off(&rig), "a controller that boots for a minute would power the arm then");

    let mut rig = Rig::ready();
    rig.fake.robot_mode = 5;
    rig.fake.answers.insert("brake release".into(), "Brake releasing".into());
    rig.run_ms(4);
    rig.command(RobotCommand::ReleaseBrakes);
    rig.drop_link(Link::Dashboard);
    rig.fake.robot_mode = 7;
    rig.run_ms(20);
    rig.connect(Link::Dashboard);
    rig.run_ms(200);
    rig.command(RobotCommand::Stop);
    rig.run_ms(200);
    assert!(!power_off(&rig), "it may be braking with an object in the hand");
}
