//! People who give the orders of a schedule, and end them when all faults have ended.

use super::executor::{ActionExecutor, RESOLVE_INTERVAL};
use super::person_action::{ALL_ROBOTS, ClosureAction, MissionAction, OrderAction, SpeedLimitAction};
use super::schedule::Schedule;
use super::{alarms, closures, mission_changes, orders, speed_limits};
use crate::history::RecordingClient;
use crate::{EventLog, Fleet, Observation, slug};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MapPart;
use serde_json::Value;

/// Request of a person for a change of orders to robots, closures, speed limits, alarms or missions.
type PersonRequest = (ApiCall, Value);

impl ActionExecutor {
    /// Starts people who end all orders of the schedule, if it has any, again and again: a request of the schedule that was
    /// delayed may give an order later.
    pub(super) fn spawn_order_enders(&self, fleet: &Fleet, schedule: &Schedule) {
        if schedule.has_orders() {
            let ends = [("release", OrderAction::Release), ("end", OrderAction::EndMaintenance)];
            let end = |(what, change): (&str, _)| (what.to_owned(), orders::request(ALL_ROBOTS, change));
            let ends: Vec<_> = ends.map(end).into();
            self.spawn_order_ender(fleet, move || ends.clone());
        }
        let open = |part: MapPart| {
            let request = closures::request(&part, ClosureAction::Open);
            (format!("opening of {part}"), request)
        };
        let ends: Vec<(String, PersonRequest)> = schedule.closed_parts().into_iter().map(open).collect();
        if !ends.is_empty() {
            self.spawn_order_ender(fleet, move || ends.clone());
        }
        if schedule.has_alarms() {
            self.spawn_order_ender(fleet, || vec![("all-clear".to_owned(), alarms::all_clear())]);
        }
        let clear = |part: MapPart| {
            let request = speed_limits::request(&part, SpeedLimitAction::Clear);
            (format!("speed limit of {part}"), request)
        };
        let ends: Vec<(String, PersonRequest)> = schedule.limited_parts().into_iter().map(clear).collect();
        if !ends.is_empty() {
            self.spawn_order_ender(fleet, move || ends.clone());
        }
        let (restricted, acknowledged) = (schedule.restricted_requests(), self.acknowledged_receiver());
        if !restricted.is_empty() {
            self.spawn_order_ender(fleet, move || {
                let known = acknowledged.borrow();
                let unpin = |request: &String| {
                    let end = mission_changes::request(known.get(request)?, &MissionAction::Unpin);
                    Some((format!("unpin of {request}"), end))
                };
                restricted.iter().filter_map(unpin).collect()
            });
        }
    }

    /// Starts a person who sends these requests, each with what it ends, again and again.
    fn spawn_order_ender(&self, fleet: &Fleet, ends: impl Fn() -> Vec<(String, PersonRequest)> + Send + 'static) {
        let (client, event_log) = (self.client(fleet), fleet.event_log.clone());
        tokio::spawn(async move {
            for number in 1.. {
                let due = ends();
                for (what, request) in due {
                    give_order(&client, &event_log, &format!("final {what} {number}"), request).await;
                }
                tokio::time::sleep(RESOLVE_INTERVAL).await;
            }
        });
    }

    /// Lets a person, named by the number of the action, give an order.
    pub(super) fn order(&self, fleet: &Fleet, number: usize, request: PersonRequest) {
        let (client, event_log) = (self.client(fleet), fleet.event_log.clone());
        tokio::spawn(async move { give_order(&client, &event_log, &person(number), request).await });
    }

    /// Lets a person, named by the number of the action, change the mission of a request once it is acknowledged.
    pub(super) fn change_mission(&self, fleet: &Fleet, number: usize, request: &str, change: &MissionAction) {
        let (client, event_log) = (self.client(fleet), fleet.event_log.clone());
        let (request, change) = (request.to_owned(), change.clone());
        let mut acknowledged = self.acknowledged_receiver();
        tokio::spawn(async move {
            if let Ok(mission) =
                acknowledged.wait_for(|known| known.contains_key(&request)).await.map(|known| known[&request].clone())
            {
                let order = mission_changes::request(&mission, &change);
                give_order(&client, &event_log, &person(number), order).await;
            }
        });
    }
}

/// Returns the person that gives the order of this action.
pub(super) fn person(number: usize) -> String {
    format!("person {number}")
}

/// Sends the request of a person, and records the acknowledgement.
async fn give_order(client: &RecordingClient, event_log: &EventLog, person: &str, (call, request): PersonRequest) {
    if let Some(by) = client.order(call, request, person).await {
        event_log.add(Observation::OrderAcknowledged { node: slug("client"), by });
    }
}
