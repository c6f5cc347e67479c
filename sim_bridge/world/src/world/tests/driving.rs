//! Driving: straight lines, the robot's own speed, lanes.

use super::*;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, MetresPerSecond};
use consort_skills::actions::{Feedback, NavigateToPose, Wait};

fn two_places(dx: f64, dy: f64) -> Map {
    let text = format!(
        "{{name: two, places: [{{name: A, kind: other, x_m: 0, y_m: 0}}, {{name: B, kind: other, x_m: {dx}, y_m: {dy}}}], \
         lanes: [{{between: [A, B]}}]}}"
    );
    map::read(&text, "two.yaml").unwrap()
}

#[test]
fn a_leg_takes_its_length_over_the_speed_in_every_direction() {
    for (dx, dy) in [(5.0, 0.0), (0.0, -5.0), (3.0, 4.0), (-4.0, 3.0)] {
        let mut world = World::new(WorldSetup::new(two_places(dx, dy), 1).robot(carrier("r1", "A"))).unwrap();
        let goal = drive_goal(&world, "B");
        world.start(&robot("r1"), GoalId(1), goal);
        assert_eq!(world.next_due(), Some(at(10.0)), "5 m at 0.5 m/s towards ({dx}, {dy})");
        world.advance(at(4.0));
        let there = world.telemetry(&robot("r1")).unwrap().pose;
        assert!(there.distance(Pose::new(dx * 0.4, dy * 0.4, 0.0)).get() < 1e-12, "{there:?}");
        assert!((there.yaw - dy.atan2(dx)).abs() < 1e-12);
    }
}

#[test]
fn a_drive_does_not_exceed_the_speed_limit_of_its_goal() {
    for (limit, expected_s) in [(0.25, 20.0), (2.0, 10.0)] {
        let mut world = World::new(WorldSetup::new(two_places(5.0, 0.0), 1).robot(carrier("r1", "A"))).unwrap();
        let pose = world.map().place(&place("B")).unwrap().pose;
        let speed_max_mps = Some(MetresPerSecond::new(limit).unwrap());
        let goal = NavigateToPose { speed_max_mps, ..NavigateToPose::to(pose, Some(place("B"))) };
        world.start(&robot("r1"), GoalId(1), Goal::from(goal));
        assert_eq!(world.next_due(), Some(at(expected_s)), "{limit} m/s");
    }
}

#[test]
fn feedback_counts_down_and_the_end_is_reported_once() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Laboratory"))).unwrap();
    let goal = drive_goal(&world, "Laboratory Corridor");
    world.start(&robot("r1"), GoalId(1), goal);
    assert_eq!(world.advance(at(6.0)), []);
    let feedback = Feedback::remaining(Metres::new(1.0).unwrap(), Seconds::new(2.0).unwrap());
    assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::Executing(feedback)));
    assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place("Laboratory"));
    assert_eq!(world.advance(at(100.0)), [ended("r1", 1, GoalStatus::succeeded())]);
    assert_eq!(world.status(&robot("r1"), GoalId(1)), Some(GoalStatus::succeeded()));
    assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place("Laboratory Corridor"));
}

#[test]
fn a_goal_without_a_lane_is_rejected() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Laboratory"))).unwrap();
    let goal = drive_goal(&world, "Dock");
    let status = rejected_status(&mut world, "r1", 1, goal);
    assert_eq!(status, aborted(ErrorCode::NoRoute, "no lane from Laboratory to Dock"));
    let goal = Goal::from(NavigateToPose::to(Pose::default(), Some(place("Labratory"))));
    let status = rejected_status(&mut world, "r1", 2, goal);
    let message = "there is no place \"Labratory\" here; did you mean \"Laboratory\"?";
    assert_eq!(status, aborted(ErrorCode::Unknown, message));
    let goal = Goal::from(NavigateToPose::to(Pose::default(), Some(place("Laboratory Corridor"))));
    let status = rejected_status(&mut world, "r1", 3, goal);
    let message = "Laboratory Corridor is at (13.5, 7) on this map, not at (0, 0)";
    assert_eq!(status, aborted(ErrorCode::Unknown, message));
    let goal = Goal::from(NavigateToPose::to(Pose::new(f64::NAN, 0.0, 0.0), None));
    let status = rejected_status(&mut world, "r1", 4, goal);
    let message = "the parameters do not fit the action navigate_to_pose: invalid type: null, expected f64";
    assert_eq!(status, aborted(ErrorCode::Unknown, message));
}

#[test]
fn a_drive_canceled_on_a_lane_continues_to_either_end() {
    for (next, message) in [
        ("Laboratory", None),
        ("Laboratory Corridor", None),
        ("Crossing", Some("no lane to Crossing from between Laboratory and Laboratory Corridor")),
    ] {
        let mut world = World::new(hospital(1).robot(carrier("r1", "Laboratory"))).unwrap();
        let goal = drive_goal(&world, "Laboratory Corridor");
        world.start(&robot("r1"), GoalId(1), goal);
        world.advance(at(2.0));
        world.cancel(&robot("r1"), GoalId(1));
        assert_eq!(world.advance(at(50.0)), [ended("r1", 1, GoalStatus::Canceled)]);
        let pose = world.telemetry(&robot("r1")).unwrap().pose;
        assert_eq!((pose.x, pose.y), (13.5, 10.0), "1 m of 4 m down the lane");
        let goal = drive_goal(&world, next);
        match message {
            None => {
                run_to_success(&mut world, "r1", 2, goal);
                let left = if next == "Laboratory" { 2.0 } else { 6.0 };
                assert_eq!(world.now(), at(50.0 + left));
                assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place(next));
            }
            Some(message) => {
                assert_eq!(rejected_status(&mut world, "r1", 2, goal), aborted(ErrorCode::NoRoute, message));
            }
        }
    }
}

#[test]
fn a_one_way_lane_is_not_driven_back() {
    let text = "{name: ring, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 4, y_m: 0}, \
                {name: C, kind: other, x_m: 0, y_m: 3}], lanes: [{between: [A, B], one_way: true, length_m: 6}, \
                {between: [B, C], one_way: true}, {between: [C, A], one_way: true}]}";
    let mut world = World::new(WorldSetup::new(map::read(text, "ring").unwrap(), 1).robot(carrier("r1", "A"))).unwrap();
    let (b, a) = (drive_goal(&world, "B"), drive_goal(&world, "A"));
    world.start(&robot("r1"), GoalId(1), b.clone());
    world.advance(at(3.0));
    world.cancel(&robot("r1"), GoalId(1));
    world.advance(at(3.0));
    let status = rejected_status(&mut world, "r1", 2, a.clone());
    assert_eq!(status, aborted(ErrorCode::NoRoute, "the lane from A to B is one-way"));
    run_to_success(&mut world, "r1", 3, b);
    assert_eq!(world.now(), at(12.0), "6 m as the map says, not the 4 m of the straight line");
    let status = rejected_status(&mut world, "r1", 4, a);
    assert_eq!(status, aborted(ErrorCode::NoRoute, "no lane from B to A"));
}

#[test]
fn a_robot_off_the_lanes_returns_to_the_last_place() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(NavigateToPose::to(Pose::new(9.0, 6.5, 0.0), None)));
    assert_eq!(world.now(), at(10.0));
    let goal = drive_goal(&world, "Crossing");
    let message = "no lane to Crossing from off the lanes near Dock: the way back is to Dock";
    assert_eq!(rejected_status(&mut world, "r1", 2, goal), aborted(ErrorCode::NoRoute, message));
    let goal = drive_goal(&world, "Dock");
    run_to_success(&mut world, "r1", 3, goal);
    assert_eq!(world.now(), at(20.0));
}

#[test]
fn a_robot_that_stands_on_a_lane_again_drives_on_along_it() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    run_to_success(&mut world, "r1", 1, Goal::from(NavigateToPose::to(Pose::new(6.2, 4.5, 0.0), None)));
    let begun_s = world.now().as_secs();
    let goal = drive_goal(&world, "Crossing");
    run_to_success(&mut world, "r1", 2, goal);
    let took_s = world.now().as_secs() - begun_s;
    assert!((took_s - 5.0).abs() < 1e-9, "{took_s} s for the last 2.5 m of the lane");
    assert_eq!(world.telemetry(&robot("r1")).unwrap().place, place("Crossing"));
}

#[test]
fn a_robot_executes_a_single_goal_and_each_id_once() {
    let mut world = World::new(hospital(1).robot(carrier("r1", "Dock"))).unwrap();
    let goal = drive_goal(&world, "Crossing");
    world.start(&robot("r1"), GoalId(1), goal.clone());
    world.start(&robot("r1"), GoalId(1), goal.clone());
    world.start(&robot("r1"), GoalId(2), Goal::from(Wait { time: Seconds::new(1.0).unwrap() }));
    world.start(&robot("r2"), GoalId(1), goal.clone());
    assert_eq!(world.next_due(), Some(at(0.0)), "refusals are due at once");
    let busy = aborted(ErrorCode::Busy, "r1 is executing navigate_to_pose (goal 1)");
    let stranger = aborted(ErrorCode::Unknown, "there is no robot r2 here; did you mean \"r1\"?");
    assert_eq!(world.advance(at(0.0)), [ended("r1", 2, busy.clone()), ended("r2", 1, stranger)]);
    assert_eq!(world.advance(at(9.0)), [ended("r1", 1, GoalStatus::succeeded())]);
    world.start(&robot("r1"), GoalId(1), goal.clone());
    world.start(&robot("r1"), GoalId(2), goal);
    world.cancel(&robot("r1"), GoalId(1));
    assert_eq!(world.advance(at(99.0)), [], "ids that were seen before change nothing");
    assert_eq!(world.status(&robot("r1"), GoalId(2)), Some(busy));
    assert_eq!(world.status(&robot("r1"), GoalId(3)), None);
}

#[test]
fn ended_goals_are_dropped_and_not_started_again() {
    let mut setup = hospital(1).robot(carrier("r1", "Dock"));
    setup.limits.ended_goals_kept = 2;
    let mut world = World::new(setup).unwrap();
    let wait = Goal::from(Wait { time: Seconds::new(1.0).unwrap() });
    for id in 1..=3 {
        run_to_success(&mut world, "r1", id, wait.clone());
    }
    let known: Vec<bool> = (1..=3).map(|id| world.status(&robot("r1"), GoalId(id)).is_some()).collect();
    assert_eq!(known, [false, true, true]);
    world.start(&robot("r1"), GoalId(1), wait);
    assert_eq!(world.advance(at(99.0)), []);
}
