//! Whether every task of the daemon gets on, and what the service manager is sent of it.
//!
//! In: beats. A task is working since its last beat, or rests because it has nothing to do. Out: which
//! tasks have not answered in their time, in the log; the messages of `sd_notify(3)` to the socket that
//! `NOTIFY_SOCKET` names: READY, STATUS, WATCHDOG as long as every task answers, STOPPING. A daemon whose
//! loop hangs still has a process, a lock and threads that get on: only all tasks together may keep the
//! service manager from starting it anew.

use cell_machine::intake::HELD_UP_AFTER;
use sd_notify::NotifyState;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How often the beats are looked at, at the least: a third of the watchdog's time, and this.
const EVERY: Duration = Duration::from_secs(1);

/// What a task is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// It has nothing to do.
    Rests,
    /// It works; the next beat is due within this time.
    Works { since: Instant, within: Duration },
    /// It ended in the middle of its work.
    Died,
    /// It ended while it rested.
    Ended,
}

#[derive(Debug)]
struct Slot {
    name: &'static str,
    state: Mutex<State>,
}

impl Slot {
    fn start_again(&self, now: Instant) {
        if let State::Works { since, .. } = &mut *self.state() {
            *since = now;
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A task that is watched; one that is dropped while it works has died, and is late from then on.
#[derive(Debug)]
pub struct Beat {
    slot: Arc<Slot>,
    within: Duration,
}

impl Beat {
    /// The task gets on; the next beat follows within its time, or it rests.
    pub fn now(&self) {
        self.at(Instant::now());
    }

    fn at(&self, now: Instant) {
        *self.slot.state() = State::Works { since: now, within: self.within };
    }

    /// Counts from now on, if the task works: celld itself was held up.
    pub fn start_again(&self) {
        self.slot.start_again(Instant::now());
    }

    /// The task has nothing to do.
    pub fn rests(&self) {
        *self.slot.state() = State::Rests;
    }

    /// It has not answered in its time.
    pub fn is_late(&self) -> bool {
        late(&self.slot, Instant::now()).is_some()
    }
}

impl Drop for Beat {
    fn drop(&mut self) {
        let mut state = self.slot.state();
        *state = if *state == State::Rests { State::Ended } else { State::Died };
    }
}

/// A task that does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    /// Its name.
    pub task: &'static str,
    /// For how long; `None`: it has died.
    pub silent: Option<Duration>,
}

impl std::fmt::Display for Late {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.silent {
            Some(silent) => write!(f, "{} has not answered for {} s", self.task, silent.as_secs()),
            None => write!(f, "{} has ended in the middle of its work", self.task),
        }
    }
}

fn late(slot: &Slot, now: Instant) -> Option<Late> {
    let silent = match *slot.state() {
        State::Rests | State::Ended => return None,
        State::Works { since, within } => Some(now.duration_since(since)).filter(|silent| *silent > within),
        State::Died => return Some(Late { task: slot.name, silent: None }),
    };
    silent.map(|_| Late { task: slot.name, silent })
}

/// All tasks of a daemon.
#[derive(Clone, Debug, Default)]
pub struct Beats(Arc<Mutex<Vec<Arc<Slot>>>>);

impl Beats {
    /// A task that answers within this time while it works; it rests until its first beat.
    pub fn task(&self, name: &'static str, within: Duration) -> Beat {
        let slot = Arc::new(Slot { name, state: Mutex::new(State::Rests) });
        self.slots().push(Arc::clone(&slot));
        Beat { slot, within }
    }

    /// The tasks that do not answer.
    pub fn late(&self, now: Instant) -> Vec<Late> {
        let mut slots = self.slots();
        slots.retain(|slot| *slot.state() != State::Ended);
        slots.iter().filter_map(|slot| late(slot, now)).collect()
    }

    /// Counts from now on for every task: celld itself was held up.
    pub fn start_again(&self, now: Instant) {
        self.slots().iter().for_each(|slot| slot.start_again(now));
    }

    fn slots(&self) -> MutexGuard<'_, Vec<Arc<Slot>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The thread that looks at the beats and sends to the service manager; it ends when this is dropped.
#[derive(Debug)]
pub struct Watchdog {
    shared: Shared,
    thread: std::thread::Thread,
    /// Closed when the thread has ended.
    ended: Receiver<()>,
}

/// How long the end of the daemon waits until the service manager has taken what was reached.
const SENT_WITHIN: Duration = Duration::from_secs(1);

/// What the daemon and the thread share.
#[derive(Debug)]
struct Shared {
    words: Arc<Mutex<String>>,
    stage: Arc<AtomicU8>,
    ends: Arc<AtomicBool>,
}

/// How far the daemon is: nothing to report, ready for jobs, ending.
const READY: u8 = 1;
const STOPPING: u8 = 2;

impl Watchdog {
    /// Starts it. Without a service manager, tasks that do not answer are logged all the same.
    pub fn start(beats: Beats) -> Watchdog {
        let (words, stage, ends) = (Arc::default(), Arc::default(), Arc::default());
        let wanted = sd_notify::watchdog_enabled();
        let every = wanted.map_or(EVERY, |within| EVERY.min(within / 3));
        let shared = Shared { words: Arc::clone(&words), stage: Arc::clone(&stage), ends: Arc::clone(&ends) };
        let feeder = Feeder { feeds: wanted.is_some(), ..Feeder::default() };
        let (runs, ended) = channel();
        let run = move || {
            let _runs: Sender<()> = runs;
            watch(&beats, &shared, feeder, every, &send);
        };
        let thread = std::thread::spawn(run).thread().clone();
        Watchdog { shared: Shared { words, stage, ends }, thread, ended }
    }

    /// Jobs are taken in from now on, and orders as soon as the robot is there.
    pub fn ready(&self) {
        self.reach(READY);
    }

    /// The daemon ends.
    pub fn stopping(&self) {
        self.reach(STOPPING);
    }

    fn reach(&self, stage: u8) {
        self.shared.stage.store(stage, Ordering::Relaxed);
        self.thread.unpark();
    }

    /// What the cell does, in one line.
    pub fn words(&self, words: &str) {
        let mut kept = self.shared.words.lock().unwrap_or_else(PoisonError::into_inner);
        if *kept != words {
            words.clone_into(&mut kept);
        }
    }
}

impl Drop for Watchdog {
    /// What was reached is sent before the process ends, unless the service manager takes nothing.
    fn drop(&mut self) {
        // Also a daemon that ends before its robot was there, once it was ready.
        let _ = self.shared.stage.compare_exchange(READY, STOPPING, Ordering::Relaxed, Ordering::Relaxed);
        self.shared.ends.store(true, Ordering::Release);
        self.thread.unpark();
        let _ = self.ended.recv_timeout(SENT_WITHIN);
    }
}

/// The thread: it alone sends to the service manager, whose socket may take nothing for a while.
fn watch(beats: &Beats, shared: &Shared, mut feeder: Feeder, every: Duration, send: &dyn Fn(NotifyState)) {
    loop {
        // Read before the stage: what was reached before the end is sent.
        let ends = shared.ends.load(Ordering::Acquire);
        feeder.reached(shared.stage.load(Ordering::Relaxed)).into_iter().for_each(send);
        if ends {
            return;
        }
        let words = shared.words.lock().unwrap_or_else(PoisonError::into_inner).clone();
        feeder.turn(&beats.late(Instant::now()), &words).iter().for_each(|outcome| outcome.carry_out(send));
        if let Some(lost) = feeder.lost(cell_edge::log::lost_lines()) {
            tracing::warn!(lost, "lines of the log were lost: the terminal or the journal took none");
        }
        let rested = Instant::now();
        std::thread::park_timeout(every);
        if rested.elapsed() > every + HELD_UP_AFTER {
            // A thread that only waits comes late when all of celld was held up.
            beats.start_again(Instant::now());
        }
    }
}

/// What comes of a look at the beats.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Outcome {
    /// To the service manager: all is well.
    Feed,
    /// To the service manager: what the cell does.
    Words(String),
    /// To the log.
    Late(String),
    /// To the log.
    Answers(&'static str),
}

impl Outcome {
    fn carry_out(&self, send: &dyn Fn(NotifyState)) {
        match self {
            Outcome::Feed => send(NotifyState::Watchdog),
            Outcome::Words(words) => send(NotifyState::Status(words)),
            Outcome::Late(late) => tracing::error!("{late}; the watchdog gets no sign of life"),
            Outcome::Answers(task) => tracing::warn!("{task} answers again"),
        }
    }
}

/// Without a service manager there is no socket, and nothing is sent; one that is not there any more is no
/// reason to end.
fn send(state: NotifyState) {
    let socket = std::env::var_os("NOTIFY_SOCKET").unwrap_or_default();
    // sd_notify supports only path sockets.
    let sent = match socket.as_encoded_bytes().strip_prefix(b"@") {
        Some(name) => send_to_abstract(name, &state.to_string()),
        None => sd_notify::notify(&[state]),
    };
    if let Err(error) = sent {
        tracing::debug!(%error, "the service manager was not reached");
    }
}

/// Sends to a socket in the abstract namespace (`unix(7)`).
fn send_to_abstract(name: &[u8], message: &str) -> io::Result<()> {
    let address = SocketAddr::from_abstract_name(name)?;
    UnixDatagram::unbound()?.send_to_addr(message.as_bytes(), &address).map(|_| ())
}

/// What came of the last look.
#[derive(Debug, Default)]
struct Feeder {
    /// The service manager waits for signs of life.
    feeds: bool,
    late: Vec<&'static str>,
    words: String,
    stage: u8,
    lost_lines: usize,
}

impl Feeder {
    /// What the service manager gets of a new stage, each once.
    fn reached(&mut self, stage: u8) -> Vec<NotifyState<'static>> {
        let before = std::mem::replace(&mut self.stage, stage);
        let states = [(READY, NotifyState::Ready), (STOPPING, NotifyState::Stopping)];
        states
            .into_iter()
            .filter(|(at, _)| (before + 1..=stage).contains(at))
            .map(|(_, state)| state)
            .collect()
    }

    /// Lines that were lost since the last look, if any.
    fn lost(&mut self, lost: usize) -> Option<usize> {
        let new = lost - std::mem::replace(&mut self.lost_lines, lost);
        (new > 0).then_some(new)
    }

    fn turn(&mut self, late: &[Late], words: &str) -> Vec<Outcome> {
        let mut said = Vec::new();
        let now: Vec<&'static str> = late.iter().map(|late| late.task).collect();
        let new = late.iter().filter(|late| !self.late.contains(&late.task));
        said.extend(new.map(|late| Outcome::Late(late.to_string())));
        let over = self.late.iter().filter(|task| !now.contains(task));
        said.extend(over.map(|task| Outcome::Answers(task)));
        if late.is_empty() && self.feeds {
            said.push(Outcome::Feed);
        }
        if words != self.words {
            words.clone_into(&mut self.words);
            said.push(Outcome::Words(words.to_string()));
        }
        self.late = now;
        said
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_task_is_late_while_it_works_and_not_while_it_rests() {
        let (beats, start) = (Beats::default(), Instant::now());
        let task = beats.task("journal", 3 * SECOND);
        assert_eq!(beats.late(start + 100 * SECOND), [], "it has not begun");
        task.at(start);
        assert_eq!(beats.late(start + 3 * SECOND), []);
        let silent = Some(4 * SECOND);
        assert_eq!(beats.late(start + 4 * SECOND), [Late { task: "journal", silent }]);
        task.at(start + 4 * SECOND);
        assert_eq!(beats.late(start + 5 * SECOND), []);
        task.rests();
        assert_eq!(beats.late(start + 100 * SECOND), []);
    }

    #[test]
    fn a_task_that_ends_at_work_has_died_and_one_that_ends_at_rest_is_forgotten() {
        let beats = Beats::default();
        let planner = beats.task("planner", SECOND);
        let worker = beats.task("camera", SECOND);
        planner.now();
        planner.rests();
        worker.now();
        drop((planner, worker));
        assert_eq!(beats.late(Instant::now()), [Late { task: "camera", silent: None }]);
        assert_eq!(beats.slots().len(), 1);
    }

    #[test]
    fn the_watchdog_is_fed_only_while_every_task_answers_and_each_change_is_said_once() {
        let mut feeder = Feeder { feeds: true, ..Feeder::default() };
        let late = Late { task: "the loop", silent: Some(6 * SECOND) };
        assert_eq!(feeder.turn(&[], "idle"), [Outcome::Feed, Outcome::Words("idle".into())]);
        assert_eq!(feeder.turn(&[], "idle"), [Outcome::Feed]);
        assert_eq!(feeder.turn(&[late], "idle"), [Outcome::Late("the loop has not answered for 6 s".into())]);
        assert_eq!(feeder.turn(&[late], "idle"), []);
        assert_eq!(feeder.turn(&[], "idle"), [Outcome::Answers("the loop"), Outcome::Feed]);
        let mut alone = Feeder::default();
        assert_eq!(alone.turn(&[], ""), [], "no service manager waits for signs of life");
    }

    #[test]
    fn what_was_reached_right_before_the_end_is_sent() {
        let shared = Shared { words: Arc::default(), stage: Arc::default(), ends: Arc::default() };
        shared.stage.store(STOPPING, Ordering::Relaxed);
        shared.ends.store(true, Ordering::Relaxed);
        let sent = Mutex::new(Vec::new());
        let send = |state: NotifyState| sent.lock().unwrap().push(state.to_string());
        watch(&Beats::default(), &shared, Feeder::default(), SECOND, &send);
        assert_eq!(*sent.lock().unwrap(), ["READY=1", "STOPPING=1"]);
    }

    #[test]
    fn each_stage_and_each_loss_of_lines_is_reported_once() {
        let mut feeder = Feeder::default();
        assert_eq!((feeder.reached(0).len(), feeder.lost(0)), (0, None));
        let reached = feeder.reached(STOPPING);
        assert!(matches!(reached[..], [NotifyState::Ready, NotifyState::Stopping]), "none is left out");
        assert_eq!((feeder.reached(STOPPING).len(), feeder.lost(7), feeder.lost(7)), (0, Some(7), None));
        assert_eq!(feeder.lost(9), Some(2));
    }

    #[test]
    fn after_a_pause_of_celld_no_task_is_late() {
        let (beats, start) = (Beats::default(), Instant::now());
        let task = beats.task("journal", 3 * SECOND);
        task.at(start);
        beats.start_again(start + 20 * SECOND);
        assert_eq!(beats.late(start + 22 * SECOND), []);
        assert_eq!(beats.late(start + 24 * SECOND).len(), 1);
    }
}
