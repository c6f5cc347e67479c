//! The user changes the priority of a mission, pins and reassigns roles, and cancels the missions that the list shows,
//! and those that meet a condition.

use crate::browser::Browser;
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::station::open_ward;
use crate::support::Folder;
use serde_json::json;

const MISSIONS: [&str; 2] = ["lab-samples-1", "lab-samples-2"];

/// Returns a mission in the model of the page.
fn model_of(mission: &str) -> String {
    format!("consort.connection.model.missions[{mission:?}]")
}

/// Submits a mission, which is then the selected mission.
fn submit(browser: &Browser, mission: &str) {
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    browser.click("#submit-send");
    browser.wait_until("its roles", &format!("{}?.roles?.r1", model_of(mission)));
    wait_for_mission(browser, mission);
}

fn wait_for_mission(browser: &Browser, mission: &str) {
    browser.wait_until("the mission", &format!("document.querySelector('#mission h3').innerText === {mission:?}"));
}

/// Opens the form of an order, without a mouse. The first field of its own has the focus.
fn open_form(browser: &Browser, key: &str, field: &str) {
    tab_to(browser, &format!("#mission [data-key={key}]"));
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        &format!("document.querySelector('#order').open && document.activeElement.name === {field:?}"),
    );
}

/// Changes a field, as a user does.
pub(crate) fn fill(browser: &Browser, selector: &str, value: &str) {
    browser.value(&format!(
        "((field) => {{ field.value = {value:?}; field.dispatchEvent(new Event('input', {{ bubbles: true }})); }})(document.querySelector({selector:?}))"
    ));
}

fn send(browser: &Browser) {
    tab_to(browser, "#order-send");
    browser.press(ENTER);
}

#[test]
fn missions_and_roles_are_ordered_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    // Slow enough that ada stays on its way to the room.
    let fleet = open_ward(&browser, 0.5);
    submit(&browser, MISSIONS[0]);
    browser.wait_until("the role of ada", "consort.connection.model.robots.ada.mission === 'lab-samples-1'");
    submit(&browser, MISSIONS[1]);

    change_priority(&browser);
    pin_and_unpin(&browser);
    reassign(&browser);
    cancel_listed(&browser);
    cancel_by_condition(&browser);
    assert_eq!(browser.console(), Vec::<String>::new());
    fleet.stop();
}

fn change_priority(browser: &Browser) {
    open_form(browser, "priority", "priority");
    assert_eq!(browser.text("#order-affected"), "Waiting missions before it: 0, after it: 0.");
    let shown =
        "['minutes', 'until', 'reason'].map((field) => document.querySelector(`#order-${field}`).checkVisibility())";
    assert_eq!(browser.value(shown), json!([false, false, false]));
    check_access(browser, "the form of a priority");
    fill(browser, "#order [name=priority]", "50");
    browser.press(ENTER);
    browser.wait_until("its priority", &format!("{}.priority === 50", model_of(MISSIONS[1])));
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.dataset.key === 'priority'",
    );
}

fn pin_and_unpin(browser: &Browser) {
    let order = format!("{}.orders?.r1", model_of(MISSIONS[1]));
    open_form(browser, "pin-r1", "pin");
    fill(browser, "#order [name=pin]", "ada");
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("No robot but ada gets the role from now on"), "{effect}");
    assert_eq!(browser.text("#order-affected"), "ada holds r1 of lab-samples-1");
    check_access(browser, "the form of a pin");
    send(browser);
    browser.wait_until("it is pinned", &format!("{order} === 'pinned to ada'"));
    tab_to(browser, "#mission [data-key=unpin-r1]");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("it is not pinned", &format!("!{order}"));
}

fn reassign(browser: &Browser) {
    browser.value("document.querySelector('#missions tr[data-row=lab-samples-1] .rowbutton').click()");
    wait_for_mission(browser, MISSIONS[0]);
    open_form(browser, "reassign-r1", "to");
    let robots = browser.value("[...document.querySelector('#order [name=to]').options].map(({ value }) => value)");
    assert_eq!(robots, json!(["", "lab-arm"]));
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("ada returns the role once its body is at rest, and another robot gets it"), "{effect}");
    browser.value("document.querySelector('#order [name=repeat]').click()");
    check_access(browser, "the form of a reassignment");
    browser.screenshot("reassign");
    send(browser);
    browser.wait_until("it is reassigned", &format!("{}.orders?.r1 === 'reassigned from ada'", model_of(MISSIONS[0])));
}

fn cancel_listed(browser: &Browser) {
    let listed = "[...document.querySelectorAll('#missions tbody tr')].map((row) => row.dataset.row).join()";
    fill(browser, "#missions-text", MISSIONS[1]);
    browser.wait_until("the mission of the filter", &format!("{listed} === 'lab-samples-2'"));
    fill(browser, "#missions-text", "");
    fill(browser, "#missions-state", "active");
    browser.wait_until("both missions", &format!("{listed} === 'lab-samples-2,lab-samples-1'"));
    check_access(browser, "the filter of missions");
    browser.value("document.querySelector('#missions-state').focus()");
    tab_to(browser, "#cancel-listed");
    browser.press(ENTER);
    browser.accept();
    for mission in MISSIONS {
        browser.wait_until("it is canceled", &format!("{}.state === 'canceled'", model_of(mission)));
    }
    browser.wait_until(
        "no mission is listed",
        "document.querySelector('#cancel-listed').disabled && document.querySelector('#missions-none').innerText === 'No mission fits the filter.'",
    );
}

fn cancel_by_condition(browser: &Browser) {
    let mission = "lab-samples-3";
    submit(browser, mission);
    browser.value("document.querySelector('#missions-state').focus()");
    tab_to(browser, "#cancel-where");
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        "document.querySelector('#order').open && document.activeElement.name === 'where' && document.querySelector('#order-send').innerText === 'Preview'",
    );
    fill(browser, "#order [name=where]", "mission.priority == 50");
    browser.press(ENTER);
    browser.wait_until(
        "no mission",
        "document.querySelector('#order-summary').innerText === 'No mission meets the condition now.'",
    );
    assert_eq!(browser.text("#order-send"), "Preview", "the mission with this priority has ended");
    fill(browser, "#order [name=where]", r#"mission.id == "lab-samples-3""#);
    browser.press(ENTER);
    browser.wait_until("the preview", "document.querySelector('#order-send').innerText === 'Cancel one mission'");
    let affected = browser.text("#order-affected");
    assert!(affected.starts_with("lab-samples-3, with") && affected.lines().count() == 1, "{affected}");
    check_access(browser, "the preview of a cancellation");
    browser.screenshot("cancel-by-condition");
    browser.press(ENTER);
    browser.wait_until("it is canceled", &format!("{}.state === 'canceled'", model_of(mission)));
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.id === 'cancel-where'",
    );
}
