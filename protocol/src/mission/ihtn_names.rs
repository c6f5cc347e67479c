//! What a domain adds to flat iHTNs.

use crate::ids::{PlaceId, RoleId, TaskType};
use std::collections::{BTreeMap, BTreeSet};

/// Meaning of names in flat iHTNs, as declared by a domain.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IhtnNames {
    /// Agents that are people, or otherwise not commanded by the fleet.
    pub people: BTreeSet<RoleId>,
    /// Agents that are things. They take no role.
    pub objects: BTreeSet<String>,
    /// Places of the map, by locations that the map lacks.
    pub places: BTreeMap<String, PlaceId>,
    /// Task types, by names of actions that differ from them (`navto` for `navigation`).
    pub actions: BTreeMap<String, TaskType>,
    /// Task types after which the location of the action is reached (`navigation`).
    pub reaching: BTreeSet<TaskType>,
}

impl IhtnNames {
    /// Adds other names. They replace earlier meanings of the same names.
    pub(in crate::mission) fn extend(&mut self, names: IhtnNames) {
        self.people.extend(names.people);
        self.objects.extend(names.objects);
        self.places.extend(names.places);
        self.actions.extend(names.actions);
        self.reaching.extend(names.reaching);
    }
}
