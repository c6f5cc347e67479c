//! Auctions of a leader session, and the order in which missions are served.
//!
//! Missions are auctioned in parallel. If several missions need the same robot, the mission with
//! the higher priority gets it, and among equals the mission that is due first (`service_order` of the ledger). Therefore an
//! auction that has its bids and would fill its roles first waits for all better-ranked missions
//! that are collecting bids. Better-ranked missions in backoff are called at once, because the
//! robots found may be the robots they wait for. An auction waits for at most 2 bid windows.
//!
//! Missions of the same priority whose calls are sent at about the same time are allocated together: an auction that has its
//! bids waits for the others. So do missions that have waited for a robot, which are called when one becomes free.
//!
//! A new coordinator finds all waiting missions at once. It calls the best-ranked ones, and the others as the first rounds end.
//!
//! In a large fleet a round calls the robots that may get a role (the module `candidates`), and calls more of them until its result is
//! proven.

use super::auctioneer::{call_for_roles, send_call};
use super::candidates::{RecordedRobots, first_call};
use super::clearing::{AuctionInputs, allocate_missions};
use super::message::{CollectedBids, CoordinatorMessage};
use super::reconcile::{backoff, can_be_auctioned};
use super::record_news::is_news;
use super::rounds::{AuctionRound, ClosedBidding, RoundPhase, Rounds};
use super::session_context::{AWARD_TIMEOUT, SessionContext};
use consort_protocol::auction::{
    AuctionEntry, AuctionId, AuctionOutcome, BidVerdict, RefusalReason, RobotRestriction, RoleReply,
};
use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, MissionEntry, Priority, ServiceRank, service_order};
use consort_protocol::units::NodeTime;
use consort_raft::ProposeError;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::debug;

/// A mission fails after this number of consecutive rounds in which every remaining robot refuses a
/// role permanently, provided that a robot has failed in that role before.
const HOPELESS_ROUNDS: u32 = 3;

/// Maximum time between the calls for missions that are allocated together. Raised: more missions are, and an auction waits for
/// later ones. A guess: requests of a client that follow each other.
const TOGETHER: Duration = Duration::from_millis(50);

/// Maximum number of waiting missions that wake beside one for each robot that has become free. Raised: more messages with a
/// large backlog; a robot is used sooner if the missions that wake cannot use it. A guess.
const WOKEN_MAX: usize = 16;

/// Number of first rounds under way from which further missions that waited when the session began are held back. Raised: more
/// messages at once after a takeover; lowered: more time until all waiting missions have been called. As many as may be allocated
/// together.
const FIRST_ROUNDS_MAX: usize = 32;

/// Maximum number of robots named in the cause of a failed mission.
const NAMED_ROBOTS_MAX: usize = 8;

/// Robots of missions that are allocated together; none for a mission that is cleared by itself.
type Allocation = BTreeMap<MissionId, BTreeMap<RoleId, RobotId>>;

/// Robots that may get roles, by the orders of people.
type Restrictions = BTreeMap<RoleId, RobotRestriction>;

/// Auctions of a session, by mission.
#[derive(Default)]
pub(super) struct Auctions {
    rounds: Rounds,
    /// Missions whose first rounds are held back, in the order in which they are served.
    held_back: BTreeSet<(ServiceRank, MissionId)>,
    /// Restrictions of roles by people when the latest auction without a result was recorded, of missions with any.
    restrictions: BTreeMap<MissionId, Restrictions>,
}

impl Auctions {
    pub(super) fn rounds(&self) -> &Rounds {
        &self.rounds
    }

    /// Forgets the auctions of missions that have ended, and follows changes of the branch.
    pub(super) fn follow(&mut self, ledger: &Ledger, now: NodeTime) {
        self.rounds.retain(|mission, round| {
            let entry = ledger.mission(mission).filter(|entry| !entry.state.is_final());
            entry.inspect(|entry| round.follow_branch(entry.branch, now)).is_some()
        });
        self.restrictions.retain(|mission, _| self.rounds.contains(mission));
    }

    /// Does the same for these missions.
    pub(super) fn follow_changed(&mut self, missions: &BTreeSet<MissionId>, ledger: &Ledger, now: NodeTime) {
        for mission in missions {
            match ledger.mission(mission).filter(|entry| !entry.state.is_final()) {
                Some(entry) => {
                    self.rounds.change(mission, |round| round.follow_branch(entry.branch, now));
                }
                None => self.rounds.remove(mission),
            }
        }
    }

    /// Ends all backoffs, because a robot has become free.
    pub(super) fn wake_all(&mut self, now: NodeTime) {
        self.rounds.end_backoffs(now);
    }

    /// Ends the backoffs of missions that these robots, which have become free, may serve. Of many missions the best-ranked
    /// ones wake: the others would not get the robots.
    pub(super) fn wake(&mut self, freed: &BTreeSet<NodeId>, context: &SessionContext, now: NodeTime) {
        let robots = RecordedRobots::read(freed.iter().cloned().map(RobotId::from), context);
        let missions: Vec<MissionId> = context.read_ledger(|ledger| {
            let waits = |mission: &MissionId| self.rounds.get(mission).is_some_and(AuctionRound::is_backing_off);
            let waiting = ledger.active_missions().into_iter().filter(|entry| waits(&entry.id));
            let served = waiting.filter(|entry| robots.may_serve(entry)).take(freed.len() + WOKEN_MAX);
            served.map(|entry| entry.id.clone()).collect()
        });
        for mission in missions {
            self.rounds.change(&mission, |round| round.end_backoff(now));
        }
    }

    /// Calls for bids for a mission. The first call for a mission that `was_found` in the ledger when the session began is held back
    /// while many first rounds are under way.
    pub(super) fn call_or_hold_back(
        &mut self,
        mission: &MissionId,
        was_found: bool,
        context: &mut SessionContext,
        now: NodeTime,
    ) {
        if !was_found || self.rounds.contains(mission) || self.first_rounds() < FIRST_ROUNDS_MAX {
            return self.call_for_bids(mission, context, now);
        }
        context.read_ledger(|ledger| {
            if let Some(entry) = ledger.mission(mission) {
                self.hold_back(entry, now);
            }
        });
    }

    fn hold_back(&mut self, entry: &MissionEntry, now: NodeTime) {
        self.rounds.insert(entry.id.clone(), AuctionRound::held_back(entry.branch, now));
        self.held_back.insert((entry.rank(), entry.id.clone()));
    }

    /// Returns the number of first rounds under way.
    fn first_rounds(&self) -> usize {
        self.rounds.under_way().filter(|(_, round)| round.number == 1).count()
    }

    /// Takes the best-ranked mission that is held back, if few first rounds are under way.
    fn next_held_back(&mut self) -> Option<MissionId> {
        while self.first_rounds() < FIRST_ROUNDS_MAX {
            let (_, mission) = self.held_back.pop_first()?;
            // The mission may have ended, or have been called before an award to a mission ranked after it.
            if self.rounds.get(&mission).is_some_and(|round| round.phase == RoundPhase::HeldBack) {
                self.rounds.remove(&mission);
                return Some(mission);
            }
        }
        None
    }

    /// Calls for bids for the open roles of a mission.
    pub(super) fn call_for_bids(&mut self, mission: &MissionId, context: &mut SessionContext, now: NodeTime) {
        let Some(branch) = context.read_ledger(|ledger| Some(ledger.mission(mission)?.branch)) else { return };
        let previous = self.rounds.change(mission, |round| {
            round.follow_branch(branch, now);
            (round.number + 1, round.since, round.hopeless_rounds)
        });
        let (number, since, hopeless_rounds) = previous.unwrap_or((1, now, 0));
        let open = context.read_ledger(|ledger| ledger.mission(mission).map(MissionEntry::roles_to_auction));
        let auction = AuctionId { mission: mission.clone(), term: context.term, round: number };
        let roles = open.unwrap_or_default();
        let Some((call, invitation)) = call_for_roles(&roles, auction, context, now) else { return };
        let bids = first_call(CollectedBids::of_all(call, invitation, None), &self.rounds, context);
        context.publish_event(EventKind::BidsRequested {
            mission: mission.clone(),
            roles: bids.call.roles.keys().cloned().collect(),
            round: number,
            asked: bids.invitation.robots.len(),
        });
        let phase = RoundPhase::Bidding;
        let round = AuctionRound { number, branch, since, called_at: now, hopeless_rounds, phase };
        self.rounds.insert(mission.clone(), round);
        send_call(bids, context);
    }

    /// Asks further robots in the same round.
    fn ask_more(&mut self, mission: &MissionId, robots: BTreeSet<RobotId>, context: &mut SessionContext) {
        let closed =
            self.rounds.change(mission, |round| match std::mem::replace(&mut round.phase, RoundPhase::Bidding) {
                RoundPhase::BiddingClosed(closed) => Some(closed.bids),
                other => {
                    round.phase = other;
                    None
                }
            });
        if let Some(mut bids) = closed.flatten() {
            bids.invite(robots);
            send_call(bids, context);
        }
    }

    /// Closes an auction: all bids have arrived, or the bid window has closed.
    pub(super) fn close_bidding(&mut self, bids: CollectedBids, context: &mut SessionContext) {
        let AuctionId { mission, round: number, .. } = bids.call.auction.clone();
        let is_current = |round: &AuctionRound| round.number == number && round.phase == RoundPhase::Bidding;
        if !self.rounds.get(&mission).is_some_and(is_current) {
            return; // the mission has ended, or another round has started
        }
        for bid in bids.latest_responses().flat_map(|response| &response.replies) {
            if let RoleReply::Bid(bid) = bid {
                context.publish_event(EventKind::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let deadline = context.now() + context.settings.auctions.bid_window * 2;
        let closed = ClosedBidding { bids, deadline, is_fillable: false };
        self.rounds.set_phase(&mission, RoundPhase::BiddingClosed(Box::new(closed)));
        self.clear(context);
    }

    /// Clears the closed auctions that need not wait for a better-ranked mission, and calls missions that were held back.
    pub(super) fn clear(&mut self, context: &mut SessionContext) {
        self.clear_closed(context);
        let now = context.now();
        while let Some(mission) = self.next_held_back() {
            self.call_for_bids(&mission, context, now);
        }
    }

    fn clear_closed(&mut self, context: &mut SessionContext) {
        if !self.rounds.under_way().any(|(_, round)| matches!(round.phase, RoundPhase::BiddingClosed(_))) {
            return;
        }
        let now = context.now();
        let open = context.read_ledger(|ledger| {
            let lease_monitor = context.lease_monitor.lock();
            let called = self.rounds.under_way().filter_map(|(mission, _)| ledger.mission(mission));
            let called = called.filter(|entry| !entry.state.is_final());
            let open = service_order(called.filter(|entry| can_be_auctioned(entry, &lease_monitor, now)));
            open.into_iter().map(|entry| (entry.id.clone(), entry.submission.priority)).collect::<Vec<_>>()
        });
        let mut calling = false;
        let mut allocated = Allocation::new();
        for (index, (mission, priority)) in open.iter().enumerate() {
            let Some(round) = self.rounds.get(mission) else { continue };
            let called = round.called_at;
            match &round.phase {
                RoundPhase::Bidding => calling = true,
                RoundPhase::Proposing(_) | RoundPhase::BackingOff { .. } | RoundPhase::HeldBack => {}
                RoundPhase::BiddingClosed(closed) => {
                    let has_bidding = calling || self.is_followed(&open[index..], *priority, called);
                    let may_wait = now < closed.deadline;
                    let waits = may_wait && has_bidding;
                    let is_restricted = closed.bids.called.is_some();
                    // An auction among candidates calls further robots once it is known which robots it may get.
                    if waits && (closed.is_fillable || is_restricted) {
                        calling = true; // lower-ranked missions wait, too
                        continue;
                    }
                    if !waits && !allocated.contains_key(mission) {
                        let allocation = self.allocate_with(&open[index..], called, context);
                        let unasked = self.unasked_robots(&allocation, context);
                        if !unasked.is_empty() {
                            for (mission, robots) in unasked {
                                self.ask_more(&mission, robots, context);
                            }
                            calling = true;
                            continue;
                        }
                        allocated.extend(allocation);
                    }
                    let is_joint = others_in(&allocated, mission).next().is_some();
                    let cleared = {
                        let mut inputs = AuctionInputs::read(&closed.bids, &self.rounds, context);
                        self.reserve_for_others(&allocated, mission, &mut inputs);
                        inputs.clear(&closed.bids, context)
                    };
                    let outcome = match cleared {
                        Ok(outcome) => outcome,
                        Err(to_ask) => {
                            self.ask_more(mission, to_ask, context);
                            calling = true;
                            continue;
                        }
                    };
                    if (outcome.holders.is_some() || is_joint) && may_wait {
                        let taken = allocated.values().chain(&outcome.holders).flat_map(BTreeMap::values);
                        let takers = is_restricted.then(|| RecordedRobots::read(taken.cloned(), context));
                        for better_ranked in self.waiting_before(mission, called, takers.as_ref(), context) {
                            self.call_for_bids(&better_ranked, context, now);
                            calling = true;
                        }
                        calling |= has_bidding;
                        if calling {
                            self.note_fillable(mission, outcome.holders.is_some());
                            continue;
                        }
                    }
                    self.record(mission, outcome, context);
                }
            }
        }
    }

    /// Returns the missions ranked before a mission whose rounds had no result before its call, or have not begun, and that may need
    /// one of these robots, or any.
    fn waiting_before(
        &self,
        mission: &MissionId,
        called: NodeTime,
        takers: Option<&RecordedRobots>,
        context: &SessionContext,
    ) -> Vec<MissionId> {
        let waits = |entry: &&MissionEntry| match self.rounds.get(&entry.id).map(|round| &round.phase) {
            Some(RoundPhase::BackingOff { since, .. }) => *since < called,
            Some(RoundPhase::HeldBack) => true,
            Some(RoundPhase::Bidding | RoundPhase::BiddingClosed(_) | RoundPhase::Proposing(_)) | None => false,
        };
        context.read_ledger(|ledger| {
            let Some(entry) = ledger.mission(mission) else { return vec![] };
            let (lease_monitor, now) = (context.lease_monitor.lock(), context.now());
            let waiting = ledger.missions_before(entry).into_iter().filter(waits);
            let open = waiting.filter(|entry| can_be_auctioned(entry, &lease_monitor, now));
            let served = open.filter(|entry| takers.is_none_or(|robots| robots.may_serve(entry)));
            served.map(|entry| entry.id.clone()).collect()
        })
    }

    /// Notes whether the roles of an auction that begins to wait could be filled. Then it is not cleared again while it waits:
    /// a clearing takes long in a large fleet.
    fn note_fillable(&mut self, mission: &MissionId, is_fillable: bool) {
        self.rounds.change(mission, |round| {
            if let RoundPhase::BiddingClosed(closed) = &mut round.phase {
                closed.is_fillable = is_fillable;
            }
        });
    }

    /// Allocates the first of these missions together with those that were called at about the same time.
    fn allocate_with(&self, open: &[(MissionId, Priority)], called: NodeTime, context: &SessionContext) -> Allocation {
        let Some((_, priority)) = open.first() else { return Allocation::new() };
        let closed = open.iter().filter(|(_, other)| other == priority).filter_map(|(mission, _)| {
            let round = self.rounds.get(mission)?;
            match &round.phase {
                RoundPhase::BiddingClosed(closed) if are_together(called, round.called_at) => {
                    Some((mission, &closed.bids))
                }
                _ => None,
            }
        });
        let closed: Vec<(&MissionId, &CollectedBids)> = closed.collect();
        let allocation = allocate_missions(&closed, &self.rounds, context);
        let mut allocated: Allocation =
            closed.into_iter().map(|(mission, _)| (mission.clone(), BTreeMap::new())).collect();
        allocated.extend(allocation.into_iter().map(|(mission, robots)| (mission.clone(), robots)));
        allocated
    }

    /// Returns the robots of an allocation that were not asked, by mission, with those that are asked beside them.
    fn unasked_robots(
        &self,
        allocation: &Allocation,
        context: &SessionContext,
    ) -> BTreeMap<MissionId, BTreeSet<RobotId>> {
        let mut unasked = BTreeMap::new();
        for (mission, robots) in allocation {
            let Some(AuctionRound { phase: RoundPhase::BiddingClosed(closed), .. }) = self.rounds.get(mission) else {
                continue;
            };
            let bids = &closed.bids;
            let chosen = robots.values().filter(|robot| bids.candidates.contains(robot)).cloned();
            let chosen: BTreeSet<RobotId> = chosen.collect();
            if !chosen.is_empty() {
                let inputs = AuctionInputs::read(bids, &self.rounds, context);
                unasked.insert(mission.clone(), inputs.to_ask_with(chosen, bids, context));
            }
        }
        unasked
    }

    /// Checks whether a mission of this priority, called at about the same time, still collects bids.
    fn is_followed(&self, open: &[(MissionId, Priority)], priority: Priority, called: NodeTime) -> bool {
        let mut rounds = open.iter().filter(|(_, other)| *other == priority).filter_map(|(id, _)| self.rounds.get(id));
        rounds.any(|round| round.phase == RoundPhase::Bidding && are_together(called, round.called_at))
    }

    /// Reserves the robots that other missions get, unless they are proposed already.
    fn reserve_for_others(&self, allocated: &Allocation, mission: &MissionId, inputs: &mut AuctionInputs<'_>) {
        for (other, role, robot) in others_in(allocated, mission) {
            let Some(RoundPhase::BiddingClosed(closed)) = self.rounds.get(other).map(|round| &round.phase) else {
                continue;
            };
            if let Some(bid) = closed.bids.bid_of(role, robot) {
                let (mission, role) = (other.clone(), role.clone());
                inputs.reserve(robot, RefusalReason::Busy { mission, role }, bid.estimate());
            }
        }
    }

    /// Proposes the award, or defers the mission and backs off.
    fn record(&mut self, mission: &MissionId, outcome: AuctionOutcome, context: &mut SessionContext) {
        let AuctionOutcome { holders, record, unfillable, energy_exceeded } = outcome;
        context.publish_event(EventKind::Closed { mission: mission.clone(), record: record.clone() });
        let count_rounds = |round: &mut AuctionRound| {
            round.hopeless_rounds = if unfillable.is_empty() { 0 } else { round.hopeless_rounds + 1 };
            (round.branch, round.hopeless_rounds)
        };
        let Some((branch, hopeless_rounds)) = self.rounds.change(mission, count_rounds) else { return };
        let (auction, mission) = (record.auction.clone(), mission.clone());
        let mut failure = None;
        let command = match holders {
            Some(holders) => {
                let record = record.for_ledger(false);
                self.rounds.set_phase(&mission, RoundPhase::Proposing(Box::new(record.clone())));
                Command::Award { mission, branch, holders, auction: record }
            }
            None => {
                let since = context.now();
                let phase = RoundPhase::BackingOff { until: since + backoff(auction.round), since };
                self.rounds.set_phase(&mission, phase);
                let (stored, restrictions, has_changed) = context.read_ledger(|ledger| {
                    let entry = ledger.mission(&mission);
                    let holds_robots = entry.is_some_and(|entry| entry.assigned_roles().next().is_some());
                    let restrictions = entry.map(MissionEntry::restrictions).unwrap_or_default();
                    let has_orders = restrictions != self.restrictions.get(&mission).cloned().unwrap_or_default();
                    let stored = record.clone().for_ledger(holds_robots);
                    let known = entry.and_then(|entry| entry.auction.as_ref());
                    let has_changed = known.is_none_or(|known| is_news(known, &stored, holds_robots, has_orders));
                    (stored, restrictions, has_changed)
                });
                if has_changed {
                    match restrictions.is_empty() {
                        true => self.restrictions.remove(&mission),
                        false => self.restrictions.insert(mission.clone(), restrictions),
                    };
                }
                let hopeless = hopeless_rounds >= HOPELESS_ROUNDS;
                let class_of_failures = |ledger: &Ledger| {
                    ledger.mission(&mission).map_or(CauseClass::Robot, |entry| entry.class_of_failures(&unfillable))
                };
                let no_robot = || (no_robot_left(&unfillable, &record.entries), context.read_ledger(class_of_failures));
                let cause = energy_exceeded.map(|excess| (excess.to_string(), CauseClass::Task));
                let cause = cause.or_else(|| hopeless.then(no_robot));
                failure = cause.map(|(cause, class)| {
                    let places = context.places_of(&mission);
                    Command::Fail { mission: mission.clone(), cause, branch: Some(branch), places, class }
                });
                if !has_changed && failure.is_none() {
                    return;
                }
                Command::Defer { mission, branch, auction: stored }
            }
        };
        let replica = context.settings.parts.replica.clone();
        context.send_result(async move {
            // If the coordinator stops, the next coordinator finds the award in the ledger or
            // repeats the auction.
            let outcome = replica.propose(command, AWARD_TIMEOUT).await;
            // The record explains the failure, so it comes first. A later round repeats a failure that was
            // not committed.
            if let Some(failure) = failure
                && let Err(problem) = replica.propose(failure, AWARD_TIMEOUT).await
            {
                debug!(%problem, "the failure of a mission was not committed");
            }
            CoordinatorMessage::AuctionRecorded { auction, outcome }
        });
    }

    /// Handles the outcome of a proposed award. `time_known` is the time since this coordinator
    /// first found the mission.
    pub(super) fn handle_recorded(
        &mut self,
        auction: &AuctionId,
        outcome: Result<CommandOutcome, ProposeError>,
        time_known: Option<Duration>,
        context: &SessionContext,
    ) {
        let since = context.now();
        let mission = &auction.mission;
        let Some(round) = self.rounds.get(mission).filter(|round| round.number == auction.round) else { return };
        let RoundPhase::Proposing(record) = &round.phase else { return };
        match outcome {
            Ok(CommandOutcome::Awarded { epoch }) => {
                let after_ms = time_known.map(|known| known.as_secs_f64() * 1000.0);
                let is_promised = |(role, _): &(RoleId, RobotId)| record.promised.contains_key(role);
                let (promised, holders) = record.chosen.clone().into_iter().partition(is_promised);
                let mission = mission.clone();
                context.publish_event(EventKind::Awarded { mission, holders, promised, epoch, after_ms });
                // If a role of the mission is released, its rounds start again from 1.
                self.rounds.remove(&auction.mission);
            }
            Ok(outcome) => {
                debug!(%mission, ?outcome, "the award no longer fits the ledger");
                self.rounds.set_phase(mission, RoundPhase::BackingOff { until: since + backoff(1), since });
            }
            Err(problem) => {
                // The commit is uncertain; the next reconciliation shows it.
                debug!(%mission, %problem, "the award was not committed");
                self.rounds.set_phase(mission, RoundPhase::BackingOff { until: since + backoff(auction.round), since });
            }
        }
    }
}

/// Returns the roles that other missions get in an allocation, with their robots.
fn others_in<'a>(
    allocation: &'a Allocation,
    mission: &'a MissionId,
) -> impl Iterator<Item = (&'a MissionId, &'a RoleId, &'a RobotId)> {
    let others = allocation.iter().filter(move |(other, _)| *other != mission);
    others.flat_map(|(other, robots)| robots.iter().map(move |(role, robot)| (other, role, robot)))
}

/// Checks whether calls that were sent at these times are allocated together.
fn are_together(one: NodeTime, other: NodeTime) -> bool {
    one.since(other).max(other.since(one)) <= TOGETHER
}

/// Returns a text like `no robot is left for r1: amber failed at it before: …; birch lacks …`.
fn no_robot_left(hopeless: &BTreeSet<RoleId>, entries: &[AuctionEntry]) -> String {
    let of_role = |role: &RoleId| {
        let refusals = entries.iter().filter(|entry| entry.role == *role).filter_map(|entry| match &entry.verdict {
            BidVerdict::Refused { reason } => Some(format!("{} {reason}", entry.robot)),
            BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } | BidVerdict::NotAsked { .. } => None,
        });
        let mut refusals: Vec<String> = refusals.collect();
        // Robots that have failed come first, because they are the cause. The others only cannot
        // help.
        refusals.sort_by_key(|refusal| !refusal.contains(" failed at it before: "));
        let more = refusals.len().saturating_sub(NAMED_ROBOTS_MAX);
        refusals.truncate(NAMED_ROBOTS_MAX);
        let more = if more > 0 { format!("; and {more} more") } else { String::new() };
        format!("no robot is left for {role}: {}{more}", refusals.join("; "))
    };
    hopeless.iter().map(of_role).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::Log;
    use super::*;
    use consort_protocol::ledger::Submission;

    /// Begins the first rounds of the missions whose turn it is, and returns them.
    fn begun(auctions: &mut Auctions) -> Vec<MissionId> {
        let mut begun = vec![];
        while let Some(mission) = auctions.next_held_back() {
            auctions.rounds.insert(mission.clone(), AuctionRound::first(RoundPhase::Bidding));
            begun.push(mission);
        }
        begun
    }

    #[test]
    fn missions_that_are_held_back_are_called_by_rank_as_others_end() {
        let (mut log, mut auctions) = (Log::default(), Auctions::default());
        let known = log.add_mission("ada");
        let submission = log.0.mission(&known).unwrap().submission.clone();
        for number in 0..40 {
            let request = format!("r-{number}").parse().unwrap();
            log.apply(Command::Submit(Box::new(Submission { request, ..submission.clone() })));
        }
        let missions = log.0.active_missions().into_iter().skip(1);
        let missions: Vec<MissionId> = missions.map(|entry| entry.id.clone()).collect();
        for mission in missions.iter().rev() {
            auctions.hold_back(log.0.mission(mission).unwrap(), NodeTime::ZERO);
        }
        assert_eq!(begun(&mut auctions), missions[..FIRST_ROUNDS_MAX]);
        assert!(begun(&mut auctions).is_empty());
        auctions.rounds.remove(&missions[4]);
        let phase = RoundPhase::BackingOff { until: NodeTime::ZERO, since: NodeTime::ZERO };
        auctions.rounds.set_phase(&missions[2], phase);
        assert_eq!(begun(&mut auctions), missions[32..34]);
        // A later round of a mission delays no first round, and the next mission in turn has ended.
        let later = AuctionRound { number: 2, ..AuctionRound::first(RoundPhase::Bidding) };
        auctions.rounds.insert(missions[2].clone(), later);
        auctions.rounds.remove(&missions[34]);
        auctions.rounds.remove(&missions[0]);
        assert_eq!(begun(&mut auctions), missions[35..36]);
    }
}
