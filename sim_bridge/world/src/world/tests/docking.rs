//! Chargers, turning on the spot, and waypoints.

use super::*;
use consort_protocol::charging_curve::CurveStep;
use consort_protocol::pose::Pose;
use consort_protocol::units::{WattHours, Watts};
use consort_skills::actions::{Dock, FollowWaypoints, GoalProgress, NavigateToPose, Spin, Undock, Waypoint};
use std::collections::BTreeMap;

pub(super) fn yard() -> WorldSetup {
    let text = "{name: yard, places: [{name: Charger, kind: charger, x_m: 0, y_m: 0}, {name: Gate, kind: other, x_m: 10, y_m: 0}, \
        {name: Far, kind: other, x_m: 10, y_m: 5}], lanes: [{between: [Charger, Gate]}, {between: [Gate, Far]}], \
        doors: [{name: Door, on: [[Charger, Gate]], opening_s: 3}]}";
    WorldSetup::new(map::read(text, "yard.yaml").unwrap(), 1)
}

/// Loses 0.1 % a second with a goal, 0.01 % idle, and gains 0.4 % docked.
fn half_full(name: &str, at: &str) -> RobotSetup {
    let (battery, charging) = (BatteryShare::new(0.5).unwrap(), SharePerSecond::new(0.004).unwrap());
    RobotSetup { battery, charging, ..carrier(name, at) }
}

fn charge(world: &World) -> f64 {
    world.telemetry(&robot("r1")).unwrap().battery.get()
}

fn dock() -> Goal {
    Goal::from(Dock { charger: None })
}

#[test]
fn a_docked_robot_charges_until_it_is_full() {
    let mut world = World::new(yard().robot(half_full("r1", "Charger"))).unwrap();
    run_to_success(&mut world, "r1", 1, dock());
    assert!((charge(&world) - 0.498).abs() < 1e-12);
    world.advance(at(12.0));
    assert!((charge(&world) - 0.537).abs() < 1e-12, "0.4 % a second, less what it loses idle");
    world.advance(at(1_000.0));
    assert_eq!(charge(&world), 1.0);
    run_to_success(&mut world, "r1", 2, Goal::from(Undock {}));
    let full = charge(&world);
    world.advance(at(1_102.0));
    assert!((full - charge(&world) - 0.01).abs() < 1e-12, "idle again");
    assert_eq!(logged(&mut world, |what| matches!(what, WorldEvent::Docked { .. }).then_some(())).len(), 2);
}

#[test]
fn a_docked_robot_charges_with_the_power_of_its_charger() {
    // 360 W fill 100 Wh, which are 360 kJ, by 0.1 % a second. A robot with a goal loses as much, and an idle robot a tenth.
    let capacity = Some(WattHours::new(100.0).unwrap());
    for (place_name, capacity, gain) in [("Gate", capacity, 0.001), ("Gate", None, 0.004), ("Charger", capacity, 0.004)]
    {
        let robot = RobotSetup { capacity, ..half_full("r1", place_name) };
        let chargers = BTreeMap::from([(place("Gate"), Watts::new(360.0).ok())]);
        let mut world = World::new(WorldSetup { chargers, ..yard().robot(robot) }).unwrap();
        run_to_success(&mut world, "r1", 1, dock());
        let docked = charge(&world);
        world.advance(at(world.now().as_secs() + 100.0));
        let expected = 100.0 * (gain - 0.0001);
        assert!((charge(&world) - docked - expected).abs() < 1e-9, "{place_name}, {capacity:?}: {}", charge(&world));
    }
}

#[test]
fn a_docked_robot_charges_along_the_charging_curve() {
    let steps = vec![CurveStep { above: BatteryShare::new(0.6).unwrap(), power: 0.5 }];
    let charging_curve = steps.try_into().unwrap();
    let mut world = World::new(WorldSetup { charging_curve, ..yard().robot(half_full("r1", "Charger")) }).unwrap();
    run_to_success(&mut world, "r1", 1, dock());
    let at_step = world.now().as_secs() + (0.6 - charge(&world)) / (0.004 - 0.0001);
    world.advance(at(at_step + 100.0));
    assert!((charge(&world) - 0.6 - 100.0 * (0.002 - 0.0001)).abs() < 1e-9, "{}", charge(&world));
    world.advance(at(10_000.0));
    assert_eq!(charge(&world), 1.0);
}

#[test]
fn a_docked_robot_keeps_the_charge_at_which_it_gains_what_it_loses() {
    // Above 60 % it gains 0.004 % a second, and loses 0.01 % idle.
    let steps = vec![CurveStep { above: BatteryShare::new(0.6).unwrap(), power: 0.01 }];
    let charging_curve = steps.try_into().unwrap();
    let mut world = World::new(WorldSetup { charging_curve, ..yard().robot(half_full("r1", "Charger")) }).unwrap();
    run_to_success(&mut world, "r1", 1, dock());
    assert_eq!(world.advance(at(20_000.0)), [], "it does not strand");
    assert!((charge(&world) - 0.6).abs() < 1e-9, "{}", charge(&world));
    world.set_charge(&robot("r1"), BatteryShare::new(0.7).unwrap());
    world.advance(at(20_100.0));
    assert!((charge(&world) - 0.7 + 100.0 * 0.00006).abs() < 1e-9, "{}", charge(&world));
    world.advance(at(40_000.0));
    assert!((charge(&world) - 0.6).abs() < 1e-9, "{}", charge(&world));
}

#[test]
fn a_charger_is_at_a_place_of_the_map() {
    let chargers = BTreeMap::from([(place("Gat"), None)]);
    let error = World::new(WorldSetup { chargers, ..yard() }).err().unwrap().to_string();
    assert!(error.contains("charger: there is no place \"Gat\" on map yard; did you mean \"Gate\"?"), "{error}");
}

#[test]
fn a_robot_that_drives_off_stops_charging() {
    let mut world = World::new(yard().robot(half_full("r1", "Charger"))).unwrap();
    run_to_success(&mut world, "r1", 1, dock());
    let goal = drive_goal(&world, "Gate");
    run_to_success(&mut world, "r1", 2, goal);
    let there = charge(&world);
    world.advance(at(world.now().as_secs() + 100.0));
    assert!((there - charge(&world) - 0.01).abs() < 1e-12);
    let status = rejected_status(&mut world, "r1", 3, Goal::from(Undock {}));
    assert_eq!(status, aborted(ErrorCode::Charger, "r1 is not docked"));
}

#[test]
fn a_robot_that_charges_in_time_does_not_strand() {
    let mut low = half_full("r1", "Charger");
    low.battery = BatteryShare::new(0.055).unwrap();
    let mut world = World::new(yard().robot(low)).unwrap();
    run_to_success(&mut world, "r1", 1, dock());
    assert_eq!(world.advance(at(10_000.0)), []);
    assert!(world.telemetry(&robot("r1")).unwrap().able);
}

#[test]
fn a_robot_docks_only_at_chargers() {
    let mut world = World::new(yard().robot(carrier("r1", "Gate"))).unwrap();
    let meant = |name| Goal::from(Dock { charger: Some(place(name)) });
    for (goal, code, message, nav2) in [
        (dock(), ErrorCode::Charger, "Gate is not a charger", 902),
        (meant("Charger"), ErrorCode::OutOfReach, "r1 is at Gate, not at Charger", 903),
        (meant("Chargr"), ErrorCode::Unknown, "there is no place \"Chargr\" here; did you mean \"Charger\"?", 901),
    ] {
        assert_eq!(goal.nav2_code(code), Some(nav2));
        let id = u64::from(nav2);
        assert_eq!(rejected_status(&mut world, "r1", id, goal), aborted(code, message));
    }
}

#[test]
fn a_robot_turns_on_the_spot() {
    let mut world = World::new(yard().robot(carrier("r1", "Gate"))).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(Spin { angle_rad: -1.5 }));
    let pose = world.telemetry(&robot("r1")).unwrap().pose;
    assert_eq!((world.now(), pose.x, pose.y), (at(1.5), 10.0, 0.0));
    assert!((pose.yaw + 1.5).abs() < 1e-12);
    run_to_success(&mut world, "r1", 2, Goal::from(Spin { angle_rad: -2.0 }));
    let yaw = world.telemetry(&robot("r1")).unwrap().pose.yaw;
    assert!((yaw - (std::f64::consts::TAU - 3.5)).abs() < 1e-12, "{yaw} is within half a turn");
    let status = rejected_status(&mut world, "r1", 3, Goal::from(Spin { angle_rad: 700.0 }));
    assert_eq!(status, aborted(ErrorCode::Unknown, "700 rad is no angle to turn by, allowed is -628 to 628"));
}

#[test]
fn waypoints_are_followed_one_after_the_other_through_doors() {
    let mut world = World::new(yard().robot(carrier("r1", "Charger"))).unwrap();
    let stop = |world: &World, name: &str| {
        let NavigateToPose { pose, place, .. } = drive_goal(world, name).read().unwrap().unwrap();
        Waypoint { pose, place }
    };
    let waypoints = ["Gate", "Far", "Gate"].map(|name| stop(&world, name)).into();
    run_to_success(&mut world, "r1", 1, Goal::from(FollowWaypoints { waypoints }));
    assert_eq!(world.now(), at(23.0 + 10.0 + 10.0));
    assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place("Gate"));
    let waypoints = vec![stop(&world, "Far"), stop(&world, "Charger"), stop(&world, "Gate")];
    let (status, _) = run(&mut world, "r1", 2, Goal::from(FollowWaypoints { waypoints }));
    assert_eq!(status, aborted(ErrorCode::NoRoute, "no lane from Far to Charger"));
    let far = world.telemetry(&robot("r1")).unwrap();
    assert_eq!((far.place, far.pose), (place("Far"), Pose::new(10.0, 5.0, 0.0)));
    let status = rejected_status(&mut world, "r1", 3, Goal::from(FollowWaypoints { waypoints: vec![] }));
    assert_eq!(status, aborted(ErrorCode::Unknown, "there are no waypoints to follow"));
}

#[test]
fn feedback_is_in_the_terms_of_the_goal() {
    let mut world = World::new(yard().robot(half_full("r1", "Charger"))).unwrap();
    let progress = |world: &World, id: u64| match world.status(&robot("r1"), GoalId(id)) {
        Some(GoalStatus::Executing(feedback)) => feedback.progress,
        other => panic!("{other:?}"),
    };
    let free = |x: f64| Waypoint { pose: Pose::new(x, 0.0, 0.0), place: None };
    let waypoints = vec![free(1.0), free(2.0), free(3.0)];
    world.start(&robot("r1"), GoalId(1), Goal::from(FollowWaypoints { waypoints }));
    // Each metre takes two seconds.
    let reached = [1.0, 3.0, 5.0].map(|seconds| {
        world.advance(at(seconds));
        progress(&world, 1)
    });
    assert_eq!(reached, [0, 1, 2].map(GoalProgress::Waypoint));
    world.advance(at(10.0));
    world.start(&robot("r1"), GoalId(2), Goal::from(Spin { angle_rad: -3.0 }));
    let turned = [10.0, 11.0, 12.5].map(|seconds| {
        world.advance(at(seconds));
        progress(&world, 2)
    });
    assert_eq!(turned, [0.0, -1.0, -2.5].map(GoalProgress::Turned));
    let mut world = World::new(yard().robot(half_full("r1", "Charger"))).unwrap();
    world.start(&robot("r1"), GoalId(3), dock());
    world.advance(at(1.5));
    assert_eq!(progress(&world, 3), GoalProgress::Docking(Seconds::new(1.5).unwrap()));
}
