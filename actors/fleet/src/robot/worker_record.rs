//! The robot's own record, as a value: its content, and the choice of changes worth publishing.

use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{Availability, Charging, Motion, RobotKnowledge};
use consort_protocol::units::NodeTime;
use consort_skills::actions::Telemetry;
use std::collections::BTreeSet;
use std::time::Duration;

/// Change of charge that is published through gossip: a guess. Bids and the robot itself use the
/// exact charge.
const CHARGE_STEP: f64 = 0.02;

/// Minimum interval of publications while neither place, availability nor charging changes.
const PUBLISH_INTERVAL: Duration = Duration::from_secs(1);

/// Nodes that receive the motion of a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum MotionScope {
    /// All nodes: motion is part of the record.
    InRecord,
    /// The nodes that use it. The record, which all nodes receive, contains the motion at the time of its latest change.
    Apart {
        /// Places at which the robot arrives, and from which it departs, by a change of the record: all robots use
        /// them without a coordinator.
        shared_places: BTreeSet<PlaceId>,
    },
}

/// What a robot publishes.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Publication {
    /// The worker as a new record, to all nodes.
    Record(Box<RobotKnowledge>),
    /// The motion since the latest record, to the nodes that use it.
    Motion(Motion),
}

/// The worker as of the latest telemetry, and as last published.
pub(super) struct WorkerRecord {
    worker: RobotKnowledge,
    scope: MotionScope,
    /// The worker as last sent to gossip since the start of this actor.
    published: Option<RobotKnowledge>,
    /// The motion as last sent, in the record or apart.
    sent: Option<Motion>,
    published_at: NodeTime,
}

impl WorkerRecord {
    /// Creates the record of a robot whose driver has not reported yet.
    pub(super) fn new(worker: RobotKnowledge, scope: MotionScope, now: NodeTime) -> WorkerRecord {
        WorkerRecord { worker, scope, published: None, sent: None, published_at: now }
    }

    pub(super) fn worker(&self) -> &RobotKnowledge {
        &self.worker
    }

    /// Updates the record. Without telemetry, place, pose and charge stay. Only a free robot charges.
    /// Returns what is to be published now.
    pub(super) fn update(
        &mut self,
        telemetry: Option<&Telemetry>,
        availability: Availability,
        charging: Option<Charging>,
        now: NodeTime,
    ) -> Option<Publication> {
        if let Some(report) = telemetry {
            self.worker.place = report.place.clone();
            self.worker.pose = report.pose;
            self.worker.battery = report.battery;
        }
        self.worker.charging = charging.filter(|_| availability == Availability::Free);
        self.worker.availability = availability;
        let publication = self.next_publication(now)?;
        self.published_at = now;
        match &publication {
            Publication::Record(worker) => {
                self.sent = Some(Motion::of(worker));
                self.published = Some(RobotKnowledge::clone(worker));
            }
            Publication::Motion(motion) => self.sent = Some(motion.clone()),
        }
        Some(publication)
    }

    fn next_publication(&self, now: NodeTime) -> Option<Publication> {
        let record = || Publication::Record(Box::new(self.worker.clone()));
        let Some(published) = &self.published else { return Some(record()) };
        let is_due = now.since(self.published_at) >= PUBLISH_INTERVAL;
        let is_new_state =
            published.availability != self.worker.availability || published.charging != self.worker.charging;
        let is_new_place = published.place != self.worker.place;
        match &self.scope {
            MotionScope::InRecord => {
                let is_urgent = is_new_state || is_new_place;
                (is_urgent || is_due && is_worth_publishing(published, &self.worker)).then(record)
            }
            MotionScope::Apart { shared_places } => {
                let is_shared = |worker: &RobotKnowledge| shared_places.contains(&worker.place);
                let is_urgent = is_new_state || is_new_place && (is_shared(published) || is_shared(&self.worker));
                if is_urgent || is_due && is_for_all(published, &self.worker) {
                    return Some(record());
                }
                let motion = Motion::of(&self.worker);
                let has_passed_place = self.sent.as_ref().is_none_or(|sent| sent.place() != motion.place());
                let is_worth_sending = self.sent.as_ref().is_none_or(|sent| motion.is_worth_sending(sent));
                (has_passed_place || is_due && is_worth_sending).then_some(Publication::Motion(motion))
            }
        }
    }
}

/// Checks whether all nodes use the change of the worker since its published record, apart from its place.
fn is_for_all(published: &RobotKnowledge, now: &RobotKnowledge) -> bool {
    let RobotKnowledge { place, pose, battery, .. } = published;
    let in_place = RobotKnowledge { place: place.clone(), pose: *pose, battery: *battery, ..now.clone() };
    in_place != *published || is_useful(published) != is_useful(now)
}

/// Checks whether the robot has enough charge to be useful.
fn is_useful(worker: &RobotKnowledge) -> bool {
    worker.battery >= worker.useful_charge
}

/// Checks whether a change of the worker is worth publishing. An idle robot loses a little charge
/// every second, which affects no decision.
fn is_worth_publishing(published: &RobotKnowledge, now: &RobotKnowledge) -> bool {
    let lost = (published.battery.get() - now.battery.get()).abs() >= CHARGE_STEP;
    lost || is_useful(published) != is_useful(now)
        || RobotKnowledge { battery: published.battery, ..now.clone() } != *published
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, WorldTime};

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
        let mut record = WorkerRecord::new(worker, MotionScope::InRecord, at(0));
        assert!(record.update(Some(&telemetry("Dock", 0.9)), Availability::Free, None, at(0)).is_some());
        record
    }

    /// Returns the worker of a publication that is a record.
    fn worker(publication: Option<Publication>) -> RobotKnowledge {
        match publication {
            Some(Publication::Record(worker)) => *worker,
            other => panic!("no record: {other:?}"),
        }
    }

    #[test]
    fn motion_changes_the_record_only_at_places_that_all_robots_use() {
        let shared_places = BTreeSet::from(["Charger".parse().unwrap()]);
        let mut record = WorkerRecord::new(idle_robot(), MotionScope::Apart { shared_places }, at(0));
        let mut update = |place: &str, x: f64, battery: f64, ms: u64| {
            let telemetry = Telemetry { pose: Pose::new(x, 0.0, 0.0), ..telemetry(place, battery) };
            record.update(Some(&telemetry), Availability::Free, None, at(ms))
        };
        let is_motion = |publication: Option<Publication>| matches!(publication, Some(Publication::Motion(_)));
        assert_eq!(worker(update("Dock", 0.0, 0.9, 0)).place.as_str(), "Dock");
        assert_eq!(update("Dock", 0.5, 0.9, 500), None, "too early");
        assert!(is_motion(update("Dock", 1.0, 0.9, 1_000)));
        assert_eq!(update("Dock", 1.1, 0.89, 9_000), None, "within the dead band");
        assert!(is_motion(update("Lab", 1.1, 0.89, 9_100)), "a passed place");
        assert!(is_motion(update("Lab", 1.1, 0.8, 10_100)), "its charge");
        assert_eq!(worker(update("Charger", 2.0, 0.8, 10_200)).pose.x, 2.0, "arrives at a charger");
        assert_eq!(worker(update("Lab", 1.1, 0.8, 10_300)).place.as_str(), "Lab", "departs from a charger");
        let problem = Availability::OutOfService { problem: "its driver does not reply".to_owned() };
        assert_eq!(worker(record.update(None, problem.clone(), None, at(10_400))).availability, problem);
    }

    #[test]
    fn a_charge_about_the_useful_charge_changes_the_record_once_a_second() {
        let apart = MotionScope::Apart { shared_places: BTreeSet::new() };
        let mut record = WorkerRecord::new(idle_robot(), apart, at(0));
        let useful = idle_robot().useful_charge.get();
        let mut records = 0;
        for step in 0..40_u64 {
            let noise = if step.is_multiple_of(2) { 0.001 } else { -0.001 };
            let telemetry = telemetry("Dock", useful + noise);
            let published = record.update(Some(&telemetry), Availability::Free, None, at(step * 250));
            records += u32::from(published.is_some());
        }
        assert!((2..=10).contains(&records), "{records} records in 10 s");
    }

    #[test]
    fn a_new_place_or_availability_is_published_at_once() {
        let mut record = record();
        assert_eq!(record.update(Some(&telemetry("Dock", 0.8)), Availability::Free, None, at(100)), None);
        let moved = worker(record.update(Some(&telemetry("Lab", 0.8)), Availability::Free, None, at(200)));
        assert_eq!((moved.place.as_str(), moved.battery.get()), ("Lab", 0.8));
        let problem = Availability::OutOfService { problem: "its driver does not reply".to_owned() };
        let failed = worker(record.update(None, problem.clone(), None, at(300)));
        assert_eq!((failed.place.as_str(), failed.availability), ("Lab", problem));
    }

    #[test]
    fn charging_of_a_free_robot_is_published_at_once() {
        let mut record = record();
        let waiting = Charging::Waiting { chargers: BTreeSet::new() };
        let published = worker(record.update(None, Availability::Free, Some(waiting.clone()), at(100)));
        assert_eq!(published.charging, Some(waiting.clone()));
        let problem = Availability::OutOfService { problem: "its driver does not reply".to_owned() };
        let failed = worker(record.update(None, problem, Some(waiting), at(200)));
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
