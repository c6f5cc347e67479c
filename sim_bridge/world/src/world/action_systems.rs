//! The system that executes the goals of an action, as the declaration of the action names it.

use super::system_access::SystemIndex;
use consort_protocol::ids::ActionName;
use consort_skills::actions::Goal;
use std::collections::BTreeMap;

/// The systems of a world, by the actions that they execute.
pub(super) struct ActionSystems(BTreeMap<ActionName, ActionSystem>);

/// The system of an action.
pub(super) struct ActionSystem {
    pub(super) index: SystemIndex,
    /// The system's name for goals of the action.
    pub(super) kind: ActionName,
    /// Time from a cancel to the end of a goal, in seconds. A system other than that of declared actions stops at once.
    pub(super) cancel_s: f64,
}

impl FromIterator<(ActionName, ActionSystem)> for ActionSystems {
    fn from_iter<I: IntoIterator<Item = (ActionName, ActionSystem)>>(systems: I) -> Self {
        ActionSystems(systems.into_iter().collect())
    }
}

impl ActionSystems {
    /// Returns the system that executes a goal, and the goal with the system's name for its action.
    pub(super) fn of(&self, goal: &Goal) -> Option<(SystemIndex, Goal)> {
        let ActionSystem { index, kind, .. } = self.0.get(&goal.action)?;
        Some((*index, Goal { action: kind.clone(), ..goal.clone() }))
    }

    /// Returns the time from a cancel to the end of a goal, in seconds.
    pub(super) fn cancel_s(&self, goal: &Goal) -> f64 {
        self.0.get(&goal.action).map_or(0.0, |system| system.cancel_s)
    }
}
