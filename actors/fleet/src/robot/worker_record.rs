//! The robot's own record, as a value: its content, and the choice of changes worth publishing.

use consort_protocol::knowledge::{Availability, Charging, RobotKnowledge};
use consort_protocol::units::NodeTime;
use consort_skills::actions::Telemetry;
use std::time::Duration;

/// Change of charge that is published through gossip: a guess. Bids and the robot itself use the
/// exact charge.
const CHARGE_STEP: f64 = 0.02;

/// Minimum interval of publications while neither place, availability nor charging changes.
const PUBLISH_INTERVAL: Duration = Duration::from_secs(1);

/// The worker as of the latest telemetry, and as last published.
pub(super) struct WorkerRecord {
    worker: RobotKnowledge,
    /// The worker as last sent to gossip since the start of this actor.
    published: Option<RobotKnowledge>,
    published_at: NodeTime,
}

impl WorkerRecord {
    /// Creates the record of a robot whose driver has not reported yet.
    pub(super) fn new(worker: RobotKnowledge, now: NodeTime) -> WorkerRecord {
        WorkerRecord { worker, published: None, published_at: now }
    }

    pub(super) fn worker(&self) -> &RobotKnowledge {
        &self.worker
    }

    /// Updates the record. Without telemetry, place, pose and charge stay. Only a free robot charges.
    /// Returns the worker if it is to be published now.
    pub(super) fn update(
        &mut self,
        telemetry: Option<&Telemetry>,
        availability: Availability,
        charging: Option<Charging>,
        now: NodeTime,
    ) -> Option<RobotKnowledge> {
        if let Some(report) = telemetry {
            self.worker.place = report.place.clone();
            self.worker.pose = report.pose;
            self.worker.battery = report.battery;
        }
        self.worker.charging = charging.filter(|_| availability == Availability::Free);
        self.worker.availability = availability;
        if !self.must_publish(now) {
            return None;
        }
        self.published_at = now;
        self.published = Some(self.worker.clone());
        self.published.clone()
    }

    fn must_publish(&self, now: NodeTime) -> bool {
        let Some(published) = &self.published else { return true };
        let is_urgent = published.availability != self.worker.availability
            || published.place != self.worker.place
            || published.charging != self.worker.charging;
        let is_due = now.since(self.published_at) >= PUBLISH_INTERVAL;
        is_urgent || is_due && is_worth_publishing(published, &self.worker)
    }
}

/// Checks whether a change of the worker is worth publishing. An idle robot loses a little charge
/// every second, which affects no decision.
fn is_worth_publishing(published: &RobotKnowledge, now: &RobotKnowledge) -> bool {
    let lost = (published.battery.get() - now.battery.get()).abs() >= CHARGE_STEP;
    let useful = |worker: &RobotKnowledge| worker.battery >= worker.useful_charge;
    lost || useful(published) != useful(now)
        || RobotKnowledge { battery: published.battery, ..now.clone() } != *published
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, WorldTime};
    use std::collections::BTreeSet;

    fn at(ms: u64) -> NodeTime {
        NodeTime::default() + Duration::from_millis(ms)
    }

    fn telemetry(place: &str, battery: f64) -> Telemetry {
        Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::default(),
            place: place.parse().unwrap(),
            battery: BatteryShare::new(battery).unwrap(),
            able: true,
            closed: vec![],
            readings: std::collections::BTreeMap::new(),
        }
    }

    fn record() -> WorkerRecord {
        let worker = RobotKnowledge { place: "Yard".parse().unwrap(), ..idle_robot() };
        let mut record = WorkerRecord::new(worker, at(0));
        assert!(record.update(Some(&telemetry("Dock", 0.9)), Availability::Free, None, at(0)).is_some());
        record
    }

    #[test]
    fn a_new_place_or_availability_is_published_at_once() {
        let mut record = record();
        assert_eq!(record.update(Some(&telemetry("Dock", 0.8)), Availability::Free, None, at(100)), None);
        let moved = record.update(Some(&telemetry("Lab", 0.8)), Availability::Free, None, at(200)).unwrap();
        assert_eq!((moved.place.as_str(), moved.battery.get()), ("Lab", 0.8));
        let problem = Availability::OutOfService { problem: "its driver does not reply".to_owned() };
        let failed = record.update(None, problem.clone(), None, at(300)).unwrap();
        assert_eq!((failed.place.as_str(), failed.availability), ("Lab", problem));
    }

    #[test]
    fn charging_of_a_free_robot_is_published_at_once() {
        let mut record = record();
        let waiting = Charging::Waiting { chargers: BTreeSet::new() };
        let published = record.update(None, Availability::Free, Some(waiting.clone()), at(100)).unwrap();
        assert_eq!(published.charging, Some(waiting.clone()));
        let problem = Availability::OutOfService { problem: "its driver does not reply".to_owned() };
        let failed = record.update(None, problem, Some(waiting), at(200)).unwrap();
        assert_eq!(failed.charging, None);
    }

    #[test]
    fn a_small_loss_of_charge_is_not_published() {
        let mut record = record();
        assert_eq!(record.update(Some(&telemetry("Dock", 0.89)), Availability::Free, None, at(5_000)), None);
        assert!(record.update(Some(&telemetry("Dock", 0.87)), Availability::Free, None, at(5_000)).is_some());
        assert_eq!(
            record.update(Some(&telemetry("Dock", 0.5)), Availability::Free, None, at(5_999)),
            None,
            "too early"
        );
        assert!(record.update(Some(&telemetry("Dock", 0.5)), Availability::Free, None, at(6_000)).is_some());
    }
}
