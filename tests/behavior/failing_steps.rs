//! Failing steps report what was found instead.

use consort_skills::extensions::Extensions;
use consort_tests::behavior::{FeatureOutcome, Features, RunOptions, ScenarioFilter, run};
use std::path::PathBuf;

/// Runs a feature and returns its outcome and its report.
pub(super) fn run_feature(name: &str, text: &str, seed: u64) -> (FeatureOutcome, String) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("failing");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let file = folder.join(name);
    std::fs::write(&file, text).expect("cargo's own folder");
    let features = Features::read(&[file], &ScenarioFilter::default()).unwrap_or_else(|bad| panic!("{bad}"));
    let mut report = vec![];
    let outcome = run(
        features,
        &RunOptions { extensions: Extensions::default(), seed, jobs: 2, steps: false, colours: false },
        &mut report,
    );
    (outcome, String::from_utf8(report).expect("UTF-8 output"))
}

/// Runs a delivery each followed by a false expectation, and checks the reports.
#[test]
fn false_facts_after_a_delivery_are_reported() {
    let cases = [
        ("the mission is failed", "found: is completed"),
        (r#"the mission has failed because "no route""#, "found: is completed"),
        (r#"the mission needs intervention because "lost""#, "found: is completed"),
        (r#"the mission was canceled by "ward 3""#, "found: is completed"),
        ("mission other is completed", "but: mission other was not requested; requested were: sample-1"),
        ("it is not true that the mission has ended", "found: it holds"),
        ("it is not true that all missions are completed", "found: it holds"),
        ("lab-arm is r1 of the mission", "found: "),
        ("amber never had a role in the mission", "found: roles were given to amber, lab-arm"),
        ("birch never had a role in the mission", "but: there is no robot birch; there are: amber, lab-arm"),
        ("task dance has begun", "found: it has not begun"),
        ("task navto_lab has begun 2 times", "found: it has begun 1 times: amber"),
        ("task dance has ended", "found: it has not ended"),
        ("lab-arm did task navto_lab", "found: amber did"),
        (r#"r1 was taken from a robot because "battery""#, "found: it was taken because … there was no such event"),
        (r#"amber did not get r1 because "lacks""#, "found: it did not because of: nothing: it bid"),
        (r#"amber retried a task because "closed""#, "found: it retried a task because … there was no such event"),
        ("there is no coordinator", "found: "),
        ("node amber is the coordinator", "found: "),
        ("another node is the coordinator", "but: no coordinator was killed or cut off"),
        ("the fleet has had 3 coordinators", "found: it has had 2"),
        (r#"amber is at "Dock""#, "found: it is at 13.50, 11.00 (the last place it passed is Laboratory)"),
        (r#"amber is at "Moon""#, "but: there is no place \"Moon\" on this map"),
        ("amber has less than 20 % of its charge", "found: it has "),
        ("amber has more than 99 % of its charge", "found: it has "),
        ("amber cannot move", "found: it can, with "),
        ("the drawer of amber is open", "found: it is closed"),
        ("amber is docked", "found: it is not"),
        (r#"amber holds "sample of IC Room 6""#, "found: it is in the arm of lab-arm"),
        (r#""sample of IC Room 6" is in the drawer of amber"#, "found: it is in the arm of lab-arm"),
        (r#""sample of IC Room 6" is still with "nurse of IC Room 6""#, "found: it is in the arm of lab-arm"),
        (r#""sample of IC Room 6" lies at "Laboratory""#, "found: it is in the arm of lab-arm"),
        (
            r#"the sample of "IC Room 6" was delivered to amber"#,
            "found: it was with nurse of IC Room 6, then in the drawer",
        ),
        (
            r#"the sample of "PC Room 1" was delivered to lab-arm"#,
            "but: there is no \"sample of PC Room 1\"; there are: sample of IC",
        ),
        (r#"the nurse in "IC Room 6" is away"#, "found: she is there"),
        ("within 20 s the mission is failed", "found: is completed"),
        ("for 20 s the mission is failed", "found: is completed"),
        ("for 20 s it is never true that the mission is completed", "found: it holds"),
        (r#"the request was refused because "no such place""#, "found: no request was refused"),
        ("the goal of amber has succeeded", "but: this scenario sent no goal to amber"),
        ("amber sees lab-arm", "but: amber has no such sensor"),
        ("amber measures 2 m ahead", "but: amber has no range sensor"),
        (r#"amber waits at "Gate""#, "but: there is no door or lift \"Gate\" on this map"),
    ];
    let mut text = "Feature: Delivered\n".to_owned();
    for (index, (step, _)) in cases.iter().enumerate() {
        text.push_str(&format!(
            "  Scenario: {index}\n    Given a robot amber at \"IC Room 4\"\n    And an arm lab-arm at \"Laboratory\"\n    \
             And a station post\n    And a nurse in \"IC Room 6\"\n    When a sample is requested from \"IC Room 6\"\n    \
             Then within 10 minutes the mission is completed\n    And {step}\n"
        ));
    }
    let (outcome, report) = run_feature("delivered.feature", &text, 1);
    assert_eq!((outcome.passed, outcome.failed.len()), (0, cases.len()), "{report}");
    let parts: Vec<&str> = report.split("  ✗ ").skip(1).collect();
    let failures: Vec<&&str> = parts.iter().filter(|part| part.contains("expected: ")).collect();
    assert_eq!(failures.len(), cases.len(), "{report}");
    for ((step, found), part) in cases.iter().zip(failures) {
        let expected = format!("expected: {step}");
        assert!(part.contains(&expected) && part.contains(found), "{step}: {found} in\n{part}");
        assert!(part.contains("amber        r1 has ended navto_lab"), "the events are missing:\n{part}");
    }
}

/// Invalid steps are reported with the reason.
#[test]
fn invalid_steps_are_reported() {
    let cases = [
        (r#"Given a robot amber at "Moon""#, "When 1 s pass", "there is no place \"Moon\" on map hospital"),
        (r#"Given the map "moon.yaml""#, "When 1 s pass", "moon.yaml: No such file"),
        (r#"Given a robot amber at "Dock""#, r#"When amber is told to drive to "Moon""#, "Moon"),
        (r#"Given a robot amber at "Dock""#, "When birch is told to dock", "there is no robot birch; there are: amber"),
        (
            r#"Given a robot amber at "Dock""#,
            "When node birch is killed",
            "there is no running node birch; there are: amber, world",
        ),
        ("Given seed 7", "When the fleet runs until there is a coordinator", "no node runs"),
        (
            r#"Given a robot amber at "Dock""#,
            r#"When the mission "dance" is requested"#,
            "missions that come with the program: ",
        ),
        (
            "Given these robots:\n      | name | colour |\n      | amber | red |",
            "When 1 s pass",
            "there is no column \"colour\"; there are name, ",
        ),
        (
            r#"Given the nurse in "IC Room 6" cancels once approached"#,
            "When 1 s pass",
            "there is no person at \"IC Room 6\"",
        ),
    ];
    for (index, (given, when, expected)) in cases.iter().enumerate() {
        let text = format!("Feature: Invalid\n  Scenario: S\n    {given}\n    {when}\n");
        let (outcome, report) = run_feature(&format!("invalid-{index}.feature"), &text, 1);
        assert!(outcome.failed.len() == 1 && report.contains(expected), "{given}, {when}: {expected:?} in\n{report}");
    }
}

#[test]
fn a_scenario_may_not_mix_missions_and_direct_goals() {
    let text = "Feature: Both\n  Scenario: S\n    Given a robot amber at \"Dock\"\n    When amber is told to drive to \"Crossing\"\n    \
                And a sample is requested from \"IC Room 6\"\n";
    let (_, report) = run_feature("both.feature", text, 1);
    assert!(report.contains("the scenario sent a goal to amber: its node would cancel that"), "{report}");
}

/// A seed determines the run, whatever else runs in parallel.
#[test]
fn a_seed_determines_the_run() {
    let text = "Feature: Seeds\n  Scenario: S\n    Given a robot amber at \"IC Room 4\"\n    And an arm lab-arm at \"Laboratory\"\n    \
                And a station post\n    And a nurse in \"IC Room 6\"\n    When a sample is requested from \"IC Room 6\"\n    \
                And the fleet runs until the mission is completed\n    Then there is no coordinator\n";
    let events = |seed| {
        let report = run_feature(&format!("seed-{seed}.feature"), text, seed).1;
        report.lines().filter(|line| line.contains(" s  ")).map(str::to_owned).collect::<Vec<_>>()
    };
    let (first, again, different) = (events(7), events(7), events(8));
    assert!(first.len() > 20, "{first:#?}");
    assert_eq!(first, again);
    assert_ne!(first, different);
}

#[test]
fn an_unexpected_rejection_fails_the_scenario() {
    let given = "Feature: Refused\n  Scenario: S\n    Given a robot amber at \"Dock\"\n    And a station post\n    \
                 When a sample is requested from \"IC Rom 6\"\n    Then ";
    let why = "sample-1 was refused: mission lab-samples has 1 problem";
    for (then, passes, expected) in [
        (r#"the request was refused because "did you mean `IC Room 6`?""#, true, ""),
        (r#"the request was refused because "no robot""#, false, "found: mission lab-samples has 1 problem"),
        ("the mission is pending", false, why),
        ("there is a coordinator", false, why),
    ] {
        let (outcome, report) = run_feature("refused.feature", &format!("{given}{then}\n"), 1);
        assert_eq!(outcome.passed == 1, passes, "{then}\n{report}");
        assert!(report.contains(expected), "{then}: {expected:?} in\n{report}");
    }
}

/// Otherwise a scenario could pass without any check.
#[test]
fn a_planned_action_that_never_happens_fails_the_scenario() {
    let text = "Feature: Never\n  Scenario: S\n    Given stations aster and basil\n    And the coordinator is killed when task dance has begun\n    \
                When the fleet runs for 10 s\n    Then there is a coordinator\n";
    let (outcome, report) = run_feature("never.feature", text, 1);
    assert!(
        report.contains("an action is planned for when task dance has begun, but that has not happened"),
        "{report}"
    );
    assert_eq!(outcome.failed.len(), 1, "{report}");
}
