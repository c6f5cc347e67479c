//! Optimal assignment of robots to roles (Kuhn 1955, Munkres 1957).
//!
//! The assignment minimises the sum of costs, in whole millionths: those of the objective, or the energy. Ties
//! are resolved by the smallest sum of the robots' ranks (in the order of their names). Remaining ties
//! are resolved by the solver. It receives roles and robots in the order of their names, so the result
//! is deterministic.
//!
//! Roles of spread loops may stay open. As many of them as possible are assigned, but at least one.

use super::bid::Bid;
use super::energy_exceeded::EnergyExceeded;
use super::insertion::Objective;
use crate::ids::{RobotId, RoleId};
use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres_min;
use std::borrow::Borrow;
use std::collections::{BTreeMap, BTreeSet};

/// Error: the roles cannot be assigned. No role is assigned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AssignmentError {
    /// Some roles have no viable bid; common in a busy fleet.
    #[error("no viable bid for {}", names(.roles))]
    NoViableBid {
        /// Roles without a viable bid.
        roles: Vec<RoleId>,
    },
    /// Each role has a viable bid, but not from different robots.
    #[error("{} roles cannot be filled by different robots: viable bids came only from {}", .roles.len(), names(.robots))]
    TooFewRobots {
        /// The roles.
        roles: Vec<RoleId>,
        /// Robots with a viable bid for any of the roles.
        robots: Vec<RobotId>,
    },
    /// Every assignment exceeds the bound on the mission's energy.
    #[error(transparent)]
    EnergyExceeded(EnergyExceeded),
    /// An allocator other than the optimal assignment found no robot for some role.
    #[error("no robot is left for a role")]
    NoRobotLeft,
}

fn names<T: std::fmt::Display>(list: &[T]) -> String {
    list.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Selects a bid for each role, by index into `bids`; all bids must be viable. Bids for roles that
/// are not open are ignored. Of several bids by the same robot for the same role the first counts.
/// Bids may be owned or borrowed. The roles in `spread` may stay open.
///
/// # Errors
/// [`AssignmentError`] if not every other role, or no role at all, can be filled by a different robot.
pub fn optimal_assignment<B: Borrow<Bid>>(
    roles: &BTreeSet<RoleId>,
    spread: &BTreeSet<RoleId>,
    bids: &[B],
    objective: Objective,
) -> Result<BTreeMap<RoleId, usize>, AssignmentError> {
    let offers: Vec<Offer<'_>> = bids
        .iter()
        .map(Borrow::borrow)
        .map(|bid: &Bid| Offer { role: &bid.role, robot: &bid.robot, cost: bid.cost(objective) })
        .collect();
    cheapest_assignment(roles, spread, &offers)
}

/// A robot that can take a role, at a cost of 0 or more.
#[derive(Clone, Copy)]
pub(super) struct Offer<'a> {
    pub(super) role: &'a RoleId,
    pub(super) robot: &'a RobotId,
    pub(super) cost: f64,
}

/// Selects an offer for each role with the smallest sum of costs, by index into `offers`. Offers for
/// roles that are not open are ignored. Of several offers of a robot for the same role the first counts.
/// The roles in `spread` may stay open.
///
/// # Errors
/// [`AssignmentError`] if not every other role, or no role at all, can be filled by a different robot.
pub(super) fn cheapest_assignment(
    roles: &BTreeSet<RoleId>,
    spread: &BTreeSet<RoleId>,
    offers: &[Offer<'_>],
) -> Result<BTreeMap<RoleId, usize>, AssignmentError> {
    let robots: BTreeSet<&RobotId> =
        offers.iter().filter(|offer| roles.contains(offer.role)).map(|offer| offer.robot).collect();
    let columns: BTreeMap<&RobotId, usize> = robots.iter().enumerate().map(|(rank, robot)| (*robot, rank)).collect();
    let rows: BTreeMap<&RoleId, usize> = roles.iter().enumerate().map(|(row, role)| (role, row)).collect();

    let mut costs_by_pair: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (index, offer) in offers.iter().enumerate() {
        if let Some(&row) = rows.get(offer.role) {
            costs_by_pair.entry((row, columns[offer.robot])).or_insert(index);
        }
    }
    if roles.is_empty() {
        return Ok(BTreeMap::new());
    }
    let bid_for: BTreeSet<usize> = costs_by_pair.keys().map(|(row, _)| *row).collect();
    let lacks_bid = |(role, row): &(&&RoleId, &usize)| !bid_for.contains(row) && !spread.contains(**role);
    let without: Vec<RoleId> = rows.iter().filter(lacks_bid).map(|(role, _)| (*role).clone()).collect();
    if !without.is_empty() || bid_for.is_empty() {
        let roles = if without.is_empty() { roles.iter().cloned().collect() } else { without };
        return Err(AssignmentError::NoViableBid { roles });
    }
    let too_few = || AssignmentError::TooFewRobots {
        roles: roles.iter().cloned().collect(),
        robots: robots.iter().map(|robot| (*robot).clone()).collect(),
    };
    // A role that may stay open has a column of its own, which leaves it open.
    let open_columns: BTreeMap<usize, usize> =
        rows.iter().filter(|(role, _)| spread.contains(**role)).map(|(_, row)| *row).zip(robots.len()..).collect();
    if robots.len() + open_columns.len() < roles.len() {
        return Err(too_few());
    }

    // The sum of ranks weighs less than a millionth. No assignment costs as much as an open role, nor as an
    // impossible pair, with any number of open roles.
    let millionth = i128::try_from(robots.len() * roles.len() + 1).expect("the sizes of a fleet fit 128 bits");
    let cost = |index: usize, column: usize| {
        (offers[index].cost * 1e6).round() as i128 * millionth
            + i128::try_from(column).expect("the sizes of a fleet fit 128 bits")
    };
    let largest_cost = costs_by_pair.iter().map(|((_, column), index)| cost(*index, *column)).max().unwrap_or(0);
    let all = i128::try_from(roles.len() + 1).expect("the sizes of a fleet fit 128 bits");
    let open = (largest_cost + 1) * all;
    let impossible = if open_columns.is_empty() { open } else { open * all };
    let mut weights = Matrix::new(roles.len(), robots.len() + open_columns.len(), impossible);
    for (&(row, column), &index) in &costs_by_pair {
        weights[(row, column)] = cost(index, column);
    }
    for (&row, &column) in &open_columns {
        weights[(row, column)] = open;
    }
    let (_, assignment) = kuhn_munkres_min(&weights);
    roles
        .iter()
        .zip(assignment)
        .enumerate()
        .filter(|(row, (_, column))| open_columns.get(row) != Some(column))
        .map(|(row, (role, column))| {
            costs_by_pair.get(&(row, column)).map(|index| (role.clone(), *index)).ok_or_else(too_few)
        })
        .collect()
}

#[cfg(test)]
mod tests;
