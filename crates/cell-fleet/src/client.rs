//! What a person at a terminal does with a fleet: submit, look, cancel, give away, agree.
//!
//! In: how to reach the server, the person's name, which is a token of every subject they publish to. Out:
//! answers, lists, or a sentence. Nothing here decides about a job: it writes what the person wants, and the
//! cells do it.

use crate::connect::{ANSWER_WITHIN, Access, ConnectFault, connect};
use crate::files::FileKind;
use crate::network::{entries, refusal_sentence, unix_s};
use crate::payloads::{
    Answer, CellState, Claim, ClaimState, Event, Job, Refusal, Request, VERSION, Wish, decode, encode,
};
use crate::server::{Server, Storage, open};
use crate::subjects::{Fleet, Key, Lane, RequestKind};
use crate::words::unix_s_of;
use async_nats::Client as Connection;
use async_nats::jetstream::consumer::{DeliverPolicy, pull};
use async_nats::jetstream::kv::Entry;
use async_nats::jetstream::message::PublishMessage;
use futures_util::StreamExt;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc::{self, UnboundedReceiver};
use tokio::time::timeout;

/// Longer than a cell takes to answer an order: the arm may have to stop first.
const ORDER_WITHIN: Duration = Duration::from_secs(20);

/// While an answer is awaited, how often it is looked whether one will come.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A large recording over a slow network.
const FILES_WITHIN: Duration = Duration::from_secs(600);

/// A person's connection to a fleet.
pub struct Client {
    pub(crate) fleet: Fleet,
    pub(crate) user: String,
    pub(crate) connection: Connection,
    pub(crate) server: Server,
    /// What the connection says by itself, such as that something is not permitted.
    said: Mutex<UnboundedReceiver<async_nats::Event>>,
}

/// A cell with the age of its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: CellState,
    /// When the server stored it, s since 1970.
    pub unix_s: f64,
}

/// What is known of one job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Story {
    /// Its claim, if a cell or the fleet has decided something.
    pub claim: Option<Claim>,
    /// The cells that refused it: epoch and reason.
    pub refusals: BTreeMap<String, (u32, String)>,
    /// Persons who want it cancelled.
    pub cancelled_by: Vec<String>,
    /// What happened, in the order of its storing.
    pub events: Vec<Event>,
}

pub(crate) fn text(error: impl ToString) -> String {
    error.to_string()
}

/// A cell by the entry of its state; one of another version says that it is.
pub(crate) fn shown(entry: Entry) -> Shown {
    let state = decode::<CellState>(&entry.value)
        .unwrap_or_else(|fault| CellState { message: fault.to_string(), ..CellState::default() });
    Shown { unix_s: unix_s(&entry), name: entry.key, state }
}

impl Client {
    /// Connects, and opens what the fleet has on the server.
    ///
    /// # Errors
    /// As [`connect`] and [`open`].
    pub async fn open(
        access: &Access,
        fleet: Fleet,
        user: &str,
        storage: Storage,
    ) -> Result<Client, ConnectFault> {
        let (events, said) = mpsc::unbounded_channel();
        let connection = connect(access, events).await?;
        let server = open(&connection, access.domain.as_deref(), &fleet, storage).await?;
        Ok(Client { fleet, user: user.to_string(), connection, server, said: Mutex::new(said) })
    }

    /// What the server has said about permissions since the last look.
    fn refused(&self) -> Option<String> {
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let mut refused = None;
        while let Ok(event) = said.try_recv() {
            if let async_nats::Event::ServerError(error) = event {
                let text = error.to_string();
                if text.to_lowercase().contains("permission") {
                    refused = Some(text);
                }
            }
        }
        refused
    }

    /// Waits for an answer about something. What the server does not permit it leaves unanswered, and says
    /// so beside: then nothing is waited for.
    ///
    /// # Errors
    /// It is not permitted.
    pub(crate) async fn permitted<T>(&self, about: &str, work: impl Future<Output = T>) -> Result<T, String> {
        // Of an earlier request, perhaps.
        self.refused();
        let mut work = std::pin::pin!(work);
        loop {
            match timeout(LOOK_EVERY, &mut work).await {
                Ok(answer) => return Ok(answer),
                Err(_) => {
                    if let Some(text) = self.refused() {
                        return Err(refusal_sentence(about, &text));
                    }
                }
            }
        }
    }

    /// The fleet's name.
    pub fn fleet_name(&self) -> &str {
        self.fleet.name()
    }

    /// Puts a job into a queue; false when the same one is there already.
    ///
    /// # Errors
    /// It is too large or malformed, its id is in use, or the server does not take it.
    pub async fn submit(&self, job: &Job, lane: &Lane) -> Result<bool, String> {
        job.check().map_err(text)?;
        let bytes = encode(job).map_err(text)?;
        if let Some((claim, _)) = self.claim(&job.id).await? {
            return match claim.job.sha256 == job.sha256 {
                true => Err(format!(
                    "job {} was submitted before and is {}; a job has one id: give it another, or see \
                     `celld fleet why {}`",
                    job.id,
                    claim.state.as_str(),
                    job.id
                )),
                false => Err(format!("another job has the id {}; choose another", job.id)),
            };
        }
        let subject = self.fleet.job(lane, &self.user);
        let message = PublishMessage::build().message_id(job.message_id()).payload(bytes.into());
        let sent = async {
            let stored = self.server.context.send_publish(subject, message).await.map_err(text)?;
            stored.await.map_err(text)
        };
        match self.permitted("the queue", timeout(ANSWER_WITHIN, sent)).await? {
            Ok(Ok(stored)) => Ok(!stored.duplicate),
            Ok(Err(message)) => Err(refusal_sentence("the queue", &message)),
            Err(_) => Err(format!(
                "the server did not answer; submit the job again with `id: {}` in its file: under this id it is \
                 not taken twice",
                job.id
            )),
        }
    }

    /// What has become of a job, if a cell or the fleet has decided something.
    ///
    /// # Errors
    /// What the server says.
    pub async fn claim_of(&self, job: &str) -> Result<Option<Claim>, String> {
        Ok(self.claim(job).await?.map(|(claim, _)| claim))
    }

    async fn claim(&self, job: &str) -> Result<Option<(Claim, u64)>, String> {
        let entry = self.server.claims.entry(Key::claim(job).to_string()).await.map_err(text)?;
        let put = entry.filter(|entry| entry.operation == async_nats::jetstream::kv::Operation::Put);
        put.map(|entry| Ok((decode::<Claim>(&entry.value).map_err(text)?, entry.revision))).transpose()
    }

    /// All cells, with the age of what is known of them.
    ///
    /// # Errors
    /// What the server says.
    pub async fn cells(&self) -> Result<Vec<Shown>, String> {
        let mut cells: Vec<Shown> = entries(&self.server.cells, ">").await?.into_iter().map(shown).collect();
        cells.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(cells)
    }

    /// The server's time, s since 1970: by it count the ages of what it stores, whatever our clock says.
    ///
    /// # Errors
    /// It does not say, or not in time.
    pub async fn server_unix_s(&self) -> Result<f64, String> {
        let what = format!("STREAM.INFO.{}", self.fleet.events_stream());
        let answer = timeout(ANSWER_WITHIN, self.server.context.request(what, &())).await;
        let answer: serde_json::Value = answer.map_err(text)?.map_err(text)?;
        let time = answer.get("ts").and_then(serde_json::Value::as_str);
        time.and_then(unix_s_of).ok_or_else(|| "the server does not say what time it is".to_string())
    }

    /// All claims, the newest last.
    ///
    /// # Errors
    /// What the server says.
    pub async fn claims(&self) -> Result<Vec<Claim>, String> {
        let found = entries(&self.server.claims, Key::CLAIMS).await?;
        let mut claims: Vec<Claim> =
            found.iter().filter_map(|entry| decode::<Claim>(&entry.value).ok()).collect();
        claims.sort_by(|a, b| a.job.submitted_unix_s.total_cmp(&b.job.submitted_unix_s));
        Ok(claims)
    }

    /// How many jobs no cell has taken yet, by lane as the subject has it.
    ///
    /// # Errors
    /// What the server says.
    pub async fn queued(&self) -> Result<BTreeMap<String, usize>, String> {
        let mut info = self.server.jobs.info_with_subjects(self.fleet.all_jobs()).await.map_err(text)?;
        let mut lanes = BTreeMap::new();
        while let Some(subject) = info.next().await {
            let (subject, count) = subject.map_err(text)?;
            if let Ok(read) = self.fleet.read_job(&subject) {
                let lane = format!("{} {}", read.lane.target, read.lane.priority.as_str());
                *lanes.entry(lane).or_default() += count;
            }
        }
        Ok(lanes)
    }

    /// Everything about one job.
    ///
    /// # Errors
    /// What the server says.
    pub async fn why(&self, job: &str) -> Result<Story, String> {
        let claim = self.claim(job).await?.map(|(claim, _)| claim);
        let mut story =
            Story { claim, refusals: BTreeMap::new(), cancelled_by: Vec::new(), events: Vec::new() };
        for entry in entries(&self.server.claims, "refusal.>").await? {
            if let Some(Key::Refusal { job: of, cell }) = Key::of(&entry.key)
                && of == job
                && let Ok(refusal) = decode::<Refusal>(&entry.value)
            {
                story.refusals.insert(cell, (refusal.epoch, refusal.reason));
            }
        }
        for entry in entries(&self.server.claims, "cancel.>").await? {
            if let Some(Key::Cancel { job: of, by }) = Key::of(&entry.key)
                && of == job
            {
                story.cancelled_by.push(by);
            }
        }
        let of_job = |event: &Event| event.job.as_deref() == Some(job);
        story.events = self.events().await?.into_iter().filter(of_job).collect();
        Ok(story)
    }

    /// All events that the server has.
    ///
    /// # Errors
    /// What the server says.
    pub async fn events(&self) -> Result<Vec<Event>, String> {
        let mut info = self.server.events.clone();
        let left = info.info().await.map_err(text)?.state.messages;
        let mut found = Vec::new();
        if left == 0 {
            return Ok(found);
        }
        let mut messages = self.follow_from(DeliverPolicy::All).await?;
        while let Ok(Some(event)) = timeout(ANSWER_WITHIN, messages.next()).await {
            let (event, pending) = event?;
            found.extend(event);
            if pending == 0 {
                break;
            }
        }
        Ok(found)
    }

    /// Events as they come, from now on; with each, how many more are there already.
    ///
    /// # Errors
    /// What the server says.
    pub async fn watch(&self) -> Result<EventStream, String> {
        self.follow_from(DeliverPolicy::New).await
    }

    async fn follow_from(&self, deliver_policy: DeliverPolicy) -> Result<EventStream, String> {
        let config = pull::OrderedConfig { deliver_policy, ..pull::OrderedConfig::default() };
        let consumer = self.server.events.create_consumer(config).await.map_err(text)?;
        let messages = consumer.messages().await.map_err(text)?;
        Ok(Box::pin(messages.map(|message| {
            let message = message.map_err(text)?;
            let pending = message.info().map_or(0, |info| info.pending);
            // Of another version: not for this reader.
            Ok((decode::<Event>(&message.payload).ok(), pending))
        })))
    }

    /// Says that a job is not wanted any more.
    ///
    /// # Errors
    /// The job is over, or the server does not take it.
    pub async fn cancel(&self, job: &str) -> Result<String, String> {
        let claim = self.claim(job).await?.map(|(claim, _)| claim);
        let said = match claim.as_ref().map(|claim| claim.state) {
            Some(ClaimState::Ended | ClaimState::Cancelled) => {
                return Err(format!("job {job} is over already; see `celld fleet why {job}`"));
            }
            Some(ClaimState::Begun | ClaimState::Claimed) => {
                let cell = claim.map(|claim| claim.cell).unwrap_or_default();
                format!("cell {cell} has the job and gives it up after the present pick-n-place")
            }
            Some(ClaimState::Offered | ClaimState::Aside) | None => {
                format!("no cell has begun the job; the fleet is to drop it, see `celld fleet why {job}`")
            }
        };
        let key = Key::Cancel { job: job.to_string(), by: self.user.clone() };
        self.wish(&key, &self.wish_now()).await?;
        Ok(said)
    }

    /// Takes a cell out of the fleet that does not come back: it is not waited for any more with jobs that
    /// all others refuse. One that is there shows itself again.
    ///
    /// # Errors
    /// There is no such cell, or the server does not take it.
    pub async fn forget(&self, cell: &str) -> Result<(), String> {
        if !self.cells().await?.iter().any(|shown| shown.name == cell) {
            return Err(format!("no cell {cell} is in the fleet"));
        }
        match self.permitted("the cells", timeout(ANSWER_WITHIN, self.server.cells.delete(cell))).await? {
            Ok(deleted) => deleted.map_err(text),
            Err(_) => Err("the server did not answer; try again".to_string()),
        }
    }

    /// Gives a job to another cell, or to whichever takes it. `seen_to`: the person has looked at the table
    /// of the cell that had begun it; without, a job that is begun, now or by the time of the decision,
    /// stays where it is.
    ///
    /// # Errors
    /// Nothing is known of the job, it was done or begun, or the server does not take it.
    pub async fn give(&self, job: &str, target: Option<String>, seen_to: bool) -> Result<Claim, String> {
        let unknown =
            || format!("no cell has taken job {job} yet; it waits in its queue, or there is no such job");
        let (claim, _) = self.claim(job).await?.ok_or_else(unknown)?;
        if claim.job.text.is_empty() {
            return Err(format!("job {job} is {} and cannot be given", claim.state.as_str()));
        }
        if matches!(claim.state, ClaimState::Begun | ClaimState::Ended) && !seen_to {
            let cell = &claim.cell;
            return Err(format!(
                "cell {cell} has begun job {job}, and its objects are on that table; when the table of {cell} was \
                 seen to, add --yes"
            ));
        }
        let key = Key::Give { job: job.to_string(), by: self.user.clone() };
        let wish = Wish { epoch: claim.job.epoch, target, begun: seen_to, ..self.wish_now() };
        self.wish(&key, &wish).await?;
        Ok(claim)
    }

    fn wish_now(&self) -> Wish {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let unix_s = now.map_or(0.0, |since| since.as_secs_f64());
        Wish { version: VERSION, epoch: 0, target: None, begun: false, unix_s }
    }

    async fn wish(&self, key: &Key, wish: &Wish) -> Result<(), String> {
        let bytes = encode(wish).map_err(text)?;
        let put = timeout(ANSWER_WITHIN, self.server.claims.put(key.to_string(), bytes.into()));
        match self.permitted("the wish", put).await? {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(refusal_sentence("the wish", &error.to_string())),
            Err(_) => Err("the server did not answer; try again".to_string()),
        }
    }

    /// Sends a request to a cell and waits for what it decides; `plan` is the number of the plan to approve.
    ///
    /// # Errors
    /// The cell is not there, or its answer is not readable.
    pub async fn request(
        &self,
        cell: &str,
        requested: RequestKind,
        job: &str,
        plan: Option<u64>,
    ) -> Result<Answer, String> {
        let request = Request { version: VERSION, job: job.to_string(), plan, files: Vec::new() };
        self.send_request(cell, requested, &request, ORDER_WITHIN).await
    }

    /// Requests that a cell puts files of a job into the object store; their names are in the answer.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub async fn request_for_files(
        &self,
        cell: &str,
        job: &str,
        kinds: &[FileKind],
    ) -> Result<Answer, String> {
        let files = kinds.iter().map(|kind| kind.as_str().to_string()).collect();
        let request = Request { version: VERSION, job: job.to_string(), plan: None, files };
        self.send_request(cell, RequestKind::Send, &request, FILES_WITHIN).await
    }

    async fn send_request(
        &self,
        cell: &str,
        requested: RequestKind,
        request: &Request,
        within: Duration,
    ) -> Result<Answer, String> {
        let bytes = encode(request).map_err(text)?;
        let subject = self.fleet.request(cell, requested, &self.user);
        let request = async_nats::Request::new().payload(bytes.into()).timeout(Some(within));
        let answer = self.permitted("to cells", self.connection.send_request(subject, request)).await?;
        let answer = answer.map_err(|error| {
            format!("cell {cell} does not answer ({error}); nothing is known of the order")
        })?;
        decode(&answer.payload).map_err(text)
    }
}

/// Events, each with how many more are there already.
pub type EventStream =
    std::pin::Pin<Box<dyn futures_util::Stream<Item = Result<(Option<Event>, u64), String>> + Send>>;
