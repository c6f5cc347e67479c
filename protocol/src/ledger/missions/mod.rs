//! Missions of the ledger, with indexes of them.
//!
//! The indexes follow from the missions, so they are neither stored nor compared. A command changes missions through
//! [`Missions::get_mut`], which notes them. [`Missions::settle`] updates the indexes after the command; until then queries examine
//! the noted missions themselves, so they are exact at any time.
//!
//! A copy of the ledger, such as a snapshot that is being written, shares the missions and the indexes. A change copies a shared
//! mission first.

mod index;

use super::entry::MissionEntry;
use super::mission_changes::ChangeList;
use super::service_order::{ServiceRank, service_order};
use super::shared_map::SharedMap;
use crate::ids::{MissionId, RobotId};
pub(super) use index::MissionGroup;
use index::{MissionIndex, holds, is_promised};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Missions by id.
#[derive(Debug, Default)]
pub(super) struct Missions {
    entries: SharedMap<MissionId, Arc<MissionEntry>>,
    index: MissionIndex,
    /// Missions that the present command may have changed.
    touched: BTreeSet<MissionId>,
    changes: ChangeList,
}

impl Missions {
    pub(super) fn get(&self, id: &MissionId) -> Option<&MissionEntry> {
        self.entries.get(id).map(|entry| &**entry)
    }

    /// Returns a mission that is about to be changed.
    pub(super) fn get_mut(&mut self, id: &MissionId) -> Option<&mut MissionEntry> {
        let entry = self.entries.get_mut(id)?;
        self.touched.insert(id.clone());
        Some(Arc::make_mut(entry))
    }

    pub(super) fn insert(&mut self, id: MissionId, entry: MissionEntry) {
        self.touched.insert(id.clone());
        self.entries.insert(id, Arc::new(entry));
    }

    pub(super) fn remove(&mut self, id: &MissionId) {
        self.touched.insert(id.clone());
        self.entries.remove(id);
    }

    pub(super) fn contains_key(&self, id: &MissionId) -> bool {
        self.entries.contains_key(id)
    }

    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns all missions, by id.
    pub(super) fn values(&self) -> impl Iterator<Item = &MissionEntry> {
        self.entries.values().map(|entry| &**entry)
    }

    /// Updates the indexes, and adds the missions to the changes, once a command has been applied.
    pub(super) fn settle(&mut self) {
        for id in std::mem::take(&mut self.touched) {
            self.index.update(&id, self.entries.get(&id).map(|entry| &**entry));
            self.changes.push(id);
        }
    }

    /// Returns the changes by the commands so far.
    pub(super) fn changes(&self) -> &ChangeList {
        &self.changes
    }

    /// Returns the missions of a group, in the order in which missions are served.
    pub(super) fn of_group(&self, group: MissionGroup) -> Vec<&MissionEntry> {
        let indexed = self.index.of_group(group).filter(|id| !self.touched.contains(*id)).filter_map(|id| self.get(id));
        let touched = self.touched_missions().map(|(_, entry)| entry).filter(|entry| group.contains(entry));
        let missions = indexed.chain(touched);
        if self.touched.is_empty() { missions.collect() } else { service_order(missions) }
    }

    /// Returns the active missions with a better rank, in the order in which missions are served.
    pub(super) fn active_before(&self, rank: ServiceRank) -> Vec<&MissionEntry> {
        if self.touched.is_empty() {
            return self.index.active_before(rank).filter_map(|id| self.get(id)).collect();
        }
        let mut missions = self.of_group(MissionGroup::Active);
        missions.retain(|entry| entry.rank() < rank);
        missions
    }

    /// Returns the number of missions of a group.
    pub(super) fn count(&self, group: MissionGroup) -> usize {
        if self.touched.is_empty() { self.index.count(group) } else { self.of_group(group).len() }
    }

    /// Returns the first active mission, by id, in which a robot holds a role.
    pub(super) fn held_by(&self, robot: &RobotId) -> Option<&MissionEntry> {
        let indexed = self.index.held_by(robot).find(|id| !self.touched.contains(*id));
        let indexed = indexed.and_then(|id| self.entries.get_key_value(id));
        let touched = self.touched_missions().find(|(_, entry)| holds(entry, robot));
        let indexed = indexed.map(|(id, entry)| (id, &**entry));
        indexed.into_iter().chain(touched).min_by_key(|(id, _)| *id).map(|(_, entry)| entry)
    }

    /// Returns the active missions with a role that is promised to a robot.
    pub(super) fn promised_to(&self, robot: &RobotId) -> impl Iterator<Item = &MissionEntry> {
        let indexed = self.index.promised_to(robot).filter(move |id| !self.touched.contains(*id));
        let indexed = indexed.filter_map(move |id| self.get(id));
        let touched = self.touched_missions().filter(move |(_, entry)| is_promised(entry, robot));
        indexed.chain(touched.map(|(_, entry)| entry))
    }

    fn touched_missions(&self) -> impl Iterator<Item = (&MissionId, &MissionEntry)> {
        self.touched.iter().filter_map(move |id| Some((id, self.get(id)?)))
    }
}

impl From<BTreeMap<MissionId, MissionEntry>> for Missions {
    fn from(entries: BTreeMap<MissionId, MissionEntry>) -> Missions {
        let mut index = MissionIndex::default();
        entries.iter().for_each(|(id, entry)| index.update(id, Some(entry)));
        let entries: BTreeMap<_, _> = entries.into_iter().map(|(id, entry)| (id, Arc::new(entry))).collect();
        Missions { entries: entries.into(), index, ..Missions::default() }
    }
}

/// A copy begins a list of changes of its own, since its changes differ.
impl Clone for Missions {
    fn clone(&self) -> Missions {
        let Missions { entries, index, touched, .. } = self;
        let (entries, index, touched) = (entries.clone(), index.clone(), touched.clone());
        Missions { entries, index, touched, changes: ChangeList::default() }
    }
}

impl PartialEq for Missions {
    fn eq(&self, other: &Missions) -> bool {
        self.entries == other.entries
    }
}

impl Serialize for Missions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.entries.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Missions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Missions, D::Error> {
        BTreeMap::<MissionId, MissionEntry>::deserialize(deserializer).map(Missions::from)
    }
}

#[cfg(test)]
mod tests;
