//! Parses a recording, as far as it is readable.

use super::schemas::{FLEET_METADATA, FORMAT_VERSION, MessageKind};
use consort_protocol::ids::FleetId;
use mcap::McapError;
use mcap::records::{ChunkHeader, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes per read.
const READ_BYTES: usize = 256 * 1024;

/// Maximum number of topics in an error message.
const TOPICS_MAX: usize = 8;

/// Reason why a file is not shown at all.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The system refuses it.
    #[error("{}: this recording cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file has another format.
    #[error("{}: this is not an MCAP file: it has no MCAP header; `consort record --out FILE` makes recordings", file.display())]
    NotMcap {
        /// The file.
        file: PathBuf,
    },
    /// A recording of something else, for example of a world alone.
    #[error(
        "{}: this MCAP file is not a recording of a fleet: it has no data of `consort record`{}{}",
        file.display(), if *world { "; it is a recording of a world, which Foxglove shows" } else { "" }, of(topics)
    )]
    NotAFleetRecording {
        /// The file.
        file: PathBuf,
        /// True if it was made by `consort world --record`.
        world: bool,
        /// Its topics.
        topics: Vec<String>,
    },
    /// Made by a later version of this program.
    #[error("{}: this recording is of format {format:?}; this version of consort reads {ours:?}", file.display(), ours = FORMAT_VERSION)]
    UnsupportedFormat {
        /// The file.
        file: PathBuf,
        /// Its format.
        format: String,
    },
    /// Damaged before any message that could be shown.
    #[error("{}: this recording cannot be shown: {problem}", file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// The problem.
        problem: String,
    },
}

fn of(topics: &[String]) -> String {
    match topics.len() {
        0 => String::new(),
        many => {
            let more = if many > TOPICS_MAX { ", …" } else { "" };
            format!("; it has the topics {}{more}", topics[..many.min(TOPICS_MAX)].join(", "))
        }
    }
}

/// A message of a fleet recording, not parsed yet.
pub(super) struct RecordedInput {
    pub(super) at_ms: u64,
    pub(super) kind: MessageKind,
    /// Key of its topic in [`RecordingContents::topics`].
    pub(super) topic: u16,
    /// Shared by all messages with the same content.
    pub(super) data: Arc<[u8]>,
    /// Current age, if it is a repeated view.
    pub(super) age_ms: Option<u64>,
}

/// Contents of a file, as far as readable.
pub(super) struct RecordingContents {
    pub(super) fleet: FleetId,
    pub(super) node: String,
    pub(super) began_ms: u64,
    pub(super) topics: BTreeMap<u16, String>,
    /// Inputs, in the order of their times.
    pub(super) inputs: Vec<RecordedInput>,
    /// Time of the last message of any topic.
    pub(super) until_ms: u64,
    /// Damage of the file.
    pub(super) damage: Option<String>,
}

#[derive(Default)]
struct Reading {
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    schemas: BTreeMap<u16, String>,
    topics: BTreeMap<u16, String>,
    kinds: BTreeMap<u16, MessageKind>,
    inputs: Vec<RecordedInput>,
    until_ms: u64,
}

/// Reads a file from its beginning, as far as it is valid.
pub(super) fn read(path: &Path) -> Result<RecordingContents, RecordingError> {
    let file = path.to_owned();
    let unreadable = |source| RecordingError::Unreadable { file: path.to_owned(), source };
    let mut source = File::open(path).map_err(unreadable)?;
    let length = source.metadata().map_err(unreadable)?.len();
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_record_length_limit(usize::try_from(length).unwrap_or(usize::MAX));
    let mut reader = LinearReader::new_with_options(options);
    let mut reading = Reading::default();
    let problem = loop {
        match reader.next_event() {
            None => break None,
            Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                let got = source.read(reader.insert(need.max(READ_BYTES))).map_err(unreadable)?;
                reader.notify_read(got);
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                let taken = match mcap::parse_record(opcode, data) {
                    Ok(Record::Chunk { header, data }) => reading.take_chunk(&header, &data),
                    Ok(record) => {
                        reading.take(record);
                        Ok(())
                    }
                    Err(problem) => Err(problem),
                };
                if let Err(problem) = taken {
                    break Some(problem);
                }
            }
            Some(Err(problem)) => break Some(problem),
        }
    };
    let foreign = matches!(problem, Some(McapError::BadMagic)) && reading.topics.is_empty();
    if foreign || length < mcap::MAGIC.len() as u64 {
        return Err(RecordingError::NotMcap { file });
    }
    let problem = problem.map(|problem| describe(&problem));
    let Reading { mut metadata, topics, mut inputs, until_ms, .. } = reading;
    let Some(mut metadata_field) = metadata.remove(FLEET_METADATA) else {
        let world = metadata.contains_key("consort.world");
        return Err(match (topics.is_empty(), problem) {
            (true, Some(problem)) => RecordingError::Unusable { file, problem },
            (_, _) => {
                let topics: BTreeSet<String> = topics.into_values().collect();
                RecordingError::NotAFleetRecording { file, world, topics: topics.into_iter().collect() }
            }
        });
    };
    let mut metadata_field = |name: &str| metadata_field.remove(name).unwrap_or_default();
    let format = metadata_field("format");
    if format != FORMAT_VERSION {
        return Err(RecordingError::UnsupportedFormat { file, format });
    }
    let nothing = |problem: String| RecordingError::Unusable { file: path.to_owned(), problem };
    let fleet = FleetId::new(metadata_field("fleet")).map_err(|problem| nothing(problem.to_string()))?;
    let began_ms = metadata_field("began_ms").parse().map_err(|_| nothing("it has no start time".to_owned()))?;
    if inputs.is_empty() {
        return Err(nothing(problem.unwrap_or_else(|| "no messages were received while it was made".to_owned())));
    }
    // Written in order; other programs may have changed the order.
    inputs.sort_by_key(|input| input.at_ms);
    Ok(RecordingContents {
        fleet,
        node: metadata_field("node"),
        began_ms,
        topics,
        inputs,
        until_ms: until_ms.max(began_ms),
        damage: problem,
    })
}

impl Reading {
    /// Parses a chunk. mcap 0.26.0 could do that, but it underflows if the length of the last
    /// record exceeds the chunk.
    fn take_chunk(&mut self, header: &ChunkHeader, mut data: &[u8]) -> Result<(), McapError> {
        if !header.compression.is_empty() {
            return Err(McapError::UnsupportedCompression(header.compression.clone()));
        }
        // The checksum is verified first: damaged data must not be parsed.
        let (saved, calculated) = (header.uncompressed_crc, crc32fast::hash(data));
        if saved != 0 && saved != calculated {
            return Err(McapError::BadChunkCrc { saved, calculated });
        }
        while !data.is_empty() {
            let (&[opcode, ref length @ ..], rest) = data.split_first_chunk::<9>().ok_or(McapError::UnexpectedEoc)?;
            let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| McapError::UnexpectedEoc)?;
            let (record, rest) = rest.split_at_checked(length).ok_or(McapError::UnexpectedEoc)?;
            self.take(mcap::parse_record(opcode, record)?);
            data = rest;
        }
        Ok(())
    }

    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Metadata(metadata) => {
                self.metadata.insert(metadata.name, metadata.metadata);
            }
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                if let Some(kind) = self.schemas.get(&channel.schema_id).and_then(|schema| MessageKind::of(schema)) {
                    self.kinds.insert(channel.id, kind);
                }
                self.topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                let at_ms = header.log_time / 1_000_000;
                self.until_ms = self.until_ms.max(at_ms);
                if let Some(kind) = self.kinds.get(&header.channel_id) {
                    let (kind, topic, data) = (*kind, header.channel_id, Arc::from(&*data));
                    self.inputs.push(RecordedInput { at_ms, kind, topic, data, age_ms: None });
                }
            }
            // The index repeats earlier data, and chunks are not nested.
            _ => {}
        }
    }
}

/// Describes the damage of a file.
fn describe(problem: &McapError) -> String {
    match problem {
        McapError::UnexpectedEof | McapError::UnexpectedEoc => {
            "it has no end: it was truncated, or its recorder was killed".to_owned()
        }
        McapError::UnsupportedCompression(name) => {
            format!(
                "its chunks are compressed with {name}; decompress it with `mcap decompress` of the MCAP command line tool"
            )
        }
        other => format!("it is damaged: {other}"),
    }
}
