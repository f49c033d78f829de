//! The whole simulated cell: controller, world, gripper and camera behind their sockets, and the thread that
//! keeps their time.
//!
//! In: [`SimConfig`]. Out: [`RunningSim`], which has the addresses, the world for reports and tests, and the
//! time factor that was reached. A frame is 2 ms of simulated time and is due every 2 ms / factor of wall
//! time. Frames that come late push the later ones back instead of being made up for in a burst: clients
//! would see time jump. With a factor above 1 the clients' processes may be the slow ones; then simulated
//! time is held, within bounds, while a client that writes regularly is late or one that reads is behind.

use crate::io::clock::Pace;
use crate::io::priority;
use crate::sim::camera::CameraSetup;
use crate::sim::camera_server;
use crate::sim::control_server;
use crate::sim::controller::{Controller, ControllerConfig};
use crate::sim::core::Core;
use crate::sim::faults::desk::FaultDesk;
use crate::sim::faults::link::LinkName;
use crate::sim::faults::{FaultError, Planned};
use crate::sim::gripper_server;
use crate::sim::motion::FRAME_SECONDS;
use crate::sim::robot_server::{self, ListenError, RobotAddresses, RobotPorts, RobotServers, RobotShared};
use crate::sim::world::spec::{WorldError, WorldSpec};
use crate::sim::world::{SharedWorld, World};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Longest that simulated time is held for a client, wall time.
const LONGEST_HOLD: Duration = Duration::from_millis(250);

/// Longest that simulated time waits for a daemon that follows it, wall time; below `io::clock`'s own
/// patience.
const LONGEST_WAIT: Duration = Duration::from_millis(1500);

/// How often a held frame looks whether it may go on.
const HOLD_POLL: Duration = Duration::from_micros(200);

/// Lateness that is still made up for: below the wake-up jitter of the system time would run slow, above it
/// frames are pushed back. At factor 20 this is a burst of five frames at most.
const TOLERATED_LATENESS: Duration = Duration::from_micros(500);

/// Frames in a row after none of which there was time to sleep, at which real-time priority is given up.
const MOST_SLEEPLESS: u32 = 50;

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

/// Why the simulation cannot start.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// A factor that is not a number above 0.
    #[error("time factor {0} is not a number between 0.01 and 1000")]
    TimeFactor(f64),
    /// The world's description is wrong.
    #[error("the simulated world cannot be built")]
    World(#[from] WorldError),
    /// A fault names something that is not there.
    #[error("a planned fault is impossible")]
    Fault(#[from] FaultError),
    /// An address is taken or not ours.
    #[error("the simulation cannot listen")]
    Listen(#[from] ListenError),
    /// The frame thread cannot be started.
    #[error("the simulation's frame thread cannot be started")]
    Thread(#[source] std::io::Error),
}

/// Where the servers listen.
#[derive(Clone, Copy, Debug)]
pub struct SimAddresses {
    /// The controller's five.
    pub robot: RobotAddresses,
    /// The gripper.
    pub modbus: SocketAddr,
    /// The camera.
    pub camera: SocketAddr,
    /// The control server, if it was asked for.
    pub control: Option<SocketAddr>,
}

/// A running simulation; it ends with [`RunningSim::shutdown`] or when it is dropped.
#[derive(Debug)]
pub struct RunningSim {
    /// Where the servers listen.
    pub addresses: SimAddresses,
    robot: Arc<RobotShared>,
    world: WorldHandle,
    desk: Arc<FaultDesk>,
    pace: Arc<Pace>,
    held_us: Arc<AtomicU64>,
    stop: watch::Sender<bool>,
    frames: Option<JoinHandle<()>>,
    servers: Option<(RobotServers, JoinSet<()>)>,
}

/// The world behind a handle that prints as its name: it is long.
struct WorldHandle(SharedWorld);

impl std::fmt::Debug for WorldHandle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("World")
    }
}

/// Starts the simulation.
///
/// # Errors
/// When the configuration is wrong or an address cannot be listened on.
pub async fn start(config: SimConfig) -> Result<RunningSim, SimError> {
    if !(0.01..=1000.0).contains(&config.time_factor) {
        return Err(SimError::TimeFactor(config.time_factor));
    }
    let robot = RobotShared::new(Controller::new(config.controller), config.bind);
    let core = Core::new(robot, World::new(config.world, config.seed)?, config.time_factor);
    core.desk.submit(config.faults)?;
    let Core { robot, world, desk } = core.clone();
    let (stop, stopped) = watch::channel(false);
    let modbus = listen("gripper", config.bind, config.modbus_port).await?;
    let camera = listen("camera", config.bind, config.camera_port).await?;
    let control = match config.control_port {
        Some(port) => Some(listen("control server", config.bind, port).await?),
        None => None,
    };
    let servers = robot_server::serve(&robot, config.bind, &config.ports, &stopped).await?;
    let addresses = SimAddresses {
        robot: servers.addresses,
        modbus: modbus.1,
        camera: camera.1,
        control: control.as_ref().map(|(_, address)| *address),
    };
    let mut tasks = JoinSet::new();
    let link = |name| robot.links.get(name).clone();
    let gripper = gripper_server::serve(modbus.0, world.clone(), link(LinkName::Gripper), until(&stopped));
    tasks.spawn(gripper);
    let seen = link(LinkName::Camera);
    let pictures = camera_server::serve(camera.0, config.camera, world.clone(), seen, until(&stopped));
    tasks.spawn(async move { report("camera server", pictures.await) });
    if let Some((listener, _)) = control {
        let control = control_server::serve(listener, world.clone(), desk.clone(), until(&stopped));
        tasks.spawn(async move { report("control server", control.await) });
    }
    let (pace, held_us) =
        (Arc::new(Pace::new(robot.controller().core.timestamp())), Arc::new(AtomicU64::new(0)));
    let frames = {
        let (pace, held_us) = (pace.clone(), held_us.clone());
        let factor = config.time_factor;
        let body = move || run_frames(&core, (&pace, &held_us), factor, &stopped);
        std::thread::Builder::new().name("sim-frames".to_owned()).spawn(body).map_err(SimError::Thread)?
    };
    Ok(RunningSim {
        addresses,
        robot,
        world: WorldHandle(world),
        desk,
        pace,
        held_us,
        stop,
        frames: Some(frames),
        servers: Some((servers, tasks)),
    })
}

async fn listen(
    server: &'static str,
    bind: IpAddr,
    port: u16,
) -> Result<(TcpListener, SocketAddr), ListenError> {
    let address = SocketAddr::new(bind, port);
    let failed = |source| ListenError { server, address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    Ok((listener, address))
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
        self.world.0.clone()
    }

    /// The controller and its connections: faults and tests.
    pub fn robot(&self) -> &Arc<RobotShared> {
        &self.robot
    }

    /// Faults: tests.
    pub fn desk(&self) -> &Arc<FaultDesk> {
        &self.desk
    }

    /// Simulated seconds per second since the start.
    pub fn factor_reached(&self) -> f64 {
        self.pace.factor()
    }

    /// Simulated time as it goes on, for a daemon in the same process.
    pub fn pace(&self) -> Arc<Pace> {
        self.pace.clone()
    }

    /// Seconds of wall time for which simulated time was held for clients.
    pub fn seconds_held(&self) -> f64 {
        self.held_us.load(Ordering::Relaxed) as f64 * 1e-6
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

/// When the next frame is due.
struct Schedule {
    period: Duration,
    due: Instant,
    /// When the frame that is being made was due before it was pushed back.
    intended: Instant,
}

impl Schedule {
    fn new(factor: f64, now: Instant) -> Schedule {
        let period = Duration::from_secs_f64(FRAME_SECONDS / factor);
        Schedule { period, due: now + period, intended: now }
    }

    /// Time to sleep until the frame that is due at `now`; a frame that is late by more than is tolerated
    /// moves all later ones.
    fn wait(&mut self, now: Instant) -> Duration {
        let wait = self.due.saturating_duration_since(now);
        self.intended = self.due;
        if now > self.due + TOLERATED_LATENESS.max(self.period) {
            self.due = now;
        }
        self.due += self.period;
        wait
    }
}

fn run_frames(
    core: &Core,
    (pace, held_us): (&Pace, &AtomicU64),
    factor: f64,
    stopped: &watch::Receiver<bool>,
) {
    // Clients measure silence on their own clocks; drawing pictures and planning can wait. Faster than real
    // time this thread may fill a core, which would then be lost to the clients it is meant for.
    if factor > 1.0 {
        priority::raise()
    } else {
        priority::real_time()
    }
    // The default slack of 50 us is half a frame at factor 20. Without it the pace is merely less even.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1000));
    let mut schedule = Schedule::new(factor, Instant::now());
    let (mut frames, mut sleepless): (u64, u32) = (0, 0);
    while !*stopped.borrow() && stopped.has_changed().is_ok() {
        if factor > 1.0 {
            let held = hold(&core.robot, stopped);
            held_us.fetch_add(held.as_micros() as u64, Ordering::Relaxed);
        }
        wait_for_follower(pace, held_us, stopped);
        core.advance(Some(schedule.intended));
        frames += 1;
        pace.reached(Duration::from_secs_f64(frames as f64 * FRAME_SECONDS));
        let wait = schedule.wait(Instant::now());
        sleepless = if wait.is_zero() { sleepless + 1 } else { 0 };
        if sleepless == MOST_SLEEPLESS && factor <= 1.0 {
            // Frames that take longer than they last would leave nothing to ordinary threads.
            tracing::warn!("this computer is too slow for real time: the simulation gives up its priority");
            priority::ordinary();
            priority::raise();
        }
        if !wait.is_zero() {
            std::thread::sleep(wait);
        }
    }
}

/// Waits for a daemon in the same process that reads this simulation's clock; what it has not heard of must
/// not look stale to it.
fn wait_for_follower(pace: &Pace, held_us: &AtomicU64, stopped: &watch::Receiver<bool>) {
    let start = Instant::now();
    while pace.ahead() {
        if start.elapsed() >= LONGEST_WAIT || *stopped.borrow() {
            pace.give_up();
            break;
        }
        std::thread::sleep(HOLD_POLL);
        held_us.fetch_add(HOLD_POLL.as_micros() as u64, Ordering::Relaxed);
    }
}

/// Waits while a client is late or behind; then gives those up, so that a dead one does not stop the time.
fn hold(robot: &RobotShared, stopped: &watch::Receiver<bool>) -> Duration {
    let (step, playing) = {
        let controller = robot.controller();
        (controller.core.step, controller.programs.playing())
    };
    // Only a running program listens for signs of life; without one a client may stop writing at any time.
    let waiting = || {
        let outlets = robot.outlets();
        (playing && outlets.someone_is_late(step)) || outlets.someone_is_behind()
    };
    if !waiting() {
        return Duration::ZERO;
    }
    let start = Instant::now();
    while waiting() {
        if start.elapsed() >= LONGEST_HOLD || *stopped.borrow() {
            robot.outlets().give_up(step);
            break;
        }
        std::thread::sleep(HOLD_POLL);
    }
    start.elapsed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::camera::CameraTiming;
    use crate::sim::render::lens::CameraTruth;
    use crate::sim::world::lock;
    use crate::sim::world::spec::{CameraMount, GripperSpec};
    use nalgebra::Isometry3;
    use tokio::io::AsyncReadExt;

    fn config(bind: &str, time_factor: f64) -> SimConfig {
        let camera = CameraTruth::ideal("sim-1", 64, 36, 40.0);
        SimConfig {
            bind: bind.parse().unwrap(),
            ports: RobotPorts::ANY,
            modbus_port: 0,
            camera_port: 0,
            control_port: Some(0),
            time_factor,
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

    #[test]
    fn frames_are_pushed_back_and_never_made_up_for_in_a_burst() {
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut schedule = Schedule::new(1.0, start);
        assert_eq!(schedule.wait(start), ms(2));
        assert_eq!(schedule.wait(start + ms(3)), ms(1));
        assert_eq!(schedule.wait(start + ms(7)), Duration::ZERO, "1 ms late");
        assert_eq!(schedule.wait(start + ms(7)), ms(1), "little lateness is made up for");
        assert_eq!(schedule.wait(start + ms(500)), Duration::ZERO);
        assert_eq!(schedule.wait(start + ms(500)), ms(2), "much is not");
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
    async fn pressing_on_the_table_stops_the_arm() {
        let sim = start(config("127.0.0.1", 100.0)).await.unwrap();
        let script =
            "def press():\n movel(pose_trans(get_actual_tcp_pose(), p[0,0,0.6,0,0,0]), v=0.5)\nend\n";
        let code = crate::sim::controller::builtins::compile_program(script);
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
