//! The page's state, and how the daemon puts it together.
//!
//! In: configuration, state folder, the feed. Out: a page that is served, the observer for the loop, the
//! office that signs people in, orders joined with those of the state folder.

use crate::cell::orders::{Reply, Role};
use crate::config::cell::CellConfig;
use crate::config::page::PageConfig;
use crate::daemon::state_orders::Office;
use crate::jobs::command::SignIn;
use crate::jobs::state::StateFolder;
use crate::page::access::{Access, Grant, SESSION_S, plain_name};
use crate::page::control::Control;
use crate::page::feed::Feed;
use crate::page::limits::Limits;
use crate::page::orders::Desk;
use crate::page::routes;
use crate::page::server::{Listening, ServeError};
use cell_edge::clock::unix_now_s;
use cell_edge::files::{FileError, read_regular, write_whole};
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::Semaphore;

/// Days that a token may last at most.
const TOKEN_DAYS_MAX: u32 = 366;

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
    pub desk: Desk,
    /// When the page came up: beats count from here.
    pub begun: Instant,
    /// The same by the calendar, ms since 1970.
    pub begun_unix_ms: u64,
    /// Plans are made one at a time.
    pub planning: Arc<Semaphore>,
    /// Orders that were carried out, and refused.
    pub orders: [AtomicU64; 2],
    access: Arc<Mutex<Access>>,
    control: Mutex<Control>,
    limits: Mutex<Limits>,
}

/// See [`Shared`].
pub type App = Arc<Shared>;

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Who may do what.
    pub fn access(&self) -> MutexGuard<'_, Access> {
        locked(&self.access)
    }

    /// Who has control.
    pub fn control(&self) -> MutexGuard<'_, Control> {
        locked(&self.control)
    }

    /// Who may ask how often.
    pub fn limits(&self) -> MutexGuard<'_, Limits> {
        locked(&self.limits)
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
        keep_access(&self.access(), &access_file(&self.state))
    }
}

fn access_file(state: &StateFolder) -> PathBuf {
    state.root().join("page.json")
}

fn keep_access(access: &Access, path: &std::path::Path) -> Result<(), FileError> {
    write_whole(path, access.file().as_bytes())
}

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
    pub desk: Desk,
}

/// Opens the address and serves the page from now on; the office signs people in.
///
/// # Errors
/// The address, certificate or key cannot be used.
pub fn start(setup: Setup) -> Result<Box<dyn Office>, ServeError> {
    let listening = Listening::open(setup.page)?;
    let mut config = setup.page.clone();
    config.listen = listening.address().unwrap_or(config.listen);
    let text = read_regular(&access_file(&setup.state), ACCESS_BYTES_MAX).map(|(text, _)| text);
    let access = Access::of_file(&text.unwrap_or_default(), unix_now_s());
    let access = Arc::new(Mutex::new(access));
    let (address, path) = (config.address(), access_file(&setup.state));
    tracing::info!("the page is at {address}; `celld open` signs a browser in");
    let office = SignsIn { access: access.clone(), address, path };
    let app = Arc::new(Shared {
        config,
        cell: setup.cell.clone(),
        config_name: setup.config_name,
        state: setup.state,
        feed: setup.feed,
        desk: setup.desk,
        begun: Instant::now(),
        begun_unix_ms: (unix_now_s() * 1e3) as u64,
        planning: Arc::new(Semaphore::new(1)),
        orders: Default::default(),
        access,
        control: Mutex::default(),
        limits: Mutex::default(),
    });
    listening.serve(move || routes::router(app))?;
    Ok(Box::new(office))
}

struct SignsIn {
    access: Arc<Mutex<Access>>,
    address: String,
    path: PathBuf,
}

impl Office for SignsIn {
    fn sign_in(&self, wanted: &SignIn, uid: Option<u32>) -> Reply {
        let name = wanted.name.as_deref().map_or_else(|| user_name(uid), str::to_string);
        let Some(name) = plain_name(&name) else { return Reply::refuse("a name has letters") };
        let now = unix_now_s();
        let grant =
            |seconds: f64| Grant { name: name.clone(), role: wanted.role, until_unix_s: now + seconds };
        let made = match wanted.token_days {
            None => {
                let ticket = locked(&self.access).ticket(grant(SESSION_S), now);
                ticket.map(|ticket| format!("{}/#ticket={ticket}", self.address))
            }
            Some(days @ 1..=TOKEN_DAYS_MAX) => {
                let mut access = locked(&self.access);
                let token = access.grant(grant(f64::from(days) * 86_400.0));
                if let Err(error) = keep_access(&access, &self.path) {
                    return Reply::refuse(format!("the token could not be kept: {error}"));
                }
                token
            }
            Some(_) => return Reply::refuse(format!("a token lasts 1 to {TOKEN_DAYS_MAX} days")),
        };
        match made {
            Ok(secret) => Reply::accept(secret),
            Err(error) => Reply::refuse(format!("no random numbers: {error}")),
        }
    }
}

/// The name of a user as the system has it.
fn user_name(uid: Option<u32>) -> String {
    let Some(uid) = uid else { return "unknown".to_string() };
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(uid)).then(|| name.to_string())
    });
    name.unwrap_or_else(|| format!("user {uid}"))
}

/// The least role that may look.
pub const LOOK: Role = Role::View;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_is_called_as_the_system_does() {
        assert_eq!(user_name(Some(0)), "root");
        assert_eq!(
            (user_name(Some(4_000_000_000)).as_str(), user_name(None).as_str()),
            ("user 4000000000", "unknown")
        );
    }
}
