//! State that a tick passes down the tree: the robot, the time, the blackboard, and notes for the
//! caller.

use super::blackboard::Blackboard;
use super::port_value::PortValue;
use super::ports::{PortError, Ports};
use super::value::Value;
use crate::actions::{ActionError, GoalId, RobotActions};
use consort_protocol::units::WorldTime;
use std::collections::BTreeSet;
use std::fmt;

/// Greatest number of loop iterations (repeat, retry, for-each) within a tick. The loop continues
/// at the next tick. A guess: far above the need of a sound tree, and small enough that a tick
/// takes at most a few milliseconds.
pub(crate) const MAX_LOOP_ITERATIONS_PER_TICK: u32 = 1000;

/// A tick in progress.
pub(crate) struct Tick<'a> {
    pub(crate) actions: &'a mut (dyn RobotActions + 'a),
    pub(crate) now: WorldTime,
    pub(crate) blackboard: &'a mut Blackboard,
    pub(crate) state: &'a mut TreeState,
    pub(crate) iterations_left: u32,
}

/// State that a tree keeps between ticks, apart from its nodes.
#[derive(Debug, Default)]
pub(crate) struct TreeState {
    /// Cause of the latest failure of a leaf.
    pub(crate) cause: Option<Cause>,
    /// A script has failed: the tree ends with `cause`.
    pub(crate) aborted: bool,
    /// Canceled goals that the robot may not have ended yet.
    pub(crate) canceling: BTreeSet<GoalId>,
}

/// Cause of a leaf's failure, with the robot's error, if any.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cause {
    /// Text for people. It names the objects involved.
    pub text: String,
    /// The underlying error, for programs.
    pub error: Option<ActionError>,
}

impl Tick<'_> {
    /// Counts a loop iteration. Returns `false` at the limit, so that the loop has to continue at
    /// the next tick.
    pub(crate) fn take_iteration(&mut self) -> bool {
        if self.iterations_left == 0 {
            return false;
        }
        self.iterations_left -= 1;
        true
    }

    /// Ends the tree with a failure at the end of this tick. No further node is ticked.
    pub(crate) fn abort(&mut self, text: String) {
        if !self.state.aborted {
            *self.state = TreeState { cause: Some(Cause::new(text)), aborted: true, ..std::mem::take(self.state) };
        }
    }

    pub(crate) fn is_aborted(&self) -> bool {
        self.state.aborted
    }

    /// Records the cause of a failure. The cause of an abortion remains.
    pub(crate) fn set_cause(&mut self, node: &str, cause: Cause) {
        if self.state.aborted {
            return;
        }
        self.state.cause = Some(Cause { text: format!("{node}: {}", cause.text), error: cause.error });
    }
}

/// A leaf's view of a tick: its own ports, the robot and the time.
pub struct LeafContext<'l, 't> {
    pub(crate) tick: &'l mut Tick<'t>,
    pub(crate) ports: &'l Ports,
}

impl LeafContext<'_, '_> {
    /// World time of this tick.
    pub fn now(&self) -> WorldTime {
        self.tick.now
    }

    /// The robot.
    pub fn actions(&mut self) -> &mut dyn RobotActions {
        self.tick.actions
    }

    /// Reads an input port.
    ///
    /// # Errors
    /// [`PortError`] if the port is not bound, is empty, or contains another type than `T`.
    pub fn read<T: PortValue>(&self, port: &str) -> Result<T, PortError> {
        self.ports.read(self.tick.blackboard, port)
    }

    /// Reads an input port that may be omitted or empty.
    ///
    /// # Errors
    /// [`PortError`] if the port contains another type than `T`.
    pub(crate) fn read_optional<T: PortValue>(&self, port: &str) -> Result<Option<T>, PortError> {
        self.ports.read_optional(self.tick.blackboard, port)
    }

    /// Writes an output port. A value for a port that the tree omits is dropped.
    ///
    /// # Errors
    /// [`PortError`] if the port is bound to a fixed value, or its key has another type.
    pub fn write(&mut self, port: &str, value: impl Into<Value>) -> Result<(), PortError> {
        self.ports.write(self.tick.blackboard, port, value.into())
    }

    /// Cancels a goal, and tracks it until the robot has ended it.
    pub fn cancel(&mut self, goal: GoalId) {
        self.tick.actions.cancel(goal);
        self.tick.state.canceling.insert(goal);
    }

    /// Checks whether the robot has ended every goal that this tree canceled. Before that it would
    /// reject another goal as busy.
    pub fn cancels_complete(&mut self) -> bool {
        let Tick { actions, state: notes, .. } = &mut *self.tick;
        notes.canceling.retain(|goal| actions.status(*goal).is_some_and(|status| !status.is_final()));
        notes.canceling.is_empty()
    }
}

impl Cause {
    /// Creates a cause from a text.
    pub fn new(text: impl Into<String>) -> Cause {
        Cause { text: text.into(), error: None }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl From<ActionError> for Cause {
    fn from(error: ActionError) -> Cause {
        Cause { text: error.to_string(), error: Some(error) }
    }
}

impl From<PortError> for Cause {
    fn from(error: PortError) -> Cause {
        Cause::new(error.to_string())
    }
}
