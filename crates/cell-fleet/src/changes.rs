//! What changes in a fleet, as it changes: cells, claims, events, for who shows all of them.
//!
//! In: a client, how many of the last events are wanted. Out: one stream: first what is there, then what
//! comes. A part of it that ends says so: what is shown then is old, and who shows it begins again.

use crate::client::{Client, Shown, shown, text};
use crate::network::unix_s;
use crate::payloads::{Claim, Event, decode};
use crate::subjects::{Fleet, Key};
use async_nats::jetstream::consumer::{DeliverPolicy, pull};
use async_nats::jetstream::kv::{Entry, Operation};
use futures_util::stream::{self, Stream, StreamExt};
use std::pin::Pin;

/// Something has changed, or was there already.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// A cell showed its state.
    Cell(Box<Shown>),
    /// A cell was taken out of the fleet.
    CellGone(String),
    /// A claim was written, without the text of its job.
    Claim(Box<Claim>),
    /// A claim has gone: it was too old.
    ClaimGone(String),
    /// Something happened in a cell.
    Event(Box<Event>),
    /// No more of this comes.
    Ended(&'static str),
}

/// Changes as they come.
pub type Changes = Pin<Box<dyn Stream<Item = Change> + Send>>;

impl Client {
    /// Follows everything: what is there, of events the last so many, then what comes.
    ///
    /// # Errors
    /// What the server says.
    pub async fn changes(&self, last_events: u64) -> Result<Changes, String> {
        let cells = self.server.cells.watch_with_history(">").await.map_err(text)?;
        let claims = self.server.claims.watch_with_history(Key::CLAIMS).await.map_err(text)?;
        let mut events = self.server.events.clone();
        let last = events.info().await.map_err(text)?.state.last_sequence;
        let start_sequence = last.saturating_sub(last_events) + 1;
        let deliver_policy = DeliverPolicy::ByStartSequence { start_sequence };
        let config = pull::OrderedConfig { deliver_policy, ..pull::OrderedConfig::default() };
        let consumer = self.server.events.create_consumer(config).await.map_err(text)?;
        let messages = consumer.messages().await.map_err(text)?;
        let fleet = self.fleet.clone();
        let parts: [Changes; 3] = [
            until_it_ends("the cells", cells.map(|entry| entry.ok().map(cell))),
            until_it_ends("the claims", claims.map(|entry| entry.ok().map(claim))),
            until_it_ends(
                "the events",
                messages.map(move |message| message.ok().map(|message| event(&fleet, &message))),
            ),
        ];
        Ok(Box::pin(stream::select_all(parts)))
    }

    /// Each claim at the moment at which it is written, also what the next writing replaces before a reader
    /// of the bucket came to it. What is written while the server is away from this reader is not in it.
    ///
    /// # Errors
    /// What the server says.
    pub async fn writes_of_claims(&self) -> Result<impl Stream<Item = Claim> + Send + use<>, String> {
        let subject = format!("$KV.{}.{}", self.fleet.claims_bucket(), Key::CLAIMS);
        let written = self.server.context.client().subscribe(subject).await.map_err(text)?;
        Ok(written.filter_map(|message| std::future::ready(decode::<Claim>(&message.payload).ok())))
    }
}

/// The changes of one part until it ends or fails, and that it did. Entries that are not for this reader are
/// left out.
fn until_it_ends(
    what: &'static str,
    entries: impl Stream<Item = Option<Option<Change>>> + Send + 'static,
) -> Changes {
    let held = entries.take_while(|entry| std::future::ready(entry.is_some()));
    let read = held.filter_map(|entry| std::future::ready(entry.flatten()));
    Box::pin(read.chain(stream::once(std::future::ready(Change::Ended(what)))))
}

fn cell(entry: Entry) -> Option<Change> {
    Some(match entry.operation {
        Operation::Put => Change::Cell(Box::new(shown(entry))),
        Operation::Delete | Operation::Purge => Change::CellGone(entry.key),
    })
}

/// The event in a message; none where it is of another version, or of another cell than its subject says:
/// the server lets a cell publish under its own name alone.
fn event(fleet: &Fleet, message: &async_nats::jetstream::Message) -> Option<Change> {
    let event = decode::<Event>(&message.payload).ok()?;
    let subject = fleet.event(&event.cell, event.what.kind());
    (message.subject.as_str() == subject).then(|| Change::Event(Box::new(event)))
}

fn claim(entry: Entry) -> Option<Change> {
    if entry.operation != Operation::Put {
        let Some(Key::Claim { job }) = Key::of(&entry.key) else { return None };
        return Some(Change::ClaimGone(job));
    }
    let mut claim = decode::<Claim>(&entry.value).ok()?;
    claim.job.text.clear();
    claim.unix_s = unix_s(&entry);
    Some(Change::Claim(Box::new(claim)))
}
