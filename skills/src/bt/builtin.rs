//! The nodes that are built into the engine, with the names of BehaviorTree.CPP 4.

use super::control::{MemoryControl, Parallel, ReactiveControl};
use super::decorator::{ForEach, LoopNode, MapResult, Timeout};
use super::leaf::{ConstantNode, LeafNode, SleepLeaf};
use super::manifest::{NodeKind, NodeManifest, PortSpec};
use super::node::{ChildNode, Node};
use super::ports::Ports;
use super::status::NodeStatus;
use super::value::PortType;

/// A built-in node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Builtin {
    Sequence,
    Fallback,
    Parallel,
    ReactiveSequence,
    ReactiveFallback,
    Inverter,
    ForceSuccess,
    ForceFailure,
    RetryUntilSuccessful,
    Repeat,
    Timeout,
    LoopString,
    AlwaysSuccess,
    AlwaysFailure,
    Sleep,
}

/// Greatest time limit in milliseconds: about 49 days.
const MAX_MSEC: f64 = u32::MAX as f64;
/// Greatest number of iterations of a loop.
const MAX_COUNT: f64 = i32::MAX as f64;

impl Builtin {
    pub(crate) const ALL: [Builtin; 15] = [
        Builtin::Sequence,
        Builtin::Fallback,
        Builtin::Parallel,
        Builtin::ReactiveSequence,
        Builtin::ReactiveFallback,
        Builtin::Inverter,
        Builtin::ForceSuccess,
        Builtin::ForceFailure,
        Builtin::RetryUntilSuccessful,
        Builtin::Repeat,
        Builtin::Timeout,
        Builtin::LoopString,
        Builtin::AlwaysSuccess,
        Builtin::AlwaysFailure,
        Builtin::Sleep,
    ];

    pub(crate) fn manifest(self) -> NodeManifest {
        let count = |name, least| PortSpec::input(name, PortType::Integer).in_range(least, MAX_COUNT);
        let msec = || PortSpec::input("msec", PortType::Integer).in_range(0.0, MAX_MSEC);
        let (id, kind, ports) = match self {
            Builtin::Sequence => ("Sequence", NodeKind::Control, vec![]),
            Builtin::Fallback => ("Fallback", NodeKind::Control, vec![]),
            Builtin::Parallel => {
                let ports = vec![
                    count("success_count", -MAX_COUNT).with_default("-1"),
                    count("failure_count", -MAX_COUNT).with_default("1"),
                ];
                ("Parallel", NodeKind::Control, ports)
            }
            Builtin::ReactiveSequence => ("ReactiveSequence", NodeKind::Control, vec![]),
            Builtin::ReactiveFallback => ("ReactiveFallback", NodeKind::Control, vec![]),
            Builtin::Inverter => ("Inverter", NodeKind::Decorator, vec![]),
            Builtin::ForceSuccess => ("ForceSuccess", NodeKind::Decorator, vec![]),
            Builtin::ForceFailure => ("ForceFailure", NodeKind::Decorator, vec![]),
            Builtin::RetryUntilSuccessful => {
                ("RetryUntilSuccessful", NodeKind::Decorator, vec![count("num_attempts", -1.0)])
            }
            Builtin::Repeat => ("Repeat", NodeKind::Decorator, vec![count("num_cycles", -1.0)]),
            Builtin::Timeout => ("Timeout", NodeKind::Decorator, vec![msec()]),
            Builtin::LoopString => {
                let if_empty = PortSpec::input("if_empty", PortType::Text).one_of(&["SUCCESS", "FAILURE"]);
                let value = PortSpec::output("value", PortType::Any);
                let ports = vec![PortSpec::input("queue", PortType::List), value, if_empty.with_default("SUCCESS")];
                ("LoopString", NodeKind::Decorator, ports)
            }
            Builtin::AlwaysSuccess => ("AlwaysSuccess", NodeKind::Action, vec![]),
            Builtin::AlwaysFailure => ("AlwaysFailure", NodeKind::Action, vec![]),
            Builtin::Sleep => ("Sleep", NodeKind::Action, vec![msec()]),
        };
        NodeManifest::new(id, kind, ports)
    }

    pub(crate) fn by_id(id: &str) -> Option<Builtin> {
        Builtin::ALL.into_iter().find(|builtin| builtin.manifest().id == id)
    }

    /// Creates the node. The number of children has been checked.
    pub(crate) fn instantiate(self, name: &str, ports: Ports, mut children: Vec<ChildNode>) -> Box<dyn Node> {
        let mut only = || children.pop().expect("decorators have a single child (checked)");
        match self {
            Builtin::Sequence => Box::new(MemoryControl::sequence(children)),
            Builtin::Fallback => Box::new(MemoryControl::fallback(children)),
            Builtin::Parallel => Box::new(Parallel::new(ports, children)),
            Builtin::ReactiveSequence => Box::new(ReactiveControl::sequence(children)),
            Builtin::ReactiveFallback => Box::new(ReactiveControl::fallback(children)),
            Builtin::Inverter => Box::new(MapResult::inverter(only())),
            Builtin::ForceSuccess => Box::new(MapResult::force(only(), NodeStatus::Success)),
            Builtin::ForceFailure => Box::new(MapResult::force(only(), NodeStatus::Failure)),
            Builtin::RetryUntilSuccessful => Box::new(LoopNode::retry(ports, only())),
            Builtin::Repeat => Box::new(LoopNode::repeat(ports, only())),
            Builtin::Timeout => Box::new(Timeout::new(ports, only())),
            Builtin::LoopString => Box::new(ForEach::new(ports, only())),
            Builtin::AlwaysSuccess => Box::new(ConstantNode(NodeStatus::Success)),
            Builtin::AlwaysFailure => Box::new(ConstantNode(NodeStatus::Failure)),
            Builtin::Sleep => Box::new(LeafNode { name: name.to_owned(), leaf: Box::new(SleepLeaf::default()), ports }),
        }
    }
}
