//! Domain files: actions and task types as data.

use super::support::{crate_file, run, test_file};
use serde_json::Value;

fn plants(name: &str) -> String {
    crate_file(&format!("../../examples/plants/{name}"))
}

#[test]
fn the_example_domain_and_its_mission_are_valid() {
    let (domain, mission) = (plants("domain.yaml"), plants("rounds.yaml"));
    let ran = run(&["check", &domain, &mission, "--domain", &domain]);
    let expected = [
        format!("{domain}: ok, a domain: 2 actions, 1 task type, content "),
        format!("\n{mission}: ok, a mission: water-plants, 1 role, 2 steps\n"),
    ];
    assert!(ran.code == Some(0) && expected.iter().all(|line| ran.out.contains(line)), "{}{}", ran.out, ran.err);
    // Without the domain its task type is unknown.
    let ran = run(&["check", &mission]);
    assert!(ran.code == Some(1) && ran.out.contains("unknown task type `water_plant`"), "{}", ran.out);
}

#[test]
fn the_example_of_battery_swaps_is_valid() {
    let swaps = |name: &str| crate_file(&format!("../../examples/battery-swap/{name}"));
    let (domain, mission) = (swaps("domain.yaml"), swaps("mission.yaml"));
    let ran = run(&["check", &domain, &mission, "--domain", &domain]);
    let expected = [
        format!("{domain}: ok, a domain: 1 action, 1 task type, content "),
        format!("\n{mission}: ok, a mission: battery-swap, 1 role, 2 steps\n"),
    ];
    assert!(ran.code == Some(0) && expected.iter().all(|line| ran.out.contains(line)), "{}{}", ran.out, ran.err);
}

#[test]
fn a_task_that_moves_an_item_hands_over() {
    let text = std::fs::read_to_string(plants("rounds.yaml")).expect("an example");
    let moving = text.replace("litres: \"1.5\" } }", "litres: \"1.5\" }, acquires: { tray: gardener } }");
    assert_ne!(moving, text);
    let mission = test_file("moving_rounds.yaml", &moving);
    let domain = plants("domain.yaml");
    // Watering is not repeatable, so it may move items.
    let ran = run(&["check", &mission, "--domain", &domain]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let text = std::fs::read_to_string(&domain).expect("an example");
    let still = text.replace("  water:\n", "  water:\n    hands_over: false\n");
    assert_ne!(still, text);
    let still = still.replace("tree: water_plant.xml", "tree: still_plants.xml");
    let tree = std::fs::read_to_string(plants("water_plant.xml")).expect("an example");
    test_file("still_plants.xml", &tree);
    let domain = test_file("still_plants.yaml", &still);
    let ran = run(&["check", &mission, "--domain", &domain]);
    let expected = "/first_plant: moves the item `tray`, but no action of `water_plant` hands items over: it needs \
                    `hands_over: true`; allowed: deposit, grasp, pick_up\n";
    assert!(ran.code == Some(1) && ran.out.starts_with(&mission) && ran.out.contains(expected), "{}", ran.out);
}

/// Robots and a simulated world that know nothing of plants water them, and a robot takes over from a
/// killed coordinator.
#[test]
fn a_mission_of_a_new_domain_runs_in_the_demo() {
    let (domain, mission) = (plants("domain.yaml"), plants("rounds.yaml"));
    let ran = run(&["demo", "--virtual", "--json", "--missions", "3", "--domain", &domain, "--mission", &mission]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let events: Vec<Value> = ran.out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let summary = events.last().expect("a summary");
    assert_eq!(summary["completed"], 3, "{summary}");
}

/// The demo adds the people and the robots that a mission lacks.
#[test]
fn shipped_missions_run_in_the_demo() {
    for mission in consort_skills::missions::shipped().keys() {
        let ran = run(&["demo", "--virtual", "--mission", mission]);
        assert_eq!(ran.code, Some(0), "{mission}\n{}\n{}", ran.out, ran.err);
    }
}

#[test]
fn trees_are_checked_node_by_node() {
    let (domain, tree) = (plants("domain.yaml"), plants("water_plant.xml"));
    let ran = run(&["check", &tree, "--domain", &domain]);
    assert_eq!((ran.code, ran.out), (Some(0), format!("{tree}: ok, a tree: water_plant, 6 nodes\n")), "{}", ran.err);
    // The actions of the domain are unknown without it.
    let ran = run(&["check", &tree]);
    let [looks, waters] = [9, 10].map(|line| format!("{tree}:{line}:1: no domain declares the node "));
    assert_eq!((ran.code, ran.out), (Some(1), format!("{looks}`inspect_plant`\n{waters}`water`\n")), "{}", ran.err);
    let navigator = test_file(
        "navigator.xml",
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"go\">\n<RecoveryNode number_of_retries=\"6\">\n<FollowPath path=\"{path}\"/>\n<Wayt seconds=\"1\"/>\n</RecoveryNode></BehaviorTree></root>",
    );
    let ran = run(&["check", &navigator]);
    for expected in [
        ":2:1: no domain declares the node `RecoveryNode`",
        ":3:1: ",
        ":4:1: no domain declares the node `Wayt`; did you mean `wait`?",
    ] {
        assert!(ran.out.contains(&format!("{navigator}{expected}")), "{expected}\n{}", ran.out);
    }
}

#[test]
fn a_tree_that_contains_an_action_of_people_is_rejected() {
    let tree = test_file(
        "asks.xml",
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"asks\">\n<ask_person message=\"why?\"/></BehaviorTree></root>",
    );
    let ran = run(&["check", &tree]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.out.contains(&format!("{tree}:2: people perform `ask_person`, and no robot")), "{}", ran.out);
}

#[test]
fn mistakes_in_a_domain_are_reported_with_file_and_place() {
    let tree =
        test_file("sprinkle.xml", "<root BTCPP_format=\"4\"><BehaviorTree ID=\"s\">\n<watr/></BehaviorTree></root>");
    let domain = test_file(
        "wrong_domain.yaml",
        "domain: plants\nactions:\n  water: { simulate: { failure_rate: 2 } }\ntasks:\n  sprinkle: { tree: sprinkle.xml, estimate: { time_s: \"1.0\" } }\n  spray: { action: watr }\n  rinse: { action: water, requires: \"readings.tank >= 1.0\" }\nreadings: { tank_l: { type: number } }\n",
    );
    let typing = test_file("typing_domain.yaml", "domain: plants\nactoins: {}\n");
    let ran = run(&["check", &domain, &typing]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    for expected in [
        format!("{domain}: actions.water.simulate.failure_rate: allowed is a share from 0 to 1"),
        format!(
            "{domain}: tasks.spray.action: the domain declares no action watr; allowed: water; did you mean `water`?"
        ),
        format!("{domain}: tasks.rinse.requires: no domain declares the reading `tank`; allowed: tank_l; "),
        "sprinkle.xml:2: ".to_owned(),
        "actoins".to_owned(),
    ] {
        assert!(ran.out.contains(&expected), "{expected:?} is missing in\n{}\n({tree})", ran.out);
    }
    let ran = run(&["demo", "--virtual", "--domain", &domain]);
    assert_eq!(ran.code, Some(2), "nothing starts with a wrong domain");
    let example = plants("domain.yaml");
    let read = |path: &str| std::fs::read_to_string(path).expect("an example");
    test_file("water_plant.xml", &read(&plants("water_plant.xml")));
    let copy = test_file("copied_plants.yaml", &read(&example));
    let twice = run(&["check", &example, "--domain", &example, "--domain", &copy]);
    assert!(twice.code == Some(2) && twice.err.contains("`inspect_plant` is already registered"), "{}", twice.err);
    let same = run(&["check", &example, "--domain", &example, "--domain", &example]);
    assert_eq!(same.code, Some(0), "{}", same.err);
}

#[test]
fn a_fleet_file_names_its_domains() {
    let fleet = |domains: &str| format!("name = \"garden\"\n{domains}");
    let domains = format!("domains = [{:?}]\n", plants("domain.yaml"));
    let with = test_file("garden.toml", &fleet(&domains));
    let without = test_file("garden_without.toml", &fleet(""));
    let missing = test_file("garden_missing.toml", &fleet("domains = [\"missing.yaml\"]\n"));
    let robot = |name: &str, fleet: &str| {
        let text = format!("name = \"a\"\nplace = \"Dock\"\nskills = [\"water_plant\"]\nfleet = {fleet:?}\n");
        test_file(name, &text)
    };
    let ran = run(&["check", &with, &robot("gardener.toml", &with)]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let ran = run(&["check", &robot("gardener_without.toml", &without)]);
    assert!(ran.code == Some(1) && ran.out.contains("`water_plant`"), "{}", ran.out);
    for file in [&missing, &robot("gardener_missing.toml", &missing)] {
        let ran = run(&["check", file]);
        assert!(ran.code == Some(1) && ran.out.contains("missing.yaml"), "{}", ran.out);
    }
}

#[test]
fn a_tree_reads_values_that_an_ensemble_of_the_fleet_exchanges() {
    let tree = "<root BTCPP_format=\"4\"><BehaviorTree ID=\"look\">\n\
        <MemberValue ensemble=\"icu\" robot=\"bob\" exchanged=\"readings.dust_g\"/>\n</BehaviorTree></root>";
    let tree = test_file("dust_look.xml", tree);
    let domain = "domain: dust\nreadings: { dust_g: { type: number } }\n\
        tasks: { look: { tree: dust_look.xml, estimate: { time_s: \"1.0\" } } }\n";
    let domain = test_file("dust.yaml", domain);
    let fleet = |name: &str, ensemble: &str, exchange: &str| {
        let text = format!(
            "name = \"ward\"\ndomains = [\"dust.yaml\"]\n[[ensemble]]\nname = {ensemble:?}\n\
             membership = [\"member.robot\"]\nstale_after_ms = 1000\nexchange = [{exchange:?}]\n"
        );
        test_file(name, &text)
    };
    let valid = fleet("dust_fleet.toml", "icu", "readings.dust_g");
    let ran = run(&["check", &domain, &tree, &valid]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    for (file, problem) in [
        (fleet("dust_er.toml", "er", "readings.dust_g"), "the fleet has no ensemble `icu`; allowed: er"),
        (fleet("dust_owner.toml", "icu", "attributes.owner"), "ensemble icu exchanges no `readings.dust_g`; allowed: "),
    ] {
        let ran = run(&["check", &file]);
        let expected = format!("dust_look.xml:2: look/MemberValue: {problem}");
        assert!(ran.code == Some(1) && ran.out.contains(&expected), "{expected:?} is missing in\n{}", ran.out);
    }
}
