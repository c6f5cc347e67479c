//! Digests: versions of records, and the classes of owners for which two nodes compare them.

use super::record::RecordStamp;
use crate::fnv::fnv1a;
use crate::ids::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Versions of the records at a node; sufficient to find the records that another node lacks.
pub type Digest = BTreeMap<NodeId, RecordStamp>;

/// Maximum number of classes of owners.
pub(super) const CLASSES_MAX: u8 = 16;

/// Subset of all owners. Owners are divided into classes by a hash of their names, identical on
/// every node. So two nodes with different records need to exchange only the classes that differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DigestScope {
    /// Number of classes.
    pub(super) classes: u8,
    /// Classes in the subset, a bit for each class.
    pub(super) within: u16,
}

impl DigestScope {
    /// All owners.
    pub const ALL: DigestScope = DigestScope { classes: 1, within: 1 };

    /// No owner.
    pub const NONE: DigestScope = DigestScope { classes: 1, within: 0 };

    /// Returns the owners for which two nodes have different records, according to their sums; all
    /// owners if the sums cannot be compared.
    pub fn of_difference(ours: &[u64], theirs: &[u64]) -> DigestScope {
        let classes = u8::try_from(ours.len()).ok().filter(|classes| (1..=CLASSES_MAX).contains(classes));
        match classes {
            Some(classes) if ours.len() == theirs.len() => {
                let differ = ours.iter().zip(theirs).enumerate().filter(|(_, (our, their))| our != their);
                DigestScope { classes, within: differ.fold(0, |within, (class, _)| within | 1 << class) }
            }
            _ => DigestScope::ALL,
        }
    }

    /// Checks whether the owner is in the subset.
    pub fn contains(&self, owner: &NodeId) -> bool {
        self.within.checked_shr(class(owner, self.classes) as u32).unwrap_or(0) & 1 == 1
    }
}

pub(super) fn class(owner: &NodeId, classes: u8) -> usize {
    (mix(hash(owner)) % u64::from(classes.max(1))) as usize
}

/// Hashes a name.
pub(super) fn hash(owner: &NodeId) -> u64 {
    fnv1a(owner.as_str().bytes())
}

/// Mixes the bits of a number (the finaliser of SplitMix64: Steele, Lea, Flood 2014).
pub(super) fn mix(number: u64) -> u64 {
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}
