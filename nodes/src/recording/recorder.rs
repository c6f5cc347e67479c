//! Takes in what is heard of a fleet while it is heard.

use super::writer::{RecordingStats, RecordingWriter};
use crate::fleet_model::{CoordinatorModel, FleetInput, FleetListener, FleetModel};
use consort_actors::clock::Clock;
use consort_sim::record::RecordError;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Who is told what is heard of a fleet, and writes it down.
pub struct Recorder {
    clock: Clock,
    inner: Mutex<Inner>,
    failed: Notify,
}

struct Inner {
    picture: FleetModel,
    has_map: bool,
    /// Gone once it has failed, or the recording is over.
    tape: Option<RecordingWriter>,
    problem: Option<RecordError>,
}

impl Recorder {
    /// Records on a tape what the picture, which is empty, is made of.
    pub fn new(picture: FleetModel, tape: RecordingWriter, clock: Clock) -> Recorder {
        let inner = Inner { picture, has_map: false, tape: Some(tape), problem: None };
        Recorder { clock, inner: Mutex::new(inner), failed: Notify::new() }
    }

    /// Has what was heard a while ago reach the file; to be called some times in a second. What there is so far, and who
    /// coordinates.
    pub fn flush_due(&self) -> (Option<RecordingStats>, Option<CoordinatorModel>) {
        let (now_ms, mut inner) = (self.clock.wall_ms(), self.lock());
        self.write(&mut inner, |tape, _| tape.flush_due(now_ms));
        (inner.tape.as_ref().map(RecordingWriter::stats), inner.picture.coordinator().cloned())
    }

    /// Waits until nothing can be written any more.
    pub async fn write_failed(&self) {
        self.failed.notified().await;
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// [`RecordError`] if the file does not hold all that was heard.
    pub fn finish(&self) -> Result<RecordingStats, RecordError> {
        let mut inner = self.lock();
        match (inner.tape.take(), inner.problem.take()) {
            (_, Some(problem)) => Err(problem),
            (Some(tape), None) => tape.finish(),
            (None, None) => Ok(RecordingStats::default()), // it has ended before
        }
    }

    /// A tape that fails is left alone from then on.
    fn write(
        &self,
        inner: &mut Inner,
        work: impl FnOnce(&mut RecordingWriter, &FleetModel) -> Result<(), RecordError>,
    ) {
        let Some(tape) = &mut inner.tape else { return };
        if let Err(problem) = work(tape, &inner.picture) {
            inner.tape = None;
            inner.problem = Some(problem);
            self.failed.notify_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FleetListener for Recorder {
    fn on_input(&self, heard: FleetInput) {
        let mut inner = self.lock();
        // Within the lock, so that what is written later is never of earlier.
        let now_ms = self.clock.wall_ms();
        inner.picture.apply(&heard, now_ms);
        inner.has_map |= matches!(&heard, FleetInput::View { key: consort_protocol::keys::Key::ViewMap, .. });
        self.write(&mut inner, |tape, picture| tape.write_input(&heard, picture, now_ms));
    }

    fn missions_to_query(&self) -> Vec<String> {
        self.lock().picture.missions_to_query()
    }

    fn needs_map(&self) -> bool {
        !self.lock().has_map
    }
}
