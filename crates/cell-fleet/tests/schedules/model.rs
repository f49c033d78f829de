//! A fleet in virtual time: a server as JetStream is, cells as processes with a disk each, and the network
//! between them, all by one seed.
//!
//! In: a seed and how much of each trouble. Out: what each cell carried out, and the claims at the end.
//! Requests of one connection arrive in order, and late; a connection that ends loses answers, not
//! necessarily requests; a process that ends loses everything but its disk.

mod disturbances;
mod served;

use cell_fleet::agent::Agent;
use cell_fleet::payloads::{CellState, Claim, ClaimState, Outcome, VERSION, Wish};
use cell_fleet::subjects::{Fleet, Key};
use cell_fleet::values::{At, Effect, Entry, Input, Kept, Local, Settle, Unread, Who, Written};
use cell_fleet::world::Settings;
use cell_values::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};

pub const ACK_WAIT_MS: u64 = 30_000;
const TIMEOUT_MS: u64 = 5_000;

#[derive(Clone, Debug)]
enum Request {
    Pull(bool),
    Settle(u64, Settle),
    Read(String),
    Write { who: Who, claim: Box<Claim>, over: Option<u64> },
    Publish(Box<Claim>),
    Refuse { job: String, refusal: Option<(u32, String)> },
    Remove(Key),
    Follow(bool),
    Watch(Option<String>),
    List,
    State(Box<CellState>),
}

#[derive(Clone, Debug)]
enum SimEvent {
    /// A request reaches the server over this connection of a cell.
    Arrives {
        cell: usize,
        connection: u64,
        request: Request,
    },
    /// Something reaches a cell's agent, if the process is still that one.
    Received {
        cell: usize,
        process: u64,
        connection: Option<u64>,
        input: Input,
    },
    /// The agent of a cell wanted to be called.
    Wake {
        cell: usize,
        process: u64,
    },
    /// The state of a cell is written.
    State {
        cell: usize,
        process: u64,
    },
    /// The spool takes a job in; it begins; it ends.
    Taken {
        cell: usize,
        job: String,
    },
    Over {
        cell: usize,
        job: String,
    },
    /// The disk has an entry.
    OnDisk {
        cell: usize,
        process: u64,
        entry: Box<Entry>,
    },
    /// Troubles and what ends them.
    Crash(usize),
    Start(usize),
    Cut(usize),
    Join(usize),
    ServerDown,
    ServerUp,
    Arm(usize, bool),
    Submit(usize),
    Wished(Key, Wish),
    /// Messages that were not settled in time, or are due, go out.
    Deliver,
}

struct Message {
    sequence: u64,
    subject: String,
    payload: Vec<u8>,
    due: u64,
    delivered: u64,
}

pub struct Cell {
    name: String,
    labels: Vec<String>,
    agent: Option<Agent>,
    process: u64,
    connection: Option<u64>,
    pub disk: BTreeMap<String, Entry>,
    /// Jobs that the journal has, with their end.
    journal: BTreeMap<String, Option<Outcome>>,
    armed: bool,
    pub dead: bool,
    /// Last arrival of a request over the present connection, ms.
    sent: u64,
    heard: u64,
    pulls: bool,
    follows: bool,
    watches: Option<String>,
    /// When the process is called next.
    wakes: (u64, u64),
}

/// How much of each trouble, and of what.
#[derive(Clone, Copy)]
pub struct Plan {
    pub cells: usize,
    pub jobs: usize,
    pub crashes: usize,
    pub server_crashes: usize,
    pub cuts: usize,
    pub disarms: usize,
    pub cancels: usize,
    pub dead: usize,
}

pub struct World {
    rng: ChaCha8Rng,
    fleet: Fleet,
    now: u64,
    next: u64,
    queue: BTreeMap<(u64, u64), SimEvent>,
    pub cells: Vec<Cell>,
    up: bool,
    counter: u64,
    messages: BTreeMap<u64, Message>,
    seen: BTreeSet<String>,
    pub claims: BTreeMap<String, (Claim, u64, u64)>,
    refusals: BTreeMap<(String, String), (u32, String)>,
    wishes: BTreeMap<Key, Wish>,
    states: BTreeMap<String, (CellState, u64)>,
    plan: Plan,
    /// Each time an arm set out for a job: cell, job, epoch.
    pub carried_out: Vec<(usize, String, u32)>,
    /// Each time a claim was set to begun: job, epoch, cell.
    pub begun: Vec<(String, u32, String)>,
    pub given: BTreeSet<String>,
    pub trace: Vec<String>,
    pub wants_trace: bool,
}

/// Who can do which job: the last but one digit of the number says so.
fn can_do(cell: usize, job: &str) -> Result<(), String> {
    let number: usize = job.trim_start_matches("job-").parse().unwrap_or(0);
    match number % 10 {
        3 if cell != 1 => Err("only cell 1 has the object".to_string()),
        7 => Err("no cell has the object".to_string()),
        _ => Ok(()),
    }
}

pub fn is_impossible(job: &str) -> bool {
    (0..64).all(|cell| can_do(cell, job).is_err())
}

impl World {
    pub fn new(seed: u64, plan: Plan) -> World {
        let cell = |index: usize| Cell {
            name: format!("c{index}"),
            labels: if index.is_multiple_of(2) { vec!["even".to_string()] } else { Vec::new() },
            agent: None,
            process: 0,
            connection: None,
            disk: BTreeMap::new(),
            journal: BTreeMap::new(),
            armed: true,
            dead: false,
            sent: 0,
            heard: 0,
            pulls: false,
            follows: false,
            watches: None,
            wakes: (0, 0),
        };
        let mut world = World {
            rng: ChaCha8Rng::seed_from_u64(seed),
            fleet: Fleet::new("test").expect("a name"),
            now: 1,
            next: 0,
            queue: BTreeMap::new(),
            cells: (0..plan.cells).map(cell).collect(),
            up: true,
            counter: 0,
            messages: BTreeMap::new(),
            seen: BTreeSet::new(),
            claims: BTreeMap::new(),
            refusals: BTreeMap::new(),
            wishes: BTreeMap::new(),
            states: BTreeMap::new(),
            plan,
            carried_out: Vec::new(),
            begun: Vec::new(),
            given: BTreeSet::new(),
            trace: Vec::new(),
            wants_trace: std::env::var_os("CELLD_FLEET_TRACE").is_some(),
        };
        world.schedule();
        world
    }

    fn at(&mut self, ms: u64, event: SimEvent) {
        self.next += 1;
        self.queue.insert((ms.max(self.now), self.next), event);
    }

    fn between(&mut self, low: u64, high: u64) -> u64 {
        self.rng.random_range(low..=high)
    }

    /// Runs so long, and then, with all cells that live joined and armed, until nothing is open.
    pub fn run(&mut self) {
        self.run_until(600_000);
        for cell in 0..self.cells.len() {
            if self.cells[cell].agent.is_none() {
                // Started again, but for those that never come back.
                let started = self.queue.values().any(|h| matches!(h, SimEvent::Start(c) if *c == cell));
                self.cells[cell].dead = !started;
            }
        }
        self.run_until(900_000);
        let cells = self.cells.len();
        (0..cells).for_each(|cell| self.happen(SimEvent::Arm(cell, true)));
        for _ in 0..60 {
            if self.open().is_empty() {
                break;
            }
            self.give_stranded();
            let until = self.now + 60_000;
            self.run_until(until);
        }
    }

    /// Jobs that have not come to an end.
    pub fn open(&self) -> Vec<String> {
        let ended = |state: ClaimState| {
            matches!(state, ClaimState::Ended | ClaimState::Aside | ClaimState::Cancelled)
        };
        let is_open = |job: &String| self.claims.get(job).is_none_or(|(claim, ..)| !ended(claim.state));
        (0..self.plan.jobs).map(|job| format!("job-{job}")).filter(is_open).collect()
    }

    fn run_until(&mut self, until: u64) {
        while let Some(entry) = self.queue.first_entry() {
            let (ms, _) = *entry.key();
            if ms > until {
                break;
            }
            let event = entry.remove();
            self.now = ms;
            self.happen(event);
        }
        self.now = until;
    }

    fn happen(&mut self, event: SimEvent) {
        match event {
            SimEvent::Arrives { cell, connection, request } => self.arrives(cell, connection, request),
            SimEvent::Received { cell, process, connection, input } => {
                let here = self.cells[cell].process == process;
                if here && connection.is_none_or(|c| self.cells[cell].connection == Some(c)) {
                    self.take_in(cell, input);
                } else if here && let Some(lost) = lost(&input) {
                    self.take_in(cell, lost);
                }
            }
            SimEvent::Wake { cell, process } if self.cells[cell].process == process => {
                self.take_in(cell, Input::Time);
            }
            SimEvent::State { cell, process } if self.cells[cell].process == process => self.state(cell),
            SimEvent::Taken { cell, job } => self.taken(cell, job),
            SimEvent::Over { cell, job } => {
                // A cell that is down, or is disarmed, does not work.
                if self.cells[cell].agent.is_none() || !self.cells[cell].armed {
                    let again = self.now + 1000;
                    self.at(again, SimEvent::Over { cell, job });
                } else if let Some(end) = self.cells[cell].journal.get_mut(&job) {
                    *end = Some(Outcome { status: "done".into(), moves: 3, ..Outcome::default() });
                }
            }
            SimEvent::OnDisk { cell, process, entry } => {
                let here = self.cells[cell].process == process;
                // What was on its way to the disk when the process ended may be there or not.
                if here || self.rng.random_bool(0.5) {
                    self.keep(cell, &entry);
                }
                if here {
                    self.take_in(cell, Input::Kept { job: entry.job.id, on_disk: true });
                }
            }
            SimEvent::Submit(job) => self.submit(job),
            SimEvent::Wished(key, wish) => {
                self.wishes.insert(key.clone(), wish.clone());
                self.broadcast(&Input::Wish { key, wish: Some(wish) });
            }
            SimEvent::Deliver => {
                self.deliver();
                let again = self.now + 1000;
                self.at(again, SimEvent::Deliver);
            }
            disturbance => self.disturbance(disturbance),
        }
    }

    fn start(&mut self, cell: usize) {
        let (name, labels) = (self.cells[cell].name.clone(), self.cells[cell].labels.clone());
        let entries = self.cells[cell].disk.values().cloned().collect();
        self.cells[cell].agent = Some(Agent::new(self.fleet.clone(), Settings::new(&name, &labels), entries));
        self.cells[cell].process += 1;
        let process = self.cells[cell].process;
        let now = self.now;
        self.at(now, SimEvent::State { cell, process });
        self.connect(cell);
        self.take_in(cell, Input::Time);
    }

    fn connect(&mut self, cell: usize) {
        let here = &mut self.cells[cell];
        if !self.up || here.agent.is_none() || here.connection.is_some() {
            return;
        }
        self.counter += 1;
        (here.connection, here.sent, here.heard) = (Some(self.counter), self.now, self.now);
        (here.pulls, here.follows, here.watches) = (false, false, None);
        self.receives(cell, Input::Connected);
        for (key, wish) in self.wishes.clone() {
            self.receives(cell, Input::Wish { key, wish: Some(wish) });
        }
        for ((job, from), refusal) in self.refusals.clone() {
            self.receives(cell, Input::Refused { job, cell: from, refusal: Some(refusal) });
        }
        if self.cells[cell].follows {
            self.follow(cell);
        }
    }

    fn disconnect(&mut self, cell: usize) {
        if self.cells[cell].connection.take().is_some() {
            (self.cells[cell].pulls, self.cells[cell].follows) = (false, false);
            self.cells[cell].watches = None;
            if self.cells[cell].agent.is_some() {
                self.take_in(cell, Input::Disconnected);
            }
        }
    }

    /// Something goes to a cell over its connection, after all that went before.
    fn receives(&mut self, cell: usize, input: Input) {
        let delay = self.between(0, 40);
        let here = &mut self.cells[cell];
        here.heard = here.heard.max(self.now + delay);
        let (ms, process, connection) = (here.heard, here.process, here.connection);
        self.at(ms, SimEvent::Received { cell, process, connection, input });
    }

    fn broadcast(&mut self, input: &Input) {
        for cell in 0..self.cells.len() {
            if self.cells[cell].connection.is_some() {
                self.receives(cell, input.clone());
            }
        }
    }

    fn state(&mut self, cell: usize) {
        let (process, ready) = (self.cells[cell].process, self.is_ready(cell));
        let again = self.now + 5000;
        self.at(again, SimEvent::State { cell, process });
        if self.cells[cell].agent.is_none() {
            return;
        }
        self.take_in(cell, Input::Ready(ready));
        let here = &self.cells[cell];
        let holds = here.agent.as_ref().map(Agent::holds).unwrap_or_default();
        let state =
            CellState { version: VERSION, labels: here.labels.clone(), holds, ..CellState::default() };
        self.send(cell, Request::State(Box::new(state)));
    }

    fn is_ready(&self, cell: usize) -> bool {
        self.cells[cell].armed && self.cells[cell].journal.values().all(Option::is_some)
    }

    fn take_in(&mut self, cell: usize, input: Input) {
        let at = At { now: Timestamp::from_nanos(self.now * 1_000_000), unix_s: self.now as f64 / 1e3 };
        let Some(agent) = &mut self.cells[cell].agent else { return };
        agent.handle(at, input);
        let mut effects = Vec::new();
        while let Some(effect) = agent.poll() {
            effects.push(effect);
        }
        let wake = (agent.next_wake().nanos() / 1_000_000 + 1).max(self.now + 1);
        let (process, wake) = (self.cells[cell].process, wake.min(self.now + 5000));
        // One call is on its way at a time, the earliest.
        if self.cells[cell].wakes.0 != process
            || self.cells[cell].wakes.1 <= self.now
            || wake < self.cells[cell].wakes.1
        {
            self.cells[cell].wakes = (process, wake);
            self.at(wake, SimEvent::Wake { cell, process });
        }
        effects.into_iter().for_each(|effect| self.carry_out(cell, effect));
    }

    fn carry_out(&mut self, cell: usize, effect: Effect) {
        if self.wants_trace {
            self.trace.push(format!("{:>8} {} {effect:?}", self.now, self.cells[cell].name));
        }
        let process = self.cells[cell].process;
        let soon = self.now + self.between(1, 30);
        let mut locally = |input| {
            self.at(soon, SimEvent::Received { cell, process, connection: None, input });
        };
        match effect {
            Effect::Judge(job) => locally(Input::Judged { verdict: can_do(cell, &job.id), job: job.id }),
            Effect::Keep(entry) => self.at(soon, SimEvent::OnDisk { cell, process, entry }),
            Effect::HandIn(job) => {
                locally(Input::HandedIn { job: job.id.clone(), result: Ok(()) });
                let taken = soon + self.between(1, 900);
                self.at(taken, SimEvent::Taken { cell, job: job.id });
            }
            Effect::Look(job) => {
                let state = match self.cells[cell].journal.get(&job) {
                    None => Local::Unknown,
                    Some(None) => Local::Open,
                    Some(Some(outcome)) => Local::Ended(outcome.clone()),
                };
                let input = Input::Local { job, state };
                self.at(soon, SimEvent::Received { cell, process, connection: None, input });
            }
            Effect::Cancel { job, .. } => {
                if let Some(end @ None) = self.cells[cell].journal.get_mut(&job) {
                    *end = Some(Outcome { status: "cancelled".into(), ..Outcome::default() });
                }
            }
            Effect::Report { .. } => {}
            Effect::Pull(on) => self.send(cell, Request::Pull(on)),
            Effect::Settle(token, how) => self.send(cell, Request::Settle(token, how)),
            Effect::Read(job) => self.send(cell, Request::Read(job)),
            Effect::Write { who, claim, over } => self.send(cell, Request::Write { who, claim, over }),
            Effect::Publish(claim) => self.send(cell, Request::Publish(claim)),
            Effect::Refuse { job, refusal } => self.send(cell, Request::Refuse { job, refusal }),
            Effect::Remove(key) => self.send(cell, Request::Remove(key)),
            Effect::Follow(on) => self.send(cell, Request::Follow(on)),
            Effect::Watch(name) => self.send(cell, Request::Watch(name)),
            Effect::List => self.send(cell, Request::List),
        }
    }

    fn keep(&mut self, cell: usize, entry: &Entry) {
        let job = entry.job.id.clone();
        if entry.kept == Kept::Closed && !entry.begun_here {
            self.cells[cell].disk.remove(&job);
        } else {
            self.cells[cell].disk.insert(job, entry.clone());
        }
    }

    /// The spool takes a file in: a job that the journal knows is refused as known.
    fn taken(&mut self, cell: usize, job: String) {
        if self.cells[cell].dead || self.cells[cell].journal.contains_key(&job) {
            return;
        }
        self.cells[cell].journal.insert(job.clone(), None);
        let epoch = self.cells[cell].disk.get(&job).map_or(0, |entry| entry.job.epoch);
        self.carried_out.push((cell, job.clone(), epoch));
        let over = self.now + self.between(500, 20_000);
        self.at(over, SimEvent::Over { cell, job });
    }
}

/// What an answer becomes whose connection ended before it came.
fn lost(input: &Input) -> Option<Input> {
    match input {
        Input::Read { job, .. } => Some(Input::Read { job: job.clone(), found: Err(Unread::Unanswered) }),
        Input::Written { who, job, .. } => {
            Some(Input::Written { who: *who, job: job.clone(), outcome: Written::Unknown })
        }
        Input::Published { job, .. } => Some(Input::Published { job: job.clone(), stored: false }),
        Input::Cells(_) => Some(Input::Cells(None)),
        _ => None,
    }
}
