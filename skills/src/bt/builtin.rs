//! The nodes that are built into the engine, with the names of BehaviorTree.CPP 4.

use super::bound_script::BoundScript;
use super::control::{IfThenElse, MemoryControl, Parallel, ParallelAll, ReactiveControl, Switch, WhileDoElse};
use super::decorator::{Delay, ForEach, KeepRunning, LoopNode, MapResult, RunOnce, Timeout};
use super::leaf::{ConstantNode, LeafNode, ScriptNode, SleepLeaf};
use super::manifest::{NodeKind, NodeManifest, PortSpec};
use super::node::{ChildNode, Node};
use super::ports::Ports;
use super::status::NodeStatus;
use super::value::PortType;
use std::sync::Arc;

/// A built-in node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Builtin {
    Sequence,
    AsyncSequence,
    SequenceWithMemory,
    Fallback,
    AsyncFallback,
    Parallel,
    ParallelAll,
    ReactiveSequence,
    ReactiveFallback,
    IfThenElse,
    WhileDoElse,
    /// `Switch2` to `Switch6`, by the number of cases.
    Switch(u8),
    Inverter,
    ForceSuccess,
    ForceFailure,
    RetryUntilSuccessful,
    Repeat,
    KeepRunningUntilFailure,
    RunOnce,
    Delay,
    Timeout,
    LoopString,
    AlwaysSuccess,
    AlwaysFailure,
    Sleep,
    Script,
    ScriptCondition,
}

/// Greatest time limit in milliseconds: about 49 days.
const MAX_MSEC: f64 = u32::MAX as f64;
/// Greatest number of iterations of a loop.
const MAX_COUNT: f64 = i32::MAX as f64;

impl Builtin {
    pub(crate) const ALL: [Builtin; 31] = [
        Builtin::Sequence,
        Builtin::AsyncSequence,
        Builtin::SequenceWithMemory,
        Builtin::Fallback,
        Builtin::AsyncFallback,
        Builtin::Parallel,
        Builtin::ParallelAll,
        Builtin::ReactiveSequence,
        Builtin::ReactiveFallback,
        Builtin::IfThenElse,
        Builtin::WhileDoElse,
        Builtin::Switch(2),
        Builtin::Switch(3),
        Builtin::Switch(4),
        Builtin::Switch(5),
        Builtin::Switch(6),
        Builtin::Inverter,
        Builtin::ForceSuccess,
        Builtin::ForceFailure,
        Builtin::RetryUntilSuccessful,
        Builtin::Repeat,
        Builtin::KeepRunningUntilFailure,
        Builtin::RunOnce,
        Builtin::Delay,
        Builtin::Timeout,
        Builtin::LoopString,
        Builtin::AlwaysSuccess,
        Builtin::AlwaysFailure,
        Builtin::Sleep,
        Builtin::Script,
        Builtin::ScriptCondition,
    ];

    /// Name in trees.
    pub(crate) const fn id(self) -> &'static str {
        match self {
            Builtin::Sequence => "Sequence",
            Builtin::AsyncSequence => "AsyncSequence",
            Builtin::SequenceWithMemory => "SequenceWithMemory",
            Builtin::Fallback => "Fallback",
            Builtin::AsyncFallback => "AsyncFallback",
            Builtin::Parallel => "Parallel",
            Builtin::ParallelAll => "ParallelAll",
            Builtin::ReactiveSequence => "ReactiveSequence",
            Builtin::ReactiveFallback => "ReactiveFallback",
            Builtin::IfThenElse => "IfThenElse",
            Builtin::WhileDoElse => "WhileDoElse",
            Builtin::Switch(0..=2) => "Switch2",
            Builtin::Switch(3) => "Switch3",
            Builtin::Switch(4) => "Switch4",
            Builtin::Switch(5) => "Switch5",
            Builtin::Switch(_) => "Switch6",
            Builtin::Inverter => "Inverter",
            Builtin::ForceSuccess => "ForceSuccess",
            Builtin::ForceFailure => "ForceFailure",
            Builtin::RetryUntilSuccessful => "RetryUntilSuccessful",
            Builtin::Repeat => "Repeat",
            Builtin::KeepRunningUntilFailure => "KeepRunningUntilFailure",
            Builtin::RunOnce => "RunOnce",
            Builtin::Delay => "Delay",
            Builtin::Timeout => "Timeout",
            Builtin::LoopString => "LoopString",
            Builtin::AlwaysSuccess => "AlwaysSuccess",
            Builtin::AlwaysFailure => "AlwaysFailure",
            Builtin::Sleep => "Sleep",
            Builtin::Script => "Script",
            Builtin::ScriptCondition => "ScriptCondition",
        }
    }

    pub(crate) fn by_id(id: &str) -> Option<Builtin> {
        Builtin::ALL.into_iter().find(|builtin| builtin.id() == id)
    }

    pub(crate) fn kind(self) -> NodeKind {
        match self {
            Builtin::Sequence
            | Builtin::AsyncSequence
            | Builtin::SequenceWithMemory
            | Builtin::Fallback
            | Builtin::AsyncFallback
            | Builtin::Parallel
            | Builtin::ParallelAll
            | Builtin::ReactiveSequence
            | Builtin::ReactiveFallback
            | Builtin::IfThenElse
            | Builtin::WhileDoElse
            | Builtin::Switch(_) => NodeKind::Control,
            Builtin::Inverter
            | Builtin::ForceSuccess
            | Builtin::ForceFailure
            | Builtin::RetryUntilSuccessful
            | Builtin::Repeat
            | Builtin::KeepRunningUntilFailure
            | Builtin::RunOnce
            | Builtin::Delay
            | Builtin::Timeout
            | Builtin::LoopString => NodeKind::Decorator,
            Builtin::AlwaysSuccess | Builtin::AlwaysFailure | Builtin::Sleep | Builtin::Script => NodeKind::Action,
            Builtin::ScriptCondition => NodeKind::Condition,
        }
    }

    pub(crate) fn manifest(self) -> NodeManifest {
        let count = |name, least| PortSpec::input(name, PortType::Integer).in_range(least, MAX_COUNT);
        let msec = |name| PortSpec::input(name, PortType::Integer).in_range(0.0, MAX_MSEC);
        let ports = match self {
            Builtin::Parallel => vec![
                count("success_count", -MAX_COUNT).with_default("-1"),
                count("failure_count", -MAX_COUNT).with_default("1"),
            ],
            Builtin::ParallelAll => vec![count("max_failures", -MAX_COUNT).with_default("1")],
            Builtin::Switch(cases) => {
                let case = |number| PortSpec::input(&format!("case_{number}"), PortType::Any);
                [PortSpec::input("variable", PortType::Any)].into_iter().chain((1..=cases).map(case)).collect()
            }
            Builtin::RetryUntilSuccessful => vec![count("num_attempts", -1.0)],
            Builtin::Repeat => vec![count("num_cycles", -1.0)],
            Builtin::RunOnce => vec![PortSpec::input("then_skip", PortType::Bool).with_default("true")],
            Builtin::Delay => vec![msec("delay_msec")],
            Builtin::Timeout | Builtin::Sleep => vec![msec("msec")],
            Builtin::LoopString => {
                let if_empty = PortSpec::input("if_empty", PortType::Text).one_of(&["SUCCESS", "FAILURE", "SKIPPED"]);
                let value = PortSpec::output("value", PortType::Any);
                vec![PortSpec::input("queue", PortType::List), value, if_empty.with_default("SUCCESS")]
            }
            Builtin::Script | Builtin::ScriptCondition => vec![PortSpec::input("code", PortType::Text)],
            _ => vec![],
        };
        NodeManifest::new(self.id(), self.kind(), ports)
    }

    /// Creates the node. The number of children has been checked, and `code` is the script of a
    /// node that has the port `code`.
    pub(crate) fn instantiate(
        self,
        name: &str,
        ports: Ports,
        code: Option<&Arc<BoundScript>>,
        mut children: Vec<ChildNode>,
    ) -> Box<dyn Node> {
        let mut only = || children.pop().expect("decorators have a single child (checked)");
        let code = || code.expect("nodes with the port `code` have a script (checked)").clone();
        match self {
            Builtin::Sequence => Box::new(MemoryControl::sequence(children)),
            Builtin::AsyncSequence => Box::new(MemoryControl::sequence(children).asynchronous()),
            Builtin::SequenceWithMemory => Box::new(MemoryControl::sequence(children).with_memory()),
            Builtin::Fallback => Box::new(MemoryControl::fallback(children)),
            Builtin::AsyncFallback => Box::new(MemoryControl::fallback(children).asynchronous()),
            Builtin::Parallel => Box::new(Parallel::new(ports, children)),
            Builtin::ParallelAll => Box::new(ParallelAll::new(ports, children)),
            Builtin::ReactiveSequence => Box::new(ReactiveControl::sequence(children)),
            Builtin::ReactiveFallback => Box::new(ReactiveControl::fallback(children)),
            Builtin::IfThenElse => Box::new(IfThenElse::new(children)),
            Builtin::WhileDoElse => Box::new(WhileDoElse::new(children)),
            Builtin::Switch(cases) => Box::new(Switch::new(cases, ports, children)),
            Builtin::Inverter => Box::new(MapResult::inverter(only())),
            Builtin::ForceSuccess => Box::new(MapResult::force(only(), NodeStatus::Success)),
            Builtin::ForceFailure => Box::new(MapResult::force(only(), NodeStatus::Failure)),
            Builtin::RetryUntilSuccessful => Box::new(LoopNode::retry(ports, only())),
            Builtin::Repeat => Box::new(LoopNode::repeat(ports, only())),
            Builtin::KeepRunningUntilFailure => Box::new(KeepRunning::new(only())),
            Builtin::RunOnce => Box::new(RunOnce::new(ports, only())),
            Builtin::Delay => Box::new(Delay::new(ports, only())),
            Builtin::Timeout => Box::new(Timeout::new(ports, only())),
            Builtin::LoopString => Box::new(ForEach::new(ports, only())),
            Builtin::AlwaysSuccess => Box::new(ConstantNode(NodeStatus::Success)),
            Builtin::AlwaysFailure => Box::new(ConstantNode(NodeStatus::Failure)),
            Builtin::Sleep => Box::new(LeafNode { name: name.to_owned(), leaf: Box::new(SleepLeaf::default()), ports }),
            Builtin::Script => Box::new(ScriptNode::action(code())),
            Builtin::ScriptCondition => Box::new(ScriptNode::condition(name, code())),
        }
    }
}
