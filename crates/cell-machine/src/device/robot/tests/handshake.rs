//! Links: handshakes, refusals, slicing, losses, malformed and unknown values.

use super::{Rig, path};
use crate::device::registers::{self, mark_of};
use crate::device::robot::tests::HOME;
use crate::device::robot_types::{InputsTaken, Link, Refused, RobotCommand, RobotEvent};
use ur_wire::enumerations::{RobotMode, SafetyMode};
use ur_wire::rtde_values::Value;
use ur_wire::rtde_variables::Register;

#[test]
fn all_links_come_up_and_identify_the_robot() {
    let mut rig = Rig::ready();
    let identity = RobotEvent::Identity {
        serial: "20235500001".into(),
        model: "UR5".into(),
        version: "URSoftware 5.20.0.1 (Jan 01 2025)".into(),
    };
    assert!(rig.saw(&identity));
    assert!(rig.saw(&RobotEvent::RemoteControl { on: true }));
    assert!(rig.saw(&RobotEvent::Mode { mode: RobotMode::Running }));
    assert!(rig.saw(&RobotEvent::Safety { mode: SafetyMode::Normal }));
    assert!(
        rig.events
            .iter()
            .any(|e| matches!(e, RobotEvent::Kinematics { checksum, .. } if *checksum == [9; 6]))
    );
    let state = rig.robot.state().unwrap();
    assert_eq!((state.q, state.remote_control), (HOME, Some(true)));
    assert!(rig.robot.fresh(rig.now));
    rig.events.clear();
    rig.run_ms(3000);
    assert_eq!(rig.events, [], "a quiet robot is a quiet session");
    let requested = rig.fake.dashboard_lines.iter().filter(|line| *line == "is in remote control").count();
    assert!((3..=4).contains(&requested), "remote control is polled each second, was {requested} times");
}

#[test]
fn slicing_makes_no_difference() {
    for slice in [1, 2, 3, 7, 100] {
        let mut rig = Rig::new();
        rig.slice = slice;
        rig.connect_all();
        rig.run_ms(150);
        assert!(rig.saw(&RobotEvent::RtdeReady), "slices of {slice}");
        assert_eq!(rig.faults(), [""; 0], "slices of {slice}");
        assert!(
            rig.robot.state().is_some_and(|state| state.remote_control == Some(true)),
            "slices of {slice}"
        );
    }
}

#[test]
fn a_link_cut_anywhere_in_the_handshake_is_made_again() {
    for cut_after_ms in (2..60).step_by(2) {
        for link in Link::ALL {
            let mut rig = Rig::new();
            rig.connect_all();
            rig.run_ms(cut_after_ms);
            rig.drop_link(link);
            rig.run_ms(20);
            rig.connect(link);
            rig.run_ms(200);
            assert!(rig.robot.fresh(rig.now), "{link} cut after {cut_after_ms} ms: {:?}", rig.events);
            assert_eq!(rig.faults(), [""; 0]);
        }
    }
}

#[test]
fn registers_in_use_are_named_and_requested_again() {
    let mut rig = Rig::new();
    rig.fake.in_use = vec!["input_int_register_25".into(), "input_double_register_30".into()];
    rig.connect_all();
    rig.run_ms(100);
    let taken = InputsTaken { names: rig.fake.in_use.clone(), celld: None };
    assert!(!rig.saw(&RobotEvent::InputInUse { taken: taken.clone(), attempt: 1 }), "no owner yet");
    rig.run_ms(500);
    assert!(rig.saw(&RobotEvent::InputInUse { taken, attempt: 1 }), "{:?}", rig.events);
    rig.run_ms(3500);
    rig.fake.in_use.clear();
    assert!(!rig.saw(&RobotEvent::RtdeReady));
    rig.run_ms(1500);
    assert!(rig.saw(&RobotEvent::RtdeReady));
}

#[test]
fn the_celld_that_holds_the_registers_is_named_by_its_mark() {
    let mut rig = Rig::new();
    rig.fake.in_use = vec!["input_int_register_27".into()];
    let mark = |rig: &mut Rig, turn| {
        let value = Value::Int32(mark_of(4711, turn));
        rig.fake.registers.insert(Register::InputInt(registers::OWNER), value);
    };
    mark(&mut rig, false);
    rig.connect_all();
    rig.run_ms(100);
    assert!(rig.events.iter().all(|event| !matches!(event, RobotEvent::InputInUse { .. })), "not yet");
    mark(&mut rig, true);
    rig.run_ms(100);
    let taken = InputsTaken { names: rig.fake.in_use.clone(), celld: Some(4711) };
    assert!(taken.to_string().contains("another celld drives this robot (process 4711"), "{taken}");
    assert!(rig.saw(&RobotEvent::InputInUse { taken, attempt: 1 }), "{:?}", rig.events);
    rig.fake.in_use.clear();
    rig.run_ms(6000);
    assert!(rig.saw(&RobotEvent::RtdeReady));
    let marks: Vec<_> = (0..2)
        .map(|_| {
            rig.run_ms(160);
            rig.fake.registers.get(&Register::InputInt(registers::OWNER)).cloned()
        })
        .collect();
    let own = [false, true].map(|turn| Some(Value::Int32(mark_of(1, turn))));
    assert!(marks[0] != marks[1] && marks.iter().all(|mark| own.contains(mark)), "{marks:?}");
}

#[test]
fn registers_in_use_for_long_drop_the_link_with_their_names() {
    let mut rig = Rig::new();
    rig.reconnect = None;
    rig.fake.in_use = vec!["input_int_register_27".into()];
    rig.connect_all();
    rig.run_ms(20_000);
    let faults = rig.faults();
    assert!(faults.len() == 1 && faults[0].contains("input_int_register_27"), "{faults:?}");
    assert!(!rig.up.contains(&Link::Rtde));
}

#[test]
fn a_missing_variable_is_named() {
    let mut rig = Rig::new();
    rig.reconnect = None;
    rig.fake.not_found = vec!["payload_cog".into()];
    rig.connect_all();
    rig.run_ms(100);
    assert!(rig.faults()[0].contains("payload_cog"), "{:?}", rig.faults());
}

#[test]
fn silence_in_the_handshake_ends_it() {
    let mut rig = Rig::new();
    rig.reconnect = None;
    rig.fake.mute_rtde = true;
    rig.fake.mute_dashboard = true;
    rig.connect_all();
    rig.run_ms(11_000);
    let faults = rig.faults();
    assert!(faults.iter().any(|fault| fault.contains("protocol version")), "{faults:?}");
    assert!(faults.iter().any(|fault| fault.contains("greeting")), "{faults:?}");
    assert_eq!(rig.up, [Link::Primary]);
}

#[test]
fn silence_on_a_standing_link_ends_it() {
    let mut rig = Rig::ready();
    rig.reconnect = None;
    rig.fake.mute_rtde = true;
    rig.run_ms(90);
    assert!(rig.robot.fresh(rig.now));
    rig.run_ms(20);
    assert!(!rig.robot.fresh(rig.now), "stale after 100 ms");
    rig.run_ms(3000);
    assert!(rig.saw(&RobotEvent::RtdeLost) && rig.robot.state().is_none());
    rig.fake.mute_dashboard = true;
    rig.fake.mute_primary = true;
    rig.run_ms(4000);
    assert_eq!(rig.up, []);
}

#[test]
fn a_controller_with_old_software_is_refused_by_the_names_of_what_it_lacks() {
    let mut rig = Rig::new();
    rig.fake.software = [5, 5];
    rig.connect_all();
    rig.run_ms(500);
    let faults = rig.faults();
    let words = "controller software 5.5 is too old: celld needs 5.6 or later (`is in remote control`";
    assert!(faults.iter().any(|fault| fault.contains(words)), "{faults:?}");
    assert!(!rig.saw(&RobotEvent::RtdeReady), "it is not used");
}

#[test]
fn a_controller_whose_time_stands_still_is_stale() {
    let mut rig = Rig::ready();
    rig.fake.frozen_time = true;
    rig.run_ms(110);
    assert!(rig.robot.state().is_some() && !rig.robot.fresh(rig.now));
}

#[test]
fn a_controller_that_restarts_is_noticed_and_not_believed_at_once() {
    let mut rig = Rig::ready();
    rig.fake.time_s = 3.0;
    rig.run_ms(2);
    assert!(rig.faults()[0].contains("restarted"), "{:?}", rig.faults());
    rig.events.clear();
    rig.run_ms(1000);
    assert!(!rig.saw(&RobotEvent::RtdeReady), "its RTDE service restarts once more while it boots");
    rig.run_ms(2000);
    assert!(rig.saw(&RobotEvent::RtdeReady));
}

#[test]
fn a_number_that_is_none_drops_the_link() {
    let mut rig = Rig::ready();
    rig.reconnect = None;
    rig.fake.nan_in_q = true;
    rig.run_ms(4);
    assert!(rig.faults()[0].contains("actual_q"), "{:?}", rig.faults());
    assert!(rig.saw(&RobotEvent::RtdeLost) && !rig.up.contains(&Link::Rtde));
}

#[test]
fn unknown_modes_are_faults_and_forbid_motion() {
    let mut rig = Rig::running();
    rig.fake.safety_mode = 99;
    rig.run_ms(4);
    assert!(rig.saw(&RobotEvent::Safety { mode: SafetyMode::Unknown(99) }));
    assert!(rig.faults()[0].contains("99"), "{:?}", rig.faults());
    assert!(rig.up.contains(&Link::Rtde), "a new link would show the same number");
    rig.run_ms(100);
    assert_eq!(rig.ended().unwrap(), "stopped by celld");
    let refused = rig.robot.command(rig.now, RobotCommand::Stream(path(HOME, 1))).unwrap_err();
    assert_eq!(refused, Refused::SafetyMode(SafetyMode::Unknown(99)));
}

#[test]
fn faults_are_counted_within_a_minute() {
    let mut rig = Rig::ready();
    for expected in 1..=3 {
        rig.fake.send(Link::Rtde, vec![0, 1, 85]);
        rig.run_ms(1000);
        let last = rig.events.iter().rev().find_map(|event| match event {
            RobotEvent::ProtocolFault { link: Link::Rtde, recent, .. } => Some(*recent),
            _ => None,
        });
        assert_eq!(last, Some(expected));
        assert!(rig.robot.fresh(rig.now), "it comes back each time");
    }
    rig.run_ms(61_000);
    rig.fake.send(Link::Primary, vec![0xff; 8]);
    rig.run_ms(4);
    assert!(
        matches!(rig.events.last(), Some(RobotEvent::ProtocolFault { recent: 1, .. })),
        "{:?}",
        rig.events.last()
    );
}

#[test]
fn a_switch_of_remote_control_makes_dashboard_and_primary_anew() {
    let mut rig = Rig::ready();
    rig.fake.remote = false;
    rig.run_ms(1100);
    assert!(rig.saw(&RobotEvent::RemoteControl { on: false }));
    let refused = rig.robot.command(rig.now, RobotCommand::CloseSafetyPopup).unwrap_err();
    assert_eq!(refused, Refused::LocalMode);
    rig.events.clear();
    let greetings = rig.fake.dashboard_lines.iter().filter(|line| *line == "get robot model").count();
    rig.fake.remote = true;
    rig.run_ms(2500);
    assert!(rig.saw(&RobotEvent::RemoteControl { on: true }), "{:?}", rig.events);
    let after = rig.fake.dashboard_lines.iter().filter(|line| *line == "get robot model").count();
    assert_eq!(after, greetings + 1, "made anew once");
    assert!(rig.events.iter().any(|event| matches!(event, RobotEvent::Kinematics { .. })));
}

#[test]
fn power_and_brakes_are_done_when_the_modes_say_so() {
    let mut rig = Rig::ready();
    rig.fake.robot_mode = 3;
    rig.run_ms(4);
    rig.command(RobotCommand::PowerOn);
    assert!(!rig.saw(&RobotEvent::Completed { what: "power on".into() }), "accepted is not done");
    rig.run_ms(4);
    assert!(rig.saw(&RobotEvent::Completed { what: "power on".into() }));
    rig.command(RobotCommand::ReleaseBrakes);
    rig.run_ms(4);
    assert!(rig.saw(&RobotEvent::Completed { what: "brake release".into() }));
    rig.events.clear();
    rig.command(RobotCommand::PowerOn);
    assert_eq!(rig.events, [RobotEvent::Completed { what: "power on".into() }], "idempotent");
}

#[test]
fn what_the_dashboard_refuses_or_leaves_undone_is_reported() {
    let mut rig = Rig::ready();
    rig.fake.safety_mode = 3;
    rig.run_ms(4);
    let early = "Cannot unlock protective stop until 5s after occurrence.";
    rig.fake.answers.insert("unlock protective stop".into(), early.into());
    rig.command(RobotCommand::UnlockProtectiveStop);
    assert_eq!(rig.refusals(), [format!("unlock protective stop: {early}")]);
    rig.fake.answers.insert("unlock protective stop".into(), "Protective stop releasing".into());
    rig.events.clear();
    rig.command(RobotCommand::UnlockProtectiveStop);
    rig.run_ms(31_000);
    assert!(rig.refusals()[0].contains("not done in time"), "{:?}", rig.refusals());
}

#[test]
fn a_dashboard_answer_that_cannot_be_read_drops_the_link() {
    let mut rig = Rig::ready();
    rig.fake.answers.insert("is in remote control".into(), "perhaps".into());
    rig.run_ms(1100);
    assert!(rig.faults()[0].contains("perhaps"), "{:?}", rig.faults());
    assert!(rig.robot.state().unwrap().remote_control.is_none(), "nobody knows");
}
