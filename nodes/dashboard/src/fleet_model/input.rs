//! Inputs of the fleet model, as values: they can be applied at once, recorded, and replayed.

use super::FleetModel;
use consort_protocol::event::Event;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_protocol::scalar::Scalar;
use consort_skills::actions::Telemetry;
use serde_json::Value;
use std::collections::BTreeMap;

/// An input from a fleet.
#[derive(Debug, Clone, PartialEq)]
pub enum FleetInput {
    /// An event published by a node.
    Event(Box<Event>),
    /// Telemetry of a robot.
    Telemetry {
        /// The robot.
        robot: String,
        /// The telemetry.
        telemetry: Telemetry,
        /// Values of the feedback of its goal in progress, by name.
        feedback: BTreeMap<String, Scalar>,
    },
    /// A coordinator's beacon.
    Beacon(Beacon),
    /// Number of links to other nodes. Received several times per second, it also drives the
    /// passing of time.
    Links(usize),
    /// A view returned by a node.
    View {
        /// Key of the view.
        key: Key,
        /// Content of the view.
        view: Value,
    },
}

/// A receiver of the inputs from a fleet.
pub trait FleetListener: Send + Sync + 'static {
    /// Receives an input.
    fn on_input(&self, heard: FleetInput);

    /// Returns the missions to query individually, the most important first.
    fn missions_to_query(&self) -> Vec<String>;

    /// Checks whether the fleet's map is needed.
    fn needs_map(&self) -> bool;
}

impl FleetModel {
    /// Applies an input. The model depends only on its inputs and their times.
    pub fn apply(&mut self, heard: &FleetInput, now_ms: u64) {
        match heard {
            FleetInput::Event(event) => self.apply_event(event, now_ms),
            FleetInput::Telemetry { robot, telemetry, feedback } => {
                self.apply_telemetry(robot, telemetry, now_ms);
                self.apply_feedback(robot, feedback);
            }
            FleetInput::Beacon(beacon) => self.apply_beacon(beacon, now_ms),
            FleetInput::Links(links) => self.apply_links(*links, now_ms),
            FleetInput::View { key, view } => self.apply_view(key, view, now_ms),
        }
    }
}
