//! Control nodes: several children, and a rule for which to tick. The rules are those of BehaviorTree.CPP 4.

mod ordered;
mod parallel;
mod reactive;

pub(crate) use ordered::Ordered;
pub(crate) use parallel::Parallel;
pub(crate) use reactive::Reactive;
