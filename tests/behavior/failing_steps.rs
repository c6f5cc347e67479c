//! Steps that do not hold fail, and say what was found instead.

use consort_tests::behavior::{FeatureOutcome, Features, RunOptions, ScenarioFilter, run};
use std::path::PathBuf;

/// Plays a feature: what came of it, and what was said.
pub(super) fn play(name: &str, text: &str, seed: u64) -> (FeatureOutcome, String) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("failing");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let file = folder.join(name);
    std::fs::write(&file, text).expect("cargo's own folder");
    let features = Features::read(&[file], &ScenarioFilter::default()).unwrap_or_else(|bad| panic!("{bad}"));
    let mut told = vec![];
    let outcome = run(features, &RunOptions { seed, jobs: 2, steps: false, colours: false }, &mut told);
    (outcome, String::from_utf8(told).expect("our own words"))
}

/// A delivery, and one expectation each that does not come true, with what is said of it.
#[test]
fn what_is_not_so_after_a_delivery_is_told() {
    let wrong = [
        ("the mission is failed", "found: is completed"),
        (r#"the mission has failed because "no route""#, "found: is completed"),
        (r#"the mission needs rescue because "lost""#, "found: is completed"),
        (r#"the mission was canceled by "ward 3""#, "found: is completed"),
        ("mission other is completed", "but: mission other was not asked for; asked for: sample-1"),
        ("it is not so that the mission is over", "found: it is so"),
        ("it is not so that all missions are completed", "found: it is so"),
        ("lab-arm is r1 of the mission", "found: "),
        ("amber never had a role in the mission", "found: roles were given to amber, lab-arm"),
        ("birch never had a role in the mission", "but: there is no robot birch; there are: amber, lab-arm"),
        ("task dance has begun", "found: it has not begun"),
        ("task navto_lab has begun 2 times", "found: it has begun 1 times: amber"),
        ("task dance has ended", "found: it has not ended"),
        ("lab-arm did task navto_lab", "found: amber did"),
        (r#"r1 was taken from a robot because "battery""#, "found: it was taken from one because … nothing"),
        (r#"amber did not get r1 because "lacks""#, "found: it did not because of: nothing: it bid"),
        (r#"amber tried again because "closed""#, "found: it tried again because … nothing"),
        ("nobody coordinates", "found: "),
        ("node amber coordinates", "found: "),
        ("somebody else coordinates", "but: no coordinator has died or was cut off"),
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
        ("for 20 s it is never so that the mission is completed", "found: it is so"),
        (r#"the request was refused because "no such place""#, "found: no request was refused"),
        ("amber has done what it was told", "but: amber was told nothing by this scenario"),
        ("amber sees lab-arm", "but: amber has no such sensor"),
        ("amber measures 2 m ahead", "but: amber has no range sensor"),
        (r#"amber waits at "Gate""#, "but: there is no door or lift \"Gate\" on this map"),
    ];
    let mut text = "Feature: Delivered\n".to_owned();
    for (index, (step, _)) in wrong.iter().enumerate() {
        text.push_str(&format!(
            "  Scenario: {index}\n    Given a robot amber at \"IC Room 4\"\n    And an arm lab-arm at \"Laboratory\"\n    \
             And a station post\n    And a nurse in \"IC Room 6\"\n    When a sample is requested from \"IC Room 6\"\n    \
             Then within 10 minutes the mission is completed\n    And {step}\n"
        ));
    }
    let (outcome, told) = play("delivered.feature", &text, 1);
    assert_eq!((outcome.passed, outcome.failed.len()), (0, wrong.len()), "{told}");
    let parts: Vec<&str> = told.split("  ✗ ").skip(1).collect();
    let failures: Vec<&&str> = parts.iter().filter(|part| part.contains("expected: ")).collect();
    assert_eq!(failures.len(), wrong.len(), "{told}");
    for ((step, found), part) in wrong.iter().zip(failures) {
        let expected = format!("expected: {step}");
        assert!(part.contains(&expected) && part.contains(found), "{step}: {found} in\n{part}");
        assert!(part.contains("amber        r1 has ended navto_lab"), "the story is told:\n{part}");
    }
}

/// What makes no sense is said, too, at its step.
#[test]
fn what_makes_no_sense_is_told() {
    let wrong = [
        (r#"Given a robot amber at "Moon""#, "When 1 s pass", "there is no place \"Moon\" on map hospital"),
        (r#"Given the map "moon.yaml""#, "When 1 s pass", "moon.yaml: No such file"),
        (r#"Given a robot amber at "Dock""#, r#"When amber is told to drive to "Moon""#, "Moon"),
        (r#"Given a robot amber at "Dock""#, "When birch is told to dock", "there is no robot birch; there are: amber"),
        (r#"Given a robot amber at "Dock""#, "When node birch dies", "no node birch runs; there are: amber, world"),
        ("Given seed 7", "When the fleet runs until somebody coordinates", "no node runs"),
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
            "there is nobody at \"IC Room 6\"",
        ),
    ];
    for (index, (given, when, said)) in wrong.iter().enumerate() {
        let text = format!("Feature: Nonsense\n  Scenario: S\n    {given}\n    {when}\n");
        let (outcome, told) = play(&format!("nonsense-{index}.feature"), &text, 1);
        assert!(outcome.failed.len() == 1 && told.contains(said), "{given}, {when}: {said:?} in\n{told}");
    }
}

#[test]
fn a_scenario_asks_for_missions_or_drives_robots_itself() {
    let text = "Feature: Both\n  Scenario: S\n    Given a robot amber at \"Dock\"\n    When amber is told to drive to \"Crossing\"\n    \
                And a sample is requested from \"IC Room 6\"\n";
    let (_, told) = play("both.feature", text, 1);
    assert!(told.contains("amber was told by the scenario what to do: its node would call that off"), "{told}");
}

/// The same seed gives the same run, whatever runs beside it.
#[test]
fn one_seed_gives_one_run() {
    let text = "Feature: Seeds\n  Scenario: S\n    Given a robot amber at \"IC Room 4\"\n    And an arm lab-arm at \"Laboratory\"\n    \
                And a station post\n    And a nurse in \"IC Room 6\"\n    When a sample is requested from \"IC Room 6\"\n    \
                And the fleet runs until the mission is completed\n    Then nobody coordinates\n";
    let story = |seed| {
        let told = play(&format!("seed-{seed}.feature"), text, seed).1;
        told.lines().filter(|line| line.contains(" s  ")).map(str::to_owned).collect::<Vec<_>>()
    };
    let (one, again, other) = (story(7), story(7), story(8));
    assert!(one.len() > 20, "{one:#?}");
    assert_eq!(one, again);
    assert_ne!(one, other);
}

#[test]
fn a_request_that_was_refused_fails_a_scenario_that_does_not_reckon_with_it() {
    let given = "Feature: Refused\n  Scenario: S\n    Given a robot amber at \"Dock\"\n    And a station post\n    \
                 When a sample is requested from \"IC Rom 6\"\n    Then ";
    let why = "sample-1 was refused: mission lab-samples has 1 problem";
    for (then, passes, says) in [
        (r#"the request was refused because "did you mean `IC Room 6`?""#, true, ""),
        (r#"the request was refused because "no robot""#, false, "found: mission lab-samples has 1 problem"),
        ("the mission is pending", false, why),
        ("somebody coordinates", false, why),
    ] {
        let (outcome, told) = play("refused.feature", &format!("{given}{then}\n"), 1);
        assert_eq!(outcome.passed == 1, passes, "{then}\n{told}");
        assert!(told.contains(says), "{then}: {says:?} in\n{told}");
    }
}

/// Else a scenario would show nothing, and nobody would see it.
#[test]
fn what_was_arranged_and_did_not_come_about_fails() {
    let text = "Feature: Never\n  Scenario: S\n    Given stations aster and basil\n    And the coordinator dies when task dance has begun\n    \
                When the fleet runs for 10 s\n    Then somebody coordinates\n";
    let (outcome, told) = play("never.feature", text, 1);
    assert!(told.contains("it was said what happens when task dance has begun, and that has not come about"), "{told}");
    assert_eq!(outcome.failed.len(), 1, "{told}");
}
