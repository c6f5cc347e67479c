//! Values of a loss, substituted into the recovery branch.
//!
//! The branch is prepared together with the mission, before any loss. Its parameters contain
//! variables, which are replaced by the values of the loss when the branch is taken. The text of a
//! variable contains a control character. Values of parameters in requests and files may not
//! contain control characters, so no other text is mistaken for a variable.

use super::domain::Domain;
use super::model::{Mission, TaskBody, TaskSpec};
use crate::ids::{ItemId, PlaceId, RobotId};
use serde::{Deserialize, Serialize};

/// Item lost together with a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LostItem {
    /// Item that the lost robot has or may have; of several items the first by name.
    pub(crate) item: ItemId,
    /// Robot that was lost.
    pub(crate) robot: RobotId,
    /// Last known place of the robot.
    pub(crate) place: Option<PlaceId>,
}

pub(super) const ITEM: &str = "\u{1a}item\u{1a}";
pub(super) const ROBOT: &str = "\u{1a}robot\u{1a}";
pub(super) const PLACE: &str = "\u{1a}place\u{1a}";

/// Names by which a recovery branch refers to the loss, and the text of each variable.
pub(super) const VARIABLES: [(&str, &str); 3] = [("lost.item", ITEM), ("lost.robot", ROBOT), ("lost.place", PLACE)];

/// Prefix of the names of the values. A task with this name has no results for others.
pub(super) const LOST: &str = "lost";

impl LostItem {
    /// Returns example values, to check a branch before any loss.
    pub(super) fn example(domain: &Domain) -> LostItem {
        let place = domain.places().and_then(|places| places.first().cloned());
        LostItem {
            item: ItemId::new("item").expect("a slug"),
            robot: RobotId::new("robot").expect("a slug"),
            place: Some(place.unwrap_or_else(|| PlaceId::new("Place").expect("a label"))),
        }
    }

    /// Substitutes the values of the loss into a task. `None` if the task uses a value that is not
    /// known.
    #[must_use]
    pub(crate) fn substitute(&self, mut spec: TaskSpec) -> Option<TaskSpec> {
        for value in spec.parameters.values_mut().chain(spec.reaches.values_mut()) {
            if value.contains(PLACE) {
                *value = value.replace(PLACE, self.place.as_ref()?.as_str());
            }
            *value = value.replace(ITEM, self.item.as_str()).replace(ROBOT, self.robot.as_str());
        }
        Some(spec)
    }

    /// Substitutes the values of the loss into each task of a mission. `None` if a task uses a
    /// value that is not known.
    #[must_use]
    pub(crate) fn substitute_mission(&self, mut mission: Mission) -> Option<Mission> {
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
