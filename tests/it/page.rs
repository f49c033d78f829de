//! The page over sockets, without a browser: who is let in, what is refused and bounded, and that orders and
//! jobs given there do what they say.
//!
//! In: `celld sim` and `celld run` as processes, requests byte by byte. Every address of the table is tried
//! without a session, with a role too low, under a foreign name, from a foreign page, with a body too large
//! and with one that never comes.

use crate::cell::{
    LOG, Running, celld, configuration, copy_calibration, start_daemon, start_sim, text, wait_until,
};
use cell_machine::orders::Role;
use celld::page::routes::{Route, table};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// A cell of this test's own, and how its page is reached.
struct Cell {
    folder: tempfile::TempDir,
    host: String,
    _sim: Running,
    daemon: Running,
}

/// A request; what is empty is left out.
#[derive(Clone, Copy, Default)]
struct Request<'a> {
    method: &'a str,
    path: &'a str,
    host: &'a str,
    origin: &'a str,
    token: &'a str,
    cookie: &'a str,
    body: &'a str,
}

/// Status, head and body.
struct Answer {
    status: u16,
    head: String,
    body: String,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.body))
    }
}

impl Cell {
    fn start(address: &str, factor: u32) -> Cell {
        let folder = tempfile::tempdir().expect("a folder");
        let (cell, sim) = configuration(folder.path(), address, factor);
        copy_calibration(folder.path());
        let sim = start_sim(&sim);
        let daemon = start_daemon(folder.path(), &cell);
        let cell = Cell { folder, host: format!("{address}:8737"), _sim: sim, daemon };
        wait_until("orders are taken", || celld(&["open", "--print"], cell.path()).status.success());
        cell
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn token(&self, role: Role) -> String {
        let made = celld(&["open", "--token", "--role", role.as_str(), "--name", role.as_str()], self.path());
        assert!(made.status.success(), "{}", text(&made.stderr));
        text(&made.stdout).trim().to_string()
    }

    fn send(&self, request: Request) -> Answer {
        let mut head = format!("{} {} HTTP/1.1\r\nconnection: close\r\n", request.method, request.path);
        let host = if request.host.is_empty() { &self.host } else { request.host };
        let bearer =
            if request.token.is_empty() { String::new() } else { format!("Bearer {}", request.token) };
        for (name, value) in [
            ("host", host),
            ("origin", request.origin),
            ("authorization", &bearer),
            ("cookie", request.cookie),
        ] {
            if !value.is_empty() {
                head.push_str(&format!("{name}: {value}\r\n"));
            }
        }
        if !request.body.is_empty() {
            head.push_str(&format!(
                "content-type: application/json\r\ncontent-length: {}\r\n",
                request.body.len()
            ));
        }
        let mut stream = TcpStream::connect(&self.host).expect("connected");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
        stream.write_all(format!("{head}\r\n").as_bytes()).expect("sent");
        // What is refused early may not be read to its end.
        let _ = stream.write_all(request.body.as_bytes());
        answer_of(&mut stream)
    }

    fn get(&self, path: &str, token: &str) -> Answer {
        self.send(Request { method: "GET", path, token, ..Request::default() })
    }

    fn post(&self, path: &str, token: &str, body: &Value) -> Answer {
        self.send(Request { method: "POST", path, token, body: &body.to_string(), ..Request::default() })
    }

    /// An order of a program; its answer.
    fn order(&self, token: &str, command: Value) -> Value {
        self.post("/api/v1/orders", token, &json!({ "command": command })).json()
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.path().join(LOG)).expect("the daemon's log")
    }
}

/// One answer, to the end of the connection or of its stated length.
fn answer_of(stream: &mut TcpStream) -> Answer {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => break,
            Ok(size) => bytes.extend_from_slice(&buffer[..size]),
        }
        if String::from_utf8_lossy(&bytes).contains("text/event-stream") {
            break;
        }
    }
    let all = String::from_utf8_lossy(&bytes).into_owned();
    let (head, body) = all.split_once("\r\n\r\n").unwrap_or((&all, ""));
    let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
    Answer { status, head: head.to_string(), body: body.to_string() }
}

/// A path of the table with something in its places.
fn filled(route: &Route) -> String {
    route.path.replace("{id}", "none").replace("{name}", "none.yaml")
}

#[test]
fn cell_page_lets_in_whom_it_should_and_bounds_the_rest() {
    let cell = Cell::start("127.7.7.1", 1);
    let view = cell.token(Role::View);
    let ours = format!("http://{}", cell.host);
    for route in table() {
        let (path, body) = (filled(&route), if route.method == "GET" { "" } else { "{}" });
        let plain = Request { method: route.method, path: &path, origin: &ours, body, ..Request::default() };
        let known = Request { token: &view, ..plain };
        let at = format!("{} {path}", route.method);
        let status = |request: Request| cell.send(request).status;
        assert_eq!(status(Request { host: "evil.example:8737", ..known }), 421, "{at}: a foreign name");
        assert_eq!(status(Request { origin: "http://evil.example", ..known }), 403, "{at}: a foreign page");
        let Some(least) = route.least else { continue };
        if least > Role::View {
            assert_eq!(status(known), 403, "{at}: a role too low");
        }
        if route.method != "GET" {
            let large = "x".repeat(600 * 1024);
            assert_eq!(status(Request { body: &large, ..known }), 413, "{at}: a body too large");
        }
    }
    // Strangers have their own limit, so that they use nothing up of those who are known.
    for route in table().into_iter().filter(|route| route.least.is_some()).take(12) {
        let (path, body) = (filled(&route), if route.method == "GET" { "" } else { "{}" });
        let plain = Request { method: route.method, path: &path, origin: &ours, body, ..Request::default() };
        let status = cell.send(plain).status;
        assert_eq!(status, 401, "{} {path} without a session", route.method);
    }
    let wrong = (0..30).map(|_| cell.get("/api/v1/status", "0123")).map(|answer| answer.status);
    let wrong: Vec<u16> = wrong.collect();
    assert!(wrong.contains(&429), "whoever tries secrets has to wait: {wrong:?}");
    assert_eq!(cell.get("/api/v1/status", &view).status, 200, "and keeps nobody else out");
    let log = cell.log();
    for wanted in ["page refused: the request comes from another page", "page refused: sign in first"] {
        assert!(log.contains(wanted), "{wanted}:\n{log}");
    }
    assert!(!log.contains(&view), "a token is not logged");
    assert_eq!(cell.get("/livez", "").status, 429, "a stranger of the same computer waits too");
}

#[test]
fn cell_page_slow_requests_end_and_a_link_counts_once() {
    let cell = Cell::start("127.7.7.2", 1);
    let link = text(&celld(&["open", "--print", "--role", "operate"], cell.path()).stdout);
    let ticket = link.trim().split_once("#ticket=").expect("a ticket").1.to_string();
    let (ours, body) = (format!("http://{}", cell.host), json!({ "ticket": ticket }).to_string());
    let sign_in =
        Request { method: "POST", path: "/api/v1/sign-in", origin: &ours, body: &body, ..Request::default() };
    let first = cell.send(sign_in);
    assert_eq!(first.status, 200, "{}", first.body);
    let cookie = first.head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).expect("a cookie");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    assert_eq!(cell.send(sign_in).status, 401, "a link counts once");
    let cookie = cookie.split(';').next().expect("its value");
    let me = Request { method: "GET", path: "/api/v1/me", cookie, ..Request::default() };
    assert_eq!(cell.send(me).json()["role"], "operate");
    // A browser that is signed in and on another page gives no order: neither with its origin nor without.
    let order = json!({ "command": { "do": "arm" }, "beat": 0 }).to_string();
    let ride = Request { method: "POST", path: "/api/v1/orders", cookie, body: &order, ..Request::default() };
    assert_eq!(cell.send(ride).status, 403);
    assert_eq!(cell.send(Request { origin: "http://evil.example", ..ride }).status, 403);
    // The page's own order with an old state moves nothing.
    let stale = cell.send(Request { origin: &ours, ..ride });
    assert_eq!((stale.status, &stale.json()["accepted"]), (200, &json!(false)));
    assert!(stale.body.contains("old state"), "{}", stale.body);

    let begun = Instant::now();
    let mut slow = TcpStream::connect(&cell.host).expect("connected");
    slow.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
    slow.write_all(b"GET / HTTP/1.1\r\nhost: ").expect("half of a head");
    let ended = answer_of(&mut slow);
    let mut half = TcpStream::connect(&cell.host).expect("connected");
    half.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
    let head = format!("POST /api/v1/sign-in HTTP/1.1\r\nhost: {}\r\norigin: {ours}\r\n", cell.host);
    let head = format!("{head}content-type: application/json\r\ncontent-length: 100\r\n\r\n{{");
    half.write_all(head.as_bytes()).expect("half of a body");
    assert_eq!(answer_of(&mut half).status, 408, "a body that does not come");
    assert!(ended.status == 0 || ended.status == 408, "{}", ended.head);
    assert!(begun.elapsed() < Duration::from_secs(30), "it held a connection for {:?}", begun.elapsed());
}

/// What lies beside the configuration is neither read nor replaced.
fn nothing_else_is_a_goal(cell: &Cell, view: &str, operate: &str) {
    std::fs::write(cell.path().join("config/page.yaml"), "-----BEGIN SECRET-----\n").expect("written");
    for name in ["cell.yaml", "page.yaml", "page.key", "..%2fcell.yaml", "sim.yaml"] {
        let read = cell.get(&format!("/api/v1/goals/{name}"), view);
        assert!(read.status == 404 && !read.body.contains("SECRET"), "{name}: {}", read.body);
        let body =
            json!({ "objects": [{ "id": "lid", "pose": [0.2, 0.2, 0.0] }], "replace": true }).to_string();
        let path = format!("/api/v1/goals/{name}");
        let put = Request { method: "PUT", path: &path, token: operate, body: &body, ..Request::default() };
        assert!([409, 422].contains(&cell.send(put).status), "{name} is not replaced");
    }
    let keys = json!({ "text": "version: 1\ngoal: {file: page.key}\n" });
    assert_eq!(cell.post("/api/v1/preview", view, &keys).status, 422);
}

#[test]
fn cell_page_orders_and_jobs_do_what_they_say() {
    let cell = Cell::start("127.7.7.3", 2);
    let [view, operate, approve] = [Role::View, Role::Operate, Role::Approve].map(|role| cell.token(role));
    let status = || cell.get("/api/v1/status", &view).json();
    let refused = cell.post("/api/v1/orders", &view, &json!({ "command": { "do": "arm" } }));
    assert_eq!(refused.status, 403, "{}", refused.body);
    wait_until("armed", || cell.order(&operate, json!({ "do": "arm" }))["accepted"] == true);
    // The status follows the answer, by as much as its file takes.
    wait_until("the status says armed", || status()["armed"] == true);
    // Another operator has to take control first.
    let taken = cell.order(&approve, json!({ "do": "park" }));
    assert!(taken["message"].as_str().is_some_and(|m| m.contains("operate has control")), "{taken}");

    // A look, a preview from it, the job with approval.
    let look = json!({ "text": "version: 1\nid: look\ngoal: {look: true}\n" });
    assert_eq!(cell.post("/api/v1/jobs", &operate, &look).status, 201);
    wait_until("the table was seen", || cell.get("/api/v1/sight", &view).status == 200);
    wait_until("the look has ended", || cell.get("/api/v1/jobs/look", &view).json()["state"] == "done");
    let job = json!({
        "text": "version: 1\nid: one\napproval: always\ngoal: {objects: [{id: lid, pose: [0.3, 0.38, 0]}]}\n"
    });
    let preview = cell.post("/api/v1/preview", &view, &job);
    assert_eq!(preview.status, 200, "{}", preview.body);
    let steps = preview.json()["plan"]["steps"].as_array().map(Vec::len);
    assert_eq!(steps, Some(1), "{}", preview.body);
    let wrong = json!({ "text": "version: 1\ngoal: {objects: [{id: mug, pose: [0.3, 0.38, 0]}]}\n" });
    let refused = cell.post("/api/v1/jobs", &operate, &wrong);
    assert!(refused.status == 422 && refused.body.contains("mug"), "{}", refused.body);
    assert_eq!(cell.post("/api/v1/jobs", &operate, &job).status, 201);
    wait_until("the plan waits", || status()["awaiting_approval"] == json!(["one"]));
    let agree = |plan: f64| {
        let body = json!({ "command": { "do": "approve", "id": "one" }, "plan_unix_s": plan });
        cell.post("/api/v1/orders", &approve, &body).json()
    };
    let plan = status()["plan"]["unix_s"].as_f64().expect("its time");
    assert_eq!(agree(plan - 5.0)["accepted"], false, "another plan than the one that waits");
    assert_eq!(agree(plan)["accepted"], true);
    wait_until("done", || cell.get("/api/v1/jobs/one", &view).json()["state"] == "done");
    let done = cell.get("/api/v1/jobs/one", &view).json();
    assert_eq!(done["steps"].as_array().map(Vec::len), Some(1));
    assert!(done["story"].as_str().is_some_and(|story| story.contains("a person approved a plan")));
    // The folder follows the journal.
    wait_until("a picture", || cell.get("/api/v1/jobs/one/files/end.jpg", &view).status == 200);
    assert!(cell.get("/api/v1/jobs/one/report", &view).body.contains("<svg"));
    nothing_else_is_a_goal(&cell, &view, &operate);
    let metrics = cell.get("/metrics", &view).body;
    assert!(
        metrics.contains("celld_armed 1") && metrics.contains("celld_device_ready{device=\"robot\"} 1"),
        "{metrics}"
    );

    // Whoever may look may stop.
    let stopped = cell.order(&view, json!({ "do": "disarm" }));
    assert_eq!(stopped["accepted"], true, "{stopped}");
    wait_until("the status says disarmed", || status()["armed"] == false);
    let ordered = "by=\"view (view) at 127.0.0.1\"";
    assert!(cell.log().contains(ordered), "{}", cell.log());
}

#[test]
fn cell_page_viewer_that_does_not_read_is_dropped_and_one_that_does_sees_the_end() {
    let mut cell = Cell::start("127.7.7.4", 5);
    let view = cell.token(Role::View);
    let request =
        format!("GET /api/v1/events HTTP/1.1\r\nhost: {}\r\nauthorization: Bearer {view}\r\n\r\n", cell.host);
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).expect("a socket");
    socket.set_recv_buffer_size(4096).expect("a small buffer");
    let address: std::net::SocketAddr = cell.host.parse().expect("an address");
    socket.connect(&address.into()).expect("connected");
    let mut deaf: TcpStream = socket.into();
    deaf.write_all(request.as_bytes()).expect("sent");
    let viewers =
        |wanted: &str| cell.get("/metrics", &view).body.contains(&format!("celld_viewers {wanted}\n"));
    wait_until("it watches", || viewers("1"));
    let mut reader = TcpStream::connect(&cell.host).expect("connected");
    reader.write_all(request.as_bytes()).expect("sent");
    reader.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
    let seen = std::thread::spawn(move || {
        let mut all = Vec::new();
        // Ends when the daemon does.
        let _ = reader.read_to_end(&mut all);
        String::from_utf8_lossy(&all).into_owned()
    });
    wait_until("both watch", || viewers("2"));
    wait_until("the one that does not read is dropped", || viewers("1"));
    let _ = cell.daemon.0.kill();
    let _ = cell.daemon.0.wait();
    let seen = seen.join().expect("a reader");
    for kind in ["event: status", "event: arm", "event: beat", "event: vacuum"] {
        assert!(seen.contains(kind), "{kind} was not seen in {} bytes", seen.len());
    }
    drop(deaf);
}
