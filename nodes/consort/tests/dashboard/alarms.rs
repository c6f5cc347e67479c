//! The user raises an alarm, sees what it affects and where robots assemble, and clears it.

use crate::browser::{Browser, SOON};
use crate::closures::{is_drawn, select, sign};
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::mission_orders::fill;
use crate::shown_model::ShownModel;
use crate::station::open_station;
use crate::support::{Folder, until};
use consort_protocol::keys::Key;
use serde_json::json;

/// What the alarm of the example demands.
const PLAN: &str =
    "Robots drive to the nearest of Dock, Laboratory Corridor. Closed: zone icu, IC Corridor 3 – IC Corridor 6.";

/// Opens the form of an alarm, without a mouse.
fn open_form(browser: &Browser) {
    browser.wait_until("the button", "document.querySelector('#raise-alarm').checkVisibility()");
    tab_to(browser, "#raise-alarm");
    browser.press(ENTER);
    browser.wait_until("the form", "document.querySelector('#order').open && document.activeElement.name === 'alarm'");
}

#[test]
fn an_alarm_is_raised_and_cleared_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let mut fleet = open_station(&browser);
    open_form(&browser);
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with(PLAN), "{effect}");
    let shown =
        "['minutes', 'until', 'reason'].map((field) => document.querySelector(`#order-${field}`).checkVisibility())";
    assert_eq!(browser.value(shown), json!([false, false, true]));
    check_access(&browser, "the form of an alarm");
    browser.screenshot("alarm-form");
    browser.value("(document.querySelector('#order-by').value = 'Nia', true)");
    tab_to(&browser, "#order-reason");
    browser.press(&format!("smoke{ENTER}"));
    browser.wait_until("it is raised", "consort.connection.model.alarms.fire?.order.reason === 'smoke'");
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.id === 'raise-alarm'",
    );

    let banner = "document.querySelector('#alarms-list p')";
    browser.wait_until(
        "the banner",
        &format!(
            "{banner}.innerText.startsWith('Alarm fire, raised by Nia: smoke, since ') && {banner}.innerText.endsWith({PLAN:?})"
        ),
    );
    let assembly = is_drawn("good", "Dock", (-8, -8));
    browser.wait_until("the assembly place on the map", &assembly);
    browser.wait_until("the closed zone on the map", &sign("IC Room 5"));
    select(&browser, "IC Room 5");
    browser.wait_until(
        "the cause of the closure",
        "document.querySelector('#part-state').innerText === 'closed by the alarm fire'",
    );
    check_access(&browser, "an alarm");
    browser.screenshot("alarm");
    until("the alarm in the view", SOON, || {
        let seen = fleet.run(&["fleet", "--json"], "station-1").expect(0).json();
        (seen["fleet"]["alarms"][0]["alarm"] == "fire").then_some(())
    });

    browser.value("document.querySelector('#raise-alarm').focus()");
    tab_to(&browser, "#alarms-list button");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("no banner", "!document.querySelector('#alarms').checkVisibility()");
    browser.wait_until("no closed zone on the map", &format!("!{}", sign("IC Room 5")));
    browser.wait_until("no assembly place on the map", &format!("!{assembly}"));
    assert_eq!(browser.console(), Vec::<String>::new());
    fleet.stop();
}

/// The model shows a robot with a role, a mission that waits, and two declared alarms.
#[test]
fn an_alarm_is_raised_with_its_effect_on_robots_and_missions() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("alarms", |_, _| {});
    let robot = json!({ "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 1.5 },
        "battery": 0.8, "discharge": 0.001, "useful_charge": 0.08, "speed": 0.7, "estimator": "e",
        "availability": { "holding": { "mission": "m-1", "role": "r1", "suspended": false } } });
    let alarms = json!({ "fire": { "robots": "assemble", "places": ["Dock"], "closes": [] },
        "freeze": { "robots": "stop", "places": [], "closes": [{ "place": "IC Room 6" }] } });
    let fleet = json!({ "nodes": [{ "node": "ada", "seen_by": "station-1", "alive": true, "robot": robot }],
        "declared": { "alarms": alarms, "zones": {} } });
    let missions =
        json!({ "missions": [{ "mission": "m-1", "detail": "running" }, { "mission": "m-2", "detail": "pending" }] });
    shown.change(|model, now_ms| {
        model.apply_view(&Key::ViewFleet, &fleet, now_ms);
        model.apply_view(&Key::ViewMissions, &missions, now_ms);
    });
    browser.open(&shown.url());
    browser.wait_until("the missions", "document.querySelectorAll('#missions tbody tr').length === 2");
    open_form(&browser);
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("Robots drive to the nearest of Dock. No robot takes a role"), "{effect}");
    let expected = "Robots: 1, of them under way: 0. Missions that have not ended: 2.\n\
        ada: r1 of m-1 is suspended\nm-2 waits for the all-clear";
    assert_eq!(browser.text("#order-affected"), expected);
    fill(&browser, "#order [name=alarm]", "freeze");
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("Robots stand still. Closed: IC Room 6."), "{effect}");
    shown.change(|model, now_ms| {
        model.apply_view(&Key::ViewFleet, &json!({ "nodes": [] }), now_ms);
    });
    browser.wait_until("another fleet file", "Object.keys(consort.connection.model.declared_alarms).length === 0");
    fill(&browser, "#order [name=alarm]", "fire");
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("The fleet file no longer declares it."), "{effect}");
    tab_to(&browser, "#order-send");
    browser.press(ENTER);
    browser.wait_until(
        "the problem",
        "document.querySelector('#order-problem').innerText === 'the shown model is not a running fleet; it accepts no requests'",
    );
}
