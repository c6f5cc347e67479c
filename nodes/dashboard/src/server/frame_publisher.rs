//! The fleet model that is shown, and its frames.

use crate::fleet_model::{FleetInput, FleetListener, FleetModel, delta};
use axum::extract::ws::Utf8Bytes;
use consort_bus::clock::Clock;
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Time between frames: five frames per second show driving robots smoothly, since the page
/// interpolates.
pub const FRAME: Duration = Duration::from_millis(FRAME_MS);

const FRAME_MS: u64 = 200;

/// Number of unchanged frames after which an empty frame is sent, so that the page can detect a
/// broken connection.
const KEEP_ALIVE_FRAMES: u64 = 5;

/// A message to the page.
#[derive(Serialize)]
struct FrameMessage<'a> {
    number: u64,
    /// Time in the model, in milliseconds since 1970.
    now_ms: u64,
    /// What the frame contains; nothing in a keep-alive frame.
    #[serde(flatten)]
    content: Option<FrameContent<'a>>,
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum FrameContent<'a> {
    /// The complete model.
    Full(&'a Value),
    /// Change since the frame before, as in RFC 7396 (JSON Merge Patch).
    Patch(&'a Value),
}

impl FrameMessage<'_> {
    fn to_text(&self) -> Utf8Bytes {
        serde_json::to_string(self).expect("JSON values have a JSON form").into()
    }
}

/// Change between two instants, as sent to the page: serialised once for all clients.
pub(super) struct Frame {
    pub(super) number: u64,
    /// Message; `None` if nothing has changed and no keep-alive is due.
    pub(super) text: Option<Utf8Bytes>,
}

/// A fleet model, and its JSON as of the last frame.
struct Rendered {
    model: FleetModel,
    /// Shown instant and playback state, if it is a recording.
    recording: Option<(u64, Value)>,
    /// JSON of the model in the frame `number`.
    full: Value,
    number: u64,
    /// Time in the model.
    now_ms: u64,
    /// Time of the last rendering; `None` if another instant of a recording is to be shown since.
    drawn_ms: Option<u64>,
    /// Serialised JSON of the model, if it was requested since.
    text: Option<Utf8Bytes>,
}

impl Rendered {
    fn time(&self, clock: Clock) -> u64 {
        self.recording.as_ref().map_or_else(|| clock.wall_ms(), |(at_ms, _)| *at_ms)
    }

    /// Updates the JSON of the model, and returns the change.
    fn redraw(&mut self) -> Option<Value> {
        let mut patch = self.model.render_patch(&mut self.full);
        if let Some((_, recording)) = &self.recording
            && let Some(change) = delta::between(&self.full["recording"], recording)
        {
            self.full["recording"] = recording.clone();
            patch.get_or_insert_with(|| json!({}))["recording"] = change;
        }
        patch
    }
}

/// Publishes the frames of a fleet model.
pub struct FramePublisher {
    rendered: Mutex<Rendered>,
    clock: Clock,
    frames: watch::Sender<Arc<Frame>>,
}

impl FramePublisher {
    /// Publishes a fleet model.
    pub fn new(model: FleetModel, clock: Clock) -> FramePublisher {
        let full = Value::Null;
        let rendered = Rendered { model, recording: None, full, number: 0, now_ms: 0, drawn_ms: None, text: None };
        let frames = watch::Sender::new(Arc::new(Frame { number: 0, text: None }));
        FramePublisher { rendered: Mutex::new(rendered), clock, frames }
    }

    /// Runs `look` with the model and the current time, or the time of the recording.
    pub fn with_model<T>(&self, look: impl FnOnce(&mut FleetModel, u64) -> T) -> T {
        let mut rendered = self.lock();
        let now_ms = rendered.time(self.clock);
        look(&mut rendered.model, now_ms)
    }

    /// Shows an instant of a recording: `seek` brings the model to its state at that time.
    pub(super) fn show_instant(&self, at_ms: u64, recording: Value, seek: impl FnOnce(&mut FleetModel)) {
        let mut rendered = self.lock();
        seek(&mut rendered.model);
        rendered.recording = Some((at_ms, recording));
        rendered.drawn_ms = None;
    }

    /// Returns the complete model of the latest frame, for a client without the frame before it,
    /// and the number of that frame.
    pub(super) fn full_frame(&self) -> (u64, Utf8Bytes) {
        let mut rendered = self.lock();
        // There may have been no client for a long time.
        if rendered.drawn_ms.is_none_or(|drawn_ms| self.clock.wall_ms().saturating_sub(drawn_ms) > FRAME_MS) {
            self.redraw(&mut rendered);
        }
        let Rendered { full, number, now_ms, text, .. } = &mut *rendered;
        let content = Some(FrameContent::Full(full));
        let text = text.get_or_insert_with(|| FrameMessage { number: *number, now_ms: *now_ms, content }.to_text());
        (*number, text.clone())
    }

    pub(super) fn frames(&self) -> watch::Receiver<Arc<Frame>> {
        self.frames.subscribe()
    }

    /// Renders a frame every [`FRAME`] while there are clients.
    pub(super) async fn publish_forever(&self) {
        let mut ticks = tokio::time::interval(FRAME);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.publish_if_watched();
        }
    }

    /// Renders a frame if there are clients.
    pub(super) fn publish_if_watched(&self) {
        if self.frames.receiver_count() > 0 {
            self.redraw(&mut self.lock());
        }
    }

    fn redraw(&self, rendered: &mut Rendered) {
        let patch = rendered.redraw();
        (rendered.number, rendered.now_ms, rendered.text) = (rendered.number + 1, rendered.time(self.clock), None);
        rendered.drawn_ms = Some(self.clock.wall_ms());
        let (number, now_ms) = (rendered.number, rendered.now_ms);
        let is_due = patch.is_some() || number.is_multiple_of(KEEP_ALIVE_FRAMES);
        let content = patch.as_ref().map(FrameContent::Patch);
        let text = is_due.then(|| FrameMessage { number, now_ms, content }.to_text());
        self.frames.send_replace(Arc::new(Frame { number, text }));
    }

    fn lock(&self) -> MutexGuard<'_, Rendered> {
        // Views are applied again every second, which repairs a partial update after a panic.
        self.rendered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FleetListener for FramePublisher {
    fn on_input(&self, heard: FleetInput) {
        self.with_model(|model, now_ms| model.apply(&heard, now_ms));
    }

    fn missions_to_query(&self) -> Vec<String> {
        self.with_model(|model, _| model.missions_to_query())
    }

    fn needs_map(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet_model::FloorPlan;

    fn parse(text: &str) -> Value {
        serde_json::from_str(text).unwrap()
    }

    #[tokio::test(start_paused = true)]
    async fn frames_contain_changes_that_add_up_to_the_full_model() {
        let model = FleetModel::new("ward", "s1", FloorPlan::default(), 0);
        let publisher = FramePublisher::new(model, Clock::virtual_at(1000));
        let (first, full) = publisher.full_frame();
        let mut seen = parse(&full)["full"].clone();
        assert_eq!((first, &seen["fleet"]), (1, &json!("ward")));
        assert_eq!(full.as_ptr(), publisher.full_frame().1.as_ptr(), "serialised once for all clients");
        for links in [1, 1, 2] {
            publisher.with_model(|model, now_ms| model.apply_links(links, now_ms));
            publisher.redraw(&mut publisher.lock());
            let frame = publisher.frames().borrow().clone();
            if let Some(text) = &frame.text {
                delta::apply(&mut seen, &parse(text)["patch"]);
            }
            assert_eq!((frame.number, &seen), (publisher.full_frame().0, &parse(&publisher.full_frame().1)["full"]));
        }
        assert_eq!(seen["reachability"]["links"], 2);
        let quiet: Vec<Option<Value>> = (0..KEEP_ALIVE_FRAMES)
            .map(|_| {
                publisher.redraw(&mut publisher.lock());
                publisher.frames().borrow().text.as_ref().map(|text| parse(text))
            })
            .collect();
        let message: Vec<&Value> = quiet.iter().flatten().collect();
        assert_eq!(message, [&json!({ "number": 5, "now_ms": 1000 })], "an occasional keep-alive frame");
    }

    #[tokio::test(start_paused = true)]
    async fn a_requested_instant_of_a_recording_is_shown_at_once() {
        let empty = || FleetModel::new("ward", "recorder", FloorPlan::default(), 0);
        let publisher = FramePublisher::new(empty(), Clock::virtual_at(90_000));
        let with_links = |links: usize| {
            let mut model = empty();
            model.apply_links(links, 0);
            model
        };
        publisher.show_instant(700, json!({ "playing": false, "seeks": 0 }), |model| *model = with_links(3));
        let mut seen = parse(&publisher.full_frame().1);
        assert_eq!((&seen["now_ms"], &seen["full"]["reachability"]["links"]), (&json!(700), &json!(3)));
        // There are no clients: a request still gets the model.
        publisher.show_instant(500, json!({ "playing": false, "seeks": 1 }), |model| *model = with_links(2));
        publisher.publish_if_watched();
        assert_eq!(publisher.frames.borrow().number, 1, "rendered for the request");
        seen = parse(&publisher.full_frame().1);
        assert_eq!(
            (&seen["number"], &seen["now_ms"], &seen["full"]["reachability"]["links"]),
            (&json!(2), &json!(500), &json!(2))
        );
        // With a client: changes of the model and of the playback state are published.
        let mut frames = publisher.frames();
        for (at_ms, seeks, links, patch) in [
            (600, 1, 2, None),
            (800, 2, 2, Some(json!({ "recording": { "seeks": 2 } }))),
            (900, 2, 5, Some(json!({ "reachability": { "links": 5 } }))),
        ] {
            publisher
                .show_instant(at_ms, json!({ "playing": false, "seeks": seeks }), |model| model.apply_links(links, 0));
            publisher.publish_if_watched();
            let frame = frames.borrow_and_update().clone();
            let message = frame.text.as_ref().map(|text| parse(text));
            assert_eq!(
                message.as_ref().map(|message| message["now_ms"].clone()),
                patch.is_some().then(|| json!(at_ms))
            );
            assert_eq!(message.map(|message| message["patch"].clone()), patch);
            assert_eq!(parse(&publisher.full_frame().1)["now_ms"], at_ms);
            assert_eq!(publisher.with_model(|_, now_ms| now_ms), at_ms);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn frames_are_rendered_while_there_are_clients() {
        let publisher =
            Arc::new(FramePublisher::new(FleetModel::new("ward", "s1", FloorPlan::default(), 0), Clock::real()));
        let watched = Arc::clone(&publisher);
        let task = tokio::spawn(async move { watched.publish_forever().await });
        tokio::time::sleep(FRAME * 10).await;
        assert_eq!(publisher.frames.borrow().number, 0, "there are no clients");
        let (number, _) = publisher.full_frame();
        assert_eq!((number, publisher.full_frame().0), (1, 1), "rendered for the request, at most once per frame time");
        let mut frames = publisher.frames();
        tokio::time::sleep(FRAME * 10).await;
        assert!(frames.borrow_and_update().number >= 9, "consecutive frames, of which this is the latest");
        task.abort();
    }
}
