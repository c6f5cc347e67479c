//! Duration of a tick of a behavior tree of 200 nodes. Every node is ticked, apart from the one that
//! sets the keys in the first tick.
//!
//! ```text
//! cargo bench -p consort-skills --bench tree_tick
//! ```
//!
//! `nodes` has no scripts. In `scripted` a tenth of the nodes has a script, which is evaluated at
//! every tick. The limit is 20 µs for a tick.

use consort_protocol::ids::TaskType;
use consort_protocol::mission::TaskSpec;
use consort_skills::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use consort_skills::bt::{PortSpec, PortType};
use consort_skills::environment::Environment;
use consort_skills::library::{ActiveSkill, SkillLibrary, SkillStatus};
use consort_skills::skill::SkillContext;
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;

/// Nodes of the tree: a root, 39 branches of 5 nodes, and 4 nodes that keep the tree running.
const NODES: usize = 1 + 39 * 5 + 4;

/// A robot that never receives a goal.
struct IdleRobot;

impl RobotActions for IdleRobot {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        panic!("no node of the tree sends {goal:?}")
    }
    fn status(&self, _: GoalId) -> Option<GoalStatus> {
        None
    }
    fn cancel(&mut self, _: GoalId) {}
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }
}

/// Returns the tree. Every second branch has a condition in a script, if `scripted`.
fn tree(scripted: bool) -> String {
    let branch = |number: usize| {
        let condition =
            if scripted && number.is_multiple_of(2) { " _skipIf=\"battery &lt; 0.2 || !free\"" } else { "" };
        format!(
            "<Fallback><Inverter><HasCharge battery=\"{{battery}}\"/></Inverter>
             <ForceSuccess><AlwaysSuccess{condition}/></ForceSuccess></Fallback>"
        )
    };
    let branches: String = (0..39).map(branch).collect();
    format!(
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"tree\"><ReactiveSequence>
         <RunOnce><Script code=\"battery := 0.8; free := true\"/></RunOnce>{branches}
         <KeepRunningUntilFailure><AlwaysSuccess/></KeepRunningUntilFailure>
         </ReactiveSequence></BehaviorTree></root>"
    )
}

fn skill(scripted: bool) -> ActiveSkill {
    let task_type = TaskType::new("bench").expect("a slug");
    let mut library = SkillLibrary::empty(Environment::new());
    let ports = [PortSpec::input("battery", PortType::Number)];
    let extended = library.extend(|registry| {
        registry.register_condition("HasCharge", ports, |leaf| Ok(leaf.read::<f64>("battery")? > 0.1))
    });
    extended.expect("the name is free");
    let text = tree(scripted);
    let nodes = text.matches('<').count() - text.matches("</").count() - 2;
    assert_eq!(nodes, NODES, "the tree has another size");
    library.register_xml(task_type.clone(), "bench.xml", &text).unwrap_or_else(|error| panic!("{error}"));
    library.load(&TaskSpec::of(task_type, vec![]), &SkillContext::default()).expect("the tree has no inputs")
}

fn ticks(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tree_tick");
    for (name, scripted) in [("nodes", false), ("scripted", true)] {
        let mut skill = skill(scripted);
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let status = black_box(&mut skill).tick(&mut IdleRobot);
                assert_eq!(status, SkillStatus::Running, "the tree has ended");
            });
        });
    }
    group.finish();
}

criterion_group!(benches, ticks);
criterion_main!(benches);
