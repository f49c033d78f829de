//! Built-ins on sockets.
//!
//! In: calls from running programs, repeated each frame while they wait. Out: values as the script manual
//! gives them: a read of numbers is a list that starts with how many arrived; what did not arrive in time is
//! -1 (whole numbers) or not a number (floats), a string is empty. A timeout of 0 or less waits for ever, 2
//! s is the default, and a peer that has gone ends a wait at once. Nothing here is an exception but a wrong
//! argument.

use crate::controller::core::Core;
use crate::controller::sockets::SocketState;
use crate::motion::FRAME_SECONDS;
use urscript::host::{Call, Reply};
use urscript::string_library::whole;
use urscript::value::Value;

/// Values a script may request in one call.
const MAX_VALUES: i32 = 30;

/// Characters that `socket_read_string` gives at most.
const MAX_STRING: usize = 1023;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &mut Call<'_>) -> Option<Result<Reply, String>> {
    Some(match call.name {
        "socket_open" => open(core, call),
        "socket_close" => name(call, 0).map(|name| {
            core.sockets.close(&name);
            Reply::Value(Value::Nothing)
        }),
        "socket_read_binary_integer" => read_list(core, call, Format::Integers),
        "socket_read_byte_list" => read_list(core, call, Format::Bytes),
        "socket_read_ascii_float" => read_list(core, call, Format::Ascii),
        "socket_read_string" => read_string(core, call),
        "socket_read_line" => read_line(core, call),
        "socket_send_int" => integer(call).and_then(|n| send(core, call, &n.to_be_bytes())),
        "socket_send_byte" => integer(call).and_then(|n| match u8::try_from(n) {
            Ok(byte) => send(core, call, &[byte]),
            Err(_) => Err(format!("socket_send_byte: {n} is not between 0 and 255")),
        }),
        "socket_send_string" => {
            call.required(0).and_then(whole).and_then(|text| send(core, call, text.as_bytes()))
        }
        "socket_send_line" => {
            call.required(0).and_then(whole).and_then(|text| send(core, call, (text + "\n").as_bytes()))
        }
        "socket_get_var" => get_variable(core, call),
        "socket_set_var" => set_variable(core, call),
        _ => return None,
    })
}

fn integer(call: &Call<'_>) -> Result<i32, String> {
    call.required(0)?.integer()
}

/// The socket's name, an optional argument.
fn name(call: &Call<'_>, index: usize) -> Result<String, String> {
    call.argument(index).map_or(Ok("socket_0".to_owned()), |value| Ok(value.string()?.to_string()))
}

fn open(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let name = name(call, 2)?;
    if call.frames == 0 {
        let port = call.required(1)?.integer()?;
        let port = u16::try_from(port).map_err(|_| format!("socket_open: there is no port {port}"))?;
        core.sockets.open(&name, call.required(0)?.string()?, port);
        return Ok(Reply::Wait);
    }
    Ok(match core.sockets.state(&name) {
        SocketState::Connecting => Reply::Wait,
        state => Reply::Value(Value::Bool(state == SocketState::Open)),
    })
}

fn send(core: &mut Core, call: &Call<'_>, bytes: &[u8]) -> Result<Reply, String> {
    let name = name(call, 1)?;
    Ok(Reply::Value(Value::Bool(core.sockets.send(&name, bytes))))
}

/// What a wait for bytes comes to.
enum Arrived<T> {
    /// It was there, and was taken.
    Now(T),
    /// The time is up, or nothing more can come.
    Never,
    NotYet,
}

/// Tries to take something from the front of what has arrived; `take` says how many bytes it used.
fn take<T>(
    core: &mut Core,
    call: &Call<'_>,
    socket: &str,
    timeout: f64,
    take: impl Fn(&[u8]) -> Option<(usize, T)>,
) -> Arrived<T> {
    let found = core.sockets.received(socket).and_then(|received| {
        let (used, value) = take(received)?;
        received.drain(..used.min(received.len()));
        Some(value)
    });
    if let Some(value) = found {
        return Arrived::Now(value);
    }
    // A failed read takes a frame, so that a loop of reads on a closed socket lets time pass.
    let gone = call.frames > 0 && core.sockets.state(socket) == SocketState::Closed;
    let late = timeout > 0.0 && call.frames as f64 * FRAME_SECONDS >= timeout - 1e-9;
    if gone || late { Arrived::Never } else { Arrived::NotYet }
}

#[derive(Clone, Copy)]
enum Format {
    /// 32 bit, big-endian.
    Integers,
    Bytes,
    /// `(1.0, 2.5)`
    Ascii,
}

fn read_list(core: &mut Core, call: &Call<'_>, format: Format) -> Result<Reply, String> {
    let wanted = integer(call)?;
    if !(1..=MAX_VALUES).contains(&wanted) {
        return Err(format!("{}: {wanted} values cannot be read, only 1 to {MAX_VALUES}", call.name));
    }
    let (count, socket) = (wanted.unsigned_abs() as usize, name(call, 1)?);
    let timeout = call.number_or(2, 2.0)?;
    let arrived = take(core, call, &socket, timeout, |bytes| match format {
        Format::Integers => {
            let front = bytes.get(..4 * count)?;
            let whole = |b: &[u8]| Value::Int(b.iter().fold(0, |n, byte| n << 8 | i32::from(*byte)));
            Some((4 * count, front.chunks_exact(4).map(whole).collect()))
        }
        Format::Bytes => {
            let front = bytes.get(..count)?;
            Some((count, front.iter().map(|byte| Value::Int(i32::from(*byte))).collect()))
        }
        Format::Ascii => ascii_floats(bytes, count),
    });
    let values: Vec<Value> = match arrived {
        Arrived::Now(values) => values,
        Arrived::Never => Vec::new(),
        Arrived::NotYet => return Ok(Reply::Wait),
    };
    let missing = match format {
        Format::Ascii => Value::Float(f64::NAN),
        Format::Integers | Format::Bytes => Value::Int(-1),
    };
    let mut list = vec![Value::Int(values.len() as i32)];
    list.extend(values);
    list.resize(count + 1, missing);
    Ok(Reply::Value(Value::list(list)))
}

/// Numbers in round brackets; one that is none makes the read fail.
fn ascii_floats(bytes: &[u8], count: usize) -> Option<(usize, Vec<Value>)> {
    let start = bytes.iter().position(|byte| *byte == b'(')?;
    let end = start + bytes.get(start..)?.iter().position(|byte| *byte == b')')?;
    let text = String::from_utf8_lossy(bytes.get(start + 1..end)?).into_owned();
    let numbers: Result<Vec<f64>, _> = text.split(',').take(count).map(|part| part.trim().parse()).collect();
    let values = numbers.unwrap_or_default().into_iter().map(Value::Float).collect();
    Some((end + 1, values))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn text_reply(arrived: Arrived<String>) -> Reply {
    match arrived {
        Arrived::Now(text) => Reply::Value(Value::text(text)),
        Arrived::Never => Reply::Value(Value::text("")),
        Arrived::NotYet => Reply::Wait,
    }
}

fn read_line(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let socket = name(call, 0)?;
    let timeout = call.number_or(1, 2.0)?;
    Ok(text_reply(take(core, call, &socket, timeout, line)))
}

fn line(bytes: &[u8]) -> Option<(usize, String)> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    Some((end + 1, text(bytes.get(..end)?).trim_end_matches('\r').to_owned()))
}

/// Without a prefix and suffix: all that has arrived. With them: what is between, which they are cut off.
fn read_string(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let socket = name(call, 0)?;
    let escapes = call.argument(3).map_or(Ok(false), Value::truth)?;
    let bracket = |index: usize| -> Result<Vec<u8>, String> {
        let given = call.argument(index).map_or(Ok(""), |value| value.string().map(|text| &**text))?;
        Ok(if escapes { unescaped(given) } else { given.to_owned() }.into_bytes())
    };
    let (prefix, suffix) = (bracket(1)?, bracket(2)?);
    let timeout = call.number_or(4, 2.0)?;
    Ok(text_reply(take(core, call, &socket, timeout, |bytes| {
        let start = if prefix.is_empty() { 0 } else { find(bytes, &prefix)? + prefix.len() };
        let rest = bytes.get(start..)?;
        let (length, used) = if suffix.is_empty() {
            (rest.len().min(MAX_STRING), rest.len().min(MAX_STRING))
        } else {
            let length = find(rest, &suffix)?;
            (length.min(MAX_STRING), length + suffix.len())
        };
        let nothing_yet = suffix.is_empty() && length == 0;
        (!nothing_yet).then(|| (start + used, text(&rest[..length])))
    })))
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes.windows(wanted.len()).position(|window| window == wanted)
}

fn unescaped(text: &str) -> String {
    text.replace("\\n", "\n").replace("\\r", "\r").replace("\\t", "\t").replace("\\\\", "\\")
}

/// `GET name`, and the answer `name value`; 0 if none comes within 2 s.
fn get_variable(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let (variable, socket) = (call.required(0)?.string()?.clone(), name(call, 1)?);
    if call.frames == 0 {
        core.sockets.send(&socket, format!("GET {variable}\n").as_bytes());
    }
    let value = |bytes: &[u8]| {
        let (used, line) = line(bytes)?;
        let value = line.strip_prefix(&*variable).and_then(|rest| rest.trim().parse().ok());
        Some((used, value.unwrap_or(0)))
    };
    Ok(match take(core, call, &socket, 2.0, value) {
        Arrived::Now(value) => Reply::Value(Value::Int(value)),
        Arrived::Never => Reply::Value(Value::Int(0)),
        Arrived::NotYet => Reply::Wait,
    })
}

fn set_variable(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let message = format!("SET {} {}\n", call.required(0)?.string()?, call.required(1)?.integer()?);
    let socket = name(call, 2)?;
    Ok(Reply::Value(Value::Bool(core.sockets.send(&socket, message.as_bytes()))))
}
