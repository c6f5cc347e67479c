//! The panel of the selected robot.

use crate::browser::Browser;
use crate::closures::is_drawn;
use crate::demo_fleet::check_access;
use crate::shown_model::ShownModel;
use crate::support::Folder;
use consort_dashboard::fleet_model::{FleetInput, FleetModel};
use consort_protocol::keys::Key;
use serde_json::{Value, json};

/// Returns a robot of the view of a fleet, with other members of its record and of its node.
fn robot(name: &str, of_record: Value, of_node: Value) -> Value {
    let mut record = json!({
        "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 1.5 }, "battery": 0.8,
        "discharge": 0.001, "useful_charge": 0.08, "speed": 0.7, "availability": "free", "estimator": "standard",
    });
    extend(&mut record, of_record);
    let mut node =
        json!({ "node": name, "seen_by": "station-1", "alive": true, "status": "alive", "age_ms": 0, "robot": record });
    extend(&mut node, of_node);
    node
}

fn extend(object: &mut Value, other: Value) {
    let Value::Object(other) = other else { panic!("an object: {other}") };
    object.as_object_mut().expect("an object").extend(other);
}

/// Applies a report of the driver of a robot.
fn report(model: &mut FleetModel, robot: &str, battery: f64, feedback: &Value, now_ms: u64) {
    let telemetry = json!({
        "time": now_ms as f64 / 1000.0, "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 1.5 }, "place": "Dock", "battery": battery,
        "able": true, "closed": [],
    });
    let input = FleetInput::Telemetry {
        robot: robot.to_owned(),
        telemetry: serde_json::from_value(telemetry).expect("telemetry"),
        feedback: serde_json::from_value(feedback.clone()).expect("scalars by name"),
    };
    model.apply(&input, now_ms);
}

/// Waits for the notes of the panel, each with its name and its value.
#[track_caller]
fn wait_for_notes(browser: &Browser, notes: &str) {
    let shown = "[...document.querySelectorAll('#robot-notes div')].map((note) => [...note.children].map((part) => part.innerText).join(' ')).join('; ')";
    browser.wait_until("the notes", &format!("{shown} === {notes:?}"));
}

#[test]
fn the_panel_shows_the_feedback_of_the_action_in_progress() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("feedback", |_, _| {});
    let holding = json!({ "availability": { "holding": { "mission": "rinse-1", "role": "r1", "suspended": false } } });
    let fleet = json!({ "nodes": [robot("ada", holding, json!({})), robot("bob", json!({}), json!({}))] });
    shown.change(|model, now_ms| {
        model.apply_view(&Key::ViewFleet, &fleet, now_ms);
        report(model, "ada", 0.8, &json!({ "soaked_share": 0.256, "phase": "rinse" }), now_ms);
    });
    browser.open(&shown.url());
    browser.wait_until("both robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    assert_eq!(browser.value("document.querySelector('#robot-notes').checkVisibility()"), false, "none is selected");
    browser.value("document.querySelector('#robots tr[data-row=ada] .rowbutton').click()");
    wait_for_notes(&browser, "feedback: phase rinse; feedback: soaked share 0.26; charge 80 %");
    check_access(&browser, "the panel of a robot");
    browser.screenshot("robot-panel");
    shown.change(|model, now_ms| report(model, "ada", 0.8, &json!({ "phase": "dry" }), now_ms));
    wait_for_notes(&browser, "feedback: phase dry; charge 80 %");
    shown.change(|model, now_ms| report(model, "ada", 0.8, &json!({}), now_ms));
    wait_for_notes(&browser, "charge 80 %");
    assert_eq!(browser.console(), Vec::<String>::new());
}

#[test]
fn the_panels_show_the_planned_starts_of_promised_roles_in_their_order() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("timelines", |_, _| {});
    let holding = json!({ "availability": { "holding": { "mission": "rinse-1", "role": "r1", "suspended": false } } });
    let starts = std::cell::Cell::new([0; 2]);
    let role = |role: &str, phase: &str| json!({ "role": role, "kind": "managed", "phase": phase, "holder": "ada" });
    let mission = |number: u64, role: Value| json!({ "mission": format!("rinse-{number}"), "number": number, "detail": "running", "roles": [role] });
    shown.change(|model, now_ms| {
        let mut apply = |number: u64, role: Value, at_ms: u64| {
            let key = Key::ViewMission(format!("rinse-{number}").parse().expect("a mission"));
            model.apply_view(&key, &mission(number, role), at_ms);
        };
        let [first, second] = [now_ms + 40_000, now_ms + 90_000];
        starts.set([first, second]);
        apply(1, role("r1", "active"), now_ms - 60_000);
        let mut promised = role("r1", "promised");
        let before = json!([{ "mission": "rinse-1", "role": "r1" }, { "mission": "rinse-3", "role": "carrier" }]);
        promised["promise"] = json!({ "planned_at_ms": second, "delayed_s": 0.0, "can_start": false, "after": before });
        apply(2, promised, now_ms);
        apply(3, role("carrier", "promised"), now_ms);
        // The rate of the world is measured: a second per second.
        report(model, "ada", 0.8, &json!({}), now_ms - 10_000);
        report(model, "ada", 0.8, &json!({}), now_ms);
        let timeline = json!({
            "holds": { "mission": "rinse-1", "role": "r1" },
            "promised": [
                { "mission": "rinse-3", "role": "carrier", "planned_at_ms": first, "time_s": 50.0 },
                { "mission": "rinse-2", "role": "r1", "planned_at_ms": second, "time_s": null },
            ],
        });
        let fleet = json!({ "nodes": [robot("ada", holding, timeline)], "closures": [] });
        model.apply_view(&Key::ViewFleet, &fleet, now_ms);
    });
    browser.open(&shown.url());
    browser.wait_until("the robot", "document.querySelectorAll('#robots tbody tr').length === 1");
    browser.value("document.querySelector('#robots tr[data-row=ada] .rowbutton').click()");
    let [first, second] = starts.get();
    let at = |ms: u64| {
        let time = browser.value(&format!("new Date({ms}).toLocaleTimeString([], {{ hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false }})"));
        time.as_str().expect("text").to_owned()
    };
    wait_for_notes(
        &browser,
        &format!(
            "charge 80 %; later, 1 carrier of rinse-3, planned for {}; later, 2 r1 of rinse-2, planned for {}",
            at(first),
            at(second)
        ),
    );
    browser.value("document.querySelector('#missions tr[data-row=rinse-2] .rowbutton').click()");
    browser.wait_until(
        "the role of the mission",
        &format!(
            "document.querySelector('#mission table .sub')?.innerText === 'promised, from about {}, after r1 of rinse-1, carrier of rinse-3'",
            at(second)
        ),
    );
    check_access(&browser, "a promised role");
    browser.screenshot("promised");
    browser.click("#tab-schedule");
    let bars = "[...document.querySelectorAll('#schedule-chart .bar')].map((bar) => bar.getAttribute('aria-label'))";
    browser.wait_until(
        "the roles on the chart",
        &format!("/^ada, r1 of rinse-1: active, [^;]+;ada, carrier of rinse-3: promised, in [^;]+, planned 50 s;ada, r1 of rinse-2: promised, in [^;]+$/.test({bars}.join(';'))"),
    );
    browser.wait_until(
        "the same as a table",
        "[...document.querySelectorAll('#schedule tbody tr')].map((row) => row.innerText).filter((row) => row.includes('promised')).length === 2",
    );
    check_access(&browser, "promised roles on the schedule");
    browser.screenshot("promised-schedule");
    assert_eq!(browser.console(), Vec::<String>::new());
}

#[test]
fn chargers_are_shown_with_their_robots_and_charges_with_forecasts() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("chargers", |_, _| {});
    let claim = |charger: &str| json!({ "charger": charger, "battery": 0.2 });
    let charging = |state: &str, of: Value| json!({ "charging": { state: of } });
    let fleet = json!({
        "nodes": [
            robot("ada", json!({}), json!({})),
            robot("bob", charging("connected", claim("Dock")), json!({})),
            robot("cyd", charging("waiting", json!({ "chargers": ["Dock"] })), json!({})),
            robot("dot", charging("bound", claim("IC Room 3")), json!({})),
            robot("eve", charging("leaving", json!({ "to": "IC Room 4" })), json!({})),
        ],
        "charging": { "below": 0.3, "until": 0.9, "opportunistic": null, "chargers": ["Dock", "IC Room 3"] },
    });
    let reported = std::cell::Cell::new(0);
    shown.change(|model, now_ms| {
        model.apply_view(&Key::ViewFleet, &fleet, now_ms - 20_000);
        for (ago_ms, falling, rising) in [(20_000, 0.5, 0.5), (10_000, 0.45, 0.6), (0, 0.4, 0.7)] {
            report(model, "ada", falling, &json!({}), now_ms - ago_ms);
            report(model, "bob", rising, &json!({}), now_ms - ago_ms);
        }
        reported.set(now_ms);
    });
    browser.open(&shown.url());
    browser.wait_until("the robots", "document.querySelectorAll('#robots tbody tr').length === 5");
    browser.wait_until(
        "the chargers",
        "/^Dock\\s+bob\\s+–\\s+cyd\\s+IC Room 3\\s+–\\s+dot\\s+–$/.test(document.querySelector('#chargers tbody').innerText)",
    );
    assert_eq!(browser.value("document.querySelector('#charger-sign').checkVisibility()"), true);
    // A charger beside its place is filled while a robot charges.
    browser.wait_until("a charging robot", &is_drawn("good", "Dock", (-21, 0)));
    browser.wait_until("a free charger", &is_drawn("floor", "IC Room 3", (-21, 0)));

    let forecast = |robot: &str| browser.value(&format!("consort.connection.model.robots.{robot}.forecast"));
    let at_ms = reported.get() + 20_000;
    assert_eq!(forecast("ada"), json!({ "share": 0.3, "at_ms": at_ms }));
    assert_eq!(forecast("bob"), json!({ "share": 0.9, "at_ms": at_ms }));
    let time =
        format!("new Date({at_ms}).toLocaleTimeString([], {{ hour: '2-digit', minute: '2-digit', hourCycle: 'h23' }})");
    browser.wait_until(
        "the forecast in the table",
        &format!("document.querySelector('#robots tr[data-row=ada] td:nth-child(3) .sub').innerText === `30 % at ${{{time}}}`"),
    );
    browser.value("document.querySelector('#robots tr[data-row=bob] .rowbutton').click()");
    let time = browser.value(&time);
    let time = time.as_str().expect("text");
    wait_for_notes(&browser, &format!("charge 70 %, 90 % at {time}, charges at Dock"));
    browser.value("document.querySelector('#robots tr[data-row=cyd] .rowbutton').click()");
    wait_for_notes(&browser, "charge 80 %, waits for Dock");
    browser.value("document.querySelector('#robots tr[data-row=eve] .rowbutton').click()");
    wait_for_notes(&browser, "charge 80 %, drives to IC Room 4, to make room");
    check_access(&browser, "chargers");
    browser.screenshot("chargers");
    assert_eq!(browser.console(), Vec::<String>::new());
}
