//! Auctions of a leader session, and the order in which missions are served.
//!
//! Missions are auctioned in parallel. If several missions need the same robot, the mission with
//! the higher priority gets it, and among equals the mission with the lower number. Therefore an
//! auction that has its bids and would fill its roles first waits for all better-ranked missions
//! that are collecting bids. Better-ranked missions in backoff are called at once, because the
//! robots found may be the robots they wait for. An auction waits for at most 2 bid windows.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::auctioneer;
use super::last_known_place::last_known_places;
use super::leader_session::{LeaderSession, live_members, lock_monitor, propose};
use super::reconcile::{AuctionRound, ClosedBidding, RoundPhase, backoff, can_be_auctioned, unavailable_robots};
use consort_protocol::auction::{
    AuctionContext, AuctionEntry, AuctionId, AuctionOutcome, AuctionRecord, BidResponse, BidVerdict, CallForBids,
    RoleReply, clear_auction_with,
};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Command, CommandOutcome};
use consort_protocol::units::NodeTime;
use consort_raft::ProposeError;
use ractor::ActorRef;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::debug;

/// Timeout for the ledger to commit an award.
const AWARD_TIMEOUT: Duration = Duration::from_secs(2);

/// A mission fails after this number of consecutive rounds in which every remaining robot refuses a
/// role permanently, provided that a robot has failed in that role before.
const HOPELESS_ROUNDS: u32 = 3;

/// Maximum number of robots named in the cause of a failed mission.
const NAMED_ROBOTS_MAX: usize = 8;

impl LeaderSession {
    pub(super) fn call_for_bids(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        now: NodeTime,
    ) {
        let called = settings.replica.read(|ledger| {
            let entry = ledger.mission(mission)?;
            let plans = entry.open_roles().into_iter().map(|role| Some((role.clone(), entry.plan(&role)?.clone())));
            Some((entry.branch, plans.collect::<Option<BTreeMap<_, _>>>()?))
        });
        let Some((branch, roles)) = called.filter(|(_, roles)| !roles.is_empty()) else { return };
        let previous = self.rounds.get_mut(mission).map(|round| {
            round.follow_branch(branch, now);
            (round.number + 1, round.hopeless_rounds)
        });
        let (number, hopeless) = previous.unwrap_or((1, 0));
        let auction = AuctionId { mission: mission.clone(), term: self.term, round: number };
        let call = CallForBids { auction, ensemble: settings.ensemble.spec().name.clone(), roles };
        let expected: BTreeSet<RobotId> = live_members(settings, now).into_iter().map(RobotId::from).collect();
        settings.events.publish(EventKind::BidsRequested {
            mission: mission.clone(),
            roles: call.roles.keys().cloned().collect(),
            round: number,
            asked: expected.len(),
        });
        self.rounds.insert(
            mission.clone(),
            AuctionRound { number, branch, called_at: now, hopeless_rounds: hopeless, phase: RoundPhase::Bidding },
        );
        let (bus, keys, window, to) =
            (settings.bus.clone(), settings.keys.clone(), settings.bid_window, myself.clone());
        self.tasks.spawn(async move {
            let responses = auctioneer::collect_bids(bus, keys, call.clone(), expected.clone(), window).await;
            // A stopped coordinator needs no bids.
            let _ = to.cast(CoordinatorMessage::BidsCollected { call: Box::new(call), expected, responses });
        });
    }

    /// Closes an auction: all bids have arrived, or the bid window has closed.
    pub(super) fn close_bidding(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        call: CallForBids,
        expected: BTreeSet<RobotId>,
        responses: Vec<BidResponse>,
    ) {
        let mission = call.auction.mission.clone();
        let current =
            |round: &&mut AuctionRound| round.number == call.auction.round && round.phase == RoundPhase::Bidding;
        let Some(round) = self.rounds.get_mut(&mission).filter(current) else {
            return; // the mission has ended, or another round has started
        };
        for bid in responses.iter().flat_map(|response| &response.replies) {
            if let RoleReply::Bid(bid) = bid {
                settings.events.publish(EventKind::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let until = settings.clock.now() + settings.bid_window * 2;
        round.phase = RoundPhase::BiddingClosed(Box::new(ClosedBidding { call, expected, responses, deadline: until }));
        self.clear_auctions(settings, myself);
    }

    /// Clears the closed auctions that need not wait for a better-ranked mission.
    pub(super) fn clear_auctions(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        if !self.rounds.values().any(|round| matches!(round.phase, RoundPhase::BiddingClosed(_))) {
            return;
        }
        let now = settings.clock.now();
        let open = settings.replica.read(|ledger| {
            let lease_monitor = lock_monitor(&self.lease_monitor);
            let open =
                ledger.active_missions().into_iter().filter(|entry| can_be_auctioned(entry, &lease_monitor, now));
            open.map(|entry| entry.id.clone()).collect::<Vec<_>>()
        });
        let mut calling = false;
        let mut waiting: Vec<(MissionId, NodeTime)> = vec![];
        for mission in open {
            let Some(round) = self.rounds.get(&mission) else { continue };
            let called = round.called_at;
            match &round.phase {
                RoundPhase::Bidding => calling = true,
                RoundPhase::BackingOff { since, .. } => waiting.push((mission, *since)),
                RoundPhase::Proposing(_) => {}
                RoundPhase::BiddingClosed(closed) => {
                    let outcome = self.clear(settings, closed);
                    if outcome.holders.is_some() && now < closed.deadline {
                        for (better_ranked, _) in waiting.iter().filter(|(_, since)| *since < called) {
                            self.call_for_bids(settings, myself, better_ranked, now);
                            calling = true;
                        }
                        if calling {
                            continue; // lower-ranked missions wait, too
                        }
                    }
                    self.record_outcome(settings, myself, &mission, outcome);
                }
            }
        }
    }

    fn clear(&self, settings: &CoordinatorSettings, closed: &ClosedBidding) -> AuctionOutcome {
        let ClosedBidding { call, expected, responses, .. } = closed;
        let (unavailable, excluded) = settings.replica.read(|ledger| {
            let entry = ledger.mission(&call.auction.mission);
            let excluded = |role: &RoleId| entry.map(|entry| entry.excluded(role)).unwrap_or_default();
            let excluded = call.roles.keys().map(|role| (role.clone(), excluded(role))).collect();
            (unavailable_robots(ledger, &self.rounds, &call.auction.mission), excluded)
        });
        let context = AuctionContext {
            invited: expected,
            unavailable: &unavailable,
            excluded: &excluded,
            limits: &settings.limits,
            window_ms: u64::try_from(settings.bid_window.as_millis()).unwrap_or(u64::MAX),
            at_ms: settings.clock.wall_ms(),
        };
        clear_auction_with(call, responses, &context, &*settings.allocator)
    }

    fn record_outcome(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        outcome: AuctionOutcome,
    ) {
        let AuctionOutcome { holders, record, unfillable } = outcome;
        let auction = record.auction.clone();
        settings.events.publish(EventKind::Closed { mission: mission.clone(), record: record.clone() });
        let Some(round) = self.rounds.get_mut(mission) else { return };
        round.hopeless_rounds = if unfillable.is_empty() { 0 } else { round.hopeless_rounds + 1 };
        let (branch, has_failed) = (round.branch, round.hopeless_rounds >= HOPELESS_ROUNDS);
        let command = match holders {
            Some(holders) => {
                round.phase = RoundPhase::Proposing(holders.clone());
                Some(Command::Award { mission: mission.clone(), branch, holders, auction: record })
            }
            None => {
                let since = settings.clock.now();
                round.phase = RoundPhase::BackingOff { until: since + backoff(auction.round), since };
                let has_changed = settings.replica.read(|ledger| {
                    let known = ledger.mission(mission).and_then(|entry| entry.auction.as_ref());
                    known.is_none_or(|known| differs(known, &record))
                });
                if has_failed {
                    let places =
                        settings.replica.read(|ledger| last_known_places(&settings.knowledge, ledger.mission(mission)));
                    let cause = no_robot_left(&unfillable, &record.entries);
                    let mission = mission.clone();
                    let fail = Command::Fail { mission, cause, branch: Some(branch), places };
                    propose(settings, &mut self.tasks, fail);
                }
                has_changed.then(|| Command::Defer { mission: mission.clone(), branch, auction: record })
            }
        };
        let Some(command) = command else { return };
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let outcome = replica.propose(command, AWARD_TIMEOUT).await;
            // If the coordinator has stopped, the next coordinator finds the award in the ledger or
            // repeats the auction.
            let _ = to.cast(CoordinatorMessage::AuctionRecorded { auction, outcome });
        });
    }

    pub(super) fn handle_auction_recorded(
        &mut self,
        settings: &CoordinatorSettings,
        auction: &AuctionId,
        outcome: Result<CommandOutcome, ProposeError>,
    ) {
        let since = settings.clock.now();
        let mission = &auction.mission;
        let time_known = self.time_known(mission, since);
        let Some(round) = self.rounds.get_mut(mission).filter(|round| round.number == auction.round) else { return };
        let RoundPhase::Proposing(holders) = &round.phase else { return };
        match outcome {
            Ok(CommandOutcome::Awarded { epoch }) => {
                let after_ms = time_known.map(|known| known.as_secs_f64() * 1000.0);
                let (mission, holders) = (mission.clone(), holders.clone());
                settings.events.publish(EventKind::Awarded { mission, holders, epoch, after_ms });
                // If a role of the mission is released, its rounds start again from 1.
                self.rounds.remove(&auction.mission);
            }
            Ok(outcome) => {
                debug!(%mission, ?outcome, "the award no longer fits the ledger");
                round.phase = RoundPhase::BackingOff { until: since + backoff(1), since };
            }
            Err(problem) => {
                // The commit is uncertain; the next reconciliation shows it.
                debug!(%mission, %problem, "the award was not committed");
                round.phase = RoundPhase::BackingOff { until: since + backoff(round.number), since };
            }
        }
    }
}

/// Checks whether a record differs from the previous record in more than times and counters.
fn differs(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    let essence = |record: &AuctionRecord| {
        let verdicts = record
            .entries
            .iter()
            .map(|entry| (entry.role.clone(), entry.robot.clone(), std::mem::discriminant(&entry.verdict)));
        (record.failure.clone(), verdicts.collect::<Vec<_>>())
    };
    essence(known) != essence(record)
}

/// Returns a text like `no robot is left for r1: amber failed at it before: …; birch lacks …`.
fn no_robot_left(hopeless: &BTreeSet<RoleId>, entries: &[AuctionEntry]) -> String {
    let of_role = |role: &RoleId| {
        let refusals = entries.iter().filter(|entry| entry.role == *role).filter_map(|entry| match &entry.verdict {
            BidVerdict::Refused { reason } => Some(format!("{} {reason}", entry.robot)),
            BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => None,
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
