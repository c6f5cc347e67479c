//! The auctions of a reign, and who is served first.
//!
//! Missions are auctioned side by side. When a robot could serve two of them, the one that is served first gets it, by
//! priority and then by number: an auction whose bids are in, and which would fill its roles, first lets all better-ranked
//! missions conclude that are being called. Those that wait out a back-off are called at once, since what it has found may
//! be what they wait for. It waits for two windows at most.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::auctioneer;
use super::last_known_place::last_known_places;
use super::leader_session::{LeaderSession, live_members, lock_monitor, propose};
use super::reconcile::{AuctionRound, ClosedBidding, RoundPhase, backoff, can_be_auctioned, unavailable_robots};
use crate::raft::ProposeError;
use consort_protocol::auction::{
    AuctionContext, AuctionEntry, AuctionId, AuctionOutcome, AuctionRecord, BidResponse, BidVerdict, CallForBids,
    RoleReply, clear_auction_with,
};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::{Command, CommandOutcome};
use consort_protocol::units::NodeTime;
use ractor::ActorRef;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::debug;

/// How long the ledger may take to accept an award.
const AWARD_LIMIT: Duration = Duration::from_secs(2);

/// After so many rounds in a row in which all who are left refuse a role for good, and at which somebody has failed before,
/// its mission is given up.
const HOPELESS_ROUNDS: u32 = 3;

/// Most robots that the cause of a failed mission names.
const NAMED: usize = 8;

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
        let former = self.rounds.get_mut(mission).map(|round| {
            round.follow_branch(branch, now);
            (round.number + 1, round.hopeless_rounds)
        });
        let (number, hopeless) = former.unwrap_or((1, 0));
        let auction = AuctionId { mission: mission.clone(), term: self.term, round: number };
        let call = CallForBids { auction, ensemble: settings.ensemble.spec().name.clone(), roles };
        let expected: BTreeSet<RobotId> = live_members(settings, now).into_iter().map(RobotId::from).collect();
        settings.events.publish(EventKind::Called {
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
            let tenders = auctioneer::collect_bids(bus, keys, call.clone(), expected.clone(), window).await;
            // A coordinator that has stopped needs no bids.
            let _ = to.cast(CoordinatorMessage::BidsCollected { call: Box::new(call), expected, responses: tenders });
        });
    }

    /// All bids are in, or the window has closed.
    pub(super) fn close_bidding(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        call: CallForBids,
        expected: BTreeSet<RobotId>,
        tenders: Vec<BidResponse>,
    ) {
        let mission = call.auction.mission.clone();
        let current =
            |round: &&mut AuctionRound| round.number == call.auction.round && round.phase == RoundPhase::Bidding;
        let Some(round) = self.rounds.get_mut(&mission).filter(current) else {
            return; // the mission has ended, or another round has begun
        };
        for bid in tenders.iter().flat_map(|tender| &tender.replies) {
            if let RoleReply::Bid(bid) = bid {
                settings.events.publish(EventKind::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let until = settings.clock.now() + settings.bid_window * 2;
        round.phase =
            RoundPhase::BiddingClosed(Box::new(ClosedBidding { call, expected, responses: tenders, deadline: until }));
        self.clear_auctions(settings, myself);
    }

    /// Concludes the closed auctions that need not wait for a better-ranked mission.
    pub(super) fn clear_auctions(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        if !self.rounds.values().any(|round| matches!(round.phase, RoundPhase::BiddingClosed(_))) {
            return;
        }
        let now = settings.clock.now();
        let open = settings.replica.read(|ledger| {
            let watch = lock_monitor(&self.lease_monitor);
            let open = ledger.active_missions().into_iter().filter(|entry| can_be_auctioned(entry, &watch, now));
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
                    let conclusion = self.conclude(settings, closed);
                    if conclusion.holders.is_some() && now < closed.deadline {
                        for (better, _) in waiting.iter().filter(|(_, since)| *since < called) {
                            self.call_for_bids(settings, myself, better, now);
                            calling = true;
                        }
                        if calling {
                            continue; // and whoever comes after this one waits, too
                        }
                    }
                    self.decide(settings, myself, &mission, conclusion);
                }
            }
        }
    }

    fn conclude(&self, settings: &CoordinatorSettings, closed: &ClosedBidding) -> AuctionOutcome {
        let ClosedBidding { call, expected, responses: tenders, .. } = closed;
        let (taken, excluded) = settings.replica.read(|ledger| {
            let entry = ledger.mission(&call.auction.mission);
            let excluded = |role: &RoleId| entry.map(|entry| entry.excluded(role)).unwrap_or_default();
            let excluded = call.roles.keys().map(|role| (role.clone(), excluded(role))).collect();
            (unavailable_robots(ledger, &self.rounds, &call.auction.mission), excluded)
        });
        let circumstances = AuctionContext {
            invited: expected,
            unavailable: &taken,
            excluded: &excluded,
            limits: &settings.limits,
            window_ms: u64::try_from(settings.bid_window.as_millis()).unwrap_or(u64::MAX),
            at_ms: settings.clock.wall_ms(),
        };
        clear_auction_with(call, tenders, &circumstances, &*settings.allocator)
    }

    fn decide(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        conclusion: AuctionOutcome,
    ) {
        let AuctionOutcome { holders, record, unfillable } = conclusion;
        let auction = record.auction.clone();
        settings.events.publish(EventKind::Closed { mission: mission.clone(), record: record.clone() });
        let Some(round) = self.rounds.get_mut(mission) else { return };
        round.hopeless_rounds = if unfillable.is_empty() { 0 } else { round.hopeless_rounds + 1 };
        let (branch, given_up) = (round.branch, round.hopeless_rounds >= HOPELESS_ROUNDS);
        let command = match holders {
            Some(holders) => {
                round.phase = RoundPhase::Proposing(holders.clone());
                Some(Command::Award { mission: mission.clone(), branch, holders, auction: record })
            }
            None => {
                let since = settings.clock.now();
                round.phase = RoundPhase::BackingOff { until: since + backoff(auction.round), since };
                let news = settings.replica.read(|ledger| {
                    let known = ledger.mission(mission).and_then(|entry| entry.auction.as_ref());
                    known.is_none_or(|known| tells_otherwise(known, &record))
                });
                if given_up {
                    let places =
                        settings.replica.read(|ledger| last_known_places(&settings.knowledge, ledger.mission(mission)));
                    let cause = nobody_is_left(&unfillable, &record.entries);
                    let mission = mission.clone();
                    let fail = Command::Fail { mission, cause, branch: Some(branch), places };
                    propose(settings, &mut self.tasks, fail);
                }
                news.then(|| Command::Defer { mission: mission.clone(), branch, auction: record })
            }
        };
        let Some(command) = command else { return };
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let outcome = replica.propose(command, AWARD_LIMIT).await;
            // A coordinator that has stopped leaves the award to the next one: it is in the ledger or it is not.
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
        let known_for = self.time_known(mission, since);
        let Some(round) = self.rounds.get_mut(mission).filter(|round| round.number == auction.round) else { return };
        let RoundPhase::Proposing(holders) = &round.phase else { return };
        match outcome {
            Ok(CommandOutcome::Awarded { epoch }) => {
                let after_ms = known_for.map(|known| known.as_secs_f64() * 1000.0);
                let (mission, holders) = (mission.clone(), holders.clone());
                settings.events.publish(EventKind::Awarded { mission, holders, epoch, after_ms });
                // Should a role of it be released, the rounds begin anew.
                self.rounds.remove(&auction.mission);
            }
            Ok(outcome) => {
                debug!(%mission, ?outcome, "the award no longer fits the ledger");
                round.phase = RoundPhase::BackingOff { until: since + backoff(1), since };
            }
            Err(problem) => {
                // Whether it will be committed is unknown; the next look at the ledger tells.
                debug!(%mission, %problem, "the award was not committed");
                round.phase = RoundPhase::BackingOff { until: since + backoff(round.number), since };
            }
        }
    }
}

/// Whether a record says anything that the former one did not, times and counters aside.
fn tells_otherwise(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    let gist = |record: &AuctionRecord| {
        let verdicts = record
            .entries
            .iter()
            .map(|entry| (entry.role.clone(), entry.robot.clone(), std::mem::discriminant(&entry.verdict)));
        (record.failure.clone(), verdicts.collect::<Vec<_>>())
    };
    gist(known) != gist(record)
}

/// `nobody is left for r1: amber failed at it before: …; birch lacks …`.
fn nobody_is_left(hopeless: &BTreeSet<RoleId>, entries: &[AuctionEntry]) -> String {
    let of_role = |role: &RoleId| {
        let refusals = entries.iter().filter(|entry| entry.role == *role).filter_map(|entry| match &entry.verdict {
            BidVerdict::Refused { reason } => Some(format!("{} {reason}", entry.robot)),
            BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => None,
        });
        let mut refusals: Vec<String> = refusals.collect();
        // Whoever failed is the reason; the others merely cannot help.
        refusals.sort_by_key(|refusal| !refusal.contains(" failed at it before: "));
        let more = refusals.len().saturating_sub(NAMED);
        refusals.truncate(NAMED);
        let more = if more > 0 { format!("; and {more} more") } else { String::new() };
        format!("nobody is left for {role}: {}{more}", refusals.join("; "))
    };
    hopeless.iter().map(of_role).collect::<Vec<_>>().join("; ")
}
