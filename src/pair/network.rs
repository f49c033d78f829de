//! The network between cell and simulator in virtual time: delays, splits, and what the simulator's faults
//! do to it.
//!
//! In: connect, close and send of the machine, what the simulator transmits, a seed. Out: events of the
//! machine and calls of the simulator, in order on each connection. Times are whole controller frames (2
//! ms). A cut cable is silence in both directions that goes on where it was when the fault ends, as TCP
//! does; a reset ends a connection for both sides.

use crate::pair::modbus::{Answer, Master};
use cell_machine::device::gripper_types::{ModbusFailure, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use tokio::sync::watch;
use ur_sim::faults::link::LinkState;
use ur_sim::motion::FRAME_SECONDS;
use ur_sim::session::Port;
use ur_sim::simulator::{ConnectionId, Simulator, Transmission};

/// Frames after which a register transaction without an answer has failed (1 s).
const ANSWER_WITHIN: u64 = 500;

/// How the network behaves without faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weather {
    /// Share of the packets that are a frame late.
    pub late: f64,
    /// Share of the packets that arrive in two pieces.
    pub split: f64,
}

impl Weather {
    /// A switch between two machines, a little busy.
    pub const LAN: Weather = Weather { late: 0.05, split: 0.02 };
}

struct Line {
    port: Port,
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

/// All connections. See the module.
pub struct Network {
    lines: [Line; 4],
    rng: ChaCha8Rng,
    weather: Weather,
    master: Master,
    /// The transaction under way, and until when it is waited for.
    transaction: Option<(ModbusRequest, u64)>,
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
            id: None,
            connecting: None,
            to_sim: VecDeque::new(),
            to_cell: VecDeque::new(),
            watch: simulator.core().robot.links.get(port.link()).watch(),
            state: simulator.link(port.link()),
            sent: 0,
        };
        Network {
            lines: [Port::Rtde, Port::Dashboard, Port::Primary, Port::Gripper].map(line),
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x6e65_7477),
            weather,
            master: Master::default(),
            transaction: None,
        }
    }

    fn line(&mut self, port: Port) -> &mut Line {
        let [rtde, dashboard, primary, gripper] = &mut self.lines;
        match port {
            Port::Rtde => rtde,
            Port::Dashboard => dashboard,
            Port::Primary | Port::Secondary | Port::Realtime | Port::Interpreter => primary,
            Port::PrimaryReadOnly | Port::SecondaryReadOnly | Port::RealtimeReadOnly => primary,
            Port::Gripper | Port::Robotiq | Port::ToolSerial | Port::Modbus => gripper,
        }
    }

    /// The machine wants a connection.
    pub fn connect(&mut self, frame: u64, link: Link) {
        self.line(port_of(link)).connecting = Some(frame + 1);
    }

    /// The machine drops a connection.
    pub fn close(&mut self, simulator: &mut Simulator, link: Link) {
        self.line(port_of(link)).drop_connection(simulator);
    }

    /// The machine's process is gone, and its sockets with it.
    pub fn close_all(&mut self, simulator: &mut Simulator) {
        self.lines.iter_mut().for_each(|line| line.drop_connection(simulator));
        self.transaction = None;
    }

    /// The machine sends.
    pub fn send(&mut self, frame: u64, link: Link, bytes: Vec<u8>) {
        self.put(frame, port_of(link), bytes);
    }

    /// The machine begins a register transaction.
    pub fn transact(&mut self, frame: u64, simulator: &mut Simulator, request: ModbusRequest) {
        if self.line(Port::Gripper).id.is_none() {
            self.master = Master::default();
            let line = self.line(Port::Gripper);
            line.id = simulator.connect(Port::Gripper);
            line.sent = 0;
        }
        let bytes = self.master.request(&request);
        self.transaction = Some((request, frame + ANSWER_WITHIN));
        self.put(frame, Port::Gripper, bytes);
    }

    /// Queues bytes for the simulator, whole or in two pieces.
    fn put(&mut self, frame: u64, port: Port, bytes: Vec<u8>) {
        let late = u64::from(self.rng.random_bool(self.weather.late));
        let cut = (bytes.len() > 1 && self.rng.random_bool(self.weather.split))
            .then(|| self.rng.random_range(1..bytes.len()));
        let line = self.line(port);
        let due = (frame + 1 + late).max(line.to_sim.back().map_or(0, |(due, _)| *due));
        match cut {
            Some(at) => {
                line.to_sim.push_back((due, bytes[..at].to_vec()));
                line.to_sim.push_back((due + 1, bytes[at..].to_vec()));
            }
            None => line.to_sim.push_back((due, bytes)),
        }
    }

    /// What reaches either side in this frame.
    pub fn step(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        for line in &mut self.lines {
            line.follow_faults(simulator, events);
            line.answer_connect(frame, simulator, events);
            line.deliver_to_sim(frame, simulator);
        }
        self.take_transmissions(frame, simulator, events);
        for index in 0..self.lines.len() {
            while let Some(bytes) = self.lines[index].arrived(frame) {
                match link_of(self.lines[index].port) {
                    Some(link) => events.push(Event::Received(link, bytes)),
                    None => self.take_registers(simulator, &bytes, events),
                }
            }
        }
        self.check_transaction(frame, simulator, events);
    }

    fn take_transmissions(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        while let Some(transmission) = simulator.transmit() {
            let (id, bytes) = match &transmission {
                Transmission::Bytes(id, bytes) => (*id, Some(bytes)),
                Transmission::Closed(id) => (*id, None),
            };
            let late = u64::from(self.rng.random_bool(self.weather.late));
            let split = self.rng.random_bool(self.weather.split);
            let Some(line) = self.lines.iter_mut().find(|line| line.id == Some(id)) else { continue };
            let over = match bytes {
                Some(bytes) => !line.queue_for_cell(frame + late, bytes, split),
                None => true,
            };
            if over {
                line.break_off(simulator, "the controller closed the connection", events);
            }
        }
    }

    fn take_registers(&mut self, simulator: &mut Simulator, bytes: &[u8], events: &mut Vec<Event>) {
        let Some((request, _)) = &self.transaction else { return };
        let answer = match self.master.received(request, bytes) {
            Answer::Incomplete => return,
            Answer::Words(words) => Ok(words),
            Answer::Exception(code) => Err(ModbusFailure::Exception(code)),
            Answer::Wrong(why) => Err(ModbusFailure::Malformed(why)),
        };
        self.finish_transaction(simulator, answer, events);
    }

    fn check_transaction(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        let Some((_, deadline)) = &self.transaction else { return };
        let gone = self.lines[3].id.is_none();
        if gone {
            let failure = ModbusFailure::Connection("connection refused or reset".to_string());
            self.finish_transaction(simulator, Err(failure), events);
        } else if frame >= *deadline {
            self.finish_transaction(simulator, Err(ModbusFailure::Timeout), events);
        }
    }

    fn finish_transaction(
        &mut self,
        simulator: &mut Simulator,
        answer: Result<Vec<u16>, ModbusFailure>,
        events: &mut Vec<Event>,
    ) {
        self.transaction = None;
        // After a failure the answer to an old request could be taken for that to a new one.
        if answer.is_err() {
            self.lines[3].drop_connection(simulator);
        }
        events.push(Event::Registers(answer));
    }
}

impl Line {
    fn drop_connection(&mut self, simulator: &mut Simulator) {
        if let Some(id) = self.id.take() {
            simulator.hang_up(id);
        }
        self.connecting = None;
        self.to_sim.clear();
        self.to_cell.clear();
    }

    fn break_off(&mut self, simulator: &mut Simulator, reason: &str, events: &mut Vec<Event>) {
        if self.id.is_some() {
            self.drop_connection(simulator);
            events.extend(link_of(self.port).map(|link| Event::Disconnected(link, reason.to_string())));
        }
    }

    /// The simulator's faults of this server.
    fn follow_faults(&mut self, simulator: &mut Simulator, events: &mut Vec<Event>) {
        if !self.watch.has_changed().unwrap_or(false) {
            return;
        }
        let state = self.watch.borrow_and_update().clone();
        let reset = state.resets != self.state.resets || (state.down && !self.state.down);
        self.state = state;
        if reset {
            self.break_off(simulator, "connection reset by peer", events);
        }
    }

    fn answer_connect(&mut self, frame: u64, simulator: &mut Simulator, events: &mut Vec<Event>) {
        if self.state.silent || self.connecting.is_none_or(|due| frame < due) {
            return;
        }
        self.connecting = None;
        let Some(link) = link_of(self.port) else { return };
        self.id = simulator.connect(self.port);
        self.sent = 0;
        events.push(match self.id {
            Some(_) => Event::Connected(link),
            None => Event::Disconnected(link, "connection refused".to_string()),
        });
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
