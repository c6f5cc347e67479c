//! A fleet that loses its coordinator is recorded and replayed afterwards.

use crate::browser::{Browser, SOON};
use crate::demo_fleet::check_access;
use crate::station::dashboard_address;
use crate::support::{Client, Folder, LONG, Program, hospital, until};
use serde_json::{Value, json};

/// Key codes of WebDriver.
const LEFT: &str = "\u{e012}";
const RIGHT: &str = "\u{e014}";
const HOME: &str = "\u{e011}";
const END: &str = "\u{e010}";

/// Records a mission during which the coordinator is killed. Returns the file and the coordinators
/// before and after.
fn record(folder: &Folder) -> (String, String, String) {
    let file = folder.path().join("run.mcap").display().to_string();
    let mut fleet = hospital("taped");
    let mut client = Client::open(&fleet.address("world"), "taped");
    let first = until("there is a coordinator", LONG, || Some(client.view("coordinator")["node"].as_str()?.to_owned()));
    let recorder = fleet.begin(&["record", "--out", &file], "world");
    until("it records", SOON, || recorder.stderr().contains("recording taped to ").then_some(()));
    let holds = |text: &str| {
        let there = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).contains(text);
        std::fs::read(&file).is_ok_and(there).then_some(())
    };
    until("the recorder has received the coordinator", SOON, || holds(&format!(r#"{{"node":"{first}","term":"#)));
    let payload = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "taped-1"}"#;
    until("the mission is acknowledged", LONG, || {
        client.request("api/submit", payload)["mission"].as_str().map(|mission| assert_eq!(mission, "lab-samples-1"))
    });
    client.wait_for_event("a task begins", LONG, |event| event["event"] == "task_began");
    // The recorder reads missions a moment after their events.
    until("the recorder has read that the mission runs", SOON, || holds(r#""state":"running","submitted_at_ms""#));
    fleet.kill(&first);
    let elected = client.wait_for_event("another is elected", LONG, |event| {
        event["event"] == "elected" && event["node"] != first.as_str()
    });
    client.wait_for_event("the mission is completed", LONG, |event| {
        event["event"] == "mission" && event["state"] == "completed"
    });
    // The mission completed before, but the recorder may receive it a moment later.
    until("the recorder has received it", SOON, || holds(r#""state":"completed","submitted_at_ms""#));
    recorder.signal("INT");
    let output = recorder.end(SOON).expect(0).stdout;
    assert!(output.starts_with(&format!("{file}: ")) && output.contains(" events, "), "{output}");
    fleet.stop();
    (file, first, elected["node"].as_str().expect("a name").to_owned())
}

/// Starts a replay and returns its dashboard address.
fn replay(folder: &Folder, name: &str, file: &str) -> (Program, String) {
    let mut program = Program::start(folder, name, &["replay", file]);
    let url = dashboard_address(&mut program);
    (program, url)
}

/// Asserts that the page shows no input later than the current instant.
fn check_nothing_is_of_later(browser: &Browser) {
    let later = browser.value(
        "(() => { const { model, now } = consort.connection; return Object.values(model.robots ?? {}).filter((one) => one.telemetry_ms > now()).length
            + Object.values(model.log ?? {}).filter((one) => one.at_ms > now() + 50).length; })()",
    );
    assert_eq!(later, 0, "robots and events of later");
}

/// Moves the slider and releases it.
fn slide(browser: &Browser, to: &str) {
    browser.value(&format!(
        "(() => {{ const slider = document.querySelector('#replay-slider'); slider.value = Math.round({to});
            slider.dispatchEvent(new Event('input')); slider.dispatchEvent(new Event('change')); }})()"
    ));
}

const MISSION: &str = "consort.connection.model.missions?.['lab-samples-1']?.state";

fn coordinates(node: &str) -> String {
    format!("document.querySelector('#coordinator').innerText.startsWith('{node}, ')")
}

#[test]
fn a_recorded_takeover_is_replayed_in_both_directions() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let (file, first, second) = record(&folder);
    let (_replay, url) = replay(&folder, "replay", &file);
    browser.open(&url);
    browser.value("window.loadedOnce = true");
    browser.wait_until(
        "the page is titled as a recording",
        "/^Recording of taped, begun on .* accepts no requests/.test(document.querySelector('#replay h2')?.innerText)",
    );
    browser.wait_until("it plays", "document.querySelector('#replay-play')?.innerText === 'Pause'");
    browser.press(" ");
    browser.wait_until("space stops it", "document.querySelector('#replay-play')?.innerText === 'Play'");
    let marks = browser.value("consort.connection.model.recording.marks");
    let marks = marks.as_array().expect("a list");
    let kinds: Vec<&str> = marks.iter().filter_map(|mark| mark["kind"].as_str()).collect();
    // The new coordinator may transfer the lead at once. Each change has a mark.
    let changes = kinds.iter().take_while(|kind| **kind == "coordinator").count();
    assert!(changes >= 1 && kinds[changes..] == ["completed"], "{marks:#?}");
    let taken_over = marks[0]["text"].as_str().expect("words");
    assert!(taken_over.starts_with(&format!("coordinator {second}, term ")), "{second}: {marks:#?}");
    assert_eq!(browser.value("document.querySelectorAll('#replay .marks li').length"), marks.len());

    // The beginning: the first coordinator, and no mission.
    browser.press(HOME);
    browser.wait_until("the beginning", "consort.connection.now() === consort.connection.model.recording.from_ms");
    browser.press(RIGHT);
    browser.wait_until("five seconds on, or the end", "consort.connection.now() >= Math.min(consort.connection.model.recording.from_ms + 5000, consort.connection.model.recording.to_ms)");
    browser.press(HOME);
    browser.press(".");
    browser.wait_until("the takeover", &coordinates(&second));
    browser.wait_until("the mission runs", &format!("{MISSION} === 'running'"));
    check_nothing_is_of_later(&browser);
    // A moment before, by slider, as with a mouse or a screen reader.
    let takeover_ms = marks[0]["at_ms"].as_u64().expect("an instant");
    slide(&browser, &format!("{takeover_ms} - consort.connection.model.recording.from_ms - 1"));
    browser.wait_until("the previous coordinator", &coordinates(&first));
    assert_eq!(browser.value("consort.connection.now()"), takeover_ms - 1);
    check_nothing_is_of_later(&browser);
    browser.press(LEFT);
    let back = format!("Math.max({takeover_ms} - 1 - 5000, consort.connection.model.recording.from_ms)");
    browser.wait_until("five seconds back, or the beginning", &format!("consort.connection.now() === {back}"));
    browser.press(".");
    browser.wait_until("the takeover again", &coordinates(&second));
    browser.press(&".".repeat(changes));
    browser.wait_until("the end of the mission", &format!("{MISSION} === 'completed'"));
    browser.wait_until(
        "it is announced",
        "/^lab-samples-1 completed, at /.test(document.querySelector('#announce').innerText)",
    );
    check_nothing_is_of_later(&browser);
    browser.press(",");
    browser.wait_until("back, it still runs", &format!("{MISSION} === 'running'"));
    browser.wait_until("the table shows it", "document.querySelector('#missions tbody').innerText.includes('running')");
    browser.wait_until("its buttons", "document.querySelector('#mission [data-key=priority]') !== null");
    let offered = "[...document.querySelectorAll('#mission button, #missions-filter button, #raise-alarm')].filter((one) => one.checkVisibility()).length";
    assert_eq!(browser.value(offered), 0, "orders to a recorded fleet");
    browser.press(HOME);
    browser.wait_until("the mission does not exist yet", &format!("{MISSION} === undefined"));
    check_nothing_is_of_later(&browser);
    assert_eq!(browser.value("window.loadedOnce"), true);

    slide(&browser, "slider.max * 0.5");
    let middle = "(consort.connection.model.recording.from_ms + consort.connection.model.recording.to_ms) / 2";
    browser.wait_until("the middle", &format!("Math.abs(consort.connection.now() - {middle}) < 2"));
    let output = browser.value("document.querySelector('#replay-slider').getAttribute('aria-valuetext')");
    assert!(output.as_str().expect("words").contains(" of "), "{output}");
    let drawn = "/ term [2-9]/.test(document.querySelector('#coordinator').innerText) && document.querySelector('#missions tbody').innerText.includes('/16')";
    browser.wait_until("all of it is drawn", drawn);
    check_access(&browser, "a recording");
    browser.documentation_screenshot("replay");
    check_dark_and_narrow(&browser);

    // Played to its end at a hundred times its speed, the replay stops there.
    let set = |command: Value| {
        browser.value(&format!(
        "fetch('/api/replay', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, body: '{command}' }}).then((answer) => answer.json())"
    ))
    };
    set(json!({ "playing": true, "speed": 100.0 }));
    browser.wait_until(
        "the end",
        "!consort.connection.model.recording.playing && consort.connection.now() === consort.connection.model.recording.to_ms",
    );
    browser.wait_until("and its mission", &format!("{MISSION} === 'completed'"));
    browser.press(END);
    assert_eq!(browser.console(), Vec::<String>::new());

    // A recorded fleet accepts no requests.
    for action in ["#new-mission", "#hold-all", "#robot-orders", "#part-orders"] {
        assert_eq!(browser.value(&format!("document.querySelector('{action}').checkVisibility()")), false, "{action}");
    }
    let of_missions =
        ["/api/missions/cancel", "/api/missions/lab-samples-1/cancel", "/api/missions/lab-samples-1/resolve"];
    let to_robots = ["/api/hold", "/api/release", "/api/maintenance", "/api/robots/select"];
    let orders = ["/api/close", "/api/open", "/api/limit", "/api/alarm", "/api/priority", "/api/reassign"];
    for path in ["/api/missions"].into_iter().chain(to_robots).chain(orders).chain(of_missions) {
        let refused = browser.value(&format!(
            "fetch('{path}', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, body: '{{}}' }}).then(async (answer) => [answer.status, (await answer.json()).error])"
        ));
        assert_eq!(
            refused,
            json!([409, "this is a recording of taped: a recorded fleet accepts no requests"]),
            "{path}"
        );
    }
    let refused = set(json!({ "speed": 0 }));
    assert_eq!(refused["error"], "a speed of 0 is not allowed: from 0.1 to 100");
    cut_short(&folder, &browser, &file);
}

fn check_dark_and_narrow(browser: &Browser) {
    browser.prefers("dark");
    browser.wait_until("dark colours", "document.documentElement.dataset.theme === 'dark'");
    check_access(browser, "a recording in the dark");
    browser.screen(360, 740);
    assert_eq!(browser.value("document.documentElement.scrollWidth"), 360, "nothing is wider than the phone");
    browser.screenshot("replay-phone");
    browser.screen(1440, 1000);
    browser.prefers("light");
}

/// Half of a file is shown and reported as incomplete.
fn cut_short(folder: &Folder, browser: &Browser, file: &str) {
    let bytes = std::fs::read(file).expect("a file of ours");
    let half = folder.path().join("half.mcap");
    std::fs::write(&half, &bytes[..bytes.len() / 2]).expect("the folder can be written to");
    let (replay, url) = replay(folder, "half", &half.display().to_string());
    assert!(replay.stderr().contains("half.mcap: it has no end"), "{}", replay.stderr());
    browser.open(&url);
    browser.wait_until(
        "the page reports that the recording is incomplete",
        "document.querySelector('#replay h2')?.innerText.includes('Incomplete: it has no end')",
    );
    browser.wait_until("robots", "document.querySelectorAll('#robots tbody tr').length === 2");
}
