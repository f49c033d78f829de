//! Packets and sentences of the controller's servers.

use crate::facts::rig::{Cell, hex};
use crate::facts::row::source::{CLIENTS, DASHBOARD, LIBRARY, MODBUS, PYTHON, RTDE, SCRIPT};
use crate::facts::row::{Fact, Section, figures, number, numbers, text};
use crate::session::Port;
use crate::simulator::ConnectionId;

/// An RTDE package.
fn package(kind: char, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len() + 3).unwrap_or(u16::MAX).to_be_bytes();
    [&length[..], &[kind as u8], payload].concat()
}

/// A cell, and a connection to RTDE that has agreed on version 2.
fn second_version() -> Option<(Cell, ConnectionId)> {
    let mut cell = Cell::ordinary(true)?;
    let (id, _) = cell.connect(Port::Rtde)?;
    cell.request(id, &package('V', &[0, 2]));
    Some((cell, id))
}

/// What a package is answered in version 2, as text.
fn requested(kind: char, payload: &[u8]) -> Vec<u8> {
    second_version().map(|(mut cell, id)| cell.request(id, &package(kind, payload))).unwrap_or_default()
}

/// A recipe's answer: identity and types.
fn recipe(kind: char, payload: &[u8]) -> String {
    let answer = requested(kind, payload);
    let id = answer.get(3).map_or_else(|| "no recipe".to_owned(), u8::to_string);
    format!("{id} {}", String::from_utf8_lossy(answer.get(4..).unwrap_or_default()))
}

/// Set-up of outputs at 125 Hz.
fn outputs(names: &str) -> Vec<u8> {
    [&125f64.to_be_bytes()[..], names.as_bytes()].concat()
}

/// The table of RTDE.
pub fn rtde() -> Section {
    let types = "timestamp,actual_q,robot_mode,safety_status_bits,tool_mode,tool_output_mode,control_step,\
                 elbow_position,joint_mode,output_bit_register_64";
    let rows = vec![
        text("`V`, version 2 (00 05 56 00 02)", PYTHON, "00 04 56 01", hex(&first(&package('V', &[0, 2])))),
        text("`V`, version 3", PYTHON, "00 04 56 00", hex(&first(&package('V', &[0, 3])))),
        text("`S`", PYTHON, "00 04 53 01", started()),
        text("`P`", PYTHON, "00 04 50 01", hex(&requested('P', &[]))),
        number("`v`: bytes of four numbers of 32 bit and the header", PYTHON, figures(&[19.0], 0.0, "bytes"), requested('v', &[]).len() as f64),
        text(
            "`O`: types of ten variables",
            RTDE,
            "1 DOUBLE,VECTOR6D,INT32,UINT32,UINT32,UINT8,UINT64,VECTOR3D,VECTOR6INT32,BOOL",
            recipe('O', &outputs(types)),
        ),
        text("`O` with a name that is not there", RTDE, "0 DOUBLE,NOT_FOUND", recipe('O', &outputs("timestamp,nothing"))),
        text("`I`: types of inputs, the first recipe", LIBRARY, "1 UINT32,DOUBLE,UINT8,BOOL,INT32", recipe(
            'I',
            b"speed_slider_mask,speed_slider_fraction,standard_digital_output,input_bit_register_64,input_int_register_24",
        )),
        text("`I` of an input that another client has", RTDE, "IN_USE", claimed()),
        number("packages in a second at 125 Hz", RTDE, figures(&[125.0], 0.0, "1/s"), rate(125.0)),
        number("packages in a second at 500 Hz", RTDE, figures(&[500.0], 0.0, "1/s"), rate(500.0)),
        number("packages in a second at 30 Hz: one in floor(500 / 30) cycles", RTDE, figures(&[31.25], 0.5, "1/s"), rate(30.0)),
        numbers("an input takes effect in the cycle in which it arrives: read back", RTDE, figures(&[7.0], 0.0, ""), vec![read_back()]),
    ];
    Section { title: "RTDE", rows }
}

fn first(request: &[u8]) -> Vec<u8> {
    let Some(mut cell) = Cell::ordinary(true) else { return Vec::new() };
    let Some((id, _)) = cell.connect(Port::Rtde) else { return Vec::new() };
    cell.request(id, request)
}

fn started() -> String {
    let answer = second_version().map(|(mut cell, id)| {
        cell.request(id, &package('O', &outputs("timestamp")));
        cell.request(id, &package('S', &[]))
    });
    hex(answer.unwrap_or_default().get(..4).unwrap_or_default())
}

fn claimed() -> String {
    let answer = second_version().and_then(|(mut cell, id)| {
        cell.request(id, &package('I', b"input_int_register_24"));
        let (other, _) = cell.connect(Port::Rtde)?;
        cell.request(other, &package('V', &[0, 2]));
        Some(cell.request(other, &package('I', b"input_int_register_24")))
    });
    String::from_utf8_lossy(answer.unwrap_or_default().get(4..).unwrap_or_default()).into_owned()
}

fn rate(frequency: f64) -> f64 {
    let count = second_version().map(|(mut cell, id)| {
        cell.request(id, &package('O', &[&frequency.to_be_bytes()[..], b"timestamp"].concat()));
        cell.request(id, &package('S', &[]));
        // Over four seconds, as a rate may not fit into one. A package: header, recipe, 8 bytes.
        cell.wait(4.0);
        cell.sent(id).len() as f64 / 12.0 / 4.0
    });
    count.unwrap_or(f64::NAN)
}

fn read_back() -> f64 {
    let value = second_version().and_then(|(mut cell, id)| {
        cell.request(id, &package('I', b"input_int_register_24"));
        cell.request(id, &package('O', &[&500f64.to_be_bytes()[..], b"input_int_register_24"].concat()));
        cell.request(id, &package('S', &[]));
        cell.wait(0.002);
        cell.request(id, &package('U', &[1, 0, 0, 0, 7]));
        cell.wait(0.002);
        cell.sent(id).last().copied()
    });
    value.map_or(f64::NAN, f64::from)
}

/// Dashboard commands on a running robot without a program, and their replies.
const REPLIES: &[(&str, &str)] = &[
    ("robotmode", "Robotmode: RUNNING"),
    ("safetymode", "Safetymode: NORMAL"),
    ("safetystatus", "Safetystatus: NORMAL"),
    ("running", "Program running: false"),
    ("get loaded program", "No program loaded"),
    ("is in remote control", "true"),
    ("get robot model", "UR5"),
    ("get operational mode", "NONE"),
    ("set operational mode manual", "Operational mode MANUAL is set"),
    ("popup hello", "showing popup"),
    ("close popup", "closing popup"),
    ("close safety popup", "closing safety popup"),
    ("addToLog hello", "Added log message"),
    ("load nothing.urp", "File not found: nothing.urp"),
    ("play", "Failed to execute: play"),
    ("pause", "Failed to execute: pause"),
    ("ROBOTMODE", "Robotmode: RUNNING"),
    ("hello", "could not understand: hello"),
    ("power on", "Powering on"),
    ("brake release", "Brake releasing"),
    ("restart safety", "Restarting safety"),
    ("power off", "Powering off"),
    ("quit", "Disconnected"),
];

/// Sub-packages of the robot state by their type, and their length.
const PARTS: &[(&str, u8, &[f64])] = &[
    ("robot state: robot mode data", 0, &[47.0]),
    ("robot state: joint data", 1, &[251.0]),
    ("robot state: tool data", 2, &[37.0]),
    ("robot state: cartesian info", 4, &[101.0]),
    ("robot state: kinematics info", 5, &[225.0]),
    ("robot state: configuration data without later fields", 6, &[445.0]),
];

/// The table of the other servers.
pub fn others() -> Section {
    let mut rows: Vec<Fact> = REPLIES
        .iter()
        .map(|(command, reply)| {
            let answer = Cell::ordinary(true).map(|mut cell| cell.lines(Port::Dashboard, &[command]));
            text(command, DASHBOARD, reply, answer.unwrap_or_default())
        })
        .collect();
    rows.push(greeting());
    let state = robot_state();
    rows.extend(PARTS.iter().map(|(what, kind, length)| {
        let found = part(&state, *kind).unwrap_or(f64::NAN);
        number(what, CLIENTS, figures(length, 0.0, "bytes"), found)
    }));
    rows.extend([state_rate(), realtime(), interpreter(), discarded(), controller_modbus()]);
    Section { title: "Dashboard, client interfaces, interpreter, Modbus", rows }
}

fn greeting() -> Fact {
    let greeting = Cell::ordinary(true).and_then(|mut cell| cell.connect(Port::Dashboard));
    let bytes = greeting.map(|(_, bytes)| bytes).unwrap_or_default();
    let answer = String::from_utf8_lossy(&bytes).trim().to_owned();
    text("greeting of 29999", DASHBOARD, "Connected: Universal Robots Dashboard Server", answer)
}

/// Everything that 30001 sends in the first half second.
fn robot_state() -> Vec<u8> {
    let sent = Cell::ordinary(true).and_then(|mut cell| {
        let (id, mut bytes) = cell.connect(Port::Primary)?;
        cell.wait(0.5);
        bytes.extend(cell.sent(id));
        Some(bytes)
    });
    sent.unwrap_or_default()
}

/// Packages of a client interface: type and what follows the header.
fn packages(mut bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut found = Vec::new();
    while let Some((head, rest)) = bytes.split_first_chunk::<4>() {
        let length = usize::try_from(u32::from_be_bytes(*head)).unwrap_or(usize::MAX);
        let Some((&kind, payload)) = length.checked_sub(4).and_then(|more| rest.get(..more)?.split_first())
        else {
            break;
        };
        found.push((kind, payload.to_vec()));
        bytes = rest.get(length - 4..).unwrap_or_default();
    }
    found
}

/// Length of the first sub-package of a type in what was sent.
fn part(bytes: &[u8], wanted: u8) -> Option<f64> {
    let states = packages(bytes).into_iter().filter(|(kind, _)| *kind == 16);
    states
        .flat_map(|(_, state)| packages(&state))
        .find(|(kind, _)| *kind == wanted)
        .map(|(_, part)| part.len() as f64 + 5.0)
}

fn state_rate() -> Fact {
    let count = Cell::ordinary(true).and_then(|mut cell| {
        let (id, _) = cell.connect(Port::Secondary)?;
        cell.wait(10.0);
        Some(packages(&cell.sent(id)).iter().filter(|(kind, _)| *kind == 16).count() as f64)
    });
    number(
        "robot states in a second on 30002",
        CLIENTS,
        figures(&[10.0], 0.11, "1/s"),
        count.map_or(f64::NAN, |count| count / 10.0),
    )
}

fn realtime() -> Fact {
    let answer = Cell::ordinary(true).and_then(|mut cell| {
        let (id, _) = cell.connect(Port::Realtime)?;
        cell.wait(1.0);
        let bytes = cell.sent(id);
        let length = u32::from_be_bytes(*bytes.first_chunk::<4>()?);
        Some(vec![f64::from(length), bytes.len() as f64 / f64::from(length)])
    });
    numbers(
        "length of the block of 30003 (5.10 and newer), and how many in a second",
        CLIENTS,
        figures(&[1220.0, 500.0], 0.0, ""),
        answer.unwrap_or_default(),
    )
}

fn interpreting(line: &str) -> String {
    let answer = Cell::ordinary(true).map(|mut cell| {
        cell.run("def i():\n interpreter_mode()\nend\n");
        cell.wait(0.01);
        cell.lines(Port::Interpreter, &[line])
    });
    answer.unwrap_or_default()
}

fn interpreter() -> Fact {
    text(
        "30020, a statement",
        SCRIPT,
        "ack: 1: set_digital_out(1, True)",
        interpreting("set_digital_out(1, True)"),
    )
}

fn discarded() -> Fact {
    let answer = interpreting("no_such_function()");
    let shown = format!(
        "{} ... {}",
        answer.get(..8).unwrap_or_default(),
        answer.rsplit(": ").next().unwrap_or_default()
    );
    text("30020, what is no statement", SCRIPT, "discard: ... no_such_function()", shown)
}

fn controller_modbus() -> Fact {
    let answer = Cell::ordinary(true).and_then(|mut cell| {
        let (id, _) = cell.connect(Port::Modbus)?;
        // Registers 256 to 258: version, and robot mode 7.
        let bytes = cell.request(id, &[0, 1, 0, 0, 0, 6, 255, 3, 1, 0, 0, 3]);
        Some(
            bytes
                .get(9..)?
                .chunks(2)
                .map(|word| f64::from(word.get(1).copied().unwrap_or_default()))
                .collect(),
        )
    });
    numbers(
        "502, registers 256 to 258: major and minor version, robot mode",
        MODBUS,
        figures(&[5.0, 26.0, 7.0], 0.0, ""),
        answer.unwrap_or_default(),
    )
}
