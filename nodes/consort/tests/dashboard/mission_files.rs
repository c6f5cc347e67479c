//! The user submits mission files with the form: YAML, and a flat iHTN with a person. The form offers the missions of
//! the fleet.

use crate::browser::Browser;
use crate::demo_fleet::check_access;
use crate::station::{dashboard_address, station_with_dashboard, wait_for_coordinator, with};
use crate::support::{Fleet, Folder, example};
use std::path::Path;

const ROUNDS: &str = r#"
mission: rounds
title: Look in at a room
parameters:
  room: { kind: place, description: where to look in }
roles: { looker: { kind: managed } }
root: { task: go, type: navigation, roles: [looker], parameters: { to: "${room}" } }
"#;

/// The tasks of the standard domain, so that no domain file is needed.
const VISIT: &str = r#"{
  "0": { "name": "visit", "type": "task", "parent": "-1", "agents": ["ada", "visitor"], "children": ["1"] },
  "1": { "name": "m-visit", "type": "method", "parent": "0", "agents": ["ada", "visitor"], "children": ["2", "3"] },
  "2": { "name": "navto", "type": "action", "parent": "1", "agents": ["ada"], "locations": ["IC Room 6"] },
  "3": { "name": "attend", "type": "action", "parent": "1", "agents": ["visitor"], "locations": ["IC Room 6"] }
}"#;

#[test]
fn mission_files_are_submitted_with_the_form() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let settings = with(example("fleet"), "bootstrap_expect", 1);
    let mut fleet = Fleet::new(&with(settings, "missions", vec!["look.yaml"]));
    let look = ROUNDS.replace("mission: rounds", "mission: look");
    std::fs::write(fleet.path("look.yaml"), look).expect("the folder can be written to");
    fleet.start("station", station_with_dashboard(), &[]);
    let url = dashboard_address(fleet.node("station-1"));
    browser.open(&url);
    wait_for_coordinator(&browser);
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    let first = browser.value("document.querySelector('#submit-mission option').value");
    assert_eq!(first, "look", "the mission of the fleet");

    // A mistake is named with its place, and the form stays as it was.
    let choose = |path: &Path| browser.upload("#submit-file", path);
    choose(&folder.write("wrong.yaml", &ROUNDS.replace("root:", "rot:")));
    browser.wait_until(
        "what is wrong",
        "/wrong.yaml: .*line \\d+.*rot/s.test(document.querySelector('#submit-problem').innerText)",
    );
    assert_eq!(browser.value("document.querySelectorAll('[data-parameter]').length"), 2);

    choose(&folder.write("rounds.yaml", ROUNDS));
    browser.wait_until("the title", "document.querySelector('#submit-title').innerText === 'Look in at a room'");
    check_access(&browser, "a mission file is chosen");
    browser.value("(document.querySelector('[data-parameter=room]').value = 'IC Room 6', true)");
    browser.click("#submit-send");
    browser.wait_until("it is acknowledged", "consort.connection.model.missions['rounds-1'] !== undefined");

    browser.click("#new-mission");
    choose(&folder.write("visit.json", VISIT));
    browser.wait_until("its agents", "document.querySelectorAll('#submit-people input').length === 2");
    check_access(&browser, "agents of an iHTN");
    browser.screenshot("mission-file");
    browser.click("#submit-people input[value=visitor]");
    browser.click("#submit-send");
    browser.wait_until("it is acknowledged", "consort.connection.model.missions['visit-2'] !== undefined");
    let missions = fleet.run(&["missions"], "station-1").expect(0).stdout;
    assert!(missions.contains("rounds-1  pending") && missions.contains("visit-2   pending"), "{missions}");
    fleet.stop();
}
