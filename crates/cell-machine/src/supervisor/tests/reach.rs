//! What an armed cell does when orders do not reach it, and when celld itself was held up.

use super::faults::working;
use super::*;
use crate::code::Code;
use crate::device::gripper_types::{Channels, GripperEvent};
use crate::intake::Unreachable;

impl Bench {
    /// Approves the plan that was made last.
    pub(super) fn approval(&self) -> Order {
        Order::Approve { id: "j".into(), plan: self.cell.last_plan() }
    }
}

fn gone() -> Input {
    Input::OrdersReach(Some(Unreachable::FolderGone("commands".into())))
}

fn stops(all: &[Action]) -> bool {
    all.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop)))
}

/// No action switches the vacuum off, so a held object stays held.
fn keeps_the_vacuum(all: &[Action]) -> bool {
    !all.iter().any(|action| matches!(action, Action::Gripper(GripperCommand::Release { .. })))
}

#[test]
fn a_carrying_cell_that_orders_do_not_reach_stops_disarms_and_keeps_what_it_holds() {
    for input in [gone(), Input::HeldUp(Duration::from_secs(20))] {
        let mut bench = working();
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
        bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
        bench.vacuum = [0.6, 0.0];
        let all = bench.feed(input.clone());
        assert!(stops(&all) && keeps_the_vacuum(&all), "{input:?}: {all:?}");
        let status = bench.cell.status();
        assert!(!status.armed && status.held.is_some(), "{input:?}: {status:?}");
        assert!(streams(&bench.ticks(500)) == 0, "{input:?}");
    }
}

#[test]
fn no_cell_is_armed_while_orders_do_not_reach_it() {
    let mut bench = Bench::new();
    bench.feed(gone());
    let refused = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!refused.accepted && !bench.cell.status().armed, "{refused:?}");
    bench.feed(Input::OrdersReach(None));
    assert!(!bench.cell.status().armed, "a person arms again");
    let armed = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(armed.accepted && bench.cell.status().armed, "{armed:?}");
}

#[test]
fn a_pause_of_celld_is_no_fault_of_the_disk() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    bench.now += Duration::from_secs(20);
    let all = bench.feed(Input::HeldUp(Duration::from_secs(20)));
    let status = bench.cell.status();
    assert!(!status.armed && !bench.cell.mode().ending(), "{all:?}");
    let stop = status.stopped.expect("the stop is shown");
    assert_eq!(stop.code, Code::HeldUp);
    assert!(stop.message.contains("20.0 s"), "{stop:?}");
}

#[test]
fn a_release_that_waits_for_the_arm_is_refused_after_a_pause_of_celld() {
    let mut bench = working();
    let waits = bench.feed(order(Order::Release(Channels::B)));
    assert!(stops(&waits) && answer(&waits).is_none() && keeps_the_vacuum(&waits), "{waits:?}");
    bench.now += Duration::from_secs(16);
    let all = bench.feed(Input::HeldUp(Duration::from_secs(16)));
    let refused = answer(&all).expect("an answer");
    assert!(!refused.accepted && keeps_the_vacuum(&all), "{refused:?}");
    let later = bench.ticks(500);
    assert!(answer(&later).is_none() && keeps_the_vacuum(&later), "{later:?}");
}
