//! A cell's part in the fleet, from start to end: agent, database, connection, and what the cell says.
//!
//! In: [`Settings`], the cell behind [`CellSide`], a flag that ends it. Out: jobs in the cell's spool,
//! states and events on the server. It runs on a thread of its own and talks to the daemon through what
//! exists: a dead network or a slow disk keep this thread waiting and no other.

use crate::agent::Agent;
use crate::files::{self, FileKind};
use crate::fragments::Shelf;
use crate::link::{Link, keep_linked};
use crate::network::{Network, News};
use crate::payloads::{Answer, CellState, Request, VERSION, What, decode, sentence};
use crate::pull::pull;
use crate::side::{CellEvent, CellSide, FragmentState, Settings};
use crate::store::Store;
use crate::subjects::RequestKind;
use crate::values::{At, Effect, Entry, Input, Settle, Token, ahead_s};
use crate::watches::Followed;
use crate::world;
use async_nats::{Message, Subject, Subscriber, jetstream};
use cell_values::time::Timestamp;
use futures_util::StreamExt;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc, watch};
use tokio::task::JoinHandle;

/// What the cell says is looked at so often.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A state that does not change is shown again after so long; one that does, not more often than this.
const STATE_EVERY: Duration = Duration::from_secs(5);
const STATE_SOONEST: Duration = Duration::from_millis(500);

/// A database that cannot be used is tried again after so long.
const OPEN_AGAIN: Duration = Duration::from_secs(2);

/// Events on their way at once.
const EVENTS_AT_ONCE: u32 = 64;

/// A clock that is off by more is a complaint.
const CLOCK_OFF_S: f64 = 60.0;

/// The own database and what is in it, opened again and again until `stop`: a full disk may get room.
async fn opened(
    settings: &Settings,
    cell: &mut dyn CellSide,
    stop: &AtomicBool,
) -> Option<(Store, Vec<Entry>)> {
    let mut said = String::new();
    while !stop.load(Ordering::Relaxed) {
        let store = Store::open(&settings.database, &settings.cell, &settings.series, settings.limits);
        let fault = match store.and_then(|store| store.entries().map(|entries| (store, entries))) {
            Ok(found) => return Some(found),
            Err(fault) => format!("the cell takes no part in the fleet: {fault}"),
        };
        if fault != said {
            cell.complaints(std::slice::from_ref(&fault));
            said = fault;
        }
        tokio::time::sleep(OPEN_AGAIN).await;
    }
    None
}

/// Works until `stop`.
pub async fn run(settings: Settings, mut cell: Box<dyn CellSide>, stop: Arc<AtomicBool>) {
    let Some((store, entries)) = opened(&settings, cell.as_mut(), &stop).await else { return };
    let agent_settings = world::Settings::new(&settings.cell, &settings.labels);
    let agent = Agent::new(settings.fleet.clone(), agent_settings.clone(), entries);
    let (news_sender, news) = mpsc::unbounded_channel();
    let (found_sender, found) = mpsc::unbounded_channel();
    let (link_sender, link) = mpsc::unbounded_channel();
    let ack_wait = agent_settings.ack_wait;
    let linking = tokio::spawn(keep_linked(settings.clone(), ack_wait, link_sender));
    let began = Instant::now();
    let mut shell = Shell {
        settings,
        agent,
        store,
        cell,
        began,
        ahead_s: 0.0,
        network: None,
        tasks: Vec::new(),
        followed: Followed::default(),
        wanted: watch::channel(0).0,
        news_sender,
        found_sender,
        messages: BTreeMap::new(),
        last_token: 0,
        requests: None,
        shelf: Shelf::default(),
        shelf_known: false,
        sending: Arc::new(Semaphore::new(1)),
        delivering: false,
        shown: CellState::default(),
        shown_at: None,
        faults: BTreeMap::new(),
        said: Vec::new(),
    };
    shell.turn(news, found, link, &stop).await;
    linking.abort();
    shell.drop_tasks();
}

struct Shell {
    settings: Settings,
    agent: Agent,
    store: Store,
    cell: Box<dyn CellSide>,
    began: Instant,
    /// How far the own clock is ahead of the server's, s.
    ahead_s: f64,
    network: Option<Network>,
    tasks: Vec<JoinHandle<()>>,
    followed: Followed,
    /// Odd: a job is wanted.
    wanted: watch::Sender<u64>,
    news_sender: mpsc::UnboundedSender<News>,
    found_sender: mpsc::UnboundedSender<Message>,
    messages: BTreeMap<Token, jetstream::Message>,
    last_token: Token,
    requests: Option<Subscriber>,
    shelf: Shelf,
    /// All fragments that there were have come.
    shelf_known: bool,
    /// A place for one request for files.
    sending: Arc<Semaphore>,
    delivering: bool,
    shown: CellState,
    shown_at: Option<Instant>,
    /// What is wrong, by what it is about.
    faults: BTreeMap<&'static str, String>,
    said: Vec<String>,
}

fn unix_now_s() -> f64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0.0, |since| since.as_secs_f64())
}

/// The next request of a person; never, while there is no connection.
async fn next_request(requests: &mut Option<Subscriber>) -> Option<Message> {
    match requests {
        Some(requests) => requests.next().await,
        None => std::future::pending().await,
    }
}

impl Shell {
    async fn turn(
        &mut self,
        mut news: mpsc::UnboundedReceiver<News>,
        mut found: mpsc::UnboundedReceiver<Message>,
        mut link: mpsc::UnboundedReceiver<Link>,
        stop: &AtomicBool,
    ) {
        let mut looks = tokio::time::interval(LOOK_EVERY);
        looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        self.handle(Input::Time);
        while !stop.load(Ordering::Relaxed) {
            let wake = self.agent.next_wake().nanos().saturating_sub(self.now().nanos());
            let wake = Duration::from_nanos(wake).max(Duration::from_millis(1));
            tokio::select! {
                Some(news) = news.recv() => self.news(news),
                Some(message) = found.recv() => self.found(message),
                Some(link) = link.recv() => self.link(link).await,
                request = next_request(&mut self.requests) => match request {
                    Some(message) => self.request(message),
                    None => self.requests = None,
                },
                _ = looks.tick() => self.look(),
                () = tokio::time::sleep(wake) => self.handle(Input::Time),
            }
        }
    }

    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    /// By the server's clock, as far as it is known.
    fn unix_s(&self) -> f64 {
        unix_now_s() - self.ahead_s
    }

    fn handle(&mut self, input: Input) {
        let at = At { now: self.now(), unix_s: self.unix_s() };
        self.agent.handle(at, input);
        while let Some(effect) = self.agent.poll() {
            let mut answers = Vec::new();
            self.carry_out(effect, &mut answers);
            for input in answers {
                self.agent.handle(At { now: self.now(), unix_s: self.unix_s() }, input);
            }
        }
    }

    /// Carries an effect out; what is answered at once is in `answers`.
    fn carry_out(&mut self, effect: Effect, answers: &mut Vec<Input>) {
        match effect {
            Effect::Judge(job) => {
                answers.push(Input::Judged { verdict: self.cell.judge(&job), job: job.id });
            }
            Effect::Keep(entry) => {
                let kept = self.store.keep(&entry, unix_now_s());
                self.complain("database", kept.as_ref().err().map(ToString::to_string));
                answers.push(Input::Kept { job: entry.job.id, on_disk: kept.is_ok() });
            }
            Effect::HandIn(job) => {
                let result = self.cell.hand_in(&job);
                self.complain("spool", result.as_ref().err().cloned());
                answers.push(Input::HandedIn { job: job.id, result });
            }
            Effect::Look(job) => match self.cell.look(&job) {
                Ok(state) => answers.push(Input::Local { job, state }),
                Err(message) => self.complain("journal", Some(message)),
            },
            Effect::Cancel { job, by } => drop(self.cell.order(RequestKind::Cancel, &job, None, &by)),
            Effect::Report { job, what } => self.note(job, what, unix_now_s()),
            Effect::Pull(on) => self.wanted.send_modify(|wanted| {
                // From even to odd and back, and on to the next odd number for the next job.
                *wanted += if on == (*wanted % 2 == 1) { 2 } else { 1 };
            }),
            of_network => self.over_network(of_network, answers),
        }
    }

    fn over_network(&mut self, effect: Effect, answers: &mut Vec<Input>) {
        let Some(network) = &self.network else {
            answers.extend(effect.unanswered());
            return;
        };
        match effect {
            Effect::Settle(token, how) => {
                if let Some(message) = self.messages.get(&token) {
                    network.settle(message, &how);
                }
                if how != Settle::Progress {
                    self.messages.remove(&token);
                }
            }
            Effect::Read(job) => network.read(job),
            Effect::Write { who, claim, over } => network.write(who, claim, over),
            Effect::Publish(claim) => network.publish(&claim),
            Effect::Refuse { job, refusal } => network.refuse(job, refusal, unix_now_s()),
            Effect::Remove(key) => network.remove(key),
            // Whose watch was refused may not be followed any more: a new one complains anew.
            Effect::Follow(on) => {
                self.followed.all(network, on).into_iter().for_each(|over| self.complain(over, None));
            }
            Effect::Watch(cell) => {
                let over = self.followed.one(network, cell);
                self.complain(over, None);
            }
            Effect::List => network.list(),
            _ => {}
        }
    }

    fn note(&mut self, job: Option<String>, what: What, unix_s: f64) {
        let noted = self.store.record(job, what, unix_s);
        self.complain("database", noted.err().map(|error| error.to_string()));
    }

    fn complain(&mut self, about: &'static str, message: Option<String>) {
        match message.filter(|message| !message.is_empty()) {
            Some(message) => self.faults.insert(about, message),
            None => self.faults.remove(about),
        };
    }

    fn news(&mut self, news: News) {
        match news {
            News::Input(input) => self.handle(input),
            News::Echo { stored_unix_s, sent_unix_s } => self.echo(stored_unix_s, sent_unix_s),
            News::Delivered(number) => {
                let noted = self.store.delivered(number);
                self.complain("database", noted.err().map(|error| error.to_string()));
            }
            News::DeliveryOver(fault) => {
                self.delivering = false;
                self.complain("events", fault);
            }
            News::Happened(job, what) => self.note(Some(job), what, unix_now_s()),
            News::Fragment(published) => self.shelf.put(*published),
            News::FragmentsKnown => self.shelf_known = true,
            News::Complaint(about, message) => self.complain(about, Some(message)),
        }
    }

    /// The own state came back with the server's time.
    fn echo(&mut self, stored_unix_s: f64, sent_unix_s: f64) {
        // Of an earlier state, perhaps of an earlier process, nothing is learnt.
        if (sent_unix_s - self.shown.unix_s).abs() > 1e-6 {
            return;
        }
        self.ahead_s = ahead_s(self.ahead_s, sent_unix_s, stored_unix_s, unix_now_s());
        let off = self.ahead_s.abs() > CLOCK_OFF_S;
        let side = if self.ahead_s > 0.0 { "ahead of" } else { "behind" };
        self.complain("clock", off.then(|| {
            format!(
                "the clock of this computer is {:.0} s {side} the fleet's; set it (timedatectl). Until then times \
                 of the fleet count by the server's clock",
                self.ahead_s.abs()
            )
        }));
    }

    fn found(&mut self, message: Message) {
        let Some(network) = &self.network else { return };
        let message = jetstream::Message { context: network.context(), message };
        let Ok(info) = message.info() else { return };
        let (sequence, delivered) = (info.stream_sequence, u64::try_from(info.delivered).unwrap_or(1));
        self.last_token += 1;
        let token = self.last_token;
        let (subject, payload) = (message.message.subject.to_string(), message.message.payload.to_vec());
        self.messages.insert(token, message);
        self.handle(Input::Pulled { token, subject, sequence, delivered, payload });
    }

    async fn link(&mut self, link: Link) {
        match link {
            Link::Fault(message) => self.complain("server", Some(message)),
            Link::Down => {
                let message = "the connection to the NATS server is gone; the cell works on alone, and what \
                               happens is kept until it is back";
                self.complain("server", Some(message.to_string()));
                self.drop_tasks();
                self.network = None;
                self.handle(Input::Disconnected);
            }
            Link::Up(ready) => {
                self.drop_tasks();
                self.faults.clear();
                // Of another server, perhaps, or one that has lost its disk: numbers begin anew there.
                (self.shelf, self.shelf_known) = (Shelf::default(), false);
                let (client, server, consumers) = *ready;
                let (fleet, cell) = (self.settings.fleet.clone(), self.settings.cell.clone());
                self.requests = client.subscribe(fleet.requests_of(&cell)).await.ok();
                let network = Network::new(fleet, cell, server, self.news_sender.clone());
                self.tasks.extend(network.watch());
                self.wanted = watch::channel(0).0;
                let pulls = pull(client, consumers, self.wanted.subscribe(), self.found_sender.clone());
                self.tasks.push(tokio::spawn(pulls));
                self.network = Some(network);
                (self.delivering, self.shown_at) = (false, None);
                self.handle(Input::Disconnected);
                self.handle(Input::Connected);
                self.look();
            }
        }
    }

    fn drop_tasks(&mut self) {
        self.tasks.drain(..).for_each(|task| task.abort());
        self.followed = Followed::default();
        self.messages.clear();
        self.requests = None;
    }

    /// A person requests something of the cell.
    fn request(&mut self, message: Message) {
        let (Some(reply), Some(network)) = (message.reply.clone(), self.network.clone()) else { return };
        let read = self.settings.fleet.read_request(&message.subject, &self.settings.cell);
        let read = read.map_err(|fault| fault.to_string()).and_then(|(requested, by)| {
            let request: Request = decode(&message.payload).map_err(|fault| fault.to_string())?;
            if requested == RequestKind::Approve && request.plan.is_none() {
                return Err("not approved: the request names no plan by its number".to_string());
            }
            Ok((requested, by, request))
        });
        match read {
            Err(fault) => network.reply(reply, &answer(false, fault)),
            Ok((RequestKind::Send, _, Request { job, files, .. })) => self.send(network, reply, job, &files),
            Ok((requested, by, Request { job, plan, .. })) => {
                let ordered = self.cell.order(requested, &job, plan, &by);
                let news = self.news_sender.clone();
                tokio::spawn(async move {
                    let gone = (false, "celld is ending; nothing is known of the order".to_string());
                    let (accepted, text) = ordered.await.unwrap_or(gone);
                    network.reply(reply, &answer(accepted, text));
                    if accepted && requested != RequestKind::Cancel {
                        let what = What::Approved { by, agreed: requested == RequestKind::Approve };
                        let _ = news.send(News::Happened(job, what));
                    }
                });
            }
        }
    }

    /// A person wants files: found and sent on a thread of their own, one request at a time.
    fn send(&mut self, network: Network, reply: Subject, job: String, kinds: &[String]) {
        // Each once, however often it is named.
        let kinds: BTreeSet<FileKind> = kinds.iter().filter_map(|word| FileKind::of(word)).collect();
        let kinds: Vec<FileKind> = kinds.into_iter().collect();
        if kinds.is_empty() {
            return network
                .reply(reply, &answer(false, "no kind of file that this celld knows is named".into()));
        }
        let Ok(place) = self.sending.clone().try_acquire_owned() else {
            let busy = "files of another request are being sent; try again in a minute";
            return network.reply(reply, &answer(false, busy.to_string()));
        };
        let (cell, found) = (self.settings.cell.clone(), self.cell.files(&job, &kinds));
        let (fleet, replicas) = (self.settings.fleet.clone(), self.settings.storage.replicas);
        let runtime = tokio::runtime::Handle::current();
        let work = move || {
            let (_place, _inside) = (place, runtime.enter());
            let sent = runtime.block_on(async {
                let files = found.await.map_err(|_| "celld is ending".to_string())??;
                files::send(&network.context(), &fleet, replicas, [&cell, &job], files).await
            });
            let said = match sent {
                Ok(files) if files.is_empty() => {
                    answer(false, format!("cell {cell} has no such file of job {job}"))
                }
                Ok(files) => {
                    Answer { files, ..answer(true, "the files are in the object store".to_string()) }
                }
                Err(fault) => answer(false, fault),
            };
            network.reply(reply, &said);
        };
        // No thread: the request gets no answer, and is repeated.
        let _ = std::thread::Builder::new().name("fleet files".to_string()).spawn(work);
    }

    /// Looks at the cell: what happened, and how it is.
    fn look(&mut self) {
        for CellEvent { job, what, unix_s } in self.cell.events() {
            // The end of a job of the fleet is reported with its claim.
            let of_fleet = job.as_ref().is_some_and(|job| self.agent.has_begun(job));
            if !(of_fleet && matches!(what, What::Done { .. })) {
                self.note(job, what, unix_s);
            }
        }
        let mut state = self.cell.state();
        self.handle(Input::Ready(state.armed && state.idle));
        state.version = VERSION;
        state.labels.clone_from(&self.settings.labels);
        state.holds = self.agent.holds();
        state.clock_ahead_s = (self.ahead_s * 10.0).round() / 10.0;
        state.undelivered = self.store.waiting().unwrap_or(0);
        state.totals = self.store.totals().unwrap_or_default();
        let wanted = self.shelf.wanted(&self.settings.cell, &self.settings.labels);
        let wanted = wanted.filter(|_| self.shelf_known);
        let FragmentState { runs, waits, fault } = self.cell.fragment(wanted);
        (state.fragment, state.fragment_waits) = (runs, waits);
        self.complain("fragment", fault.map(|fault| sentence(&fault)));
        state.complaints = self.agent.complaints();
        state.complaints.extend(self.faults.values().cloned());
        if state.complaints != self.said {
            self.said.clone_from(&state.complaints);
            self.cell.complaints(&state.complaints);
        }
        self.deliver();
        self.show(state);
    }

    fn show(&mut self, mut state: CellState) {
        let Some(network) = &self.network else { return };
        let before = CellState { unix_s: state.unix_s, undelivered: state.undelivered, ..self.shown.clone() };
        let since = self.shown_at.map(|at| at.elapsed());
        let due =
            since.is_none_or(|since| since >= if before == state { STATE_EVERY } else { STATE_SOONEST });
        if due {
            state.unix_s = unix_now_s();
            network.show(&state);
            self.shown = state;
            self.shown_at = Some(Instant::now());
        }
    }

    fn deliver(&mut self) {
        let Some(network) = self.network.as_ref().filter(|_| !self.delivering) else { return };
        match self.store.undelivered(EVENTS_AT_ONCE) {
            Ok(events) if !events.is_empty() => {
                self.delivering = true;
                network.deliver(events);
            }
            Ok(_) => {}
            Err(error) => self.complain("database", Some(error.to_string())),
        }
    }
}

fn answer(accepted: bool, message: String) -> Answer {
    Answer { version: VERSION, accepted, message, files: Vec::new() }
}
