//! Allocators: rules that assign roles to robots after all replies have arrived.
//!
//! A fleet uses [`OptimalAssignment`]. Evaluations use other allocators and compare their results;
//! the allocator is the only difference.

use super::assignment::{AssignmentError, optimal_assignment};
use super::bid::{Bid, BidLimits, CallForBids};
use crate::ids::{RobotId, RoleId};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Input of an allocator.
#[derive(Debug, Clone, Copy)]
pub struct AllocatorInput<'a> {
    /// Call for bids.
    pub call: &'a CallForBids,
    /// Robots that replied and may get the role, for each role of the call: they hold no other role
    /// and have not failed at this role. They may lack the skills or the charge for it.
    pub candidates: &'a BTreeMap<RoleId, BTreeSet<RobotId>>,
    /// Bids of these robots, viable or not, by role and robot.
    pub bids: &'a [&'a Bid],
    /// Bids within the limits.
    pub viable: &'a [&'a Bid],
    /// Limits for bids.
    pub limits: &'a BidLimits,
}

/// Allocator. Deterministic: the same input gives the same result.
pub trait Allocator: fmt::Debug + Send + Sync {
    /// Assigns every role of the call to a different robot from [`AllocatorInput::candidates`]. Roles of spread
    /// loops may stay open.
    ///
    /// # Errors
    /// [`AssignmentError`] if the roles cannot be assigned; then no role is assigned.
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError>;

    /// Checks whether missions that are auctioned at the same time are allocated together first
    /// ([`allocate_together`](super::allocate_together)). Then the allocator minimises the sum of the costs, too.
    fn allocates_together(&self) -> bool {
        false
    }
}

/// Optimal assignment of [`optimal_assignment`](super::optimal_assignment()).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OptimalAssignment;

impl Allocator for OptimalAssignment {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let roles = input.call.roles.keys().cloned().collect();
        let picks = optimal_assignment(&roles, &input.call.spread, input.viable, input.call.timelines.objective)?;
        Ok(picks.into_iter().map(|(role, index)| (role, input.viable[index].robot.clone())).collect())
    }

    fn allocates_together(&self) -> bool {
        true
    }
}
