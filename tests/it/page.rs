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
    /// The secret of the page.
    page: &'a str,
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
        wait_until("there is a page", || celld(&["open", "--print"], cell.path()).status.success());
        wait_until("orders are taken", || {
            let status = std::fs::read(cell.path().join("state/status.json")).unwrap_or_default();
            serde_json::from_slice(&status).is_ok_and(|status: Value| status["state"] != "starting")
        });
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
            ("x-celld-page", request.page),
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
        let mut stream = TcpStream::connect(&self.host).unwrap_or_else(|error| {
            let log = std::fs::read_to_string(self.path().join(LOG)).unwrap_or_default();
            panic!("{}: {error}; the daemon's log:\n{log}", request.path)
        });
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
    // A thread of its own writes the log.
    for wanted in ["page refused: the request comes from another page", "page refused: sign in first"] {
        wait_until(wanted, || cell.log().contains(wanted));
    }
    assert!(!cell.log().contains(&view), "a token is not logged");
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
    let page = first.json()["page"].as_str().expect("the secret of the page").to_string();
    // A cookie goes to every port of the computer: alone it stops, and does nothing else.
    let order = json!({ "command": { "do": "arm" }, "beat": 0 }).to_string();
    let stop = json!({ "command": { "do": "pause" } }).to_string();
    let ride = Request { method: "POST", path: "/api/v1/orders", cookie, body: &order, ..Request::default() };
    for other in ["", "0123456789abcdef"] {
        let alone = Request { origin: &ours, page: other, ..ride };
        let answer = cell.send(alone);
        assert!(answer.status == 403 && answer.body.contains("signs it in again"), "{}", answer.body);
        assert_eq!(cell.send(Request { path: "/api/v1/control", ..alone }).status, 403);
        // Nor is it a program's token.
        let token = cookie.split_once('=').expect("a value").1;
        let as_token = Request { cookie: "", token, ..alone };
        assert_eq!(cell.send(as_token).status, 403);
        let stopped = cell.send(Request { body: &stop, ..alone });
        assert_eq!((stopped.status, &stopped.json()["accepted"]), (200, &json!(true)), "{}", stopped.body);
    }
    let ride = Request { page: &page, ..ride };
    // A browser that is signed in and on another page gives no order: neither with its origin nor without.
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

/// What was recorded of a job is played back; it may still be on its way to the disk.
fn it_is_played_back(cell: &Cell, view: &str) {
    let played = || cell.get("/api/v1/jobs/one/playback", view);
    wait_until("it is played back", || played().body.contains("every object is at its goal"));
    let played = played();
    assert!(played.body.contains("data:image/jpeg"), "{}", played.head);
    assert!(played.head.contains("sandbox allow-scripts"), "it gets no session: {}", played.head);
    assert_eq!(cell.get("/api/v1/jobs/none/playback", view).status, 404);
}

/// The goal of a job again: one that has ended, under a number of its own.
fn once_more(cell: &Cell, view: &str, operate: &str) {
    let again = |id: &str| cell.post(&format!("/api/v1/jobs/{id}/again"), operate, &json!({}));
    let refused = cell.post("/api/v1/jobs/one/again", view, &json!({}));
    assert_eq!((refused.status, again("none").status), (403, 404));
    let made = again("one");
    assert!(made.status == 201 && made.json()["id"] == "one.2", "{}", made.body);
    let job = cell.get("/api/v1/jobs/one.2", view).json();
    assert_eq!(job["goals"], cell.get("/api/v1/jobs/one", view).json()["goals"]);
    let early = again("one.2");
    assert!(early.status == 409 && early.body.contains("not ended"), "{}", early.body);
    assert_eq!(cell.order(operate, json!({ "do": "cancel", "id": "one.2" }))["accepted"], true);
    wait_until("cancelled", || cell.get("/api/v1/jobs/one.2", view).json()["state"] == "cancelled");
}

/// Whoever may look may stop, and see what may be done then.
fn whoever_looks_may_stop(cell: &Cell, view: &str) {
    let status = || cell.get("/api/v1/status", view).json();
    let stopped = cell.order(view, json!({ "do": "disarm" }));
    assert_eq!(stopped["accepted"], true, "{stopped}");
    wait_until("the status says disarmed", || status()["armed"] == false);
    wait_until("and could be armed", || status()["arm_refused"].is_null());
    let shown = cell.order(view, json!({ "do": "recover", "how": "show" }));
    assert!(shown["accepted"] == true && shown.to_string().contains("ways back"), "{shown}");
    let ordered = "by=\"view (view) at 127.0.0.1\"";
    assert!(cell.log().contains(ordered), "{}", cell.log());
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
    let agree = |plan: u64| {
        let body = json!({ "command": { "do": "approve", "id": "one", "plan": plan } });
        cell.post("/api/v1/orders", &approve, &body).json()
    };
    let plan = status()["plan"]["number"].as_u64().expect("its number");
    let another = agree(plan + 1);
    assert!(another["message"].as_str().is_some_and(|message| message.contains("changed")), "{another}");
    assert_eq!(agree(plan)["accepted"], true);
    wait_until("done", || cell.get("/api/v1/jobs/one", &view).json()["state"] == "done");
    let done = cell.get("/api/v1/jobs/one", &view).json();
    assert_eq!(done["steps"].as_array().map(Vec::len), Some(1));
    assert!(done["story"].as_str().is_some_and(|story| story.contains("a person approved a plan")));
    // The folder follows the journal.
    wait_until("a picture", || cell.get("/api/v1/jobs/one/files/end.jpg", &view).status == 200);
    assert!(cell.get("/api/v1/jobs/one/report", &view).body.contains("<svg"));
    it_is_played_back(&cell, &view);
    nothing_else_is_a_goal(&cell, &view, &operate);
    once_more(&cell, &view, &operate);
    let metrics = cell.get("/metrics", &view).body;
    assert!(
        metrics.contains("celld_armed 1") && metrics.contains("celld_device_ready{device=\"robot\"} 1"),
        "{metrics}"
    );
    whoever_looks_may_stop(&cell, &view);
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

/// Begins to watch the film; what was read of it after a while.
fn film(cell: &Cell, token: &str, pictures: usize) -> Vec<u8> {
    let mut stream = TcpStream::connect(&cell.host).expect("connected");
    stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
    let head =
        format!("GET /api/v1/film HTTP/1.1\r\nhost: {}\r\nauthorization: Bearer {token}\r\n\r\n", cell.host);
    stream.write_all(head.as_bytes()).expect("sent");
    let (mut bytes, mut buffer) = (Vec::new(), [0; 1 << 16]);
    let count = |bytes: &[u8]| bytes.windows(24).filter(|w| *w == b"Content-Type: image/jpeg").count();
    while count(&bytes) < pictures {
        match stream.read(&mut buffer) {
            Ok(size) if size > 0 => bytes.extend_from_slice(&buffer[..size]),
            ended => panic!("{ended:?} after {}", String::from_utf8_lossy(&bytes[..bytes.len().min(300)])),
        }
    }
    bytes
}

#[test]
fn cell_page_film_is_taken_for_viewers_and_a_token_taken_back_ends_it() {
    let cell = Cell::start("127.7.7.5", 1);
    let [view, operate] = [Role::View, Role::Operate].map(|role| cell.token(role));
    let watchers =
        |wanted: &str| cell.get("/metrics", &view).body.contains(&format!("celld_film_viewers {wanted}\n"));
    let known = || cell.get("/api/v1/calibration", &operate).json()["cell"]["lens"].is_object();
    wait_until("the robot is known", known);
    assert!(watchers("0"));
    let seen = film(&cell, &view, 3);
    assert!(seen.windows(3).any(|w| w == [0xff, 0xd8, 0xff]), "JPEG pictures");
    wait_until("no viewer is left", || watchers("0"));

    let other = cell.token(Role::Operate);
    assert_eq!(cell.get("/api/v1/me", &other).status, 200);
    let mut stream = TcpStream::connect(&cell.host).expect("connected");
    stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
    let head = format!(
        "GET /api/v1/events HTTP/1.1\r\nhost: {}\r\nauthorization: Bearer {other}\r\n\r\n",
        cell.host
    );
    stream.write_all(head.as_bytes()).expect("sent");
    let revoked = celld(&["open", "--revoke", "operate"], cell.path());
    assert!(revoked.status.success(), "{}", text(&revoked.stderr));
    assert_eq!(cell.get("/api/v1/me", &other).status, 401, "it counts no more, with the same celld");
    // Its stream ends too, by itself.
    let _ = stream.read_to_end(&mut Vec::new()).expect("the end of the stream");
    assert_eq!(cell.get("/api/v1/me", &view).status, 200, "others go on");
    let again = celld(&["open", "--revoke", "operate"], cell.path());
    assert_eq!(again.status.code(), Some(1), "{}", text(&again.stdout));
}

#[test]
fn cell_page_calibrates_step_by_step_and_moves_only_when_ordered() {
    let cell = Cell::start("127.7.7.6", 5);
    let [operate, engineer] = [Role::Operate, Role::Engineer].map(|role| cell.token(role));
    let step = |body: Value| cell.post("/api/v1/calibration", &engineer, &body);
    let bench = || cell.get("/api/v1/calibration", &operate).json();
    assert_eq!(cell.post("/api/v1/calibration", &operate, &json!({ "do": "keep", "number": 1 })).status, 403);
    let by_operator = cell.post("/api/v1/orders", &operate, &json!({ "command": { "do": "calibrate" } }));
    assert_eq!(by_operator.status, 403, "{}", by_operator.body);
    wait_until("the robot is known", || bench()["cell"]["lens"].is_object());
    // Nothing of it is there yet, and nothing is made up.
    assert_eq!(step(json!({ "do": "keep", "number": 0 })).status, 409);
    assert_eq!(step(json!({ "do": "picture" })).status, 409, "there is no film");
    let solved = step(json!({ "do": "solve" })).json();
    assert!(solved["fault"].as_str().is_some_and(|why| why.contains("no round")), "{}", solved["fault"]);
    let disarmed = cell.order(&engineer, json!({ "do": "calibrate" }));
    assert!(disarmed["message"].as_str().is_some_and(|m| m.contains("disarmed")), "{disarmed}");

    // Where the arm rests is recorded, and does not place a table by itself.
    let points =
        json!({ "do": "touches", "points": ["500", "501:lower_left", "0.25/0.25"], "tip_mm": [0, 0, 150] });
    assert_eq!(step(points).status, 200);
    assert_eq!(step(json!({ "do": "touches", "points": ["7000"] })).status, 422);
    let touched = step(json!({ "do": "touch" })).json();
    assert_eq!(touched["touches"]["wanted"]["number"], 2, "{touched}");
    assert_eq!(step(json!({ "do": "untouch" })).json()["touches"]["wanted"]["number"], 1);

    wait_until("armed", || cell.order(&engineer, json!({ "do": "arm" }))["accepted"] == true);
    // Who has just armed the cell waits until its arm is at rest.
    wait_until("a round", || cell.order(&engineer, json!({ "do": "calibrate" }))["accepted"] == true);
    wait_until("the round is over", || bench()["round"]["over"] == true);
    let round = bench()["round"].clone();
    let poses = bench()["cell"]["poses"].as_u64();
    assert!(round["fault"].is_null(), "{round}");
    assert_eq!(round["markers"].as_array().map(|all| all.len() as u64), poses, "{round}");
    wait_until("disarmed", || cell.get("/api/v1/status", &operate).json()["armed"] == false);
    let picture = cell.get("/api/v1/calibration/pictures/round-1", &operate);
    assert!(picture.status == 200 && picture.head.contains("image/jpeg"), "{}", picture.head);
    assert_eq!(cell.get("/api/v1/calibration/pictures/round-99", &operate).status, 404);

    let solved = step(json!({ "do": "solve", "drop": [2] })).json();
    let number = |path: &str| solved.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
    assert!(solved["fault"].is_null(), "{}", solved["fault"]);
    assert!(number("/solved/table/px") < 0.3 && number("/solved/table/held_out_mm") < 0.5, "{solved}");
    assert!(number("/solved/camera_moved/mm") < 1.0, "as the files in use have it: {solved}");
    assert!(solved["solved"]["marks"][0].as_array().is_some_and(|marks| !marks.is_empty()));
    let file = cell.path().join("calibration/sim/table.yaml");
    let before = std::fs::read_to_string(&file).expect("the table's file");
    let of = |solved: &Value| solved["solved"]["number"].clone();
    let looked_at = of(&solved);
    let again = step(json!({ "do": "solve" })).json();
    assert_ne!(of(&again), looked_at);
    let other = step(json!({ "do": "keep", "number": looked_at }));
    assert!(other.status == 409 && other.body.contains("another calibration"), "{}", other.body);
    assert_eq!(std::fs::read_to_string(&file).expect("the table's file"), before);
    let kept = step(json!({ "do": "keep", "number": of(&again) })).json();
    assert!(kept["kept"].as_str().is_some_and(|said| said.contains("next start")), "{}", kept["kept"]);
    assert_ne!(std::fs::read_to_string(&file).expect("the table's file"), before);
    let aside = walk(&cell.path().join("state/calibration"), "table.yaml");
    assert_eq!(std::fs::read_to_string(aside).expect("the file before"), before);
}

/// The first file of this name in the folders of a folder.
fn walk(folder: &Path, name: &str) -> std::path::PathBuf {
    let folders = std::fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.path().join(name));
    folders.into_iter().find(|path| path.exists()).expect("a file of this name")
}
