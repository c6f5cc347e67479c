//! Exchange of knowledge between the members of an ensemble.

use crate::support::received_of;
use consort_bus::Bus as _;
use consort_protocol::codec;
use consort_protocol::ensemble::EnsembleSpec;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, KeyKind};
use consort_protocol::knowledge::{Digest, DigestScope};
use consort_protocol::message::Exchange;
use consort_skills::domain_file::DomainFile;
use consort_tests::{DomainSetup, Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const SEEDS: [u64; 2] = [941, 942];
const SOON: Duration = Duration::from_secs(60);
/// Part of the attribute `code` of every robot, and of no other text.
const CODE: &[u8] = b"-code-";
const DOMAIN: &str = r#"{
    "domain": "cleaning",
    "readings": {
        "bag_g": { "type": "number", "simulate": { "value": 2 } },
        "lid": { "type": "bool", "simulate": { "value": true } }
    },
    "tasks": { "look": {
        "parameters": { "of": { "type": "text" } },
        "results": { "seen": { "type": "text" } },
        "tree": "look.xml",
        "estimate": { "time_s": "1.0" }
    } }
}"#;

/// The result is the code of another robot, if the tree can read its code and the dust in its bag.
const TREE: &str = r#"<root BTCPP_format="4" main_tree_to_execute="look">
  <BehaviorTree ID="look">
    <Fallback>
      <Sequence>
        <MemberValue ensemble="icu" robot="{of}" exchanged="readings.bag_g" maximum="5" value="{bag}"/>
        <MemberValue ensemble="icu" robot="{of}" exchanged="attributes.code" value="{code}"/>
        <ScriptCondition code="bag &gt; 1.0"/>
        <Script code="seen := code"/>
      </Sequence>
      <Script code="seen := 'unknown'"/>
    </Fallback>
  </BehaviorTree>
</root>"#;

/// Starts a fleet with an ensemble of these robots, which exchange an attribute and a reading.
async fn fleet(seed: u64, robots: Vec<RobotSpec>, condition: &str, closed: bool) -> Fleet {
    let form = serde_json::from_str(DOMAIN).expect("a domain");
    let trees = BTreeMap::from([("look.xml".to_owned(), TREE.to_owned())]);
    let domain = DomainFile::check(form, &trees, &[]).expect("a valid domain");
    let value = |text: &str| text.to_owned().try_into().expect("an exchanged value");
    let icu = EnsembleSpec {
        membership: vec!["member.robot".to_owned(), condition.to_owned()],
        exchange: ["attributes.code", "readings.bag_g"].map(value).into(),
        ..EnsembleSpec::with_any_skill_of(slug("icu"), BTreeSet::new())
    };
    let hospital = EnsembleSpec {
        membership: vec!["member.robot".to_owned()],
        ..EnsembleSpec::with_any_skill_of(slug("hospital"), BTreeSet::new())
    };
    let setup = DomainSetup { domain, ensembles: vec![icu, hospital], rooms: &[], closed };
    let mut fleet = Fleet::hospital_of_domain_setup(seed, robots, &["aster"], setup).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn robot(name: &str, place: &str, section: &str) -> RobotSpec {
    let code = format!("{name}-code-{}", name.len());
    RobotSpec::carrier(name, place).with_skill("look").with_attribute("section", section).with_attribute("code", &code)
}

/// Queries the values that the members exchange, under `view` or `seen/{node}`.
async fn exchanged(fleet: &Fleet, from: &str) -> Option<Value> {
    let key = format!("consort/ward/{from}/ensemble/icu");
    let mut replies = fleet.client.query(&key, vec![].into(), Duration::from_secs(1)).await.expect("a virtual bus");
    serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()
}

/// Waits until a node has the values of these robots.
async fn wait_for_values(fleet: &Fleet, from: &str, robots: &[&str]) -> Value {
    let all = async |fleet: &Fleet| {
        let view = exchanged(fleet, from).await?;
        let known: Vec<&String> = view["robots"].as_object()?.keys().collect();
        (known == robots).then_some(view)
    };
    fleet.poll_until(&format!("values of {robots:?} at {from}"), SOON, all).await
}

/// Returns the number of messages of the exchange that a node has received.
fn received(fleet: &Fleet, node: &str) -> u64 {
    received_of(fleet, node, KeyKind::Ensemble)
}

async fn drive(fleet: &mut Fleet, condition: &str, to: &str) -> MissionId {
    let mission = json!({
        "mission": "drive", "roles": { "r1": { "kind": "managed", "eligible": condition } },
        "root": { "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": to },
            "reaches": { "location": to } },
    });
    complete(fleet, &mission).await
}

async fn complete(fleet: &mut Fleet, mission: &Value) -> MissionId {
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
    let mission = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")));
    fleet.assert_completes(&mission).await;
    mission
}

/// Lets a robot read the values of another robot. Returns what its tree has read.
async fn look(fleet: &mut Fleet, robot: &str, of: &str) -> Value {
    let condition = format!("robot.name == '{robot}'");
    let mission = json!({
        "mission": "look", "roles": { "r1": { "kind": "managed", "eligible": condition } },
        "root": { "task": "see", "type": "look", "roles": ["r1"], "parameters": { "of": of } },
        "result": { "seen": "see.seen" },
    });
    let mission = complete(fleet, &mission).await;
    fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await["result"]["seen"].clone()
}

fn contains_code(payload: &[u8]) -> bool {
    payload.windows(CODE.len()).any(|part| part == CODE)
}

/// Subscribes a client to all messages, and collects the keys of those with a code.
async fn keys_with_codes(fleet: &Fleet) -> Arc<Mutex<BTreeSet<String>>> {
    let mut samples = fleet.client.subscribe("consort/ward/**").await.expect("a virtual bus");
    let found: Arc<Mutex<BTreeSet<String>>> = Arc::default();
    let keys = Arc::clone(&found);
    tokio::spawn(async move {
        while let Some(sample) = samples.recv().await {
            if contains_code(&sample.payload) {
                keys.lock().expect("no panic").insert(sample.key);
            }
        }
    });
    found
}

#[test]
fn members_receive_the_listed_values_and_others_nothing() {
    for (seed, closed) in [(SEEDS[0], false), (SEEDS[1], true)] {
        for_each_seed([seed], async |seed| {
            let robots =
                vec![robot("amber", "Dock", "icu"), robot("birch", "Dock", "icu"), robot("cedar", "Dock", "er")];
            let mut fleet = fleet(seed, robots, "member.attributes.section == 'icu'", closed).await;
            let of_both = async |fleet: &Fleet| {
                let view = exchanged(fleet, "seen/amber").await?;
                let is_read = |robot| view["robots"][robot]["readings"]["bag_g"].is_number();
                (is_read("amber") && is_read("birch")).then_some(view)
            };
            let view = fleet.poll_until("readings of both members", SOON, of_both).await;
            let readings = json!({ "bag_g": 2.0 });
            for robot in ["amber", "birch"] {
                let (values, attributes) = (&view["robots"][robot], json!({ "code": format!("{robot}-code-5") }));
                assert_eq!(
                    (&values["attributes"], &values["readings"]),
                    (&attributes, &readings),
                    "seed {seed}: {view}"
                );
                assert!(values["age_ms"].as_u64().is_some_and(|age| age < 6_000), "seed {seed}: {view}");
            }
            let before = received(&fleet, "birch");
            let since = |fleet: &Fleet| received(fleet, "birch") - before;
            fleet.assert_never("more than 8 messages", Duration::from_secs(30), |fleet| since(fleet) > 8).await;
            let after = since(&fleet);
            assert!(after >= 4, "seed {seed}: {after} messages in 30 s without a change");
            for other in ["cedar", "lab-arm", "aster", "world"] {
                assert_eq!(received(&fleet, other), 0, "seed {seed}: {other}");
                assert_eq!(exchanged(&fleet, &format!("seen/{other}")).await, None, "seed {seed}: {other}");
            }
            // Any node passes on the view of a member.
            let view = exchanged(&fleet, "view").await.expect("a reply");
            assert!(["amber", "birch"].map(Value::from).contains(&view["member"]), "seed {seed}: {view}");
        });
    }
}

#[test]
fn nodes_that_are_no_members_do_not_find_an_exchanged_attribute() {
    for_each_seed(SEEDS, async |seed| {
        let robots =
            vec![robot("amber", "Dock", "icu"), robot("hawthorn", "Dock", "icu"), robot("cedar", "Dock", "er")];
        let mut fleet = fleet(seed, robots, "member.attributes.section == 'icu'", false).await;
        let keys = keys_with_codes(&fleet).await;
        // The robot evaluates the condition on its own attributes. It publishes its record at each place.
        let mission = drive(&mut fleet, "robot.attributes.code.endsWith('8')", "IC Room 6").await;
        assert_eq!(fleet.all_holders(&mission), BTreeSet::from(["hawthorn".to_owned()]), "seed {seed}");
        let view = wait_for_values(&fleet, "seen/amber", &["amber", "hawthorn"]).await;
        assert_eq!(view["robots"]["hawthorn"]["attributes"], json!({ "code": "hawthorn-code-8" }), "seed {seed}");
        let exchange = ["amber", "hawthorn"].map(|robot| format!("consort/ward/wire/ensemble/icu/{robot}"));
        let exchange = BTreeSet::from(exchange);
        let on_exchange = async |_: &Fleet| keys.lock().expect("no panic").is_superset(&exchange).then_some(());
        fleet.poll_until("the codes on the keys of the exchange", SOON, on_exchange).await;
        for node in ["amber", "cedar", "aster"] {
            for robot in ["amber", "hawthorn", "cedar"] {
                let known = fleet.knowledge_of(node, &slug(robot)).expect("a record");
                let names: Vec<&String> = known.attributes.iter().map(|(name, _)| name).collect();
                assert_eq!(names, ["section"], "seed {seed}: {robot} as known to {node}");
            }
        }
        let views = fleet.view("fleet").await;
        let view = views.values().next().expect("a reply").to_string();
        assert!(view.contains("section") && !contains_code(view.as_bytes()), "seed {seed}: {view}");
        let request = Exchange { sums: vec![], scope: DigestScope::ALL, digest: Digest::new(), records: vec![] };
        let request = codec::encode_for_version(2, request).expect("a message");
        let key = "consort/ward/wire/gossip/cedar";
        let mut replies = fleet.client.query(key, request.into(), Duration::from_secs(1)).await.expect("a virtual bus");
        let reply = replies.recv().await.expect("a reply").payload.expect("the records that the client lacks");
        let records = codec::decode_any_version::<Exchange>(&reply).expect("an exchange").records;
        assert!(records.iter().any(|record| record.owner.as_str() == "hawthorn"), "seed {seed}: {records:?}");
        assert!(!contains_code(&reply), "seed {seed}: {records:?}");
        assert_eq!(*keys.lock().expect("no panic"), exchange, "seed {seed}: keys of all messages with a code");
    });
}

#[test]
fn a_robot_receives_values_only_while_it_is_a_member() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![robot("amber", "IC Room 6", "icu"), robot("birch", "Dock", "er")];
        let mut fleet = fleet(seed, robots, "member.place == 'IC Room 6'", false).await;
        wait_for_values(&fleet, "seen/amber", &["amber"]).await;
        assert_eq!((exchanged(&fleet, "seen/birch").await, received(&fleet, "birch")), (None, 0), "seed {seed}");
        drive(&mut fleet, "robot.name == 'birch'", "IC Room 6").await;
        wait_for_values(&fleet, "seen/birch", &["amber", "birch"]).await;
        wait_for_values(&fleet, "seen/amber", &["amber", "birch"]).await;
        drive(&mut fleet, "robot.name == 'birch'", "Dock").await;
        let left = async |fleet: &Fleet| exchanged(fleet, "seen/birch").await.is_none().then_some(());
        fleet.poll_until("the end of its membership", SOON, left).await;
        wait_for_values(&fleet, "seen/amber", &["amber"]).await;
        let before = received(&fleet, "birch");
        let receives = |fleet: &Fleet| received(fleet, "birch") != before;
        fleet.assert_never("a message without a subscription", Duration::from_secs(20), receives).await;
    });
}

#[test]
fn trees_of_members_read_the_values_of_other_members() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![robot("amber", "Dock", "icu"), robot("birch", "Dock", "icu"), robot("cedar", "Dock", "er")];
        let mut fleet = fleet(seed, robots, "member.attributes.section == 'icu'", false).await;
        let of_birch = async |fleet: &Fleet| {
            let view = exchanged(fleet, "seen/amber").await?;
            view["robots"]["birch"]["readings"]["bag_g"].is_number().then_some(())
        };
        fleet.poll_until("readings of birch at amber", SOON, of_birch).await;
        assert_eq!(look(&mut fleet, "amber", "birch").await, json!("birch-code-5"), "seed {seed}");
        assert_eq!(look(&mut fleet, "amber", "cedar").await, json!("unknown"), "seed {seed}: cedar is not a member");
        assert_eq!(look(&mut fleet, "cedar", "birch").await, json!("unknown"), "seed {seed}: cedar is not a member");
        fleet.kill("birch").await;
        wait_for_values(&fleet, "seen/amber", &["amber"]).await;
        assert_eq!(look(&mut fleet, "amber", "birch").await, json!("unknown"), "seed {seed}: birch has failed");
    });
}

#[test]
fn readings_of_a_silent_driver_are_unknown_to_the_other_members() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![robot("amber", "Dock", "icu"), robot("birch", "Dock", "icu")];
        let mut fleet = fleet(seed, robots, "member.attributes.section == 'icu'", false).await;
        let known = async |fleet: &Fleet| {
            let view = exchanged(fleet, "seen/amber").await?;
            view["robots"]["birch"]["readings"]["bag_g"].is_number().then_some(())
        };
        fleet.poll_until("readings of birch at amber", SOON, known).await;
        // This node executes the drivers of all robots.
        fleet.kill("world").await;
        let unknown = async |fleet: &Fleet| {
            let birch = exchanged(fleet, "seen/amber").await?["robots"]["birch"].clone();
            (birch["readings"] == json!({}) && birch["attributes"]["code"] == "birch-code-5").then_some(())
        };
        fleet.poll_until("attributes of birch without readings", SOON, unknown).await;
    });
}
