//! Candidates: the robots that the coordinator asks for bids in a large fleet.
//!
//! A call to all robots costs two messages for each. So the coordinator reads from the record of each robot whether it would
//! refuse a role (the module `expectation`), and otherwise a lower bound of its cost. It asks the robots with the least bounds
//! first, and asks more until the result is proven:
//!
//! ```text
//!   bids of those asked, bounds of the others ──▶ assignment ──▶ only robots that were asked: proven
//!          ▲                                          │
//!          └────────────── ask more ◀─── a robot that was not asked
//! ```
//!
//! No bid costs less than its bound, so no assignment costs less than it does with the bounds. If the assignment with the
//! bounds contains only robots that were asked, it is the one that an auction among all robots finds. This is a branch and bound
//! (Land and Doig, 1960) whose branches are questions to robots. A single role goes to the same robot even among equal costs. Several roles
//! with equal sums of costs may go to other robots, at the same sum.
//!
//! The proof needs costs to decide alone: a mission with a preference, with a bound on energy, with a spread loop or with robots
//! that failed asks all robots.

mod expectation;

pub use expectation::{Expectation, Price, RoleTerms};

use super::assignment::{Offer, cheapest_assignment};
use super::bid::{BidResponse, CallForBids, RefusalReason};
use super::clearing::{AuctionContext, viable_bids};
use super::record::{AuctionEntry, BidVerdict, NotAskedReason};
use super::restriction::RobotRestriction;
use crate::ids::{RobotId, RoleId};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

/// Robots that were not asked, with what each would reply for each role.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Candidates(BTreeMap<RobotId, BTreeMap<RoleId, Expectation>>);

impl Candidates {
    /// Returns robots of which none was asked.
    pub fn new(expected: BTreeMap<RobotId, BTreeMap<RoleId, Expectation>>) -> Candidates {
        Candidates(expected)
    }

    /// Checks whether all robots were asked.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of robots that were not asked.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Checks whether a robot was not asked.
    pub fn contains(&self, robot: &RobotId) -> bool {
        self.0.contains_key(robot)
    }

    /// Returns the robots as those that refuse the roles from which restrictions exclude them.
    pub fn restricted(&self, restrictions: &BTreeMap<RoleId, RobotRestriction>) -> Cow<'_, Candidates> {
        if restrictions.is_empty() {
            return Cow::Borrowed(self);
        }
        let mut restricted = self.clone();
        for (robot, expected) in &mut restricted.0 {
            for (role, expectation) in expected {
                if restrictions.get(role).is_some_and(|restriction| !restriction.permits(robot)) {
                    *expectation = Expectation::Refuses(NotAskedReason::Restricted);
                }
            }
        }
        Cow::Owned(restricted)
    }

    /// Returns the robots.
    pub fn robots(&self) -> impl Iterator<Item = &RobotId> {
        self.0.keys()
    }

    /// Removes robots that are asked.
    pub fn remove(&mut self, asked: &BTreeSet<RobotId>) {
        self.0.retain(|robot, _| !asked.contains(robot));
    }

    /// Returns the robots to ask next: those that may have to get a role, and about `count` with the least bounds. Returns none
    /// if the result of the clearing is proven: whether the roles are assigned, and to which robots.
    pub fn to_ask(
        &self,
        call: &CallForBids,
        responses: &[BidResponse],
        context: &AuctionContext<'_>,
        count: usize,
    ) -> BTreeSet<RobotId> {
        if self.is_empty() {
            return BTreeSet::new();
        }
        if !context.is_by_cost(call) || context.excluded.values().any(|robots| !robots.is_empty()) {
            return self.0.keys().cloned().collect();
        }
        let of_each_role = count.div_ceil(call.roles.len().max(1));
        let now: Vec<Offer<'_>> = call.roles.keys().flat_map(|role| self.offers_now(role, context)).collect();
        if let Some(chosen) = chosen_unasked(call, responses, context, &now) {
            return with_next(chosen, now, of_each_role);
        }
        // The roles cannot be filled now. They may be promised.
        let Some((promises, (responses, context))) = context.promises.as_ref().zip(context.later(responses)) else {
            return BTreeSet::new();
        };
        let later = call
            .roles
            .keys()
            .flat_map(|role| self.offers(role, &context, move |robot, alone| promises.bound(robot, role, alone)));
        let later: Vec<Offer<'_>> = later.collect();
        let chosen = chosen_unasked(call, &responses, &context, &later).unwrap_or_default();
        with_next(chosen, later, of_each_role)
    }

    /// Adds about `count` robots with the least bounds to robots that may have to get a role now.
    pub fn with_best(
        &self,
        chosen: BTreeSet<RobotId>,
        call: &CallForBids,
        context: &AuctionContext<'_>,
        count: usize,
    ) -> BTreeSet<RobotId> {
        let now = call.roles.keys().flat_map(|role| self.offers_now(role, context)).collect();
        with_next(chosen, now, count.div_ceil(call.roles.len().max(1)))
    }

    /// Returns offers of the robots for a role at their bounds.
    pub(super) fn offers_now<'a>(
        &'a self,
        role: &'a RoleId,
        context: &'a AuctionContext<'_>,
    ) -> impl Iterator<Item = Offer<'a>> {
        self.offers(role, context, |_, cost| Some(cost))
    }

    /// Returns offers of the robots that may get a role. `bound` returns the cost of each from its bound by its record.
    fn offers<'a>(
        &'a self,
        role: &'a RoleId,
        context: &'a AuctionContext<'_>,
        bound: impl Fn(&RobotId, f64) -> Option<f64> + 'a,
    ) -> impl Iterator<Item = Offer<'a>> {
        let excluded = context.excluded.get(role);
        let may_get = move |robot: &RobotId| {
            !context.unavailable.contains_key(robot) && !excluded.is_some_and(|robots| robots.contains_key(robot))
        };
        self.0.iter().filter_map(move |(robot, expected)| match expected.get(role)? {
            Expectation::CostsAtLeast(cost) if may_get(robot) => {
                Some(Offer { role, robot, cost: bound(robot, *cost)? })
            }
            Expectation::CostsAtLeast(_) | Expectation::Refuses(_) => None,
        })
    }

    /// Returns the robots for the record of the auction: an entry for each role and reason.
    pub fn entries(&self, unavailable: &BTreeMap<RobotId, RefusalReason>) -> Vec<AuctionEntry> {
        let mut groups: BTreeMap<(&RoleId, NotAskedReason), (f64, BTreeSet<RobotId>)> = BTreeMap::new();
        for (robot, expected) in &self.0 {
            for (role, expectation) in expected {
                let (reason, cost) = match expectation {
                    Expectation::Refuses(reason) => (reason.clone(), 0.0),
                    Expectation::CostsAtLeast(_) if unavailable.contains_key(robot) => (NotAskedReason::Busy, 0.0),
                    Expectation::CostsAtLeast(cost) => (NotAskedReason::NotNeeded, *cost),
                };
                let (cost_min, robots) = groups.entry((role, reason)).or_insert((cost, BTreeSet::new()));
                *cost_min = cost_min.min(cost);
                robots.insert(robot.clone());
            }
        }
        let entry =
            |((role, reason), (cost_min, mut others)): ((&RoleId, NotAskedReason), (f64, BTreeSet<RobotId>))| {
                let robot = others.pop_first()?;
                let verdict = BidVerdict::NotAsked { reason, cost_min, others };
                Some(AuctionEntry { role: role.clone(), robot, verdict, parts: vec![] })
            };
        groups.into_iter().filter_map(entry).collect()
    }
}

/// Returns the robots that were not asked and get a role if each costs as little as its bound; `None` if the roles cannot be
/// filled even then.
fn chosen_unasked(
    call: &CallForBids,
    responses: &[BidResponse],
    context: &AuctionContext<'_>,
    bounds: &[Offer<'_>],
) -> Option<BTreeSet<RobotId>> {
    let objective = call.timelines.objective;
    let viable = viable_bids(call, responses, context);
    let bids = viable.iter().map(|bid| Offer { role: &bid.role, robot: &bid.robot, cost: bid.cost(objective) });
    let offers: Vec<Offer<'_>> = bids.chain(bounds.iter().copied()).collect();
    let roles = call.roles.keys().cloned().collect();
    let chosen = cheapest_assignment(&roles, &BTreeSet::new(), &offers).ok()?;
    let unasked = |index: usize| bounds.get(index.checked_sub(viable.len())?).map(|offer| offer.robot.clone());
    Some(chosen.into_values().filter_map(unasked).collect())
}

/// Adds the first robots of each role in the order of their costs, then of their names.
fn with_next(chosen: BTreeSet<RobotId>, mut offers: Vec<Offer<'_>>, of_each_role: usize) -> BTreeSet<RobotId> {
    if chosen.is_empty() {
        return chosen;
    }
    offers.sort_by(|one, other| {
        one.role.cmp(other.role).then(one.cost.total_cmp(&other.cost)).then(one.robot.cmp(other.robot))
    });
    let first =
        offers.chunk_by(|one, other| one.role == other.role).flat_map(|offers| offers.iter().take(of_each_role));
    chosen.into_iter().chain(first.map(|offer| offer.robot.clone())).collect()
}

#[cfg(test)]
mod tests;
