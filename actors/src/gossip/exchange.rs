//! What of a digest and of records goes into one message.
//!
//! A message is bounded ([`codec::LIMIT`]). What does not fit waits for the next: each selection begins behind the last
//! owner of the selection before it, so that every owner's turn comes, however large the fleet.

use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, Record};
use consort_protocol::message::Exchange;
use serde::Serialize;

/// Largest record. Eight fit into a message beside the largest digest; a robot's takes some 200 bytes.
pub(super) const RECORD_MAX: usize = 3 * 1024;

/// Bytes of a digest: some 1500 owners with names of usual length. The other's digest tells no more than ours.
const DIGEST_MAX: usize = 38 * 1024;

/// For the version byte and the two lengths.
const FRAME: usize = 32;

/// Bytes that a value takes within a message.
pub(super) fn encoded_size<T: Serialize>(value: &T) -> usize {
    codec::encode(value).map_or(usize::MAX, |bytes| bytes.len() - 1)
}

/// Whose turn is next, in digests and in records.
#[derive(Debug, Default)]
pub(super) struct ExchangeCursors {
    digest: Option<NodeId>,
    records: Option<NodeId>,
}

impl ExchangeCursors {
    /// A message with as much of both as fits. The digest is of those in the scope.
    pub(super) fn compose(&mut self, scope: DigestScope, digest: Digest, lacking: &[&Record]) -> Exchange {
        let entries: Vec<_> = digest.into_iter().collect();
        let (entries, used) = fitting(entries, |(owner, _)| owner, DIGEST_MAX, &mut self.digest);
        let left = codec::MESSAGE_BYTES_MAX - FRAME - used;
        let (records, _) = fitting(lacking.to_vec(), |record| &record.owner, left, &mut self.records);
        let sums = vec![];
        Exchange { sums, scope, digest: entries.into_iter().collect(), records: records.into_iter().cloned().collect() }
    }
}

/// As many items as fit, given in the order of their owners, beginning behind `turn`; and how many bytes they take.
fn fitting<T: Serialize>(
    mut items: Vec<T>,
    owner: impl Fn(&T) -> &NodeId,
    budget: usize,
    turn: &mut Option<NodeId>,
) -> (Vec<T>, usize) {
    let begin = turn.as_ref().map_or(0, |last| items.partition_point(|item| owner(item) <= last));
    let begin = begin % items.len().max(1);
    items.rotate_left(begin);
    let mut used = 0;
    let fits = |item: &T| {
        used += encoded_size(item);
        used <= budget
    };
    let taken = items.iter().map(fits).take_while(|fit| *fit).count();
    // Only when some had to wait is there a turn to remember.
    if taken < items.len() {
        // One that fits no message at all must not hold up the others for ever.
        *turn = items.get(taken.saturating_sub(1)).map(|item| owner(item).clone());
        items.truncate(taken);
    }
    let used = items.iter().map(encoded_size).sum();
    (items, used)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::knowledge::{Knowledge, RecordStamp};
    use consort_protocol::versions::VersionRange;
    use std::collections::BTreeSet;

    fn records(count: usize, name: impl Fn(usize) -> String) -> Vec<Record> {
        let knowledge = Knowledge {
            may_vote: false,
            stationary: false,
            mains_powered: false,
            replica: Some(u64::MAX),
            cluster: None,
            leaving: false,
            supported_versions: VersionRange::OWN,
            robot: None,
        };
        let record = |n| Record {
            owner: NodeId::new(name(n)).unwrap(),
            stamp: RecordStamp { incarnation: u64::MAX, version: u64::MAX },
            knowledge: knowledge.clone(),
            proof: None,
        };
        (0..count).map(record).collect()
    }

    #[test]
    fn every_turn_comes_and_every_message_fits() {
        for count in [0, 1, 20, 3000] {
            let records = records(count, |n| format!("{n:0>64}"));
            let lacking: Vec<&Record> = records.iter().collect();
            let digest: Digest = records.iter().map(|record| (record.owner.clone(), record.stamp)).collect();
            let (mut told, mut handed) = (BTreeSet::new(), BTreeSet::new());
            let mut turns = ExchangeCursors::default();
            for _ in 0..=count / 150 {
                let exchange = turns.compose(DigestScope::ALL, digest.clone(), &lacking);
                assert!(codec::encode_for_version(VersionRange::OWN.newest, exchange.clone()).is_ok());
                told.extend(exchange.digest.into_keys());
                handed.extend(exchange.records.into_iter().map(|record| record.owner));
            }
            assert_eq!((told.len(), handed.len()), (count, count));
        }
    }

    #[test]
    fn what_fits_is_sent_whole_and_in_order() {
        let records = records(20, |n| format!("node{n:02}"));
        let mut turns = ExchangeCursors { digest: None, records: Some(NodeId::new("node07").unwrap()) };
        let exchange = turns.compose(DigestScope::ALL, Digest::new(), &records.iter().collect::<Vec<_>>());
        assert_eq!(exchange.records.len(), 20);
        assert_eq!(exchange.records[0].owner.as_str(), "node08");
    }
}
