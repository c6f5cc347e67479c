//! Step documentation: every example resolves to a single step.

use consort_tests::behavior::{FeatureErrors, Features, ScenarioFilter, step_docs};
use std::path::PathBuf;

fn test_file(name: &str, text: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("words");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let file = folder.join(name);
    std::fs::write(&file, text).expect("cargo's own folder");
    file
}

fn read_feature(name: &str, text: &str) -> Result<usize, FeatureErrors> {
    let features = Features::read(&[test_file(name, text)], &ScenarioFilter::default());
    features.map(|features| features.scenarios())
}

#[test]
fn every_example_resolves_uniquely_in_every_form() {
    let mut text = "Feature: All examples\n  Scenario: All\n".to_owned();
    for step in step_docs() {
        let example = &step.example;
        let lines = match step.kind {
            "Forms of a step" => vec![example.clone()],
            "Actions" => vec![format!("When {example}"), format!("Given {example} when there is a coordinator")],
            "Facts" => vec![
                format!("Then {example}"),
                format!("Then it is not true that {example}"),
                format!("Then within 2 min {example}"),
                format!("Then for 1.5 s {example}"),
                format!("Then for 10 minutes it is never true that {example}"),
                format!("When the fleet runs until {example}"),
                format!("Given the coordinator is killed when {example}"),
            ],
            _ => vec![format!("Given {example}")],
        };
        lines.iter().for_each(|line| text.push_str(&format!("    {line}\n")));
    }
    assert_eq!(read_feature("examples.feature", &text), Ok(1));
}

#[test]
fn settings_actions_and_facts_are_not_interchangeable() {
    for step in [r#"When a nurse in "IC Room 6""#, "Then the coordinator is killed", r#"Given amber is at "Dock""#] {
        let error = read_feature("wrong_kind.feature", &format!("Feature: F\n  Scenario: S\n    {step}\n"))
            .expect_err(step)
            .to_string();
        assert!(error.contains(&format!(":3: {step}: unknown step")), "{error}");
    }
}

#[test]
fn an_unknown_step_is_reported_once_per_outline_and_background() {
    let text = "Feature: F\n  Background:\n    Given a ghost\n\n  Scenario Outline: S\n    When <who> flies\n\n    Examples:\n      \
                | who   |\n      | amber |\n      | birch |\n";
    let error = read_feature("outline.feature", text).expect_err("two unknown steps").to_string();
    assert_eq!(error.matches("unknown step").count(), 2, "{error}");
    assert!(
        error.contains("outline.feature:3: Given a ghost") && error.contains("outline.feature:6: When amber flies"),
        "{error}"
    );
}

#[test]
fn similar_steps_are_suggested() {
    let error = read_feature("near.feature", "Feature: F\n  Scenario: S\n    When the co-ordinator is killed\n")
        .expect_err("a misspelling")
        .to_string();
    assert!(error.contains("similar steps are\n    When the coordinator is killed\n"), "{error}");
}
