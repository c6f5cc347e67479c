//! Rolling upgrade of a fleet from the previous release to this version, while missions continue.
//!
//! The previous release is this program, limited to wire version 1. The layouts of version 1 itself
//! are compared with stored bytes in `tests/fuzz_targets/golden_bytes.rs`.

use crate::crashes::{STATIONS, coordinator_and_term, submit, with, world};
use crate::support::{Client, Closed, Ended, Fleet, LONG, example, until};
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use toml::Table;

const ROBOTS: [&str; 2] = ["ada", "lab-arm"];

/// Arguments in front of the program that make it read wire version 1 only, as the previous release
/// does: the variable of the hidden flag `--newest-wire-version` of a node.
const PREVIOUS: [&str; 2] = ["env", "CONSORT_NEWEST_WIRE_VERSION=2"];

/// Hospital in which some nodes run the previous release and some the current release.
struct Hospital {
    fleet: Fleet,
    speed: f64,
}

impl Hospital {
    fn open(name: &str, speed: f64) -> Hospital {
        let fleet = Fleet::new(&with(example("fleet"), "name", name));
        let mut hospital = Hospital { fleet, speed };
        for node in ["world"].into_iter().chain(STATIONS).chain(ROBOTS) {
            hospital.start(node, true);
        }
        hospital
    }

    fn file(&self, node: &str) -> (&'static str, Table) {
        let data = self.fleet.path(&format!("{node}-data")).display().to_string();
        match node {
            "world" => ("world", world(self.speed)),
            "ada" => ("robot", with(with(example("robot"), "may_vote", false), "data_dir", data)),
            "lab-arm" => ("robot", with(with(example("arm"), "may_vote", false), "data_dir", data)),
            station => ("station", with(with(example("station"), "name", station), "data_dir", data)),
        }
    }

    /// Starts a node, linked with all running nodes.
    fn start(&mut self, node: &str, previous: bool) {
        let others: Vec<String> = self.fleet.names().into_iter().map(str::to_owned).collect();
        let others: Vec<&str> = others.iter().map(String::as_str).collect();
        let (kind, file) = self.file(node);
        self.fleet.start_by(if previous { &PREVIOUS } else { &[] }, kind, file, &others);
    }

    /// Stops a node, waits until the others have noticed, and starts it with the chosen program.
    /// Waits until it is back.
    fn move_over(&mut self, node: &str, previous: bool, seen_by: &Client) {
        self.fleet.node(node).signal("TERM");
        self.fleet.ends(node);
        self.start(node, previous);
        self.back(node, seen_by);
    }

    /// Waits until a node is alive again. A station must also be a voter in good health.
    fn back(&mut self, node: &str, seen_by: &Client) {
        let mine = self.fleet.address(node);
        until(&format!("{node} is back at {mine}"), LONG, || {
            let fleet = seen_by.view("fleet");
            let is_alive = |entry: &&Value| entry["node"] == node && entry["status"] == "alive";
            fleet["nodes"].as_array()?.iter().find(is_alive)?;
            let coordinator = seen_by.view("coordinator");
            let is_in = |list: &str| coordinator[list].as_array().is_some_and(|list| list.contains(&node.into()));
            let keeps = !STATIONS.contains(&node) || (is_in("voters") && !is_in("voters_lost"));
            (keeps && coordinator["node"].is_string()).then_some(())
        });
    }

    fn upgrade(&mut self, more: &[&str], by: &str) -> Ended {
        self.fleet.run(&[&["upgrade"][..], more].concat(), by)
    }
}

/// Submits missions in sequence and waits for each, until `ended` is set. Returns the
/// missions.
fn work(address: &str, fleet: &'static str, ended: &AtomicBool) -> Vec<String> {
    let client = Client::open(address, fleet);
    let mut missions = vec![];
    while !ended.load(Ordering::SeqCst) {
        let mission = submit(&client, &format!("work-{}", missions.len()));
        until(&format!("{mission} ends"), LONG, || {
            let state = client.view(&format!("mission/{mission}"))["state"].clone();
            (state == "completed" || state.is_object()).then_some(())
        });
        missions.push(mission);
    }
    missions
}

#[test]
fn a_fleet_is_upgraded_node_by_node_during_missions() {
    let mut hospital = Hospital::open("upgrade", 10.0);
    let address = hospital.fleet.address("world");
    let mut client = Client::open(&address, "upgrade");
    let (leader, _) = coordinator_and_term(&client);
    let ended = Arc::new(AtomicBool::new(false));
    let worker_ended = Arc::clone(&ended);
    let at = address.clone();
    let worker = std::thread::spawn(move || work(&at, "upgrade", &worker_ended));
    client.wait_for_event("a mission is under way", LONG, |event| event["event"] == "task_began");

    // The coordinator comes last.
    let mut stations = STATIONS.to_vec();
    stations.sort_by_key(|station| *station == leader);
    hospital.move_over(stations[0], false, &client);
    // Downgrades to the previous release and upgrades again.
    hospital.move_over(stations[0], true, &client);
    hospital.move_over(stations[0], false, &client);
    for station in &stations[1..] {
        hospital.move_over(station, false, &client);
    }
    // Some nodes run the old release and some the new. The fleet writes the version that all of
    // them read.
    until("the versions of all nodes are known", LONG, || {
        let state = client.request("api/upgrade", "{}");
        let nodes = state["nodes"].as_array()?;
        let known = nodes.iter().filter(|node| node["newest"].is_number()).count();
        let ready = nodes.iter().filter(|node| node["ready"] == true);
        let ready: Vec<&str> = ready.filter_map(|node| node["node"].as_str()).collect();
        (ready == STATIONS && known == STATIONS.len() + ROBOTS.len() + 1).then_some(())
    });
    let refused = hospital.upgrade(&["--finish"], "world").expect(1).stderr;
    assert!(
        refused
            .contains("wire version 3 is not read by ada (reads 1 to 2), lab-arm (reads 1 to 2), world (reads 1 to 2)"),
        "{refused}"
    );
    let shown = hospital.upgrade(&[], "world").expect(0).stdout;
    assert!(shown.starts_with("the fleet writes wire version 2; 3 of 6 nodes do not read 3 yet\n"), "{shown}");

    // Restarts a robot in the middle of a mission.
    client.wait_for_event("ada carries something out", LONG, |event| {
        event["event"] == "task_began" && event["node"] == "ada"
    });
    for robot in ROBOTS {
        hospital.move_over(robot, false, &client);
    }
    ended.store(true, Ordering::SeqCst);
    let missions = worker.join().expect("all missions ended");
    for mission in &missions {
        let state = client.view(&format!("mission/{mission}"))["state"].clone();
        assert_eq!(state, "completed", "{mission}\n{}", hospital.fleet.logs());
        // A restart may have interrupted a task, which then began again and ended once.
        for (task, (begun, ended)) in client.tasks(mission) {
            assert!(ended == 1 && begun >= 1, "{mission}, {task}: begun {begun} times, ended {ended} times");
        }
    }
    assert!(!missions.is_empty());

    // The nodes connect to the world. A restart of the world also restores its samples.
    drop(client);
    hospital.fleet.node("world").signal("TERM");
    hospital.fleet.ends("world");
    hospital.start("world", false);
    for node in STATIONS.into_iter().chain(ROBOTS) {
        let seen_by = Client::open(&hospital.fleet.address("world"), "upgrade");
        hospital.move_over(node, false, &seen_by);
    }
    let client = Client::open(&hospital.fleet.address("world"), "upgrade");
    until("all nodes read version 3", LONG, || {
        let state = client.request("api/upgrade", "{}");
        state["nodes"].as_array()?.iter().all(|node| node["ready"] == true).then_some(())
    });
    let output = hospital.upgrade(&["--finish"], "world").expect(0).stdout;
    assert!(
        output.starts_with("the fleet writes wire version 3; the coordinator's release reads no later version"),
        "{output}"
    );
    let mission = submit(&client, "afterwards");
    until("a mission is completed after it", LONG, || {
        (client.view(&format!("mission/{mission}"))["state"] == "completed").then_some(())
    });

    // A downgrade is no longer possible.
    hospital.fleet.node("lab-arm").signal("TERM");
    hospital.fleet.ends("lab-arm");
    hospital.start("lab-arm", true);
    let left = hospital.fleet.take("lab-arm").end(LONG).expect(1);
    let release = env!("CARGO_PKG_VERSION");
    let reason = format!(
        "the fleet writes wire version 3, but this program, {release}, reads 1 to 2: install the release that the other nodes run"
    );
    assert!(left.stderr.contains(&reason), "{}", left.stderr);
    hospital.start("lab-arm", false);
    hospital.back("lab-arm", &client);
    hospital.fleet.stop();
}

#[test]
fn two_releases_accept_each_other_in_a_closed_fleet() {
    let mut closed = Closed::new();
    let operator = closed.of("operate").display().to_string();
    // All three nodes with a store are voters, two of them with the previous release.
    let folder = closed.fleet.path(".");
    let file = |kind: &str| with(example(kind), "data_dir", folder.join(format!("{kind}-data")).display().to_string());
    closed.start_by(&PREVIOUS, "station", file("station"), &[]);
    closed.start("world", world(20.0), &["station-1"]);
    closed.start("robot", file("robot"), &["station-1", "world"]);
    closed.start_by(&PREVIOUS, "robot", file("arm"), &["station-1", "world"]);
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait", "--certs", &operator];
    let ended = closed.fleet.begin_by(&PREVIOUS, &submit, "world").end(LONG).expect(0);
    assert!(ended.stdout.ends_with("completed\n"), "{}", ended.stdout);
    for name in ["station-1", "world", "ada", "lab-arm"] {
        assert_eq!(closed.refused(name), "", "{name} rejects messages of its own fleet");
    }

    for (name, kind, file) in [("station-1", "station", file("station")), ("lab-arm", "robot", file("arm"))] {
        closed.fleet.node(name).signal("TERM");
        closed.fleet.ends(name);
        let others: Vec<String> = closed.fleet.names().into_iter().map(str::to_owned).collect();
        closed.start(kind, file, &others.iter().map(String::as_str).collect::<Vec<_>>());
    }
    until("all nodes read version 3", LONG, || {
        let ran = closed.fleet.run(&["upgrade", "--finish", "--certs", &operator], "world");
        (ran.code() == 0 && ran.stdout.starts_with("the fleet writes wire version 3;")).then_some(())
    });
    let again = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait", "--certs", &operator];
    let ended = closed.fleet.run(&again, "world").expect(0);
    assert!(ended.stdout.ends_with("completed\n"), "{}", ended.stdout);
    for name in ["station-1", "world", "ada", "lab-arm"] {
        assert_eq!(closed.refused(name), "", "{name} rejects messages of its own fleet");
    }
    closed.fleet.stop();
}
