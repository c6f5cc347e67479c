//! Recordings of a world while it runs: for Foxglove, and as a picture of the paths driven.
//!
//! ```text
//!  SharedWorld::advance ──▶ Recorder ──▶ World::advance, from one instant to the next
//!                               │ events, and robots that have moved
//!                               ├──▶ foxglove       an MCAP file, chunk by chunk
//!                               └──▶ driven_paths   an SVG, when the recording ends
//! ```
//!
//! A world without a recording has no recorder and no extra cost. A recorded world runs exactly the
//! same, to the last bit: its time advances in smaller steps while a robot moves, which makes no
//! difference to it, and the recorder only reads. While nothing moves and no event occurs, nothing
//! is written.
//!
//! **Time** in a recording is world time, from 0: the same seed and the same requests give the same
//! file.
//!
//! **End.** [`SharedWorld::end_recording`](crate::world::SharedWorld::end_recording) completes both
//! files. If the process is killed, the SVG is empty, and the MCAP file lacks its index and the
//! events of the last [`foxglove::CHUNK_S`] seconds of world time (or since time was last advanced,
//! if that is longer ago). The rest can be read from the beginning, and the command line tool of
//! MCAP repairs the file (`mcap recover`).

mod driven_paths;
pub mod foxglove;

use crate::world::{LoggedEvent, MotionState, MotionSummary, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{BackendEvent, RobotBackend};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Rate at which positions are written while a robot moves, in hertz of world time.
pub const RATE_HZ: f64 = 10.0;

/// Output files of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordingOutputs {
    /// An MCAP file for Foxglove.
    pub mcap: Option<PathBuf>,
    /// A picture of the paths driven.
    pub svg: Option<PathBuf>,
}

/// A recording cannot be written. The world itself is not affected.
#[derive(Debug, thiserror::Error)]
#[error("{}: the recording cannot be written: {reason}", file.display())]
pub struct RecordError {
    /// Output file.
    pub file: PathBuf,
    /// Error text of the operating system or the encoder.
    pub reason: String,
}

impl RecordError {
    fn of<E: std::fmt::Display>(file: &Path) -> impl FnOnce(E) -> RecordError {
        move |error| RecordError { file: file.to_owned(), reason: error.to_string() }
    }
}

/// A destination of recordings.
trait RecordingSink: Send {
    /// Writes the state of the world at the start of the recording.
    fn begin(&mut self, world: &World) -> Result<(), RecordError>;

    /// Writes the events since the last call, and the robots that have moved since.
    fn write_changes(&mut self, world: &World, changes: &WorldChanges<'_>) -> Result<(), RecordError>;

    /// Notifies the sink that world time has advanced to `now_s`, whether or not events occurred.
    fn on_time_advanced(&mut self, now_s: f64) -> Result<(), RecordError>;

    /// Completes the recording. Returns a summary as text.
    fn end(&mut self, world: &World) -> Result<String, RecordError>;
}

struct WorldChanges<'a> {
    now_s: f64,
    events: &'a [LoggedEvent],
    moved: &'a [MotionState],
}

/// Records a world. Pass it to [`SharedWorld::record`](crate::world::SharedWorld::record).
pub struct Recorder {
    sinks: Vec<Box<dyn RecordingSink>>,
    failed: Vec<RecordError>,
    /// Number of world events already written.
    written: u64,
    /// Position of each robot as last written.
    positions: BTreeMap<RobotId, MotionState>,
    motion: MotionSummary,
}

impl Recorder {
    /// Creates the files, replacing existing files; `None` if no output is configured.
    ///
    /// # Errors
    /// [`RecordError`] if a file cannot be written.
    pub fn open(outputs: &RecordingOutputs) -> Result<Option<Recorder>, RecordError> {
        let mut sinks: Vec<Box<dyn RecordingSink>> = vec![];
        if let Some(file) = &outputs.mcap {
            sinks.push(Box::new(foxglove::FoxgloveSink::create(file)?));
        }
        if let Some(file) = &outputs.svg {
            sinks.push(Box::new(driven_paths::DrivenPathsSink::create(file)?));
        }
        let recorder = Recorder {
            sinks,
            failed: vec![],
            written: 0,
            positions: BTreeMap::new(),
            motion: MotionSummary::default(),
        };
        Ok((!recorder.sinks.is_empty()).then_some(recorder))
    }

    /// Starts the recording with the full state of the world.
    pub(crate) fn begin(&mut self, world: &World) {
        self.written = world.events_after(0).1;
        self.positions = world.motion_states().map(|position| (position.robot.clone(), position)).collect();
        self.motion = world.motion_summary();
        self.for_each_sink(|sink| sink.begin(world));
    }

    /// Advances the world as [`World::advance`] does, and records its events.
    pub(crate) fn advance(&mut self, world: &mut World, to: WorldTime) -> Vec<BackendEvent> {
        let to_s = to.as_secs().max(world.now().as_secs());
        let mut events = vec![];
        self.record_changes(world, false);
        loop {
            let mut until_s = to_s;
            let sample_s = if self.motion.any_moving { next_sample_s(world.now().as_secs()) } else { f64::INFINITY };
            until_s = until_s.min(sample_s);
            if let Some(due) = world.next_due() {
                until_s = until_s.min(due.as_secs());
            }
            events.extend(world.advance(WorldTime::from_secs(until_s)));
            self.record_changes(world, until_s >= sample_s);
            if until_s >= to_s {
                break;
            }
        }
        self.for_each_sink(|sink| sink.on_time_advanced(to_s));
        events
    }

    /// Completes the recording. Returns a summary of each file, or the error that interrupted it.
    pub(crate) fn end(mut self, world: &World) -> Vec<Result<String, RecordError>> {
        self.record_changes(world, true);
        let ended = self.sinks.iter_mut().map(|sink| sink.end(world));
        let mut summaries: Vec<_> = ended.collect();
        summaries.extend(self.failed.into_iter().map(Err));
        summaries
    }

    /// Writes the changes since the last call, if there are events or a sample is due.
    fn record_changes(&mut self, world: &World, sample: bool) {
        let (events, written) = world.events_after(self.written);
        let events: Vec<LoggedEvent> = events.cloned().collect();
        self.written = written;
        let before = std::mem::replace(&mut self.motion, world.motion_summary());
        if !sample && events.is_empty() && before == self.motion {
            return;
        }
        let moved: Vec<MotionState> =
            world.motion_states().filter(|position| self.positions.get(&position.robot) != Some(position)).collect();
        if events.is_empty() && moved.is_empty() {
            return;
        }
        let changes = WorldChanges { now_s: world.now().as_secs(), events: &events, moved: &moved };
        self.for_each_sink(|sink| sink.write_changes(world, &changes));
        self.positions.extend(moved.into_iter().map(|position| (position.robot.clone(), position)));
    }

    /// A sink that fails is logged once and removed. The world continues.
    fn for_each_sink(&mut self, mut work: impl FnMut(&mut dyn RecordingSink) -> Result<(), RecordError>) {
        let failed = &mut self.failed;
        self.sinks.retain_mut(|sink| match work(&mut **sink) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!(%error, "recording failed and ends; the world continues");
                failed.push(error);
                false
            }
        });
    }
}

/// Next instant at which the positions of moving robots are sampled.
fn next_sample_s(now_s: f64) -> f64 {
    // An instant closer than the rounding error is the previous sample.
    ((now_s * RATE_HZ + 1e-6).floor() + 1.0) / RATE_HZ
}
