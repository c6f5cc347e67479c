//! Orders that the user gives on the terminal, and their requests.

use crate::output::to_value;
use consort_protocol::api::{
    AlarmAction, AlarmRequest, CloseRequest, HoldRequest, MaintenanceAction, MaintenanceRequest, MissionChangeRequest,
    OpenRequest, PriorityRequest, ReleaseRequest, RobotSelection,
};
use consort_protocol::ids::{AlarmId, MissionId, PlaceId, RequestId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Priority;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fmt;

/// An order of the user to the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Order {
    /// Hold a robot, for the default time.
    Hold { robot: RobotId, reason: String },
    /// Release a robot.
    Release(RobotId),
    /// Take a robot out of service.
    BeginMaintenance { robot: RobotId, reason: String },
    /// Return a robot to service.
    EndMaintenance(RobotId),
    /// Cancel a mission.
    Cancel(MissionId),
    /// Change the priority of a mission.
    SetPriority { mission: MissionId, priority: Priority },
    /// Close a place or a zone.
    Close { place: PlaceId, reason: String },
    /// Open a place or a zone.
    OpenPlace(PlaceId),
    /// Open a lane.
    OpenLane(PlaceId, PlaceId),
    /// Raise an alarm.
    RaiseAlarm { alarm: AlarmId, reason: String },
    /// Clear an alarm.
    ClearAlarm(AlarmId),
}

impl Order {
    /// Returns the request of the order. `by` is the responsible person.
    pub(crate) fn request(self, by: Option<String>, id: RequestId) -> (ApiCall, Value) {
        let request = Some(id);
        let only = |robot| RobotSelection::Named(BTreeSet::from([robot]));
        let maintenance = |robot, action, reason, by, request| {
            let request = MaintenanceRequest { robots: only(robot), action, until: None, reason, by, request };
            (ApiCall::Maintenance, to_value(&request))
        };
        match self {
            Order::Hold { robot, reason } => {
                (ApiCall::Hold, to_value(&HoldRequest { robots: only(robot), for_s: None, reason, by, request }))
            }
            Order::Release(robot) => (ApiCall::Release, to_value(&ReleaseRequest { robots: only(robot), by, request })),
            Order::BeginMaintenance { robot, reason } => {
                maintenance(robot, MaintenanceAction::Begin, reason, by, request)
            }
            Order::EndMaintenance(robot) => maintenance(robot, MaintenanceAction::End, String::new(), by, request),
            Order::Cancel(mission) => (ApiCall::Cancel, to_value(&MissionChangeRequest { mission, by })),
            Order::SetPriority { mission, priority } => {
                let priority = priority.get().into();
                (ApiCall::Priority, to_value(&PriorityRequest { mission, priority, by, request }))
            }
            Order::Close { place, reason } => {
                let (places, lanes) = (BTreeSet::from([place]), vec![]);
                let request = CloseRequest { places, lanes, for_s: None, until: None, reason, by, request };
                (ApiCall::Close, to_value(&request))
            }
            Order::OpenPlace(place) => {
                let (places, lanes) = (BTreeSet::from([place]), vec![]);
                (ApiCall::Open, to_value(&OpenRequest { places, lanes, by, request }))
            }
            Order::OpenLane(a, b) => {
                let (places, lanes) = (BTreeSet::new(), vec![(a, b)]);
                (ApiCall::Open, to_value(&OpenRequest { places, lanes, by, request }))
            }
            Order::RaiseAlarm { alarm, reason } => {
                let (action, alarm) = (AlarmAction::Raise, Some(alarm));
                (ApiCall::Alarm, to_value(&AlarmRequest { action, alarm, reason, by, request }))
            }
            Order::ClearAlarm(alarm) => {
                let (action, alarm, reason) = (AlarmAction::Clear, Some(alarm), String::new());
                (ApiCall::Alarm, to_value(&AlarmRequest { action, alarm, reason, by, request }))
            }
        }
    }
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Order::Hold { robot, .. } => write!(f, "hold {robot}"),
            Order::Release(robot) => write!(f, "release {robot}"),
            Order::BeginMaintenance { robot, .. } => write!(f, "take {robot} out of service"),
            Order::EndMaintenance(robot) => write!(f, "return {robot} to service"),
            Order::Cancel(mission) => write!(f, "cancel {mission}"),
            Order::SetPriority { mission, priority } => write!(f, "give {mission} the priority {}", priority.get()),
            Order::Close { place, .. } => write!(f, "close {place}"),
            Order::OpenPlace(place) => write!(f, "open {place}"),
            Order::OpenLane(a, b) => write!(f, "open {a} – {b}"),
            Order::RaiseAlarm { alarm, .. } => write!(f, "raise the alarm {alarm}"),
            Order::ClearAlarm(alarm) => write!(f, "clear the alarm {alarm}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::api::parse_request;
    use serde::de::DeserializeOwned;
    use serde_json::json;

    fn request(order: Order) -> (ApiCall, Value) {
        order.request(Some("Nia".to_owned()), "r-1".parse().unwrap())
    }

    /// The coordinator reads the payload with the same function.
    fn is_read<T: DeserializeOwned>((call, payload): &(ApiCall, Value)) -> bool {
        parse_request::<T>(*call, payload.to_string().as_bytes()).is_ok()
    }

    #[test]
    fn each_order_has_its_request() {
        let (ada, fire) = ("ada".parse::<RobotId>().unwrap(), "fire".parse::<AlarmId>().unwrap());
        let spill = || "a spill".to_owned();
        let hold = request(Order::Hold { robot: ada.clone(), reason: spill() });
        assert_eq!(hold.1, json!({ "robots": ["ada"], "reason": "a spill", "by": "Nia", "request": "r-1" }));
        assert!(hold.0 == ApiCall::Hold && is_read::<HoldRequest>(&hold));
        let end = request(Order::EndMaintenance(ada));
        assert_eq!(end.1, json!({ "robots": ["ada"], "action": "end", "by": "Nia", "request": "r-1" }));
        assert!(end.0 == ApiCall::Maintenance && is_read::<MaintenanceRequest>(&end));
        let mission = "m-1".parse().unwrap();
        let priority = request(Order::SetPriority { mission, priority: Priority::new(-5).unwrap() });
        assert_eq!(priority.1, json!({ "mission": "m-1", "priority": -5, "by": "Nia", "request": "r-1" }));
        assert!(priority.0 == ApiCall::Priority && is_read::<PriorityRequest>(&priority));
        let open = request(Order::OpenLane("A".parse().unwrap(), "B".parse().unwrap()));
        assert_eq!(open.1, json!({ "lanes": [["A", "B"]], "by": "Nia", "request": "r-1" }));
        assert!(open.0 == ApiCall::Open && is_read::<OpenRequest>(&open));
        let clear = request(Order::ClearAlarm(fire));
        assert_eq!(clear.1, json!({ "action": "clear", "alarm": "fire", "by": "Nia", "request": "r-1" }));
        assert!(clear.0 == ApiCall::Alarm && is_read::<AlarmRequest>(&clear));
    }
}
