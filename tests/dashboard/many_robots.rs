//! Two hundred robots that report five times a second, and a page that keeps up with its screen.

use crate::browser::Browser;
use crate::support::Folder;
use consort_actors::clock::Clock;
use consort_nodes::address::Taken;
use consort_nodes::dashboard::{Board, Dashboard};
use consort_nodes::floor;
use consort_nodes::picture::{FloorPlan, Picture};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_skills::actions::Telemetry;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

const ROBOTS: usize = 200;

/// Five times a second.
const REPORTS: Duration = Duration::from_millis(200);

fn name(index: usize) -> String {
    format!("robot-{index:03}")
}

/// The fleet as the coordinator shows it.
fn fleet() -> Value {
    let node = |index: usize| {
        let availability = match index % 3 {
            0 => json!({ "holding": { "mission": format!("round-{index}"), "role": "r1", "suspended": false } }),
            _ => json!("free"),
        };
        json!({ "node": name(index), "alive": true, "status": "alive", "age_ms": 0, "robot": {
            "skills": ["navigation"], "place": "Crossing", "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 },
            "battery": 0.9, "useful_charge": 0.08, "speed": 0.7, "availability": availability } })
    };
    let members = (0..ROBOTS).map(|index| json!({ "node": name(index), "member": true, "reason": "" }));
    json!({ "nodes": (0..ROBOTS).map(node).collect::<Vec<_>>(),
        "ensembles": [{ "name": "logistics", "nodes": members.collect::<Vec<_>>() }] })
}

/// Each robot goes round in a circle of its own.
fn telemetry(index: usize, now_ms: u64) -> Telemetry {
    let share = index as f64 / ROBOTS as f64;
    let turn = TAU * ((now_ms % 3_600_000) as f64 / 40_000.0 + share * 7.0);
    let (x, y) = (18.0 + (3.0 + 13.0 * share) * turn.cos(), 17.0 + (3.0 + 13.0 * share) * turn.sin());
    let pose = json!({ "x_m": x, "y_m": y, "yaw_rad": turn % TAU + TAU / 4.0 });
    let telemetry = json!({ "time": 1.0, "pose": pose, "place": "Crossing", "battery": 0.2 + 0.8 * share, "able": true, "closed": [] });
    serde_json::from_value(telemetry).expect("a body's report")
}

fn report(board: &Board) {
    let coordinator = NodeId::new(name(0)).expect("a slug");
    let beacon = Beacon { node: coordinator, term: 1, voters: [].into(), since_ms: 1000, cluster: None };
    board.with(|picture, now_ms| {
        picture.take_beacon(&beacon, now_ms);
        picture.take_links(3, now_ms);
        for index in 0..ROBOTS {
            picture.take_body(&name(index), &telemetry(index, now_ms), now_ms);
        }
    });
}

/// Counts the browser's frames for some seconds: those between which more than one and a half of a frame's usual time went by
/// are counted as late, by how many frames.
const MEASURE: &str = "new Promise((tell) => {
    const times = []; const began = performance.now(); const drawn = consort.drawn.frames; consort.drawn.worst = 0;
    const frame = (now) => {
        times.push(now);
        if (now - began < 10000) requestAnimationFrame(frame);
        else {
            const gaps = times.slice(1).map((time, index) => time - times[index]).sort((a, b) => a - b);
            tell({ frames: gaps.length, median_ms: gaps[gaps.length >> 1], worst_ms: gaps.at(-1),
                p99_ms: gaps[Math.floor(gaps.length * 0.99)],
                dropped: gaps.reduce((sum, gap) => sum + Math.max(0, Math.round(gap / gaps[gaps.length >> 1]) - 1), 0),
                drawn: consort.drawn.frames - drawn, worst_draw_ms: consort.drawn.worst });
        }
    };
    requestAnimationFrame(frame);
})";

#[test]
#[expect(clippy::print_stderr, reason = "what was measured is told")]
fn two_hundred_robots_are_shown_and_drawn_in_every_frame() {
    let folder = Folder::new();
    let Some(browser) = Browser::start(&folder) else { return };
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().expect("a runtime");
    let clock = runtime.block_on(async { Clock::real() });
    let plan = FloorPlan::new(&floor::load("hospital").expect("a shipped map"));
    let mut picture = Picture::new("many", "station-1", plan, clock.wall_ms());
    picture.take_view(&Key::ViewFleet, &fleet(), clock.wall_ms());
    let board = Arc::new(Board::new(picture, clock));
    report(&board);
    let dashboard = runtime.block_on(async {
        let address = Taken::take("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.expect("a free port");
        Dashboard::show(address, Arc::clone(&board))
    });
    runtime.spawn(async move {
        let mut ticks = tokio::time::interval(REPORTS);
        loop {
            ticks.tick().await;
            report(&board);
        }
    });
    browser.open(&dashboard.url());
    browser.until("all robots", &format!("document.querySelectorAll('#robots tbody tr').length === {ROBOTS}"));
    let measured = browser.value(MEASURE);
    eprintln!("{ROBOTS} robots at 5 Hz, 10 s: {measured}");
    browser.picture("many-robots");
    // How many frames a second there are is the machine's affair; but robots are moved, and the page is not behind.
    let number = |key: &str| measured[key].as_f64().expect("a number");
    assert!(number("drawn") >= 20.0, "{measured}");
    let age = browser.value(
        "consort.line.now() - Math.min(...Object.values(consort.line.picture.robots).map((robot) => robot.body_ms))",
    );
    assert!(age.as_f64().expect("a number") < 5000.0, "the page is {age} ms behind");
    assert_eq!(browser.console(), Vec::<String>::new());
}
