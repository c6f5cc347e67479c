use super::*;
use crate::actions::{DeclaredGoal, Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use crate::descriptor::EstimateContext;
use crate::environment::{Edge, Routes, TopologicalMap};
use crate::library::SkillStatus;
use crate::skill::SkillContext;
use consort_protocol::ids::PlaceId;
use consort_protocol::mission::{NumberRange, TaskSpec, ValueKind};
use consort_protocol::pose::Pose;
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_protocol::yaml;
use serde_json::json;

const PLANTS: &str = r#"
domain: plants
description: watering plants
actions:
  water:
    parameters:
      litres: { type: number, unit: l, minimum: 0, maximum: 5 }
      gentle: { type: bool, optional: true }
    simulate: { duration_s: [6, 10], failure_rate: 0.5 }
  look: { repeatable: true }
tasks:
  water_plant:
    parameters:
      litres: { type: number, minimum: 0, maximum: 5 }
      at: { type: place, optional: true }
    action: water
    estimate: { time_s: "4.0 + 2.0 * litres", energy: "discharge * 10.0" }
  round: { tree: round.xml, parameters: { to: { type: place } }, estimate: { time_s: "distance.to / speed", ends_at: to } }
  look: { action: look }
"#;

const ROUND: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="round"><Sequence>
    <look/><water litres="0.5" gentle="true"/></Sequence></BehaviorTree></root>"#;

fn check(text: &str) -> Result<DomainFile, Vec<String>> {
    let trees = BTreeMap::from([("round.xml".to_owned(), ROUND.to_owned())]);
    DomainFile::check(yaml::parse(text).unwrap(), &trees, &[])
        .map_err(|problems| problems.iter().map(ToString::to_string).collect())
}

/// A robot that completes every goal at once.
#[derive(Default)]
struct InstantRobot(Vec<Goal>);

impl RobotActions for InstantRobot {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        self.0.push(goal);
        GoalId(self.0.len() as u64)
    }
    fn status(&self, _: GoalId) -> Option<GoalStatus> {
        Some(GoalStatus::succeeded())
    }
    fn cancel(&mut self, _: GoalId) {}
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }
}

fn task(task_type: &str, parameters: &[(&str, &str)]) -> TaskSpec {
    let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    TaskSpec { parameters, ..TaskSpec::of(task_type.parse().unwrap(), vec!["r1".parse().unwrap()]) }
}

#[test]
fn a_declared_task_sends_the_goals_of_its_actions() {
    let domain = check(PLANTS).unwrap();
    let mut library = SkillLibrary::standard(Environment::new());
    domain.extend_library(&mut library).unwrap();
    let goals = |task: &TaskSpec| {
        let mut skill = library.load(task, &SkillContext::default()).unwrap();
        let mut robot = InstantRobot::default();
        while skill.tick(&mut robot) == SkillStatus::Running {}
        robot.0
    };
    let goal = |action: &str, parameters: serde_json::Value, repeatable| {
        let parameters = parameters.as_object().unwrap().clone();
        Goal::Declared(DeclaredGoal { action: action.parse().unwrap(), parameters, repeatable })
    };
    assert_eq!(goals(&task("water_plant", &[("litres", "1.5")])), [goal("water", json!({ "litres": 1.5 }), false)]);
    let both = [goal("look", json!({}), true), goal("water", json!({ "litres": 0.5, "gentle": true }), false)];
    assert_eq!(goals(&task("round", &[("to", "B")])), both);
    let too_much = library.load(&task("water_plant", &[("litres", "9")]), &SkillContext::default());
    let problem = too_much.err().unwrap().to_string();
    assert!(problem.contains("allowed is 0 to 5"), "{problem}");
}

/// A robot refuses a task that was made with another content of the file.
#[test]
fn the_content_of_a_domain_is_compared_without_texts_for_people() {
    let domain = check(PLANTS).unwrap();
    let described = check(&PLANTS.replace("watering plants", "water for plants")).unwrap();
    assert_eq!(domain.reference(), described.reference());
    let changed = check(&PLANTS.replace("4.0 + 2.0", "5.0 + 2.0")).unwrap();
    assert_ne!(domain.reference(), changed.reference());

    let types: BTreeMap<TaskType, TaskSchema> = changed.task_types().collect();
    let made = TaskSpec { domain: types[&"look".parse::<TaskType>().unwrap()].domain.clone(), ..task("look", &[]) };
    assert_eq!(made.domain, Some(changed.reference()));
    let (mut library, at) = (SkillLibrary::standard(Environment::new()), "A".parse::<PlaceId>().unwrap());
    domain.extend_library(&mut library).unwrap();
    let refused = library.load(&made, &SkillContext::default()).err().unwrap().to_string();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new());
    assert!(estimator.is_err(), "its routes are missing");
    let map = TopologicalMap { places: BTreeMap::from([(at.clone(), Pose::new(0.0, 0.0, 0.0))]), edges: vec![] };
    let environment = Environment::new().with(Routes::new(&map).unwrap());
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(environment).unwrap();
    let context = EstimateContext {
        place: at,
        pose: None,
        speed: MetresPerSecond::new(0.5).unwrap(),
        discharge: SharePerSecond::new(0.001).unwrap(),
        closed: vec![],
    };
    let priced = estimator.estimate(&made, &context).unwrap_err().to_string();
    for problem in [refused, priced] {
        let expected =
            format!("the mission has look of the domain {}, and this node has the domain ", changed.reference());
        assert!(problem.starts_with(&expected) && problem.ends_with("their files differ"), "{problem}");
    }
    assert!(library.load(&task("look", &[]), &SkillContext::default()).is_ok(), "a task without a domain");
}

#[test]
fn missions_are_checked_against_the_parameters() {
    let domain = check(PLANTS).unwrap();
    let types: BTreeMap<TaskType, TaskSchema> = domain.task_types().collect();
    let schema = &types[&"water_plant".parse::<TaskType>().unwrap()];
    let range = NumberRange { minimum: Some(0.0), maximum: Some(5.0) };
    assert_eq!(schema.parameters["litres"].kind, ValueKind::Number(range));
    assert!(schema.parameters["litres"].required && !schema.parameters["at"].required);
    assert_eq!(domain.simulated_actions().map(|(_, action)| action.mean_s()).collect::<Vec<_>>(), [2.0, 8.0]);
}

#[test]
fn expressions_estimate_the_cost() {
    let domain = check(PLANTS).unwrap();
    let [a, b] = ["A", "B"].map(|id| id.parse::<PlaceId>().unwrap());
    let map = TopologicalMap {
        places: BTreeMap::from([(a.clone(), Pose::new(0.0, 0.0, 0.0)), (b.clone(), Pose::new(12.0, 0.0, 0.0))]),
        edges: vec![Edge { a, b, length_m: 12.0, one_way: false }],
    };
    let environment = Environment::new().with(Routes::new(&map).unwrap());
    let estimator = domain.extend_descriptors(DescriptorRegistry::standard()).resolve(environment).unwrap();
    let robot = EstimateContext {
        place: "A".parse().unwrap(),
        pose: None,
        speed: MetresPerSecond::new(0.5).unwrap(),
        discharge: SharePerSecond::new(0.001).unwrap(),
        closed: vec![],
    };
    let estimate = |task: TaskSpec| {
        let estimate = estimator.estimate(&task, &robot).unwrap();
        (estimate.time.get(), estimate.energy, estimate.ends_at.to_string())
    };
    assert_eq!(estimate(task("water_plant", &[("litres", "3")])), (10.0, 0.01, "A".to_owned()));
    assert_eq!(estimate(task("round", &[("to", "B")])), (24.0, 0.024, "B".to_owned()));
    // Without an estimate: the mean time of the action in the simulator.
    assert_eq!(estimate(task("look", &[])), (2.0, 0.002, "A".to_owned()));
}

#[test]
fn every_mistake_is_reported_with_its_place() {
    let wrong = r#"
domain: plants
actions:
  water: { parameters: { 2nd: { type: number }, mode: { type: place, one_of: [a] }, litres: { type: number } } }
  wait: { simulate: { duration_s: [6, 5], failure_rate: 2 } }
tasks:
  navigation: { action: water }
  sprinkle: { action: watr, parameters: { to: { type: text, minimum: 1 } } }
  both: { action: water, tree: round.xml, estimate: { time_s: "litres" } }
  climb: { tree: climb.xml, estimate: { time_s: "1 +" } }
"#;
    let problems = check(wrong).unwrap_err();
    for expected in [
        "actions.water.parameters.2nd: allowed is a letter",
        "actions.water.parameters.mode: only texts have `one_of`",
        "actions.wait.simulate.duration_s: allowed are two numbers",
        "actions.wait.simulate.failure_rate: allowed is a share",
        "tasks.navigation: the standard domain has a task type of this name",
        "tasks.navigation.action: water needs the parameter `litres` of the task",
        "tasks.sprinkle.action: the domain declares no action watr; allowed: wait, water; did you mean `water`?",
        "tasks.sprinkle.parameters.to: only numbers and integers have a minimum",
        "tasks.both: a task has either an `action` or a `tree`",
        "tasks.both.estimate.time_s: `litres`: Undeclared reference",
        "tasks.climb.estimate.time_s: ",
        "tasks.climb.tree: climb.xml is missing",
    ] {
        assert!(problems.iter().any(|problem| problem.starts_with(expected)), "{expected}\n{problems:#?}");
    }
    let unknown = check("domain: p\ntasks: { t: { tree: round.xml, estimate: { time_s: \"1.0\" } } }").unwrap_err();
    assert!(unknown[0].starts_with("round.xml:2: "), "{unknown:?}");
}

#[test]
fn two_domains_do_not_declare_the_same() {
    let plants = check(PLANTS).unwrap();
    let again = "domain: garden\nactions: { water: {} }\ntasks: { look: { action: water } }";
    let problems = DomainFile::check(yaml::parse(again).unwrap(), &BTreeMap::new(), &[&plants]).unwrap_err();
    let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
    for expected in [
        "actions.water: a node `water` is already registered",
        "tasks.look: the domain plants has a task type of this name",
    ] {
        assert!(problems.iter().any(|problem| problem == expected), "{expected}\n{problems:#?}");
    }
}
