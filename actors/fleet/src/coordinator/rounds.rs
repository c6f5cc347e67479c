//! Auction rounds of a session, with an index of those under way.

use super::message::CollectedBids;
use consort_protocol::auction::AuctionRecord;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::Branch;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};

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

    /// Checks whether the round has begun and has no result yet.
    fn is_under_way(&self) -> bool {
        match self.phase {
            RoundPhase::Bidding | RoundPhase::BiddingClosed(_) | RoundPhase::Proposing(_) => true,
            RoundPhase::BackingOff { .. } | RoundPhase::HeldBack => false,
        }
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

    /// Returns the state of a mission before its first round, which is held back.
    pub(super) fn held_back(branch: Branch, now: NodeTime) -> AuctionRound {
        let phase = RoundPhase::HeldBack;
        AuctionRound { number: 0, branch, since: now, called_at: now, hopeless_rounds: 0, phase }
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
    /// The first round has not begun: it follows when others have ended.
    HeldBack,
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

/// Auction rounds of a session, by mission. With a backlog most missions wait, so the rounds under way are found by an
/// index.
#[derive(Debug, Default)]
pub(super) struct Rounds {
    all: BTreeMap<MissionId, AuctionRound>,
    under_way: BTreeSet<MissionId>,
}

impl Rounds {
    pub(super) fn get(&self, mission: &MissionId) -> Option<&AuctionRound> {
        self.all.get(mission)
    }

    pub(super) fn contains(&self, mission: &MissionId) -> bool {
        self.all.contains_key(mission)
    }

    /// Returns the rounds that have begun and have no result yet.
    pub(super) fn under_way(&self) -> impl Iterator<Item = (&MissionId, &AuctionRound)> {
        self.under_way.iter().filter_map(|mission| self.all.get_key_value(mission))
    }

    pub(super) fn insert(&mut self, mission: MissionId, round: AuctionRound) {
        self.note(&mission, round.is_under_way());
        self.all.insert(mission, round);
    }

    pub(super) fn remove(&mut self, mission: &MissionId) {
        self.note(mission, false);
        self.all.remove(mission);
    }

    /// Changes the round of a mission. Returns `None` if there is none.
    pub(super) fn change<R>(&mut self, mission: &MissionId, change: impl FnOnce(&mut AuctionRound) -> R) -> Option<R> {
        let round = self.all.get_mut(mission)?;
        let changed = change(round);
        let is_under_way = round.is_under_way();
        self.note(mission, is_under_way);
        Some(changed)
    }

    /// Replaces the phase of a round.
    pub(super) fn set_phase(&mut self, mission: &MissionId, phase: RoundPhase) {
        self.change(mission, |round| round.phase = phase);
    }

    /// Makes the next calls of all rounds without a result due.
    pub(super) fn end_backoffs(&mut self, now: NodeTime) {
        self.all.values_mut().for_each(|round| round.end_backoff(now));
    }

    /// Changes all rounds, and removes those for which `keep` returns false.
    pub(super) fn retain(&mut self, keep: impl FnMut(&MissionId, &mut AuctionRound) -> bool) {
        self.all.retain(keep);
        let under_way = self.all.iter().filter(|(_, round)| round.is_under_way());
        self.under_way = under_way.map(|(mission, _)| mission.clone()).collect();
    }

    fn note(&mut self, mission: &MissionId, is_under_way: bool) {
        if !is_under_way {
            self.under_way.remove(mission);
        } else if !self.under_way.contains(mission) {
            self.under_way.insert(mission.clone());
        }
    }
}

impl FromIterator<(MissionId, AuctionRound)> for Rounds {
    fn from_iter<I: IntoIterator<Item = (MissionId, AuctionRound)>>(rounds: I) -> Rounds {
        let mut all = Rounds::default();
        rounds.into_iter().for_each(|(mission, round)| all.insert(mission, round));
        all
    }
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

    /// Returns the rounds under way, as an examination of all rounds finds them.
    fn examined(rounds: &Rounds) -> Vec<&MissionId> {
        let waits = |phase: &RoundPhase| matches!(phase, RoundPhase::BackingOff { .. } | RoundPhase::HeldBack);
        let under_way = rounds.all.iter().filter(|(_, round)| !waits(&round.phase));
        under_way.map(|(mission, _)| mission).collect()
    }

    #[test]
    fn of_a_backlog_only_the_rounds_under_way_are_visited() {
        let mission = |number: usize| MissionId::new(format!("m-{number}")).unwrap();
        let waiting = || RoundPhase::BackingOff { until: NodeTime::ZERO, since: NodeTime::ZERO };
        let mut rounds: Rounds = (0..1000).map(|number| (mission(number), AuctionRound::first(waiting()))).collect();
        for number in [4, 40, 400] {
            rounds.set_phase(&mission(number), RoundPhase::Bidding);
        }
        assert_eq!(rounds.under_way().count(), 3);
        for step in 0..5000 {
            let changed = mission(step % 997);
            match step % 7 {
                0 => rounds.set_phase(&changed, RoundPhase::Bidding),
                1 => rounds.set_phase(&changed, waiting()),
                2 => rounds.insert(changed, AuctionRound::first(RoundPhase::Bidding)),
                3 => rounds.insert(changed, AuctionRound::first(waiting())),
                4 => rounds.remove(&changed),
                5 => rounds.insert(changed, AuctionRound::held_back(Branch::Main, NodeTime::ZERO)),
                _ => {
                    rounds.change(&changed, |round| round.follow_branch(Branch::Recovery, NodeTime::ZERO));
                }
            }
            if step % 50 == 0 {
                rounds.end_backoffs(NodeTime::ZERO);
                rounds.retain(|other, _| *other != mission(step / 50));
                let under_way: Vec<_> = rounds.under_way().map(|(mission, _)| mission).collect();
                assert_eq!(under_way, examined(&rounds), "step {step}");
            }
        }
    }
}
