//! `consort test`.

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
fn a_feature_that_holds_is_told_in_a_line_each() {
    let file = test_file("stands.feature", STANDS);
    let ran = run(&["test", &file, "--tags", "@quick"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.starts_with("A robot\n  ✓ It stays where it is\n"), "{}", ran.out);
    assert!(ran.out.contains("1 of 1 scenarios passed (1 features, "), "{}", ran.out);
    let ran = run(&["test", &file, "--name", "stays", "--verbose"]);
    assert!(ran.out.contains("    ✓ Then amber is at \"1, 1\"\n"), "{}", ran.out);
}

#[test]
fn a_step_that_does_not_hold_is_told_with_what_was_found() {
    let file = test_file("goes.feature", STANDS);
    let ran = run(&["test", &file]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    for said in [
        "  ✗ It does not go by itself\n",
        "    ✗ Then amber is at \"2, 2\" (line 13)\n",
        "      expected: amber is at \"2, 2\"\n",
        "         found: it is at 1.00, 1.00 (the last place it passed is 1, 1)\n",
        "1 of 2 scenarios passed",
    ] {
        assert!(ran.out.contains(said), "{said:?} in\n{}", ran.out);
    }
    assert!(ran.out.contains(&format!("failed: {file}:9: It does not go by itself")), "{}", ran.out);
    assert_eq!(ran.err, "consort: 1 of 2 scenarios failed\n");
}

#[test]
fn steps_that_nobody_knows_are_told_with_their_lines_and_the_nearest_before_anything_is_played() {
    let file = test_file(
        "typo.feature",
        &STANDS.replace("When 10 s pass", "When 10 s go by").replace("is at \"2, 2\"", "is in \"2, 2\""),
    );
    let ran = run(&["test", &file]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(
        ran.err.contains(&format!("{file}:6: When 10 s go by: nobody knows this step; the nearest are\n")),
        "{}",
        ran.err
    );
    assert!(ran.err.contains("    When 10 minutes pass\n"), "{}", ran.err);
    assert!(ran.err.contains(&format!("{file}:13: Then amber is in \"2, 2\": nobody knows this step")), "{}", ran.err);
}

#[test]
fn what_is_no_feature_or_none_at_all_is_said() {
    let file = test_file("none.feature", "Scenario: without a feature\n  Given nothing\n");
    let ran = run(&["test", &file]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains(&format!("{file}: no feature in Gherkin")), "{}", ran.err);
    let ran = run(&["test", "no/such/folder"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("no/such/folder: No such file or directory"), "{}", ran.err);
    let ran = run(&["test", &test_file("stands_again.feature", STANDS), "--name", "flies"]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(2), "consort: no scenario has such a name and such tags\n"));
}

#[test]
fn all_that_may_be_said_is_listed_with_examples() {
    let ran = run(&["test", "--steps"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for said in [
        "Given {deed} when {fact}",
        "  a nurse in {text}\n      a nurse in \"IC Room 6\"\n",
        "  the coordinator dies\n",
    ] {
        assert!(ran.out.contains(said), "{said:?} in\n{}", ran.out);
    }
}
