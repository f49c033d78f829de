//! The three links to the controller, by the daemon's own sessions over blocking sockets.
//!
//! In: the configuration. Out: [`RobotFacts`]. Each link has some seconds; they are looked at side by side.

use crate::config::cell::CellConfig;
use crate::config::sessions::{RTDE_HZ, clock};
use crate::doctor::robot::{DashboardFacts, LinkFault, PrimaryFacts, RobotFacts, RtdeFacts, ToolFacts};
use cell_edge::clock::Clock;
use cell_machine::device::dashboard_session::{DashboardEvent, DashboardSession};
use cell_machine::device::primary_session::{PrimaryEvent, PrimarySession};
use cell_machine::device::robot_types::Link;
use cell_machine::device::robot_types::RobotState;
use cell_machine::device::rtde_session::{NO_MARK, RtdeEvent, RtdeSession};
use cell_machine::stillness::Sway;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use ur_arm::kinematics::DhParameters;
use ur_wire::dashboard::{Command, Reply};

/// For a connection, wall time.
const CONNECT_WITHIN: Duration = Duration::from_secs(3);
/// For everything that a link has to say, in the cell's time.
const SAID_WITHIN: Duration = Duration::from_secs(12);
/// States are watched for so long, in the cell's time.
const WATCHED: Duration = Duration::from_secs(2);
/// How long one read may block, wall time.
const READ_WITHIN: Duration = Duration::from_millis(20);

/// Looks at the controller of the configuration; `daemon`: a celld runs already.
pub fn facts(config: &CellConfig, daemon: bool) -> RobotFacts {
    let host = config.devices.robot_host.as_str();
    let clock = match format!("{host}:30004").parse() {
        Ok(rtde) => clock(config.simulation, rtde),
        Err(_) => Clock::new(config.simulation.map_or(1.0, |simulation| simulation.clock_factor)),
    };
    std::thread::scope(|scope| {
        let dashboard = scope.spawn(|| dashboard(host, &clock));
        let primary = scope.spawn(|| primary(host, &clock));
        let rtde = rtde(host, &clock);
        let died = || LinkFault::Broken("the probe has failed".to_string());
        RobotFacts {
            host: host.to_string(),
            dashboard: dashboard.join().unwrap_or_else(|_| Err(died())),
            primary: primary.join().unwrap_or_else(|_| Err(died())),
            rtde,
            tool: ToolFacts {
                mass_kg: config.gripper.mass_kg,
                centre_of_gravity_m: config.gripper.centre_of_gravity_m,
                flange_from_tool: config.flange_from_tool,
            },
            daemon,
            simulated: config.simulation.is_some(),
        }
    })
}

/// What the three sessions have in common.
trait Session {
    fn connected(&mut self, now: Timestamp);
    fn received(&mut self, now: Timestamp, bytes: &[u8]);
    fn tick(&mut self, now: Timestamp);
    fn poll_transmit(&mut self) -> Option<Vec<u8>>;
}

macro_rules! session {
    ($name:ty) => {
        impl Session for $name {
            fn connected(&mut self, now: Timestamp) {
                self.connected(now);
            }
            fn received(&mut self, now: Timestamp, bytes: &[u8]) {
                self.received(now, bytes);
            }
            fn tick(&mut self, now: Timestamp) {
                self.tick(now);
            }
            fn poll_transmit(&mut self) -> Option<Vec<u8>> {
                self.poll_transmit()
            }
        }
    };
}
session!(DashboardSession);
session!(PrimarySession);
session!(RtdeSession);

/// A session on its socket.
struct Line<S> {
    stream: TcpStream,
    session: S,
    clock: Clock,
    begun: Timestamp,
}

impl<S: Session> Line<S> {
    fn connect(host: &str, link: Link, clock: &Clock, mut session: S) -> Result<Line<S>, LinkFault> {
        let stream = connect(host, link.port())?;
        let begun = clock.now();
        session.connected(begun);
        Ok(Line { stream, session, clock: clock.clone(), begun })
    }

    /// Sends what is to be sent and takes what has come; true if something has.
    fn turn(&mut self, buffer: &mut [u8]) -> Result<bool, LinkFault> {
        let broken = |error: std::io::Error| LinkFault::Broken(error.to_string());
        while let Some(bytes) = self.session.poll_transmit() {
            self.stream.write_all(&bytes).map_err(broken)?;
        }
        let came = match self.stream.read(buffer) {
            Ok(0) => return Err(LinkFault::Broken("the controller closes the connection".to_string())),
            Ok(count) => {
                self.session.received(self.clock.now(), buffer.get(..count).unwrap_or_default());
                true
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => false,
            Err(error) => return Err(broken(error)),
        };
        self.session.tick(self.clock.now());
        Ok(came)
    }

    fn overdue(&self) -> bool {
        self.clock.now().since(self.begun) > SAID_WITHIN
    }
}

fn connect(host: &str, port: u16) -> Result<TcpStream, LinkFault> {
    let found = (host, port).to_socket_addrs().map_err(|error| LinkFault::NoAddress(error.to_string()))?;
    let addresses: Vec<SocketAddr> = found.collect();
    let address = addresses.first().ok_or_else(|| LinkFault::NoAddress("the name has none".to_string()))?;
    let stream = TcpStream::connect_timeout(address, CONNECT_WITHIN).map_err(|error| match error.kind() {
        ErrorKind::ConnectionRefused => LinkFault::Refused,
        _ => LinkFault::Silent(error.to_string()),
    })?;
    let set = stream.set_read_timeout(Some(READ_WITHIN)).and_then(|()| stream.set_nodelay(true));
    set.map_err(|error| LinkFault::Broken(error.to_string()))?;
    Ok(stream)
}

fn dashboard(host: &str, clock: &Clock) -> Result<DashboardFacts, LinkFault> {
    let mut line = Line::connect(host, Link::Dashboard, clock, DashboardSession::default())?;
    let (mut facts, mut buffer, mut requested) = (DashboardFacts::default(), [0; 4096], clock.now());
    // The last of what the session queries by itself.
    while facts.safety_mode.is_none() {
        line.turn(&mut buffer)?;
        while let Some(event) = line.session.poll_event() {
            match event {
                DashboardEvent::Reply { command, reply } => {
                    facts.slowest = facts.slowest.max(clock.now().since(requested));
                    requested = clock.now();
                    take_reply(&mut facts, &command, reply);
                }
                DashboardEvent::Fault(cause) => return Err(LinkFault::Broken(cause)),
                DashboardEvent::Silent(cause) => return Err(LinkFault::Silent(cause)),
            }
        }
        if line.overdue() {
            return Err(LinkFault::Silent("some questions stay without an answer".to_string()));
        }
    }
    Ok(facts)
}

fn take_reply(facts: &mut DashboardFacts, command: &Command, reply: Reply) {
    match (command, reply) {
        (Command::PolyscopeVersion, Reply::Text(text)) => facts.version = Some(text),
        (Command::GetSerialNumber, Reply::Text(text)) => facts.serial = Some(text),
        (Command::GetRobotModel, Reply::Text(text)) => facts.model = Some(text),
        (Command::IsInRemoteControl, Reply::Flag(on)) => facts.remote_control = Some(on),
        (Command::RobotMode, Reply::RobotMode(mode)) => facts.robot_mode = Some(mode),
        (Command::SafetyMode, Reply::SafetyMode(mode)) => facts.safety_mode = Some(mode),
        _ => {}
    }
}

fn primary(host: &str, clock: &Clock) -> Result<PrimaryFacts, LinkFault> {
    let mut line = Line::connect(host, Link::Primary, clock, PrimarySession::default())?;
    let (mut facts, mut buffer) = (PrimaryFacts::default(), [0; 64 * 1024]);
    // A controller that has not sent its kinematics by then has its own line on the sheet.
    while facts.dh.is_none() && !line.overdue() {
        line.turn(&mut buffer)?;
        while let Some(event) = line.session.poll_event() {
            match event {
                PrimaryEvent::Kinematics(data) => {
                    let (a, d, alpha, theta) = (data.a, data.d, data.alpha, data.theta);
                    facts.dh = Some(DhParameters { a, d, alpha, theta });
                    facts.checksum = data.checksum.map(|word| format!("{word:08x}")).concat();
                }
                PrimaryEvent::SafetyChecksum(checksum) => facts.safety_checksum = Some(checksum),
                PrimaryEvent::Fault(cause) => return Err(LinkFault::Broken(cause)),
                PrimaryEvent::Silent(cause) => return Err(LinkFault::Silent(cause)),
                PrimaryEvent::ProgramStarted(_)
                | PrimaryEvent::ProgramStopped(_)
                | PrimaryEvent::RuntimeException { .. }
                | PrimaryEvent::ReadOnly
                | PrimaryEvent::ErrorCode { .. }
                | PrimaryEvent::Message(_) => {}
            }
        }
    }
    Ok(facts)
}

fn rtde(host: &str, clock: &Clock) -> Result<RtdeFacts, LinkFault> {
    let mut line = Line::connect(host, Link::Rtde, clock, RtdeSession::new(RTDE_HZ, NO_MARK))?;
    let (mut facts, mut buffer) = (RtdeFacts::default(), [0; 64 * 1024]);
    let (mut watch, mut rest) = (ArrivalStats::default(), RestStats::default());
    while watch.since.is_none_or(|since| clock.now().since(since) < WATCHED) {
        line.turn(&mut buffer)?;
        while let Some(event) = line.session.poll_event() {
            match event {
                RtdeEvent::Ready => {}
                // Another try would wait 5 s for a client that has crashed; the line says that there may be
                // one.
                RtdeEvent::InUse { taken, .. } => {
                    facts.taken = Some(taken);
                    return Ok(facts);
                }
                RtdeEvent::Jump(detail) => {
                    facts.messages.push(format!("the arm's position jumped: {detail}"));
                }
                RtdeEvent::Message(text) => facts.messages.push(text),
                RtdeEvent::Fault(cause) => return Err(LinkFault::Broken(cause)),
                RtdeEvent::Silent(cause) => return Err(LinkFault::Silent(cause)),
            }
        }
        if let Some(state) = line.session.latest() {
            watch.saw(clock.now(), state.controller_time_s);
            rest.saw(state);
            facts.state = Some(state.clone());
        }
        if watch.since.is_none() && line.overdue() {
            return Err(LinkFault::Silent("no state within 12 s".to_string()));
        }
    }
    (facts.packages, facts.lost, facts.longest_gap) = (watch.packages, watch.lost(), watch.longest_gap);
    facts.sway = rest.largest;
    Ok(facts)
}

/// Rest before a calibration picture: the longest that celld requires.
const WATCHED_REST: Duration = Duration::from_millis(500);

/// How well the joints rest.
#[derive(Default)]
struct RestStats {
    /// Positions of the last moments, with the controller's time, s.
    last: VecDeque<(f64, Joints)>,
    largest: Sway,
}

impl RestStats {
    fn saw(&mut self, state: &RobotState) {
        let now_s = state.controller_time_s;
        if self.last.back().is_some_and(|(last_s, _)| *last_s == now_s) {
            return;
        }
        self.last.push_back((now_s, state.q));
        while self.last.front().is_some_and(|(at_s, _)| now_s - at_s > WATCHED_REST.as_secs_f64()) {
            self.last.pop_front();
        }
        let sway = Sway::among(self.last.iter().map(|(_, q)| q));
        if sway.by_rad > self.largest.by_rad {
            self.largest = sway;
        }
    }
}

/// How steadily states come.
#[derive(Default)]
struct ArrivalStats {
    since: Option<Timestamp>,
    last: Timestamp,
    packages: u32,
    /// The controller's time of the first and the last, s.
    times: (f64, f64),
    longest_gap: Duration,
}

impl ArrivalStats {
    /// States that come in one read count as one arrival; none of them is lost.
    fn saw(&mut self, now: Timestamp, controller_time_s: f64) {
        if self.since.is_none() {
            (self.since, self.times) = (Some(now), (controller_time_s, controller_time_s));
        } else if controller_time_s > self.times.1 {
            self.longest_gap = self.longest_gap.max(now.since(self.last));
            self.times.1 = controller_time_s;
        } else {
            return;
        }
        self.last = now;
        self.packages += 1;
    }

    /// Periods of the controller's time in which nothing arrived.
    fn lost(&self) -> u32 {
        let due = ((self.times.1 - self.times.0) * RTDE_HZ).round() as u32 + 1;
        due.saturating_sub(self.packages)
    }
}
