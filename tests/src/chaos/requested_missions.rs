//! Mission files that a run requests besides the shipped ones.

use super::control_flow::{CONTROL_FLOW_FILES, CONTROL_FLOW_MISSIONS};
use super::poison::{WAITING_FILES, WAITING_MISSIONS, failing_file};
use super::schedule::{ChaosAction, Schedule};
use crate::{FAILING_TASKS, failing_domain};
use consort_protocol::api::SubmitRequest;
use consort_protocol::mission::{Format, IhtnFields, MissionDocument};
use consort_skills::workload::{UserMission, Workload};

/// Returns the workload with those of the missions of chaos that the schedule requests, and with the domain that they
/// need.
pub(super) fn workload_with(workload: &Workload, schedule: &Schedule) -> Workload {
    let is_requested = |name: &str| {
        let mut actions = schedule.steps.iter().map(|step| &step.action);
        actions.any(|action| matches!(action, ChaosAction::Submit { mission, .. } if mission == name))
    };
    let files = CONTROL_FLOW_MISSIONS.into_iter().zip(CONTROL_FLOW_FILES);
    let files = files.chain(WAITING_MISSIONS.into_iter().zip(WAITING_FILES));
    let requested = files.filter(|(name, _)| is_requested(name)).map(|(_, text)| read(text));
    let failing: Vec<&str> = FAILING_TASKS.into_iter().filter(|task| is_requested(task)).collect();
    let mut workload = workload.clone();
    if !failing.is_empty() {
        workload.extensions = workload.extensions.with_domain("failing.yaml", failing_domain());
    }
    workload.with(requested.chain(failing.into_iter().map(|task| read(&failing_file(task)))))
}

fn read(text: &str) -> UserMission {
    let request = MissionDocument::request(text, Format::Yaml, IhtnFields::default());
    let source = request.map(|file| serde_json::from_value(file).expect("a mission file is an object"));
    let document = MissionDocument::parse(text, Format::Yaml, IhtnFields::default());
    let valid = "the missions of chaos are tested";
    UserMission { document: document.expect(valid), request: SubmitRequest::of(source.expect(valid)) }
}
