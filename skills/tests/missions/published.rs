//! Missions of the MissionControl replication package.

use crate::skip::skip;
use crate::{instance, role, steps_text};
use consort_protocol::ids::{TaskId, TaskType};
use consort_protocol::mission::{IhtnOptions, Mission, TaskSchema, ValueKind, import_ihtn};
use consort_protocol::plan::{Signal, StepAction, divide_and_check};
use consort_skills::domain::hospital;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Reads a published iHTN from outside the repository; skips the test if the file is missing.
fn published(file: &str) -> Option<String> {
    let default_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference");
    let folder = std::env::var_os("CONSORT_REFERENCE").map_or(default_folder, PathBuf::from);
    let path = folder.join("mission_control").join(file);
    let text = std::fs::read_to_string(&path).ok();
    if text.is_none() {
        skip("no published evaluation (CONSORT_REFERENCE names the folder that contains it)");
    }
    text
}

fn options(people: &[&str]) -> IhtnOptions {
    IhtnOptions { name: TaskId::new("published").unwrap(), people: people.iter().map(|name| role(name)).collect() }
}

#[test]
fn the_published_lab_samples_give_the_robot_the_same_plan_as_ours() {
    let Some(text) = published("ihtn_lsl.json") else { return };
    let theirs = import_ihtn(&text, &options(&["nurse"]), &hospital()).unwrap();
    let ours = instance("lab-samples", &[("room", "PC Room 2")]);
    let plan = |mission: &Mission| -> Vec<String> {
        let types: BTreeMap<String, String> =
            mission.elementary().iter().map(|(id, spec)| (id.to_string(), spec.task_type.to_string())).collect();
        let plans = divide_and_check(mission).unwrap().plans;
        let signal_text = |signal: &Signal| {
            format!("{:?} {} {} {}", signal.kind, types[signal.task.as_str()], signal.from, signal.to)
        };
        let steps = plans[&role("r1")].steps.iter();
        steps
            .map(|step| match &step.action {
                StepAction::Task { spec, .. } => format!("{} {:?} {:?}", spec.task_type, spec.parameters, step.after),
                StepAction::Send(signal) => format!("send {} {:?}", signal_text(signal), step.after),
                StepAction::Wait(signal) => format!("wait {} {:?}", signal_text(signal), step.after),
            })
            .collect()
    };
    let expected = plan(&ours);
    assert_eq!(expected.len(), 13);
    assert_eq!(plan(&theirs), expected);
}

#[test]
fn the_other_published_missions_can_be_divided() {
    let domain = ["wait-for-food", "wait-for-human-to-fetch", "approach-human", "approach-door", "open-door"]
        .into_iter()
        .chain(["pick-patient-dishes", "load-dishes", "retrieve-dishes"])
        .fold(hospital(), |domain, name| {
            domain.with(TaskType::new(name).unwrap(), TaskSchema::default().optional("at", ValueKind::Place))
        });
    let people: &[&[&str]] = &[&["Delivery1", "Patient1"], &["Patient1"]];
    for (file, people) in ["ihtn_fld.json", "ihtn_flp.json"].into_iter().zip(people) {
        let Some(text) = published(file) else { return };
        let options = options(people);
        let mission = import_ihtn(&text, &options, &domain).unwrap_or_else(|error| panic!("{file}: {error}"));
        let division = divide_and_check(&mission).unwrap();
        if file == "ihtn_flp.json" {
            let plan = steps_text(&division.plans[&role("r1")]);
            assert_eq!(
                plan,
                [
                    "navto []",
                    "!done:navto:r1:r2 [0]",
                    "?done:navto-2:r2:r1 [0]",
                    "approach-door [2]",
                    "!done:approach-door:r1:r2 [3]",
                    "!ready:open-door:r1:r2 [3]",
                    "?ready:open-door:r2:r1 [5]",
                    "open-door [6]",
                    "!done:open-door:r1:r2 [7]",
                    "!done:open-door:r1:Patient1 [7]",
                    "?done:pick-patient-dishes:Patient1:r1 [7]",
                    "!ready:load-dishes:r1:r2 [10]",
                    "?ready:load-dishes:r2:r1 [11]",
                    "load-dishes [12]",
                    "?done:load-dishes:r2:r1 [13]",
                    "navto-3 [14]",
                    "retrieve-dishes [15]",
                ]
            );
        }
    }
}
