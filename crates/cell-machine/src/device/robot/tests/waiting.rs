//! Ways to a waiting place: where they end, and what goes on from them.

use super::running::turned;
use super::{Rig, path};
use crate::device::robot::tests::HOME;
use crate::device::robot_types::{RobotCommand, RobotEvent};

/// A way that goes on in another ends where that one does, and nowhere before.
#[test]
fn a_way_to_a_waiting_place_ends_there_unless_another_follows() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::SetOut(path(HOME, 2)));
    rig.run_ms(5);
    rig.command(RobotCommand::Stream(path(turned(0.2), 1)));
    rig.run_ms(400);
    assert!(!rig.saw(&RobotEvent::PathFinished { batch: 1 }), "{:?}", rig.events);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 2 }), "{:?}", rig.events);
    rig.command(RobotCommand::SetOut(path(turned(0.3), 2)));
    rig.run_ms(400);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 3 }), "{:?}", rig.events);
    assert_eq!(rig.fake.options, [0, 3, 1, 0, 3], "only the last segment may be left out");
}

#[test]
fn the_only_segment_of_a_waiting_path_is_never_skipped() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::SetOut(path(HOME, 1)));
    rig.run_ms(5);
    rig.command(RobotCommand::Stream(path(turned(0.1), 1)));
    rig.run_ms(400);
    assert!(!rig.saw(&RobotEvent::PathFinished { batch: 1 }), "{:?}", rig.events);
    assert!(rig.saw(&RobotEvent::PathFinished { batch: 2 }), "{:?}", rig.events);
    assert_eq!(rig.fake.options, [1, 1]);
}

/// As no path begins on one.
#[test]
fn a_way_to_a_waiting_place_is_not_gone_on_from_on_an_old_answer() {
    for (answers, taken) in [(true, 3), (false, 2)] {
        let mut rig = Rig::running();
        rig.fake.segment_frames = 2000;
        rig.command(RobotCommand::SetOut(path(HOME, 2)));
        rig.run_ms(50);
        rig.fake.mute_dashboard = !answers;
        rig.run_ms(1700);
        rig.command(RobotCommand::Stream(path(turned(0.2), 1)));
        rig.run_ms(100);
        assert_eq!((rig.fake.taken.len(), rig.ended()), (taken, None), "answers: {answers}");
    }
}
