//! The user limits the speed in a zone and on a lane on the map, and clears a limit. A hold of a zone without robots
//! holds none.

use crate::browser::{Browser, SOON};
use crate::closures::{is_drawn, select};
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::mission_orders::fill;
use crate::station::open_station;
use crate::support::{Folder, until};

const LANE: &str = "IC Corridor 6 – IC Room 6";

/// Opens the form of a limit, without a mouse.
fn open_form(browser: &Browser) {
    tab_to(browser, "#part-orders [data-order=limit]");
    browser.press(ENTER);
    browser
        .wait_until("the form", "document.querySelector('#order').open && document.activeElement.name === 'speed_mps'");
}

fn wait_for_selection(browser: &Browser, part: &str) {
    browser.wait_until("it is selected", &format!("document.querySelector('#part-head').innerText === {part:?}"));
}

#[test]
fn speeds_are_limited_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let mut fleet = open_station(&browser);
    for place in ["IC Room 4", "IC Room 5", "IC Room 6"] {
        browser.wait_until("the zone on the map", &is_drawn("zone", place, (9, 9)));
    }
    assert_eq!(browser.value(&is_drawn("zone", "PC Room 2", (9, 9))), false, "it is in no zone");
    browser.wait_until(
        "the zone in the choice",
        "[...document.querySelector('#part').options].at(-1).value === 'zone icu'",
    );

    select(&browser, "zone icu");
    wait_for_selection(&browser, "zone icu");
    hold_no_robot(&browser);
    select(&browser, "zone icu");
    open_form(&browser);
    fill(&browser, "#order [name=speed_mps]", "0.5");
    let effect = browser.text("#order-effect");
    assert!(effect.starts_with("Robots drive at most 0.5 m/s on every lane from and to its places."), "{effect}");
    assert_eq!(browser.text("#order-affected"), "No robot is known that it affects now.");
    check_access(&browser, "the form of a speed limit");
    browser.value("(document.querySelector('#order-by').value = 'Nia', true)");
    tab_to(&browser, "#order-reason");
    browser.press(&format!("wet floor{ENTER}"));
    browser.wait_until("it is limited", "consort.connection.model.speed_limits['zone icu']?.speed_mps === 0.5");
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.dataset.order === 'limit'",
    );
    let sign = is_drawn("warn", "IC Room 5", (15, 22));
    browser.wait_until("the sign on the map", &sign);
    browser.wait_until(
        "the list",
        "/^zone icu\\s+0\\.5 m\\/s\\s+Nia\\s+wet floor\\s+it is cleared$/.test(document.querySelector('#limits tbody').innerText)",
    );
    assert_eq!(browser.text("#part-state"), "limited to 0.5 m/s by Nia: wet floor");
    check_access(&browser, "a speed limit");
    browser.screenshot("speed-limit");
    until("the limit in the view", SOON, || {
        let seen = fleet.run(&["fleet", "--json"], "station-1").expect(0).json();
        (seen["fleet"]["speed_limits"][0]["speed_mps"] == 0.5).then_some(())
    });
    select(&browser, "IC Room 6");
    wait_for_selection(&browser, "IC Room 6");
    assert_eq!(browser.text("#part-state"), "in zone icu, limited to 0.5 m/s");

    clear_from_list(&browser);
    browser.wait_until("no sign on the map", &format!("!{sign}"));
    browser.wait_until("no list", "!document.querySelector('#limits').checkVisibility()");

    select(&browser, LANE);
    wait_for_selection(&browser, LANE);
    open_form(&browser);
    tab_to(&browser, "#order-send");
    browser.press(ENTER);
    browser.wait_until(
        "the lane is limited as the form proposes",
        &format!("consort.connection.model.speed_limits[{LANE:?}]?.speed_mps === 0.3"),
    );
    assert_eq!(browser.console(), Vec::<String>::new());
    fleet.stop();
}

/// The form of a hold proposes the selected zone. No robot is in it.
fn hold_no_robot(browser: &Browser) {
    browser.value("document.querySelector('#hold-group').focus()");
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        "document.querySelector('#order').open && document.querySelector('#order [name=zone]').value === 'icu'",
    );
    assert_eq!(browser.value("document.querySelector('#order [name=where]').checkVisibility()"), false);
    tab_to(browser, "#order-send");
    browser.press(ENTER);
    browser.wait_until(
        "the preview",
        "document.querySelector('#order-summary').innerText === 'No robot is in zone icu now.' && document.querySelector('#order-send').innerText === 'Preview'",
    );
    browser.click("#order-close");
}

/// Clears the only limit of the list, without a mouse.
fn clear_from_list(browser: &Browser) {
    browser.value("document.querySelector('#limits .rowbutton').focus()");
    browser.press(ENTER);
    wait_for_selection(browser, "zone icu");
    browser.wait_until("its orders", "document.activeElement.id === 'part-orders'");
    tab_to(browser, "#part-orders [data-order=clear]");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("it is cleared", "consort.connection.model.speed_limits['zone icu'] === undefined");
}
