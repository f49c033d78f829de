//! The shell around the machine in virtual time: who gives orders, by which way they come, what holds the
//! process up.
//!
//! In: clients that give orders and give up or end, a folder that vanishes, a process that is stopped. Out:
//! the events that the daemon's shell would make of it. What decides is the daemon's own code: `jobs::inbox`
//! reads the folder, `jobs::order_queue` keeps what people order at the page, `jobs::sources` puts stops
//! first, `cell_machine::intake` judges age and reach. What only the real shell has (files, threads, locks,
//! the log) is listed in docs/shell.md and disturbed in `tests/shell`.

mod client;
pub mod folder;

pub use client::{Client, Leaves, Way};

use crate::jobs::command::{Command, file_name};
use crate::jobs::inbox::{Folder, Inbox, Taken, UNANSWERED_MAX, Unreported};
use crate::jobs::order_queue::{OrderQueue, OrderedBy, Waiting};
use crate::jobs::reported::Kind;
use crate::jobs::sources::{Given, Stops, number_of};
use crate::pair::shell::folder::{Fate, Files};
use cell_machine::event::Event;
use cell_machine::intake::{HELD_UP_AFTER, Reach, Unreachable};
use cell_machine::orders::Order;
use cell_values::time::Duration;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_sim::motion::FRAME_SECONDS;

/// The name of this run of the daemon, in commands.
const DAEMON: &str = "pair";

/// The computer has run for so long when the cell is switched on, s.
const BOOTED_S: f64 = 5000.0;

/// Calendar time when the cell is switched on, s since 1970.
const CALENDAR_S: f64 = 1.8e9;

/// Frames in which orders are taken in, of five: every 5 ms.
const TAKES_IN: [bool; 5] = [true, false, true, false, false];

/// Sources of orders: the folder and the page.
const FOLDER: usize = 1;
const PAGE: usize = 2;

/// What became of orders in a frame, for the rules: who gave each is known here, and not in the machine.
#[derive(Clone, Debug)]
pub enum Happened {
    /// A client gave an order.
    Given(usize, Order),
    /// It was handed on under this number.
    HandedOn(u64, Vec<usize>),
    /// It came to nothing before: taken back, or refused on its way.
    Over(usize),
    /// The process goes on after it was stopped for so long.
    HeldUp(Duration),
}

/// What the shell hands to the machine in a frame.
#[derive(Debug, Default)]
pub struct Handed {
    /// Events in their order.
    pub events: Vec<Event>,
    /// For the rules.
    pub happened: Vec<Happened>,
}

/// Where the answer to a number goes.
enum Awaited {
    File(usize, Box<Taken<Arc<AtomicBool>>>),
    Page(Vec<usize>),
}

/// The shell. See the module.
pub struct Shell {
    inbox: Inbox<Files>,
    /// Files that the kernel has reported and that were not looked into yet: stops, and others.
    reported: [BTreeSet<String>; 2],
    /// What the listing has found that was not reported.
    unreported: Unreported,
    page: OrderQueue<usize>,
    stops: Stops,
    reach: Reach,
    /// Frame of the last look into the folder that was possible, and why the last one was not.
    looked: (u64, Option<Unreachable>),
    last: [u32; 3],
    awaited: BTreeMap<u64, Awaited>,
    clients: Vec<Client>,
    /// The process is stopped: since when, until when.
    stopped: Option<(u64, u64)>,
    /// The calendar is off by so much, s.
    calendar_off_s: f64,
    /// How many files clients have left; each name has its number.
    files: u32,
}

impl Default for Shell {
    fn default() -> Shell {
        let (mut inbox, unreported) = (Inbox::of(Files::default(), DAEMON), Unreported::default());
        inbox.leave_to(unreported.clone());
        Shell {
            inbox,
            reported: Default::default(),
            unreported,
            page: OrderQueue::default(),
            stops: Stops::default(),
            reach: Reach::default(),
            looked: (0, None),
            last: [0; 3],
            awaited: BTreeMap::new(),
            clients: Vec::new(),
            stopped: None,
            calendar_off_s: 0.0,
            files: 0,
        }
    }
}

fn seconds(frame: u64) -> f64 {
    frame as f64 * FRAME_SECONDS
}

fn boot_s(frame: u64) -> f64 {
    BOOTED_S + seconds(frame)
}

impl Shell {
    /// A client that gives its order when its time comes.
    pub fn add(&mut self, client: Client) {
        self.clients.push(client);
    }

    /// The clients so far.
    pub fn clients(&self) -> &[Client] {
        &self.clients
    }

    /// What has become of the folder of commands from now on.
    pub fn folder_is(&self, fate: Fate) {
        self.inbox.folder().set_fate(fate);
    }

    /// The folder of commands as it is.
    pub fn folder(&self) -> Fate {
        self.inbox.folder().fate()
    }

    /// The folder is gone, or an order lies in it that cannot be read.
    pub fn is_cut_off(&self) -> bool {
        match self.folder() {
            Fate::Sound => false,
            Fate::Gone => true,
            Fate::Unreadable => self.inbox.folder().has_orders_to_read(),
        }
    }

    /// The process is stopped at this frame, for so many frames.
    pub fn stop(&mut self, frame: u64, frames: u64) {
        let (since, until) = self.stopped.unwrap_or((frame, frame));
        self.stopped = Some((since, until.max(frame + frames)));
    }

    /// The process does nothing in this frame.
    pub fn is_stopped(&self, frame: u64) -> bool {
        self.stopped.is_some_and(|(_, until)| frame < until)
    }

    /// The calendar jumps by so many seconds.
    pub fn calendar_jumps(&mut self, by_s: f64) {
        self.calendar_off_s += by_s;
    }

    /// A script leaves so many files in the folder, each an order whose sender has ended.
    pub fn flood(&mut self, frame: u64, count: u32) {
        for number in 0..count {
            let name = format!("{number:05}-{frame}.command");
            self.leave(frame, name, &Command::Resume, Arc::default());
        }
    }

    /// The daemon is gone and comes back: it clears the folder.
    pub fn restarted(&mut self) {
        let (clients, calendar_off_s) = (std::mem::take(&mut self.clients), self.calendar_off_s);
        *self = Shell { clients, calendar_off_s, files: self.files, ..Shell::default() };
    }

    /// One controller frame of the clients, which are no part of the process.
    pub fn people(&mut self, frame: u64, happened: &mut Vec<Happened>) {
        for index in 0..self.clients.len() {
            if self.clients[index].gives_in(frame) {
                self.give(frame, index, happened);
            }
            self.leaves(frame, index, happened);
        }
    }

    fn give(&mut self, frame: u64, index: usize, happened: &mut Vec<Happened>) {
        let client = &mut self.clients[index];
        let (command, waits) = (client.command.clone(), client.given(frame));
        let Some(order) = command.order() else { return client.done() };
        let there = match client.way.clone() {
            Way::File => {
                self.files += 1;
                let unix_s = CALENDAR_S + seconds(frame) + self.calendar_off_s;
                let name = file_name(unix_s, self.files, 0, order.only_stops());
                client.file = Some(name.clone());
                self.leave(frame, name, &command, waits)
            }
            Way::Page(session) => {
                let by = OrderedBy { name: session.clone(), session };
                let (boot_s, open, answers) = (boot_s(frame), waits, vec![index]);
                self.page.put(Waiting { order: order.clone(), by, boot_s, open, answers }).is_ok()
            }
        };
        if there {
            happened.push(Happened::Given(index, order));
        } else {
            self.clients[index].done();
        }
    }

    fn leave(&self, frame: u64, name: String, command: &Command, waits: Arc<AtomicBool>) -> bool {
        self.inbox.folder().leave(name, command.text(DAEMON, boot_s(frame)), waits)
    }

    /// A client gives up, and takes back what it can; one that is killed takes nothing back.
    fn leaves(&mut self, frame: u64, index: usize, happened: &mut Vec<Happened>) {
        let client = &mut self.clients[index];
        let Some(killed) = client.leaves_in(frame) else { return };
        client.waits().store(false, Ordering::Relaxed);
        let only_stops = client.command.only_stops();
        let taken_back = match &client.file {
            Some(name) if !killed && !only_stops => self.inbox.folder().take_back(name),
            _ => false,
        };
        if taken_back {
            self.clients[index].done();
            happened.push(Happened::Over(index));
        }
    }

    /// One controller frame of the process, unless it is stopped.
    pub fn step(&mut self, frame: u64) -> Handed {
        let mut handed = Handed::default();
        if let Some((since, until)) = self.stopped.take_if(|(_, until)| frame >= *until) {
            let gap = Duration::from_secs_f64(seconds(until - since));
            if gap > HELD_UP_AFTER {
                self.looked.0 = frame;
                handed.events.push(Event::HeldUp(gap));
            }
            handed.happened.push(Happened::HeldUp(gap));
        }
        if TAKES_IN[(frame % 5) as usize] {
            self.take_in(frame, &mut handed);
        }
        let silent = Duration::from_secs_f64(seconds(frame - self.looked.0));
        let fault = self.looked.1.clone().unwrap_or_else(|| Unreachable::Silent("the intake".to_string()));
        handed.events.extend(self.reach.judge(Some((silent, fault))).map(Event::OrdersReach));
        handed
    }

    fn take_in(&mut self, frame: u64, handed: &mut Handed) {
        let [stops, others] = &mut self.reported;
        for name in self.inbox.folder().arrived() {
            if Kind::Stops.has(&name) {
                stops.insert(name)
            } else {
                others.insert(name)
            };
        }
        others.extend(self.unreported.take());
        let room = |inbox: &Inbox<Files>| UNANSWERED_MAX.saturating_sub(inbox.unanswered());
        let mut reported = self.inbox.take_reported_stops(stops);
        reported.extend(self.inbox.take_reported(others, room(&self.inbox), || true));
        let mail = self.inbox.take(room(&self.inbox));
        if mail.fault.is_none() {
            self.looked.0 = frame;
        }
        self.looked.1 = mail.fault;
        let mut given = Vec::new();
        for taken in reported.into_iter().chain(mail.taken) {
            let Some(order) = taken.command.order() else { continue };
            let number = self.number(FOLDER);
            let name = taken.path.file_name().map(|name| name.to_string_lossy().into_owned());
            let client = self.clients.iter().position(|client| client.file == name);
            let lock = taken.lock.clone();
            given.push(Given {
                number,
                order,
                boot_s: taken.boot_s,
                client_waits: Arc::new(move || lock.load(Ordering::Relaxed)),
            });
            let client = client.unwrap_or(usize::MAX);
            self.awaited.insert(number_of(FOLDER, number), Awaited::File(client, Box::new(taken)));
        }
        self.hand_on(frame, FOLDER, given, handed);
        let mut given = Vec::new();
        for Waiting { order, boot_s, open, answers, .. } in self.page.take() {
            let number = self.number(PAGE);
            let client_waits = Arc::new(move || open.load(Ordering::Relaxed));
            given.push(Given { number, order, boot_s, client_waits });
            self.awaited.insert(number_of(PAGE, number), Awaited::Page(answers));
        }
        self.hand_on(frame, PAGE, given, handed);
    }

    fn number(&mut self, source: usize) -> u32 {
        self.last[source] += 1;
        self.last[source]
    }

    fn hand_on(&mut self, frame: u64, source: usize, given: Vec<Given>, handed: &mut Handed) {
        let mut refused = Vec::new();
        let awaited = &self.awaited;
        let send = |given: &Given| {
            let number = number_of(source, given.number);
            let clients = awaited.get(&number).map(Awaited::clients).unwrap_or_default();
            handed.happened.push(Happened::HandedOn(number, clients));
            handed.events.push(Event::Order(number, given.order.clone(), given.origin(boot_s(frame))));
            true
        };
        self.stops.hand_on(given, || boot_s(frame), send, |number, _| refused.push(number));
        for number in refused {
            handed.happened.extend(self.answered(number_of(source, number)).into_iter().map(Happened::Over));
        }
    }

    /// The machine, or the shell itself, has answered; the clients that get the answer.
    pub fn answered(&mut self, number: u64) -> Vec<usize> {
        let Some(awaited) = self.awaited.remove(&number) else { return Vec::new() };
        if let Awaited::File(_, taken) = &awaited
            && let Some(name) = taken.path.file_name()
        {
            let _ = self.inbox.folder().remove(&name.to_string_lossy());
            taken.settle(false);
        }
        let clients = awaited.clients();
        for client in &clients {
            if let Some(client) = self.clients.get_mut(*client) {
                client.done();
            }
        }
        clients
    }
}

impl Awaited {
    fn clients(&self) -> Vec<usize> {
        match self {
            Awaited::File(client, _) => vec![*client],
            Awaited::Page(clients) => clients.clone(),
        }
    }
}
