//! Objects on tables: grasped within reach and payload, carried, put down, kept by a stopped robot.

use super::*;
use crate::world::actions::{Deposit, Grasp};

fn thing(name: &str, weight_kg: f64, distance_m: f64) -> ObjectSetup {
    ObjectSetup { name: name.into(), place: place("Laboratory"), weight_kg, distance_m }
}

fn porter() -> RobotSetup {
    RobotSetup { has_arm: true, ..carrier("r1", "Laboratory") }
}

fn store() -> World {
    let mut setup = hospital(1).robot(porter()).robot(carrier("r2", "Laboratory"));
    setup.objects = vec![thing("tray", 1.5, 0.5), thing("crate", 2.5, 0.5), thing("box", 0.5, 1.5)];
    World::new(setup).unwrap()
}

fn grasp(object: &str) -> Goal {
    Goal::from(Grasp { object: object.to_owned() })
}

fn sample_holder(world: &World, object: &str) -> SampleHolder {
    world.sample(&object.into()).unwrap().holder
}

#[test]
fn an_arm_takes_objects_within_reach_and_payload() {
    let mut world = store();
    for (id, object, code, message) in [
        (1, "crate", ErrorCode::TooHeavy, "crate weighs 2.5 kg, r1 lifts 2 kg"),
        (2, "box", ErrorCode::OutOfReach, "box is 1.5 m away, r1 reaches 1 m"),
        (3, "cup", ErrorCode::OutOfReach, "no \"cup\" is on the table at Laboratory; objects there: tray, crate, box"),
    ] {
        assert_eq!(rejected_status(&mut world, "r1", id, grasp(object)), aborted(code, message));
    }
    let status = rejected_status(&mut world, "r2", 4, grasp("tray"));
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "r2 has no arm"));
    run_to_success(&mut world, "r1", 5, grasp("tray"));
    assert_eq!((world.now(), sample_holder(&world, "tray")), (at(2.0), SampleHolder::Arm(robot("r1"))));
    let status = rejected_status(&mut world, "r1", 6, grasp("box"));
    assert_eq!(status, aborted(ErrorCode::Busy, "r1 already holds tray"));
}

#[test]
fn an_object_is_carried_and_put_down_elsewhere() {
    let mut world = store();
    run_to_success(&mut world, "r1", 1, grasp("tray"));
    let goal = drive_goal(&world, "Laboratory Corridor");
    run_to_success(&mut world, "r1", 2, goal);
    assert_eq!(world.sample(&"tray".into()).unwrap().place, place("Laboratory Corridor"));
    run_to_success(&mut world, "r1", 3, Goal::from(Deposit { into: None }));
    assert_eq!(sample_holder(&world, "tray"), SampleHolder::Table(place("Laboratory Corridor")));
    run_to_success(&mut world, "r1", 4, grasp("tray"));
}

#[test]
fn an_interrupted_grasp_leaves_the_object_in_place() {
    let mut world = store();
    world.start(&robot("r1"), GoalId(1), grasp("tray"));
    world.advance(at(1.0));
    world.cancel(&robot("r1"), GoalId(1));
    world.advance(at(9.0));
    assert_eq!(sample_holder(&world, "tray"), SampleHolder::Table(place("Laboratory")));
    world.start(&robot("r1"), GoalId(2), grasp("tray"));
    world.set_charge(&robot("r1"), BatteryShare::new(0.04).unwrap());
    world.advance(at(20.0));
    assert_eq!(sample_holder(&world, "tray"), SampleHolder::Table(place("Laboratory")), "its battery ran down");
}

#[test]
fn a_stranded_robot_keeps_its_load() {
    let mut world = store();
    run_to_success(&mut world, "r1", 1, grasp("tray"));
    let goal = drive_goal(&world, "Laboratory Corridor");
    world.start(&robot("r1"), GoalId(2), goal);
    world.advance(at(4.0));
    world.set_charge(&robot("r1"), BatteryShare::new(0.04).unwrap());
    world.advance(at(60.0));
    let left = world.sample(&"tray".into()).unwrap();
    assert_eq!(
        (left.holder, left.place),
        (SampleHolder::Arm(robot("r1")), place("Laboratory")),
        "a metre down the lane"
    );
}

#[test]
fn two_arms_do_not_take_the_same_object() {
    let mut setup = hospital(1).robot(porter()).robot(RobotSetup { has_arm: true, ..carrier("r2", "Laboratory") });
    setup.objects = vec![thing("tray", 1.5, 0.5)];
    let mut world = World::new(setup).unwrap();
    world.start(&robot("r2"), GoalId(1), grasp("tray"));
    world.start(&robot("r1"), GoalId(1), grasp("tray"));
    let late = aborted(ErrorCode::OutOfReach, "no \"tray\" is on the table at Laboratory; objects there: nothing");
    let events = [ended("r2", 1, GoalStatus::succeeded()), ended("r1", 1, late)];
    assert_eq!(world.advance(at(10.0)), events);
}

#[test]
fn a_setup_with_invalid_objects_is_rejected() {
    let mut setup = hospital(1).robot(RobotSetup { reach_m: f64::NAN, ..porter() });
    setup.objects = vec![thing("tray", -1.0, 0.0), ObjectSetup { place: place("Attic"), ..thing("tray", 1.0, 0.0) }];
    let errors = World::new(setup).unwrap_err().to_string();
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            "robot r1: reach_m is NaN, allowed is a number from 0 to 1000",
            "object tray: weight_kg is -1, allowed is a number from 0 to 1000",
            "object tray: there is no place \"Attic\" on map hospital",
            "sample tray is defined more than once",
        ]
    );
}
