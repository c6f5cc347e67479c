//! The fleet model that is built from the messages of a fleet.

use consort_dashboard::fleet_model::{
    FleetInput, FleetModel, FloorPlan, NO_COORDINATOR_AFTER_MS, ReachabilityState, bounds, delta,
};
use consort_dashboard::loaded_map::LoadedMap;
use consort_protocol::cause::CauseClass;
use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::message::Beacon;
use consort_protocol::units::WorldTime;
use consort_protocol::view::HealthLevel;
use consort_skills::actions::Telemetry;
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;
use consort_world::map;
use serde_json::{Value, json};
use std::collections::BTreeMap;

const NOW: u64 = 1_000_000;

const SHED: &str = "{name: shed, places: [{name: Dock, kind: dock, x_m: 1, y_m: 2}, {name: Bench, kind: room, x_m: 3, y_m: 2}], \
    lanes: [{between: [Dock, Bench]}]}";

fn model() -> FleetModel {
    FleetModel::new("ward", "station-1", FloorPlan::new(&LoadedMap::from(map::shipped("hospital").unwrap())), NOW)
}

fn event(node: &str, sequence: u64, at_ms: u64, what: Value) -> Event {
    let mut event = json!({ "node": node, "sequence": sequence, "at_ms": at_ms });
    event.as_object_mut().unwrap().extend(what.as_object().unwrap().clone());
    serde_json::from_value(event).unwrap()
}

fn beacon(node: &str, term: u64, since_ms: u64) -> Beacon {
    let node = NodeId::new(node).unwrap();
    Beacon { node: node.clone(), term, voters: [node].into(), since_ms, cluster: None, wire: None }
}

fn worker(availability: Value) -> Value {
    json!({
        "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 6.0, "y_m": 2.5, "yaw_rad": 1.5 }, "battery": 0.8,
        "discharge": 0.001, "useful_charge": 0.08, "speed": 0.7, "availability": availability, "estimator": "e",
    })
}

fn fleet(mut nodes: Value) -> Value {
    for node in nodes.as_array_mut().unwrap() {
        node["seen_by"] = json!("station-1");
    }
    json!({ "nodes": nodes, "closures": [], "ensembles": [{ "name": "logistics", "membership": ["member.robot"], "skills": ["navigation"],
        "stale_after_ms": 10_000, "nodes": [
        { "node": "ada", "member": true, "reason": "", "age_ms": 5 },
        { "node": "bob", "member": false, "reason": "lacks navigation", "age_ms": 5 },
    ] }] })
}

fn telemetry(x: f64, y: f64) -> Telemetry {
    serde_json::from_value(json!({
        "time": 1.0, "pose": { "x_m": x, "y_m": y, "yaw_rad": 0.0 }, "place": "Dock", "battery": 0.75, "able": true, "closed": [],
    }))
    .unwrap()
}

#[test]
fn a_robot_has_the_pose_of_its_telemetry_and_the_route_of_its_task() {
    let mut model = model();
    let holding = json!({ "holding": { "mission": "m-1", "role": "r1", "suspended": false } });
    let ada = json!({ "node": "ada", "alive": true, "status": "alive", "age_ms": 300, "robot": worker(holding) });
    model.apply_view(&Key::ViewFleet, &fleet(json!([ada])), NOW);
    let mission = shipped()["lab-samples"].instantiate(&BTreeMap::new(), &hospital()).unwrap();
    let view =
        json!({ "mission": "m-1", "detail": "running", "tasks": mission.tasks, "roles": [], "done": 0, "steps": 11 });
    model.apply_view(&Key::ViewMission("m-1".parse().unwrap()), &view, NOW);
    model.apply_event(
        &event("ada", 1, NOW, json!({ "event": "task_began", "mission": "m-1", "role": "r1", "task": "navto_room" })),
        NOW,
    );
    model.apply_telemetry("ada", &telemetry(6.0, 4.0), NOW + 10);

    let ada = &model.robots()["ada"];
    assert_eq!((ada.x, ada.y, ada.battery), (6.0, 4.0, 0.75));
    assert_eq!((ada.availability.as_str(), ada.task.as_deref()), ("holding", Some("navto_room")));
    assert_eq!(ada.last_contact_ms, NOW - 300);
    assert_eq!(ada.destination.as_deref(), Some("IC Room 6"));
    assert_eq!(ada.route.last().map(String::as_str), Some("IC Room 6"));
    assert!(ada.route.len() > 2, "along the corridor: {:?}", ada.route);

    // The record of its node is older than its telemetry.
    model.apply_view(
        &Key::ViewFleet,
        &fleet(json!([{ "node": "ada", "alive": true, "age_ms": 500, "robot": worker(json!("free")) }])),
        NOW + 20,
    );
    let ada = &model.robots()["ada"];
    assert_eq!((ada.y, ada.availability.as_str()), (4.0, "free"));
    assert_eq!((&ada.destination, ada.route.len()), (&None, 0));
    let logistics = &model.ensembles()["logistics"];
    assert_eq!(logistics.members, ["ada"]);
    assert_eq!(logistics.non_members["bob"], "lacks navigation");
    assert_eq!(
        (logistics.membership.as_slice(), logistics.stale_after_ms),
        (&["member.robot".to_owned()][..], Some(10_000))
    );

    model.apply_view(&Key::ViewFleet, &fleet(json!([{ "node": "cyd", "alive": true }])), NOW + 30);
    assert!(model.robots().is_empty(), "unknown robots are removed");
}

#[test]
fn a_takeover_records_the_previous_coordinator_and_the_gap() {
    let mut model = model();
    model.apply_beacon(&beacon("ada", 1, 500), NOW);
    model.apply_beacon(&beacon("ada", 1, 750), NOW + 250);
    assert_eq!(model.kpis().takeovers, 0, "the first coordinator is no takeover");
    model.apply_event(
        &event("bob", 1, NOW + 600, json!({ "event": "elected", "term": 2, "voters": ["bob"] })),
        NOW + 600,
    );
    model.apply_beacon(&beacon("bob", 2, 100), NOW + 700);
    let bob = model.coordinator().unwrap();
    assert_eq!((bob.node.as_str(), bob.term, bob.voters.as_slice()), ("bob", 2, &["bob".to_owned()][..]));
    let takeover = &model.takeovers()[1];
    assert_eq!((takeover.from.as_deref(), takeover.gap_ms, model.takeovers().len()), (Some("ada"), Some(350), 2));
    // A coordinator that has not noticed its replacement yet.
    model.apply_beacon(&beacon("ada", 1, 9_000), NOW + 800);
    assert_eq!(model.coordinator().unwrap().node, "bob");
    assert_eq!(model.kpis().takeovers, 1);
    assert_eq!(model.kpis().takeover_ms, Some(350));
}

#[test]
fn a_silent_fleet_is_shown_as_lost_with_the_time() {
    let mut model = model();
    model.apply_links(2, NOW);
    assert_eq!(model.reachability().state, ReachabilityState::NoCoordinator, "no beacon was received yet");
    model.apply_beacon(&beacon("ada", 1, 0), NOW + 100);
    model.apply_links(2, NOW + 200);
    assert_eq!(model.reachability().state, ReachabilityState::Connected);
    model.apply_links(2, NOW + 100 + NO_COORDINATOR_AFTER_MS);
    assert_eq!(model.reachability().state, ReachabilityState::Connected);
    let late = NOW + 101 + NO_COORDINATOR_AFTER_MS;
    model.apply_links(2, late);
    assert_eq!((model.reachability().state, model.reachability().since_ms), (ReachabilityState::NoCoordinator, late));
    model.apply_links(0, late + 5);
    assert_eq!(
        (model.reachability().state, model.reachability().last_contact_ms),
        (ReachabilityState::Isolated, Some(NOW + 100))
    );
    // The fleet may have been restarted: after a silence, the next beacon names the coordinator.
    model.apply_beacon(&beacon("bob", 1, 0), late + 10);
    model.apply_links(1, late + 11);
    assert_eq!(model.reachability().state, ReachabilityState::Connected);
}

#[test]
fn tasks_become_bars_and_a_mission_ends_with_its_event() {
    let mut model = model();
    let of = |what: &str, task: &str| json!({ "event": what, "mission": "m-1", "role": "r1", "task": task });
    let apply = |model: &mut FleetModel, at: u64, what: Value| model.apply_event(&event("ada", 1, at, what), at);
    apply(&mut model, NOW, json!({ "event": "submitted", "mission": "m-1", "parameters": { "room": "IC Room 6" } }));
    let awarded = json!({ "event": "awarded", "mission": "m-1", "holders": { "r1": "ada" }, "epoch": { "term": 1, "index": 3 }, "after_ms": 6.5 });
    apply(&mut model, NOW + 7, awarded);
    apply(&mut model, NOW + 10, of("task_began", "go"));
    apply(&mut model, NOW + 50, of("task_ended", "go"));
    apply(&mut model, NOW + 60, of("task_began", "open"));
    apply(&mut model, NOW + 90, of("task_ended", "unheard"));
    apply(
        &mut model,
        NOW + 100,
        json!({ "event": "mission", "mission": "m-1", "state": "completed", "submitted_at_ms": NOW }),
    );
    let shown = &model.missions()["m-1"];
    let bars: Vec<_> = shown.bars.iter().map(|bar| (bar.task.as_str(), bar.state.as_str(), bar.to_ms)).collect();
    assert_eq!(
        bars,
        [("go", "done", Some(NOW + 50)), ("open", "aborted", Some(NOW + 100)), ("unheard", "done", Some(NOW + 90)),]
    );
    assert_eq!((shown.state.as_str(), shown.ended, shown.ended_ms), ("completed", true, Some(NOW + 100)));
    let kpis = model.kpis();
    assert_eq!((kpis.success, kpis.completion_ms, kpis.award_ms), (Some(1.0), Some(100), Some(6.5)));

    // An older list does not change an ended mission back. The end time of a mission is unknown if
    // it had ended before it was first seen.
    let list = json!({ "missions": [
        { "mission": "m-1", "detail": "running", "done": 1, "steps": 3 },
        { "mission": "m-2", "detail": { "failed": { "cause": "no robots", "class": "transient" } }, "submitted_at_ms": 5 },
    ] });
    model.apply_view(&Key::ViewMissions, &list, NOW + 200);
    assert_eq!(model.missions()["m-1"].state, "completed");
    let failed = &model.missions()["m-2"];
    assert_eq!((failed.cause.as_deref(), failed.ended_ms), (Some("no robots"), None));
    assert_eq!(failed.cause_class, Some(CauseClass::Transient));
    assert_eq!(model.kpis().success, Some(0.5));
}

#[test]
fn an_auction_contains_every_bid_with_its_parts_and_the_winner() {
    let mut model = model();
    let apply = |model: &mut FleetModel, what: Value| model.apply_event(&event("ada", 1, NOW, what), NOW);
    apply(&mut model, json!({ "event": "bids_requested", "mission": "m-1", "roles": ["r1"], "round": 1, "asked": 2 }));
    let bid = json!({ "robot": "bob", "role": "r1", "time": 99.5, "energy": 0.06, "remaining": 0.84, "useful_charge": 0.08,
        "from": "Dock", "age_ms": 3, "parts": [{ "step": 0, "label": "navto_room", "skill": "navigation", "time": 60.0, "energy": 0.04 }] });
    apply(&mut model, json!({ "event": "bid", "mission": "m-1", "bid": bid }));
    let auction = json!({ "mission": "m-1", "term": 1, "round": 1 });
    let record = json!({ "auction": auction, "at_ms": NOW, "omitted": 0, "chosen": { "r1": "bob" }, "failure": null, "entries": [
        { "role": "r1", "robot": "bob", "verdict": { "viable": { "time": 99.5, "energy": 0.06, "remaining": 0.84 } } },
        { "role": "r1", "robot": "cyd", "verdict": { "refused": { "reason": { "missing_skills": { "skills": ["navigation"] } } } } },
    ] });
    apply(&mut model, json!({ "event": "closed", "mission": "m-1", "record": record }));
    // The views contain the same record without parts: the parts are kept.
    model.apply_view(&Key::ViewAuctions, &json!({ "auctions": [record] }), NOW);
    let (name, shown) = model.auctions().first_key_value().unwrap();
    assert_eq!((name.as_str(), shown.offers.len()), ("m-1#1.1", 2));
    let (bob, cyd) = (&shown.offers[0], &shown.offers[1]);
    assert!(bob.chosen && !cyd.chosen);
    assert_eq!((bob.time_s, bob.from.as_deref()), (Some(99.5), Some("Dock")));
    assert_eq!(bob.parts.as_ref().unwrap()[0].label, "navto_room");
    assert_eq!((cyd.verdict.as_str(), cyd.why.as_deref()), ("refused", Some("lacks navigation")));
}

#[test]
fn utilization_counts_the_time_of_busy_robots() {
    let mut model = model();
    let node = |name: &str, availability: Value| json!({ "node": name, "alive": true, "robot": worker(availability) });
    let holding = json!({ "holding": { "mission": "m-1", "role": "r1", "suspended": false } });
    let out = json!({ "out_of_service": { "problem": "no charge" } });
    let nodes = json!([node("ada", holding), node("bob", json!("free")), node("cyd", out)]);
    model.apply_view(&Key::ViewFleet, &fleet(nodes), NOW);
    model.apply_links(1, NOW);
    model.apply_links(1, NOW + 1000);
    let kpis = model.kpis();
    assert_eq!((kpis.busy, kpis.in_service, kpis.utilisation), (1, 2, Some(0.5)));
}

#[test]
fn a_robot_at_work_shows_the_orders_of_people() {
    let mut model = model();
    let holding = || json!({ "holding": { "mission": "m-1", "role": "r1", "suspended": false } });
    let order = json!({ "by": "Nia", "reason": "a spill", "since_ms": NOW, "until_ms": NOW + 600_000 });
    let mut show = |hold: &Value, by_ledger: bool| {
        let orders = json!({ "hold": hold, "maintenance": null });
        let node = json!({ "node": "ada", "alive": true, "robot": worker(holding()), "orders": orders });
        let mut view = fleet(json!([node]));
        view["closures"] = if by_ledger { json!([]) } else { Value::Null };
        model.apply_view(&Key::ViewFleet, &view, NOW);
        let robot = model.to_json()["robots"]["ada"].clone();
        (robot["problem"].clone(), robot["orders"].clone())
    };
    let held = (json!("held by Nia: a spill"), json!({ "hold": order }));
    assert_eq!(show(&order, true), held);
    assert_eq!(show(&Value::Null, false), held, "a node without a ledger does not know them");
    assert_eq!(show(&Value::Null, true), (Value::Null, Value::Null));
}

#[test]
fn a_free_robot_at_a_charger_is_shown_as_charging() {
    let mut model = model();
    let claim = json!({ "charger": "Dock", "battery": 0.2 });
    let node = |name: &str, charging: Value| {
        let mut robot = worker(json!("free"));
        robot["charging"] = charging;
        json!({ "node": name, "alive": true, "robot": robot })
    };
    let nodes = [
        node("ada", json!({ "connected": claim })),
        node("bob", json!({ "bound": claim })),
        node("cyd", json!({ "waiting": { "chargers": ["Dock"] } })),
    ];
    model.apply_view(&Key::ViewFleet, &fleet(json!(nodes)), NOW);
    let shown = ["ada", "bob", "cyd"].map(|name| model.robots()[name].availability.as_str());
    assert_eq!(shown, ["charging", "free", "free"]);
}

/// Returns the assignments of a role: the robot, start and end in milliseconds after the start, and
/// the state.
fn assignments(model: &FleetModel) -> Vec<(&str, u64, Option<u64>, &str)> {
    let all = model.missions()["m-1"].assignments.iter();
    let since = |ms: u64| ms - NOW;
    all.map(|one| (one.by.as_str(), since(one.from_ms), one.to_ms.map(since), one.state.as_str())).collect()
}

#[test]
fn each_assignment_of_a_role_has_its_times_and_planned_end() {
    let mut model = model();
    let apply = |model: &mut FleetModel, node: &str, at: u64, what: Value| {
        model.apply_event(&event(node, 1, NOW + at, what), NOW + at);
    };
    let of = |what: &str| json!({ "event": what, "mission": "m-1", "role": "r1" });
    let auction = |round: u32, robot: &str, time: f64| {
        let auction = json!({ "mission": "m-1", "term": 1, "round": round });
        let record = json!({ "auction": auction, "at_ms": NOW, "omitted": 0, "chosen": { "r1": robot }, "failure": null, "entries": [
            { "role": "r1", "robot": robot, "verdict": { "viable": { "time": time, "energy": 0.06, "remaining": 0.84 } } }] });
        json!({ "event": "closed", "mission": "m-1", "record": record })
    };
    let award = |index: u64, robot: &str| json!({ "event": "awarded", "mission": "m-1", "holders": { "r1": robot }, "epoch": { "term": 1, "index": index }, "after_ms": 6.5 });
    apply(&mut model, "s1", 0, auction(1, "ada", 60.0));
    apply(&mut model, "s1", 1, award(3, "ada"));
    apply(
        &mut model,
        "ada",
        2,
        json!({ "event": "started", "mission": "m-1", "role": "r1", "epoch": { "term": 1, "index": 3 } }),
    );
    assert_eq!(assignments(&model), [("ada", 1, None, "active")], "begun once");
    // World time runs five times as fast: 60 s are planned as 12 s.
    let at = |world_s: f64| Telemetry { time: WorldTime::from_secs(world_s), ..telemetry(1.0, 1.0) };
    for (world_s, at_ms) in [(100.0, 10), (102.0, 410), (115.0, 3010)] {
        model.apply_telemetry("ada", &at(world_s), NOW + at_ms);
        model.apply_links(1, NOW + at_ms);
    }
    assert_eq!(model.missions()["m-1"].assignments[0].planned_ms, Some(12_000));

    apply(&mut model, "ada", 4000, of("suspended"));
    assert_eq!(assignments(&model), [("ada", 1, None, "suspended")]);
    apply(&mut model, "s1", 5000, json!({ "event": "released", "mission": "m-1", "role": "r1", "cause": "silent" }));
    apply(&mut model, "s1", 5100, auction(2, "bob", 40.0));
    apply(&mut model, "s1", 5200, award(9, "bob"));
    // The previous holder reports late; the report changes nothing.
    apply(&mut model, "ada", 6000, json!({ "event": "halted", "mission": "m-1", "role": "r1", "reason": "replaced" }));
    model.apply_links(1, NOW + 6100);
    let completed = json!({ "event": "mission", "mission": "m-1", "state": "completed", "submitted_at_ms": NOW });
    apply(&mut model, "s1", 9000, completed);
    assert_eq!(assignments(&model), [("ada", 1, Some(5000), "released"), ("bob", 5200, Some(9000), "completed")]);
    assert_eq!(model.missions()["m-1"].assignments[1].planned_ms, Some(8000));
}

#[test]
fn a_late_client_learns_role_holders_from_the_ledger() {
    let mut model = model();
    let mission = |phase: &str, holder: &str| {
        json!({ "mission": "m-1", "detail": "running", "done": 1, "steps": 3, "roles": [
            { "role": "r1", "kind": "managed", "phase": phase, "holder": holder },
            { "role": "nurse", "kind": "unmanaged", "phase": "open", "holder": null },
        ] })
    };
    let key = Key::ViewMission("m-1".parse().unwrap());
    model.apply_view(&key, &mission("active", "ada"), NOW + 100);
    assert_eq!(assignments(&model), [("ada", 100, None, "active")]);
    let released = json!({ "event": "released", "mission": "m-1", "role": "r1", "cause": "silent" });
    model.apply_event(&event("s1", 1, NOW + 5000, released), NOW + 5000);
    // A view from before the release does not restore the previous holder.
    model.apply_view(&key, &mission("active", "ada"), NOW + 5100);
    assert_eq!(assignments(&model), [("ada", 100, Some(5000), "released")]);
    model.apply_view(&key, &mission("active", "bob"), NOW + 8000);
    model.apply_view(&key, &mission("ended", "bob"), NOW + 12_000);
    assert_eq!(assignments(&model)[1..], [("bob", 8000, Some(12_000), "completed")]);
}

#[test]
fn health_findings_come_from_the_nearest_node() {
    let mut model = model();
    let view = json!({ "level": "warning", "findings": [
        { "level": "warning", "about": "node", "name": "bob", "text": "bob is down; last contact 9.0 s ago" }] });
    model.apply_view(&Key::ViewHealth, &view, NOW);
    let [finding] = model.health() else { panic!("{:?}", model.health()) };
    assert_eq!((finding.level, finding.name.as_deref()), (HealthLevel::Warning, Some("bob")));
    assert_eq!(model.to_json()["health"], view["findings"]);
}

#[test]
fn schedules_have_their_next_occurrences() {
    let mut model = model();
    // 2027-03-26 08:00 in Berlin. In the night to 2027-03-28 the clocks go forward.
    let first: u64 = 1_806_044_400_000;
    let view = |cron: &str, change: Value| {
        let mut schedule = json!({
            "schedule": "rounds", "mission": "vital-signs", "cron": cron, "zone": "Europe/Berlin", "next_ms": first,
        });
        schedule.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        json!({ "schedules": [schedule] })
    };
    let mut upcoming = |view: Value| {
        model.apply_view(&Key::ViewSchedules, &view, NOW);
        assert_eq!(
            model.to_json()["schedules"]["rounds"]["upcoming_ms"],
            json!(model.schedules()["rounds"].upcoming_ms)
        );
        model.schedules()["rounds"].upcoming_ms.clone()
    };
    let daily = [0, 24, 47, 71, 95, 119, 143, 167].map(|hours| first + hours * 3_600_000);
    assert_eq!(upcoming(view("0 8 * * *", json!({}))), daily);
    let end = json!({ "until_ms": daily[2] });
    assert_eq!(upcoming(view("0 8 * * *", end)), daily[..3]);
    assert_eq!(upcoming(view("* * * * *", json!({}))).len(), bounds::OCCURRENCES);
    let paused = json!({ "next_ms": null, "pause": { "by": "Nia", "since_ms": NOW } });
    assert!(upcoming(view("0 8 * * *", paused)).is_empty());
    model.apply_view(&Key::ViewSchedules, &json!({ "schedules": [] }), NOW);
    assert_eq!(model.schedules().len(), 0, "it was removed");
}

#[test]
fn closures_are_those_of_the_latest_view() {
    let mut model = model();
    let order = json!({ "by": "Nia", "reason": "wet floor", "since_ms": 5, "until_ms": null });
    let mut view = fleet(json!([{ "node": "ada", "alive": true, "robot": worker(json!("free")) }]));
    view["closures"] = json!([
        { "part": { "place": "IC Room 6" }, "order": order },
        { "part": { "lane": ["A", "B"] }, "order": order },
        { "part": { "zone": { "name": "icu", "places": ["IC Room 4", "IC Room 5"] } }, "order": order },
    ]);
    model.apply_view(&Key::ViewFleet, &view, NOW);
    let order = json!({ "by": "Nia", "reason": "wet floor", "since_ms": 5 });
    let expected = json!({
        "IC Room 6": { "part": { "place": "IC Room 6" }, "order": order },
        "A – B": { "part": { "lane": ["A", "B"] }, "order": order },
        "zone icu": { "part": { "zone": { "name": "icu", "places": ["IC Room 4", "IC Room 5"] } }, "order": order },
    });
    assert_eq!(model.to_json()["closures"], expected);
    // A node without a ledger does not know them.
    let mut unknown = fleet(json!([{ "node": "bob", "alive": true, "robot": worker(json!("free")) }]));
    unknown.as_object_mut().unwrap().remove("closures");
    for closures in [None, Some(Value::Null)] {
        unknown.as_object_mut().unwrap().extend(closures.map(|closures| ("closures".to_owned(), closures)));
        model.apply_view(&Key::ViewFleet, &unknown, NOW);
        assert_eq!(model.robots().keys().collect::<Vec<_>>(), ["bob"]);
        assert_eq!(model.to_json()["closures"], expected);
    }
    view["closures"] = json!([]);
    model.apply_view(&Key::ViewFleet, &view, NOW);
    assert_eq!(model.to_json()["closures"], json!({}));
}

#[test]
fn alarms_and_speed_limits_are_those_of_the_latest_view() {
    let mut model = model();
    let mut view = fleet(json!([]));
    let order = json!({ "by": "Nia", "reason": "smoke", "since_ms": 5, "until_ms": null });
    let plan = json!({ "robots": "assemble", "places": ["Dock"], "closes": [{ "lane": ["A", "B"] }] });
    view["alarms"] = json!([{ "alarm": "fire", "plan": plan, "order": order }]);
    view["speed_limits"] = json!([{ "part": { "place": "IC Room 6" }, "speed_mps": 0.3, "order": order }]);
    view["declared"] = json!({ "alarms": { "fire": plan }, "zones": { "icu": ["IC Room 5", "IC Room 6"] } });
    model.apply_view(&Key::ViewFleet, &view, NOW);
    let order = json!({ "by": "Nia", "reason": "smoke", "since_ms": 5 });
    let rendered = model.to_json();
    assert_eq!(rendered["alarms"], json!({ "fire": { "alarm": "fire", "plan": plan, "order": order } }));
    let limit = json!({ "part": { "place": "IC Room 6" }, "speed_mps": 0.3, "order": order });
    assert_eq!(rendered["speed_limits"], json!({ "IC Room 6": limit }));
    assert_eq!(rendered["declared_alarms"], json!({ "fire": plan }));
    assert_eq!(rendered["zones"], json!({ "icu": ["IC Room 5", "IC Room 6"] }));
    let mut unknown = view.clone();
    (unknown["alarms"], unknown["speed_limits"]) = (Value::Null, Value::Null);
    model.apply_view(&Key::ViewFleet, &unknown, NOW);
    for section in ["alarms", "speed_limits"] {
        assert_eq!(model.to_json()[section], rendered[section], "a node without a ledger does not know them");
    }
    let mut none = fleet(json!([]));
    (none["alarms"], none["speed_limits"]) = (json!([]), json!([]));
    model.apply_view(&Key::ViewFleet, &none, NOW);
    let rendered = model.to_json();
    for section in ["alarms", "speed_limits", "declared_alarms", "zones"] {
        assert_eq!(rendered[section], json!({}), "{section}");
    }
}

#[test]
fn declarations_do_not_alternate_while_nodes_with_different_files_reply() {
    let mut model = model();
    let mut zones_after = |hash: &str, zone: &str| {
        let mut view = fleet(json!([]));
        view["declared"] = json!({ "alarms": {}, "zones": { zone: ["IC Room 5"] }, "hash": hash });
        model.apply_view(&Key::ViewFleet, &view, NOW);
        model.zones().keys().map(|zone| zone.to_string()).collect::<Vec<_>>()
    };
    for _ in 0..10 {
        assert_eq!(zones_after("1", "icu"), ["icu"]);
        assert_eq!(zones_after("2", "ward"), ["icu"]);
    }
    zones_after("1", "icu");
    let later = [(); 6].map(|()| zones_after("2", "ward").concat());
    assert_eq!(later, ["icu", "icu", "icu", "icu", "ward", "ward"], "all nodes have the other file now");
}

#[test]
fn consecutive_patches_equal_the_whole_model() {
    let mut model = model();
    let (mut drawn, mut seen) = (Value::Null, Value::Null);
    model.render_patch(&mut drawn);
    delta::apply(&mut seen, &drawn);
    let holding = json!({ "holding": { "mission": "m-1", "role": "r1", "suspended": false } });
    let node = |name: &str, availability: &Value| json!({ "node": name, "alive": true, "robot": worker(availability.clone()) });
    let steps: [&dyn Fn(&mut FleetModel); 7] = [
        &|model| {
            model.apply_view(&Key::ViewFleet, &fleet(json!([node("ada", &holding), node("bob", &json!("free"))])), NOW);
        },
        &|model| model.apply_telemetry("ada", &telemetry(3.0, 4.0), NOW + 1),
        &|model| {
            model.apply_view(
                &Key::ViewMissions,
                &json!({ "missions": [{ "mission": "m-1", "detail": "running" }] }),
                NOW,
            );
        },
        &|model| {
            model.apply_view(&Key::ViewWorld, &json!({ "doors": [{ "name": "Narrow", "state": "open" }] }), NOW);
        },
        &|model| model.apply_view(&Key::ViewFleet, &fleet(json!([node("bob", &holding)])), NOW),
        &|model| model.apply_view(&Key::ViewWorld, &json!({ "doors": [] }), NOW),
        &|model| {
            model.apply_view(
                &Key::ViewMap,
                &serde_json::to_value(LoadedMap::from(map::read(SHED, "shed.yaml").unwrap()).to_view()).unwrap(),
                NOW,
            );
        },
    ];
    for (number, step) in steps.iter().enumerate() {
        step(&mut model);
        let patch = model.render_patch(&mut drawn).unwrap_or_else(|| panic!("step {number} changes something"));
        delta::apply(&mut seen, &patch);
        assert_eq!(delta::between(&seen, &model.to_json()), None, "after step {number}");
        assert_eq!(delta::between(&drawn, &seen), None, "after step {number}");
    }
    assert_eq!(model.render_patch(&mut drawn), None);
}

#[test]
fn a_fleet_model_has_a_bounded_size() {
    let mut model = model();
    for number in 0..3 * bounds::EVENTS as u64 {
        let of = |what: &str| json!({ "event": what, "mission": "m-0", "role": "r1", "task": "go" });
        model.apply_event(&event("ada", number, NOW + number, of("task_began")), NOW);
        model.apply_beacon(&beacon("ada", number, 0), NOW + number);
    }
    assert_eq!(model.missions()["m-0"].bars.len(), bounds::BARS);
    let ended: Vec<Value> = (0..2 * bounds::ENDED_MISSIONS)
        .map(|number| json!({ "mission": format!("m-{number}"), "detail": "completed" }))
        .collect();
    model.apply_view(&Key::ViewMissions, &json!({ "missions": ended }), NOW);
    assert_eq!(model.log().len(), bounds::EVENTS);
    assert_eq!(*model.log().last_key_value().unwrap().0, 3 * bounds::EVENTS as u64);
    assert_eq!(model.takeovers().len(), bounds::TAKEOVERS);
    assert_eq!(model.missions().len(), bounds::ENDED_MISSIONS);
    assert!(model.missions().contains_key("m-599"));
}

#[test]
fn invalid_views_and_unchanged_values_produce_no_patch() {
    let mut model = model();
    let before = model.to_json();
    for view in [json!(null), json!([]), json!({ "nodes": 7, "missions": "x", "auctions": [{}], "people": [1] })] {
        for key in [Key::ViewFleet, Key::ViewCoordinator, Key::ViewMissions, Key::ViewAuctions, Key::ViewWorld] {
            model.apply_view(&key, &view, NOW);
        }
    }
    let mut after = model.to_json();
    after["views"] = json!({});
    assert_eq!(delta::between(&before, &after), None);

    model.apply_telemetry("ada", &telemetry(1.0, 1.0), NOW);
    let before = model.to_json();
    model.apply_telemetry("ada", &telemetry(1.5, 1.0), NOW + 200);
    let patch = delta::between(&before, &model.to_json()).unwrap();
    assert_eq!(patch, json!({ "robots": { "ada": { "x": 1.5, "telemetry_ms": NOW + 200 } } }));
}

#[test]
fn a_robot_has_the_latest_readings_of_its_driver() {
    let mut model = model();
    let with = |readings: Value| {
        let mut report = serde_json::to_value(telemetry(1.0, 1.0)).unwrap();
        report["readings"] = readings;
        serde_json::from_value::<Telemetry>(report).unwrap()
    };
    model.apply_telemetry("ada", &with(json!({ "bag_g": 2.5, "lid": true })), NOW);
    assert_eq!(model.to_json()["robots"]["ada"]["readings"], json!({ "bag_g": 2.5, "lid": true }));
    model.apply_telemetry("ada", &with(json!({ "lid": false })), NOW + 200);
    assert_eq!(model.to_json()["robots"]["ada"]["readings"], json!({ "lid": false }));
}

#[test]
fn a_robot_has_the_feedback_of_its_goal_in_progress() {
    let mut model = model();
    let report = |feedback: Value| FleetInput::Telemetry {
        robot: "ada".to_owned(),
        telemetry: telemetry(1.0, 1.0),
        feedback: serde_json::from_value(feedback).unwrap(),
    };
    model.apply(&report(json!({ "phase": "rinse", "soaked": 0.5 })), NOW);
    assert_eq!(model.to_json()["robots"]["ada"]["feedback"], json!({ "phase": "rinse", "soaked": 0.5 }));
    model.apply(&report(json!({})), NOW + 200);
    assert_eq!(model.to_json()["robots"]["ada"]["feedback"], Value::Null, "the goal has ended");
}

#[test]
fn a_forecast_begins_again_when_the_availability_changes() {
    let mut model = model();
    let charge = |battery: f64| {
        let mut report = serde_json::to_value(telemetry(1.0, 1.0)).unwrap();
        report["battery"] = json!(battery);
        serde_json::from_value::<Telemetry>(report).unwrap()
    };
    let view = |charging: Value| {
        let mut record = worker(json!("free"));
        record["charging"] = charging;
        let mut view = fleet(json!([{ "node": "ada", "alive": true, "robot": record }]));
        view["charging"] = json!({ "below": 0.3, "until": 0.9, "chargers": ["Dock"] });
        view
    };
    model.apply_view(&Key::ViewFleet, &view(Value::Null), NOW);
    for (after_ms, battery) in [(0, 0.5), (10_000, 0.4)] {
        model.apply_telemetry("ada", &charge(battery), NOW + after_ms);
    }
    let shown = model.to_json();
    assert_eq!(shown["robots"]["ada"]["forecast"], json!({ "share": 0.3, "at_ms": NOW + 20_000 }));
    assert_eq!(shown["charging"], json!({ "below": 0.3, "until": 0.9, "chargers": ["Dock"] }));
    let claim = json!({ "connected": { "charger": "Dock", "battery": 0.4 } });
    model.apply_view(&Key::ViewFleet, &view(claim.clone()), NOW + 11_000);
    let shown = model.to_json();
    assert_eq!(shown["robots"]["ada"]["charging"], claim);
    assert_eq!(shown["robots"]["ada"]["forecast"], Value::Null);
    for (after_ms, battery) in [(20_000, 0.4), (30_000, 0.5)] {
        model.apply_telemetry("ada", &charge(battery), NOW + after_ms);
    }
    let forecast = model.to_json()["robots"]["ada"]["forecast"].clone();
    assert_eq!(forecast, json!({ "share": 0.9, "at_ms": NOW + 70_000 }));
}

#[test]
fn promised_roles_have_planned_starts_and_the_time_of_their_world() {
    let mut model = model();
    let at = |world_s: f64| Telemetry { time: WorldTime::from_secs(world_s), ..telemetry(1.0, 1.0) };
    // The world is twice as fast as the clock.
    for (at_ms, world_s) in [(0, 0.0), (5_000, 10.0)] {
        model.apply_telemetry("ada", &at(world_s), NOW + at_ms);
    }
    let mut ada = json!({ "node": "ada", "alive": true, "robot": worker(json!("free")) });
    ada["promised"] = json!([
        { "mission": "m-3", "role": "r2", "planned_at_ms": NOW + 50_000, "time_s": 50.0 },
        { "mission": "m-2", "role": "r1", "planned_at_ms": NOW + 80_000, "time_s": null },
    ]);
    model.apply_view(&Key::ViewFleet, &fleet(json!([ada])), NOW + 5_000);
    let expected = json!([
        { "mission": "m-3", "role": "r2", "start_ms": NOW + 50_000, "planned_ms": 25_000 },
        { "mission": "m-2", "role": "r1", "start_ms": NOW + 80_000 },
    ]);
    assert_eq!(model.to_json()["robots"]["ada"]["next"], expected);
}

#[test]
fn a_mission_has_the_results_of_its_tasks() {
    let mut model = model();
    let key = Key::ViewMission("m-1".parse().unwrap());
    let view = |results: Value| {
        let task = |name: &str, results: &Value| {
            json!({ "kind": "elementary", "task": name, "type": "measure_vital_signs", "parameters": {}, "state": "done",
                "roles": [], "results": results })
        };
        let children = [task("first", &results), task("second", &json!({}))];
        let tree =
            json!({ "kind": "abstract", "task": "all", "order": "sequential", "state": "done", "children": children });
        json!({ "mission": "m-1", "detail": "running", "tree": tree })
    };
    let shown = |model: &FleetModel| model.to_json()["missions"]["m-1"]["task_results"].clone();
    model.apply_view(&key, &view(json!({})), NOW);
    assert_eq!(shown(&model), Value::Null);
    model.apply_view(&key, &view(json!({ "pulse_bpm": 72, "fever": false })), NOW + 10);
    assert_eq!(shown(&model), json!({ "first": { "pulse_bpm": 72, "fever": false } }));
    // A node that lags behind has fewer results.
    model.apply_view(&key, &view(json!({})), NOW + 20);
    assert_eq!(shown(&model), json!({ "first": { "pulse_bpm": 72, "fever": false } }));
}

#[test]
fn a_mission_shows_the_orders_about_its_roles_until_they_end() {
    let mut model = model();
    let key = Key::ViewMission("m-1".parse().unwrap());
    let mut shown = |orders: Value| {
        let view = json!({ "mission": "m-1", "detail": "running", "orders": orders });
        model.apply_view(&key, &view, NOW + 100);
        model.to_json()["missions"]["m-1"]["orders"].clone()
    };
    assert_eq!(shown(json!({ "r1": "pinned to ada" })), json!({ "r1": "pinned to ada" }));
    assert_eq!(shown(json!({})), Value::Null);
}
