//! Requests to people and their cancellation, as values.

use crate::robot::StepRef;
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, MissionId, RobotId, RoleId, TaskId};
use consort_protocol::lease::RoleHolder;
use consort_protocol::ledger::Branch;
use consort_protocol::mission::TaskSpec;
use consort_skills::actions::{GoalId, PersonRequest};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// Maximum number of cancellations that are repeated; older ones are dropped. Raised: more queries
/// per timer to an unreachable driver server. A guess: each belongs to a mission that ended, or
/// lost a robot, during a person request.
const CANCELLATIONS_MAX: usize = 64;

/// Subject of a person request.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct RequestSubject {
    /// A newly founded ledger may reuse a mission id.
    pub(super) cluster: Option<ClusterId>,
    pub(super) mission: MissionId,
    pub(super) branch: Branch,
    pub(super) role: RoleId,
    pub(super) task: TaskId,
    pub(super) spec: TaskSpec,
    /// A robot that gets its role back has a new award, and the person meets it anew.
    pub(super) holders: BTreeMap<RoleId, RoleHolder>,
}

/// Request to a person.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OpenRequest {
    pub(super) step: StepRef,
    subject: RequestSubject,
    /// Number of earlier requests with the same subject that were canceled while still needed.
    turn: u32,
}

impl OpenRequest {
    pub(super) fn new(step: StepRef, subject: RequestSubject) -> OpenRequest {
        OpenRequest { step, subject, turn: 0 }
    }

    /// Returns the request id: FNV-1a (Fowler, Noll, Vo) over the subject and the turn. Another
    /// proxy, or a later incarnation of this proxy, gets the same id for the same subject and turn.
    pub(super) fn id(&self) -> GoalId {
        let content = codec::encode_record(&(&self.subject, self.turn)).expect("a person request fits a record");
        let step = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        GoalId(content.iter().fold(0xcbf2_9ce4_8422_2325, step))
    }

    /// Returns the request as sent to the driver server.
    pub(super) fn request(&self) -> PersonRequest {
        let RequestSubject { role, spec, holders, .. } = &self.subject;
        PersonRequest { role: role.clone(), task: spec.clone(), holders: RoleHolder::robots(holders) }
    }

    /// Checks whether the robots to be met, or their awards, have changed.
    pub(super) fn is_outdated(&self, holders: &BTreeMap<RoleId, RoleHolder>) -> bool {
        self.subject.holders != *holders
    }

    /// Renews a canceled request that is still needed. A canceled id is not served again.
    pub(super) fn renew(&mut self) {
        self.turn += 1;
    }
}

/// Cancellations that the driver server has not confirmed yet, oldest first.
#[derive(Debug, Default)]
pub(super) struct PendingCancellations(VecDeque<GoalId>);

impl PendingCancellations {
    pub(super) fn add(&mut self, id: GoalId) {
        self.confirm(id);
        self.0.push_back(id);
        if self.0.len() > CANCELLATIONS_MAX {
            self.0.pop_front();
        }
    }

    /// Removes a request that has ended, for any reason.
    pub(super) fn confirm(&mut self, id: GoalId) {
        self.0.retain(|known| *known != id);
    }

    /// Returns the cancellations to be repeated.
    pub(super) fn pending(&self) -> impl Iterator<Item = GoalId> {
        self.0.iter().copied()
    }
}

/// Number of recent cancel orders that are recognised as repetitions. The driver server repeats an
/// order for some publish intervals, 2.5 s with the defaults, and not later. People who each stand
/// at a place do not send more than this number meanwhile. Raised: more memory, no other effect.
const ORDERS_MAX: usize = 256;

/// Recent orders of people to cancel a mission, oldest first. A repeated order must not cancel the
/// next mission.
#[derive(Debug, Default)]
struct RecentCancelOrders(VecDeque<(String, RobotId, u64)>);

impl RecentCancelOrders {
    /// Checks whether an order is new. It is identified by the person, the robot, and the time on
    /// the world's clock.
    fn is_new(&mut self, by: &str, robot: &RobotId, at_ms: u64) -> bool {
        let known = |(other, to, at): &(String, RobotId, u64)| other == by && to == robot && *at == at_ms;
        if self.0.iter().any(known) {
            return false;
        }
        self.0.push_back((by.to_owned(), robot.clone(), at_ms));
        if self.0.len() > ORDERS_MAX {
            self.0.pop_front();
        }
        true
    }
}

/// Missions canceled by people, with the name of the person. The cancellation is repeated until the
/// mission is no longer active.
#[derive(Debug, Default)]
pub(super) struct CanceledMissions {
    missions: BTreeMap<MissionId, String>,
    recent_orders: RecentCancelOrders,
}

impl CanceledMissions {
    /// Adds the mission of an order. Returns false for a repeated order.
    pub(super) fn add(&mut self, mission: &MissionId, order: CancelOrder<'_>) -> bool {
        let is_new = self.recent_orders.is_new(order.by, order.robot, order.at_ms);
        if is_new {
            self.missions.insert(mission.clone(), order.by.to_owned());
        }
        is_new
    }

    /// Removes the missions that are no longer active.
    pub(super) fn retain(&mut self, is_active: impl Fn(&MissionId) -> bool) {
        self.missions.retain(|mission, _| is_active(mission));
    }

    /// Returns the missions to be canceled, each with the name of the person.
    pub(super) fn pending(&self) -> Vec<(MissionId, String)> {
        self.missions.iter().map(|(mission, by)| (mission.clone(), by.clone())).collect()
    }
}

/// Order of a person to cancel a mission.
#[derive(Debug, Clone, Copy)]
pub(super) struct CancelOrder<'a> {
    /// Name of the person.
    pub(super) by: &'a str,
    /// Role of the person.
    pub(super) role: &'a RoleId,
    /// The robot that came.
    pub(super) robot: &'a RobotId,
    /// World time of the order in milliseconds.
    pub(super) at_ms: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::TaskType;
    use consort_protocol::lease::Epoch;

    fn subject(holders: &[(&str, &str, u64)]) -> RequestSubject {
        let role = |name: &str| RoleId::new(name).unwrap();
        let holding = |(of, robot, index): &(&str, &str, u64)| {
            (role(of), RoleHolder { robot: RobotId::new(*robot).unwrap(), epoch: Epoch { term: 1, index: *index } })
        };
        RequestSubject {
            cluster: Some(ClusterId(7)),
            mission: MissionId::new("lab-samples-1").unwrap(),
            branch: Branch::Main,
            role: role("nurse"),
            task: TaskId::new("deposit").unwrap(),
            spec: TaskSpec::of(TaskType::new("deposit").unwrap(), vec![role("nurse")]),
            holders: holders.iter().map(holding).collect(),
        }
    }

    fn id(subject: RequestSubject) -> GoalId {
        OpenRequest::new(StepRef::Step(0), subject).id()
    }

    #[test]
    fn a_new_award_of_the_same_robot_gets_a_new_request() {
        let both = subject(&[("lab_arm", "arm", 2), ("r1", "amber", 2)]);
        let alone = subject(&[("r1", "amber", 2)]);
        let again = subject(&[("lab_arm", "arm", 9), ("r1", "amber", 2)]);
        let ids = std::collections::BTreeSet::from([id(both.clone()), id(alone), id(again.clone())]);
        assert_eq!(ids.len(), 3);
        let request = OpenRequest::new(StepRef::Step(0), both.clone());
        assert!(request.is_outdated(&again.holders) && !request.is_outdated(&both.holders));
        assert_eq!(id(both.clone()), id(both), "the same request has the same id");
    }

    #[test]
    fn requests_of_different_clusters_and_branches_have_different_ids() {
        let here = subject(&[("r1", "amber", 2)]);
        let other_cluster = RequestSubject { cluster: Some(ClusterId(8)), ..here.clone() };
        let recovery = RequestSubject { branch: Branch::Recovery, ..here.clone() };
        let ids = std::collections::BTreeSet::from([id(here), id(other_cluster), id(recovery)]);
        assert_eq!(ids.len(), 3);
    }

    #[test]
    fn a_renewed_request_has_another_id() {
        let mut request = OpenRequest::new(StepRef::Step(0), subject(&[]));
        let first_id = request.id();
        request.renew();
        assert_ne!(request.id(), first_id);
        let mut other_proxy = OpenRequest::new(StepRef::Step(0), subject(&[]));
        other_proxy.renew();
        assert_eq!(other_proxy.id(), request.id(), "every proxy computes the same id");
    }

    #[test]
    fn a_repeated_cancel_order_is_recognised_and_memory_is_bounded() {
        let mut orders = RecentCancelOrders::default();
        let amber = RobotId::new("amber").unwrap();
        assert!(orders.is_new("Nia", &amber, 1000));
        assert!(!orders.is_new("Nia", &amber, 1000), "repeated");
        for at_ms in [0, 2000] {
            assert!(orders.is_new("Nia", &amber, at_ms), "another order, possibly of a restarted world");
        }
        assert!(orders.is_new("Ria", &amber, 1000) && orders.is_new("Nia", &RobotId::new("birch").unwrap(), 1000));
        assert!(!orders.is_new("Nia", &amber, 1000));
        (10_000..20_000).for_each(|at_ms| assert!(orders.is_new("Nia", &amber, at_ms)));
        assert_eq!(orders.0.len(), ORDERS_MAX, "the number is bounded");
        assert!(!orders.is_new("Nia", &amber, 19_999) && orders.is_new("Nia", &amber, 1000));
    }

    #[test]
    fn a_cancellation_is_repeated_until_it_is_confirmed() {
        let mut cancellations = PendingCancellations::default();
        [1, 2, 1].into_iter().for_each(|id| cancellations.add(GoalId(id)));
        assert_eq!(cancellations.pending().collect::<Vec<_>>(), [GoalId(2), GoalId(1)]);
        assert_eq!(cancellations.pending().count(), 2, "reading them does not remove them");
        cancellations.confirm(GoalId(2));
        assert_eq!(cancellations.pending().collect::<Vec<_>>(), [GoalId(1)]);
        (10..200).for_each(|id| cancellations.add(GoalId(id)));
        assert_eq!(cancellations.pending().count(), CANCELLATIONS_MAX, "the number is bounded");
    }
}
