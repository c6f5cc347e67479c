//! The robot's side of its lease: the award, the coordinator, and the reports that renew it.

use super::checkpoint::Checkpoint;
use crate::followed_coordinator::{BeaconChange, FollowedCoordinator};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::{Action, Award, DeclineReason, Epoch, Event, LeaseTerms, RoleHolder, RoleLease};
use consort_protocol::message::{AwardNotice, AwardReply, Beacon};
use consort_protocol::plan::StepIndex;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time without a beacon after which a robot counts as without a coordinator. Raised: a robot that has lost its coordinator
/// charges later. It covers some lost beacons.
const BEACON_AGE_MAX: Duration = Duration::from_secs(3);

/// The lease of a robot, and the coordinator that renews it.
pub(super) struct LeaseClient {
    lease: RoleLease,
    /// The award that was restored from the checkpoint.
    resumed_epoch: Option<Epoch>,
    /// Holders of the mission's roles, from the latest report reply for this award.
    latest_holders: Option<(Epoch, BTreeMap<RoleId, RoleHolder>)>,
    coordinator: FollowedCoordinator,
    reports: ReportSchedule,
}

/// Schedule of reports. At most 1 report is in flight.
struct ReportSchedule {
    /// Interval of reports without news: a quarter of the lease.
    interval: Duration,
    in_flight: bool,
    /// Another report follows the reply.
    queued: bool,
    sent_at: NodeTime,
}

/// Head of a report: its recipient and the award.
pub(super) struct ReportHeader {
    pub(super) coordinator: NodeId,
    pub(super) mission: MissionId,
    pub(super) role: RoleId,
    pub(super) epoch: Epoch,
    /// The award was restored from the checkpoint.
    pub(super) from_checkpoint: bool,
}

/// Renewal of a lease by the coordinator.
pub(super) struct Renewal {
    pub(super) epoch: Epoch,
    /// Time at which the report was sent.
    pub(super) sent: NodeTime,
    /// Steps that the ledger contains as ended.
    pub(super) ended: BTreeSet<StepIndex>,
    pub(super) holders: BTreeMap<RoleId, RoleHolder>,
}

impl LeaseClient {
    /// Creates the lease of a robot, with the award of its checkpoint if there is one.
    pub(super) fn new(robot: RobotId, terms: LeaseTerms, restored: Option<&Checkpoint>, now: NodeTime) -> LeaseClient {
        let lease = match restored {
            Some(checkpoint) => RoleLease::restore(robot, terms, checkpoint.award.clone()),
            None => RoleLease::new(robot, terms),
        };
        LeaseClient {
            lease,
            resumed_epoch: restored.map(|checkpoint| checkpoint.award.epoch),
            latest_holders: None,
            coordinator: FollowedCoordinator::default(),
            reports: ReportSchedule { interval: terms.lease / 4, in_flight: false, queued: false, sent_at: now },
        }
    }

    /// Returns the award, confirmed or not.
    pub(super) fn award(&self) -> Option<&Award> {
        self.lease.award()
    }

    /// Checks whether the robot may act at this instant.
    pub(super) fn may_act(&self, now: NodeTime) -> bool {
        self.lease.may_act(now)
    }

    /// Returns the time until which the robot may act, if it holds a confirmed award.
    pub(super) fn acts_until(&self) -> Option<NodeTime> {
        self.lease.acts_until()
    }

    /// Returns the availability of a robot with an award.
    pub(super) fn holding(&self) -> Option<Availability> {
        self.award().map(|award| Availability::Holding {
            mission: award.mission.clone(),
            role: award.role.clone(),
            suspended: self.lease.is_suspended(),
        })
    }

    /// Returns the coordinator, if its beacon was received.
    pub(super) fn coordinator(&self) -> Option<&NodeId> {
        self.coordinator.beacon().map(|beacon| &beacon.node)
    }

    /// Checks whether the beacons of a coordinator arrive.
    pub(super) fn has_coordinator(&self, now: NodeTime) -> bool {
        self.coordinator.latest().is_some_and(|(_, at)| now.since(*at) < BEACON_AGE_MAX)
    }

    /// Follows the coordinator of a beacon. Returns `None` if another coordinator takes precedence.
    pub(super) fn follow(&mut self, beacon: Beacon, now: NodeTime) -> Option<BeaconChange> {
        let change = self.coordinator.receive(beacon, now);
        if change.is_some_and(|change| change.other_cluster) {
            self.lease.clear_latest_epochs();
        }
        change
    }

    /// Returns the reply to an award notice, and the event to be handled after the reply was sent.
    pub(super) fn answer(&self, notice: AwardNotice, is_leaving: bool) -> (AwardReply, Option<Event>) {
        let is_held = |award: &Award| self.lease.award().is_some_and(|held| held.epoch == award.epoch);
        match notice {
            AwardNotice::Awarded(award) if is_leaving && !is_held(&award) => {
                (AwardReply::Declined(DeclineReason::Leaving), None)
            }
            AwardNotice::Awarded(award) => match self.lease.check_award(&award) {
                Ok(()) => (AwardReply::Acknowledged, Some(Event::AwardReceived(award))),
                Err(why) => (AwardReply::Declined(why), None),
            },
            AwardNotice::GiveWay { .. }
            | AwardNotice::Orders(_)
            | AwardNotice::Return { .. }
            | AwardNotice::Leased { .. } => (AwardReply::Acknowledged, None),
            AwardNotice::Revoked { epoch, reason } => {
                (AwardReply::Acknowledged, Some(Event::Revoked { epoch, reason }))
            }
        }
    }

    /// Handles an event of the lease and returns the resulting actions.
    pub(super) fn handle(&mut self, event: Event, now: NodeTime) -> Vec<Action> {
        self.lease.handle(event, now)
    }

    /// Renews the lease and returns the resulting actions.
    pub(super) fn renew(&mut self, renewal: Renewal, now: NodeTime) -> Vec<Action> {
        let Renewal { epoch, sent, ended, holders } = renewal;
        self.latest_holders = Some((epoch, holders));
        self.lease.handle(Event::Renewed { epoch, sent, ended }, now)
    }

    /// Takes the latest holders of the mission's roles, to start the plan of an award.
    pub(super) fn take_holders(&mut self, award: &Award) -> BTreeMap<RoleId, RoleHolder> {
        let latest = self.latest_holders.take().filter(|(epoch, _)| *epoch == award.epoch);
        latest.map_or_else(|| award.holders.clone(), |(_, holders)| holders)
    }

    /// Checks whether a report without news is due.
    pub(super) fn is_report_due(&self, now: NodeTime) -> bool {
        now.since(self.reports.sent_at) >= self.reports.interval
    }

    /// Begins a report. Returns `None` without an award or a coordinator, and while a report is in
    /// flight: another then follows the reply.
    pub(super) fn begin_report(&mut self, now: NodeTime) -> Option<ReportHeader> {
        let (award, beacon) = (self.lease.award()?, self.coordinator.beacon()?);
        if self.reports.in_flight {
            self.reports.queued = true;
            return None;
        }
        self.reports.in_flight = true;
        self.reports.sent_at = now;
        Some(ReportHeader {
            coordinator: beacon.node.clone(),
            mission: award.mission.clone(),
            role: award.role.clone(),
            epoch: award.epoch,
            from_checkpoint: self.resumed_epoch == Some(award.epoch),
        })
    }

    /// Ends the report in flight. `answered` is true if the recipient replied as a coordinator.
    pub(super) fn end_report(&mut self, recipient: &NodeId, answered: bool, now: NodeTime) {
        self.reports.in_flight = false;
        match answered {
            true => self.coordinator.answered(recipient),
            false => self.coordinator.not_answered(recipient, now),
        }
    }

    /// Lets the beacons of other nodes than `node`, which claims to coordinate, take precedence.
    pub(super) fn distrust(&mut self, node: NodeId, now: NodeTime) {
        self.coordinator.distrust(node, now);
    }

    /// Takes the request for another report.
    pub(super) fn take_queued_report(&mut self) -> bool {
        std::mem::take(&mut self.reports.queued)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_values::{at, award};
    use super::*;

    fn beacon(node: &str, term: u64) -> Beacon {
        let node = node.parse().unwrap();
        Beacon { node, term, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None }
    }

    fn client() -> LeaseClient {
        let mut client = LeaseClient::new("ada".parse().unwrap(), LeaseTerms::default(), None, at(0));
        let (_, event) = client.answer(AwardNotice::Awarded(Box::new(award(7))), false);
        client.handle(event.unwrap(), at(0));
        client
    }

    #[test]
    fn one_report_is_in_flight_and_another_follows_the_reply() {
        let mut client = client();
        assert!(client.begin_report(at(1)).is_none() && !client.take_queued_report(), "no coordinator is known");
        client.follow(beacon("one", 1), at(1));
        assert_eq!(client.begin_report(at(2)).unwrap().coordinator.as_str(), "one");
        assert!(client.begin_report(at(3)).is_none());
        client.end_report(&"one".parse().unwrap(), true, at(3));
        assert!(client.take_queued_report() && !client.take_queued_report());
        assert!(client.begin_report(at(4)).is_some());
    }

    #[test]
    fn a_leaving_robot_declines_an_award() {
        let client = LeaseClient::new("ada".parse().unwrap(), LeaseTerms::default(), None, at(0));
        let (reply, event) = client.answer(AwardNotice::Awarded(Box::new(award(7))), true);
        assert_eq!((reply, event), (AwardReply::Declined(DeclineReason::Leaving), None));
    }

    /// A robot that declines an award counts as not holding it, and the role passes on at once.
    #[test]
    fn a_leaving_robot_acknowledges_a_repetition_of_the_award_it_holds() {
        let (reply, _) = client().answer(AwardNotice::Awarded(Box::new(award(7))), true);
        assert_eq!(reply, AwardReply::Acknowledged);
        let (reply, _) = client().answer(AwardNotice::Awarded(Box::new(award(9))), true);
        assert_eq!(reply, AwardReply::Declined(DeclineReason::Leaving));
    }

    #[test]
    fn the_latest_holders_belong_to_their_award() {
        let mut client = client();
        let held = RoleHolder { robot: "bob".parse().unwrap(), epoch: award(9).epoch };
        let holders = BTreeMap::from([("arm".parse().unwrap(), held)]);
        let renewal = |holders| Renewal { epoch: award(7).epoch, sent: at(0), ended: BTreeSet::new(), holders };
        client.renew(renewal(holders.clone()), at(1));
        assert_eq!(client.take_holders(&award(8)), BTreeMap::new());
        client.renew(renewal(holders.clone()), at(2));
        assert_eq!(client.take_holders(&award(7)), holders);
        assert_eq!(client.take_holders(&award(7)), BTreeMap::new(), "the holders of the award itself");
    }
}
