//! Batteries: a single rate for the world and for estimates, linear charge, and a stop at 5 %.

use super::*;
use crate::map::{MapFile, PlaceEntry, PlaceKind};
use consort_protocol::yaml;
use consort_skills::actions::Wait;
use consort_skills::domain_file::DomainFile;
use std::collections::BTreeMap;

fn weak(charge: f64) -> RobotSetup {
    RobotSetup { battery: BatteryShare::new(charge).unwrap(), ..carrier("r1", "Laboratory") }
}

fn charge(world: &World, name: &str) -> f64 {
    world.telemetry(&robot(name)).unwrap().battery.get()
}

#[test]
fn a_goal_costs_its_time_at_the_rate_that_estimates_use() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Laboratory"))).unwrap();
    let rate = world.robot_setup(&robot("r1")).unwrap().discharge;
    let goal = drive_goal(&world, "Laboratory Corridor");
    run_to_success(&mut world, "r1", 1, goal);
    assert!((charge(&world, "r1") - (1.0 - rate.over(Seconds::new(8.0).unwrap()))).abs() < 1e-12);
    world.advance(at(108.0));
    assert!((charge(&world, "r1") - (1.0 - 0.008 - 100.0 * 0.0001)).abs() < 1e-12, "a tenth when idle");
}

#[test]
fn a_goal_discharges_the_battery_as_its_action_declares() {
    let text = "domain: digging\nactions: { dig: { discharge: 3, simulate: { duration_s: [10, 10] } } }";
    let domain = DomainFile::check(yaml::parse(text).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let mut world = World::new(hospital(1).domain(&domain).robot(carrier("r1", "Laboratory"))).unwrap();
    let dig = serde_json::from_value(serde_json::json!({ "action": "dig", "parameters": {} })).unwrap();
    run_to_success(&mut world, "r1", 1, dig);
    assert!((charge(&world, "r1") - (1.0 - 10.0 * 0.003)).abs() < 1e-12, "{}", charge(&world, "r1"));
    run_to_success(&mut world, "r1", 2, Goal::from(Wait { time: Seconds::new(10.0).unwrap() }));
    assert!((charge(&world, "r1") - (1.0 - 10.0 * 0.004)).abs() < 1e-12, "{}", charge(&world, "r1"));
}

#[test]
fn a_goal_that_renews_the_battery_fills_it_when_it_succeeds() {
    let text = "domain: swaps\nactions: { renew: { simulate: { renews_battery: true } }, fail: { simulate: \
                { renews_battery: true, failure_rate: 1 } } }";
    let domain = DomainFile::check(yaml::parse(text).unwrap(), &BTreeMap::new(), &[]).unwrap();
    let mut world = World::new(hospital(1).domain(&domain).robot(weak(0.3))).unwrap();
    let goal =
        |action: &str| serde_json::from_value(serde_json::json!({ "action": action, "parameters": {} })).unwrap();
    world.start(&robot("r1"), GoalId(1), goal("fail"));
    world.advance(at(5.0));
    assert!(charge(&world, "r1") < 0.3, "{}", charge(&world, "r1"));
    run_to_success(&mut world, "r1", 2, goal("renew"));
    assert_eq!(charge(&world, "r1"), 1.0);
}

#[test]
fn a_failed_battery_stops_its_robot_at_once() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Laboratory"))).unwrap();
    let goal = drive_goal(&world, "Laboratory Corridor");
    world.start(&robot("r1"), GoalId(1), goal);
    world.advance(at(2.0));
    world.set_charge(&robot("r1"), BatteryShare::new(0.01).unwrap());
    let low = aborted(ErrorCode::BatteryLow, "the battery of r1 is down to 1.0 %");
    assert_eq!(world.advance(at(3.0)), [ended("r1", 1, low), BackendEvent::Stranded { robot: robot("r1") }]);
}

#[test]
fn a_robot_below_five_percent_stops() {
    let mut world = World::new(hospital(1).robot(weak(0.054))).unwrap();
    let goal = drive_goal(&world, "Laboratory Corridor");
    world.start(&robot("r1"), GoalId(1), goal);
    let due = world.next_due().unwrap();
    assert!((due.as_secs() - 4.0).abs() < 1e-9, "0.4 % at 0.1 %/s, {due:?}");
    let low = aborted(ErrorCode::BatteryLow, "the battery of r1 is down to 5.0 %");
    assert_eq!(world.advance(at(100.0)), [ended("r1", 1, low.clone()), BackendEvent::Stranded { robot: robot("r1") }]);
    let telemetry = world.telemetry(&robot("r1")).unwrap();
    assert!(!telemetry.able);
    assert!((telemetry.pose.y - 9.0).abs() < 1e-9, "2 m of 4 m down the lane: {:?}", telemetry.pose);
    assert!((telemetry.battery.get() - (0.05 - 96.0 * 0.0001)).abs() < 1e-9);
    let status = rejected_status(&mut world, "r1", 2, Goal::from(Wait { time: Seconds::ZERO }));
    assert_eq!(status, aborted(ErrorCode::BatteryLow, "the battery of r1 is down to 4.0 %"));
    assert_eq!(world.advance(at(1e7)), [], "stranded once");
    assert_eq!(charge(&world, "r1"), 0.0, "and never below empty");
}

#[test]
fn an_empty_robot_moves_again_after_a_battery_replacement() {
    let mut world = World::new(hospital(1).robot(weak(0.03))).unwrap();
    assert_eq!(world.advance(at(1.0)), [BackendEvent::Stranded { robot: robot("r1") }]);
    world.set_charge(&robot("r1"), BatteryShare::FULL);
    assert!(!world.telemetry(&robot("r1")).unwrap().able, "the charge alone does not bring it back");
    world.replace_battery(&robot("r1"));
    assert!(world.telemetry(&robot("r1")).unwrap().able);
    assert_eq!(charge(&world, "r1"), 1.0);
    run_to_success(&mut world, "r1", 1, Goal::from(Wait { time: Seconds::new(1.0).unwrap() }));
}

#[test]
fn an_idle_battery_drains_and_a_low_start_strands() {
    let mut world = World::new(hospital(1).robot(weak(0.06))).unwrap();
    assert!((world.next_due().unwrap().as_secs() - 100.0).abs() < 1e-9);
    let mut low = World::new(hospital(1).robot(weak(0.03))).unwrap();
    assert_eq!(low.next_due(), Some(at(0.0)));
    for world in [&mut world, &mut low] {
        assert_eq!(world.advance(at(200.0)), [BackendEvent::Stranded { robot: robot("r1") }]);
        assert_eq!(world.next_due(), None);
    }
}

#[test]
fn a_robot_on_mains_power_does_not_discharge() {
    let mut world = World::new(hospital(1).robot(RobotSetup::arm(robot("lab_arm"), place("Laboratory")))).unwrap();
    run_to_success(&mut world, "lab_arm", 1, Goal::from(Wait { time: Seconds::new(1e6).unwrap() }));
    assert_eq!(charge(&world, "lab_arm"), 1.0);
    assert_eq!(world.next_due(), None, "nothing will ever happen here by itself");
}

#[test]
fn idle_robots_cause_no_events() {
    let file = MapFile {
        name: "yard".into(),
        places: vec![PlaceEntry { name: "Yard".into(), kind: PlaceKind::Other, ..PlaceEntry::default() }],
        ..MapFile::default()
    };
    let mut setup = WorldSetup::new(file.check("yard").unwrap(), 1);
    setup.robots = (0..200).map(|n| carrier(&format!("d{n}"), "Yard")).collect();
    let mut world = World::new(setup).unwrap();
    assert!(world.next_due().unwrap() > at(3600.0));
    assert_eq!(world.advance(at(3600.0)), []);
    assert!(world.drain_event_log().is_empty());
}
