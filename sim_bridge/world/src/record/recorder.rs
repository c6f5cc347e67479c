//! The recorder: advances a world from instant to instant, and passes its changes to the sinks.

use super::driven_paths::DrivenPathsSink;
use super::foxglove::FoxgloveSink;
use super::sink::{RecordError, RecordingSink, WorldChanges};
use crate::world::{LoggedEvent, MotionState, MotionSummary, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{BackendEvent, RobotBackend};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Rate at which positions are written while a robot moves, in hertz of world time.
const RATE_HZ: f64 = 10.0;

/// Output files of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordingOutputs {
    /// An MCAP file for Foxglove.
    pub mcap: Option<PathBuf>,
    /// A picture of the paths driven.
    pub svg: Option<PathBuf>,
}

/// Records a world. Pass it to [`SharedWorld::record`](crate::SharedWorld::record).
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
            sinks.push(Box::new(FoxgloveSink::create(file)?));
        }
        if let Some(file) = &outputs.svg {
            sinks.push(Box::new(DrivenPathsSink::create(file)?));
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
