//! Mission files that a run requests besides the shipped ones.

use super::control_flow::{CONTROL_FLOW_FILES, CONTROL_FLOW_MISSIONS};
use super::poison::{POISON_FILES, POISON_MISSIONS};
use super::schedule::{ChaosAction, Schedule};
use consort_protocol::api::SubmitRequest;
use consort_protocol::mission::{Format, IhtnFields, MissionDocument};
use consort_skills::workload::{UserMission, Workload};

/// Returns the workload with those of the missions of chaos that the schedule requests.
pub(super) fn workload_with(workload: &Workload, schedule: &Schedule) -> Workload {
    let is_requested = |name: &str| {
        let mut actions = schedule.steps.iter().map(|step| &step.action);
        actions.any(|action| matches!(action, ChaosAction::Submit { mission, .. } if mission == name))
    };
    let files = CONTROL_FLOW_MISSIONS.into_iter().zip(CONTROL_FLOW_FILES);
    let files = files.chain(POISON_MISSIONS.into_iter().zip(POISON_FILES));
    let requested = files.filter(|(name, _)| is_requested(name));
    workload.clone().with(requested.map(|(_, text)| read(text)))
}

fn read(text: &str) -> UserMission {
    let request = MissionDocument::request(text, Format::Yaml, IhtnFields::default());
    let source = request.map(|file| serde_json::from_value(file).expect("a mission file is an object"));
    let document = MissionDocument::parse(text, Format::Yaml, IhtnFields::default());
    let valid = "the missions of chaos are tested";
    UserMission { document: document.expect(valid), request: SubmitRequest::of(source.expect(valid)) }
}
