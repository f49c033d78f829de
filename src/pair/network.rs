//! The network between cell and simulator in virtual time: delays, splits, and what the simulator's faults
//! do to it.
//!
//! In: connect, close and send of the machine, what the simulator transmits, a seed. Out: events of the
//! machine and calls of the simulator, in order on each connection. Times are whole controller frames (2
//! ms). A cut cable is silence in both directions that goes on where it was when the fault ends, as TCP
//! does; a reset ends a connection for both sides.

use cell_machine::device::gripper_types::{ModbusRequest, UNIT};
use cell_machine::device::modbus::master::{Action, Ending, Master};
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use cell_values::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use tokio::sync::watch;
use ur_sim::faults::link::LinkState;
use ur_sim::motion::FRAME_SECONDS;
use ur_sim::session::Port;
use ur_sim::simulator::{ConnectionId, Simulator, Transmission};

/// How the network behaves without faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weather {
    /// Share of the packets that are a frame late.
    pub late: f64,
    /// Share of the packets that arrive in two pieces.
    pub split: f64,
    /// Share of the packets to celld before which their connection is silent for 100 ms.
    pub gap_share: f64,
    /// How long the dashboard takes to answer, s.
    pub dashboard_s: f64,
}

impl Weather {
    /// A switch between two machines, a little busy.
    pub const LAN: Weather = Weather { late: 0.05, split: 0.02, gap_share: 0.0, dashboard_s: 0.0 };

    /// The worst plausible link: gaps of 100 ms, about one a minute on RTDE.
    pub const WORST: Weather = Weather { late: 0.3, split: 0.2, gap_share: 1.5e-4, dashboard_s: 0.7 };

    /// Extra frames by which a packet to celld is late.
    fn extra_frames(&self, port: Port, rng: &mut ChaCha8Rng) -> u64 {
        let gap = self.gap_share > 0.0 && rng.random_bool(self.gap_share);
        let answers =
            if port == Port::Dashboard { (self.dashboard_s / FRAME_SECONDS).round() as u64 } else { 0 };
        answers + if gap { GAP_FRAMES } else { 0 }
    }

    /// A link may be silent for longer than celld lets a motion go on.
    pub fn has_gaps(&self) -> bool {
        self.gap_share > 0.0
    }
}

/// Length of a gap.
const GAP_FRAMES: u64 = 50;

struct Line {
    port: Port,
    /// Which connection of the gripper's master it carries.
    number: Option<u64>,
    id: Option<ConnectionId>,
    /// A request to connect that is answered in this frame.
    connecting: Option<u64>,
    to_sim: VecDeque<(u64, Vec<u8>)>,
    to_cell: VecDeque<(u64, Vec<u8>)>,
    watch: watch::Receiver<LinkState>,
    state: LinkState,
    /// Bytes that the simulator has sent on this connection.
    sent: u64,
}

/// What has become of a line.
enum Happened {
    Connected,
    Ended(Ending),
}

/// All connections: three to the controller, two to the gripper, as an old one may not be given up yet
/// when a new one is made. See the module.
pub struct Network {
    lines: [Line; 5],
    rng: ChaCha8Rng,
    weather: Weather,
    master: Master,
    /// Answers of the gripper for the next step.
    answers: Vec<Event>,
}

/// Lines of the gripper.
const GRIPPER: [usize; 2] = [3, 4];

fn time_of(frame: u64) -> Timestamp {
    Timestamp::from_nanos(frame * 2_000_000)
}

fn port_of(link: Link) -> Port {
    match link {
        Link::Rtde => Port::Rtde,
        Link::Dashboard => Port::Dashboard,
        Link::Primary => Port::Primary,
    }
}

fn link_of(port: Port) -> Option<Link> {
    Link::ALL.into_iter().find(|link| port_of(*link) == port)
}

impl Network {
    /// Nothing is connected.
    pub fn new(simulator: &Simulator, seed: u64, weather: Weather) -> Network {
        let line = |port: Port| Line {
            port,
            number: None,
            id: None,
            connecting: None,
            to_sim: VecDeque::new(),
            to_cell: VecDeque::new(),
            watch: simulator.core().robot.links.get(port.link()).watch(),
            state: simulator.link(port.link()),
            sent: 0,
        };
        Network {
            lines: [Port::Rtde, Port::Dashboard, Port::Primary, Port::Gripper, Port::Gripper].map(line),
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x6e65_7477),
            weather,
            master: Master::new(UNIT),
            answers: Vec::new(),
        }
    }

    fn line(&mut self, link: Link) -> &mut Line {
        let [rtde, dashboard, primary, ..] = &mut self.lines;
        match link {
            Link::Rtde => rtde,
            Link::Dashboard => dashboard,
            Link::Primary => primary,
        }
    }

    /// The line that carries a connection of the gripper's master.
    fn gripper(&mut self, number: u64) -> Option<&mut Line> {
        self.lines.iter_mut().find(|line| line.number == Some(number))
    }

    /// The machine wants a connection.
    pub fn connect(&mut self, frame: u64, link: Link) {
        self.line(link).connecting = Some(frame + 1);
    }

    /// The machine drops a connection.
    pub fn close(&mut self, simulator: &mut Simulator, link: Link) {
        self.line(link).drop_connection(simulator);
    }

    /// The machine's process is gone, and its sockets with it.
    pub fn close_all(&mut self, simulator: &mut Simulator) {
        self.lines.iter_mut().for_each(|line| line.drop_connection(simulator));
        self.master = Master::new(UNIT);
        self.answers.clear();
    }

    /// The machine sends.
    pub fn send(&mut self, frame: u64, link: Link, bytes: Vec<u8>) {
        let (late, cut) = self.by_weather(&bytes);
        self.line(link).queue_for_sim(frame + 1 + late, bytes, cut);
    }

    /// The machine begins a register transaction.
    pub fn transact(&mut self, frame: u64, simulator: &mut Simulator, request: ModbusRequest) {
        self.master.request(time_of(frame), request);
        self.act(frame, simulator);
    }

    /// Does what the gripper's master decides.
    fn act(&mut self, frame: u64, simulator: &mut Simulator) {
        while let Some(action) = self.master.poll_action() {
            match action {
                Action::Connect(number) => {
                    // There are two: the master has one connection, and one attempt, at most.
                    let free = GRIPPER.into_iter().find(|index| self.lines[*index].number.is_none());
                    if let Some(index) = free {
                        let line = &mut self.lines[index];
                        (line.number, line.connecting) = (Some(number), Some(frame + 1));
                    }
                }
                Action::Send(number, bytes) => {
                    let (late, cut) = self.by_weather(&bytes);
                    if let Some(line) = self.gripper(number) {
                        line.queue_for_sim(frame + 1 + late, bytes, cut);
                    }
                }
                Action::Reset(number) => {
                    if let Some(line) = self.gripper(number) {
                        line.drop_connection(simulator);
                    }
                }
            }
        }
        let results = std::iter::from_fn(|| self.master.poll_result());
        self.answers.extend(results.map(Event::Registers));
    }

    /// Frames that bytes are late, and where they are cut.
    fn by_weather(&mut self, bytes: &[u8]) -> (u64, Option<usize>) {
        let late = u64::from(self.rng.random_bool(self.weather.late));
        let cut = bytes.len() > 1 && self.rng.random_bool(self.weather.split);
        (late, cut.then(|| self.rng.random_range(1..bytes.len())))
    }

    /// What reaches either side in this frame.
    pub fn step(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        events.append(&mut self.answers);
        for index in 0..self.lines.len() {
            let line = &mut self.lines[index];
            let ended = line.follow_faults(simulator);
            let made = line.answer_connect(frame, simulator);
            line.deliver_to_sim(frame, simulator);
            for happened in ended.into_iter().chain(made) {
                self.happened(frame, simulator, index, happened, events);
            }
        }
        self.take_transmissions(frame, simulator, events);
        for index in 0..self.lines.len() {
            while let Some(bytes) = self.lines[index].arrived(frame) {
                match (link_of(self.lines[index].port), self.lines[index].number) {
                    (Some(link), _) => events.push(Event::Received(link, bytes)),
                    (None, Some(number)) => self.master.received(time_of(frame), number, &bytes),
                    (None, None) => {}
                }
            }
        }
        self.master.tick(time_of(frame));
        self.act(frame, simulator);
        events.append(&mut self.answers);
    }

    /// Passes it on to the machine, or to the gripper's master.
    fn happened(
        &mut self,
        frame: u64,
        simulator: &mut Simulator,
        index: usize,
        happened: Happened,
        events: &mut Vec<Event>,
    ) {
        let line = &mut self.lines[index];
        if let Some(link) = link_of(line.port) {
            events.push(match happened {
                Happened::Connected => Event::Connected(link),
                Happened::Ended(Ending::Refused) => {
                    Event::Disconnected(link, "connection refused".to_string())
                }
                Happened::Ended(Ending::Closed) => {
                    Event::Disconnected(link, "the controller closed the connection".to_string())
                }
                Happened::Ended(Ending::Other(words)) => Event::Disconnected(link, words),
            });
            return;
        }
        let (now, Some(number)) = (time_of(frame), line.number) else { return };
        match happened {
            Happened::Connected => self.master.connected(now, number),
            Happened::Ended(ending) => {
                line.number = None;
                self.master.closed(now, number, ending);
            }
        }
        self.act(frame, simulator);
    }

    fn take_transmissions(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        while let Some(transmission) = simulator.transmit() {
            let (id, bytes) = match &transmission {
                Transmission::Bytes(id, bytes) => (*id, Some(bytes)),
                Transmission::Closed(id) => (*id, None),
            };
            let late = u64::from(self.rng.random_bool(self.weather.late));
            let split = self.rng.random_bool(self.weather.split);
            let Some(index) = self.lines.iter().position(|line| line.id == Some(id)) else { continue };
            let late = late + self.weather.extra_frames(self.lines[index].port, &mut self.rng);
            let line = &mut self.lines[index];
            let over = match bytes {
                Some(bytes) => !line.queue_for_cell(frame + late, bytes, split),
                None => true,
            };
            if over && let Some(happened) = line.break_off(simulator, Ending::Closed) {
                self.happened(frame, simulator, index, happened, events);
            }
        }
    }
}

impl Line {
    fn drop_connection(&mut self, simulator: &mut Simulator) {
        if let Some(id) = self.id.take() {
            simulator.hang_up(id);
        }
        self.number = None;
        self.connecting = None;
        self.to_sim.clear();
        self.to_cell.clear();
    }

    /// The connection ends, if there is one.
    fn break_off(&mut self, simulator: &mut Simulator, ending: Ending) -> Option<Happened> {
        self.id?;
        let number = self.number;
        self.drop_connection(simulator);
        self.number = number;
        Some(Happened::Ended(ending))
    }

    /// The simulator's faults of this server.
    fn follow_faults(&mut self, simulator: &mut Simulator) -> Option<Happened> {
        if !self.watch.has_changed().unwrap_or(false) {
            return None;
        }
        let state = self.watch.borrow_and_update().clone();
        let reset = state.resets != self.state.resets || (state.down && !self.state.down);
        self.state = state;
        let ending = match self.port {
            Port::Gripper => Ending::Closed,
            _ => Ending::Other("connection reset by peer".to_string()),
        };
        reset.then(|| self.break_off(simulator, ending)).flatten()
    }

    fn answer_connect(&mut self, frame: u64, simulator: &mut Simulator) -> Option<Happened> {
        if self.state.silent || self.connecting.is_none_or(|due| frame < due) {
            return None;
        }
        self.connecting = None;
        self.id = simulator.connect(self.port);
        self.sent = 0;
        Some(match self.id {
            Some(_) => Happened::Connected,
            None => Happened::Ended(Ending::Refused),
        })
    }

    /// Bytes for the simulator, whole or cut in two.
    fn queue_for_sim(&mut self, due: u64, bytes: Vec<u8>, cut: Option<usize>) {
        let due = due.max(self.to_sim.back().map_or(0, |(due, _)| *due));
        match cut {
            Some(at) => {
                self.to_sim.push_back((due, bytes[..at].to_vec()));
                self.to_sim.push_back((due + 1, bytes[at..].to_vec()));
            }
            None => self.to_sim.push_back((due, bytes)),
        }
    }

    fn deliver_to_sim(&mut self, frame: u64, simulator: &mut Simulator) {
        let Some(id) = self.id.filter(|_| !self.state.silent) else { return };
        while let Some((_, bytes)) = pop_due(&mut self.to_sim, frame) {
            simulator.receive(id, &bytes);
        }
    }

    /// Bytes for the cell; false when the connection ends before them.
    fn queue_for_cell(&mut self, due: u64, bytes: &[u8], split: bool) -> bool {
        self.sent += bytes.len() as u64;
        if self.state.limit.is_some_and(|limit| self.sent > limit) {
            return false;
        }
        let delay = (self.state.latency.as_secs_f64() / FRAME_SECONDS).round() as u64;
        let mut due = (due + delay).max(self.to_cell.back().map_or(0, |(due, _)| *due));
        let half = if split { bytes.len().div_ceil(2) } else { bytes.len() };
        for piece in bytes.chunks(self.state.slice.unwrap_or(half).max(1)) {
            self.to_cell.push_back((due, piece.to_vec()));
            due += u64::from(split && self.state.slice.is_none());
        }
        true
    }

    fn arrived(&mut self, frame: u64) -> Option<Vec<u8>> {
        if self.state.silent {
            return None;
        }
        pop_due(&mut self.to_cell, frame).map(|(_, bytes)| bytes)
    }
}

/// The first one, once it is due.
fn pop_due(queue: &mut VecDeque<(u64, Vec<u8>)>, frame: u64) -> Option<(u64, Vec<u8>)> {
    queue.front().filter(|(due, _)| *due <= frame)?;
    queue.pop_front()
}
