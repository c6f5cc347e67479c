//! A committed entry is never lost and never changed.
//!
//! A replica applies only committed entries. So every node that applies an index applies the same
//! entry of the same term there: before and after takeovers, restarts and lost disks.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::ids::NodeId;
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Committed {
    /// Term, digest of the commands and first node, by index.
    entries: BTreeMap<u64, (u64, Option<u64>, NodeId)>,
    /// Last applied index of each node in its current incarnation.
    last: BTreeMap<NodeId, u64>,
}

impl Invariant for Committed {
    fn name(&self) -> &'static str {
        "committed"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::TestAction { node, action: "starts again" } => {
                self.last.remove(node);
            }
            Observation::EntryApplied { node, at, digest, .. } => {
                let known = self.entries.entry(at.index).or_insert_with(|| (at.term, *digest, node.clone()));
                if (known.0, known.1) != (at.term, *digest) {
                    let (term, _, first) = known;
                    return Err(format!(
                        "entry {} is of term {term} on {first} and of term {} on {node}, with commands that {}",
                        at.index,
                        at.term,
                        if known.1 == *digest { "agree" } else { "differ" }
                    )
                    .into());
                }
                if let Some(last) = self.last.insert(node.clone(), at.index)
                    && at.index <= last
                {
                    return Err(format!("{node} took in entry {} after entry {last}", at.index).into());
                }
            }
            _ => {}
        }
        Ok(())
    }
}
