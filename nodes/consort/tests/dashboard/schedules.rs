//! Schedules on the page: the user adds one with the form, pauses, resumes and removes it.

use crate::browser::Browser;
use crate::demo_fleet::{ENTER, check_access};
use crate::station::open_station;
use crate::support::Folder;
use std::time::Duration;

/// Limit for an occurrence of a schedule with occurrences every minute.
const OCCURRENCE: Duration = Duration::from_secs(120);

#[test]
fn schedules_are_changed_on_the_page() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let fleet = open_station(&browser);
    browser.click("#tab-calendar");
    browser.wait_until("no schedule", "document.querySelector('#schedules-none').checkVisibility()");

    // A mistake is named, and the form stays as it was.
    browser.click("#new-schedule");
    browser.wait_until(
        "its parameters",
        "document.querySelectorAll('#add-schedule [data-parameter]').length === 2 && document.activeElement.id === 'add-schedule-name'",
    );
    check_access(&browser, "the form of a schedule");
    let set = |selector: &str, value: &str| {
        browser.value(&format!("(document.querySelector({selector:?}).value = {value:?}, true)"));
    };
    browser.press("rounds");
    set("#add-schedule-cron", "61 8 * * *");
    set("#add-schedule-zone", "Europe/Berlin");
    set("#add-schedule [data-parameter=room]", "IC Room 6");
    browser.click("#add-schedule-send");
    browser.wait_until(
        "what is wrong",
        "document.querySelector('#add-schedule-problem').innerText.startsWith('cron is \"61 8 * * *\"')",
    );
    set("#add-schedule-cron", "0 8 * * *");
    browser.click("#add-schedule-send");
    browser.wait_until("the form is closed", "!document.querySelector('#add-schedule').open");
    browser.wait_until(
        "the schedule",
        "/^rounds\\s+lab-samples\\s+0 8 \\* \\* \\*\\s+Europe\\/Berlin\\s+active/.test(document.querySelector('#schedules tbody').innerText)",
    );
    browser.wait_until(
        "an occurrence on each of seven days",
        "document.querySelectorAll('#calendar section').length === 7 && [...document.querySelectorAll('#calendar li')].every((item) => item.innerText === '08:00 rounds')",
    );
    check_access(&browser, "a schedule");
    browser.screenshot("calendar");

    let act = |action: &str| {
        browser.value(&format!("document.querySelector('#schedules [data-action={action}]').focus()"));
        browser.press(ENTER);
        browser.accept();
    };
    act("pause");
    browser.wait_until(
        "who paused it",
        "/paused\\s+by the dashboard of station-1/.test(document.querySelector('#schedules tbody').innerText)",
    );
    browser.wait_until("no occurrences", "document.querySelector('#calendar-none').checkVisibility()");
    check_access(&browser, "a paused schedule");
    act("resume");
    browser.wait_until("it is resumed", "document.querySelectorAll('#calendar section').length === 7");
    act("remove");
    browser.wait_until("it is removed", "document.querySelector('#schedules-none').checkVisibility()");

    // A program adds a schedule with the same request; the table leads to its last mission.
    let request = r#"{"action": "add", "cron": "* * * * *", "submit": {"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}}"#;
    let added = browser.value(&format!(
        "fetch('/api/schedules/minutes', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, body: {request:?} }}).then((answer) => answer.status)",
    ));
    assert_eq!(added, 200);
    browser.wait_until("a bounded calendar", "document.querySelectorAll('#calendar li').length === 20");
    browser.wait_until_within(
        OCCURRENCE,
        "its last mission",
        "document.querySelector('#schedules .rowbutton').innerText === 'lab-samples-1'",
    );
    browser.value("document.querySelector('#schedules .rowbutton').focus()");
    browser.press(ENTER);
    browser.wait_until("the mission", "/^lab-samples-\\d/.test(document.querySelector('#mission h3').innerText)");

    // The console of the browser reports the rejection of the mistake.
    let output = browser.console();
    assert!(output.iter().all(|line| line.contains("/api/schedules/rounds") && line.contains("400")), "{output:#?}");
    fleet.stop();
}
