//! The rule by which roles are given to robots, once all answers are in.
//!
//! A fleet uses [`Exact`]. Others are for evaluations, which compare what comes of them: the rule is all that differs.

use super::assignment::optimal_assignment;
use super::bid::{Bid, BidLimits, CallForBids};
use crate::ids::{RobotId, RoleId};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// What there is to choose from.
#[derive(Debug, Clone, Copy)]
pub struct AllocatorInput<'a> {
    /// What was asked.
    pub call: &'a CallForBids,
    /// For each role of the call, who answered and could be given it: robots that hold no other role and have not failed at
    /// this one. Whether they have the skills and the charge for it is another matter.
    pub candidates: &'a BTreeMap<RoleId, BTreeSet<RobotId>>,
    /// The bids of those, viable or not, by role and robot.
    pub bids: &'a [&'a Bid],
    /// The bids among them that keep to the limits.
    pub viable: &'a [&'a Bid],
    /// The limits.
    pub limits: &'a BidLimits,
}

/// A rule. Asked twice about one ballot, it answers the same.
pub trait Allocator: fmt::Debug + Send + Sync {
    /// Gives every role of the call to a robot of its own out of [`Ballot::open`].
    ///
    /// # Errors
    /// Why not, for people; nobody gets anything then.
    fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String>;
}

/// The exact assignment of [`select`](super::select()).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OptimalAssignment;

impl Allocator for OptimalAssignment {
    fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
        let roles = ballot.call.roles.keys().cloned().collect();
        let picks = optimal_assignment(&roles, ballot.viable).map_err(|problem| problem.to_string())?;
        Ok(picks.into_iter().map(|(role, index)| (role, ballot.viable[index].robot.clone())).collect())
    }
}
