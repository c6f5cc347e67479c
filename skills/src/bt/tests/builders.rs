//! Constructors of built-in nodes, for short trees in tests.

use crate::bt::spec::NodeSpec;

/// Executes children in order until a child succeeds.
pub(super) fn fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Fallback").children(children)
}

/// Executes all children, starting with the first at every tick.
pub(super) fn reactive_sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveSequence").children(children)
}

/// Executes children until a child succeeds, starting with the first at every tick.
pub(super) fn reactive_fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveFallback").children(children)
}

/// Executes children in parallel: succeeds when `enough` of them succeed, fails once that is out of
/// reach.
pub(super) fn parallel(enough: u32, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    let node = NodeSpec::new("Parallel").children(children);
    node.port("success_count", &enough.to_string()).port("failure_count", "-1")
}

/// Inverts the child's status.
pub(super) fn inverter(child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Inverter").child(child)
}

/// Executes the child up to `attempts` times, until it succeeds.
pub(super) fn retry(attempts: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("RetryUntilSuccessful").port("num_attempts", &attempts.to_string()).child(child)
}

/// Executes the child `cycles` times, while it succeeds.
pub(super) fn repeat(cycles: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Repeat").port("num_cycles", &cycles.to_string()).child(child)
}
