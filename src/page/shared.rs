//! What all handlers share: configuration, state folder, what happens, who may do what.
//!
//! In: the parts, as `app` puts them together. Out: [`App`], which each handler is given. Locks are held for
//! single values, never over a wait.

use crate::config::cell::CellConfig;
use crate::config::page::PageConfig;
use crate::daemon::film::{Film, Shown};
use crate::jobs::state::StateFolder;
use crate::page::access::Access;
use crate::page::calibration::bench::Bench;
use crate::page::connections::StreamPlaces;
use crate::page::control::Control;
use crate::page::feed::Feed;
use crate::page::limits::Limits;
use crate::page::orders::OrderSender;
use crate::page::places::{EVENT_STREAMS, FILM_STREAMS};
use crate::page::screen::Screen;
use crate::page::texts::Texts;
use cell_edge::clock::{boot_id, boot_now_s, unix_now_s};
use cell_edge::files::{FileError, read_regular, write_secret};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Instant;
use tokio::sync::Semaphore;

/// What the daemon needs to serve a page.
pub struct Setup<'a> {
    /// The section of the configuration.
    pub page: &'a PageConfig,
    /// The cell.
    pub cell: &'a CellConfig,
    /// Name of the configuration's file.
    pub config_name: String,
    /// Jobs and journal.
    pub state: StateFolder,
    /// What happens.
    pub feed: Feed,
    /// Where orders go.
    pub order_sender: OrderSender,
    /// The camera's film.
    pub film: Film,
    /// Where its pictures arrive, and those of calibration rounds.
    pub pictures: Receiver<Shown>,
    /// Texts in other languages.
    pub texts: Texts,
}

/// A page that calibrates polls every second.
const CALIBRATES_MS: u64 = 4000;

/// Largest file of grants that is read.
const ACCESS_BYTES_MAX: u64 = 1 << 20;

/// Everything that handlers share.
pub struct Shared {
    /// The section of the configuration; its port is the one that is listened at.
    pub config: PageConfig,
    /// The cell.
    pub cell: CellConfig,
    /// Name of the configuration's file.
    pub config_name: String,
    /// Jobs and journal.
    pub state: StateFolder,
    /// What happens.
    pub feed: Feed,
    /// Where orders go.
    pub order_sender: OrderSender,
    /// The camera's film.
    pub film: Film,
    /// Its last picture.
    pub screen: Screen,
    /// When the page came up: beats count from here.
    pub begun: Instant,
    /// The same by the calendar, ms since 1970.
    pub begun_unix_ms: u64,
    /// Texts in other languages.
    pub texts: Texts,
    /// Plans are made one at a time.
    pub planning: Arc<Semaphore>,
    /// Places for streams of events.
    pub event_streams: StreamPlaces,
    /// Places for viewers of the film.
    pub film_streams: StreamPlaces,
    /// Orders that were carried out, and refused.
    pub orders: [AtomicU64; 2],
    /// The API in a document.
    pub document: Value,
    access: Mutex<Access>,
    writing: Mutex<()>,
    control: Mutex<Control>,
    limits: Mutex<Limits>,
    calibration: Mutex<Bench>,
    /// When a page that calibrates last requested anything, by the clock of beats.
    calibrated_at: AtomicU64,
}

/// See [`Shared`].
pub type App = Arc<Shared>;

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// With the grants of an earlier daemon; `config.listen` is where the page is listened at.
    pub fn new(config: PageConfig, setup: Setup, document: Value) -> (Shared, Receiver<Shown>) {
        let text = read_regular(&access_file(&setup.state), ACCESS_BYTES_MAX).map(|(text, _)| text);
        let begun_unix_ms = (unix_now_s() * 1e3) as u64;
        let shared = Shared {
            config,
            cell: setup.cell.clone(),
            config_name: setup.config_name,
            state: setup.state,
            feed: setup.feed,
            order_sender: setup.order_sender,
            film: setup.film,
            screen: Screen::default(),
            begun: Instant::now(),
            begun_unix_ms,
            texts: setup.texts,
            planning: Arc::new(Semaphore::new(1)),
            event_streams: StreamPlaces::new(EVENT_STREAMS.0, EVENT_STREAMS.1),
            film_streams: StreamPlaces::new(FILM_STREAMS.0, FILM_STREAMS.1),
            orders: Default::default(),
            document,
            access: Mutex::new(Access::of_file(&text.unwrap_or_default(), &boot_id(), boot_now_s())),
            writing: Mutex::default(),
            control: Mutex::default(),
            limits: Mutex::default(),
            calibration: Mutex::new(Bench::numbered_from(begun_unix_ms)),
            calibrated_at: AtomicU64::new(0),
        };
        (shared, setup.pictures)
    }

    /// Who may do what.
    pub fn access(&self) -> MutexGuard<'_, Access> {
        locked(&self.access)
    }

    /// Who has control.
    pub fn control(&self) -> MutexGuard<'_, Control> {
        locked(&self.control)
    }

    /// Who may send how many requests.
    pub fn limits(&self) -> MutexGuard<'_, Limits> {
        locked(&self.limits)
    }

    /// What is calibrated. It is held while something is solved: not to be taken by what must not wait.
    pub fn calibration(&self) -> MutexGuard<'_, Bench> {
        locked(&self.calibration)
    }

    /// The same, unless it is held.
    pub fn calibration_if_free(&self) -> Option<MutexGuard<'_, Bench>> {
        match self.calibration.try_lock() {
            Ok(bench) => Some(bench),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// A page that calibrates is open.
    pub fn calibrates(&self) {
        self.calibrated_at.store(self.beat(), Ordering::Relaxed);
    }

    /// Whether one was a moment ago.
    pub fn is_calibrating(&self) -> bool {
        self.beat().saturating_sub(self.calibrated_at.load(Ordering::Relaxed)) < CALIBRATES_MS
    }

    /// Name of the cookie: browsers do not keep those of two cells on one computer apart by their ports.
    pub fn cookie_name(&self) -> String {
        format!("celld_{}", self.config.listen.port())
    }

    /// The clock of beats, ms: it counts from the calendar's time at the start, so that the beats of an
    /// earlier celld are old, and goes on evenly whatever happens to the calendar.
    pub fn beat(&self) -> u64 {
        let elapsed = u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.begun_unix_ms.saturating_add(elapsed)
    }

    /// Keeps the grants for the next start.
    ///
    /// # Errors
    /// The disk.
    pub fn keep_access(&self) -> Result<(), FileError> {
        // One after the other; who may do what is not locked while the disk is waited for.
        let _writing = locked(&self.writing);
        let text = self.access().file();
        write_secret(&access_file(&self.state), text.as_bytes(), false)
    }
}

/// Where grants are kept.
fn access_file(state: &StateFolder) -> PathBuf {
    state.root().join("page.json")
}
