//! Robots with kinematics: on lanes, in steps, around each other and in collisions.

use super::*;
use crate::kinematics::{AckermannSettings, AerialSettings, DifferentialSettings, Kinematics, OmnidirectionalSettings};
use crate::world::actions::ApproachRobot;
use consort_protocol::pose::Pose;

pub(super) fn all() -> [Kinematics; 4] {
    [
        Kinematics::Differential(DifferentialSettings::default()),
        Kinematics::Omnidirectional(OmnidirectionalSettings::default()),
        Kinematics::Ackermann(AckermannSettings::default()),
        Kinematics::Aerial(AerialSettings::default()),
    ]
}

/// A robot without discharge, so that the queue contains only its own motion.
pub(super) fn steered(name: &str, at: &str, kinematics: Kinematics) -> RobotSetup {
    RobotSetup { kinematics: Some(kinematics), discharge: SharePerSecond::new(0.0).unwrap(), ..carrier(name, at) }
}

pub(super) fn differential(name: &str, at: &str) -> RobotSetup {
    steered(name, at, all()[0].clone())
}

/// A hall without walls: A at the origin, B 10 m east of it, C 10 m north of B.
fn hall() -> Map {
    let text = "{name: hall, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
                {name: C, kind: other, x_m: 10, y_m: 10}], lanes: [{between: [A, B]}, {between: [B, C]}]}";
    map::read(text, "hall").unwrap()
}

/// The same with a wall across the lane from A to B.
fn walled() -> Map {
    let text = "{name: hall, walls: [[[5, -3], [5, 3]]], places: [{name: A, kind: other, x_m: 0, y_m: 0}, \
                {name: B, kind: other, x_m: 10, y_m: 0}], lanes: [{between: [A, B]}]}";
    map::read(text, "walled").unwrap()
}

pub(super) fn pose_of(world: &World, name: &str) -> Pose {
    world.telemetry(&robot(name)).unwrap().pose
}

/// Advances time until a robot's goal has ended.
pub(super) fn until_ended(world: &mut World, name: &str, id: u64) -> GoalStatus {
    for _ in 0..100_000 {
        let due = world.next_due().expect("the goal has not ended");
        world.advance(due);
        match world.status(&robot(name), GoalId(id)) {
            Some(status) if status.is_final() => return status,
            _ => {}
        }
    }
    panic!("goal {id} of {name} did not end");
}

#[test]
fn every_chassis_drives_the_lanes_and_then_the_world_rests() {
    for kinematics in all() {
        let mut world = World::new(WorldSetup::new(hall(), 1).robot(steered("r1", "A", kinematics.clone()))).unwrap();
        for (id, to) in [(1, "B"), (2, "C"), (3, "B")] {
            let goal = drive_goal(&world, to);
            world.start(&robot("r1"), GoalId(id), goal);
            assert_eq!(until_ended(&mut world, "r1", id), GoalStatus::succeeded(), "{kinematics:?} to {to}");
            let there = world.map().place(&place(to)).unwrap().pose;
            assert!(pose_of(&world, "r1").distance(there).get() < 0.05, "{kinematics:?} to {to}");
            assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place(to));
        }
        assert!((60.0..110.0).contains(&world.now().as_secs()), "30 m at 0.5 m/s: {:?}", world.now());
        world.advance(at(200.0));
        assert_eq!(world.next_due(), None, "nothing moves, so nothing is due: {kinematics:?}");
    }
}

#[test]
fn steps_of_any_length_give_the_same_arrival() {
    for kinematics in all() {
        let [coarse, fine] = [0.1, 1.0 / 60.0].map(|step_s| {
            let setup = WorldSetup { step_s, ..WorldSetup::new(hall(), 1) };
            let mut world = World::new(setup.robot(steered("r1", "A", kinematics.clone()))).unwrap();
            let goal = drive_goal(&world, "B");
            world.start(&robot("r1"), GoalId(1), goal);
            assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
            world.now().as_secs()
        });
        assert!((coarse - fine).abs() < 0.01 * fine, "{coarse} s at 10 Hz, {fine} s at 60: {kinematics:?}");
    }
}

#[test]
fn a_driving_robot_reports_progress_at_any_time() {
    let mut world = World::new(WorldSetup::new(hall(), 1).robot(differential("r1", "A"))).unwrap();
    let goal = drive_goal(&world, "B");
    world.start(&robot("r1"), GoalId(1), goal);
    world.advance(at(10.013));
    let x = pose_of(&world, "r1").x;
    assert!((4.0..5.0).contains(&x), "10 s at 0.5 m/s less the ramp: {x} m");
    let Some(GoalStatus::Executing(feedback)) = world.status(&robot("r1"), GoalId(1)) else { panic!("under way") };
    assert!((feedback.distance_remaining.get() - (10.0 - x)).abs() < 0.05, "{feedback:?} at {x}");
    assert!((10.0..14.0).contains(&feedback.time_remaining.get()), "{feedback:?}");
    assert!(world.with_kinematic_model(&robot("r1"), |model| model.is_moving()).unwrap());
    assert!(world.with_kinematic_model(&robot("r2"), |_| ()).is_none());
}

#[test]
fn a_canceled_robot_brakes_and_drives_on_from_there() {
    let mut world = World::new(WorldSetup::new(hall(), 1).robot(differential("r1", "A"))).unwrap();
    let goal = drive_goal(&world, "B");
    world.start(&robot("r1"), GoalId(1), goal.clone());
    world.advance(at(8.02));
    let before = pose_of(&world, "r1").x;
    world.cancel(&robot("r1"), GoalId(1));
    world.advance(at(20.0));
    let rolled = pose_of(&world, "r1").x - before;
    assert!((0.05..0.3).contains(&rolled), "0.5 m/s and 0.8 m/s²: {rolled} m");
    assert_eq!((world.status(&robot("r1"), GoalId(1)), world.next_due()), (Some(GoalStatus::Canceled), None));
    world.start(&robot("r1"), GoalId(2), goal);
    assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded());
}

#[test]
fn a_chassis_needs_a_lane_too() {
    let mut world = World::new(WorldSetup::new(hall(), 1).robot(differential("r1", "A"))).unwrap();
    let goal = drive_goal(&world, "C");
    assert_eq!(rejected_status(&mut world, "r1", 1, goal), aborted(ErrorCode::NoRoute, "no lane from A to C"));
    assert_eq!(world.next_due(), None);
}

#[test]
fn a_wall_stops_a_robot_and_is_reported_once() {
    let mut world = World::new(WorldSetup::new(walled(), 1).robot(differential("r1", "A"))).unwrap();
    let (there, back) = (drive_goal(&world, "B"), drive_goal(&world, "A"));
    world.start(&robot("r1"), GoalId(1), there);
    let status = until_ended(&mut world, "r1", 1);
    assert_eq!(status, aborted(ErrorCode::NoRoute, "r1 collided with a wall"));
    let x = pose_of(&world, "r1").x;
    assert!((4.74..4.8).contains(&x), "its edge is 0.25 m ahead of its middle: {x}");
    world.start(&robot("r1"), GoalId(2), back);
    assert_eq!(until_ended(&mut world, "r1", 2), GoalStatus::succeeded(), "the way back is free");
    let collided = WorldEvent::Collided { robot: robot("r1"), with: None };
    let journal = world.drain_event_log();
    assert_eq!(journal.iter().filter(|entry| entry.event == collided).count(), 1);
}

#[test]
fn two_robots_that_meet_on_a_lane_collide() {
    let setup = WorldSetup::new(hall(), 1).robot(differential("r1", "A")).robot(differential("r2", "B"));
    let mut world = World::new(setup).unwrap();
    let (there, back) = (drive_goal(&world, "B"), drive_goal(&world, "A"));
    world.start(&robot("r1"), GoalId(1), there);
    world.start(&robot("r2"), GoalId(1), back);
    assert_eq!(until_ended(&mut world, "r1", 1), aborted(ErrorCode::NoRoute, "r1 collided with r2"));
    assert_eq!(world.status(&robot("r2"), GoalId(1)), Some(aborted(ErrorCode::NoRoute, "r2 collided with r1")));
    let apart = pose_of(&world, "r1").distance(pose_of(&world, "r2")).get();
    assert!((0.4..0.5).contains(&apart), "they touch: {apart} m");
}

#[test]
fn drones_avoid_each_other_on_a_lane() {
    let drone =
        |name, at| RobotSetup { speed: MetresPerSecond::new(3.0).unwrap(), ..steered(name, at, all()[3].clone()) };
    let setup = WorldSetup::new(hall(), 1).robot(drone("r1", "A")).robot(drone("r2", "B"));
    let mut world = World::new(setup).unwrap();
    let (there, back) = (drive_goal(&world, "B"), drive_goal(&world, "A"));
    world.start(&robot("r1"), GoalId(1), there);
    world.start(&robot("r2"), GoalId(1), back);
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    assert_eq!(until_ended(&mut world, "r2", 1), GoalStatus::succeeded());
}

#[test]
fn a_robot_arrives_next_to_a_robot_at_its_target() {
    let setup = WorldSetup::new(hall(), 1).robot(differential("r1", "A")).robot(carrier("r2", "B"));
    let mut world = World::new(setup).unwrap();
    let goal = drive_goal(&world, "B");
    world.start(&robot("r1"), GoalId(1), goal);
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    let apart = pose_of(&world, "r1").distance(pose_of(&world, "r2")).get();
    assert!((0.55..0.65).contains(&apart), "{apart} m");
    run_to_success(&mut world, "r1", 2, Goal::from(ApproachRobot { robot: robot("r2") }));
}

#[test]
fn gusts_push_only_hovering_robots() {
    let wind = Some(WindSettings { interval_s: 0.7, probability: 1.0, max_speed_change_mps: 0.5 });
    let setup = WorldSetup { wind, ..WorldSetup::new(hall(), 1) };
    let setup = setup.robot(steered("r1", "A", all()[3].clone())).robot(differential("r2", "B"));
    let mut world = World::new(setup).unwrap();
    let goal = drive_goal(&world, "B");
    world.start(&robot("r1"), GoalId(1), goal.clone());
    assert_eq!(until_ended(&mut world, "r1", 1), GoalStatus::succeeded());
    let (before, mut strayed_m) = (pose_of(&world, "r1"), 0.0_f64);
    for _ in 0..400 {
        let due = world.next_due().unwrap();
        world.advance(due);
        strayed_m = strayed_m.max(pose_of(&world, "r1").distance(before).get());
    }
    assert!((0.001..0.2).contains(&strayed_m), "{strayed_m} m");
    assert_eq!(pose_of(&world, "r2"), world.map().place(&place("B")).unwrap().pose);
}

#[test]
fn invalid_kinematics_are_rejected() {
    let settings = AckermannSettings { turning_radius_m: 0.0, ..AckermannSettings::default() };
    let mut setup = WorldSetup::new(hall(), 1).robot(steered("r1", "A", Kinematics::Ackermann(settings)));
    setup.robots[0].radius_m = -1.0;
    (setup.step_s, setup.wind) = (0.0, Some(WindSettings { probability: 2.0, ..WindSettings::default() }));
    setup.systems.retain(|name| name != "steering");
    let said = World::new(setup).unwrap_err().to_string();
    assert_eq!(
        said.lines().collect::<Vec<_>>(),
        [
            "world: step_s is 0, allowed is a number of seconds from 0.001 to 10",
            "wind: probability is 2, allowed is a number from 0 to 1",
            "robot r1: radius_m is -1, allowed is a number of metres from 0.01 to 10",
            "robot r1, kinematics: turning_radius_m is 0, allowed is a number from 0.001 to 1000",
            "robot r1 has kinematics, so the systems must include driving and steering; they are: driving, doors, lifts, \
             obstacles, turning, waiting, declared_actions, co_presence, drawer, arm, docking, power, spontaneous_actions, people, collisions, wind",
        ]
    );
}

#[test]
fn a_chassis_is_read_from_a_file() {
    let text = r#"{"id": "r1", "place": "A", "speed_mps": 0.5, "battery": 1.0, "discharge_share_per_s": 0.001,
        "radius_m": 0.3, "kinematics": {"kind": "ackermann", "turning_radius_m": 2}}"#;
    let body: RobotSetup = serde_json::from_str(text).unwrap();
    let settings = AckermannSettings { turning_radius_m: 2.0, ..AckermannSettings::default() };
    assert_eq!((body.radius_m, body.kinematics), (0.3, Some(Kinematics::Ackermann(settings))));
    let wrong = text.replace("turning_radius_m", "turning_radius");
    let said = serde_json::from_str::<RobotSetup>(&wrong).unwrap_err().to_string();
    assert!(said.contains("unknown field `turning_radius`"), "{said}");
}
