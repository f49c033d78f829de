//! Who has the cell in hand: one person at a time gives the orders that move the arm.
//!
//! In: sessions with their names, the time. Out: whether an order may come from a session, and who has
//! control. Control is taken with the first order where it is free, given back, or taken from another with
//! the intent to do so; it lapses when nothing comes from its holder any more. Stops need no control. Pure.

use serde::Serialize;
use std::time::{Duration, Instant};

/// A holder that shows no sign of life for so long has gone: an open page shows one every second.
pub const LAPSES_AFTER: Duration = Duration::from_secs(20);

/// Who has control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Holder {
    /// The session; no secret.
    pub session: String,
    /// How the person is called.
    pub name: String,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Control {
    holder: Option<(Holder, Instant)>,
}

/// Another one has control.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} has control of the cell; take it on the page first, or wait until it is given back")]
pub struct Held {
    /// Who.
    pub name: String,
}

impl Control {
    /// Who has control.
    pub fn holder(&self, now: Instant) -> Option<&Holder> {
        let (holder, alive) = self.holder.as_ref()?;
        (now.duration_since(*alive) < LAPSES_AFTER).then_some(holder)
    }

    /// Takes control where it is free or already there; `force`: also from another one.
    ///
    /// # Errors
    /// Who has it.
    pub fn take(&mut self, session: &str, name: &str, force: bool, now: Instant) -> Result<(), Held> {
        match self.holder(now) {
            Some(holder) if holder.session != session && !force => Err(Held { name: holder.name.clone() }),
            Some(_) | None => {
                let holder = Holder { session: session.to_string(), name: name.to_string() };
                self.holder = Some((holder, now));
                Ok(())
            }
        }
    }

    /// Gives control back; another one's stays.
    pub fn give_back(&mut self, session: &str) {
        if self.holder.as_ref().is_some_and(|(holder, _)| holder.session == session) {
            self.holder = None;
        }
    }

    /// A sign of life of a session; one that has lapsed is not brought back by it.
    pub fn alive(&mut self, session: &str, now: Instant) {
        if self.holder(now).is_some_and(|holder| holder.session == session)
            && let Some((_, alive)) = &mut self.holder
        {
            *alive = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_has_control_until_it_is_given_back_taken_or_lapses() {
        let (mut control, start) = (Control::default(), Instant::now());
        let at = |s: u64| start + Duration::from_secs(s);
        let name = |control: &Control, now: Instant| control.holder(now).map(|holder| holder.name.clone());
        control.take("a", "anna", false, at(0)).unwrap();
        assert_eq!(control.take("b", "ben", false, at(1)), Err(Held { name: "anna".into() }));
        control.take("b", "ben", true, at(2)).unwrap();
        assert_eq!(name(&control, at(2)).as_deref(), Some("ben"));
        control.give_back("a");
        assert_eq!(name(&control, at(2)).as_deref(), Some("ben"), "anna cannot give away what ben has");
        control.alive("b", at(15));
        assert!(control.take("a", "anna", false, at(30)).is_err(), "ben was there 15 s ago");
        control.take("a", "anna", false, at(36)).unwrap();
        control.alive("b", at(37));
        assert_eq!(name(&control, at(37)).as_deref(), Some("anna"));
        control.give_back("a");
        assert_eq!(name(&control, at(37)), None);
    }
}
