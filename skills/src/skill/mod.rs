//! The leaves of behavior trees that are written in Rust, and the data of a running skill.
//!
//! The leaves of declared actions are [`GoalLeaf`]s: each sends a goal and tracks it. An action with
//! `retry` has a `RetryLeaf`, which tries its goal again for a while. The leaves here compute what a domain file
//! cannot express: routes, headings along a path, the holders of roles, values of other members of an
//! ensemble, and questions to people.

mod ask_person;
mod context;
mod follow_path;
mod goal_leaf;
mod member_value;
mod navigation;
mod retry_leaf;
mod roles;
mod stated_question;
mod value_condition;

pub(crate) use ask_person::ASK_PERSON;
pub use context::{SkillContext, TaskContext};
pub use goal_leaf::GoalLeaf;
pub use member_value::member_value_errors;
pub(crate) use retry_leaf::RetryLeaf;
pub use stated_question::StatedQuestion;
pub(crate) use stated_question::{KnownValues, stated_questions};
pub(crate) use value_condition::{EQUALS, MAXIMUM, MINIMUM, VALUE, value_holds};

use crate::bt::{Registry, RegistryError};

/// Registers the leaves that are written in Rust.
pub(crate) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    ask_person::register_leaves(registry)?;
    roles::register_leaves(registry)?;
    member_value::register_leaves(registry)?;
    navigation::register_leaves(registry)?;
    follow_path::register_leaves(registry)
}
