//! How the daemon puts the page together.
//!
//! In: configuration, state folder, the feed. Out: a page that is served, the observer for the loop, the
//! handler that signs people in, orders joined with those of the state folder.

use crate::daemon::state_orders::SignInHandler;
use crate::jobs::command::SignIn;
use crate::page::access::{Grant, SESSION_S, plain_name};
use crate::page::film;
use crate::page::openapi::openapi;
use crate::page::routes;
use crate::page::server::{Listening, ServeError};
use crate::page::shared::{App, Setup, Shared};
use cell_edge::clock::boot_now_s;
use cell_machine::orders::Reply;
use std::sync::Arc;

/// Days that a token may last at most.
const TOKEN_DAYS_MAX: u32 = 366;

/// Opens the address and serves the page from now on; what is returned signs people in.
///
/// # Errors
/// The address, certificate or key cannot be used.
pub fn start(setup: Setup) -> Result<Box<dyn SignInHandler>, ServeError> {
    let listening = Listening::open(setup.page)?;
    let mut config = setup.page.clone();
    config.listen = listening.address().unwrap_or(config.listen);
    tracing::info!("the page is at {}; `celld open` signs a browser in", config.address());
    let (shared, pictures) = Shared::new(config, setup, openapi());
    let app = Arc::new(shared);
    let projector = app.clone();
    let project = move || film::project(&projector, &pictures);
    std::thread::Builder::new().name("film".into()).spawn(project).map_err(ServeError::Thread)?;
    let sign_ins = SignsIn(app.clone());
    listening.serve(move || routes::router(app))?;
    Ok(Box::new(sign_ins))
}

struct SignsIn(App);

impl SignInHandler for SignsIn {
    fn sign_in(&self, wanted: &SignIn, uid: Option<u32>) -> Reply {
        let name = wanted.name.as_deref().map_or_else(|| user_name(uid), str::to_string);
        let Some(name) = plain_name(&name) else { return Reply::refuse("a name has letters") };
        let now = boot_now_s();
        let grant =
            |seconds: f64| Grant { name: name.clone(), role: wanted.role, until_boot_s: now + seconds };
        let made = match wanted.token_days {
            None => {
                let user = uid.filter(|_| wanted.own_browser);
                let ticket = self.0.access().ticket(grant(SESSION_S), user, now);
                ticket.map(|ticket| format!("{}/#ticket={ticket}", self.0.config.address()))
            }
            Some(days @ 1..=TOKEN_DAYS_MAX) => {
                let token = self.0.access().grant(grant(f64::from(days) * 86_400.0));
                if let Err(error) = self.0.keep_access() {
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

    fn sign_out(&self, name: &str) -> Reply {
        let ended = self.0.access().end_all_of(name);
        if ended == 0 {
            return Reply::refuse(format!("no session, token or link has the name {name:?}"));
        }
        let said = format!("{ended} sessions, tokens and links of {name} are void from now on");
        match self.0.keep_access() {
            Ok(()) => Reply::accept(said),
            Err(error) => Reply::refuse(format!(
                "{said}, but that could not be written down and ends with this celld: {error}"
            )),
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
