//! Changes of the missions of a ledger, for readers on the same node.
//!
//! A reader keeps a [`ChangeCursor`] and asks which missions commands have changed since. So several changes between two
//! reads cost a single read, and its cost does not depend on the other missions. The changes are no part of the replicated
//! state: they are gone with the process, and a ledger that was read from a snapshot, or is a copy, begins anew.

use crate::ids::MissionId;
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};

/// Maximum number of changes that are remembered. A reader that is later examines all missions. A guess: some seconds of commits
/// in a large fleet.
const REMEMBERED_MAX: usize = 4096;

/// Identity of the next list of changes in this process; 0 belongs to no list.
static NEXT_LIST: AtomicU64 = AtomicU64::new(1);

/// Position of a reader among the changes of a ledger.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ChangeCursor {
    list: u64,
    position: u64,
}

/// Missions that a reader has to examine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MissionChanges {
    /// Any mission may have changed.
    All,
    /// These missions may have changed, were added, or are no longer in the ledger.
    These(BTreeSet<MissionId>),
}

/// Latest changes of a ledger.
#[derive(Debug)]
pub(super) struct ChangeList {
    id: u64,
    /// Number of changes so far.
    position: u64,
    /// The latest changes, oldest first.
    latest: VecDeque<MissionId>,
}

impl Default for ChangeList {
    fn default() -> ChangeList {
        ChangeList { id: NEXT_LIST.fetch_add(1, Ordering::Relaxed), position: 0, latest: VecDeque::new() }
    }
}

impl ChangeList {
    pub(super) fn push(&mut self, mission: MissionId) {
        if self.latest.len() == REMEMBERED_MAX {
            self.latest.pop_front();
        }
        self.latest.push_back(mission);
        self.position += 1;
    }

    /// Returns the changes since the position of the cursor, and moves it to the present.
    pub(super) fn since(&self, cursor: &mut ChangeCursor) -> MissionChanges {
        let ChangeCursor { list, position } =
            std::mem::replace(cursor, ChangeCursor { list: self.id, position: self.position });
        let missed = self.position.checked_sub(position).filter(|_| list == self.id);
        let missed = missed.and_then(|missed| usize::try_from(missed).ok());
        match missed.and_then(|missed| self.latest.len().checked_sub(missed)) {
            Some(first) => MissionChanges::These(self.latest.range(first..).cloned().collect()),
            None => MissionChanges::All,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn these(names: &[&str]) -> MissionChanges {
        MissionChanges::These(names.iter().map(|name| name.parse().unwrap()).collect())
    }

    #[test]
    fn a_cursor_returns_each_change_once_and_all_missions_if_changes_are_unknown() {
        let (mut list, mut cursor) = (ChangeList::default(), ChangeCursor::default());
        assert_eq!(list.since(&mut cursor), MissionChanges::All, "a new reader");
        assert_eq!(list.since(&mut cursor), these(&[]));
        for name in ["m-1", "m-2", "m-1"] {
            list.push(name.parse().unwrap());
        }
        let mut late = cursor;
        assert_eq!(list.since(&mut cursor), these(&["m-1", "m-2"]));
        assert_eq!(list.since(&mut cursor), these(&[]));
        let mut foreign = cursor;
        assert_eq!(ChangeList::default().since(&mut foreign), MissionChanges::All, "another list");
        for _ in 0..REMEMBERED_MAX {
            list.push("m-3".parse().unwrap());
        }
        assert_eq!(list.since(&mut cursor), these(&["m-3"]));
        assert_eq!(list.since(&mut late), MissionChanges::All, "too many changes");
    }
}
