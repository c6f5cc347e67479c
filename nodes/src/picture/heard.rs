//! What a picture is made of, as values: so that what is heard of a fleet can be drawn at once, kept, and drawn again.

use super::Picture;
use consort_protocol::event::Event;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_skills::actions::Telemetry;
use serde_json::Value;

/// Something heard of a fleet.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    /// A node told what happened.
    Event(Box<Event>),
    /// A body reported of itself.
    Body {
        /// Whose body it is.
        robot: String,
        /// Its report.
        telemetry: Telemetry,
    },
    /// The coordinator gave a sign of life.
    Beacon(Beacon),
    /// So many other nodes are linked. Heard some times in a second, it is also how time passes.
    Links(usize),
    /// A node showed what it knows.
    View {
        /// Which view it is.
        key: Key,
        /// What it holds.
        view: Value,
    },
}

/// Whoever is told what is heard of a fleet.
pub trait Ear: Send + Sync + 'static {
    /// Takes in what was just heard.
    fn take(&self, heard: Heard);

    /// The missions whose own views are wanted, the most wanted first.
    fn missions_to_ask_for(&self) -> Vec<String>;

    /// Whether the fleet's map is wanted.
    fn wants_map(&self) -> bool;
}

impl Picture {
    /// Takes in what was heard. A picture depends on what it has taken in, and when, and on nothing else.
    pub fn take(&mut self, heard: &Heard, now_ms: u64) {
        match heard {
            Heard::Event(event) => self.take_event(event, now_ms),
            Heard::Body { robot, telemetry } => self.take_body(robot, telemetry, now_ms),
            Heard::Beacon(beacon) => self.take_beacon(beacon, now_ms),
            Heard::Links(links) => self.take_links(*links, now_ms),
            Heard::View { key, view } => self.take_view(key, view, now_ms),
        }
    }
}
