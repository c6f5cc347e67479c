//! The user holds robots on the page, releases them, takes one out of service, and sees who ordered it.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::mission_orders::fill;
use crate::station::open_ward;
use crate::support::{Fleet, Folder, until};
use serde_json::{Value, json};

/// Orders to ada in the model of the page.
const ORDERS: &str = "consort.connection.model.robots.ada.orders";

/// Returns the orders to ada in `view/fleet`.
fn orders_in_view(fleet: &mut Fleet) -> Value {
    let seen = fleet.run(&["fleet", "--json"], "station-1").expect(0).json();
    let nodes = seen["fleet"]["nodes"].as_array().expect("nodes");
    nodes.iter().find(|node| node["node"] == "ada").expect("ada")["orders"].clone()
}

fn press_order(browser: &Browser, order: &str) {
    tab_to(browser, &format!("#robot-orders [data-order={order}]"));
    browser.press(ENTER);
}

fn wait_for_form(browser: &Browser) {
    browser.wait_until(
        "the form",
        "document.querySelector('#order').open && document.activeElement.id === 'order-reason'",
    );
}

#[test]
fn robots_are_held_and_released_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    // Slow enough that the mission does not end meanwhile.
    let mut fleet = open_ward(&browser, 2.0);
    assert_eq!(browser.value("document.querySelector('#robot-orders').disabled"), true, "no robot is selected");
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    browser.click("#submit-send");
    browser.wait_until("the role of ada", "consort.connection.model.robots.ada.mission === 'lab-samples-1'");

    hold_and_release(&browser, &mut fleet);
    maintain(&browser);
    hold_and_release_all(&browser);
    read_audit_trail(&browser);
    hold_and_release_group(&browser);
    assert_eq!(browser.console(), Vec::<String>::new());
    fleet.stop();
}

fn hold_and_release(browser: &Browser, fleet: &mut Fleet) {
    // A user without a mouse continues at the orders of the selected robot.
    browser.value("document.querySelector('#robots tr[data-row=ada] .rowbutton').focus()");
    browser.press(ENTER);
    browser.wait_until(
        "its orders",
        "document.querySelector('#robot-head').innerText === 'ada' && document.activeElement.id === 'robot-orders'",
    );
    browser.wait_until("its role", "/ of lab-samples-1$/.test(document.querySelector('#robot-state').innerText)");
    press_order(browser, "hold");
    wait_for_form(browser);
    let roles = browser.text("#order-affected");
    assert!(roles.starts_with("ada: ") && roles.ends_with(" of lab-samples-1 waits"), "{roles}");
    assert_eq!(browser.value("document.querySelector('#order-until').checkVisibility()"), false);
    check_access(browser, "the form of a hold");
    browser.screenshot("hold");
    browser.value(
        "(document.querySelector('#order-minutes').value = '30', document.querySelector('#order-by').value = 'Nia', true)",
    );
    browser.press(&format!("wet floor{ENTER}"));
    browser.wait_until("it is held", &format!("{ORDERS}?.hold?.by === 'Nia'"));
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.dataset.order === 'hold'",
    );
    browser.wait_until(
        "the page shows it",
        "/held by Nia until .*: wet floor$/.test(document.querySelector('#robot-state').innerText) && /held: .* of lab-samples-1/.test(document.querySelector('#robots tr[data-row=ada]').innerText)",
    );
    check_access(browser, "a held robot");
    let hold = until("it is held in the view", SOON, || {
        let hold = orders_in_view(fleet)["hold"].clone();
        (!hold.is_null()).then_some(hold)
    });
    assert_eq!((&hold["by"], &hold["reason"]), (&json!("Nia"), &json!("wet floor")));
    let lasts_ms = hold["until_ms"].as_u64().zip(hold["since_ms"].as_u64()).map(|(until, since)| until - since);
    assert!(lasts_ms.is_some_and(|ms| (1_700_000..=1_800_000).contains(&ms)), "half an hour: {hold}");

    press_order(browser, "release");
    browser.accept();
    browser.wait_until("it is released", &format!("{ORDERS} === undefined"));
    browser.wait_until("the focus is where it was", "document.activeElement.dataset.order === 'release'");
    until("it is released in the view", SOON, || orders_in_view(fleet)["hold"].is_null().then_some(()));
    browser.wait_until("its role goes on", "consort.connection.model.robots.ada.availability === 'holding'");
}

fn maintain(browser: &Browser) {
    press_order(browser, "maintenance");
    wait_for_form(browser);
    let shown = "['minutes', 'until'].map((field) => document.querySelector(`#order-${field}`).checkVisibility())";
    assert_eq!(browser.value(shown), json!([false, true]));
    // Without a reason the form sends nothing.
    browser.press(ENTER);
    assert_eq!(browser.value("document.querySelector('#order').open"), true);
    check_access(browser, "the form of maintenance");
    browser.press("new tyres");
    // The node does not reply at first. The browser moves the focus from a disabled button when it draws the page.
    let silent = "() => new Promise((_, reject) => setTimeout(reject, 300))";
    browser.value(&format!("(window.kept = window.fetch, window.fetch = {silent}, true)"));
    tab_to(browser, "#order-send");
    browser.press(ENTER);
    browser.wait_until(
        "the problem, and the focus where it was",
        "!document.querySelector('#order-problem').hidden && document.activeElement.id === 'order-send'",
    );
    browser.value("(window.fetch = window.kept, true)");
    browser.press(ENTER);
    browser.wait_until("its maintenance", &format!("{ORDERS}?.maintenance?.reason === 'new tyres'"));
    press_order(browser, "end");
    browser.accept();
    browser.wait_until("the end of its maintenance", &format!("{ORDERS} === undefined"));
}

fn hold_and_release_all(browser: &Browser) {
    let are = |condition: &str| {
        format!("Object.values(consort.connection.model.robots).every(({{ orders }}) => {condition})")
    };
    browser.click("#hold-all");
    wait_for_form(browser);
    browser.press(&format!("drill{ENTER}"));
    browser.wait_until("both are held", &are("orders?.hold?.reason === 'drill'"));
    browser.value("document.querySelector('#release-all').focus()");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("both are released", &are("orders === undefined"));
}

fn read_audit_trail(browser: &Browser) {
    let row = |number: usize, pattern: &str| {
        format!("/{pattern}/.test(document.querySelectorAll('#audit tbody tr')[{number}].innerText)")
    };
    browser.click("#tab-audit");
    browser.wait_until("the latest change first", &row(0, "the dashboard of station-1\\s+release\\s+ada, lab-arm"));
    browser.click("#audit-person");
    browser.press("nia");
    browser.wait_until("her changes alone", "document.querySelectorAll('#audit tbody tr').length === 3");
    for (number, pattern) in [
        (0, "Nia\\s+hold\\s+ada, lab-arm\\s+for \\d+ s: drill"),
        (1, "Nia\\s+begin maintenance\\s+ada\\s+new tyres"),
        (2, "Nia\\s+hold\\s+ada\\s+for \\d+ s: wet floor"),
    ] {
        browser.wait_until("her change", &row(number, pattern));
    }
    check_access(browser, "the audit trail");
    browser.screenshot("audit");
    let lines = browser.value("fetch('/api/audit.jsonl').then((answer) => answer.text())");
    let lines = lines.as_str().expect("text").lines();
    let entries: Vec<Value> = lines.map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let hers: Vec<&Value> = entries.iter().filter(|entry| entry["by"] == "Nia").map(|entry| &entry["action"]).collect();
    assert_eq!(hers, [&json!("hold"), &json!("begin_maintenance"), &json!("hold")], "{entries:#?}");
}

/// Opens the form of an order to a group, without a mouse, and enters a condition. The focus is in its field.
fn enter_condition(browser: &Browser, button: &str, condition: &str) {
    browser.value(&format!("document.querySelector({button:?}).focus()"));
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        "document.querySelector('#order').open && document.activeElement.name === 'zone' && document.querySelector('#order-send').innerText === 'Preview'",
    );
    fill(browser, "#order [name=zone]", "");
    tab_to(browser, "#order [name=where]");
    fill(browser, "#order [name=where]", condition);
}

fn hold_and_release_group(browser: &Browser) {
    enter_condition(browser, "#hold-group", "robot.wheels > 3");
    browser.press(ENTER);
    browser.wait_until(
        "the problem",
        "/has no field `wheels`/.test(document.querySelector('#order-problem').innerText) && document.querySelector('#order-send').innerText === 'Preview'",
    );
    let logged = until("the refusal in the log of the browser", SOON, || {
        let logged = browser.console();
        (!logged.is_empty()).then_some(logged)
    });
    assert!(logged.iter().all(|line| line.contains("/api/robots/select")), "{logged:#?}");
    fill(browser, "#order [name=where]", r#"robot.name == "ada""#);
    browser.press(ENTER);
    browser.wait_until("the preview", "document.querySelector('#order-send').innerText === 'Hold one robot'");
    let affected = browser.text("#order-affected");
    assert!(affected.starts_with("ada") && affected.lines().count() == 1, "{affected}");
    assert_eq!(browser.text("#order-summary"), "Selected now: one robot.");
    check_access(browser, "the preview of a hold");
    browser.screenshot("hold-group");
    fill(browser, "#order [name=where]", "robot.battery >= 0.0");
    assert_eq!(browser.text("#order-send"), "Preview", "another condition needs another preview");
    fill(browser, "#order [name=where]", r#"robot.name == "ada""#);
    browser.press(ENTER);
    browser.wait_until("the preview again", "document.querySelector('#order-send').innerText === 'Hold one robot'");
    browser.press(ENTER);
    browser.wait_until("it is held", &format!("{ORDERS}?.hold?.by === 'Nia'"));
    assert_eq!(browser.value("consort.connection.model.robots['lab-arm'].orders === undefined"), true);
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.id === 'hold-group'",
    );

    enter_condition(browser, "#release-group", r#"robot.name == "ada""#);
    browser.press(ENTER);
    browser.wait_until("the preview", "document.querySelector('#order-send').innerText === 'Release one robot'");
    browser.press(ENTER);
    browser.wait_until("it is released", &format!("{ORDERS} === undefined"));
}
