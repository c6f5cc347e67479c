//! Everything that the coordinator confirms to a robot is in the ledger.
//!
//! A role begins only under a committed award. A robot halts a finished role only after some
//! replica has contained the end of the role, because a report is committed before it is
//! acknowledged. The replica may have been killed since.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::RolePhase;
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Settled {
    /// Applied positions of the log.
    applied: BTreeSet<(u64, u64)>,
    reference: ReferenceLedger,
}

impl Invariant for Settled {
    fn name(&self) -> &'static str {
        "settled"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
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
                let has_ended = self.reference.ledger.mission(mission).is_none_or(|entry| {
                    entry.state.is_final() || entry.roles.get(role).is_none_or(|role| role.phase == RolePhase::Ended)
                });
                if !has_ended {
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
