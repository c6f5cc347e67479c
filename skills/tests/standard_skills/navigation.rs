//! `navigation` and `wait`.

use super::*;

#[test]
fn a_drive_goes_leg_by_leg_along_the_shortest_route() {
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&task("navigation", &[("to", "C")])), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_robot_at_the_destination_does_not_drive() {
    let mut driver = ScriptedDriver::at("B");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    assert_eq!(skill.tick(&mut driver), succeeded(), "at the first tick");
    assert_eq!(driver.sent(), Vec::<String>::new());
}

#[test]
fn the_next_leg_starts_in_the_tick_that_ends_the_previous_leg() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.end_goal();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_halted_drive_cancels_its_leg_and_resumes_where_it_stopped() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    skill.tick(&mut driver);
    driver.end_goal();
    skill.tick(&mut driver);
    skill.halt(&mut driver);
    assert!(driver.is_canceling());
    assert!(!skill.cancels_complete(&driver));
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent().len(), 2, "nothing is sent to a body that has not stopped");
    driver.set_position(14.0, place("B"));
    driver.complete_cancel();
    assert!(skill.cancels_complete(&driver));
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20", "drive C 20"]);
}

#[test]
fn a_failed_leg_ends_the_drive_with_the_goal_error() {
    let mut driver =
        ScriptedDriver::at("A").with_results([Ok(()), Err(error(ErrorCode::NoRoute, "a bed blocks the corridor"))]);
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    let ended = failed("NavigateToPose: no route: a bed blocks the corridor");
    assert_eq!(run(&mut skill, &mut driver), ended);
    assert_eq!(skill.tick(&mut driver), ended, "what has ended stays ended");
    assert_eq!(driver.sent().len(), 2);
}

#[test]
fn a_missing_route_fails_without_a_drive() {
    let mut driver = ScriptedDriver::at("A");
    let ended = run(&mut skill(&task("navigation", &[("to", "D")])), &mut driver);
    assert_eq!(ended, failed("PlanRoute: no route from A to D: the map has no way between them"));
    assert_eq!(driver.sent(), Vec::<String>::new());
}

#[test]
fn a_lost_goal_fails_the_skill() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut driver);
    driver.forget_goals();
    assert_eq!(skill.tick(&mut driver), failed("NavigateToPose: the robot no longer reports goal 0"));
}

#[test]
fn a_goal_canceled_from_outside_fails_the_skill() {
    use consort_skills::actions::{GoalId, RobotActions};
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut driver);
    driver.cancel(GoalId(0));
    driver.complete_cancel();
    assert_eq!(skill.tick(&mut driver), failed("NavigateToPose: it was canceled from outside"));
}

#[test]
fn a_wait_takes_the_requested_time() {
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&task("wait", &[("seconds", "2.5")])), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["wait 2.50 s"]);
}

#[test]
fn a_resumed_drive_is_planned_from_the_stopping_point() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut driver);
    skill.halt(&mut driver);
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.set_position(10.0, place("B"));
    driver.complete_cancel();
    assert_eq!(skill.tick(&mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10"], "it rolled on to B while it stopped");
}

/// A – B – C, and a longer route from A via E to C.
fn ring() -> SkillLibrary {
    let names = [("A", 0.0), ("B", 10.0), ("C", 20.0), ("E", 15.0)];
    let edge = |(a, b, length_m)| Edge { a: place(a), b: place(b), length_m, one_way: false };
    let map = TopologicalMap {
        places: names.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
        edges: [("A", "B", 10.0), ("B", "C", 10.0), ("A", "E", 30.0), ("E", "C", 30.0)].map(edge).into(),
    };
    SkillLibrary::standard(Environment::new().with(Routes::new(&map).unwrap()))
}

fn blocked() -> Result<(), ActionError> {
    Err(error(ErrorCode::Blocked, "a bed stands in it"))
}

#[test]
fn a_blocked_drive_takes_another_route() {
    let mut driver = ScriptedDriver::at("A").with_results([Ok(()), blocked()]);
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20", "drive A 0", "drive E 15", "drive C 20"]);
}

#[test]
fn known_closed_lanes_are_avoided() {
    let mut driver = ScriptedDriver::at("A").with_results([blocked()]);
    let ring = ring();
    let mut first = ring.load(&task("navigation", &[("to", "B")]), &context()).unwrap();
    assert_eq!(run(&mut first, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive E 15", "drive C 20", "drive B 10"]);
    let mut back = ring.load(&task("navigation", &[("to", "A")]), &context()).unwrap();
    assert_eq!(run(&mut back, &mut driver), succeeded());
    assert_eq!(driver.sent()[4..], ["drive C 20", "drive E 15", "drive A 0"]);
}

#[test]
fn a_blocked_drive_without_another_route_fails_with_the_goal_error() {
    let mut driver = ScriptedDriver::at("A").with_results([Ok(()), blocked()]);
    let ended = run(&mut skill(&task("navigation", &[("to", "C")])), &mut driver);
    assert_eq!(ended, failed("NavigateToPose: blocked: a bed stands in it"));
    assert_eq!(driver.sent().len(), 2);
}

#[test]
fn a_drive_that_is_blocked_on_every_route_fails() {
    let mut driver = ScriptedDriver::at("A").with_results([blocked(), blocked()]);
    let ended = run(&mut ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap(), &mut driver);
    assert_eq!(ended, failed("NavigateToPose: blocked: a bed stands in it"));
    assert_eq!(driver.sent(), ["drive B 10", "drive E 15"]);
}

#[test]
fn a_drive_whose_leg_people_close_stops_and_takes_another_route() {
    for (a, b) in [("B", "B"), ("B", "A")] {
        let mut driver = ScriptedDriver::at("A");
        let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
        assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
        driver.close(a, b);
        assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
        assert!(driver.is_canceling(), "{a} – {b}");
        assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
        assert_eq!(driver.sent(), ["drive B 10"], "{a} – {b}: it has not stopped yet");
        driver.complete_cancel();
        assert_eq!(run(&mut skill, &mut driver), succeeded());
        assert_eq!(driver.sent(), ["drive B 10", "drive E 15", "drive C 20"], "{a} – {b}");
    }
}

#[test]
fn a_drive_avoids_a_later_leg_that_people_close_on_its_way() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.close("B", "C");
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert!(!driver.is_canceling(), "its leg is open");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive A 0", "drive E 15", "drive C 20"]);
}

#[test]
fn a_drive_waits_while_people_have_closed_every_route() {
    let mut driver = ScriptedDriver::at("A");
    driver.close("C", "C");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    for _ in 0..5 {
        assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    }
    assert_eq!(driver.sent(), Vec::<String>::new());
    driver.open_all();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent(), ["drive B 10"]);
    driver.close("B", "C");
    driver.end_goal();
    for _ in 0..5 {
        assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    }
    assert_eq!(driver.sent(), ["drive B 10"]);
    driver.open_all();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_drive_waits_for_a_device_or_takes_another_route() {
    let at_device = || {
        let mut driver = ScriptedDriver::at("A");
        driver.guard("B", "C");
        let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
        skill.tick(&mut driver);
        driver.end_goal();
        for _ in 0..5 {
            assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
        }
        assert_eq!(driver.sent(), ["drive B 10"], "it has not confirmed");
        (driver, skill)
    };
    let (mut driver, mut skill) = at_device();
    driver.admit();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20"]);
    let (mut driver, mut skill) = at_device();
    driver.close("B", "C");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive A 0", "drive E 15", "drive C 20"]);
}

#[test]
fn a_request_contains_the_rest_of_the_route() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    driver.guard("B", "C");
    skill.tick(&mut driver);
    assert_eq!(driver.requested(), ["A B C"]);
    driver.end_goal();
    skill.tick(&mut driver);
    driver.close("B", "C");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.requested(), ["A B C", "B C", "B A E C", "A E C", "E C"], "the detour, too");
}

#[test]
fn a_robot_leaves_a_closed_place() {
    let mut driver = ScriptedDriver::at("B");
    driver.close("B", "B");
    assert_eq!(run(&mut skill(&task("navigation", &[("to", "C")])), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive C 20"]);
}

#[test]
fn a_leg_is_driven_at_the_speed_limit_of_people() {
    let mut driver = ScriptedDriver::at("A");
    driver.limit("C", "B", 0.3);
    assert_eq!(run(&mut skill(&task("navigation", &[("to", "C")])), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive C 20 at 0.3 m/s"]);
}

#[test]
fn a_drive_takes_a_faster_route_around_a_slow_lane() {
    let mut driver = ScriptedDriver::at("A");
    driver.limit("B", "C", 0.1);
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive E 15", "drive C 20"], "60 s at 1 m/s, not 110 s");
}

#[test]
fn a_drive_avoids_a_later_leg_on_which_people_limit_the_speed_on_its_way() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.limit("B", "C", 0.1);
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert!(!driver.is_canceling(), "its leg is not limited");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    let way = ["drive B 10", "drive A 0", "drive E 15", "drive C 20"];
    assert_eq!(driver.sent(), way, "70 s at 1 m/s, not 100 s");
}

#[test]
fn a_drive_under_way_is_slowed_when_people_lower_the_speed_limit_of_its_leg() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.limit("A", "B", 0.5);
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert!(driver.is_canceling());
    driver.complete_cancel();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent(), ["drive B 10", "drive B 10 at 0.5 m/s"]);
    driver.limit("A", "B", 0.8);
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert!(!driver.is_canceling(), "the leg is driven slower than allowed");
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drive B 10", "drive B 10 at 0.5 m/s", "drive C 20"]);
}
