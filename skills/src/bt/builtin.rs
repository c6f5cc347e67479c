//! The nodes that every tree may use, by the names of BehaviorTree.CPP 4.

use super::control::{Ordered, Parallel, Reactive};
use super::decorator::{Again, ForEach, Mapped, Timeout};
use super::leaf::{Always, Bound, Sleep};
use super::node::{Node, Slot};
use super::ports::{Manifest, NodeKind, PortSpec, Ports};
use super::status::Status;
use super::value::PortType;

/// A node that comes with the engine.
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

/// Longest limit in milliseconds: some 49 days.
const MAX_MSEC: f64 = u32::MAX as f64;
/// Most turns of a loop.
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

    pub(crate) fn manifest(self) -> Manifest {
        let count = |name, least| PortSpec::input(name, PortType::Integer).within(least, MAX_COUNT);
        let msec = || PortSpec::input("msec", PortType::Integer).within(0.0, MAX_MSEC);
        let (id, kind, ports) = match self {
            Builtin::Sequence => ("Sequence", NodeKind::Control, vec![]),
            Builtin::Fallback => ("Fallback", NodeKind::Control, vec![]),
            Builtin::Parallel => {
                let ports =
                    vec![count("success_count", -MAX_COUNT).or("-1"), count("failure_count", -MAX_COUNT).or("1")];
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
                let ports = vec![PortSpec::input("queue", PortType::List), value, if_empty.or("SUCCESS")];
                ("LoopString", NodeKind::Decorator, ports)
            }
            Builtin::AlwaysSuccess => ("AlwaysSuccess", NodeKind::Action, vec![]),
            Builtin::AlwaysFailure => ("AlwaysFailure", NodeKind::Action, vec![]),
            Builtin::Sleep => ("Sleep", NodeKind::Action, vec![msec()]),
        };
        Manifest::new(id, kind, ports)
    }

    pub(crate) fn named(id: &str) -> Option<Builtin> {
        Builtin::ALL.into_iter().find(|builtin| builtin.manifest().id == id)
    }

    /// Puts a node to work. The number of children has been checked.
    pub(crate) fn node(self, name: &str, ports: Ports, mut children: Vec<Slot>) -> Box<dyn Node> {
        let mut only = || children.pop().expect("a decorator was checked to have one child");
        match self {
            Builtin::Sequence => Box::new(Ordered::sequence(children)),
            Builtin::Fallback => Box::new(Ordered::fallback(children)),
            Builtin::Parallel => Box::new(Parallel::new(ports, children)),
            Builtin::ReactiveSequence => Box::new(Reactive::sequence(children)),
            Builtin::ReactiveFallback => Box::new(Reactive::fallback(children)),
            Builtin::Inverter => Box::new(Mapped::inverter(only())),
            Builtin::ForceSuccess => Box::new(Mapped::force(only(), Status::Success)),
            Builtin::ForceFailure => Box::new(Mapped::force(only(), Status::Failure)),
            Builtin::RetryUntilSuccessful => Box::new(Again::retry(ports, only())),
            Builtin::Repeat => Box::new(Again::repeat(ports, only())),
            Builtin::Timeout => Box::new(Timeout::new(ports, only())),
            Builtin::LoopString => Box::new(ForEach::new(ports, only())),
            Builtin::AlwaysSuccess => Box::new(Always(Status::Success)),
            Builtin::AlwaysFailure => Box::new(Always(Status::Failure)),
            Builtin::Sleep => Box::new(Bound { name: name.to_owned(), leaf: Box::new(Sleep::default()), ports }),
        }
    }
}
