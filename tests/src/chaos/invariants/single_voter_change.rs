//! Who keeps the ledger changes one at a time: no change takes more than one voter out.

use super::Invariant;
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct SingleVoterChange {
    /// The voters, as the last coordinator told them that was elected or has changed them.
    voters: BTreeSet<NodeId>,
}

impl Invariant for SingleVoterChange {
    fn name(&self) -> &'static str {
        "keepers"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), String> {
        match entry.event_kind() {
            // Elected in the midst of a change, it may know of the former and the later ones together, and completes it.
            Some(EventKind::Elected { voters, .. }) => {
                self.voters = voters.iter().cloned().collect();
                Ok(())
            }
            Some(EventKind::Voters { voters, reason }) => {
                let voters: BTreeSet<NodeId> = voters.iter().cloned().collect();
                let out: Vec<_> = self.voters.difference(&voters).map(NodeId::as_str).collect();
                if out.len() > 1 {
                    return Err(format!("{} are taken out in one change: {reason}", out.join(" and ")));
                }
                self.voters = voters;
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
