//! Holders and awards of a mission's roles, as known to the holder of another role.

use consort_bus::Author;
use consort_protocol::ids::{RobotId, RoleId};
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

/// Result of checking the sender of a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SignalCheck {
    /// Sent by the holder of the role.
    Valid,
    /// Sent under an award that the coordinator has not confirmed to this robot.
    Unconfirmed,
    /// Not sent by the holder of the role.
    Foreign,
    /// Said to be of a person. Only the ledger proves it.
    OfPerson,
}

/// Holders of the managed roles of a mission, and their latest awards. All of it comes from the
/// coordinator.
#[derive(Debug, Clone)]
pub(super) struct RoleAwards {
    holders: BTreeMap<RoleId, RoleHolder>,
    /// Latest award of each role that has been held or is to be held; `None` before the first. A
    /// role in this map without a holder is about to be awarded.
    latest: BTreeMap<RoleId, Option<RoleHolder>>,
}

impl RoleAwards {
    pub(super) fn new(holders: BTreeMap<RoleId, RoleHolder>) -> RoleAwards {
        let latest = holders.iter().map(|(role, holding)| (role.clone(), Some(holding.clone()))).collect();
        RoleAwards { holders, latest }
    }

    /// Returns the robots that hold the roles.
    pub(super) fn robots(&self) -> BTreeMap<RoleId, RobotId> {
        RoleHolder::robots(&self.holders)
    }

    /// Checks whether a task names a role without a holder.
    pub(super) fn names_vacant_role(&self, spec: &TaskSpec) -> bool {
        let mut vacant = self.latest.keys().filter(|role| !self.holders.contains_key(*role));
        vacant.any(|role| spec.names(role))
    }

    /// Updates the holders. Returns the roles with a new holder or a new award.
    pub(super) fn set_holders(&mut self, holders: BTreeMap<RoleId, RoleHolder>) -> Vec<RoleId> {
        let mut changed = vec![];
        for (role, holding) in &holders {
            let latest = self.latest.entry(role.clone()).or_insert_with(|| Some(holding.clone()));
            if latest.as_ref().is_none_or(|latest| latest.epoch < holding.epoch) {
                *latest = Some(holding.clone());
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

    /// Checks the epoch and the author of a signal.
    ///
    /// # Errors
    /// [`StaleSignal`] if a later award of the sending role is known.
    pub(super) fn check_signal(
        &self,
        from: &RoleId,
        epoch: Epoch,
        author: &Author,
    ) -> Result<SignalCheck, StaleSignal> {
        if !self.latest.contains_key(from) && epoch == Epoch::default() {
            return Ok(SignalCheck::OfPerson);
        }
        let Some(Some(RoleHolder { robot, epoch: latest })) = self.latest.get(from) else {
            return Ok(SignalCheck::Unconfirmed);
        };
        match epoch.cmp(latest) {
            Ordering::Less => Err(StaleSignal { current: *latest }),
            Ordering::Equal if author.may_be(robot.as_str()) => Ok(SignalCheck::Valid),
            Ordering::Equal => Ok(SignalCheck::Foreign),
            Ordering::Greater => Ok(SignalCheck::Unconfirmed),
        }
    }
}
