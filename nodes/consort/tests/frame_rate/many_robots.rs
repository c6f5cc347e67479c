//! A thousand robots that report five times a second, and a page that draws every report.

use crate::browser::Browser;
use crate::shown_model::ShownModel;
use crate::support::Folder;
use consort_dashboard::fleet_model::FleetModel;
use consort_protocol::keys::Key;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_skills::actions::Telemetry;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

const ROBOTS: usize = 1000;

/// Largest number of table rows that change in a frame: the visible rows (a dozen, and a partly
/// visible row at either end), and ten of the others in turn.
const ROWS_AT_ONCE: u64 = 40;

/// Largest number of rows that the table has as elements.
const ROWS_SHOWN: u64 = 60;

/// Least number of frames per second, unless an empty page has less than twice as many.
const FRAMES_PER_S: f64 = 30.0;

fn name(index: usize) -> String {
    format!("robot-{index:03}")
}

/// Returns the fleet view of the coordinator.
fn fleet() -> Value {
    let node = |index: usize| {
        let availability = match index % 3 {
            0 => json!({ "holding": { "mission": format!("round-{index}"), "role": "r1", "suspended": false } }),
            _ => json!("free"),
        };
        json!({ "node": name(index), "seen_by": name(0), "alive": true, "status": "alive", "age_ms": 0, "robot": {
            "skills": ["navigation"], "place": "Crossing", "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 },
            "battery": 0.9, "discharge": 0.001, "useful_charge": 0.08, "speed": 0.7, "availability": availability,
            "estimator": "standard" } })
    };
    let members = (0..ROBOTS).map(|index| json!({ "node": name(index), "member": true, "reason": "", "age_ms": 0 }));
    json!({ "nodes": (0..ROBOTS).map(node).collect::<Vec<_>>(),
        "ensembles": [{ "name": "logistics", "nodes": members.collect::<Vec<_>>() }] })
}

/// Each robot drives in its own circle, and all consume a hundredth of their charge per second, so
/// all rows change.
fn telemetry(index: usize, now_ms: u64) -> Telemetry {
    let share = index as f64 / ROBOTS as f64;
    let turn = TAU * ((now_ms % 3_600_000) as f64 / 40_000.0 + share * 7.0);
    let (x, y) = (18.0 + (3.0 + 13.0 * share) * turn.cos(), 17.0 + (3.0 + 13.0 * share) * turn.sin());
    let spent = (now_ms / 1000 % 20) as f64 / 100.0;
    Telemetry {
        time: WorldTime::from_secs(1.0),
        pose: Pose::new(x, y, turn % TAU + TAU / 4.0),
        place: "Crossing".parse().expect("a place"),
        battery: BatteryShare::new(0.2 + 0.8 * share - spent).expect("a share"),
        able: true,
        closed: vec![],
        readings: BTreeMap::new(),
    }
}

fn report(model: &mut FleetModel, now_ms: u64) {
    for index in 0..ROBOTS {
        model.apply_telemetry(&name(index), &telemetry(index, now_ms), now_ms);
    }
}

/// Counts for some seconds: the frames of the browser, its dropped frames (gaps above one and a
/// half of the usual gap), the messages and reports of the page, and the largest number of table
/// rows changed in a frame.
const MEASURE: &str = "((seconds) => new Promise((tell) => {
    const page = window.consort;
    const counts = () => (page ? { ...page.connection.received, ...page.drawStats } : {});
    if (page) page.drawStats.worst = 0;
    const [times, began, before] = [[], performance.now(), counts()];
    const rows = { now: new Set(), most: 0, all: 0 };
    const watch = new MutationObserver((changes) => {
        for (const { target } of changes) {
            const row = (target.closest ? target : target.parentElement)?.closest('tbody tr');
            if (row) rows.now.add(row);
        }
    });
    watch.observe(document.body, { subtree: true, childList: true, characterData: true });
    const frame = (now) => {
        times.push(now);
        rows.most = Math.max(rows.most, rows.now.size);
        rows.all += rows.now.size;
        rows.now.clear();
        if (now - began < seconds * 1000) return requestAnimationFrame(frame);
        watch.disconnect();
        const gaps = times.slice(1).map((time, index) => time - times[index]).sort((a, b) => a - b);
        const median = gaps[gaps.length >> 1];
        const after = counts();
        const since = Object.fromEntries(Object.entries(after).map(([name, count]) => [name, Math.round((count - before[name]) * 10) / 10]));
        tell({ frames: gaps.length, median_ms: median, p99_ms: gaps[Math.floor(gaps.length * 0.99)], worst_ms: gaps.at(-1),
            dropped: gaps.reduce((sum, gap) => sum + Math.max(0, Math.round(gap / median) - 1), 0),
            rows_in_a_frame: rows.most, rows: rows.all, ...since, worst: after.worst });
    };
    requestAnimationFrame(frame);
}))";

#[test]
#[expect(clippy::print_stderr, reason = "the measurements are printed")]
fn a_thousand_robots_are_drawn_in_every_frame() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let shown = ShownModel::serve("many", report);
    shown.change(|model, now_ms| model.apply_view(&Key::ViewFleet, &fleet(), now_ms));
    // The frame rate of this machine without the page.
    let measure = |seconds: u32| browser.value(&format!("{MEASURE}({seconds})"));
    browser.open("about:blank");
    let machine = measure(5);
    browser.open(&shown.url());
    let rows = ROBOTS + 1; // with the heading
    browser.wait_until("all robots", &format!("document.querySelector('#robots').ariaRowCount === '{rows}'"));
    // By then the initial work is done.
    browser.wait_until("frames", "consort.drawStats.frames > 100");
    let page = measure(10);
    eprintln!("an empty page, 5 s: {machine}\n{ROBOTS} robots at 5 Hz, 10 s: {page}");
    browser.screenshot("many-robots");

    // The frame rate depends on the machine and its load. The page must guarantee the following on
    // any machine:
    let number = |key: &str| page[key].as_u64().unwrap_or_else(|| panic!("{key} in {page}"));
    // It received changes, in sequence; a page that misses a change receives a full frame again.
    assert!(number("patches") > 0 && number("fulls") == 0, "{page}");
    // It drew each report, except reports between which the browser requested no frame; the last
    // report may still be pending.
    let undrawn = number("patches").saturating_sub(number("reports") + number("missed"));
    assert!(undrawn <= 1 && number("missed_with_a_frame_between") == 0, "{page}");
    // It changes few table rows at a time, although the row of every robot changes all the time.
    assert!(number("rows_in_a_frame") <= ROWS_AT_ONCE, "{page}");
    // The map is shown whole, so robots cover each other.
    assert!(number("frames") as f64 / 10.0 >= FRAMES_PER_S.min(machine_rate(&machine) / 2.0), "{machine}, {page}");
    assert!(browser.value("consort.drawStats.groups").as_u64() > Some(0), "no groups of robots on the map");
    let age = browser.value(
        "consort.connection.now() - Math.min(...Object.values(consort.connection.model.robots).map((robot) => robot.telemetry_ms))",
    );
    assert!(age.as_f64().expect("a number") < 5000.0, "the page is {age} ms behind");
    // The table has the visible rows only, and scrolling shows the others.
    let elements = browser.value("document.querySelectorAll('#robots tbody tr').length");
    assert!(elements.as_u64().is_some_and(|rows| rows <= ROWS_SHOWN), "{elements} rows");
    browser.value("document.querySelector('#robots').closest('.scroll').scrollTop = 1e6");
    let last = name(ROBOTS - 1);
    browser.wait_until("the last robot", &format!("document.querySelector('#robots tr[data-row={last}]') !== null"));
    assert_eq!(browser.console(), Vec::<String>::new());
}

/// Returns the frames per second of a measurement of 5 s.
fn machine_rate(machine: &Value) -> f64 {
    machine["frames"].as_f64().expect("a number of frames") / 5.0
}
