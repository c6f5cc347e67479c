//! Shows a recording on the board.

use super::frame_publisher::{FRAME, FramePublisher};
use crate::recording::{Player, PlayerCommand, RecordingReader};
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::{Instant, MissedTickBehavior};

/// A recording that is being shown.
pub(super) struct ReplayServer {
    reel: RecordingReader,
    board: Arc<FramePublisher>,
    at: Mutex<At>,
}

struct At {
    player: Player,
    /// Inputs that the picture on the board has taken in.
    taken: usize,
    looked: Instant,
}

impl ReplayServer {
    pub(super) fn new(reel: RecordingReader, player: Player, board: Arc<FramePublisher>) -> ReplayServer {
        let projector = ReplayServer { reel, board, at: Mutex::new(At { player, taken: 0, looked: Instant::now() }) };
        projector.go_on(&mut projector.lock());
        projector
    }

    /// Shows what is due, a frame after the other.
    pub(super) async fn play_forever(&self) {
        let mut ticks = tokio::time::interval(FRAME);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.go_on(&mut self.lock());
            self.board.publish_if_watched();
        }
    }

    /// Does as somebody at the page asks, and shows it at once: what is shown then.
    ///
    /// # Errors
    /// In words, if it makes no sense.
    pub(super) fn apply_command(&self, command: PlayerCommand) -> Result<Value, String> {
        let mut at = self.lock();
        self.go_on(&mut at);
        at.player.apply(command)?;
        self.go_on(&mut at);
        self.board.publish_if_watched();
        Ok(self.value(&at.player))
    }

    /// What is shown, for programs.
    pub(super) fn state(&self) -> Value {
        self.value(&self.lock().player)
    }

    /// What this is, in words.
    pub(super) fn description(&self) -> String {
        format!("this is a recording of {}", self.reel.fleet())
    }

    fn go_on(&self, at: &mut At) {
        let now = Instant::now();
        at.player.advance(now - at.looked);
        at.looked = now;
        let at_ms = at.player.at_ms();
        let mut said = self.value(&at.player);
        // The page is told of that beside: it would be a change in each frame.
        if let Some(fields) = said.as_object_mut() {
            fields.remove("at_ms");
        }
        let taken = &mut at.taken;
        self.board.show_instant(at_ms, said, |picture| *taken = self.reel.seek(picture, *taken, at_ms));
    }

    fn value(&self, player: &Player) -> Value {
        let mut value = json!(player);
        value["marks"] = json!(self.reel.marks());
        if let Some(problem) = self.reel.damage() {
            value["problem"] = problem.into();
        }
        value
    }

    fn lock(&self) -> MutexGuard<'_, At> {
        // A picture that was left half done is brought to what is shown from the beginning on.
        self.at.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
