//! Requests to people that follow from a mission before it begins: its tasks of people, and the
//! questions in the trees of its robots.

use consort_protocol::ids::{RoleId, TaskId};
use consort_protocol::mission::{Mission, RoleKind, TaskSpec};
use consort_skills::library::SkillLibrary;
use serde::Serialize;
use std::fmt;

/// Request to people. A value that only a running tree determines is the key of its blackboard:
/// `{key}`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct ExpectedRequest {
    /// Role of the people.
    pub role: String,
    /// Task of the people; for a question, the task in which the robot asks.
    pub task: TaskId,
    /// Question of a robot; none for a task of people.
    pub question: Option<ExpectedQuestion>,
    /// Seconds after which it expires; none if it does not.
    pub patience_s: Option<StatedSeconds>,
    /// Role of the people that are asked, too, without an answer.
    pub escalate_to: Option<String>,
    /// Seconds after which they are asked.
    pub escalate_after_s: Option<StatedSeconds>,
}

/// Question of a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct ExpectedQuestion {
    /// Role of the robot.
    pub by: RoleId,
    /// The question.
    pub message: String,
}

/// Time in seconds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub(crate) enum StatedSeconds {
    /// The time.
    Known(u32),
    /// Key of the blackboard that contains the time.
    Key(String),
}

impl StatedSeconds {
    fn parse(text: String) -> StatedSeconds {
        text.parse::<u32>().map_or(StatedSeconds::Key(text), StatedSeconds::Known)
    }
}

impl fmt::Display for StatedSeconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StatedSeconds::Known(seconds) => write!(f, "{seconds} s"),
            StatedSeconds::Key(key) => write!(f, "{key} s"),
        }
    }
}

impl fmt::Display for ExpectedRequest {
    /// `visit of r1 asks nurse "may I enter?", waits 120 s, escalates to head after 60 s`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ExpectedRequest { role, task, .. } = self;
        match &self.question {
            None => write!(f, "{task} asks {role}")?,
            Some(ExpectedQuestion { by, message }) => write!(f, "{task} of {by} asks {role} {message:?}")?,
        }
        match &self.patience_s {
            None => f.write_str(", waits without limit")?,
            Some(patience) => write!(f, ", waits {patience}")?,
        }
        match self.escalate_to.as_ref().zip(self.escalate_after_s.as_ref()) {
            None => Ok(()),
            Some((to, after)) => write!(f, ", escalates to {to} after {after}"),
        }
    }
}

/// Returns the requests of a mission, in the order of its tasks. Those that state no time limit have `patience_s`.
pub(crate) fn expected_requests(
    mission: &Mission,
    library: &SkillLibrary,
    patience_s: Option<u32>,
) -> Vec<ExpectedRequest> {
    let requests = mission.elementary().into_iter().flat_map(|(task, spec)| requests_of(mission, library, task, spec));
    let with_limit = |request: ExpectedRequest| ExpectedRequest {
        patience_s: request.patience_s.or(patience_s.map(StatedSeconds::Known)),
        ..request
    };
    requests.map(with_limit).collect()
}

fn requests_of(mission: &Mission, library: &SkillLibrary, task: &TaskId, spec: &TaskSpec) -> Vec<ExpectedRequest> {
    let is_of_people =
        |role: &&RoleId| mission.roles.get(*role).is_some_and(|declared| declared.kind == RoleKind::Unmanaged);
    let (people, robots): (Vec<&RoleId>, Vec<&RoleId>) = spec.roles.iter().partition(is_of_people);
    let escalation = spec.escalation.as_deref();
    let of_people = people.into_iter().map(|role| ExpectedRequest {
        role: role.to_string(),
        task: task.clone(),
        question: None,
        patience_s: spec.patience_s.map(StatedSeconds::Known),
        escalate_to: escalation.map(|escalation| escalation.to.to_string()),
        escalate_after_s: escalation.map(|escalation| StatedSeconds::Known(escalation.after_s)),
    });
    let questions =
        robots.into_iter().flat_map(|by| library.questions(spec).into_iter().map(move |stated| (by, stated)));
    let of_robots = questions.map(|(by, stated)| ExpectedRequest {
        role: stated.role,
        task: task.clone(),
        question: Some(ExpectedQuestion { by: by.clone(), message: stated.message }),
        patience_s: stated.patience_s.map(StatedSeconds::parse),
        escalate_to: stated.escalate_to,
        escalate_after_s: stated.escalate_after_s.map(StatedSeconds::parse),
    });
    of_people.chain(of_robots).collect()
}

/// Returns the problems of escalations of questions that are certain before the mission begins.
/// Those of tasks of people are problems of the mission.
pub(crate) fn question_problems(mission: &Mission, library: &SkillLibrary) -> Vec<String> {
    let requests = expected_requests(mission, library, None);
    let problem = |request: &ExpectedRequest| {
        let question = request.question.as_ref()?;
        let to = RoleId::new(request.escalate_to.as_deref()?).ok()?;
        let asked: Vec<RoleId> = RoleId::new(request.role.as_str()).into_iter().collect();
        let problem = mission.escalation_problem(&asked, &to)?;
        Some(format!("{}: the question {:?} of {} {problem}", request.task, question.message, question.by))
    };
    requests.iter().filter_map(problem).collect()
}
