//! A replica equals the result of its log.
//!
//! Entries are the same everywhere ([`committed`](super::committed)). So the resulting ledgers must
//! be equal, no matter whether a replica applied all entries, was read from a disk after a restart,
//! or was received as a snapshot.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Replayed {
    reference: ReferenceLedger,
}

impl Replayed {
    /// Compares all replicas that have applied the known log.
    fn compare(&self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        for (name, node) in &fleet.nodes {
            let Some(replica) = &node.replica else { continue };
            if replica.applied().borrow().index != self.reference.index {
                continue;
            }
            let difference = replica.read(|ledger| {
                let differs = self.reference.ledger.missions().find(|entry| ledger.mission(&entry.id) != Some(*entry));
                (*ledger != self.reference.ledger)
                    .then(|| differs.map(|entry| (entry, ledger.mission(&entry.id).cloned())))
            });
            match difference {
                None => {}
                Some(Some((entry, found))) => {
                    let (expected, actual) =
                        (format!("{:?} {:?}", entry.state, entry.roles), found.map(|f| (f.state, f.roles)));
                    return Err(format!(
                        "the ledger of {name} has {actual:?} for {}, but the log contains {expected}",
                        entry.id
                    )
                    .into());
                }
                Some(None) => return Err(format!("the ledger of {name} differs from its log").into()),
            }
        }
        Ok(())
    }
}

impl Invariant for Replayed {
    fn name(&self) -> &'static str {
        "replayed"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        match entry {
            Observation::LeadershipChanged { leading_as: Some(_), .. } => self.compare(fleet),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        self.compare(fleet)
    }
}
