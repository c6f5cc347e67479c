//! Reads of clients: linearizable, or from the copy of any node with its age.

use consort_protocol::ids::NodeId;
use consort_protocol::keys::{ApiCall, Key};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const SEEDS: [u64; 3] = [171, 172, 173];
const ROOM: &str = "IC Room 6";
const STATIONS: [&str; 3] = ["aster", "basil", "clove"];

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![RobotSpec::carrier("fern", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &STATIONS, &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn linearizable() -> Value {
    json!({ "linearizable": true })
}

/// Returns the coordinator and another station.
fn coordinator_and_other(fleet: &Fleet) -> (NodeId, NodeId) {
    let coordinator = fleet.coordinating().expect("a coordinator");
    let other = STATIONS.into_iter().find(|station| *station != coordinator.as_str()).expect("three stations");
    (coordinator, slug(other))
}

/// Isolates a node together with the client.
fn isolate(fleet: &Fleet, node: &NodeId) {
    fleet.network.partition([vec![node.clone(), slug("client")]]);
}

#[test]
fn a_linearizable_read_through_any_node_contains_what_was_acknowledged() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed).await;
        for number in 1..=5 {
            let mission = fleet.submit(&format!("r{number}"), ROOM).await;
            let lists = fleet.read_everywhere(ApiCall::List, &linearizable()).await;
            assert_eq!(lists.len(), fleet.running().len(), "seed {seed}: every node replies: {lists:?}");
            for list in &lists {
                let (missions, ledger) = (list["missions"].as_array().expect("missions"), &list["ledger"]);
                assert_eq!(missions.len(), number, "seed {seed}: {list}");
                assert_eq!((&ledger["linearizable"], &ledger["age_ms"]), (&json!(true), &json!(0)), "seed {seed}");
            }
            let query = json!({ "mission": mission, "linearizable": true });
            for (call, field) in [(ApiCall::Get, "detail"), (ApiCall::Explain, "state")] {
                let reply = fleet.request_answered(call, &query).await;
                assert!(reply[field].is_string(), "seed {seed}: {reply}");
                assert_eq!(reply["ledger"]["linearizable"], true, "seed {seed}: {reply}");
            }
        }
        let unknown = json!({ "mission": "lab-samples-9", "linearizable": true });
        let error = fleet.request_answered(ApiCall::Get, &unknown).await;
        assert_eq!(error["error"], "no mission lab-samples-9 is known; see api/list", "seed {seed}");
        assert_eq!(error.get("retry_after_ms"), None, "seed {seed}");
    });
}

#[test]
fn a_deposed_coordinator_answers_no_linearizable_read() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        fleet.submit("before", ROOM).await;
        let (coordinator, _) = coordinator_and_other(&fleet);
        isolate(&fleet, &coordinator);
        // At first it does not know that it is isolated, and the client does not know that other nodes are
        // out of reach.
        let mut replies = vec![];
        for _ in 0..10 {
            replies.extend(fleet.read_everywhere(ApiCall::List, &linearizable()).await);
        }
        assert!(!replies.is_empty(), "seed {seed}");
        for reply in replies {
            assert!(reply["retry_after_ms"].is_u64() && reply.get("missions").is_none(), "seed {seed}: {reply}");
        }
        let local = fleet.request_answered(ApiCall::List, &Value::Null).await;
        assert_eq!(local["missions"].as_array().map(Vec::len), Some(1), "seed {seed}: {local}");
        fleet.network.heal();
        fleet.wait_for_coordinator().await;
        fleet
            .poll_until("a linearizable read", Duration::from_secs(30), async |fleet| {
                let reply = fleet.request_answered(ApiCall::List, &linearizable()).await;
                reply["missions"].is_array().then_some(())
            })
            .await;
    });
}

/// The list is complete, or there is none: a person may cancel nothing else because of it.
#[test]
fn an_isolated_coordinator_lists_no_missions_to_cancel() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed).await;
        let mission = fleet.submit("before", ROOM).await;
        let dry_run = json!({ "missions": [mission], "dry_run": true, "by": "Nia" });
        let listed = fleet.request_answered(ApiCall::CancelMissions, &dry_run).await;
        assert!(listed["missions"].get(mission.as_str()).is_some(), "seed {seed}: {listed}");
        let (coordinator, _) = coordinator_and_other(&fleet);
        isolate(&fleet, &coordinator);
        // It still counts itself leader.
        assert_eq!(fleet.coordinating(), Some(coordinator), "seed {seed}");
        let replies = fleet.request_all(ApiCall::CancelMissions, &dry_run).await;
        assert!(replies.iter().all(|reply| reply.get("missions").is_none()), "seed {seed}: {replies:?}");
    });
}

#[test]
fn a_read_from_an_isolated_node_states_its_age() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed).await;
        fleet.submit("before", ROOM).await;
        let (_, other) = coordinator_and_other(&fleet);
        let age = async || {
            let list = fleet.request_answered(ApiCall::List, &Value::Null).await;
            assert_eq!(list["ledger"]["linearizable"], false, "seed {seed}: {list}");
            list["ledger"]["age_ms"].as_u64().expect("a node that follows knows the age")
        };
        let linked = age().await;
        assert!(linked < 1_000, "seed {seed}: {linked} ms while linked with the coordinator");
        isolate(&fleet, &other);
        let since = fleet.elapsed();
        let isolated = fleet
            .poll_until("a reply that is 20 s old", Duration::from_secs(60), async |fleet| {
                let list = fleet.request(ApiCall::List, &Value::Null).await?;
                let age = list["ledger"]["age_ms"].as_u64().filter(|age| *age >= 20_000)?;
                assert_eq!(list["seen_by"], json!(other), "seed {seed}: {list}");
                Some(Duration::from_millis(age))
            })
            .await;
        let elapsed = fleet.elapsed() - since;
        assert!(isolated.abs_diff(elapsed) < Duration::from_secs(1), "seed {seed}: {isolated:?} after {elapsed:?}");
        let reply = fleet.request_answered(ApiCall::List, &linearizable()).await;
        assert!(reply["retry_after_ms"].is_u64(), "seed {seed}: {reply}");
    });
}

/// The lookups of the mission get no reply, while those of the list of missions do: the links of a node
/// without a ledger have returned in between.
#[test]
fn a_mission_is_not_called_unknown_before_a_voter_has_replied() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed).await;
        let mission = fleet.submit("before", ROOM).await;
        for node in fleet.running() {
            let node: NodeId = slug(&node);
            let lookup = Key::Seen(node.clone(), Box::new(Key::ViewMission(slug(mission.as_str()))));
            fleet.network.block_queries(node, &fleet.keys().write(&lookup));
        }
        let replies = fleet.read_everywhere(ApiCall::Get, &json!({ "mission": mission })).await;
        let world = replies.iter().find(|reply| reply["seen_by"] == "world").expect("a reply of the world");
        assert!(world["retry_after_ms"].is_u64(), "seed {seed}: {world}");

        let replies = fleet.read_everywhere(ApiCall::Get, &json!({ "mission": "lab-samples-9" })).await;
        for reply in &replies {
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with("no mission lab-samples-9 is known at "), "seed {seed}: {reply}");
            assert_eq!(reply.get("retry_after_ms"), None, "seed {seed}: {reply}");
        }
    });
}
