//! What a cell follows on the server: wishes of persons, refusals, its own state, shared configuration, the
//! one cell whose absence matters to it, and as steward all claims and all cells.
//!
//! In: buckets. Out: what changes in them, as [`News`]. A watch that cannot begin, or that ends, is begun
//! again; meanwhile a sentence says what is not seen.

use crate::network::{Network, News, SILENT, claim_of, entries, published, unix_s};
use crate::payloads::{CellState, Refusal, Wish, decode};
use crate::subjects::Key;
use crate::values::Input;
use async_nats::jetstream::kv::{Entry, Operation, Watch};
use futures_util::StreamExt;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::error::Elapsed;
use tokio::time::{sleep, timeout};

/// A watch that could not begin, or that has ended, is begun again after this.
const AGAIN: Duration = Duration::from_secs(5);

/// A watch that has not begun by then has no answer.
const BEGINS_WITHIN: Duration = Duration::from_secs(15);

/// What is followed, in complaints.
const ALL_CLAIMS: &str = "the claims of all cells";
const ALL_CELLS: &str = "the other cells";
const ONE_CELL: &str = "a cell before this one";

/// What a cell follows for a while; it ends with this.
#[derive(Default)]
pub struct Followed {
    all: Vec<JoinHandle<()>>,
    one: Option<JoinHandle<()>>,
}

impl Followed {
    /// All claims and all cells from now on, or no longer. The names of the complaints that are over.
    pub fn all(&mut self, network: &Network, on: bool) -> [&'static str; 2] {
        let following = if on { network.follow().into() } else { Vec::new() };
        std::mem::replace(&mut self.all, following).iter().for_each(JoinHandle::abort);
        [ALL_CLAIMS, ALL_CELLS]
    }

    /// This one cell, and no other one. The name of the complaint that is over.
    pub fn one(&mut self, network: &Network, cell: Option<String>) -> &'static str {
        let following = cell.map(|cell| network.follow_one(cell));
        if let Some(before) = std::mem::replace(&mut self.one, following) {
            before.abort();
        }
        ONE_CELL
    }
}

impl Drop for Followed {
    fn drop(&mut self) {
        self.all.iter().chain(&self.one).for_each(JoinHandle::abort);
    }
}

impl Network {
    /// Follows refusals, wishes, the own state and shared configuration from now on. A watch that cannot
    /// begin, or that ends, is begun again; meanwhile a sentence says what is not seen.
    pub fn watch(&self) -> [JoinHandle<()>; 3] {
        [
            self.again(|network| async move { network.watch_keys().await }),
            self.again(|network| async move {
                let own = network.cell.clone();
                network.watch_cells("the own state", &own).await;
            }),
            self.again(|network| async move { network.watch_fragments().await }),
        ]
    }

    fn follow(&self) -> [JoinHandle<()>; 2] {
        [
            self.again(|network| async move { network.watch_claims().await }),
            self.again(|network| async move { network.watch_cells(ALL_CELLS, ">").await }),
        ]
    }

    fn follow_one(&self, cell: String) -> JoinHandle<()> {
        self.again(move |network| {
            let cell = cell.clone();
            async move { network.watch_cells(ONE_CELL, &cell).await }
        })
    }

    /// Reads the states of all cells.
    pub fn list(&self) {
        let this = self.clone();
        self.spawn(async move {
            let listed = timeout(BEGINS_WITHIN, entries(&this.server.cells, ">")).await;
            let listed = listed.unwrap_or_else(|_| Err("no answer".to_string()));
            let fault = listed.as_ref().err().map(|text| format!("the cells could not be listed ({text})"));
            this.report(News::Complaint("the list of the cells", fault.unwrap_or_default()));
            let cells = listed.ok().map(|entries| {
                let cell = |entry: Entry| {
                    let (unix_s, state) = (unix_s(&entry), state_of(&entry));
                    (entry.key, state, unix_s)
                };
                entries.into_iter().map(cell).collect()
            });
            this.report(News::Input(Input::Cells(cells)));
        });
    }

    /// A watch that is begun again whenever it ends.
    fn again<F: Future<Output = ()> + Send>(
        &self,
        watch: impl Fn(Network) -> F + Send + 'static,
    ) -> JoinHandle<()> {
        let this = self.clone();
        tokio::spawn(async move {
            loop {
                watch(this.clone()).await;
                sleep(AGAIN).await;
            }
        })
    }

    async fn watch_keys(&self) {
        let watch = timeout(BEGINS_WITHIN, self.server.claims.watch_many_with_history(Key::WATCHED)).await;
        let Some(mut watch) = self.watched("orders from afar", watch) else { return };
        while let Some(entry) = watch.next().await {
            if let Some(input) = entry.ok().and_then(key_input) {
                self.report(News::Input(input));
            }
        }
        self.ended("orders from afar");
    }

    async fn watch_cells(&self, what: &'static str, pattern: &str) {
        let watch = timeout(BEGINS_WITHIN, self.server.cells.watch_with_history(pattern)).await;
        let Some(mut watch) = self.watched(what, watch) else { return };
        while let Some(entry) = watch.next().await {
            if let Ok(entry) = entry {
                self.cell(entry);
            }
        }
        self.ended(what);
    }

    async fn watch_fragments(&self) {
        let watch = timeout(BEGINS_WITHIN, self.server.config.watch_with_history(">")).await;
        let Some(watch) = self.watched("shared configuration", watch) else { return };
        let pass = |entry| {
            if let Some(published) = published(entry) {
                self.report(News::Fragment(Box::new(published)));
            }
        };
        self.pass_on("shared configuration", watch, pass, News::FragmentsKnown).await;
    }

    /// Passes entries on as they come, and `known` once all that there were have come: after the last of
    /// them, or a silence where there is none.
    async fn pass_on(&self, what: &'static str, mut watch: Watch, pass: impl Fn(Entry), known: News) {
        let mut known = Some(known);
        loop {
            let next = match known {
                None => Ok(watch.next().await),
                Some(_) => timeout(SILENT, watch.next()).await,
            };
            let last = match next {
                Ok(None) => return self.ended(what),
                Ok(Some(Err(_))) => false,
                Ok(Some(Ok(entry))) => {
                    let last = entry.delta == 0;
                    pass(entry);
                    last
                }
                Err(_) => true,
            };
            if let Some(known) = known.take_if(|_| last) {
                self.report(known);
            }
        }
    }

    /// A watch that has begun; a sentence where it could not, taken back where it could.
    fn watched<T, E: std::fmt::Display>(
        &self,
        what: &'static str,
        watch: Result<Result<T, E>, Elapsed>,
    ) -> Option<T> {
        let begun = match watch {
            Ok(Ok(watch)) => Ok(watch),
            Ok(Err(error)) => Err(error.to_string()),
            // A server does not answer what its permissions rule out.
            Err(_) => Err("no answer".to_string()),
        };
        let fault = begun.as_ref().err().map(|text| unseen_sentence(what, text));
        self.report(News::Complaint(what, fault.unwrap_or_default()));
        begun.ok()
    }

    fn ended(&self, what: &'static str) {
        self.report(News::Complaint(what, unseen_sentence(what, "the watch has ended")));
    }

    fn cell(&self, entry: Entry) {
        let unix_s = unix_s(&entry);
        let state = match entry.operation {
            Operation::Put => Some(state_of(&entry)),
            Operation::Delete | Operation::Purge => None,
        };
        if let Some(state) = state.as_ref().filter(|_| entry.key == self.cell) {
            self.report(News::Echo { stored_unix_s: unix_s, sent_unix_s: state.unix_s });
        }
        self.report(News::Input(Input::Cell { name: entry.key, state: state.map(Box::new), unix_s }));
    }

    async fn watch_claims(&self) {
        let watch = timeout(BEGINS_WITHIN, self.server.claims.watch_with_history(Key::CLAIMS)).await;
        let Some(watch) = self.watched(ALL_CLAIMS, watch) else { return };
        let pass = |entry| {
            let unix_s = unix_s(&entry);
            if let Ok(Some((claim, revision))) = claim_of(Some(entry)) {
                self.report(News::Input(Input::Claim { claim, revision, unix_s }));
            }
        };
        self.pass_on(ALL_CLAIMS, watch, pass, News::Input(Input::ClaimsKnown)).await;
    }
}

/// A state of another version is of a cell all the same.
fn state_of(entry: &Entry) -> CellState {
    decode::<CellState>(&entry.value).unwrap_or_default()
}

/// What an entry under a watched key says.
fn key_input(entry: Entry) -> Option<Input> {
    let put = entry.operation == Operation::Put;
    Some(match Key::of(&entry.key)? {
        Key::Claim { .. } => return None,
        Key::Refusal { job, cell } => {
            let refusal = decode::<Refusal>(&entry.value).ok().filter(|_| put);
            Input::Refused { job, cell, refusal: refusal.map(|refusal| (refusal.epoch, refusal.reason)) }
        }
        key => Input::Wish { key, wish: decode::<Wish>(&entry.value).ok().filter(|_| put) },
    })
}

/// What a person should know of a watch that is not there.
fn unseen_sentence(what: &str, text: &str) -> String {
    format!(
        "{what} cannot be followed, and what changes there is not seen ({text}); tried again every {} s, see \
         the permissions in docs/fleet.md",
        AGAIN.as_secs()
    )
}
