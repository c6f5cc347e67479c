//! Missions in files and requests.

use super::frames::text;
use consort_fleet::fuzz_api::{ApiRequest, request as parse_request};
use consort_protocol::codec;
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::{
    Domain, Format, IhtnFields, IhtnOptions, Mission, MissionDocument, TemplateKind, import_ihtn,
};
use consort_protocol::plan::{check_division, divide_and_check};
use consort_skills::domain::hospital;
use std::collections::{BTreeMap, BTreeSet};

/// An accepted mission is valid, is divided or rejected with a message, and can be encoded.
fn check_mission(mission: &Mission, domain: &Domain) {
    mission.check(domain).expect("a mission that was taken is sound");
    match divide_and_check(mission) {
        Ok(division) => check_division(mission, &division).expect("it was checked"),
        Err(problem) => assert!(!problem.to_string().is_empty()),
    }
    if let Ok(bytes) = codec::encode(mission) {
        assert_eq!(&codec::decode::<Mission>(&bytes).expect("what was written can be read"), mission);
    }
}

fn instantiated(template: &MissionDocument) {
    let domain = hospital();
    let open = template.parameters().iter().filter(|(_, parameter)| parameter.default.is_none());
    let value = |kind: TemplateKind| match kind {
        TemplateKind::Place | TemplateKind::Places => "IC Room 6",
        TemplateKind::Seconds | TemplateKind::Number => "1",
        TemplateKind::Text | TemplateKind::Texts => "some text",
    };
    let given: BTreeMap<String, String> =
        open.map(|(name, parameter)| (name.clone(), value(parameter.kind).to_owned())).collect();
    match template.instantiate_with_recovery(&given, &domain) {
        Ok((mission, _)) => check_mission(&mission, &domain),
        Err(errors) => assert!(!errors.diagnostics.is_empty()),
    }
}

fn read(bytes: &[u8], format: Format) -> bool {
    let Some(text) = text(bytes) else { return false };
    let no_fields = IhtnFields::default;
    match MissionDocument::parse(text, format, no_fields()) {
        Ok(template) => {
            instantiated(&template);
            let request = MissionDocument::request(text, format, no_fields())
                .expect("a readable mission can be requested")
                .to_string();
            let again =
                MissionDocument::parse(&request, Format::Json, no_fields()).expect("a requested mission can be read");
            assert_eq!((again.name(), again.parameters()), (template.name(), template.parameters()));
            true
        }
        Err(problem) => {
            assert!(!problem.to_string().is_empty());
            false
        }
    }
}

pub(super) fn yaml(bytes: &[u8]) -> bool {
    read(bytes, Format::Yaml)
}

pub(super) fn json(bytes: &[u8]) -> bool {
    read(bytes, Format::Json)
}

pub(super) fn ihtn(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let reading = IhtnOptions { name: "mission".parse().expect("a slug"), people: BTreeSet::new() };
    let domain = hospital();
    match import_ihtn(text, &reading, &domain) {
        Ok(mission) => {
            check_mission(&mission, &domain);
            true
        }
        Err(errors) => {
            assert!(errors.diagnostics.iter().all(|problem| !problem.path.is_empty()), "where is it wrong?");
            false
        }
    }
}

/// A request is accepted or rejected with a message.
pub(super) fn request(bytes: &[u8]) -> bool {
    let mut taken = false;
    for call in ApiCall::ALL {
        match parse_request(*call, bytes) {
            Ok(ApiRequest::Submit(template)) => {
                instantiated(&template);
                taken = true;
            }
            // These two calls accept any payload.
            Ok(ApiRequest::Other) => taken |= !matches!(call, ApiCall::Help | ApiCall::Backup),
            Err(problem) => assert!(!problem.to_string().is_empty()),
        }
    }
    taken
}
