//! What the agent wants of the network, carried out beside its loop: each request gets an answer.
//!
//! In: effects. Out: inputs, also when the server is away or refuses; what a person should know of a refusal
//! is a sentence beside it. Requests have a deadline, and nothing here waits for another.

use crate::connect::ANSWER_WITHIN;
use crate::fragments::{FRAGMENT_MAX, Fragment, Published};
use crate::hands::OTHER_VERSION;
use crate::payloads::{Answer, CellState, Claim, Event, Refusal, VERSION, What, decode, encode};
use crate::server::Server;
use crate::subjects::{Fleet, Key, Target};
use crate::values::{Found, Input, Settle, Unread, Who, Written};
use crate::words::sha256;
use async_nats::Subject;
use async_nats::jetstream::kv::{CreateErrorKind, Entry, Operation, Store, UpdateErrorKind};
use async_nats::jetstream::{AckKind, Context, Message, message::PublishMessage};
use futures_util::StreamExt;
use std::future::Future;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::timeout;

/// After this silence a bucket has no entries.
pub(crate) const SILENT: Duration = Duration::from_secs(2);

/// What comes back from the network.
#[derive(Debug)]
pub enum News {
    /// For the agent.
    Input(Input),
    /// An own state came back: when the server stored it, and what it said of the time, s since 1970.
    Echo {
        /// By the server's clock.
        stored_unix_s: f64,
        /// By our own, as it was sent.
        sent_unix_s: f64,
    },
    /// Events were stored up to this number.
    Delivered(u64),
    /// No more events are on their way; why, if the last was not stored.
    DeliveryOver(Option<String>),
    /// Something happened to a job, for the cell's own sequence of events.
    Happened(String, What),
    /// A configuration fragment was published.
    Fragment(Box<Published>),
    /// All that there were have come: before, the nearest one may be missing.
    FragmentsKnown,
    /// Something was refused: about what, and a sentence. An empty one takes it back.
    Complaint(&'static str, String),
}

/// The network, as long as one connection's streams are known.
#[derive(Clone)]
pub struct Network {
    fleet: Fleet,
    pub(crate) cell: String,
    pub(crate) server: Server,
    news: UnboundedSender<News>,
}

impl Network {
    /// The network of a cell.
    pub fn new(fleet: Fleet, cell: String, server: Server, news: UnboundedSender<News>) -> Network {
        Network { fleet, cell, server, news }
    }

    pub(crate) fn report(&self, news: News) {
        // The loop has ended.
        let _ = self.news.send(news);
    }

    pub(crate) fn spawn(&self, work: impl Future<Output = ()> + Send + 'static) {
        drop(tokio::spawn(work));
    }

    /// Says about something that it goes, or why not.
    fn said<T, E: std::fmt::Display>(&self, about: &'static str, result: &Result<T, E>) {
        let text = result.as_ref().err().map(|error| refusal_sentence(about, &error.to_string()));
        self.report(News::Complaint(about, text.unwrap_or_default()));
    }

    /// To settle messages with.
    pub fn context(&self) -> Context {
        self.server.context.clone()
    }

    /// Answers a person.
    pub fn reply(&self, to: Subject, answer: &Answer) {
        let Ok(bytes) = encode(answer) else { return };
        let client = self.server.context.client();
        self.spawn(async move {
            // Who requested it may have gone.
            let _ = client.publish(to, bytes.into()).await;
        });
    }

    /// Reads a claim.
    pub fn read(&self, job: String) {
        let this = self.clone();
        self.spawn(async move {
            let found = timeout(ANSWER_WITHIN, this.server.claims.entry(Key::claim(&job).to_string())).await;
            let found = match found {
                Ok(Ok(entry)) => {
                    let found = claim_of(entry);
                    let foreign = if found.is_err() { foreign_sentence(&job) } else { String::new() };
                    this.report(News::Complaint("claims of another version", foreign));
                    found
                }
                Ok(Err(_)) | Err(_) => Err(Unread::Unanswered),
            };
            this.report(News::Input(Input::Read { job, found }));
        });
    }

    /// Writes a claim over a revision, or where there is none.
    pub fn write(&self, who: Who, claim: Box<Claim>, over: Option<u64>) {
        let this = self.clone();
        self.spawn(async move {
            let job = claim.job.id.clone();
            let (outcome, fault) = this.set(&claim, over).await;
            this.report(News::Complaint("claims", fault.unwrap_or_default()));
            this.report(News::Input(Input::Written { who, job, outcome }));
        });
    }

    async fn set(&self, claim: &Claim, over: Option<u64>) -> (Written, Option<String>) {
        let bytes = match encode(claim) {
            Ok(bytes) => bytes::Bytes::from(bytes),
            Err(fault) => return (Written::Unknown, Some(fault.to_string())),
        };
        let key = Key::claim(&claim.job.id).to_string();
        let claims = &self.server.claims;
        let refused = |text: String| (Written::Unknown, Some(refusal_sentence("claims", &text)));
        match over {
            Some(revision) => match timeout(ANSWER_WITHIN, claims.update(key, bytes, revision)).await {
                Ok(Ok(revision)) => (Written::Done(revision), None),
                Ok(Err(error)) if error.kind() == UpdateErrorKind::WrongLastRevision => {
                    (Written::Conflict, None)
                }
                Ok(Err(error)) => refused(error.to_string()),
                Err(_) => (Written::Unknown, None),
            },
            None => match timeout(ANSWER_WITHIN, claims.create(key, bytes)).await {
                Ok(Ok(revision)) => (Written::Done(revision), None),
                Ok(Err(error)) if error.kind() == CreateErrorKind::AlreadyExists => (Written::Conflict, None),
                Ok(Err(error)) => refused(error.to_string()),
                Err(_) => (Written::Unknown, None),
            },
        }
    }

    /// Settles a message.
    pub fn settle(&self, message: &Message, how: &Settle) {
        let kind = match how {
            Settle::Done => AckKind::Ack,
            Settle::Back(after) if after.is_zero() => AckKind::Nak(None),
            Settle::Back(after) => AckKind::Nak(Some(*after)),
            Settle::Progress => AckKind::Progress,
        };
        let (context, message) = (message.context.clone(), message.message.clone());
        self.spawn(async move {
            // Lost: the message comes again, which does no harm.
            let _ = Message { message, context }.ack_with(kind).await;
        });
    }

    /// Puts a job into its queue.
    pub fn publish(&self, claim: &Claim) {
        let job = claim.job.id.clone();
        let (Some(lane), Ok(bytes)) = (claim.lane(), encode(&claim.job)) else {
            return self.report(News::Input(Input::Published { job, stored: false }));
        };
        let (subject, id) = (self.fleet.job(&lane, &claim.by), claim.job.message_id());
        let this = self.clone();
        self.spawn(async move {
            let result = this.store(subject, &id, bytes).await;
            this.said("queue", &result);
            this.report(News::Input(Input::Published { job, stored: result.is_ok() }));
        });
    }

    async fn store(&self, subject: String, id: &str, bytes: Vec<u8>) -> Result<(), String> {
        let message = PublishMessage::build().message_id(id).payload(bytes.into());
        let sent = timeout(ANSWER_WITHIN, async {
            let stored = self.server.context.send_publish(subject, message).await;
            stored.map_err(|error| error.to_string())?.await.map_err(|error| error.to_string())
        });
        match sent.await {
            Ok(result) => result.map(drop),
            Err(_) => Err("no answer in time".to_string()),
        }
    }

    /// Notes a refusal, or takes it back.
    pub fn refuse(&self, job: String, refusal: Option<(u32, String)>, unix_s: f64) {
        let key = Key::Refusal { job, cell: self.cell.clone() }.to_string();
        let this = self.clone();
        self.spawn(async move {
            let Some((epoch, reason)) = refusal else {
                let _ = timeout(ANSWER_WITHIN, this.server.claims.delete(key)).await;
                return;
            };
            let Ok(bytes) = encode(&Refusal { version: VERSION, epoch, reason, unix_s }) else { return };
            // Lost: the job comes again, and is refused again.
            let _ = timeout(ANSWER_WITHIN, this.server.claims.put(key, bytes.into())).await;
        });
    }

    /// Removes a key.
    pub fn remove(&self, key: Key) {
        let this = self.clone();
        self.spawn(async move {
            let _ = timeout(ANSWER_WITHIN, this.server.claims.delete(key.to_string())).await;
        });
    }

    /// Shows the cell's state.
    pub fn show(&self, state: &CellState) {
        let bytes = match encode(state) {
            Ok(bytes) => bytes,
            Err(fault) => {
                // Others take this cell for away.
                return self.report(News::Complaint(
                    "cells",
                    format!("the state of this cell is not shown: {fault}"),
                ));
            }
        };
        let this = self.clone();
        self.spawn(async move {
            let put = timeout(ANSWER_WITHIN, this.server.cells.put(&this.cell, bytes.into())).await;
            if let Ok(result) = put {
                this.said("cells", &result);
            }
        });
    }

    /// Stores events one after the other, in their order.
    pub fn deliver(&self, events: Vec<Event>) {
        let this = self.clone();
        self.spawn(async move {
            for event in events {
                let subject = this.fleet.event(&event.cell, event.what.kind());
                let stored = match encode(&event) {
                    Ok(bytes) => this.store(subject, &event.message_id(), bytes).await,
                    Err(fault) => Err(fault.to_string()),
                };
                match stored {
                    Ok(()) => this.report(News::Delivered(event.number)),
                    Err(message) => {
                        let sentence = refusal_sentence("events", &message);
                        return this.report(News::DeliveryOver(Some(sentence)));
                    }
                }
            }
            this.report(News::DeliveryOver(None));
        });
    }
}

/// When the server stored an entry, s since 1970.
pub fn unix_s(entry: &Entry) -> f64 {
    entry.created.unix_timestamp_nanos() as f64 / 1e9
}

/// The claim in an entry; none where it was deleted.
pub(crate) fn claim_of(entry: Option<Entry>) -> Found {
    match entry {
        Some(entry) if entry.operation == Operation::Put => {
            let claim = decode::<Claim>(&entry.value).map_err(|_| Unread::Foreign)?;
            Ok(Some((Box::new(claim), entry.revision)))
        }
        _ => Ok(None),
    }
}

/// The fragment in an entry; none where it was deleted, is of another version, or not what its hash says.
pub fn published(entry: Entry) -> Option<Published> {
    if entry.operation != Operation::Put {
        return None;
    }
    let (target, by) = Target::of_config_key(&entry.key)?;
    let fragment = decode::<Fragment>(&entry.value).ok()?;
    let sound = fragment.text.len() <= FRAGMENT_MAX && sha256(&fragment.text) == fragment.sha256;
    sound.then_some(Published { target, by, revision: entry.revision, fragment })
}

/// All entries of a bucket under a pattern; none after a silence without any.
///
/// # Errors
/// What the server says, or that it went silent before the last of them.
pub async fn entries(store: &Store, pattern: &str) -> Result<Vec<Entry>, String> {
    let mut watch = store.watch_with_history(pattern).await.map_err(|error| error.to_string())?;
    let (mut found, mut more) = (Vec::new(), 0);
    while let Ok(Some(entry)) = timeout(SILENT, watch.next()).await {
        let entry = entry.map_err(|error| error.to_string())?;
        more = entry.delta;
        if entry.operation == Operation::Put {
            found.push(entry);
        }
        if more == 0 {
            break;
        }
    }
    match more {
        0 => Ok(found),
        _ => Err(format!("the server went silent; {more} entries under {pattern} did not come")),
    }
}

/// A refusal of the server in words that say what to do.
pub fn refusal_sentence(about: &str, text: &str) -> String {
    let lower = text.to_lowercase();
    let full =
        ["maximum bytes", "maximum messages", "insufficient storage", "resources exceeded", "no space"];
    if full.iter().any(|words| lower.contains(words)) {
        return format!(
            "the server has no room left for {about} ({text}); enlarge the stream or let cells work jobs off, \
             nothing that was accepted is lost"
        );
    }
    if lower.contains("permission") {
        return format!(
            "the server's permissions do not let this user write {about} ({text}); see docs/fleet.md"
        );
    }
    format!("the server did not take {about}: {text}")
}

fn foreign_sentence(job: &str) -> String {
    format!(
        "the claim of job {job} is not of this version of celld ({VERSION}) or cannot be read, and is left as it \
         is: this cell does not begin the job, and a message of it goes back into its queue for {} s, for a cell \
         of that version; run the same version in all cells, or take the job back (`celld fleet cancel`)",
        OTHER_VERSION.as_secs()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_stream_says_what_to_do() {
        let text = refusal_sentence("queue", "publish failed: maximum bytes exceeded");
        assert!(
            text.contains("no room left for queue") && text.contains("nothing that was accepted is lost")
        );
        assert!(refusal_sentence("claims", "timed out").starts_with("the server did not take claims"));
    }
}
