//! Deterministic ids of traces and spans: every process derives the same ids from cluster, mission,
//! role and epoch, which are part of the fleet's messages. So no id needs to be sent.

use consort_protocol::ids::{ClusterId, MissionId};
use siphasher::sip::SipHasher13;
use std::fmt;
use std::hash::Hasher;

/// The trace of a mission, as in W3C Trace Context: the cluster in the first half, the mission in
/// the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct TraceId(pub u128);

/// A span within a trace.
#[cfg(any(feature = "otlp", test))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct SpanId(pub u64);

impl TraceId {
    /// Derives the trace id of a mission. A node without a cluster publishes no mission events; its
    /// cluster counts as 0.
    pub(crate) fn of(cluster: Option<ClusterId>, mission: &MissionId) -> TraceId {
        let cluster = cluster.map_or(0, |cluster| cluster.0);
        TraceId(u128::from(cluster) << 64 | u128::from(digest(&["mission", mission.as_str()])))
    }
}

#[cfg(any(feature = "otlp", test))]
impl SpanId {
    /// Derives a span id from parts that distinguish the span from all others of its trace.
    pub(crate) fn of(parts: &[&str]) -> SpanId {
        SpanId(digest(parts))
    }
}

/// Stable on every machine and in every version: SipHash-1-3 without a key, each part followed by a
/// byte that does not occur in UTF-8. Never 0, which stands for no id.
fn digest(parts: &[&str]) -> u64 {
    let mut hasher = SipHasher13::new();
    for part in parts {
        hasher.write(part.as_bytes());
        hasher.write_u8(0xff);
    }
    hasher.finish().max(1)
}

impl fmt::Display for TraceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

#[cfg(any(feature = "otlp", test))]
impl fmt::Display for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_stable_and_differ_for_different_inputs() {
        let mission: MissionId = "lab-samples-1".parse().unwrap();
        let trace = TraceId::of(Some(ClusterId(0xabc)), &mission);
        // Fixed value: later versions must derive the same id.
        assert_eq!(trace.to_string(), "0000000000000abc8896d98a82bbc964");
        assert_ne!(trace, TraceId::of(Some(ClusterId(0xabd)), &mission));
        assert_ne!(trace, TraceId::of(Some(ClusterId(0xabc)), &"lab-samples-2".parse().unwrap()));
        assert_ne!(SpanId::of(&["role", "ab"]), SpanId::of(&["role", "a", "b"]));
    }
}
