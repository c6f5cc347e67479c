//! Auction rounds and actions of a leader session, as values.

use super::message::{AwardedRole, CollectedBids};
use consort_protocol::auction::AuctionRecord;
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::lease::{Epoch, LeaseMonitor};
use consort_protocol::ledger::{Branch, RoleReturn};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::BTreeMap;

/// Auction of a mission's open roles by this coordinator.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AuctionRound {
    /// Number of rounds that this coordinator has called for the mission.
    pub(super) number: u32,
    /// Branch of the auctioned roles.
    pub(super) branch: Branch,
    /// Start of the first round.
    pub(super) since: NodeTime,
    /// Start of the current round.
    pub(super) called_at: NodeTime,
    /// Number of consecutive rounds without any possible robot for some role.
    pub(super) hopeless_rounds: u32,
    /// Phase of the current round.
    pub(super) phase: RoundPhase,
}

impl AuctionRound {
    pub(super) fn is_backing_off(&self) -> bool {
        matches!(self.phase, RoundPhase::BackingOff { .. })
    }

    /// Makes the next call due, if the round had no result.
    pub(super) fn end_backoff(&mut self, now: NodeTime) {
        if let RoundPhase::BackingOff { until, .. } = &mut self.phase {
            *until = now;
        }
    }

    /// Follows the mission's branch. On a change, results for the other branch are void and the
    /// next round is due: an award of the old roles would be refused, and the count of hopeless
    /// rounds is meaningless.
    pub(super) fn follow_branch(&mut self, branch: Branch, now: NodeTime) {
        if self.branch != branch {
            let AuctionRound { number, called_at, .. } = *self;
            let phase = RoundPhase::BackingOff { until: now, since: now };
            *self = AuctionRound { number, branch, since: now, called_at, hopeless_rounds: 0, phase };
        }
    }

    /// Returns the first round for the main branch, called at time 0.
    #[cfg(test)]
    pub(super) fn first(phase: RoundPhase) -> AuctionRound {
        let (since, called_at) = (NodeTime::ZERO, NodeTime::ZERO);
        AuctionRound { number: 1, branch: Branch::Main, since, called_at, hopeless_rounds: 0, phase }
    }
}

/// Phase of an auction round.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RoundPhase {
    /// Bids are being collected.
    Bidding,
    /// All bids have arrived. Missions with a better rank may still need the same robots.
    BiddingClosed(Box<ClosedBidding>),
    /// The award is proposed and not committed yet.
    Proposing(Box<AuctionRecord>),
    /// The round had no result.
    BackingOff {
        /// Time of the next call.
        until: NodeTime,
        /// End of the round.
        since: NodeTime,
    },
}

/// Auction with all its bids.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ClosedBidding {
    pub(super) bids: CollectedBids,
    /// Time until which it waits for better-ranked missions.
    pub(super) deadline: NodeTime,
    /// Its roles could be filled when it began to wait.
    pub(super) is_fillable: bool,
}

/// Pending action of the coordinator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum CoordinatorAction {
    /// Call for bids for a mission's open roles.
    CallForBids(MissionId),
    /// Notify a robot of its award.
    NotifyAward(AwardedRole),
    /// Award a promised role to its robot, which is free.
    AwardPromised(AwardedRole),
    /// Release a role with the cause: the lease of its robot has certainly expired, or the robot of a
    /// promise is out of service.
    ReleaseRole(AwardedRole, String),
    /// Ask a robot to return a role for another mission.
    AskToGiveWay {
        awarded: AwardedRole,
        to: MissionId,
        /// The robot gets the role again.
        for_now: bool,
    },
    /// Ask a robot to return a role that a person has reassigned.
    AskToReturn { awarded: AwardedRole, order: RoleReturn },
    /// Fail a mission.
    FailMission { mission: MissionId, cause: String, class: CauseClass },
}

/// Charge of a robot by its record, as a share of a full battery.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordedCharge {
    pub(super) charge: f64,
    /// Charge above the minimum that a role must leave.
    pub(super) spare: f64,
}

/// Session state that the pending actions depend on.
pub(super) struct SessionState<'a> {
    pub(super) lease_monitor: &'a LeaseMonitor,
    pub(super) rounds: &'a BTreeMap<MissionId, AuctionRound>,
    pub(super) notified: &'a BTreeMap<(Epoch, RoleId), NodeTime>,
    /// Robots with promises that cannot take a role, with the reasons.
    pub(super) unfit: &'a BTreeMap<RobotId, String>,
    /// Charge of robots with promises.
    pub(super) charges: &'a BTreeMap<RobotId, RecordedCharge>,
    /// Maximum number of promises of a robot.
    pub(super) promises_max: u32,
    /// Time before the earliest start of a mission from which its roles are promised.
    pub(super) ahead: Seconds,
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::AuctionId;
    use std::time::Duration;

    #[test]
    fn a_branch_change_voids_the_round_and_makes_the_next_due() {
        let now = NodeTime::ZERO + Duration::from_secs(9);
        let auction = AuctionId { mission: "m-1".parse().unwrap(), term: 1, round: 4 };
        let proposing = RoundPhase::Proposing(Box::new(AuctionRecord::empty(auction)));
        let round = AuctionRound { number: 4, hopeless_rounds: 2, ..AuctionRound::first(proposing) };
        let mut same = round.clone();
        same.follow_branch(Branch::Main, now);
        assert_eq!(same, round);
        let mut other = round.clone();
        other.follow_branch(Branch::Recovery, now);
        let phase = RoundPhase::BackingOff { until: now, since: now };
        // The number stays, so that a late reply to the void round is not taken for a reply to the
        // next round.
        let (number, branch, called_at) = (4, Branch::Recovery, NodeTime::ZERO);
        assert_eq!(other, AuctionRound { number, branch, since: now, called_at, hopeless_rounds: 0, phase });
    }
}
