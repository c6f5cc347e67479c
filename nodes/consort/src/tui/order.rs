//! Orders that the user gives on the terminal, and their requests.

use super::listed;
use crate::output::to_value;
use consort_protocol::api::{
    AlarmAction, AlarmRequest, CancelMissionsReply, CancelMissionsRequest, CloseRequest, HoldRequest, LimitAction,
    LimitRequest, MaintenanceAction, MaintenanceRequest, MissionChangeRequest, MissionSelection, OpenRequest,
    OrdersReply, PriorityRequest, ReassignRequest, ReleaseRequest, RobotSelection, ScheduleAction, ScheduleRequest,
};
use consort_protocol::ids::{AlarmId, MissionId, NameError, PlaceId, RequestId, RobotId, RoleId, ScheduleId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{MapPart, Priority};
use consort_protocol::units::MetresPerSecond;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fmt;

/// An order of the user to the fleet. `for_s` are the seconds after which it ends by itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Order {
    /// Hold robots.
    Hold { robots: RobotSelection, for_s: Option<u32>, reason: String },
    /// Release robots.
    Release(RobotSelection),
    /// Take a robot out of service; `until` is a time in RFC 3339.
    BeginMaintenance { robot: RobotId, until: Option<String>, reason: String },
    /// Return a robot to service.
    EndMaintenance(RobotId),
    /// Cancel a mission.
    Cancel(MissionId),
    /// Cancel several missions at once.
    CancelAll(BTreeSet<MissionId>),
    /// Change the priority of a mission.
    SetPriority { mission: MissionId, priority: Priority },
    /// Give a role to another robot: to any other if none is named.
    Reassign { mission: MissionId, role: RoleId, to: Option<RobotId>, repeat: bool },
    /// Restrict a role that waits to a robot; without one, end the order about the role.
    Pin { mission: MissionId, role: RoleId, robot: Option<RobotId> },
    /// Close a part of the map.
    Close { part: NamedPart, for_s: Option<u32>, reason: String },
    /// Open a part of the map.
    Open(NamedPart),
    /// Limit the speed in a part of the map.
    Limit { part: NamedPart, speed: MetresPerSecond, for_s: Option<u32>, reason: String },
    /// Clear the speed limit of a part of the map.
    ClearLimit(NamedPart),
    /// Raise an alarm.
    RaiseAlarm { alarm: AlarmId, reason: String },
    /// Clear an alarm.
    ClearAlarm(AlarmId),
    /// Pause, resume or remove a schedule.
    ChangeSchedule { schedule: ScheduleId, action: ScheduleAction },
}

/// A part of the map, as named by the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum NamedPart {
    /// A place or a zone.
    PlaceOrZone(PlaceId),
    /// The lane between two places.
    Lane(PlaceId, PlaceId),
}

impl NamedPart {
    /// Reads a place, a zone, with or without the word `zone`, or a lane as `A – B` or, easier to type, `A -- B`.
    pub(super) fn parse(text: &str) -> Result<NamedPart, NameError> {
        match [" – ", " -- "].into_iter().find_map(|between| text.split_once(between)) {
            Some((a, b)) => Ok(NamedPart::Lane(PlaceId::new(a.trim())?, PlaceId::new(b.trim())?)),
            None => PlaceId::new(text.strip_prefix("zone ").unwrap_or(text)).map(NamedPart::PlaceOrZone),
        }
    }

    /// Returns the names of a part.
    pub(super) fn of(part: &MapPart) -> Result<NamedPart, NameError> {
        Ok(match part {
            MapPart::Zone(zone) => NamedPart::PlaceOrZone(PlaceId::new(zone.name.as_str())?),
            MapPart::Place(place) => NamedPart::PlaceOrZone(place.clone()),
            MapPart::Lane(a, b) => NamedPart::Lane(a.clone(), b.clone()),
        })
    }

    /// Returns the places and the lanes of a request.
    fn split(self) -> (BTreeSet<PlaceId>, Vec<(PlaceId, PlaceId)>) {
        match self {
            NamedPart::PlaceOrZone(place) => (BTreeSet::from([place]), vec![]),
            NamedPart::Lane(a, b) => (BTreeSet::new(), vec![(a, b)]),
        }
    }
}

impl fmt::Display for NamedPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NamedPart::PlaceOrZone(place) => write!(f, "{place}"),
            NamedPart::Lane(a, b) => write!(f, "{a} – {b}"),
        }
    }
}

/// Selects a single robot.
pub(super) fn only(robot: RobotId) -> RobotSelection {
    RobotSelection::Named(BTreeSet::from([robot]))
}

impl Order {
    /// Returns the request of the order. `by` is the responsible person.
    pub(crate) fn request(&self, by: Option<String>, id: RequestId) -> (ApiCall, Value) {
        let request = Some(id);
        match self.clone() {
            Order::Hold { robots, for_s, reason } => {
                (ApiCall::Hold, to_value(&HoldRequest { robots, for_s, reason, by, request }))
            }
            Order::Release(robots) => (ApiCall::Release, to_value(&ReleaseRequest { robots, by, request })),
            Order::BeginMaintenance { robot, until, reason } => {
                let (robots, action) = (only(robot), MaintenanceAction::Begin);
                let request = MaintenanceRequest { robots, action, until, reason, by, request };
                (ApiCall::Maintenance, to_value(&request))
            }
            Order::EndMaintenance(robot) => {
                let (robots, action, reason) = (only(robot), MaintenanceAction::End, String::new());
                let request = MaintenanceRequest { robots, action, until: None, reason, by, request };
                (ApiCall::Maintenance, to_value(&request))
            }
            Order::Cancel(mission) => (ApiCall::Cancel, to_value(&MissionChangeRequest { mission, by })),
            Order::CancelAll(missions) => {
                let (missions, dry_run) = (MissionSelection::Named(missions), false);
                (ApiCall::CancelMissions, to_value(&CancelMissionsRequest { missions, dry_run, by, request }))
            }
            Order::SetPriority { mission, priority } => {
                let priority = priority.get().into();
                (ApiCall::Priority, to_value(&PriorityRequest { mission, priority, by, request }))
            }
            Order::Reassign { mission, role, to, repeat } => {
                let (pin, unpin) = (None, false);
                let request = ReassignRequest { mission, role, to, pin, unpin, repeat, by, request };
                (ApiCall::Reassign, to_value(&request))
            }
            Order::Pin { mission, role, robot: pin } => {
                let (to, unpin, repeat) = (None, pin.is_none(), false);
                let request = ReassignRequest { mission, role, to, pin, unpin, repeat, by, request };
                (ApiCall::Reassign, to_value(&request))
            }
            Order::Close { part, for_s, reason } => {
                let (places, lanes) = part.split();
                let request = CloseRequest { places, lanes, for_s, until: None, reason, by, request };
                (ApiCall::Close, to_value(&request))
            }
            Order::Open(part) => {
                let (places, lanes) = part.split();
                (ApiCall::Open, to_value(&OpenRequest { places, lanes, by, request }))
            }
            Order::Limit { part, speed, for_s, reason } => {
                let ((places, lanes), action, speed_mps) = (part.split(), LimitAction::Set, Some(speed));
                let request =
                    LimitRequest { places, lanes, action, speed_mps, for_s, until: None, reason, by, request };
                (ApiCall::Limit, to_value(&request))
            }
            Order::ClearLimit(part) => {
                let ((places, lanes), action, reason) = (part.split(), LimitAction::Clear, String::new());
                let (speed_mps, for_s, until) = (None, None, None);
                let request = LimitRequest { places, lanes, action, speed_mps, for_s, until, reason, by, request };
                (ApiCall::Limit, to_value(&request))
            }
            Order::RaiseAlarm { alarm, reason } => {
                let (action, alarm) = (AlarmAction::Raise, Some(alarm));
                (ApiCall::Alarm, to_value(&AlarmRequest { action, alarm, reason, by, request }))
            }
            Order::ClearAlarm(alarm) => {
                let (action, alarm, reason) = (AlarmAction::Clear, Some(alarm), String::new());
                (ApiCall::Alarm, to_value(&AlarmRequest { action, alarm, reason, by, request }))
            }
            Order::ChangeSchedule { schedule, action } => {
                let (cron, zone, until, missed, submit) = (None, None, None, None, None);
                let request = ScheduleRequest { schedule, action, cron, zone, until, missed, submit, by };
                (ApiCall::Schedule, to_value(&request))
            }
        }
    }

    /// Describes the reply: also the robots that the coordinator has selected, and the missions that it left out.
    pub(crate) fn done_text(&self, reply: &Value) -> String {
        let done = "done".to_owned();
        match self {
            Order::Hold { robots, .. } | Order::Release(robots) if !matches!(robots, RobotSelection::Named(_)) => {
                OrdersReply::deserialize(reply).map_or(done, |reply| format!("done: {}", listed(reply.robots.keys())))
            }
            Order::CancelAll(_) => {
                let refused = CancelMissionsReply::deserialize(reply).map(|reply| reply.refused).unwrap_or_default();
                let refused: Vec<String> = refused.iter().map(|(mission, why)| format!("{mission}: {why}")).collect();
                if refused.is_empty() { done } else { format!("done, except {}", listed(refused)) }
            }
            _ => done,
        }
    }
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Order::Hold { robots, .. } => write!(f, "hold {}", robots_text(robots)),
            Order::Release(robots) => write!(f, "release {}", robots_text(robots)),
            Order::BeginMaintenance { robot, .. } => write!(f, "take {robot} out of service"),
            Order::EndMaintenance(robot) => write!(f, "return {robot} to service"),
            Order::Cancel(mission) => write!(f, "cancel {mission}"),
            Order::CancelAll(missions) => write!(f, "cancel {}", listed(missions)),
            Order::SetPriority { mission, priority } => write!(f, "give {mission} the priority {}", priority.get()),
            Order::Reassign { mission, role, to: Some(robot), .. } => write!(f, "give {role} of {mission} to {robot}"),
            Order::Reassign { mission, role, to: None, .. } => {
                write!(f, "give {role} of {mission} to another robot")
            }
            Order::Pin { mission, role, robot: Some(robot) } => write!(f, "pin {role} of {mission} to {robot}"),
            Order::Pin { mission, role, robot: None } => write!(f, "end the order about {role} of {mission}"),
            Order::Close { part, .. } => write!(f, "close {part}"),
            Order::Open(part) => write!(f, "open {part}"),
            Order::Limit { part, speed, .. } => write!(f, "limit {part} to {} m/s", speed.get()),
            Order::ClearLimit(part) => write!(f, "clear the speed limit of {part}"),
            Order::RaiseAlarm { alarm, .. } => write!(f, "raise the alarm {alarm}"),
            Order::ClearAlarm(alarm) => write!(f, "clear the alarm {alarm}"),
            Order::ChangeSchedule { schedule, action } => {
                let action = match action {
                    ScheduleAction::Add => "add",
                    ScheduleAction::Pause => "pause",
                    ScheduleAction::Resume => "resume",
                    ScheduleAction::Remove => "remove",
                };
                write!(f, "{action} the schedule {schedule}")
            }
        }
    }
}

fn robots_text(robots: &RobotSelection) -> String {
    match robots {
        RobotSelection::Named(robots) => listed(robots),
        RobotSelection::Where(selection) => format!("the robots with `{}`", selection.condition),
        RobotSelection::Zone(selection) => format!("the robots in zone {}", selection.zone),
        RobotSelection::All(_) => "all robots".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::api::{AllRobots, RobotZone, SelectionCondition, parse_request};
    use serde::de::DeserializeOwned;
    use serde_json::json;

    /// Checks the request of an order. The coordinator reads the payload with the same function.
    fn check<T: DeserializeOwned>(order: Order, call: ApiCall, payload: Value) {
        let (sent_call, sent) = order.request(Some("Nia".to_owned()), "r-1".parse().unwrap());
        assert_eq!((sent_call, &sent), (call, &payload), "{order}");
        if let Err(problem) = parse_request::<T>(call, sent.to_string().as_bytes()) {
            panic!("{order}: {problem}");
        }
    }

    fn icu() -> RobotSelection {
        RobotSelection::Zone(RobotZone { zone: "icu".parse().unwrap() })
    }

    #[test]
    fn each_order_to_robots_has_its_request() {
        let ada = || "ada".parse::<RobotId>().unwrap();
        let spill = || "a spill".to_owned();
        let hold = Order::Hold { robots: only(ada()), for_s: None, reason: spill() };
        let request = json!({ "robots": ["ada"], "reason": "a spill", "by": "Nia", "request": "r-1" });
        check::<HoldRequest>(hold, ApiCall::Hold, request);
        let hold = Order::Hold { robots: icu(), for_s: Some(60), reason: String::new() };
        let request = json!({ "robots": { "zone": "icu" }, "for_s": 60, "by": "Nia", "request": "r-1" });
        check::<HoldRequest>(hold, ApiCall::Hold, request);
        let release = Order::Release(RobotSelection::All(AllRobots::All));
        check::<ReleaseRequest>(release, ApiCall::Release, json!({ "robots": "all", "by": "Nia", "request": "r-1" }));
        let (until, begin) = ("2026-12-31T18:00:00Z", "begin");
        let maintain = Order::BeginMaintenance { robot: ada(), until: Some(until.to_owned()), reason: spill() };
        let request = json!({ "robots": ["ada"], "action": begin, "until": until, "reason": "a spill", "by": "Nia",
            "request": "r-1" });
        check::<MaintenanceRequest>(maintain, ApiCall::Maintenance, request);
        let request = json!({ "robots": ["ada"], "action": "end", "by": "Nia", "request": "r-1" });
        check::<MaintenanceRequest>(Order::EndMaintenance(ada()), ApiCall::Maintenance, request);
    }

    #[test]
    fn each_order_about_missions_has_its_request() {
        let mission = || "m-1".parse::<MissionId>().unwrap();
        let cancel = Order::CancelAll([mission()].into());
        let request = json!({ "missions": ["m-1"], "dry_run": false, "by": "Nia", "request": "r-1" });
        check::<CancelMissionsRequest>(cancel, ApiCall::CancelMissions, request);
        let priority = Order::SetPriority { mission: mission(), priority: Priority::new(-5).unwrap() };
        let request = json!({ "mission": "m-1", "priority": -5, "by": "Nia", "request": "r-1" });
        check::<PriorityRequest>(priority, ApiCall::Priority, request);
        let (role, bea) = (|| "r1".parse::<RoleId>().unwrap(), || "bea".parse().unwrap());
        for (order, own) in [
            (
                Order::Reassign { mission: mission(), role: role(), to: Some(bea()), repeat: true },
                json!({ "to": "bea", "unpin": false, "repeat": true }),
            ),
            (
                Order::Pin { mission: mission(), role: role(), robot: Some(bea()) },
                json!({ "pin": "bea", "unpin": false, "repeat": false }),
            ),
            (Order::Pin { mission: mission(), role: role(), robot: None }, json!({ "unpin": true, "repeat": false })),
        ] {
            let mut request = json!({ "mission": "m-1", "role": "r1", "by": "Nia", "request": "r-1" });
            request.as_object_mut().unwrap().extend(own.as_object().unwrap().clone());
            check::<ReassignRequest>(order, ApiCall::Reassign, request);
        }
        let pause = Order::ChangeSchedule { schedule: "rounds".parse().unwrap(), action: ScheduleAction::Pause };
        let request = json!({ "schedule": "rounds", "action": "pause", "by": "Nia" });
        check::<ScheduleRequest>(pause, ApiCall::Schedule, request);
    }

    #[test]
    fn each_order_about_the_map_and_alarms_has_its_request() {
        let lane = || NamedPart::parse("A -- B").unwrap();
        let request = json!({ "lanes": [["A", "B"]], "by": "Nia", "request": "r-1" });
        check::<OpenRequest>(Order::Open(lane()), ApiCall::Open, request);
        let speed = MetresPerSecond::new(0.3).unwrap();
        let limit = Order::Limit { part: lane(), speed, for_s: Some(7200), reason: "wet".to_owned() };
        let request = json!({ "lanes": [["A", "B"]], "action": "set", "speed_mps": 0.3, "for_s": 7200, "reason": "wet",
            "by": "Nia", "request": "r-1" });
        check::<LimitRequest>(limit, ApiCall::Limit, request);
        let zone = NamedPart::parse("zone icu").unwrap();
        let request = json!({ "places": ["icu"], "action": "clear", "by": "Nia", "request": "r-1" });
        check::<LimitRequest>(Order::ClearLimit(zone.clone()), ApiCall::Limit, request);
        let close = Order::Close { part: zone, for_s: Some(60), reason: String::new() };
        let request = json!({ "places": ["icu"], "for_s": 60, "by": "Nia", "request": "r-1" });
        check::<CloseRequest>(close, ApiCall::Close, request);
        let clear = Order::ClearAlarm("fire".parse().unwrap());
        let request = json!({ "action": "clear", "alarm": "fire", "by": "Nia", "request": "r-1" });
        check::<AlarmRequest>(clear, ApiCall::Alarm, request);
    }

    #[test]
    fn a_result_names_selected_robots_and_missions_left_out() {
        let reply = json!({ "robots": { "ada": {}, "bea": {} } });
        let hold = |robots| Order::Hold { robots, for_s: None, reason: String::new() };
        assert_eq!(hold(only("ada".parse().unwrap())).done_text(&reply), "done");
        assert_eq!(hold(icu()).done_text(&reply), "done: ada, bea");
        let condition = "robot.battery < 0.2".to_owned();
        let release = Order::Release(RobotSelection::Where(SelectionCondition { condition }));
        assert_eq!(release.done_text(&reply), "done: ada, bea");
        assert_eq!(release.to_string(), "release the robots with `robot.battery < 0.2`");
        let cancel = Order::CancelAll(["m-1".parse().unwrap(), "m-2".parse().unwrap()].into());
        let reply = |refused: Value| json!({ "missions": { "m-2": null }, "refused": refused, "again": false });
        assert_eq!(cancel.done_text(&reply(json!({}))), "done");
        assert_eq!(cancel.done_text(&reply(json!({ "m-1": "it has ended" }))), "done, except m-1: it has ended");
    }
}
