//! `modbus_send_custom_command` to real listeners.

use super::*;

#[test]
fn a_custom_command_goes_out_as_a_frame_and_the_program_waits_for_the_answer() {
    // The script manual's example: 600 ms of watchdog for a bus coupler.
    let (sender, frames) = std::sync::mpsc::channel();
    let port = server(move |mut stream| {
        let mut frame = [0; 12];
        stream.read_exact(&mut frame).unwrap();
        sender.send(frame).unwrap();
        stream.write_all(&frame).unwrap();
    });
    let script = format!(
        "def m():\n textmsg(modbus_send_custom_command(\"127.0.0.1:{port}\", 103, 6, [17,32,2,88]))\n \
         textmsg(\"on\")\nend\n"
    );
    assert_eq!(said(&script).last().map(String::as_str), Some("on"));
    assert_eq!(frames.recv_timeout(PATIENCE).unwrap(), [0, 1, 0, 0, 0, 6, 103, 6, 17, 32, 2, 88]);
}

#[test]
fn a_device_that_is_silent_or_not_there_holds_the_program_up_for_two_seconds_at_most() {
    let port = server(|mut stream| {
        let mut byte = [0];
        while stream.read(&mut byte).is_ok_and(|count| count > 0) {}
    });
    let gone = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    for port in [port, gone] {
        let script = format!(
            "def m():\n modbus_send_custom_command(\"127.0.0.1:{port}\", 1, 6, [0,0,0,1])\n textmsg(\"on\")\nend\n"
        );
        let mut controller = controller();
        start(&mut controller, &script);
        let begun = controller.core.step;
        step_until(&mut controller, stopped);
        assert!(controller.core.step - begun < 1010);
    }
    for (call, complaint) in [
        ("modbus_send_custom_command(\"\", 1, 6, [0])", "is no address"),
        ("modbus_send_custom_command(\"a b\", 1, 6, [0])", "is no address"),
        ("modbus_send_custom_command(\"127.0.0.1\", 256, 6, [0])", "256 is not between"),
        ("modbus_send_custom_command(\"127.0.0.1\", 1, -1, [0])", "-1 is not between"),
        ("modbus_send_custom_command(\"127.0.0.1\", 1, 6, [300])", "300 is not between"),
    ] {
        let said = said(&format!("def m():\n {call}\nend\n"));
        assert!(said.iter().any(|text| text.contains(complaint)), "{call}: {said:?}");
    }
}

#[test]
fn threads_that_are_killed_while_they_wait_for_a_device_leave_no_connection() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let mut controller = controller();
    let script = format!(
        "def m():\n thread t():\n  modbus_send_custom_command(\"127.0.0.1:{port}\", 1, 6, [0])\n end\n n = 0\n \
         while n < 40:\n  h = run t()\n  sleep(0.004)\n  kill h\n  n = n + 1\n end\n \
         textmsg(socket_open(\"127.0.0.1\", {port}))\nend\n"
    );
    start(&mut controller, &script);
    step_until(&mut controller, stopped);
    let said = controller.core.take_messages();
    assert!(said.contains(&MessageBody::Text("True".to_owned())), "{said:?}");
}
