//! A file that is read back, as far as it goes.

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

/// How much is read at once, in bytes.
const PIECE: usize = 256 * 1024;

/// Topics that are named in an error.
const TOPICS: usize = 8;

/// Why a file is not shown at all.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The system does not hand it out.
    #[error("{}: this recording cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// It is something else.
    #[error("{}: this is no MCAP file: it does not begin as one; `consort record --out FILE` makes recordings", file.display())]
    NotMcap {
        /// The file.
        file: PathBuf,
    },
    /// It is a recording of something else, as of a world alone.
    #[error(
        "{}: this MCAP file is no recording of a fleet: there is nothing of `consort record` in it{}{}",
        file.display(), if *world { "; a world was recorded here, which Foxglove shows" } else { "" }, of(topics)
    )]
    NotAFleetRecording {
        /// The file.
        file: PathBuf,
        /// Whether it is of `consort world --record`.
        world: bool,
        /// Topics that it has.
        topics: Vec<String>,
    },
    /// It was made by a later version of this program.
    #[error("{}: this recording is of format {format:?}; this version of consort reads {ours:?}", file.display(), ours = FORMAT_VERSION)]
    UnsupportedFormat {
        /// The file.
        file: PathBuf,
        /// Its format.
        format: String,
    },
    /// It is damaged before anything that could be shown.
    #[error("{}: nothing of this recording can be shown: {problem}", file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
}

fn of(topics: &[String]) -> String {
    match topics.len() {
        0 => String::new(),
        many => {
            let more = if many > TOPICS { ", …" } else { "" };
            format!("; it has the topics {}{more}", topics[..many.min(TOPICS)].join(", "))
        }
    }
}

/// A message of ours, not yet read.
pub(super) struct RecordedInput {
    pub(super) at_ms: u64,
    pub(super) kind: MessageKind,
    /// In which of [`Contents::topics`] it stands.
    pub(super) topic: u16,
    /// Shared by all that say the same.
    pub(super) data: Arc<[u8]>,
    /// Of a view that was answered again: the age it has now.
    pub(super) age_ms: Option<u64>,
}

/// What a file holds, as far as it could be read.
pub(super) struct RecordingContents {
    pub(super) fleet: FleetId,
    pub(super) node: String,
    pub(super) began_ms: u64,
    pub(super) topics: BTreeMap<u16, String>,
    /// In the order of their times.
    pub(super) inputs: Vec<RecordedInput>,
    /// Time of the last message, of whichever topic.
    pub(super) until_ms: u64,
    /// What is wrong with it.
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

/// Reads a file from its beginning on, for as long as it makes sense.
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
                let got = source.read(reader.insert(need.max(PIECE))).map_err(unreadable)?;
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
    let problem = problem.map(|problem| words(&problem));
    let Reading { mut metadata, topics, mut inputs, until_ms, .. } = reading;
    let Some(mut said) = metadata.remove(FLEET_METADATA) else {
        let world = metadata.contains_key("consort.world");
        return Err(match (topics.is_empty(), problem) {
            (true, Some(problem)) => RecordingError::Unusable { file, problem },
            (_, _) => {
                let topics: BTreeSet<String> = topics.into_values().collect();
                RecordingError::NotAFleetRecording { file, world, topics: topics.into_iter().collect() }
            }
        });
    };
    let mut said = |name: &str| said.remove(name).unwrap_or_default();
    let format = said("format");
    if format != FORMAT_VERSION {
        return Err(RecordingError::UnsupportedFormat { file, format });
    }
    let nothing = |problem: String| RecordingError::Unusable { file: path.to_owned(), problem };
    let fleet = FleetId::new(said("fleet")).map_err(|problem| nothing(problem.to_string()))?;
    let began_ms = said("began_ms").parse().map_err(|_| nothing("it does not say when it began".to_owned()))?;
    if inputs.is_empty() {
        return Err(nothing(problem.unwrap_or_else(|| "nothing was heard while it was made".to_owned())));
    }
    // As they were written; other programs may have put them in another order.
    inputs.sort_by_key(|input| input.at_ms);
    Ok(RecordingContents {
        fleet,
        node: said("node"),
        began_ms,
        topics,
        inputs,
        until_ms: until_ms.max(began_ms),
        damage: problem,
    })
}

impl Reading {
    /// Takes what is in a chunk. mcap 0.26.0 would do that, too, and reckons below zero if the last record says that it is longer
    /// than the chunk.
    fn take_chunk(&mut self, header: &ChunkHeader, mut data: &[u8]) -> Result<(), McapError> {
        if !header.compression.is_empty() {
            return Err(McapError::UnsupportedCompression(header.compression.clone()));
        }
        // Before anything of it is looked at: what is damaged there is not to be made sense of.
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
            // The index repeats what stands before, and no chunk stands in a chunk.
            _ => {}
        }
    }
}

/// What is wrong with a file from some place on.
fn words(problem: &McapError) -> String {
    match problem {
        McapError::UnexpectedEof | McapError::UnexpectedEoc => {
            "it has no end: it was cut short, or its recorder was killed".to_owned()
        }
        McapError::UnsupportedCompression(name) => {
            format!("its chunks are compressed with {name}; `mcap decompress` of the MCAP command line tool undoes it")
        }
        other => format!("it is damaged: {other}"),
    }
}
