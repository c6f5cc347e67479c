//! Missions in the flat iHTN form, with scaffolded domains.

use super::published::reference;
use super::support::{Running, command, crate_file, free_address, run, test_file};
use serde_json::Value;
use std::process::Stdio;

/// An iHTN with names with hyphens, joint actions, two locations, an object, a location that the
/// map lacks, and an action with the name of a standard task type that does not fit.
fn serve_meal() -> String {
    crate_file("../../examples/ihtn/serve-meal.json")
}

/// Writes the scaffolded domain of a mission and returns its path and the notes.
fn scaffold(mission: &str, name: &str, flags: &[&str]) -> (String, String) {
    let ran = run(&[&["domain", "scaffold", mission], flags].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    (test_file(&format!("{name}.yaml"), &ran.out), ran.err)
}

const MEAL_FLAGS: &[&str] = &["--person", "resident", "--object", "trolley"];

/// Two robots and the arm, with these skills.
fn workers(name: &str, skills: &[&str]) -> String {
    let robot = |name: &str| {
        format!(
            "[[worker]]\nname = \"{name}\"\nplace = \"Dock\"\nspeed_mps = 0.6\nbattery = 1.0\ndischarge_share_per_s = 0.0001\nskills = {}\n",
            Value::from(skills.to_vec())
        )
    };
    let arm = "[[worker]]\nname = \"arm\"\nplace = \"Laboratory\"\nskills = [\"pick_up\"]\n";
    test_file(&format!("{name}.toml"), &format!("{}{}{arm}", robot("ada"), robot("bob")))
}

#[test]
fn a_scaffolded_domain_declares_every_other_action_of_an_ihtn() {
    let mission = serve_meal();
    let (domain, notes) = scaffold(&mission, "meal_text", MEAL_FLAGS);
    assert!(notes.contains("the map hospital has no place \"Canteen\""), "{notes}");
    let text = std::fs::read_to_string(&domain).expect("it was written");
    for expected in [
        "domain: serve-meal\n",
        "  people: [resident]\n  objects: [trolley]\n  places:\n    Canteen: ",
        "  actions:\n    \"wait\": ihtn-wait\n",
        "  push-trolley:\n    parameters: { location_1: { type: place }, location_2: { type: place }, object: { type: text } }\n",
        "  offer-meal:\n    parameters: { at: { type: place } }\n    action: offer-meal\n",
    ] {
        assert!(text.contains(expected), "{expected}\n{text}");
    }
    assert!(!text.contains("navto"), "a standard task type\n{text}");
    let ran = run(&["check", &mission, &domain, "--domain", &domain]);
    let expected = format!("{mission}: ok, a flat iHTN: 3 roles, ");
    assert!(ran.code == Some(0) && ran.out.starts_with(&expected), "{}{}", ran.out, ran.err);
    // With its own domain, no action is left to declare.
    let ran = run(&["domain", "scaffold", &mission, "--domain", &domain]);
    assert!(ran.code == Some(0) && !ran.out.contains("tasks:"), "{}{}", ran.out, ran.err);
}

#[test]
fn an_ihtn_with_its_scaffolded_domain_completes_in_the_demo() {
    let mission = serve_meal();
    let (domain, _) = scaffold(&mission, "meal_demo", MEAL_FLAGS);
    let ran = run(&["demo", "--virtual", "--mission", &mission, "--domain", &domain, "--person", "resident"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("1 of 1 missions completed") && ran.out.contains("serve-meal-1"), "{}", ran.out);
}

#[test]
fn a_dry_run_auctions_the_robots_of_an_ihtn() {
    let mission = serve_meal();
    let (domain, _) = scaffold(&mission, "meal_dry_run", &["--object", "trolley"]);
    let workers = workers("meal_workers", &["navigation", "push-trolley", "offer-meal", "ihtn-wait"]);
    let args = ["dry-run", &mission, "--domain", &domain, "--workers", &workers];
    let ran = run(&[&args[..], &["--person", "resident"]].concat());
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let auctioned = ran.out.contains("\n  r2\n") && !ran.out.contains("\n  resident\n");
    assert!(ran.out.contains("  assignment: r1 = ") && auctioned, "{}", ran.out);
    // Without the flag the resident is a robot.
    let ran = run(&args);
    assert!(ran.code == Some(1) && ran.err.contains("no viable bid for resident"), "{}{}", ran.out, ran.err);
}

#[test]
fn a_fleet_takes_an_ihtn_with_its_people() {
    let mission = serve_meal();
    let (domain, _) = scaffold(&mission, "meal_submit", &["--object", "trolley"]);
    let address = free_address();
    let args = ["station", "--name", "s1", "--listen", &address, "--domain", &domain];
    let _station = Running(command(&args).stderr(Stdio::null()).spawn().expect("the binary starts"));
    let submit =
        |flags: &[&str]| run(&[&["submit", &mission, "--connect", &address, "--timeout", "60"], flags].concat());
    let ran = submit(&["--person", "resident"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "serve-meal-1\n"), "{}", ran.err);
    let ran = submit(&["--person", "residant"]);
    let expected = "people/residant: is named as a person, but is no agent of an action; allowed: r1, r2, resident; \
                    did you mean `resident`?";
    assert!(ran.code == Some(1) && ran.err.contains(expected), "{}{}", ran.out, ran.err);
    let ran = run(&["submit", "lab-samples", "--person", "nurse", "--connect", &address]);
    assert!(ran.code == Some(2) && ran.err.contains("`people` belongs to"), "{}{}", ran.out, ran.err);
}

#[test]
fn mistakes_in_an_ihtn_are_reported_with_file_and_node() {
    let text = std::fs::read_to_string(serve_meal()).expect("the example");
    let unknown = test_file(
        "meal_unknown.json",
        &text.replace("\"parent\": \"6\", \"locations\": \"\"", "\"parent\": \"60\", \"locations\": \"\""),
    );
    let objects = test_file("meal_objects.json", &text.replacen("[\"resident\"]", "[{ \"name\": \"resident\" }]", 1));
    let mission = serve_meal();
    let (domain, _) = scaffold(&mission, "meal_mistakes", &["--object", "trolley"]);
    let without_place =
        std::fs::read_to_string(&domain).expect("it was written").replace("    Canteen: ", "    Cantine: ");
    let without_place = test_file("meal_without_place.yaml", &without_place);
    for (args, code, expected) in [
        (vec!["check", &unknown], 1, format!("{unknown}: node 10 (eat-meal): its parent \"60\" does not exist")),
        (vec!["check", &objects], 1, format!("{objects}: node 10 (eat-meal): a list of texts, or a text")),
        (
            vec!["check", &mission],
            1,
            format!("{mission}: node 12 (push-trolley): unknown task type `push-trolley`; allowed: "),
        ),
        (vec!["domain", "scaffold", &unknown], 2, format!("{unknown}: node 10 (eat-meal): its parent")),
        (
            vec!["domain", "scaffold", &mission, "--object", "cart"],
            2,
            "--object cart is no agent of an action; allowed: r1, r2, resident, trolley".to_owned(),
        ),
        (vec!["domain", "scaffold", &domain], 2, "not a flat iHTN".to_owned()),
        (
            vec!["demo", "--virtual", "--mission", &mission, "--domain", &without_place, "--person", "resident"],
            2,
            "node 4 (navto): `to` is the place \"Canteen\", which is not on the fleet's map; allowed: Crossing, Dock, "
                .to_owned(),
        ),
        (
            vec!["demo", "--virtual", "--person", "nurse"],
            2,
            "`people` belongs to a mission in the flat iHTN form".to_owned(),
        ),
    ] {
        let ran = run(&args);
        assert_eq!(ran.code, Some(code), "{args:?}: {}{}", ran.out, ran.err);
        assert!(ran.out.contains(&expected) || ran.err.contains(&expected), "{args:?}: {}{}", ran.out, ran.err);
    }
}

#[test]
fn the_published_ihtns_complete_unchanged() {
    let Some(folder) = reference() else { return };
    let missions: [(&str, &[&str]); 3] =
        [("lsl", &["nurse"]), ("fld", &["Delivery1", "Patient1"]), ("flp", &["Patient1"])];
    for (name, people) in missions {
        let mission = folder.join(format!("ihtn_{name}.json")).display().to_string();
        let (domain, _) = scaffold(&mission, &format!("published_{name}"), &[]);
        let people: Vec<&str> = people.iter().flat_map(|person| ["--person", *person]).collect();
        let with_domain = [&["--domain", &domain][..], &people].concat();
        let ran = run(&[&["demo", "--virtual", "--mission", &mission], &with_domain[..]].concat());
        assert_eq!(ran.code, Some(0), "{name}: {}{}", ran.out, ran.err);

        let text = std::fs::read_to_string(&domain).expect("it was written");
        let tasks = text.split("\ntasks:\n").nth(1).unwrap_or_default().lines();
        let declared =
            tasks.filter_map(|line| line.strip_prefix("  ")?.strip_suffix(':')).filter(|name| !name.starts_with(' '));
        let standard = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];
        let skills: Vec<&str> = declared.chain(standard).collect();
        let workers = workers(&format!("published_{name}"), &skills);
        let ran = run(&[&["dry-run", &mission, "--workers", &workers], &with_domain[..]].concat());
        assert_eq!(ran.code, Some(0), "{name}: {}{}", ran.out, ran.err);
    }
}
