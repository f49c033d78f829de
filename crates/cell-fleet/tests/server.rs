//! Cells and persons against a real NATS server, which is killed, full, old or wrong.
//!
//! In: the program that `CELLD_NATS_SERVER` names (`make test-fleet`). Out: what the seeded schedules say
//! holds on the real server too; without the program every test here is skipped, and says so.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

#[path = "server/bench.rs"]
mod bench;
#[path = "server/documented.rs"]
mod documented;
#[path = "server/leaf.rs"]
mod leaf;

use bench::{Cell, STORAGE, Server, client, fleet, program, until};
use cell_fleet::changes::Change;
use cell_fleet::client::Client;
use cell_fleet::connect::{ConnectFault, Credentials};
use cell_fleet::files::{Content, FileKind, FileToSend, send};
use cell_fleet::payloads::{ClaimState, Job, What, encode};
use cell_fleet::server::Storage;
use cell_fleet::subjects::{Key, Lane, Priority, RequestKind, Target};
use futures_util::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use tokio::runtime::Runtime;

fn runtime() -> Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

fn any() -> Lane {
    Lane { priority: Priority::Normal, target: Target::any() }
}

fn job(id: &str) -> Job {
    Job::new(id, &format!("version: 1\nid: {id}\n"), 1.0)
}

fn submit(runtime: &Runtime, client: &Client, jobs: usize) {
    for number in 0..jobs {
        let new = runtime.block_on(client.submit(&job(&format!("job-{number}")), &any()));
        assert_eq!(new, Ok(true));
    }
}

/// Waits until so many jobs have ended, and returns how often each was carried out.
fn ended(runtime: &Runtime, client: &Client, jobs: usize, cells: &[Cell]) -> BTreeMap<String, u32> {
    until("all jobs have ended", || {
        // The server may be away at this moment.
        let claims = runtime.block_on(client.claims()).unwrap_or_default();
        claims.iter().filter(|claim| claim.state == ClaimState::Ended).count() == jobs
    });
    let mut times = BTreeMap::new();
    for cell in cells {
        for (job, count) in &cell.disk.lock().unwrap().carried_out {
            *times.entry(job.clone()).or_default() += count;
        }
    }
    times
}

#[test]
fn a_queue_is_worked_off_once_and_events_arrive_in_order() {
    let Some(program) = program() else { return };
    let (server, runtime) = (Server::usual(&program), runtime());
    let mut cells: Vec<Cell> =
        (0..3).map(|index| Cell::new(&format!("c{index}"), server.access(None), 20)).collect();
    cells.iter_mut().for_each(Cell::up);
    let client = runtime.block_on(client(&server, "anna"));
    submit(&runtime, &client, 25);
    let times = ended(&runtime, &client, 25, &cells);
    assert!(times.len() == 25 && times.values().all(|times| *times == 1), "{times:?}");
    // The same job again is refused with a sentence, and another with its id too.
    let again = runtime.block_on(client.submit(&job("job-3"), &any())).unwrap_err();
    assert!(again.contains("submitted before"), "{again}");
    let other = runtime.block_on(client.submit(&Job::new("job-3", "other", 1.0), &any())).unwrap_err();
    assert!(other.contains("another job has the id"), "{other}");
    let mut next: BTreeMap<String, u64> = BTreeMap::new();
    until("an event for each end", || {
        let events = runtime.block_on(client.events()).unwrap();
        next = BTreeMap::new();
        let mut done = 0;
        for event in &events {
            let number = next.entry(event.cell.clone()).or_insert(1);
            assert_eq!(event.number, *number, "{}", event.cell);
            *number += 1;
            done += usize::from(matches!(event.what, What::Done { .. }));
        }
        done == 25
    });
    let story = runtime.block_on(client.why("job-3")).unwrap();
    assert_eq!(story.claim.unwrap().outcome.unwrap().status, "done");
}

#[test]
fn killed_cells_and_servers_lose_no_job_and_do_none_twice() {
    let Some(program) = program() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut server, runtime) = (Server::usual(&program), runtime());
    let mut cells: Vec<Cell> =
        (0..6).map(|index| Cell::new(&format!("c{index}"), server.access(None), 60)).collect();
    cells.iter_mut().for_each(Cell::up);
    let client = runtime.block_on(client(&server, "anna"));
    submit(&runtime, &client, 60);
    for round in 0..40 {
        std::thread::park_timeout(std::time::Duration::from_millis(rng.random_range(20..200)));
        let index = rng.random_range(0..cells.len());
        cells[index].kill();
        if round % 10 == 5 {
            server.kill();
            server.up();
        }
        cells[index].up();
    }
    let times = ended(&runtime, &client, 60, &cells);
    assert!(times.len() == 60 && times.values().all(|times| *times == 1), "seed 7: {times:?}");
}

#[test]
fn a_cell_that_is_cut_off_ends_what_it_began_and_tells_it_later_in_order() {
    let Some(program) = program() else { return };
    let (mut server, runtime) = (Server::usual(&program), runtime());
    let mut cell = Cell::new("c1", server.access(None), 1500);
    cell.up();
    let client = runtime.block_on(client(&server, "anna"));
    submit(&runtime, &client, 1);
    until("the job is begun", || !cell.disk.lock().unwrap().carried_out.is_empty());
    server.kill();
    until("the cell says so", || cell.complains_of("the connection to the NATS server is gone"));
    let announced: Vec<String> = (0..300).map(|number| format!("fault {number}")).collect();
    cell.disk.lock().unwrap().announced.clone_from(&announced);
    until("they were taken in", || cell.disk.lock().unwrap().announced.is_empty());
    server.up();
    ended(&runtime, &client, 1, std::slice::from_ref(&cell));
    let mut arrived = Vec::new();
    until("all events", || {
        let events = runtime.block_on(client.events()).unwrap_or_default();
        let numbers: Vec<u64> = events.iter().map(|event| event.number).collect();
        assert!(numbers.iter().copied().eq(1..=numbers.len() as u64), "{numbers:?}");
        arrived = events
            .into_iter()
            .filter_map(|event| match event.what {
                What::Fault { message, .. } if message.starts_with("fault ") => Some(message),
                _ => None,
            })
            .collect();
        arrived.len() == announced.len()
    });
    assert_eq!(arrived, announced);
    until("nothing is wrong any more", || cell.disk.lock().unwrap().complaints.is_empty());
}

#[test]
fn what_all_refuse_is_set_aside_and_a_person_decides_from_afar() {
    let Some(program) = program() else { return };
    let (server, runtime) = (Server::usual(&program), runtime());
    let mut cells: Vec<Cell> =
        (0..2).map(|index| Cell::new(&format!("c{index}"), server.access(None), 20)).collect();
    for cell in &mut cells {
        cell.refuses = "big".to_string();
        cell.up();
    }
    let client = runtime.block_on(client(&server, "anna"));
    until("both cells are there", || runtime.block_on(client.cells()).unwrap().len() == 2);
    assert_eq!(runtime.block_on(client.submit(&job("big-1"), &any())), Ok(true));
    until("it is set aside", || {
        let claims = runtime.block_on(client.claims()).unwrap();
        claims.iter().any(|claim| claim.state == ClaimState::Aside && claim.reasons.len() == 2)
    });
    let unnamed = runtime.block_on(client.request("c1", RequestKind::Approve, "tidy", None)).unwrap();
    assert!(!unnamed.accepted && unnamed.message.contains("no plan"), "{unnamed:?}");
    let answer = runtime.block_on(client.request("c1", RequestKind::Approve, "tidy", Some(7))).unwrap();
    assert!(answer.accepted && answer.message == "agreed", "{answer:?}");
    let ordered = cells[1].disk.lock().unwrap().ordered.clone();
    assert_eq!(ordered, [(RequestKind::Approve, "tidy".to_string(), Some(7), "anna".to_string())]);
    let nobody = runtime.block_on(client.request("c9", RequestKind::Approve, "tidy", Some(7))).unwrap_err();
    assert!(nobody.contains("c9 does not answer"), "{nobody}");
    // Not taken by any cell yet: it waits for a time of its own.
    let late = Job { not_before_unix_s: Some(4e9), ..job("late") };
    assert_eq!(runtime.block_on(client.submit(&late, &any())), Ok(true));
    runtime.block_on(client.cancel("late")).unwrap();
    until("it is cancelled", || {
        let claims = runtime.block_on(client.claims()).unwrap();
        claims.iter().any(|claim| claim.job.id == "late" && claim.state == ClaimState::Cancelled)
    });
}

#[test]
fn payloads_of_others_are_left_where_they_are_and_named() {
    let Some(program) = program() else { return };
    let (server, runtime) = (Server::usual(&program), runtime());
    let mut cell = Cell::new("c1", server.access(None), 20);
    cell.up();
    let client = runtime.block_on(client(&server, "anna"));
    until("the cell is there", || !runtime.block_on(client.cells()).unwrap().is_empty());
    let raw = |subject: String, payload: &[u8]| {
        let payload = payload.to_vec();
        let address = format!("nats://127.0.0.1:{}", server.port);
        runtime.block_on(async {
            let connection = async_nats::connect(address).await.unwrap();
            let context = async_nats::jetstream::new(connection);
            let sent = context.publish(subject, payload.into()).await.unwrap();
            sent.await.unwrap();
        });
    };
    let in_queue = || fleet().job(&any(), "anna");
    raw(in_queue(), br#"{"version": 9, "id": "x"}"#);
    until("the version is named", || cell.complains_of("version 9"));
    raw(in_queue(), b"no json");
    until("it is set aside", || {
        let claims = runtime.block_on(client.claims()).unwrap();
        claims.iter().any(|claim| claim.state == ClaimState::Aside && claim.job.id.starts_with("message-"))
    });
    submit(&runtime, &client, 1);
    ended(&runtime, &client, 1, std::slice::from_ref(&cell));
    assert_eq!(runtime.block_on(client.queued()).unwrap().values().sum::<usize>(), 1, "that of version 9");

    // A claim of another version: its job is not begun, and goes back for a cell of that version.
    let key = Key::claim("later");
    raw(format!("$KV.{}.{key}", fleet().claims_bucket()), br#"{"version": 9}"#);
    raw(in_queue(), &encode(&job("later")).unwrap());
    until("the claim is named", || cell.complains_of("the claim of job later is not of this version"));
    assert!(!cell.disk.lock().unwrap().carried_out.contains_key("later"));
    // The cell has not waited for it.
    assert_eq!(runtime.block_on(client.submit(&job("after"), &any())), Ok(true));
    ended(&runtime, &client, 2, std::slice::from_ref(&cell));
}

#[test]
fn a_full_stream_refuses_with_a_sentence_and_drops_nothing() {
    let Some(program) = program() else { return };
    let (server, runtime) = (Server::usual(&program), runtime());
    let small = Storage { jobs_bytes: 20_000, ..STORAGE };
    let client = runtime.block_on(Client::open(&server.access(None), fleet(), "anna", small)).unwrap();
    let mut accepted = 0;
    let refusal = (0..100).find_map(|number| {
        let text = "a".repeat(2000);
        let new = runtime.block_on(client.submit(&Job::new(&format!("j{number}"), &text, 1.0), &any()));
        accepted += usize::from(new.is_ok());
        new.err()
    });
    assert!(refusal.as_ref().is_some_and(|text| text.contains("no room left")), "{refusal:?}");
    assert_eq!(runtime.block_on(client.queued()).unwrap().values().sum::<usize>(), accepted);
    let text = "a".repeat(10_000_000);
    let large = runtime.block_on(client.submit(&Job::new("large", &text, 1.0), &any())).unwrap_err();
    assert!(large.contains("at most"), "{large}");
}

#[test]
fn wrong_credentials_and_a_server_without_jetstream_are_named_and_the_cell_works_on_alone() {
    let Some(program) = program() else { return };
    let user = nkeys::KeyPair::new_user();
    let config = format!(
        "jetstream {{store_dir: \"STORE\"}}\nauthorization {{users: [{{nkey: {}}}]}}",
        user.public_key()
    );
    let (server, runtime) = (Server::start(&program, &config), runtime());
    let folder = tempfile::tempdir().unwrap();
    let key = |name: &str, pair: &nkeys::KeyPair| {
        let path = folder.path().join(name);
        std::fs::write(&path, pair.seed().unwrap()).unwrap();
        Some(Credentials::Nkey(path))
    };
    let (right, wrong) = (key("right.nk", &user), key("wrong.nk", &nkeys::KeyPair::new_user()));
    let open =
        |credentials| runtime.block_on(Client::open(&server.access(credentials), fleet(), "anna", STORAGE));
    assert!(open(right.clone()).is_ok());
    assert!(matches!(open(wrong.clone()).err(), Some(ConnectFault::Refused { .. })));
    assert!(matches!(open(None).err(), Some(ConnectFault::Refused { .. })));
    let mut cell = Cell::new("c1", server.access(wrong), 20);
    cell.up();
    until("the cell says so", || cell.complains_of("refuses the credentials"));

    let bare = Server::start(&program, "");
    let fault = runtime.block_on(Client::open(&bare.access(None), fleet(), "anna", STORAGE)).err().unwrap();
    assert!(matches!(fault, ConnectFault::NoJetStream { .. }), "{fault}");
}

/// What the server says of itself is all that the version is known by.
#[test]
fn an_old_server_is_named() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        use std::io::{BufRead, BufReader, Write};
        for stream in listener.incoming().flatten() {
            let mut out = stream.try_clone().unwrap();
            let info = r#"{"server_id":"X","server_name":"X","version":"2.9.10","proto":1,"go":"go1","host":"127.0.0.1","port":4222,"headers":true,"max_payload":1048576,"jetstream":true,"client_id":1}"#;
            let _ = write!(out, "INFO {info}\r\n");
            for line in BufReader::new(stream).lines().map_while(Result::ok) {
                if line.starts_with("PING") {
                    let _ = out.write_all(b"PONG\r\n");
                }
            }
        }
    });
    let access = cell_fleet::connect::Access {
        servers: vec![format!("nats://127.0.0.1:{port}")],
        credentials: None,
        authority: None,
        tls: false,
        domain: None,
        name: "test".to_string(),
    };
    let fault = runtime().block_on(Client::open(&access, fleet(), "anna", STORAGE)).err().unwrap();
    assert_eq!(fault, ConnectFault::Old { found: "2.9.10".to_string() });
}

/// The events of a fleet for a client that knows MQTT alone, at the server's gateway.
#[test]
fn a_client_of_the_mqtt_gateway_sees_the_events() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let (Some(program), Some(python)) = (program(), std::env::var_os("CELLD_MQTT_PYTHON")) else {
        eprintln!(
            "SKIPPED: CELLD_MQTT_PYTHON names no Python with paho-mqtt; `make test-fleet` installs one"
        );
        return;
    };
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let config = format!(
        "server_name: \"one\"\njetstream {{store_dir: \"STORE\"}}\nmqtt {{host: \"127.0.0.1\", port: {port}}}"
    );
    let server = Server::start(&program, &config);
    let script = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fleet/mqtt.py");
    let mut reader = Command::new(python)
        .args([script.as_os_str(), port.to_string().as_ref(), "celld/v1/test/event/#".as_ref()])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(reader.stdout.take().unwrap()).lines().map_while(Result::ok);
    assert_eq!(lines.next().as_deref(), Some("READY"));
    let mut cell = Cell::new("c1", server.access(None), 20);
    cell.disk.lock().unwrap().announced.push("the feeder is empty".to_string());
    cell.up();
    let line = lines.next().unwrap_or_default();
    reader.kill().unwrap();
    reader.wait().unwrap();
    let (topic, payload) = line.split_once(' ').unwrap_or_default();
    let event: cell_fleet::payloads::Event = serde_json::from_str(payload).unwrap();
    assert_eq!((topic, event.number), ("celld/v1/test/event/c1/fault", 1));
    assert!(matches!(event.what, What::Fault { message, .. } if message == "the feeder is empty"));
}

#[test]
fn files_go_over_the_object_store_whole() {
    let Some(program) = program() else { return };
    fetch_files(&Server::usual(&program));
}

/// The streams and buckets that are made at once leave 230 MB of it: less than the files' bucket takes where
/// there is room.
#[test]
fn files_go_where_a_server_has_little_room_left() {
    let Some(program) = program() else { return };
    let server = Server::start(&program, "jetstream {store_dir: \"STORE\", max_file_store: 600MB}");
    fetch_files(&server);
    // More than it holds is not begun, and what others have requested stays.
    let runtime = runtime();
    let (stored, refused) = runtime.block_on(async {
        let context = async_nats::jetstream::new(async_nats::connect(server.address()).await.unwrap());
        let large = FileToSend { name: "large".into(), content: Content::Bytes(vec![0; 200 << 20]) };
        let refused = send(&context, &fleet(), 1, ["c1", "job-0"], vec![large]).await;
        let store = context.get_object_store(fleet().files_bucket()).await.unwrap();
        (store.list().await.unwrap().count().await, refused)
    });
    assert!(refused.as_ref().is_err_and(|fault| fault.contains("fetch it at the cell")), "{refused:?}");
    assert_eq!(stored, 2, "the files of before");
}

fn fetch_files(server: &Server) {
    let runtime = runtime();
    let mut cell = Cell::new("c1", server.access(None), 0);
    // Several chunks, and not a whole number of them.
    let bytes: Vec<u8> = (0..3_000_001_u32).map(|number| (number % 251) as u8).collect();
    cell.disk.lock().unwrap().file.clone_from(&bytes);
    cell.up();
    let client = runtime.block_on(client(server, "anna"));
    submit(&runtime, &client, 1);
    ended(&runtime, &client, 1, &[]);
    let folder = tempfile::tempdir().unwrap();
    let kinds = [FileKind::Plan, FileKind::Recording];
    let answer = runtime.block_on(client.request_for_files("c1", "job-0", &kinds)).unwrap();
    assert_eq!((answer.accepted, answer.files.len()), (true, 2), "{answer:?}");
    for name in &answer.files {
        let path = runtime.block_on(client.fetch("c1", "job-0", name, folder.path())).unwrap();
        assert_eq!(std::fs::read(path).unwrap(), bytes, "{name}");
    }
    let answer = runtime.block_on(client.request_for_files("c1", "job-1", &kinds)).unwrap();
    assert_eq!((answer.accepted, answer.message.as_str()), (false, "no such job"));
    for name in ["../plan.bin", "/etc/passwd", "none.bin"] {
        assert!(runtime.block_on(client.fetch("c1", "job-0", name, folder.path())).is_err(), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing half is left");
}

#[test]
fn a_cell_knows_the_newest_of_its_nearest_target() {
    let Some(program) = program() else { return };
    let (mut server, runtime) = (Server::usual(&program), runtime());
    let mut cell = Cell::new("c1", server.access(None), 0);
    cell.up();
    let (anna, ben) = (runtime.block_on(client(&server, "anna")), runtime.block_on(client(&server, "ben")));
    let publish = |who: &Client, target: &str, text: &str| {
        let target = Target::parse(target).unwrap();
        runtime.block_on(who.publish_fragment(&target, text, 1.0)).unwrap()
    };
    let wants = |text: Option<Option<&str>>| {
        until("what the cell should run with", || {
            cell.disk.lock().unwrap().wanted.as_ref().map(|wanted| wanted.as_deref()) == text
        });
    };
    publish(&anna, "any", "all");
    wants(Some(Some("all")));
    publish(&anna, "label=line", "of anna");
    wants(Some(Some("of anna")));
    let number = publish(&ben, "label=line", "of ben");
    wants(Some(Some("of ben")));
    until("its number in the cell's state", || {
        let cells = runtime.block_on(anna.cells()).unwrap_or_default();
        cells.iter().any(|cell| cell.state.fragment == Some(number))
    });
    let history = runtime.block_on(anna.fragment_history(&Target::Label("line".into()))).unwrap();
    assert_eq!(history.iter().map(|one| one.by.as_str()).collect::<Vec<_>>(), ["anna", "ben"]);
    publish(&anna, "label=line", "");
    wants(Some(Some("all")));
    publish(&ben, "any", "");
    wants(Some(None));
    publish(&ben, "any", "again");
    wants(Some(Some("again")));
    // A server that has lost everything changes no cell.
    server.wipe();
    wants(None);
}

#[test]
fn all_that_changes_is_followed_and_dated_by_the_server() {
    let Some(program) = program() else { return };
    let (server, runtime) = (Server::usual(&program), runtime());
    let mut cell = Cell::new("c1", server.access(None), 0);
    cell.up();
    let client = runtime.block_on(client(&server, "anna"));
    submit(&runtime, &client, 3);
    ended(&runtime, &client, 3, &[]);
    let (claims, dones, cells) = runtime.block_on(async {
        let mut changes = client.changes(1000).await.unwrap();
        let (mut claims, mut dones, mut cells) = (BTreeMap::new(), 0, 0);
        while claims.len() < 3 || dones < 3 || cells == 0 {
            match changes.next().await.unwrap() {
                Change::Claim(claim) => drop(claims.insert(claim.job.id.clone(), claim.state)),
                Change::Event(event) => dones += u32::from(matches!(event.what, What::Done { .. })),
                Change::Cell(_) => cells += 1,
                Change::CellGone(_) | Change::ClaimGone(_) => {}
                Change::Ended(what) => panic!("{what} has ended"),
            }
        }
        (claims, dones, cells)
    });
    assert!(claims.values().all(|state| *state == ClaimState::Ended) && dones == 3 && cells > 0);
    let (server_s, own) =
        (runtime.block_on(client.server_unix_s()).unwrap(), std::time::UNIX_EPOCH.elapsed());
    assert!(
        (server_s - own.unwrap().as_secs_f64()).abs() < 60.0,
        "{server_s}: on one computer it is one time"
    );
}
