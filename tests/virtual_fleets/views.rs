//! Views of a fleet for any client.

use crate::support::{fleet, request, task_began};
use consort_bus::{Bus, VirtualBus};
use consort_protocol::api::{
    AlarmsReply, AnswerReply, ClosuresReply, ErrorReply, ExplainReply, HelpReply, LimitsReply, MissionChangeReply,
    OrdersReply, ScheduleReply, UpgradeReply,
};
use consort_protocol::event::EventKind;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_protocol::view::{
    AuctionsView, AuditView, CoordinatorView, EnsemblesView, FleetView, HealthView, ListPart, MapView, MissionView,
    MissionsView, RequestsView, RobotView, SchedulesView, WithProvenance,
};
use consort_raft::store::Backup;
use consort_skills::domain_file::DomainFile;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::WorldReport;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

const SEEDS: [u64; 2] = [121, 122];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

#[test]
fn every_view_has_a_single_reply_with_the_current_state() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began("deposit");
        fleet.wait_until("the deposit", SOON, |fleet| fleet.has_event(&began)).await;
        // The state of robots arrives by gossip.
        let holding = async |fleet: &Fleet| {
            let views = fleet.view("**").await;
            let mut tasks = BTreeMap::new();
            elementary(&views["mission/lab-samples-1"]["tree"], &mut tasks);
            let holding = views["robot/gorse"]["robot"]["availability"]["holding"]["role"] == "r1";
            (holding && tasks["deposit"] == "under_way").then_some(views)
        };
        let views = fleet
            .poll_until("gorse's word that it holds r1, and the deposit under way", Duration::from_secs(2), holding)
            .await;
        let names: Vec<&str> = views.keys().map(String::as_str).collect();
        let expected = [
            "auctions",
            "audit",
            "coordinator",
            "ensembles",
            "fleet",
            "health",
            "map",
            "mission/lab-samples-1",
            "missions",
            "requests",
            "robot/fern",
            "robot/gorse",
            "robot/lab-arm",
            "schedules",
            "world",
        ];
        assert_eq!(names, expected, "seed {seed}");

        let coordinator = &views["coordinator"];
        assert_eq!((&coordinator["node"], &coordinator["term"]), (&json!("aster"), &json!(1)), "seed {seed}");
        let voters: BTreeSet<&str> =
            coordinator["voters"].as_array().expect("a list").iter().filter_map(|voter| voter.as_str()).collect();
        assert_eq!(voters, BTreeSet::from(["aster", "basil", "clove", "fern", "lab-arm"]), "seed {seed}");

        let freeze = json!({ "robots": "stop", "places": [], "closes": [] });
        let declared = &views["fleet"]["declared"];
        assert_eq!(declared["alarms"]["freeze"], freeze, "seed {seed}");
        assert_eq!(declared["hash"].as_str().map(str::len), Some(16), "seed {seed}: {declared}");
        let nodes = views["fleet"]["nodes"].as_array().expect("a list");
        let alive: Vec<&str> =
            nodes.iter().filter(|node| node["alive"] == true).filter_map(|node| node["node"].as_str()).collect();
        let all = ["aster", "basil", "clove", "fern", "gorse", "lab-arm", "world"];
        assert_eq!(alive, all, "seed {seed}: alive");
        let ensemble = &views["fleet"]["ensembles"][0];
        assert_eq!(ensemble["name"], "logistics", "seed {seed}");
        let members: Vec<&str> = ensemble["nodes"]
            .as_array()
            .expect("a list")
            .iter()
            .filter(|node| node["member"] == true)
            .filter_map(|node| node["node"].as_str())
            .collect();
        assert_eq!(members, ["fern", "gorse", "lab-arm"], "seed {seed}: members");

        let gorse = &views["robot/gorse"];
        let held = (&gorse["holds"]["mission"], &gorse["holds"]["role"]);
        assert_eq!(held, (&json!(mission), &json!("r1")), "seed {seed}: {gorse}");
        assert_eq!(views["robot/fern"]["holds"], json!(null), "seed {seed}");
        assert_eq!(views["robot/fern"]["robot"]["availability"], "free", "seed {seed}");

        let shown = &views["mission/lab-samples-1"];
        assert_eq!(shown["state"], "running", "seed {seed}");
        let roles: Vec<_> = shown["roles"].as_array().expect("a list").iter().collect();
        let holding = |role: &Value| {
            let text = |field: &str| role[field].as_str().unwrap_or("-").to_owned();
            (text("role"), text("kind"), text("holder"))
        };
        let holding: Vec<_> = roles.into_iter().map(holding).collect();
        let line = |role: &str, kind: &str, holder: &str| (role.to_owned(), kind.to_owned(), holder.to_owned());
        assert_eq!(
            holding,
            [line("lab_arm", "managed", "lab-arm"), line("nurse", "unmanaged", "-"), line("r1", "managed", "gorse")],
            "seed {seed}"
        );
        assert_eq!(views["missions"]["missions"][0]["done"], shown["done"], "seed {seed}");
        assert_eq!(views["auctions"]["auctions"][0]["chosen"], json!({ "lab_arm": "lab-arm", "r1": "gorse" }));

        // In the tree, the awaited task is under way, earlier tasks are done, and later tasks are
        // waiting.
        let mut tasks = BTreeMap::new();
        elementary(&shown["tree"], &mut tasks);
        assert_eq!(tasks["navto_room"], "done", "seed {seed}: {tasks:?}");
        assert_eq!(tasks["deposit"], "under_way", "seed {seed}: {tasks:?}");
        assert_eq!(tasks["navto_lab"], "waiting", "seed {seed}: {tasks:?}");
        assert_eq!(shown["tree"]["state"], "under_way", "seed {seed}");

        let ensemble = &views["ensembles"]["ensembles"][0];
        assert_eq!(ensemble["members"], json!(["fern", "gorse", "lab-arm"]), "seed {seed}");
        let why = ensemble["not_members"]["aster"].as_str().expect("a reason");
        assert!(why.contains("member.robot"), "seed {seed}: {why}");
        let why = &views["auctions"]["auctions"][0]["explanation"]["roles"][1];
        assert_eq!((&why["role"], &why["winner"]), (&json!("r1"), &json!("gorse")), "seed {seed}: {why}");
        let places = views["map"]["places"].as_array().expect("places");
        let room = places.iter().find(|place| place["name"] == ROOM).expect("the room");
        assert!(room["x_m"].is_f64() && room["y_m"].is_f64(), "seed {seed}: {room}");
        assert_eq!(views["health"]["level"], "ok", "seed {seed}: {}", views["health"]);
        for (name, view) in &views {
            assert!(view["seen_by"].is_string() && view["age_ms"].is_u64(), "seed {seed}: {name}: {view}");
            assert_eq!((&view["coordinator"], &view["term"]), (&json!("aster"), &json!(1)), "seed {seed}: {name}");
        }
    });
}

/// Any node gets the readings of a robot from the robot's node. Records do not contain them.
#[test]
fn the_view_of_a_robot_contains_its_readings() {
    let domain = r#"{
        "domain": "cleaning",
        "readings": {
            "bag_g": { "type": "number", "simulate": { "value": 2 } },
            "lid": { "type": "bool", "simulate": { "value": true } }
        }
    }"#;
    for_each_seed([123], async |seed| {
        let form = serde_json::from_str(domain).expect("a domain");
        let domain = DomainFile::check(form, &BTreeMap::new(), &[]).expect("a valid domain");
        let members = ["fern", "gorse"].map(|name| RobotSpec::carrier(name, "Dock")).to_vec();
        let mut fleet = Fleet::hospital_of_domain(seed, members, &["aster"], domain).await;
        fleet.wait_for_coordinator().await;
        let readings = json!({ "bag_g": 2.0, "lid": true });
        for from in ["view", "seen/aster", "seen/gorse"] {
            // Another node shows the readings in `view` only.
            let expected = if from == "seen/aster" { &Value::Null } else { &readings };
            let key = format!("{from}/robot/gorse");
            let shown = async |fleet: &Fleet| {
                let (views, _) = query_views(&fleet.client, &format!("consort/ward/{key}")).await;
                views.get(&key).filter(|view| view["readings"] == *expected).cloned()
            };
            let view = fleet.poll_until(&format!("{key} with {expected}"), SOON, shown).await;
            assert_eq!(view["node"], "gorse", "seed {seed}");
            check_type::<RobotView>(&key, &view);
        }
        // A key expression for robots shows the readings of all of them; a wider one queries no other node.
        for (expression, expected) in [("robot/*", &readings), ("**", &Value::Null)] {
            let views = fleet.view(expression).await;
            for robot in ["fern", "gorse"] {
                let view = &views[&format!("robot/{robot}")];
                let is_own = view["seen_by"] == robot;
                assert!(view["readings"] == *expected || is_own, "seed {seed}: {expression}: {view}");
            }
        }
        let record = fleet.knowledge_of("aster", &slug("gorse")).expect("a record");
        let record = serde_json::to_string(&record).expect("JSON");
        assert!(!record.contains("bag_g"), "seed {seed}: {record}");
        // Without the robot's node there is still a view.
        fleet.kill("gorse").await;
        let shown = async |fleet: &Fleet| {
            let views = fleet.view("robot/gorse").await;
            views.get("robot/gorse").is_some_and(|view| view["readings"].is_null()).then_some(())
        };
        fleet.poll_until("a view without readings", SOON, shown).await;
    });
}

/// The feedback that an action declares is in the view of its robot while a goal is in progress.
#[test]
fn the_view_of_a_robot_contains_the_feedback_of_its_goal() {
    let domain = r#"{
        "domain": "laundry",
        "actions": {
            "soak": {
                "feedback": { "soaked": { "type": "number", "minimum": 0, "maximum": 1 } },
                "simulate": { "duration_s": [40, 40] }
            }
        },
        "tasks": { "soak": { "action": "soak" } }
    }"#;
    for_each_seed([124], async |seed| {
        let form = serde_json::from_str(domain).expect("a domain");
        let domain = DomainFile::check(form, &BTreeMap::new(), &[]).expect("a valid domain");
        let members = vec![RobotSpec::carrier("gorse", "Dock").with_skill("soak")];
        let mut fleet = Fleet::hospital_of_domain(seed, members, &["aster"], domain).await;
        fleet.wait_for_coordinator().await;
        let none = json!({});
        fleet.poll_until("no feedback", SOON, async |fleet| feedback(fleet).await.filter(|now| *now == none)).await;
        let mission = json!({
            "mission": "wash", "roles": { "r1": { "kind": "managed" } },
            "root": { "task": "soak", "type": "soak", "roles": ["r1"] },
        });
        let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission })).await;
        let id = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}")));
        let soaked = async |fleet: &Fleet, above: f64| {
            let soaked = feedback(fleet).await?["soaked"].as_f64()?;
            (above < soaked && soaked < 1.0).then_some(soaked)
        };
        let first = fleet.poll_until("feedback", SOON, async |fleet| soaked(fleet, 0.0).await).await;
        fleet.poll_until("later feedback", SOON, async |fleet| soaked(fleet, first).await).await;
        let state = fleet.wait_for_end(&id).await;
        assert_eq!(state, MissionState::Completed, "seed {seed}");
        fleet.poll_until("no feedback", SOON, async |fleet| feedback(fleet).await.filter(|now| *now == none)).await;
    });
}

/// Returns the feedback in the view of a robot.
async fn feedback(fleet: &Fleet) -> Option<Value> {
    Some(fleet.view("robot/gorse").await.get("robot/gorse")?["feedback"].clone())
}

/// Reads a value by its type, and checks that writing it again gives the same value.
fn check_type<T: Serialize + DeserializeOwned>(name: &str, value: &Value) {
    let read: T = serde_json::from_value(value.clone()).unwrap_or_else(|problem| panic!("{name}: {problem}: {value}"));
    assert_eq!(&serde_json::to_value(read).expect("JSON"), value, "{name}");
}

/// Checks the type of a view.
fn check_view(name: &str, view: &Value) {
    match name.split('/').next().unwrap_or_default() {
        "fleet" => check_type::<WithProvenance<FleetView>>(name, view),
        "robot" => check_type::<RobotView>(name, view),
        "ensembles" => check_type::<WithProvenance<EnsemblesView>>(name, view),
        "coordinator" => check_type::<WithProvenance<CoordinatorView>>(name, view),
        "requests" => check_type::<WithProvenance<RequestsView>>(name, view),
        "schedules" => check_type::<WithProvenance<SchedulesView>>(name, view),
        "audit" => check_type::<WithProvenance<AuditView>>(name, view),
        "missions" => check_type::<WithProvenance<MissionsView>>(name, view),
        "mission" => check_type::<WithProvenance<MissionView>>(name, view),
        "auctions" => check_type::<WithProvenance<AuctionsView>>(name, view),
        "health" => check_type::<WithProvenance<HealthView>>(name, view),
        "world" => check_type::<WithProvenance<WorldReport>>(name, view),
        "map" => check_type::<WithProvenance<MapView>>(name, view),
        _ => panic!("{name} has no type"),
    }
}

#[test]
fn views_and_replies_contain_exactly_the_fields_of_their_types() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began("deposit");
        fleet.wait_until("the deposit", SOON, |fleet| fleet.has_event(&began)).await;
        fleet.submit("b", ROOM).await;
        let schedule =
            json!({ "schedule": "a", "action": "add", "cron": "0 8 * * *", "submit": { "mission": "vital-signs" } });
        let reply = fleet.request_answered(ApiCall::Schedule, &schedule).await;
        check_type::<ScheduleReply>("schedule", &reply);
        assert_ne!(reply["schedule"], Value::Null, "seed {seed}: {reply}");
        fleet.view("**").await.iter().for_each(|(name, view)| check_view(name, view));
        let ask = async |call: ApiCall, payload: Value| fleet.request_answered(call, &payload).await;
        let named = json!({ "mission": mission });
        check_type::<WithProvenance<MissionView>>("get", &ask(ApiCall::Get, named.clone()).await);
        check_type::<WithProvenance<MissionsView>>("list", &ask(ApiCall::List, Value::Null).await);
        check_type::<WithProvenance<SchedulesView>>("schedules", &ask(ApiCall::Schedules, Value::Null).await);
        check_type::<WithProvenance<AuditView>>("audit", &ask(ApiCall::Audit, Value::Null).await);
        let orders = json!({ "robots": ["fern"] });
        check_type::<OrdersReply>("hold", &ask(ApiCall::Hold, orders.clone()).await);
        check_type::<OrdersReply>("release", &ask(ApiCall::Release, orders).await);
        let places = json!({ "places": ["PC Room 1"] });
        let reply = ask(ApiCall::Close, places.clone()).await;
        check_type::<ClosuresReply>("close", &reply);
        assert_eq!(reply["closures"].as_array().map(Vec::len), Some(1), "seed {seed}: {reply}");
        check_type::<ClosuresReply>("open", &ask(ApiCall::Open, places).await);
        let limit = json!({ "places": ["PC Room 1"], "action": "set", "speed_mps": 0.5 });
        let reply = ask(ApiCall::Limit, limit).await;
        check_type::<LimitsReply>("limit", &reply);
        assert_eq!(reply["speed_limits"][0]["speed_mps"], json!(0.5), "seed {seed}: {reply}");
        let alarm = ask(ApiCall::Alarm, json!({ "action": "raise", "alarm": "freeze" })).await;
        check_type::<AlarmsReply>("alarm", &alarm);
        assert_eq!(alarm["alarms"].as_array().map(Vec::len), Some(1), "seed {seed}: {alarm}");
        fleet.view("fleet").await.iter().for_each(|(name, view)| check_view(name, view));
        check_type::<AlarmsReply>("alarm", &ask(ApiCall::Alarm, json!({ "action": "clear" })).await);
        check_type::<WithProvenance<ExplainReply>>("explain", &ask(ApiCall::Explain, named.clone()).await);
        check_type::<HelpReply>("help", &ask(ApiCall::Help, Value::Null).await);
        check_type::<UpgradeReply>("upgrade", &ask(ApiCall::Upgrade, json!({})).await);
        check_type::<Backup>("backup", &ask(ApiCall::Backup, Value::Null).await);
        check_type::<ErrorReply>("error", &ask(ApiCall::Get, json!({ "mission": "lab-samples-9" })).await);
        fleet.kill("gorse").await;
        let end = fleet.wait_for_end(&mission).await;
        assert!(matches!(end, MissionState::NeedsIntervention { .. }), "seed {seed}: {end:?}");
        fleet.view("**").await.iter().for_each(|(name, view)| check_view(name, view));
        let ask = async |call: ApiCall, payload: Value| fleet.request_answered(call, &payload).await;
        let request = json!({ "request": format!("{mission}.1"), "answer": "done", "by": "nurse" });
        check_type::<AnswerReply>("answer", &ask(ApiCall::Answer, request).await);
        check_type::<MissionChangeReply>("resolve", &ask(ApiCall::Resolve, named).await);
        for kind in fleet.events() {
            check_type::<EventKind>("event", &json!(kind));
        }
    });
}

/// Collects the elementary tasks of a tree with their states.
fn elementary(tree: &Value, tasks: &mut BTreeMap<String, String>) {
    for child in tree["children"].as_array().into_iter().flatten() {
        elementary(child, tasks);
    }
    if tree["kind"] == "elementary" {
        let text = |key: &str| tree[key].as_str().unwrap_or("?").to_owned();
        tasks.insert(text("task"), text("state"));
    }
}

/// Queries a key on the bus of a node or a client. Returns the replies and the duration.
async fn query_views(bus: &VirtualBus, key: &str) -> (BTreeMap<String, Value>, Duration) {
    let asked = Instant::now();
    let mut replies = bus.query_nearest(key, vec![].into(), Duration::from_secs(3)).await.expect("a virtual bus");
    let mut views = BTreeMap::new();
    while let Some(reply) = replies.recv().await {
        let view = serde_json::from_slice(&reply.payload.expect("a view")).expect("JSON");
        let former = views.insert(reply.key.trim_start_matches("consort/ward/").to_owned(), view);
        assert!(former.is_none(), "{} was answered twice", reply.key);
    }
    (views, asked.elapsed())
}

#[test]
fn every_node_answers_views_with_their_origin_and_age() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began("deposit");
        fleet.wait_until("the deposit", SOON, |fleet| fleet.has_event(&began)).await;
        let nodes = ["aster", "basil", "clove", "fern", "gorse", "lab-arm", "world"];
        let hold = json!({ "robots": ["fern"], "for_s": 600, "reason": "a spill", "by": "Nia" });
        request(&fleet, ApiCall::Hold, &hold).await;
        // Nodes without a ledger show the missions and the orders of a voter.
        for node in nodes {
            let bus = fleet.network.bus(slug(node));
            let held = async |_: &Fleet| {
                let fleet_view = query_views(&bus, "consort/ward/view/fleet").await.0.remove("view/fleet")?;
                assert_eq!(fleet_view["seen_by"], node, "seed {seed}");
                assert!(fleet_view["closures"].is_array(), "seed {seed}: {node}: {fleet_view}");
                let fern = fleet_view["nodes"].as_array()?.iter().find(|node| node["node"] == "fern")?;
                let robot = query_views(&bus, "consort/ward/view/robot/fern").await.0.remove("view/robot/fern")?;
                assert_eq!(robot["seen_by"], node, "seed {seed}");
                assert!(robot["ledger"]["revision"].is_u64(), "seed {seed}: {node}: {robot}");
                [fern, &robot].iter().all(|view| view["orders"]["hold"]["by"] == "Nia").then_some(())
            };
            fleet.poll_until("the hold in the views of the fleet and the robot", Duration::from_secs(2), held).await;
            let (views, _) = query_views(&bus, "consort/ward/view/**").await;
            let of_its_own = ["fleet", "coordinator", "ensembles", "map"];
            for view in of_its_own {
                assert_eq!(views[&format!("view/{view}")]["seen_by"], node, "seed {seed}: {view}");
            }
            let keeper = views["view/missions"]["seen_by"].as_str().expect("a node");
            let keeps = !["gorse", "world"].contains(&node);
            assert_eq!(keeper == node, keeps, "seed {seed}: {node} has the missions of {keeper}");
            assert_eq!(views["view/missions"]["missions"][0]["mission"], json!(mission), "seed {seed}: {node}");
            assert_eq!(views[&format!("view/mission/{mission}")]["state"], "running", "seed {seed}: {node}");
            assert!(views["view/world"].is_object(), "seed {seed}: {node}");
            let age = views["view/coordinator"]["age_ms"].as_u64().expect("an age");
            assert!(if node == "aster" { age == 0 } else { age <= 500 }, "seed {seed}: {node}: {age} ms");
            let got = query_views(&bus, "consort/ward/api/list").await.0;
            assert_eq!(got["api/list"]["missions"][0]["mission"], json!(mission), "seed {seed}: {node}");
        }
        // Each node answers separately on its own key.
        let (seen, _) = query_views(&fleet.client, "consort/ward/seen/*/coordinator").await;
        let seen: BTreeMap<&str, &str> =
            seen.iter().map(|(key, view)| (key.as_str(), view["coordinator"].as_str().unwrap_or("nobody"))).collect();
        let expected: Vec<(String, &str)> =
            nodes.iter().map(|node| (format!("seen/{node}/coordinator"), "aster")).collect();
        assert!(seen.iter().map(|(key, who)| ((*key).to_owned(), *who)).eq(expected), "seed {seed}: {seen:?}");
    });
}

#[test]
fn a_view_of_missions_has_changes_and_pages() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed, ROOM).await;
        let part = async |parameters: &str| {
            let view = fleet.view_of("aster", &format!("missions?{parameters}")).await;
            let part: ListPart = serde_json::from_value(view["part"].clone()).expect("a part");
            let missions = view["missions"].as_array().expect("a list").iter();
            (missions.map(|mission| mission["mission"].clone()).collect::<Vec<_>>(), part)
        };
        let first = json!(fleet.submit("a", ROOM).await);
        let (all, before) = part("since=").await;
        assert_eq!((all, &before.since), (vec![first.clone()], &None), "seed {seed}");
        let second = json!(fleet.submit("b", ROOM).await);
        let (changed, after) = part(&format!("since={}", before.version)).await;
        assert!(changed.contains(&second), "seed {seed}: {changed:?}");
        assert_eq!((after.since, after.removed), (Some(before.version), vec![]), "seed {seed}");
        let (page, ListPart { next, .. }) = part("limit=1").await;
        assert_eq!(page, [first], "seed {seed}");
        let (page, last) = part(&format!("limit=1;after={}", next.expect("another page"))).await;
        assert_eq!((page, last.next), (vec![second], None), "seed {seed}");
    });
}

#[test]
fn views_are_answered_quickly_without_a_leader() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        let client = fleet.client.clone();
        let moment = Duration::from_millis(900);
        fleet.kill("aster").await;
        let killed = Instant::now();
        let mut leaders = vec![];
        while killed.elapsed() < Duration::from_secs(3) {
            let (views, took) = query_views(&client, "consort/ward/view/**").await;
            assert!(took < moment, "seed {seed}: {took:?} at {:?}", killed.elapsed());
            let missions = &views["view/missions"];
            assert_eq!(missions["missions"][0]["mission"], json!(mission), "seed {seed}: {missions}");
            leaders.push(views["view/coordinator"]["node"].clone());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let next = leaders.last().and_then(Value::as_str).expect("the next is known").to_owned();
        assert_ne!(next, "aster", "seed {seed}");

        // Without a majority there is no leader; the remaining nodes report the problem.
        for voter in ["basil", "clove", "fern", "lab-arm"].into_iter().filter(|voter| *voter != next).take(2) {
            fleet.kill(voter).await;
        }
        fleet.kill(&next).await;
        let known = async |fleet: &Fleet| {
            let health = fleet.view("health").await.remove("health")?;
            let findings = health["findings"].as_array()?.clone();
            let said = |about: &str| findings.iter().any(|finding| finding["about"] == about);
            (health["level"] == "error" && said("quorum") && said("coordinator")).then_some(health)
        };
        let health = fleet.poll_until("the loss of the quorum", Duration::from_secs(20), known).await;
        assert_eq!(health["coordinator"], Value::Null, "seed {seed}: {health}");
    });
}

#[test]
fn a_dead_robot_holds_the_role_in_the_ledger_not_in_its_record() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the laboratory", SOON, |fleet| fleet.has_event(task_began("navto_lab"))).await;
        let known = async |fleet: &Fleet| {
            let robot = fleet.view("robot/gorse").await.remove("robot/gorse")?;
            (robot["robot"]["availability"]["holding"]["role"] == "r1").then_some(())
        };
        fleet.poll_until("gorse's word that it holds r1", SOON, known).await;
        fleet.kill("gorse").await;
        let end = fleet.wait_for_end(&mission).await;
        assert!(matches!(end, MissionState::NeedsIntervention { .. }), "seed {seed}: {end:?}");
        let closed = fleet.request_answered(ApiCall::Resolve, &json!({ "mission": mission, "by": "Nia" })).await;
        assert!(closed["state"]["failed"].is_object(), "seed {seed}: {closed}");
        // Most of these nodes have a ledger; the world host only has the last record of gorse.
        for node in ["aster", "basil", "clove", "fern", "lab-arm", "world"] {
            let shown = async |_: &Fleet| {
                let (views, _) = query_views(&fleet.network.bus(slug(node)), "consort/ward/view/**").await;
                let of_all = views["view/fleet"]["nodes"].as_array()?.iter().find(|node| node["node"] == "gorse")?;
                let alone = views.get("view/robot/gorse")?;
                (of_all["status"] == "down").then(|| [of_all.clone(), alone.clone()])
            };
            for gorse in fleet.poll_until("gorse is down", SOON, shown).await {
                assert_eq!(gorse["holds"], Value::Null, "seed {seed}: {node}: {gorse}");
                assert_eq!(gorse["robot"]["availability"], "free", "seed {seed}: {node}: {gorse}");
            }
        }
    });
}

#[test]
fn the_explanation_contains_the_result_of_each_robot() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        let said = fleet.request_answered(ApiCall::Explain, &json!({ "mission": mission })).await;
        let words: Vec<&str> = said["text"].as_array().expect("sentences").iter().filter_map(Value::as_str).collect();
        assert_eq!(words[0], format!("{mission} is completed; auction 1:"), "seed {seed}");
        for expected in [
            "lab_arm: lab-arm gets the role with ",
            "  fern lacks ",
            "r1: gorse gets the role with ",
            "  gorse bid ",
            "    navto_room ",
            "  fern bid ",
            "  lab-arm lacks ",
        ] {
            assert!(
                words.iter().any(|line| line.starts_with(expected)),
                "seed {seed}: {expected:?} is not in {words:#?}"
            );
        }
        let explained = |robot: &str| {
            let robots = said["explanation"]["roles"][1]["robots"].as_array().expect("robots");
            robots.iter().find(|of| of["robot"] == robot).expect("it is there").clone()
        };
        let outcome = |robot: &str| explained(robot)["outcome"].clone();
        for robot in ["gorse", "fern"] {
            let Value::Array(parts) = &explained(robot)["parts"] else {
                panic!("seed {seed}: no parts of {robot}'s bid")
            };
            let sum: f64 = parts.iter().filter_map(|part| part["time"].as_f64()).sum();
            let whole = explained(robot)["bid"]["time_s"].as_f64().expect("a time");
            assert!(parts.len() > 5 && (sum - whole).abs() < 1e-6, "seed {seed}: {robot} bid {whole}, in parts {sum}");
        }
        assert_eq!((outcome("gorse"), outcome("fern")), (json!("won"), json!("outbid")), "seed {seed}: {words:#?}");
        let missing = fleet.request_answered(ApiCall::Explain, &json!({ "mission": "lab-samples-9" })).await;
        assert!(missing["error"].as_str().is_some_and(|error| error.contains("no mission lab-samples-9")), "{missing}");
    });
}

#[test]
fn every_call_documents_its_payload() {
    for_each_seed([123], async |_| {
        let fleet = fleet(123, ROOM).await;
        let help = fleet.request_answered(ApiCall::Help, &Value::Null).await;
        let calls: Vec<&str> =
            help["calls"].as_array().expect("calls").iter().filter_map(|call| call["call"].as_str()).collect();
        assert_eq!(
            calls,
            [
                "submit",
                "cancel",
                "cancel_missions",
                "priority",
                "reassign",
                "resolve",
                "answer",
                "schedule",
                "hold",
                "release",
                "maintenance",
                "close",
                "open",
                "limit",
                "alarm",
                "backup",
                "upgrade",
                "get",
                "list",
                "requests",
                "schedules",
                "audit",
                "explain",
                "help"
            ]
        );
        let (each, _) = query_views(&fleet.client, "consort/ward/api/*/help").await;
        assert_eq!(each.len(), calls.len());
        let submit = &each["api/submit/help"];
        assert_eq!(submit["payload_schema"]["required"], json!(["mission"]), "{submit}");
        let taken = fleet.request(ApiCall::Submit, &submit["example"]).await.expect("a reply");
        assert!(taken["mission"].is_string(), "the example is taken: {taken}");
        let refused = fleet.request_raw(ApiCall::Submit, r#"{"mission": "lab-samples", "priority": "high"}"#).await;
        let error = refused.expect("a reply")["error"].as_str().expect("an error").to_owned();
        assert!(error.starts_with("priority is a string; allowed is integer"), "{error}");
    });
}

#[test]
fn presence_tokens_follow_nodes_and_the_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let nodes = ["aster", "basil", "clove", "fern", "gorse", "lab-arm", "world"];
        let expected = |coordinator: &str, gone: &[&str]| {
            let nodes = nodes.iter().filter(|node| !gone.contains(node)).map(|node| format!("node/{node}"));
            let robots = ["fern", "gorse", "lab-arm"].into_iter().filter(|robot| !gone.contains(robot));
            let robots = robots.map(|robot| format!("robot/{robot}"));
            nodes.chain(robots).chain([format!("coordinator/{coordinator}")]).collect::<BTreeSet<_>>()
        };
        assert_eq!(fleet.presence_tokens().await, expected("1/aster", &[]), "seed {seed}");
        fleet.kill("gorse").await;
        assert_eq!(fleet.presence_tokens().await, expected("1/aster", &["gorse"]), "seed {seed}");
        fleet.kill("aster").await;
        let next = fleet.wait_for_coordinator().await;
        let elected = |what: &EventKind| matches!(what, EventKind::Elected { term, .. } if *term > 1);
        fleet.wait_until("the next term", SOON, |fleet| fleet.has_event(elected)).await;
        let term = fleet.events().iter().rev().find_map(|what| match what {
            EventKind::Elected { term, .. } => Some(*term),
            _ => None,
        });
        let office = format!("{}/{next}", term.expect("checked before"));
        assert_eq!(fleet.presence_tokens().await, expected(&office, &["gorse", "aster"]), "seed {seed}");
        fleet.start_robot("gorse").await;
        assert_eq!(fleet.presence_tokens().await, expected(&office, &["aster"]), "seed {seed}");
    });
}
