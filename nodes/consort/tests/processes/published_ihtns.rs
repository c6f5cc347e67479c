//! The published missions in the flat iHTN form, unchanged, in a demo that keeps running.

use crate::demo_shutdown::keep_running;
use crate::support::{Folder, LONG, Program, reference};

/// Skills of a robot for all three missions.
const SKILLS: [&str; 13] = [
    "navigation",
    "approach_person",
    "authenticate_person",
    "operate_drawer",
    "approach_robot",
    "wait-for-food",
    "approach-human",
    "wait-for-human-to-fetch",
    "approach-door",
    "open-door",
    "pick-patient-dishes",
    "load-dishes",
    "retrieve-dishes",
];

/// Returns two robots and the arm.
fn workers() -> String {
    let robot =
        |name: &str| format!("[[worker]]\nname = {name:?}\nplace = \"Dock\"\nspeed_mps = 0.6\nskills = {SKILLS:?}\n");
    let arm = "[[worker]]\nname = \"arm\"\nplace = \"Laboratory\"\nskills = [\"pick_up\"]\n";
    format!("{}{}{arm}", robot("ada"), robot("bob"))
}

fn flags(domains: &[String]) -> Vec<&str> {
    domains.iter().flat_map(|domain| ["--domain", domain.as_str()]).collect()
}

#[test]
fn a_demo_that_keeps_running_completes_the_published_ihtns() {
    let Some(published) = reference() else { return };
    let folder = Folder::new();
    let run = |name: &str, arguments: &[&str]| Program::start(&folder, name, arguments).end(LONG).expect(0).stdout;
    let missions = ["lsl", "fld", "flp"].map(|name| published.join(format!("ihtn_{name}.json")).display().to_string());

    // Each domain declares what the earlier ones lack: the files share a location and a person.
    let mut domains: Vec<String> = vec![];
    let people: [&[&str]; 3] = [&[], &["--person", "Delivery1", "--person", "Patient1"], &[]];
    for (number, (mission, people)) in missions.iter().zip(people).enumerate() {
        let scaffold = [&["domain", "scaffold", mission.as_str()][..], people, &flags(&domains)[..]].concat();
        let domain = run(&format!("scaffold-{number}"), &scaffold);
        domains.push(folder.write(&format!("domain-{number}.yaml"), &domain).display().to_string());
    }

    let workers = folder.write("workers.toml", &workers()).display().to_string();
    for (number, mission) in missions.iter().enumerate() {
        let dry_run = [&["dry-run", mission.as_str(), "--workers", &workers][..], &flags(&domains)[..]].concat();
        let outcome = run(&format!("dry-run-{number}"), &dry_run);
        assert!(outcome.contains("  assignment: "), "{mission}: {outcome}");
    }

    let (demo, address) = keep_running(&folder, &flags(&domains));
    for (number, mission) in missions.iter().enumerate() {
        let submit = ["submit", mission.as_str(), "--fleet", "demo", "--connect", &address, "--wait"];
        let outcome = run(&format!("submit-{number}"), &submit);
        assert!(outcome.ends_with(" completed\n"), "{mission}: {outcome}");
    }
    demo.signal("TERM");
    demo.end(LONG).expect(0);
}
