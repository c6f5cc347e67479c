//! Messages whose layout has changed, as version 1 of the wire has them. What is not in it is not sent to whoever may read no
//! later one.

use crate::ids::NodeId;
use crate::knowledge::{Digest, Knowledge, Scope, Stamp};
use crate::message;
use serde::{Deserialize, Serialize};

/// A record without proof.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    owner: NodeId,
    stamp: Stamp,
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

/// See [`message::Statement`].
#[expect(clippy::large_enum_variant, reason = "as in what it stands for")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Statement {
    /// All of it.
    Record(Record),
    /// That it still says what it said.
    Still {
        /// Its latest version.
        stamp: Stamp,
        /// The version with which it began to say this.
        since: u64,
    },
}

impl From<message::Statement> for Statement {
    fn from(statement: message::Statement) -> Statement {
        match statement {
            message::Statement::Record(record) => Statement::Record(record.into()),
            message::Statement::Still { stamp, since, proof: _ } => Statement::Still { stamp, since },
        }
    }
}

impl From<Statement> for message::Statement {
    fn from(statement: Statement) -> message::Statement {
        match statement {
            Statement::Record(record) => message::Statement::Record(record.into()),
            Statement::Still { stamp, since } => message::Statement::Still { stamp, since, proof: None },
        }
    }
}

/// See [`message::Exchange`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exchange {
    sums: Vec<u64>,
    scope: Scope,
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
