//! Robots request doors and lifts of the building, and enter once these confirm.

use crate::closures::{DRIVE, ROOM};
use crate::support::{
    assert_completes_by, drive_to_room, fleet_of, longer_than_a_lease, released, request, slow_carriers, visit,
};
use consort_fleet::node::{DevicePart, NodeSettings};
use consort_protocol::devices::{AlarmPosition, Device, DeviceKind, Devices};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{DeviceId, MissionId, NodeId, PlaceId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::DeviceState;
use consort_protocol::units::Seconds;
use consort_tests::{Fleet, for_each_seed, slug};
use consort_world::device::{DeviceSwitch, SimulatedDevice};
use serde_json::json;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// The only way to the room leads from `BEFORE` through `GATE`.
const GATE: &str = "IC Corridor 6";
const BEFORE: &str = "IC Corridor 3";
/// A robot beyond has left `BEFORE` (29 m) for `GATE` (31 m).
const INSIDE_Y_M: f64 = 29.3;
const DEVICE: &str = "gate";
/// Station that runs the driver of the device.
const HOST: &str = "basil";
/// Robot with a stolen key.
const FORGER: &str = "lab-arm";
/// Time in which the device opens, in seconds of node time.
const OPENING_S: f64 = 3.0;

fn place(name: &str) -> PlaceId {
    slug(name)
}

/// Returns a door on the way to the room.
fn door() -> Device {
    Device {
        name: slug(DEVICE),
        kind: DeviceKind::Door,
        host: slug(HOST),
        lanes: [(place(BEFORE), place(GATE))].into(),
        places: BTreeSet::new(),
        silent_after: Duration::from_secs(10),
        in_alarm: AlarmPosition::Closed,
    }
}

/// Returns a lift with the room as one of its stops.
fn lift() -> Device {
    Device {
        kind: DeviceKind::Lift,
        lanes: BTreeSet::new(),
        places: [place(GATE), place(ROOM)].into(),
        in_alarm: AlarmPosition::OutOfUse,
        ..door()
    }
}

/// Returns the driver of the device, which opens in this time.
fn driver(opening_s: f64, switch: &DeviceSwitch) -> DevicePart {
    let opening = Seconds::new(opening_s).expect("a duration");
    DevicePart { device: slug(DEVICE), driver: Box::new(SimulatedDevice::new(slug(DEVICE), opening, switch.clone())) }
}

/// Declares the device in a fleet whose roles pass to other robots late. `HOST` runs its driver.
fn with_device(device: Device, switch: DeviceSwitch) -> impl FnMut(&mut NodeSettings) + 'static {
    let devices = Arc::new(Devices::new([device]));
    move |settings| {
        settings.fleet.devices = Arc::clone(&devices);
        settings.fleet.stall_timeout = Duration::from_secs(900);
        if settings.node.as_str() == HOST {
            settings.devices.push(driver(OPENING_S, &switch));
        }
    }
}

/// Starts two slow carriers and three stations, one of which runs the driver of the device.
async fn fleet(seed: u64, device: Device, switch: &DeviceSwitch) -> Fleet {
    fleet_of(seed, slow_carriers(), &[ROOM], with_device(device, switch.clone())).await
}

/// Returns the state of the device, as known to a node.
fn state(fleet: &Fleet, node: &str) -> Option<DeviceState> {
    state_by(fleet, HOST, node)
}

/// Returns the state of the device that `host` reports, as known to a node.
fn state_by(fleet: &Fleet, host: &str, node: &str) -> Option<DeviceState> {
    fleet.knowledge(node).read(|base| {
        let (host, device): (NodeId, DeviceId) = (slug(host), slug(DEVICE));
        Some(base.get(&host)?.record.knowledge.devices.reports.get(&device)?.state)
    })
}

fn is_inside(fleet: &Fleet, robot: &str) -> bool {
    fleet.position(robot).1 > INSIDE_Y_M
}

/// Checks whether the robot claims the device, as known to the coordinator.
fn is_claimed(fleet: &Fleet, robot: &str) -> bool {
    fleet.knowledge("aster").read(|base| {
        let (robot, device): (NodeId, DeviceId) = (slug(robot), slug(DEVICE));
        let claims = base.get(&robot).and_then(|known| known.record.knowledge.devices.claims.as_ref());
        claims.is_some_and(|claims| claims.contains_key(&device))
    })
}

fn leased(what: &EventKind) -> bool {
    matches!(what, EventKind::DeviceLeased { device, .. } if device.as_str() == DEVICE)
}

/// Checks whether a lease of the robot has ended.
fn is_freed(fleet: &Fleet, carrier: &str) -> bool {
    fleet.has_event(|what| matches!(what, EventKind::DeviceFreed { robot, .. } if robot.as_str() == carrier))
}

async fn wait_until_free(fleet: &mut Fleet) {
    let is_free = |fleet: &Fleet| fleet.ledger(|ledger| ledger.device_leases().is_empty()) == Some(true);
    fleet.wait_until("the end of all leases", DRIVE, is_free).await;
}

#[test]
fn a_robot_waits_at_a_door_until_it_confirms() {
    for_each_seed([1701, 1702], async |seed| {
        let mut fleet = fleet(seed, door(), &DeviceSwitch::default()).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        fleet.wait_until("the lease of the door", DRIVE, |fleet| fleet.has_event(leased)).await;
        // A new coordinator follows the lease.
        fleet.kill_coordinator().await;
        let mut was_ready = false;
        let enters = |fleet: &Fleet| {
            was_ready |= state(fleet, &carrier) == Some(DeviceState::Ready);
            is_inside(fleet, &carrier)
        };
        fleet.wait_until("the entry", DRIVE, enters).await;
        assert!(was_ready, "seed {seed}: it enters before the door confirms\n{}", fleet.event_log_text());
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        wait_until_free(&mut fleet).await;
        let is_closed = |fleet: &Fleet| state(fleet, HOST) == Some(DeviceState::Idle);
        fleet.wait_until("the closed door", DRIVE, is_closed).await;
    });
}

#[test]
fn two_robots_use_a_lift_one_after_the_other() {
    for_each_seed([1711, 1712], async |seed| {
        let mut fleet = fleet(seed, lift(), &DeviceSwitch::default()).await;
        let missions: [MissionId; 2] =
            [visit(&fleet, &[ROOM, "IC Corridor 1"]).await, visit(&fleet, &[ROOM, "IC Corridor 2"]).await];
        let mut met = false;
        let both_end = |fleet: &Fleet| {
            met |= ["fern", "gorse"].iter().all(|carrier| is_inside(fleet, carrier));
            missions.iter().all(|mission| fleet.state(mission).as_deref() == Some("completed"))
        };
        fleet.wait_until("the end of both missions", DRIVE * 2, both_end).await;
        assert!(!met, "seed {seed}: both robots are in the lift\n{}", fleet.event_log_text());
        let robots: BTreeSet<String> = fleet
            .events()
            .into_iter()
            .filter_map(|what| match what {
                EventKind::DeviceLeased { robot, .. } => Some(robot.to_string()),
                _ => None,
            })
            .collect();
        assert_eq!(robots.len(), 2, "seed {seed}: {robots:?}");
        wait_until_free(&mut fleet).await;
    });
}

#[test]
fn a_robot_lost_inside_blocks_the_door_until_it_is_out_of_service() {
    for_each_seed([1741], async |seed| {
        let mut fleet = fleet(seed, door(), &DeviceSwitch::default()).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        fleet.wait_until("the entry", DRIVE, |fleet| is_inside(fleet, &carrier)).await;
        fleet.kill(&carrier).await;
        let is_blocked = |fleet: &Fleet| state(fleet, "aster") == Some(DeviceState::Blocked);
        fleet.wait_until("the blocked door", DRIVE, is_blocked).await;
        let other = visit(&fleet, &[ROOM]).await;
        // After 30 s the other nodes forget its record.
        let during = Duration::from_secs(60);
        let broken = |fleet: &Fleet| is_freed(fleet, &carrier) || fleet.holder(&other, "r1").is_some();
        fleet.assert_never("the end of the lease, or an award", during, broken).await;
        assert!(is_blocked(&fleet), "seed {seed}: {:?}", state(&fleet, "aster"));
        let remove = json!({ "robots": [carrier], "action": "begin", "reason": "it is outside", "by": "Nia" });
        request(&fleet, ApiCall::Maintenance, &remove).await;
        fleet.wait_until("the end of the lease", DRIVE, |fleet| is_freed(fleet, &carrier)).await;
        let is_other = |robot: RobotId| robot.as_str() != carrier;
        let is_awarded =
            |fleet: &Fleet| [&mission, &other].iter().any(|of| fleet.holder(of, "r1").is_some_and(is_other));
        fleet.wait_until("an award", DRIVE, is_awarded).await;
        assert!(!is_blocked(&fleet), "seed {seed}");
    });
}

#[test]
fn a_silent_door_stops_robots_and_is_reported_until_it_responds() {
    for_each_seed([1721, 1722], async |seed| {
        let switch = DeviceSwitch::default();
        let mut fleet = fleet(seed, door(), &switch).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        switch.set_silent(true);
        let is_silent = |fleet: &Fleet| state(fleet, "aster") == Some(DeviceState::Silent);
        fleet.wait_until("the silent door", DRIVE, is_silent).await;
        let waits = |fleet: &Fleet| (fleet.position(&carrier).1 - 29.0).abs() < 0.3;
        fleet.wait_until("the carrier before the door", DRIVE, waits).await;
        let other = visit(&fleet, &[ROOM]).await;
        let broken = |fleet: &Fleet| {
            let is_held = fleet.holder(&other, "r1").is_some();
            is_held || is_inside(fleet, &carrier) || fleet.has_event(released)
        };
        fleet.assert_never("an entry, a release or another award", longer_than_a_lease(), broken).await;
        let health = fleet.view_of("aster", "health").await.to_string();
        assert!(health.contains("gate is unavailable: it does not confirm"), "seed {seed}: {health}");
        request(&fleet, ApiCall::Cancel, &json!({ "mission": other })).await;
        switch.set_silent(false);
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

#[test]
fn a_door_closes_during_an_alarm_and_opens_for_the_robot_afterwards() {
    for_each_seed([1731, 1732], async |seed| {
        let mut fleet = fleet(seed, door(), &DeviceSwitch::default()).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        request(&fleet, ApiCall::Alarm, &json!({ "action": "raise", "alarm": "freeze", "by": "Nia" })).await;
        let is_in_alarm = |fleet: &Fleet| state(fleet, "aster") == Some(DeviceState::Alarm);
        fleet.wait_until("the door in its position", DRIVE, is_in_alarm).await;
        let enters = |fleet: &Fleet| is_inside(fleet, &carrier);
        fleet.assert_never("an entry", longer_than_a_lease(), enters).await;
        request(&fleet, ApiCall::Alarm, &json!({ "action": "clear", "by": "Abe" })).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

/// The alarm is raised when the lift comes for the carrier, which drives to an assembly place instead.
#[test]
fn a_lift_is_out_of_use_during_an_alarm_and_serves_robots_afterwards() {
    for_each_seed([1771, 1772], async |seed| {
        let mut fleet = fleet(seed, lift(), &DeviceSwitch::default()).await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        fleet.wait_until("the lease of the lift", DRIVE, |fleet| fleet.has_event(leased)).await;
        request(&fleet, ApiCall::Alarm, &json!({ "action": "raise", "alarm": "fire", "by": "Nia" })).await;
        let mut entered = false;
        let is_out_of_use = |fleet: &Fleet| {
            entered |= is_inside(fleet, &carrier);
            state(fleet, "aster") == Some(DeviceState::Alarm)
        };
        fleet.wait_until("the lift out of use", DRIVE, is_out_of_use).await;
        assert!(!entered, "seed {seed}: the carrier enters\n{}", fleet.event_log_text());
        wait_until_free(&mut fleet).await;
        let is_used = |fleet: &Fleet| {
            let is_leased = fleet.ledger(|ledger| ledger.device_leases().is_empty()) == Some(false);
            is_leased || is_claimed(fleet, &carrier) || is_inside(fleet, &carrier)
        };
        fleet.assert_never("a use of the lift", longer_than_a_lease(), is_used).await;
        request(&fleet, ApiCall::Alarm, &json!({ "action": "clear", "by": "Abe" })).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
        wait_until_free(&mut fleet).await;
    });
}

/// The forger has the certificate of a robot, and runs a driver of the device that is ready at once. In its fleet file it is
/// the host.
#[test]
fn the_key_of_a_robot_confirms_no_device() {
    for_each_seed([1751], async |seed| {
        let (device, switch) = (Device { silent_after: Duration::from_secs(3600), ..door() }, DeviceSwitch::default());
        switch.set_silent(true);
        let forged = Arc::new(Devices::new([Device { host: slug(FORGER), ..device.clone() }]));
        let mut declare = with_device(device, switch.clone());
        let adjust = move |settings: &mut NodeSettings| {
            declare(settings);
            settings.fleet.bootstrap_expect = 5;
            if settings.node.as_str() == FORGER {
                settings.may_vote = false;
                settings.fleet.devices = Arc::clone(&forged);
                settings.devices.push(driver(0.1, &DeviceSwitch::default()));
            }
        };
        let stations = ["aster", "basil", "clove"];
        let mut fleet =
            Fleet::adjusted_closed_hospital(seed, slow_carriers(), &stations, &[ROOM], Box::new(adjust)).await;
        fleet.wait_for_coordinator().await;
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        let reports = |fleet: &Fleet| [HOST, FORGER].map(|host| state_by(fleet, host, &carrier));
        let is_forged = |fleet: &Fleet| reports(fleet) == [DeviceState::Preparing, DeviceState::Ready].map(Some);
        fleet.wait_until("a true and a false report", DRIVE, is_forged).await;
        fleet.assert_never("an entry", longer_than_a_lease(), |fleet| is_inside(fleet, &carrier)).await;
        switch.set_silent(false);
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}

/// The ledger has a single voter, which is not the host of the device.
#[test]
fn a_station_without_a_copy_of_the_ledger_serves_its_device() {
    for_each_seed([1761], async |seed| {
        let mut declare = with_device(door(), DeviceSwitch::default());
        let adjust = move |settings: &mut NodeSettings| {
            declare(settings);
            settings.fleet.voters = 1;
        };
        let stations = ["aster", "basil", "clove"];
        let mut fleet = Fleet::adjusted_hospital(seed, slow_carriers(), &stations, &[ROOM], Box::new(adjust)).await;
        assert_ne!(fleet.wait_for_coordinator().await.as_str(), HOST, "seed {seed}");
        let (mission, carrier) = drive_to_room(&mut fleet, ROOM).await;
        assert_completes_by(&mut fleet, &mission, ROOM, &carrier).await;
    });
}
