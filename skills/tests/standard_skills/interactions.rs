//! Skills for people, other robots and drawers.

use super::*;

/// Returns the goals of a task that succeeds.
fn sent(task: &TaskSpec) -> Vec<String> {
    let mut driver = ScriptedDriver::at("A");
    assert_eq!(run(&mut skill(task), &mut driver), succeeded());
    driver.sent()
}

#[test]
fn each_skill_sends_the_goal_of_its_task() {
    for (task, expected) in [
        (task("approach_person", &[("person_role", "nurse")]), "approach person nurse"),
        (task("authenticate_person", &[("person_role", "nurse")]), "authenticate nurse"),
        (task("operate_drawer", &[("action", "open")]), "drawer open"),
        (task("operate_drawer", &[("action", "close")]), "drawer close"),
        (task("approach_robot", &[("robot_role", "lab_arm")]), "approach robot arm"),
        (task("pick_up", &[("from_role", "r1"), ("item", "sample")]), "pick up from ada"),
        (task("deposit", &[("into_role", "lab_arm")]), "deposit into arm"),
        (task("deposit", &[]), "deposit"),
    ] {
        assert_eq!(sent(&task), [expected]);
    }
}

#[test]
fn a_joint_task_identifies_its_person() {
    let joint = TaskSpec { roles: vec![role("r1"), role("nurse")], ..task("approach_person", &[]) };
    assert_eq!(sent(&joint), ["approach person nurse"]);
}

#[test]
fn an_unnamed_person_is_an_error() {
    let ended = run(&mut skill(&task("approach_person", &[])), &mut ScriptedDriver::at("A"));
    let cause = "FindPerson: the task names no person: set `person_role`, or do the task jointly with a single person";
    assert_eq!(ended, failed(cause));
}

#[test]
fn an_approach_is_tried_again_after_a_pause() {
    let mut driver = ScriptedDriver::at("A").with_results([away("nurse is not at A"), Ok(()), Ok(())]);
    let task = task("approach_person", &[("person_role", "nurse")]);
    assert_eq!(run(&mut skill(&task), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["approach person nurse", "wait 1.00 s", "approach person nurse"]);
}

fn away(message: &str) -> Result<(), ActionError> {
    Err(error(ErrorCode::OutOfReach, message))
}

#[test]
fn an_approach_to_a_robot_fails_after_three_tries_with_the_last_reason() {
    let script = [away("not here"), Ok(()), away("not here"), Ok(()), away("gone home"), Ok(())];
    let mut driver = ScriptedDriver::at("A").with_results(script);
    let ended = run(&mut skill(&task("approach_robot", &[("robot_role", "lab_arm")])), &mut driver);
    assert_eq!(ended, failed("approach_robot: out of reach: gone home"));
    assert_eq!(driver.sent().iter().filter(|goal| goal.starts_with("approach")).count(), 3);
}

/// Returns the result and the goals of a task about a person absent for a number of attempts.
fn waited(task: &TaskSpec, tries: usize) -> (SkillStatus, Vec<String>) {
    let script = (0..tries).flat_map(|_| [away("not here"), Ok(())]);
    let (mut driver, mut skill) = (ScriptedDriver::at("A").with_results(script), skill(task));
    for _ in 0..1000 {
        match skill.tick(&mut driver) {
            SkillStatus::Running => driver.end_goal(),
            ended => return (ended, driver.sent()),
        }
    }
    panic!("it still runs: {:?}", driver.sent());
}

#[test]
fn an_absent_person_is_awaited_until_the_timeout() {
    for (task_type, leaf, goal) in [
        ("approach_person", "approach_person", "approach person nurse"),
        ("authenticate_person", "authenticate_person", "authenticate nurse"),
    ] {
        let nurse = ("person_role", "nurse");
        let usual = task(task_type, &[nurse]);
        let (ended, sent) = waited(&usual, 120);
        assert_eq!(ended, succeeded(), "she is back after two minutes");
        assert_eq!(sent.iter().filter(|sent| *sent == "wait 1.00 s").count(), 120);
        assert_eq!(sent.iter().filter(|sent| *sent == goal).count(), 121);
        let (ended, sent) = waited(&usual, 121);
        assert_eq!(ended, failed_as(CauseClass::Task, &format!("{leaf}: out of reach: not here; waited for 120 s")));
        assert_eq!(sent.len(), 241);
        let hurried = task(task_type, &[nurse, ("timeout_s", "2.5")]);
        assert_eq!(waited(&hurried, 2).0, succeeded());
        assert_eq!(
            waited(&hurried, 3).0,
            failed_as(CauseClass::Task, &format!("{leaf}: out of reach: not here; waited for 2 s"))
        );
        let busy = task(task_type, &[nurse, ("timeout_s", "0")]);
        assert_eq!(
            waited(&busy, 1),
            (failed_as(CauseClass::Task, &format!("{leaf}: out of reach: not here")), vec![goal.to_owned()])
        );
    }
}

#[test]
fn a_wait_for_a_person_can_be_halted() {
    let mut driver = ScriptedDriver::at("A").with_results([away("not here")]);
    let mut skill = skill(&task("approach_person", &[("person_role", "nurse")]));
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    driver.end_goal();
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent(), ["approach person nurse", "wait 1.00 s"]);
    skill.halt(&mut driver);
    driver.complete_cancel();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["approach person nurse", "wait 1.00 s", "approach person nurse"]);
}

#[test]
fn a_rejected_authentication_is_not_repeated() {
    let no = Err(error(ErrorCode::NotAuthenticated, "nurse declined"));
    let mut driver = ScriptedDriver::at("A").with_results([no]);
    let ended = run(&mut skill(&task("authenticate_person", &[("person_role", "nurse")])), &mut driver);
    assert_eq!(ended, failed_as(CauseClass::Task, "authenticate_person: not authenticated: nurse declined"));
    assert_eq!(driver.sent().len(), 1);
}

#[test]
fn an_unheld_role_is_reported_with_the_held_roles() {
    for (task, leaf) in [
        (task("approach_robot", &[("robot_role", "r9")]), "FindRoleHolder"),
        (task("pick_up", &[("from_role", "r9")]), "FindRoleHolder"),
        (task("deposit", &[("into_role", "r9")]), "FindRoleHolderIfAny"),
    ] {
        let mut driver = ScriptedDriver::at("A");
        let cause = format!("{leaf}: no robot holds role r9; held are lab_arm by arm, r1 by ada");
        assert_eq!(run(&mut skill(&task), &mut driver), failed(&cause));
        assert_eq!(driver.sent(), Vec::<String>::new());
    }
}

#[test]
fn a_halted_skill_sends_again_after_the_cancel_completes() {
    let mut driver = ScriptedDriver::at("A");
    let mut skill = skill(&task("operate_drawer", &[("action", "open")]));
    skill.tick(&mut driver);
    skill.halt(&mut driver);
    assert_eq!(skill.tick(&mut driver), SkillStatus::Running);
    assert_eq!(driver.sent(), ["drawer open"]);
    driver.complete_cancel();
    assert_eq!(run(&mut skill, &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drawer open", "drawer open"]);
}

#[test]
fn a_completed_goal_is_not_repeated() {
    let pick_up = task("pick_up", &[("from_role", "r1")]);
    let from = |robot: &str| goal("pick_up", json!({ "from": robot }), false);
    let mut driver = ScriptedDriver::at("A").with_completed(from("ada"));
    assert_eq!(run(&mut skill(&pick_up), &mut driver), succeeded());
    assert_eq!(driver.sent(), [""; 0]);
    // Once for each completion.
    assert_eq!(run(&mut skill(&pick_up), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["pick up from ada"]);
    let mut driver = ScriptedDriver::at("A").with_completed(from("arm"));
    assert_eq!(run(&mut skill(&pick_up), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["pick up from ada"], "from somebody else");
    // A repeatable goal is sent again.
    let mut driver = ScriptedDriver::at("A").with_completed(goal("operate_drawer", json!({ "action": "open" }), true));
    assert_eq!(run(&mut skill(&task("operate_drawer", &[("action", "open")])), &mut driver), succeeded());
    assert_eq!(driver.sent(), ["drawer open"]);
}
