//! Feedback of actions.

use super::*;

const SOAKING: &str = r#"
domain: laundry
actions:
  soak:
    feedback:
      soaked: { type: number, unit: "1", minimum: 0, maximum: 1, description: share }
      phase: { type: text, one_of: [fill, rest] }
      left: { type: seconds }
    simulate: { feedback: { phase: [rest, fill] } }
"#;

#[test]
fn feedback_is_declared_like_results() {
    let domain = check(SOAKING).unwrap();
    let (_, action) = domain.simulated_actions().next().unwrap();
    let kinds: Vec<ValueKind> = action.feedback.values().map(ParameterForm::value_kind).collect();
    let share = NumberRange { minimum: Some(0.0), maximum: Some(1.0) };
    let phases = ValueKind::OneOf(["fill", "rest"].map(str::to_owned).into());
    assert_eq!(kinds, [ValueKind::Seconds, phases, ValueKind::Number(share)]);
    let text = |text: &str| Scalar::Text(text.to_owned());
    let expected = [
        ("left", SimulatedResult::Range([0.0, 1.0])),
        ("phase", SimulatedResult::OneOf(vec![text("rest"), text("fill")])),
        ("soaked", SimulatedResult::Range([0.0, 1.0])),
    ];
    assert_eq!(action.simulate.feedback, BTreeMap::from(expected.map(|(name, value)| (name.to_owned(), value))));
}

#[test]
fn simulated_feedback_may_fall() {
    let domain = check(&SOAKING.replace("phase: [rest, fill]", "soaked: [0.8, 0.1], left: [90, 0]")).unwrap();
    let (_, action) = domain.simulated_actions().next().unwrap();
    let soaked = (&action.simulate.feedback["soaked"], &action.simulate.feedback["left"]);
    assert_eq!(soaked, (&SimulatedResult::Range([0.8, 0.1]), &SimulatedResult::Range([90.0, 0.0])));
}

#[test]
fn wrong_feedback_is_reported_with_its_place() {
    let wrong = r#"
domain: laundry
actions:
  soak:
    feedback:
      soaked: { type: number, maximum: 1 }
      where: { type: place }
      nurse: { type: role }
      dry-run: { type: bool }
      phase: { type: text, optional: true }
    simulate: { feedback: { soaked: [2, 0], phse: fill } }
  drive: { feedback: { speed: { type: number } }, simulate: { system: driving, feedback: { speed: 1 } } }
  iron: { by_people: true, feedback: { heat: { type: number } } }
"#;
    let problems = check(wrong).unwrap_err();
    for expected in [
        "actions.soak.feedback.where: allowed are seconds, number, integer, bool and text",
        "actions.soak.feedback.nurse: allowed are seconds, number, integer, bool and text",
        "actions.soak.feedback.dry-run: allowed is a letter, followed by letters, digits and `_`",
        "actions.soak.feedback.phase: feedback is not `optional`",
        "actions.soak.simulate.feedback.soaked: the range [2, 0] does not fit the feedback; allowed is a number, 1 or less",
        "actions.soak.simulate.feedback.phse: no such feedback; allowed: dry-run, nurse, phase, soaked, where; did you \
         mean `phase`?",
        "actions.drive.simulate.feedback.speed: the system driving determines the feedback; omit it",
        "actions.iron.feedback: people perform the action, and only robots have feedback",
    ] {
        assert!(problems.iter().any(|problem| problem == expected), "{expected}\n{problems:#?}");
    }
    assert_eq!(problems.len(), 8, "{problems:#?}");
    let many: String = (0..17).map(|number| format!("f{number}: {{ type: bool }}, ")).collect();
    let long = "f".repeat(65);
    let problems =
        check(&format!("domain: d\nactions: {{ a: {{ feedback: {{ {many} {long}: {{ type: bool }} }} }} }}"));
    let expected = [
        format!("actions.a.feedback.{long}: allowed are at most 64 letters"),
        "actions.a.feedback: 18 values; at most 16 are allowed".to_owned(),
    ];
    assert_eq!(problems.unwrap_err(), expected);
}

/// Domains of other releases have no feedback.
#[test]
fn feedback_is_a_part_of_the_content_if_there_is_any() {
    let reference = |text: &str| check(text).unwrap().reference();
    let domain = reference(SOAKING);
    assert_eq!(reference(&SOAKING.replace(r#"unit: "1", "#, "").replace(", description: share", "")), domain);
    for (part, changed) in [("maximum: 1", "maximum: 2"), ("phase: [rest", "phase: [fill")] {
        assert_ne!(reference(&SOAKING.replace(part, changed)), domain, "{changed}");
    }
    let without = serde_json::to_string(&yaml::parse::<DomainForm>(PLANTS).unwrap()).unwrap();
    assert!(!without.contains("feedback"), "{without}");
}
