//! The whole simulated cell as a process runs it: controller, world, gripper and camera behind their
//! sockets, and the thread that keeps their time.
//!
//! In: [`SimConfig`]. Out: [`RunningSim`], which has the addresses, the world for reports and tests, and the
//! time factor that was reached. This only puts together: [`frames`] advances the [`Core`],
//! [`crate::serve`] carries bytes between sockets and the sessions on it.

use crate::camera::CameraSetup;
use crate::camera_server;
use crate::control_server;
use crate::controller::{Controller, ControllerConfig};
use crate::core::Core;
use crate::faults::injector::FaultInjector;
use crate::faults::link::LinkName;
use crate::faults::{FaultError, Planned};
use crate::frames::{self, Holding, Progress};
use crate::robot_server::shared::RobotShared;
use crate::robot_server::{ROBOTIQ_PORT, RobotAddresses, RobotPorts, TOOL_SERIAL_PORT};
use crate::script_sockets::TcpScriptSockets;
use crate::serve::{ListenError, Servers, listen};
use crate::session::Port;
use crate::world::spec::{WorldError, WorldSpec};
use crate::world::{SharedWorld, World};
use cell_edge::clock_channel::{self, ClockServer};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::thread::JoinHandle;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// What is simulated and where it listens.
#[derive(Clone, Debug)]
pub struct SimConfig {
    /// Address of all servers.
    pub bind: IpAddr,
    /// Ports of the controller.
    pub ports: RobotPorts,
    /// Port of the gripper's Modbus server; 0 for any.
    pub modbus_port: u16,
    /// Port of the camera; 0 for any.
    pub camera_port: u16,
    /// Port of the control server, which is not started without; 0 for any.
    pub control_port: Option<u16>,
    /// Simulated seconds per second.
    pub time_factor: f64,
    /// Simulated time is held for nobody.
    pub strict: bool,
    /// The controller and the arm.
    pub controller: ControllerConfig,
    /// Table, objects and gripper.
    pub world: WorldSpec,
    /// The camera.
    pub camera: CameraSetup,
    /// Seed of the world's random errors.
    pub seed: u64,
    /// What goes wrong, and when.
    pub faults: Vec<Planned>,
}

impl SimConfig {
    /// Moves all ports that are fixed up by `offset`.
    ///
    /// # Errors
    /// A port would be beyond 65535.
    pub fn move_ports(&mut self, offset: u16) -> Result<(), SimError> {
        let up = |port: u16| match port {
            0 => Ok(0),
            port => port.checked_add(offset).ok_or(SimError::PortOffset { port, offset }),
        };
        let RobotPorts { dashboard, robotiq, tool_serial, .. } = self.ports;
        let others = [robotiq, tool_serial].map(Option::unwrap_or_default);
        let highest = RobotPorts::REAL.interpreter.max(dashboard).max(others[0]).max(others[1]);
        let beyond = SimError::PortOffset { port: highest, offset };
        if self.ports != RobotPorts::ANY {
            self.ports = self.ports.moved(offset).ok_or(beyond)?;
        }
        (self.modbus_port, self.camera_port) = (up(self.modbus_port)?, up(self.camera_port)?);
        self.control_port = self.control_port.map(up).transpose()?;
        Ok(())
    }
}

/// Why the simulation cannot start.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// A factor that is not a number above 0.
    #[error("time factor {0} is not a number between 0.01 and 1000")]
    TimeFactor(f64),
    /// A port beyond the last one.
    #[error("port {port} cannot be moved up by {offset}: the last port is 65535")]
    PortOffset {
        /// Which port.
        port: u16,
        /// By how much.
        offset: u16,
    },
    /// The world's description is wrong.
    #[error("the simulated world cannot be built")]
    World(#[from] WorldError),
    /// A fault names something that is not there.
    #[error("a planned fault is impossible")]
    Fault(#[from] FaultError),
    /// An address is taken or not ours.
    #[error("the simulation cannot listen")]
    Listen(#[from] ListenError),
    /// Another process has the name.
    #[error("the clock channel {name:?} cannot be opened")]
    Clock {
        /// Of the channel.
        name: String,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The frame thread cannot be started.
    #[error("the simulation's frame thread cannot be started")]
    Thread(#[source] std::io::Error),
}

/// Where the servers listen.
#[derive(Clone, Copy, Debug)]
pub struct SimAddresses {
    /// The controller's.
    pub robot: RobotAddresses,
    /// The gripper.
    pub modbus: SocketAddr,
    /// The camera.
    pub camera: SocketAddr,
    /// The control server, if it was requested.
    pub control: Option<SocketAddr>,
    /// Whether it has a clock channel, which has the name of the RTDE server's address.
    pub clock: bool,
}

/// A running simulation; it ends with [`RunningSim::shutdown`] or when it is dropped.
#[derive(Debug)]
pub struct RunningSim {
    /// Where the servers listen.
    pub addresses: SimAddresses,
    core: Core,
    progress: Arc<Progress>,
    stop: watch::Sender<bool>,
    frames: Option<JoinHandle<()>>,
    servers: Option<(Servers, JoinSet<()>)>,
}

/// Starts the simulation.
///
/// # Errors
/// When the configuration is wrong or an address cannot be listened on.
pub async fn start(config: SimConfig) -> Result<RunningSim, SimError> {
    if !(0.01..=1000.0).contains(&config.time_factor) {
        return Err(SimError::TimeFactor(config.time_factor));
    }
    let core = Core::new(
        Controller::new(config.controller),
        World::new(config.world, config.seed)?,
        config.time_factor,
    );
    core.injector.submit(config.faults)?;
    let (stop, stopped) = watch::channel(false);
    let gripper = listen(Port::Gripper.name(), config.bind, config.modbus_port).await?;
    let camera = listen("camera", config.bind, config.camera_port).await?;
    let control = match config.control_port {
        Some(port) => Some(listen("control server", config.bind, port).await?),
        None => None,
    };
    let mut servers = Servers::default();
    let addresses = SimAddresses {
        robot: servers.take_robot(&core, config.bind, &config.ports, &stopped).await?,
        modbus: gripper.1,
        camera: camera.1,
        control: control.as_ref().map(|(_, address)| *address),
        clock: !config.strict,
    };
    let own = [(ROBOTIQ_PORT, addresses.robot.robotiq), (TOOL_SERIAL_PORT, addresses.robot.tool_serial)];
    let sockets = TcpScriptSockets::from_address(config.bind).with_own(own);
    core.robot.controller().core.sockets = Box::new(sockets);
    servers.take(gripper, &core, Port::Gripper, &stopped);
    let mut tasks = JoinSet::new();
    let link = (core.robot.links.get(LinkName::Camera).clone(), core.robot.lateness.clone());
    let pictures = camera_server::serve(camera.0, config.camera, core.world.clone(), link, until(&stopped));
    tasks.spawn(async move { report("camera server", pictures.await) });
    if let Some((listener, _)) = control {
        let (world, injector) = (core.world.clone(), core.injector.clone());
        let control = control_server::serve(listener, world, injector, until(&stopped));
        tasks.spawn(async move { report("control server", control.await) });
    }
    let holding = holding(config.strict, config.time_factor, addresses.robot.rtde)?;
    let progress = Arc::new(Progress::default());
    let frames = {
        let (core, progress, factor) = (core.clone(), progress.clone(), config.time_factor);
        let body = move || frames::run(&core, &progress, factor, holding, &stopped);
        std::thread::Builder::new().name("sim-frames".to_owned()).spawn(body).map_err(SimError::Thread)?
    };
    let (frames, servers) = (Some(frames), Some((servers, tasks)));
    Ok(RunningSim { addresses, core, progress, stop, frames, servers })
}

/// For whom simulated time is held.
fn holding(strict: bool, factor: f64, rtde: SocketAddr) -> Result<Holding, SimError> {
    if strict {
        return Ok(Holding { clock: None, slow_readers: false });
    }
    let clock = ClockServer::open(rtde);
    let clock = clock.map_err(|source| SimError::Clock { name: clock_channel::name(rtde), source })?;
    Ok(Holding { clock: Some(clock), slow_readers: factor > 1.0 })
}

/// Resolves when the simulation ends.
fn until(stopped: &watch::Receiver<bool>) -> impl Future<Output = ()> + Send + Sync + 'static {
    let mut stopped = stopped.clone();
    async move {
        // An error means that the sender is gone, which is an end too.
        let _ = stopped.wait_for(|stop| *stop).await;
    }
}

fn report<E: std::fmt::Display>(server: &'static str, result: Result<(), E>) {
    if let Err(error) = result {
        tracing::error!(server, %error, "simulated server ended");
    }
}

impl RunningSim {
    /// The world: true poses for the final report and for tests.
    pub fn world(&self) -> SharedWorld {
        self.core.world.clone()
    }

    /// The controller and its connections: faults and tests.
    pub fn robot(&self) -> &Arc<RobotShared> {
        &self.core.robot
    }

    /// Faults: tests.
    pub fn injector(&self) -> &Arc<FaultInjector> {
        &self.core.injector
    }

    /// Simulated seconds per second since the start.
    pub fn factor_reached(&self) -> f64 {
        self.progress.factor()
    }

    /// Seconds of wall time for which simulated time was held for clients.
    pub fn seconds_held(&self) -> f64 {
        self.progress.seconds_held()
    }

    /// Ends all connections and the frame thread.
    pub async fn shutdown(mut self) {
        self.stop.send_replace(true);
        if let Some((servers, mut tasks)) = self.servers.take() {
            servers.stopped().await;
            while tasks.join_next().await.is_some() {}
        }
        if let Some(frames) = self.frames.take() {
            // The thread looks at the signal every frame; a panic in it was printed when it happened.
            let _ = tokio::task::spawn_blocking(move || frames.join()).await;
        }
    }
}

impl Drop for RunningSim {
    fn drop(&mut self) {
        self.stop.send_replace(true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraTiming;
    use crate::render::lens::CameraTruth;
    use crate::serve::MAX_CONNECTIONS;
    use crate::world::drive::{Drive, FingersSpec};
    use crate::world::lock;
    use crate::world::spec::{CameraMount, GripperSpec};
    use nalgebra::Isometry3;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    fn config(bind: &str, time_factor: f64) -> SimConfig {
        let camera = CameraTruth::ideal("sim-1", 64, 36, 40.0);
        SimConfig {
            bind: bind.parse().unwrap(),
            ports: RobotPorts::ANY,
            modbus_port: 0,
            camera_port: 0,
            control_port: Some(0),
            time_factor,
            strict: false,
            controller: ControllerConfig { running: true, ..ControllerConfig::ur5e(1) },
            world: WorldSpec::bare(Isometry3::translation(-0.75, -0.4, 0.0), GripperSpec::one_cup(0.2)),
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

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn time_goes_on_and_everything_answers_until_shutdown() {
        let sim = start(config("127.0.0.1", 50.0)).await.unwrap();
        let began = sim.robot().controller().core.timestamp();
        for address in [sim.addresses.robot.dashboard, sim.addresses.robot.primary] {
            let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
            stream.read_u8().await.unwrap();
        }
        for address in [sim.addresses.modbus, sim.addresses.camera, sim.addresses.control.unwrap()] {
            tokio::net::TcpStream::connect(address).await.unwrap();
        }
        while sim.robot().controller().core.timestamp() < began + 1.0 {
            tokio::task::yield_now().await;
        }
        assert!(sim.factor_reached() > 0.0 && lock(&sim.world()).now_s() > began);
        let address = sim.addresses.robot.rtde;
        sim.shutdown().await;
        assert!(tokio::net::TcpStream::connect(address).await.is_err());
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn forgotten_connections_shut_out_no_other_client_of_dashboard_and_control_server() {
        let sim = start(config("127.0.0.1", 1.0)).await.unwrap();
        let control = sim.addresses.control.unwrap();
        let mut forgotten = Vec::new();
        for _ in 0..3 * MAX_CONNECTIONS {
            for address in [sim.addresses.robot.dashboard, control] {
                forgotten.push(tokio::net::TcpStream::connect(address).await.unwrap());
            }
        }
        let request = async |address, request: &[u8], count: usize| {
            let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
            stream.write_all(request).await.unwrap();
            let mut answer = vec![0; count];
            stream.read_exact(&mut answer).await.unwrap();
            answer
        };
        assert_eq!(request(sim.addresses.robot.dashboard, b"robotmode\n", 9).await, b"Connected");
        let world = b"GET /world.json HTTP/1.1\r\nHost: sim\r\n\r\n";
        assert_eq!(request(control, world, 15).await, b"HTTP/1.1 200 OK");
        sim.shutdown().await;
    }

    #[test]
    fn an_offset_moves_the_ports_that_are_fixed() {
        let fixed = || SimConfig { ports: RobotPorts::REAL, modbus_port: 502, ..config("127.0.0.1", 1.0) };
        let mut moved = fixed();
        moved.move_ports(1000).unwrap();
        assert_eq!((moved.ports.dashboard, moved.ports.rtde), (30_999, 31_004));
        assert_eq!(
            (moved.ports.primary, moved.ports.secondary, moved.ports.realtime),
            (31_001, 31_002, 31_003)
        );
        assert_eq!((moved.ports.read_only, moved.modbus_port), ([31_011, 31_012, 31_013], 1502));
        assert_eq!((moved.camera_port, moved.control_port), (0, Some(0)), "any stays any");
        assert!(fixed().move_ports(35_515).is_ok() && fixed().move_ports(35_516).is_err());
        let mut camera = SimConfig { camera_port: 60_000, ..fixed() };
        let error = camera.move_ports(10_000).unwrap_err();
        assert!(error.to_string().contains("port 60000"), "{error}");
    }

    #[tokio::test]
    async fn bad_configurations_are_refused() {
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(start(config("127.0.0.1", factor)).await, Err(SimError::TimeFactor(_))));
        }
        let mut taken = config("127.0.0.1", 1.0);
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        taken.modbus_port = listener.local_addr().unwrap().port();
        let error = start(taken).await.unwrap_err();
        assert!(matches!(&error, SimError::Listen(listen) if listen.server == "gripper"), "{error}");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn scripts_find_the_urcap_of_a_robotiq_gripper_on_their_own_controller() {
        let mut config = config("127.0.0.1", 10.0);
        config.world.gripper.drive = Drive::Fingers(FingersSpec::ROBOTIQ_2F85);
        config.world.gripper.cups.clear();
        let sim = start(config).await.unwrap();
        assert!(sim.addresses.robot.robotiq.is_some());
        let script = "def rq():\n socket_open(\"127.0.0.1\", 63352, \"g\")\n socket_set_var(\"ACT\", 1, \
                      \"g\")\n ack = socket_read_byte_list(3, \"g\")\n while socket_get_var(\"STA\", \"g\") != \
                      3:\n  sync()\n end\n set_standard_digital_out(1, ack == [3, 97, 99, 107])\nend\n";
        sim.robot().controller().programs.upload(crate::controller::builtins::compile_program(script));
        let output = || sim.robot().controller().core.registers.digital_outputs;
        let begun = tokio::time::Instant::now();
        while output() != 1 << 1 {
            assert!(begun.elapsed().as_secs() < 30, "the gripper was not activated");
            tokio::task::yield_now().await;
        }
        sim.shutdown().await;
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn pressing_on_the_table_stops_the_arm() {
        let sim = start(config("127.0.0.1", 100.0)).await.unwrap();
        let script =
            "def press():\n movel(pose_trans(get_actual_tcp_pose(), p[0,0,0.6,0,0,0]), v=0.5)\nend\n";
        let code = crate::controller::builtins::compile_program(script);
        sim.robot().controller().programs.upload(code);
        while !sim.robot().controller().core.modes.protective_stopped() {
            tokio::task::yield_now().await;
            assert!(sim.robot().controller().core.step < 5000, "the arm went through the table");
        }
        let contact = lock(&sim.world()).contact().cloned();
        assert!(contact.is_some_and(|contact| contact.against == "table"));
        sim.shutdown().await;
    }
}
