//! What a robot was told of the ledger is in the ledger.
//!
//! A role is begun only under an award that was committed. And a robot that puts its role down because it was carried out
//! may do so only once some copy of the ledger says the same: what was reported is written down before it is acknowledged.

use super::Invariant;
use crate::{Entry, Fleet};
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Ending;
use consort_protocol::ledger::{Ledger, RolePhase};
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Settled {
    /// Places of the log that some copy has taken in.
    applied: BTreeSet<(u64, u64)>,
    /// Roles that were seen to be over on a copy that may have been killed since.
    over: BTreeSet<(MissionId, RoleId)>,
}

impl Invariant for Settled {
    fn name(&self) -> &'static str {
        "settled"
    }

    fn see(&mut self, _: Duration, entry: &Entry, fleet: &Fleet) -> Result<(), String> {
        if let Entry::Applied { at, .. } = entry {
            self.applied.insert((at.index, at.term));
        }
        let node = entry.node();
        match entry.happening() {
            Some(Happening::Started { mission, role, epoch }) if !self.applied.contains(&(epoch.index, epoch.term)) => {
                return Err(format!("{node} begins {role} of {mission} under {epoch}, which was never committed"));
            }
            Some(Happening::Halted { mission, role, reason: Ending::Over }) => {
                let part = (mission.clone(), role.clone());
                let over = |ledger: &Ledger| {
                    ledger.mission(mission).is_none_or(|entry| {
                        entry.state.is_end() || entry.roles.get(role).is_none_or(|r| r.phase == RolePhase::Ended)
                    })
                };
                let somewhere = fleet.nodes.values().filter_map(|node| node.replica.as_ref()).any(|r| r.read(over));
                if somewhere {
                    self.over.insert(part);
                } else if !self.over.contains(&part) {
                    return Err(format!("{node} was told that {role} of {mission} is over, which no ledger says"));
                }
            }
            _ => {}
        }
        Ok(())
    }
}
