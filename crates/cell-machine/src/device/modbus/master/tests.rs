//! The connection to the gripper's box, in virtual time.

use super::*;

const READING: ModbusRequest = ModbusRequest::Read { address: 258, count: 2 };

struct Rig {
    master: Master,
    ms: u64,
    actions: Vec<Action>,
    results: Vec<Result<Vec<u16>, ModbusFailure>>,
}

impl Rig {
    fn new() -> Rig {
        Rig { master: Master::new(65), ms: 5000, actions: Vec::new(), results: Vec::new() }
    }

    /// Connected, and one request answered; the number of the connection.
    fn at_work() -> (Rig, u64) {
        let mut rig = Rig::new();
        rig.request();
        let number = rig.connects();
        rig.connected(number);
        rig.answer(number, rig.sent_on(number), 600);
        assert_eq!(std::mem::take(&mut rig.results), [Ok(vec![600, 0])]);
        rig.actions.clear();
        (rig, number)
    }

    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.ms * 1_000_000)
    }

    fn poll(&mut self) {
        self.actions.extend(std::iter::from_fn(|| self.master.poll_action()));
        self.results.extend(std::iter::from_fn(|| self.master.poll_result()));
    }

    fn request(&mut self) {
        self.master.request(self.now(), READING);
        self.poll();
    }

    fn connected(&mut self, number: u64) {
        self.master.connected(self.now(), number);
        self.poll();
    }

    fn closed(&mut self, number: u64, ending: Ending) {
        self.master.closed(self.now(), number, ending);
        self.poll();
    }

    fn answer(&mut self, number: u64, transaction: u16, per_mille: u16) {
        let [t1, t0] = transaction.to_be_bytes();
        let [v1, v0] = per_mille.to_be_bytes();
        let bytes = [t1, t0, 0, 0, 0, 7, 65, 3, 4, v1, v0, 0, 0];
        self.master.received(self.now(), number, &bytes);
        self.poll();
    }

    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.ms += 1;
            self.master.tick(self.now());
            assert!(self.master.poll_timeout().is_none_or(|due| due > self.now()), "it stays in the past");
            self.poll();
        }
    }

    /// The attempt that was begun, and nothing else.
    fn connects(&mut self) -> u64 {
        match std::mem::take(&mut self.actions)[..] {
            [Action::Connect(number)] => number,
            ref other => panic!("{other:?}"),
        }
    }

    /// Transaction of the last request sent on a connection.
    fn sent_on(&self, number: u64) -> u16 {
        let sent = self.actions.iter().rev().find_map(|action| match action {
            Action::Send(to, bytes) if *to == number => Some(u16::from_be_bytes([bytes[0], bytes[1]])),
            _ => None,
        });
        sent.unwrap_or_else(|| panic!("nothing was sent on {number}: {:?}", self.actions))
    }
}

#[test]
fn a_late_answer_is_dropped_and_the_connection_kept() {
    let (mut rig, number) = Rig::at_work();
    rig.request();
    let late = rig.sent_on(number);
    rig.run_ms(999);
    assert_eq!(rig.results, []);
    rig.run_ms(1);
    assert_eq!(rig.results, [Err(ModbusFailure::Timeout)]);
    rig.request();
    let next = rig.sent_on(number);
    assert_ne!(late, next);
    rig.answer(number, late, 1);
    assert_eq!(rig.results.len(), 1, "the late answer is for nobody");
    rig.answer(number, next, 2);
    assert_eq!(rig.results[1], Ok(vec![2, 0]));
    assert!(!rig.actions.contains(&Action::Reset(number)));
}

#[test]
fn a_command_waits_for_the_next_attempt() {
    let mut rig = Rig::new();
    rig.request();
    let number = rig.connects();
    rig.closed(number, Ending::Refused);
    rig.actions.clear();
    rig.master.request(rig.now(), ModbusRequest::Write { address: 0, values: vec![0] });
    rig.run_ms(249);
    assert_eq!((rig.results.len(), rig.actions.len()), (1, 0));
    rig.run_ms(1);
    let number = rig.connects();
    rig.connected(number);
    rig.sent_on(number);
}

/// A box that serves another client first would carry the command out when its turn comes.
#[test]
fn a_command_is_sent_once_the_box_has_answered_on_the_connection() {
    let release = ModbusRequest::Write { address: 0, values: vec![0] };
    let mut rig = Rig::new();
    rig.master.request(rig.now(), release.clone());
    rig.poll();
    let number = rig.connects();
    rig.connected(number);
    let reading = rig.sent_on(number);
    assert_eq!(rig.actions, [Action::Send(number, request_bytes(reading, 65, &READING))]);
    rig.answer(number, reading, 1);
    let command = rig.sent_on(number);
    assert_eq!(rig.actions[1..], [Action::Send(number, request_bytes(command, 65, &release))]);
    assert_eq!(rig.results, [], "it is the command that is waited for");
    let [high, low] = command.to_be_bytes();
    rig.master.received(rig.now(), number, &[high, low, 0, 0, 0, 6, 65, 16, 0, 0, 0, 1]);
    rig.poll();
    assert_eq!(rig.results, [Ok(vec![])]);

    let mut rig = Rig::new();
    rig.master.request(rig.now(), release);
    rig.poll();
    let number = rig.connects();
    rig.connected(number);
    let probe = rig.sent_on(number);
    rig.run_ms(1000);
    assert_eq!(rig.results, [Err(ModbusFailure::Unserved)]);
    rig.answer(number, probe, 1);
    let sent = |action: &&Action| matches!(action, Action::Send(..) | Action::Reset(_));
    assert_eq!(rig.actions.iter().filter(sent).count(), 1, "the reading alone: {:?}", rig.actions);
}

/// celld was held up over the command's time, and finds the answer first.
#[test]
fn a_command_that_waits_for_an_answer_is_not_sent_after_its_time() {
    let mut rig = Rig::new();
    rig.master.request(rig.now(), ModbusRequest::Write { address: 0, values: vec![0] });
    rig.poll();
    let number = rig.connects();
    rig.connected(number);
    let probe = rig.sent_on(number);
    rig.ms += 1001;
    rig.answer(number, probe, 1);
    assert_eq!(rig.actions.len(), 1, "{:?}", rig.actions);
    assert_eq!(rig.results, [Err(ModbusFailure::Unserved)]);
}

/// The number of the command is not used before it is sent.
#[test]
fn an_answer_ahead_of_the_command_sends_nothing() {
    for ahead in [1, 2] {
        let mut rig = Rig::new();
        rig.master.request(rig.now(), ModbusRequest::Write { address: 0, values: vec![0] });
        rig.poll();
        let number = rig.connects();
        rig.connected(number);
        rig.answer(number, rig.sent_on(number).wrapping_add(ahead), 1);
        assert!(matches!(rig.results[..], [Err(ModbusFailure::Malformed(_))]), "{:?}", rig.results);
        assert_eq!(rig.actions[1..], [Action::Reset(number)]);
    }
}

#[test]
fn a_box_that_takes_the_connection_and_answers_nothing_is_named() {
    let mut rig = Rig::new();
    rig.request();
    let first = rig.connects();
    rig.connected(first);
    for second in 1..=29 {
        rig.run_ms(1000);
        assert_eq!(rig.results, [Err(ModbusFailure::Unserved)], "after {second} s");
        rig.results.clear();
        rig.request();
    }
    assert!(rig.actions.iter().all(|action| matches!(action, Action::Send(..))), "it keeps its place");
    rig.actions.clear();
    rig.run_ms(1000);
    let second = rig.connects();
    // A cable that is pulled then is not the box's silence.
    rig.closed(second, Ending::Other("no route".into()));
    rig.results.clear();
    rig.request();
    rig.run_ms(1000);
    assert_eq!(rig.results, [Err(ModbusFailure::Timeout)]);
}

/// A release that is delivered when the cable is back would drop what the arm carries then.
#[test]
fn a_write_without_an_answer_is_not_delivered_later() {
    let (mut rig, number) = Rig::at_work();
    rig.master.request(rig.now(), ModbusRequest::Write { address: 0, values: vec![0] });
    rig.poll();
    rig.actions.clear();
    rig.run_ms(999);
    assert_eq!(rig.actions, []);
    rig.run_ms(1);
    assert_eq!(rig.actions, [Action::Reset(number)]);
    assert_eq!(rig.results, [Err(ModbusFailure::Timeout)]);
}

#[test]
fn an_answer_to_a_request_that_was_never_sent_ends_the_connection() {
    let (mut rig, number) = Rig::at_work();
    rig.request();
    let ahead = rig.sent_on(number).wrapping_add(1);
    rig.answer(number, ahead, 1);
    assert!(matches!(rig.results[..], [Err(ModbusFailure::Malformed(_))]), "{:?}", rig.results);
    assert_eq!(rig.actions.last(), Some(&Action::Reset(number)));
}

#[test]
fn after_a_second_of_silence_a_second_connection_takes_the_place_of_the_first() {
    let (mut rig, first) = Rig::at_work();
    rig.request();
    rig.actions.clear();
    rig.run_ms(1000);
    let second = rig.connects();
    rig.request();
    assert_eq!(rig.actions.len(), 1, "the first is still used: {:?}", rig.actions);
    rig.connected(second);
    assert_eq!(rig.actions[1], Action::Reset(first));
    rig.answer(second, rig.sent_on(second), 7);
    assert_eq!(rig.results, [Err(ModbusFailure::Timeout), Ok(vec![7, 0])]);
}

#[test]
fn a_first_connection_that_speaks_again_is_kept() {
    let (mut rig, first) = Rig::at_work();
    rig.request();
    let late = rig.sent_on(first);
    rig.actions.clear();
    rig.run_ms(1000);
    let second = rig.connects();
    rig.answer(first, late, 7);
    assert_eq!(rig.actions, [Action::Reset(second)]);
    rig.connected(second);
    assert_eq!(rig.actions.len(), 1, "it came too late");
}

#[test]
fn a_refused_second_connection_shows_that_the_first_is_dead() {
    let (mut rig, first) = Rig::at_work();
    rig.request();
    rig.actions.clear();
    rig.run_ms(1000);
    let second = rig.connects();
    rig.closed(second, Ending::Refused);
    assert_eq!(rig.actions, [Action::Reset(first)], "its place is free then");
    rig.actions.clear();
    rig.run_ms(250);
    rig.request();
    rig.connects();
}

#[test]
fn a_pulled_cable_leaves_the_first_connection_and_is_tried_each_second() {
    let (mut rig, first) = Rig::at_work();
    for _ in 0..5 {
        rig.request();
        rig.run_ms(1000);
    }
    assert!(!rig.actions.contains(&Action::Reset(first)), "what lies there may still get through");
    let attempts = rig.actions.iter().filter(|action| matches!(action, Action::Connect(_))).count();
    assert_eq!(attempts, 5);
    assert_eq!(rig.results, vec![Err(ModbusFailure::Timeout); 5]);
}

#[test]
fn a_connection_closed_before_an_answer_is_reported_as_taken() {
    let mut rig = Rig::new();
    rig.request();
    let number = rig.connects();
    rig.connected(number);
    rig.closed(number, Ending::Closed);
    assert_eq!(rig.results, [Err(ModbusFailure::Taken)]);
    rig.actions.clear();
    rig.run_ms(249);
    rig.request();
    assert_eq!((rig.results.len(), rig.actions.len()), (2, 0), "not at once again");
    assert_eq!(rig.results[1], Err(ModbusFailure::Taken));
    rig.run_ms(1);
    rig.request();
    let refused = rig.connects();
    rig.closed(refused, Ending::Refused);
    assert_eq!(rig.results[2], Err(ModbusFailure::Refused));
}

#[test]
fn one_reset_is_mended_at_once_and_a_second_within_ten_seconds_after_a_second() {
    let (mut rig, first) = Rig::at_work();
    rig.closed(first, Ending::Closed);
    rig.request();
    let second = rig.connects();
    rig.connected(second);
    rig.answer(second, rig.sent_on(second), 1);
    rig.actions.clear();
    rig.run_ms(9000);
    rig.request();
    rig.actions.clear();
    rig.closed(second, Ending::Closed);
    assert_eq!(rig.results.last(), Some(&Err(ModbusFailure::Taken)));
    rig.run_ms(999);
    rig.request();
    assert_eq!(rig.actions, []);
    rig.run_ms(1);
    rig.request();
    rig.connects();
}

#[test]
fn a_request_waits_for_the_connection_that_is_being_made() {
    let mut rig = Rig::new();
    rig.request();
    let number = rig.connects();
    rig.run_ms(900);
    rig.connected(number);
    rig.answer(number, rig.sent_on(number), 3);
    assert_eq!(rig.results, [Ok(vec![3, 0])]);
}

#[test]
fn an_attempt_that_nobody_answers_is_begun_again() {
    let mut rig = Rig::new();
    rig.request();
    let first = rig.connects();
    rig.run_ms(1000);
    assert_eq!(rig.actions, [Action::Reset(first)]);
    assert_eq!(rig.results, [Err(ModbusFailure::Timeout)]);
    rig.actions.clear();
    rig.request();
    assert!(rig.connects() > first);
}
