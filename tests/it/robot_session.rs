//! The robot session against the simulated controller, over real sockets: what `cell_machine::device` and
//! `ur-sim` each took from the vendor's guides has to fit together, and the on-robot program in between is
//! the real one.

#![expect(clippy::unwrap_used, reason = "a test that unwraps is a test that fails loudly")]

use cell_edge::clock::Clock;
use cell_machine::device::program::Nonce;
use cell_machine::device::robot::Robot;
use cell_machine::device::robot_types::{Link, ProgramEnd, RobotCommand, RobotEvent, RobotParameters};
use cell_motion::bodies::{Bodies, Room};
use cell_motion::path::{ArmLimits, ArmModel, CheckedPath, Leg, Segment};
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use ur_arm::kinematics::DhParameters;
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
    links: BTreeMap<u16, TcpStream>,
    clock: Clock,
    events: Vec<RobotEvent>,
    dh: DhParameters,
}

impl Cell {
    async fn new(running: bool) -> Cell {
        let sim = start(config(running)).await.unwrap();
        let robot = Robot::new(RobotParameters::full_rate()).unwrap();
        let clock = Clock::simulated(sim.addresses.robot.rtde, FACTOR);
        let (links, dh) = (BTreeMap::new(), DhParameters::UR5E);
        let mut cell = Cell { sim, robot, links, clock, events: Vec::new(), dh };
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
            Link::Rtde => addresses.rtde,
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
            dh: self.dh,
            base_from_table: Isometry3::identity(),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.1),
            home: from,
            limits,
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
