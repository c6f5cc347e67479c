//! The main job with the example files, a process per node, and the commands of a client.

use crate::support::{Client, Fleet, Folder, LONG, Program, example, free_port, until};
use serde_json::{Value, json};

fn mission<'a>(missions: &'a Value, id: &str) -> &'a Value {
    let all = missions["missions"].as_array().expect("a list");
    all.iter().find(|entry| entry["mission"] == id).unwrap_or_else(|| panic!("{id} is not in {missions}"))
}

/// Returns mission, role and robot of all held roles, from the fleet view.
fn held(fleet: &Value) -> Vec<(Value, Value, Value)> {
    let nodes = fleet["fleet"]["nodes"].as_array().expect("a list").iter().filter(|node| node["holds"].is_object());
    nodes.map(|node| (node["holds"]["mission"].clone(), node["holds"]["role"].clone(), node["node"].clone())).collect()
}

/// Returns the same data from the missions view.
fn holders(missions: &Value) -> Vec<(Value, Value, Value)> {
    let running = missions["missions"].as_array().expect("a list").iter().filter(|entry| entry["state"] == "running");
    let mut all: Vec<_> = running
        .flat_map(|entry| {
            let holders = entry["holders"].as_object().expect("roles");
            holders.iter().map(|(role, robot)| (entry["mission"].clone(), json!(role), robot.clone()))
        })
        .collect();
    all.sort_by_key(|(_, _, robot)| robot.to_string());
    all
}

/// Returns the holders of roles that have ended, from the mission views.
fn ended(client: &Client, missions: &Value) -> Vec<(Value, Value, Value)> {
    let carried_out = |(mission, role, _): &(Value, Value, Value)| {
        let view = client.view(&format!("mission/{}", mission.as_str().expect("a name")));
        let mut roles = view["roles"].as_array().expect("roles").iter();
        roles.any(|entry| entry["role"] == *role && entry["phase"] == "ended")
    };
    holders(missions).into_iter().filter(carried_out).collect()
}

#[test]
fn commands_submit_watch_and_cancel_missions_of_the_example_fleet() {
    let mut fleet = Fleet::new(&example("fleet"));
    let data = fleet.path("station-1-data").display().to_string();
    let mut station = example("station");
    station.insert("data_dir".to_owned(), data.clone().into());
    station.insert("archive".to_owned(), toml::Table::new().into());
    fleet.start("station", station, &[]);
    let mut world = example("world");
    world.insert("speed".to_owned(), 20.0.into());
    fleet.start("world", world, &["station-1"]);
    fleet.start("robot", example("robot"), &["station-1", "world"]);
    fleet.start("robot", example("arm"), &["station-1", "world"]);

    // Runs a mission to its end and compares the views meanwhile.
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--request", "order-1"];
    let mut waiting = fleet.begin(&[&submit[..], &["--wait"]].concat(), "world");
    let client = Client::open(&fleet.address("world"), "ward");
    let mut agreed = 0;
    while !waiting.has_ended() {
        let before = fleet.run(&["missions", "--json"], "ada").expect(0).json();
        let ended_before = ended(&client, &before);
        let seen = fleet.run(&["fleet", "--json"], "station-1").expect(0).json();
        let ended_after = ended(&client, &before);
        let after = fleet.run(&["missions", "--json"], "lab-arm").expect(0).json();
        let held_roles = holders(&before);
        if held_roles == holders(&after) && !held_roles.is_empty() && ended_before == ended_after {
            // An ended role is no longer held but still listed with its mission. This is the only
            // difference.
            let left: Vec<_> = held_roles.into_iter().filter(|role| !ended_before.contains(role)).collect();
            assert_eq!(held(&seen), left, "\n{seen}\n{before}");
            agreed += 1;
        }
    }
    let ended = waiting.end(LONG).expect(0);
    assert_eq!(
        ended.stdout.lines().collect::<Vec<_>>(),
        ["lab-samples-1", "lab-samples-1 completed"],
        "{}",
        fleet.logs()
    );
    assert!(agreed > 0, "the mission was never seen while it ran");

    // All nodes are there with the settings of the files.
    let seen = fleet.run(&["fleet", "--json"], "world").expect(0).json();
    let nodes = seen["fleet"]["nodes"].as_array().expect("a list");
    let alive: Vec<&str> =
        nodes.iter().filter(|node| node["alive"] == true).filter_map(|node| node["node"].as_str()).collect();
    assert_eq!(alive, ["ada", "lab-arm", "station-1", "world"]);
    assert_eq!(seen["fleet"]["coordinator"], seen["coordinator"]["node"]);
    let mut voters: Vec<&str> =
        seen["coordinator"]["voters"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    voters.sort_unstable();
    assert_eq!(voters, ["ada", "lab-arm", "station-1"]);
    assert_eq!(held(&seen), [], "the mission is over");
    let ada = nodes.iter().find(|node| node["node"] == "ada").expect("ada");
    assert_eq!(ada["robot"]["place"], "Laboratory");

    // The same request returns the same mission.
    let again = fleet.run(&[&submit[..], &["--json"]].concat(), "ada").expect(0).json();
    let expected = json!({ "mission": "lab-samples-1", "again": true, "outcome": "completed", "request": "order-1" });
    assert_eq!(again, expected);

    // A mission without suitable robots waits and reports the reason; it can be canceled once.
    let pending = fleet.run(&["submit", "bed-transfer", "--json"], "ada").expect(0).json();
    let request = pending["request"].as_str().expect("a request that was not named is").to_owned();
    assert_eq!(pending, json!({ "mission": "bed-transfer-2", "again": false, "request": request }));
    let again = fleet.run(&["submit", "bed-transfer", "--json", "--request", &request], "world").expect(0).json();
    assert_eq!(again, json!({ "mission": "bed-transfer-2", "again": true, "request": request }));
    until("the auction of bed-transfer-2 has a reason of failure", LONG, || {
        let missions = fleet.run(&["missions", "--json"], "world").expect(0).json();
        let entry = mission(&missions, "bed-transfer-2");
        assert_eq!(entry["state"], "pending");
        entry["pending_reason"].is_string().then_some(())
    });
    let output = fleet.run(&["cancel", "bed-transfer-2", "--by", "ward 3"], "station-1").expect(0).stdout;
    assert_eq!(output, "bed-transfer-2 canceled: by ward 3\n");
    let missions = fleet.run(&["missions", "--json"], "ada").expect(0).json();
    assert_eq!(mission(&missions, "bed-transfer-2")["state"], "canceled");
    assert_eq!(mission(&missions, "lab-samples-1")["state"], "completed");
    assert_eq!(missions["missions"].as_array().map(Vec::len), Some(2), "{missions}");

    // An ended mission keeps its state; an unknown mission is reported.
    let output = fleet.run(&["cancel", "lab-samples-1"], "ada").expect(1).stderr;
    assert!(output.contains("lab-samples-1") && output.contains("completed"), "{output}");
    let output = fleet.run(&["cancel", "lab-samples-9"], "ada").expect(1).stderr;
    assert!(output.contains("lab-samples-9"), "{output}");

    // The station has archived what happened, each mission once.
    let export = ["history", "export", "--data-dir", &data, "--format", "json"];
    let is_cancel = |record: &Value| {
        let change = &record["content"]["audit"];
        change["action"] == "cancel" && change["by"] == "ward 3"
    };
    let archived = until("the cancellation is in the archive", LONG, || {
        let records = fleet.tool(&export).expect(0).json_lines();
        records.iter().any(is_cancel).then_some(records)
    });
    let of_kind = |kind: &'static str| archived.iter().map(move |record| &record["content"][kind]);
    let missions: Vec<_> = of_kind("mission")
        .filter(|ended| ended.is_object())
        .map(|ended| json!([ended["mission"], ended["state"]]))
        .collect();
    let canceled = json!({ "canceled": { "by": "ward 3" } });
    assert_eq!(missions, [json!(["lab-samples-1", "completed"]), json!(["bed-transfer-2", canceled])]);
    let is_award =
        |auction: &Value| auction["auction"]["mission"] == "lab-samples-1" && auction["chosen"]["r1"] == "ada";
    assert!(of_kind("auction").any(is_award), "{archived:#?}");
    let is_of_ada = |report: &Value| report["node"] == "ada" && report["event"]["task"] == "navto_lab";
    assert!(of_kind("report").any(is_of_ada), "{archived:#?}");
    let export = ["history", "export", "--data-dir", &data, "--kind", "mission", "--mission", "lab-samples-1"];
    let csv = fleet.tool(&export).expect(0).stdout;
    let lines: Vec<&str> = csv.lines().collect();
    assert!(lines.len() == 2 && lines[1].contains(",mission,lab-samples-1,"), "{csv}");

    fleet.stop();
}

#[test]
fn an_unreachable_fleet_is_reported() {
    let folder = Folder::new();
    let address = format!("tcp/127.0.0.1:{}", free_port());
    let arguments = ["missions", "--connect", &address, "--timeout", "1"];
    let ended = Program::start(&folder, "missions", &arguments).end(LONG).expect(3);
    assert!(ended.stderr.contains(&format!("no node answers at {address}")), "{}", ended.stderr);
}
