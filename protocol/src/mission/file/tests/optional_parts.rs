//! Tests of optional parts of mission files: attempts, items, alternatives, recovery.

use crate::ids::{ItemId, RoleId};
use crate::mission::model::ATTEMPTS;
use crate::mission::test_data::domain;
use crate::mission::{Format, LostItem, MissionTemplate, OnLoss, TaskBody, TaskSpec};
use std::collections::BTreeMap;

/// A robot fetches a key and hands it to another robot. If the first robot is lost with the key,
/// the other robot drives there.
const FILE: &str = r#"
mission: fetch-key
roles:
  r1: { kind: managed, on_loss: restart }
  r2: { kind: managed }
  clerk: { kind: unmanaged }
root:
  task: fetch
  method: sequential
  tasks:
    - task: find
      method: sequential
      tasks:
        - { task: go, type: navigation, roles: [r1], parameters: { to: Dock }, attempts: 5 }
      alternatives:
        - { method: sequential, tasks: [{ task: go_round, type: navigation, roles: [r1], parameters: { to: Laboratory } }, { task: go_then, type: navigation, roles: [r1], parameters: { to: Dock } }] }
        - { method: sequential, tasks: [{ task: rest, type: wait, roles: [r1], parameters: { seconds: "60" }, attempts: 1 }] }
    - { task: take, type: deposit, roles: [clerk], parameters: { into_role: r1 }, acquires: { key: r1 } }
    - { task: pass_on, type: wait, roles: [r1, r2], parameters: { seconds: "5" }, acquires: { key: r2 } }
    - { task: lay_down, type: deposit, roles: [r2], releases: [key] }
recovery:
  task: look_after
  method: sequential
  tasks:
    - { task: go_there, type: navigation, roles: [r2], parameters: { to: "${lost.place}" } }
    - { task: stay, type: wait, roles: [r2], parameters: { seconds: "9" }, reaches: { watched: "${lost.item} of ${lost.robot}" } }
"#;

fn diagnostics_of(text: &str) -> Vec<String> {
    let template = MissionTemplate::parse(text, Format::Yaml).unwrap();
    match template.instantiate(&BTreeMap::new(), &domain()) {
        Ok(_) => vec![],
        Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
    }
}

/// Returns the diagnostics of the file with `from` replaced by `to`.
fn diagnostics_with(from: &str, to: &str) -> Vec<String> {
    assert!(FILE.contains(from), "{from}");
    diagnostics_of(&FILE.replace(from, to))
}

#[test]
fn all_fields_of_a_file_are_in_the_mission_and_its_recovery() {
    let template = MissionTemplate::parse(FILE, Format::Yaml).unwrap();
    let (mission, recovery) = template.instantiate_with_recovery(&BTreeMap::new(), &domain()).unwrap();
    let on_loss = |role: &str| mission.roles[&RoleId::new(role).unwrap()].on_loss;
    assert_eq!((on_loss("r1"), on_loss("r2")), (OnLoss::Restart, OnLoss::Fail));
    let specs: BTreeMap<&str, &TaskSpec> =
        mission.elementary().into_iter().map(|(id, spec)| (id.as_str(), spec)).collect();
    assert_eq!((specs["go"].attempts, specs["take"].attempts), (5, ATTEMPTS));
    let key = ItemId::new("key").unwrap();
    let gets = |task: &str| specs[task].acquires.get(&key).map(RoleId::as_str);
    assert_eq!((gets("take"), gets("pass_on"), gets("lay_down")), (Some("r1"), Some("r2"), None));
    assert_eq!((specs["pass_on"].releases.len(), specs["lay_down"].releases.contains(&key)), (0, true));

    let TaskBody::Abstract(method) = &mission.tasks[1].body else { panic!("find is abstract") };
    let alternatives = method.alternatives.iter().map(|other| {
        let tasks = other.tasks.iter().map(|(id, spec)| (id.as_str(), spec.attempts));
        tasks.collect::<Vec<_>>()
    });
    assert_eq!(alternatives.collect::<Vec<_>>(), [vec![("go_round", 2), ("go_then", 2)], vec![("rest", 1)]]);

    let recovery = recovery.expect("the file has a recovery branch");
    assert_eq!(recovery.roles.keys().map(RoleId::as_str).collect::<Vec<_>>(), ["r2"], "only the roles of the branch");
    let lost = LostItem { place: Some("Dock".parse().unwrap()), item: key, robot: "ada".parse().unwrap() };
    let filled = lost.substitute_mission(recovery).expect("all values are known");
    let specs = filled.elementary();
    assert_eq!((specs[0].1.parameters["to"].as_str(), specs[1].1.reaches["watched"].as_str()), ("Dock", "key of ada"));
    assert_eq!(diagnostics_of(FILE), [""; 0]);
}

#[test]
fn attempts_range_from_1_to_10() {
    for number in ["0", "11", "255"] {
        let expected = format!("root/find/go: has {number} attempts; 1 to 10 are allowed");
        assert_eq!(diagnostics_with("attempts: 5", &format!("attempts: {number}")), [expected]);
    }
    for (text, found) in [("often", "often"), ("300", "300"), ("-1", "-1"), ("1.5", "1.5")] {
        let template = MissionTemplate::parse(&FILE.replace("attempts: 5", &format!("attempts: {text}")), Format::Yaml);
        let error = template.unwrap_err().to_string();
        for part in ["not a mission file in YAML: ", "line 14", found, "a whole number of attempts from 1 to 10"] {
            assert!(error.contains(part), "{part:?} is not in {error}");
        }
    }
    assert_eq!(
        diagnostics_with("    - task: find\n", "    - task: find\n      attempts: 3\n"),
        [
            "root/find: a task has either `method` and `tasks`, or `type` and `roles` (and `parameters`, `reaches`); this \
          task is abstract and has `parameters`, `reaches`, `acquires`, `releases`, `attempts`, `patience_s` or `escalate`"
        ]
    );
}

#[test]
fn items_belong_to_roles_and_move_in_a_definite_order() {
    let unknown = diagnostics_with("acquires: { key: r1 }", "acquires: { key: r11 }");
    let expected = "root/take: unknown role `r11`; allowed: clerk, r1, r2; did you mean `r1`?";
    assert_eq!(unknown, [expected]);
    assert_eq!(
        diagnostics_with("releases: [key]", "releases: [key], acquires: { key: r2 }"),
        ["root/lay_down: both acquires and releases the item `key`; only one of the two is allowed"]
    );
    assert_eq!(
        diagnostics_with("releases: [key]", "releases: [\"a key\"]"),
        [
            "root/lay_down: \"a key\" cannot name an item: it contains ' '; allowed are 1 to 64 characters of A-Z, a-z, 0-9, \
          `_`, `.` and `-`"
        ]
    );
    let unordered = diagnostics_with("task: fetch\n  method: sequential", "task: fetch\n  method: unordered");
    let rule = "and the two tasks are unordered; put them in sequence";
    assert_eq!(
        unordered,
        [
            format!("pass_on: touches the item `key`, as does take, {rule}"),
            format!("lay_down: touches the item `key`, as does pass_on, {rule}")
        ]
    );
}

#[test]
fn alternatives_are_local_sequences_of_elementary_tasks() {
    let rule = "has alternatives, so a single managed role must execute its tasks and theirs, and none may touch an item; but ";
    for (from, to, problem) in [
        ("task: rest, type: wait, roles: [r1]", "task: rest, type: wait, roles: [r2]", "root/find"),
        ("task: rest, type: wait, roles: [r1]", "task: rest, type: wait, roles: [clerk]", "root/find"),
        ("task: rest, type: wait, roles: [r1]", "task: rest, type: wait, roles: [r1, r2]", "root/find"),
        ("attempts: 1 }", "attempts: 1, releases: [key] }", "root/find"),
        ("parameters: { to: Dock }, attempts: 5", "parameters: { to: Dock }, acquires: { key: r1 }", "root/find"),
    ] {
        let found = diagnostics_with(from, to);
        let reported = found.iter().any(|text| text.starts_with(problem) && text.contains(rule));
        assert!(reported, "{to}: {found:#?}");
    }
    let found =
        diagnostics_with("- { method: sequential, tasks: [{ task: rest", "- { method: unordered, tasks: [{ task: rest");
    assert_eq!(
        found,
        ["root/find/alternative 2: a task has either `method` and `tasks`, or `type` and `roles` (and `parameters`, \
          `reaches`); this task is an alternative; its method must be `sequential`"]
    );
    let nested = "task: rest, method: sequential, tasks: []";
    let found =
        diagnostics_with("task: rest, type: wait, roles: [r1], parameters: { seconds: \"60\" }, attempts: 1", nested);
    let expected = "root/find/alternative 2/rest: a task has either `method` and `tasks`, or `type` and `roles` (and \
                    `parameters`, `reaches`); this task is part of an alternative; its tasks must be elementary";
    assert!(found.iter().any(|problem| problem == expected), "{found:#?}");
    let found = diagnostics_with("parameters: { to: Laboratory }", "parameters: { two: Laboratory }");
    assert!(
        found.iter().any(|problem| problem.contains("`navigation` has no parameter `two`; allowed: to")),
        "{found:#?}"
    );
    let found = diagnostics_with(
        "- { task: take, type: deposit",
        "- { task: take, alternatives: [{ method: sequential, tasks: [] }], type: deposit",
    );
    assert!(
        found.iter().any(|problem| problem.ends_with("this task is elementary and has `alternatives`")),
        "{found:#?}"
    );
    let found = diagnostics_with("task: go_round", "task: go");
    assert!(found.iter().any(|problem| problem.contains("task names must be unique in a mission")), "{found:#?}");
}

#[test]
fn a_recovery_branch_is_checked_with_its_own_paths() {
    let found = diagnostics_with("to: \"${lost.place}\"", "to: \"${lost.spot}\"");
    let allowed = "`${lost.spot}` is not a parameter of the mission; allowed: lost.item, lost.place, lost.robot";
    assert!(found.len() == 1 && found[0].starts_with(&format!("recovery/go_there: {allowed}")), "{found:#?}");
    let found = diagnostics_with("to: Dock }, attempts: 5", "to: \"${lost.place}\" }");
    assert!(
        found
            .iter()
            .any(|problem| problem.starts_with("root/find/go: `${lost.place}` is not a parameter of the mission")),
        "the main branch has no loss: {found:#?}"
    );
    let found = diagnostics_with("task: stay, type: wait, roles: [r2]", "task: stay, type: weight, roles: [r3]");
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(found[0].starts_with("recovery/stay: unknown role `r3`; allowed: "), "{found:#?}");
    assert!(found[1].starts_with("recovery/stay: unknown task type `weight`; "), "{found:#?}");
    let found = diagnostics_with("task: go_there", "task: take");
    assert_eq!(found, ["recovery/…/take: has the same name as root/…/take; task names must be unique in a mission"]);
    let without = FILE.replace(", acquires: { key: r1 }", "").replace(", acquires: { key: r2 }", "");
    assert_eq!(diagnostics_of(&without), ["recovery: is never taken: no task of the mission acquires an item"]);
}

#[test]
fn on_loss_has_two_values() {
    let template = MissionTemplate::parse(&FILE.replace("on_loss: restart", "on_loss: again"), Format::Yaml);
    let error = template.unwrap_err().to_string();
    for part in ["again", "fail", "restart", "line 4"] {
        assert!(error.contains(part), "{part:?} is not in {error}");
    }
}
