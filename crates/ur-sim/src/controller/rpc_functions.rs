//! `rpc_factory` and the calls on its handles.
//!
//! In: calls from running programs, repeated each frame while they wait. Out: the value that the server has
//! answered, or a runtime exception: a server that is not there, does not answer or reports a fault
//! (assumed; the manual leaves it open). Each call is one HTTP request on a connection of its own; the
//! script waits and the controller does not.

use crate::controller::core::Core;
use crate::controller::sockets::{MAX_BUFFER, SocketState};
use crate::controller::xml_rpc;
use crate::motion::FRAMES_PER_SECOND;
use urscript::host::{Call, REMOTE_CALL, Reply};
use urscript::value::{ThreadId, Value};

/// Frames that a server has for its answer.
const PATIENCE_FRAMES: u64 = 10 * FRAMES_PER_SECOND;

/// Method of a handle that is no call: it ends the connection, which here ends with each call.
const CLOSE: &str = "closeXMLRPCClientConnection";

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &mut Call<'_>) -> Option<Result<Reply, String>> {
    match call.name {
        "rpc_factory" => Some(factory(call)),
        _ if call.name != REMOTE_CALL.name => None,
        _ if core.secondary => Some(Err(format!("{}: a secondary program must not wait", call.name))),
        _ => Some(remote(core, call)),
    }
}

/// Name of the connection that a thread's call has.
pub(super) fn socket(thread: ThreadId) -> String {
    format!("the calls of thread {}", thread.0)
}

fn factory(call: &Call<'_>) -> Result<Reply, String> {
    let kind = call.required(0)?.string()?;
    if !kind.eq_ignore_ascii_case("xmlrpc") {
        return Err(format!("rpc_factory: there is no type {kind}"));
    }
    let url = call.required(1)?.string()?.clone();
    address(&url)?;
    Ok(Reply::Value(Value::Remote(url)))
}

/// Host, port and path of a URL.
fn address(url: &str) -> Result<(&str, u16, &str), String> {
    let wrong = || format!("rpc_factory: {url} is not an address like http://127.0.0.1:8080/RPC2");
    let rest = url.strip_prefix("http://").ok_or_else(wrong)?;
    let (place, path) = rest.find('/').map_or((rest, "/RPC2"), |slash| rest.split_at(slash));
    let (host, port) = match place.rsplit_once(':') {
        Some((host, port)) => (host, port.parse().map_err(|_| wrong())?),
        None => (place, 80),
    };
    let plain =
        |text: &str| !text.is_empty() && !text.contains(|c: char| c.is_whitespace() || c.is_control());
    if plain(host) && plain(path) { Ok((host, port, path)) } else { Err(wrong()) }
}

fn remote(core: &mut Core, call: &mut Call<'_>) -> Result<Reply, String> {
    let Value::Remote(url) = call.required(0)? else { return Err("this is no handle of calls".to_owned()) };
    let (url, method) = (url.clone(), call.required(1)?.string()?.clone());
    let (host, port, path) = address(&url)?;
    let socket = socket(call.thread);
    if method.as_ref() == CLOSE {
        return Ok(Reply::Value(Value::Bool(true)));
    }
    if call.frames == 0 {
        core.sockets.open(&socket, host, port);
        return Ok(Reply::Wait);
    }
    let state = core.sockets.state(&socket);
    if state == SocketState::Open && *call.note == 0 {
        let Value::List(arguments) = call.required(2)? else {
            return Err("there are no arguments".to_owned());
        };
        let body = xml_rpc::call(&method, arguments)?;
        let length = body.len();
        let head = format!(
            "POST {path} HTTP/1.0\r\nHost: {host}:{port}\r\nContent-Type: text/xml\r\nContent-Length: \
             {length}\r\n\r\n"
        );
        *call.note = 1;
        if !core.sockets.send(&socket, (head + &body).as_bytes())
            && core.sockets.state(&socket) == SocketState::Open
        {
            return Err(format!("{method} at {url}: the call is too long"));
        }
    }
    let closed = state == SocketState::Closed;
    let received = core.sockets.received(&socket).map(|bytes| &**bytes).unwrap_or_default();
    let answer = answer(received, closed);
    let failed = match (&answer, closed) {
        (Some(_), _) => None,
        (None, true) if *call.note == 0 => Some("no connection"),
        (None, true) => Some("the connection ended without an answer"),
        (None, false) if received.len() >= MAX_BUFFER => Some("the answer is too long"),
        (None, false) if call.frames >= PATIENCE_FRAMES => Some("no answer in time"),
        (None, false) => return Ok(Reply::Wait),
    };
    core.sockets.close(&socket);
    let value = match (answer, failed) {
        (Some(answer), _) => answer,
        (None, reason) => Err(reason.unwrap_or_default().to_owned()),
    };
    value.map(Reply::Value).map_err(|reason| format!("{method} at {url}: {reason}"))
}

/// The answer once it is whole: as many bytes as its head says, or all until the connection ended.
fn answer(received: &[u8], closed: bool) -> Option<Result<Value, String>> {
    let text = String::from_utf8_lossy(received);
    let (head, body) = text.split_once("\r\n\r\n")?;
    let mut lines = head.lines();
    let status = lines.next()?.split(' ').nth(1).unwrap_or_default().to_owned();
    let named = |line: &str| Some(line.split_once(':')?.1.trim().parse::<usize>().ok());
    let length = lines.find(|line| line.to_ascii_lowercase().starts_with("content-length:")).and_then(named);
    let whole = match length.flatten() {
        Some(length) => body.len() >= length,
        None => closed,
    };
    if !whole && !closed {
        return None;
    }
    Some(if status == "200" { xml_rpc::answer(body) } else { Err(format!("HTTP status {status}")) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_host_and_may_have_a_port_and_a_path() {
        assert_eq!(address("http://127.0.0.1/RPC2"), Ok(("127.0.0.1", 80, "/RPC2")));
        assert_eq!(address("http://pc:41414"), Ok(("pc", 41_414, "/RPC2")));
        assert_eq!(address("http://pc:41414/"), Ok(("pc", 41_414, "/")));
        for wrong in ["pc", "https://pc", "http://", "http://pc:x/", "http://p c/", "http://pc/a\r\nb: c"] {
            assert!(address(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn an_answer_is_whole_by_its_length_or_at_the_end() {
        let body =
            "<methodResponse><params><param><value><int>4</int></value></param></params></methodResponse>";
        let with = format!("HTTP/1.1 200 OK\r\ncontent-length: {}\r\n\r\n{body}", body.len());
        assert_eq!(answer(with.as_bytes(), false), Some(Ok(Value::Int(4))));
        assert_eq!(answer(&with.as_bytes()[..with.len() - 1], false), None);
        let without = format!("HTTP/1.0 200 OK\r\n\r\n{body}");
        assert_eq!(answer(without.as_bytes(), false), None);
        assert_eq!(answer(without.as_bytes(), true), Some(Ok(Value::Int(4))));
        assert_eq!(answer(b"HTTP/1.0 404 no\r\n\r\n", true), Some(Err("HTTP status 404".to_owned())));
        assert_eq!(answer(b"HTTP/1.0 200", true), None);
    }
}
