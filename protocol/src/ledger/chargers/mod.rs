//! Leases of chargers in the ledger: a charger has a single lease, and a robot at most one.
//!
//! The coordinator proposes them by the records of the robots ([`ChargerLeases`](crate::chargers::ChargerLeases)). A
//! lease is renewed by no entry, so the ledger changes only with a grant and with its end.

use super::apply::Ledger;
use super::charger_lease::{CHARGER_LEASE_BYTES_MAX, CHARGER_LEASES_BYTES_MAX, ChargerLease};
use super::command::CommandOutcome;
use super::command_error::CommandError;
use super::history::HISTORY_SINCE;
use crate::codec;
use crate::ids::{PlaceId, RobotId};
use crate::lease::Epoch;

impl Ledger {
    /// Checks whether the fleet writes a wire version with leases of chargers.
    pub fn leases_chargers(&self) -> bool {
        self.keeps_history()
    }

    /// Checks whether there is room for a lease with names of any length.
    pub fn has_room_for_charger_lease(&self) -> bool {
        let bytes = codec::encoded_size(self.charger_leases());
        bytes.saturating_add(CHARGER_LEASE_BYTES_MAX) <= CHARGER_LEASES_BYTES_MAX
    }

    /// Leases a charger to a robot. A repetition is refused, so that each lease is published once.
    pub(super) fn lease_charger(
        &mut self,
        charger: PlaceId,
        robot: RobotId,
        since_ms: u64,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        if !self.leases_chargers() {
            return Err(CommandError::NoOrdersYet { since: HISTORY_SINCE });
        }
        let leases = self.charger_leases_mut();
        if let Some((charger, lease)) =
            leases.iter().find(|(leased, lease)| **leased == charger || lease.robot == robot)
        {
            return Err(CommandError::ChargerLeased { charger: charger.clone(), robot: lease.robot.clone() });
        }
        let mut changed = leases.clone();
        changed.insert(charger, ChargerLease { robot, epoch: at, since_ms });
        if codec::encoded_size(&changed) > CHARGER_LEASES_BYTES_MAX {
            return Err(CommandError::ChargerLeasesFull);
        }
        *leases = changed;
        Ok(CommandOutcome::Done)
    }

    /// Ends a lease.
    pub(super) fn free_charger(&mut self, charger: &PlaceId, epoch: Epoch) -> Result<CommandOutcome, CommandError> {
        let leases = self.charger_leases_mut();
        if leases.get(charger).is_none_or(|lease| lease.epoch != epoch) {
            return Err(CommandError::NoChargerLease { charger: charger.clone(), epoch });
        }
        leases.remove(charger);
        Ok(CommandOutcome::Done)
    }
}

#[cfg(test)]
mod tests;
