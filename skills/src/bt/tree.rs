//! A running tree.

use super::blackboard::{Blackboard, BlackboardError, EntryId};
use super::node::ChildNode;
#[cfg(test)]
use super::port_value::PortValue;
use super::status::NodeStatus;
use super::tick::{Cause, MAX_LOOP_ITERATIONS_PER_TICK, Tick, TreeState};
use super::value::Value;
use crate::actions::RobotActions;
use crate::names::join_names;
use consort_protocol::units::WorldTime;
use std::collections::BTreeMap;

/// A running tree with its blackboard.
pub(crate) struct Tree {
    pub(crate) root: ChildNode,
    pub(crate) blackboard: Blackboard,
    /// Keys of the main tree.
    pub(crate) keys: BTreeMap<String, EntryId>,
    pub(crate) state: TreeState,
}

impl Tree {
    /// Ticks the tree once, at world time `now`. An error of a script halts the tree, which fails.
    pub(crate) fn tick(&mut self, actions: &mut dyn RobotActions, now: WorldTime) -> NodeStatus {
        if !self.root.is_running() {
            (self.state.cause, self.state.aborted) = (None, false);
        }
        let Tree { root, blackboard, state, .. } = self;
        let tick = &mut Tick { actions, now, blackboard, state, iterations_left: MAX_LOOP_ITERATIONS_PER_TICK };
        let status = root.tick(tick);
        if tick.is_aborted() {
            root.halt(tick);
            return NodeStatus::Failure;
        }
        status
    }

    /// Halts every running node; the next tick starts from the beginning. The blackboard is
    /// unchanged.
    pub(crate) fn halt(&mut self, actions: &mut dyn RobotActions, now: WorldTime) {
        let Tree { root, blackboard, state, .. } = self;
        root.halt(&mut Tick { actions, now, blackboard, state, iterations_left: MAX_LOOP_ITERATIONS_PER_TICK });
    }

    /// Returns the cause of the latest failure of a leaf, in the current run or the last run that
    /// ended.
    pub(crate) fn cause(&self) -> Option<&Cause> {
        self.state.cause.as_ref()
    }

    /// Writes a key of the main tree; text is converted to the key's type.
    ///
    /// # Errors
    /// [`BlackboardError`] if no port uses the key, or its type differs.
    pub(crate) fn set(&mut self, key: &str, value: impl Into<Value>) -> Result<(), BlackboardError> {
        let id = self.entry(key)?;
        self.blackboard.write(id, value.into())
    }

    /// Reads a key of the main tree; `None` while it is empty.
    ///
    /// # Errors
    /// [`BlackboardError`] if no port uses the key, or its type differs.
    #[cfg(test)]
    pub(crate) fn get<T: PortValue>(&self, key: &str) -> Result<Option<T>, BlackboardError> {
        self.blackboard.read(self.entry(key)?)
    }

    /// Returns the value of a key of the main tree; `None` if no port uses the key, or while it is empty.
    pub(crate) fn value(&self, key: &str) -> Option<&Value> {
        self.blackboard.value(*self.keys.get(key)?)
    }

    /// Checks whether the robot has ended every goal that this tree canceled.
    pub(crate) fn cancels_complete(&self, actions: &dyn RobotActions) -> bool {
        let held = |goal| actions.status(goal).is_some_and(|status| !status.is_final());
        !self.state.canceling.iter().any(|goal| held(*goal))
    }

    fn entry(&self, key: &str) -> Result<EntryId, BlackboardError> {
        let unknown = || {
            let known = join_names(self.keys.keys().map(String::as_str));
            BlackboardError::UnknownKey { key: key.to_owned(), known }
        };
        self.keys.get(key).copied().ok_or_else(unknown)
    }
}
