//! Topics and schemas of our own.

use crate::fleet_model::FleetInput;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_sim::record::foxglove::Schema;
use consort_skills::actions::Telemetry;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The record at the beginning of a file, and what it says.
pub(super) const FLEET_METADATA: &str = "consort.fleet";

/// How files are written now. One of another number may hold what this program does not know.
pub(super) const FORMAT_VERSION: &str = "1";

pub(super) static EVENT: Schema = Schema::new("consort.Event", || {
    json!({
        "type": "object",
        "description": "What happened, as the node told it on consort/FLEET/events/NODE; the fields depend on the event.",
        "required": ["node", "sequence", "at_ms", "event"],
        "properties": {
            "node": { "type": "string", "description": "Where it happened." },
            "sequence": { "type": "integer", "description": "Counts the node's events since it started, from 1." },
            "at_ms": { "type": "integer", "description": "When, in milliseconds of the node's wall clock." },
            "event": { "type": "string", "description": "What kind of event it is." },
            "mission": { "type": "string" }, "role": { "type": "string" }, "task": { "type": "string" },
        },
    })
});

pub(super) static GAP: Schema = Schema::new("consort.Gap", || {
    json!({
        "type": "object",
        "description": "Events that a node numbered and that were not heard.",
        "required": ["node", "after", "before", "lost"],
        "properties": {
            "node": { "type": "string" },
            "after": { "type": "integer", "description": "The number of the last event before; 0 if the node had just started." },
            "before": { "type": "integer", "description": "The number of the first one that was heard again." },
            "lost": { "type": "integer", "description": "How many there were in between." },
        },
    })
});

pub(super) static BEACON: Schema = Schema::new("consort.Beacon", || {
    json!({
        "type": "object",
        "description": "The coordinator's sign of life.",
        "required": ["node", "term", "since_ms", "voters"],
        "properties": {
            "node": { "type": "string" },
            "term": { "type": "integer" },
            "since_ms": { "type": "integer", "description": "How long it has coordinated, in milliseconds." },
            "voters": { "type": "array", "items": { "type": "string" }, "description": "Who keeps the ledger." },
        },
    })
});

pub(super) static TELEMETRY: Schema = Schema::new("consort.Body", || {
    let pose = json!({
        "type": "object",
        "required": ["x_m", "y_m", "yaw_rad"],
        "properties": {
            "x_m": { "type": "number" }, "y_m": { "type": "number" }, "yaw_rad": { "type": "number" },
        },
    });
    json!({
        "type": "object",
        "description": "What a robot's body reports of itself.",
        "required": ["time", "pose", "place", "battery", "able"],
        "properties": {
            "time": { "type": "number", "description": "Seconds on the world's clock." },
            "pose": pose,
            "place": { "type": "string", "description": "Where it stands, or the last place that it passed." },
            "battery": { "type": "number", "description": "Charge left, as a share." },
            "able": { "type": "boolean", "description": "Whether it can still move." },
        },
    })
});

pub(super) static LINKS: Schema = Schema::new("consort.Links", || {
    json!({
        "type": "object",
        "description": "How many nodes the recorder was linked to.",
        "required": ["links"],
        "properties": { "links": { "type": "integer" } },
    })
});

pub(super) static VIEW: Schema = Schema::new("consort.View", || {
    json!({
        "type": "object",
        "description": "What a node answered to somebody who looked.",
        "required": ["key", "view"],
        "properties": {
            "key": { "type": "string", "description": "The key that was asked." },
            "view": { "type": "object", "description": "The answer." },
        },
    })
});

pub(super) static REPEATED_VIEW: Schema = Schema::new("consort.Again", || {
    json!({
        "type": "object",
        "description": "A node answered what was answered on this key before, but for its age.",
        "required": ["key"],
        "properties": {
            "key": { "type": "string", "description": "The key that was asked." },
            "age_ms": { "type": ["integer", "null"], "description": "The age that the answer gives." },
        },
    })
});

#[derive(Serialize, Deserialize)]
pub(super) struct RepeatedViewMessage {
    pub(super) key: String,
    pub(super) age_ms: Option<u64>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct LinksMessage {
    pub(super) links: usize,
}

#[derive(Serialize, Deserialize)]
pub(super) struct ViewMessage<V> {
    pub(super) key: String,
    pub(super) view: V,
}

/// The topic of a view. Missions come and go: they share one.
pub(super) fn view_topic(key: &Key) -> String {
    match key {
        Key::ViewMission(_) => "/view/mission".to_owned(),
        key => format!("/{key}"),
    }
}

pub(super) fn telemetry_topic(robot: &str) -> String {
    format!("/robots/{robot}/body")
}

/// What kind of input a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MessageKind {
    Event,
    Beacon,
    Telemetry,
    Links,
    View,
    /// A view as it was answered before.
    RepeatedView,
}

impl MessageKind {
    /// That of messages of a schema.
    pub(super) fn of(schema: &str) -> Option<MessageKind> {
        let kinds = [
            (&EVENT, MessageKind::Event),
            (&BEACON, MessageKind::Beacon),
            (&TELEMETRY, MessageKind::Telemetry),
            (&LINKS, MessageKind::Links),
            (&VIEW, MessageKind::View),
            (&REPEATED_VIEW, MessageKind::RepeatedView),
        ];
        kinds.into_iter().find(|(known, _)| known.name() == schema).map(|(_, kind)| kind)
    }

    /// Reads a message back; `None` for one that makes no sense by itself.
    pub(super) fn parse(self, keys: &Keys, topic: &str, data: &[u8]) -> Option<FleetInput> {
        let heard = match self {
            MessageKind::RepeatedView => return None,
            MessageKind::Event => FleetInput::Event(serde_json::from_slice(data).ok()?),
            MessageKind::Beacon => FleetInput::Beacon(serde_json::from_slice::<Beacon>(data).ok()?),
            MessageKind::Links => FleetInput::Links(serde_json::from_slice::<LinksMessage>(data).ok()?.links),
            MessageKind::Telemetry => {
                let robot = topic.strip_prefix("/robots/")?.strip_suffix("/body")?.to_owned();
                FleetInput::Telemetry { robot, telemetry: serde_json::from_slice::<Telemetry>(data).ok()? }
            }
            MessageKind::View => {
                let ViewMessage::<Value> { key, view } = serde_json::from_slice(data).ok()?;
                FleetInput::View { key: keys.read(&key)?, view }
            }
        };
        Some(heard)
    }
}
