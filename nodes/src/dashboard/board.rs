//! The picture that is shown, and its frames.

use crate::picture::Picture;
use axum::extract::ws::Utf8Bytes;
use consort_actors::clock::Clock;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Time from one frame to the next: five in a second show driving robots smoothly, since the page fills in between.
pub const FRAME: Duration = Duration::from_millis(FRAME_MS);

const FRAME_MS: u64 = 200;

/// Frames without news after which one is sent all the same, so that the page knows that it is still connected.
const QUIET: u64 = 5;

/// What has changed from one instant to the next, as the page is told: written once, whoever looks.
pub(super) struct Frame {
    pub(super) number: u64,
    /// Nothing, if nothing has changed and nobody is to be told so.
    pub(super) text: Option<Utf8Bytes>,
}

/// A picture, and what it was drawn to.
struct Drawn {
    picture: Picture,
    /// As in the frame of this number.
    whole: Value,
    number: u64,
    at_ms: u64,
    /// The whole in words, if it was asked for since.
    text: Option<Utf8Bytes>,
}

/// The picture that is shown.
pub struct Board {
    drawn: Mutex<Drawn>,
    clock: Clock,
    frames: watch::Sender<Arc<Frame>>,
}

impl Board {
    /// Shows a picture.
    pub fn new(picture: Picture, clock: Clock) -> Board {
        let drawn = Drawn { picture, whole: Value::Null, number: 0, at_ms: 0, text: None };
        let frames = watch::Sender::new(Arc::new(Frame { number: 0, text: None }));
        Board { drawn: Mutex::new(drawn), clock, frames }
    }

    /// Looks at the picture, or changes it; it is told what time it is.
    pub fn with<T>(&self, look: impl FnOnce(&mut Picture, u64) -> T) -> T {
        let now_ms = self.clock.wall_ms();
        look(&mut self.lock().picture, now_ms)
    }

    /// The whole as it was drawn last, for somebody who has not seen the frame before; with the number of that frame.
    pub(super) fn whole(&self) -> (u64, Utf8Bytes) {
        let mut drawn = self.lock();
        // Nobody may have looked for long.
        if drawn.whole.is_null() || self.clock.wall_ms().saturating_sub(drawn.at_ms) > FRAME_MS {
            self.draw(&mut drawn);
        }
        let Drawn { whole, number, at_ms, text, .. } = &mut *drawn;
        let write = || json!({ "number": number, "now_ms": at_ms, "whole": whole }).to_string().into();
        let text = text.get_or_insert_with(write);
        (*number, text.clone())
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
            if self.frames.receiver_count() > 0 {
                self.draw(&mut self.lock());
            }
        }
    }

    fn draw(&self, drawn: &mut Drawn) {
        let patch = drawn.picture.redraw(&mut drawn.whole);
        (drawn.number, drawn.at_ms, drawn.text) = (drawn.number + 1, self.clock.wall_ms(), None);
        let (number, now_ms) = (drawn.number, drawn.at_ms);
        let told = match patch {
            Some(patch) => Some(json!({ "number": number, "now_ms": now_ms, "patch": patch })),
            None if number.is_multiple_of(QUIET) => Some(json!({ "number": number, "now_ms": now_ms })),
            None => None,
        };
        let text = told.map(|told| told.to_string().into());
        self.frames.send_replace(Arc::new(Frame { number, text }));
    }

    fn lock(&self) -> MutexGuard<'_, Drawn> {
        // Views are taken in anew every second: what a panic left half done does not stay.
        self.drawn.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::{FloorPlan, delta};

    fn said(text: &str) -> Value {
        serde_json::from_str(text).unwrap()
    }

    #[tokio::test(start_paused = true)]
    async fn frames_tell_what_has_changed_and_the_whole_is_what_they_come_to() {
        let picture = Picture::new("ward", "s1", FloorPlan::default(), 0);
        let board = Board::new(picture, Clock::virtual_at(1000));
        let (first, whole) = board.whole();
        let mut seen = said(&whole)["whole"].clone();
        assert_eq!((first, &seen["fleet"]), (1, &json!("ward")));
        assert_eq!(whole.as_ptr(), board.whole().1.as_ptr(), "written once for all who ask");
        for links in [1, 1, 2] {
            board.with(|picture, now_ms| picture.take_links(links, now_ms));
            board.draw(&mut board.lock());
            let frame = board.frames().borrow().clone();
            if let Some(text) = &frame.text {
                delta::apply(&mut seen, &said(text)["patch"]);
            }
            assert_eq!((frame.number, &seen), (board.whole().0, &said(&board.whole().1)["whole"]));
        }
        assert_eq!(seen["reach"]["links"], 2);
        let quiet: Vec<Option<Value>> = (0..QUIET)
            .map(|_| {
                board.draw(&mut board.lock());
                board.frames().borrow().text.as_ref().map(|text| said(text))
            })
            .collect();
        let told: Vec<&Value> = quiet.iter().flatten().collect();
        assert_eq!(told, [&json!({ "number": 5, "now_ms": 1000 })], "a sign of life now and then");
    }

    #[tokio::test(start_paused = true)]
    async fn frames_are_drawn_while_somebody_looks_and_only_the_latest_is_kept() {
        let board = Arc::new(Board::new(Picture::new("ward", "s1", FloorPlan::default(), 0), Clock::real()));
        let drawing = Arc::clone(&board);
        let drawer = tokio::spawn(async move { drawing.draw_for_ever().await });
        tokio::time::sleep(FRAME * 10).await;
        assert_eq!(board.frames.borrow().number, 0, "nobody looks");
        let (number, _) = board.whole();
        assert_eq!((number, board.whole().0), (1, 1), "drawn for whoever asks, once in a while");
        let mut frames = board.frames();
        tokio::time::sleep(FRAME * 10).await;
        assert!(frames.borrow_and_update().number >= 9, "one after the other, and this is the latest");
        drawer.abort();
    }
}
