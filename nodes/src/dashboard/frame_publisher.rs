//! The picture that is shown, and its frames.

use crate::fleet_model::{FleetInput, FleetListener, FleetModel, delta};
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
    picture: FleetModel,
    /// Of a recording: which instant of it is shown, and what is to be said of it.
    recording: Option<(u64, Value)>,
    /// As in the frame of this number.
    whole: Value,
    number: u64,
    /// What time it is there.
    now_ms: u64,
    /// When it was drawn; nothing, if another instant of a recording is to be shown since.
    drawn_ms: Option<u64>,
    /// The whole in words, if it was asked for since.
    text: Option<Utf8Bytes>,
}

impl Drawn {
    fn time(&self, clock: Clock) -> u64 {
        self.recording.as_ref().map_or_else(|| clock.wall_ms(), |(at_ms, _)| *at_ms)
    }

    /// Brings the whole up to date, and says what has changed.
    fn redraw(&mut self) -> Option<Value> {
        let mut patch = self.picture.render_patch(&mut self.whole);
        if let Some((_, recording)) = &self.recording
            && let Some(change) = delta::between(&self.whole["recording"], recording)
        {
            self.whole["recording"] = recording.clone();
            patch.get_or_insert_with(|| json!({}))["recording"] = change;
        }
        patch
    }
}

/// The picture that is shown.
pub struct FramePublisher {
    drawn: Mutex<Drawn>,
    clock: Clock,
    frames: watch::Sender<Arc<Frame>>,
}

impl FramePublisher {
    /// Shows a picture.
    pub fn new(picture: FleetModel, clock: Clock) -> FramePublisher {
        let whole = Value::Null;
        let drawn = Drawn { picture, recording: None, whole, number: 0, now_ms: 0, drawn_ms: None, text: None };
        let frames = watch::Sender::new(Arc::new(Frame { number: 0, text: None }));
        FramePublisher { drawn: Mutex::new(drawn), clock, frames }
    }

    /// Looks at the picture, or changes it; it is told what time it is, or which of a recording is shown.
    pub fn with_model<T>(&self, look: impl FnOnce(&mut FleetModel, u64) -> T) -> T {
        let mut drawn = self.lock();
        let now_ms = drawn.time(self.clock);
        look(&mut drawn.picture, now_ms)
    }

    /// Shows an instant of a recording: `bring` makes the picture what it was then.
    pub(super) fn show_instant(&self, at_ms: u64, recording: Value, bring: impl FnOnce(&mut FleetModel)) {
        let mut drawn = self.lock();
        bring(&mut drawn.picture);
        drawn.recording = Some((at_ms, recording));
        drawn.drawn_ms = None;
    }

    /// The whole as it was drawn last, for somebody who has not seen the frame before; with the number of that frame.
    pub(super) fn full_frame(&self) -> (u64, Utf8Bytes) {
        let mut drawn = self.lock();
        // Nobody may have looked for long.
        if drawn.drawn_ms.is_none_or(|drawn_ms| self.clock.wall_ms().saturating_sub(drawn_ms) > FRAME_MS) {
            self.redraw(&mut drawn);
        }
        let Drawn { whole, number, now_ms, text, .. } = &mut *drawn;
        let write = || json!({ "number": number, "now_ms": now_ms, "whole": whole }).to_string().into();
        let text = text.get_or_insert_with(write);
        (*number, text.clone())
    }

    pub(super) fn frames(&self) -> watch::Receiver<Arc<Frame>> {
        self.frames.subscribe()
    }

    /// Draws a frame every [`FRAME`] while somebody looks.
    pub(super) async fn publish_forever(&self) {
        let mut ticks = tokio::time::interval(FRAME);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.publish_if_watched();
        }
    }

    /// Draws a frame if somebody looks.
    pub(super) fn publish_if_watched(&self) {
        if self.frames.receiver_count() > 0 {
            self.redraw(&mut self.lock());
        }
    }

    fn redraw(&self, drawn: &mut Drawn) {
        let patch = drawn.redraw();
        (drawn.number, drawn.now_ms, drawn.text) = (drawn.number + 1, drawn.time(self.clock), None);
        drawn.drawn_ms = Some(self.clock.wall_ms());
        let (number, now_ms) = (drawn.number, drawn.now_ms);
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

impl FleetListener for FramePublisher {
    fn on_input(&self, heard: FleetInput) {
        self.with_model(|picture, now_ms| picture.apply(&heard, now_ms));
    }

    fn missions_to_query(&self) -> Vec<String> {
        self.with_model(|picture, _| picture.missions_to_query())
    }

    fn needs_map(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet_model::FloorPlan;

    fn said(text: &str) -> Value {
        serde_json::from_str(text).unwrap()
    }

    #[tokio::test(start_paused = true)]
    async fn frames_tell_what_has_changed_and_the_whole_is_what_they_come_to() {
        let picture = FleetModel::new("ward", "s1", FloorPlan::default(), 0);
        let board = FramePublisher::new(picture, Clock::virtual_at(1000));
        let (first, whole) = board.full_frame();
        let mut seen = said(&whole)["whole"].clone();
        assert_eq!((first, &seen["fleet"]), (1, &json!("ward")));
        assert_eq!(whole.as_ptr(), board.full_frame().1.as_ptr(), "written once for all who ask");
        for links in [1, 1, 2] {
            board.with_model(|picture, now_ms| picture.apply_links(links, now_ms));
            board.redraw(&mut board.lock());
            let frame = board.frames().borrow().clone();
            if let Some(text) = &frame.text {
                delta::apply(&mut seen, &said(text)["patch"]);
            }
            assert_eq!((frame.number, &seen), (board.full_frame().0, &said(&board.full_frame().1)["whole"]));
        }
        assert_eq!(seen["reach"]["links"], 2);
        let quiet: Vec<Option<Value>> = (0..QUIET)
            .map(|_| {
                board.redraw(&mut board.lock());
                board.frames().borrow().text.as_ref().map(|text| said(text))
            })
            .collect();
        let told: Vec<&Value> = quiet.iter().flatten().collect();
        assert_eq!(told, [&json!({ "number": 5, "now_ms": 1000 })], "a sign of life now and then");
    }

    #[tokio::test(start_paused = true)]
    async fn of_a_recording_the_instant_that_was_asked_for_is_shown_at_once_and_its_time_passes_by_itself() {
        let empty = || FleetModel::new("ward", "recorder", FloorPlan::default(), 0);
        let board = FramePublisher::new(empty(), Clock::virtual_at(90_000));
        let linked = |links: usize| {
            let mut picture = empty();
            picture.apply_links(links, 0);
            picture
        };
        board.show_instant(700, json!({ "playing": false, "jumps": 0 }), |picture| *picture = linked(3));
        let mut seen = said(&board.full_frame().1);
        assert_eq!((&seen["now_ms"], &seen["whole"]["reach"]["links"]), (&json!(700), &json!(3)));
        // Nobody looks on: whoever asks has it all the same.
        board.show_instant(500, json!({ "playing": false, "jumps": 1 }), |picture| *picture = linked(2));
        board.publish_if_watched();
        assert_eq!(board.frames.borrow().number, 1, "drawn for whoever asked");
        seen = said(&board.full_frame().1);
        assert_eq!(
            (&seen["number"], &seen["now_ms"], &seen["whole"]["reach"]["links"]),
            (&json!(2), &json!(500), &json!(2))
        );
        // Somebody does: what has changed is told, of the picture and of what is said beside it.
        let mut frames = board.frames();
        for (at_ms, jumps, links, patch) in [
            (600, 1, 2, None),
            (800, 2, 2, Some(json!({ "recording": { "jumps": 2 } }))),
            (900, 2, 5, Some(json!({ "reach": { "links": 5 } }))),
        ] {
            board.show_instant(at_ms, json!({ "playing": false, "jumps": jumps }), |picture| {
                picture.apply_links(links, 0)
            });
            board.publish_if_watched();
            let frame = frames.borrow_and_update().clone();
            let told = frame.text.as_ref().map(|text| said(text));
            assert_eq!(told.as_ref().map(|told| told["now_ms"].clone()), patch.is_some().then(|| json!(at_ms)));
            assert_eq!(told.map(|told| told["patch"].clone()), patch);
            assert_eq!(said(&board.full_frame().1)["now_ms"], at_ms);
            assert_eq!(board.with_model(|_, now_ms| now_ms), at_ms);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn frames_are_drawn_while_somebody_looks_and_only_the_latest_is_kept() {
        let board =
            Arc::new(FramePublisher::new(FleetModel::new("ward", "s1", FloorPlan::default(), 0), Clock::real()));
        let drawing = Arc::clone(&board);
        let drawer = tokio::spawn(async move { drawing.publish_forever().await });
        tokio::time::sleep(FRAME * 10).await;
        assert_eq!(board.frames.borrow().number, 0, "nobody looks");
        let (number, _) = board.full_frame();
        assert_eq!((number, board.full_frame().0), (1, 1), "drawn for whoever asks, once in a while");
        let mut frames = board.frames();
        tokio::time::sleep(FRAME * 10).await;
        assert!(frames.borrow_and_update().number >= 9, "one after the other, and this is the latest");
        drawer.abort();
    }
}
