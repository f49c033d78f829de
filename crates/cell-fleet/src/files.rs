//! Files of a job in the server's object store: a cell puts them there when a person requests them.
//!
//! In: files on the cell's disk or made for it. Out: objects `CELL/JOB/NAME` in the bucket
//! `celld-FLEET-files`, kept for a week. A name is one plain token and no path.

use crate::network::refusal_sentence;
use crate::subjects::Fleet;
use async_nats::jetstream::Context;
use async_nats::jetstream::object_store::{Config, ObjectMetadata, ObjectStore};
use async_nats::jetstream::stream::StorageType;
use futures_util::StreamExt;
use std::fs::File;
use std::io::Read;
use std::path::PathBuf;
use std::pin::Pin;
use std::task::Poll;
use std::time::Duration;
use tokio::io::{AsyncRead, ReadBuf};

/// What is in the bucket is for who requested it.
const KEPT: Duration = Duration::from_secs(7 * 86_400);

/// Bytes of the bucket: with streams and buckets of the usual sizes below the 10 GB of docs/fleet.md. A
/// server sets them aside, and where its disk has less left the bucket is smaller, down to the second.
const BUCKET_BYTES: i64 = 4 << 30;
const BUCKET_BYTES_LEAST: i64 = 64 << 20;

/// Bytes of one file: a long recording.
pub const FILE_BYTES_MAX: u64 = 1 << 30;

/// What a file takes in the bucket beside its content, at most: its entry there.
const OVERHEAD: u64 = 16 * 1024;

/// Longest name of a file.
const FILE_NAME_MAX: usize = 200;

/// Read at once.
pub(crate) const CHUNK: usize = 128 * 1024;

/// What can be requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FileKind {
    /// The plan as a drawing.
    Plan,
    /// The table when the plan was made, and at the end.
    Pictures,
    /// The job's report, one page.
    Report,
    /// What the journal says of it.
    Result,
    /// Its recording, which may be large.
    Recording,
}

impl FileKind {
    /// All of them.
    pub const ALL: [FileKind; 5] =
        [FileKind::Plan, FileKind::Pictures, FileKind::Report, FileKind::Result, FileKind::Recording];

    /// The word.
    pub fn as_str(self) -> &'static str {
        match self {
            FileKind::Plan => "plan",
            FileKind::Pictures => "pictures",
            FileKind::Report => "report",
            FileKind::Result => "result",
            FileKind::Recording => "recording",
        }
    }

    /// The kind that a word names.
    pub fn of(word: &str) -> Option<FileKind> {
        FileKind::ALL.into_iter().find(|kind| kind.as_str() == word)
    }
}

/// Where a file's bytes are.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// In memory.
    Bytes(Vec<u8>),
    /// On the disk.
    File(PathBuf),
}

/// A file that is sent.
#[derive(Clone, Debug, PartialEq)]
pub struct FileToSend {
    /// One plain token, as [`is_file_name`] has it.
    pub name: String,
    /// Its bytes.
    pub content: Content,
}

/// A name that is no path: letters, digits, dots, dashes and underscores, no dot first.
pub fn is_file_name(name: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_');
    (1..=FILE_NAME_MAX).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(plain)
}

pub(crate) fn object_name(cell: &str, job: &str, name: &str) -> String {
    format!("{cell}/{job}/{name}")
}

async fn bucket(context: &Context, fleet: &Fleet, replicas: usize) -> Result<ObjectStore, String> {
    let name = fleet.files_bucket();
    if let Ok(found) = context.get_object_store(&name).await {
        return Ok(found);
    }
    let mut bytes = BUCKET_BYTES;
    loop {
        let config = Config {
            bucket: name.clone(),
            description: Some("celld: files of jobs that a person asked for".to_string()),
            max_age: KEPT,
            max_bytes: bytes,
            storage: StorageType::File,
            num_replicas: replicas,
            ..Config::default()
        };
        let fault = match context.create_object_store(config).await {
            Ok(made) => return Ok(made),
            Err(error) => refusal_sentence("files", &error.to_string()),
        };
        // Another cell made it at this moment.
        if let Ok(found) = context.get_object_store(&name).await {
            return Ok(found);
        }
        if !is_full(&fault) || bytes <= BUCKET_BYTES_LEAST {
            return Err(fault);
        }
        bytes /= 2;
    }
}

/// A reader that reads where it is called: on a thread that has nothing else to do.
struct Blocking<R>(R);

impl<R: Read + Unpin> AsyncRead for Blocking<R> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut std::task::Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        let mut bytes = vec![0; buffer.remaining().min(CHUNK)];
        Poll::Ready(
            self.0.read(&mut bytes).map(|count| buffer.put_slice(bytes.get(..count).unwrap_or_default())),
        )
    }
}

/// Puts files into the store, on the thread that calls; their names come back.
///
/// # Errors
/// A file that cannot be read or is too large, or what the server says.
pub async fn send(
    context: &Context,
    fleet: &Fleet,
    replicas: usize,
    [cell, job]: [&str; 2],
    files: Vec<FileToSend>,
) -> Result<Vec<String>, String> {
    let store = bucket(context, fleet, replicas).await?;
    fits(context, fleet, &store, &files).await?;
    let mut sent = Vec::new();
    for FileToSend { name, content } in files {
        let object = object_name(cell, job, &name);
        let put = match put(&store, &object, &content).await {
            Err(fault) if is_full(&fault) && make_room(&store).await => put(&store, &object, &content).await,
            put => put,
        };
        put.map_err(|fault| format!("{name}: {fault}"))?;
        sent.push(name);
    }
    Ok(sent)
}

/// Makes room for files that are requested together. What does not fit is not begun: the parts that had come
/// would stay in the bucket, and no name would lead to them.
async fn fits(
    context: &Context,
    fleet: &Fleet,
    store: &ObjectStore,
    files: &[FileToSend],
) -> Result<(), String> {
    let mut needed = 0;
    for FileToSend { name, content } in files {
        let size = match content {
            Content::Bytes(bytes) => bytes.len() as u64,
            Content::File(path) => std::fs::metadata(path).map_err(|error| format!("{name}: {error}"))?.len(),
        };
        if size > FILE_BYTES_MAX {
            return Err(format!(
                "{name}: {size} bytes are more than the fleet carries; fetch it at the cell"
            ));
        }
        // Each part has a heading of its own.
        needed += size + size / 64 + OVERHEAD;
    }
    loop {
        let stream = context.get_stream(format!("OBJ_{}", fleet.files_bucket())).await;
        let stream = stream.map_err(|error| refusal_sentence("files", &error.to_string()))?;
        let info = stream.cached_info();
        let room = u64::try_from(info.config.max_bytes).unwrap_or(u64::MAX);
        if needed > room {
            let [all, most] = [needed, room].map(|bytes| bytes.div_ceil(1_000_000));
            return Err(format!(
                "{all} MB, and the server keeps {most} MB of files at most; request fewer at once, or fetch it \
                 at the cell"
            ));
        }
        if info.state.bytes + needed <= room {
            return Ok(());
        }
        if !make_room(store).await {
            let why = "parts of files that broke off fill the server's room; they leave after a week";
            return Err(format!("{why}, or with `nats object del`"));
        }
    }
}

async fn put(store: &ObjectStore, object: &str, content: &Content) -> Result<(), String> {
    let meta = ObjectMetadata { name: object.to_string(), ..ObjectMetadata::default() };
    let put = match content {
        Content::Bytes(bytes) => store.put(meta, &mut Blocking(bytes.as_slice())).await,
        Content::File(path) => {
            let file = File::open(path).map_err(|error| error.to_string())?;
            let size = file.metadata().map_err(|error| error.to_string())?.len();
            if size > FILE_BYTES_MAX {
                return Err(format!("{size} bytes are more than the fleet carries; fetch it at the cell"));
            }
            // One that still grows is sent as far as it is now.
            store.put(meta, &mut Blocking(file.take(size))).await
        }
    };
    put.map(drop).map_err(|error| refusal_sentence("files", &error.to_string()))
}

fn is_full(fault: &str) -> bool {
    fault.contains("no room left")
}

/// Removes the older half of what others have requested: it can be requested again. False where nothing
/// went.
async fn make_room(store: &ObjectStore) -> bool {
    let Ok(list) = store.list().await else { return false };
    let mut objects: Vec<_> = list.filter_map(|object| std::future::ready(object.ok())).collect().await;
    objects.sort_by_key(|object| object.modified);
    let mut removed = false;
    for object in objects.iter().take(objects.len().div_ceil(2)) {
        removed |= store.delete(&object.name).await.is_ok();
    }
    removed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_no_path() {
        for name in ["plan.svg", "a-1_b.mcap", &"a".repeat(200)] {
            assert!(is_file_name(name), "{name}");
        }
        for name in ["", ".", "..", "../x", "a/b", ".x", "a b", "a\0", "ä", &"a".repeat(201)] {
            assert!(!is_file_name(name), "{name:?}");
        }
        assert!(FileKind::ALL.into_iter().all(|kind| FileKind::of(kind.as_str()) == Some(kind)));
    }
}
