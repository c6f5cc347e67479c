//! Skills that deal with people, other robots and drawers.

use super::*;

/// What a task makes the body do when all goes well.
fn sent(task: &TaskSpec) -> Vec<String> {
    let mut body = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(task), &mut body), SkillStatus::Succeeded);
    body.sent()
}

#[test]
fn each_skill_asks_the_body_for_what_its_task_says() {
    for (task, expected) in [
        (task("approach_person", &[("person_role", "nurse")]), "approach person nurse"),
        (task("authenticate_person", &[("person_role", "nurse")]), "authenticate nurse"),
        (task("operate_drawer", &[("action", "open")]), "drawer true"),
        (task("operate_drawer", &[("action", "close")]), "drawer false"),
        (task("approach_robot", &[("robot_role", "lab_arm")]), "approach robot arm"),
        (task("pick_up", &[("from_role", "r1"), ("item", "sample")]), "pick up from ada"),
        (task("deposit", &[("into_role", "lab_arm")]), "deposit into arm"),
        (task("deposit", &[]), "deposit"),
    ] {
        assert_eq!(sent(&task), [expected]);
    }
}

#[test]
fn a_joint_task_says_by_itself_which_person_is_meant() {
    let joint = TaskSpec { roles: vec![role("r1"), role("nurse")], ..task("approach_person", &[]) };
    assert_eq!(sent(&joint), ["approach person nurse"]);
}

#[test]
fn a_person_who_is_not_named_is_asked_for() {
    let ended = run(&mut skill(&task("approach_person", &[])), &mut ScriptedDriver::at("A"));
    let cause =
        "FindPerson: the task does not say which person is meant: give `person_role`, or do it jointly with one person";
    assert_eq!(ended, failed(cause));
}

#[test]
fn an_approach_is_tried_again_after_a_pause() {
    let mut body = ScriptedDriver::at("A").with_results([away("nurse is not at A"), Ok(()), Ok(())]);
    let task = task("approach_person", &[("person_role", "nurse")]);
    assert_eq!(run(&mut skill(&task), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["approach person nurse", "wait 1.00 s", "approach person nurse"]);
}

fn away(message: &str) -> Result<(), ActionError> {
    Err(error(ErrorCode::OutOfReach, message))
}

#[test]
fn an_approach_to_a_robot_fails_after_three_tries_with_the_last_reason() {
    let script = [away("not here"), Ok(()), away("not here"), Ok(()), away("gone home"), Ok(())];
    let mut body = ScriptedDriver::at("A").with_results(script);
    let ended = run(&mut skill(&task("approach_robot", &[("robot_role", "lab_arm")])), &mut body);
    assert_eq!(ended, failed("ApproachRobot: out of reach: gone home"));
    assert_eq!(body.sent().iter().filter(|goal| goal.starts_with("approach")).count(), 3);
}

/// The goals of a task about a person who is away for so many tries, and how it ends.
fn waited(task: &TaskSpec, tries: usize) -> (SkillStatus, Vec<String>) {
    let script = (0..tries).flat_map(|_| [away("not here"), Ok(())]);
    let (mut body, mut skill) = (ScriptedDriver::at("A").with_results(script), skill(task));
    for _ in 0..1000 {
        match skill.tick(&mut body) {
            SkillStatus::Running => body.end_goal(),
            ended => return (ended, body.sent()),
        }
    }
    panic!("it still runs: {:?}", body.sent());
}

#[test]
fn a_person_who_is_away_is_waited_for_so_long_and_no_longer() {
    for (task_type, leaf, goal) in [
        ("approach_person", "ApproachPerson", "approach person nurse"),
        ("authenticate_person", "AuthenticatePerson", "authenticate nurse"),
    ] {
        let nurse = ("person_role", "nurse");
        let usual = task(task_type, &[nurse]);
        let (ended, sent) = waited(&usual, 120);
        assert_eq!(ended, SkillStatus::Succeeded, "she is back after two minutes");
        assert_eq!(sent.iter().filter(|sent| *sent == "wait 1.00 s").count(), 120);
        assert_eq!(sent.iter().filter(|sent| *sent == goal).count(), 121);
        let (ended, sent) = waited(&usual, 121);
        assert_eq!(ended, failed(&format!("{leaf}: out of reach: not here; waited for 120 s")));
        assert_eq!(sent.len(), 241);
        let hurried = task(task_type, &[nurse, ("patience", "2.5")]);
        assert_eq!(waited(&hurried, 2).0, SkillStatus::Succeeded);
        assert_eq!(waited(&hurried, 3).0, failed(&format!("{leaf}: out of reach: not here; waited for 2 s")));
        let busy = task(task_type, &[nurse, ("patience", "0")]);
        assert_eq!(waited(&busy, 1), (failed(&format!("{leaf}: out of reach: not here")), vec![goal.to_owned()]));
    }
}

#[test]
fn whoever_waits_for_a_person_can_be_halted() {
    let mut body = ScriptedDriver::at("A").with_results([away("not here")]);
    let mut skill = skill(&task("approach_person", &[("person_role", "nurse")]));
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    body.end_goal();
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent(), ["approach person nurse", "wait 1.00 s"]);
    skill.halt(&mut body);
    body.complete_cancel();
    assert_eq!(run(&mut skill, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["approach person nurse", "wait 1.00 s", "approach person nurse"]);
}

#[test]
fn a_person_who_is_somebody_else_is_not_asked_twice() {
    let no = Err(error(ErrorCode::NotAuthenticated, "nurse declined"));
    let mut body = ScriptedDriver::at("A").with_results([no]);
    let ended = run(&mut skill(&task("authenticate_person", &[("person_role", "nurse")])), &mut body);
    assert_eq!(ended, failed("AuthenticatePerson: not authenticated: nurse declined"));
    assert_eq!(body.sent().len(), 1);
}

#[test]
fn a_role_that_no_robot_holds_is_named_with_those_that_are_held() {
    for (task, leaf) in [
        (task("approach_robot", &[("robot_role", "r9")]), "FindHolder"),
        (task("pick_up", &[("from_role", "r9")]), "FindHolder"),
        (task("deposit", &[("into_role", "r9")]), "Deposit"),
    ] {
        let mut body = ScriptedDriver::at("A");
        let cause = format!("{leaf}: no robot holds role r9; held are lab_arm by arm, r1 by ada");
        assert_eq!(run(&mut skill(&task), &mut body), failed(&cause));
        assert_eq!(body.sent(), Vec::<String>::new());
    }
}

#[test]
fn a_halted_skill_sends_again_only_when_the_body_has_let_go() {
    let mut body = ScriptedDriver::at("A");
    let mut skill = skill(&task("operate_drawer", &[("action", "open")]));
    skill.tick(&mut body);
    skill.halt(&mut body);
    assert_eq!(skill.tick(&mut body), SkillStatus::Running);
    assert_eq!(body.sent(), ["drawer true"]);
    body.complete_cancel();
    assert_eq!(run(&mut skill, &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drawer true", "drawer true"]);
}

#[test]
fn what_an_earlier_attempt_has_done_is_not_done_twice() {
    let pick_up = task("pick_up", &[("from_role", "r1")]);
    let from = |robot: &str| Goal::PickUp { from: RobotId::new(robot).unwrap() };
    let mut body = ScriptedDriver::at("A").with_completed(from("ada"));
    assert_eq!(run(&mut skill(&pick_up), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), [""; 0]);
    // Once for each time that it was done.
    assert_eq!(run(&mut skill(&pick_up), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["pick up from ada"]);
    let mut body = ScriptedDriver::at("A").with_completed(from("arm"));
    assert_eq!(run(&mut skill(&pick_up), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["pick up from ada"], "from somebody else");
    // What may be done again is.
    let mut body = ScriptedDriver::at("A").with_completed(Goal::OperateDrawer { open: true });
    assert_eq!(run(&mut skill(&task("operate_drawer", &[("action", "open")])), &mut body), SkillStatus::Succeeded);
    assert_eq!(body.sent(), ["drawer true"]);
}
