//! The gripper session against scripted answers, in virtual time.

use super::*;
use crate::device::gripper_types::{CONTROL, FIRMWARE, PRODUCT, SERIAL, UNIT, VGC10};

const README: &str = include_str!("../../../../../hardware/gripper/README.md");

struct Rig {
    gripper: Gripper,
    now: Timestamp,
    vacuum: [u16; 2],
    writes: Vec<(u16, Vec<u16>)>,
    reads: u32,
    /// What every request is answered with, if not by the device.
    failure: Option<ModbusFailure>,
    /// Requests are swallowed.
    mute: bool,
    /// It has registers that say which one it is, and this serial number.
    serial: Option<[u16; 16]>,
    events: Vec<GripperEvent>,
}

impl Rig {
    fn new() -> Rig {
        let parameters = GripperParameters {
            vacuum_min: 0.5,
            vacuum_hold: 0.4,
            grip_within: Duration::from_millis(800),
            release_within: Duration::from_millis(500),
        };
        Rig {
            gripper: Gripper::new(parameters),
            now: Timestamp::from_secs_f64(5.0),
            vacuum: [0, 0],
            writes: Vec::new(),
            reads: 0,
            failure: None,
            mute: false,
            serial: None,
            events: Vec::new(),
        }
    }

    /// The request that was swallowed fails.
    fn answer_late(&mut self) {
        self.gripper.response(self.now, Err(ModbusFailure::Timeout));
    }

    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += Duration::from_millis(1);
            self.gripper.tick(self.now);
            while let Some(request) = self.gripper.poll_request(self.now) {
                if self.mute {
                    break;
                }
                let answer = self.answer(request);
                self.gripper.response(self.now, answer);
            }
            let next = self.gripper.poll_timeout().unwrap();
            assert!(next.0 > self.now || self.mute, "{next:?} stays in the past at {:?}", self.now);
            while let Some(event) = self.gripper.poll_event() {
                if !matches!(event, GripperEvent::Reading { .. }) {
                    self.events.push(event);
                }
            }
        }
    }

    fn answer(&mut self, request: ModbusRequest) -> Result<Vec<u16>, ModbusFailure> {
        match request {
            ModbusRequest::Read { address: VACUUM, count } => {
                assert_eq!(count, 2);
                self.reads += 1;
                self.failure.clone().map_or(Ok(self.vacuum.to_vec()), Err)
            }
            ModbusRequest::Read { address, count } => match (address, self.serial) {
                _ if self.failure.is_some() => Err(self.failure.clone().unwrap()),
                (PRODUCT, Some(_)) => Ok(vec![VGC10]),
                (FIRMWARE, Some(_)) => Ok(vec![1, 7]),
                (SERIAL, Some(serial)) => Ok(serial[..usize::from(count)].to_vec()),
                _ => Err(ModbusFailure::Exception(2)),
            },
            ModbusRequest::Write { address, values } => {
                self.writes.push((address, values));
                self.failure.clone().map_or(Ok(Vec::new()), Err)
            }
        }
    }

    fn grip(&mut self, channels: Channels) {
        self.gripper.command(self.now, GripperCommand::Grip { channels, target: 0.6 }).unwrap();
    }

    fn release(&mut self, channels: Channels) {
        self.gripper.command(self.now, GripperCommand::Release { channels }).unwrap();
    }

    fn holding() -> Rig {
        let mut rig = Rig::new();
        rig.grip(Channels::A);
        rig.vacuum = [600, 0];
        rig.run_ms(60);
        assert_eq!(rig.events, [GripperEvent::Answering, GripperEvent::Gripped { vacuum: 0.6 }]);
        rig.events.clear();
        rig
    }
}

#[test]
fn the_register_map_for_people_says_the_same() {
    for register in [CONTROL, CONTROL + 1, VACUUM, VACUUM + 1] {
        assert!(README.contains(&format!("| {register} | ")), "{register}");
    }
    assert!(README.contains(&format!("unit {UNIT} ")));
    assert!(README.contains(&format!("`0x{:04X}` grip at 60 %", grip_word(0.6))));
    assert!(README.contains(&format!("`0x{RELEASE:04X}` release, `0x{IDLE:04X}` idle")));
}

#[test]
fn golden_words() {
    // A failure here means the wire changed.
    assert_eq!([grip_word(0.2), grip_word(0.4), grip_word(0.75)], [0x0114, 0x0128, 0x014B]);
}

#[test]
fn only_the_channels_requested_are_written() {
    for (channels, expected) in [
        (Channels::A, (0, vec![0x013C])),
        (Channels::B, (1, vec![0x013C])),
        (Channels::Both, (0, vec![0x013C; 2])),
    ] {
        let mut rig = Rig::new();
        rig.grip(channels);
        rig.run_ms(10);
        assert_eq!(rig.writes, [expected]);
    }
}

#[test]
fn a_grip_is_as_good_as_its_worst_channel() {
    let mut rig = Rig::new();
    rig.grip(Channels::Both);
    rig.vacuum = [700, 450];
    rig.run_ms(790);
    assert_eq!(rig.events, [GripperEvent::Answering]);
    rig.run_ms(20);
    assert_eq!(rig.events[1..], [GripperEvent::GripFailed { vacuum: 0.45 }]);
}

#[test]
fn one_good_reading_is_noise() {
    let mut rig = Rig::new();
    rig.grip(Channels::A);
    for _ in 0..5 {
        rig.vacuum = [510, 0];
        rig.run_ms(20);
        rig.vacuum = [490, 0];
        rig.run_ms(20);
    }
    assert_eq!(rig.events, [GripperEvent::Answering]);
}

#[test]
fn readings_come_at_50_hz_while_holding_and_10_hz_otherwise() {
    let mut rig = Rig::new();
    rig.run_ms(1000);
    assert!((10..=11).contains(&rig.reads), "{}", rig.reads);
    let mut rig = Rig::holding();
    rig.reads = 0;
    rig.run_ms(1000);
    assert!((50..=51).contains(&rig.reads), "{}", rig.reads);
}

#[test]
fn vacuum_lost_is_reported_once_after_50_ms() {
    let mut rig = Rig::holding();
    rig.vacuum = [390, 0];
    rig.run_ms(40);
    rig.vacuum = [410, 0];
    rig.run_ms(40);
    assert_eq!(rig.events, [], "a dip is noise");
    rig.vacuum = [300, 0];
    rig.run_ms(50);
    assert_eq!(rig.events, []);
    rig.run_ms(1000);
    assert_eq!(rig.events, [GripperEvent::VacuumLost { vacuum: 0.3 }]);
    assert!(!rig.gripper.holding());
}

#[test]
fn release_is_verified() {
    let mut rig = Rig::holding();
    rig.release(Channels::A);
    rig.run_ms(100);
    assert_eq!(rig.writes.last(), Some(&(0, vec![0])));
    assert_eq!(rig.events, []);
    rig.vacuum = [20, 0];
    rig.run_ms(30);
    assert_eq!(rig.events, [GripperEvent::Released]);
    let mut rig = Rig::holding();
    rig.release(Channels::A);
    rig.run_ms(600);
    assert_eq!(rig.events, [GripperEvent::ReleaseFailed { vacuum: 0.6 }]);
}

#[test]
fn what_could_drop_the_object_is_refused() {
    let mut rig = Rig::holding();
    assert_eq!(rig.gripper.command(rig.now, GripperCommand::Idle), Err(GripperRefused::Holding));
    let again = GripperCommand::Grip { channels: Channels::B, target: 0.6 };
    assert_eq!(rig.gripper.command(rig.now, again), Err(GripperRefused::Holding));
    for target in [0.0, 0.81, -1.0, f64::NAN, f64::INFINITY] {
        let mut rig = Rig::new();
        let command = GripperCommand::Grip { channels: Channels::A, target };
        assert!(matches!(rig.gripper.command(rig.now, command), Err(GripperRefused::Target(_))));
    }
    let mut rig = Rig::new();
    rig.gripper.command(rig.now, GripperCommand::Idle).unwrap();
    rig.run_ms(5);
    assert_eq!(rig.writes, [(0, vec![0x0200; 2])]);
}

#[test]
fn three_failures_make_it_unreachable_and_one_answer_brings_it_back() {
    let failures =
        [ModbusFailure::Timeout, ModbusFailure::Exception(4), ModbusFailure::Connection("refused".into())];
    for failure in failures {
        let mut rig = Rig::holding();
        rig.failure = Some(failure.clone());
        rig.run_ms(30);
        assert_eq!(rig.events, []);
        rig.run_ms(500);
        assert_eq!(rig.events, [GripperEvent::Unreachable { failures: 3, cause: failure }]);
        assert!(rig.gripper.holding(), "the device goes on as it was ordered");
        rig.failure = None;
        rig.run_ms(30);
        assert_eq!(rig.events[1..], [GripperEvent::Answering]);
    }
}

#[test]
fn no_answer_at_all_is_noticed_and_a_late_one_is_not_mistaken() {
    let mut rig = Rig::holding();
    rig.mute = true;
    rig.run_ms(650);
    assert_eq!(rig.events, [GripperEvent::Unreachable { failures: 3, cause: ModbusFailure::Timeout }]);
    assert_eq!(rig.gripper.poll_request(rig.now), None, "one request at a time");
    rig.gripper.response(rig.now, Ok(vec![610, 0]));
    rig.mute = false;
    rig.run_ms(5);
    assert_eq!(rig.events[1..], [GripperEvent::Answering]);
    rig.gripper.response(rig.now, Ok(vec![0, 0]));
    assert_eq!(
        rig.gripper.reading().unwrap().1[0],
        0.61_f64.min(0.6),
        "an answer without a request is ignored"
    );
}

#[test]
fn readings_that_cannot_be_are_failures() {
    for words in [vec![600], vec![600, 0, 0], vec![1051, 0], vec![0, 65535], vec![]] {
        assert!(matches!(vacuum_of(&words), Err(ModbusFailure::Malformed(_))), "{words:?}");
    }
    let mut rig = Rig::holding();
    rig.vacuum = [40_000, 0];
    rig.run_ms(100);
    assert!(matches!(
        &rig.events[..],
        [GripperEvent::Unreachable { cause: ModbusFailure::Malformed(_), .. }]
    ));
}

#[test]
fn a_command_is_tried_three_times_and_never_late() {
    let mut rig = Rig::new();
    rig.failure = Some(ModbusFailure::Timeout);
    rig.grip(Channels::A);
    rig.run_ms(2000);
    assert_eq!(rig.writes.len(), 3);
    assert!(rig.events.contains(&GripperEvent::GripFailed { vacuum: 0.0 }), "{:?}", rig.events);
    let mut rig = Rig::new();
    rig.mute = true;
    rig.grip(Channels::A);
    rig.run_ms(2000);
    rig.gripper.response(rig.now, Err(ModbusFailure::Timeout));
    rig.mute = false;
    rig.run_ms(500);
    assert_eq!(rig.writes, [], "the arm may be elsewhere by now");
}

#[test]
fn a_release_overtakes_a_grip_that_did_not_get_through() {
    for under_way in [false, true] {
        let mut rig = Rig::new();
        rig.failure = Some(ModbusFailure::Timeout);
        rig.grip(Channels::A);
        if under_way {
            let grip = rig.gripper.poll_request(rig.now).unwrap();
            assert_eq!(grip, ModbusRequest::Write { address: 0, values: vec![0x013C] });
            rig.release(Channels::A);
            rig.gripper.response(rig.now, Err(ModbusFailure::Timeout));
        } else {
            rig.run_ms(2);
            rig.release(Channels::A);
            rig.writes.clear();
        }
        rig.failure = None;
        rig.run_ms(100);
        assert_eq!(rig.writes, [(0, vec![0])], "the grip is not tried again");
        assert!(rig.events.contains(&GripperEvent::Released));
    }
}

#[test]
fn two_releases_in_haste_release_both_channels() {
    let mut rig = Rig::new();
    rig.vacuum = [600, 600];
    rig.grip(Channels::Both);
    rig.run_ms(60);
    rig.events.clear();
    rig.writes.clear();
    rig.release(Channels::A);
    rig.release(Channels::B);
    rig.run_ms(30);
    assert_eq!(rig.writes, [(0, vec![0, 0])]);
    rig.vacuum = [20, 300];
    rig.run_ms(30);
    assert_eq!(rig.events, [], "B is not released yet");
    rig.vacuum = [20, 20];
    rig.run_ms(30);
    assert_eq!(rig.events, [GripperEvent::Released]);
}

#[test]
fn what_the_other_channel_holds_is_watched_on() {
    let mut rig = Rig::new();
    rig.vacuum = [600, 600];
    rig.grip(Channels::Both);
    rig.run_ms(60);
    rig.events.clear();
    rig.release(Channels::A);
    rig.vacuum = [20, 600];
    rig.run_ms(30);
    assert_eq!(rig.events, [GripperEvent::Released]);
    assert!(rig.gripper.holding());
    rig.vacuum = [20, 100];
    rig.run_ms(100);
    assert_eq!(rig.events[1..], [GripperEvent::VacuumLost { vacuum: 0.1 }]);
}

#[test]
fn a_low_vacuum_before_the_release_got_through_proves_nothing() {
    let mut rig = Rig::new();
    rig.grip(Channels::A);
    rig.run_ms(900);
    rig.failure = Some(ModbusFailure::Exception(6));
    rig.release(Channels::A);
    rig.run_ms(100);
    rig.failure = None;
    rig.run_ms(500);
    assert_eq!(rig.writes.last(), Some(&(0, vec![0])));
    assert!(!rig.events.contains(&GripperEvent::Released), "{:?}", rig.events);
    assert!(rig.events.contains(&GripperEvent::ReleaseFailed { vacuum: 0.0 }), "{:?}", rig.events);
}

#[test]
fn what_hangs_there_at_the_start_is_watched() {
    let mut rig = Rig::new();
    rig.vacuum = [0, 620];
    rig.run_ms(300);
    assert!(rig.gripper.holding());
    let reads = rig.reads;
    rig.run_ms(1000);
    assert!((45..=51).contains(&(rig.reads - reads)), "{}", rig.reads - reads);
    rig.vacuum = [0, 100];
    rig.run_ms(120);
    let lost = |event: &GripperEvent| matches!(event, GripperEvent::VacuumLost { .. });
    assert!(rig.events.iter().any(lost), "{:?}", rig.events);
    assert!(rig.writes.is_empty(), "watching writes nothing");
}

#[test]
fn silence_is_noticed_sooner_while_an_object_is_held() {
    let unreachable = |event: &GripperEvent| matches!(event, GripperEvent::Unreachable { .. });
    for (mut rig, within_ms) in [(Rig::holding(), 270), (Rig::new(), 710)] {
        rig.run_ms(10);
        rig.mute = true;
        rig.run_ms(within_ms);
        assert!(rig.events.iter().any(unreachable), "{within_ms}: {:?}", rig.events);
    }
}

#[test]
fn a_vacuum_that_falls_is_reported_before_it_is_lost() {
    let mut rig = Rig::holding();
    rig.vacuum = [640, 0];
    rig.run_ms(300);
    rig.vacuum = [560, 0];
    rig.run_ms(1000);
    assert_eq!(rig.events, [], "a little less is no leak");
    rig.vacuum = [440, 0];
    rig.run_ms(150);
    rig.vacuum = [600, 0];
    rig.run_ms(300);
    assert_eq!(rig.events, [], "nor is a moment");
    rig.vacuum = [440, 0];
    rig.run_ms(2000);
    assert_eq!(rig.events, [GripperEvent::VacuumWeak { vacuum: 0.44, best: 0.6 }], "once");
    rig.vacuum = [0, 0];
    rig.run_ms(200);
    assert_eq!(rig.events[1..], [GripperEvent::VacuumLost { vacuum: 0.0 }]);
    // A pump that overshoots, falls by a tenth and runs again.
    let mut rig = Rig::holding();
    for vacuum in [720, 650, 560, 490, 560, 660, 495] {
        rig.vacuum = [vacuum, 0];
        rig.run_ms(1000);
    }
    assert_eq!(rig.events, []);
    // What falls at once is lost and nothing else.
    let mut rig = Rig::holding();
    rig.vacuum = [0, 0];
    rig.run_ms(500);
    assert_eq!(rig.events, [GripperEvent::VacuumLost { vacuum: 0.0 }]);
}

/// A serial number of two characters.
fn serial(last: u8) -> [u16; 16] {
    let mut serial = [0; 16];
    serial[0] = u16::from_be_bytes([b'v', last]);
    serial
}

#[test]
fn it_says_which_one_it_is_and_again_after_it_was_gone() {
    let mut rig = Rig::new();
    rig.serial = Some(serial(b'1'));
    rig.run_ms(400);
    let identity = rig.gripper.identity().expect("it was read");
    assert_eq!((identity.product, identity.firmware), (Some(VGC10), Some([1, 7])));
    assert_eq!(identity.serial_text().as_deref(), Some("v1"));
    rig.failure = Some(ModbusFailure::Timeout);
    rig.run_ms(500);
    assert_eq!(rig.gripper.fault(), Some(GripperFault::Silent));
    (rig.failure, rig.serial) = (None, Some(serial(b'2')));
    rig.run_ms(400);
    assert_eq!(rig.gripper.identity().and_then(|it| it.serial_text()).as_deref(), Some("v2"));
}

#[test]
fn a_gripper_without_such_registers_is_nameless_and_grips_all_the_same() {
    let mut rig = Rig::new();
    rig.run_ms(400);
    assert_eq!(rig.gripper.identity(), Some(Identity::default()));
    assert_eq!(rig.gripper.identity().unwrap().serial_text(), None);
    rig.grip(Channels::A);
    rig.vacuum = [600, 0];
    rig.run_ms(60);
    assert!(rig.gripper.holding());
}

/// Two tries for each of three parts: six silences.
#[test]
fn a_gripper_that_falls_silent_at_each_read_of_its_identity_works_in_the_end() {
    let mut rig = Rig::new();
    let mut silent_until = None;
    for _ in 0..20_000 {
        rig.now += Duration::from_millis(1);
        rig.gripper.tick(rig.now);
        if silent_until.is_some_and(|until| rig.now >= until) {
            silent_until = None;
            rig.gripper.response(rig.now, Err(ModbusFailure::Timeout));
        }
        match rig.gripper.poll_request(rig.now) {
            Some(ModbusRequest::Read { address: VACUUM, .. }) => {
                rig.gripper.response(rig.now, Ok(vec![0, 0]));
            }
            Some(_) => silent_until = Some(rig.now + Duration::from_secs(1)),
            None => {}
        }
    }
    assert_eq!(rig.gripper.identity(), Some(Identity::default()));
    assert!(rig.gripper.answering());
}

#[test]
fn why_it_does_not_answer_is_known() {
    for (failure, fault) in [
        (ModbusFailure::Taken, GripperFault::Taken),
        (ModbusFailure::Refused, GripperFault::Refused),
        (ModbusFailure::Unserved, GripperFault::Unserved),
        (ModbusFailure::Exception(2), GripperFault::NoVacuum),
        (ModbusFailure::Exception(4), GripperFault::Silent),
    ] {
        let mut rig = Rig::new();
        rig.failure = Some(failure.clone());
        rig.run_ms(500);
        assert_eq!(rig.gripper.fault(), Some(fault), "{failure:?}");
        rig.mute = true;
        rig.run_ms(900);
        assert_eq!(rig.gripper.fault(), Some(fault), "requests that nothing answers are less specific");
        rig.answer_late();
        (rig.failure, rig.mute) = (None, false);
        rig.run_ms(200);
        assert_eq!(rig.gripper.fault(), None);
        rig.mute = true;
        rig.run_ms(900);
        assert_eq!(rig.gripper.fault(), Some(GripperFault::Silent), "a cause of before it answered is none");
    }
}

#[test]
fn a_serial_number_is_text_or_hexadecimal() {
    let text = |words: [u16; 16]| Identity { serial: Some(words), ..Identity::default() }.serial_text();
    assert_eq!(text([0; 16]), None, "empty registers name nothing");
    let mut binary = [0; 16];
    binary[15] = 0x0102;
    assert_eq!(text(binary), Some(format!("{}0102", "0000".repeat(15))));
}
