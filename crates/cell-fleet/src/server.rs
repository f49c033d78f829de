//! What a fleet has on the server: two streams and three buckets, made if missing and checked if not.
//!
//! In: a client, the fleet, how much may be stored. Out: their handles. The stream of jobs is a work queue:
//! each message goes to one consumer and is gone once it is settled; full, it refuses what is new, so that a
//! submission fails loudly and nothing that was accepted is dropped. Events are kept by age and size.

use crate::connect::{ANSWER_WITHIN, ConnectFault, check_version};
use crate::payloads::PAYLOAD_MAX;
use crate::subjects::{Fleet, Lane};
use async_nats::Client;
use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::context::{CreateStreamErrorKind, GetStreamErrorKind};
use async_nats::jetstream::stream::{Config, DiscardPolicy, RetentionPolicy, StorageType, Stream};
use async_nats::jetstream::{self, Context, kv};
use std::time::Duration;

/// How much the server stores for a fleet, and on how many of its nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Storage {
    /// Nodes of a cluster that hold each message: 1, 3 or 5.
    pub replicas: usize,
    /// Bytes of jobs that wait.
    pub jobs_bytes: i64,
    /// Bytes of events.
    pub events_bytes: i64,
    /// Bytes of claims.
    pub claims_bytes: i64,
}

impl Storage {
    /// One node; sizes for 10,000 jobs a day.
    pub const USUAL: Storage =
        Storage { replicas: 1, jobs_bytes: 256 << 20, events_bytes: 2 << 30, claims_bytes: 1 << 30 };
}

/// A second submission is known by its id for so long; after that by its claim.
const DUPLICATES: Duration = Duration::from_secs(3600);

const EVENTS_AGE: Duration = Duration::from_secs(90 * 86_400);

/// What has become of a job is known for so long.
const CLAIMS_AGE: Duration = Duration::from_secs(90 * 86_400);

/// Jobs that are with cells or wait for their time, of one lane.
const OPEN_MOST: i64 = 100_000;

/// Cells that wait at one lane.
const WAITING_MOST: i64 = 4096;

/// A fleet's streams and buckets.
#[derive(Clone, Debug)]
pub struct Server {
    /// To publish and to request.
    pub context: Context,
    /// The queue.
    pub jobs: Stream,
    /// What happened.
    pub events: Stream,
    /// Claims, refusals and wishes.
    pub claims: kv::Store,
    /// The cells' states.
    pub cells: kv::Store,
    /// Configuration fragments.
    pub config: kv::Store,
}

fn store_fault(what: &str, message: impl ToString) -> ConnectFault {
    ConnectFault::Store { what: what.to_string(), message: message.to_string() }
}

/// Opens what a fleet has on a server, in a JetStream domain if one is named, and makes what is missing.
///
/// # Errors
/// The server is too old, has no JetStream, or a stream is missing and may not be made, or is another kind.
pub async fn open(
    client: &Client,
    domain: Option<&str>,
    fleet: &Fleet,
    storage: Storage,
) -> Result<Server, ConnectFault> {
    let info = client.server_info();
    check_version(&info.version)?;
    let mut context = match domain {
        Some(domain) => jetstream::with_domain(client.clone(), domain),
        None => jetstream::new(client.clone()),
    };
    context.set_timeout(ANSWER_WITHIN);
    context
        .query_account()
        .await
        .map_err(|error| ConnectFault::NoJetStream { message: error.to_string() })?;
    // At once: after the server's return all cells of a fleet do this, and each answer takes its time.
    let (jobs, events, claims, cells, config) = tokio::try_join!(
        stream(&context, jobs_config(fleet, storage)),
        stream(&context, events_config(fleet, storage)),
        bucket(&context, claims_config(fleet, storage)),
        bucket(&context, cells_config(fleet, storage)),
        bucket(&context, fragments_config(fleet, storage)),
    )?;
    Ok(Server { context, jobs, events, claims, cells, config })
}

fn jobs_config(fleet: &Fleet, storage: Storage) -> Config {
    Config {
        name: fleet.jobs_stream(),
        description: Some("celld: jobs that wait for a cell".to_string()),
        subjects: vec![fleet.all_jobs()],
        retention: RetentionPolicy::WorkQueue,
        discard: DiscardPolicy::New,
        max_bytes: storage.jobs_bytes,
        max_message_size: i32::try_from(PAYLOAD_MAX + 4096).unwrap_or(i32::MAX),
        storage: StorageType::File,
        num_replicas: storage.replicas,
        duplicate_window: DUPLICATES,
        ..Config::default()
    }
}

fn events_config(fleet: &Fleet, storage: Storage) -> Config {
    Config {
        name: fleet.events_stream(),
        description: Some("celld: what happened in the cells".to_string()),
        subjects: vec![fleet.all_events()],
        retention: RetentionPolicy::Limits,
        discard: DiscardPolicy::Old,
        max_bytes: storage.events_bytes,
        max_age: EVENTS_AGE,
        storage: StorageType::File,
        num_replicas: storage.replicas,
        duplicate_window: DUPLICATES,
        ..Config::default()
    }
}

fn claims_config(fleet: &Fleet, storage: Storage) -> kv::Config {
    kv::Config {
        bucket: fleet.claims_bucket(),
        description: "celld: who has which job, and what became of it".to_string(),
        history: 1,
        max_age: CLAIMS_AGE,
        max_bytes: storage.claims_bytes,
        storage: StorageType::File,
        num_replicas: storage.replicas,
        ..kv::Config::default()
    }
}

fn cells_config(fleet: &Fleet, storage: Storage) -> kv::Config {
    kv::Config {
        bucket: fleet.cells_bucket(),
        description: "celld: the state of each cell".to_string(),
        history: 1,
        storage: StorageType::File,
        max_bytes: 64 << 20,
        num_replicas: storage.replicas,
        ..kv::Config::default()
    }
}

/// Versions of a fragment that one can go back to.
const FRAGMENTS_KEPT: i64 = 32;

fn fragments_config(fleet: &Fleet, storage: Storage) -> kv::Config {
    kv::Config {
        bucket: fleet.config_bucket(),
        description: "celld: parts of configurations that cells share".to_string(),
        history: FRAGMENTS_KEPT,
        storage: StorageType::File,
        max_bytes: 256 << 20,
        num_replicas: storage.replicas,
        ..kv::Config::default()
    }
}

/// The stream, made if it is missing. One that is there keeps its sizes, but must be the right kind.
async fn stream(context: &Context, config: Config) -> Result<Stream, ConnectFault> {
    let name = config.name.clone();
    let what = format!("stream {name}");
    let found = match context.get_stream(&name).await {
        Ok(found) => found,
        Err(error) if is_missing(error.kind()) => match context.create_stream(config.clone()).await {
            Ok(made) => made,
            // Another cell made it at this moment.
            Err(error) if is_there(&error.kind()) => {
                context.get_stream(&name).await.map_err(|error| store_fault(&what, error))?
            }
            Err(error) => return Err(store_fault(&what, error)),
        },
        Err(error) => return Err(store_fault(&what, error)),
    };
    let has = &found.cached_info().config;
    if has.retention != config.retention || has.subjects != config.subjects {
        let message = "is there with other subjects or another retention; it is none of this version of celld \
                       (docs/fleet.md says how to make room for it)";
        return Err(store_fault(&what, message));
    }
    Ok(found)
}

fn is_missing(kind: GetStreamErrorKind) -> bool {
    match kind {
        GetStreamErrorKind::JetStream(error) => error.error_code() == jetstream::ErrorCode::STREAM_NOT_FOUND,
        _ => false,
    }
}

fn is_there(kind: &CreateStreamErrorKind) -> bool {
    match kind {
        CreateStreamErrorKind::JetStream(error) => {
            error.error_code() == jetstream::ErrorCode::STREAM_NAME_EXIST
        }
        _ => false,
    }
}

async fn bucket(context: &Context, config: kv::Config) -> Result<kv::Store, ConnectFault> {
    let (name, what) = (config.bucket.clone(), format!("bucket {}", config.bucket));
    if let Ok(found) = context.get_key_value(&name).await {
        return Ok(found);
    }
    match context.create_key_value(config).await {
        Ok(made) => Ok(made),
        Err(_) => context.get_key_value(&name).await.map_err(|error| store_fault(&what, error)),
    }
}

/// The consumer of a lane, made if it is missing; all cells of the lane share it.
///
/// # Errors
/// The server refuses it.
pub async fn consumer(
    jobs: &Stream,
    fleet: &Fleet,
    lane: &Lane,
    ack_wait: Duration,
) -> Result<PullConsumer, ConnectFault> {
    let name = lane.consumer();
    let config = pull::Config {
        durable_name: Some(name.clone()),
        filter_subject: fleet.lane_filter(lane),
        ack_policy: AckPolicy::Explicit,
        ack_wait,
        max_ack_pending: OPEN_MOST,
        max_waiting: WAITING_MOST,
        ..pull::Config::default()
    };
    let made = jobs.get_or_create_consumer(&name, config).await;
    made.map_err(|error| store_fault(&format!("consumer {name}"), error))
}
