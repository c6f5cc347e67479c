//! Obstacles: encountered, detected, remembered for a while.

use super::*;

pub(super) fn corridor() -> WorldSetup {
    let text = "{name: corridor, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
        {name: C, kind: other, x_m: 0, y_m: 10}], lanes: [{between: [A, B]}, {between: [A, C]}]}";
    WorldSetup::new(map::read(text, "corridor.yaml").unwrap(), 1)
}

pub(super) fn trolley() -> Obstacle {
    Obstacle::between("trolley", place("A"), place("B"))
}

pub(super) const BLOCKED: &str = "the lane from A to B is blocked: trolley is in the way";

pub(super) fn x(world: &World, name: &str) -> f64 {
    world.telemetry(&robot(name)).unwrap().pose.x
}

pub(super) fn known(world: &World, name: &str) -> Vec<(PlaceId, PlaceId)> {
    world.telemetry(&robot(name)).unwrap().closed
}

#[test]
fn a_robot_stops_before_an_obstacle() {
    let mut setup = corridor().robot(carrier("r1", "A")).robot(carrier("r2", "A"));
    setup.obstacles.push(trolley());
    let mut world = World::new(setup).unwrap();
    assert_eq!(known(&world, "r1"), [], "it has not met it");
    let goal = drive_goal(&world, "B");
    assert_eq!(run(&mut world, "r1", 1, goal).0, aborted(ErrorCode::Blocked, BLOCKED));
    assert_eq!((world.now(), x(&world, "r1")), (at(8.0), 4.0));
    assert_eq!(known(&world, "r1"), [(place("A"), place("B"))]);
    assert_eq!(known(&world, "r2"), [], "nobody has told it");
    let (again, back) = (drive_goal(&world, "B"), drive_goal(&world, "A"));
    assert_eq!(run(&mut world, "r1", 2, again).0, aborted(ErrorCode::Blocked, BLOCKED), "it is still there");
    run_to_success(&mut world, "r1", 3, back);
    assert_eq!(world.now(), at(16.0));
}

#[test]
fn a_new_obstacle_stops_a_robot_before_it() {
    for (comes, ends) in [(4.0, 8.0), (9.0, 9.0), (11.0, 20.0)] {
        let mut setup = corridor().robot(carrier("r1", "A"));
        setup.obstacles.push(Obstacle { from_s: comes, ..trolley() });
        let mut world = World::new(setup).unwrap();
        let goal = drive_goal(&world, "B");
        let (status, _) = run(&mut world, "r1", 1, goal);
        assert_eq!(world.now(), at(ends), "it comes at {comes} s");
        let expected = if ends == 20.0 { GoalStatus::succeeded() } else { aborted(ErrorCode::Blocked, BLOCKED) };
        assert_eq!(status, expected, "it comes at {comes} s");
    }
}

#[test]
fn an_obstacle_removed_in_time_stops_no_robot() {
    let mut setup = corridor().robot(carrier("r1", "B"));
    setup.obstacles.push(Obstacle { until_s: Some(7.0), ..trolley() });
    let mut world = World::new(setup).unwrap();
    let goal = drive_goal(&world, "A");
    run_to_success(&mut world, "r1", 1, goal);
    assert_eq!((world.now(), known(&world, "r1")), (at(20.0), vec![]));
}

#[test]
fn a_remembered_closure_expires() {
    let mut world = World::new(corridor().robot(carrier("r1", "A"))).unwrap();
    world.add_obstacle(&Obstacle { at: 0.0, ..trolley() }).unwrap();
    let goal = drive_goal(&world, "B");
    assert_eq!(run(&mut world, "r1", 1, goal.clone()).0, aborted(ErrorCode::Blocked, BLOCKED));
    assert_eq!(world.now(), at(0.0), "it stands right before the robot");
    world.remove_obstacle("trolley");
    world.advance(at(299.0));
    assert_eq!(known(&world, "r1").len(), 1, "the robot has not tried the lane again");
    world.advance(at(300.0));
    assert_eq!(known(&world, "r1"), []);
    run_to_success(&mut world, "r1", 2, goal);
}

#[test]
fn a_setup_with_an_invalid_obstacle_is_rejected() {
    let mut setup = corridor();
    setup.obstacles = vec![
        Obstacle { on: (place("B"), place("C")), ..trolley() },
        Obstacle { on: (place("A"), place("D")), name: "cart".to_owned(), ..trolley() },
        Obstacle { at: 1.5, name: "bed".to_owned(), ..trolley() },
        Obstacle { from_s: 9.0, until_s: Some(8.0), ..trolley() },
    ];
    let errors = World::new(setup).unwrap_err().to_string();
    assert_eq!(
        errors.lines().collect::<Vec<_>>(),
        [
            "obstacle trolley: map corridor has no lane between \"B\" and \"C\"",
            "obstacle cart: there is no place \"D\" on map corridor; did you mean \"A\"?",
            "obstacle bed: at is 1.5, allowed is a number from 0 to 1",
            "obstacle trolley: until_s is 8, allowed is a number of seconds, no less than from_s",
            "obstacle trolley is defined more than once",
        ]
    );
}

#[test]
fn worlds_share_no_obstacles() {
    let mut closed = World::new(corridor().robot(carrier("r1", "A"))).unwrap();
    closed.add_obstacle(&trolley()).unwrap();
    let mut open = World::new(corridor().robot(carrier("r1", "A"))).unwrap();
    let goal = drive_goal(&open, "B");
    run_to_success(&mut open, "r1", 1, goal);
    assert_eq!(open.now(), at(20.0));
}
