mod distributions;
mod feedback;
mod items;
mod requirements;

use super::*;
use crate::actions::{ActionError, ErrorCode, Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use crate::descriptor::EstimateContext;
use crate::environment::{Edge, Environment, Routes, TopologicalMap};
use crate::library::SkillStatus;
use crate::skill::SkillContext;
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::PlaceId;
use consort_protocol::mission::{NumberRange, TaskSpec, ValueKind};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
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

const RESULTS: &str = r#"
domain: ward
actions:
  count:
    results: { beds: { type: integer }, free: { type: bool } }
    simulate: { duration_s: [30, 60], results: { beds: [2, 4] } }
tasks:
  count: { action: count }
  glance: { action: count, results: { beds: { type: integer } } }
"#;

const ROUND: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="round"><Sequence>
    <look/><water litres="0.5" gentle="true"/></Sequence></BehaviorTree></root>"#;

fn check(text: &str) -> Result<DomainFile, Vec<String>> {
    let trees = BTreeMap::from([("round.xml".to_owned(), ROUND.to_owned())]);
    DomainFile::check(yaml::parse(text).unwrap(), &trees, &[])
        .map_err(|problems| problems.iter().map(ToString::to_string).collect())
}

/// A robot at the place A.
fn robot() -> EstimateContext {
    EstimateContext::at("A".parse().unwrap(), MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap())
}

/// A robot that completes every goal at once, with its telemetry.
#[derive(Default)]
struct InstantRobot(Vec<Goal>, Option<Telemetry>);

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
        self.1.as_ref()
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
        Goal { action: action.parse().unwrap(), parameters, repeatable, hands_over: None, since: None }
    };
    assert_eq!(goals(&task("water_plant", &[("litres", "1.5")])), [goal("water", json!({ "litres": 1.5 }), false)]);
    let both = [goal("look", json!({}), true), goal("water", json!({ "litres": 0.5, "gentle": true }), false)];
    assert_eq!(goals(&task("round", &[("to", "B")])), both);
    let too_much = library.load(&task("water_plant", &[("litres", "9")]), &SkillContext::default());
    let problem = too_much.err().unwrap().to_string();
    assert!(problem.contains("allowed is 0 to 5"), "{problem}");
}

/// Formulas that are computed without CEL are checked like all others.
#[test]
fn an_energy_may_be_a_parameter_or_the_time_of_a_drive() {
    let text = r#"
domain: d
actions: { a: {} }
tasks:
  given: { action: a, parameters: { share: { type: number } }, estimate: { time_s: "1.0", energy: share } }
  driven: { action: a, parameters: { to: { type: place } }, estimate: { time_s: "1.0", energy: travel_s.to } }
"#;
    let domain = DomainFile::check(yaml::parse(text).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let edge = Edge { a: "A".parse().unwrap(), b: "B".parse().unwrap(), length_m: 10.0, one_way: false };
    let places = ["A", "B"].map(|name| (name.parse().unwrap(), Pose::default())).into();
    let environment = Environment::new().with(Routes::new(&TopologicalMap { places, edges: vec![edge] }).unwrap());
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(environment).unwrap();
    let energy = |task: &TaskSpec| estimator.estimate(task, &robot()).map(|estimate| estimate.energy);
    assert_eq!(energy(&task("given", &[("share", "0.5")])), Ok(0.5));
    assert_eq!(energy(&task("driven", &[("to", "B")])), Ok(20.0));
    let negative = energy(&task("given", &[("share", "-0.5")])).unwrap_err().to_string();
    assert_eq!(negative, "the given task has `share` = \"-0.5\": allowed are finite numbers of 0 or more");
}

#[test]
fn a_task_uses_the_discharge_of_its_action() {
    let text = r#"
domain: digging
actions: { dig: { discharge: 3 }, look: { discharge: -1 } }
tasks:
  dig: { action: dig, parameters: { depth_m: { type: number } }, estimate: { time_s: "10.0 * depth_m" } }
  scrape: { action: dig, estimate: { time_s: "10.0", energy: "0.5" } }
"#;
    let problem = check(text).unwrap_err();
    assert_eq!(problem, ["actions.look.discharge: allowed is a multiple of 0 or more"]);
    let domain = check(&text.replace("-1", "1")).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let energy = |task: TaskSpec| estimator.estimate(&task, &robot()).unwrap().energy;
    let dug = energy(task("dig", &[("depth_m", "2")]));
    assert!((dug - 0.06).abs() < 1e-12, "{dug}: 20 s at three times 0.001 a second");
    assert_eq!(energy(task("scrape", &[])), 0.5, "the energy is stated");
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
    let context = robot();
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
    assert_eq!(domain.simulated_actions().map(|(_, action)| action.simulate.mean_s()).collect::<Vec<_>>(), [2.0, 8.0]);
}

#[test]
fn people_play_the_action_of_a_task_with_the_results_of_the_task() {
    let domain = DomainFile::check(yaml::parse(RESULTS).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let tasks: BTreeMap<TaskType, ActionForm> = domain.simulated_tasks().collect();
    let [count, glance] = ["count", "glance"].map(|name| tasks[&name.parse::<TaskType>().unwrap()].clone());
    assert_eq!((count.simulate.duration_s, count.results.len()), (SimulatedDuration::Range([30.0, 60.0]), 2));
    assert_eq!(count.simulate.results["beds"], SimulatedResult::Range([2.0, 4.0]));
    let free = SimulatedResult::OneOf(vec![Scalar::Bool(false), Scalar::Bool(true)]);
    assert_eq!(count.simulate.results["free"], free, "within the declared range");
    assert_eq!(glance.results.keys().collect::<Vec<_>>(), ["beds"]);
    assert_eq!(glance.simulate.duration_s, SimulatedDuration::Range([30.0, 60.0]));
    let plants: BTreeMap<TaskType, ActionForm> = check(PLANTS).unwrap().simulated_tasks().collect();
    let round = &plants[&"round".parse::<TaskType>().unwrap()];
    assert_eq!(round.simulate.system.as_deref(), Some("people"), "a tree declares no time");
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
    let robot = robot();
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
fn a_task_requires_attributes_of_the_robot() {
    let text = r#"
domain: moving
actions: { lift: { parameters: { mass_kg: { type: number } } } }
tasks:
  lift:
    parameters: { mass_kg: { type: number } }
    action: lift
    requires: "attributes.payload_kg >= mass_kg"
    estimate: { time_s: "mass_kg / attributes.payload_kg" }
"#;
    let domain = check(text).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let task = task("lift", &[("mass_kg", "3")]);
    let estimate = |attributes: serde_json::Value| {
        let robot = EstimateContext { attributes: serde_json::from_value(attributes).unwrap(), ..robot() };
        estimator.estimate(&task, &robot).map(|estimate| estimate.time.get()).map_err(|error| error.to_string())
    };
    assert_eq!(estimate(json!({ "payload_kg": 6.0 })), Ok(0.5));
    let lacks = "lift requires `attributes.payload_kg >= mass_kg`, which ";
    assert_eq!(estimate(json!({ "payload_kg": 2.0 })), Err(format!("{lacks}is false")));
    assert_eq!(estimate(json!({})), Err(format!("{lacks}has no value: No such key: payload_kg")));
    for (condition, expected) in [
        ("mass_kg", "tasks.lift.requires: `mass_kg` is Float(1.0); allowed is true or false"),
        ("weight > 1.0", "tasks.lift.requires: `weight > 1.0` has no value: Undeclared reference"),
        ("mass_kg >", "tasks.lift.requires: "),
    ] {
        let problems = check(&text.replace("attributes.payload_kg >= mass_kg", condition)).unwrap_err();
        assert!(problems[0].starts_with(expected), "{problems:?}");
    }
}

#[test]
fn every_mistake_is_reported_with_its_place() {
    let wrong = r#"
domain: plants
actions:
  water: { parameters: { 2nd: { type: number }, mode: { type: place, one_of: [a] }, litres: { type: number } } }
  wait: { simulate: { as: dock, duration_s: [6, 5], failure_rate: 2 } }
  fill: { failures: { tap closed: {}, leak: {} }, simulate: { failures: { leek: 0.1, leak: 0.9 }, failure_rate: 0.2 } }
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
        "actions.wait.simulate.as: `as` is a kind of goals of a `system`",
        "actions.wait.simulate.duration_s: allowed are two numbers",
        "actions.wait.simulate.failure_rate: allowed is a share",
        "actions.fill.failures.tap closed: allowed is a letter",
        "actions.fill.simulate.failures.leek: no such failure; allowed: leak, tap closed; did you mean `leak`?",
        "actions.fill.simulate: the shares of failures add up to 1.2",
        "tasks.navigation: the standard domain has a task type of this name",
        "tasks.navigation.action: water needs the parameter `litres` of the task",
        "tasks.sprinkle.action: the domain declares no action watr; allowed: fill, wait, water; did you mean `water`?",
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
fn goals_say_whether_they_hand_items_over() {
    let goals = |action: &str| {
        let text = format!("domain: d\nactions: {{ load: {action} }}\ntasks: {{ load: {{ action: load }} }}");
        let domain = check(&text).unwrap();
        let mut library = SkillLibrary::standard(Environment::new());
        domain.extend_library(&mut library).unwrap();
        let mut skill = library.load(&task("load", &[]), &SkillContext::default()).unwrap();
        let mut robot = InstantRobot::default();
        while skill.tick(&mut robot) == SkillStatus::Running {}
        robot.0.iter().map(Goal::may_move_items).collect::<Vec<_>>()
    };
    for (action, may_move_items) in [
        ("{}", true),
        ("{ repeatable: true }", false),
        ("{ hands_over: false }", false),
        ("{ repeatable: true, hands_over: true }", true),
    ] {
        assert_eq!(goals(action), [may_move_items], "{action}");
    }
}

#[test]
fn wrong_moves_and_cancels_are_reported_with_their_place() {
    let wrong = r#"
domain: loading
actions:
  a: { cancel: { within_s: 0 } }
  b: { cancel: { within_s: 61 } }
  c: { simulate: { system: arm, moves: { from: table, to: container } } }
  d: { by_people: true, simulate: { moves: { from: table, to: table } } }
  e: { repeatable: true, simulate: { moves: { from: table, to: arm } } }
  f: { hands_over: false, simulate: { moves: { from: table, to: arm, robot: other } } }
  g:
    parameters: { name: { type: text, optional: true }, thing: { type: text }, other: { type: robot } }
    failures: { gone: {} }
    simulate: { moves: { from: other_container, to: arm, item: thin, otherwise: gon } }
  h:
    parameters: { name: { type: text, optional: true }, other: { type: text } }
    simulate: { moves: { from: arm, to: other_container, item: name, robot: other } }
"#;
    let problems = check(wrong).unwrap_err();
    let expected = [
        "actions.a.cancel.within_s: allowed are seconds from 0.1 to 60",
        "actions.b.cancel.within_s: allowed are seconds from 0.1 to 60",
        "actions.c.simulate.moves: the system arm determines what a goal moves; omit `moves`",
        "actions.d.simulate.moves: people perform the action, and only robots have `moves`",
        "actions.d.simulate.moves: `from` and `to` are the same; allowed are two different holders",
        "actions.e.simulate.moves: an action that moves items needs `hands_over: true`",
        "actions.f.simulate.moves: an action that moves items needs `hands_over: true`",
        "actions.f.simulate.moves.robot: only `other_container` has a robot; omit `robot`",
        "actions.g.simulate.moves.item: no parameter with the type \"text\" that is not `optional`; allowed: thing; did \
         you mean `thing`?",
        "actions.g.simulate.moves: `other_container` needs `robot`: a parameter of type robot",
        "actions.g.simulate.moves.otherwise: no such failure; allowed: gone; did you mean `gone`?",
        "actions.h.simulate.moves.item: no parameter with the type \"text\" that is not `optional`; allowed: other",
        "actions.h.simulate.moves.robot: no parameter with the type \"robot\" that is not `optional`; no names are \
         available",
    ];
    assert_eq!(problems, expected);
    let unknown =
        yaml::parse::<DomainForm>("domain: d\nactions: { a: { simulate: { moves: { from: shelf, to: arm } } } }");
    let unknown = unknown.unwrap_err();
    assert!(unknown.contains("shelf") && unknown.contains("other_container"), "{unknown}");
}

#[test]
fn a_declared_failure_has_a_class() {
    let text = "{ failures: { dry: { class: task, moved_nothing: true }, leak: {} } }";
    let action: ActionForm = yaml::parse(text).unwrap();
    let error = |class, moved_nothing, message: &str| {
        Some(ActionError { class, moved_nothing, ..ActionError::new(ErrorCode::Failed, message) })
    };
    assert_eq!(action.failure("dry", "the can is empty"), error(CauseClass::Task, true, "dry: the can is empty"));
    assert_eq!(action.failure("leak", "wet"), error(CauseClass::Robot, false, "leak: wet"));
    assert_eq!(action.failure("other", "?"), None);
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

const BAG: &str = r#"
domain: cleaning
actions:
  empty_bag: { simulate: { effects: { bag_g: 0, bag_full: false, mode: [idle, eco] } } }
  sweep: { repeatable: true, simulate: { effects: { bag_g: { add: 2.5 }, passes: [1, 3] } } }
readings:
  bag_g: { type: number, unit: g, minimum: 0, maximum: 50, description: dust in the bag, simulate: { value: 5 } }
  bag_full: { type: bool }
  passes: { type: integer, minimum: 0, maximum: 9, simulate: { value: [0, 2] } }
  mode: { type: text, one_of: [idle, eco, strong] }
  at: { type: place }
tasks:
  clean: { tree: clean.xml, estimate: { time_s: "1.0" } }
"#;

#[test]
fn a_tree_of_a_robot_contains_no_action_of_people() {
    let domain = "domain: d\nactions:\n  sign: { by_people: true }\ntasks:\n  sign: { action: sign }\n  \
        round: { tree: round.xml, estimate: { time_s: \"1.0\" } }";
    for (action, node) in [("ask_person", "<ask_person message=\"why?\"/>"), ("sign", "<Action ID=\"sign\"/>")] {
        let text = format!(
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"round\"><Sequence>\n{node}</Sequence></BehaviorTree></root>"
        );
        let trees = BTreeMap::from([("round.xml".to_owned(), text)]);
        let problems = DomainFile::check(yaml::parse(domain).unwrap(), &trees, &[]).unwrap_err();
        let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
        let expected =
            format!("round.xml:2: people perform `{action}`, and no robot; the node that asks a person is `AskPerson`");
        assert_eq!(problems, [expected]);
    }
}

/// Runs a tree of the domain `BAG` with these readings of the robot. Returns the actions of its goals, and
/// the cause of a failure.
fn run_tree(tree: &str, readings: serde_json::Value) -> (Vec<String>, Option<String>) {
    let text = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"clean\">{tree}</BehaviorTree></root>");
    let trees = BTreeMap::from([("clean.xml".to_owned(), text)]);
    let domain = DomainFile::check(yaml::parse(BAG).unwrap(), &trees, &[]).unwrap();
    let mut library = SkillLibrary::standard(Environment::new());
    domain.extend_library(&mut library).unwrap();
    let telemetry = json!({
        "time": 1.0, "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 }, "place": "Dock", "battery": 1.0, "able": true,
        "closed": [], "readings": readings,
    });
    let mut robot = InstantRobot(vec![], Some(serde_json::from_value(telemetry).unwrap()));
    let mut skill = library.load(&task("clean", &[]), &SkillContext::default()).unwrap();
    let cause = loop {
        match skill.tick(&mut robot) {
            SkillStatus::Running => {}
            SkillStatus::Failed { cause, .. } => break Some(cause),
            SkillStatus::Succeeded(_) => break None,
        }
    };
    (robot.0.iter().map(|goal| goal.action.to_string()).collect(), cause)
}

#[test]
fn a_reading_is_a_condition_of_trees() {
    let readings = json!({ "bag_g": 12, "bag_full": true, "passes": 3, "mode": "eco", "at": "Dock" });
    for (condition, cause) in [
        ("<bag_full/>", None),
        (r#"<Condition ID="bag_full" equals="true"/>"#, None),
        (r#"<bag_full equals="false"/>"#, Some("bag_full: the reading is true, not false")),
        ("<bag_g/>", None),
        (r#"<bag_g minimum="12" maximum="12"/>"#, None),
        (r#"<bag_g minimum="12.5"/>"#, Some("bag_g: the reading is 12, below the minimum 12.5")),
        (r#"<bag_g maximum="11"/>"#, Some("bag_g: the reading is 12, above the maximum 11")),
        (r#"<bag_g equals="12"/>"#, None),
        (r#"<passes minimum="4"/>"#, Some("passes: the reading is 3, below the minimum 4")),
        (r#"<mode equals="eco"/>"#, None),
        (r#"<mode equals="idle"/>"#, Some("mode: the reading is eco, not idle")),
        (r#"<at equals="Dock"/>"#, None),
    ] {
        let (goals, failure) = run_tree(&format!("<Sequence>{condition}<sweep/></Sequence>"), readings.clone());
        assert_eq!(failure.as_deref(), cause, "{condition}");
        assert_eq!(goals.len(), usize::from(cause.is_none()), "{condition}");
    }
    let off = run_tree("<Fallback><bag_full/><empty_bag/></Fallback>", json!({ "bag_full": false }));
    assert_eq!(off, (vec!["empty_bag".to_owned()], None));
}

#[test]
fn an_unknown_reading_fails_with_its_cause() {
    let (goals, cause) = run_tree("<Sequence><bag_full/><sweep/></Sequence>", json!({ "bag_g": 1.0 }));
    let expected = "bag_full: the reading is unknown: the driver has not published it";
    assert_eq!((goals.len(), cause.as_deref()), (0, Some(expected)));
}

/// Limits come from the blackboard, and the value goes to it.
#[test]
fn scripts_use_the_value_of_a_reading() {
    let tree = r#"<Sequence>
        <Script code="limit := 10.0"/>
        <bag_g value="{bag}"/>
        <sweep _skipIf="bag &gt; limit"/>
        <empty_bag _while="bag &gt; limit"/>
        <ForceSuccess><Sequence><bag_g maximum="{limit}"/><sweep/></Sequence></ForceSuccess>
        </Sequence>"#;
    let actions = |bag: f64| run_tree(tree, json!({ "bag_g": bag })).0;
    assert_eq!(actions(12.0), ["empty_bag"]);
    assert_eq!(actions(8.0), ["sweep", "sweep"]);
}

#[test]
fn wrong_readings_and_effects_are_reported_with_their_place() {
    let wrong = r#"
domain: cleaning
actions:
  sweep:
    results: { dust_g: { type: number, minimum: 0 }, rounds: { type: integer, minimum: 1 } }
    simulate:
      results: { dust_g: [5, 1], rounds: 0 }
      effects: { bag: 1, bag_g: 60, passes: { add: 1 }, bag_full: { add: 1 }, mode: [eco, loud], lid: [1, 2] }
readings:
  bag_g: { type: number, minimum: 0, maximum: 50, simulate: { value: [20, 10] } }
  passes: { type: integer, simulate: { value: 0.5 } }
  bag_full: { type: bool, minimum: 1 }
  mode: { type: text, one_of: [eco], optional: true }
  lid: { type: bool }
  bag-level: { type: number }
  nurse: { type: role }
  sweep: { type: bool }
"#;
    let problems = check(wrong).unwrap_err();
    let effect = "actions.sweep.simulate.effects";
    for expected in [
        format!("{effect}.bag: the domain declares no such reading; allowed: bag-level, "),
        format!("{effect}.bag_g: `60` does not fit the reading; allowed is a number from 0 to 50"),
        format!("{effect}.bag_full: `add` needs a finite number and a reading that is a number; it is true or false"),
        format!("{effect}.mode: `loud` does not fit the reading; allowed is one of eco"),
        format!("{effect}.lid: the range [1, 2] does not fit the reading; allowed is true or false"),
        "actions.sweep.simulate.results.dust_g: the range [5, 1] does not fit the result; allowed is".to_owned(),
        "actions.sweep.simulate.results.rounds: `0` does not fit the result; allowed is".to_owned(),
        "readings.bag_g.simulate.value: the range [20, 10] does not fit the reading".to_owned(),
        "readings.passes.simulate.value: `0.5` does not fit the reading; allowed is a whole number".to_owned(),
        "readings.bag_full: only numbers and integers have a minimum".to_owned(),
        "readings.mode: a reading is not `optional`".to_owned(),
        "readings.bag-level: allowed is a letter, followed by letters, digits and `_`".to_owned(),
        "readings.nurse: allowed are place, seconds, number, integer, bool and text".to_owned(),
        "readings.sweep: a node `sweep` is already registered".to_owned(),
    ] {
        assert!(problems.iter().any(|problem| problem.starts_with(&expected)), "{expected}\n{problems:#?}");
    }
    assert!(problems.iter().any(|problem| problem.ends_with("did you mean `bag_g`?")), "{problems:#?}");
    assert_eq!(problems.len(), 14, "{problems:#?}");
    let many: String = (0..65).map(|number| format!("  r{number}: {{ type: bool }}\n")).collect();
    let problems = check(&format!("domain: many\nreadings:\n{many}")).unwrap_err();
    assert_eq!(problems, ["readings: 65 readings in all domains; at most 64 are allowed"]);
    let misspelt = yaml::parse::<DomainForm>("domain: d\nreadings: { lid: { type: bool, minmum: 1 } }").unwrap_err();
    assert!(misspelt.contains("unknown field `minmum`"), "{misspelt}");
}

/// Domains of other releases have no readings.
#[test]
fn readings_are_a_part_of_the_content_if_there_are_any() {
    let trees = BTreeMap::from([("clean.xml".to_owned(), ROUND.replace("round", "clean").replace("look", "sweep"))]);
    let reference = |text: &str| {
        let trees =
            trees.iter().map(|(name, tree)| (name.clone(), tree.replace(r#"<water litres="0.5" gentle="true"/>"#, "")));
        DomainFile::check(yaml::parse(text).unwrap(), &trees.collect(), &[]).unwrap().reference()
    };
    let domain = reference(BAG);
    assert_eq!(reference(&BAG.replace("unit: g, ", "").replace("dust in the bag", "dust")), domain);
    for (part, changed) in [("maximum: 50", "maximum: 60"), ("value: 5", "value: 6"), ("add: 2.5", "add: 3.5")] {
        assert_ne!(reference(&BAG.replace(part, changed)), domain, "{changed}");
    }
    let without = serde_json::to_string(&yaml::parse::<DomainForm>(PLANTS).unwrap()).unwrap();
    assert!(!without.contains("readings") && !without.contains("effects"), "{without}");
}
