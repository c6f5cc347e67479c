//! Tests of the engine. A fake leaf returns a given list of statuses (as py_trees tests its
//! composites), and records when it is ticked and halted.

mod branches;
mod builders;
mod checks;
mod composites;
mod conditions;
mod decorators;
mod report;
mod scopes;
mod scripts;
mod xml;

use super::tick::MAX_LOOP_ITERATIONS_PER_TICK;
use super::*;
use crate::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use builders::{fallback, inverter, parallel, reactive_fallback, reactive_sequence, repeat, retry};
use consort_protocol::units::WorldTime;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Calls of the fake leaves: `a` for a tick of `a`, `a!` for a halt.
#[derive(Clone, Default)]
struct CallLog(Arc<Mutex<Vec<String>>>);

impl CallLog {
    fn note(&self, what: String) {
        self.0.lock().unwrap().push(what);
    }

    /// Returns the calls since the last time.
    fn take(&self) -> String {
        std::mem::take(&mut *self.0.lock().unwrap()).join(" ")
    }
}

/// A robot that must never receive a goal.
struct NoRobot;

impl RobotActions for NoRobot {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        panic!("nobody sends {goal:?} here")
    }
    fn status(&self, _: GoalId) -> Option<GoalStatus> {
        None
    }
    fn cancel(&mut self, goal: GoalId) {
        panic!("nobody sent {goal:?}")
    }
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }
}

/// Returns the statuses in its port `plays`, a letter per tick: `R`, `S`, `F`. The last letter
/// repeats.
struct Play {
    name: String,
    left: Option<VecDeque<char>>,
    log: CallLog,
}

impl Leaf for Play {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if self.left.is_none() {
            self.name = context.read("as")?;
            self.left = Some(context.read::<String>("plays")?.chars().collect());
        }
        self.log.note(self.name.clone());
        let left = self.left.as_mut().expect("it was just filled");
        let letter = if left.len() > 1 { left.pop_front() } else { left.front().copied() };
        match letter {
            Some('R') => Ok(NodeStatus::Running),
            Some('S') => Ok(NodeStatus::Success),
            Some('F') => Err(Cause::new(format!("{} says no", self.name))),
            other => panic!("{other:?} is no status"),
        }
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {
        self.log.note(format!("{}!", self.name));
    }
}

fn registry() -> Registry<CallLog> {
    let mut registry = Registry::new();
    let text = |name| PortSpec::input(name, PortType::Text);
    let manifest = NodeManifest::new("Play", NodeKind::Action, [text("as"), text("plays")]);
    let make =
        |log: &CallLog| -> Box<dyn Leaf> { Box::new(Play { name: String::new(), left: None, log: log.clone() }) };
    registry.register(manifest, make).unwrap();
    let place = [PortSpec::input("place", PortType::Place)];
    registry.register_condition("IsHome", place, |leaf| Ok(leaf.read::<String>("place")? == "Home")).unwrap();
    let ports = [PortSpec::input("value", PortType::Any), PortSpec::output("to", PortType::Any)];
    registry
        .register(NodeManifest::new("Copy", NodeKind::Action, ports), |_| {
            Box::new(SyncLeaf(|leaf: &mut LeafContext<'_, '_>| {
                let value: Value = leaf.read("value")?;
                leaf.write("to", value)?;
                Ok(true)
            }))
        })
        .unwrap();
    registry
}

/// A fake leaf with a name and its statuses.
fn play(name: &str, plays: &str) -> NodeSpec {
    NodeSpec::new("Play").port("as", name).port("plays", plays)
}

/// A tree under test, with its own clock.
struct TreeFixture {
    tree: Tree,
    log: CallLog,
    now: WorldTime,
}

impl TreeFixture {
    fn from_root(root: NodeSpec) -> TreeFixture {
        TreeFixture::from_spec(&TreeSpec::single("main", root))
    }

    fn from_spec(spec: &TreeSpec) -> TreeFixture {
        let log = CallLog::default();
        let tree = registry().check(spec).unwrap_or_else(|error| panic!("{error}")).instantiate(&log);
        TreeFixture { tree, log, now: WorldTime::ZERO }
    }

    /// Ticks once. Returns the letter of the status, and the calls.
    fn tick(&mut self) -> (char, String) {
        let status = match self.tree.tick(&mut NoRobot, self.now) {
            NodeStatus::Running => 'R',
            NodeStatus::Success => 'S',
            NodeStatus::Failure => 'F',
            NodeStatus::Skipped => '-',
        };
        (status, self.log.take())
    }

    /// Ticks once for each expectation.
    fn expect(&mut self, expected: &[(char, &str)]) {
        for (number, (status, log)) in expected.iter().enumerate() {
            assert_eq!(self.tick(), (*status, (*log).to_owned()), "tick {}", number + 1);
        }
    }

    fn halt(&mut self) -> String {
        self.tree.halt(&mut NoRobot, self.now);
        self.log.take()
    }

    fn at(&mut self, seconds: f64) -> &mut TreeFixture {
        self.now = WorldTime::from_secs(seconds);
        self
    }
}

/// Returns the error for a description.
fn check_error(spec: &TreeSpec) -> String {
    match registry().check(spec) {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    }
}
