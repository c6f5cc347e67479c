//! Promises: missions that share a scarce robot.

use crate::support::task_began;
use consort_fleet::node::NodeSettings;
use consort_protocol::auction::{Allocator, AllocatorInput, AssignmentError, OptimalAssignment, PromiseTerms};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Ledger, RolePhase};
use consort_protocol::message::FailureKind;
use consort_protocol::units::Seconds;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

const SEEDS: [u64; 3] = [81, 82, 83];
const SOON: Duration = Duration::from_secs(60);
const ROOMS: [&str; 4] = ["IC Room 6", "PC Room 8", "PC Room 2", "IC Room 4"];

/// Starts four carriers and the named arms.
async fn fleet(seed: u64, arms: &[&str], stations: &[&str]) -> Fleet {
    fleet_with(seed, arms, stations, PromiseTerms::default()).await
}

async fn fleet_with(seed: u64, arms: &[&str], stations: &[&str], terms: PromiseTerms) -> Fleet {
    let adjust = Box::new(move |node: &mut NodeSettings| node.fleet.promises = terms);
    let carriers = [("amber", "PC Room 8"), ("birch", "IC Room 4"), ("fern", "Dock"), ("gorse", "PC Room 2")];
    let carriers = carriers.map(|(name, place)| RobotSpec::carrier(name, place));
    let arms = arms.iter().map(|name| RobotSpec::arm(name, "Laboratory").with_skills(&["pick_up", "wait"]));
    let robots = carriers.into_iter().chain(arms).collect();
    let mut fleet = Fleet::adjusted_hospital(seed, robots, stations, &ROOMS, adjust).await;
    fleet.wait_for_coordinator().await;
    fleet
}

async fn submit_all(fleet: &Fleet) -> Vec<MissionId> {
    let mut missions = vec![];
    for (request, room) in ["a", "b", "c", "d"].into_iter().zip(ROOMS) {
        missions.push(fleet.submit(request, room).await);
    }
    missions
}

/// Returns the robot of each promise.
fn promised(ledger: &Ledger) -> Vec<RobotId> {
    let missions = ledger.active_missions();
    missions.iter().flat_map(|entry| entry.promised_roles().map(|(_, robot)| robot.robot.clone())).collect()
}

fn has_promises(fleet: &Fleet, count: usize) -> bool {
    fleet.ledger(promised).is_some_and(|promised| promised.len() >= count)
}

/// Returns the roles of a robot in the view of the coordinator: the role that it holds, and those that it gets later.
async fn timeline_of(fleet: &mut Fleet, robot: &str) -> Vec<Value> {
    let coordinator = fleet.wait_for_coordinator().await;
    let view = fleet.view_of(coordinator.as_str(), "fleet").await;
    let nodes = view["nodes"].as_array().expect("nodes");
    let node = nodes.iter().find(|node| node["node"] == robot).expect("the robot");
    let held = Some(&node["holds"]).filter(|role| !role.is_null());
    held.into_iter().chain(node["promised"].as_array().expect("roles")).cloned().collect()
}

async fn assert_all_complete(fleet: &mut Fleet, missions: &[MissionId]) {
    for (mission, room) in missions.iter().zip(ROOMS) {
        fleet.assert_completes(mission).await;
        fleet.assert_each_task_once(mission);
        fleet.assert_sample_delivered(room);
    }
    fleet.assert_exclusive_roles();
}

fn is_postponed(what: &EventKind) -> bool {
    matches!(what, EventKind::GaveUp { kind: FailureKind::Postponed, .. })
}

#[test]
fn one_arm_serves_missions_that_are_under_way_together() {
    let postponed = Cell::new(0);
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["lab-arm"], &["aba"]).await;
        let missions = submit_all(&fleet).await;
        fleet
            .wait_until("all carriers to start", SOON, |fleet| {
                fleet.event_log.times(task_began("navto_room")).len() == 4
            })
            .await;
        assert!(has_promises(&fleet, 3), "seed {seed}: the arm has a role and three promises");
        let view = fleet.view(&format!("mission/{}", missions[3])).await;
        let text = serde_json::to_string(&view).expect("JSON");
        assert!(
            text.contains(r#""phase":"promised""#) && text.contains(r#""holder":"lab-arm""#),
            "seed {seed}: {text}"
        );
        let arm =
            view.values().find_map(|view| view["roles"].as_array()?.iter().find(|role| role["role"] == "lab_arm"));
        let promise = arm.map(|arm| arm["promise"].clone()).unwrap_or_default();
        assert!(promise["planned_at_ms"].as_u64().is_some_and(|at| at > 0), "seed {seed}: {text}");
        assert!(promise["after"].as_array().is_some_and(|after| !after.is_empty()), "seed {seed}: {text}");
        let reply = fleet.request_answered(ApiCall::Explain, &json!({ "mission": missions[3] })).await;
        let planned = "lab_arm is promised to lab-arm, which is free for it at about 1970-01-0";
        let lines = reply["text"].as_array().cloned().unwrap_or_default();
        let explains = |line: &Value| line.as_str().is_some_and(|line| line.starts_with(planned));
        assert!(lines.iter().any(explains), "seed {seed}: {reply}");
        let timeline = timeline_of(&mut fleet, "lab-arm").await;
        let mut shown: Vec<&Value> = timeline.iter().map(|role| &role["mission"]).collect();
        shown.sort_by(|a, b| a.as_str().cmp(&b.as_str()));
        assert_eq!(json!(shown), json!(missions), "seed {seed}: {timeline:?}");
        let later: Vec<&Value> = timeline.iter().filter(|role| role.get("planned_at_ms").is_some()).collect();
        assert!(later.iter().all(|role| role["time_s"].as_f64() > Some(0.0)), "seed {seed}: {timeline:?}");
        let planned = fleet.ledger(|ledger| {
            let promises = ledger.promises_in_order();
            json!(promises.iter().map(|(entry, _, promise)| (&entry.id, promise.planned_ms)).collect::<Vec<_>>())
        });
        let shown: Vec<_> = later.iter().map(|role| (&role["mission"], &role["planned_at_ms"])).collect();
        assert_eq!(planned, Some(json!(shown)), "seed {seed}: {timeline:?}");
        assert_all_complete(&mut fleet, &missions).await;
        let arm: RoleId = slug("lab_arm");
        let ended = fleet.ledger(|ledger| {
            missions
                .iter()
                .all(|id| ledger.mission(id).is_some_and(|entry| entry.roles[&arm].phase == RolePhase::Ended))
        });
        assert_eq!(ended, Some(true), "seed {seed}");
        postponed.set(postponed.get() + fleet.event_log.count(is_postponed));
    });
    assert!(postponed.get() > 0, "the arm never left a mission whose sample was still on its way");
}

#[test]
fn a_held_robot_keeps_the_role_in_which_it_waits() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["lab-arm"], &["aba"]).await;
        let missions = submit_all(&fleet).await;
        fleet.wait_until("promises", SOON, |fleet| has_promises(fleet, 3)).await;
        let reply = fleet.request_answered(ApiCall::Hold, &json!({ "robots": ["lab-arm"], "for_s": 600 })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        let postponed = fleet.event_log.count(is_postponed);
        fleet.assert_never("a return of its role", SOON, |fleet| fleet.event_log.count(is_postponed) > postponed).await;
        let reply = fleet.request_answered(ApiCall::Release, &json!({ "robots": ["lab-arm"] })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        assert_all_complete(&mut fleet, &missions).await;
    });
}

#[test]
fn promises_survive_the_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["lab-arm"], &["aba", "bab", "cab"]).await;
        let missions = submit_all(&fleet).await;
        fleet.wait_until("promises", SOON, |fleet| has_promises(fleet, 3)).await;
        fleet.kill_coordinator().await;
        assert_all_complete(&mut fleet, &missions).await;
    });
}

/// Returns a mission in which a carrier drives somewhere, and then an arm does something.
fn drive_and_wait(room: &str, request: &str) -> Value {
    let managed = json!({ "kind": "managed" });
    let drive = json!({ "task": "go", "type": "navigation", "roles": ["cart"], "parameters": { "to": room } });
    let wait = json!({ "task": "act", "type": "wait", "roles": ["arm"], "parameters": { "seconds": "5" } });
    let mission = json!({
        "mission": "go-and-act", "roles": { "cart": managed, "arm": managed },
        "root": { "task": "all", "method": "sequential", "tasks": [drive, wait] },
    });
    json!({ "mission": mission, "request": request })
}

/// Returns a mission in which a cart drives for some minutes, and then a courier visits a room.
fn visit_after_drives(room: &str, request: &str) -> Value {
    let managed = json!({ "kind": "managed" });
    let drive = |task: &str, role: &str, to: &str| -> Value {
        json!({ "task": task, "type": "navigation", "roles": [role], "parameters": { "to": to } })
    };
    let ends = ["IC Room 6", "PC Room 8"].into_iter().cycle().take(LEGS);
    let legs = ends.enumerate().map(|(number, to)| drive(&format!("leg-{number}"), "cart", to));
    let act = json!({ "task": "act", "type": "wait", "roles": ["courier"], "parameters": { "seconds": "5" } });
    let tasks: Vec<Value> = legs.chain([drive("visit", "courier", room), act]).collect();
    let mission = json!({
        "mission": "visit", "roles": { "cart": managed, "courier": managed },
        "root": { "task": "all", "method": "sequential", "tasks": tasks },
    });
    json!({ "mission": mission, "request": request })
}

/// Number of drives of the cart.
const LEGS: usize = 5;

#[test]
fn a_robot_inserts_a_role_on_its_way_before_an_earlier_promise() {
    for_each_seed(SEEDS, async |seed| {
        let courier = RobotSpec::carrier("gorse", "Dock").with_skill("wait");
        let carts = [("amber", "PC Room 8"), ("birch", "PC Room 2")];
        let carts = carts.map(|(name, place)| RobotSpec::carrier(name, place));
        let robots = carts.into_iter().chain([courier]).collect();
        let mut fleet = Fleet::hospital(seed, robots, &["aba"], &[]).await;
        fleet.wait_for_coordinator().await;
        let stay = json!({
            "mission": "stay", "roles": { "courier": { "kind": "managed" } },
            "root": { "task": "stay", "type": "wait", "roles": ["courier"], "parameters": { "seconds": "100" } },
        });
        let stay = json!({ "mission": stay, "request": "stay" });
        let (far, near) = (visit_after_drives("IC Room 6", "far"), visit_after_drives("IC Room 1", "near"));
        let mut missions: Vec<MissionId> = vec![];
        for (promises, request) in [stay, far, near].iter().enumerate() {
            let answer = fleet.request_answered(ApiCall::Submit, request).await;
            missions.push(slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}"))));
            fleet
                .wait_until("the role of the courier", SOON, |fleet| {
                    fleet.has_event(task_began("stay")) && has_promises(fleet, promises)
                })
                .await;
        }
        // The courier is held until both roles can start.
        let reply = fleet.request_answered(ApiCall::Hold, &json!({ "robots": ["gorse"], "for_s": 3600 })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        let [_, far, near] = &missions[..] else { panic!("seed {seed}: {missions:?}") };
        let in_order = |ledger: &Ledger| -> Vec<MissionId> {
            ledger.promises_in_order().into_iter().map(|(entry, ..)| entry.id.clone()).collect()
        };
        assert_eq!(fleet.ledger(in_order), Some(vec![near.clone(), far.clone()]), "seed {seed}");
        let last_leg = format!("leg-{}", LEGS - 1);
        let is_last = |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == last_leg);
        fleet.wait_until("both carts to arrive", 5 * SOON, |fleet| fleet.event_log.count(is_last) == 2).await;
        let reply = fleet.request_answered(ApiCall::Release, &json!({ "robots": ["gorse"] })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        for mission in &missions {
            fleet.assert_completes(mission).await;
        }
        fleet.assert_exclusive_roles();
        let visits = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::TaskBegan { mission, task, .. } if task.as_str() == "visit" => Some(mission),
            _ => None,
        });
        let in_order = [near.clone(), far.clone()];
        assert_eq!(visits.collect::<Vec<_>>(), in_order, "seed {seed}:\n{}", fleet.event_log_text());
    });
}

/// Starts two arms, and missions that share them. Returns a robot with a promise.
async fn sharing_two_arms(seed: u64, terms: PromiseTerms) -> (Fleet, Vec<MissionId>, RobotId) {
    let mut fleet = fleet_with(seed, &["lab-arm-1", "lab-arm-2"], &["aba", "bab", "cab"], terms).await;
    let mut missions: Vec<MissionId> = vec![];
    for (request, room) in ["a", "b", "c", "d"].into_iter().zip(ROOMS) {
        let answer = fleet.request_answered(ApiCall::Submit, &drive_and_wait(room, request)).await;
        missions.push(slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}"))));
    }
    fleet.wait_until("a promise", SOON, |fleet| has_promises(fleet, 1)).await;
    let robot = fleet.ledger(promised).expect("a ledger").remove(0);
    (fleet, missions, robot)
}

/// Asserts that all missions complete, and that a promise was released for this cause.
async fn assert_complete_without(fleet: &mut Fleet, missions: &[MissionId], released: &str) {
    for mission in missions {
        fleet.assert_completes(mission).await;
    }
    fleet.assert_exclusive_roles();
    let is_promise = |what: &EventKind| matches!(what, EventKind::Released { cause, .. } if *cause == released);
    assert!(fleet.has_event(is_promise), "seed {}:\n{}", fleet.seed, fleet.event_log_text());
}

#[test]
fn promises_of_a_lost_robot_pass_to_another() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, missions, lost) = sharing_two_arms(seed, PromiseTerms::default()).await;
        fleet.kill(lost.as_str()).await;
        assert_complete_without(&mut fleet, &missions, &format!("{lost} was judged dead")).await;
    });
}

#[test]
fn promises_of_a_robot_in_maintenance_pass_to_another() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, missions, arm) = sharing_two_arms(seed, PromiseTerms::default()).await;
        let begin = json!({ "robots": [arm], "action": "begin", "reason": "inspection", "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Maintenance, &begin).await;
        assert_eq!(reply["robots"][arm.as_str()]["maintenance"]["reason"], "inspection", "seed {seed}: {reply}");
        let released = format!("{arm} is in maintenance by Nia: inspection");
        assert_complete_without(&mut fleet, &missions, &released).await;
        assert!(!has_promises(&fleet, 1), "seed {seed}");
    });
}

#[test]
fn the_late_promise_of_a_held_robot_passes_to_another() {
    for_each_seed(SEEDS, async |seed| {
        let seconds = |number: f64| Seconds::new(number).expect("a time");
        let terms = PromiseTerms { late_max: seconds(20.0), gain_min: seconds(1e6), ..PromiseTerms::default() };
        let (mut fleet, missions, arm) = sharing_two_arms(seed, terms).await;
        let reply = fleet.request_answered(ApiCall::Hold, &json!({ "robots": [arm], "for_s": 3600 })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        let is_late = format!("{arm} is late, and ");
        let passed =
            |what: &EventKind| matches!(what, EventKind::Released { cause, .. } if cause.starts_with(&is_late));
        fleet.wait_until("another robot for the promise", 10 * SOON, |fleet| fleet.has_event(passed)).await;
        fleet
            .wait_until("the held robot to have no promises", 10 * SOON, |fleet| {
                fleet.ledger(promised).is_some_and(|promised| !promised.contains(&arm))
            })
            .await;
        let reply = fleet.request_answered(ApiCall::Release, &json!({ "robots": [arm] })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        for mission in &missions {
            fleet.assert_completes(mission).await;
        }
        fleet.assert_exclusive_roles();
    });
}

/// Submits the drive of a robot to a room, with an earliest start.
async fn submit_drive(fleet: &Fleet, request: &str, room: &str, not_before: &str) -> MissionId {
    let go = json!({ "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": room } });
    let mission = json!({ "mission": "go", "roles": { "r1": { "kind": "managed" } }, "root": go });
    let body = json!({ "mission": mission, "request": request, "not_before": not_before });
    let answer = fleet.request_answered(ApiCall::Submit, &body).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {answer}", fleet.seed)))
}

#[test]
fn a_role_is_promised_ahead_of_the_earliest_start_of_its_mission() {
    for_each_seed([84, 85], async |seed| {
        let terms = PromiseTerms { ahead: Seconds::new(600.0).expect("a time"), ..PromiseTerms::default() };
        let adjust = Box::new(move |node: &mut NodeSettings| node.fleet.promises = terms);
        let robots = vec![RobotSpec::carrier("amber", "Dock")];
        let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aba"], &[], adjust).await;
        fleet.wait_for_coordinator().await;
        let later = submit_drive(&fleet, "later", "IC Room 4", "1970-01-01T00:02:00Z").await;
        fleet.wait_until("a promise", SOON, |fleet| has_promises(fleet, 1)).await;
        let planned_ms =
            |ledger: &Ledger| ledger.mission(&later)?.promised_roles().next().map(|(_, promise)| promise.planned_ms);
        let planned_ms = fleet.ledger(planned_ms).flatten().expect("a promise");
        assert!(planned_ms.abs_diff(120_000) <= 1_000, "seed {seed}: {planned_ms}");
        // Meanwhile the robot does another role.
        let now = submit_drive(&fleet, "now", "IC Room 3", "1970-01-01T00:00:00Z").await;
        fleet.assert_completes(&now).await;
        assert!(fleet.elapsed() < Duration::from_secs(110), "seed {seed}: {:?}", fleet.elapsed());
        let has_begun = |what: &EventKind| matches!(what, EventKind::Started { mission, .. } if *mission == later);
        assert!(!fleet.has_event(has_begun), "seed {seed}\n{}", fleet.event_log_text());
        fleet.wait_until("the earliest start", 3 * SOON, |fleet| fleet.has_event(has_begun)).await;
        let begun = fleet.event_log.times(has_begun)[0];
        assert!(begun >= Duration::from_secs(119) && begun < Duration::from_secs(125), "seed {seed}: {begun:?}");
        fleet.assert_completes(&later).await;
    });
}

/// A robot is a little nearer to the room of the first mission, and much nearer to that of the second.
#[test]
fn missions_that_start_together_are_allocated_together() {
    for_each_seed(SEEDS, async |seed| {
        let robots = [("amber", "IC Room 2"), ("birch", "Dock")].map(|(name, place)| RobotSpec::carrier(name, place));
        let mut fleet = Fleet::hospital(seed, robots.into(), &["aba"], &[]).await;
        fleet.wait_for_coordinator().await;
        let mut missions: Vec<MissionId> = vec![];
        for (request, room) in [("first", "IC Room 4"), ("second", "IC Room 3")] {
            missions.push(submit_drive(&fleet, request, room, "1970-01-01T00:02:00Z").await);
        }
        let holders = |ledger: &Ledger| -> Vec<String> {
            let holder = |id| Some(ledger.mission(id)?.holders().into_values().next()?.to_string());
            missions.iter().filter_map(holder).collect()
        };
        assert_eq!(fleet.ledger(holders), Some(vec![]), "seed {seed}: they have not started");
        fleet
            .wait_until("both awards", 3 * SOON, |fleet| {
                fleet.ledger(holders).is_some_and(|holders| holders.len() == 2)
            })
            .await;
        assert_eq!(fleet.ledger(holders), Some(vec!["birch".to_owned(), "amber".to_owned()]), "seed {seed}");
        for mission in &missions {
            fleet.assert_completes(mission).await;
        }
    });
}

/// Allocates as the default does, and counts the calls.
#[derive(Debug, Default)]
struct CountingAllocator(AtomicUsize);

impl Allocator for CountingAllocator {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        self.0.fetch_add(1, Ordering::Relaxed);
        OptimalAssignment.allocate(input)
    }

    fn allocates_together(&self) -> bool {
        true
    }
}

/// Each of the missions is cleared once when it has its bids, and once when all have theirs.
#[test]
fn auctions_that_wait_for_others_are_not_cleared_again() {
    let robots = [
        ("amber", "PC Room 8"),
        ("birch", "IC Room 4"),
        ("cedar", "IC Room 1"),
        ("dogwood", "IC Room 2"),
        ("elder", "IC Room 3"),
        ("fern", "Dock"),
        ("gorse", "PC Room 2"),
        ("hazel", "IC Room 6"),
    ];
    for_each_seed(SEEDS, async |seed| {
        let allocator = Arc::new(CountingAllocator::default());
        let of_nodes = Arc::clone(&allocator);
        let adjust = Box::new(move |node: &mut NodeSettings| node.fleet.allocator = of_nodes.clone());
        let members = robots.map(|(name, place)| RobotSpec::carrier(name, place)).into();
        let mut fleet = Fleet::adjusted_hospital(seed, members, &["aba"], &[], adjust).await;
        fleet.wait_for_coordinator().await;
        let mut missions: Vec<MissionId> = vec![];
        for (request, _) in robots {
            let go =
                json!({ "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": "Laboratory" } });
            let mission = json!({ "mission": "go", "roles": { "r1": { "kind": "managed" } }, "root": go });
            let body = json!({ "mission": mission, "request": request, "not_before": "1970-01-01T00:02:00Z" });
            let answer = fleet.request_answered(ApiCall::Submit, &body).await;
            missions.push(slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}"))));
        }
        let held = |ledger: &Ledger| {
            missions.iter().filter_map(|id| ledger.mission(id)?.holders().into_values().next()).count()
        };
        fleet.wait_until("all awards", 3 * SOON, |fleet| fleet.ledger(held) == Some(robots.len())).await;
        let cleared = allocator.0.load(Ordering::Relaxed);
        assert!(cleared <= 3 * robots.len(), "seed {seed}: cleared {cleared} times");
    });
}

#[test]
fn an_urgent_mission_gets_a_robot_that_only_waits() {
    for_each_seed(SEEDS, async |seed| {
        let courier = RobotSpec::carrier("gorse", "Dock").with_skill("wait");
        let robots = vec![RobotSpec::carrier("amber", "PC Room 8"), courier];
        let mut fleet = Fleet::hospital(seed, robots, &["aba"], &[]).await;
        fleet.wait_for_coordinator().await;
        let act = json!({ "task": "act-now", "type": "wait", "roles": ["courier"], "parameters": { "seconds": "5" } });
        let urgent = json!({
            "mission": { "mission": "urgent", "roles": { "courier": { "kind": "managed" } }, "root": act },
            "request": "urgent", "priority": 10,
        });
        let mut missions: Vec<MissionId> = vec![];
        for request in [visit_after_drives("IC Room 1", "plain"), urgent] {
            let answer = fleet.request_answered(ApiCall::Submit, &request).await;
            missions.push(slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {seed}: {answer}"))));
            let latest = missions.last().expect("a mission").clone();
            fleet
                .wait_until("the courier", SOON, |fleet| {
                    fleet.holder(&latest, "courier").is_some_and(|robot| robot.as_str() == "gorse")
                })
                .await;
        }
        fleet.assert_completes(&missions[1]).await;
        assert!(!fleet.has_event(task_began("visit")), "seed {seed}:\n{}", fleet.event_log_text());
        fleet.assert_completes(&missions[0]).await;
        fleet.assert_exclusive_roles();
    });
}
