//! Faults over the real protocols: a running cell, its sockets, and what a client sees of each fault.

use crate::camera::{CameraSetup, CameraTiming};
use crate::cell::{RunningSim, SimConfig, SimError, start};
use crate::controller::ControllerConfig;
use crate::faults::FaultError;
use crate::faults::read::{read_faults, read_posted};
use crate::render::lens::CameraTruth;
use crate::render::scene::look_at;
use crate::robot_server::RobotPorts;
use crate::world::event::EventKind;
use crate::world::lock;
use crate::world::spec::{CameraMount, GripperSpec, PlacementErrors, ReferenceMarker, TableSpec};
use crate::world::spec::{WorldObject, WorldSpec};
use crate::world::vacuum::Channel;
use nalgebra::Isometry3;
use rearrange::geometry::footprint::Footprint;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_modbus::client::{Context, Reader, Writer, tcp};
use tokio_modbus::prelude::{ExceptionCode, Slave};
use ur_wire::rtde::{Reply, Request, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Offer, Recipe, Value};

mod camera;
mod robot;

/// Longest a test waits for anything, wall time.
const PATIENCE: Duration = Duration::from_secs(60);
/// Simulated seconds per second.
const FACTOR: f64 = 50.0;

/// A block under the arm, on a table whose frame is the arm's but for its height.
pub(super) fn config() -> SimConfig {
    let mut camera = CameraTruth::ideal("sim-1", 96, 72, 90.0);
    camera.noise_sigma = 1.0;
    let controller = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
    let tool = ur_arm::kinematics::forward(&controller.dh, &controller.start)
        * Isometry3::translation(0.0, 0.0, 0.1);
    let at = tool.translation.vector;
    let block = WorldObject {
        id: "block".to_owned(),
        footprint: Footprint::rectangle(0.08, 0.08).unwrap(),
        height_m: 0.03,
        mass_kg: 0.1,
        pose: rearrange::geometry::pose::Pose2::new(0.5, 0.5, 0.0),
        marker: None,
        grippable: None,
        fixed: false,
        colour: None,
    };
    SimConfig {
        bind: "127.0.0.1".parse().unwrap(),
        ports: RobotPorts::ANY,
        modbus_port: 0,
        camera_port: 0,
        control_port: Some(0),
        time_factor: FACTOR,
        strict: false,
        controller,
        world: WorldSpec {
            table: TableSpec { width_m: 1.0, height_m: 1.0, margin_m: 0.1 },
            // The tool is 0.1 m over the block's middle.
            base_from_table: Isometry3::translation(at.x - 0.5, at.y - 0.5, at.z - 0.13),
            objects: vec![block],
            reference_markers: vec![ReferenceMarker {
                id: 5,
                size_m: 0.1,
                pose: rearrange::geometry::pose::Pose2::new(0.2, 0.2, 0.0),
            }],
            errors: PlacementErrors::default(),
            gripper: GripperSpec::one_cup(0.1),
            hand_board: None,
        },
        camera: CameraSetup {
            truth: camera.clone(),
            reported: camera,
            mount: CameraMount::Fixed(look_at([0.2, 0.2, 0.25], [0.2, 0.2, 0.0], [1.0, 0.0, 0.0])),
            timing: CameraTiming::INSTANT,
        },
        seed: 1,
        faults: Vec::new(),
    }
}

struct Bench {
    sim: RunningSim,
}

async fn bench(faults: &str) -> Bench {
    let mut config = config();
    if !faults.is_empty() {
        config.faults = read_faults(faults, "test").unwrap();
    }
    Bench { sim: start(config).await.unwrap() }
}

impl Bench {
    #[track_caller]
    fn fault(&self, text: &str) {
        self.sim.injector().submit(read_posted(text).unwrap()).unwrap();
    }

    /// What posting gives when it is refused.
    fn refusal(&self, text: &str) -> FaultError {
        self.sim.injector().submit(read_posted(text).unwrap()).unwrap_err()
    }

    async fn until(&self, what: &str, mut ready: impl FnMut(&RunningSim) -> bool) {
        let began = Instant::now();
        while !ready(&self.sim) {
            assert!(began.elapsed() < PATIENCE, "{what} did not happen");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn dashboard(&self) -> TcpStream {
        let mut stream = TcpStream::connect(self.sim.addresses.robot.dashboard).await.unwrap();
        line(&mut stream).await;
        stream
    }

    async fn request(&self, question: &str) -> String {
        request(&mut self.dashboard().await, question).await
    }

    async fn upload(&self, script: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.sim.addresses.robot.primary).await.unwrap();
        stream.write_all(script.as_bytes()).await.unwrap();
        stream
    }

    async fn gripper(&self) -> Context {
        tcp::connect_slave(self.sim.addresses.modbus, Slave(65)).await.unwrap()
    }

    fn happened(&self, test: impl Fn(&EventKind) -> bool) -> bool {
        lock(&self.sim.world()).events().any(|event| test(&event.kind))
    }

    fn step(&self) -> u64 {
        self.sim.robot().controller().core.step
    }
}

async fn request(stream: &mut TcpStream, question: &str) -> String {
    stream.write_all(format!("{question}\n").as_bytes()).await.unwrap();
    tokio::time::timeout(PATIENCE, line(stream)).await.unwrap()
}

/// A line, or what came of it before the end.
async fn line(stream: &mut TcpStream) -> String {
    let mut line = Vec::new();
    loop {
        match stream.read_u8().await {
            Ok(b'\n') | Err(_) => return String::from_utf8(line).unwrap(),
            Ok(byte) => line.push(byte),
        }
    }
}

/// An RTDE client with one recipe.
struct Rtde {
    stream: TcpStream,
    splitter: Splitter,
    recipe: Recipe,
}

impl Rtde {
    async fn connect(address: SocketAddr, names: &[&str]) -> Rtde {
        let stream = TcpStream::connect(address).await.unwrap();
        let recipe = Recipe { id: 1, fields: Vec::new() };
        let mut rtde = Rtde { stream, splitter: Splitter::default(), recipe };
        rtde.send(&Request::ProtocolVersion(2), Version::V1).await;
        assert_eq!(rtde.reply().await, Some(Reply::ProtocolVersion(true)));
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let setup = Request::SetupOutputs { frequency_hz: Some(25.0), names: names.clone() };
        rtde.send(&setup, Version::V2).await;
        let Some(Reply::SetupOutputs { offers, .. }) = rtde.reply().await else { panic!("no recipe") };
        for (name, offer) in names.into_iter().zip(offers) {
            let Offer::Type(kind) = offer else { panic!("{name}") };
            rtde.recipe.fields.push((name, kind));
        }
        rtde.send(&Request::Start, Version::V2).await;
        rtde
    }

    async fn send(&mut self, request: &Request, version: Version) {
        self.stream.write_all(&request.encode(version)).await.unwrap();
    }

    /// `None` when the connection broke.
    async fn reply(&mut self) -> Option<Reply> {
        let version = if self.recipe.fields.is_empty() { Version::V1 } else { Version::V2 };
        loop {
            if let Some(frame) = self.splitter.next_frame().unwrap() {
                return Some(
                    Reply::decode(version, &frame)
                        .unwrap_or_else(|_| Reply::decode(Version::V2, &frame).unwrap()),
                );
            }
            let mut buffer = [0; 4096];
            match tokio::time::timeout(PATIENCE, self.stream.read(&mut buffer)).await.unwrap() {
                Ok(count @ 1..) => self.splitter.push(&buffer[..count]),
                _ => return None,
            }
        }
    }

    /// Reads until two packages with `control_step` alone are `gap` frames apart.
    async fn until_gap(&mut self, gap: u64) {
        let began = Instant::now();
        let mut last = 0;
        loop {
            assert!(began.elapsed() < PATIENCE, "never {gap} frames apart");
            let Reply::Data { payload, .. } = self.reply().await.expect("closed") else { continue };
            let values = self.recipe.decode(&payload, Leftover::Refuse).unwrap();
            let [Value::Uint64(step)] = values[..] else { panic!("{values:?}") };
            if std::mem::replace(&mut last, step) + gap == step {
                return;
            }
        }
    }

    /// Reads until the values are these.
    async fn until(&mut self, wanted: &[Value]) {
        let began = Instant::now();
        let mut last = Vec::new();
        while last != wanted {
            assert!(began.elapsed() < PATIENCE, "{last:?} instead of {wanted:?}");
            if let Reply::Data { payload, .. } = self.reply().await.expect("closed") {
                last = self.recipe.decode(&payload, Leftover::Refuse).unwrap();
            }
        }
    }
}
