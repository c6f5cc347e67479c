//! A copy of the ledger is what its log says: no more, no less.
//!
//! Entries are the same everywhere ([`committed`](super::committed)); so must be what they add up to, whether a copy was kept
//! from the first entry on, read from a disk after a restart, or handed over as a snapshot.

use super::Invariant;
use super::reference_ledger::ReferenceLedger;
use crate::{Fleet, Observation};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Replayed {
    reference: ReferenceLedger,
}

impl Replayed {
    /// Compares all copies that are as far as the log is known.
    fn compare(&self, fleet: &Fleet) -> Result<(), String> {
        for (name, node) in &fleet.nodes {
            let Some(replica) = &node.replica else { continue };
            if replica.applied().borrow().index != self.reference.index {
                continue;
            }
            let astray = replica.read(|ledger| {
                let differs = self.reference.ledger.missions().find(|entry| ledger.mission(&entry.id) != Some(*entry));
                (*ledger != self.reference.ledger)
                    .then(|| differs.map(|entry| (entry, ledger.mission(&entry.id).cloned())))
            });
            match astray {
                None => {}
                Some(Some((entry, found))) => {
                    let (said, has) =
                        (format!("{:?} {:?}", entry.state, entry.roles), found.map(|f| (f.state, f.roles)));
                    return Err(format!("the ledger of {name} has {has:?} for {}, and the log says {said}", entry.id));
                }
                Some(None) => return Err(format!("the ledger of {name} has what its log does not say")),
            }
        }
        Ok(())
    }
}

impl Invariant for Replayed {
    fn name(&self) -> &'static str {
        "replayed"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), String> {
        self.reference.observe(entry);
        match entry {
            Observation::LeadershipChanged { leading_as: Some(_), .. } => self.compare(fleet),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), String> {
        self.compare(fleet)
    }
}
