//! View of the requests to people.

use super::readable;
use crate::ids::{MissionId, PlaceId, RobotId, RoleId, TaskId, TaskType};
use crate::lease::RoleHolder;
use crate::ledger::{MissionEntry, PersonRequestEntry, PersonRequestId, PersonRequestPhase};
use crate::mission::ValueKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The requests to people.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RequestsView {
    /// Open requests in the order in which missions are served; then closed requests of missions that are
    /// still known, the latest first.
    #[serde(deserialize_with = "readable")]
    pub requests: Vec<PersonRequestView>,
}

/// A request to a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PersonRequestView {
    /// Id of the request.
    pub request: PersonRequestId,
    /// Mission for which it is made.
    pub mission: MissionId,
    /// Role of the person.
    pub role: RoleId,
    /// Task of the mission.
    pub task: TaskId,
    /// Type of the task; null if the mission has taken another branch since.
    pub task_type: Option<TaskType>,
    /// Parameters of the task.
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// Robots that the person meets, by their roles.
    #[serde(default)]
    pub robots: BTreeMap<RoleId, RobotId>,
    /// Place: a parameter of the task, or else where the robot is.
    #[serde(default)]
    pub place: Option<PlaceId>,
    /// Results that the answer `done` states, by name.
    #[serde(default)]
    pub form: BTreeMap<String, ValueKind>,
    /// Time of the request in milliseconds since 1970.
    pub asked_at_ms: u64,
    /// Time after which it expires, in milliseconds since 1970; null if it does not.
    #[serde(default)]
    pub expires_at_ms: Option<u64>,
    /// Role of the other people that are asked, too, without an answer until `escalates_at_ms`; null
    /// without escalation.
    #[serde(default)]
    pub escalates_to: Option<RoleId>,
    /// Time from which they are to be asked, in milliseconds since 1970.
    #[serde(default)]
    pub escalates_at_ms: Option<u64>,
    /// Time at which they were asked, in milliseconds since 1970; null until then.
    #[serde(default)]
    pub escalated_at_ms: Option<u64>,
    /// Phase.
    pub phase: PersonRequestPhase,
}

/// Parameters that name a place, in order of precedence.
const PLACE_PARAMETERS: [&str; 5] = ["place", "location", "at", "to", "room"];

impl PersonRequestView {
    /// Checks whether people with this role are asked.
    pub fn is_for(&self, role: &RoleId) -> bool {
        self.role == *role || self.escalated_to() == Some(role)
    }

    /// Returns the role of the other people, if they are asked, too.
    pub fn escalated_to(&self) -> Option<&RoleId> {
        self.escalates_to.as_ref().filter(|_| self.escalated_at_ms.is_some())
    }

    /// Returns the view of a request. `place_of` returns the last known place of a robot.
    pub fn of(
        entry: &MissionEntry,
        request: &PersonRequestEntry,
        place_of: impl Fn(&RobotId) -> Option<PlaceId>,
    ) -> PersonRequestView {
        let spec = entry.requested_task(request);
        let escalation = request.escalation.as_ref();
        let parameters = spec.as_ref().map(|spec| spec.parameters.clone()).unwrap_or_default();
        let robots = RoleHolder::robots(&request.robots);
        let named = PLACE_PARAMETERS.iter().find_map(|name| PlaceId::new(parameters.get(*name)?.as_str()).ok());
        let place = named.or_else(|| robots.values().find_map(place_of));
        PersonRequestView {
            request: PersonRequestId { mission: entry.id.clone(), number: request.number },
            mission: entry.id.clone(),
            role: request.role.clone(),
            task: request.task.clone(),
            form: entry.form_of(request),
            task_type: spec.as_ref().map(|spec| spec.task_type.clone()),
            parameters,
            robots,
            place,
            asked_at_ms: request.asked_ms,
            expires_at_ms: request.expires_ms,
            escalates_to: escalation.map(|escalation| escalation.to.clone()),
            escalates_at_ms: escalation.map(|escalation| escalation.due_ms),
            escalated_at_ms: escalation.and_then(|escalation| escalation.escalated_ms),
            phase: request.phase.clone(),
        }
    }
}
