//! Takes in what is heard of a fleet while it is heard.

use super::tape::{Recorded, Tape};
use crate::picture::{CoordinatorShown, Ear, Heard, Picture};
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
    picture: Picture,
    has_map: bool,
    /// Gone once it has failed, or the recording is over.
    tape: Option<Tape>,
    problem: Option<RecordError>,
}

impl Recorder {
    /// Records on a tape what the picture, which is empty, is made of.
    pub fn new(picture: Picture, tape: Tape, clock: Clock) -> Recorder {
        let inner = Inner { picture, has_map: false, tape: Some(tape), problem: None };
        Recorder { clock, inner: Mutex::new(inner), failed: Notify::new() }
    }

    /// Has what was heard a while ago reach the file; to be called some times in a second. What there is so far, and who
    /// coordinates.
    pub fn pass(&self) -> (Option<Recorded>, Option<CoordinatorShown>) {
        let (now_ms, mut inner) = (self.clock.wall_ms(), self.lock());
        self.write(&mut inner, |tape, _| tape.pass(now_ms));
        (inner.tape.as_ref().map(Tape::recorded), inner.picture.coordinator().cloned())
    }

    /// Waits until nothing can be written any more.
    pub async fn failed(&self) {
        self.failed.notified().await;
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// [`RecordError`] if the file does not hold all that was heard.
    pub fn end(&self) -> Result<Recorded, RecordError> {
        let mut inner = self.lock();
        match (inner.tape.take(), inner.problem.take()) {
            (_, Some(problem)) => Err(problem),
            (Some(tape), None) => tape.end(),
            (None, None) => Ok(Recorded::default()), // it has ended before
        }
    }

    /// A tape that fails is left alone from then on.
    fn write(&self, inner: &mut Inner, work: impl FnOnce(&mut Tape, &Picture) -> Result<(), RecordError>) {
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

impl Ear for Recorder {
    fn take(&self, heard: Heard) {
        let mut inner = self.lock();
        // Within the lock, so that what is written later is never of earlier.
        let now_ms = self.clock.wall_ms();
        inner.picture.take(&heard, now_ms);
        inner.has_map |= matches!(&heard, Heard::View { key: consort_protocol::keys::Key::ViewMap, .. });
        self.write(&mut inner, |tape, picture| tape.take(&heard, picture, now_ms));
    }

    fn missions_to_ask_for(&self) -> Vec<String> {
        self.lock().picture.missions_to_ask_for()
    }

    fn wants_map(&self) -> bool {
        !self.lock().has_map
    }
}
