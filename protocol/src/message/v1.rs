//! Layouts of wire version 1, for messages whose layout has changed since. Fields that version 1
//! lacks are not sent to nodes that read no later version.

use crate::ids::NodeId;
use crate::knowledge::{Digest, DigestScope, Knowledge, RecordStamp};
use crate::message;
use serde::{Deserialize, Serialize};

/// A record without proof.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    owner: NodeId,
    stamp: RecordStamp,
    knowledge: Knowledge,
}

impl From<crate::knowledge::Record> for Record {
    fn from(record: crate::knowledge::Record) -> Record {
        let crate::knowledge::Record { owner, stamp, knowledge, proof: _ } = record;
        Record { owner, stamp, knowledge }
    }
}

impl From<Record> for crate::knowledge::Record {
    fn from(record: Record) -> crate::knowledge::Record {
        let Record { owner, stamp, knowledge } = record;
        crate::knowledge::Record { owner, stamp, knowledge, proof: None }
    }
}

/// Layout of [`message::RecordUpdate`] in version 1.
#[expect(clippy::large_enum_variant, reason = "same as in the current layout")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum RecordUpdate {
    /// The whole record.
    Record(Record),
    /// The record has not changed.
    Refresh {
        /// Latest version of the record.
        stamp: RecordStamp,
        /// Version since which the content is unchanged.
        since: u64,
    },
}

impl From<message::RecordUpdate> for RecordUpdate {
    fn from(statement: message::RecordUpdate) -> RecordUpdate {
        match statement {
            message::RecordUpdate::Record(record) => RecordUpdate::Record(record.into()),
            message::RecordUpdate::Refresh { stamp, since, proof: _ } => RecordUpdate::Refresh { stamp, since },
        }
    }
}

impl From<RecordUpdate> for message::RecordUpdate {
    fn from(statement: RecordUpdate) -> message::RecordUpdate {
        match statement {
            RecordUpdate::Record(record) => message::RecordUpdate::Record(record.into()),
            RecordUpdate::Refresh { stamp, since } => message::RecordUpdate::Refresh { stamp, since, proof: None },
        }
    }
}

/// Layout of [`message::Exchange`] in version 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exchange {
    sums: Vec<u64>,
    scope: DigestScope,
    digest: Digest,
    records: Vec<Record>,
}

impl From<message::Exchange> for Exchange {
    fn from(exchange: message::Exchange) -> Exchange {
        let message::Exchange { sums, scope, digest, records } = exchange;
        Exchange { sums, scope, digest, records: records.into_iter().map(Record::from).collect() }
    }
}

impl From<Exchange> for message::Exchange {
    fn from(exchange: Exchange) -> message::Exchange {
        let Exchange { sums, scope, digest, records } = exchange;
        message::Exchange { sums, scope, digest, records: records.into_iter().map(Into::into).collect() }
    }
}
