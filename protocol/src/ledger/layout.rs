//! Part of the ledger whose layout depends on the wire version of the fleet.
//!
//! The version comes first, so a reader knows what follows. While a fleet writes an earlier version,
//! the ledger has the layout of that version, and its nodes can return to an earlier program.

use super::history::{HISTORY_SINCE, History};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// Wire version, and what it adds to the ledger.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct VersionedPart {
    /// Wire version that the fleet writes.
    pub(super) wire: Option<u8>,
    /// History; present exactly from [`HISTORY_SINCE`] on.
    pub(super) history: Option<History>,
}

impl Serialize for VersionedPart {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.history {
            None => (self.wire,).serialize(serializer),
            Some(history) => (self.wire, history).serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for VersionedPart {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(2, PartVisitor)
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
        let history = match wire >= Some(HISTORY_SINCE) {
            true => Some(parts.next_element()?.ok_or_else(|| A::Error::invalid_length(1, &self))?),
            false => None,
        };
        Ok(VersionedPart { wire, history })
    }
}
