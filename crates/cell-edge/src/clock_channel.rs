//! The clock channel between the simulator and a daemon on the same computer (docs/clock-channel.md).
//!
//! In: at the simulator's end ([`ClockServer`]) its time, frame by frame; at the daemon's ([`Following`])
//! how far it has taken in what was sent. Out: whether the simulator holds its time, and the time that the
//! daemon's clock shows. It is a Unix socket in the abstract namespace, named after the simulator's RTDE
//! address, so that no real controller, no tunnel and no other vendor's simulator can have one. No call
//! waits.

use crate::pace::{FollowerTime, Progress};
use cell_values::time::Duration;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use std::io::{ErrorKind, Read};
use std::net::SocketAddr;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr as UnixAddress, UnixListener, UnixStream};
use std::time::Instant;

/// Bytes of a message: microseconds of simulated time, little endian.
const MESSAGE: usize = 8;

/// Daemons that may follow one simulator.
const MOST_FOLLOWERS: usize = 8;

/// Reads of a connection at a time: what is sent faster than it can be read ends the channel.
const READS: usize = 64;

/// How often a simulator that holds its time says so, wall time.
const REPEAT: Duration = Duration::from_millis(20);

/// How often a daemon looks for a simulator, wall time.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Over how long the factor reached is measured, wall time.
const FACTOR_OVER: Duration = Duration::from_secs(5);

/// Name of the channel of the simulator whose RTDE server has this address; the digit is the version.
pub fn name(rtde: SocketAddr) -> String {
    format!("celld-clock-1/{rtde}")
}

/// The other side is gone or does not keep to the protocol.
#[derive(Debug)]
struct Gone;

/// One end of a connection.
#[derive(Debug)]
struct Line {
    stream: UnixStream,
    /// The beginning of a message.
    rest: Vec<u8>,
}

impl Line {
    fn new(stream: UnixStream) -> Line {
        Line { stream, rest: Vec::new() }
    }

    /// The latest time that has arrived, if any has.
    fn latest(&mut self) -> Result<Option<Duration>, Gone> {
        let (mut latest, mut buffer) = (None, [0; 64 * MESSAGE]);
        for _ in 0..READS {
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(Gone),
                Ok(count) => self.rest.extend_from_slice(buffer.get(..count).unwrap_or_default()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(latest),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(Gone),
            }
            let (messages, rest) = self.rest.as_chunks::<MESSAGE>();
            latest =
                messages.last().map(|bytes| Duration::from_micros(u64::from_le_bytes(*bytes))).or(latest);
            self.rest = rest.to_vec();
        }
        Err(Gone)
    }

    /// Sends a time; false if there is no room for it.
    fn send(&self, time: Duration) -> Result<bool, Gone> {
        let micros = u64::try_from(time.as_micros()).map_err(|_| Gone)?;
        match rustix::net::send(&self.stream, &micros.to_le_bytes(), rustix::net::SendFlags::NOSIGNAL) {
            Ok(MESSAGE) => Ok(true),
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => Ok(false),
            Ok(_) | Err(_) => Err(Gone),
        }
    }
}

#[derive(Debug)]
struct Follower {
    line: Line,
    progress: Progress,
}

impl Follower {
    fn hear(&mut self, simulated: Duration) -> Result<(), Gone> {
        if let Some(taken_in) = self.line.latest()? {
            // A follower cannot have received a time that was not sent yet.
            return self.progress.taken_in(taken_in.min(simulated)).then_some(()).ok_or(Gone);
        }
        Ok(())
    }
}

/// The simulator's end.
#[derive(Debug)]
pub struct ClockServer {
    listener: UnixListener,
    followers: Vec<Follower>,
    simulated: Duration,
    sent: Instant,
}

impl ClockServer {
    /// Takes the name of the simulator whose RTDE server has this address.
    ///
    /// # Errors
    /// It is taken.
    pub fn open(rtde: SocketAddr) -> std::io::Result<ClockServer> {
        let listener = UnixListener::bind_addr(&UnixAddress::from_abstract_name(name(rtde))?)?;
        listener.set_nonblocking(true)?;
        let (followers, simulated) = (Vec::new(), Duration::ZERO);
        Ok(ClockServer { listener, followers, simulated, sent: Instant::now() })
    }

    /// Simulated time has come so far: says so, and takes in what has been reported.
    pub fn reached(&mut self, simulated: Duration, now: Instant) {
        self.simulated = simulated;
        self.accept();
        self.send_time(now);
    }

    /// Takes in who has connected; each finds the time that it is.
    fn accept(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            let fits = self.followers.len() < MOST_FOLLOWERS && is_of_us(&stream);
            if fits && stream.set_nonblocking(true).is_ok() {
                let line = Line::new(stream);
                let _ = line.send(self.simulated);
                self.followers.push(Follower { line, progress: Progress::default() });
            }
        }
    }

    fn send_time(&mut self, now: Instant) {
        let simulated = self.simulated;
        self.sent = now;
        // A follower without room would find times of long ago when it reads again.
        self.followers.retain_mut(|follower| {
            matches!(follower.line.send(simulated), Ok(true)) && follower.hear(simulated).is_ok()
        });
    }

    /// True if any daemon follows.
    pub fn is_followed(&self) -> bool {
        !self.followers.is_empty()
    }

    /// Whether to hold the time now. Followers get a message that it stands. One that has been waited for
    /// too long is dropped: it finds the channel closed instead of times of long ago.
    pub fn holds(&mut self, now: Instant) -> bool {
        let simulated = self.simulated;
        self.accept();
        self.followers.retain_mut(|follower| follower.hear(simulated).is_ok());
        if now.saturating_duration_since(self.sent) >= REPEAT {
            self.send_time(now);
        }
        let mut any = false;
        self.followers.retain_mut(|follower| {
            let holds = follower.progress.holds(simulated, now);
            any |= holds == Some(true);
            holds.is_some()
        });
        any
    }
}

/// Simulated and wall time of the last measurement of the factor.
#[derive(Debug)]
struct FactorReached {
    from: (Duration, Instant),
    factor: Option<f64>,
}

impl FactorReached {
    fn update(&mut self, shown: Duration, now: Instant) {
        let wall = now.saturating_duration_since(self.from.1);
        if wall >= FACTOR_OVER {
            self.factor = Some(shown.saturating_sub(self.from.0).as_secs_f64() / wall.as_secs_f64());
            self.from = (shown, now);
        }
    }
}

/// The daemon's end: a time that follows the simulator's while there is one.
#[derive(Debug)]
pub struct Following {
    rtde: SocketAddr,
    line: Option<Line>,
    look_at: Instant,
    time: FollowerTime,
    reported: Option<Duration>,
    reached: FactorReached,
}

impl Following {
    /// Follows the simulator whose RTDE server has this address as soon as it is there.
    pub fn new(rtde: SocketAddr, factor: f64) -> Following {
        let now = Instant::now();
        Following {
            rtde,
            line: None,
            look_at: now,
            time: FollowerTime::new(factor, now),
            reported: None,
            reached: FactorReached { from: (Duration::ZERO, now), factor: None },
        }
    }

    /// The time at `now`, by what the simulator has said so far.
    pub fn at(&mut self, now: Instant) -> Duration {
        if self.line.is_none() && now >= self.look_at {
            self.look_at = now + LOOK_EVERY;
            self.line = connect(self.rtde).ok().map(Line::new);
        }
        if let Some(line) = &mut self.line {
            match line.latest() {
                Ok(None) => {}
                Ok(Some(simulated)) if self.time.received(simulated, now) => {}
                Ok(Some(_)) | Err(Gone) => self.lose(now),
            }
        }
        let shown = self.time.at(now);
        self.reached.update(shown, now);
        shown
    }

    fn lose(&mut self, now: Instant) {
        (self.line, self.reported) = (None, None);
        self.time.lost(now);
    }

    /// How far the simulator's time has come, while it is followed.
    pub fn simulated(&mut self, now: Instant) -> Option<Duration> {
        self.at(now);
        self.time.simulated()
    }

    /// Reports that what the simulator had sent before its time `simulated` is taken in.
    pub fn taken_in(&mut self, simulated: Duration, now: Instant) {
        let Some(line) = self.line.as_ref().filter(|_| self.reported != Some(simulated)) else { return };
        match line.send(simulated) {
            Ok(true) => self.reported = Some(simulated),
            // The next report says it too.
            Ok(false) => {}
            Err(Gone) => self.lose(now),
        }
    }

    /// Seconds of this clock per second of the wall's, lately; none while no simulator is followed.
    pub fn factor_reached(&self) -> Option<f64> {
        self.reached.factor.filter(|_| self.time.simulated().is_some())
    }
}

/// Connects without waiting: a simulator that takes no connections is none.
fn connect(rtde: SocketAddr) -> rustix::io::Result<UnixStream> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    rustix::net::connect(&socket, &SocketAddrUnix::new_abstract_name(name(rtde).as_bytes())?)?;
    let stream = UnixStream::from(socket);
    if is_of_us(&stream) { Ok(stream) } else { Err(rustix::io::Errno::PERM) }
}

/// The other end is a process of this user or of root, or this one is root's: names in the abstract
/// namespace have no owner.
fn is_of_us(stream: &UnixStream) -> bool {
    let own = rustix::process::geteuid();
    rustix::net::sockopt::socket_peercred(stream)
        .is_ok_and(|peer| peer.uid == own || peer.uid.is_root() || own.is_root())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pace::PATIENCE;

    const MS: Duration = Duration::from_millis(1);

    /// An address of its own for each test: the name alone is used.
    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 77, 1, 1], port))
    }

    /// Both ends, the daemon's connected and the simulator at 1 s.
    fn ends(port: u16, now: Instant) -> (ClockServer, Following) {
        let mut server = ClockServer::open(address(port)).unwrap();
        let mut following = Following::new(address(port), 1.0);
        following.look_at = now;
        following.at(now);
        server.reached(1000 * MS, now);
        assert_eq!(following.simulated(now), Some(1000 * MS));
        (server, following)
    }

    #[test]
    fn both_clocks_stand_while_the_daemon_is_late() {
        let start = Instant::now();
        let (mut server, mut following) = ends(1, start);
        assert!(server.is_followed() && !server.holds(start), "it has not reported yet");
        following.taken_in(1000 * MS, start);
        server.reached(1040 * MS, start);
        assert!(!server.holds(start));
        server.reached(1042 * MS, start);
        assert!(server.holds(start));
        let shown = following.at(start);
        assert_eq!(following.at(start + 1000 * MS), shown, "the simulator has said nothing new");
        following.taken_in(1042 * MS, start);
        assert!(!server.holds(start));
    }

    #[test]
    fn a_simulator_that_holds_its_time_is_not_taken_for_a_dead_one() {
        let start = Instant::now();
        let (mut server, mut following) = ends(2, start);
        let shown = following.at(start);
        for repeat in 1..500 {
            server.holds(start + repeat * REPEAT);
            assert_eq!(following.at(start + repeat * REPEAT), shown);
        }
        assert!(following.at(start + 499 * REPEAT + PATIENCE + 100 * MS) > shown, "silent since");
    }

    #[test]
    fn a_daemon_that_has_ended_holds_nothing_up() {
        let start = Instant::now();
        let (mut server, mut following) = ends(3, start);
        following.taken_in(1000 * MS, start);
        server.reached(2000 * MS, start);
        assert!(server.holds(start));
        drop(following);
        assert!(!server.holds(start) && !server.is_followed());
    }

    #[test]
    fn a_simulator_that_has_ended_is_not_waited_for_and_is_found_again() {
        let start = Instant::now();
        let (server, mut following) = ends(4, start);
        let shown = following.at(start);
        drop(server);
        assert_eq!(following.simulated(start + 10 * MS), None);
        assert_eq!(following.at(start + 60 * MS), shown + 50 * MS);
        let mut server = ClockServer::open(address(4)).unwrap();
        following.at(start + 300 * MS);
        server.reached(2 * MS, start);
        assert_eq!(following.simulated(start + 310 * MS), Some(2 * MS));
        assert_eq!(following.at(start + 900 * MS), shown + 300 * MS, "and followed from there");
    }

    /// A tunnel or another vendor's simulator.
    #[test]
    fn without_a_channel_the_clock_is_the_walls() {
        let mut following = Following::new(address(5), 1.0);
        let start = Instant::now();
        let first = following.at(start);
        assert_eq!(following.at(start + 500 * MS), first + 500 * MS);
        following.taken_in(700 * MS, start);
        assert_eq!((following.simulated(start), following.factor_reached()), (None, None));
    }

    #[test]
    fn a_peer_whose_time_goes_back_is_dropped() {
        let start = Instant::now();
        let (mut server, mut following) = ends(6, start);
        server.reached(999 * MS, start);
        assert_eq!(following.simulated(start), None);
        server.reached(999 * MS, start);
        assert!(!server.is_followed());
    }

    #[test]
    fn reports_from_the_future_count_as_the_present() {
        let start = Instant::now();
        let (mut server, mut following) = ends(7, start);
        following.taken_in(50_000 * MS, start);
        server.reached(1000 * MS, start);
        server.reached(1100 * MS, start);
        assert!(server.holds(start));
    }

    #[test]
    fn messages_may_arrive_in_pieces() {
        use std::io::Write;
        let (near, far) = UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let (mut line, mut far) = (Line::new(near), far);
        far.write_all(&[1, 0, 0]).unwrap();
        assert_eq!(line.latest().unwrap(), None);
        far.write_all(&[0, 0, 0, 0, 0, 2]).unwrap();
        assert_eq!(line.latest().unwrap(), Some(Duration::from_micros(1)));
        far.write_all(&[0; 7]).unwrap();
        assert_eq!(line.latest().unwrap(), Some(Duration::from_micros(2)));
        drop(far);
        assert!(line.latest().is_err());
    }

    /// Else a request that it makes at the old time would be overdue at once.
    #[test]
    fn a_daemon_that_was_held_up_for_too_long_finds_the_time_that_has_passed() {
        for reports in [false, true] {
            let start = Instant::now();
            let (mut server, mut following) = ends(8, start);
            let before = following.at(start);
            if reports {
                following.taken_in(1000 * MS, start);
            }
            for frame in 1..5000 {
                server.reached(1000 * MS + frame * 2 * MS, start);
                server.holds(start + frame * 2 * MS);
            }
            assert!(!server.is_followed());
            let passed = following.at(start + 10_000 * MS) - before;
            assert_eq!(passed, 10_000 * MS - PATIENCE);
        }
    }

    #[test]
    fn the_factor_reached_is_that_of_the_last_seconds() {
        let start = Instant::now();
        let (mut server, mut following) = ends(9, start);
        for second in 1..=12 {
            let now = start + second * 1000 * MS;
            server.reached(1000 * MS + second * 3000 * MS, now);
            following.at(now);
        }
        let factor = following.factor_reached().unwrap();
        assert!((factor - 3.0).abs() < 0.01, "{factor}");
    }
}
