//! The servers over real sockets, with the frames stepped by the test.

use super::*;
use crate::controller::{Controller, ControllerConfig};
use crate::robot_server::publisher::Feed;
use crate::world::empty_world;
use std::net::Ipv4Addr;
use ur_wire::dashboard::GREETING;
use ur_wire::primary::{Package, Splitter as PrimarySplitter};
use ur_wire::primary_message::{MessageBody, PROGRAM_STARTED, PROGRAM_STOPPED};
use ur_wire::primary_state::SubPackage;
use ur_wire::rtde::{Reply, Request, Splitter as RtdeSplitter, Version};
use ur_wire::rtde_values::{Leftover, Offer, Recipe, Value, VariableType};

mod places;
mod sending;

/// Longest a test waits for anything.
const PATIENCE: Duration = Duration::from_secs(30);

struct Bench {
    core: Core,
    shared: Arc<RobotShared>,
    at: RobotAddresses,
    _shutdown: watch::Sender<bool>,
}

/// Servers on the real port numbers, on a loopback address that only this test of this process uses.
async fn bench(test: u8, config: ControllerConfig) -> Bench {
    let [high, low] = ((std::process::id() % 65_000) as u16 + 256).to_be_bytes();
    let address = IpAddr::V4(Ipv4Addr::new(127, high, low, test));
    let core = Core::new(Controller::new(config), empty_world(5), 1.0);
    let (sender, receiver) = watch::channel(false);
    let at = Servers::default().take_robot(&core, address, &RobotPorts::REAL, &receiver).await.unwrap();
    Bench { shared: core.robot.clone(), core, at, _shutdown: sender }
}

fn running() -> ControllerConfig {
    ControllerConfig { running: true, ..ControllerConfig::ur5e(1) }
}

impl Bench {
    /// Steps frames until `ready` gives something.
    async fn until<T>(&self, mut ready: impl FnMut(&Bench) -> Option<T>) -> T {
        let stepping = async {
            loop {
                if let Some(found) = ready(self) {
                    return found;
                }
                self.shared.frame(None);
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(PATIENCE, stepping).await.expect("did not happen")
    }

    /// Steps frames while `waiting` for a peer.
    async fn during<T>(&self, waiting: impl Future<Output = T>) -> T {
        let stepping = async {
            loop {
                self.shared.frame(None);
                tokio::task::yield_now().await;
            }
        };
        let either = async {
            tokio::select! {
                found = waiting => found,
                () = stepping => unreachable!("frames go on for ever"),
            }
        };
        tokio::time::timeout(PATIENCE, either).await.expect("the peer kept silent")
    }
}

struct Lines(TcpStream);

impl Lines {
    async fn read(&mut self) -> String {
        let mut line = Vec::new();
        loop {
            match self.0.read_u8().await {
                Ok(b'\n') | Err(_) => return String::from_utf8(line).unwrap(),
                Ok(byte) => line.push(byte),
            }
        }
    }

    async fn request(&mut self, question: &str) -> String {
        self.0.write_all(format!("{question}\n").as_bytes()).await.unwrap();
        tokio::time::timeout(PATIENCE, self.read()).await.unwrap()
    }
}

async fn dashboard(bench: &Bench) -> Lines {
    let mut line = Lines(TcpStream::connect(bench.at.dashboard).await.unwrap());
    assert_eq!(line.read().await, GREETING);
    line
}

struct Primary(TcpStream, PrimarySplitter);

impl Primary {
    async fn connect(address: SocketAddr) -> Primary {
        Primary(TcpStream::connect(address).await.unwrap(), PrimarySplitter::default())
    }

    /// `None` at the end of the stream.
    async fn next(&mut self) -> Option<Package> {
        loop {
            if let Some(package) = self.1.next_package().unwrap() {
                return Some(package);
            }
            let mut buffer = [0; 4096];
            match self.0.read(&mut buffer).await {
                Ok(0) | Err(_) => return None,
                Ok(count) => self.1.push(&buffer[..count]),
            }
        }
    }

    /// The next key event, exception or error, as one word.
    async fn event(&mut self) -> String {
        while let Some(package) = self.next().await {
            match package {
                Package::Message(message) => match message.body {
                    MessageBody::Key { title, text, .. } => return format!("{title}:{text}"),
                    MessageBody::RuntimeException { line, column, .. } => return format!("{line}:{column}"),
                    MessageBody::Error { code, .. } => return format!("C{code}"),
                    _ => {}
                },
                Package::RobotState(_) | Package::Other { .. } => {}
            }
        }
        "closed".to_owned()
    }
}

struct Rtde(TcpStream, RtdeSplitter, Version);

impl Rtde {
    async fn connect(bench: &Bench, version: Version) -> Rtde {
        let mut rtde =
            Rtde(TcpStream::connect(bench.at.rtde).await.unwrap(), RtdeSplitter::default(), Version::V1);
        let number = if version == Version::V2 { 2 } else { 1 };
        assert_eq!(rtde.request(Request::ProtocolVersion(number)).await, Reply::ProtocolVersion(true));
        rtde.2 = version;
        rtde
    }

    async fn send(&mut self, request: Request) {
        self.0.write_all(&request.encode(self.2)).await.unwrap();
    }

    async fn next(&mut self) -> Option<Reply> {
        loop {
            if let Some(frame) = self.1.next_frame().unwrap() {
                return Some(Reply::decode(self.2, &frame).unwrap());
            }
            let mut buffer = [0; 4096];
            match self.0.read(&mut buffer).await {
                Ok(0) | Err(_) => return None,
                Ok(count) => self.1.push(&buffer[..count]),
            }
        }
    }

    /// The next reply that is not data.
    async fn request(&mut self, request: Request) -> Reply {
        self.send(request).await;
        loop {
            let reply = tokio::time::timeout(PATIENCE, self.next()).await.unwrap().expect("closed");
            if !matches!(reply, Reply::Data { .. }) {
                return reply;
            }
        }
    }

    async fn inputs(&mut self, names: &[&str]) -> (u8, Vec<Offer>) {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        match self.request(Request::SetupInputs { names }).await {
            Reply::SetupInputs { recipe, offers } => (recipe, offers),
            other => panic!("{other:?}"),
        }
    }

    async fn outputs(&mut self, frequency_hz: f64, names: &[&str]) -> Option<Recipe> {
        let list: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let frequency_hz = (self.2 == Version::V2).then_some(frequency_hz);
        let Reply::SetupOutputs { recipe, offers } =
            self.request(Request::SetupOutputs { frequency_hz, names: list.clone() }).await
        else {
            panic!("not a set-up reply");
        };
        let kinds = offers.into_iter().map(|offer| match offer {
            Offer::Type(kind) => Some(kind),
            Offer::NotFound | Offer::InUse => None,
        });
        let fields: Option<Vec<(String, VariableType)>> =
            list.into_iter().zip(kinds).map(|(name, kind)| Some((name, kind?))).collect();
        (recipe != 0).then(|| Recipe { id: recipe, fields: fields.unwrap() })
    }

    async fn data(&mut self, recipe: &Recipe) -> Vec<Value> {
        match self.next().await.expect("closed") {
            Reply::Data { payload, .. } => recipe.decode(&payload, Leftover::Refuse).unwrap(),
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test]
async fn the_dashboard_brings_the_arm_up() {
    let bench = bench(1, ControllerConfig::ur5e(1)).await;
    let mut line = dashboard(&bench).await;
    assert_eq!(line.request("robotmode").await, "Robotmode: POWER_OFF");
    assert_eq!(line.request("POWER ON").await, "Powering on");
    assert_eq!(line.request("robotmode").await, "Robotmode: BOOTING");
    bench.until(|b| b.shared.controller().core.modes.powered().then_some(())).await;
    assert_eq!(line.request("brake release").await, "Brake releasing");
    bench.until(|b| b.shared.controller().core.modes.brakes_open().then_some(())).await;
    assert_eq!(line.request("robotmode").await, "Robotmode: RUNNING");
    assert_eq!(line.request("safetymode").await, "Safetymode: NORMAL");
    assert_eq!(line.request("programState").await, "STOPPED <unnamed>");
    assert_eq!(line.request("play").await, "Failed to execute: play");
    assert_eq!(line.request("is in remote control").await, "true");
    assert!(line.request("get serial number").await.parse::<u64>().is_ok());
    assert_eq!(line.request("dance").await, "could not understand: dance");
    assert_eq!(line.request("load x.urp").await, "File not found: x.urp");
    assert_eq!(line.request("quit").await, "Disconnected");
    assert_eq!(line.read().await, "");
}

#[tokio::test]
async fn a_client_that_has_sent_its_last_byte_still_gets_its_answers() {
    let bench = bench(19, running()).await;
    let mut line = dashboard(&bench).await;
    line.0.write_all(b"robotmode\nsafetymode\n").await.unwrap();
    line.0.shutdown().await.unwrap();
    let answers = async { [line.read().await, line.read().await, line.read().await] };
    let answers = tokio::time::timeout(PATIENCE, answers).await.unwrap();
    assert_eq!(answers, ["Robotmode: RUNNING", "Safetymode: NORMAL", ""]);
}

#[tokio::test]
async fn local_mode_refuses_until_the_connection_is_made_anew() {
    let bench = bench(2, running()).await;
    let mut old = dashboard(&bench).await;
    let mut primary = Primary::connect(bench.at.primary).await;
    primary.next().await;
    bench.shared.controller().core.modes.set_remote(false);
    assert!(old.request("power off").await.starts_with("Command is not allowed"));
    assert_eq!(bench.during(primary.event()).await, "closed", "going local closes script connections");
    let mut read_only = Primary::connect(bench.at.primary).await;
    read_only.0.write_all(b"def a():\nend\n").await.unwrap();
    assert_eq!(bench.during(read_only.event()).await, "C210");
    bench.shared.controller().core.modes.set_remote(true);
    assert!(
        old.request("power off").await.starts_with("Command is not allowed"),
        "the old connection stays refused"
    );
    read_only.0.write_all(b"def b():\nend\n").await.unwrap();
    assert_eq!(bench.during(read_only.event()).await, "C210");
    let mut fresh = Primary::connect(bench.at.primary).await;
    fresh.0.write_all(b"def c():\nend\n").await.unwrap();
    assert_eq!(bench.during(fresh.event()).await, format!("{PROGRAM_STARTED}:c"));
    assert_eq!(dashboard(&bench).await.request("power off").await, "Powering off");
}

#[tokio::test]
async fn scripts_run_from_all_three_ports() {
    let bench = bench(3, running()).await;
    let mut watcher = Primary::connect(bench.at.primary).await;
    let first = bench.during(watcher.next()).await.unwrap();
    assert!(
        matches!(first, Package::Message(message) if matches!(message.body, MessageBody::Version { .. }))
    );
    let Some(Package::RobotState(parts)) = bench.during(watcher.next()).await else {
        panic!("no robot state")
    };
    let dh = *bench.shared.controller().core.mover.arm.kinematics.dh();
    assert!(parts.iter().any(|part| matches!(part, SubPackage::Kinematics(data) if data.a == dh.a)));
    assert!(parts.iter().any(|part| matches!(part, SubPackage::Configuration(_))));
    for (name, address) in
        [("one", bench.at.primary), ("two", bench.at.secondary), ("three", bench.at.realtime)]
    {
        let mut sender = TcpStream::connect(address).await.unwrap();
        for chunk in format!("def {name}():\n  sync()\nend\n").as_bytes().chunks(5) {
            sender.write_all(chunk).await.unwrap();
        }
        assert_eq!(bench.during(watcher.event()).await, format!("{PROGRAM_STARTED}:{name}"));
        assert_eq!(bench.during(watcher.event()).await, format!("{PROGRAM_STOPPED}:{name}"));
    }
    watcher.0.write_all(b"def bad():\n x = 1 / 0\nend\n").await.unwrap();
    assert_eq!(bench.during(watcher.event()).await, format!("{PROGRAM_STARTED}:bad"));
    assert_eq!(bench.during(watcher.event()).await, "2:8");
    assert_eq!(bench.during(watcher.event()).await, format!("{PROGRAM_STOPPED}:bad"));
}

#[tokio::test]
async fn read_only_ports_send_the_same_and_take_nothing() {
    let bench = bench(12, running()).await;
    let [primary, secondary, realtime] = bench.at.read_only;
    assert_eq!([primary.port(), secondary.port(), realtime.port()], [30011, 30012, 30013]);
    let mut watcher = Primary::connect(primary).await;
    for address in [primary, secondary, realtime] {
        let mut sender = TcpStream::connect(address).await.unwrap();
        sender.write_all(b"def no():\nend\n").await.unwrap();
        bench.during(sender.read_u8()).await.unwrap();
    }
    bench.shared.controller().core.modes.set_remote(false);
    bench.shared.frame(None);
    bench.shared.controller().core.modes.set_remote(true);
    let mut sender = TcpStream::connect(bench.at.primary).await.unwrap();
    sender.write_all(b"def yes():\nend\n").await.unwrap();
    let first = bench.during(watcher.event()).await;
    assert_eq!(first, format!("{PROGRAM_STARTED}:yes"), "going local leaves read-only connections open");
}

#[tokio::test]
async fn popups_are_reported_on_the_primary_interface() {
    let bench = bench(13, running()).await;
    let mut watcher = Primary::connect(bench.at.primary).await;
    bench.during(watcher.next()).await;
    assert_eq!(dashboard(&bench).await.request("popup mind the arm").await, "showing popup");
    let popup = async {
        loop {
            if let Some(Package::Message(message)) = watcher.next().await
                && let MessageBody::Popup { text, .. } = message.body
            {
                return text;
            }
        }
    };
    assert_eq!(bench.during(popup).await, "mind the arm");
}

#[tokio::test]
async fn equal_recipes_share_one_encoding_and_long_lists_are_bounded_on_newer_software() {
    let bench = bench(14, running()).await;
    let mut clients = Vec::new();
    for _ in 0..3 {
        let mut rtde = Rtde::connect(&bench, Version::V2).await;
        let recipe = rtde.outputs(500.0, &["timestamp", "actual_q"]).await.unwrap();
        rtde.request(Request::Start).await;
        clients.push((rtde, recipe));
    }
    bench.shared.frame(None);
    let mut seen = Vec::new();
    for (rtde, recipe) in &mut clients {
        seen.push(rtde.data(recipe).await);
    }
    assert!(seen[0] == seen[1] && seen[1] == seen[2]);
    let names: Vec<String> = (0..48).map(|n| format!("output_double_register_{n}")).collect();
    let names: Vec<&str> = names.iter().chain(&names).map(String::as_str).collect();
    let (rtde, _) = &mut clients[0];
    assert!(rtde.outputs(1.0, &names).await.is_some());
    bench.shared.controller().core.pendant.pretend_version(Some([10, 10, 0, 0]));
    assert!(rtde.outputs(1.0, &names).await.is_none());
    assert!(rtde.outputs(1.0, &names[..48]).await.is_some());
}

#[tokio::test]
async fn rtde_gives_recipes_and_data() {
    let bench = bench(4, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    let Reply::ControllerVersion(version) = rtde.request(Request::ControllerVersion).await else {
        panic!("no version")
    };
    assert_eq!(version.major, 5);
    assert_eq!(rtde.request(Request::Start).await, Reply::Start(false), "nothing is set up");
    assert!(rtde.outputs(125.0, &["timestamp", "no_such_thing"]).await.is_none());
    assert!(rtde.outputs(0.0, &["timestamp"]).await.is_none());
    assert!(rtde.outputs(f64::NAN, &["timestamp"]).await.is_none());
    let recipe = rtde.outputs(125.0, &["timestamp", "actual_q", "runtime_state"]).await.unwrap();
    assert_eq!(rtde.request(Request::Start).await, Reply::Start(true));
    let mut before = 40.99;
    for _ in 0..20 {
        let values = bench.during(rtde.data(&recipe)).await;
        let Value::Double(timestamp) = values[0] else { panic!("{values:?}") };
        assert!(timestamp > before, "{timestamp} after {before}");
        assert_eq!(values[1], Value::Vector6D(bench.shared.controller().core.mover.q().0));
        assert_eq!(values[2], Value::Uint32(1));
        before = timestamp;
    }
    assert_eq!(bench.during(rtde.request(Request::Pause)).await, Reply::Pause(true));
}

#[tokio::test]
async fn the_output_frequency_divides_the_frames() {
    let bench = bench(5, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    for (frequency, frames) in [(500.0, 1), (600.0, 1), (125.0, 4), (150.0, 3), (1.0, 500)] {
        let recipe = rtde.outputs(frequency, &["control_step"]).await.unwrap();
        rtde.request(Request::Start).await;
        let mut steps = Vec::new();
        while steps.len() < 3 {
            // One frame at a time, so that no package is skipped.
            bench.shared.frame(None);
            let step = bench.shared.controller().core.step;
            if step % frames == 0 {
                assert_eq!(rtde.data(&recipe).await, [Value::Uint64(step)], "{frequency} Hz");
                steps.push(step);
            }
        }
        rtde.request(Request::Pause).await;
    }
}

#[tokio::test]
async fn inputs_take_effect_in_the_next_frame_and_belong_to_one_client() {
    let bench = bench(6, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    let names = [
        "input_int_register_24",
        "input_double_register_24",
        "standard_digital_output_mask",
        "standard_digital_output",
    ];
    // A trailing comma is what one client library sends; the reply has none.
    let mut text = names.join(",");
    text.push(',');
    let package = ur_wire::rtde::Frame { kind: b'I', payload: text.into_bytes() };
    rtde.0.write_all(&package.encode()).await.unwrap();
    let Some(Reply::SetupInputs { recipe: 1, offers }) = rtde.next().await else { panic!("refused") };
    assert_eq!(offers.len(), 4);
    let mut values = Recipe { id: 1, fields: vec![] };
    values.fields = names
        .iter()
        .zip(&offers)
        .map(|(name, offer)| match offer {
            Offer::Type(kind) => ((*name).to_owned(), *kind),
            other => panic!("{other:?}"),
        })
        .collect();
    let mut payload =
        values.encode(&[Value::Int32(-5), Value::Double(0.25), Value::Uint8(3), Value::Uint8(1)]).unwrap();
    payload.extend_from_slice(&[9; 48]);
    // Data before any start, and longer than the recipe.
    rtde.send(Request::Data { recipe: 1, payload }).await;
    bench.until(|b| (b.shared.controller().core.registers.input_ints[24] == -5).then_some(())).await;
    assert_eq!(bench.shared.controller().core.registers.digital_outputs, 1);

    let mut other = Rtde::connect(&bench, Version::V2).await;
    let (recipe, offers) =
        other.inputs(&["input_int_register_24", "input_int_register_25", "nonsense"]).await;
    assert_eq!((recipe, offers), (0, vec![Offer::InUse, Offer::Type(VariableType::Int32), Offer::NotFound]));
    assert_eq!(other.inputs(&["input_int_register_25"]).await.0, 1);
    assert_eq!(other.inputs(&["input_int_register_25", "input_int_register_26"]).await.0, 2);
    let text = other.request(Request::Data { recipe: 2, payload: vec![0; 3] }).await;
    assert!(matches!(text, Reply::Text(_)), "{text:?}");
    let text = other.request(Request::Data { recipe: 9, payload: vec![0; 3] }).await;
    assert!(matches!(text, Reply::Text(_)), "{text:?}");

    drop(rtde);
    bench
        .until(|b| (!b.shared.controller().core.registers.claimed("input_int_register_24")).then_some(()))
        .await;
    assert_eq!(other.inputs(&["input_int_register_24"]).await.0, 3);
    assert_eq!(bench.shared.controller().core.registers.input_ints[24], -5, "values outlive their writer");
}

#[tokio::test]
async fn a_script_and_rtde_exchange_registers() {
    let bench = bench(7, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    let recipe = rtde.outputs(500.0, &["output_int_register_24", "input_int_register_24"]).await.unwrap();
    rtde.inputs(&["input_int_register_24"]).await;
    rtde.request(Request::Start).await;
    let mut sender = TcpStream::connect(bench.at.realtime).await.unwrap();
    let script = "def echo():\n while True:\n  write_output_integer_register(24, 2 * \
                  read_input_integer_register(24))\n  sync()\n end\nend\n";
    sender.write_all(script.as_bytes()).await.unwrap();
    rtde.send(Request::Data { recipe: 1, payload: 21i32.to_be_bytes().to_vec() }).await;
    let echoed = async { while rtde.data(&recipe).await != [Value::Int32(42), Value::Int32(21)] {} };
    bench.during(echoed).await;
}

#[tokio::test]
async fn version_one_clients_get_packages_without_a_recipe_id() {
    let bench = bench(8, running()).await;
    let mut rtde = Rtde::connect(&bench, Version::V1).await;
    let recipe = rtde.outputs(0.0, &["timestamp"]).await.unwrap();
    rtde.request(Request::Start).await;
    let values = bench.during(rtde.data(&recipe)).await;
    assert!(matches!(values[..], [Value::Double(timestamp)] if timestamp >= 41.0));
}

#[tokio::test]
async fn an_rtde_client_that_does_not_read_is_dropped_and_a_script_client_is_not() {
    let bench = bench(9, running()).await;
    let mut lazy = Rtde::connect(&bench, Version::V2).await;
    let names: Vec<&str> = ur_wire::rtde_variables::OUTPUTS.iter().map(|(name, _)| *name).collect();
    lazy.outputs(500.0, &names).await.unwrap();
    lazy.request(Request::Start).await;
    let mut silent = TcpStream::connect(bench.at.realtime).await.unwrap();
    let mut good = Rtde::connect(&bench, Version::V2).await;
    let recipe = good.outputs(1.0, &["timestamp"]).await.unwrap();
    good.request(Request::Start).await;
    let connections = |b: &Bench| b.shared.publisher().subscribers(Feed::Rtde);
    bench.until(|b| (connections(b) == 1).then_some(())).await;
    assert!(bench.shared.publisher().counts().1 > 0, "nothing was skipped");
    bench.during(good.data(&recipe)).await;
    silent.write_all(b"def late():\n sleep(1000)\nend\n").await.unwrap();
    bench.until(|b| b.shared.controller().programs.playing().then_some(())).await;
}

#[tokio::test]
async fn random_bytes_do_not_disturb_the_servers() {
    use rand::{RngExt, SeedableRng};
    let bench = bench(10, running()).await;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let at = bench.at;
    for address in [at.dashboard, at.primary, at.secondary, at.realtime, at.rtde] {
        for _ in 0..20 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let bytes: Vec<u8> = (0..rng.random_range(1..2000)).map(|_| rng.random::<u8>()).collect();
            // The server may have closed on the first nonsense already.
            let _ = stream.write_all(&bytes).await;
            bench.shared.frame(None);
        }
    }
    assert_eq!(dashboard(&bench).await.request("robotmode").await, "Robotmode: RUNNING");
    let mut rtde = Rtde::connect(&bench, Version::V2).await;
    assert!(rtde.outputs(500.0, &["timestamp"]).await.is_some());
}

#[tokio::test]
async fn a_taken_address_is_named() {
    let bench = bench(11, running()).await;
    let (_sender, receiver) = watch::channel(false);
    let mut servers = Servers::default();
    let taken = servers.take_robot(&bench.core, bench.at.rtde.ip(), &RobotPorts::REAL, &receiver).await;
    let error = taken.unwrap_err();
    assert!(
        error.to_string().contains("dashboard server") && error.to_string().contains(":29999"),
        "{error}"
    );
}
