//! Ensembles of missions, and conditions on the robots of their roles.

use super::*;
use crate::ids::EnsembleId;

const VISIT: &str = r#"
mission: visit
ensembles: [icu, hospital]
parameters:
  section: { kind: text, default: icu }
  charge: { kind: number, default: 0.3 }
roles:
  r1: { kind: managed, eligible: "robot.attributes.section == ${section} && robot.battery > ${charge}" }
root:
  task: visit
  method: sequential
  tasks:
    - { task: take, type: wait, roles: [r1], parameters: { seconds: 1 }, acquires: { sample: r1 } }
    - { task: give, type: wait, roles: [r1], parameters: { seconds: 1 }, releases: [sample] }
recovery: { task: inspect, type: wait, roles: [r1], parameters: { seconds: 1 } }
"#;

/// Returns the problems of a file in a fleet with two ensembles.
fn problems(text: &str) -> Vec<String> {
    let ensembles = ["icu", "hospital"].map(|name| EnsembleId::new(name).unwrap());
    let template = MissionTemplate::parse(text, Format::Yaml).unwrap();
    match template.instantiate_with_recovery(&given(&[]), &domain().with_ensembles(ensembles)) {
        Ok(_) => vec![],
        Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
    }
}

#[test]
fn both_branches_have_the_policies_of_the_mission() {
    let template = MissionTemplate::parse(VISIT, Format::Yaml).unwrap();
    let given = given(&[("section", "a \"b\"")]);
    let (mission, recovery) = template.instantiate_with_recovery(&given, &domain()).unwrap();
    for branch in [mission, recovery.unwrap()] {
        assert_eq!(branch.ensembles.iter().map(EnsembleId::as_str).collect::<Vec<_>>(), ["icu", "hospital"]);
        let condition = branch.roles.values().next().unwrap().eligible.as_deref();
        assert_eq!(condition, Some(r#"robot.attributes.section == "a \"b\"" && robot.battery > 0.3"#));
    }
    assert_eq!(problems(VISIT), [""; 0]);
}

#[test]
fn problems_of_policies_are_reported_once_with_their_place() {
    for (from, to, expected) in [
        (
            "[icu, hospital]",
            "[icuu]",
            "ensembles: the fleet has no ensemble `icuu`; allowed: hospital, icu; did you mean `icu`?",
        ),
        ("[icu, hospital]", "[\"a b\"]", "ensembles: "),
        (
            "robot.battery",
            "robot.batery",
            "roles/r1/eligible: `robot.attributes.section == \"icu\" && robot.batery > 0.3`: `robot` has no field `batery`",
        ),
        ("robot.battery >", "${place} >", "roles/r1/eligible: `${place}` is not a parameter of the mission"),
        ("robot.battery >", "${lost.robot} >", "roles/r1/eligible: `${lost.robot}` is not a parameter of the mission"),
        ("${section} &&", "'${section}' &&", "parameters/section: is declared, but `${section}` is not used"),
    ] {
        let text = VISIT.replace(from, to);
        assert_ne!(text, VISIT);
        let found = problems(&text);
        // A condition that cannot be built uses no parameters.
        let found: Vec<_> = found.into_iter().filter(|text| !text.starts_with("parameters/charge")).collect();
        assert!(found.len() == 1 && found[0].starts_with(expected), "{to}: {found:?}");
    }
    let person = "mission: m\nroles:\n  r1: { kind: managed }\n  nurse: { kind: unmanaged, eligible: 'true' }\n\
        root: { task: rest, type: wait, roles: [r1, nurse], parameters: { seconds: 1 } }\n";
    assert_eq!(problems(person), ["roles/nurse/eligible: `true`: only a managed role has a condition on its robot"]);
    let many = VISIT.replace("[icu, hospital]", &format!("[{}]", ["icu"; 17].join(", ")));
    assert_eq!(problems(&many), ["ensembles: 17 ensembles; at most 16 are allowed"]);
}
