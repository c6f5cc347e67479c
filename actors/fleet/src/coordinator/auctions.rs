//! Auctions of a leader session, and the order in which missions are served.
//!
//! Missions are auctioned in parallel. If several missions need the same robot, the mission with
//! the higher priority gets it, and among equals the mission with the lower number. Therefore an
//! auction that has its bids and would fill its roles first waits for all better-ranked missions
//! that are collecting bids. Better-ranked missions in backoff are called at once, because the
//! robots found may be the robots they wait for. An auction waits for at most 2 bid windows.

use super::actions::{AuctionRound, ClosedBidding, RoundPhase};
use super::auctioneer;
use super::ensemble_members::live_members;
use super::message::{CollectedBids, CoordinatorMessage};
use super::queues::{robot_queues, unavailable_robots, unpromisable_robots};
use super::reconcile::{backoff, can_be_auctioned};
use super::session_context::SessionContext;
use consort_protocol::auction::{
    AuctionContext, AuctionEntry, AuctionId, AuctionOutcome, AuctionRecord, BidVerdict, CallForBids, EnergyBudget,
    Invitation, PromiseContext, PromiseTerms, RefusalReason, RobotQueue, RoleReply, Timelines, clear_auction_with,
};
use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, MissionEntry};
use consort_protocol::units::NodeTime;
use consort_raft::ProposeError;
use std::collections::{BTreeMap, BTreeSet};
use std::mem::discriminant;
use std::time::Duration;
use tracing::debug;

/// Timeout for the ledger to commit an award.
pub(super) const AWARD_TIMEOUT: Duration = Duration::from_secs(2);

/// A mission fails after this number of consecutive rounds in which every remaining robot refuses a
/// role permanently, provided that a robot has failed in that role before.
const HOPELESS_ROUNDS: u32 = 3;

/// Maximum number of robots named in the cause of a failed mission.
const NAMED_ROBOTS_MAX: usize = 8;

/// Inputs of the clearing of an auction, from the ledger and the other auctions.
struct AuctionInputs {
    /// Robots that can get no role now.
    unavailable: BTreeMap<RobotId, RefusalReason>,
    /// Robots that can be promised no role.
    unpromisable: BTreeMap<RobotId, RefusalReason>,
    queues: BTreeMap<RobotId, RobotQueue>,
    /// Roles that can start now.
    startable: BTreeSet<RoleId>,
    /// Robots that have failed at each role.
    failed: BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// Robots that have lost or returned each role.
    released: BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    is_under_way: bool,
    energy: Option<EnergyBudget>,
}

/// Auctions of a session, by mission.
#[derive(Default)]
pub(super) struct Auctions {
    rounds: BTreeMap<MissionId, AuctionRound>,
}

impl Auctions {
    pub(super) fn rounds(&self) -> &BTreeMap<MissionId, AuctionRound> {
        &self.rounds
    }

    /// Forgets the auctions of missions that have ended, and follows changes of the branch.
    pub(super) fn follow(&mut self, ledger: &Ledger, now: NodeTime) {
        self.rounds.retain(|mission, round| {
            let entry = ledger.mission(mission).filter(|entry| !entry.state.is_final());
            entry.inspect(|entry| round.follow_branch(entry.branch, now)).is_some()
        });
    }

    /// Ends all backoffs, because a robot has become free.
    pub(super) fn end_backoff(&mut self, now: NodeTime) {
        for round in self.rounds.values_mut() {
            if let RoundPhase::BackingOff { until, .. } = &mut round.phase {
                *until = now;
            }
        }
    }

    /// Calls for bids for the open roles of a mission.
    pub(super) fn call_for_bids(&mut self, mission: &MissionId, context: &mut SessionContext, now: NodeTime) {
        let Some(branch) = context.read_ledger(|ledger| Some(ledger.mission(mission)?.branch)) else { return };
        let previous = self.rounds.get_mut(mission).map(|round| {
            round.follow_branch(branch, now);
            (round.number + 1, round.hopeless_rounds)
        });
        let (number, hopeless) = previous.unwrap_or((1, 0));
        let auction = AuctionId { mission: mission.clone(), term: context.term, round: number };
        let settings = &context.settings;
        let robots = |nodes: BTreeSet<NodeId>| nodes.into_iter().map(RobotId::from).collect();
        let members = live_members(settings, now).into_iter().map(|(name, nodes)| (name, robots(nodes))).collect();
        let PromiseTerms { objective, delay_max, .. } = settings.auctions.promises;
        let called = context.read_ledger(|ledger| {
            let entry = ledger.mission(mission)?;
            let call = entry.call_for_bids(auction)?;
            let invitation = Invitation::of(&call.ensembles, &members);
            let promised = ledger.promised_roles(mission, delay_max, &invitation.robots);
            let startable = call.roles.keys().filter(|role| entry.can_proceed(role)).cloned().collect();
            let timelines = Timelines { objective, promised, startable };
            Some((CallForBids { timelines, ..call }, invitation))
        });
        let Some((call, invitation)) = called else { return };
        context.publish_event(EventKind::BidsRequested {
            mission: mission.clone(),
            roles: call.roles.keys().cloned().collect(),
            round: number,
            asked: invitation.robots.len(),
        });
        self.rounds.insert(
            mission.clone(),
            AuctionRound { number, branch, called_at: now, hopeless_rounds: hopeless, phase: RoundPhase::Bidding },
        );
        let (bus, keys) = (settings.parts.bus.clone(), settings.parts.keys.clone());
        let window = settings.auctions.bid_window;
        context.send_result(async move {
            let responses = auctioneer::collect_bids(bus, keys, call.clone(), invitation.robots.clone(), window).await;
            CoordinatorMessage::BidsCollected(Box::new(CollectedBids { call, invitation, responses }))
        });
    }

    /// Closes an auction: all bids have arrived, or the bid window has closed.
    pub(super) fn close_bidding(&mut self, bids: CollectedBids, context: &mut SessionContext) {
        let AuctionId { mission, round: number, .. } = bids.call.auction.clone();
        let current = |round: &&mut AuctionRound| round.number == number && round.phase == RoundPhase::Bidding;
        let Some(round) = self.rounds.get_mut(&mission).filter(current) else {
            return; // the mission has ended, or another round has started
        };
        for bid in bids.responses.iter().flat_map(|response| &response.replies) {
            if let RoleReply::Bid(bid) = bid {
                context.publish_event(EventKind::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let deadline = context.now() + context.settings.auctions.bid_window * 2;
        round.phase = RoundPhase::BiddingClosed(Box::new(ClosedBidding { bids, deadline }));
        self.clear(context);
    }

    /// Clears the closed auctions that need not wait for a better-ranked mission.
    pub(super) fn clear(&mut self, context: &mut SessionContext) {
        if !self.rounds.values().any(|round| matches!(round.phase, RoundPhase::BiddingClosed(_))) {
            return;
        }
        let now = context.now();
        let open = context.read_ledger(|ledger| {
            let lease_monitor = context.lease_monitor.lock();
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
                RoundPhase::Proposing { .. } => {}
                RoundPhase::BiddingClosed(closed) => {
                    let outcome = self.outcome(&closed.bids, context);
                    if outcome.holders.is_some() && now < closed.deadline {
                        for (better_ranked, _) in waiting.iter().filter(|(_, since)| *since < called) {
                            self.call_for_bids(better_ranked, context, now);
                            calling = true;
                        }
                        if calling {
                            continue; // lower-ranked missions wait, too
                        }
                    }
                    self.record(&mission, outcome, context);
                }
            }
        }
    }

    /// Assigns the roles. A robot that has lost or returned a role of the mission gets it again only if
    /// the mission cannot be awarded otherwise: a robot that bids and then does not act delays the mission
    /// once, and not for ever.
    fn outcome(&self, bids: &CollectedBids, context: &SessionContext) -> AuctionOutcome {
        let CollectedBids { call, invitation, responses } = bids;
        let mission = &call.auction.mission;
        let inputs = context.read_ledger(|ledger| {
            let entry = ledger.mission(mission);
            let of_roles = |robots: &dyn Fn(&MissionEntry, &RoleId) -> BTreeMap<RobotId, String>| {
                let of_role = |role| entry.map(|entry| robots(entry, role)).unwrap_or_default();
                call.roles.keys().map(|role| (role.clone(), of_role(role))).collect::<BTreeMap<_, _>>()
            };
            let queues = robot_queues(ledger, &self.rounds);
            let can_proceed = |role: &&RoleId| entry.is_none_or(|entry| entry.can_proceed(role));
            AuctionInputs {
                unavailable: unavailable_robots(ledger, &queues, mission),
                unpromisable: unpromisable_robots(ledger, mission),
                queues,
                startable: call.roles.keys().filter(can_proceed).cloned().collect(),
                failed: of_roles(&MissionEntry::excluded),
                released: of_roles(&MissionEntry::former_robots),
                is_under_way: entry.is_some_and(|entry| entry.assigned_roles().next().is_some()),
                energy: entry.and_then(MissionEntry::energy_budget),
            }
        });
        let AuctionInputs { unavailable, unpromisable, queues, startable, failed, released, is_under_way, energy } =
            &inputs;
        let settings = &context.settings.auctions;
        let clear_with = |excluded, may_promise: bool| {
            let promises = PromiseContext {
                queues,
                unavailable: unpromisable,
                startable,
                is_under_way: *is_under_way,
                terms: settings.promises,
            };
            let auction_context = AuctionContext {
                invitation,
                unavailable,
                excluded,
                limits: &settings.limits,
                energy: *energy,
                promises: Some(promises).filter(|_| may_promise),
                window_ms: u64::try_from(settings.bid_window.as_millis()).unwrap_or(u64::MAX),
                at_ms: context.settings.parts.clock.wall_ms(),
            };
            clear_auction_with(call, responses, &auction_context, &*settings.allocator)
        };
        // Missions that would wait for each other are resolved by rank, once the reason is on record.
        let is_possible = |outcome: &AuctionOutcome| {
            let promised = &outcome.record.promised;
            let is_circular =
                |holders| context.read_ledger(|ledger| ledger.would_wait_circularly(mission, holders, promised));
            promised.is_empty() || !outcome.holders.iter().any(is_circular)
        };
        let clear = |excluded| {
            let outcome = clear_with(excluded, settings.promises.promises_max > 0);
            if is_possible(&outcome) { outcome } else { clear_with(excluded, false) }
        };
        let by_others = (released != failed).then(|| clear(released));
        by_others.filter(|outcome| outcome.holders.is_some()).unwrap_or_else(|| clear(failed))
    }

    /// Proposes the award, or defers the mission and backs off.
    fn record(&mut self, mission: &MissionId, outcome: AuctionOutcome, context: &mut SessionContext) {
        let AuctionOutcome { holders, record, unfillable, energy_exceeded } = outcome;
        let promised: BTreeSet<RoleId> = record.promised.keys().cloned().collect();
        context.publish_event(EventKind::Closed { mission: mission.clone(), record: record.clone() });
        let Some(round) = self.rounds.get_mut(mission) else { return };
        round.hopeless_rounds = if unfillable.is_empty() { 0 } else { round.hopeless_rounds + 1 };
        let (branch, auction, mission) = (round.branch, record.auction.clone(), mission.clone());
        let mut failure = None;
        let command = match holders {
            Some(holders) => {
                round.phase = RoundPhase::Proposing { holders: holders.clone(), promised };
                Command::Award { mission, branch, holders, auction: record }
            }
            None => {
                let since = context.now();
                round.phase = RoundPhase::BackingOff { until: since + backoff(auction.round), since };
                let has_changed = context.read_ledger(|ledger| {
                    let known = ledger.mission(&mission).and_then(|entry| entry.auction.as_ref());
                    known.is_none_or(|known| differs(known, &record))
                });
                let hopeless = round.hopeless_rounds >= HOPELESS_ROUNDS;
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
                Command::Defer { mission, branch, auction: record }
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
        let Some(round) = self.rounds.get_mut(mission).filter(|round| round.number == auction.round) else { return };
        let RoundPhase::Proposing { holders, promised } = &round.phase else { return };
        match outcome {
            Ok(CommandOutcome::Awarded { epoch }) => {
                let after_ms = time_known.map(|known| known.as_secs_f64() * 1000.0);
                let (promised, holders) = holders.clone().into_iter().partition(|(role, _)| promised.contains(role));
                let mission = mission.clone();
                context.publish_event(EventKind::Awarded { mission, holders, promised, epoch, after_ms });
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

/// Checks whether a record differs from the previous record in more than times, counters and details.
/// The kinds of refusals count, because [`circular_waits`](super::circular_waits) reads them in the ledger.
fn differs(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    let essence = |record: &AuctionRecord| {
        let verdicts = record.entries.iter().map(|entry| {
            let reason = match &entry.verdict {
                BidVerdict::Refused { reason } => Some(discriminant(reason)),
                BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => None,
            };
            (entry.role.clone(), entry.robot.clone(), discriminant(&entry.verdict), reason)
        });
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
