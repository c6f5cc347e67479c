//! What a tick hands down the tree: the body, the time, the blackboard, and notes for whoever ticks.

use super::blackboard::Blackboard;
use super::ports::{PortError, Ports};
use super::value::{PortValue, Value};
use crate::actions::{ActionError, GoalId, RobotActions};
use consort_protocol::units::WorldTime;
use std::collections::BTreeSet;
use std::fmt;

/// How often loops (repeat, retry, for-each) may turn within one tick before they leave the rest to the next. A guess:
/// far above what a sound tree needs, and small enough that a tick stays below a few milliseconds.
pub const MAX_LOOP_ITERATIONS_PER_TICK: u32 = 1000;

/// One tick under way.
pub struct Tick<'a> {
    pub(crate) actions: &'a mut (dyn RobotActions + 'a),
    pub(crate) now: WorldTime,
    pub(crate) blackboard: &'a mut Blackboard,
    pub(crate) state: &'a mut TreeState,
    pub(crate) iterations_left: u32,
}

/// What a tree keeps from tick to tick beside its nodes.
#[derive(Debug, Default)]
pub(crate) struct TreeState {
    /// Why the last leaf that failed did.
    pub(crate) cause: Option<Cause>,
    /// When the tree wants to be ticked even if nothing happens.
    pub(crate) wake_at: Option<WorldTime>,
    /// Goals canceled, of which the body may not have let go yet.
    pub(crate) canceling: BTreeSet<GoalId>,
}

/// Why a leaf failed, for people; with the body's own error where there is one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cause {
    /// Names who and which.
    pub text: String,
    /// The error behind it, for programs.
    pub error: Option<ActionError>,
}

impl Tick<'_> {
    /// World time of this tick.
    pub fn now(&self) -> WorldTime {
        self.now
    }

    /// Asks to be ticked at `time` at the latest.
    pub(crate) fn wake_at(&mut self, time: WorldTime) {
        let earliest = self.state.wake_at.map_or(time, |set| if time < set { time } else { set });
        self.state.wake_at = Some(earliest);
    }

    /// Takes one turn of a loop; `false` when the tick has had enough, and the loop has to go on at the next.
    pub(crate) fn take_iteration(&mut self) -> bool {
        if self.iterations_left == 0 {
            self.wake_at(self.now);
            return false;
        }
        self.iterations_left -= 1;
        true
    }

    pub(crate) fn set_cause(&mut self, node: &str, cause: Cause) {
        self.state.cause = Some(Cause { text: format!("{node}: {}", cause.text), error: cause.error });
    }
}

/// One tick as a leaf sees it: its own ports, the body and the time.
pub struct LeafContext<'l, 't> {
    pub(crate) tick: &'l mut Tick<'t>,
    pub(crate) ports: &'l Ports,
}

impl LeafContext<'_, '_> {
    /// World time of this tick.
    pub fn now(&self) -> WorldTime {
        self.tick.now
    }

    /// The body.
    pub fn actions(&mut self) -> &mut dyn RobotActions {
        self.tick.actions
    }

    /// Reads an input port.
    ///
    /// # Errors
    /// [`PortError`] where it is not bound, holds nothing, or holds something else than `T`.
    pub fn read<T: PortValue>(&self, port: &str) -> Result<T, PortError> {
        self.ports.read(self.tick.blackboard, port)
    }

    /// Reads an input port that may be left out or empty.
    ///
    /// # Errors
    /// [`PortError`] where it holds something else than `T`.
    pub fn read_optional<T: PortValue>(&self, port: &str) -> Result<Option<T>, PortError> {
        self.ports.read_optional(self.tick.blackboard, port)
    }

    /// Writes an output port; one that the tree leaves out takes the value and drops it.
    ///
    /// # Errors
    /// [`PortError`] where it is bound to a fixed value, or its key takes another type.
    pub fn write(&mut self, port: &str, value: impl Into<Value>) -> Result<(), PortError> {
        self.ports.write(self.tick.blackboard, port, value.into())
    }

    /// Asks to be ticked at `time` at the latest, even if nothing happens before.
    pub fn wake_at(&mut self, time: WorldTime) {
        self.tick.wake_at(time);
    }

    /// Cancels a goal, and remembers it until the body has let go of it.
    pub fn cancel(&mut self, goal: GoalId) {
        self.tick.actions.cancel(goal);
        self.tick.state.canceling.insert(goal);
    }

    /// Whether the body has let go of every goal that this tree canceled: before that it would refuse another as busy.
    pub fn cancels_complete(&mut self) -> bool {
        let Tick { actions, state: notes, .. } = &mut *self.tick;
        notes.canceling.retain(|goal| actions.status(*goal).is_some_and(|status| !status.is_final()));
        notes.canceling.is_empty()
    }
}

impl Cause {
    /// A cause in words.
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
