//! Mission files that a fleet file names.

use super::support::{free_address, run, test_file};

const LOOK: &str = "mission: look
title: Look in at a room
parameters: { room: { kind: place } }
roles: { looker: { kind: managed } }
root: { task: go, type: navigation, roles: [looker], parameters: { to: \"${room}\" } }
";

const VISIT: &str = r#"{
  "0": { "name": "any", "type": "task", "parent": "-1", "agents": ["ada"], "children": ["1"] },
  "1": { "name": "m-any", "type": "method", "parent": "0", "agents": ["ada"], "children": ["2"] },
  "2": { "name": "navto", "type": "action", "parent": "1", "agents": ["ada"], "locations": ["IC Room 6"] }
}"#;

/// Writes a fleet file with these mission files, which are beside it.
fn fleet(name: &str, missions: &[(&str, &str)]) -> String {
    let names: Vec<String> = missions.iter().map(|(file, _)| format!("{file:?}")).collect();
    for (file, text) in missions {
        test_file(file, text);
    }
    test_file(name, &format!("name = \"ward\"\nmissions = [{}]\n", names.join(", ")))
}

#[test]
fn a_dry_run_finds_missions_of_the_fleet_by_name() {
    let fleet = fleet("looking.toml", &[("fleet_look.yaml", LOOK), ("fleet_visit.json", VISIT)]);
    let ran = run(&["check", &fleet]);
    assert_eq!((ran.code, ran.out), (Some(0), format!("{fleet}: ok, a fleet: ward\n")), "{}", ran.err);
    let worker = "[[worker]]\nname = \"bob\"\nplace = \"Dock\"\nskills = [\"navigation\"]\nspeed_mps = 0.5\n";
    let workers = test_file("looking_workers.toml", worker);
    // A flat iHTN has the name of its file.
    for mission in [&["look", "--set", "room=IC Room 6"][..], &["fleet_visit"]] {
        let flags = ["--fleet", &fleet, "--workers", &workers];
        let ran = run(&[&["dry-run"][..], mission, &flags].concat());
        assert!(ran.code == Some(0) && ran.out.contains("  assignment: "), "{mission:?}: {}{}", ran.out, ran.err);
    }
    let ran = run(&["dry-run", "fleet_visit", "--fleet", &fleet, "--workers", &workers, "--person", "ada"]);
    let expected = "`people` belongs to a mission in the flat iHTN form that is given as a file";
    assert!(ran.code == Some(2) && ran.err.contains(expected), "{}{}", ran.out, ran.err);
    let ran = run(&["dry-run", "look", "--workers", &workers]);
    assert!(ran.code == Some(2) && ran.err.contains("no mission of this name"), "{}{}", ran.out, ran.err);
}

#[test]
fn mistakes_in_missions_of_the_fleet_are_reported_with_file_and_place() {
    let unknown_type = LOOK.replace("mission: look", "mission: fly").replace("type: navigation", "type: navigate");
    let unknown_place = VISIT.replace("IC Room 6", "IC Rom 6");
    let shipped = LOOK.replace("mission: look", "mission: vital-signs");
    let missions = [
        ("mistakes_look.yaml", LOOK),
        ("mistakes_again.yaml", LOOK),
        ("mistakes_type.yaml", unknown_type.as_str()),
        ("mistakes_place.json", unknown_place.as_str()),
        ("mistakes_shipped.yaml", shipped.as_str()),
        ("mistakes_form.yaml", "mission: form\nrot: {}\n"),
    ];
    let fleet = fleet("mistakes.toml", &missions);
    let robot = format!("name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\nfleet = {fleet:?}\n");
    let robot = test_file("mistakes_robot.toml", &robot);
    let ran = run(&["check", &fleet, &robot]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    let folder = fleet.strip_suffix("mistakes.toml").expect("its name");
    for expected in [
        "mistakes_again.yaml: mission look: another mission file of the fleet has this name",
        "mistakes_type.yaml: root: unknown task type `navigate`; allowed: ",
        "mistakes_place.json: node 2 (navto): `to` is the place \"IC Rom 6\", which is not on the fleet's map; ",
        "mistakes_shipped.yaml: mission vital-signs: it is the name of a shipped mission",
        "mistakes_form.yaml: not a mission file in YAML: ",
    ] {
        let found = ran.out.matches(&format!("{folder}{expected}")).count();
        assert_eq!(found, 2, "for the fleet and for the robot: {expected:?} in\n{}", ran.out);
    }
    assert!(!ran.out.contains("mistakes_look.yaml"), "{}", ran.out);
    let ran = run(&["station", "--name", "s", "--listen", &free_address(), "--fleet", &fleet]);
    assert!(ran.code == Some(2) && ran.err.contains("mistakes_again.yaml: mission look: "), "{}", ran.err);
    let missing = test_file("mistakes_missing.toml", "name = \"ward\"\nmissions = [\"no_such_mission.yaml\"]\n");
    let ran = run(&["check", &missing]);
    assert!(ran.code == Some(1) && ran.out.contains("no_such_mission.yaml: cannot be read"), "{}", ran.out);
}

/// Only the nodes of a fleet know its missions.
#[test]
fn a_submitted_word_that_is_no_file_is_a_name() {
    let away = ["--connect", "tcp/127.0.0.1:1", "--timeout", "1"];
    let submit = |word: &str| run(&[&["submit", word][..], &away].concat());
    assert_eq!(submit("look-of-the-fleet").code, Some(3), "the fleet is queried");
    let ran = submit("look-of-the-fleet.yaml");
    assert!(ran.code == Some(2) && ran.err.contains("there is no such file"), "{}", ran.err);
}
