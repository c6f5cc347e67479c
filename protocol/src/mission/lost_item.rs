//! What a recovery branch is told of the loss that it recovers from.
//!
//! The branch is prepared with the mission, when nothing is lost yet: in its parameters stand marks, which are exchanged
//! for what is known when it is taken. A mark holds a control character, which no value that a request or a file gives for
//! a parameter may hold, so nothing else is ever taken for one.

use super::domain::Domain;
use super::model::{Mission, TaskBody, TaskSpec};
use crate::ids::{ItemId, PlaceId, RobotId};
use serde::{Deserialize, Serialize};

/// What was lost.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostItem {
    /// What the lost robot has or may have; of several items the first by name.
    pub item: ItemId,
    /// The robot.
    pub robot: RobotId,
    /// Where it was last known to be.
    pub place: Option<PlaceId>,
}

pub(super) const ITEM: &str = "\u{1a}item\u{1a}";
pub(super) const ROBOT: &str = "\u{1a}robot\u{1a}";
pub(super) const PLACE: &str = "\u{1a}place\u{1a}";

/// The names by which a recovery branch refers to the loss, and the marks that stand for them.
pub(super) const VARIABLES: [(&str, &str); 3] = [("lost.item", ITEM), ("lost.robot", ROBOT), ("lost.place", PLACE)];

impl LostItem {
    /// Something to check a branch with before anything was lost.
    pub(super) fn example(domain: &Domain) -> LostItem {
        let place = domain.places().and_then(|places| places.first().cloned());
        LostItem {
            item: ItemId::new("item").expect("a slug"),
            robot: RobotId::new("robot").expect("a slug"),
            place: Some(place.unwrap_or_else(|| PlaceId::new("Place").expect("a label"))),
        }
    }

    /// Puts into a task what was lost. `None` if it asks for what is not known.
    #[must_use]
    pub fn substitute(&self, mut spec: TaskSpec) -> Option<TaskSpec> {
        for value in spec.parameters.values_mut().chain(spec.reaches.values_mut()) {
            if value.contains(PLACE) {
                *value = value.replace(PLACE, self.place.as_ref()?.as_str());
            }
            *value = value.replace(ITEM, self.item.as_str()).replace(ROBOT, self.robot.as_str());
        }
        Some(spec)
    }

    /// Puts into each task of a mission what was lost. `None` if one asks for what is not known.
    #[must_use]
    pub fn substitute_mission(&self, mut mission: Mission) -> Option<Mission> {
        for node in &mut mission.tasks {
            match &mut node.body {
                TaskBody::Elementary(spec) => *spec = self.substitute(spec.clone())?,
                TaskBody::Abstract(method) => {
                    for (_, spec) in method.alternatives.iter_mut().flat_map(|other| &mut other.tasks) {
                        *spec = self.substitute(spec.clone())?;
                    }
                }
            }
        }
        Some(mission)
    }
}
