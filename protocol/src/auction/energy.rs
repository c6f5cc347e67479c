//! Bound on the energy of a mission, over all its robots and awards together.
//!
//! The bound is compared with estimates: those of the bids, and those of the awards so far. An auction
//! takes the fastest assignment if it is within the bound, otherwise the one with the least energy.

use super::assignment::{AssignmentError, Offer, cheapest_assignment};
use super::bid::Bid;
use super::energy_exceeded::EnergyExceeded;
use crate::ids::{RobotId, RoleId};
use crate::units::{Energy, EnergyLimit};
use std::collections::{BTreeMap, BTreeSet};

/// Bound on the energy of a mission, and the part of it that awards have used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EnergyBudget {
    /// The bound.
    pub limit: EnergyLimit,
    /// Estimated energy of the awards so far.
    pub used: Energy,
}

/// A robot that may get a role, with the energy that it needs at least.
pub(super) struct EnergyOffer<'a> {
    pub(super) role: &'a RoleId,
    pub(super) robot: &'a RobotId,
    pub(super) energy: Energy,
}

impl EnergyBudget {
    /// Checks whether the open roles may use this energy. Differences of rounding do not count.
    fn admits(&self, energy: Energy) -> bool {
        (self.used + energy).get() <= self.limit.get() + 1e-9
    }

    /// Returns `holders` if their bids are within the bound, otherwise the assignment with the least
    /// energy.
    ///
    /// # Errors
    /// [`AssignmentError::EnergyExceeded`] if no assignment is within the bound.
    pub(super) fn restrict(
        &self,
        holders: BTreeMap<RoleId, RobotId>,
        viable: &[&Bid],
    ) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let energy_of = |(role, robot): (&RoleId, &RobotId)| {
            let bid = viable.iter().find(|bid| bid.role == *role && bid.robot == *robot);
            bid.map_or(Energy::ZERO, |bid| Energy::of_share(bid.energy))
        };
        if self.admits(holders.iter().map(energy_of).sum()) {
            return Ok(holders);
        }
        let roles = holders.keys().cloned().collect();
        let offers = viable.iter().map(|bid| EnergyOffer {
            role: &bid.role,
            robot: &bid.robot,
            energy: Energy::of_share(bid.energy),
        });
        self.least(&roles, &offers.collect::<Vec<_>>())?.map_err(AssignmentError::EnergyExceeded)
    }

    /// Returns the assignment with the least energy, or the excess if it is not within the bound.
    ///
    /// # Errors
    /// [`AssignmentError`] if not every role can be filled by a different robot.
    pub(super) fn least(
        &self,
        roles: &BTreeSet<RoleId>,
        offers: &[EnergyOffer<'_>],
    ) -> Result<Result<BTreeMap<RoleId, RobotId>, EnergyExceeded>, AssignmentError> {
        let costs: Vec<Offer<'_>> = offers
            .iter()
            .map(|offer| Offer { role: offer.role, robot: offer.robot, cost: offer.energy.get() })
            .collect();
        let picks = cheapest_assignment(roles, &BTreeSet::new(), &costs)?;
        let least: Energy = picks.values().map(|index| offers[*index].energy).sum();
        let holders = picks.into_iter().map(|(role, index)| (role, offers[index].robot.clone())).collect();
        Ok(match self.admits(least) {
            true => Ok(holders),
            false => Err(EnergyExceeded { limit: self.limit, used: self.used, least, holders }),
        })
    }
}
