//! Conditions of task types on readings of their robots.

use super::*;
use crate::descriptor::EstimateError;

const TANK: &str = r#"
domain: watering
actions: { water: { parameters: { litres: { type: number } } } }
readings:
  tank_l: { type: number, minimum: 0, maximum: 5 }
  lid_open: { type: bool }
tasks:
  water:
    parameters: { litres: { type: number } }
    action: water
    requires: "readings.tank_l >= litres && !readings.lid_open"
"#;

/// A condition on readings is true, false or unknown. A robot bids only if it is true.
#[test]
fn a_task_requires_readings_of_the_robot() {
    let domain = check(TANK).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let task = task("water", &[("litres", "3")]);
    let refused = |readings: Option<serde_json::Value>| {
        let readings = readings.map(|readings| serde_json::from_value(readings).unwrap());
        let refused = estimator.estimate(&task, &EstimateContext { readings, ..robot() }).err()?;
        assert!(matches!(refused, EstimateError::Requirement { may_change: true, .. }), "{refused:?}");
        let text = refused.to_string();
        let problem = text.strip_prefix("water requires `readings.tank_l >= litres && !readings.lid_open`, which ");
        Some(problem.unwrap_or_else(|| panic!("{text}")).to_owned())
    };
    assert_eq!(refused(Some(json!({ "tank_l": 3, "lid_open": false, "other": "x" }))), None);
    let unknown =
        |name: &str| format!("has no value: the reading `{name}` is unknown: the driver has not published it");
    for (readings, problem) in [
        (json!({ "tank_l": 2.5, "lid_open": false }), "is false".to_owned()),
        (json!({ "tank_l": 4.5 }), unknown("lid_open")),
        (json!({ "lid_open": false }), unknown("tank_l")),
        // The other operand decides.
        (json!({ "lid_open": true }), "is false".to_owned()),
        (json!({ "tank_l": 1.0 }), "is false".to_owned()),
        (
            json!({ "tank_l": "full", "lid_open": false }),
            "has no value: the reading `tank_l` is `full`; allowed is a number from 0 to 5".to_owned(),
        ),
    ] {
        assert_eq!(refused(Some(readings.clone())), Some(problem), "{readings}");
    }
    assert_eq!(refused(None), None, "a robot that performs the task");
}

/// Where readings do not count, attributes still do.
#[test]
fn a_condition_on_attributes_and_readings_is_evaluated_without_readings() {
    let both = "attributes.arm && readings.tank_l >= litres";
    let domain = check(&TANK.replace("readings.tank_l >= litres && !readings.lid_open", both)).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let accepts = |arm: bool| {
        let attributes = serde_json::from_value(json!({ "arm": arm })).unwrap();
        estimator.estimate(&task("water", &[("litres", "3")]), &EstimateContext { attributes, ..robot() }).is_ok()
    };
    assert_eq!((accepts(true), accepts(false)), (true, false));
}

/// A robot without the attribute never does the task, whatever its readings are.
#[test]
fn a_condition_that_no_reading_changes_is_final() {
    let both = "readings.tank_l >= litres && attributes.arm";
    let domain = check(&TANK.replace("readings.tank_l >= litres && !readings.lid_open", both)).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let may_change = |arm: bool, readings: serde_json::Value| {
        let attributes = serde_json::from_value(json!({ "arm": arm })).unwrap();
        let readings = Some(serde_json::from_value(readings).unwrap());
        let context = EstimateContext { attributes, readings, ..robot() };
        match estimator.estimate(&task("water", &[("litres", "3")]), &context) {
            Err(EstimateError::Requirement { may_change, .. }) => may_change,
            other => panic!("{other:?}"),
        }
    };
    for readings in [json!({ "tank_l": 5 }), json!({ "tank_l": 1 }), json!({})] {
        assert!(!may_change(false, readings.clone()), "{readings}");
    }
    for readings in [json!({ "tank_l": 1 }), json!({})] {
        assert!(may_change(true, readings.clone()), "{readings}");
    }
}

#[test]
fn a_wrong_reading_in_a_condition_is_reported_with_its_place() {
    let with = |condition: &str| TANK.replace("readings.tank_l >= litres && !readings.lid_open", condition);
    for (condition, expected) in [
        (
            "readings.tank >= litres",
            "tasks.water.requires: no domain declares the reading `tank`; allowed: lid_open, tank_l; did you mean \
             `tank_l`?",
        ),
        (
            "attributes.arm && readings.lid",
            "tasks.water.requires: no domain declares the reading `lid`; allowed: lid_open, tank_l",
        ),
        ("readings.lid_open >= litres", "tasks.water.requires: `readings.lid_open >= litres` has no value: "),
        ("readings.tank_l", "tasks.water.requires: `readings.tank_l` is Float(0.0); allowed is true or false"),
    ] {
        let problems = check(&with(condition)).unwrap_err();
        assert!(problems.len() == 1 && problems[0].starts_with(expected), "{problems:#?}");
    }
    let estimate = TANK.replace("requires: \"", "estimate: { time_s: \"readings.tank_l\" }\n    requires: \"");
    let problems = check(&estimate).unwrap_err();
    assert!(problems[0].starts_with("tasks.water.estimate.time_s: "), "{problems:#?}");

    // A reading of another domain.
    let known = DomainFile::check(
        yaml::parse("domain: tanks\nreadings: { pressure_bar: { type: number } }").unwrap(),
        &BTreeMap::new(),
        &[],
    );
    let form = yaml::parse(&with("readings.pressure_bar >= 1.0 && readings.tank_l >= litres")).unwrap();
    let domain = DomainFile::check(form, &BTreeMap::new(), &[&known.unwrap()]).unwrap();
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    let readings = Some(serde_json::from_value(json!({ "pressure_bar": 0.5, "tank_l": 5 })).unwrap());
    let refused = estimator.estimate(&task("water", &[("litres", "3")]), &EstimateContext { readings, ..robot() });
    assert!(refused.unwrap_err().to_string().ends_with("which is false"));
}
