//! Everything that the coordinator confirms to a robot is in the ledger.
//!
//! A role begins only under a committed award. A robot halts a finished role only after some
//! replica contains the end of the role, because a report is committed before it is acknowledged.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{Ledger, RolePhase};
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Settled {
    /// Applied positions of the log.
    applied: BTreeSet<(u64, u64)>,
    /// Roles that had ended on some replica, which may have been killed since.
    over: BTreeSet<(MissionId, RoleId)>,
}

impl Invariant for Settled {
    fn name(&self) -> &'static str {
        "settled"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if let Observation::EntryApplied { at, .. } = entry {
            self.applied.insert((at.index, at.term));
        }
        let node = entry.node();
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, epoch }) if !self.applied.contains(&(epoch.index, epoch.term)) => {
                return Err(
                    format!("{node} begins {role} of {mission} under {epoch}, which was never committed").into()
                );
            }
            Some(EventKind::Halted { mission, role, reason: EndReason::Over }) => {
                let part = (mission.clone(), role.clone());
                let over = |ledger: &Ledger| {
                    ledger.mission(mission).is_none_or(|entry| {
                        entry.state.is_final() || entry.roles.get(role).is_none_or(|r| r.phase == RolePhase::Ended)
                    })
                };
                let somewhere = fleet.nodes.values().filter_map(|node| node.replica.as_ref()).any(|r| r.read(over));
                if somewhere {
                    self.over.insert(part);
                } else if !self.over.contains(&part) {
                    return Err(format!(
                        "{node} halted {role} of {mission} as ended, but it has not ended in any ledger"
                    )
                    .into());
                }
            }
            _ => {}
        }
        Ok(())
    }
}
