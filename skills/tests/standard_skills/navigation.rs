//! `navigation` and `wait`.

use super::*;

#[test]
fn a_drive_goes_leg_by_leg_along_the_shortest_route() {
    let mut body = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&task("navigation", &[("to", "C")])), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_robot_that_is_there_does_not_drive() {
    let mut body = ScriptedDriver::at("B");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    assert_eq!(skill.tick(&mut body), SkillStatus::Succeeded, "at the first tick");
    assert_eq!(body.sent(), Vec::<String>::new());
}

#[test]
fn the_next_leg_begins_in_the_tick_that_sees_the_end_of_the_one_before() {
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    body.end_goal();
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_halted_drive_cancels_its_leg_and_resumes_from_where_the_body_stopped() {
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    skill.tick(&mut body);
    body.end_goal();
    skill.tick(&mut body);
    skill.halt(&mut body);
    assert!(body.is_canceling());
    assert!(!skill.cancels_complete(&body));
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent().len(), 2, "nothing is sent to a body that has not stopped");
    body.set_position(14.0, place("B"));
    body.complete_cancel();
    assert!(skill.cancels_complete(&body));
    assert_eq!(run(&mut skill, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20", "drive C 20"]);
}

#[test]
fn a_leg_that_fails_ends_the_drive_with_the_bodys_own_words() {
    let mut body =
        ScriptedDriver::at("A").with_results([Ok(()), Err(error(ErrorCode::NoRoute, "a bed blocks the corridor"))]);
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    let ended = failed("NavigateToPose: no route: a bed blocks the corridor");
    assert_eq!(run(&mut skill, &mut body), ended);
    assert_eq!(skill.tick(&mut body), ended, "what has ended stays ended");
    assert_eq!(body.sent().len(), 2);
}

#[test]
fn no_way_is_a_failure_and_no_drive() {
    let mut body = ScriptedDriver::at("A");
    let ended = run(&mut skill(&task("navigation", &[("to", "D")])), &mut body);
    assert_eq!(ended, failed("PlanRoute: no route from A to D: the map has no way between them"));
    assert_eq!(body.sent(), Vec::<String>::new());
}

#[test]
fn a_body_that_lost_its_goal_fails_the_skill() {
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    body.forget_goals();
    assert_eq!(skill.tick(&mut body), failed("NavigateToPose: the body no longer knows of goal 0"));
}

#[test]
fn a_goal_canceled_by_somebody_else_fails_the_skill() {
    use consort_skills::actions::{GoalId, RobotActions};
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    body.cancel(GoalId(0));
    body.complete_cancel();
    assert_eq!(skill.tick(&mut body), failed("NavigateToPose: it was canceled from outside"));
}

#[test]
fn a_wait_takes_the_time_it_is_told() {
    let mut body = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(&task("wait", &[("seconds", "2.5")])), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["wait 2.50 s"]);
}

#[test]
fn a_resumed_drive_is_planned_from_where_the_body_came_to_a_stop() {
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    skill.halt(&mut body);
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    body.set_position(10.0, place("B"));
    body.complete_cancel();
    assert_eq!(skill.tick(&mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10"], "it rolled on to B while it stopped");
}

/// A – B – C, and a longer way from A over E to C.
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
fn a_drive_that_is_blocked_goes_another_way() {
    let mut body = ScriptedDriver::at("A").with_results([Ok(()), blocked()]);
    let mut skill = ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap();
    assert_eq!(run(&mut skill, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20", "drive A 0", "drive E 15", "drive C 20"]);
}

#[test]
fn what_is_known_to_be_closed_is_not_tried() {
    let mut body = ScriptedDriver::at("A").with_results([blocked()]);
    let ring = ring();
    let mut first = ring.load(&task("navigation", &[("to", "B")]), &context()).unwrap();
    assert_eq!(run(&mut first, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive E 15", "drive C 20", "drive B 10"]);
    let mut back = ring.load(&task("navigation", &[("to", "A")]), &context()).unwrap();
    assert_eq!(run(&mut back, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent()[4..], ["drive C 20", "drive E 15", "drive A 0"]);
}

#[test]
fn a_drive_without_another_way_fails_with_the_bodys_own_words() {
    let mut body = ScriptedDriver::at("A").with_results([Ok(()), blocked()]);
    let ended = run(&mut skill(&task("navigation", &[("to", "C")])), &mut body);
    assert_eq!(ended, failed("NavigateToPose: blocked: a bed stands in it"));
    assert_eq!(body.sent().len(), 2);
}

#[test]
fn a_drive_that_is_blocked_on_every_way_fails() {
    let mut body = ScriptedDriver::at("A").with_results([blocked(), blocked()]);
    let ended = run(&mut ring().load(&task("navigation", &[("to", "C")]), &context()).unwrap(), &mut body);
    assert_eq!(ended, failed("NavigateToPose: blocked: a bed stands in it"));
    assert_eq!(body.sent(), ["drive B 10", "drive E 15"]);
}
