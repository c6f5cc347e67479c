//! A script of a node, bound to the entries of its scope.

use super::blackboard::EntryId;
use super::error::{Place, TreeErrorKind};
use super::script::{Script, ScriptError};
use super::tick::Tick;
use std::sync::Arc;

/// A script with the entries of its keys, and its position for messages.
#[derive(Debug)]
pub(crate) struct BoundScript {
    pub(crate) script: Arc<Script>,
    /// The script attribute, or the port `code`.
    pub(crate) attribute: &'static str,
    pub(crate) entries: Vec<(String, EntryId)>,
    pub(crate) place: Place,
}

impl BoundScript {
    /// Executes the script. An error aborts the tree; then the result is `false`.
    pub(crate) fn run(&self, tick: &mut Tick<'_>) -> bool {
        match self.script.run(&self.entries, tick.blackboard) {
            Ok(_) => true,
            Err(error) => {
                self.abort(tick, error);
                false
            }
        }
    }

    /// Evaluates the condition. An error aborts the tree; then the result is `None`.
    pub(crate) fn holds(&self, tick: &mut Tick<'_>) -> Option<bool> {
        match self.script.holds(&self.entries, tick.blackboard) {
            Ok(holds) => Some(holds),
            Err(error) => {
                self.abort(tick, error);
                None
            }
        }
    }

    fn abort(&self, tick: &mut Tick<'_>, source: ScriptError) {
        let attribute = self.attribute.to_owned();
        tick.abort(self.place.error(TreeErrorKind::Script { attribute, source }).to_string());
    }
}
