//! The user closes a place and a lane on the map, sees what that affects, and opens the place and a zone again.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::{ENTER, check_access, tab_to};
use crate::shown_model::ShownModel;
use crate::station::open_ward;
use crate::support::{Fleet, Folder, until};
use consort_protocol::keys::Key;
use serde_json::{Value, json};

const ROOM: &str = "IC Room 6";
/// The only lane to the room.
const LANE: &str = "IC Corridor 6 – IC Room 6";

/// Returns the closures in `view/fleet`.
fn closures_in_view(fleet: &mut Fleet) -> Value {
    fleet.run(&["fleet", "--json"], "station-1").expect(0).json()["fleet"]["closures"].clone()
}

/// Returns the order of a closure in the model of the page.
fn closure(part: &str) -> String {
    format!("consort.connection.model.closures[{part:?}]?.order")
}

/// Returns an expression that is true if the map has a colour of the page at a distance in pixels from a place.
pub(crate) fn is_drawn(colour: &str, place: &str, (right, down): (i32, i32)) -> String {
    format!(
        "(() => {{
            const [map, copy] = [document.querySelector('#map'), document.createElement('canvas')];
            [copy.width, copy.height] = [map.width, map.height];
            const pen = copy.getContext('2d', {{ willReadFrequently: true }});
            const colour = (x, y) => pen.getImageData(x, y, 1, 1).data.join();
            pen.drawImage(map, 0, 0);
            const [x, y] = consort.positionOf({place:?});
            const shown = colour((x + {right}) * devicePixelRatio, (y + {down}) * devicePixelRatio);
            pen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue('--{colour}');
            pen.fillRect(0, 0, 1, 1);
            return shown === colour(0, 0);
        }})()"
    )
}

/// Returns an expression that is true if the map shows that a place is closed.
pub(crate) fn sign(place: &str) -> String {
    is_drawn("bad", place, (0, -7))
}

/// Clicks on a place of the map.
fn click_on_map(browser: &Browser, place: &str) {
    browser.value("document.querySelector('#map').scrollIntoView({ block: 'center' })");
    let at = browser.value(&format!(
        "(({{ left, top }}, [x, y]) => [left + x, top + y])(document.querySelector('#map').getBoundingClientRect(), consort.positionOf({place:?}))"
    ));
    for kind in ["mousePressed", "mouseReleased"] {
        let event = json!({ "type": kind, "x": at[0], "y": at[1], "button": "left", "clickCount": 1 });
        browser.command("Input.dispatchMouseEvent", event);
    }
}

/// Selects a place or lane in the choice; the choice gets the focus.
pub(crate) fn select(browser: &Browser, part: &str) {
    browser.value(&format!(
        "((choice) => {{ choice.value = {part:?}; choice.dispatchEvent(new Event('change')); choice.focus(); }})(document.querySelector('#part'))"
    ));
}

fn open_form(browser: &Browser) {
    tab_to(browser, "#part-orders [data-order=close]");
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        "document.querySelector('#order').open && document.activeElement.id === 'order-reason'",
    );
}

#[test]
fn places_and_lanes_are_closed_and_opened_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    // Slow enough that ada stays on its way to the room.
    let mut fleet = open_ward(&browser, 0.5);
    assert_eq!(browser.value("document.querySelector('#part-orders').disabled"), true, "no place is selected");
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    browser.value(&format!("(document.querySelector('#submit [data-parameter=room]').value = {ROOM:?}, true)"));
    browser.click("#submit-send");
    browser
        .wait_until("the way to the room", &format!("consort.connection.model.robots.ada.route.at(-1) === {ROOM:?}"));
    browser.wait_until("its tasks", "consort.connection.model.missions['lab-samples-1'].tasks !== undefined");

    close_place(&browser, &mut fleet);
    open_place(&browser, &mut fleet);
    open_zone(&browser, &mut fleet);
    close_lane(&browser);
    assert_eq!(browser.console(), Vec::<String>::new());
    fleet.stop();
}

/// The places of a zone are those of its closure.
#[test]
fn a_closed_zone_is_drawn_on_its_places_and_listed_by_its_name() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("zones", |_, _| {});
    let apply = |closures: Value| {
        let view = json!({ "nodes": [], "closures": closures });
        shown.change(|model, now_ms| {
            model.apply_view(&Key::ViewFleet, &view, now_ms);
        });
    };
    let order = json!({ "by": "Nia", "reason": "evacuation", "since_ms": 5, "until_ms": null });
    apply(json!([{ "part": { "zone": { "name": "icu", "places": ["IC Room 5", ROOM] } }, "order": order }]));
    browser.open(&shown.url());
    for place in ["IC Room 5", ROOM] {
        browser.wait_until("the sign on the map", &sign(place));
    }
    assert_eq!(browser.value(&sign("IC Room 4")), false);
    browser.wait_until("the list", "document.querySelector('#closures .rowbutton')?.innerText === 'zone icu'");
    browser.value("document.querySelector('#closures .rowbutton').click()");
    browser.wait_until("its name", "document.querySelector('#part-head').innerText === 'zone icu'");
    assert_eq!(browser.text("#part-state"), "closed by Nia: evacuation");
    check_access(&browser, "a closed zone");
    select(&browser, ROOM);
    browser.wait_until("the place", &format!("document.querySelector('#part-head').innerText === {ROOM:?}"));
    assert_eq!(browser.text("#part-state"), "in the closed zone icu");
    apply(json!([]));
    browser.wait_until("no sign on the map", &format!("!{}", sign(ROOM)));
    assert_eq!(browser.console(), Vec::<String>::new());
}

fn close_place(browser: &Browser, fleet: &mut Fleet) {
    assert_eq!(browser.value(&sign(ROOM)), false, "it is not closed yet");
    click_on_map(browser, ROOM);
    browser.wait_until("it is selected", &format!("document.querySelector('#part').value === {ROOM:?}"));
    check_access(browser, "a selected place");
    open_form(browser);
    assert_eq!(
        browser.text("#order-affected"),
        format!("ada is on its way there, as r1 of lab-samples-1\nlab-samples-1 needs {ROOM}")
    );
    let shown = "['minutes', 'until'].map((field) => document.querySelector(`#order-${field}`).checkVisibility())";
    assert_eq!(browser.value(shown), json!([false, true]));
    check_access(browser, "the form of a closure");
    browser.screenshot("close");
    browser.value("(document.querySelector('#order-by').value = 'Nia', true)");
    browser.press(&format!("wet floor{ENTER}"));
    browser.wait_until("it is closed", &format!("{}?.reason === 'wet floor'", closure(ROOM)));
    browser.wait_until(
        "the focus is where it was",
        "!document.querySelector('#order').open && document.activeElement.dataset.order === 'close'",
    );
    browser.wait_until("the sign on the map", &sign(ROOM));
    browser.wait_until(
        "the list",
        "/^IC Room 6\\s+Nia\\s+wet floor\\s+it is opened$/.test(document.querySelector('#closures tbody').innerText)",
    );
    assert_eq!(browser.text("#part-state"), "closed by Nia: wet floor");
    browser.wait_until(
        "the event",
        "Object.values(consort.connection.model.log).some(({ kind, text }) => kind === 'closure_changed' && text === 'IC Room 6 is closed by Nia: wet floor')",
    );
    check_access(browser, "a closed place");
    browser.screenshot("closed-place");
    let parts = until("the closure in the view", SOON, || {
        closures_in_view(fleet).as_array().filter(|closures| !closures.is_empty()).cloned()
    });
    assert_eq!(parts[0]["part"]["place"], json!(ROOM), "{parts:?}");
}

/// Opens the first closure of the list, without a mouse.
fn open_from_list(browser: &Browser, part: &str) {
    select(browser, "");
    browser.wait_until("nothing is selected", "document.querySelector('#part-orders').disabled");
    // The list may be drawn again while it gets the focus.
    browser.wait_until("the list", "document.querySelector('#closures .rowbutton')?.focus() === undefined && document.activeElement.className === 'rowbutton'");
    browser.press(ENTER);
    browser.wait_until(
        "its orders",
        &format!(
            "document.querySelector('#part-head').innerText === {part:?} && document.activeElement.id === 'part-orders'"
        ),
    );
    tab_to(browser, "#part-orders [data-order=open]");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("it is open", &format!("{} === undefined", closure(part)));
}

fn open_place(browser: &Browser, fleet: &mut Fleet) {
    open_from_list(browser, ROOM);
    browser.wait_until("the focus is where it was", "document.activeElement.dataset.order === 'open'");
    wait_for_no_closure(browser, fleet);
}

/// Opens a zone that a command has closed.
fn open_zone(browser: &Browser, fleet: &mut Fleet) {
    fleet.run(&["close", "icu", "--reason", "evacuation"], "station-1").expect(0);
    browser.wait_until("the sign on the map", &sign(ROOM));
    browser.wait_until("the list", "document.querySelector('#closures .rowbutton')?.innerText === 'zone icu'");
    open_from_list(browser, "zone icu");
    wait_for_no_closure(browser, fleet);
}

fn wait_for_no_closure(browser: &Browser, fleet: &mut Fleet) {
    browser.wait_until("no sign on the map", &format!("!{}", sign(ROOM)));
    browser.wait_until("no list", "!document.querySelector('#closures').checkVisibility()");
    until("no closure in the view", SOON, || (closures_in_view(fleet) == json!([])).then_some(()));
}

/// Closes a lane that is selected in the choice: no robot reaches the place at its end.
fn close_lane(browser: &Browser) {
    select(browser, LANE);
    open_form(browser);
    assert_eq!(
        browser.text("#order-affected"),
        format!(
            "ada is on its way through it, as r1 of lab-samples-1\nlab-samples-1 needs {ROOM}, which no robot reaches any more"
        )
    );
    browser.press(&format!("a door is broken{ENTER}"));
    browser.wait_until("it is closed", &format!("{}?.by === 'Nia'", closure(LANE)));
    browser.wait_until("the list", &format!("document.querySelector('#closures .rowbutton').innerText === {LANE:?}"));
}
