//! The robot session against the simulated controller, over real sockets: what `cell_machine::device` and
//! `ur-sim` each took from the vendor's guides has to fit together, and the on-robot program in between is
//! the real one.

#![expect(clippy::unwrap_used, reason = "a test that unwraps is a test that fails loudly")]

use cell_edge::clock::Clock;
use cell_machine::device::program::Nonce;
use cell_machine::device::robot::Robot;
use cell_machine::device::robot_types::{Link, ProgramEnd, RobotCommand, RobotEvent, RobotParameters};
use cell_motion::bodies::{Bodies, Room};
use cell_motion::path::{ArmLimits, ArmModel, BlendSpeed, CheckedPath, Leg, Segment};
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use ur_arm::kinematics::{DhParameters, Kinematics};
use ur_sim::camera::{CameraSetup, CameraTiming};
use ur_sim::cell::{RunningSim, SimConfig, start};
use ur_sim::controller::ControllerConfig;
use ur_sim::render::lens::CameraTruth;
use ur_sim::robot_server::RobotPorts;
use ur_sim::world::spec::{CameraMount, GripperSpec, WorldSpec};

/// How much faster than the clock on the wall these simulations run.
const FACTOR: f64 = 3.0;
/// Simulated seconds after which a wait has failed.
const PATIENCE_S: f64 = 60.0;

pub fn config(running: bool) -> SimConfig {
    let camera = CameraTruth::ideal("sim-1", 64, 36, 40.0);
    SimConfig {
        bind: "127.0.0.1".parse().unwrap(),
        ports: RobotPorts::ANY,
        modbus_port: 0,
        camera_port: 0,
        control_port: None,
        time_factor: FACTOR,
        strict: false,
        controller: ControllerConfig { running, ..ControllerConfig::ur5e(3) },
        world: WorldSpec::bare(Isometry3::translation(-0.75, -0.4, -0.5), GripperSpec::one_cup(0.1)),
        camera: CameraSetup {
            truth: camera.clone(),
            reported: camera,
            mount: CameraMount::Flange(Isometry3::identity()),
            timing: CameraTiming::INSTANT,
        },
        seed: 1,
        faults: Vec::new(),
    }
}

/// Session, sockets and clock: a small substitute for the daemon's links.
struct Cell {
    sim: RunningSim,
    robot: Robot,
    rtde: SocketAddr,
    links: BTreeMap<u16, TcpStream>,
    clock: Clock,
    events: Vec<RobotEvent>,
    dh: DhParameters,
}

impl Cell {
    async fn new(running: bool) -> Cell {
        Cell::with(config(running), |rtde| rtde).await
    }

    /// On the way to the RTDE server may be something else.
    async fn with(config: SimConfig, way: impl FnOnce(SocketAddr) -> SocketAddr) -> Cell {
        let sim = start(config).await.unwrap();
        let robot = Robot::new(RobotParameters::full_rate()).unwrap();
        let rtde = way(sim.addresses.robot.rtde);
        let clock = Clock::simulated(rtde, FACTOR);
        let (links, dh) = (BTreeMap::new(), DhParameters::UR5E);
        let mut cell = Cell { sim, robot, rtde, links, clock, events: Vec::new(), dh };
        for link in Link::ALL {
            cell.connect(link);
        }
        cell.wait("identity", |cell| cell.saw(|e| matches!(e, RobotEvent::Identity { .. }))).await;
        cell.wait("RTDE", |cell| cell.saw(|e| *e == RobotEvent::RtdeReady)).await;
        cell.wait("kinematics", |cell| cell.saw(|e| matches!(e, RobotEvent::Kinematics { .. }))).await;
        cell.wait("remote control", |cell| {
            cell.robot.state().is_some_and(|s| s.remote_control == Some(true))
        })
        .await;
        cell
    }

    fn now(&self) -> Timestamp {
        self.clock.now() + Duration::from_secs(1)
    }

    fn address(&self, link: Link) -> SocketAddr {
        let addresses = &self.sim.addresses.robot;
        match link {
            Link::Rtde => self.rtde,
            Link::Dashboard => addresses.dashboard,
            Link::Primary => addresses.primary,
        }
    }

    fn connect(&mut self, link: Link) {
        let stream = TcpStream::connect(self.address(link)).unwrap();
        match link {
            // RTDE streams all the time: waiting on it paces the loop without burning a core.
            Link::Rtde => stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap(),
            Link::Dashboard | Link::Primary => stream.set_nonblocking(true).unwrap(),
        }
        stream.set_nodelay(true).unwrap();
        self.links.insert(link.port(), stream);
        self.robot.connected(self.now(), link);
    }

    /// One turn: everything that arrived in, everything to send out.
    fn turn(&mut self) {
        let sent_before = self.clock.mark();
        for link in Link::ALL {
            let mut bytes = [0; 65536];
            let Some(stream) = self.links.get_mut(&link.port()) else { continue };
            match stream.read(&mut bytes) {
                Ok(0) => panic!("{link} was closed by the simulator"),
                Ok(count) => self.robot.received(self.now(), link, &bytes[..count]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) => panic!("{link}: {error}"),
            }
        }
        if self.robot.poll_timeout().is_some_and(|(at, _)| at <= self.now()) {
            self.robot.tick(self.now());
        }
        while let Some((link, bytes)) = self.robot.poll_transmit() {
            self.links.get_mut(&link.port()).unwrap().write_all(&bytes).unwrap();
        }
        self.clock.taken_in(sent_before);
        assert_eq!(self.robot.poll_close(), None, "{:?}", self.events);
        while let Some(event) = self.robot.poll_event() {
            if let RobotEvent::Kinematics { dh, .. } = &event {
                self.dh = *dh;
            }
            assert!(!matches!(event, RobotEvent::ProtocolFault { .. }), "{event:?}");
            self.events.push(event);
        }
    }

    async fn wait(&mut self, what: &str, done: impl Fn(&Cell) -> bool) {
        let until = self.now().as_secs_f64() + PATIENCE_S;
        while !done(self) {
            self.turn();
            tokio::task::yield_now().await;
            assert!(
                self.now().as_secs_f64() < until,
                "no {what}: {:?}\n{:?}",
                self.events,
                self.robot.state()
            );
        }
    }

    async fn shutdown(self) {
        self.sim.shutdown().await;
    }

    fn saw(&self, is: impl Fn(&RobotEvent) -> bool) -> bool {
        self.events.iter().any(is)
    }

    fn command(&mut self, command: RobotCommand) {
        self.turn();
        let now = self.now();
        self.robot.command(now, command).unwrap();
    }

    async fn start_program(&mut self, seed: u64) {
        self.events.clear();
        let nonce = Nonce::new(seed);
        self.command(RobotCommand::StartProgram { nonce });
        self.wait("program", |cell| cell.saw(|e| *e == RobotEvent::ProgramRunning { nonce })).await;
    }

    /// Three blended segments there and one straight one on.
    fn path(&self, sign: f64) -> CheckedPath {
        let from = self.robot.state().unwrap().q;
        let limits = ArmLimits {
            joint_range: [(-6.2, 6.2); 6],
            joint_speed: 3.0,
            joint_acceleration: 10.0,
            tool_speed: 1.0,
            tool_acceleration: 5.0,
        };
        let model = ArmModel {
            kinematics: Kinematics::of(&self.dh),
            base_from_table: Isometry3::identity(),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.1),
            home: from,
            limits,
            blend_speed: BlendSpeed::Unknown,
            bodies: Bodies::bare(&self.dh),
        };
        let at = |turn: f64, tilt: f64| {
            let mut q = from;
            q.0[0] += sign * turn;
            q.0[3] += tilt;
            q
        };
        let joint = |target: Joints, blend| Segment::Joint { target, speed: 1.0, acceleration: 3.0, blend };
        let legs = [
            joint(at(0.2, 0.0), 0.02),
            joint(at(0.4, 0.05), 0.02),
            joint(at(0.6, 0.0), 0.0),
            Segment::Linear { target: at(0.7, 0.0), speed: 0.25, acceleration: 1.2, blend: 0.0 },
        ];
        CheckedPath::new(&model, &from, &legs.map(|segment| Leg::over(segment, -1.0)), &Room::empty())
            .unwrap()
    }

    async fn follow(&mut self, path: CheckedPath) {
        let end = path.end();
        self.command(RobotCommand::Stream(path));
        let batch = self.robot.last_batch();
        self.wait("end of path", |cell| cell.saw(|e| *e == RobotEvent::PathFinished { batch })).await;
        let difference = self.robot.state().unwrap().q.max_difference(&end);
        assert!(difference < 2e-3, "{difference} rad from the end");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn from_powered_off_to_the_end_of_a_path() {
    let mut cell = Cell::new(false).await;
    assert_ne!(cell.dh, DhParameters::UR5E, "the arm has a calibration of its own");
    cell.command(RobotCommand::PowerOn);
    cell.wait("power", |cell| cell.saw(|e| *e == RobotEvent::Completed { what: "power on".into() })).await;
    cell.command(RobotCommand::ReleaseBrakes);
    cell.wait("brakes", |cell| cell.saw(|e| *e == RobotEvent::Completed { what: "brake release".into() }))
        .await;
    cell.start_program(11).await;
    cell.command(RobotCommand::SetPayload { mass_kg: 1.3, centre_of_gravity_m: [0.0, 0.01, 0.06] });
    cell.command(RobotCommand::SetTcp([0.0, 0.0, 0.2, 0.0, 0.0, 0.5]));
    cell.follow(cell.path(1.0)).await;
    assert!(cell.saw(|e| *e == RobotEvent::PayloadSet) && cell.saw(|e| *e == RobotEvent::TcpSet));
    let state = cell.robot.state().unwrap();
    assert!((state.payload - 1.3).abs() < 1e-9 && (state.tcp_offset[2] - 0.2).abs() < 1e-9);
    cell.follow(cell.path(-1.0)).await;
    cell.command(RobotCommand::EndProgram);
    cell.wait("end", |cell| {
        cell.saw(|e| matches!(e, RobotEvent::ProgramEnded { reason: ProgramEnd::AsRequested }))
    })
    .await;
    cell.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stop_in_motion_then_a_new_program_goes_on() {
    let mut cell = Cell::new(true).await;
    cell.start_program(21).await;
    cell.command(RobotCommand::Stream(cell.path(1.0)));
    cell.wait("motion", |cell| cell.saw(|e| matches!(e, RobotEvent::SegmentFinished { index: 0, .. }))).await;
    cell.command(RobotCommand::Stop);
    cell.wait("stop", |cell| cell.saw(|e| *e == RobotEvent::Stopped)).await;
    assert!(cell.robot.state().unwrap().stands_still(), "{:?}", cell.robot.state());
    assert!(!cell.saw(|e| matches!(e, RobotEvent::PathFinished { .. })));
    cell.wait("end", |cell| cell.saw(|e| matches!(e, RobotEvent::ProgramEnded { .. }))).await;
    cell.start_program(22).await;
    assert!(
        cell.robot.state().unwrap().accepted > 0,
        "numbers of the first program are still in the registers"
    );
    cell.follow(cell.path(-1.0)).await;
    cell.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_arm_stops_when_the_pc_falls_silent() {
    let mut cell = Cell::new(true).await;
    cell.start_program(31).await;
    cell.command(RobotCommand::Stream(cell.path(1.0)));
    cell.wait("motion", |cell| cell.saw(|e| matches!(e, RobotEvent::SegmentFinished { index: 0, .. }))).await;
    // From here on no turn is made: the process might as well be dead.
    let status = || cell.sim.robot().controller().core.registers.output_ints[27];
    while status() != 2 {
        tokio::task::yield_now().await;
        assert!(cell.now().as_secs_f64() < PATIENCE_S, "the watchdog did not fire");
    }
    cell.shutdown().await;
}

/// The program's watchdog waits for 0.2 s.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_simulator_waits_for_a_client_that_follows_its_time() {
    let mut cell = Cell::new(true).await;
    cell.start_program(41).await;
    let held = cell.sim.seconds_held();
    while cell.sim.seconds_held() < held + 0.5 {
        tokio::task::yield_now().await;
    }
    let at = cell.robot.state().unwrap().controller_time_s;
    cell.wait("time goes on", |cell| cell.robot.state().unwrap().controller_time_s > at + 1.0).await;
    assert!(!cell.saw(|e| matches!(e, RobotEvent::ProgramEnded { .. })), "{:?}", cell.events);
    cell.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_strict_simulator_waits_for_nobody() {
    let mut cell = Cell::with(SimConfig { strict: true, ..config(true) }, |rtde| rtde).await;
    cell.start_program(42).await;
    let status = || cell.sim.robot().controller().core.registers.output_ints[27];
    while status() != 2 {
        tokio::task::yield_now().await;
        assert!(cell.now().as_secs_f64() < PATIENCE_S, "the watchdog did not fire");
    }
    assert_eq!((cell.sim.seconds_held(), cell.sim.addresses.clock), (0.0, false));
    cell.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_simulator_that_is_late_is_waited_for() {
    let mut cell = Cell::new(true).await;
    cell.wait("state", |cell| cell.robot.fresh(cell.now())).await;
    let sim = cell.sim.robot().clone();
    // It makes no frame meanwhile.
    let controller = sim.controller();
    // Each waits for the robot for 1 ms or some more: at least 150 ms of a clock that does not stand, and
    // less than celld's patience.
    for _ in 0..50 {
        cell.turn();
    }
    assert!(cell.robot.fresh(cell.now()));
    drop(controller);
    cell.shutdown().await;
}

/// The tunnel is at an address of this computer, and no clock channel belongs to that.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_at_the_end_of_a_tunnel_is_not_waited_for() {
    let broken = Arc::new(AtomicBool::new(false));
    let mut cell = Cell::with(config(true), |rtde| tunnel(rtde, broken.clone())).await;
    cell.wait("state", |cell| cell.robot.fresh(cell.now())).await;
    broken.store(true, Ordering::Relaxed);
    let began = Instant::now();
    while cell.robot.fresh(cell.now()) {
        cell.turn();
        assert!(began.elapsed().as_secs_f64() < PATIENCE_S, "celld waits for a silent robot");
    }
    cell.shutdown().await;
}

/// Forwards one connection; what the robot sends is lost once the flag is up.
fn tunnel(robot: SocketAddr, broken: Arc<AtomicBool>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let (client, mut robot) = (listener.accept().unwrap().0, TcpStream::connect(robot).unwrap());
        let (mut from, mut to) = (client.try_clone().unwrap(), robot.try_clone().unwrap());
        std::thread::spawn(move || std::io::copy(&mut from, &mut to));
        let (mut client, mut buffer) = (client, [0; 65536]);
        while let Ok(count @ 1..) = robot.read(&mut buffer) {
            if !broken.load(Ordering::Relaxed) && client.write_all(&buffer[..count]).is_err() {
                return;
            }
        }
    });
    address
}
