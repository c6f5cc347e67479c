//! Topics and schemas of recordings.

use crate::fleet_model::FleetInput;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_skills::actions::Telemetry;
use consort_world::record::foxglove::Schema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Name of the metadata record at the beginning of a file.
pub(super) const FLEET_METADATA: &str = "consort.fleet";

/// Version of the file format. A file with another version may contain unknown messages.
pub(super) const FORMAT_VERSION: &str = "1";

pub(super) static EVENT: Schema = Schema::new("consort.Event", || {
    json!({
        "type": "object",
        "description": "An event, as the node published it on consort/FLEET/events/NODE; the fields depend on the event.",
        "required": ["node", "sequence", "at_ms", "event"],
        "properties": {
            "node": { "type": "string", "description": "The publishing node." },
            "sequence": { "type": "integer", "description": "Sequence number of the node's events since its start, from 1." },
            "at_ms": { "type": "integer", "description": "Time, in milliseconds of the node's wall clock." },
            "event": { "type": "string", "description": "Kind of the event." },
            "mission": { "type": "string" }, "role": { "type": "string" }, "task": { "type": "string" },
        },
    })
});

pub(super) static GAP: Schema = Schema::new("consort.Gap", || {
    json!({
        "type": "object",
        "description": "Missed events of a node, by their sequence numbers.",
        "required": ["node", "after", "before", "lost"],
        "properties": {
            "node": { "type": "string" },
            "after": { "type": "integer", "description": "Number of the last event before the gap; 0 if the node had just started." },
            "before": { "type": "integer", "description": "Number of the first event after the gap." },
            "lost": { "type": "integer", "description": "Number of missed events." },
        },
    })
});

pub(super) static BEACON: Schema = Schema::new("consort.Beacon", || {
    json!({
        "type": "object",
        "description": "The coordinator's beacon.",
        "required": ["node", "term", "since_ms", "voters"],
        "properties": {
            "node": { "type": "string" },
            "term": { "type": "integer" },
            "since_ms": { "type": "integer", "description": "Time since its election, in milliseconds." },
            "voters": { "type": "array", "items": { "type": "string" }, "description": "Voters of the ledger." },
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
        "description": "Telemetry of a robot.",
        "required": ["time", "pose", "place", "battery", "able"],
        "properties": {
            "time": { "type": "number", "description": "Seconds on the world's clock." },
            "pose": pose,
            "place": { "type": "string", "description": "Current place, or the last passed place." },
            "battery": { "type": "number", "description": "Charge left, as a share." },
            "able": { "type": "boolean", "description": "True if it can still move." },
        },
    })
});

pub(super) static LINKS: Schema = Schema::new("consort.Links", || {
    json!({
        "type": "object",
        "description": "Number of nodes linked to the recorder.",
        "required": ["links"],
        "properties": { "links": { "type": "integer" } },
    })
});

pub(super) static VIEW: Schema = Schema::new("consort.View", || {
    json!({
        "type": "object",
        "description": "A view returned by a node.",
        "required": ["key", "view"],
        "properties": {
            "key": { "type": "string", "description": "The queried key." },
            "view": { "type": "object", "description": "The reply." },
        },
    })
});

pub(super) static REPEATED_VIEW: Schema = Schema::new("consort.Again", || {
    json!({
        "type": "object",
        "description": "A view with the same content as the last view of this key, except for its age.",
        "required": ["key"],
        "properties": {
            "key": { "type": "string", "description": "The queried key." },
            "age_ms": { "type": ["integer", "null"], "description": "Age in the reply." },
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

/// Returns the topic of a view. All missions share a topic because they come and go.
pub(super) fn view_topic(key: &Key) -> String {
    match key {
        Key::ViewMission(_) => "/view/mission".to_owned(),
        key => format!("/{key}"),
    }
}

pub(super) fn telemetry_topic(robot: &str) -> String {
    format!("/robots/{robot}/body")
}

/// Kind of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MessageKind {
    Event,
    Beacon,
    Telemetry,
    Links,
    View,
    /// A view with the same content as before.
    RepeatedView,
}

impl MessageKind {
    /// Returns the kind of messages with a schema.
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

    /// Parses a message; `None` if it is invalid, or has no meaning by itself.
    pub(super) fn parse(self, keys: &Keys, topic: &str, data: &[u8]) -> Option<FleetInput> {
        let input = match self {
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
        Some(input)
    }
}
