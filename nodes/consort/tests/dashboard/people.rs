//! The page for people: requests of a mission, answers at the same time, and a serving node that dies
//! between the press and the answer.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::{ENTER, check_access};
use crate::support::{Fleet, Folder, example, free_port, until};
use serde_json::{Value, json};
use toml::Table;

/// A doctor measures twice. The world has no simulated doctor, who would answer.
const MISSION: &str = r"
mission: by-hand
roles: { doctor: { kind: unmanaged }, r1: { kind: managed, on_loss: restart } }
root:
  task: all
  method: sequential
  tasks:
    - { task: come, type: navigation, roles: [r1], parameters: { to: Dock } }
    - { task: measure, type: measure_vital_signs, roles: [doctor], escalate: { to: head_nurse, after_s: 1 } }
    - { task: stay, type: wait, roles: [r1], parameters: { seconds: '1' } }
    - { task: measure_again, type: measure_vital_signs, roles: [doctor] }
result: { first: measure.pulse_bpm, second: measure_again.pulse_bpm }
";

fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

/// Fills the form of the first open request with a pulse. Expects that the page shows it.
fn fill(page: &str, pulse: u32) -> String {
    format!(
        "(() => {{ const card = {page}.querySelector('#open form'); for (const [name, value] of \
         [['pulse_bpm', {pulse}], ['temperature_c', 36.6], ['oxygen_percent', 98]]) \
         card.querySelector(`[data-result=${{name}}]`).value = value; return true; }})()"
    )
}

const DONE: &str = "querySelector('#open form .primary').click()";

fn requests(fleet: &mut Fleet, more: &[&str]) -> Vec<Value> {
    let ran = fleet.run(&[&["requests", "--json"], more].concat(), "station-2").expect(0).stdout;
    let view: Value = serde_json::from_str(&ran).unwrap_or_else(|problem| panic!("{problem}: {ran}"));
    view["requests"].as_array().cloned().unwrap_or_default()
}

#[test]
fn people_answer_requests_whichever_node_dies() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let ports = [free_port(), free_port()];
    let pages = ports.map(|port| format!("http://127.0.0.1:{port}"));
    let mut fleet = Fleet::new(&with(example("fleet"), "dashboards", pages.to_vec()));
    for (name, port, neighbours) in [("station-1", ports[0], &[][..]), ("station-2", ports[1], &["station-1"])] {
        let station = with(example("station"), "name", name);
        fleet.start("station", with(station, "dashboard", format!("127.0.0.1:{port}")), neighbours);
    }
    fleet.start("world", example("world"), &["station-1", "station-2"]);
    let robot = with(example("robot"), "skills", vec!["navigation", "operate_drawer", "wait"]);
    fleet.start("robot", robot, &["station-1", "station-2", "world"]);
    fleet.start("robot", example("arm"), &["station-1", "station-2", "world"]);
    let mission = folder.write("by-hand.yaml", MISSION).display().to_string();
    fleet.run(&["submit", &mission, "--by", "Nia"], "station-2").expect(0);

    browser.screen(390, 844); // a phone
    browser.open(&format!("{}/me", pages[0]));
    browser.wait_until("the request", "document.querySelectorAll('#open form').length === 1");
    let card = browser.text("#open form");
    assert!(card.starts_with("measure") && card.contains("doctor – by-hand-1"), "{card}");
    check_access(&browser, "an open request");
    browser.screenshot("request");
    let small = "[...document.querySelectorAll('main button, main input, main select')].filter((control) => \
                 control.checkVisibility() && control.getBoundingClientRect().height < 44).map((control) => control.id)";
    assert_eq!(browser.value(small), json!([]), "controls that are too small for a thumb");
    // The request is escalated to people with another role.
    let choose = |role: &str| {
        let set = format!(
            "(document.querySelector('#role').value = '{role}', document.querySelector('#role').oninput(), true)"
        );
        browser.value(&set);
    };
    choose("head_nurse");
    browser.wait_until(
        "the escalation",
        "/Escalated to head nurse/.test(document.querySelector('#open form')?.innerText)",
    );
    assert_eq!(requests(&mut fleet, &["--role", "head_nurse"]).len(), 1, "the command shows it, too");
    choose("");
    // Without a name nothing is sent.
    browser.value(&fill("document", 60));
    browser.value(&format!("document.{DONE}"));
    browser.wait_until("what is missing", "/Say who you are/.test(document.querySelector('#announce').innerText)");
    assert_eq!(browser.value("document.activeElement.id"), "name");
    browser.press("Nia");

    // Two tabs answer at the same time: a single answer counts, and the other tab says so.
    browser.value("(window.other = window.open('/me'), true)");
    let other = "window.other.document";
    browser.wait_until("the other tab", &format!("{other}.querySelectorAll('#open form').length === 1"));
    assert_eq!(browser.value(&format!("{other}.querySelector('#name').value")), "Nia", "the browser remembers her");
    browser.value(&format!("({other}.querySelector('#name').value = 'Ria', true)"));
    browser.value(&fill(other, 66));
    browser.value(&format!("(document.{DONE}, {other}.{DONE}, true)"));
    let told = format!(
        "[document, {other}].map((tab) => tab.querySelector('#announce').innerText).filter((text) => \
         /Thank you/.test(text) || /is closed; it was answered by .*: done/.test(text)).length === 2"
    );
    browser.wait_until("both are told", &told);
    let winners = format!(
        "[document, {other}].filter((tab) => /Thank you/.test(tab.querySelector('#announce').innerText)).length"
    );
    assert_eq!(browser.value(&winners), 1, "one answer counts");
    let closed = requests(&mut fleet, &["--all"]).into_iter().find(|request| request["task"] == "measure");
    let by = closed.expect("the first request")["phase"]["answered"]["by"].as_str().expect("a name").to_owned();

    // The serving node dies between the press and the answer. The page says so, and where to go on.
    browser.wait_until("the next request", "/measure again/.test(document.querySelector('#open form')?.innerText)");
    browser.value(&fill("document", 77));
    fleet.kill("station-1");
    browser.value(&format!("(document.{DONE}, true)"));
    browser.wait_until("that the connection is lost", "!document.querySelector('#banner').hidden");
    assert!(browser.text("#banner").contains("Your answers are not sent"), "{}", browser.text("#banner"));
    assert_eq!(browser.text("#elsewhere a"), format!("Go on at {}", pages[1]));
    browser.screenshot("request-connection-lost");
    let link = browser.value("document.querySelector('#elsewhere a').href");
    browser.open(link.as_str().expect("an address"));
    browser.wait_until("the request at the other node", "document.querySelectorAll('#open form').length === 1");
    browser.value("(document.querySelector('#name').value = 'Nia', document.querySelector('#name').oninput(), true)");
    browser.value(&fill("document", 88));
    browser.value(&format!("(document.{DONE}, true)"));
    browser.wait_until("it counts", "/Thank you/.test(document.querySelector('#announce').innerText)");
    browser.wait_until("her mission", "/by-hand-1: completed/.test(document.querySelector('#mine').innerText)");
    browser.screenshot("request-answered");
    let answer = fleet.run(&["missions", "--json"], "station-2").expect(0).stdout;
    let missions: Value = serde_json::from_str(&answer).expect("JSON");
    let first = if by == "Nia" { 60 } else { 66 };
    assert_eq!(missions["missions"][0]["result"], json!({ "first": first, "second": 88 }), "{answer}");
    assert_eq!(missions["missions"][0]["by"], "Nia", "{answer}");
    assert_eq!(requests(&mut fleet, &[]), [] as [Value; 0], "nothing is open");

    // A call for a robot, with the keyboard alone.
    browser.value("(document.querySelector('#call-send').focus(), true)");
    browser.press(ENTER);
    browser.wait_until("it is acknowledged", "/is acknowledged/.test(document.querySelector('#announce').innerText)");

    // The same from a shell.
    fleet.run(&["submit", &mission], "station-2").expect(0);
    let open = until("another request", SOON, || requests(&mut fleet, &["--role", "doctor"]).into_iter().next());
    let id = open["request"].as_str().expect("an id").to_owned();
    let refused = fleet.run(&["answer", &id, "--done", "--set", "pulse_bpm=fast"], "station-2").expect(2).stderr;
    assert!(refused.contains("pulse_bpm must be a whole number from 0 to 300"), "{refused}");
    let refused = fleet.run(&["answer", &id, "--done", "--set", "pulse_bpm=70"], "station-2").expect(1).stderr;
    assert!(refused.contains("is missing; it is a"), "{refused}");
    let words = ["answer", &id, "--later", "15m", "--by", "Ria"];
    assert_eq!(fleet.run(&words, "station-2").expect(0).stdout, format!("{id} put off by Ria\n"));
    let words = ["answer", &id, "--cannot", "--note", "no cuff", "--by", "Ria"];
    assert_eq!(fleet.run(&words, "station-2").expect(0).stdout, format!("{id} answered by Ria: cannot\n"));
    let refused = fleet.run(&["answer", &id, "--declined", "--by", "Nia"], "station-2").expect(1).stderr;
    assert!(refused.contains(&format!("request {id} is closed; it was answered by Ria: cannot")), "{refused}");
    fleet.stop();
}
