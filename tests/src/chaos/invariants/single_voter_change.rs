//! A membership change removes at most a single voter.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use std::collections::BTreeSet;
use std::time::Duration;

#[derive(Default)]
pub(super) struct SingleVoterChange {
    /// Voters, as published by the last coordinator that was elected or changed them.
    voters: BTreeSet<NodeId>,
    /// They are the old and the new voters of a change that an election interrupted. The change is completed
    /// later, possibly without an event.
    interrupted: bool,
}

impl Invariant for SingleVoterChange {
    fn name(&self) -> &'static str {
        "single_voter_change"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry.event_kind() {
            // A leader that is elected during a membership change lists the old and the new voters
            // together.
            Some(EventKind::Elected { voters, .. }) => {
                let voters: BTreeSet<NodeId> = voters.iter().cloned().collect();
                if voters != self.voters {
                    self.interrupted = !self.voters.is_empty() && self.voters.is_subset(&voters);
                    self.voters = voters;
                }
                Ok(())
            }
            Some(EventKind::Voters { voters, reason }) => {
                let voters: BTreeSet<NodeId> = voters.iter().cloned().collect();
                let removed: Vec<_> = self.voters.difference(&voters).map(NodeId::as_str).collect();
                if removed.len() > 1 + usize::from(self.interrupted) {
                    return Err(format!("{} were removed in a single change: {reason}", removed.join(" and ")).into());
                }
                if voters != self.voters {
                    (self.interrupted, self.voters) = (false, voters);
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
