//! The dashboard of a closed fleet: a person shows a token, sees and may do what that is good for, and is asked again when it
//! has ended.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::{ENTER, check_access};
use crate::support::{Closed, Folder, example, until};
use std::time::Duration;

/// How long the brief token is good: long enough to be typed and looked at on a slow machine.
const BRIEF: Duration = Duration::from_secs(25);

#[test]
fn a_closed_fleet_is_shown_to_whoever_has_a_token_for_as_long_as_that_is_good() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let mut closed = Closed::new();
    let mut station = example("station");
    station.insert("dashboard".to_owned(), "127.0.0.1:0".into());
    closed.start("station", station, &[]);
    closed.start_others();
    let url = until("the address of the dashboard", SOON, || {
        let said = closed.fleet.node("station-1").stdout();
        Some(said.lines().find_map(|line| line.strip_prefix("dashboard: "))?.to_owned())
    });
    browser.open(&url);
    browser.wait_until("it asks for a token", "document.querySelector('#admission').open");
    assert!(browser.text("#admission-why").contains("this fleet is closed"), "{}", browser.text("#admission"));
    assert_eq!(browser.value("consort.line.picture"), serde_json::Value::Null, "nothing is shown before");
    check_access(&browser, "it asks for a token");
    browser.screenshot("admission");
    browser.press("abc");
    browser.press(ENTER);
    browser
        .wait_until("what is wrong", "/it is no token/.test(document.querySelector('#admission-problem').innerText)");
    // What was typed stays, to be mended.
    browser.value("document.querySelector('#admission-token').value = ''");
    let brief = closed.token("read", &["--for", &format!("{}s", BRIEF.as_secs())]);
    browser.press(&brief);
    browser.press(ENTER);
    browser.wait_until("the robots", "document.querySelectorAll('#robots tbody tr').length === 2");
    assert_eq!(browser.text("#sign-out"), "Sign out read");
    assert_eq!(
        browser.value("document.querySelector('#new-mission').checkVisibility()"),
        false,
        "who reads asks for none"
    );
    assert_eq!(browser.value("document.cookie"), "", "no script reads the token");

    // It ends, and so does what is shown; a link brings the next one, which is good for more.
    browser.wait_until_within(BRIEF * 4, "it asks anew", "document.querySelector('#admission').open");
    let link = closed.token("submit", &["--link", &url]);
    browser.open("about:blank");
    browser.open(&link);
    browser.wait_until("the robots again", "document.querySelectorAll('#robots tbody tr').length === 2");
    assert_eq!(browser.value("location.hash"), "", "the token is not left in the address");
    browser.wait_until("who it is", "document.querySelector('#sign-out').innerText === 'Sign out submit'");
    browser.wait_until("who coordinates", "/term \\d/.test(document.querySelector('#coordinator').innerText)");
    browser.click("#new-mission");
    browser.wait_until("its parameters", "document.querySelectorAll('[data-parameter]').length === 2");
    browser.click("#order-send");
    browser.wait_until("it is acknowledged", "consort.line.picture.missions['lab-samples-1'] !== undefined");

    browser.click("#sign-out");
    browser.wait_until("it asks after that", "document.querySelector('#admission').open");
    closed.fleet.stop();
}
