//! A destination of recordings.

use crate::world::{LoggedEvent, MotionState, World};
use std::path::{Path, PathBuf};

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
    pub(super) fn of<E: std::fmt::Display>(file: &Path) -> impl FnOnce(E) -> RecordError {
        move |error| RecordError { file: file.to_owned(), reason: error.to_string() }
    }
}

/// A destination of recordings.
pub(super) trait RecordingSink: Send {
    /// Writes the state of the world at the start of the recording.
    fn begin(&mut self, world: &World) -> Result<(), RecordError>;

    /// Writes the events since the last call, and the robots that have moved since.
    fn write_changes(&mut self, world: &World, changes: &WorldChanges<'_>) -> Result<(), RecordError>;

    /// Notifies the sink that world time has advanced to `now_s`, whether or not events occurred.
    fn on_time_advanced(&mut self, now_s: f64) -> Result<(), RecordError>;

    /// Completes the recording. Returns a summary as text.
    fn end(&mut self, world: &World) -> Result<String, RecordError>;
}

/// Changes of a world since the last call.
pub(super) struct WorldChanges<'a> {
    pub(super) now_s: f64,
    pub(super) events: &'a [LoggedEvent],
    pub(super) moved: &'a [MotionState],
}
