//! What may be said: every example is understood, in one way.

use consort_tests::behavior::{Features, ScenarioFilter, step_docs};
use std::path::PathBuf;

fn written(name: &str, text: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("words");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let file = folder.join(name);
    std::fs::write(&file, text).expect("cargo's own folder");
    file
}

fn read(name: &str, text: &str) -> Result<usize, String> {
    let read = Features::read(&[written(name, text)], &ScenarioFilter::default());
    read.map(|features| features.scenarios()).map_err(|bad| bad.to_string())
}

#[test]
fn every_example_is_understood_in_one_way_in_every_form() {
    let mut text = "Feature: All examples\n  Scenario: All\n".to_owned();
    for step in step_docs() {
        let example = &step.example;
        let lines = match step.kind {
            "Forms of a step" => vec![example.clone()],
            "Deeds" => vec![format!("When {example}"), format!("Given {example} when somebody coordinates")],
            "Facts" => vec![
                format!("Then {example}"),
                format!("Then it is not so that {example}"),
                format!("Then within 2 min {example}"),
                format!("Then for 1.5 s {example}"),
                format!("Then for 10 minutes it is never so that {example}"),
                format!("When the fleet runs until {example}"),
                format!("Given the coordinator dies when {example}"),
            ],
            _ => vec![format!("Given {example}")],
        };
        lines.iter().for_each(|line| text.push_str(&format!("    {line}\n")));
    }
    assert_eq!(read("examples.feature", &text), Ok(1));
}

#[test]
fn a_setting_is_no_deed_and_a_deed_no_fact() {
    for step in [r#"When a nurse in "IC Room 6""#, "Then the coordinator dies", r#"Given amber is at "Dock""#] {
        let said = read("wrong_kind.feature", &format!("Feature: F\n  Scenario: S\n    {step}\n")).expect_err(step);
        assert!(said.contains(&format!(":3: {step}: nobody knows this step")), "{said}");
    }
}

#[test]
fn an_unknown_step_of_an_outline_is_told_once_and_one_of_a_background_too() {
    let text = "Feature: F\n  Background:\n    Given a ghost\n\n  Scenario Outline: S\n    When <who> flies\n\n    Examples:\n      \
                | who   |\n      | amber |\n      | birch |\n";
    let said = read("outline.feature", text).expect_err("two steps that nobody knows");
    assert_eq!(said.matches("nobody knows this step").count(), 2, "{said}");
    assert!(
        said.contains("outline.feature:3: Given a ghost") && said.contains("outline.feature:6: When amber flies"),
        "{said}"
    );
}

#[test]
fn the_nearest_steps_are_offered() {
    let said =
        read("near.feature", "Feature: F\n  Scenario: S\n    When the co-ordinator dies\n").expect_err("a misspelling");
    assert!(said.contains("the nearest are\n    When the coordinator dies\n"), "{said}");
}
