//! The picture that is shown, and its frames.

use crate::picture::{Ear, Heard, Picture, delta};
use consort_actors::clock::Clock;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Time from one frame to the next: five in a second show driving robots smoothly, since the page fills in between.
pub const FRAME: Duration = Duration::from_millis(200);

/// Frames without news after which one is sent all the same, so that the page knows that it is still connected.
const QUIET: u64 = 5;

/// A picture at one instant.
pub(super) struct Frame {
    pub(super) number: u64,
    at_ms: u64,
    whole: Value,
    /// What has changed since the frame before.
    patch: Option<Value>,
}

impl Frame {
    /// For somebody who has seen the frame `seen`: what has changed since, or the whole. `None` if there is nothing to say.
    pub(super) fn text_for(&self, seen: Option<u64>) -> Option<String> {
        let (number, now_ms) = (self.number, self.at_ms);
        if seen.is_none_or(|seen| seen + 1 != number) {
            return Some(json!({ "number": number, "now_ms": now_ms, "whole": self.whole }).to_string());
        }
        match &self.patch {
            Some(patch) => Some(json!({ "number": number, "now_ms": now_ms, "patch": patch }).to_string()),
            None if number.is_multiple_of(QUIET) => Some(json!({ "number": number, "now_ms": now_ms }).to_string()),
            None => None,
        }
    }
}

/// The picture that is shown.
pub struct Board {
    shown: Mutex<Shown>,
    clock: Clock,
    frames: watch::Sender<Arc<Frame>>,
}

struct Shown {
    picture: Picture,
    /// Of a recording: which instant of it is shown, and what is to be said of it.
    recording: Option<(u64, Value)>,
}

impl Shown {
    fn now_ms(&self, clock: Clock) -> u64 {
        self.recording.as_ref().map_or_else(|| clock.wall_ms(), |(at_ms, _)| *at_ms)
    }

    fn value(&self) -> Value {
        let mut value = self.picture.value();
        if let Some((_, recording)) = &self.recording {
            value["recording"] = recording.clone();
        }
        value
    }
}

impl Board {
    /// Shows a picture.
    pub fn new(picture: Picture, clock: Clock) -> Board {
        let frame = Frame { number: 0, at_ms: clock.wall_ms(), whole: picture.value(), patch: None };
        let shown = Shown { picture, recording: None };
        Board { shown: Mutex::new(shown), clock, frames: watch::Sender::new(Arc::new(frame)) }
    }

    /// Looks at the picture, or changes it; it is told what time it is, or which of a recording is shown.
    pub fn with<T>(&self, look: impl FnOnce(&mut Picture, u64) -> T) -> T {
        let mut shown = self.lock();
        let now_ms = shown.now_ms(self.clock);
        look(&mut shown.picture, now_ms)
    }

    /// Shows an instant of a recording: `bring` makes the picture what it was then.
    pub(super) fn show(&self, at_ms: u64, recording: Value, bring: impl FnOnce(&mut Picture)) {
        let mut shown = self.lock();
        bring(&mut shown.picture);
        shown.recording = Some((at_ms, recording));
    }

    /// The whole, with the time.
    pub(super) fn whole(&self) -> Value {
        let shown = self.lock();
        json!({ "now_ms": shown.now_ms(self.clock), "whole": shown.value() })
    }

    pub(super) fn frames(&self) -> watch::Receiver<Arc<Frame>> {
        self.frames.subscribe()
    }

    /// Draws a frame every [`FRAME`] while somebody looks.
    pub(super) async fn draw_for_ever(&self) {
        let mut ticks = tokio::time::interval(FRAME);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.draw();
        }
    }

    /// Draws a frame if somebody looks.
    pub(super) fn draw(&self) {
        if self.frames.receiver_count() == 0 {
            return;
        }
        let (at_ms, whole) = {
            let shown = self.lock();
            (shown.now_ms(self.clock), shown.value())
        };
        let before = self.frames.borrow().clone();
        let patch = delta::between(&before.whole, &whole);
        self.frames.send_replace(Arc::new(Frame { number: before.number + 1, at_ms, whole, patch }));
    }

    fn lock(&self) -> MutexGuard<'_, Shown> {
        // A picture is drawn anew every second: what a panic left half done does not stay.
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ear for Board {
    fn take(&self, heard: Heard) {
        self.with(|picture, now_ms| picture.take(&heard, now_ms));
    }

    fn missions_to_ask_for(&self) -> Vec<String> {
        self.with(|picture, _| picture.missions_to_ask_for())
    }

    fn wants_map(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::FloorPlan;

    fn frame(number: u64, patch: Option<Value>) -> Frame {
        Frame { number, at_ms: 7, whole: json!({ "a": 1 }), patch }
    }

    #[test]
    fn whoever_has_missed_a_frame_gets_the_whole_and_others_what_has_changed() {
        let news = frame(3, Some(json!({ "a": 2 })));
        assert_eq!(news.text_for(Some(2)).unwrap(), r#"{"now_ms":7,"number":3,"patch":{"a":2}}"#);
        for seen in [None, Some(0), Some(1)] {
            assert_eq!(news.text_for(seen).unwrap(), r#"{"now_ms":7,"number":3,"whole":{"a":1}}"#);
        }
        assert_eq!(frame(3, None).text_for(Some(2)), None);
        assert_eq!(frame(5, None).text_for(Some(4)).unwrap(), r#"{"now_ms":7,"number":5}"#);
    }

    #[tokio::test(start_paused = true)]
    async fn frames_are_drawn_while_somebody_looks_and_only_the_latest_is_kept() {
        let board = Arc::new(Board::new(Picture::new("ward", "s1", FloorPlan::default(), 0), Clock::real()));
        let drawing = Arc::clone(&board);
        let drawer = tokio::spawn(async move { drawing.draw_for_ever().await });
        tokio::time::sleep(FRAME * 10).await;
        assert_eq!(board.frames.borrow().number, 0, "nobody looks");
        let mut frames = board.frames();
        tokio::time::sleep(FRAME * 10).await;
        assert!(frames.borrow_and_update().number >= 9, "one after the other, and this is the latest");
        drawer.abort();
    }
}
