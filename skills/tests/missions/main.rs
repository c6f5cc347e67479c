//! Local plans of the shipped missions and of published missions.

mod division_check;
mod local_plans;
mod published;
#[path = "../../../tests/support/skip.rs"]
mod skip;
#[path = "../../../protocol/tests/division/team.rs"]
mod team;

use consort_protocol::ids::RoleId;
use consort_protocol::mission::Mission;
use consort_protocol::plan::{LocalPlan, Step, StepAction};
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;

fn instance(name: &str, given: &[(&str, &str)]) -> Mission {
    let given = given.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    shipped()[name].instantiate(&given, &hospital()).unwrap()
}

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

/// Formats the steps: `open_drawer`, `!done:…` for a send, `?done:…` for a wait, each with its
/// predecessors.
fn steps_text(plan: &LocalPlan) -> Vec<String> {
    let line = |step: &Step| match &step.action {
        StepAction::Task { id, .. } => format!("{id} {:?}", step.after),
        StepAction::Send(signal) => format!("!{signal} {:?}", step.after),
        StepAction::Wait(signal) => format!("?{signal} {:?}", step.after),
    };
    plan.steps.iter().map(line).collect()
}
