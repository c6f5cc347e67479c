//! Views: the state of a fleet as JSON, as served on `view/**` and `seen/**`.
//!
//! Each view is a single struct. Nodes write it, and the dashboard, the commands, the JSON Schemas
//! and the reference page use the same struct. A reader accepts views of neighbouring releases: it
//! ignores unknown fields, uses the default for a missing field, and skips the members of a list
//! that it cannot read.
//!
//! | view | type |
//! |---|---|
//! | `view/fleet` | [`FleetView`] |
//! | `view/robot/{robot}` | [`RobotView`] |
//! | `view/ensembles` | [`EnsemblesView`] |
//! | `view/ensemble/{ensemble}` | [`EnsembleKnowledgeView`] |
//! | `view/coordinator` | [`CoordinatorView`] |
//! | `view/missions` | [`MissionsView`] |
//! | `view/requests` | [`RequestsView`] |
//! | `view/schedules` | [`SchedulesView`] |
//! | `view/audit` | [`AuditView`] |
//! | `view/mission/{mission}` | [`MissionView`] |
//! | `view/auctions` | [`AuctionsView`] |
//! | `view/map` | [`MapView`] |
//! | `view/health` | [`HealthView`] |
//!
//! All of them carry their [`Provenance`], and a reply with a part of a list has a [`ListPart`]. The
//! simulator defines the type of `view/world`.

mod auction;
mod audit;
mod coordinator;
mod fleet;
mod health;
mod list_part;
mod map;
mod mission;
mod person_request;
mod provenance;
mod schedule;

pub use auction::{AuctionView, AuctionsView};
pub use audit::AuditView;
pub use coordinator::{AutopilotView, CoordinatorView, VoterChange};
pub use fleet::{
    ChargerLeaseView, ChargerView, ChargingView, Contact, DeclarationsView, EnsembleKnowledgeView, EnsembleMember,
    EnsembleView, EnsemblesView, FleetView, HeldRole, MemberKnowledge, NodeStatus, NodeTraits, NodeView,
    PromisedRoleView, PublishedRecord, RobotView,
};
pub use health::{HealthFinding, HealthLevel, HealthView};
pub use list_part::ListPart;
pub use map::{DoorView, LaneView, LevelView, LiftView, MapBounds, MapView, PlaceView, WallView};
pub use mission::{
    MissionBrief, MissionProgress, MissionStateName, MissionStatus, MissionSummary, MissionView, MissionsView,
    PromiseView, RequestTerms, RoleView, StepView, TaskParticipant, TaskProgress, TaskView,
};
pub use person_request::{PersonRequestView, RequestsView};
pub use provenance::{LedgerCopy, Provenance, WithProvenance};
pub use schedule::{ScheduleView, SchedulesView};

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

/// Returns the JSON Schema of a view, a reply or an event, as a node writes it.
pub fn schema_of<T: JsonSchema>() -> Schema {
    SchemaSettings::draft2020_12().for_serialize().into_generator().into_root_schema_for::<T>()
}

/// A view with its schema.
#[derive(Debug, Clone, Copy)]
pub struct PublishedView {
    /// Name of the view: its key after `view/`, without ids.
    pub name: &'static str,
    /// Returns the schema.
    pub schema: fn() -> Schema,
}

/// All views of this crate.
pub const PUBLISHED_VIEWS: &[PublishedView] = &[
    PublishedView { name: "fleet", schema: schema_of::<WithProvenance<FleetView>> },
    PublishedView { name: "robot", schema: schema_of::<RobotView> },
    PublishedView { name: "ensembles", schema: schema_of::<WithProvenance<EnsemblesView>> },
    PublishedView { name: "ensemble", schema: schema_of::<WithProvenance<EnsembleKnowledgeView>> },
    PublishedView { name: "coordinator", schema: schema_of::<WithProvenance<CoordinatorView>> },
    PublishedView { name: "missions", schema: schema_of::<WithProvenance<MissionsView>> },
    PublishedView { name: "requests", schema: schema_of::<WithProvenance<RequestsView>> },
    PublishedView { name: "schedules", schema: schema_of::<WithProvenance<SchedulesView>> },
    PublishedView { name: "audit", schema: schema_of::<WithProvenance<AuditView>> },
    PublishedView { name: "mission", schema: schema_of::<WithProvenance<MissionView>> },
    PublishedView { name: "auctions", schema: schema_of::<WithProvenance<AuctionsView>> },
    PublishedView { name: "map", schema: schema_of::<WithProvenance<MapView>> },
    PublishedView { name: "health", schema: schema_of::<WithProvenance<HealthView>> },
];

/// Deserializes a list, without the members that this release cannot read.
fn readable<'de, D: Deserializer<'de>, T: DeserializeOwned>(deserializer: D) -> Result<Vec<T>, D::Error> {
    Ok(readable_members(Vec::deserialize(deserializer)?))
}

/// Deserializes a list as [`readable`] does, or null.
fn readable_if_known<'de, D: Deserializer<'de>, T: DeserializeOwned>(
    deserializer: D,
) -> Result<Option<Vec<T>>, D::Error> {
    Ok(Option::<Vec<Value>>::deserialize(deserializer)?.map(readable_members))
}

fn readable_members<T: DeserializeOwned>(members: Vec<Value>) -> Vec<T> {
    members.into_iter().filter_map(|member| serde_json::from_value(member).ok()).collect()
}

/// Deserializes a value, or returns the default if this release cannot read it.
fn readable_or_default<'de, D: Deserializer<'de>, T: DeserializeOwned + Default>(
    deserializer: D,
) -> Result<T, D::Error> {
    Ok(serde_json::from_value(Value::deserialize(deserializer)?).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_mission_view_of_an_earlier_release_is_read_as_far_as_possible() {
        let view = json!({
            "mission": "m-1", "state": "needs_rescue", "detail": { "needs_rescue": { "cause": "lost", "items": [] } },
            "releases": [{ "role": "r1", "robot": "ada", "cause": "silent", "blamed": true, "confirmed": true },
                { "role": "r2", "robot": "bob" }],
            "roles": [{ "role": "r1", "kind": "managed", "phase": "open" }, { "role": "r2", "kind": "new kind" }],
            "explanation": { "round": 1, "at_ms": 0, "omitted": 0, "roles": [
                { "role": "r1", "winner": null, "why": "", "robots": [
                    { "robot": "ada", "outcome": "in_vain", "why": "", "bid": null, "behind_s": null }] }] },
            "unknown": 1,
        });
        let view: MissionView = serde_json::from_value(view).unwrap();
        assert_eq!(view.brief.status.state, MissionStateName::NeedsIntervention);
        assert!(view.brief.status.detail.needs_intervention());
        assert_eq!((view.releases.len(), view.explanation), (1, None));
        assert_eq!(view.roles.iter().map(|role| role.role.as_str()).collect::<Vec<_>>(), ["r1"]);
    }

    #[test]
    fn a_list_that_the_replying_node_does_not_know_is_no_empty_list() {
        let zone = json!({ "part": { "floor": 3 } });
        for (closures, expected) in [(json!([zone]), Some(0)), (json!([]), Some(0)), (Value::Null, None)] {
            let view: FleetView = serde_json::from_value(json!({ "closures": closures })).unwrap();
            assert_eq!(view.closures.map(|closures| closures.len()), expected);
            assert_eq!((view.speed_limits, view.alarms), (None, None), "a node of an earlier release");
        }
    }

    #[test]
    fn an_error_is_no_view_of_missions() {
        let error = json!({ "error": "no voter of the ledger replies", "retry_after_ms": 300 });
        assert!(serde_json::from_value::<MissionsView>(error).is_err());
    }

    #[test]
    fn the_schema_of_a_view_requires_every_field_that_a_node_writes() {
        let schema = schema_of::<WithProvenance<HealthView>>().to_value();
        let required = ["seen_by", "age_ms", "coordinator", "term", "at_ms", "version", "level", "findings"];
        assert_eq!(schema["required"], json!(required));
    }
}
