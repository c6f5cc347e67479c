//! Selection of digest entries and records for a single message.
//!
//! The size of a message is limited ([`codec::MESSAGE_BYTES_MAX`]). Entries that do not fit wait
//! for the next message. Each selection begins after the last owner of the selection before it, so
//! every owner is included eventually, however large the fleet.

use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, Record};
use consort_protocol::message::Exchange;
use serde::Serialize;

/// Maximum size of a record, in bytes. Eight fit into a message with the largest digest; the record
/// of a robot takes some 200 bytes.
pub(super) const RECORD_MAX: usize = 3 * 1024;

/// Maximum size of a digest, in bytes: some 1500 owners with names of usual length. The peer's
/// digest is limited likewise.
const DIGEST_MAX: usize = 38 * 1024;

/// Bytes for the version byte and the two lengths.
const FRAME: usize = 32;

/// Returns the encoded size of a value within a message, in bytes.
pub(super) fn encoded_size<T: Serialize>(value: &T) -> usize {
    codec::encode(value).map_or(usize::MAX, |bytes| bytes.len() - 1)
}

/// Last selected owners of digest entries and of records.
#[derive(Debug, Default)]
pub(super) struct ExchangeCursors {
    digest: Option<NodeId>,
    records: Option<NodeId>,
}

impl ExchangeCursors {
    /// Composes a message with as many digest entries and records as fit. The digest is limited to
    /// `scope`.
    pub(super) fn compose(&mut self, scope: DigestScope, digest: Digest, missing: &[&Record]) -> Exchange {
        let entries: Vec<_> = digest.into_iter().collect();
        let (entries, used) = fitting(entries, |(owner, _)| owner, DIGEST_MAX, &mut self.digest);
        let left = codec::MESSAGE_BYTES_MAX - FRAME - used;
        let (records, _) = fitting(missing.to_vec(), |record| &record.owner, left, &mut self.records);
        let sums = vec![];
        Exchange { sums, scope, digest: entries.into_iter().collect(), records: records.into_iter().cloned().collect() }
    }
}

/// Selects as many items as fit, in the order of their owners, beginning after `turn`. Returns the
/// items and their total size.
fn fitting<T: Serialize>(
    mut items: Vec<T>,
    owner: impl Fn(&T) -> &NodeId,
    budget: usize,
    cursor: &mut Option<NodeId>,
) -> (Vec<T>, usize) {
    let begin = cursor.as_ref().map_or(0, |last| items.partition_point(|item| owner(item) <= last));
    let begin = begin % items.len().max(1);
    items.rotate_left(begin);
    let mut used = 0;
    let fits = |item: &T| {
        used += encoded_size(item);
        used <= budget
    };
    let taken = items.iter().map(fits).take_while(|fit| *fit).count();
    // The cursor moves only if some items did not fit.
    if taken < items.len() {
        // An item too large for any message must not block the others forever.
        *cursor = items.get(taken.saturating_sub(1)).map(|item| owner(item).clone());
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
        let knowledge = Knowledge { may_vote: false, replica: Some(u64::MAX), ..Knowledge::of(None) };
        let record = |n| Record {
            owner: NodeId::new(name(n)).unwrap(),
            stamp: RecordStamp { incarnation: u64::MAX, version: u64::MAX },
            knowledge: knowledge.clone(),
            proof: None,
        };
        (0..count).map(record).collect()
    }

    #[test]
    fn every_owner_is_included_and_every_message_fits() {
        for count in [0, 1, 20, 3000] {
            let records = records(count, |n| format!("{n:0>64}"));
            let missing: Vec<&Record> = records.iter().collect();
            let digest: Digest = records.iter().map(|record| (record.owner.clone(), record.stamp)).collect();
            let (mut listed, mut sent) = (BTreeSet::new(), BTreeSet::new());
            let mut cursors = ExchangeCursors::default();
            for _ in 0..=count / 150 {
                let exchange = cursors.compose(DigestScope::ALL, digest.clone(), &missing);
                assert!(codec::encode_for_version(VersionRange::OWN.newest, exchange.clone()).is_ok());
                listed.extend(exchange.digest.into_keys());
                sent.extend(exchange.records.into_iter().map(|record| record.owner));
            }
            assert_eq!((listed.len(), sent.len()), (count, count));
        }
    }

    #[test]
    fn entries_that_fit_are_sent_in_order() {
        let records = records(20, |n| format!("node{n:02}"));
        let mut cursors = ExchangeCursors { digest: None, records: Some(NodeId::new("node07").unwrap()) };
        let exchange = cursors.compose(DigestScope::ALL, Digest::new(), &records.iter().collect::<Vec<_>>());
        assert_eq!(exchange.records.len(), 20);
        assert_eq!(exchange.records[0].owner.as_str(), "node08");
    }
}
