//! A plain Zenoh client can use everything: the keys are written out here, as in any other
//! language.

use crate::demo::each_once;
use crate::support::{Client, LONG, VIEWS, hospital, until};
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn names(list: &Value, key: &str) -> Vec<String> {
    let list = list.as_array().expect("a list");
    list.iter().filter_map(|entry| entry[key].as_str()).map(str::to_owned).collect()
}

#[test]
fn a_plain_zenoh_client_runs_a_mission_through_a_takeover() {
    let mut fleet = hospital("stock");
    let mut client = Client::open(&fleet.address("world"), "stock");

    // Before the first request: the nodes in each view and in the presence tokens.
    let everyone = ["ada", "lab-arm", "station-1", "station-2", "station-3", "world"].map(str::to_owned).to_vec();
    until("all nodes are in the fleet's view, alive and judged", LONG, || {
        let nodes = client.view("fleet")["nodes"].clone();
        let alive = nodes.as_array()?.iter().all(|node| node["alive"] == true);
        (names(&nodes, "node") == everyone && alive).then_some(())
    });
    let coordinator = until("there is a coordinator", LONG, || {
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
    // Also for clients that leave all settings at their defaults.
    for view in VIEWS {
        assert!(client.view_by_default(view).is_object(), "{view}");
        // Also for clients that query all nodes: of several replies on the same key Zenoh returns
        // one.
        assert_eq!(client.query_all_nodes(&format!("view/{view}")).len(), 1, "{view}");
    }
    let whole: BTreeSet<String> = client.all("view/**", "").into_iter().map(|(key, _)| key).collect();
    assert_eq!(whole, VIEWS.iter().map(|view| format!("view/{view}")).collect());
    // The views of each single node have their own keys.
    let seen: BTreeSet<String> = client.all("seen/*/coordinator", "").into_iter().map(|(key, _)| key).collect();
    assert_eq!(seen, everyone.iter().map(|node| format!("seen/{node}/coordinator")).collect());

    // Impossible requests are answered too.
    let refused = client.request("api/submit", r#"{"mission": "nope"}"#);
    assert!(refused["error"].as_str().is_some_and(|text| text.contains("lab-samples")), "{refused}");
    let refused = client.request("api/submit", "no JSON");
    assert!(refused["error"].is_string(), "{refused}");

    // Submits a mission and kills the coordinator while it runs.
    let request = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "stock-1"}"#;
    assert_eq!(client.request("api/submit", request), json!({ "mission": "lab-samples-1", "again": false }));
    client.wait_for_event("the mission's first task begins", LONG, |event| event["event"] == "task_began");
    fleet.kill(&first);
    let successor = client.wait_for_event("another node is elected", LONG, |event| {
        event["event"] == "elected" && event["node"] != first.as_str()
    });
    assert!(successor["term"].as_u64() > term.as_u64(), "{successor}");
    // The acknowledged mission is not lost and not treated as new.
    let again = until("the next coordinator replies", LONG, || {
        let answer = client.request("api/submit", request);
        answer["error"].is_null().then_some(answer)
    });
    assert_eq!(again, json!({ "mission": "lab-samples-1", "again": true }));
    client.wait_for_event("the mission completes", LONG, |event| {
        event["event"] == "mission" && event["mission"] == "lab-samples-1" && event["state"] == "completed"
    });
    assert_eq!(client.tasks("lab-samples-1"), each_once());

    // Views of the new coordinator.
    let mission = client.view("mission/lab-samples-1");
    assert_eq!((&mission["state"], &mission["done"]), (&json!("completed"), &mission["steps"]), "{mission}");
    assert_eq!(names(&mission["roles"], "holder"), ["lab-arm", "ada"]);
    assert_eq!(names(&client.view("missions")["missions"], "state"), ["completed"]);
    let auctions = client.view("auctions");
    let record = &auctions["auctions"][0];
    assert_eq!(record["chosen"], json!({ "lab_arm": "lab-arm", "r1": "ada" }));
    // Reply of each robot for each role: a bid or a refusal.
    assert_eq!(record["entries"].as_array().map(Vec::len), Some(4), "{record}");
    assert_eq!(client.view("world")["samples"][0]["place"], "Laboratory");
    assert_eq!(client.view("robot/ada")["robot"]["place"], "Laboratory");
    let now = client.view("coordinator");
    assert_ne!(now["node"], first.as_str());
    assert_eq!(client.view("fleet")["coordinator"], now["node"]);
    let token = format!("coordinator/{}/{}", now["term"], now["node"].as_str().expect("a name"));
    present.retain(|key| !key.ends_with(&first));
    present.insert(token);
    fleet.wait_for_removed_tokens(&client, &first);
    let of_others = || client.present().into_iter().filter(|key| !key.ends_with(&first)).collect::<BTreeSet<_>>();
    until("all other nodes are present", LONG, || (of_others() == present).then_some(()));

    // The command line shows the same.
    let output = fleet.run(&["missions", "--json"], "ada").expect(0).json();
    assert_eq!(output["missions"], client.view("missions")["missions"]);
    fleet.stop();
}
