//! Publishes a recording.

use super::frame_publisher::{FRAME, FramePublisher};
use crate::recording::{Player, PlayerCommand, RecordingReader, SpeedError, TimelineMark};
use serde::Serialize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::{Instant, MissedTickBehavior};

/// A recording that is being shown.
pub(super) struct ReplayServer {
    reader: RecordingReader,
    publisher: Arc<FramePublisher>,
    at: Mutex<Position>,
}

/// Playback of a recording, as programs and the page see it.
#[derive(Serialize)]
pub(super) struct PlaybackState<'a> {
    #[serde(flatten)]
    player: Player,
    marks: &'a [TimelineMark],
    /// What of the recording could not be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    damage: Option<String>,
}

struct Position {
    player: Player,
    /// Number of inputs that the published model contains.
    applied: usize,
    advanced_at: Instant,
}

impl ReplayServer {
    pub(super) fn new(reader: RecordingReader, player: Player, publisher: Arc<FramePublisher>) -> ReplayServer {
        let server = ReplayServer {
            reader,
            publisher,
            at: Mutex::new(Position { player, applied: 0, advanced_at: Instant::now() }),
        };
        server.advance(&mut server.lock());
        server
    }

    /// Publishes frames continuously.
    pub(super) async fn play_forever(&self) {
        let mut ticks = tokio::time::interval(FRAME);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.advance(&mut self.lock());
            self.publisher.publish_if_watched();
        }
    }

    /// Applies a command of the page, publishes the result at once, and returns the new state.
    ///
    /// # Errors
    /// [`SpeedError`] if the command is invalid.
    pub(super) fn apply_command(&self, command: PlayerCommand) -> Result<PlaybackState<'_>, SpeedError> {
        let mut at = self.lock();
        self.advance(&mut at);
        at.player.apply(command)?;
        self.advance(&mut at);
        self.publisher.publish_if_watched();
        Ok(self.state_of(&at.player))
    }

    /// Returns the playback state, for programs.
    pub(super) fn state(&self) -> PlaybackState<'_> {
        self.state_of(&self.lock().player)
    }

    /// Describes the recording.
    pub(super) fn description(&self) -> String {
        format!("this is a recording of {}", self.reader.fleet())
    }

    fn advance(&self, at: &mut Position) {
        let now = Instant::now();
        at.player.advance(now - at.advanced_at);
        at.advanced_at = now;
        let at_ms = at.player.at_ms();
        let mut state = serde_json::to_value(self.state_of(&at.player)).expect("playback states have a JSON form");
        // The page gets the time separately: it would be a change in each frame.
        if let Some(fields) = state.as_object_mut() {
            fields.remove("at_ms");
        }
        let applied = &mut at.applied;
        self.publisher.show_instant(at_ms, state, |model| *applied = self.reader.seek(model, *applied, at_ms));
    }

    fn state_of(&self, player: &Player) -> PlaybackState<'_> {
        PlaybackState { player: player.clone(), marks: self.reader.marks(), damage: self.reader.damage() }
    }

    fn lock(&self) -> MutexGuard<'_, Position> {
        // A partially updated model is rebuilt from the beginning.
        self.at.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
