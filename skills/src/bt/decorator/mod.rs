//! Decorators: nodes with a single child that change its status or the number of its executions.
//! The rules are those of BehaviorTree.CPP 4.

mod for_each;
mod repeat;
mod result;
mod time;

pub(crate) use for_each::ForEach;
pub(crate) use repeat::{KeepRunning, LoopNode};
pub(crate) use result::{MapResult, RunOnce};
pub(crate) use time::{Delay, Timeout};
