//! Inputs from a small fleet, and the fleet models after each input.

use consort_dashboard::fleet_model::{FleetInput, FleetModel, FloorPlan};
use consort_dashboard::loaded_map::LoadedMap;
use consort_dashboard::recording::{RecordingStats, RecordingWriter};
use consort_protocol::event::Event;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_protocol::scalar::Scalar;
use consort_world::map;
use consort_world::record::foxglove::ExistingFile;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Start time of recordings.
pub(crate) const BEGAN: u64 = 1_795_000_000_000;

/// A temporary file, removed on drop.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new() -> Scratch {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("consort-recording-{}-{}.mcap", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        Scratch(std::env::temp_dir().join(name))
    }

    pub(crate) fn holding(bytes: &[u8]) -> Scratch {
        let file = Scratch::new();
        fs::write(&file.0, bytes).unwrap();
        file
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

pub(crate) fn fleet() -> FleetId {
    FleetId::new("ward").unwrap()
}

pub(crate) fn recorder(file: &Path, existing: ExistingFile) -> RecordingWriter {
    RecordingWriter::create(file, existing, &fleet(), "recorder", BEGAN).unwrap()
}

fn empty() -> FleetModel {
    FleetModel::new("ward", "recorder", FloorPlan::default(), BEGAN)
}

/// Inputs with their times, and the models after each of them.
pub(crate) struct LiveRecording {
    pub(crate) file: Scratch,
    pub(crate) recorded: RecordingStats,
    /// Models as JSON with their times in milliseconds; the first model is empty.
    pictures: Vec<(u64, Value)>,
}

impl LiveRecording {
    /// Records inputs, each with its delay in milliseconds after the start of the recording.
    pub(crate) fn record(inputs: impl IntoIterator<Item = (u64, FleetInput)>) -> LiveRecording {
        let file = Scratch::new();
        let (mut writer, mut model) = (recorder(&file.0, ExistingFile::Keep), empty());
        let mut pictures = vec![(0, model.to_json())];
        for (after_ms, input) in inputs {
            let now_ms = BEGAN + after_ms;
            model.apply(&input, now_ms);
            writer.write_input(&input, &model, now_ms).unwrap();
            writer.flush_due(now_ms).unwrap();
            pictures.push((after_ms, model.to_json()));
        }
        let recorded = writer.finish().unwrap();
        LiveRecording { file, recorded, pictures }
    }

    /// Returns the model at an instant.
    pub(crate) fn at(&self, after_ms: u64) -> &Value {
        let until = self.pictures.partition_point(|(at, _)| *at <= after_ms);
        &self.pictures[until.saturating_sub(1)].1
    }

    /// Returns the time of the last input up to an instant.
    pub(crate) fn last_input_ms(&self, after_ms: u64) -> u64 {
        let until = self.pictures.partition_point(|(at, _)| *at <= after_ms);
        self.pictures[until.saturating_sub(1)].0
    }

    /// Returns the time of the last input.
    pub(crate) fn length_ms(&self) -> u64 {
        self.pictures.last().unwrap().0
    }
}

pub(crate) fn event(node: &str, sequence: u64, after_ms: u64, what: Value) -> FleetInput {
    let mut event = json!({ "node": node, "sequence": sequence, "at_ms": BEGAN + after_ms });
    event.as_object_mut().unwrap().extend(what.as_object().unwrap().clone());
    FleetInput::Event(Box::new(serde_json::from_value::<Event>(event).unwrap()))
}

pub(crate) fn beacon(node: &str, term: u64, since_ms: u64) -> FleetInput {
    let node: consort_protocol::ids::NodeId = node.parse().unwrap();
    FleetInput::Beacon(Beacon { node: node.clone(), term, voters: [node].into(), since_ms, cluster: None, wire: None })
}

pub(crate) fn body(robot: &str, x: f64) -> FleetInput {
    let telemetry = json!({
        "time": x, "pose": { "x_m": x, "y_m": 2.5, "yaw_rad": 0.5 }, "place": "Dock", "battery": 0.75, "able": true, "closed": [],
    });
    let (telemetry, feedback) =
        (serde_json::from_value(telemetry).unwrap(), [("done".to_owned(), Scalar::Number(x))].into());
    FleetInput::Telemetry { robot: robot.to_owned(), telemetry, feedback }
}

const HALL: &str = "{name: hall, walls: [[[0, 0], [12, 0]]], places: [{name: Dock, kind: dock, x_m: 6, y_m: 2.5}, \
    {name: IC Room 6, kind: room, x_m: 10, y_m: 5}], lanes: [{between: [Dock, IC Room 6]}], \
    doors: [{name: Lab door, on: [[Dock, IC Room 6]], opening_s: 1}]}";

pub(crate) fn map() -> FleetInput {
    view(Key::ViewMap, serde_json::to_value(LoadedMap::from(map::read(HALL, "hall.yaml").unwrap()).to_view()).unwrap())
}

pub(crate) fn robots(names: &[&str]) -> FleetInput {
    let node = |name: &&str| {
        json!({ "node": name, "seen_by": "s-1", "alive": true, "status": "alive", "age_ms": 20, "robot": {
            "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 0.5 }, "battery": 0.75,
            "discharge": 0.001, "useful_charge": 0.125, "speed": 0.5, "availability": "free", "estimator": "e" } })
    };
    view(
        Key::ViewFleet,
        json!({ "seen_by": "s-1", "age_ms": 5, "nodes": names.iter().map(node).collect::<Vec<_>>(), "ensembles": [] }),
    )
}

pub(crate) fn world(away: bool, door: &str) -> FleetInput {
    let nurse = json!({ "name": "Nia", "role": "nurse", "place": "IC Room 6", "away": away, "samples": ["blood"] });
    view(
        Key::ViewWorld,
        json!({ "seen_by": "s-1", "people": [nurse], "doors": [{ "name": "Lab door", "state": door }] }),
    )
}

pub(crate) fn missions(state: &str) -> FleetInput {
    missions_of(state, 0)
}

/// Returns the view of missions with this age.
pub(crate) fn missions_of(state: &str, age_ms: u64) -> FleetInput {
    let mission = json!({ "mission": "m-1", "detail": state, "parameters": { "room": "IC Room 6" }, "holders": { "r1": "ada" },
        "done": 3, "steps": 7, "submitted_at_ms": BEGAN });
    view(Key::ViewMissions, json!({ "seen_by": "s-1", "age_ms": age_ms, "missions": [mission] }))
}

pub(crate) fn view(key: Key, view: Value) -> FleetInput {
    FleetInput::View { key, view }
}
