//! `navigation` and `wait`.

use super::*;

#[test]
fn a_drive_goes_leg_by_leg_along_the_shortest_route() {
    let mut body = ScriptedBody::at("A");
    assert_eq!(run(&mut skill(&task("navigation", &[("to", "C")])), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_robot_that_is_there_does_not_drive() {
    let mut body = ScriptedBody::at("B");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    assert_eq!(skill.tick(&mut body), SkillStatus::Succeeded, "at the first tick");
    assert_eq!(body.sent(), Vec::<String>::new());
}

#[test]
fn the_next_leg_begins_in_the_tick_that_sees_the_end_of_the_one_before() {
    let mut body = ScriptedBody::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    body.end_goal();
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20"]);
}

#[test]
fn a_halted_drive_cancels_its_leg_and_resumes_from_where_the_body_stopped() {
    let mut body = ScriptedBody::at("A");
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    skill.tick(&mut body);
    body.end_goal();
    skill.tick(&mut body);
    skill.halt(&mut body);
    assert!(body.is_canceling());
    assert!(!skill.is_settled(&body));
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent().len(), 2, "nothing is sent to a body that has not stopped");
    body.put(14.0, place("B"));
    body.stand_still();
    assert!(skill.is_settled(&body));
    assert_eq!(run(&mut skill, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10", "drive C 20", "drive C 20"]);
}

#[test]
fn a_leg_that_fails_ends_the_drive_with_the_bodys_own_words() {
    let mut body = ScriptedBody::at("A").playing([Ok(()), Err(error(ErrorCode::NoRoute, "a bed blocks the corridor"))]);
    let mut skill = skill(&task("navigation", &[("to", "C")]));
    let ended = failed("NavigateToPose: no route: a bed blocks the corridor");
    assert_eq!(run(&mut skill, &mut body), ended);
    assert_eq!(skill.tick(&mut body), ended, "what has ended stays ended");
    assert_eq!(body.sent().len(), 2);
}

#[test]
fn no_way_is_a_failure_and_no_drive() {
    let mut body = ScriptedBody::at("A");
    let ended = run(&mut skill(&task("navigation", &[("to", "D")])), &mut body);
    assert_eq!(ended, failed("PlanRoute: no route from A to D: the map has no way between them"));
    assert_eq!(body.sent(), Vec::<String>::new());
}

#[test]
fn a_body_that_lost_its_goal_fails_the_skill() {
    let mut body = ScriptedBody::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    body.forget();
    assert_eq!(skill.tick(&mut body), failed("NavigateToPose: the body no longer knows of goal 0"));
}

#[test]
fn a_goal_canceled_by_somebody_else_fails_the_skill() {
    use consort_skills::actions::{GoalId, RobotActions};
    let mut body = ScriptedBody::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    body.cancel(GoalId(0));
    body.stand_still();
    assert_eq!(skill.tick(&mut body), failed("NavigateToPose: it was canceled from outside"));
}

#[test]
fn a_wait_takes_the_time_it_is_told() {
    let mut body = ScriptedBody::at("A");
    assert_eq!(run(&mut skill(&task("wait", &[("seconds", "2.5")])), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["wait 2.50 s"]);
}

#[test]
fn a_resumed_drive_is_planned_from_where_the_body_came_to_a_stop() {
    let mut body = ScriptedBody::at("A");
    let mut skill = skill(&task("navigation", &[("to", "B")]));
    skill.tick(&mut body);
    skill.halt(&mut body);
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    body.put(10.0, place("B"));
    body.stand_still();
    assert_eq!(skill.tick(&mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drive B 10"], "it rolled on to B while it stopped");
}
