//! What is done with fuzzed bytes: one function a protocol, for libFuzzer and for the test that replays the
//! corpora.
//!
//! In: any bytes; the first says how the rest is cut into pieces, as a network may. Out: nothing, or a
//! panic, which is a finding: our own of a broken promise, or one of the code under test. Both directions of
//! every codec are read, and the simulator's sessions are driven as if over a socket, with controller frames
//! in between.

use cell_machine::device::dashboard_session::DashboardSession;
use cell_machine::device::primary_session::PrimarySession;
use cell_machine::device::rtde_session::RtdeSession;
use cell_values::time::{Duration, Timestamp};
use nalgebra::Isometry3;
use ur_sim::controller::builtins::compile_program;
use ur_sim::controller::program_files::ProgramSource;
use ur_sim::controller::{Controller, ControllerConfig};
use ur_sim::robot_api::reply::{Outcome, Request as ApiRequest};
use ur_sim::robot_api::{answer, reached};
use ur_sim::robot_server::shared::RobotShared;
use ur_sim::session::Port;
use ur_sim::simulator::{Simulator, Transmission};
use ur_sim::world::drive::{Drive, FingersSpec};
use ur_sim::world::lock;
use ur_sim::world::spec::{GripperSpec, WorldSpec};
use ur_sim::world::vacuum::Channel;
use ur_wire::dashboard::{Command, LineSplitter, Reply as DashboardReply};
use ur_wire::modbus;
use ur_wire::modbus_rtu;
use ur_wire::primary::Splitter as PrimarySplitter;
use ur_wire::rtde::{Frame, Reply, Request, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Recipe};
use ur_wire::rtde_variables::OUTPUTS;

/// What a target does with the bytes it is given.
pub type Target = fn(&[u8]);

/// Names of the targets and what they do.
pub const TARGETS: [(&str, Target); 9] = [
    ("rtde", rtde),
    ("dashboard", dashboard),
    ("primary", primary),
    ("urscript", urscript),
    ("modbus", modbus),
    ("robotiq", robotiq),
    ("tool_serial", tool_serial),
    ("interpreter", interpreter),
    ("robot_api", robot_api),
];

/// Most pieces of one input; after how many of them time goes on, and frames a program gets: frames are what
/// an input costs most of.
const MOST_PIECES: usize = 64;
const PIECES_WITH_FRAMES: usize = 16;
const FRAMES: usize = 12;

/// The bytes behind the first, in pieces as long as the first says (0: whole).
fn pieces(data: &[u8]) -> Vec<&[u8]> {
    let Some((length, rest)) = data.split_first() else { return Vec::new() };
    let length = match usize::from(*length) {
        0 => rest.len().max(1),
        length => length.max(rest.len() / MOST_PIECES),
    };
    rest.chunks(length.max(1)).collect()
}

fn simulator() -> Simulator {
    simulator_with(Drive::Vgc10)
}

fn simulator_with(drive: Drive) -> Simulator {
    let mut controller = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
    let program = "def work():\n while True:\n  sync()\n end\nend\n";
    controller.programs.add("work", ProgramSource::Script(program.to_owned()));
    let cups = GripperSpec::one_cup(0.2);
    let cups =
        if matches!(drive, Drive::Fingers(_)) { GripperSpec { cups: Vec::new(), ..cups } } else { cups };
    let world = WorldSpec::bare(Isometry3::identity(), GripperSpec { drive, ..cups });
    Simulator::new(controller, world, 1, Vec::new()).expect("a sound cell")
}

/// Sends to a server of the simulator, `frames` frames after each of the first pieces; `received` gets what
/// it sends, in the pieces in which it sends it. The client then leaves.
fn talk(port: Port, data: &[u8], frames: usize, received: impl FnMut(&[u8])) -> Simulator {
    talk_to(simulator(), port, data, frames, received)
}

/// The same with a simulator that is there already.
fn talk_to(
    mut simulator: Simulator,
    port: Port,
    data: &[u8],
    frames: usize,
    mut received: impl FnMut(&[u8]),
) -> Simulator {
    let id = simulator.connect(port).expect("the server listens");
    let mut listen = |simulator: &mut Simulator| {
        while let Some(transmission) = simulator.transmit() {
            if let Transmission::Bytes(_, bytes) = transmission {
                received(&bytes);
            }
        }
    };
    listen(&mut simulator);
    for (number, piece) in pieces(data).into_iter().enumerate() {
        simulator.receive(id, piece);
        if number < PIECES_WITH_FRAMES {
            (0..frames).for_each(|_| simulator.advance());
        }
        listen(&mut simulator);
    }
    simulator.hang_up(id);
    simulator
}

/// Gives a client of ours the bytes a second apart, and takes what it has to say; `$before` is done before
/// each piece.
macro_rules! receive {
    ($client:expr, $data:expr, $before:expr) => {{
        let (mut client, mut now) = ($client, Timestamp::ZERO);
        client.connected(now);
        for piece in pieces($data) {
            $before(&mut client, now);
            client.received(now, piece);
            now += Duration::from_secs(1);
            client.tick(now);
            while client.poll_transmit().is_some() || client.poll_event().is_some() {}
        }
    }};
}

/// Packages of both directions in both versions; then a connection to the simulator; then a client of ours.
pub fn rtde(data: &[u8]) {
    let fields = OUTPUTS.iter().map(|(name, kind)| ((*name).to_owned(), *kind)).collect();
    let recipe = Recipe { id: 1, fields };
    for version in [Version::V1, Version::V2] {
        let mut splitter = Splitter::default();
        for piece in pieces(data) {
            splitter.push(piece);
            while let Ok(Some(frame)) = splitter.next_frame() {
                let _ = Request::decode(version, &frame).map(|request| request.encode(version));
                let _ = Reply::decode(version, &frame).map(|reply| reply.encode(version));
                let _ = recipe.decode(&frame.payload, Leftover::Ignore);
            }
        }
    }
    let simulator = talk(Port::Rtde, data, 1, must_be_readable);
    assert!(
        !simulator.core().robot.controller().core.registers.claimed("input_int_register_24"),
        "a claim has outlived its client"
    );
    receive!(RtdeSession::new(500.0, 1), data, |_: &mut RtdeSession, _| {});
}

/// A client of ours reads what the simulator sends, whatever the request was.
fn must_be_readable(package: &[u8]) {
    let mut splitter = Splitter::default();
    splitter.push(package);
    let frame: Frame = splitter.next_frame().expect("a length").expect("a whole package");
    let readable = [Version::V1, Version::V2].iter().any(|version| Reply::decode(*version, &frame).is_ok());
    assert!(readable, "{frame:?}");
}

/// Lines of both directions; then a connection to the simulator; then a client of ours.
pub fn dashboard(data: &[u8]) {
    let mut splitter = LineSplitter::default();
    for piece in pieces(data) {
        splitter.push(piece);
        while let Ok(Some(line)) = splitter.next_line() {
            let command = Command::parse(&line);
            assert!(command.line().ends_with('\n'), "a command is a line");
            let _ = DashboardReply::parse(&command, &line).map(|reply| reply.line(&command));
        }
    }
    talk(Port::Dashboard, data, 1, |replies| assert!(replies.ends_with(b"\n"), "{replies:?}"));
    receive!(DashboardSession::default(), data, |client: &mut DashboardSession, now| {
        let _ = client.request(now, Command::SafetyMode);
    });
}

/// Packages; then a script connection to the simulator; then a client of ours.
pub fn primary(data: &[u8]) {
    let mut splitter = PrimarySplitter::default();
    for piece in pieces(data) {
        splitter.push(piece);
        loop {
            match splitter.next_package() {
                Ok(Some(package)) => drop(package.encode()),
                Ok(None) => break,
                Err(_) => {}
            }
        }
    }
    let mut received = PrimarySplitter::default();
    let mut simulator = talk(Port::Primary, data, 1, |bytes| {
        received.push(bytes);
        while received.next_package().expect("what we send can be read").is_some() {}
    });
    (0..FRAMES).for_each(|_| simulator.advance());
    receive!(PrimarySession::default(), data, |_: &mut PrimarySession, _| {});
}

/// A program: parsed, checked, and run for some frames.
pub fn urscript(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let code = compile_program(&text);
    let runs = code.is_ok();
    let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
    controller.programs.upload(code);
    for _ in 0..if runs { FRAMES } else { 1 } {
        controller.frame();
    }
    assert!(controller.core.mover.q().0.iter().all(|angle| angle.is_finite()), "the arm is nowhere");
    controller.programs.stop(&mut controller.core);
    controller.frame();
}

/// Requests to the gripper, with the world's time going on.
pub fn modbus(data: &[u8]) {
    let mut splitter = modbus::Splitter::default();
    let simulator = talk(Port::Gripper, data, 1, |answers| {
        splitter.push(answers);
        while splitter.next_adu().expect("what we send is Modbus").is_some() {}
    });
    let world = lock(&simulator.core().world);
    for channel in Channel::ALL {
        assert!(world.vacuum_reading_per_mille(channel) <= 1000, "more than a vacuum");
    }
}

/// Lines to the URCap of a two-finger gripper, with the world's time going on.
pub fn robotiq(data: &[u8]) {
    let simulator = simulator_with(Drive::Fingers(FingersSpec::ROBOTIQ_2F85));
    let simulator = talk_to(simulator, Port::Robotiq, data, 1, |answers| {
        assert!(answers.is_ascii(), "what we send is a line or an acknowledgement");
    });
    let world = lock(&simulator.core().world);
    let gap = world.finger_gap_m().expect("it has fingers");
    assert!((0.0..=FingersSpec::ROBOTIQ_2F85.stroke_m + 1e-9).contains(&gap), "fingers {gap} m apart");
}

/// Frames on the serial line of the tool; the codec alone, then a gripper that has power.
pub fn tool_serial(data: &[u8]) {
    let mut line = modbus_rtu::SerialLine::default();
    for piece in pieces(data) {
        line.push(piece);
        while let Some(request) = line.next_request() {
            let frame = modbus_rtu::answer(&request, request.function().map(|function| function.echo()));
            let (body, sum) = frame.split_last_chunk::<2>().expect("a checksum");
            assert_eq!(modbus_rtu::checksum(body).to_le_bytes(), *sum);
        }
    }
    let mut simulator = simulator_with(Drive::Vgc10OnTool);
    let script =
        "def on():\n set_tool_voltage(24)\n set_tool_communication(True, 115200, 2, 1, 1.5, 3.5)\nend\n";
    simulator.core().robot.controller().programs.upload(compile_program(script));
    (0..3).for_each(|_| simulator.advance());
    let simulator = talk_to(simulator, Port::ToolSerial, data, 1, |answers| {
        assert!(answers.len() >= 4, "{answers:?} is no frame");
    });
    let world = lock(&simulator.core().world);
    for channel in Channel::ALL {
        assert!(world.vacuum_command(channel).1 <= 0.8, "more than the device takes");
    }
}

/// Lines to a program that is in interpreter mode, with frames in between.
pub fn interpreter(data: &[u8]) {
    let mut simulator = simulator();
    let script = "def i():\n own = 1\n interpreter_mode()\nend\n";
    simulator.core().robot.controller().programs.upload(compile_program(script));
    (0..3).for_each(|_| simulator.advance());
    let mut simulator = talk_to(simulator, Port::Interpreter, data, 1, |replies| {
        let text = String::from_utf8_lossy(replies);
        let known = |line: &str| ["ack: ", "discard: ", "state: "].iter().any(|word| line.starts_with(word));
        // What a statement quotes may have line ends of its own kind; the first line is ours.
        assert!(text.lines().next().is_some_and(known), "{text:?}");
    });
    (0..FRAMES).for_each(|_| simulator.advance());
    let controller = simulator.core().robot.controller();
    assert!(controller.core.mover.q().0.iter().all(|angle| angle.is_finite()), "the arm is nowhere");
}

/// Requests to the Robot API of the newest software: in each piece the first byte says which, the line
/// after it goes on with the path, and the rest is the body.
pub fn robot_api(data: &[u8]) {
    const REQUESTS: [(&str, &str); 12] = [
        ("GET", "/openapi.json"),
        ("PUT", "/robotstate/v1/state"),
        ("GET", "/robotstate/v1/robotmode"),
        ("PUT", "/program/v1/loaded"),
        ("PUT", "/program/v1/state"),
        ("POST", "/programs/v1/"),
        ("PUT", "/programs/v1/"),
        ("GET", "/programs/v1/"),
        ("POST", "/popup/v1"),
        ("POST", "/supportfiles/v1"),
        ("GET", "/supportfiles/v1"),
        ("PUT", "/operational-mode/v1"),
    ];
    let config = ControllerConfig { version: [10, 14, 0, 1], ..ControllerConfig::ur5e(1) };
    let shared = RobotShared::new(Controller::new(config));
    for piece in pieces(data) {
        let Some((which, rest)) = piece.split_first() else { continue };
        let (method, path) = REQUESTS[usize::from(*which) % REQUESTS.len()];
        let end = rest.iter().position(|byte| *byte == b'\n').unwrap_or(0);
        let path = format!("{path}{}", String::from_utf8_lossy(&rest[..end]));
        let body = rest.get(end + 1..).unwrap_or_default();
        let content_type = match which / 128 {
            0 => "application/json",
            _ => "multipart/form-data; boundary=x",
        };
        let reply = match answer(&shared, &ApiRequest { method, path: &path, content_type, body }) {
            Outcome::Reply(reply) => Some(reply),
            Outcome::Until(goal) => (0..1000).find_map(|_| {
                shared.frame(None);
                reached(&shared, goal)
            }),
        };
        let reply = reply.expect("an action comes to an end");
        assert!((200..600).contains(&reply.status), "{reply:?}");
        shared.frame(None);
    }
}
