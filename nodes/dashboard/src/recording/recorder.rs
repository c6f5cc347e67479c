//! Records inputs of a fleet as they arrive.

use super::writer::{RecordingStats, RecordingWriter};
use crate::fleet_model::{CoordinatorModel, FleetInput, FleetListener, FleetModel};
use consort_bus::clock::Clock;
use consort_world::record::RecordError;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// A listener that applies the inputs of a fleet to a model and writes them to a file.
pub struct Recorder {
    clock: Clock,
    inner: Mutex<Inner>,
    failed: Notify,
}

struct Inner {
    model: FleetModel,
    has_map: bool,
    /// `None` after a write error, or after the end of the recording.
    writer: Option<RecordingWriter>,
    problem: Option<RecordError>,
}

impl Recorder {
    /// Creates a recorder with an empty model.
    pub fn new(model: FleetModel, writer: RecordingWriter, clock: Clock) -> Recorder {
        let inner = Inner { model, has_map: false, writer: Some(writer), problem: None };
        Recorder { clock, inner: Mutex::new(inner), failed: Notify::new() }
    }

    /// Writes older inputs to the file; to be called several times per second. Returns the
    /// statistics and the coordinator.
    pub fn flush_due(&self) -> (Option<RecordingStats>, Option<CoordinatorModel>) {
        let (now_ms, mut inner) = (self.clock.wall_ms(), self.lock());
        self.write(&mut inner, |writer, _| writer.flush_due(now_ms));
        (inner.writer.as_ref().map(RecordingWriter::stats), inner.model.coordinator().cloned())
    }

    /// Waits until a write error occurs.
    pub async fn write_failed(&self) {
        self.failed.notified().await;
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// [`RecordError`] if the file does not hold all inputs.
    pub fn finish(&self) -> Result<RecordingStats, RecordError> {
        let mut inner = self.lock();
        match (inner.writer.take(), inner.problem.take()) {
            (_, Some(problem)) => Err(problem),
            (Some(writer), None) => writer.finish(),
            (None, None) => Ok(RecordingStats::default()), // it was ended before
        }
    }

    /// After a write error nothing more is written.
    fn write(
        &self,
        inner: &mut Inner,
        work: impl FnOnce(&mut RecordingWriter, &FleetModel) -> Result<(), RecordError>,
    ) {
        let Some(writer) = &mut inner.writer else { return };
        if let Err(problem) = work(writer, &inner.model) {
            inner.writer = None;
            inner.problem = Some(problem);
            self.failed.notify_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FleetListener for Recorder {
    fn on_input(&self, input: FleetInput) {
        let mut inner = self.lock();
        // The time is read within the lock, so that inputs are written in the order of their times.
        let now_ms = self.clock.wall_ms();
        inner.model.apply(&input, now_ms);
        inner.has_map |= matches!(&input, FleetInput::View { key: consort_protocol::keys::Key::ViewMap, .. });
        self.write(&mut inner, |writer, model| writer.write_input(&input, model, now_ms));
    }

    fn missions_to_query(&self) -> Vec<String> {
        self.lock().model.missions_to_query()
    }

    fn needs_map(&self) -> bool {
        !self.lock().has_map
    }
}
