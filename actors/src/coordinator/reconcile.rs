//! What a coordinator has to do next, as a value.

use consort_protocol::auction::{BidResponse, CallForBids, RefusalReason};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::lease::{Epoch, LeaseMonitor};
use consort_protocol::ledger::{Branch, Ledger, MissionEntry, RolePhase};
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// An auction of a mission's open roles, as far as this coordinator has come with it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AuctionRound {
    /// How many rounds this coordinator has called for the mission.
    pub(super) number: u32,
    /// Of which branch's roles.
    pub(super) branch: Branch,
    /// When this one was called.
    pub(super) called_at: NodeTime,
    /// How many rounds in a row have shown that nobody is left for some role.
    pub(super) hopeless_rounds: u32,
    /// Where this one stands.
    pub(super) phase: RoundPhase,
}

impl AuctionRound {
    /// The mission takes this branch. What was found about another branch's roles is void, and the next round is due: an
    /// award of those would be refused, and nobody is left for them means nothing any more.
    pub(super) fn follow_branch(&mut self, branch: Branch, now: NodeTime) {
        if self.branch != branch {
            let phase = RoundPhase::BackingOff { until: now, since: now };
            *self = AuctionRound { number: self.number, branch, called_at: self.called_at, hopeless_rounds: 0, phase };
        }
    }
}

/// Where a round stands.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RoundPhase {
    /// Bids are coming in.
    Bidding,
    /// All bids are in; missions that are served before this one may yet want the same robots.
    BiddingClosed(Box<ClosedBidding>),
    /// These robots are being given roles; the ledger has not said yes yet.
    Proposing(BTreeMap<RoleId, RobotId>),
    /// It came to nothing.
    BackingOff {
        /// When the next is called.
        until: NodeTime,
        /// When it did.
        since: NodeTime,
    },
}

/// An auction whose bids are in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ClosedBidding {
    pub(super) call: CallForBids,
    pub(super) expected: BTreeSet<RobotId>,
    pub(super) responses: Vec<BidResponse>,
    /// How long it waits for others at most.
    pub(super) deadline: NodeTime,
}

/// Something to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum CoordinatorAction {
    /// Ask for bids for a mission's open roles.
    CallForBids(MissionId),
    /// Tell a robot that it has a role.
    NotifyAward { mission: MissionId, role: RoleId, robot: RobotId, epoch: Epoch },
    /// Take a role from a robot that has certainly stopped acting on it.
    ReleaseRole { mission: MissionId, role: RoleId, robot: RobotId, epoch: Epoch, cause: String },
    /// Give a mission up.
    FailMission { mission: MissionId, cause: String },
}

/// How long to wait after the n-th round in a row that came to nothing: 0.25 s, doubled each time, 5 s at most. Raised:
/// fewer questions to a busy fleet, later starts when a robot becomes free unnoticed.
pub(super) fn backoff(rounds: u32) -> Duration {
    Duration::from_millis(250 << rounds.saturating_sub(1).min(5)).min(Duration::from_secs(5))
}

/// How often a robot is told of an award that it has not confirmed.
const TELL_AGAIN: Duration = Duration::from_millis(500);

/// What is remembered of a reign.
pub(super) struct SessionState<'a> {
    pub(super) lease_monitor: &'a LeaseMonitor,
    pub(super) rounds: &'a BTreeMap<MissionId, AuctionRound>,
    pub(super) notified: &'a BTreeMap<(Epoch, RoleId), NodeTime>,
}

/// All that is to be done now, in the order in which missions are served.
pub(super) fn pending_actions(
    ledger: &Ledger,
    memory: &SessionState<'_>,
    now: NodeTime,
    wall_ms: u64,
) -> Vec<CoordinatorAction> {
    let SessionState { lease_monitor, rounds, notified } = memory;
    let mut duties = vec![];
    for entry in ledger.active_missions() {
        if entry.submission.deadline_ms.is_some_and(|deadline| deadline <= wall_ms) {
            duties.push(CoordinatorAction::FailMission { mission: entry.id.clone(), cause: past_deadline(entry) });
            continue;
        }
        let due = match rounds.get(&entry.id).map(|round| &round.phase) {
            None => true,
            Some(RoundPhase::BackingOff { until, .. }) => *until <= now,
            Some(RoundPhase::Bidding | RoundPhase::BiddingClosed(_) | RoundPhase::Proposing(_)) => false,
        };
        if due && can_be_auctioned(entry, lease_monitor, now) {
            duties.push(CoordinatorAction::CallForBids(entry.id.clone()));
        }
        for (role, held) in &entry.roles {
            let (Some(holder), RolePhase::Awarded | RolePhase::Active) = (&held.holder, held.phase) else { continue };
            let (mission, role, robot, epoch) = (entry.id.clone(), role.clone(), holder.robot.clone(), holder.epoch);
            if lease_monitor.has_expired(epoch, &robot, now) {
                let cause = format!(
                    "{robot} silent for {:.1} s",
                    lease_monitor.since_contact(epoch, &robot, now).as_secs_f64()
                );
                duties.push(CoordinatorAction::ReleaseRole { mission, role, robot, epoch, cause });
            } else if held.phase == RolePhase::Awarded
                && notified.get(&(epoch, role.clone())).is_none_or(|at| now.since(*at) >= TELL_AGAIN)
            {
                duties.push(CoordinatorAction::NotifyAward { mission, role, robot, epoch });
            }
        }
    }
    duties
}

/// Whether there are roles to be given out, and nobody acts in them any more: those who were at work when the recovery
/// branch was taken may be so until their leases have run out.
pub(super) fn can_be_auctioned(entry: &MissionEntry, watch: &LeaseMonitor, now: NodeTime) -> bool {
    let left = entry.former_holders.iter().all(|held| watch.has_expired(held.epoch, &held.robot, now));
    left && !entry.open_roles().is_empty()
}

fn past_deadline(entry: &MissionEntry) -> String {
    let why = entry.auction.as_ref().and_then(|auction| auction.failure.as_ref());
    match (entry.open_roles().is_empty(), why) {
        (true, _) => {
            let (done, steps) = entry.progress();
            format!("its deadline passed after {done} of {steps} steps")
        }
        (false, Some(why)) => format!("its deadline passed while it waited: {why}"),
        (false, None) => "its deadline passed before an auction was held".to_owned(),
    }
}

/// Robots that are given no role of a mission, and why: they hold one or are about to, or carry something of another
/// mission.
pub(super) fn unavailable_robots(
    ledger: &Ledger,
    rounds: &BTreeMap<MissionId, AuctionRound>,
    of: &MissionId,
) -> BTreeMap<RobotId, RefusalReason> {
    let busy =
        |mission: &MissionId, role: &RoleId| RefusalReason::Busy { mission: mission.clone(), role: role.clone() };
    let full = ledger.held_items().filter(|(entry, _)| entry.id != *of).map(|(entry, kept)| {
        let (item, mission) = (kept.item, entry.id.clone());
        (kept.robot, RefusalReason::HandsFull { item, mission })
    });
    let held = ledger.active_missions().into_iter().flat_map(|entry| {
        let holding =
            entry.roles.iter().filter(|(_, held)| matches!(held.phase, RolePhase::Awarded | RolePhase::Active));
        holding.filter_map(|(role, held)| Some((held.holder.as_ref()?.robot.clone(), busy(&entry.id, role))))
    });
    let about_to = rounds.iter().flat_map(|(mission, round)| match &round.phase {
        RoundPhase::Proposing(holders) => {
            holders.iter().map(|(role, robot)| (robot.clone(), busy(mission, role))).collect::<Vec<_>>()
        }
        RoundPhase::Bidding | RoundPhase::BiddingClosed(_) | RoundPhase::BackingOff { .. } => vec![],
    });
    full.chain(held).chain(about_to).collect()
}

/// The awards that are in force, or were and may still be acted on, and whose they are.
pub(super) fn awards_in_force(ledger: &Ledger) -> BTreeSet<(Epoch, RobotId)> {
    let mut awards = BTreeSet::new();
    for entry in ledger.active_missions() {
        awards.extend(entry.role_holders().into_values().map(|held| (held.epoch, held.robot)));
        awards.extend(entry.former_holders.iter().map(|held| (held.epoch, held.robot.clone())));
    }
    awards
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_about_another_branchs_roles_is_void_and_the_next_one_is_due() {
        let now = NodeTime::ZERO + Duration::from_secs(9);
        let proposing = RoundPhase::Proposing(BTreeMap::from([("r1".parse().unwrap(), "amber".parse().unwrap())]));
        let round = AuctionRound {
            number: 4,
            branch: Branch::Main,
            called_at: NodeTime::ZERO,
            hopeless_rounds: 2,
            phase: proposing.clone(),
        };
        let mut same = round.clone();
        same.follow_branch(Branch::Main, now);
        assert_eq!(same, round);
        let mut other = round.clone();
        other.follow_branch(Branch::Recovery, now);
        let phase = RoundPhase::BackingOff { until: now, since: now };
        // The number stays, lest a late answer to the void round be taken for one to the next.
        let called = NodeTime::ZERO;
        assert_eq!(
            other,
            AuctionRound { number: 4, branch: Branch::Recovery, called_at: called, hopeless_rounds: 0, phase }
        );
    }
}
