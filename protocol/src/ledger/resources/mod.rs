//! Leases of chargers and devices in the ledger: each has a single lease, and a robot that of at most one charger.
//!
//! The coordinator proposes them by the records of the robots ([`ChargerLeases`](crate::chargers::ChargerLeases),
//! [`DeviceLeases`](crate::devices::DeviceLeases)). A lease is renewed by no entry, so the ledger changes only with a grant
//! and with its end.

use super::apply::Ledger;
use super::command::CommandOutcome;
use super::command_error::CommandError;
use super::history::HISTORY_SINCE;
use super::resource_lease::{RESOURCE_LEASE_BYTES_MAX, RESOURCE_LEASES_BYTES_MAX, Resource, ResourceLease};
use crate::codec;
use crate::ids::{DeviceId, PlaceId, RobotId};
use crate::lease::Epoch;
use std::collections::BTreeMap;

impl Ledger {
    /// Checks whether the fleet writes a wire version with leases of resources.
    pub fn leases_resources(&self) -> bool {
        self.keeps_history()
    }

    /// Checks whether there is room for a lease with names of any length.
    pub fn has_room_for_lease(&self) -> bool {
        let bytes = codec::encoded_size(self.resource_leases());
        bytes.saturating_add(RESOURCE_LEASE_BYTES_MAX) <= RESOURCE_LEASES_BYTES_MAX
    }

    /// Returns the leases of chargers.
    pub fn charger_leases(&self) -> BTreeMap<PlaceId, ResourceLease> {
        let of_charger = |(resource, lease): (&Resource, &ResourceLease)| match resource {
            Resource::Charger(place) => Some((place.clone(), lease.clone())),
            Resource::Device(_) => None,
        };
        self.resource_leases().iter().filter_map(of_charger).collect()
    }

    /// Returns the leases of devices.
    pub fn device_leases(&self) -> BTreeMap<DeviceId, ResourceLease> {
        let of_device = |(resource, lease): (&Resource, &ResourceLease)| match resource {
            Resource::Device(device) => Some((device.clone(), lease.clone())),
            Resource::Charger(_) => None,
        };
        self.resource_leases().iter().filter_map(of_device).collect()
    }

    /// Leases a resource to a robot. A repetition is refused, so that each lease is published once.
    pub(super) fn lease_resource(
        &mut self,
        resource: Resource,
        robot: RobotId,
        since_ms: u64,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        if !self.leases_resources() {
            return Err(CommandError::NoOrdersYet { since: HISTORY_SINCE });
        }
        let leases = self.resource_leases_mut();
        let is_taken = |(leased, lease): &(&Resource, &ResourceLease)| {
            **leased == resource || lease.robot == robot && leased.excludes(&resource)
        };
        if let Some((resource, lease)) = leases.iter().find(is_taken) {
            return Err(CommandError::ResourceLeased { resource: resource.clone(), robot: lease.robot.clone() });
        }
        let mut changed = leases.clone();
        changed.insert(resource, ResourceLease { robot, epoch: at, since_ms });
        if codec::encoded_size(&changed) > RESOURCE_LEASES_BYTES_MAX {
            return Err(CommandError::ResourceLeasesFull);
        }
        *leases = changed;
        Ok(CommandOutcome::Done)
    }

    /// Ends a lease.
    pub(super) fn free_resource(&mut self, resource: &Resource, epoch: Epoch) -> Result<CommandOutcome, CommandError> {
        let leases = self.resource_leases_mut();
        if leases.get(resource).is_none_or(|lease| lease.epoch != epoch) {
            return Err(CommandError::NoResourceLease { resource: resource.clone(), epoch });
        }
        leases.remove(resource);
        Ok(CommandOutcome::Done)
    }
}

#[cfg(test)]
mod tests;
