//! Clearing of an auction: from replies to a decision.

use super::allocator::{Allocator, AllocatorInput, OptimalAssignment};
use super::assignment::AssignmentError;
use super::bid::{Bid, BidLimits, BidPart, BidResponse, CallForBids, RefusalReason, RoleReply};
use super::energy::{EnergyBudget, EnergyOffer};
use super::energy_exceeded::EnergyExceeded;
use super::invitation::Invitation;
use super::promise::PromiseContext;
use super::record::{AuctionEntry, AuctionRecord, BidVerdict, durations_s};
use crate::ids::{EnsembleId, RobotId, RoleId};
use crate::plan::{EstimatedPlan, earliest_starts};
use crate::units::{Energy, Seconds};
use std::collections::{BTreeMap, BTreeSet};

/// Outcome of an auction.
#[derive(Debug, Clone, PartialEq)]
pub struct AuctionOutcome {
    /// Robot of each role: all roles of the call, except for roles of spread loops that stay open; or `None`.
    pub holders: Option<BTreeMap<RoleId, RobotId>>,
    /// Record of the auction.
    pub record: AuctionRecord,
    /// Roles that at least 1 robot has failed at and all others refuse permanently.
    pub unfillable: BTreeSet<RoleId>,
    /// Set if the mission exceeds its bound on energy, whichever of the robots get the roles.
    pub energy_exceeded: Option<EnergyExceeded>,
}

/// Inputs of the clearing in addition to the replies.
#[derive(Debug, Clone)]
pub struct AuctionContext<'a> {
    /// Robots that were invited.
    pub invitation: &'a Invitation,
    /// Robots with bids that do not count, and the reasons. Such a robot holds a role or is about
    /// to get one, and may have sent its bid before it was notified; or it carries an item of
    /// another mission.
    pub unavailable: &'a BTreeMap<RobotId, RefusalReason>,
    /// Robots that failed at a role of this mission, with the causes.
    pub excluded: &'a BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// Limits for bids.
    pub limits: &'a BidLimits,
    /// Bound on the energy of the mission; `None` for no bound.
    pub energy: Option<EnergyBudget>,
    /// Promises to robots that are busy; `None` for none.
    pub promises: Option<PromiseContext<'a>>,
    /// Time waited for replies, in milliseconds.
    pub window_ms: u64,
    /// Time to write into the record, in milliseconds.
    pub at_ms: u64,
}

impl<'a> AuctionContext<'a> {
    /// Checks whether costs alone decide: the mission prefers no robots, has no bound on energy, and needs all its roles.
    pub(super) fn is_by_cost(&self, call: &CallForBids) -> bool {
        self.invitation.preferred.is_empty() && self.energy.is_none() && call.spread.is_empty()
    }

    /// Returns the replies and the context for promises; `None` if there are no promises.
    pub(super) fn later(&self, responses: &[BidResponse]) -> Option<(Vec<BidResponse>, AuctionContext<'a>)> {
        let promises = self.promises.as_ref()?;
        let later = AuctionContext { unavailable: promises.unavailable, promises: None, ..self.clone() };
        Some((promises.later(responses), later))
    }
}

/// Evaluates all replies to a call and assigns the roles. Invited robots without a reply are
/// recorded as silent. So the record contains every robot that could have had a role, and the
/// reason if it did not get it.
pub fn clear_auction(call: &CallForBids, responses: &[BidResponse], context: &AuctionContext<'_>) -> AuctionOutcome {
    clear_auction_with(call, responses, context, &OptimalAssignment)
}

/// Does the same with another allocator.
pub fn clear_auction_with(
    call: &CallForBids,
    responses: &[BidResponse],
    context: &AuctionContext<'_>,
    allocator: &dyn Allocator,
) -> AuctionOutcome {
    let now = clear_by_preference(call, responses, context, allocator);
    let Some(promises) = context.promises.as_ref().filter(|_| now.holders.is_none()) else { return now };
    let Some((later_responses, later_context)) = context.later(responses) else { return now };
    let later = clear_by_preference(call, &later_responses, &later_context, allocator);
    match later.holders.as_ref().and_then(|holders| promises.promised(holders, responses)) {
        Some(promised) => {
            let promised = after_others(call, &later.record, responses, &promised);
            AuctionOutcome { record: AuctionRecord { promised, ..later.record }, ..later }
        }
        None => now,
    }
}

/// Returns the starts of promised roles, not before the other roles of the call have done what they wait for.
fn after_others(
    call: &CallForBids,
    record: &AuctionRecord,
    responses: &[BidResponse],
    promised: &BTreeMap<RoleId, Seconds>,
) -> BTreeMap<RoleId, Seconds> {
    let replies = replies_to(call, responses);
    let estimated = |(role, robot): (&RoleId, &RobotId)| {
        let plan = call.roles.get(role)?;
        let durations_s = bid_of(&replies, role, robot).map(|bid| durations_s(&bid.parts)).unwrap_or_default();
        let begin_s = promised.get(role).map_or(0.0, |start| start.get());
        Some((role.clone(), EstimatedPlan { plan, begin_s, durations_s }))
    };
    let plans = record.chosen.iter().filter_map(estimated).collect();
    let released = earliest_starts(&plans, |_| false);
    let start = |(role, start): (RoleId, Seconds)| {
        let released = released.get(&role).and_then(|start_s| Seconds::new(*start_s).ok());
        let start = released.filter(|released| *released > start).unwrap_or(start);
        (role, start)
    };
    promised.iter().map(|(role, start)| (role.clone(), *start)).map(start).collect()
}

fn clear_by_preference(
    call: &CallForBids,
    responses: &[BidResponse],
    context: &AuctionContext<'_>,
    allocator: &dyn Allocator,
) -> AuctionOutcome {
    let replies = replies_to(call, responses);
    let mut preferred = BTreeSet::new();
    for (ensemble, members) in &context.invitation.preferred {
        preferred.extend(members);
        let preference = Preference { ensemble, robots: &preferred };
        let outcome = clear_among(call, &replies, context, allocator, Some(preference));
        if outcome.holders.is_some() {
            return outcome;
        }
    }
    clear_among(call, &replies, context, allocator, None)
}

/// Robots to which the roles are restricted.
#[derive(Clone, Copy)]
struct Preference<'a> {
    /// The last ensemble among theirs.
    ensemble: &'a EnsembleId,
    robots: &'a BTreeSet<&'a RobotId>,
}

fn clear_among(
    call: &CallForBids,
    replies: &Replies<'_>,
    context: &AuctionContext<'_>,
    allocator: &dyn Allocator,
    preference: Option<Preference<'_>>,
) -> AuctionOutcome {
    let mut entries = evaluate_all(call, replies, context, preference);
    let unfillable = unfillable_roles(call, &entries, context);
    let (holders, problem) = match allocate_roles(allocator, call, replies, &entries, context) {
        Ok(holders) => (Some(holders), None),
        Err(problem) => (None, Some(problem)),
    };
    let energy_exceeded = problem.as_ref().and_then(|_| inevitable_excess(call, &entries, context.energy?));
    let failure = energy_exceeded.as_ref().map(ToString::to_string).or(problem.map(|problem| problem.to_string()));
    let chosen = holders.clone().unwrap_or_default();
    keep_parts(&mut entries, &chosen, |role, robot| bid_of(replies, role, robot).map_or(&[], |bid| &bid.parts));
    let planned_by =
        |(role, robot): (&RoleId, &RobotId)| Some((role.clone(), *bid_of(replies, role, robot)?.planned.clone()?));
    let mut record = AuctionRecord {
        planned: chosen.iter().filter_map(planned_by).collect(),
        auction: call.auction.clone(),
        at_ms: context.at_ms,
        entries,
        omitted: 0,
        chosen,
        promised: BTreeMap::new(),
        failure,
    };
    record.limit();
    AuctionOutcome { holders, record, unfillable, energy_exceeded }
}

/// Reply of each robot for each role; the first reply counts.
type Replies<'a> = BTreeMap<(&'a RoleId, &'a RobotId), &'a RoleReply>;

/// Collects the replies to this call. A robot may reply only for itself.
fn replies_to<'a>(call: &CallForBids, responses: &'a [BidResponse]) -> Replies<'a> {
    let mut replies = Replies::new();
    for response in responses.iter().filter(|response| response.auction == call.auction) {
        for reply in &response.replies {
            let (role, robot) = match reply {
                RoleReply::Bid(bid) => (&bid.role, &bid.robot),
                RoleReply::Refusal(refusal) => (&refusal.role, &refusal.robot),
            };
            if *robot == response.robot {
                replies.entry((role, robot)).or_insert(reply);
            }
        }
    }
    replies
}

fn bid_of<'a>(replies: &Replies<'a>, role: &RoleId, robot: &RobotId) -> Option<&'a Bid> {
    match replies.get(&(role, robot)) {
        Some(RoleReply::Bid(bid)) => Some(bid),
        Some(RoleReply::Refusal(_)) | None => None,
    }
}

/// Returns the bids of robots that may get a role, without preferences among robots.
pub(super) fn viable_bids<'a>(
    call: &CallForBids,
    responses: &'a [BidResponse],
    context: &AuctionContext<'_>,
) -> Vec<&'a Bid> {
    let replies = replies_to(call, responses);
    viable_among(&replies, &evaluate_all(call, &replies, context, None))
}

fn viable_among<'a>(replies: &Replies<'a>, entries: &[AuctionEntry]) -> Vec<&'a Bid> {
    let viable = entries.iter().filter(|entry| matches!(entry.verdict, BidVerdict::Viable { .. }));
    viable.filter_map(|entry| bid_of(replies, &entry.role, &entry.robot)).collect()
}

/// Evaluates every robot for every role: robots that replied and robots that were invited.
fn evaluate_all(
    call: &CallForBids,
    replies: &Replies<'_>,
    context: &AuctionContext<'_>,
    preference: Option<Preference<'_>>,
) -> Vec<AuctionEntry> {
    let robots: BTreeSet<&RobotId> =
        context.invitation.robots.iter().chain(replies.keys().map(|(_, robot)| *robot)).collect();
    let mut entries = vec![];
    for role in call.roles.keys() {
        for &robot in &robots {
            let excluded = context.excluded.get(role).and_then(|excluded| excluded.get(robot));
            let verdict = match replies.get(&(role, robot)) {
                _ if let Some(cause) = excluded => {
                    BidVerdict::Refused { reason: RefusalReason::Excluded { cause: cause.clone() } }
                }
                Some(RoleReply::Bid(bid)) => evaluate(bid, context, preference),
                Some(RoleReply::Refusal(refusal)) => BidVerdict::Refused { reason: refusal.reason.clone() },
                None => BidVerdict::Refused { reason: RefusalReason::Silent { window_ms: context.window_ms } },
            };
            entries.push(AuctionEntry { role: role.clone(), robot: robot.clone(), verdict, parts: vec![] });
        }
    }
    entries
}

/// Returns the roles of the call that at least 1 robot has failed at and all others refuse
/// permanently.
fn unfillable_roles(call: &CallForBids, entries: &[AuctionEntry], context: &AuctionContext<'_>) -> BTreeSet<RoleId> {
    let failed_at = context.excluded.iter().filter(|(_, excluded)| !excluded.is_empty()).map(|(role, _)| role);
    let called = failed_at.filter(|role| call.roles.contains_key(*role));
    called
        .filter(|role| entries.iter().filter(|entry| entry.role == **role).all(|entry| is_out(call, entry)))
        .cloned()
        .collect()
}

/// Checks whether the robot cannot get the role any more, whatever it does meanwhile.
fn is_out(call: &CallForBids, entry: &AuctionEntry) -> bool {
    match &entry.verdict {
        // A robot that holds a role of this same mission is taken to be busy until the mission ends, but the
        // roles of a spread loop wait for it.
        BidVerdict::Refused { reason: RefusalReason::Busy { mission, .. } } => {
            *mission == call.auction.mission && !call.spread.contains(&entry.role)
        }
        BidVerdict::Refused { reason } => reason.is_permanent(),
        BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } | BidVerdict::NotAsked { .. } => false,
    }
}

/// Returns the excess over the bound if even the assignment with the least energy exceeds it, among
/// all robots that can still get the roles. Of roles of spread loops a single one counts: the energy of the
/// next depends on where the robots are then. The energy of a robot that may bid later is unknown, and
/// counts as none.
fn inevitable_excess(call: &CallForBids, entries: &[AuctionEntry], budget: EnergyBudget) -> Option<EnergyExceeded> {
    let offers = entries.iter().filter(|entry| !is_out(call, entry)).map(|entry| EnergyOffer {
        role: &entry.role,
        robot: &entry.robot,
        energy: match entry.verdict {
            BidVerdict::Viable { energy, .. } | BidVerdict::Unviable { energy, .. } => Energy::of_share(energy),
            BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. } => Energy::ZERO,
        },
    });
    let offers: Vec<EnergyOffer<'_>> = offers.collect();
    let mut roles: BTreeSet<RoleId> = call.roles.keys().filter(|role| !call.spread.contains(*role)).cloned().collect();
    if roles.is_empty() {
        let cheapest = offers.iter().min_by(|one, other| one.energy.get().total_cmp(&other.energy.get()))?;
        roles.insert(cheapest.role.clone());
    }
    budget.least(&roles, &offers).ok()?.err()
}

/// Assigns the roles with the allocator, among the robots that the verdicts permit, within the bound on
/// energy.
fn allocate_roles(
    allocator: &dyn Allocator,
    call: &CallForBids,
    replies: &Replies<'_>,
    entries: &[AuctionEntry],
    context: &AuctionContext<'_>,
) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
    let mut open: BTreeMap<RoleId, BTreeSet<RobotId>> =
        call.roles.keys().map(|role| (role.clone(), BTreeSet::new())).collect();
    for entry in entries.iter().filter(|entry| is_candidate(&entry.verdict)) {
        open.entry(entry.role.clone()).or_default().insert(entry.robot.clone());
    }
    let viable = viable_among(replies, entries);
    let bids: Vec<&Bid> = replies
        .iter()
        .filter(|((role, robot), _)| open.get(*role).is_some_and(|robots| robots.contains(*robot)))
        .filter_map(|(_, reply)| if let RoleReply::Bid(bid) = reply { Some(bid) } else { None })
        .collect();
    let limits = context.limits;
    let mut holders =
        allocator.allocate(&AllocatorInput { call, candidates: &open, bids: &bids, viable: &viable, limits })?;
    let Some(budget) = context.energy else { return Ok(holders) };
    // Roles of spread loops stay open, as far as needed to remain within the bound.
    loop {
        let spread = holders.keys().rfind(|role| call.spread.contains(*role)).cloned();
        match (budget.restrict(holders.clone(), &viable), spread) {
            (Err(AssignmentError::EnergyExceeded(_)), Some(role)) if holders.len() > 1 => holders.remove(&role),
            (restricted, _) => return restricted,
        };
    }
}

/// Adds the parts of bids to the record while there is room: first those of winners, then by time,
/// and last those of bids outside the limits.
fn keep_parts<'a>(
    entries: &mut [AuctionEntry],
    chosen: &BTreeMap<RoleId, RobotId>,
    parts_of: impl Fn(&RoleId, &RobotId) -> &'a [BidPart],
) {
    let mut order: Vec<(bool, bool, Seconds, &mut AuctionEntry)> = entries
        .iter_mut()
        .filter_map(|entry| match entry.verdict {
            BidVerdict::Viable { time, .. } => {
                Some((chosen.get(&entry.role) != Some(&entry.robot), false, time, entry))
            }
            BidVerdict::Unviable { time, .. } => Some((true, true, time, entry)),
            BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. } => None,
        })
        .collect();
    order.sort_by(|one, other| (one.0, one.1).cmp(&(other.0, other.1)).then(one.2.get().total_cmp(&other.2.get())));
    let mut room = AuctionRecord::PARTS_BYTES_MAX;
    for (_, _, _, entry) in order {
        let parts = parts_of(&entry.role, &entry.robot);
        let bytes: usize = parts.iter().map(|part| part.label.len() + part.skill.as_str().len() + 24).sum();
        let Some(left) = room.checked_sub(bytes) else { return };
        room = left;
        entry.parts = parts.to_vec();
    }
}

/// Checks whether the allocator may assign the role to the robot. Robots that lack skills are
/// included, for allocators other than ours.
fn is_candidate(verdict: &BidVerdict) -> bool {
    match verdict {
        BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } => true,
        BidVerdict::Refused { reason } => {
            matches!(reason, RefusalReason::MissingSkills { .. } | RefusalReason::NotFeasible { .. })
        }
        BidVerdict::NotAsked { .. } => false,
    }
}

fn evaluate(bid: &Bid, context: &AuctionContext<'_>, preference: Option<Preference<'_>>) -> BidVerdict {
    let Bid { time, energy, remaining, .. } = *bid;
    if let Some(reason) = context.unavailable.get(&bid.robot) {
        return BidVerdict::Refused { reason: reason.clone() };
    }
    if let Some(present) = &bid.present {
        return BidVerdict::Refused { reason: RefusalReason::from(present) };
    }
    if let Some(Preference { ensemble, robots }) = preference
        && !robots.contains(&bid.robot)
    {
        return BidVerdict::Refused { reason: RefusalReason::NotPreferred { ensemble: ensemble.clone() } };
    }
    match bid.check_viable(context.limits) {
        Ok(()) => BidVerdict::Viable { time, energy, remaining },
        Err(why) => BidVerdict::Unviable { time, energy, remaining, why },
    }
}

#[cfg(test)]
mod tests;
