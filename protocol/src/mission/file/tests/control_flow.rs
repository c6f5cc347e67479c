//! Tests of conditions, choices, loops, repetitions and results in mission files.

use super::given;
use crate::mission::test_data::domain;
use crate::mission::{
    Domain, Format, Mission, MissionTemplate, NumberRange, TaskOutcome, TaskOutcomes, TaskSchema, ValueKind,
};
use serde_json::json;
use std::collections::BTreeMap;

const FILE: &str = r#"
mission: clean
parameters:
  rooms: { kind: places, default: "IC Room 6, Dock" }
  limit: { kind: number, default: "5" }
roles: { r1: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - task: rounds
      for: room
      in: "${rooms}"
      do:
        task: visit
        method: sequential
        tasks:
          - { task: go, type: navigation, roles: [r1], parameters: { to: "${room}" } }
          - { task: inspect, type: inspect, roles: [r1] }
          - task: clean
            choose:
              - when: inspect.dust_g > ${limit}
                do: { task: vacuum, type: vacuum, roles: [r1], parameters: { power: "${inspect.dust_g}" } }
              - when: '!inspect.clean'
                do: { task: wipe, type: wait, roles: [r1], parameters: { seconds: "5" } }
            else: { task: rest, type: wait, roles: [r1], parameters: { seconds: "1" } }
    - task: polish
      when: inspect_1.clean
      repeat: 3
      do: { task: rub, type: inspect, roles: [r1] }
      until: rub.dust_g < 1.0
result:
  dust_g: inspect_1.dust_g + inspect_2.dust_g
"#;

fn with_results() -> Domain {
    let number = || ValueKind::Number(NumberRange::default());
    let inspect = TaskSchema::default().returning("dust_g", number()).returning("clean", ValueKind::Bool);
    let range = NumberRange { minimum: Some(0.0), maximum: Some(10.0) };
    let vacuum = TaskSchema::default().required("power", ValueKind::Number(range));
    domain().with("inspect".parse().unwrap(), inspect).with("vacuum".parse().unwrap(), vacuum)
}

fn mission(text: &str, values: &[(&str, &str)]) -> Result<Mission, Vec<String>> {
    let template = MissionTemplate::parse(text, Format::Yaml).unwrap();
    let mission = template.instantiate(&given(values), &with_results());
    mission.map_err(|errors| errors.diagnostics.iter().map(ToString::to_string).collect())
}

/// Returns the diagnostics of the file with `from` replaced by `to`.
fn diagnostics_with(from: &str, to: &str) -> Vec<String> {
    assert!(FILE.contains(from), "{from}");
    mission(&FILE.replace(from, to), &[]).unwrap_err()
}

fn outcomes(of: &[(&str, f64, bool)]) -> TaskOutcomes {
    let done = |(task, dust_g, clean): &(&str, f64, bool)| {
        let results = serde_json::from_value(json!({ "dust_g": dust_g, "clean": clean })).unwrap();
        (task.parse().unwrap(), TaskOutcome::Done(results))
    };
    of.iter().map(done).collect()
}

/// Returns the tasks that are executed with these results of the others.
fn executed(mission: &Mission, outcomes: &TaskOutcomes) -> Vec<String> {
    let tasks = mission.elementary().into_iter().filter(|(_, spec)| spec.conditions_hold(outcomes).unwrap());
    tasks.map(|(id, _)| id.to_string()).collect()
}

#[test]
fn loops_and_choices_become_tasks_with_conditions() {
    let mission = mission(FILE, &[]).unwrap_or_else(|problems| panic!("{problems:#?}"));
    let names: Vec<&str> = mission.elementary().iter().map(|(id, _)| id.as_str()).collect();
    let expected = [
        "go_1",
        "inspect_1",
        "vacuum_1",
        "wipe_1",
        "rest_1",
        "go_2",
        "inspect_2",
        "vacuum_2",
        "wipe_2",
        "rest_2",
        "rub_1",
        "rub_2",
        "rub_3",
    ];
    assert_eq!(names, expected);
    let specs: BTreeMap<_, _> = mission.elementary().into_iter().map(|(id, spec)| (id.as_str(), spec)).collect();
    assert_eq!([&specs["go_1"].parameters["to"], &specs["go_2"].parameters["to"]], ["IC Room 6", "Dock"]);
    assert_eq!(specs["vacuum_2"].conditions, ["inspect_2.dust_g > 5.0"]);
    assert_eq!(specs["rest_1"].conditions, ["!(inspect_1.dust_g > 5.0)", "!(!inspect_1.clean)"]);
    assert_eq!(specs["vacuum_2"].parameters["power"], "5", "a typical value for estimates");
    let mut vacuum = specs["vacuum_2"].clone();
    let known =
        outcomes(&[("inspect_1", 7.5, false), ("inspect_2", 0.5, true), ("rub_1", 3.0, false), ("rub_2", 0.5, false)]);
    vacuum.set_inputs(&known).unwrap();
    assert_eq!(vacuum.parameters["power"], "0.5");
    let first = ["go_1", "inspect_1", "vacuum_1", "go_2", "inspect_2", "rest_2"];
    assert_eq!(executed(&mission, &known), first, "not clean, so it is not polished");
    assert_eq!(mission.known_results(&known)["dust_g"].to_string(), "8");
    let clean =
        outcomes(&[("inspect_1", 1.0, true), ("inspect_2", 0.5, false), ("rub_1", 3.0, false), ("rub_2", 0.5, false)]);
    let expected = ["go_1", "inspect_1", "rest_1", "go_2", "inspect_2", "wipe_2", "rub_1", "rub_2"];
    assert_eq!(executed(&mission, &clean), expected, "the third iteration is not needed");
}

/// `mop` was skipped, so its results are unknown.
#[test]
fn a_false_condition_decides_beside_an_unknown_one() {
    let file = "
mission: mop
roles: { r1: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - { task: look, type: inspect, roles: [r1] }
    - { task: mop, type: inspect, roles: [r1], when: look.clean }
    - task: react
      when: mop.dust_g > 1.0
      CONTENT
";
    let react = |conditions: &str| {
        let part = "method: sequential\n      tasks: [{ task: again, type: inspect, roles: [r1], when: CONDITION }]";
        let mission = mission(&file.replace("CONTENT", &part.replace("CONDITION", conditions)), &[]).unwrap();
        let again = mission.elementary().into_iter().find(|(id, _)| id.as_str() == "again").unwrap().1.clone();
        let mut known = outcomes(&[("look", 3.0, false)]);
        known.insert("mop".parse().unwrap(), TaskOutcome::Skipped);
        again.conditions_hold(&known)
    };
    assert_eq!(react("look.clean"), Ok(false));
    let problem = react("'!look.clean'").unwrap_err();
    assert_eq!(problem, "`mop.dust_g > 1.0`: the results of mop are unknown: it was skipped");
}

#[test]
fn a_list_may_be_written_in_the_file_and_its_values_are_checked() {
    let listed = FILE
        .replace("in: \"${rooms}\"", "in: [Dock]")
        .replace("  rooms: { kind: places, default: \"IC Room 6, Dock\" }\n", "");
    let listed = listed.replace(" + inspect_2.dust_g", "");
    assert_eq!(mission(&listed, &[]).map(|mission| mission.elementary().len()), Ok(8));
    let problems = mission(FILE, &[("rooms", "Dock, ")]).unwrap_err();
    assert!(
        problems.iter().any(|problem| problem.starts_with("parameters/rooms: parameter `rooms` is \"\"")),
        "{problems:?}"
    );
}

#[test]
fn wrong_references_are_reported_with_their_place() {
    for (from, to, expected) in [
        ("inspect.dust_g > ${limit}", "inspekt.dust_g > 5.0", "uses a result of `inspekt`"),
        (
            "inspect.dust_g > ${limit}",
            "inspect.dust > 5.0",
            "uses inspect_1.dust, but `inspect` returns no such result",
        ),
        ("inspect.dust_g > ${limit}", "inspect.dust_g >", "root/rounds/visit_1/clean_1/vacuum_1: `inspect_1.dust_g >`"),
        ("inspect.dust_g > ${limit}", "rub_1.dust_g > 5.0", "uses a result of rub_1, which may end later"),
        ("inspect.dust_g > ${limit}", "inspect.dust_g > ${limits}", "`${limits}` is not a parameter of the mission"),
        (
            "\"${inspect.dust_g}\"",
            "\"${inspect.clean}\"",
            "parameter `power` must be a number from 0 to 10, and inspect_1.clean is true or false",
        ),
        ("\"${inspect.dust_g}\"", "\"about ${inspect.dust_g}\"", "can only be the whole value"),
        ("repeat: 3", "repeat: 30", "repeats 30 times; 1 to 10 times are allowed"),
        ("repeat: 3", "type: wait", "is a repetition, which has `repeat`, `do` and `until`"),
        ("for: room", "for: limit", "has the name of a parameter or of another variable"),
        ("in: \"${rooms}\"", "in: \"${limit}\"", "`in` is a list, or `${name}` of a parameter of kind `places`"),
        (
            "type: vacuum, roles: [r1],",
            "type: vacuum, roles: [r1], acquires: { bag: r1 },",
            "has a condition and touches the item `bag`",
        ),
        ("  dust_g: inspect_1.dust_g", "  dust_g: inspect_9.dust_g", "result/dust_g: uses a result of `inspect_9`"),
        (
            "            else:",
            "            method: sequential\n            else:",
            "has `choose`, with which only `else` is allowed",
        ),
    ] {
        let problems = diagnostics_with(from, to);
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{to}: {problems:#?}");
    }
}

/// A report of all outcomes of a role must fit in a message.
#[test]
fn more_results_than_a_report_can_contain_are_rejected() {
    let noting = TaskSchema::default().returning("note", ValueKind::Text);
    let domain = domain().with("look".parse().unwrap(), noting);
    let rooms = |count: usize| {
        let tasks =
            (0..count).map(|number| json!({ "task": format!("look_{number}"), "type": "look", "roles": ["r1"] }));
        let root = json!({ "task": "all", "method": "sequential", "tasks": tasks.collect::<Vec<_>>() });
        let file = json!({ "mission": "looks", "roles": { "r1": { "kind": "managed" } }, "root": root }).to_string();
        MissionTemplate::parse(&file, Format::Json).unwrap().instantiate(&given(&[]), &domain)
    };
    assert!(rooms(20).is_ok());
    let problem = rooms(400).unwrap_err().to_string();
    assert!(problem.contains("the results of its tasks may have"), "{problem}");
}

#[test]
fn a_value_of_a_request_is_never_an_expression() {
    let file = FILE.replace("limit: { kind: number, default: \"5\" }", "limit: { kind: text, default: \"5\" }");
    let mission = mission(&file, &[("limit", "1.0 || true || '")]).unwrap_or_else(|problems| panic!("{problems:#?}"));
    let vacuum = mission.elementary().into_iter().find(|(id, _)| id.as_str() == "vacuum_1").unwrap().1;
    assert_eq!(vacuum.conditions, [r#"inspect_1.dust_g > "1.0 || true || '""#]);
}

/// Numbers of YAML arrive at the coordinator as numbers, and bare scalars in place of texts as texts.
#[test]
fn a_request_for_a_yaml_file_is_the_same_mission() {
    let file = "
mission: polish
parameters: { repeat: { kind: number, default: 2 }, room: { kind: place, default: Dock } }
roles: { r1: { kind: managed }, clerk: { kind: unmanaged }, head: { kind: unmanaged } }
root:
  task: all
  method: sequential
  tasks:
    - { task: rounds, repeat: 3, do: { task: rest, type: wait, roles: [r1], parameters: { seconds: 5 } }, until: true }
    - { task: go, type: navigation, roles: [r1], parameters: { to: \"${room}\" }, attempts: 4 }
    - task: hand_over
      type: deposit
      roles: [clerk]
      parameters: { into_role: r1 }
      patience_s: 60
      escalate: { to: head, after_s: 30 }
";
    let template = MissionTemplate::parse(file, Format::Yaml).unwrap();
    let request = MissionTemplate::request(file, Format::Yaml).unwrap();
    let requested =
        MissionTemplate::parse(&request.to_string(), Format::Json).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(format!("{requested:?}"), format!("{template:?}"), "{request}");
}

#[test]
fn a_task_escalates_to_other_people() {
    let problems = |to: &str| {
        let parameters = json!({ "seconds": "1" });
        let task =
            |name: &str, role: &str| json!({ "task": name, "type": "wait", "roles": [role], "parameters": parameters });
        let mut sign = task("sign", "clerk");
        sign["escalate"] = json!({ "to": to, "after_s": 30 });
        let root = json!({ "task": "all", "method": "sequential", "tasks": [task("rest", "r1"), sign] });
        let roles = json!({ "clerk": { "kind": "unmanaged" }, "r1": { "kind": "managed" } });
        let file = json!({ "mission": "permit", "roles": roles, "root": root }).to_string();
        match MissionTemplate::parse(&file, Format::Json).unwrap().instantiate(&given(&[]), &domain()) {
            Ok(_) => vec![],
            Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect::<Vec<_>>(),
        }
    };
    assert_eq!(problems("r1"), ["root/sign: escalates to r1, which is a managed role; only people are asked"]);
    let asked = "root/sign: escalates to clerk, which is asked from the beginning; name another role";
    assert_eq!(problems("clerk"), [asked]);
    assert_eq!(problems("head"), [""; 0]);
}

const SPREAD: &str = r#"
mission: sweep
parameters: { rooms: { kind: places, default: "IC Room 6, Dock" } }
roles: { r1: { kind: managed, eligible: "robot.name != 'ada'" }, r2: { kind: managed }, clerk: { kind: unmanaged } }
root:
  task: all
  method: sequential
  tasks:
    - task: rounds
      for: room
      in: "${rooms}"
      spread: true
      do:
        task: visit
        method: sequential
        tasks:
          - { task: go, type: navigation, roles: [r1], parameters: { to: "${room}" } }
          - { task: meet, type: approach_robot, roles: [r2, r1], parameters: { robot_role: "${r1}" } }
          - { task: note, type: wait, roles: [clerk], parameters: { seconds: "5" } }
    - { task: park, type: wait, roles: [r2], parameters: { seconds: "1" } }
"#;

fn with_meetings() -> Domain {
    let meeting = TaskSchema::default().required("robot_role", ValueKind::Role);
    with_results().with("approach_robot".parse().unwrap(), meeting)
}

fn spread_mission(text: &str, rooms: &str) -> Result<Mission, Vec<String>> {
    let template = MissionTemplate::parse(text, Format::Yaml).unwrap();
    let mission = template.instantiate(&given(&[("rooms", rooms)]), &with_meetings());
    mission.map_err(|errors| errors.diagnostics.iter().map(ToString::to_string).collect())
}

#[test]
fn the_iterations_of_a_spread_loop_have_roles_of_their_own() {
    let mission = spread_mission(SPREAD, "IC Room 6, Dock").unwrap_or_else(|problems| panic!("{problems:#?}"));
    let roles: Vec<(&str, bool)> =
        mission.roles.iter().map(|(role, declared)| (role.as_str(), declared.spread)).collect();
    assert_eq!(roles, [("clerk", false), ("r1_1", true), ("r1_2", true), ("r2", false)], "`park` has r2, too");
    assert_eq!(mission.roles.values().filter(|role| role.eligible.is_some()).count(), 2);
    let specs: BTreeMap<_, _> = mission.elementary().into_iter().map(|(id, spec)| (id.as_str(), spec)).collect();
    assert_eq!(specs["go_2"].roles, ["r1_2".parse().unwrap()]);
    assert_eq!(specs["meet_1"].parameters["robot_role"], "r1_1");
    let request = MissionTemplate::request(SPREAD, Format::Yaml).unwrap();
    assert_eq!(spread_mission(&request.to_string(), "IC Room 6, Dock"), Ok(mission), "as a request");
}

#[test]
fn nested_spread_loops_have_a_role_for_each_iteration_of_both() {
    let nested = SPREAD.replace(
        "          - { task: go, ",
        "          - task: twice\n            for: again\n            in: [a, b]\n            spread: true\n            do: { task: go, ",
    );
    let nested = nested
        .replace("roles: [r1], parameters: { to: \"${room}\" } }", "roles: [r3], parameters: { to: \"${room}\" } }");
    let nested = nested.replace("r2: { kind: managed }", "r2: { kind: managed }, r3: { kind: managed }");
    let mission = spread_mission(&nested, "IC Room 6, Dock").unwrap_or_else(|problems| panic!("{problems:#?}"));
    let roles: Vec<&str> = mission.roles.keys().map(|role| role.as_str()).collect();
    assert_eq!(roles, ["clerk", "r1_1", "r1_2", "r2", "r3_1_1", "r3_1_2", "r3_2_1", "r3_2_2"]);
}

#[test]
fn wrong_spread_loops_are_reported_with_their_place() {
    for (from, to, expected) in [
        ("spread: true", "spread: true\n      method: sequential", "root/rounds: a task has either"),
        ("[r2], ", "[r1], ", "is spread over robots, but has no managed role that no other task has"),
        ("in: \"${rooms}\"", "repeat: 2", "is a repetition"),
        ("r2: { kind: managed }", "r2: { kind: managed }, r1_2: { kind: managed }", "already a role with this name"),
        ("parameters: { rooms", "parameters: { r1: { kind: text, default: a }, rooms", "has the name of a parameter"),
        ("spread: true", "spread: true\n      type: wait", "is a loop, which has `for`, `in` and `do`"),
        ("{ task: park, ", "{ task: park, spread: true, ", "`spread` without `for`"),
    ] {
        assert!(SPREAD.contains(from), "{from}");
        let mut text = SPREAD.replace(from, to);
        if from.starts_with("in:") {
            text = text.replace("      for: room\n", "");
        }
        if to == "[r1], " {
            text = text.replace("roles: [r2, r1]", "roles: [clerk, r1]");
        }
        let problems = spread_mission(&text, "IC Room 6, Dock").unwrap_err();
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{from} -> {to}: {problems:#?}");
    }
}
