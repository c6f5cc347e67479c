//! Detects missed events by their sequence numbers.

use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Missed events of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub(crate) struct EventGap {
    /// The node.
    pub node: NodeId,
    /// Number of the last event before the gap; 0 if the node had just started.
    pub after: u64,
    /// Number of the first event after the gap.
    pub before: u64,
    /// Number of missed events.
    pub lost: u64,
}

/// Detects gaps: stores the latest number of each node.
#[derive(Debug, Clone, Default)]
pub(crate) struct GapDetector {
    latest: BTreeMap<NodeId, u64>,
}

impl GapDetector {
    /// Applies an event, and returns the gap before it. The first event of a node has no gap: the
    /// node may have started long before.
    ///
    /// A number that is not greater than the last number belongs to a restarted node: samples of a
    /// node arrive in order, or not at all.
    pub(crate) fn observe(&mut self, event: &Event) -> Option<EventGap> {
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

    fn gap_before(gaps: &mut GapDetector, node: &str, sequence: u64) -> Option<(u64, u64, u64)> {
        let kind = EventKind::SteppedDown { term: 1 };
        let gap = gaps.observe(&Event { node: node.parse().unwrap(), sequence, at_ms: 0, kind })?;
        assert_eq!(gap.node.as_str(), node);
        Some((gap.after, gap.before, gap.lost))
    }

    #[test]
    fn a_skipped_number_is_a_gap_and_a_restart_is_not() {
        let mut gaps = GapDetector::default();
        assert_eq!(gap_before(&mut gaps, "ada", 7), None, "events before the recording are not missed");
        assert_eq!(gap_before(&mut gaps, "ada", 8), None);
        assert_eq!(gap_before(&mut gaps, "bob", 1), None);
        assert_eq!(gap_before(&mut gaps, "ada", 11), Some((8, 11, 2)));
        assert_eq!(gap_before(&mut gaps, "ada", 12), None, "a gap is reported once");
        assert_eq!(gap_before(&mut gaps, "ada", 1), None, "the node was restarted");
        assert_eq!(gap_before(&mut gaps, "bob", 2), None);
        assert_eq!(
            gap_before(&mut gaps, "bob", 2),
            Some((0, 2, 1)),
            "the first event after the next restart was missed"
        );
    }
}
