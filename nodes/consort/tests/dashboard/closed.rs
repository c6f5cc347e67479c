//! The dashboard of a closed fleet: a user signs in with a token, has the permissions of the token,
//! and must sign in again after it has expired.

use crate::browser::Browser;
use crate::demo_fleet::{ENTER, check_access};
use crate::station::{dashboard_address, station_with_dashboard, wait_for_coordinator};
use crate::support::{Closed, Folder};
use std::time::Duration;

/// Lifetime of the brief token: long enough to check the page on a slow machine.
const BRIEF: Duration = Duration::from_secs(25);

/// Starts a closed fleet. Returns it with the address of its dashboard.
pub(crate) fn start_with_dashboard() -> (Closed, String) {
    let mut closed = Closed::new();
    closed.start("station", station_with_dashboard(), &[]);
    closed.start_others();
    let url = dashboard_address(closed.fleet.node("station-1"));
    (closed, url)
}

#[test]
fn a_closed_dashboard_requires_a_valid_token() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let (mut closed, url) = start_with_dashboard();
    browser.open(&url);
    browser.wait_until("the sign-in dialog", "document.querySelector('#admission').open");
    assert!(browser.text("#admission-reason").contains("this fleet is closed"), "{}", browser.text("#admission"));
    assert_eq!(browser.value("consort.connection.model"), serde_json::Value::Null, "nothing is shown before");
    check_access(&browser, "the sign-in dialog");
    browser.screenshot("admission");
    browser.press("abc");
    browser.press(ENTER);
    browser
        .wait_until("what is wrong", "/malformed token/.test(document.querySelector('#admission-problem').innerText)");
    // The typed text remains for corrections.
    // The token is pasted: on a slow machine, it would expire while hundreds of keys are pressed.
    let brief = closed.token("read", &["--for", &format!("{}s", BRIEF.as_secs())]);
    browser.value(&format!("document.querySelector('#admission-token').value = {}", serde_json::json!(brief)));
    browser.press(ENTER);
    browser.wait_until("the robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    assert_eq!(browser.text("#sign-out"), "Sign out read");
    assert_eq!(
        browser.value("document.querySelector('#new-mission').checkVisibility()"),
        false,
        "the read scope permits no submission"
    );
    let orders = "['#hold-all', '#hold-group', '#robot-orders', '#part-orders', '#raise-alarm', '#cancel-listed', '#cancel-where'].some((one) => document.querySelector(one).checkVisibility())";
    assert_eq!(browser.value(orders), false, "the read scope permits no orders");
    assert_eq!(browser.value("document.cookie"), "", "no script reads the token");

    // After the token expires, the page shows nothing; a link contains the next token, which
    // permits more.
    browser.wait_until_within(
        BRIEF * 4,
        "the sign-in dialog after expiry",
        "document.querySelector('#admission').open",
    );
    let link = closed.token("submit", &["--link", &url]);
    browser.open("about:blank");
    browser.open(&link);
    browser.wait_until("the robots again", "document.querySelectorAll('#robots tbody tr').length === 2");
    assert_eq!(browser.value("location.hash"), "", "the token is not left in the address");
    browser.wait_until("the name of the user", "document.querySelector('#sign-out').innerText === 'Sign out submit'");
    wait_for_coordinator(&browser);
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    browser.click("#submit-send");
    browser.wait_until("it is acknowledged", "consort.connection.model.missions['lab-samples-1'] !== undefined");

    browser.click("#sign-out");
    browser.wait_until("the sign-in dialog after signing out", "document.querySelector('#admission').open");
    closed.fleet.stop();
}
