//! Seeds of the targets: a valid input of each kind. Shipped examples are read from their own
//! folders.

mod fleet;
mod sample_messages;

use consort_protocol::versions::VersionRange;
use serde_json::json;
use std::fs;
use std::path::Path;

/// A line of each message of a driver.
const DRIVER_LINES: &str = r#"{"type":"hello","protocol":1,"driver":"test 1.0","actions":{"wait":{"parameters":{"seconds":{"type":"seconds"}},"example":{"seconds":2}}},"resumes":true}
{"type":"feedback","id":"7","distance_remaining_m":1.5,"time_remaining_s":3,"values":{"share":0.5,"phase":"rinse"}}
{"type":"result","id":"7","status":"aborted","code":"blocked","message":"a chair"}
{"type":"result","id":"1152921504606846976","status":"succeeded","results":{"dust_g":2.5,"full":true}}
{"type":"pose","x_m":1.25,"y_m":-3.5,"yaw_rad":0.1,"place":"IC Room 6"}
{"type":"charge","share":0.5,"able":false}
{"type":"readings","values":{"bag_g":120.5,"lid":true,"mode":"eco","cycles":-4}}
{"type":"heartbeat","sequence":18446744073709551615}
{"type":"error","message":"no such action"}
"#;

/// Returns the seeds of a target. None of them is rejected as a whole.
pub(crate) fn for_target(name: &str) -> Vec<Vec<u8>> {
    match name {
        "wire" => (VersionRange::OWN.oldest..=VersionRange::OWN.newest).flat_map(sample_messages::messages).collect(),
        "gossip" => sample_messages::gossip(),
        "raft" => sample_messages::raft(),
        "award" => sample_messages::awards(),
        "checkpoint" => sample_messages::checkpoints(),
        "ledger" => vec![sample_messages::commands()],
        "store" => vec![vec![]],
        "signed_envelope" => sample_messages::signed_envelopes(),
        // No edits: the issued certificate.
        "certificate" | "pem" => vec![vec![0]],
        "names" => texts(&[
            "consort://ward/node/ada?roles=robot,voter",
            "consort://ward/person/kim?scope=submit",
            "00112233445566778899aabbccddeeff",
            "consort/ward/wire/raft/0000000000abcdef/append",
            "consort/ward/seen/lab-1/view/mission/m-1",
            "consort/ward/api/submit/help",
            "IC Room 2",
        ]),
        "request" => [
            json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" }, "request": "my-7" }),
            json!({ "mission": fleet::template("lab-samples"), "priority": 7, "deadline_s": 60.5 }),
            json!({ "mission": "lab-samples-1", "by": "Nia" }),
        ]
        .map(|value| value.to_string().into_bytes())
        .into(),
        "mission_yaml" => files("skills/missions", ".yaml"),
        "mission_json" => fleet::TEMPLATES.iter().map(|name| fleet::template(name).to_string().into_bytes()).collect(),
        "ihtn" => vec![ihtn().to_string().into_bytes()],
        "domain" => ["plants", "vacuum"].map(|name| file(&format!("examples/{name}/domain.yaml"))).into(),
        "driver" => texts(&[DRIVER_LINES]),
        "map_yaml" => [files("sim_bridge/world/maps", "c.yaml"), files("tests/features/maps", ".yaml")].concat(),
        "map_json" => vec![file("nodes/consort/tests/data/ward_map.json"), fleet::map_in_json()],
        "drawing" => files("sim_bridge/map_import/maps", ".drawio"),
        "building" => files("sim_bridge/map_import/maps", ".building.yaml"),
        "layout" => files("sim_bridge/map_import/maps", ".lif"),
        "tree" => files("skills/domains", ".xml"),
        "condition" => texts(&[
            "member.robot || member.skills.exists(s, s in ensemble.skills)\ncoordinator.mains_powered",
            "member.name.startsWith('a') && size(member.skills) * 2 >= 0\nmember.battery > 0.2 || !member.free",
            "member.x_m - coordinator.x_m < 10.0 && {'a': [1, 2.5, b'x']}['a'].size() == 3",
        ]),
        "feature" => files("tests/features", ".feature"),
        "config" => {
            ["fleet", "robot", "arm", "station", "world"].map(|name| file(&format!("examples/{name}.toml"))).into()
        }
        "design" => files("sim_bridge/evaluation/designs", ".toml"),
        "calibration" => vec![file("examples/calibration.toml"), fleet::calibration()],
        "tables" => vec![
            file("examples/workers.toml"),
            file("nodes/consort/tests/data/ward_scenarios.json"),
            b"origin,dest,duration_s,estimate_s\nDock,IC Room 2,30.5,28\n".to_vec(),
            fleet::schedule(),
        ],
        "recording" => vec![fleet::recording()],
        "fleet_model" => vec![fleet::fleet_inputs()],
        "dashboard" => texts(&[
            "GET /api/events?after=1&kind=bid&mission=m-1&robot=ada&text=a%20b&limit=5",
            "GET /api/fleet",
            "GET /healthz",
        ]),
        other => panic!("{other} has no seeds"),
    }
}

/// Returns the seeds of a target; messages are encoded with this wire version.
pub(crate) fn at_version(wire: u8, name: &str) -> Vec<Vec<u8>> {
    match name {
        "wire" => sample_messages::messages(wire),
        other => for_target(other),
    }
}

fn texts(all: &[&str]) -> Vec<Vec<u8>> {
    all.iter().map(|text| text.as_bytes().to_vec()).collect()
}

/// Reads a file of the repository.
fn file(path: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    fs::read(&path).unwrap_or_else(|problem| panic!("{}: {problem}", path.display()))
}

/// Reads the files in a folder of the repository with this suffix.
fn files(folder: &str, ending: &str) -> Vec<Vec<u8>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(folder);
    let names = fs::read_dir(path).expect("a folder").map(|file| file.expect("a file").file_name());
    let names = names.map(|name| name.into_string().expect("a name"));
    let mut names: Vec<String> = names.filter(|name| name.ends_with(ending)).collect();
    names.sort();
    assert!(!names.is_empty(), "nothing in {folder} ends with {ending}");
    names.iter().map(|name| file(&format!("{folder}/{name}"))).collect()
}

fn ihtn() -> serde_json::Value {
    let action = |name: &str, agent: &str, locations: &[&str]| json!({ "name": name, "type": "action", "parent": "1", "agents": [agent], "locations": locations, "children": "" });
    json!({
        "0": { "name": "Fetch", "type": "task", "parent": "-1", "agents": ["r1", "nurse"], "children": ["1"] },
        "1": { "name": "m", "type": "method", "parent": "0", "agents": ["r1", "nurse"], "children": ["2", "3", "4", "5"] },
        "2": action("navto", "r1", &["Ward"]),
        "3": action("operate_drawer-open", "r1", &[]),
        "4": action("deposit", "nurse", &[]),
        "5": action("navto", "r1", &["Laboratory"]),
    })
}
