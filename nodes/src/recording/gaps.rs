//! Which events were not heard: nodes number them.

use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Events of one node that were not heard.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventGap {
    /// Whose.
    pub node: NodeId,
    /// The number of the last one before; 0 if the node had just started.
    pub after: u64,
    /// The number of the first one that was heard again.
    pub before: u64,
    /// How many there were in between.
    pub lost: u64,
}

/// The latest number of each node.
#[derive(Debug, Clone, Default)]
pub struct GapDetector {
    latest: BTreeMap<NodeId, u64>,
}

impl GapDetector {
    /// Takes an event in: what was not heard before it. Nothing was missed of a node that is heard for the first time: it was
    /// there before.
    ///
    /// A number that is no greater than the one before is of the node's next life: samples of one node arrive in order, or not at
    /// all.
    pub fn observe(&mut self, event: &Event) -> Option<EventGap> {
        let Event { node, sequence, .. } = event;
        let latest = self.latest.insert(node.clone(), *sequence)?;
        let after = if *sequence <= latest { 0 } else { latest };
        let lost = sequence.saturating_sub(after + 1);
        (lost > 0).then(|| EventGap { node: node.clone(), after, before: *sequence, lost })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::event::EventKind;

    fn heard(gaps: &mut GapDetector, node: &str, sequence: u64) -> Option<(u64, u64, u64)> {
        let what = EventKind::SteppedDown { term: 1 };
        let gap = gaps.observe(&Event { node: node.parse().unwrap(), sequence, at_ms: 0, kind: what })?;
        assert_eq!(gap.node.as_str(), node);
        Some((gap.after, gap.before, gap.lost))
    }

    #[test]
    fn a_number_that_is_left_out_is_a_gap_and_a_new_life_is_none() {
        let mut gaps = GapDetector::default();
        assert_eq!(heard(&mut gaps, "ada", 7), None, "what was before the recording is not missed");
        assert_eq!(heard(&mut gaps, "ada", 8), None);
        assert_eq!(heard(&mut gaps, "bob", 1), None);
        assert_eq!(heard(&mut gaps, "ada", 11), Some((8, 11, 2)));
        assert_eq!(heard(&mut gaps, "ada", 12), None, "it is told once");
        assert_eq!(heard(&mut gaps, "ada", 1), None, "it was started anew");
        assert_eq!(heard(&mut gaps, "bob", 2), None);
        assert_eq!(heard(&mut gaps, "bob", 2), Some((0, 2, 1)), "and of the next life the first was not heard");
    }
}
