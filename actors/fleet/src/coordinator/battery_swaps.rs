//! Battery swaps: the coordinator submits the mission in which a person swaps the battery of a robot.
//!
//! A robot with low charge that does not charge at chargers waits for a person. Its mission is requested once: the id of the
//! request contains the robot and the minute, a session requests no other for more than a minute, which is longer than a
//! proposal takes, and none while one for the robot is active. The charge must have been low for some seconds without such a
//! mission, since the record of a robot may be older than the end of its mission.

use super::session_context::SessionContext;
use super::submission::{Definitions, SubmitError, prepare};
use crate::robot::ChargingSettings;
use consort_protocol::api::{MissionSource, SubmitRequest};
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::knowledge::{Availability, KnowledgeBase, RobotKnowledge};
use consort_protocol::ledger::{Command, Ledger, Submission};
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::warn;

/// Parameter of the mission that names the robot.
const ROBOT: &str = "robot";

/// Interval at which the records of robots are examined. Raised: a robot waits longer.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Time for which the charge has been low before a swap is requested. Raised: a robot waits longer. A guess: a record arrives
/// within seconds.
const LOW_TIME: Duration = Duration::from_secs(10);

/// Time after a request in which no other is made for the robot. Raised: a robot whose mission has failed at once waits longer.
/// It is longer than the minute that the id of a request contains, and than the time limit of a proposal.
const REPEAT_INTERVAL: Duration = Duration::from_secs(70);

/// Priority of the mission: only this robot does it, and it can do little else.
const PRIORITY: i64 = 100;

/// Robots of a session whose batteries have to be swapped.
#[derive(Default)]
pub(super) struct BatterySwaps {
    /// Robots with low charge and without an active mission for it, and since when.
    low_since: BTreeMap<RobotId, NodeTime>,
    /// Times of the latest requests.
    requested_at: BTreeMap<RobotId, NodeTime>,
    /// Time of the latest examination.
    checked_at: Option<NodeTime>,
}

impl BatterySwaps {
    /// Requests the missions that are due. `now_ms` is the time of day that a majority of the voters confirms, in milliseconds
    /// since 1970.
    pub(super) fn follow(&mut self, context: &mut SessionContext, now: NodeTime, now_ms: Option<u64>) {
        let (Some(charging), Some(now_ms)) = (context.settings.charging.clone(), now_ms) else { return };
        let Some(swap) = &charging.swap else { return };
        if self.checked_at.is_some_and(|at| now.since(at) < CHECK_INTERVAL) {
            return;
        }
        self.checked_at = Some(now);
        let low = low_robots(context, &charging);
        let missions_max = context.settings.request_limits.missions_max;
        let (requested, has_room) = context.read_ledger(|ledger| {
            (requested_swaps(ledger, &swap.mission), missions_max == 0 || !ledger.has_active(missions_max))
        });
        let due = self.due(low.difference(&requested).cloned().collect(), has_room, now);
        for robot in due {
            match submission(&robot, &swap.mission, context, now_ms) {
                Ok(submission) => context.propose(Command::Submit(Box::new(submission))),
                Err(problem) => warn!(%robot, %problem, "cannot request a swap of the battery"),
            }
        }
    }

    /// Returns the robots that have been among those with low charge for long enough, unless a swap was requested for them a
    /// short time ago. A fleet without room for further missions requests none.
    fn due(&mut self, low: BTreeSet<RobotId>, has_room: bool, now: NodeTime) -> Vec<RobotId> {
        self.requested_at.retain(|_, at| now.since(*at) < REPEAT_INTERVAL);
        self.low_since.retain(|robot, _| low.contains(robot));
        for robot in low {
            self.low_since.entry(robot).or_insert(now);
        }
        let is_due = |(robot, since): &(&RobotId, &NodeTime)| {
            now.since(**since) >= LOW_TIME && !self.requested_at.contains_key(*robot)
        };
        let due = self.low_since.iter().filter(is_due).filter(|_| has_room);
        let due: Vec<RobotId> = due.map(|(robot, _)| robot.clone()).collect();
        self.requested_at.extend(due.iter().map(|robot| (robot.clone(), now)));
        due
    }
}

/// Returns the robots in contact that have a low charge and batteries to swap.
fn low_robots(context: &SessionContext, charging: &ChargingSettings) -> BTreeSet<RobotId> {
    let knowledge = &context.settings.parts.knowledge;
    let low = knowledge.read(|base| known_as_low(base, charging));
    low.into_iter().filter(|node| knowledge.is_alive(node)).map(RobotId::from).collect()
}

/// Returns the nodes of the robots whose batteries are swapped, and whose latest known charge is low.
fn known_as_low(base: &KnowledgeBase, charging: &ChargingSettings) -> Vec<NodeId> {
    let is_low = |robot: &RobotId, worker: &RobotKnowledge| {
        let is_in_service = !matches!(worker.availability, Availability::OutOfService { .. });
        is_in_service && worker.battery < charging.thresholds.below && charging.swaps(robot, worker)
    };
    let known = base.iter().filter(|(node, known)| {
        let worker = known.knowledge().robot.as_ref();
        worker.is_some_and(|worker| is_low(&RobotId::from(NodeId::clone(node)), worker))
    });
    known.map(|(node, _)| node.clone()).collect()
}

/// Returns the robots with an active mission of this name.
fn requested_swaps(ledger: &Ledger, mission: &str) -> BTreeSet<RobotId> {
    let swaps = ledger.active_missions().into_iter().map(|entry| &entry.submission);
    let swaps = swaps.filter(|submission| submission.mission.name.as_str() == mission);
    swaps.filter_map(|submission| submission.parameters.get(ROBOT)?.parse().ok()).collect()
}

fn submission(
    robot: &RobotId,
    mission: &str,
    context: &SessionContext,
    now_ms: u64,
) -> Result<Submission, SubmitError> {
    let settings = &context.settings;
    let (missions, domain, limits) = (&settings.missions, &settings.domain, settings.request_limits);
    let definitions = Definitions { missions, domain, limits };
    let mut request = SubmitRequest::of(MissionSource::Named(mission.to_owned()));
    request.parameters.insert(ROBOT.to_owned(), robot.to_string());
    request.priority = PRIORITY;
    let id = format!("swap-{robot}-{}", now_ms / 60_000);
    prepare(request, definitions, now_ms, id, format!("the low charge of {robot}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use crate::robot::{BatterySwap, ChargeThresholds};
    use consort_protocol::charging_curve::ChargingCurve;
    use consort_protocol::knowledge::{Knowledge, Motion, MotionUpdate, Record, RecordStamp};
    use consort_protocol::units::{BatteryShare, MetresPerSecond};

    #[test]
    fn a_charge_counts_as_low_by_motion_that_the_record_lacks() {
        let [below, low] = [0.4, 0.3].map(|share| BatteryShare::new(share).unwrap());
        let charging = ChargingSettings {
            thresholds: ChargeThresholds { below, until: BatteryShare::FULL, opportunistic: None },
            chargers: vec![],
            parking: BTreeSet::new(),
            curve: ChargingCurve::default(),
            gain: None,
            swap: Some(BatterySwap { mission: "battery-swap".to_owned(), eligible: None }),
        };
        let (owner, stamp) = (NodeId::new("ada").unwrap(), RecordStamp::default());
        let robot = RobotKnowledge { speed: Some(MetresPerSecond::new(1.0).unwrap()), ..idle_robot() };
        let knowledge = Knowledge::of(Some(robot.clone()));
        let mut base = KnowledgeBase::default();
        base.merge(Record { owner: owner.clone(), stamp, knowledge, proof: None }, NodeTime::ZERO);
        assert!(known_as_low(&base, &charging).is_empty());
        let motion = Some(Motion::of(&RobotKnowledge { battery: low, ..robot }));
        assert!(base.receive_motion(&owner, &MotionUpdate { stamp, number: 1, motion }));
        assert_eq!(known_as_low(&base, &charging), [owner]);
    }

    /// Returns the robots of these with low charge for which a swap is requested at this second.
    fn due(swaps: &mut BatterySwaps, low: &[&str], has_room: bool, at_s: u64) -> Vec<String> {
        let low = low.iter().map(|name| name.parse().unwrap()).collect();
        let due = swaps.due(low, has_room, NodeTime::ZERO + Duration::from_secs(at_s));
        due.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_swap_is_due_once_the_charge_has_been_low_for_a_while() {
        let mut swaps = BatterySwaps::default();
        let mut due = |low: &[&str], at_s: u64| due(&mut swaps, low, true, at_s);
        assert!(due(&["ada"], 0).is_empty());
        assert_eq!(due(&["ada", "bob"], 10), ["ada"]);
        assert!(due(&["bob"], 11).is_empty(), "the mission of ada is active");
        assert_eq!(due(&["ada", "bob"], 85), ["bob"], "the record of ada may be older than the end of its mission");
        assert_eq!(due(&["ada"], 95), ["ada"]);
    }

    #[test]
    fn a_swap_is_not_requested_again_while_its_proposal_is_under_way() {
        let mut swaps = BatterySwaps::default();
        let mut due = |has_room, at_s| due(&mut swaps, &["ada"], has_room, at_s);
        assert!(due(true, 0).is_empty());
        assert!(due(false, 10).is_empty(), "the fleet has no room for another mission");
        assert_eq!(due(true, 11), ["ada"]);
        // The minute ends, and with it the id of the request.
        assert!((12..81).all(|at_s| due(true, at_s).is_empty()));
        assert_eq!(due(true, 81), ["ada"], "the mission was not submitted, or has failed at once");
    }
}
