//! Ids of traces and spans, worked out from what they are of: every process that has a hand in a mission comes to the same
//! ones, since the fleet's messages name cluster, mission, role and epoch, and no id needs to be sent beside them.

use consort_protocol::ids::{ClusterId, MissionId};
use siphasher::sip::SipHasher13;
use std::fmt;
use std::hash::Hasher;

/// The trace of one mission, as W3C Trace Context has it: the cluster in the first half, the mission in the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TraceId(pub u128);

/// A span within a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SpanId(pub u64);

impl TraceId {
    /// Of a mission. A node that belongs to no cluster yet tells of no mission; 0 stands for it all the same.
    pub fn of(cluster: Option<ClusterId>, mission: &MissionId) -> TraceId {
        let cluster = cluster.map_or(0, |cluster| cluster.0);
        TraceId(u128::from(cluster) << 64 | u128::from(digest(&["mission", mission.as_str()])))
    }
}

impl SpanId {
    /// Of the parts that tell a span from every other of its trace.
    pub fn of(parts: &[&str]) -> SpanId {
        SpanId(digest(parts))
    }
}

/// The same on every machine and in every version: SipHash-1-3 without a key, each part followed by a byte that no UTF-8 text
/// has. Never 0, which means that there is none.
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

impl fmt::Display for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_the_same_everywhere_and_differ_where_anything_does() {
        let mission: MissionId = "lab-samples-1".parse().unwrap();
        let trace = TraceId::of(Some(ClusterId(0xabc)), &mission);
        // Written down: a later version must come to the same.
        assert_eq!(trace.to_string(), "0000000000000abc8896d98a82bbc964");
        assert_ne!(trace, TraceId::of(Some(ClusterId(0xabd)), &mission));
        assert_ne!(trace, TraceId::of(Some(ClusterId(0xabc)), &"lab-samples-2".parse().unwrap()));
        assert_ne!(SpanId::of(&["role", "ab"]), SpanId::of(&["role", "a", "b"]));
    }
}
