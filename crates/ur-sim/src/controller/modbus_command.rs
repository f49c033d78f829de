//! `modbus_send_custom_command`: one Modbus request to a device, whose answer the script does not get.
//!
//! In: calls from running programs, repeated each frame. Out: a Modbus TCP frame on a connection of its own,
//! to port 502. Assumed: the program goes on once the device has answered, after two seconds without an
//! answer, and when there is no connection, which the log of the controller would name. The simulator's
//! addition: `"127.0.0.1:5020"` as the address names another port.

use crate::controller::core::Core;
use crate::controller::sockets::SocketState;
use crate::motion::FRAMES_PER_SECOND;
use urscript::host::{Call, Reply};
use urscript::value::{ThreadId, Value};

/// Port of Modbus devices.
const PORT: u16 = 502;

/// Frames that a device has for its answer.
const PATIENCE_FRAMES: u64 = 2 * FRAMES_PER_SECOND;

/// Longest data of a request: a frame has 253 bytes from the function code on.
const MOST_DATA: usize = 252;

/// Carries out the built-in of this file; `None` if it is another one.
pub fn call(core: &mut Core, call: &mut Call<'_>) -> Option<Result<Reply, String>> {
    (call.name == "modbus_send_custom_command").then(|| send(core, call))
}

/// Name of the connection that a thread's command has.
pub(super) fn socket(thread: ThreadId) -> String {
    format!("the Modbus command of thread {}", thread.0)
}

fn send(core: &mut Core, call: &mut Call<'_>) -> Result<Reply, String> {
    if core.secondary {
        return Err(format!("{}: a secondary program must not wait", call.name));
    }
    let (host, port) = address(call)?;
    let frame = frame(call)?;
    let socket = socket(call.thread);
    if call.frames == 0 {
        core.sockets.open(&socket, &host, port);
        return Ok(Reply::Wait);
    }
    let state = core.sockets.state(&socket);
    if state == SocketState::Open && *call.note == 0 {
        *call.note = 1;
        core.sockets.send(&socket, &frame);
    }
    let answered = core.sockets.received(&socket).is_some_and(|answer| !answer.is_empty());
    if answered || state == SocketState::Closed || call.frames >= PATIENCE_FRAMES {
        core.sockets.close(&socket);
        return Ok(Reply::Value(Value::Nothing));
    }
    Ok(Reply::Wait)
}

fn address(call: &Call<'_>) -> Result<(String, u16), String> {
    let text = call.required(0)?.string()?;
    let wrong = || format!("{}: {text} is no address", call.name);
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) => (host, port.parse().map_err(|_| wrong())?),
        None => (&**text, PORT),
    };
    let plain = !host.is_empty() && !host.contains(|c: char| c.is_whitespace() || c.is_control());
    if plain { Ok((host.to_owned(), port)) } else { Err(wrong()) }
}

/// The request with its header; the number of the transaction is always 1, as no two are under way.
fn frame(call: &Call<'_>) -> Result<Vec<u8>, String> {
    let byte = |value: &Value| {
        let number = value.integer()?;
        u8::try_from(number).map_err(|_| format!("{}: {number} is not between 0 and 255", call.name))
    };
    let (unit, function) = (byte(call.required(1)?)?, byte(call.required(2)?)?);
    let data = call.required(3)?.elements()?;
    if data.len() > MOST_DATA {
        return Err(format!("{}: more than {MOST_DATA} bytes of data", call.name));
    }
    let length = u16::try_from(data.len() + 2).unwrap_or(u16::MAX).to_be_bytes();
    let mut frame = vec![0, 1, 0, 0, length[0], length[1], unit, function];
    for value in data {
        frame.push(byte(value)?);
    }
    Ok(frame)
}
