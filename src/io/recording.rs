//! The recording of a run: one MCAP file with pictures, joint states, arrangements, plans and the log.
//!
//! In: values with the daemon's timestamps. Out: a chunked, zstd-compressed file that common viewers open.
//! Every message is JSON with a schema; pictures and log lines use the field names of Foxglove's
//! `CompressedImage` and `Log`, so that viewers draw them. A chunk is closed at every picture and on
//! [`Recording::flush`]: after a crash the file can be read up to there.

use base64::Engine as _;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use mcap::records::MessageHeader;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

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

/// How serious a log line is; the numbers are Foxglove's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Every decision.
    Debug = 1,
    /// What an operator cares about.
    Info = 2,
    /// A person should look this week.
    Warning = 3,
    /// The cell stopped.
    Error = 4,
}

/// How a picture is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureFormat {
    /// Lossy, small.
    Jpeg,
    /// Lossless.
    Png,
}

/// An object as recorded: pose in the table frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordedObject {
    /// Object of the catalogue.
    pub id: String,
    /// m.
    pub x: f64,
    /// m.
    pub y: f64,
    /// rad.
    pub theta: f64,
    /// Standard deviation of the position, m.
    pub std_xy_m: f64,
    /// Standard deviation of the angle, rad.
    pub std_theta_rad: f64,
}

/// One topic: its name, the name of its schema and the properties of its messages beside `timestamp`.
struct Topic {
    name: &'static str,
    schema: &'static str,
    properties: fn() -> Value,
}

const JOINTS: Topic =
    Topic { name: "/robot/joints", schema: "celld.JointState", properties: joint_properties };
const ARRANGEMENT: Topic =
    Topic { name: "/table/arrangement", schema: "celld.Arrangement", properties: arrangement_properties };
const PLAN: Topic = Topic { name: "/plan", schema: "celld.Plan", properties: plan_properties };
const LOG: Topic = Topic { name: "/log", schema: "foxglove.Log", properties: log_properties };
const PICTURE: Topic =
    Topic { name: "/camera/image", schema: "foxglove.CompressedImage", properties: picture_properties };

fn joint_properties() -> Value {
    let six = json!({"type": "array", "items": {"type": "number"}, "minItems": 6, "maxItems": 6});
    json!({"position_rad": six, "velocity_rad_s": six})
}

fn arrangement_properties() -> Value {
    let number = json!({"type": "number"});
    let object = json!({"type": "object", "properties": {
        "id": {"type": "string"}, "x": number, "y": number, "theta": number,
        "std_xy_m": number, "std_theta_rad": number}});
    json!({"source": {"type": "string"}, "objects": {"type": "array", "items": object}})
}

fn plan_properties() -> Value {
    json!({"plan": {"type": "object"}})
}

fn log_properties() -> Value {
    let text = json!({"type": "string"});
    json!({"level": {"type": "integer"}, "message": text, "name": text, "file": text, "line": {"type": "integer"}})
}

fn picture_properties() -> Value {
    let text = json!({"type": "string"});
    let data = json!({"type": "string", "contentEncoding": "base64"});
    json!({"frame_id": text, "data": data, "format": text})
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
        let options = mcap::WriteOptions::new()
            .compression(Some(mcap::Compression::Zstd))
            // One thread: a pool of its own would compete with the planner for no gain at these rates.
            .compression_threads(0)
            .profile("celld")
            .library(concat!("celld ", env!("CARGO_PKG_VERSION")));
        let writer = options
            .create(BufWriter::new(file))
            .map_err(|source| RecordingError::Write { path: path.to_owned(), source })?;
        Ok(Recording {
            writer,
            path: path.to_owned(),
            epoch_unix_ns: (epoch_unix_s.max(0.0) * 1e9) as u64,
            sequences: BTreeMap::new(),
        })
    }

    /// Joint positions in rad and velocities in rad/s.
    ///
    /// # Errors
    /// The file cannot be written, mostly for want of space ([`RecordingError::Write`]).
    pub fn joints(&mut self, at: Timestamp, q: &Joints, qd: &[f64; 6]) -> Result<(), RecordingError> {
        self.write(&JOINTS, at, json!({"position_rad": q.0, "velocity_rad_s": qd}))
    }

    /// Where the objects are; `source` says who says so ("camera", "goal").
    ///
    /// # Errors
    /// As [`Recording::joints`].
    pub fn arrangement(
        &mut self,
        at: Timestamp,
        source: &str,
        objects: &[RecordedObject],
    ) -> Result<(), RecordingError> {
        self.write(&ARRANGEMENT, at, json!({"source": source, "objects": objects}))
    }

    /// A plan as its JSON file.
    ///
    /// # Errors
    /// As [`Recording::joints`].
    pub fn plan(&mut self, at: Timestamp, plan: &Value) -> Result<(), RecordingError> {
        self.write(&PLAN, at, json!({"plan": plan}))?;
        self.flush()
    }

    /// A log line; `name` is the part of celld that speaks.
    ///
    /// # Errors
    /// As [`Recording::joints`].
    pub fn log(
        &mut self,
        at: Timestamp,
        severity: Severity,
        name: &str,
        message: &str,
    ) -> Result<(), RecordingError> {
        let level = severity as u8;
        self.write(&LOG, at, json!({"level": level, "message": message, "name": name, "file": "", "line": 0}))
    }

    /// A compressed picture as the camera gave it.
    ///
    /// # Errors
    /// As [`Recording::joints`].
    pub fn picture(
        &mut self,
        at: Timestamp,
        format: PictureFormat,
        bytes: &[u8],
    ) -> Result<(), RecordingError> {
        let format = match format {
            PictureFormat::Jpeg => "jpeg",
            PictureFormat::Png => "png",
        };
        let data = base64::engine::general_purpose::STANDARD.encode(bytes);
        self.write(&PICTURE, at, json!({"frame_id": "camera", "data": data, "format": format}))?;
        self.flush()
    }

    /// Closes the chunk: everything written so far can be read after a crash.
    ///
    /// # Errors
    /// As [`Recording::joints`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(|source| RecordingError::Write { path: self.path.clone(), source })
    }

    /// Writes index and summary and closes the file.
    ///
    /// # Errors
    /// As [`Recording::joints`]; the file then has no index.
    pub fn finish(mut self) -> Result<PathBuf, RecordingError> {
        let finished = self.writer.finish();
        finished.map_err(|source| RecordingError::Write { path: self.path.clone(), source })?;
        Ok(self.path)
    }

    fn write(&mut self, topic: &Topic, at: Timestamp, mut message: Value) -> Result<(), RecordingError> {
        let log_time = self.epoch_unix_ns.saturating_add(at.nanos());
        let (sec, nsec) = (log_time / 1_000_000_000, log_time % 1_000_000_000);
        message["timestamp"] = json!({"sec": sec, "nsec": nsec});
        self.write_message(topic, log_time, message.to_string().as_bytes())
            .map_err(|source| RecordingError::Write { path: self.path.clone(), source })
    }

    fn write_message(&mut self, topic: &Topic, log_time: u64, data: &[u8]) -> Result<(), mcap::McapError> {
        let schema = schema_text(topic);
        let schema = self.writer.add_schema(topic.schema, "jsonschema", schema.as_bytes())?;
        let channel_id = self.writer.add_channel(schema, topic.name, "json", &BTreeMap::new())?;
        let sequence = self.sequences.entry(channel_id).or_insert(0);
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence: *sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data)
    }
}

fn schema_text(topic: &Topic) -> String {
    let mut properties = (topic.properties)();
    properties["timestamp"] = json!({"type": "object", "title": "time", "properties": {
        "sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}}});
    json!({"title": topic.schema, "type": "object", "properties": properties}).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages(bytes: &[u8]) -> Vec<(String, u32, u64, Value)> {
        let read = mcap::MessageStream::new(bytes).unwrap();
        read.map_while(Result::ok)
            .map(|message| {
                assert_eq!(message.channel.message_encoding, "json");
                let schema = message.channel.schema.as_ref().unwrap();
                assert_eq!(schema.encoding, "jsonschema");
                let schema: Value = serde_json::from_slice(&schema.data).unwrap();
                let value: Value = serde_json::from_slice(&message.data).unwrap();
                for key in value.as_object().unwrap().keys() {
                    assert!(schema["properties"].get(key).is_some(), "{key} is not in the schema");
                }
                (message.channel.topic.clone(), message.sequence, message.log_time, value)
            })
            .collect()
    }

    fn record(path: &Path) -> Recording {
        let mut recording = Recording::create(path, 1_000.0).unwrap();
        let at = Timestamp::from_secs_f64;
        recording.log(at(0.0), Severity::Info, "daemon", "start").unwrap();
        recording.joints(at(0.5), &Joints([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), &[0.0; 6]).unwrap();
        recording.joints(at(0.502), &Joints([0.1; 6]), &[0.0; 6]).unwrap();
        let mug = RecordedObject {
            id: "mug".into(),
            x: 0.1,
            y: 0.2,
            theta: 0.3,
            std_xy_m: 1e-4,
            std_theta_rad: 1e-3,
        };
        recording.arrangement(at(0.6), "camera", &[mug]).unwrap();
        recording.plan(at(0.7), &json!({"moves": 2})).unwrap();
        recording.picture(at(0.8), PictureFormat::Png, &[137, 80, 78, 71]).unwrap();
        recording
    }

    #[test]
    fn what_was_written_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        assert_eq!(record(&path).finish().unwrap(), path);
        let bytes = std::fs::read(&path).unwrap();
        let read = messages(&bytes);
        let topics: Vec<_> = read.iter().map(|(topic, ..)| topic.as_str()).collect();
        let expected =
            ["/log", "/robot/joints", "/robot/joints", "/table/arrangement", "/plan", "/camera/image"];
        assert_eq!(topics, expected);
        let (_, sequence, log_time, joints) = &read[2];
        assert_eq!((*sequence, *log_time), (2, 1_000_502_000_000));
        assert_eq!(joints["timestamp"], json!({"sec": 1000, "nsec": 502_000_000}));
        assert_eq!(read[5].3["data"], "iVBORw==");
        assert_eq!(read[3].3["objects"][0]["id"], "mug");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 6);
        assert!(summary.chunk_indexes.iter().all(|chunk| chunk.compression == "zstd"));
    }

    #[test]
    fn after_a_crash_the_file_reads_up_to_the_last_flush() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut recording = record(&path);
        recording.log(Timestamp::from_secs_f64(0.9), Severity::Error, "daemon", "after the flush").unwrap();
        let bytes = std::fs::read(&path).unwrap();
        drop(recording);
        assert_eq!(messages(&bytes).len(), 6);
    }
}
