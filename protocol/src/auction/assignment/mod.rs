//! Optimal assignment of robots to roles (Kuhn 1955, Munkres 1957).
//!
//! The assignment minimises the sum of costs, in whole millionths: the bids' times, or the energy. Ties
//! are resolved by the smallest sum of the robots' ranks (in the order of their names). Remaining ties
//! are resolved by the solver. It receives roles and robots in the order of their names, so the result
//! is deterministic.

use super::bid::Bid;
use super::energy_exceeded::EnergyExceeded;
use crate::ids::{RobotId, RoleId};
use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres_min;
use std::borrow::Borrow;
use std::collections::{BTreeMap, BTreeSet};

/// Error: the roles cannot be assigned. No role is assigned: a mission is filled completely or not
/// at all.
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
/// Bids may be owned or borrowed.
///
/// # Errors
/// [`AssignmentError`] if not every role can be filled by a different robot.
pub fn optimal_assignment<B: Borrow<Bid>>(
    roles: &BTreeSet<RoleId>,
    bids: &[B],
) -> Result<BTreeMap<RoleId, usize>, AssignmentError> {
    let offers: Vec<Offer<'_>> = bids
        .iter()
        .map(Borrow::borrow)
        .map(|bid: &Bid| Offer { role: &bid.role, robot: &bid.robot, cost: bid.time.get() })
        .collect();
    cheapest_assignment(roles, &offers)
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
///
/// # Errors
/// [`AssignmentError`] if not every role can be filled by a different robot.
pub(super) fn cheapest_assignment(
    roles: &BTreeSet<RoleId>,
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
    let bid_for: BTreeSet<usize> = costs_by_pair.keys().map(|(row, _)| *row).collect();
    if bid_for.len() < roles.len() {
        let roles = rows.iter().filter(|(_, row)| !bid_for.contains(row)).map(|(role, _)| (*role).clone()).collect();
        return Err(AssignmentError::NoViableBid { roles });
    }
    let too_few = || AssignmentError::TooFewRobots {
        roles: roles.iter().cloned().collect(),
        robots: robots.iter().map(|robot| (*robot).clone()).collect(),
    };
    if robots.len() < roles.len() {
        return Err(too_few());
    }
    if roles.is_empty() {
        return Ok(BTreeMap::new());
    }

    // The sum of ranks weighs less than a millionth, and no feasible assignment costs as much as
    // an impossible pair.
    let millionth = i128::try_from(robots.len() * roles.len() + 1).expect("the sizes of a fleet fit 128 bits");
    let cost = |index: usize, column: usize| {
        (offers[index].cost * 1e6).round() as i128 * millionth
            + i128::try_from(column).expect("the sizes of a fleet fit 128 bits")
    };
    let largest_cost = costs_by_pair.iter().map(|((_, column), index)| cost(*index, *column)).max().unwrap_or(0);
    let impossible = (largest_cost + 1) * i128::try_from(roles.len() + 1).expect("the sizes of a fleet fit 128 bits");
    let mut weights = Matrix::new(roles.len(), robots.len(), impossible);
    for (&(row, column), &index) in &costs_by_pair {
        weights[(row, column)] = cost(index, column);
    }
    let (_, assignment) = kuhn_munkres_min(&weights);
    roles
        .iter()
        .zip(assignment)
        .enumerate()
        .map(|(row, (role, column))| {
            costs_by_pair.get(&(row, column)).map(|index| (role.clone(), *index)).ok_or_else(too_few)
        })
        .collect()
}

#[cfg(test)]
mod tests;
