//! Holders and awards of a mission's roles, as known to the holder of another role.

use consort_protocol::ids::RoleId;
use consort_protocol::lease::{Epoch, RoleHolder};
use consort_protocol::mission::TaskSpec;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// The signal was sent under an award that is no longer in force. It is ignored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct StaleSignal {
    /// Latest known award of the sending role.
    pub(crate) current: Epoch,
}

/// Holders of the managed roles of a mission, and their latest awards.
#[derive(Debug, Clone)]
pub(super) struct RoleAwards {
    holders: BTreeMap<RoleId, RoleHolder>,
    /// Latest known award of each role that has been held or is to be held. The default epoch means
    /// not yet awarded. A role in this map without a holder is about to be awarded.
    latest: BTreeMap<RoleId, Epoch>,
}

impl RoleAwards {
    pub(super) fn new(holders: BTreeMap<RoleId, RoleHolder>) -> RoleAwards {
        let latest = holders.iter().map(|(role, holding)| (role.clone(), holding.epoch)).collect();
        RoleAwards { holders, latest }
    }

    pub(super) fn holders(&self) -> &BTreeMap<RoleId, RoleHolder> {
        &self.holders
    }

    /// Checks whether a task names a role without a holder.
    pub(super) fn names_vacant_role(&self, spec: &TaskSpec) -> bool {
        let mut vacant = self.latest.keys().filter(|role| !self.holders.contains_key(*role));
        vacant.any(|role| spec.roles.contains(role) || spec.parameters.values().any(|value| value == role.as_str()))
    }

    /// Updates the holders. Returns the roles with a new holder or a new award.
    pub(super) fn set_holders(&mut self, holders: BTreeMap<RoleId, RoleHolder>) -> Vec<RoleId> {
        let mut changed = vec![];
        for (role, holding) in &holders {
            let latest = self.latest.entry(role.clone()).or_insert(holding.epoch);
            if *latest < holding.epoch {
                *latest = holding.epoch;
                changed.push(role.clone());
            }
        }
        self.holders = holders;
        changed
    }

    /// Adds roles without a holder.
    pub(super) fn set_vacant_roles(&mut self, vacant: &BTreeSet<RoleId>) {
        for role in vacant {
            self.latest.entry(role.clone()).or_default();
        }
    }

    /// Checks the epoch of a signal. Returns true if it is newer than the latest known award: the
    /// signal of the new holder has arrived before the notice of its award.
    ///
    /// # Errors
    /// [`StaleSignal`] if a later award of the sending role is known.
    pub(super) fn check_signal(&mut self, from: &RoleId, epoch: Epoch) -> Result<bool, StaleSignal> {
        // Unmanaged roles have no award.
        let Some(latest) = self.latest.get_mut(from) else { return Ok(false) };
        match epoch.cmp(latest) {
            Ordering::Less => Err(StaleSignal { current: *latest }),
            Ordering::Equal => Ok(false),
            Ordering::Greater => {
                *latest = epoch;
                Ok(true)
            }
        }
    }
}
