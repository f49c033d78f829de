//! The recording of a run: one MCAP file that common viewers open, and that can be replayed.
//!
//! In: messages with the daemon's timestamps. Out: a chunked, zstd-compressed file. What people look at
//! (frames, scene, pictures, lens, joints, log) is in Foxglove's own schemas, from its published SDK; what
//! only celld knows (states, plans) is JSON with a schema of its own; what a replay needs is in the postcard
//! format (`cell-replay`), each piece as the bytes of a protobuf message: viewers report encodings that they
//! do not know as errors. A chunk ends on [`Recording::flush`]: after a crash the file can be read up to
//! there, and `repair` gives it the index that it lacks.

pub mod read;
pub mod repair;

use cell_values::time::Timestamp;
use foxglove::Encode;
use mcap::records::{MessageHeader, Metadata};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Why the recording could not be written. The run itself does not depend on it.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be created.
    #[error("create recording {path}")]
    Create {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
    /// Writing failed, mostly for want of space.
    #[error("write recording {path}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: mcap::McapError,
    },
}

/// The name of the metadata record that says which celld wrote the file.
pub const ABOUT: &str = "celld";

/// The clock's time of a message's time in a file that was made with this epoch.
pub fn log_time_at(epoch_unix_s: f64, log_time: u64) -> Timestamp {
    Timestamp::from_nanos(log_time.saturating_sub((epoch_unix_s.max(0.0) * 1e9) as u64))
}

/// A topic whose messages are JSON, and the properties of these beside `timestamp`.
pub struct JsonTopic {
    /// Where it is written.
    pub name: &'static str,
    /// The name of its schema.
    pub schema: &'static str,
    /// What its messages hold.
    pub properties: fn() -> Value,
}

/// An open recording. Dropping it without [`Recording::finish`] leaves a file without an index.
pub struct Recording {
    writer: mcap::Writer<BufWriter<File>>,
    path: PathBuf,
    epoch_unix_ns: u64,
    sequences: BTreeMap<u16, u32>,
}

impl Recording {
    /// Creates the file. `epoch_unix_s`: calendar time at the clock's epoch, so that viewers show dates.
    ///
    /// # Errors
    /// The file cannot be created ([`RecordingError::Create`]), or its header cannot be written
    /// ([`RecordingError::Write`]).
    pub fn create(path: &Path, epoch_unix_s: f64) -> Result<Recording, RecordingError> {
        let fail = |source| RecordingError::Create { path: path.to_owned(), source };
        // A link under this name is replaced, never followed.
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(fail(error)),
            _ => {}
        }
        let file = File::create_new(path).map_err(fail)?;
        let fail = |source| RecordingError::Write { path: path.to_owned(), source };
        let mut writer = options().create(BufWriter::new(file)).map_err(fail)?;
        let about = BTreeMap::from([
            ("version".to_string(), env!("CARGO_PKG_VERSION").to_string()),
            ("epoch_unix_s".to_string(), format!("{epoch_unix_s:.9}")),
        ]);
        writer.write_metadata(&Metadata { name: ABOUT.to_string(), metadata: about }).map_err(fail)?;
        let epoch_unix_ns = (epoch_unix_s.max(0.0) * 1e9) as u64;
        Ok(Recording { writer, path: path.to_owned(), epoch_unix_ns, sequences: BTreeMap::new() })
    }

    /// The time of a message in the file, ns since 1970.
    pub fn log_time(&self, at: Timestamp) -> u64 {
        self.epoch_unix_ns.saturating_add(at.nanos())
    }

    /// A message in one of Foxglove's schemas; its own timestamp is made with [`Recording::log_time`].
    ///
    /// # Errors
    /// The file cannot be written, mostly for want of space ([`RecordingError::Write`]).
    pub fn message<T: Encode>(
        &mut self,
        topic: &str,
        at: Timestamp,
        message: &T,
    ) -> Result<(), RecordingError> {
        let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(64));
        // Writing into memory cannot fail; a message that cannot be encoded is left out.
        let (Ok(()), Some(schema)) = (message.encode(&mut data), T::get_schema()) else { return Ok(()) };
        let schema = Schema { name: &schema.name, encoding: &schema.encoding, data: &schema.data };
        self.write(topic, &T::get_message_encoding(), Some(schema), at, &data)
    }

    /// A message of celld's own.
    ///
    /// # Errors
    /// As [`Recording::message`].
    pub fn json(
        &mut self,
        topic: &JsonTopic,
        at: Timestamp,
        mut message: Value,
    ) -> Result<(), RecordingError> {
        let log_time = self.log_time(at);
        let (sec, nsec) = (log_time / 1_000_000_000, log_time % 1_000_000_000);
        message["timestamp"] = json!({"sec": sec, "nsec": nsec});
        let schema = schema_text(topic);
        let schema = Some(Schema { name: topic.schema, encoding: "jsonschema", data: schema.as_bytes() });
        self.write(topic.name, "json", schema, at, message.to_string().as_bytes())
    }

    /// A piece for a replay, in the postcard format.
    ///
    /// # Errors
    /// As [`Recording::message`].
    pub fn piece(&mut self, topic: &str, at: Timestamp, bytes: &[u8]) -> Result<(), RecordingError> {
        static SCHEMA: LazyLock<Vec<u8>> = LazyLock::new(PieceMessage::schema);
        let schema = Some(Schema { name: PIECE, encoding: "protobuf", data: &SCHEMA });
        let message = PieceMessage { data: bytes.to_vec() };
        self.write(topic, "protobuf", schema, at, &message.encode_to_vec())
    }

    /// Closes the chunk: everything written so far can be read after a crash.
    ///
    /// # Errors
    /// As [`Recording::message`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(|source| RecordingError::Write { path: self.path.clone(), source })
    }

    /// Writes index and summary and closes the file.
    ///
    /// # Errors
    /// As [`Recording::message`]; the file then has no index.
    pub fn finish(mut self) -> Result<PathBuf, RecordingError> {
        let finished = self.writer.finish();
        finished.map_err(|source| RecordingError::Write { path: self.path.clone(), source })?;
        Ok(self.path)
    }

    fn write(
        &mut self,
        topic: &str,
        encoding: &str,
        schema: Option<Schema>,
        at: Timestamp,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let log_time = self.log_time(at);
        self.write_message(topic, encoding, schema, log_time, data)
            .map_err(|source| RecordingError::Write { path: self.path.clone(), source })
    }

    fn write_message(
        &mut self,
        topic: &str,
        encoding: &str,
        schema: Option<Schema>,
        log_time: u64,
        data: &[u8],
    ) -> Result<(), mcap::McapError> {
        // 0 is the format's word for no schema.
        let schema = schema.map_or(Ok(0), |of| self.writer.add_schema(of.name, of.encoding, of.data))?;
        let channel_id = self.writer.add_channel(schema, topic, encoding, &BTreeMap::new())?;
        let sequence = self.sequences.entry(channel_id).or_insert(0);
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence: *sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data)
    }
}

/// Name of the schema of pieces.
const PIECE: &str = "celld.Piece";

/// A piece of a replay in its envelope.
#[derive(Clone, PartialEq, prost::Message)]
struct PieceMessage {
    #[prost(bytes = "vec", tag = "1")]
    data: Vec<u8>,
}

impl PieceMessage {
    /// Its description, as a file of it has it.
    fn schema() -> Vec<u8> {
        let text = |text: &str| Some(text.to_string());
        let data = FieldDescriptorProto {
            name: text("data"),
            number: Some(1),
            label: Some(Label::Optional as i32),
            r#type: Some(Type::Bytes as i32),
            ..FieldDescriptorProto::default()
        };
        let piece = DescriptorProto { name: text("Piece"), field: vec![data], ..DescriptorProto::default() };
        let file = FileDescriptorProto {
            name: text("celld.proto"),
            package: text("celld"),
            message_type: vec![piece],
            syntax: text("proto3"),
            ..FileDescriptorProto::default()
        };
        FileDescriptorSet { file: vec![file] }.encode_to_vec()
    }
}

/// The bytes of a piece out of a message; files of earlier celld have it without an envelope.
fn piece_in<'a>(schema: Option<&str>, data: &'a [u8]) -> Cow<'a, [u8]> {
    match schema {
        Some(PIECE) => Cow::Owned(PieceMessage::decode(data).map(|piece| piece.data).unwrap_or_default()),
        _ => Cow::Borrowed(data),
    }
}

/// What describes the messages of a topic.
#[derive(Clone, Copy)]
struct Schema<'a> {
    name: &'a str,
    encoding: &'a str,
    data: &'a [u8],
}

/// How files of celld are written.
fn options() -> mcap::WriteOptions {
    mcap::WriteOptions::new()
        .compression(Some(mcap::Compression::Zstd))
        // One thread: a pool of its own would compete with the planner for no gain at these rates.
        .compression_threads(0)
        .profile("celld")
        .library(concat!("celld ", env!("CARGO_PKG_VERSION")))
}

fn schema_text(topic: &JsonTopic) -> String {
    let mut properties = (topic.properties)();
    properties["timestamp"] = json!({"type": "object", "title": "time", "properties": {
        "sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}}});
    json!({"title": topic.schema, "type": "object", "properties": properties}).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_is_read_with_and_without_its_envelope() {
        let enveloped = PieceMessage { data: vec![1, 2, 3] }.encode_to_vec();
        assert_eq!(*piece_in(Some(PIECE), &enveloped), [1, 2, 3]);
        assert_eq!(*piece_in(None, &[1, 2, 3]), [1, 2, 3], "of an earlier celld");
        assert_eq!(*piece_in(Some(PIECE), &[0x0a, 9, 1]), [0; 0], "damaged");
    }
}
