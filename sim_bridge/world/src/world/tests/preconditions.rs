//! Preconditions of goals, at the start and at the end.

use super::*;
use crate::world::actions::{ApproachPerson, ApproachRobot, AuthenticatePerson, Deposit, OperateDrawer, PickUp};

fn lab() -> World {
    let setup = hospital(1)
        .robot(carrier("r1", "Laboratory"))
        .robot(carrier("r2", "Laboratory"))
        .robot(RobotSetup::arm(robot("lab_arm"), place("Laboratory")))
        .person(nurse("Ana", "PC Room 1", "s1"));
    World::new(setup).unwrap()
}

fn pick_up() -> Goal {
    Goal::from(PickUp { from: robot("r1") })
}

#[test]
fn rejections_name_the_objects_involved() {
    use ErrorCode::*;
    let nurse = role("nurse");
    let corridor = drive_goal(&lab(), "Laboratory Corridor");
    for (name, goal, code, message) in [
        ("r1", Goal::from(ApproachPerson { role: nurse.clone() }), OutOfReach, "r1: no nurse is at Laboratory"),
        ("r1", Goal::from(AuthenticatePerson { role: nurse }), OutOfReach, "r1 has not approached a nurse"),
        ("r1", Goal::from(ApproachRobot { robot: robot("r1") }), Unknown, "r1 cannot do this with itself"),
        (
            "r1",
            Goal::from(ApproachRobot { robot: robot("lab_arn") }),
            Unknown,
            "there is no robot lab_arn here; did you mean \"lab_arm\"?",
        ),
        ("r1", pick_up(), Unknown, "r1 cannot do this with itself"),
        ("r2", pick_up(), OutOfReach, "r2 has no arm"),
        ("lab_arm", Goal::from(OperateDrawer { open: true }), ContainerState, "lab_arm has no drawer"),
        ("lab_arm", corridor, NoRoute, "lab_arm cannot drive"),
        ("lab_arm", pick_up(), OutOfReach, "neither of lab_arm and r1 has approached the other"),
        ("lab_arm", Goal::from(Deposit { into: None }), ContainerState, "lab_arm holds nothing"),
    ] {
        assert_eq!(rejected_status(&mut lab(), name, 1, goal), aborted(code, message));
    }
}

#[test]
fn picking_up_needs_an_open_drawer_with_content() {
    let mut world = lab();
    run_to_success(&mut world, "r1", 1, Goal::from(ApproachRobot { robot: robot("lab_arm") }));
    let status = rejected_status(&mut world, "lab_arm", 1, pick_up());
    assert_eq!(status, aborted(ErrorCode::ContainerState, "the drawer of r1 is closed"));
    run_to_success(&mut world, "r1", 2, Goal::from(OperateDrawer { open: true }));
    let status = rejected_status(&mut world, "lab_arm", 2, pick_up());
    assert_eq!(status, aborted(ErrorCode::ContainerState, "the drawer of r1 is empty"));
}

#[test]
fn a_departed_robot_loses_its_co_presence() {
    let mut world = lab();
    run_to_success(&mut world, "lab_arm", 1, Goal::from(ApproachRobot { robot: robot("r1") }));
    run_to_success(&mut world, "r1", 1, Goal::from(OperateDrawer { open: true }));
    let (out, back) = (drive_goal(&world, "Laboratory Corridor"), drive_goal(&world, "Laboratory"));
    run_to_success(&mut world, "r1", 2, out);
    let status = rejected_status(&mut world, "lab_arm", 2, pick_up());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "lab_arm is at Laboratory, r1 at Laboratory Corridor"));
    run_to_success(&mut world, "r1", 3, back);
    let status = rejected_status(&mut world, "lab_arm", 3, pick_up());
    assert_eq!(status, aborted(ErrorCode::OutOfReach, "neither of lab_arm and r1 has approached the other"));
}

#[test]
fn a_goal_fails_if_its_preconditions_end() {
    let mut world = lab();
    world.start(&robot("r1"), GoalId(1), Goal::from(ApproachRobot { robot: robot("r2") }));
    world.advance(at(1.0));
    let out = drive_goal(&world, "Laboratory Corridor");
    world.start(&robot("r2"), GoalId(1), out);
    let between = "r1 is at Laboratory, r2 between Laboratory and Laboratory Corridor";
    assert_eq!(world.advance(at(2.0)), [ended("r1", 1, aborted(ErrorCode::OutOfReach, between))]);
    assert_eq!(world.robot_report(&robot("r1")).unwrap().beside_robot, None);
}

#[test]
fn a_canceled_goal_changes_nothing() {
    let mut world = lab();
    world.start(&robot("r1"), GoalId(1), Goal::from(OperateDrawer { open: true }));
    world.advance(at(1.0));
    world.cancel(&robot("r1"), GoalId(1));
    assert_eq!(world.advance(at(9.0)), [ended("r1", 1, GoalStatus::Canceled)]);
    assert!(!world.robot_report(&robot("r1")).unwrap().drawer_open);
}

#[test]
fn the_wrong_person_is_not_authenticated() {
    let mut setup = hospital(1).robot(carrier("r1", "PC Room 1")).person(nurse("Ana", "PC Room 1", "s1"));
    setup.people.push(PersonSetup::new("Eve", role("visitor"), place("PC Room 1")));
    let mut world = World::new(setup).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(ApproachPerson { role: role("visitor") }));
    let status = rejected_status(&mut world, "r1", 2, Goal::from(AuthenticatePerson { role: role("nurse") }));
    assert_eq!(status, aborted(ErrorCode::NotAuthenticated, "r1: Eve is a visitor, not a nurse"));
}
