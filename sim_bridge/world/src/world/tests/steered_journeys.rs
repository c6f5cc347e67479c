//! Robots with kinematics on the same routes: through doors, in lifts, up to obstacles.

use super::doors::{doors_only, passage};
use super::lifts::tower;
use super::obstacles::{BLOCKED, corridor, known, trolley, x};
use super::steering::{all, differential, pose_of, steered, until_ended};
use super::*;
use consort_protocol::pose::Pose;
use consort_skills::actions::{FollowWaypoints, NavigateToPose, Spin, Waypoint};

fn set_off(world: &mut World, name: &str, id: u64, to: &str) {
    let goal = drive_goal(world, to);
    world.start(&robot(name), GoalId(id), goal);
}

fn waypoint(world: &World, name: &str) -> Waypoint {
    Waypoint { pose: world.map().place(&place(name)).unwrap().pose, place: Some(place(name)) }
}

#[test]
fn every_chassis_waits_at_a_door_and_passes_it() {
    for kinematics in all() {
        let mut world = World::new(passage().robot(steered("r1", "A", kinematics.clone()))).unwrap();
        set_off(&mut world, "r1", 1, "B");
        let (mut passed, mut closed) = (false, false);
        while world.status(&robot("r1"), GoalId(1)).is_some_and(|status| !status.is_final()) {
            let due = world.next_due().expect("under way");
            world.advance(due);
            let lines = logged(&mut world, doors_only);
            for (_, line) in &lines {
                let x = pose_of(&world, "r1").x;
                match line.as_str() {
                    "r1 waits" | "open" | "r1 enters" => {
                        assert!((4.4..4.6).contains(&x), "{line} at {x}: {kinematics:?}");
                    }
                    "r1 leaves" => assert!((5.5..5.6).contains(&x), "{line} at {x}: {kinematics:?}"),
                    _ => assert!(passed, "{line} at {x}: {kinematics:?}"),
                }
                (passed, closed) = (passed || line == "r1 leaves", line == "closed");
            }
        }
        assert!(passed, "the door was on the way: {kinematics:?}");
        assert!(closed, "behind it: {kinematics:?}");
        assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::succeeded()), "{kinematics:?}");
        let there = world.map().place(&place("B")).unwrap().pose;
        assert!(pose_of(&world, "r1").distance(there).get() < 0.05, "{:?}: {kinematics:?}", pose_of(&world, "r1"));
        assert!((23.0..34.0).contains(&world.now().as_secs()), "23 s without a chassis: {:?}", world.now());
        world.advance(at(100.0));
        assert_eq!(world.next_due(), None, "nothing moves any more: {kinematics:?}");
    }
}

#[test]
fn a_door_does_not_stop_an_admitted_robot() {
    let mut world = World::new(passage().robot(differential("r1", "A"))).unwrap();
    set_off(&mut world, "r1", 1, "B");
    let mut slowest = f64::INFINITY;
    while world.status(&robot("r1"), GoalId(1)).is_some_and(|status| !status.is_final()) {
        let due = world.next_due().expect("under way");
        world.advance(due);
        if (5.2..6.5).contains(&x(&world, "r1")) {
            slowest = slowest.min(
                world.with_kinematic_model(&robot("r1"), |model| model.as_differential().unwrap().speeds().0).unwrap(),
            );
        }
    }
    assert!(slowest > 0.4, "{slowest} m/s where it leaves the doorway");
}

#[test]
fn a_canceled_robot_frees_the_door_unless_it_stands_in_it() {
    let mut setup = passage().robot(differential("r1", "A")).robot(carrier("r2", "B"));
    // The robots meet on the lane, but this test is about the door.
    setup.systems.retain(|name| name != "collisions");
    let mut world = World::new(setup).unwrap();
    set_off(&mut world, "r1", 1, "B");
    world.advance(at(11.0));
    assert_eq!(logged(&mut world, doors_only).len(), 1, "it waits");
    world.cancel(&robot("r1"), GoalId(1));
    world.advance(at(40.0));
    let lines: Vec<_> = logged(&mut world, doors_only).into_iter().map(|(_, line)| line).collect();
    assert_eq!(lines, ["r1 leaves", "open", "closed"]);
    set_off(&mut world, "r1", 2, "B");
    while !logged(&mut world, doors_only).iter().any(|(_, line)| line == "r1 enters") {
        let due = world.next_due().expect("the door opens");
        world.advance(due);
    }
    world.cancel(&robot("r1"), GoalId(2));
    let now = world.now().as_secs();
    set_off(&mut world, "r2", 1, "A");
    world.advance(at(now + 60.0));
    let lines: Vec<_> = logged(&mut world, doors_only).into_iter().map(|(_, line)| line).collect();
    assert_eq!(lines, ["r2 waits"], "it stands in the doorway");
    set_off(&mut world, "r1", 3, "A");
    assert_eq!(until_ended(&mut world, "r1", 3), GoalStatus::succeeded());
    assert_eq!(until_ended(&mut world, "r2", 1), GoalStatus::succeeded());
}

#[test]
fn every_chassis_stops_before_an_obstacle() {
    for kinematics in all() {
        let mut setup = corridor().robot(steered("r1", "A", kinematics.clone()));
        setup.obstacles.push(trolley());
        let mut world = World::new(setup).unwrap();
        let goal = drive_goal(&world, "B");
        world.start(&robot("r1"), GoalId(1), goal);
        assert_eq!(until_ended(&mut world, "r1", 1), aborted(ErrorCode::Blocked, BLOCKED), "{kinematics:?}");
        assert!((x(&world, "r1") - 4.0).abs() < 0.05, "{} m: {kinematics:?}", x(&world, "r1"));
        assert_eq!(known(&world, "r1"), [(place("A"), place("B"))]);
        set_off(&mut world, "r1", 2, "A");
        assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded(), "the way back is free: {kinematics:?}");
        assert!(x(&world, "r1").abs() < 0.05, "{} m: {kinematics:?}", x(&world, "r1"));
    }
}

#[test]
fn a_new_obstacle_stops_a_chassis_before_it() {
    for (comes, stops) in [(4.0, Some(3.9..4.1)), (9.5, Some(4.6..4.9)), (14.0, None)] {
        let mut setup = corridor().robot(differential("r1", "A"));
        setup.obstacles.push(Obstacle { from_s: comes, ..trolley() });
        let mut world = World::new(setup).unwrap();
        set_off(&mut world, "r1", 1, "B");
        let status = until_ended(&mut world, "r1", 1);
        world.advance(at(60.0));
        let x = x(&world, "r1");
        match stops {
            Some(stops) => {
                assert_eq!(status, aborted(ErrorCode::Blocked, BLOCKED), "it comes at {comes} s");
                assert!(stops.contains(&x), "it comes at {comes} s, the robot stands at {x}");
            }
            None => assert_eq!((status, (x - 10.0).abs() < 0.05), (GoalStatus::succeeded(), true), "{comes} s: {x}"),
        }
    }
}

#[test]
fn a_removed_obstacle_does_not_stop_a_chassis() {
    let mut setup = corridor().robot(differential("r1", "A"));
    setup.obstacles.push(Obstacle { until_s: Some(5.0), ..trolley() });
    let mut world = World::new(setup).unwrap();
    set_off(&mut world, "r1", 1, "B");
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    assert!((x(&world, "r1") - 10.0).abs() < 0.05 && world.now() < at(25.0), "{:?}", world.now());
}

#[test]
fn every_chassis_rides_the_lift_and_drives_on() {
    for kinematics in all() {
        let mut world = World::new(tower(1).robot(steered("r1", "L0", kinematics.clone()))).unwrap();
        set_off(&mut world, "r1", 1, "L2");
        assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded(), "{kinematics:?}");
        assert_eq!((world.now(), world.telemetry(&robot("r1")).unwrap().place), (at(17.0), place("L2")));
        set_off(&mut world, "r1", 2, "Room");
        assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded(), "{kinematics:?}");
        assert!((x(&world, "r1") - 5.0).abs() < 0.05, "{kinematics:?}");
        set_off(&mut world, "r1", 3, "L2");
        assert_eq!(until_ended(&mut world, "r1", 3), GoalStatus::succeeded(), "{kinematics:?}");
        set_off(&mut world, "r1", 4, "L1");
        assert_eq!(until_ended(&mut world, "r1", 4), GoalStatus::succeeded(), "{kinematics:?}");
        let status = world.telemetry(&robot("r1")).unwrap();
        assert_eq!((status.place, status.pose.x), (place("L1"), 0.0), "{kinematics:?}");
    }
}

#[test]
fn a_robot_in_a_lift_blocks_no_other() {
    let quick = RobotSetup { speed: MetresPerSecond::new(1.0).unwrap(), ..steered("r2", "Room", all()[1].clone()) };
    let setup = tower(2).robot(differential("r1", "L0")).robot(quick);
    let mut world = World::new(setup).unwrap();
    set_off(&mut world, "r1", 1, "L2");
    world.advance(at(5.0));
    set_off(&mut world, "r2", 1, "L2");
    assert_eq!(until_ended(&mut world, "r2", 1), GoalStatus::succeeded());
    assert!(x(&world, "r2") < 0.05 && world.now() < at(17.0), "{} m at {:?}", x(&world, "r2"), world.now());
}

#[test]
fn a_steered_robot_follows_waypoints_to_the_last() {
    let mut world = World::new(passage().robot(differential("r1", "A"))).unwrap();
    let waypoints = ["B", "C", "B"].map(|name| waypoint(&world, name)).to_vec();
    world.start(&robot("r1"), GoalId(1), Goal::from(FollowWaypoints { waypoints }));
    let mut furthest = 0.0_f64;
    while world.status(&robot("r1"), GoalId(1)).is_some_and(|status| !status.is_final()) {
        let due = world.next_due().expect("under way");
        world.advance(due);
        furthest = furthest.max(x(&world, "r1"));
    }
    assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::succeeded()));
    assert!((furthest - 20.0).abs() < 0.05 && (x(&world, "r1") - 10.0).abs() < 0.05, "{furthest}");
    let lines = logged(&mut world, doors_only);
    assert_eq!(lines.iter().filter(|(_, line)| line == "r1 enters").count(), 3, "{lines:?}");
}

#[test]
fn a_steered_robot_keeps_limits_and_drives_backward() {
    let text = "{name: two, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}], \
        lanes: [{between: [A, B], speed_limit_mps: 0.2, facing: backward}]}";
    for (kinematics, backward) in all().into_iter().zip([true, false, true, false]) {
        let setup =
            WorldSetup::new(map::read(text, "two.yaml").unwrap(), 1).robot(steered("r1", "A", kinematics.clone()));
        let mut world = World::new(setup).unwrap();
        let goal = Goal::from(NavigateToPose::to(Pose::new(10.0, 0.0, std::f64::consts::PI), Some(place("B"))));
        world.start(&robot("r1"), GoalId(1), goal);
        let (mut before, mut fastest) = (pose_of(&world, "r1"), 0.0_f64);
        while world.status(&robot("r1"), GoalId(1)).is_some_and(|status| !status.is_final()) {
            world.advance(WorldTime::from_secs(world.now().as_secs() + 1.0));
            let pose = pose_of(&world, "r1");
            fastest = fastest.max(before.distance(pose).get());
            if backward && (3.0..9.0).contains(&pose.x) {
                assert!(pose.yaw.cos() < -0.95, "{pose:?}: {kinematics:?}");
            }
            before = pose;
        }
        assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::succeeded()), "{kinematics:?}");
        assert!((x(&world, "r1") - 10.0).abs() < 0.05 && (0.19..0.201).contains(&fastest), "{fastest}: {kinematics:?}");
    }
}

#[test]
fn a_steered_robot_departs_with_its_turned_heading() {
    for kinematics in all() {
        let mut world = World::new(corridor().robot(steered("r1", "A", kinematics.clone()))).unwrap();
        run_to_success(&mut world, "r1", 1, Goal::from(Spin { angle_rad: 2.0 }));
        assert!((pose_of(&world, "r1").yaw - 2.0).abs() < 1e-9, "{kinematics:?}");
        set_off(&mut world, "r1", 2, "B");
        world.advance(at(2.1));
        assert!((1.5..2.1).contains(&pose_of(&world, "r1").yaw), "{:?}: {kinematics:?}", pose_of(&world, "r1"));
        assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded(), "{kinematics:?}");
    }
}
