//! A fleet from the example files with a door in the ward. The page shows the door opening and
//! closing. A mission is canceled while its robot has the sample, and the user resolves it.

use crate::browser::Browser;
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::station::{dashboard_address, station_with_dashboard, wait_for_coordinator, with};
use crate::support::{Fleet, Folder, example};
use std::time::Duration;

/// Limit for the robot to reach the nurse and receive the sample.
const ON_ITS_WAY: Duration = Duration::from_secs(120);

/// Returns the shipped ward with a door across its corridor, on the way from the dock to the
/// intensive care rooms.
fn ward(folder: &Folder) -> String {
    let map = include_str!("../../../../sim_bridge/world/maps/hospital.yaml");
    let door = "doors:\n  - { name: Ward Door, on: [[Crossing, IC Corridor 1]], opening_s: 6 }\n";
    folder.write("ward.yaml", &format!("{map}\n{door}")).display().to_string()
}

#[test]
fn a_door_is_shown_opening_and_a_mission_is_resolved() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let map = ward(&folder);
    let mut fleet = Fleet::new(&with(example("fleet"), "map", map.clone()));
    fleet.start("station", station_with_dashboard(), &[]);
    let mut world = with(with(example("world"), "map", map), "speed", 3.0);
    // The nurse must stay where she is.
    let nurse = world["person"].as_array_mut().and_then(|people| people[0].as_table_mut()).expect("a nurse");
    nurse.remove("spontaneous_actions");
    fleet.start("world", world, &["station-1"]);
    fleet.start("robot", example("robot"), &["station-1", "world"]);
    fleet.start("robot", example("arm"), &["station-1", "world"]);
    let url = dashboard_address(fleet.node("station-1"));
    browser.open(&url);
    browser.wait_until("both robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    wait_for_coordinator(&browser);
    let door = "document.querySelector('#doors tbody tr')?.innerText";
    browser.wait_until("the door is shut", &format!("/^Ward Door\\s+closed$/.test({door})"));
    browser.wait_until("its sign", "document.querySelector('#door-sign').checkVisibility()");

    // Requested with the form; ada drives through the door.
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    tab_to(&browser, "#submit-send");
    browser.press(ENTER);
    browser.wait_until("its state", "consort.connection.model.missions['lab-samples-1']?.state === 'running'");
    browser.wait_until_within(ON_ITS_WAY, "the door opens", &format!("/open/.test({door})"));
    browser.screenshot("door");
    browser.wait_until("the door shuts again", &format!("/\\sclosed$/.test({door})"));

    // Canceled with the sample in the drawer: the mission needs intervention.
    browser.wait_until_within(
        ON_ITS_WAY,
        "ada has the sample for certain",
        "consort.connection.model.missions['lab-samples-1'].items?.some((item) => item.certain && item.robot === 'ada')",
    );
    browser
        .wait_until("the page shows it", "document.querySelector('#mission .items').innerText.includes('ada has it')");
    tab_to(&browser, "#mission .danger");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until(
        "the mission needs intervention",
        "consort.connection.model.missions['lab-samples-1'].state === 'needs_intervention'",
    );
    browser.wait_until("the health reports an error", "/error/.test(document.querySelector('#health').innerText)");
    check_access(&browser, "a mission that needs intervention");
    browser.screenshot("needs-rescue");

    // A person must have taken care of it: without a name the form sends nothing.
    tab_to(&browser, "#mission [data-key=resolve]");
    browser.press(ENTER);
    browser.wait_until("the form asks for a name", "document.activeElement.id === 'resolve-by'");
    assert!(browser.text("#resolve-items").contains("ada has it"), "{}", browser.text("#resolve"));
    browser.press(ENTER);
    assert_eq!(browser.value("document.querySelector('#resolve').open"), true);
    check_access(&browser, "resolving a mission");
    browser.screenshot("rescue");
    browser.press(&format!("Nia{ENTER}"));
    browser.wait_until("the form is closed", "!document.querySelector('#resolve').open");
    browser.wait_until("it has failed", "consort.connection.model.missions['lab-samples-1'].state === 'failed'");
    browser.wait_until(
        "the name of the person",
        "document.querySelector('#mission .cause').innerText.endsWith('resolved by Nia')",
    );
    browser.wait_until("all is well", "/^(ok|\\d warning)/.test(document.querySelector('#health').innerText)");

    // The mission is resolved once; another attempt is rejected with the error of the coordinator.
    let refused = browser.value(
        "fetch('/api/missions/lab-samples-1/resolve', { method: 'POST', headers: { 'content-type': 'application/json' }, body: '{\"by\": \"Bo\"}' }).then(async (answer) => [answer.status, (await answer.json()).error])",
    );
    assert_eq!(refused[0], 400);
    assert!(
        refused[1].as_str().expect("words").contains("only a mission that needs intervention can be resolved"),
        "{refused}"
    );
    let output = browser.console();
    assert!(output.iter().all(|line| line.contains("/resolve") && line.contains("400")), "{output:#?}");
    fleet.stop();
}
