//! Ensembles of missions, bounds on their energy, and conditions on the robots of their roles.

use super::*;
use crate::ids::EnsembleId;
use crate::units::EnergyLimit;

const VISIT: &str = r#"
mission: visit
ensembles: [icu, hospital]
energy_max: 0.4
parameters:
  section: { kind: text, default: icu }
  charge: { kind: number, default: 0.3 }
roles:
  r1: { kind: managed, eligible: "robot.attributes.section == ${section} && robot.battery > ${charge}" }
root:
  task: visit
  method: sequential
  tasks:
    - { task: take, type: wait, roles: [r1], parameters: { seconds: 1 }, acquires: { parcel: r1 } }
    - { task: give, type: wait, roles: [r1], parameters: { seconds: 1 }, releases: [parcel] }
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
        assert_eq!(branch.energy_max.map(EnergyLimit::get), Some(0.4));
        assert_eq!(branch.ensembles.iter().map(EnsembleId::as_str).collect::<Vec<_>>(), ["icu", "hospital"]);
        let condition = branch.roles.values().next().unwrap().eligible.as_deref();
        assert_eq!(condition, Some(r#"robot.attributes.section == "a \"b\"" && robot.battery > 0.3"#));
    }
    assert_eq!(problems(VISIT), [""; 0]);
}

const ELIGIBLE: &str = r#"
mission: meet
eligible: robot.attributes.section == ${section} || robot.name == "ada"
parameters: { section: { kind: text, default: icu } }
roles:
  r1: { kind: managed, eligible: "robot.battery > 0.3 || robot.place == 'Dock'" }
  r2: { kind: managed }
  clerk: { kind: unmanaged }
root: { task: meet, type: wait, roles: [r1, r2, clerk], parameters: { seconds: 1 } }
"#;

#[test]
fn a_condition_of_the_mission_applies_to_all_managed_roles() {
    let mission = MissionTemplate::parse(ELIGIBLE, Format::Yaml).unwrap().instantiate(&given(&[]), &domain()).unwrap();
    let conditions: Vec<_> = mission.roles.iter().map(|(id, role)| (id.as_str(), role.eligible.as_deref())).collect();
    let of_mission = r#"robot.attributes.section == "icu" || robot.name == "ada""#;
    let of_r1 = format!("({of_mission}) && (robot.battery > 0.3 || robot.place == 'Dock')");
    assert_eq!(conditions, [("clerk", None), ("r1", Some(&*of_r1)), ("r2", Some(of_mission))]);
    assert_eq!(problems(ELIGIBLE), [""; 0]);
    for (from, to, expected) in [
        (
            "robot.name",
            "robot.nme",
            "eligible: `robot.attributes.section == \"icu\" || robot.nme == \"ada\"`: `robot` has no field `nme`",
        ),
        ("== \"ada\"", "==", "eligible: `robot.attributes.section == \"icu\" || robot.name ==`: "),
        ("${section}", "${sektion}", "eligible: `${sektion}` is not a parameter of the mission"),
        (
            "robot.battery",
            "robot.batery",
            "roles/r1/eligible: `robot.batery > 0.3 || robot.place == 'Dock'`: `robot` has no field",
        ),
        // The condition of the mission cannot be left in this way.
        ("robot.battery > 0.3 ||", "true) || (", "roles/r1/eligible: `true) || ( robot.place == 'Dock'`: "),
    ] {
        assert!(ELIGIBLE.contains(from), "{from}");
        let found = problems(&ELIGIBLE.replace(from, to));
        let found: Vec<_> = found.into_iter().filter(|text| !text.starts_with("parameters/section")).collect();
        assert!(found.len() == 1 && found[0].starts_with(expected), "{to}: {found:?}");
    }
}

#[test]
fn a_bound_on_energy_is_a_number_above_0() {
    let with = |bound: &str| {
        let text = VISIT.replace("energy_max: 0.4", bound);
        let template = MissionTemplate::parse(&text, Format::Yaml).map_err(|problem| problem.to_string())?;
        let (mission, _) = template.instantiate_with_recovery(&given(&[]), &domain()).unwrap();
        Ok::<_, String>(mission.energy_max.map(EnergyLimit::get))
    };
    assert_eq!(with(""), Ok(None));
    assert_eq!(with("energy_max: 2"), Ok(Some(2.0)));
    for bound in ["0", "0.0", "-0.1", ".nan", ".inf", "much", "[0.4]"] {
        let found = with(&format!("energy_max: {bound}"));
        assert!(found.as_ref().is_err_and(|problem| problem.contains("energy_max")), "{bound}: {found:?}");
    }
    let zero = with("energy_max: 0").unwrap_err();
    assert!(
        zero.contains("0 is not a bound on energy: allowed is a finite number of full batteries above 0"),
        "{zero}"
    );
}

#[test]
fn a_bound_on_time_is_a_whole_number_of_seconds() {
    let with = |bound: &str| {
        let text = VISIT.replace("energy_max: 0.4", bound);
        let template = MissionTemplate::parse(&text, Format::Yaml).map_err(|problem| problem.to_string())?;
        let request = MissionTemplate::request(&text, Format::Yaml).unwrap().to_string();
        let requested = MissionTemplate::parse(&request, Format::Json).unwrap();
        assert_eq!(requested.time_limit(), template.time_limit(), "as a request");
        Ok::<_, String>(template.time_limit().map(|limit| limit.as_secs()))
    };
    assert_eq!(with(""), Ok(None));
    for seconds in [1, 900, 315_360_000] {
        assert_eq!(with(&format!("time_limit_s: {seconds}")), Ok(Some(seconds)));
    }
    for bound in ["0", "-1", "1.5", "315360001", "long", "[60]"] {
        let found = with(&format!("time_limit_s: {bound}"));
        assert!(found.as_ref().is_err_and(|problem| problem.contains("time_limit_s")), "{bound}: {found:?}");
    }
    let zero = with("time_limit_s: 0").unwrap_err();
    assert!(zero.contains("time_limit_s is 0; allowed are 1 to 315360000 seconds"), "{zero}");
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
    let person = "mission: m\nroles:\n  r1: { kind: managed }\n  clerk: { kind: unmanaged, eligible: 'true' }\n\
        root: { task: rest, type: wait, roles: [r1, clerk], parameters: { seconds: 1 } }\n";
    assert_eq!(problems(person), ["roles/clerk/eligible: `true`: only a managed role has a condition on its robot"]);
    let many = VISIT.replace("[icu, hospital]", &format!("[{}]", ["icu"; 17].join(", ")));
    assert_eq!(problems(&many), ["ensembles: 17 ensembles; at most 16 are allowed"]);
}
