//! Allocation of missions that are auctioned together.
//!
//! If auctions are cleared one after the other, the first mission may get a robot that it hardly needs: another robot would
//! cost it a little more, and the second mission a lot less. So auctions that are open at the same time are allocated together:
//! the sum of the costs of all their roles is minimal (the module `assignment`). A mission that cannot be filled with free robots
//! beside the missions before it is left out, and cleared by itself.

use super::assignment::{Offer, cheapest_assignment};
use super::bid::{Bid, BidResponse, CallForBids};
use super::candidates::Candidates;
use super::clearing::{AuctionContext, viable_bids};
use crate::ids::{RobotId, RoleId};
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of roles that are allocated together: the time grows with the square of their number.
const JOINT_ROLES_MAX: usize = 32;

/// Auction with all its bids.
#[derive(Debug, Clone)]
pub struct OpenAuction<'a> {
    /// Call for bids.
    pub call: &'a CallForBids,
    /// Replies to it.
    pub responses: &'a [BidResponse],
    /// Inputs of its clearing.
    pub context: AuctionContext<'a>,
    /// Robots that were not asked, with their bounds.
    pub candidates: &'a Candidates,
}

/// Returns the number of calls, from the first one on, whose missions are allocated together.
pub fn joint_count<'a>(calls: impl IntoIterator<Item = &'a CallForBids>) -> usize {
    let mut roles = 0;
    let fits = |call: &&CallForBids| {
        roles += call.roles.len();
        roles <= JOINT_ROLES_MAX
    };
    calls.into_iter().take_while(fits).count()
}

/// Returns the robots of each auction in the allocation of all, in the order of the missions; none for an auction that is left
/// out. There are at most [`joint_count`] auctions. A robot that was not asked counts with its bound: an allocation with such
/// robots holds once they have been asked.
pub fn allocate_together(auctions: &[OpenAuction<'_>]) -> Vec<BTreeMap<RoleId, RobotId>> {
    let bids: Vec<Vec<&Bid>> =
        auctions.iter().map(|auction| viable_bids(auction.call, auction.responses, &auction.context)).collect();
    let is_by_cost = |auction: &OpenAuction<'_>| auction.context.is_by_cost(auction.call);
    let members: Vec<usize> = (0..auctions.len()).filter(|index| is_by_cost(&auctions[*index])).collect();
    if let Some(all) = assign(auctions, &bids, &members) {
        return all;
    }
    let (mut filled, mut allocation) = (vec![], vec![BTreeMap::new(); auctions.len()]);
    for member in members {
        filled.push(member);
        match assign(auctions, &bids, &filled) {
            Some(more) => allocation = more,
            None => drop(filled.pop()),
        }
    }
    allocation
}

/// Assigns the roles of these auctions; `None` if not all of them can be filled.
fn assign(
    auctions: &[OpenAuction<'_>],
    bids: &[Vec<&Bid>],
    members: &[usize],
) -> Option<Vec<BTreeMap<RoleId, RobotId>>> {
    let of_member = |member: usize| auctions[member].call.roles.keys().map(move |role| (member, role));
    let roles: Vec<(usize, &RoleId)> = members.iter().copied().flat_map(of_member).collect();
    // Roles of several missions may have the same name.
    let name = |number: usize| RoleId::new(format!("r{number:03}")).expect("a letter and digits form a slug");
    let names: Vec<RoleId> = (0..roles.len()).map(name).collect();
    let mut offers = vec![];
    let mut numbers = vec![];
    for (number, (member, role)) in roles.iter().enumerate() {
        let objective = auctions[*member].call.timelines.objective;
        for bid in bids[*member].iter().filter(|bid| bid.role == **role) {
            offers.push(Offer { role: &names[number], robot: &bid.robot, cost: bid.cost(objective) });
            numbers.push(number);
        }
        let OpenAuction { candidates, context, .. } = &auctions[*member];
        for offer in candidates.offers_now(role, context) {
            offers.push(Offer { role: &names[number], ..offer });
            numbers.push(number);
        }
    }
    let chosen = cheapest_assignment(&names.iter().cloned().collect(), &BTreeSet::new(), &offers).ok()?;
    let mut allocation = vec![BTreeMap::new(); auctions.len()];
    for index in chosen.into_values() {
        let (member, role) = roles[numbers[index]];
        allocation[member].insert(role.clone(), offers[index].robot.clone());
    }
    Some(allocation)
}

#[cfg(test)]
mod tests;
