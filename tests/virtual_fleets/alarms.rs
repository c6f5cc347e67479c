//! People raise alarms: robots stand still or assemble, and go on with their missions after the all-clear.

use crate::support::{audited_changes, fleet_of, longer_than_a_lease, released, request, slow_carriers, task_began};
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::Availability;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const ROOMS: [&str; 2] = ["IC Room 6", "IC Room 5"];
const ROOM_AT: (f64, f64) = (9.5, 31.0);
const CARRIERS: [&str; 3] = ["fern", "gorse", "heath"];
const STATIONS: [&str; 3] = ["aster", "basil", "clove"];
/// Positions in metres of the assembly places of the alarm `fire`, which closes the crossing between them.
const ASSEMBLY: [(f64, f64); 3] = [(6.0, 2.5), (6.0, 13.0), (32.5, 7.0)];
/// Longer than a drive of the slow carriers through the hospital.
const SOON: Duration = Duration::from_secs(120);

async fn raise(fleet: &Fleet, alarm: &str) -> Value {
    request(fleet, ApiCall::Alarm, &json!({ "action": "raise", "alarm": alarm, "reason": "smoke", "by": "Nia" })).await
}

async fn clear(fleet: &Fleet, alarm: Option<&str>) -> Value {
    request(fleet, ApiCall::Alarm, &json!({ "action": "clear", "alarm": alarm, "by": "Abe" })).await
}

/// Starts three slow carriers, far from the rooms, and three stations; `aster` coordinates.
async fn fleet(seed: u64) -> Fleet {
    let mut robots = slow_carriers();
    robots.push(RobotSpec::carrier("heath", "PC Room 2").with_speed(0.5));
    let adjust = |settings: &mut NodeSettings| settings.fleet.stall_timeout = Duration::from_secs(900);
    let mut fleet = fleet_of(seed, robots, &ROOMS, adjust).await;
    fleet.wait_for_audit_trail().await;
    fleet
}

/// Two missions, each with the carrier that performs it.
struct UnderWay {
    fleet: Fleet,
    missions: [(MissionId, String); 2],
}

/// Starts two missions, and waits until both carriers drive; the third carrier is free.
async fn under_way(seed: u64) -> UnderWay {
    let mut fleet = fleet(seed).await;
    let starts = CARRIERS.map(|carrier| fleet.position(carrier));
    let missions = [fleet.submit("a", ROOMS[0]).await, fleet.submit("b", ROOMS[1]).await];
    let both_drive = |fleet: &Fleet| {
        let moved = CARRIERS.iter().zip(starts).filter(|(carrier, start)| fleet.position(carrier) != *start);
        moved.count() == 2 && fleet.event_log.count(task_began("navto_room")) == 2
    };
    fleet.wait_until("two carriers on their way", SOON, both_drive).await;
    let missions = missions.map(|mission| {
        let carrier = fleet.holder(&mission, "r1").expect("held").to_string();
        (mission, carrier)
    });
    UnderWay { fleet, missions }
}

fn is_at(fleet: &Fleet, robot: &str, place: (f64, f64)) -> bool {
    let (x, y) = fleet.position(robot);
    (x - place.0).hypot(y - place.1) < 0.3
}

fn is_assembled(fleet: &Fleet, robot: &str) -> bool {
    ASSEMBLY.into_iter().any(|place| is_at(fleet, robot, place))
}

/// Asserts that the carriers do not move, and that no role is released, for a while.
async fn assert_still(fleet: &mut Fleet, during: Duration) {
    let places = CARRIERS.map(|carrier| fleet.position(carrier));
    let changed =
        |fleet: &Fleet| CARRIERS.map(|carrier| fleet.position(carrier)) != places || fleet.has_event(released);
    fleet.assert_never("a move or a release", during, changed).await;
}

/// Waits until all carriers stand at assembly places.
async fn wait_for_assembly(fleet: &mut Fleet) {
    let all = |fleet: &Fleet| CARRIERS.iter().all(|carrier| is_assembled(fleet, carrier));
    fleet.wait_until("all carriers at assembly places", SOON, all).await;
    wait_for_rest(fleet).await;
}

async fn wait_for_rest(fleet: &mut Fleet) {
    for carrier in CARRIERS {
        fleet.wait_for_rest(carrier).await;
    }
}

/// Asserts that the missions complete under their first awards, and that each of their tasks ends once.
async fn assert_goes_on(fleet: &mut Fleet, missions: &[(MissionId, String)]) {
    for (mission, carrier) in missions {
        fleet.assert_completes(mission).await;
        let holder = fleet.holder(mission, "r1");
        assert_eq!(holder.as_ref().map(RobotId::as_str), Some(carrier.as_str()), "seed {}", fleet.seed);
        for (task, (_, ended)) in fleet.task_counts(mission) {
            assert_eq!(ended, 1, "seed {}: {task} of {mission}\n{}", fleet.seed, fleet.event_log_text());
        }
    }
    fleet.assert_exclusive_roles();
    assert_eq!(fleet.event_log.count(released), 0, "seed {}\n{}", fleet.seed, fleet.event_log_text());
}

#[test]
fn an_alarm_stops_every_robot_until_it_is_cleared() {
    for_each_seed([1501, 1502, 1503], async |seed| {
        let UnderWay { mut fleet, missions } = under_way(seed).await;
        let reply = raise(&fleet, "freeze").await;
        assert_eq!(reply["alarms"][0]["alarm"], "freeze", "seed {seed}: {reply}");
        wait_for_rest(&mut fleet).await;
        let third = fleet.submit("c", ROOMS[0]).await;
        assert_still(&mut fleet, longer_than_a_lease()).await;
        assert_eq!(fleet.holder(&third, "r1"), None, "seed {seed}: no robot gets a role");
        let explained = fleet.request_answered(ApiCall::Explain, &json!({ "mission": third })).await;
        assert!(explained["text"].to_string().contains("under alarm freeze by Nia: smoke"), "seed {seed}: {explained}");
        let (view, health) = (fleet.view_of("aster", "fleet").await, fleet.view_of("aster", "health").await);
        assert_eq!(view["alarms"][0]["order"]["by"], "Nia", "seed {seed}: {view}");
        let view = fleet.view_of("world", "fleet").await;
        assert_eq!(view.get("alarms"), Some(&Value::Null), "seed {seed}: a node without a ledger does not know them");
        let finding = "the fleet is under alarm freeze by Nia: smoke";
        assert!(health.to_string().contains(finding), "seed {seed}: {health}");
        // Its nurse has a single sample.
        request(&fleet, ApiCall::Cancel, &json!({ "mission": third })).await;
        let reply = clear(&fleet, None).await;
        assert_eq!(reply["alarms"], json!([]), "seed {seed}");
        assert_goes_on(&mut fleet, &missions).await;
        let changes = fleet.events().into_iter().filter_map(|what| match what {
            EventKind::AlarmChanged { alarm, raised } => Some((alarm.to_string(), raised.is_some())),
            _ => None,
        });
        let expected = [("freeze".to_owned(), true), ("freeze".to_owned(), false)];
        assert_eq!(changes.collect::<Vec<_>>(), expected, "seed {seed}");
        let mut of_alarms = audited_changes(&fleet).await;
        of_alarms.retain(|[_, action, _]| action.as_str().is_some_and(|action| action.ends_with("alarm")));
        let expected = json!([["Nia", "raise_alarm", "freeze"], ["Abe", "clear_alarm", "all"]]);
        assert_eq!(json!(of_alarms), expected, "seed {seed}");
    });
}

#[test]
fn robots_assemble_under_the_next_coordinator_and_go_on_after_the_all_clear() {
    for_each_seed([1511, 1512, 1513], async |seed| {
        let UnderWay { mut fleet, missions } = under_way(seed).await;
        raise(&fleet, "fire").await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        wait_for_assembly(&mut fleet).await;
        fleet.wait_for_coordinator().await;
        assert_still(&mut fleet, longer_than_a_lease()).await;
        clear(&fleet, Some("fire")).await;
        assert_goes_on(&mut fleet, &missions).await;
        ROOMS.iter().for_each(|room| fleet.assert_sample_delivered(room));
    });
}

#[test]
fn an_alarm_survives_the_restart_of_all_nodes() {
    for_each_seed([1521, 1522], async |seed| {
        let UnderWay { mut fleet, missions } = under_way(seed).await;
        raise(&fleet, "freeze").await;
        wait_for_rest(&mut fleet).await;
        let nodes: Vec<&str> = STATIONS.iter().chain(&CARRIERS).copied().chain(["lab-arm"]).collect();
        for node in &nodes {
            fleet.kill(node).await;
        }
        for node in &nodes {
            fleet.restart(node).await;
        }
        assert_still(&mut fleet, longer_than_a_lease()).await;
        fleet.wait_for_coordinator().await;
        let raised = fleet.ledger(|ledger| ledger.alarms().count());
        assert_eq!(raised, Some(1), "seed {seed}");
        clear(&fleet, None).await;
        for (mission, _) in &missions {
            fleet.assert_completes(mission).await;
        }
    });
}

#[test]
fn a_robot_returns_to_the_person_that_it_left_even_after_a_restart() {
    for_each_seed([1531, 1532, 1533], async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = fleet.submit("a", ROOMS[0]).await;
        fleet.wait_until("the nurse", SOON, |fleet| fleet.has_event(task_began("approach_nurse"))).await;
        let carrier = fleet.holder(&mission, "r1").expect("held").to_string();
        raise(&fleet, "fire").await;
        fleet.wait_until("the carrier at an assembly place", SOON, |fleet| is_assembled(fleet, &carrier)).await;
        fleet.kill(&carrier).await;
        fleet.restart(&carrier).await;
        let leaves = |fleet: &Fleet| !is_assembled(fleet, &carrier) || fleet.has_event(released);
        fleet.assert_never("a departure or a release", longer_than_a_lease(), leaves).await;
        clear(&fleet, None).await;
        fleet.wait_until("the return to the room", SOON, |fleet| is_at(fleet, &carrier, ROOM_AT)).await;
        assert_goes_on(&mut fleet, &[(mission, carrier)]).await;
        fleet.assert_sample_delivered(ROOMS[0]);
    });
}

/// No other robot could take the role.
#[test]
fn a_free_robot_keeps_its_promised_role_during_an_alarm() {
    for_each_seed([1535, 1536], async |seed| {
        let mut robots = slow_carriers();
        robots.push(RobotSpec::carrier("heath", "PC Room 2").with_skill("wait"));
        let mut fleet = fleet_of(seed, robots, &[], |_: &mut NodeSettings| {}).await;
        fleet.wait_for_audit_trail().await;
        let (managed, room) = (json!({ "kind": "managed" }), ROOMS[0]);
        let drive = json!({ "task": "go", "type": "navigation", "roles": ["cart"], "parameters": { "to": room } });
        let wait =
            |task: &str| json!({ "task": task, "type": "wait", "roles": ["arm"], "parameters": { "seconds": "5" } });
        let first = json!({ "mission": "rest", "roles": { "arm": managed }, "root": wait("rest") });
        let mission = json!({
            "mission": "go-and-act", "roles": { "cart": managed, "arm": managed },
            "root": { "task": "all", "method": "sequential", "tasks": [drive, wait("act")] },
        });
        request(&fleet, ApiCall::Submit, &json!({ "mission": first, "request": "first" })).await;
        fleet.wait_until("the first mission", SOON, |fleet| fleet.has_event(task_began("rest"))).await;
        let reply = request(&fleet, ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
        let mission: MissionId = slug(reply["mission"].as_str().expect("a mission"));
        // The arm was busy when the cart got its role, and is free before the cart arrives.
        let record = |fleet: &Fleet| fleet.knowledge_of("aster", &slug("heath"));
        let is_free = |fleet: &Fleet| record(fleet).is_some_and(|robot| robot.availability == Availability::Free);
        let promises = |fleet: &Fleet| fleet.ledger(|ledger| ledger.promises_in_order().len());
        let is_promised = |fleet: &Fleet| fleet.has_event(task_began("go")) && promises(fleet) == Some(1);
        fleet.wait_until("a free robot with a promise", SOON, |fleet| is_free(fleet) && is_promised(fleet)).await;
        raise(&fleet, "freeze").await;
        wait_for_rest(&mut fleet).await;
        let is_lost = |fleet: &Fleet| promises(fleet) != Some(1);
        fleet.assert_never("the end of the promise", longer_than_a_lease(), is_lost).await;
        clear(&fleet, None).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn to_stop_prevails_over_assembly() {
    for_each_seed([1541, 1542], async |seed| {
        let UnderWay { mut fleet, missions } = under_way(seed).await;
        raise(&fleet, "fire").await;
        let carrier = missions[0].1.clone();
        let place = fleet.position(&carrier);
        fleet.wait_until("its way to the assembly", SOON, |fleet| fleet.position(&carrier) != place).await;
        raise(&fleet, "freeze").await;
        wait_for_rest(&mut fleet).await;
        assert_still(&mut fleet, longer_than_a_lease()).await;
        clear(&fleet, Some("freeze")).await;
        wait_for_assembly(&mut fleet).await;
        clear(&fleet, Some("fire")).await;
        assert_goes_on(&mut fleet, &missions).await;
    });
}

#[test]
fn a_robot_that_joins_during_an_alarm_obeys_it() {
    for_each_seed([1551, 1552], async |seed| {
        let robots = vec![
            RobotSpec::carrier("fern", "Dock").with_speed(0.6),
            RobotSpec::carrier("gorse", "PC Room 8").with_speed(0.7).starting_later(),
        ];
        let mut fleet = Fleet::hospital(seed, robots, &STATIONS, &ROOMS).await;
        fleet.wait_for_coordinator().await;
        fleet.wait_for_audit_trail().await;
        raise(&fleet, "fire").await;
        fleet.start_robot("gorse").await;
        fleet.wait_until("its assembly", SOON, |fleet| is_at(fleet, "gorse", ASSEMBLY[2])).await;
        let mission = fleet.submit("a", ROOMS[0]).await;
        let leaves = |fleet: &Fleet| !is_at(fleet, "gorse", ASSEMBLY[2]) || fleet.holder(&mission, "r1").is_some();
        fleet.assert_never("a departure or an award", longer_than_a_lease(), leaves).await;
        clear(&fleet, None).await;
        fleet.assert_completes(&mission).await;
    });
}

/// It has no contact by which it could learn of the all-clear.
#[test]
fn a_robot_that_is_cut_off_obeys_the_alarm_that_it_has_received() {
    for_each_seed([1561, 1562], async |seed| {
        let UnderWay { mut fleet, missions } = under_way(seed).await;
        let carrier = missions[0].1.clone();
        raise(&fleet, "freeze").await;
        fleet.wait_for_rest(&carrier).await;
        fleet.cut_off(&[&carrier]);
        clear(&fleet, None).await;
        let place = fleet.position(&carrier);
        let moves = |fleet: &Fleet| fleet.position(&carrier) != place;
        fleet.assert_never("a move", longer_than_a_lease(), moves).await;
        fleet.heal();
        for (mission, _) in &missions {
            fleet.assert_completes(mission).await;
        }
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn an_alarm_that_no_file_declares_is_rejected_with_those_that_exist() {
    for_each_seed([1571], async |seed| {
        let fleet = fleet(seed).await;
        for (payload, expected) in [
            (
                json!({ "action": "raise", "alarm": "fier" }),
                "there is no alarm fier; allowed: fire, freeze; did you mean ",
            ),
            (json!({ "action": "clear", "alarm": "flood" }), "there is no alarm flood; allowed: fire, freeze"),
            (json!({ "action": "raise" }), "the action `raise` needs an `alarm`"),
            (json!({ "action": "clear", "reason": "over" }), "`reason` belongs to the action `raise`"),
        ] {
            let reply = fleet.request_answered(ApiCall::Alarm, &payload).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.starts_with(expected), "seed {seed}: {payload}: {reply}");
        }
        assert_eq!(fleet.ledger(|ledger| ledger.alarms().count()), Some(0), "seed {seed}");
    });
}
