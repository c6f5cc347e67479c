//! `consort demo` without arguments: the main job.

use crate::support::{Folder, LONG, Program, tasks};
use serde_json::Value;
use std::collections::BTreeMap;

/// Tasks of the shipped mission with their roles.
pub(crate) const LAB_SAMPLES: [&str; 11] = [
    "lab_arm/pick_up_sample",
    "nurse/deposit",
    "r1/approach_arm",
    "r1/approach_nurse",
    "r1/authenticate_nurse",
    "r1/close_drawer_lab",
    "r1/close_drawer_nurse",
    "r1/navto_lab",
    "r1/navto_room",
    "r1/open_drawer_for_nurse",
    "r1/open_drawer_lab",
];

/// Returns the expected counts: each task begun once and ended once.
pub(crate) fn each_once() -> BTreeMap<String, (u32, u32)> {
    LAB_SAMPLES.iter().map(|task| ((*task).to_owned(), (1, 1))).collect()
}

fn of<'a>(events: &'a [Value], name: &str) -> Vec<&'a Value> {
    events.iter().filter(|event| event["event"] == name).collect()
}

#[test]
fn the_demo_kills_its_coordinator_and_the_sample_arrives() {
    let folder = Folder::new();
    let ended = Program::start(&folder, "demo", &["demo", "--json"]).end(LONG).expect(0);
    let events = ended.json_lines();

    let [killed] = of(&events, "demo_killed")[..] else { panic!("expected a single kill\n{}", ended.stdout) };
    let [takeover] = of(&events, "demo_takeover")[..] else { panic!("expected a single takeover\n{}", ended.stdout) };
    assert_ne!(killed["node"], takeover["node"]);
    let elected: Vec<&Value> = of(&events, "elected");
    assert_eq!(elected[0]["node"], killed["node"], "the coordinator was killed");
    let successor = elected.iter().find(|event| event["node"] == takeover["node"]).expect("it was elected");
    assert!(successor["term"].as_u64() > elected[0]["term"].as_u64(), "{elected:?}");
    // The demo kills the coordinator while the mission runs.
    let place = |name: &str| events.iter().position(|event| event["event"] == name);
    assert!(place("task_began") < place("demo_killed"));
    let completed = events.iter().rposition(|event| event["event"] == "mission" && event["state"] == "completed");
    assert!(place("demo_takeover") < completed);

    let missions = of(&events, "submitted");
    assert_eq!(missions.len(), 1);
    let mission = missions[0]["mission"].as_str().expect("a mission's name");
    assert_eq!(tasks(&events, mission), each_once());
    assert_eq!(of(&events, "released"), Vec::<&Value>::new(), "no role was released");

    let summary = events.last().expect("a summary");
    assert_eq!(summary["event"], "demo_summary");
    assert_eq!((&summary["completed"], &summary["samples"], &summary["delivered"]), (&1.into(), &1.into(), &1.into()));
    assert_eq!(summary["killed"], killed["node"]);
    assert_eq!(summary["takeover"]["node"], takeover["node"]);

    folder.await_no_process();
    assert_eq!(folder.temporary_files(), Vec::<String>::new());
}
