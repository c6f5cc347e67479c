//! A fleet with a mission: its files, views and recordings.

use super::sample_messages::{body_state, frame};
use consort_dashboard::fleet_model::{FleetInput, FleetModel, FloorPlan};
use consort_dashboard::recording::RecordingWriter;
use consort_nodes::map_loader;
use consort_protocol::event::Event;
use consort_protocol::keys::Key;
use consort_protocol::ledger::Submission;
use consort_protocol::message::Beacon;
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;
use consort_tests::chaos::{ChaosFleet, FaultKind, generate};
use consort_world::record::foxglove::ExistingFile;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Shipped missions: small missions, and a mission with all features.
pub(super) const TEMPLATES: [&str; 3] = ["lab-samples", "vital-signs", "bed-transfer"];

/// Returns a mission as a client sends it.
pub(super) fn template(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../skills/missions/{name}.yaml"));
    let text = std::fs::read_to_string(path).expect("it is shipped");
    MissionTemplate::request(&text, Format::Yaml).expect("it is shipped")
}

/// Returns a mission as it is committed.
pub(super) fn submission() -> Submission {
    let template = &shipped()["lab-samples"];
    let given = BTreeMap::from([("room".to_owned(), "IC Room 6".to_owned())]);
    let mission = template.instantiate(&given, &hospital()).expect("it is shipped");
    let division = divide_and_check(&mission).expect("it is shipped");
    Submission::of("my-7".parse().expect("a slug"), mission, division)
}

/// Returns a JSON map in the format of this project.
pub(super) fn map_in_json() -> Vec<u8> {
    let map = json!({
        "name": "hall",
        "levels": [{ "name": "ground" }, { "name": "first", "elevation_m": 4.0, "walls": [[[0, 0], [1, 1]]] }],
        "walls": [[[0, 0], [12, 0]]],
        "places": [
            { "name": "Dock", "kind": "dock", "x_m": 6, "y_m": 2.5 },
            { "name": "Room", "kind": "room", "x_m": 10, "y_m": 5, "yaw_rad": 1.5 },
            { "name": "Hall", "kind": "corridor", "x_m": 6, "y_m": 3, "level": "first" },
        ],
        "lanes": [{ "between": ["Dock", "Room"], "length_m": 5.5, "speed_limit_mps": 0.5, "facing": "backward" }],
        "doors": [{ "name": "Door", "on": [["Dock", "Room"]], "opening_s": 1, "span": [[8, 3], [8, 4]] }],
        "lifts": [{ "name": "Lift", "stops": ["Dock", "Hall"], "capacity": 1 }],
    });
    map.to_string().into_bytes()
}

pub(super) fn calibration() -> Vec<u8> {
    let factor = "count = 12\nmean = 1.41\nsd = 0.35\nupper = 1.92\n";
    let leg = "[[legs]]\nfrom = \"Dock\"\nto = \"Room\"\nfactor = { count = 12, mean = 1.4, sd = 0.3, upper = 1.9 }\n";
    format!("quantile = 0.9\n[skills.navigation]\n{factor}[to.\"IC Room 2\"]\n{factor}[from.Dock]\n{factor}{leg}")
        .into_bytes()
}

pub(super) fn schedule() -> Vec<u8> {
    let schedule = generate(1, &ChaosFleet::of(6), 4.0, &FaultKind::FAULTS);
    serde_json::to_vec(&schedule).expect("a schedule")
}

fn events() -> [Value; 5] {
    let robots = json!({ "r1": "ada" });
    [
        json!({ "event": "elected", "term": 2, "voters": ["s-1"] }),
        json!({ "event": "submitted", "mission": "m-1", "parameters": { "room": "IC Room 6" } }),
        json!({ "event": "awarded", "mission": "m-1", "holders": robots, "epoch": { "term": 2, "index": 3 }, "after_ms": 31.5 }),
        json!({ "event": "released", "mission": "m-1", "role": "r1", "cause": "it is lost" }),
        json!({ "event": "mission", "mission": "m-1", "state": "completed", "submitted_at_ms": 900 }),
    ]
}

fn event(sequence: usize, at_ms: u64, what: &Value) -> Value {
    let mut event = json!({ "node": "s-1", "sequence": sequence, "at_ms": at_ms });
    event.as_object_mut().expect("an object").extend(what.as_object().expect("an object").clone());
    event
}

fn views() -> [(u8, Key, Value); 4] {
    let map: Value = serde_json::from_slice(&map_in_json()).expect("JSON");
    let map_view = map_loader::parse(&map.to_string(), "hall.json").expect("a map").to_view();
    let map_json = serde_json::to_value(map_view).expect("JSON");
    let robot = json!({
        "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 0.5 }, "battery": 0.75,
        "discharge": 0.001, "useful_charge": 0.125, "speed": 0.5, "availability": "free", "estimator": "e",
    });
    let node =
        json!({ "node": "ada", "seen_by": "s-1", "alive": true, "status": "alive", "age_ms": 20, "robot": robot });
    let person = json!({ "name": "Nia", "role": "nurse", "place": "Room", "away": false, "samples": ["blood"] });
    let mission = json!({
        "mission": "m-1", "state": "running", "detail": "running", "done": 1, "steps": 9, "holders": { "r1": "ada" }, "submitted_at_ms": 900,
        "parameters": {},
    });
    [
        (6, Key::ViewFleet, json!({ "seen_by": "s-1", "age_ms": 5, "nodes": [node], "ensembles": [] })),
        (6 + 8 * 2, Key::ViewMissions, json!({ "seen_by": "s-1", "age_ms": 5, "missions": [mission] })),
        (6 + 8 * 4, Key::ViewWorld, json!({ "people": [person], "doors": [{ "name": "Door", "state": "open" }] })),
        (6 + 8 * 6, Key::ViewMap, map_json),
    ]
}

/// Returns the inputs of a fleet model.
pub(super) fn fleet_inputs() -> Vec<u8> {
    let beacon = json!({ "node": "s-1", "term": 2, "voters": ["s-1"], "since_ms": 40, "cluster": null });
    let views = views().map(|(kind, _, view)| frame(kind, view.to_string().as_bytes()));
    let events =
        (1..).zip(events()).map(|(sequence, what)| frame(0, event(sequence, 1000, &what).to_string().as_bytes()));
    let mut all =
        vec![frame(4, b"two"), frame(5, beacon.to_string().as_bytes()), frame(2, &body_state()), frame(83, &[])];
    all.extend(events);
    all.extend(views);
    all.concat()
}

/// Returns a recording of some seconds.
pub(super) fn recording() -> Vec<u8> {
    let began_ms = 1_795_000_000_000;
    let file = std::env::temp_dir().join(format!("consort-fuzz-seed-{}.mcap", std::process::id()));
    let fleet = "ward".parse().expect("a slug");
    let mut writer = RecordingWriter::create(&file, ExistingFile::Replace, &fleet, "s-1", began_ms).expect("a file");
    let mut model = FleetModel::new("ward", "s-1", FloorPlan::default(), began_ms);
    let node: consort_protocol::ids::NodeId = "s-1".parse().expect("a slug");
    let beacon = Beacon { node: node.clone(), term: 2, voters: [node].into(), since_ms: 40, cluster: None, wire: None };
    let mut all = vec![FleetInput::Beacon(beacon), FleetInput::Links(2)];
    all.extend(views().map(|(_, key, view)| FleetInput::View { key, view }));
    for (sequence, what) in (1..).zip(events()) {
        let event: Event = serde_json::from_value(event(sequence, began_ms, &what)).expect("an event");
        all.push(FleetInput::Event(Box::new(event)));
    }
    all.extend(views().map(|(_, key, view)| FleetInput::View { key, view }));
    for (now_ms, input) in (began_ms..).step_by(300).zip(all) {
        model.apply(&input, now_ms);
        writer.write_input(&input, &model, now_ms).expect("a file");
        writer.flush_due(now_ms).expect("a file");
    }
    writer.finish().expect("a file");
    let bytes = std::fs::read(&file).expect("the same file");
    std::fs::remove_file(file).expect("the same file");
    bytes
}
