//! Topics and schemas of recordings.

use super::gaps::EventGap;
use crate::fleet_model::FleetInput;
use consort_protocol::event::Event;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_protocol::scalar::Scalar;
use consort_skills::actions::Telemetry;
use consort_world::record::foxglove::Schema;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Name of the metadata record at the beginning of a file.
pub(super) const FLEET_METADATA: &str = "consort.fleet";

/// Version of the file format. A file with another version may contain unknown messages.
pub(super) const FORMAT_VERSION: &str = "1";

pub(super) static EVENT: Schema = Schema::new("consort.Event", inline_schema_of::<Event>);
pub(super) static GAP: Schema = Schema::new("consort.Gap", inline_schema_of::<EventGap>);
pub(super) static BEACON: Schema = Schema::new("consort.Beacon", inline_schema_of::<Beacon>);
pub(super) static TELEMETRY: Schema = Schema::new("consort.Body", inline_schema_of::<TelemetryMessage>);
pub(super) static LINKS: Schema = Schema::new("consort.Links", inline_schema_of::<LinksMessage>);
pub(super) static VIEW: Schema = Schema::new("consort.View", inline_schema_of::<ViewMessage<Map<String, Value>>>);
pub(super) static REPEATED_VIEW: Schema = Schema::new("consort.Again", inline_schema_of::<RepeatedViewMessage>);

/// Returns the schema of a message type without references: viewers do not resolve them.
fn inline_schema_of<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|settings| settings.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// Telemetry of a robot, and the feedback of its goal in progress.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(super) struct TelemetryMessage {
    /// The telemetry.
    #[serde(flatten)]
    pub(super) telemetry: Telemetry,
    /// Values of the feedback, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) feedback: BTreeMap<String, Scalar>,
}

/// A view with the same content as the last view of this key, except for its age.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(super) struct RepeatedViewMessage {
    /// The queried key.
    pub(super) key: String,
    /// Age in the reply, in milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) age_ms: Option<u64>,
}

/// Number of nodes linked to the recorder.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(super) struct LinksMessage {
    /// The number.
    pub(super) links: usize,
}

/// A view returned by a node.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(super) struct ViewMessage<V> {
    /// The queried key.
    pub(super) key: String,
    /// The reply.
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
                let TelemetryMessage { telemetry, feedback } = serde_json::from_slice(data).ok()?;
                FleetInput::Telemetry { robot, telemetry, feedback }
            }
            MessageKind::View => {
                let ViewMessage::<Value> { key, view } = serde_json::from_slice(data).ok()?;
                FleetInput::View { key: keys.read(&key)?, view }
            }
        };
        Some(input)
    }
}
