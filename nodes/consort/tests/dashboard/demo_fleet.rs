//! The fleet of the demo on the page: views, requests, and the loss of the connection.

use crate::browser::{Browser, SOON};
use crate::station::{dashboard_address, wait_for_coordinator};
use crate::support::{Folder, Program, until};
use serde_json::Value;
use std::time::Duration;

/// Limit for a mission.
const MISSION: Duration = Duration::from_secs(180);

/// Key codes of WebDriver.
const TAB: &str = "\u{e004}";
pub(crate) const ENTER: &str = "\u{e007}";
const RIGHT: &str = "\u{e014}";
const DOWN: &str = "\u{e015}";
const HOME: &str = "\u{e011}";
const END: &str = "\u{e010}";

/// Returns the dashboard address that a demo prints.
fn address(demo: &Program) -> String {
    until("the address of the dashboard", SOON, || {
        let output = demo.stdout();
        let events = output.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let url = events
            .filter(|event| event["event"] == "demo_dashboard")
            .find_map(|event| Some(event["url"].as_str()?.to_owned()));
        url.or_else(|| {
            assert!(!demo.stderr().contains("consort:"), "{}", demo.stderr());
            None
        })
    })
}

/// Returns accessibility faults of the page: missing names, captions and landmarks, skipped heading
/// levels, duplicate ids.
const ACCESS: &str = r"(() => {
    const faults = [];
    const seen = (one) => one.checkVisibility() && !one.closest('[hidden], .unseen');
    const name = (one) => (one.getAttribute('aria-label') ?? one.labels?.[0]?.innerText ?? one.innerText ?? '').trim();
    for (const one of document.querySelectorAll('button, a, input, select, [tabindex=\'0\']')) {
        if (seen(one) && !name(one) && !one.getAttribute('aria-labelledby')) faults.push(`no name: ${one.outerHTML.slice(0, 80)}`);
    }
    let level = 0;
    for (const one of document.querySelectorAll('h1, h2, h3, h4')) {
        if (!one.checkVisibility()) continue;
        const now = Number(one.tagName[1]);
        if (now > level + 1) faults.push(`heading ${one.innerText} of level ${now} after level ${level}`);
        level = now;
    }
    for (const one of document.querySelectorAll('table')) if (!one.caption?.textContent) faults.push(`no caption: ${one.id}`);
    for (const tag of ['main', 'header.top', 'h1', '[aria-live]', 'a.skip']) if (!document.querySelector(tag)) faults.push(`no ${tag}`);
    const ids = [...document.querySelectorAll('[id]')].map((one) => one.id);
    for (const [index, id] of ids.entries()) if (ids.indexOf(id) !== index) faults.push(`twice: #${id}`);
    return faults;
})()";

/// Returns texts with less contrast than WCAG 2 (AA) requires.
const CONTRAST: &str = r"(() => {
    const numbers = (colour) => (colour.match(/[\d.]+/g) ?? []).map(Number);
    const light = ([r, g, b]) => [r, g, b].map((c) => c / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
        .reduce((sum, c, index) => sum + c * [0.2126, 0.7152, 0.0722][index], 0);
    const behind = (one) => {
        for (let at = one; at; at = at.parentElement) {
            const [r, g, b, a = 1] = numbers(getComputedStyle(at).backgroundColor);
            if (a > 0) return [r, g, b];
        }
        return [255, 255, 255];
    };
    const faults = new Set();
    for (const one of document.querySelectorAll('body *')) {
        const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
        if (!own || !one.checkVisibility() || one.closest('.unseen, .skip, svg, canvas, option')) continue;
        const style = getComputedStyle(one);
        const [a, b] = [light(numbers(style.color)), light(behind(one))];
        const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        const large = parseFloat(style.fontSize) >= 24;
        if (ratio < (large ? 3 : 4.5)) faults.add(`${ratio.toFixed(2)}: ${one.tagName}.${one.className} ${one.innerText.slice(0, 30)}`);
    }
    return [...faults];
})()";

pub(crate) fn check_access(browser: &Browser, when: &str) {
    for check in [ACCESS, CONTRAST] {
        let faults = browser.value(check);
        assert_eq!(faults.as_array().map(Vec::len), Some(0), "{when}: {faults:#}");
    }
}

/// Presses Tab until an element has the focus, as a keyboard user does.
pub(crate) fn tab_to(browser: &Browser, selector: &str) {
    for _ in 0..80 {
        if browser.value(&format!("document.activeElement.matches({selector:?})")) == true {
            let outline = browser.value("getComputedStyle(document.activeElement).outlineStyle");
            assert_eq!(outline, "solid", "the focus on {selector} is seen");
            return;
        }
        browser.press(TAB);
    }
    panic!("{selector} is not reached by Tab");
}

fn state_of(mission: &str) -> String {
    format!("consort.connection.model.missions[{mission:?}]?.state")
}

#[test]
fn the_demo_is_usable_without_a_mouse() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let demo =
        Program::start(&folder, "demo", &["demo", "--json", "--keep-running", "--missions", "2", "--speed", "6"]);
    browser.open(&address(&demo));
    // A reload of the page would remove this variable.
    browser.value("window.loadedOnce = true");

    // The fleet is visible and a mission runs.
    browser.wait_until("eight robots", "document.querySelectorAll('#robots tbody tr').length >= 8");
    wait_for_coordinator(&browser);
    browser.wait_until("missions", "document.querySelectorAll('#missions tbody tr').length === 2");
    // A nurse in each of 14 rooms, and three people on call for nine robots in each of two roles.
    browser.wait_until("people", "document.querySelectorAll('#people tbody tr').length === 20");
    browser.wait_until(
        "a way ahead",
        "Object.values(consort.connection.model.robots).some((robot) => robot.route.length)",
    );

    // The demo kills the coordinator; the page shows the next coordinator.
    browser.wait_until("a takeover", "consort.connection.model.takeovers.some((one) => one.from)");
    browser.wait_until(
        "the new coordinator",
        "document.querySelector('#coordinator').innerText.startsWith(consort.connection.model.takeovers.at(-1).node)",
    );
    browser.wait_until("takeovers are counted", "/Takeovers\\s*[1-9]/.test(document.querySelector('#kpis').innerText)");
    assert_eq!(browser.value("window.loadedOnce"), true);
    browser.wait_until("tasks on the chart", "document.querySelectorAll('#mission .gantt rect').length >= 5");
    browser.wait_until("the tree", "document.querySelectorAll('#mission .tree li').length >= 11");
    browser.documentation_screenshot("console");
    check_access(&browser, "missions");

    look_at_the_schedule(&browser);

    // Arrow keys change tabs. The auction shows every bid with its parts.
    tab_to(&browser, "#tab-missions");
    browser.press(RIGHT);
    browser.press(RIGHT);
    browser.wait_until("the auction", "document.querySelectorAll('#auction tr.won').length >= 1");
    browser.wait_until("bids with parts", "document.querySelectorAll('#auction .parts tbody tr').length >= 5");
    let auction = browser.text("#auction");
    assert!(auction.contains("lacks") && auction.contains("won"), "{auction}");
    check_access(&browser, "auctions");
    browser.value("document.querySelector('#auction details').open = true");
    browser.documentation_screenshot("auction");
    browser.press(RIGHT);
    browser.wait_until(
        "the reason why a node is no member",
        "document.querySelector('#ensembles').innerText.includes('is false for')",
    );
    check_access(&browser, "ensembles");
    browser.press(RIGHT);
    browser.wait_until("voters and takeovers", "document.querySelectorAll('#coordination table tbody tr').length >= 9");
    check_access(&browser, "coordination");
    browser.screenshot("coordination");
    browser.press(RIGHT);
    browser.wait_until("events", "document.querySelectorAll('#log tbody tr').length > 20");
    browser.click("#log-text");
    browser.press("deposit");
    browser.wait_until(
        "only what was looked for",
        "[...document.querySelectorAll('#log tbody tr')].length > 0 && [...document.querySelectorAll('#log tbody tr')].every((row) => row.innerText.includes('deposit'))",
    );
    check_access(&browser, "log");
    browser.screenshot("log");

    // Both missions complete, and the history lists them.
    browser.wait_until_within(MISSION, "both missions completed", "consort.connection.model.kpis.completed === 2");
    tab_to(&browser, "[role=tab][aria-selected=true]");
    browser.press(END);
    browser.wait_until("the history", "document.querySelectorAll('#history tbody tr').length === 2");
    let table = browser.value("fetch('/api/history.csv').then((answer) => answer.text())");
    let table = table.as_str().expect("text");
    assert_eq!(
        table.lines().filter(|line| line.starts_with("lab-samples-") && line.contains(",completed,")).count(),
        2,
        "{table}"
    );
    check_access(&browser, "history");

    // Meanwhile the new mission must not end by itself.
    order_all(&browser, "hold");
    submit_and_cancel_by_keyboard(&browser);
    order_all(&browser, "release");
    check_dark_and_narrow(&browser);
    assert_eq!(browser.console(), Vec::<String>::new());
    assert_eq!(browser.value("window.loadedOnce"), true);
}

/// Checks the chart of all missions: a bar per role, a single Tab stop, and a table with the same
/// content.
fn look_at_the_schedule(browser: &Browser) {
    tab_to(browser, "#tab-missions");
    browser.press(RIGHT);
    browser.wait_until("four roles", "document.querySelectorAll('#schedule-chart .bar').length >= 4");
    browser.wait_until("the same as a table", "document.querySelectorAll('#schedule tbody tr').length === document.querySelectorAll('#schedule-chart .bar').length");
    browser.wait_until("what was planned", "document.querySelectorAll('#schedule-chart .planned').length >= 4");
    browser.wait_until(
        "a row for each robot",
        "document.querySelectorAll('#schedule-chart text[text-anchor=end]').length >= 8",
    );
    let bars =
        "[...document.querySelectorAll('#schedule-chart .bar')].map((bar) => bar.getAttribute('aria-label')).join()";
    let output = browser.value(bars);
    let output = output.as_str().expect("text");
    assert!(
        output.contains("r1 of lab-samples-1: ")
            && output.contains("r1 of lab-samples-2: ")
            && output.contains(", planned "),
        "{output}"
    );
    check_access(browser, "the schedule");
    browser.documentation_screenshot("schedule");
    tab_to(browser, "#schedule-chart .bar");
    assert_eq!(browser.value("document.querySelectorAll('#schedule-chart .bar[tabindex=\"0\"]').length"), 1);
    browser.press(HOME);
    let first = browser.value("document.activeElement.dataset.key");
    browser.press(DOWN);
    browser.wait_until(
        "another bar has the focus",
        &format!("document.activeElement.matches('.bar') && document.activeElement.dataset.key !== {first}"),
    );
    let chosen = browser.value("document.activeElement.dataset.key.split('#')[0]");
    browser.press(ENTER);
    browser.wait_until("its mission", &format!("document.querySelector('#mission h3').innerText === {chosen}"));
    browser.wait_until(
        "its panel",
        "!document.querySelector('#panel-missions').hidden && document.activeElement.id === 'mission'",
    );
}

/// Holds or releases all robots.
fn order_all(browser: &Browser, order: &str) {
    let (json, robots) = ("'content-type': 'application/json'", r#"{"robots": "all"}"#);
    let sent = format!("fetch('/api/{order}', {{ method: 'POST', headers: {{ {json} }}, body: '{robots}' }})");
    assert_eq!(browser.value(&format!("{sent}.then((answer) => answer.status)")), 200);
}

fn submit_and_cancel_by_keyboard(browser: &Browser) {
    browser.value("document.activeElement.blur()");
    tab_to(browser, "#new-mission");
    browser.press(ENTER);
    browser.wait_until(
        "the form",
        "document.querySelector('#submit').open && document.activeElement.id === 'submit-mission'",
    );
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    check_access(browser, "the form");
    browser.screenshot("form");
    // As in any list, typing the first letters of a name selects it.
    tab_to(browser, "[data-parameter=room]");
    browser.press("PC Room 8");
    tab_to(browser, "#submit-priority");
    browser.press("\u{e009}a\u{e000}5");
    tab_to(browser, "#submit-send");
    browser.press(ENTER);
    browser.wait_until("the form is closed", "!document.querySelector('#submit').open");
    browser.wait_until("the new mission", &state_of("lab-samples-3"));
    browser.wait_until("it is looked at", "document.querySelector('#mission h3').innerText === 'lab-samples-3'");
    assert_eq!(browser.value("consort.connection.model.missions['lab-samples-3'].parameters.room"), "PC Room 8");
    browser.wait_until("its priority", "consort.connection.model.missions['lab-samples-3'].priority === 5");

    tab_to(browser, "#mission .danger");
    browser.press(ENTER);
    browser.accept();
    browser.wait_until("it is canceled", "consort.connection.model.missions['lab-samples-3'].state === 'canceled'");
    browser.wait_until(
        "the page shows it",
        "document.querySelector('#mission').innerText.includes('by the dashboard of demo')",
    );

    // An invalid request is rejected with the error of the coordinator.
    let refused = browser.value(
        "fetch('/api/missions', { method: 'POST', headers: { 'content-type': 'application/json' }, body: '{\"mission\": \"dance\"}' }).then(async (answer) => [answer.status, (await answer.json()).error])",
    );
    assert_eq!(refused[0], 400);
    assert!(refused[1].as_str().expect("words").contains("the fleet has no mission \"dance\""), "{refused}");
    // The console of the browser reports the same rejection.
    let output = browser.console();
    assert!(output.iter().all(|line| line.contains("/api/missions") && line.contains("400")), "{output:#?}");
}

fn check_dark_and_narrow(browser: &Browser) {
    browser.prefers("dark");
    browser.wait_until("dark colours", "document.documentElement.dataset.theme === 'dark'");
    check_access(browser, "in the dark");
    browser.documentation_screenshot("dark");
    browser.click("#theme");
    browser.wait_until("light by the switch", "document.documentElement.dataset.theme === 'light'");
    browser.click("#theme");
    browser.screen(360, 740);
    for tab in ["missions", "schedule", "auctions", "ensembles", "coordination", "log", "calendar", "audit", "history"]
    {
        browser.value(&format!("document.querySelector('#tab-{tab}').click()"));
        browser.wait_until("its panel", &format!("!document.querySelector('#panel-{tab}').hidden"));
        let width = browser.value("document.documentElement.scrollWidth");
        assert_eq!(width, 360, "{tab}: nothing is wider than the phone");
        browser.value("document.querySelector('.tabs').scrollIntoView()");
        browser.screenshot(&format!("phone-{tab}"));
    }
    browser.value("document.querySelector('#tab-missions').click()");
    browser.value("scrollTo(0, 0)");
    browser.wait_until(
        "sharp on this screen",
        "document.querySelector('#map').width === 2 * document.querySelector('#map').clientWidth",
    );
    browser.screenshot("phone");
    check_access(browser, "on a phone");
}

#[test]
fn a_page_shows_the_loss_of_its_node_and_reconnects() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let mut demo = Program::start(&folder, "demo", &["demo", "--json", "--keep-running", "--no-kill", "--speed", "6"]);
    let link = until("where the demo's world listens", SOON, || {
        let output = demo.stdout();
        let (_, rest) = output.split_once("--connect ")?;
        Some(rest.split(['"', ' ', '\n']).next()?.to_owned())
    });
    let station = |name: &str, dashboard: &str| {
        let arguments =
            ["station", "--name", "desk", "--fleet-name", "demo", "--may-vote", "false", "--connect", &link];
        Program::start(&folder, name, &[&arguments[..], &["--dashboard", dashboard]].concat())
    };
    let mut desk = station("desk", "127.0.0.1:0");
    let url = dashboard_address(&mut desk);
    browser.open(&url);
    browser.wait_until("eight robots", "document.querySelectorAll('#robots tbody tr').length === 8");
    browser.wait_until("a mission", "document.querySelectorAll('#missions tbody tr').length === 1");
    browser.wait_until("a live fleet", "document.querySelector('#connection').innerText === 'live'");
    assert_eq!(browser.value("document.querySelector('#banner').hidden"), true);

    // All other nodes are gone: the page shows the last state and its age.
    demo.kill();
    browser.wait_until("a banner", "/^desk is cut off.* ago/s.test(document.querySelector('#banner').innerText)");
    browser.wait_until("grey", "document.body.classList.contains('stale')");
    assert_eq!(browser.value("document.querySelectorAll('#robots tbody tr').length"), 8);
    browser
        .wait_until("ages that grow", "/\\b([6-9]|\\d\\d) s/.test(document.querySelector('#robots tbody').innerText)");
    check_access(&browser, "cut off");
    browser.screenshot("cut-off");

    // The node itself is killed and restarted at its address.
    desk.kill();
    browser.wait_until("the line is down", "document.querySelector('#banner').innerText.includes('interrupted')");
    let address = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
    let _desk = station("desk-again", &address);
    browser.wait_until_within(Duration::from_secs(60), "the line is up", "consort.connection.state === 'open'");
    browser.wait_until("another picture", "Object.keys(consort.connection.model.missions).length === 0");
}
