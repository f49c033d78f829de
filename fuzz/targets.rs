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
use ur_sim::session::Port;
use ur_sim::simulator::{Simulator, Transmission};
use ur_sim::world::lock;
use ur_sim::world::spec::{GripperSpec, WorldSpec};
use ur_sim::world::vacuum::Channel;
use ur_wire::dashboard::{Command, LineSplitter, Reply as DashboardReply};
use ur_wire::modbus;
use ur_wire::primary::Splitter as PrimarySplitter;
use ur_wire::rtde::{Frame, Reply, Request, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Recipe};
use ur_wire::rtde_variables::OUTPUTS;

/// What a target does with the bytes it is given.
pub type Target = fn(&[u8]);

/// Names of the targets and what they do.
pub const TARGETS: [(&str, Target); 5] = [
    ("rtde", rtde),
    ("dashboard", dashboard),
    ("primary", primary),
    ("urscript", urscript),
    ("modbus", modbus),
];

/// Most pieces of one input, and frames a program gets.
const MOST_PIECES: usize = 64;
const FRAMES: usize = 40;

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
    let mut controller = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
    let program = "def work():\n while True:\n  sync()\n end\nend\n";
    controller.programs.add("work", ProgramSource::Script(program.to_owned()));
    let world = WorldSpec::bare(Isometry3::identity(), GripperSpec::one_cup(0.2));
    Simulator::new(controller, world, 1, Vec::new()).expect("a sound cell")
}

/// Sends to a server of the simulator, `frames` frames after each piece; `received` gets what it sends, in
/// the pieces in which it sends it. The client then leaves.
fn talk(port: Port, data: &[u8], frames: usize, mut received: impl FnMut(&[u8])) -> Simulator {
    let mut simulator = simulator();
    let id = simulator.connect(port).expect("the server listens");
    let mut listen = |simulator: &mut Simulator| {
        while let Some(transmission) = simulator.transmit() {
            if let Transmission::Bytes(_, bytes) = transmission {
                received(&bytes);
            }
        }
    };
    listen(&mut simulator);
    for piece in pieces(data) {
        simulator.receive(id, piece);
        (0..frames).for_each(|_| simulator.advance());
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
    talk(Port::Dashboard, data, 3, |replies| assert!(replies.ends_with(b"\n"), "{replies:?}"));
    receive!(DashboardSession::default(), data, |client: &mut DashboardSession, now| {
        let _ = client.ask(now, Command::SafetyMode);
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
    let mut simulator = talk(Port::Primary, data, 3, |bytes| {
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
