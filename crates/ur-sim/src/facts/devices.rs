//! Grippers: packets of public drivers and what the devices do on them.

use crate::facts::rig::{Cell, config, hex};
use crate::facts::row::source::{ROBOTIQ, RTU, VGC10};
use crate::facts::row::{Fact, Section, figures, number, numbers, text};
use crate::session::Port;
use crate::world::drive::{Drive, FingersSpec};
use crate::world::lock;
use crate::world::spec::GripperSpec;
use crate::world::vacuum::{Channel, VacuumMode};
use ur_wire::modbus_rtu::checksum;

/// Control word, and what drivers mean by it.
const WORDS: &[(&str, u16, &str)] = &[
    ("VGC10, 0x0114 to register 0", 0x0114, "grip 20 %"),
    ("VGC10, 0x0128 to register 0", 0x0128, "grip 40 %"),
    ("VGC10, 0x014B to register 0", 0x014b, "grip 75 %"),
    ("VGC10, 0x0000 to register 0", 0x0000, "release 0 %"),
    ("VGC10, 0x0200 to register 0", 0x0200, "idle 0 %"),
    ("VGC10, 0x01FF to register 0: taken as the most", 0x01ff, "grip 80 %"),
];

/// The table.
pub fn section() -> Section {
    let mut rows: Vec<Fact> =
        WORDS.iter().map(|(what, word, meaning)| text(what, VGC10, meaning, commanded(*word))).collect();
    rows.extend([both_channels(), vacuum(), default_limit()]);
    rows.push(text("Modbus RTU, checksum of 02 07", RTU, "41 12", hex(&checksum(&[2, 7]).to_le_bytes())));
    rows.extend([activation(), travel()]);
    Section { title: "Grippers", rows }
}

fn request(cell: &mut Cell, pdu: &[u8]) -> Vec<u8> {
    let Some((id, _)) = cell.connect(Port::Gripper) else { return Vec::new() };
    let length = u8::try_from(pdu.len() + 1).unwrap_or(u8::MAX);
    cell.request(id, &[&[0, 1, 0, 0, 0, length, 65], pdu].concat())
}

fn commanded(word: u16) -> String {
    let [high, low] = word.to_be_bytes();
    let command = Cell::ordinary(true).map(|mut cell| {
        request(&mut cell, &[6, 0, 0, high, low]);
        lock(&cell.simulator.core().world).vacuum_command(Channel::A)
    });
    let Some((mode, target)) = command else { return String::new() };
    let name = match mode {
        VacuumMode::Release => "release",
        VacuumMode::Grip => "grip",
        VacuumMode::Idle => "idle",
    };
    format!("{name} {:.0} %", target * 100.0)
}

fn both_channels() -> Fact {
    let answer = Cell::ordinary(true).map(|mut cell| {
        request(&mut cell, &[16, 0, 0, 0, 2, 4, 1, 60, 1, 60]);
        let world = lock(&cell.simulator.core().world);
        Channel::ALL.map(|channel| world.vacuum_command(channel).1 * 100.0).to_vec()
    });
    numbers(
        "VGC10, one 0x10 for both channels: targets",
        VGC10,
        figures(&[60.0, 60.0], 1e-6, "%"),
        answer.unwrap_or_default(),
    )
}

fn vacuum() -> Fact {
    let answer = Cell::ordinary(true).map(|mut cell| request(&mut cell, &[3, 1, 2, 0, 2]).len() as f64);
    number(
        "VGC10, registers 258 and 259 in one answer",
        VGC10,
        figures(&[13.0], 0.0, "bytes"),
        answer.unwrap_or(f64::NAN),
    )
}

fn default_limit() -> Fact {
    let answer =
        Cell::ordinary(true).map(|cell| f64::from(lock(&cell.simulator.core().world).current_limit_ma()));
    number(
        "VGC10, register 2 at the start: current limit",
        VGC10,
        figures(&[500.0], 0.0, "mA"),
        answer.unwrap_or(f64::NAN),
    )
}

fn fingers() -> Option<Cell> {
    let gripper = GripperSpec {
        drive: Drive::Fingers(FingersSpec::ROBOTIQ_2F85),
        cups: Vec::new(),
        ..GripperSpec::one_cup(0.2)
    };
    Cell::new(config(true), gripper)
}

fn activation() -> Fact {
    let answer = fingers().map(|mut cell| {
        let before = cell.lines(Port::Robotiq, &["SET ACT 1", "GET ACT"]);
        cell.wait(2.0);
        format!("{before} / {}", cell.lines(Port::Robotiq, &["GET STA", "GET FLT"]))
    });
    text(
        "Robotiq: SET ACT 1, GET ACT, 2 s, GET STA, GET FLT",
        ROBOTIQ,
        "ack / ACT 1 / STA 3 / FLT 00",
        answer.unwrap_or_default(),
    )
}

fn travel() -> Fact {
    let answer = fingers().map(|mut cell| {
        cell.lines(Port::Robotiq, &["SET ACT 1"]);
        cell.wait(2.0);
        let begun = cell.lines(Port::Robotiq, &["SET POS 255 SPE 255 FOR 100 GTO 1", "GET PRE", "GET OBJ"]);
        cell.wait(2.0);
        format!("{begun} / {}", cell.lines(Port::Robotiq, &["GET OBJ"]))
    });
    text(
        "Robotiq: SET POS 255 SPE 255 FOR 100 GTO 1, GET PRE, GET OBJ, 2 s, GET OBJ",
        ROBOTIQ,
        "ack / PRE 255 / OBJ 0 / OBJ 3",
        answer.unwrap_or_default(),
    )
}
