//! Part of the ledger whose layout depends on the wire version of the fleet.
//!
//! The version comes first, so a reader knows what follows. While a fleet writes an earlier version,
//! the ledger has the layout of that version, and its nodes can return to an earlier program.

use super::audit_trail::AuditTrail;
use super::history::{HISTORY_SINCE, History};
use super::order_book::OrderBook;
use super::resource_lease::{Resource, ResourceLease};
use super::schedule::ScheduleEntry;
use crate::ids::ScheduleId;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// Wire version, and what it adds to the ledger.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct VersionedPart {
    /// Wire version that the fleet writes.
    pub(super) wire: Option<u8>,
    /// History; present exactly from [`HISTORY_SINCE`] on.
    pub(super) history: Option<History>,
    /// Schedules; empty without a history.
    pub(super) schedules: BTreeMap<ScheduleId, Arc<ScheduleEntry>>,
    /// Orders of people; empty without a history.
    pub(super) orders: OrderBook,
    /// Requests of people; empty without a history.
    pub(super) trail: AuditTrail,
    /// Leases of chargers and devices; empty without a history.
    pub(super) leases: BTreeMap<Resource, ResourceLease>,
}

impl Serialize for VersionedPart {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.history {
            None => (self.wire,).serialize(serializer),
            Some(history) => {
                let VersionedPart { wire, schedules, orders, trail, leases, .. } = self;
                (wire, history, schedules, orders, trail, leases).serialize(serializer)
            }
        }
    }
}

impl<'de> Deserialize<'de> for VersionedPart {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(6, PartVisitor)
    }
}

struct PartVisitor;

impl<'de> Visitor<'de> for PartVisitor {
    type Value = VersionedPart;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a wire version and what it adds to the ledger")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut parts: A) -> Result<VersionedPart, A::Error> {
        let wire: Option<u8> = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(0, &self))?;
        if wire < Some(HISTORY_SINCE) {
            return Ok(VersionedPart { wire, ..VersionedPart::default() });
        }
        let history = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(1, &self))?;
        let schedules = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(2, &self))?;
        let orders = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(3, &self))?;
        let trail = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(4, &self))?;
        let leases = parts.next_element()?.ok_or_else(|| A::Error::invalid_length(5, &self))?;
        Ok(VersionedPart { wire, history: Some(history), schedules, orders, trail, leases })
    }
}
