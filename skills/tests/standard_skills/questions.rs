//! Questions of a skill to people.

use super::*;
use consort_protocol::ledger::PersonQuestion;
use consort_protocol::mission::{Escalation, ResultReference};
use consort_skills::actions::{GoalId, GoalStatus, RobotActions, Telemetry};
use consort_skills::bt::TreeError;

/// A robot that records its questions and gets no answer.
#[derive(Default)]
struct AskingRobot(Vec<PersonQuestion>);

impl RobotActions for AskingRobot {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        panic!("a goal was sent: {goal:?}")
    }
    fn status(&self, _: GoalId) -> Option<GoalStatus> {
        None
    }
    fn cancel(&mut self, goal: GoalId) {
        panic!("a goal was canceled: {goal:?}")
    }
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }
    fn ask_person(&mut self, question: &PersonQuestion) -> Option<Result<String, String>> {
        self.0.push(question.clone());
        None
    }
}

/// Returns the skills with a task `enter` that asks a nurse, with further ports.
fn asking(ports: &str) -> Result<SkillLibrary, TreeError> {
    let mut library = SkillLibrary::standard(environment());
    let node = format!(r#"<AskPerson role="nurse" message="may I enter?" {ports}/>"#);
    let xml = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"enter\">{node}</BehaviorTree></root>");
    library.register_xml(TaskType::new("enter").unwrap(), "enter.xml", &xml)?;
    Ok(library)
}

/// Ticks the task once. Returns its status and the question.
fn ask(ports: &str, parameters: &[(&str, &str)]) -> (SkillStatus, Option<PersonQuestion>) {
    let library = asking(ports).unwrap_or_else(|error| panic!("{error}"));
    let skill = library.load(&task("enter", parameters), &context());
    let mut robot = AskingRobot::default();
    let status = skill.unwrap_or_else(|error| panic!("{error}")).tick(&mut robot);
    (status, robot.0.pop())
}

#[test]
fn a_question_states_its_escalation() {
    let question = |escalation| {
        let (to, message) = (role("nurse"), "may I enter?".to_owned());
        Some(PersonQuestion { to, message, at: None, patience_s: Some(60), escalation })
    };
    let to_head = || question(Some(Box::new(Escalation { to: role("head"), after_s: 30 })));
    let fixed = r#"patience_s="60" escalate_to="head" escalate_after_s="30""#;
    let keys = r#"patience_s="60" escalate_to="{other}" escalate_after_s="{after_s}""#;
    for (ports, parameters, expected) in [
        (r#"patience_s="60""#, &[][..], question(None)),
        (fixed, &[][..], to_head()),
        (keys, &[("other", "head"), ("after_s", "30")][..], to_head()),
        (keys, &[][..], question(None)),
    ] {
        assert_eq!(ask(ports, parameters), (SkillStatus::Running, expected), "{ports}");
    }
}

#[test]
fn a_wrong_escalation_is_rejected_where_it_is_known() {
    for (ports, expected) in [
        (r#"escalate_to="head""#, "port `escalate_to` needs port `escalate_after_s`, which is missing"),
        (r#"escalate_after_s="9""#, "port `escalate_after_s` needs port `escalate_to`, which is missing"),
        (
            r#"escalate_to="head" escalate_after_s="0""#,
            "port `escalate_after_s`: \"0\" is rejected: allowed is 1 to 604800",
        ),
        (r#"patience_s="604801""#, "port `patience_s`: \"604801\" is rejected: allowed is 1 to 604800"),
    ] {
        let error = asking(ports).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(error.contains(expected), "{ports}: {error}");
    }
    let keys = r#"escalate_to="{other}" escalate_after_s="{after_s}""#;
    for (parameters, expected) in [
        (&[("other", "nurse"), ("after_s", "30")][..], "escalate_to is nurse, which is asked already"),
        (&[("other", "head")][..], "escalate_to and escalate_after_s need values, both or neither"),
    ] {
        assert_eq!(ask(keys, parameters), (failed(&format!("AskPerson: {expected}")), None));
    }
}

#[test]
fn the_questions_of_a_task_are_known_before_it_runs() {
    let ports = r#"patience_s="{patience_s}" escalate_to="{other}" escalate_after_s="30""#;
    let library = asking(ports).unwrap_or_else(|error| panic!("{error}"));
    let stated = |task: &TaskSpec| {
        let question = library.questions(task).pop().expect("the tree asks");
        assert_eq!((question.role.as_str(), question.message.as_str()), ("nurse", "may I enter?"));
        (question.patience_s, question.escalate_to, question.escalate_after_s)
    };
    let text = |text: &str| Some(text.to_owned());
    let task = task("enter", &[("patience_s", "60")]);
    assert_eq!(stated(&task), (text("60"), None, text("30")));
    let result = ResultReference { task: "look".parse().unwrap(), result: "who".to_owned() };
    let later = TaskSpec { inputs: [("other".to_owned(), result)].into(), ..task };
    assert_eq!(stated(&later), (text("60"), text("{other}"), text("30")));
}
