//! What happens in a world, written down while it happens: for Foxglove, and as a picture of the paths driven.
//!
//! ```text
//!  SharedWorld::advance ──▶ Recorder ──▶ World::advance, from one instant to the next
//!                               │ what happened, and who is somewhere else now
//!                               ├──▶ foxglove   an MCAP file, chunk by chunk
//!                               └──▶ paths      an SVG, when the recording ends
//! ```
//!
//! A world that is not recorded has no recorder, and nothing is asked of it. One that is takes the same course to the last
//! bit: its time passes in smaller steps while anything moves, which makes no difference to it, and the recorder only looks.
//! While nothing moves and nothing happens, nothing is written.
//!
//! **Time** in a recording is world time, from 0: the same seed and the same requests give the same file.
//!
//! **Ends.** [`SharedWorld::end_recording`](crate::world::SharedWorld::end_recording) completes both files. Of a process
//! that is killed, the SVG is empty, and the MCAP file lacks its index and what happened in the last [`foxglove::CHUNK_S`]
//! seconds of world time (or since time was last let pass, if that is longer ago); what is there can be read from its beginning
//! on, and the command line tool of MCAP makes a whole file of it (`mcap recover`).

mod driven_paths;
pub mod foxglove;

use crate::world::{LoggedEvent, MotionState, MotionSummary, World};
use consort_protocol::ids::RobotId;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{BackendEvent, RobotBackend};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How often it is written where robots are while any of them moves, in times per second of world time.
pub const RATE_HZ: f64 = 10.0;

/// Where recordings go.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordingOutputs {
    /// An MCAP file for Foxglove.
    pub mcap: Option<PathBuf>,
    /// A picture of the paths driven.
    pub svg: Option<PathBuf>,
}

/// Why something was not recorded. The world itself is not affected.
#[derive(Debug, thiserror::Error)]
#[error("{}: the recording cannot be written: {reason}", file.display())]
pub struct RecordError {
    /// The file.
    pub file: PathBuf,
    /// What the system says.
    pub reason: String,
}

impl RecordError {
    fn of<E: std::fmt::Display>(file: &Path) -> impl FnOnce(E) -> RecordError {
        move |problem| RecordError { file: file.to_owned(), reason: problem.to_string() }
    }
}

/// Something that recordings are made on.
trait RecordingSink: Send {
    /// The world as it is when the recording begins.
    fn begin(&mut self, world: &World) -> Result<(), RecordError>;

    /// What happened by now that was not yet told, and who is somewhere else than last told.
    fn write_changes(&mut self, world: &World, moment: &WorldChanges<'_>) -> Result<(), RecordError>;

    /// So much world time has passed, whatever happened.
    fn on_time_advanced(&mut self, now_s: f64) -> Result<(), RecordError>;

    /// The recording is over. What there is of it, in words.
    fn end(&mut self, world: &World) -> Result<String, RecordError>;
}

struct WorldChanges<'a> {
    now_s: f64,
    events: &'a [LoggedEvent],
    moved: &'a [MotionState],
}

/// Writes down what happens in a world. It is handed to [`SharedWorld::record`](crate::world::SharedWorld::record).
pub struct Recorder {
    tapes: Vec<Box<dyn RecordingSink>>,
    failed: Vec<RecordError>,
    /// How many happenings of the world were told.
    told: u64,
    /// Where each robot was when that was last told.
    stances: BTreeMap<RobotId, MotionState>,
    motion: MotionSummary,
}

impl Recorder {
    /// Makes the files ready; `None` if there are to be none. Files that are there are replaced.
    ///
    /// # Errors
    /// [`RecordError`] if a file cannot be written.
    pub fn open(outputs: &RecordingOutputs) -> Result<Option<Recorder>, RecordError> {
        let mut tapes: Vec<Box<dyn RecordingSink>> = vec![];
        if let Some(file) = &outputs.mcap {
            tapes.push(Box::new(foxglove::FoxgloveSink::create(file)?));
        }
        if let Some(file) = &outputs.svg {
            tapes.push(Box::new(driven_paths::DrivenPathsSink::create(file)?));
        }
        let recorder =
            Recorder { tapes, failed: vec![], told: 0, stances: BTreeMap::new(), motion: MotionSummary::default() };
        Ok((!recorder.tapes.is_empty()).then_some(recorder))
    }

    /// Begins: all that is in the world is told.
    pub(crate) fn begin(&mut self, world: &World) {
        self.told = world.events_after(0).1;
        self.stances = world.motion_states().map(|stance| (stance.robot.clone(), stance)).collect();
        self.motion = world.motion_summary();
        self.each_tape(|tape| tape.begin(world));
    }

    /// Lets the world's time pass as [`World::advance`] does, and tells what happens meanwhile.
    pub(crate) fn advance(&mut self, world: &mut World, to: WorldTime) -> Vec<BackendEvent> {
        let to_s = to.as_secs().max(world.now().as_secs());
        let mut events = vec![];
        self.look(world, false);
        loop {
            let mut until_s = to_s;
            let sample_s = if self.motion.any_moving { next_sample_s(world.now().as_secs()) } else { f64::INFINITY };
            until_s = until_s.min(sample_s);
            if let Some(due) = world.next_due() {
                until_s = until_s.min(due.as_secs());
            }
            events.extend(world.advance(WorldTime::from_secs(until_s)));
            self.look(world, until_s >= sample_s);
            if until_s >= to_s {
                break;
            }
        }
        self.each_tape(|tape| tape.on_time_advanced(to_s));
        events
    }

    /// Completes what is being recorded: what each file holds, in words, or why it does not hold all.
    pub(crate) fn end(mut self, world: &World) -> Vec<Result<String, RecordError>> {
        self.look(world, true);
        let ended = self.tapes.iter_mut().map(|tape| tape.end(world));
        let mut said: Vec<_> = ended.collect();
        said.extend(self.failed.into_iter().map(Err));
        said
    }

    /// Tells what has happened, if anything has or if it is time to.
    fn look(&mut self, world: &World, sample: bool) {
        let (news, told) = world.events_after(self.told);
        let news: Vec<LoggedEvent> = news.cloned().collect();
        self.told = told;
        let before = std::mem::replace(&mut self.motion, world.motion_summary());
        if !sample && news.is_empty() && before == self.motion {
            return;
        }
        let moved: Vec<MotionState> =
            world.motion_states().filter(|stance| self.stances.get(&stance.robot) != Some(stance)).collect();
        if news.is_empty() && moved.is_empty() {
            return;
        }
        let moment = WorldChanges { now_s: world.now().as_secs(), events: &news, moved: &moved };
        self.each_tape(|tape| tape.write_changes(world, &moment));
        self.stances.extend(moved.into_iter().map(|stance| (stance.robot.clone(), stance)));
    }

    /// A tape that fails is told of once, and left alone from then on: the world goes on.
    fn each_tape(&mut self, mut work: impl FnMut(&mut dyn RecordingSink) -> Result<(), RecordError>) {
        let failed = &mut self.failed;
        self.tapes.retain_mut(|tape| match work(&mut **tape) {
            Ok(()) => true,
            Err(problem) => {
                tracing::warn!(%problem, "recording ends here; the world goes on");
                failed.push(problem);
                false
            }
        });
    }
}

/// The next instant at which it is told where moving robots are.
fn next_sample_s(now_s: f64) -> f64 {
    // An instant that is a hair away is the one that has just been.
    ((now_s * RATE_HZ + 1e-6).floor() + 1.0) / RATE_HZ
}
