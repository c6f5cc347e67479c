//! Clearing of an auction by what the ledger and the other auctions of the session contain.

use super::message::CollectedBids;
use super::queues::{reserve, robot_queues, unavailable_robots, unpromisable_robots};
use super::rounds::Rounds;
use super::session_context::SessionContext;
use consort_protocol::auction::{
    AuctionContext, AuctionOutcome, BidResponse, Candidates, EnergyBudget, OpenAuction, PromiseContext, PromiseTerms,
    RefusalReason, RobotQueue, RoleEstimate, allocate_together, clear_auction_with, joint_count, restrict_replies,
};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::MissionEntry;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Inputs of the clearing of an auction, from the ledger and the other auctions.
pub(super) struct AuctionInputs<'a> {
    /// Replies of the robots, with refusals of those that the orders of people keep from a role.
    responses: Cow<'a, [BidResponse]>,
    /// Robots that were not asked, without the roles from which the orders of people keep them.
    candidates: Cow<'a, Candidates>,
    /// Robots that can get no role now.
    unavailable: BTreeMap<RobotId, RefusalReason>,
    /// Robots that can be promised no role.
    unpromisable: BTreeMap<RobotId, RefusalReason>,
    queues: BTreeMap<RobotId, RobotQueue>,
    /// Roles that can start now.
    pub(super) startable: BTreeSet<RoleId>,
    /// Robots that have failed at each role.
    failed: BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// Robots that have lost or returned each role.
    released: BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// The robots of the mission may wait for each other.
    may_wait: bool,
    energy: Option<EnergyBudget>,
}

impl<'a> AuctionInputs<'a> {
    /// Reads the inputs from the ledger and the auctions of the session.
    pub(super) fn read(bids: &'a CollectedBids, rounds: &Rounds, context: &SessionContext) -> AuctionInputs<'a> {
        let CollectedBids { call, responses, again, candidates, .. } = bids;
        let mission = &call.auction.mission;
        // A mission that has waited for as long as a promise may be delayed and late might never start in a busy fleet.
        let PromiseTerms { delay_max, late_max, .. } = context.settings.auctions.promises;
        let waited = rounds.get(mission).map_or(Duration::ZERO, |round| context.now().since(round.since));
        let is_overdue = waited.as_secs_f64() >= (delay_max + late_max).get();
        context.read_ledger(|ledger| {
            let entry = ledger.mission(mission);
            let of_roles = |robots: &dyn Fn(&MissionEntry, &RoleId) -> BTreeMap<RobotId, String>| {
                let of_role = |role| entry.map(|entry| robots(entry, role)).unwrap_or_default();
                call.roles.keys().map(|role| (role.clone(), of_role(role))).collect::<BTreeMap<_, _>>()
            };
            let queues = robot_queues(ledger, rounds, mission, again.as_ref().map(|again| &again.promised));
            let may_start = entry.is_none_or(|entry| entry.submission.may_start(context.confirmed_ms));
            let can_proceed = |role: &&RoleId| may_start && entry.is_none_or(|entry| entry.can_proceed(role));
            let mut unavailable = unavailable_robots(ledger, &queues, mission);
            if !may_start {
                // The roles are promised only.
                let invited = bids.invitation.robots.iter().chain(candidates.robots());
                let robots = invited.chain(responses.iter().map(|response| &response.robot));
                unavailable.extend(robots.map(|robot| (robot.clone(), too_early())));
            }
            let restrictions = entry.map(MissionEntry::restrictions).unwrap_or_default();
            AuctionInputs {
                responses: restrict_replies(responses, &restrictions),
                candidates: candidates.restricted(&restrictions),
                unavailable,
                unpromisable: unpromisable_robots(ledger, mission),
                queues,
                startable: call.roles.keys().filter(can_proceed).cloned().collect(),
                failed: of_roles(&MissionEntry::excluded),
                released: of_roles(&MissionEntry::former_robots),
                may_wait: is_overdue
                    || !may_start
                    || entry.is_some_and(|entry| entry.assigned_roles().next().is_some()),
                energy: entry.and_then(|entry| entry.energy_budget(call)),
            }
        })
    }

    /// Returns the inputs for promises.
    pub(super) fn promises(&self, terms: PromiseTerms) -> PromiseContext<'_> {
        PromiseContext {
            queues: &self.queues,
            unavailable: &self.unpromisable,
            startable: &self.startable,
            may_wait: self.may_wait,
            terms,
        }
    }

    /// Reserves a robot for a role of another mission.
    pub(super) fn reserve(&mut self, robot: &RobotId, reason: RefusalReason, estimate: RoleEstimate) {
        reserve(&mut self.queues, robot, reason.clone(), estimate);
        self.unavailable.entry(robot.clone()).or_insert(reason);
    }

    /// Checks whether no robot has lost or returned a role of the mission, except for robots that failed.
    fn is_first(&self) -> bool {
        self.released == self.failed
    }

    fn without_promises<'c>(
        &'c self,
        bids: &'c CollectedBids,
        excluded: &'c BTreeMap<RoleId, BTreeMap<RobotId, String>>,
        context: &'c SessionContext,
    ) -> AuctionContext<'c> {
        let settings = &context.settings.auctions;
        AuctionContext {
            invitation: &bids.invitation,
            unavailable: &self.unavailable,
            excluded,
            limits: &settings.limits,
            energy: self.energy,
            promises: None,
            window_ms: u64::try_from(settings.bid_window.as_millis()).unwrap_or(u64::MAX),
            at_ms: context.settings.parts.clock.wall_ms(),
        }
    }

    /// Returns the robots to ask next; none if the result of the auction is proven.
    pub(super) fn to_ask(&self, bids: &CollectedBids, context: &SessionContext) -> BTreeSet<RobotId> {
        if self.candidates.is_empty() {
            return BTreeSet::new();
        }
        let terms = context.settings.auctions.promises;
        let promises = (terms.promises_max > 0).then(|| self.promises(terms));
        let inputs = AuctionContext { promises, ..self.without_promises(bids, &self.released, context) };
        self.candidates.to_ask(&bids.call, &self.responses, &inputs, next_count(bids, context))
    }

    /// Returns the robots to ask next, if these may have to get roles.
    pub(super) fn to_ask_with(
        &self,
        chosen: BTreeSet<RobotId>,
        bids: &CollectedBids,
        context: &SessionContext,
    ) -> BTreeSet<RobotId> {
        let inputs = self.without_promises(bids, &self.released, context);
        self.candidates.with_best(chosen, &bids.call, &inputs, next_count(bids, context))
    }

    /// Assigns the roles. A robot that has lost or returned a role of the mission gets it again only if
    /// the mission cannot be awarded otherwise: a robot that bids and then does not act delays the mission
    /// once, and not for ever.
    ///
    /// # Errors
    /// The robots to ask first, unless the result is proven.
    pub(super) fn clear(
        &self,
        bids: &CollectedBids,
        context: &SessionContext,
    ) -> Result<AuctionOutcome, BTreeSet<RobotId>> {
        let to_ask = self.to_ask(bids, context);
        if !to_ask.is_empty() {
            return Err(to_ask);
        }
        let CollectedBids { call, .. } = bids;
        let AuctionInputs { responses, failed, released, .. } = self;
        let settings = &context.settings.auctions;
        let clear_with = |excluded, may_promise: bool| {
            let promises = may_promise.then(|| self.promises(settings.promises));
            let auction_context = AuctionContext { promises, ..self.without_promises(bids, excluded, context) };
            clear_auction_with(call, responses, &auction_context, &*settings.allocator)
        };
        // Missions that would wait for each other are resolved by rank, once the reason is on record.
        let is_possible = |outcome: &AuctionOutcome| {
            let (mission, promised) = (&call.auction.mission, &outcome.record.promised);
            let is_circular =
                |holders| context.read_ledger(|ledger| ledger.would_wait_circularly(mission, holders, promised));
            promised.is_empty() || !outcome.holders.iter().any(is_circular)
        };
        let clear = |excluded| {
            let outcome = clear_with(excluded, settings.promises.promises_max > 0);
            if is_possible(&outcome) { outcome } else { clear_with(excluded, false) }
        };
        let by_others = (!self.is_first()).then(|| clear(released));
        let mut outcome = by_others.filter(|outcome| outcome.holders.is_some()).unwrap_or_else(|| clear(failed));
        outcome.record.add_not_asked(self.candidates.entries(&self.unavailable));
        Ok(outcome)
    }
}

/// Returns the reason for which no robot gets a role of a mission now that may start later.
fn too_early() -> RefusalReason {
    RefusalReason::NotEligible { why: "the mission may start later".to_owned(), permanent: false }
}

/// Returns the number of robots to ask next: as many as were asked before, since each call takes time.
fn next_count(bids: &CollectedBids, context: &SessionContext) -> usize {
    let first = context.settings.auctions.candidates.as_ref().map_or(0, |settings| settings.count);
    bids.invitation.robots.len().max(first).max(1)
}

/// Returns the robots of each mission in the allocation of all together; none for a mission that is cleared by itself.
pub(super) fn allocate_missions<'a>(
    missions: &[(&'a MissionId, &'a CollectedBids)],
    rounds: &Rounds,
    context: &SessionContext,
) -> Vec<(&'a MissionId, BTreeMap<RoleId, RobotId>)> {
    // The others are cleared by themselves, so their inputs are not needed.
    let missions = &missions[..joint_count(missions.iter().map(|(_, bids)| &bids.call))];
    if missions.len() < 2 || !context.settings.auctions.allocator.allocates_together() {
        return vec![];
    }
    let inputs = missions.iter().map(|(mission, bids)| (*mission, *bids, AuctionInputs::read(bids, rounds, context)));
    let first: Vec<_> = inputs.filter(|(.., inputs)| inputs.is_first()).collect();
    let mut open = vec![];
    for (_, bids, inputs) in &first {
        let context = inputs.without_promises(bids, &inputs.failed, context);
        let candidates = &*inputs.candidates;
        open.push(OpenAuction { call: &bids.call, responses: &inputs.responses, context, candidates });
    }
    let allocation = allocate_together(&open);
    first.iter().map(|(mission, ..)| *mission).zip(allocation).collect()
}
