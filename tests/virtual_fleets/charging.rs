//! Robots that charge by themselves.

use crate::support::visit;
use consort_bus::Bus as _;
use consort_fleet::node::NodeSettings;
use consort_protocol::auction::{BidVerdict, RefusalReason};
use consort_protocol::event::EventKind;
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::Charging;
use consort_skills::actions::RobotBackend as _;
use consort_tests::{ChargingSetup, Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::WorldEvent as InWorld;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

const SEEDS: [u64; 2] = [941, 942];

/// Time for a drive across the hospital (59 m), for waiting, and for charging: at most 15 minutes of world time, which
/// is ten times as fast.
const SOON: Duration = Duration::from_secs(90);

/// The only charger.
const CHARGER: &str = "Dock";

const BELOW: f64 = 0.4;
const UNTIL: f64 = ChargingSetup::UNTIL;

/// Power of the charger: a battery gains 0.4 % a second.
const POWER_W: f64 = 1440.0;

/// Discharge of the robots per second of work: a drive from one of these rooms to the other (59 m) takes 98 s and
/// 9.8 % of a battery; the drive to the charger takes 6 % from the first (36 m) and 5.3 % from the second (32 m).
const DISCHARGE: f64 = 0.001;
const ROOMS: [&str; 2] = ["PC Room 8", "IC Room 6"];
const DRIVE_M: f64 = 59.0;
const SPEED_MPS: f64 = 0.6;
/// Charge below which the robots are not useful, which is the reserve at the charger.
const USEFUL: f64 = 0.08;

fn setup(below: f64) -> ChargingSetup {
    ChargingSetup::new(&[CHARGER], below, POWER_W)
}

fn carrier(name: &str, place: &str, battery: f64) -> RobotSpec {
    RobotSpec { discharge: DISCHARGE, ..RobotSpec::carrier(name, place).with_speed(SPEED_MPS).with_charge(battery) }
}

async fn fleet(seed: u64, robots: Vec<RobotSpec>, below: f64) -> Fleet {
    let stations = ["aster", "basil", "clove"];
    let mut fleet = Fleet::hospital_with_chargers(seed, robots, &stations, setup(below), Box::new(|_| ())).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn battery(fleet: &Fleet, robot: &str) -> f64 {
    fleet.world.telemetry(&slug(robot)).expect("a robot of this world").battery.get()
}

/// Returns what a station knows about the charging of a robot.
fn charging(fleet: &Fleet, robot: &str) -> Option<Charging> {
    fleet.knowledge_of("aster", &slug(robot))?.charging
}

fn is_connected(fleet: &Fleet, robot: &str) -> bool {
    matches!(charging(fleet, robot), Some(Charging::Connected(claim)) if claim.charger.as_str() == CHARGER)
}

/// Returns the robots in the order in which they connected to the charger.
///
/// # Panics
/// If two robots were connected at the same time.
fn connections(fleet: &Fleet) -> Vec<String> {
    let (mut connected, mut order) = (BTreeSet::new(), vec![]);
    for entry in fleet.journal() {
        if let InWorld::Docked { robot, docked } = &entry.event {
            match docked {
                true => connected.insert(robot.to_string()),
                false => connected.remove(robot.as_str()),
            };
            if *docked {
                order.push(robot.to_string());
            }
            assert!(connected.len() <= 1, "seed {}: {connected:?} are connected to one charger", fleet.seed);
        }
    }
    order
}

#[test]
fn a_fleet_serves_missions_that_need_more_than_its_batteries() {
    const MISSIONS: usize = 12;
    const CHARGE: f64 = 0.5;
    // Each mission contains at least the drive from one room to the other.
    let needed = MISSIONS as f64 * DRIVE_M / SPEED_MPS * DISCHARGE;
    assert!(needed > 2.0 * (CHARGE - USEFUL), "without charging the robots could do them");
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![carrier("fern", ROOMS[1], CHARGE), carrier("gorse", ROOMS[1], CHARGE)];
        let mut fleet = fleet(seed, robots, BELOW).await;
        let view = fleet.view("fleet").await;
        let expected = json!({ "below": BELOW, "until": UNTIL, "opportunistic": null, "chargers": [CHARGER] });
        assert_eq!(view["fleet"]["charging"], expected, "seed {seed}");
        for _ in 0..MISSIONS {
            let mission = visit(&fleet, &ROOMS).await;
            fleet.assert_completes(&mission).await;
        }
        assert!(!connections(&fleet).is_empty(), "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_robot_charges_without_a_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        // No ledger is created, since fewer nodes than expected meet.
        let adjust = Box::new(|node: &mut NodeSettings| node.fleet.bootstrap_expect = 100);
        let robots = vec![carrier("fern", ROOMS[1], BELOW - 0.05)];
        let mut fleet = Fleet::hospital_with_chargers(seed, robots, &["aster"], setup(BELOW), adjust).await;
        fleet.wait_until("a connection", SOON, |fleet| is_connected(fleet, "fern")).await;
        fleet.wait_until("a charged battery", SOON, |fleet| battery(fleet, "fern") >= UNTIL).await;
        assert_eq!(connections(&fleet), ["fern"], "seed {seed}");
        assert_eq!(fleet.coordinating(), None, "seed {seed}");
    });
}

/// Robots receive no motion of each other.
#[test]
fn robots_of_a_large_fleet_take_turns_at_a_charger_without_a_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let adjust = Box::new(|node: &mut NodeSettings| {
            node.fleet.bootstrap_expect = 100;
            node.fleet.scoped_knowledge = true;
        });
        let names = ["fern", "gorse"];
        let robots = vec![carrier(names[0], ROOMS[1], BELOW - 0.05), carrier(names[1], ROOMS[0], BELOW - 0.1)];
        let mut fleet = Fleet::hospital_with_chargers(seed, robots, &["aster"], setup(BELOW), adjust).await;
        let connected = |fleet: &Fleet| names.into_iter().find(|robot| is_connected(fleet, robot));
        fleet.wait_until("the first connection", SOON, |fleet| connected(fleet).is_some()).await;
        let second = if connected(&fleet) == Some(names[0]) { names[1] } else { names[0] };
        fleet.wait_until("the connection of the other robot", SOON, |fleet| is_connected(fleet, second)).await;
        assert!(names.iter().all(|robot| !fleet.knowledge(robot).receives_motion()), "seed {seed}");
        assert!(connections(&fleet).len() >= 2, "seed {seed}\n{}", fleet.event_log_text());
    });
}

/// A robot that restarts lacks its orders until a coordinator reaches it.
#[test]
fn a_held_robot_does_not_drive_to_a_charger_after_a_restart() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, vec![carrier("fern", ROOMS[1], BELOW - 0.05)], BELOW).await;
        let start = fleet.position("fern");
        fleet.wait_until("a drive to the charger", SOON, |fleet| fleet.position("fern") != start).await;
        let reply = fleet.request_answered(ApiCall::Hold, &json!({ "robots": ["fern"], "for_s": 600 })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        fleet.wait_for_rest("fern").await;
        fleet.kill("fern").await;
        fleet.cut_off(&["fern"]);
        fleet.restart("fern").await;
        let place = fleet.position("fern");
        let moves = |fleet: &Fleet| fleet.position("fern") != place;
        fleet.assert_never("a move", Duration::from_secs(8), moves).await;
    });
}

#[test]
fn a_robot_stays_at_its_charger_during_an_alarm_to_stop() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, vec![carrier("fern", ROOMS[1], BELOW - 0.05)], BELOW).await;
        fleet.wait_for_audit_trail().await;
        fleet.wait_until("a connection", SOON, |fleet| is_connected(fleet, "fern")).await;
        let reply = fleet.request_answered(ApiCall::Alarm, &json!({ "action": "raise", "alarm": "freeze" })).await;
        assert!(reply.get("error").is_none(), "seed {seed}: {reply}");
        let (place, charge) = (fleet.position("fern"), battery(&fleet, "fern"));
        let leaves = |fleet: &Fleet| fleet.position("fern") != place;
        fleet.assert_never("a move", Duration::from_secs(10), leaves).await;
        assert!(battery(&fleet, "fern") > charge, "seed {seed}: it charges");
    });
}

#[test]
fn two_robots_use_a_single_charger_in_turn() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![carrier("fern", "IC Room 1", BELOW - 0.05), carrier("gorse", "IC Room 4", BELOW - 0.1)];
        let mut fleet = fleet(seed, robots, BELOW).await;
        let one_waits = |fleet: &Fleet| {
            let waits = |robot| matches!(charging(fleet, robot), Some(Charging::Waiting { .. }));
            waits("fern") || waits("gorse")
        };
        fleet.wait_until("a robot that waits", SOON, one_waits).await;
        for robot in ["fern", "gorse"] {
            fleet
                .wait_until(&format!("{robot} to be charged"), SOON * 2, |fleet| {
                    connections(fleet).iter().any(|connected| connected == robot) && battery(fleet, robot) >= BELOW
                })
                .await;
        }
        fleet.wait_until("no robot that needs charge", SOON, |fleet| !one_waits(fleet)).await;
        assert_eq!(connections(&fleet).len(), 2, "seed {seed}: {:?}", connections(&fleet));
    });
}

/// Returns the robots to which the charger was leased, in their order.
fn leased(fleet: &Fleet) -> Vec<String> {
    let robots = fleet.events().into_iter().filter_map(|event| match event {
        EventKind::ChargerLeased { charger, robot } if charger.as_str() == CHARGER => Some(robot.to_string()),
        _ => None,
    });
    robots.collect()
}

/// Returns the charger as seen by the coordinator.
async fn charger_view(fleet: &Fleet) -> Value {
    let coordinator = fleet.coordinating().expect("a coordinator");
    let key = format!("consort/ward/seen/{coordinator}/fleet");
    let mut replies = fleet.client.query(&key, vec![].into(), Duration::from_secs(1)).await.expect("a virtual bus");
    let payload = replies.recv().await.expect("a reply").payload.expect("a view");
    let view: Value = serde_json::from_slice(&payload).expect("JSON");
    view["chargers"][0].clone()
}

/// Returns the cause of the end of the first lease of a robot, if it has ended.
fn freed(fleet: &Fleet, name: &str) -> Option<String> {
    fleet.events().into_iter().find_map(|event| match event {
        EventKind::ChargerFreed { robot, cause, .. } if robot.as_str() == name => Some(cause),
        _ => None,
    })
}

#[test]
fn a_charger_is_leased_to_the_waiting_robots_with_less_charge_first() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![
            carrier("fern", ROOMS[1], BELOW - 0.1),
            carrier("gorse", ROOMS[0], BELOW - 0.15),
            carrier("hazel", CHARGER, BELOW - 0.01),
        ];
        let mut fleet = fleet(seed, robots, BELOW).await;
        fleet.wait_until("the first connection", SOON, |fleet| is_connected(fleet, "hazel")).await;
        fleet.wait_until("the lease", SOON, |fleet| leased(fleet) == ["hazel"]).await;
        let both_wait = |fleet: &Fleet| {
            ["fern", "gorse"].iter().all(|robot| matches!(charging(fleet, robot), Some(Charging::Waiting { .. })))
        };
        fleet.wait_until("two robots that wait", SOON, both_wait).await;
        let view = charger_view(&fleet).await;
        assert_eq!(view["charger"], json!(CHARGER), "seed {seed}: {view}");
        assert_eq!(view["lease"]["robot"], json!("hazel"), "seed {seed}: {view}");
        assert_eq!(view["waiting"], json!(["gorse", "fern"]), "seed {seed}: {view}");
        fleet.wait_until("the last connection", SOON * 3, |fleet| is_connected(fleet, "fern")).await;
        assert_eq!(connections(&fleet), ["hazel", "gorse", "fern"], "seed {seed}");
        assert_eq!(leased(&fleet), ["hazel", "gorse", "fern"], "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_lease_outlasts_the_coordinator_and_not_its_robot() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![carrier("fern", ROOMS[1], BELOW - 0.1), carrier("hazel", CHARGER, BELOW - 0.05)];
        let mut fleet = fleet(seed, robots, BELOW).await;
        fleet.wait_until("a connection", SOON, |fleet| is_connected(fleet, "hazel")).await;
        fleet.wait_until("the lease", SOON, |fleet| leased(fleet) == ["hazel"]).await;
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        let ended = |fleet: &Fleet| freed(fleet, "hazel").is_some();
        fleet.wait_until("a charged battery", SOON, |fleet| battery(fleet, "hazel") > 0.8).await;
        assert!(!ended(&fleet) && leased(&fleet) == ["hazel"], "seed {seed}\n{}", fleet.event_log_text());
        fleet.wait_until("the next lease", SOON, |fleet| leased(fleet) == ["hazel", "fern"]).await;
        fleet.kill("fern").await;
        fleet.wait_until("the end of the lease", SOON, |fleet| freed(fleet, "fern").is_some()).await;
        let causes = (freed(&fleet, "hazel"), freed(&fleet, "fern"));
        let expected = ("it no longer uses it".to_owned(), "it is lost, or has left the fleet".to_owned());
        assert_eq!(causes, (Some(expected.0), Some(expected.1)), "seed {seed}");
    });
}

#[test]
fn idle_robots_park_at_different_places() {
    const PARKING: [&str; 2] = ["IC Room 1", "IC Room 4"];
    for_each_seed(SEEDS, async |seed| {
        let robots = ["fern", "gorse"].map(|name| carrier(name, ROOMS[1], UNTIL)).to_vec();
        let mut charging = setup(BELOW);
        charging.settings.parking = BTreeSet::from(PARKING.map(slug));
        let adjust = Box::new(|_: &mut NodeSettings| ());
        let mut fleet = Fleet::hospital_with_chargers(seed, robots, &["aster"], charging, adjust).await;
        let place =
            |fleet: &Fleet, robot| fleet.knowledge_of("aster", &slug(robot)).map(|robot| robot.place.to_string());
        let parked = |fleet: &Fleet| {
            let places: BTreeSet<_> = ["fern", "gorse"].into_iter().filter_map(|robot| place(fleet, robot)).collect();
            places == BTreeSet::from(PARKING.map(str::to_owned))
        };
        fleet.wait_until("two parked robots", SOON, parked).await;
        for robot in ["fern", "gorse"] {
            fleet.wait_for_rest(robot).await;
        }
        fleet.assert_never("a move", Duration::from_secs(15), |fleet| !parked(fleet)).await;
    });
}

#[test]
fn an_award_ends_charging() {
    for_each_seed(SEEDS, async |seed| {
        // A drive from the charger to the room (36 m) and back needs 12 %, and the reserve is 8 %.
        let mut fleet = fleet(seed, vec![carrier("fern", CHARGER, BELOW - 0.01)], BELOW).await;
        fleet.wait_until("a connection", SOON, |fleet| is_connected(fleet, "fern")).await;
        let mission = visit(&fleet, &ROOMS[..1]).await;
        fleet.assert_completes(&mission).await;
        let drives_off = |event: &InWorld| matches!(event, InWorld::Docked { docked: false, .. });
        assert!(fleet.journal().iter().any(|entry| drives_off(&entry.event)), "seed {seed}: it was connected");
        assert!(battery(&fleet, "fern") < UNTIL, "seed {seed}: it had not charged until the end");
    });
}

#[test]
fn a_robot_is_promised_a_role_after_a_planned_stop_at_a_charger() {
    for_each_seed(SEEDS, async |seed| {
        // The round takes 19.6 % from where the robot is, and 15.8 % from the charger.
        let robots = vec![carrier("fern", ROOMS[1], 0.25)];
        let charging = setup(0.2).with_known_power();
        let adjust = Box::new(|_: &mut NodeSettings| ());
        let mut fleet = Fleet::hospital_with_chargers(seed, robots, &["aster"], charging, adjust).await;
        fleet.wait_for_coordinator().await;
        let mission = visit(&fleet, &ROOMS).await;
        let is_promised = |event: &EventKind| match event {
            EventKind::Awarded { promised, .. } => promised.values().any(|robot| robot.as_str() == "fern"),
            _ => false,
        };
        fleet.wait_until("a promise", SOON, |fleet| fleet.has_event(is_promised)).await;
        let stop = fleet.events().into_iter().find_map(|event| match event {
            EventKind::Closed { record, .. } if record.auction.mission == mission => {
                let start = record.promised.values().next().copied()?;
                Some((record.planned.into_values().next()?.charging?, start))
            }
            _ => None,
        });
        let (stop, start) = stop.unwrap_or_else(|| panic!("seed {seed}: no stop\n{}", fleet.event_log_text()));
        assert_eq!(stop.charger.as_str(), CHARGER, "seed {seed}");
        // The round, the way to the charger and the reserve need 32.9 % from where the robot is.
        let until = stop.until.get();
        assert!(until > 0.329 && until < 0.4, "seed {seed}: {until}");
        // The way takes 53 s. The charge then rises from 19.7 % on, by 0.4 % a second.
        assert!(start >= stop.time && start.get() > 80.0 && start.get() < 170.0, "seed {seed}: {start}");
        let reply = fleet.request_answered(ApiCall::Explain, &json!({ "mission": mission })).await;
        let lines = reply["text"].as_array().cloned().unwrap_or_default();
        let explains = |line: &Value| line.as_str().is_some_and(|line| line.contains(", after charging at Dock"));
        assert!(lines.iter().any(explains), "seed {seed}: {reply}");
        let has_begun = |event: &EventKind| matches!(event, EventKind::Started { .. });
        fleet.wait_until("the award", SOON, |fleet| fleet.has_event(has_begun)).await;
        assert_eq!(connections(&fleet), ["fern"], "seed {seed}");
        let charge = battery(&fleet, "fern");
        assert!(charge > until - 0.05, "seed {seed}: it begins with {charge}");
        assert!(charge < UNTIL - 0.2, "seed {seed}: it leaves the charger with {charge}");
        fleet.assert_completes(&mission).await;
        assert!(battery(&fleet, "fern") > USEFUL, "seed {seed}");
    });
}

#[test]
fn a_bid_needs_the_way_to_a_charger() {
    for_each_seed(SEEDS, async |seed| {
        // The drive leaves 12 %, of which 6 % are left at the charger.
        let battery = DRIVE_M / SPEED_MPS * DISCHARGE + 0.12;
        let mut fleet = fleet(seed, vec![carrier("fern", ROOMS[1], battery)], 0.2).await;
        let mission = visit(&fleet, &ROOMS[..1]).await;
        let verdict = |fleet: &Fleet| {
            fleet.events().into_iter().find_map(|event| match event {
                EventKind::Closed { record, .. } if record.auction.mission == mission => {
                    record.entries.into_iter().find(|entry| entry.robot.as_str() == "fern").map(|entry| entry.verdict)
                }
                _ => None,
            })
        };
        fleet.wait_until("an auction", SOON, |fleet| verdict(fleet).is_some()).await;
        let verdict = verdict(&fleet).expect("checked before");
        let BidVerdict::Refused { reason: RefusalReason::ChargerOutOfReach { charger, problem } } = verdict else {
            panic!("seed {seed}: {verdict:?}")
        };
        assert_eq!(charger, Some(slug(CHARGER)), "seed {seed}");
        assert!(problem.ends_with("charge left at Dock is not above the reserve of 8.0 %"), "seed {seed}: {problem}");
        // The robot charges until it has enough.
        fleet.assert_completes(&mission).await;
        assert_eq!(connections(&fleet), ["fern"], "seed {seed}");
    });
}
