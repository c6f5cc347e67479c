mod control_flow;
mod optional_parts;
mod policies;

use super::*;
use crate::mission::test_data::domain;
use crate::mission::{Method, TaskBody, TaskOrder, TaskSpec};

const FILE: &str = r#"
mission: inspect-room
parameters:
  room: { kind: place, default: IC Room 6 }
  pause: { kind: seconds }
roles:
  r1: { kind: managed }
  clerk: { kind: unmanaged, description: on duty }
root:
  task: inspect
  method: sequential
  tasks:
    - { task: go, type: navigation, roles: [r1], parameters: { to: "${room}" }, reaches: { at: "in ${room} for $$1" } }
    - task: meet
      method: unordered
      tasks:
        - { task: stay, type: wait, roles: [r1, clerk], parameters: { seconds: "${pause}" } }
        - { task: sit, type: wait, roles: [clerk], parameters: { seconds: 2.50 } }
"#;

fn given(entries: &[(&str, &str)]) -> BTreeMap<String, String> {
    entries.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect()
}

fn diagnostics_of(text: &str, values: &[(&str, &str)]) -> Vec<String> {
    let template = MissionTemplate::parse(text, Format::of(None, text)).unwrap();
    match template.instantiate(&given(values), &domain()) {
        Ok(_) => vec![],
        Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
    }
}

#[test]
fn a_file_becomes_a_mission_with_its_parameters_filled_in() {
    let template = MissionTemplate::parse(FILE, Format::Yaml).unwrap();
    let mission = template.instantiate(&given(&[("pause", "4")]), &domain()).unwrap();
    let ids: Vec<&str> = mission.tasks.iter().map(|node| node.id.as_str()).collect();
    assert_eq!(ids, ["inspect", "go", "meet", "stay", "sit"]);
    let specs: Vec<&TaskSpec> = mission.elementary().into_iter().map(|(_, spec)| spec).collect();
    assert_eq!(specs[0].parameters["to"], "IC Room 6");
    assert_eq!(specs[0].reaches["at"], "in IC Room 6 for $1");
    assert_eq!(specs[1].parameters["seconds"], "4");
    assert_eq!(specs[2].parameters["seconds"], "2.50");
    let TaskBody::Abstract(method) = &mission.tasks[2].body else { panic!("meet is abstract") };
    assert_eq!(method, &Method::of(TaskOrder::Unordered, vec![3, 4]));
}

#[test]
fn an_unknown_place_is_reported_once() {
    let places = ["Dock", "IC Room 5", "IC Room 6"].map(|name| crate::ids::PlaceId::new(name).unwrap());
    let domain = domain().with_places(places);
    let diagnostics = |text: &str, values: &[(&str, &str)]| match MissionTemplate::parse(text, Format::of(None, text))
        .unwrap()
        .instantiate_with_recovery(&given(values), &domain)
    {
        Ok(_) => vec![],
        Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
    };
    assert_eq!(diagnostics(FILE, &[("pause", "4")]), Vec::<String>::new());
    let allowed = "which is not on the fleet's map; allowed: Dock, IC Room 5, IC Room 6";
    assert_eq!(
        diagnostics(FILE, &[("pause", "4"), ("room", "IC Room 66")]),
        [format!("parameters/room: `room` is the place \"IC Room 66\", {allowed}; did you mean `IC Room 6`?")]
    );
    let fixed = FILE.replace("parameters: { to: \"${room}\" }", "parameters: { to: Attic }");
    assert_eq!(
        diagnostics(&fixed, &[("pause", "4"), ("room", "Dock")]),
        [format!("root/go: `to` is the place \"Attic\", {allowed}")]
    );
    assert_eq!(
        diagnostics_of(FILE, &[("pause", "4"), ("room", "Attic")]),
        Vec::<String>::new(),
        "without a map every place is accepted"
    );
}

#[test]
fn json_and_yaml_give_the_same_mission() {
    let json = r#" {"mission": "m", "roles": {"r1": {"kind": "managed"}},
            "root": {"task": "go", "type": "navigation", "roles": ["r1"], "parameters": {"to": "Laboratory"}}}"#;
    assert_eq!(Format::of(None, json), Format::Json);
    assert_eq!(Format::of(Some(Path::new("a/m.yml")), json), Format::Yaml);
    let yaml = MissionTemplate::parse(json, Format::Yaml).unwrap();
    let json = MissionTemplate::parse(json, Format::Json).unwrap();
    let build = |template: MissionTemplate| template.instantiate(&BTreeMap::new(), &domain()).unwrap();
    assert_eq!(build(json), build(yaml));
}

#[test]
fn a_request_must_give_exactly_the_declared_parameters() {
    assert_eq!(
        diagnostics_of(FILE, &[("rom", "IC Room 2")]),
        [
            "parameters/pause: is not given and has no default; it must be a number of seconds, zero or more",
            "parameters/rom: is given, but the mission has no such parameter; allowed: pause, room; did you mean \
             `room`?",
        ]
    );
    assert_eq!(
        diagnostics_of(FILE, &[("pause", "soon")]),
        ["parameters/pause: parameter `pause` is \"soon\"; it must be a number of seconds, zero or more"]
    );
}

#[test]
fn a_value_cannot_insert_another_value() {
    let template = MissionTemplate::parse(FILE, Format::Yaml).unwrap();
    let values = given(&[("pause", "4"), ("room", "${pause}")]);
    let mission = template.instantiate(&values, &domain()).unwrap();
    assert_eq!(mission.elementary()[0].1.parameters["to"], "${pause}");
}

#[test]
fn every_problem_of_a_file_is_reported_with_its_path() {
    let file = FILE
        .replace("to: \"${room}\"", "to: \"${roon}\"")
        .replace("in ${room}", "in ${room")
        .replace("task: stay, type: wait, roles: [r1, clerk]", "task: st/ay, type: wait, roles: [r 1, clerk]")
        .replace("{ task: sit, type: wait, roles: [clerk]", "{ task: sit, roles: [clerk]");
    assert_eq!(
        diagnostics_of(&file, &[("pause", "1")]),
        [
            "root/go: `${roon}` is not a parameter of the mission; allowed: pause, room; did you mean `room`?",
            "root/go: \"in ${room for $$1\": a `${` is not closed; write `${name}` for a parameter and `$$` for \
             a dollar sign",
            "root/meet/st/ay: \"st/ay\" cannot name a task: it contains '/'; allowed are 1 to 64 characters of A-Z, \
             a-z, 0-9, `_`, `.` and `-`",
            "root/meet/st/ay: \"r 1\" cannot name a role: it contains ' '; allowed are 1 to 64 characters of A-Z, \
             a-z, 0-9, `_`, `.` and `-`",
            "root/meet/sit: a task has either `method` and `tasks`, or `type` and `roles` (and `parameters`, \
             `reaches`); this task has `roles` but no `type`",
            "parameters/room: is declared, but `${room}` is not used in any task or condition",
        ]
    );
}

#[test]
fn unknown_fields_and_repeated_keys_are_rejected_with_their_place() {
    let message = |text: &str| MissionTemplate::parse(text, Format::of(None, text)).unwrap_err().to_string();
    let error = message(&FILE.replace("method: unordered", "methode: unordered"));
    assert!(error.contains("methode") && error.contains("line 15"), "{error}");
    let error = message(&FILE.replace("unordered", "random"));
    assert!(error.contains("random") && error.contains("unordered"), "{error}");
    let error = message(r#"{"mission": "m", "roles": {"r": {"kind": "managed"}, "r": {"kind": "managed"}}}"#);
    assert!(error.contains("the key `r` occurs twice"), "{error}");
}

#[test]
fn hostile_files_are_rejected_quickly() {
    let large = format!("mission: m\ntitle: {}\n", "x".repeat(FILE_BYTES_MAX));
    assert!(matches!(MissionTemplate::parse(&large, Format::Yaml), Err(MissionFileError::TooLarge { .. })));
    let bomb = "mission: &a [x,x,x,x,x,x,x,x]\ntitle: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nroot: [*b,*b,*b,*b,*b,*b]\n";
    assert!(MissionTemplate::parse(bomb, Format::Yaml).is_err());
    let alias = "mission: &a m\ntitle: *a\nroles: {}\nroot: { task: t }\n";
    assert!(MissionTemplate::parse(alias, Format::Yaml).is_err());
    for open in ["[", "{\"root\":", "{\"tasks\":[", "{root: ", "- ", "? "] {
        let deep = open.repeat(FILE_BYTES_MAX / open.len());
        assert!(MissionTemplate::parse(&deep, Format::Json).is_err());
        assert!(MissionTemplate::parse(&deep, Format::Yaml).is_err());
    }
    let nest = |levels: usize| {
        let open = r#"{"task":"a","method":"sequential","tasks":["#;
        let root = open.repeat(levels) + r#"{"task":"b","type":"wait","roles":["r"]}"# + &"]}".repeat(levels);
        format!(r#"{{"mission":"m","roles":{{"r":{{"kind":"managed"}}}},"root":{root}}}"#)
    };
    assert!(MissionTemplate::parse(&nest(10_000 / 48), Format::Json).is_err());
    assert!(diagnostics_of(&nest(40), &[]).iter().any(|problem| problem.contains("levels deep")));
}

#[test]
fn too_many_tasks_are_rejected_without_building_them() {
    let task = r#"{"task":"b","type":"wait","roles":["r"]},"#.repeat(600);
    let file = format!(
        r#"{{"mission":"m","roles":{{"r":{{"kind":"managed"}}}},
                "root":{{"task":"a","method":"unordered","tasks":[{}]}}}}"#,
        task.trim_end_matches(',')
    );
    assert_eq!(diagnostics_of(&file, &[]), ["root: 513 tasks; at most 512 are allowed"]);
}
