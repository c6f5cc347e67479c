//! Writer of an MCAP file: topics with their schemas, and chunks that reach the disk whole.

use super::message::Time;
use super::schema::Schema;
use crate::record::sink::RecordError;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A chunk is written to the file after this many seconds of world time, or after 256 KiB.
/// A killed process loses at most this much.
pub const CHUNK_S: f64 = 5.0;

/// A chunk is written to the file after this many bytes, regardless of its age. A killed process
/// loses at most this much.
const CHUNK_BYTES: u64 = 256 * 1024;

/// Treatment of a file that already exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExistingFile {
    /// Keep the file. Nothing is recorded.
    Keep,
    /// Replace the file.
    Replace,
}

/// Times and sequence number of a message.
#[derive(Debug, Clone, Copy)]
pub struct MessageStamp {
    /// Time of reception, by which a recording is played. If it is earlier than that of a previous
    /// message, the previous time is written instead.
    pub log_time: Time,
    /// Time of publication, as far as it is known.
    pub publish_time: Time,
    /// Sequence number; `None` for the number after the previous message on the topic.
    pub sequence: Option<u32>,
}

impl MessageStamp {
    /// Returns the stamp of a message that was received when it was published.
    pub fn at(time: Time) -> MessageStamp {
        MessageStamp { log_time: time, publish_time: time, sequence: None }
    }
}

/// An MCAP file being written.
pub struct McapFile {
    file: PathBuf,
    writer: Writer<BufWriter<File>>,
    schemas: BTreeMap<&'static str, u16>,
    /// Channel id and latest sequence number, by topic.
    channels: BTreeMap<String, (u16, u32)>,
    /// Time of the first message of the chunk that is not in the file yet.
    chunk_since: Option<Time>,
    /// Time of the latest message. Later messages are never earlier.
    latest: Time,
    messages: u64,
}

impl McapFile {
    /// Creates the file.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written, or exists and is to be kept.
    pub fn create(file: &Path, existing: ExistingFile) -> Result<McapFile, RecordError> {
        let mut how = OpenOptions::new();
        let sink = match existing {
            ExistingFile::Keep => how.write(true).create_new(true).open(file),
            ExistingFile::Replace => how.write(true).create(true).truncate(true).open(file),
        };
        let sink = sink.map_err(RecordError::of(file))?;
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk reaches the file whole: a partial chunk could not be read.
            .disable_seeking(true)
            .library(concat!("consort ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(BufWriter::new(sink)).map_err(RecordError::of(file))?;
        Ok(McapFile {
            file: file.to_owned(),
            writer,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunk_since: None,
            latest: Time::default(),
            messages: 0,
        })
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.file
    }

    /// Number of messages written.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Writes metadata of the whole recording, as names and values.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn write_metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), RecordError> {
        let record = mcap::write::Metadata { name: name.to_owned(), metadata };
        self.writer.write_metadata(&record).map_err(RecordError::of(&self.file))
    }

    /// Writes a message as JSON.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn write(
        &mut self,
        topic: &str,
        schema: &'static Schema,
        stamp: MessageStamp,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        let channel_id = self.channel(topic, schema)?;
        let sequence = self.channels.get_mut(topic).map_or(1, |(_, latest)| {
            *latest = stamp.sequence.unwrap_or_else(|| latest.wrapping_add(1));
            *latest
        });
        self.latest = self.latest.max(stamp.log_time);
        let (log_time, publish_time) = (self.latest.nanoseconds(), stamp.publish_time.nanoseconds());
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        let data = serde_json::to_vec(message).map_err(RecordError::of(&self.file))?;
        self.writer.write_to_known_channel(&header, &data).map_err(RecordError::of(&self.file))?;
        self.chunk_since.get_or_insert(stamp.log_time);
        self.messages += 1;
        Ok(())
    }

    /// Returns the channel id of a topic, and registers the topic if it is new.
    fn channel(&mut self, topic: &str, schema: &'static Schema) -> Result<u16, RecordError> {
        if let Some((channel, _)) = self.channels.get(topic) {
            return Ok(*channel);
        }
        let schema_id = match self.schemas.get(schema.name()) {
            Some(id) => *id,
            None => {
                let text = serde_json::to_vec(&schema.describe()).map_err(RecordError::of(&self.file))?;
                let added = self.writer.add_schema(schema.name(), "jsonschema", &text);
                let id = added.map_err(RecordError::of(&self.file))?;
                self.schemas.insert(schema.name(), id);
                id
            }
        };
        let added = self.writer.add_channel(schema_id, topic, "json", &BTreeMap::new());
        let channel = added.map_err(RecordError::of(&self.file))?;
        self.channels.insert(topic.to_owned(), (channel, 0));
        Ok(channel)
    }

    /// Flushes buffered messages to the file if the oldest is at least `age` old.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn flush_if_older(&mut self, now: Time, age: Duration) -> Result<(), RecordError> {
        let age = u64::try_from(age.as_nanos()).unwrap_or(u64::MAX);
        let due = |since: Time| now.nanoseconds() >= since.nanoseconds().saturating_add(age);
        if !self.chunk_since.is_some_and(due) {
            return Ok(());
        }
        self.chunk_since = None;
        self.writer.flush().map_err(RecordError::of(&self.file))
    }

    /// Completes the file: writes its index.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be written.
    pub fn finish(&mut self) -> Result<(), RecordError> {
        self.writer.finish().map(drop).map_err(RecordError::of(&self.file))
    }
}
