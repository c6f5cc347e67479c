//! The lab-samples mission, run step by step through the backend.

use super::*;
use crate::world::actions::{ApproachPerson, ApproachRobot, AuthenticatePerson, Deposit, OperateDrawer, PickUp};
use std::collections::BTreeMap;

/// The places from PC Room 3 to the Laboratory on the shipped map, 4 + 13 + 4 m.
const WAY: [&str; 7] = [
    "PC Corridor 3",
    "PC Corridor 6",
    "PC Corridor 2",
    "PC Corridor 5",
    "PC Corridor 1",
    "Laboratory Corridor",
    "Laboratory",
];

#[test]
fn the_sample_reaches_the_laboratory() {
    let setup = hospital(11)
        .robot(carrier("r1", "PC Corridor 3"))
        .robot(RobotSetup::arm(robot("lab_arm"), place("Laboratory")))
        .person(nurse("Nia", "PC Room 3", "s1"));
    let mut world = World::new(setup).unwrap();
    let room = drive_goal(&world, "PC Room 3");
    run_to_success(&mut world, "r1", 1, room);
    run_to_success(&mut world, "r1", 2, Goal::from(ApproachPerson { role: role("nurse") }));
    run_to_success(&mut world, "r1", 3, Goal::from(AuthenticatePerson { role: role("nurse") }));
    assert!(world.robot_report(&robot("r1")).unwrap().authenticated);
    run_to_success(&mut world, "r1", 4, Goal::from(OperateDrawer { open: true }));
    world.request_person(GoalId(1), deposit("r1"));
    let due = world.next_due().unwrap();
    assert_eq!(
        world.advance(due),
        [BackendEvent::PersonRequestEnded { request: GoalId(1), result: Ok(BTreeMap::new()) }]
    );
    let handed_over = world.now();
    run_to_success(&mut world, "r1", 5, Goal::from(OperateDrawer { open: false }));
    for (id, to) in (6..).zip(WAY) {
        let leg = drive_goal(&world, to);
        run_to_success(&mut world, "r1", id, leg);
    }
    assert_eq!(world.sample(&"s1".into()).unwrap().place, place("Laboratory"), "it travels with the robot");
    run_to_success(&mut world, "r1", 20, Goal::from(ApproachRobot { robot: robot("lab_arm") }));
    run_to_success(&mut world, "r1", 21, Goal::from(OperateDrawer { open: true }));
    run_to_success(&mut world, "lab_arm", 1, Goal::from(PickUp { from: robot("r1") }));
    let picked_up = world.now();
    run_to_success(&mut world, "r1", 22, Goal::from(OperateDrawer { open: false }));
    assert_eq!(
        world.samples(),
        [SampleReport {
            id: "s1".into(),
            holder: SampleHolder::Arm(robot("lab_arm")),
            place: place("Laboratory"),
            history: vec![
                (handed_over, SampleHolder::Person("Nia".into())),
                (picked_up, SampleHolder::Drawer(robot("r1")))
            ],
        }]
    );
    let driven = (4.0 + 4.0 + 13.0 + 4.0) / 0.5;
    let took = world.now().as_secs() - driven - 8.0 * 2.0;
    assert!((2.0..=4.0).contains(&took), "driving, eight steps of 2 s, and the nurse: {took}");
    run_to_success(&mut world, "lab_arm", 2, Goal::from(Deposit { into: None }));
    assert_eq!(world.samples()[0].holder, SampleHolder::Table(place("Laboratory")));
}

#[test]
fn an_arm_on_wheels_carries_a_sample_from_one_drawer_to_another() {
    let mut porter = carrier("porter", "PC Room 1");
    porter.has_arm = true;
    let setup = hospital(1)
        .robot(carrier("r1", "PC Room 1"))
        .robot(carrier("r2", "PC Corridor 1"))
        .robot(porter)
        .person(nurse("Ana", "PC Room 1", "s1"));
    let mut world = World::new(setup).unwrap();
    let sample_holder = |world: &World| world.samples()[0].holder.clone();
    run_to_success(&mut world, "r1", 1, Goal::from(ApproachPerson { role: role("nurse") }));
    run_to_success(&mut world, "r1", 2, Goal::from(OperateDrawer { open: true }));
    world.request_person(GoalId(1), deposit("r1"));
    world.advance(at(20.0));
    run_to_success(&mut world, "porter", 1, Goal::from(ApproachRobot { robot: robot("r1") }));
    run_to_success(&mut world, "porter", 2, Goal::from(PickUp { from: robot("r1") }));
    let status = rejected_status(&mut world, "porter", 3, Goal::from(PickUp { from: robot("r1") }));
    assert_eq!(status, aborted(ErrorCode::Busy, "porter already holds s1"));
    let out = drive_goal(&world, "PC Corridor 1");
    run_to_success(&mut world, "porter", 4, out);
    assert_eq!(sample_holder(&world), SampleHolder::Arm(robot("porter")));
    run_to_success(&mut world, "r2", 1, Goal::from(OperateDrawer { open: true }));
    run_to_success(&mut world, "porter", 5, Goal::from(ApproachRobot { robot: robot("r2") }));
    run_to_success(&mut world, "porter", 6, Goal::from(Deposit { into: Some(robot("r2")) }));
    assert_eq!(sample_holder(&world), SampleHolder::Drawer(robot("r2")));
    assert_eq!(world.samples()[0].place, place("PC Corridor 1"));
}

#[test]
fn a_stationary_arm_puts_an_object_down_before_the_next() {
    let mut nurse = nurse("Ana", "Laboratory", "s1");
    nurse.samples.push("s2".into());
    let setup = hospital(1)
        .robot(carrier("r1", "Laboratory"))
        .robot(RobotSetup::arm(robot("lab_arm"), place("Laboratory")))
        .person(nurse);
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(OperateDrawer { open: true }));
    for (turn, goals) in [(1, [2, 3]), (2, [4, 5])] {
        run_to_success(&mut world, "r1", goals[0], Goal::from(ApproachPerson { role: role("nurse") }));
        world.request_person(GoalId(turn), deposit("r1"));
        let soon = at(world.now().as_secs() + 10.0);
        world.advance(soon);
        run_to_success(&mut world, "r1", goals[1], Goal::from(ApproachRobot { robot: robot("lab_arm") }));
        run_to_success(&mut world, "lab_arm", turn, Goal::from(PickUp { from: robot("r1") }));
    }
    let sample_holders: Vec<SampleHolder> = world.samples().into_iter().map(|sample| sample.holder).collect();
    assert_eq!(sample_holders, [SampleHolder::Table(place("Laboratory")), SampleHolder::Arm(robot("lab_arm"))]);
}
