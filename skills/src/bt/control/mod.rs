//! Control nodes: they have several children and a rule for ticking them. The rules are those of
//! BehaviorTree.CPP 4.

mod branch;
mod memory;
mod parallel;
mod reactive;

pub(crate) use branch::{IfThenElse, Switch, WhileDoElse};
pub(crate) use memory::MemoryControl;
pub(crate) use parallel::{Parallel, ParallelAll};
pub(crate) use reactive::ReactiveControl;
