//! The page for people: requests of a mission, answers at the same time, and a serving node that dies
//! between the press and the answer.

use crate::browser::{Browser, SOON};
use crate::closed::start_with_dashboard;
use crate::demo_fleet::{ENTER, check_access};
use crate::station::with;
use crate::support::{Closed, Fleet, Folder, example, free_port, until};
use serde_json::{Value, json};

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

/// A doctor signs, once a robot is there.
const SIGN: &str = r"
mission: signature
roles: { doctor: { kind: unmanaged }, r1: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - { task: come, type: navigation, roles: [r1], parameters: { to: Dock } }
    - { task: sign, type: attend, roles: [doctor], parameters: { at: Dock } }
";

/// Alerts of each level, one after the other.
const ALERTS: &str = r"
mission: alerts
roles: { doctor: { kind: unmanaged }, r1: { kind: managed } }
root:
  task: all
  method: sequential
  tasks:
    - { task: come, type: navigation, roles: [r1], parameters: { to: Dock } }
    - { task: tell, type: alert, roles: [doctor], parameters: { message: it is here, level: info, at: Dock } }
    - { task: warn, type: alert, roles: [doctor], parameters: { message: it stands, level: warning, at: Dock } }
    - { task: call, type: alert, roles: [doctor], parameters: { message: it is hot, level: urgent, at: Dock } }
";

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
    let shown = fleet.run(&["missions", "by-hand-1"], "station-2").expect(0).stdout;
    let task = shown.lines().find(|line| line.trim_start().starts_with("measure_again ")).expect("its task");
    assert!(task.contains("done") && task.contains("pulse_bpm=88"), "{shown}");
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

    // The dashboard shows the results of the tasks, also that of the last.
    browser.open(&pages[1]);
    let button =
        "[...document.querySelectorAll('#missions .rowbutton')].find((one) => one.textContent === 'by-hand-1')";
    browser.wait_until("the mission", &format!("{button} !== undefined"));
    browser.value(&format!("({button}.click(), true)"));
    let results =
        |pulse: u32| format!("/pulse bpm: {pulse}/.test(document.querySelector('#mission .tree')?.textContent)");
    for pulse in [first, 88] {
        browser.wait_until("the results of the tasks", &results(pulse));
    }
    fleet.stop();
}

#[test]
fn a_person_signs_in_with_a_token_and_answers() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let (mut closed, url) = start_with_dashboard();
    closed.cert(&["person", "lee", "--scope", "submit", "--missions", "vital-signs"]);
    let certs = closed.of("submit").display().to_string();
    let mission = folder.write("signature.yaml", SIGN).display().to_string();
    closed.fleet.run(&["submit", &mission, "--certs", &certs], "station-1").expect(0);

    browser.screen(390, 844);
    browser.open(&format!("{}/me", url.trim_end_matches('/')));
    browser.wait_until("the sign-in dialog", "document.querySelector('#admission').open");
    assert!(browser.text("#admission-reason").contains("this fleet is closed"), "{}", browser.text("#admission"));
    let sign_in = |token: &str| {
        browser.value(&format!("(document.querySelector('#admission-token').value = {token:?}, true)"));
        browser.click("#admission-send");
    };
    // The token of another authority.
    let mut other = Closed::new();
    sign_in(&other.token("submit", &[]));
    let problem = "document.querySelector('#admission-problem').innerText";
    browser.wait_until("what is wrong", &format!("/invalid certificate in the token/.test({problem})"));
    assert_eq!(
        browser.value("[document.querySelector('#admission').open, document.querySelectorAll('#open form').length]"),
        json!([true, 0]),
        "nothing is shown"
    );

    sign_in(&closed.token("lee", &[]));
    browser.wait_until("the request", "/^sign\\b/.test(document.querySelector('#open form')?.innerText)");
    assert_eq!(browser.value("document.querySelector('#admission').open"), false);
    let name = "[document.querySelector('#name').value, document.querySelector('#name').readOnly]";
    assert_eq!(browser.value(name), json!(["lee", true]), "the token says who answers");
    browser.wait_until("the missions", "document.querySelectorAll('#call-mission option').length > 0");
    let offered = "[...document.querySelectorAll('#call-mission option')].map((option) => option.value)";
    assert_eq!(browser.value(offered), json!(["vital-signs"]), "those that lee may submit");
    browser.value(&format!("(document.{DONE}, true)"));
    browser.wait_until("it counts", "/Thank you/.test(document.querySelector('#announce').innerText)");
    let answered = closed.fleet.run(&["requests", "--all", "--json", "--certs", &certs], "station-1").expect(0).json();
    assert_eq!(answered["requests"][0]["phase"]["answered"]["by"], "lee", "{answered}");
    closed.fleet.stop();
}

#[test]
fn a_new_request_is_notified_once_and_as_its_level_demands() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let port = free_port();
    let mut fleet = Fleet::new(&example("fleet"));
    let station = with(example("station"), "name", "station-2");
    fleet.start("station", with(station, "dashboard", format!("127.0.0.1:{port}")), &[]);
    fleet.start("world", example("world"), &["station-2"]);
    for robot in ["robot", "arm"] {
        fleet.start("robot", example(robot), &["station-2", "world"]);
    }
    let mission = folder.write("signature.yaml", SIGN).display().to_string();
    let submit = ["submit", &mission];
    // A request that is open when the page is opened is not new.
    fleet.run(&submit, "station-2").expect(0);
    until("the first request", SOON, || requests(&mut fleet, &[]).into_iter().next());
    browser.open(&format!("http://127.0.0.1:{port}/me"));
    browser.wait_until("the first request", "document.querySelectorAll('#open form').length === 1");
    browser.watch_notifications();
    browser.click("#notify");
    browser.wait_until("the permission", "document.querySelector('#notify').innerText === 'Notified'");

    let mut expected = vec![];
    for number in [2, 3] {
        // The robot is free again.
        let open = requests(&mut fleet, &[])[0]["request"].as_str().expect("an id").to_owned();
        fleet.run(&["answer", &open, "--done", "--by", "Ria"], "station-2").expect(0);
        fleet.run(&submit, "station-2").expect(0);
        let id = format!("signature-{number}.1");
        browser.wait_until(
            "the next request",
            &format!("document.querySelector('#open form').dataset.request === '{id}'"),
        );
        expected.push(json!(["New request", "sign at Dock", id]));
        assert_eq!(browser.value("window.shown"), json!(expected), "each request once, and no other");
    }
    assert_eq!(browser.value("window.tones"), 2, "a tone for each new request");

    // Each alert states its level as a text; people are notified of a warning, and more clearly of an urgent alert.
    fleet.run(&["answer", "signature-3.1", "--done", "--by", "Ria"], "station-2").expect(0);
    let alerts = folder.write("alerts.yaml", ALERTS).display().to_string();
    let mission = fleet.run(&["submit", &alerts], "station-2").expect(0).stdout.trim().to_owned();
    let levels = [("tell", "info", 2), ("warn", "warning", 3), ("call", "urgent", 6)];
    for (number, (task, level, tones)) in levels.into_iter().enumerate() {
        let id = format!("{mission}.{}", number + 1);
        browser.wait_until("the alert", &format!("document.querySelector('#open form').dataset.request === '{id}'"));
        let card = browser.text("#open form");
        assert!(card.contains(&format!("Level: {level}")) && !card.contains("level:"), "{card}");
        assert_eq!(browser.text("#announce"), format!("New request, {level}: {task} at Dock"), "to screen readers");
        if level != "info" {
            expected.push(json!([format!("New request, {level}"), format!("{task} at Dock"), id]));
        }
        assert_eq!(browser.value("window.shown"), json!(expected), "{level}");
        assert_eq!(browser.value("window.tones"), tones, "{level}");
        check_access(&browser, level);
        fleet.run(&["answer", &id, "--done", "--by", "Ria"], "station-2").expect(0);
    }
    fleet.stop();
}
