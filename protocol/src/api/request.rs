//! Payloads of requests.

use crate::ids::{AlarmId, MissionId, PlaceId, RequestId, RobotId, RoleId, ScheduleId, TaskId, ZoneId};
use crate::ledger::{MissedOccurrences, PersonRequestId};
use crate::mission::IhtnFields;
use crate::scalar::Scalar;
use crate::schema::inline_schema;
use crate::units::MetresPerSecond;
use schemars::{JsonSchema, json_schema};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Submits a mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SubmitRequest {
    /// The name of a mission, shipped or of the fleet file; or a whole mission file, or a mission in the flat iHTN
    /// form, as an object.
    pub mission: MissionSource,
    /// For a mission in the flat iHTN form: the agents that are people, in addition to those of the domain.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub people: BTreeSet<RoleId>,
    /// For a mission in the flat iHTN form: the name of the mission. Default: the name of the root.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub name: Option<TaskId>,
    /// The values of the mission's parameters, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// The client's id for this request. A repeated request with the same id is executed once.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub request: Option<RequestId>,
    /// Order in which waiting missions are served: higher priorities first.
    #[serde(default)]
    #[schemars(range(min = -100, max = 100))]
    pub priority: i64,
    /// Time before which no robot gets a role and no person is asked: a date and time in RFC 3339, or seconds from now.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_before: Option<StartTime>,
    /// Seconds from now until the mission should be completed; after that it fails.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub deadline_s: Option<f64>,
    /// Name of the person who asks for the mission, for display. In a closed fleet the signer is named,
    /// too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

impl SubmitRequest {
    /// Creates a request for a mission, with the default of each other field.
    pub fn of(mission: MissionSource) -> SubmitRequest {
        SubmitRequest {
            mission,
            people: BTreeSet::new(),
            name: None,
            parameters: BTreeMap::new(),
            request: None,
            priority: 0,
            not_before: None,
            deadline_s: None,
            by: None,
        }
    }

    /// Returns the fields that a flat iHTN lacks.
    pub fn ihtn_fields(&self) -> IhtnFields {
        IhtnFields { name: self.name.clone(), people: self.people.clone() }
    }
}

/// Time at which a mission may start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum StartTime {
    /// Date and time in RFC 3339, as `2026-11-27T08:00:00+01:00`.
    At(String),
    /// Seconds from now.
    In(f64),
}

inline_schema!(
    StartTime,
    json_schema!({ "anyOf": [{ "type": "string", "format": "date-time" }, { "type": "number", "minimum": 0 }] })
);

/// The mission of a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum MissionSource {
    /// Name of a mission, shipped or of the fleet file.
    Named(String),
    /// A whole mission file, or a flat iHTN.
    File(Map<String, Value>),
}

inline_schema!(MissionSource, json_schema!({ "type": ["string", "object"] }));

/// Changes a mission on behalf of a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissionChangeRequest {
    /// The mission.
    #[schemars(with = "String")]
    pub mission: MissionId,
    /// Name of the responsible person, for display. In a closed fleet the signer is named, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

/// The missions of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "missions must be a list of names, or an object with a condition as `where`")]
pub enum MissionSelection {
    /// Missions by their ids.
    Named(BTreeSet<MissionId>),
    /// The active missions for which a condition holds: `mission.name == "vital-signs"`.
    Where(SelectionCondition),
}

inline_schema!(MissionSelection, json_schema!({ "type": ["array", "object"], "items": { "type": "string" } }));

/// Answers a request to a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AnswerRequest {
    /// The request, as in `view/requests`.
    pub request: PersonRequestId,
    /// The answer.
    pub answer: AnswerWord,
    /// For `done`: the results of the task, by name, as in the `form` of the request.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, Value>")]
    pub results: BTreeMap<String, Scalar>,
    /// Remark, for display.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
    /// For `later`: minutes until the request is due again; 10 if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = LATER_MINUTES_MAX))]
    pub minutes: Option<u32>,
    /// Name of the person, for display. In a closed fleet the signer is named, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

/// Adds or changes a schedule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScheduleRequest {
    /// Name of the schedule.
    #[schemars(with = "String")]
    pub schedule: ScheduleId,
    /// The change.
    pub action: ScheduleAction,
    /// For `add`: the times, in the format of cron.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cron: Option<String>,
    /// For `add`: the time zone, by its name in the IANA database. Default: UTC.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zone: Option<String>,
    /// For `add`: the time after which there are no occurrences, in RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("format" = "date-time"))]
    pub until: Option<String>,
    /// For `add`: what becomes of missed occurrences. Default: `skip`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed: Option<MissedOccurrences>,
    /// For `add`: the mission of each occurrence, as for `submit`, without `request` and `not_before`. `deadline_s`
    /// counts from the time of the occurrence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub submit: Option<Box<SubmitRequest>>,
    /// Name of the responsible person, for display. In a closed fleet the signer is named, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

impl ScheduleRequest {
    /// Checks whether the request contains what belongs to the action `add`.
    pub fn has_content(&self) -> bool {
        let ScheduleRequest { cron, zone, until, missed, submit, .. } = self;
        cron.is_some() || zone.is_some() || until.is_some() || missed.is_some() || submit.is_some()
    }
}

/// Change of a schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScheduleAction {
    /// Add it. The same schedule may be added again.
    Add,
    /// Leave out its occurrences from now on.
    Pause,
    /// Submit its occurrences again, from now on.
    Resume,
    /// Remove it. Its missions go on.
    Remove,
}

/// Defines requests of people for orders and closures: each with fields of its own, and those of all.
macro_rules! order_requests {
    ($($(#[$doc:meta])* $name:ident { $($(#[$attribute:meta])* $field:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$attribute])* pub $field: $type,)*
            /// Name of the responsible person, for display. In a closed fleet the signer is named, too.
            #[serde(skip_serializing_if = "Option::is_none")]
            pub by: Option<String>,
            /// The client's id for this request. A repeated request with the same id changes nothing.
            #[serde(skip_serializing_if = "Option::is_none")]
            #[schemars(with = "Option<String>")]
            pub request: Option<RequestId>,
        }
    )*};
}

order_requests! {
    /// Cancels missions, all at once. Missions that have ended, or that the person may not cancel, are left out.
    CancelMissionsRequest {
        /// The missions.
        missions: MissionSelection,
        /// Only list the missions that the request would cancel.
        #[serde(default)]
        dry_run: bool,
    }

    /// Changes the priority of a mission that waits or runs.
    PriorityRequest {
        /// The mission.
        #[schemars(with = "String")]
        mission: MissionId,
        /// Order in which missions are served from now on: higher priorities first.
        #[schemars(range(min = -100, max = 100))]
        priority: i64,
    }

    /// Gives a role to another robot, or restricts it to a robot.
    ReassignRequest {
        /// The mission.
        #[schemars(with = "String")]
        mission: MissionId,
        /// The role.
        #[schemars(with = "String")]
        role: RoleId,
        /// The robot that gets the role. Default: any but the present one.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(with = "Option<String>")]
        to: Option<RobotId>,
        /// Instead of `to`, for a role that waits: the only robot that may get it, from now on.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(with = "Option<String>")]
        pin: Option<RobotId>,
        /// Instead of `to`: end the order about the role. Any robot may get it.
        #[serde(default)]
        unpin: bool,
        /// The other robot may repeat tasks of the role that have ended.
        #[serde(default)]
        repeat: bool,
    }

    /// Holds robots: they stand still at once, and keep their roles.
    HoldRequest {
        /// The robots.
        robots: RobotSelection,
        /// Seconds after which the hold ends by itself; 600 if absent.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(range(min = 1, max = HOLD_S_MAX))]
        for_s: Option<u32>,
        /// Reason, for display.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    }

    /// Releases held robots.
    ReleaseRequest {
        /// The robots. Robots that are not held stay as they are.
        robots: RobotSelection,
    }

    /// Takes robots out of service, or returns them to service.
    MaintenanceRequest {
        /// The robots.
        robots: RobotSelection,
        /// The change.
        action: MaintenanceAction,
        /// For `begin`: the time at which the maintenance ends by itself, in RFC 3339. Default: no end.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(extend("format" = "date-time"))]
        until: Option<String>,
        /// For `begin`: the reason, for display.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    }

    /// Closes zones, places or lanes: no robot enters them.
    CloseRequest {
        /// Places of the map, and zones of the fleet file. Every lane to them is closed, too.
        #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
        places: BTreeSet<PlaceId>,
        /// Lanes of the map, each by its two ends. They are closed in both directions.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        lanes: Vec<(PlaceId, PlaceId)>,
        /// Seconds after which the closure ends by itself. Default: no end.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(range(min = 1, max = CLOSE_S_MAX))]
        for_s: Option<u32>,
        /// Instead of `for_s`: the time at which the closure ends by itself, in RFC 3339.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(extend("format" = "date-time"))]
        until: Option<String>,
        /// Reason, for display.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    }

    /// Opens closed zones, places or lanes.
    OpenRequest {
        /// Places and zones. Those that are not closed stay as they are. A place stays closed while a zone with it is closed.
        #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
        places: BTreeSet<PlaceId>,
        /// Lanes, each by its two ends. A lane stays closed while a place at its end is closed.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        lanes: Vec<(PlaceId, PlaceId)>,
    }

    /// Sets or clears speed limits in zones, at places or on lanes.
    LimitRequest {
        /// Places of the map, and zones of the fleet file. The limit holds on every lane from and to them.
        #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
        places: BTreeSet<PlaceId>,
        /// Lanes of the map, each by its two ends. The limit holds in both directions.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        lanes: Vec<(PlaceId, PlaceId)>,
        /// The change.
        action: LimitAction,
        /// For `set`: the highest allowed speed in metres per second, 0.05 or more.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(with = "Option<f64>", range(min = 0.05))]
        speed_mps: Option<MetresPerSecond>,
        /// For `set`: seconds after which the limit ends by itself. Default: no end.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(range(min = 1, max = CLOSE_S_MAX))]
        for_s: Option<u32>,
        /// For `set`, instead of `for_s`: the time at which the limit ends by itself, in RFC 3339.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(extend("format" = "date-time"))]
        until: Option<String>,
        /// For `set`: the reason, for display.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    }

    /// Raises an alarm that the fleet file declares, or clears alarms.
    AlarmRequest {
        /// The change.
        action: AlarmAction,
        /// The alarm. For `clear` it may be omitted: all alarms end.
        #[serde(skip_serializing_if = "Option::is_none")]
        #[schemars(with = "Option<String>")]
        alarm: Option<AlarmId>,
        /// For `raise`: the reason, for display.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    }
}

/// Seconds after which a hold ends by default.
pub const HOLD_S: u32 = 600;

/// Maximum number of seconds of a hold: a day.
pub const HOLD_S_MAX: u32 = 24 * 60 * 60;

/// Change of the maintenance of robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MaintenanceAction {
    /// They finish their roles, and get no others.
    Begin,
    /// They get roles again.
    End,
}

/// Maximum number of seconds of a closure or a speed limit that is given as `for_s`: a year.
pub const CLOSE_S_MAX: u32 = 366 * 24 * 60 * 60;

/// Lowest speed limit in metres per second: at less, a drive takes so long that it counts as no progress.
pub const SPEED_LIMIT_MIN_MPS: f64 = 0.05;

/// Change of speed limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LimitAction {
    /// Set them. The latest limit of a zone, place or lane counts.
    Set,
    /// Clear them.
    Clear,
}

/// Change of the alarms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmAction {
    /// The alarm begins.
    Raise,
    /// The alarms end.
    Clear,
}

/// The robots of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "robots must be a list of names, \"all\", or an object with a condition as `where` or a zone as `zone`"
)]
pub enum RobotSelection {
    /// Robots by name.
    Named(BTreeSet<RobotId>),
    /// The robots for which a condition holds, as that of a role: `robot.attributes.section == "icu"`.
    Where(SelectionCondition),
    /// The robots that are in a zone now.
    Zone(RobotZone),
    /// All robots with a known record.
    All(AllRobots),
}

/// Condition on the robots or missions of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelectionCondition {
    /// The condition, in CEL.
    #[serde(rename = "where")]
    pub condition: String,
}

/// Zone of the robots of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotZone {
    /// The zone, as named in the fleet file. A robot is in it if the place that it has passed last is.
    pub zone: ZoneId,
}

/// All robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AllRobots {
    /// Every robot with a known record.
    All,
}

inline_schema!(RobotSelection, json_schema!({ "type": ["array", "object", "string"], "items": { "type": "string" } }));

/// Maximum number of minutes for which a person puts a request off: a day.
pub const LATER_MINUTES_MAX: u32 = 24 * 60;

/// Answer to a request to a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnswerWord {
    /// The task is done.
    Done,
    /// The person does not want to do it; the mission fails.
    Declined,
    /// The person is not able to do it; the mission fails.
    Cannot,
    /// The person will do it later; the request stays open.
    Later,
}

/// Queries the progress of the upgrade to the next wire version.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UpgradeRequest {
    /// The fleet writes the next version from now on. This cannot be undone.
    #[serde(default)]
    pub finish: bool,
}

/// Options of a read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadOptions {
    /// The reply contains everything that was acknowledged before the request: a majority confirms
    /// it, or the reply is an error. Otherwise any node replies from its own copy, which may lag
    /// behind; the reply states how far.
    #[serde(default)]
    pub linearizable: bool,
}

/// Queries a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissionQuery {
    /// The mission.
    #[schemars(with = "String")]
    pub mission: MissionId,
    /// The reply contains everything that was acknowledged before the request; see `list`.
    #[serde(default)]
    pub linearizable: bool,
}
