//! What a picture is made of, as values: so that what is heard of a fleet can be drawn at once, kept, and drawn again.

use super::FleetModel;
use consort_protocol::event::Event;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_skills::actions::Telemetry;
use serde_json::Value;

/// Something heard of a fleet.
#[derive(Debug, Clone, PartialEq)]
pub enum FleetInput {
    /// A node told what happened.
    Event(Box<Event>),
    /// A body reported of itself.
    Telemetry {
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
pub trait FleetListener: Send + Sync + 'static {
    /// Takes in what was just heard.
    fn on_input(&self, heard: FleetInput);

    /// The missions whose own views are wanted, the most wanted first.
    fn missions_to_query(&self) -> Vec<String>;

    /// Whether the fleet's map is wanted.
    fn needs_map(&self) -> bool;
}

impl FleetModel {
    /// Takes in what was heard. A picture depends on what it has taken in, and when, and on nothing else.
    pub fn apply(&mut self, heard: &FleetInput, now_ms: u64) {
        match heard {
            FleetInput::Event(event) => self.apply_event(event, now_ms),
            FleetInput::Telemetry { robot, telemetry } => self.apply_telemetry(robot, telemetry, now_ms),
            FleetInput::Beacon(beacon) => self.apply_beacon(beacon, now_ms),
            FleetInput::Links(links) => self.apply_links(*links, now_ms),
            FleetInput::View { key, view } => self.apply_view(key, view, now_ms),
        }
    }
}
