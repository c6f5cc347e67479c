//! Whoever has Zenoh has all of it: keys are written out here, as in any other language.

use crate::demo::each_once;
use crate::support::{Client, hospital, until};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

const LONG: Duration = Duration::from_secs(60);

fn names(list: &Value, key: &str) -> Vec<String> {
    let list = list.as_array().expect("a list");
    list.iter().filter_map(|entry| entry[key].as_str()).map(str::to_owned).collect()
}

#[test]
fn a_stock_client_sees_everything_and_has_a_mission_done_across_the_death_of_the_coordinator() {
    let mut fleet = hospital("stock");
    let mut client = Client::open(&fleet.address("world"), "stock");

    // Before anything is asked for: who is there, as each view and the presence tokens have it.
    let everyone = ["ada", "lab-arm", "station-1", "station-2", "station-3", "world"].map(str::to_owned).to_vec();
    until("all nodes are in the fleet's view, alive and judged", LONG, || {
        let nodes = client.view("fleet")["nodes"].clone();
        let alive = nodes.as_array()?.iter().all(|node| node["alive"] == true);
        (names(&nodes, "node") == everyone && alive).then_some(())
    });
    let coordinator = until("somebody coordinates", LONG, || {
        let view = client.view("coordinator");
        view["node"].is_string().then_some(view)
    });
    let (first, term) = (coordinator["node"].as_str().expect("a name").to_owned(), coordinator["term"].clone());
    assert!(first.starts_with("station-"), "{coordinator}");
    assert_eq!(client.view("fleet")["coordinator"], first.as_str());
    assert_eq!(client.view("missions")["missions"], json!([]));
    assert_eq!(client.view("auctions")["auctions"], json!([]));
    let robots = client.all("view/robot/*", "");
    let keys: Vec<&str> = robots.iter().map(|(key, _)| key.as_str()).collect();
    assert_eq!(BTreeSet::from_iter(keys.clone()), BTreeSet::from(["view/robot/ada", "view/robot/lab-arm"]));
    assert_eq!(keys.len(), 2, "each once: {keys:?}");
    assert_eq!(client.view("robot/ada")["robot"]["place"], "Dock");
    let mut present: BTreeSet<String> = everyone.iter().map(|node| format!("node/{node}")).collect();
    present.extend(["robot/ada", "robot/lab-arm"].map(str::to_owned));
    present.insert(format!("coordinator/{term}/{first}"));
    assert_eq!(client.present(), present);
    // Also for those who leave all settings as they are.
    let views = ["auctions", "coordinator", "ensembles", "fleet", "health", "map", "missions", "robot/ada", "world"];
    for view in views {
        assert!(client.view_by_default(view).is_object(), "{view}");
        // And for those who have all nodes asked: of several answers on one key Zenoh gives one.
        assert_eq!(client.asked_of_all_nodes(&format!("view/{view}")).len(), 1, "{view}");
    }
    let whole: BTreeSet<String> = client.all("view/**", "").into_iter().map(|(key, _)| key).collect();
    let expected = views.iter().chain(&["robot/lab-arm"]).map(|view| format!("view/{view}"));
    assert_eq!(whole, expected.collect());
    // Whoever wants to know what each node has asks for that.
    let seen: BTreeSet<String> = client.all("seen/*/coordinator", "").into_iter().map(|(key, _)| key).collect();
    assert_eq!(seen, everyone.iter().map(|node| format!("seen/{node}/coordinator")).collect());

    // What cannot be done is answered too.
    let refused = client.ask("api/submit", r#"{"mission": "nope"}"#);
    assert!(refused["error"].as_str().is_some_and(|text| text.contains("lab-samples")), "{refused}");
    let refused = client.ask("api/submit", "no JSON");
    assert!(refused["error"].is_string(), "{refused}");

    // A mission is asked for; the coordinator dies while it runs.
    let request = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "stock-1"}"#;
    assert_eq!(client.ask("api/submit", request), json!({ "mission": "lab-samples-1", "again": false }));
    client.hears("the mission's first task begins", LONG, |event| event["event"] == "task_began");
    fleet.kill(&first);
    let successor = client
        .hears("another node is elected", LONG, |event| event["event"] == "elected" && event["node"] != first.as_str());
    assert!(successor["term"].as_u64() > term.as_u64(), "{successor}");
    // What was acknowledged is not lost, and is not taken for something new.
    let again = until("the next coordinator answers", LONG, || {
        let answer = client.ask("api/submit", request);
        answer["error"].is_null().then_some(answer)
    });
    assert_eq!(again, json!({ "mission": "lab-samples-1", "again": true }));
    client.hears("the mission completes", LONG, |event| {
        event["event"] == "mission" && event["mission"] == "lab-samples-1" && event["state"] == "completed"
    });
    assert_eq!(client.tasks("lab-samples-1"), each_once());

    // The views of the new coordinator.
    let mission = client.view("mission/lab-samples-1");
    assert_eq!((&mission["state"], &mission["done"]), (&json!("completed"), &mission["steps"]), "{mission}");
    assert_eq!(names(&mission["roles"], "holder"), ["lab-arm", "ada"]);
    assert_eq!(names(&client.view("missions")["missions"], "state"), ["completed"]);
    let auctions = client.view("auctions");
    let record = &auctions["auctions"][0];
    assert_eq!(record["chosen"], json!({ "lab_arm": "lab-arm", "r1": "ada" }));
    // Each robot's answer for each role: a bid, or why there is none.
    assert_eq!(record["entries"].as_array().map(Vec::len), Some(4), "{record}");
    assert_eq!(client.view("world")["samples"][0]["place"], "Laboratory");
    assert_eq!(client.view("robot/ada")["robot"]["place"], "Laboratory");
    let now = client.view("coordinator");
    assert_ne!(now["node"], first.as_str());
    assert_eq!(client.view("fleet")["coordinator"], now["node"]);
    let token = format!("coordinator/{}/{}", now["term"], now["node"].as_str().expect("a name"));
    present.retain(|key| !key.ends_with(&first));
    present.insert(token);
    until("the dead node's tokens are gone", LONG, || (client.present() == present).then_some(()));

    // And back to the command line: it tells the same.
    let said = fleet.run(&["missions", "--json"], "ada").expect(0).json();
    assert_eq!(said["missions"], client.view("missions")["missions"]);
    fleet.stop();
}
