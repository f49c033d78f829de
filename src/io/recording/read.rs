//! A recording read from its beginning to its end, or to where it breaks off.
//!
//! In: any file, in pieces. Out: what it says of itself and its messages in the order in which they were
//! written, or why it cannot be read on. Nothing but the present chunk is kept in memory; lengths are
//! bounded, since a file may be anything.

use crate::io::recording::piece_in;
use mcap::read::ChannelAccumulator;
use mcap::records::{Metadata, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, McapError, parse_record};
use std::borrow::Cow;
use std::io::Read;
use std::sync::Arc;

/// No record is longer, bytes: a picture of 64 MB compressed.
const LONGEST: usize = 1 << 26;

/// A message with its channel.
#[derive(Debug)]
pub struct Entry {
    /// Topic, encoding and schema.
    pub channel: Arc<Channel<'static>>,
    /// When it was written, ns since 1970.
    pub log_time: u64,
    /// Its number on the channel.
    pub sequence: u32,
    /// The message.
    pub data: Vec<u8>,
}

impl Entry {
    /// Its bytes, where it is a piece of a replay.
    pub fn piece(&self) -> Cow<'_, [u8]> {
        piece_in(self.channel.schema.as_ref().map(|schema| schema.name.as_str()), &self.data)
    }
}

/// One thing that a recording holds.
#[derive(Debug)]
pub enum Item {
    /// What it says of itself.
    About(Metadata),
    /// A message.
    Message(Entry),
}

/// Why a recording cannot be read on.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file itself.
    #[error("it cannot be read: {0}")]
    File(#[from] std::io::Error),
    /// Its content.
    #[error("it is no recording from here on: {0}")]
    Content(#[from] McapError),
}

/// See the module.
pub struct Items<R> {
    source: R,
    reader: LinearReader,
    channels: ChannelAccumulator<'static>,
    ended: bool,
}

impl<R: Read> Items<R> {
    /// From the beginning of a file.
    pub fn new(source: R) -> Items<R> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LONGEST);
        let reader = LinearReader::new_with_options(options);
        Items { source, reader, channels: ChannelAccumulator::default(), ended: false }
    }

    fn step(&mut self) -> Result<Option<Item>, ReadError> {
        while let Some(event) = self.reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let read = self.source.read(self.reader.insert(wanted.min(LONGEST)))?;
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => {
                    let record = parse_record(opcode, data)?;
                    if let Some(item) = taken(&mut self.channels, record)? {
                        return Ok(Some(item));
                    }
                }
            }
        }
        Ok(None)
    }
}

fn taken(channels: &mut ChannelAccumulator<'static>, record: Record) -> Result<Option<Item>, McapError> {
    match record {
        Record::Schema { header, data } => {
            channels.add_schema(header, Cow::Owned(data.into_owned()))?;
            Ok(None)
        }
        Record::Channel(channel) => {
            channels.add_channel(channel)?;
            Ok(None)
        }
        Record::Metadata(metadata) => Ok(Some(Item::About(metadata))),
        Record::Message { header, data } => {
            let channel = channels
                .get(header.channel_id)
                .ok_or(McapError::UnknownChannel(header.sequence, header.channel_id))?;
            let (log_time, sequence, data) = (header.log_time, header.sequence, data.into_owned());
            Ok(Some(Item::Message(Entry { channel, log_time, sequence, data })))
        }
        _ => Ok(None),
    }
}

impl<R: Read> Iterator for Items<R> {
    type Item = Result<Item, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let item = self.step().transpose();
        self.ended = !matches!(item, Some(Ok(_)));
        item
    }
}
