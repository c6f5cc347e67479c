//! Domain files, and lines of drivers.

use super::frames::text;
use consort_driver::{Contract, DriverMessage};
use consort_protocol::ids::RoleId;
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::{TaskSchema, TaskSpec, ValueKind};
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_protocol::yaml;
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext};
use consort_skills::domain_file::{DomainFile, DomainForm};
use consort_skills::environment::{Environment, SpeedLimits};
use consort_skills::library::SkillLibrary;
use std::collections::BTreeMap;
use std::sync::OnceLock;

/// The trees beside the seeds.
const TREES: [(&str, &str); 2] = [
    ("water_plant.xml", include_str!("../../../examples/plants/water_plant.xml")),
    ("clean_room.xml", include_str!("../../../examples/vacuum/clean_room.xml")),
];

fn environment() -> &'static Environment {
    static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();
    ENVIRONMENT.get_or_init(|| {
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        map.environment().expect("it is sound")
    })
}

/// An accepted domain file can be used by a robot; each problem of a rejected file has a text.
pub(super) fn domain(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let form: DomainForm = match yaml::parse(text) {
        Ok(form) => form,
        Err(problem) => {
            assert!(!problem.is_empty());
            return false;
        }
    };
    let trees = BTreeMap::from(TREES.map(|(name, text)| (name.to_owned(), text.to_owned())));
    match DomainFile::check(form, &trees, &[]) {
        Ok(domain) => {
            use_domain(&domain);
            true
        }
        Err(problems) => {
            assert!(!problems.is_empty() && problems.iter().all(|found| !found.problem.is_empty()));
            false
        }
    }
}

/// Extends the skills and the estimators of a robot, and estimates each task.
fn use_domain(domain: &DomainFile) {
    let mut library = SkillLibrary::standard(environment().clone());
    domain.extend_library(&mut library).expect("its names were checked");
    let estimator = domain.extend_descriptors(DescriptorRegistry::standard()).resolve(environment().clone());
    let estimator = estimator.expect("the map has all descriptors");
    let context = EstimateContext {
        place: "Dock".parse().expect("a place"),
        pose: None,
        speed: MetresPerSecond::new(0.5).expect("a speed"),
        discharge: SharePerSecond::new(0.001).expect("a rate"),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    };
    for (task_type, schema) in domain.task_types() {
        let role: RoleId = "r1".parse().expect("a slug");
        let spec = TaskSpec { parameters: parameters(&schema), ..TaskSpec::of(task_type, vec![role]) };
        if let Err(problem) = estimator.estimate(&spec, &context) {
            assert!(!problem.to_string().is_empty());
        }
    }
}

fn parameters(schema: &TaskSchema) -> BTreeMap<String, String> {
    schema.parameters.iter().map(|(name, parameter)| (name.clone(), value(&parameter.kind).to_owned())).collect()
}

fn value(kind: &ValueKind) -> &str {
    match kind {
        ValueKind::Place => "IC Room 6",
        ValueKind::Role => "r1",
        ValueKind::Bool => "true",
        ValueKind::Seconds | ValueKind::Number(_) | ValueKind::Integer(_) | ValueKind::Text => "1",
        ValueKind::OneOf(words) => words.first().map_or("", String::as_str),
    }
}

/// Each line of a driver is rejected with a message, or can be written and reads back as the same message.
pub(super) fn driver(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let mut read = 0;
    for line in text.lines().take(60) {
        match DriverMessage::parse(line) {
            Ok(message) => {
                let json = serde_json::to_string(&message).expect("messages have a JSON form");
                let again = DriverMessage::parse(&json).expect("what was written can be read");
                assert_eq!(again, message, "it reads back as something else");
                check_hello(message);
                read += 1;
            }
            Err(problem) => assert!(!problem.to_string().is_empty()),
        }
    }
    read > 0
}

fn check_hello(message: DriverMessage) {
    let DriverMessage::Hello { protocol, actions, .. } = message else { return };
    if let Err(problem) = Contract::new([]).check(protocol, &actions) {
        assert!(problem.to_string().starts_with("hello: "), "{problem}");
    }
}
