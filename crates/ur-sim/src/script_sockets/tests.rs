//! Scripts that exchange bytes with real listeners, frame by frame.

use super::*;
use crate::controller::builtins::compile_program;
use crate::controller::{Controller, ControllerConfig};
use std::net::TcpListener;
use std::time::Instant;
use ur_wire::enumerations::RuntimeState;
use ur_wire::primary_message::MessageBody;

mod external_control;
mod modbus;
mod xml_rpc;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

fn controller() -> Controller {
    let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(3) });
    controller.core.sockets = Box::new(TcpScriptSockets::default());
    controller
}

fn start(controller: &mut Controller, script: &str) {
    assert!(controller.programs.upload(compile_program(script)));
    controller.frame();
}

/// Steps frames at twice the speed of real time: scripts wait 2 simulated seconds for a peer, and frames as
/// fast as they can be made leave a peer on a busy computer a few milliseconds of that.
#[track_caller]
fn step_until(controller: &mut Controller, done: impl Fn(&Controller) -> bool) {
    let start = Instant::now();
    let mut due = start;
    while !done(controller) {
        controller.frame();
        assert!(start.elapsed() < PATIENCE, "did not happen: {:?}", controller.core.take_messages());
        // Time that the computer has lost is not made up for by frames that leave a peer none.
        due = due.max(Instant::now()) + Duration::from_millis(1);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
}

fn stopped(controller: &Controller) -> bool {
    controller.programs.runtime_state() == RuntimeState::Stopped
}

/// Runs a script to its end; what it said by `textmsg`.
#[track_caller]
fn said(script: &str) -> Vec<String> {
    let mut controller = controller();
    start(&mut controller, script);
    step_until(&mut controller, stopped);
    let texts = controller.core.take_messages().into_iter().filter_map(|message| match message {
        MessageBody::Text(text) => Some(text),
        MessageBody::RuntimeException { text, .. } => Some(format!("exception {text}")),
        _ => None,
    });
    texts.collect()
}

/// A server for one connection; what it does ends with its thread.
fn server(serve: impl FnOnce(TcpStream) + Send + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || serve(listener.accept().unwrap().0));
    port
}

fn integers(values: &[i32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

#[test]
fn a_sender_that_is_faster_than_its_reader_is_no_endless_loop() {
    let port = server(|mut stream| while stream.write_all(&[7; 65_536]).is_ok() {});
    let mut controller = controller();
    let script = format!(
        "def r():\n socket_open(\"127.0.0.1\", {port})\n while True:\n  n = socket_read_byte_list(1)\n  \
         write_output_integer_register(24, read_output_integer_register(24) + n[1])\n end\nend\n"
    );
    start(&mut controller, &script);
    step_until(&mut controller, |c| c.core.registers.output_ints[24] > 7 * 10_000 || stopped(c));
    assert!(controller.programs.playing(), "{:?}", controller.core.take_messages());
}

#[test]
fn every_way_of_reading_takes_its_part_of_the_stream() {
    let port = server(|mut stream| {
        stream.write_all(&integers(&[5, -6])).unwrap();
        stream.write_all(b"\x01\xff( 1.5 , -2,3e1)line\r\n<a><b>rest").unwrap();
        let mut received = Vec::new();
        stream.read_to_end(&mut received).unwrap();
    });
    let script = format!(
        "def r():\n textmsg(socket_open(\"127.0.0.1\", {port}))\n \
         textmsg(socket_read_binary_integer(2))\n textmsg(socket_read_byte_list(2))\n \
         textmsg(socket_read_ascii_float(3))\n textmsg(socket_read_line())\n \
         textmsg(socket_read_string(prefix=\"<\", suffix=\">\"))\n textmsg(socket_read_string(prefix=\"<\", \
         suffix=\">\"))\n \
         textmsg(socket_read_string())\n textmsg(socket_read_binary_integer(3, timeout=0.01))\nend\n"
    );
    let expected = [
        "True",
        "[2, 5, -6]",
        "[2, 1, 255]",
        "[3, 1.5, -2, 30]",
        "line",
        "a",
        "b",
        "rest",
        "[0, -1, -1, -1]",
    ];
    assert_eq!(said(&script), expected);
}

#[test]
fn every_way_of_sending_arrives_as_documented() {
    let (sender, arrived) = sync_channel(1);
    let port = server(move |mut stream| {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        sender.send(bytes).unwrap();
    });
    let script = format!(
        "def s():\n socket_open(\"127.0.0.1\", {port}, \"x\")\n textmsg(socket_send_int(-2, \"x\"))\n \
         socket_send_byte(65, \"x\")\n socket_send_string([1, 2], \"x\")\n socket_send_line(\"b\", \"x\")\n \
         socket_set_var(\"POS\", 7, \"x\")\n textmsg(socket_send_int(1, \"nobody\"))\n socket_close(\"x\")\n\
         end\n"
    );
    assert_eq!(said(&script), ["True", "False"]);
    assert_eq!(arrived.recv_timeout(PATIENCE).unwrap(), b"\xff\xff\xff\xfeA[1, 2]b\nSET POS 7\n");
}

#[test]
fn the_controller_calls_from_its_own_address() {
    let (seen, came) = sync_channel(1);
    let port = server(move |stream| seen.send(stream.peer_addr().unwrap().ip()).unwrap());
    let mut controller = controller();
    let address = IpAddr::from([127, 71, 3, 9]);
    controller.core.sockets = Box::new(TcpScriptSockets::from_address(address));
    start(&mut controller, &format!("def s():\n socket_open(\"127.0.0.1\", {port}, \"x\")\nend\n"));
    step_until(&mut controller, stopped);
    assert_eq!(came.recv_timeout(PATIENCE), Ok(address));
}

#[test]
fn a_variable_is_requested_and_answered() {
    let port = server(|mut stream| {
        let mut requested = [0; 8];
        stream.read_exact(&mut requested).unwrap();
        assert_eq!(&requested, b"GET POS\n");
        stream.write_all(b"POS 42\n").unwrap();
    });
    assert_eq!(
        said(&format!(
            "def g():\n socket_open(\"127.0.0.1\", {port})\n textmsg(socket_get_var(\"POS\"))\nend\n"
        )),
        ["42"]
    );
}

#[test]
fn a_refused_connection_and_a_closed_peer_are_values_not_exceptions() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert_eq!(said(&format!("def o():\n textmsg(socket_open(\"127.0.0.1\", {port}))\nend\n")), ["False"]);
    let port = server(drop);
    let script = format!(
        "def c():\n socket_open(\"127.0.0.1\", {port})\n i = 0\n while i < 3:\n  \
         textmsg(socket_read_binary_integer(1, timeout=0))\n  i = i + 1\n end\nend\n"
    );
    assert_eq!(said(&script), ["[0, -1]", "[0, -1]", "[0, -1]"]);
    assert_eq!(
        said("def n():\n socket_read_binary_integer(31)\nend\n"),
        ["exception socket_read_binary_integer: 31 values cannot be read, only 1 to 30"]
    );
}

#[test]
fn a_peer_that_never_reads_does_not_hold_the_controller() {
    let (keep, kept) = sync_channel::<()>(0);
    let port = server(move |stream| {
        let _ = kept.recv_timeout(PATIENCE);
        drop(stream);
    });
    let script = format!(
        "def f():\n socket_open(\"127.0.0.1\", {port})\n t = \"0123456789\"\n i = 0\n while i < 10:\n  \
         t = str_cat(t, t)\n  i = i + 1\n end\n while socket_send_string(t):\n  sync()\n end\n \
         textmsg(\"full\")\nend\n"
    );
    assert_eq!(said(&script), ["full"]);
    drop(keep);
}

#[test]
fn sockets_close_with_the_program() {
    let (ended, end) = sync_channel(1);
    let port = server(move |mut stream| {
        let mut bytes = Vec::new();
        ended.send(stream.read_to_end(&mut bytes).is_ok()).unwrap();
    });
    let mut controller = controller();
    start(
        &mut controller,
        &format!("def w():\n socket_open(\"127.0.0.1\", {port})\n textmsg(1)\n sleep(1000)\nend\n"),
    );
    step_until(&mut controller, |c| c.core.step > 5 && c.programs.playing());
    step_until(&mut controller, |c| c.programs.line() == 4);
    controller.programs.stop(&mut controller.core);
    assert!(end.recv_timeout(PATIENCE).unwrap());
}

/// The way client libraries drive an arm from the PC: set-points on one socket, a trajectory on another
/// while the first one is read on, and a cancellation in the middle of it.
const EXTERNAL: &str = "
def external():
  global mode = 0
  global points = 0
  global motion = 0
  thread trajectory():
    enter_critical
    result = 0
    while points > 0:
      raw = socket_read_binary_integer(21, \"trajectory\", 0.5)
      points = points - 1
      q = [raw[1], raw[2], raw[3], raw[4], raw[5], raw[6]] / 1000000
      movej(q, t=raw[19] / 1000000, r=raw[20] / 1000000)
    end
    exit_critical
    stopj(4.0)
    socket_send_int(result, \"trajectory\")
  end
  socket_open(\"127.0.0.1\", TRAJECTORY, \"trajectory\")
  socket_open(\"127.0.0.1\", REVERSE, \"reverse\")
  timeout = 0.0
  while mode > -2:
    enter_critical
    order = socket_read_binary_integer(8, \"reverse\", timeout)
    if order[0] == 0:
      kill motion
      stopj(4.0)
      halt
    end
    timeout = order[1] / 1000.0
    mode = order[8]
    if mode == 1:
      servoj([order[2], order[3], order[4], order[5], order[6], order[7]] / 1000000, t=get_steptime())
    elif mode == 3 and order[2] == 1:
      points = order[3]
      motion = run trajectory()
    elif mode == 3 and order[2] == -1:
      kill motion
      stopj(4.0)
      socket_send_int(1, \"trajectory\")
    end
    exit_critical
  end
end
";

/// The PC's two sockets of [`EXTERNAL`], connected.
fn external(controller: &mut Controller) -> (TcpStream, TcpStream) {
    let [trajectory, reverse] = [(), ()].map(|()| TcpListener::bind("127.0.0.1:0").unwrap());
    let port = |listener: &TcpListener| listener.local_addr().unwrap().port().to_string();
    let script = EXTERNAL.replace("TRAJECTORY", &port(&trajectory)).replace("REVERSE", &port(&reverse));
    start(controller, &script);
    for listener in [&trajectory, &reverse] {
        listener.set_nonblocking(true).unwrap();
    }
    let accept = |listener: &TcpListener, controller: &mut Controller| {
        let start = Instant::now();
        loop {
            controller.frame();
            match listener.accept() {
                Ok((stream, _)) => return stream,
                Err(_) => assert!(start.elapsed() < PATIENCE, "the script does not connect"),
            }
        }
    };
    let streams = (accept(&trajectory, controller), accept(&reverse, controller));
    streams.0.set_nonblocking(false).unwrap();
    streams.1.set_nonblocking(false).unwrap();
    streams
}

fn micro(q: [f64; 6]) -> Vec<i32> {
    q.iter().map(|value| (value * 1e6).round() as i32).collect()
}

#[test]
fn set_points_and_trajectories_come_over_sockets() {
    let mut controller = controller();
    let (mut trajectory, mut reverse) = external(&mut controller);
    let q = [0.1, -1.5, 1.5, -1.6, -1.5, 0.1];
    for _ in 0..600 {
        let order = [vec![0], micro(q), vec![1]].concat();
        reverse.write_all(&integers(&order)).unwrap();
        controller.frame();
    }
    step_until(&mut controller, |c| c.core.mover.q().max_difference(&cell_values::units::Joints(q)) < 1e-3);
    let targets = [[0.3, -1.4, 1.5, -1.6, -1.5, 0.1], [0.5, -1.4, 1.4, -1.6, -1.5, 0.1]];
    reverse.write_all(&integers(&[0, 1, 2, 0, 0, 0, 0, 3])).unwrap();
    for (index, target) in targets.iter().enumerate() {
        let blend = if index == 0 { 50_000 } else { 0 };
        let point = [micro(*target), vec![0; 12], vec![1_000_000, blend, 0]].concat();
        trajectory.write_all(&integers(&point)).unwrap();
    }
    step_until(&mut controller, |c| c.core.mover.q().0 == targets[1]);
    (0..10).for_each(|_| controller.frame());
    let mut result = [9; 4];
    trajectory.read_exact(&mut result).unwrap();
    assert_eq!(result, [0; 4]);
}

#[test]
fn a_trajectory_within_the_critical_section_can_be_cancelled_and_silence_ends_the_program() {
    let mut controller = controller();
    let (mut trajectory, mut reverse) = external(&mut controller);
    reverse.write_all(&integers(&[0, 1, 1, 0, 0, 0, 0, 3])).unwrap();
    let point = [micro([2.0, -1.4, 1.5, -1.6, -1.5, 0.1]), vec![0; 12], vec![5_000_000, 0, 0]].concat();
    trajectory.write_all(&integers(&point)).unwrap();
    step_until(&mut controller, |c| c.core.mover.q().0[0] > 0.1);
    reverse.write_all(&integers(&[50, -1, 0, 0, 0, 0, 0, 3])).unwrap();
    step_until(&mut controller, stopped);
    let mut result = [9; 4];
    trajectory.read_exact(&mut result).unwrap();
    assert_eq!(result, [0, 0, 0, 1]);
    assert!(controller.core.mover.q().0[0] < 1.0 && controller.core.mover.stands());
}
