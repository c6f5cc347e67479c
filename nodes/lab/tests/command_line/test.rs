//! `consort-lab test`.

use super::support::{run, test_file};

const STANDS: &str = r#"Feature: A robot
  @quick
  Scenario: It stays where it is
    Given a room of 10 by 10 metres
    And a robot amber at "1, 1"
    When 10 s pass
    Then amber is at "1, 1"

  Scenario: It does not go by itself
    Given a room of 10 by 10 metres
    And a robot amber at "1, 1"
    When 10 s pass
    Then amber is at "2, 2"
"#;

#[test]
fn each_passing_scenario_prints_a_line() {
    let file = test_file("stands.feature", STANDS);
    let ran = run(&["test", &file, "--tags", "@quick"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.starts_with("A robot\n  ✓ It stays where it is\n"), "{}", ran.out);
    assert!(ran.out.contains("1 of 1 scenarios passed (1 features, "), "{}", ran.out);
    let ran = run(&["test", &file, "--name", "stays", "--verbose"]);
    assert!(ran.out.contains("    ✓ Then amber is at \"1, 1\"\n"), "{}", ran.out);
}

#[test]
fn a_failing_step_prints_what_was_found() {
    let file = test_file("goes.feature", STANDS);
    let ran = run(&["test", &file]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    for expected in [
        "  ✗ It does not go by itself\n",
        "    ✗ Then amber is at \"2, 2\" (line 13)\n",
        "      expected: amber is at \"2, 2\"\n",
        "         found: it is at 1.00, 1.00 (the last place it passed is 1, 1)\n",
        "1 of 2 scenarios passed",
    ] {
        assert!(ran.out.contains(expected), "{expected:?} in\n{}", ran.out);
    }
    assert!(ran.out.contains(&format!("failed: {file}:9: It does not go by itself")), "{}", ran.out);
    assert_eq!(ran.err, "consort-lab: 1 of 2 scenarios failed\n");
}

#[test]
fn unknown_steps_are_reported_with_similar_steps_before_any_run() {
    let file = test_file(
        "typo.feature",
        &STANDS.replace("When 10 s pass", "When 10 s go by").replace("is at \"2, 2\"", "is in \"2, 2\""),
    );
    let ran = run(&["test", &file]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(ran.err.contains(&format!("{file}:6: When 10 s go by: unknown step; similar steps are\n")), "{}", ran.err);
    assert!(ran.err.contains("    When 10 minutes pass\n"), "{}", ran.err);
    assert!(ran.err.contains(&format!("{file}:13: Then amber is in \"2, 2\": unknown step")), "{}", ran.err);
}

#[test]
fn an_invalid_or_missing_feature_is_reported() {
    let file = test_file("none.feature", "Scenario: without a feature\n  Given nothing\n");
    let ran = run(&["test", &file]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains(&format!("{file}: no feature in Gherkin")), "{}", ran.err);
    let ran = run(&["test", "no/such/folder"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("no/such/folder: No such file or directory"), "{}", ran.err);
    let ran = run(&["test", &test_file("stands_again.feature", STANDS), "--name", "flies"]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(2), "consort-lab: no scenario has such a name and such tags\n"));
}

#[test]
fn all_steps_are_listed_with_examples() {
    let ran = run(&["test", "--steps"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for expected in [
        "Given {action} when {fact}",
        "  a nurse in {text}\n      a nurse in \"IC Room 6\"\n",
        "  the coordinator is killed\n",
    ] {
        assert!(ran.out.contains(expected), "{expected:?} in\n{}", ran.out);
    }
}
