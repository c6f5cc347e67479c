//! A fleet by hand, of the example files, with a door in the ward: the door is seen to open and to shut, a mission is withdrawn
//! while its robot has the sample, and closed by whoever took care of that.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::support::{Fleet, Folder, example, until};
use std::time::Duration;
use toml::Table;

/// How long the robot may take to the nurse and to have what she gives.
const ON_ITS_WAY: Duration = Duration::from_secs(120);

/// The shipped ward with a door across its corridor, on the way from the dock to the intensive care rooms.
fn ward(folder: &Folder) -> String {
    let map = include_str!("../../sim_bridge/maps/hospital.yaml");
    let door = "doors:\n  - { name: Ward Door, on: [[Crossing, IC Corridor 1]], opening_s: 6 }\n";
    folder.write("ward.yaml", &format!("{map}\n{door}")).display().to_string()
}

fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

#[test]
fn a_door_is_seen_to_open_and_a_mission_is_closed_after_its_rescue() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let map = ward(&folder);
    let mut fleet = Fleet::new(&with(example("fleet"), "map", map.clone()));
    fleet.start("station", with(example("station"), "dashboard", "127.0.0.1:0"), &[]);
    let mut world = with(with(example("world"), "map", map), "speed", 3.0);
    // She stays where she is: this is not her story.
    let nurse = world["person"].as_array_mut().and_then(|people| people[0].as_table_mut()).expect("a nurse");
    nurse.remove("mood");
    fleet.start("world", world, &["station-1"]);
    fleet.start("robot", example("robot"), &["station-1", "world"]);
    fleet.start("robot", example("arm"), &["station-1", "world"]);
    let url = until("the address of the dashboard", SOON, || {
        let said = fleet.node("station-1").stdout();
        Some(said.lines().find_map(|line| line.strip_prefix("dashboard: "))?.to_owned())
    });
    browser.open(&url);
    browser.wait_until("both robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    browser.wait_until("who coordinates", "/term \\d/.test(document.querySelector('#coordinator').innerText)");
    let door = "document.querySelector('#doors tbody tr')?.innerText";
    browser.wait_until("the door is shut", &format!("/^Ward Door\\s+closed$/.test({door})"));
    browser.wait_until("its sign", "document.querySelector('#door-sign').checkVisibility()");

    // Asked for by the form; ada sets out through the door.
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    tab_to(&browser, "#order-send");
    browser.press(ENTER);
    browser.wait_until("its state", "consort.line.picture.missions['lab-samples-1']?.state === 'running'");
    browser.wait_until_within(ON_ITS_WAY, "the door opens", &format!("/open/.test({door})"));
    browser.screenshot("door");
    browser.wait_until("the door shuts again", &format!("/\\sclosed$/.test({door})"));

    // Withdrawn with the sample in the drawer: somebody must see to that.
    browser.wait_until_within(
        ON_ITS_WAY,
        "ada has the sample for certain",
        "consort.line.picture.missions['lab-samples-1'].items?.some((item) => item.certain && item.robot === 'ada')",
    );
    browser.wait_until("that is said", "document.querySelector('#mission .items').innerText.includes('ada has it')");
    tab_to(&browser, "#mission .danger");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("it needs rescue", "consort.line.picture.missions['lab-samples-1'].state === 'needs_rescue'");
    browser.wait_until("health says so", "/error/.test(document.querySelector('#health').innerText)");
    check_access(&browser, "a mission that needs rescue");
    browser.screenshot("needs-rescue");

    // Only somebody can have taken care of it: without a name nothing is sent.
    tab_to(&browser, "#mission [data-key=rescue]");
    browser.press(ENTER);
    browser.wait_until("who it was is asked", "document.activeElement.id === 'rescue-by'");
    assert!(browser.text("#rescue-items").contains("ada has it"), "{}", browser.text("#rescue"));
    browser.press(ENTER);
    assert_eq!(browser.value("document.querySelector('#rescue').open"), true);
    check_access(&browser, "closing after a rescue");
    browser.screenshot("rescue");
    browser.press(&format!("Nia{ENTER}"));
    browser.wait_until("the form is closed", "!document.querySelector('#rescue').open");
    browser.wait_until("it has failed", "consort.line.picture.missions['lab-samples-1'].state === 'failed'");
    browser.wait_until("by whom", "document.querySelector('#mission .cause').innerText.endsWith('rescued by Nia')");
    browser.wait_until("all is well", "/^(well|\\d warning)/.test(document.querySelector('#health').innerText)");

    // It is closed once: another time is refused, in the words of the coordinator.
    let refused = browser.value(
        "fetch('/api/missions/lab-samples-1/rescued', { method: 'POST', headers: { 'content-type': 'application/json' }, body: '{\"by\": \"Bo\"}' }).then(async (answer) => [answer.status, (await answer.json()).error])",
    );
    assert_eq!(refused[0], 400);
    assert!(refused[1].as_str().expect("words").contains("only one that needs rescue can be closed"), "{refused}");
    let said = browser.console();
    assert!(said.iter().all(|line| line.contains("/rescued") && line.contains("400")), "{said:#?}");
    fleet.stop();
}
