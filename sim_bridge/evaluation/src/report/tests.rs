//! Tests of reports on synthetic rows.

use super::super::outcome::EndState;
use super::*;

fn row(scenario: usize, policy: Policy, treatment: Treatment, repetition: u32) -> TrialRow {
    let good = match policy {
        Policy::Consort => repetition < 8,
        _ => (scenario + repetition as usize).is_multiple_of(2),
    };
    let end_state = if good { EndState::Success } else { EndState::LowBattery };
    let ttc_s = good.then(|| {
        200.0 + 10.0 * scenario as f64 + f64::from(repetition) + if policy == Policy::Random { 40.0 } else { 0.0 }
    });
    TrialRow {
        trial: format!("{scenario}/{policy}/{repetition}"),
        mission: "lab-samples".to_owned(),
        scenario: format!("s{scenario}"),
        speed: "a".to_owned(),
        charge: ["a", "b"][scenario % 2].to_owned(),
        discharge: "a".to_owned(),
        location: "a".to_owned(),
        skills: "a".to_owned(),
        policy,
        treatment,
        repetition,
        end_state,
        ttc_s,
        predicted_s: Some(200.0),
        lowest_share: Some(0.3),
        robots: "r1=r2".to_owned(),
        note: String::new(),
    }
}

fn rows(treatments: &[Treatment]) -> Vec<TrialRow> {
    let mut rows = vec![];
    for scenario in 0..6 {
        for policy in [Policy::Consort, Policy::Random] {
            for treatment in treatments {
                rows.extend((1..=8).map(|repetition| row(scenario, policy, *treatment, repetition)));
            }
        }
    }
    rows
}

fn heading() -> ReportHeader {
    ReportHeader {
        design: "thin".to_owned(),
        seed: 7,
        map: "hospital".to_owned(),
        travel: "kinematic".to_owned(),
        world_speed: 20.0,
    }
}

#[test]
fn the_report_contains_all_figures_and_tests() {
    let files = report(&heading(), &rows(&[Treatment::Calm, Treatment::CoordinatorKilled]), None);
    let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(
        names,
        ["report.md", "end-states.svg", "successes.svg", "ttc.svg", "ttc-by-charge.svg", "statistics.json"]
    );
    for file in files.iter().filter(|file| file.name.ends_with(".svg")) {
        assert!(file.text.starts_with("<svg") && file.text.ends_with("</svg>\n"), "{}", file.name);
        assert!(file.text.matches("<rect").count() + file.text.matches("<polygon").count() > 4, "{}", file.name);
    }
    let text = &files[0].text;
    for part in [
        "| consort | calm | 48 | 42 | 0 | 6 | 0 | 0 | 87.5 % | 75.3 to 94.1 % |",
        "### consort against random",
        "| more successes per scenario | 3.000 (3.000 to 3.000) | inf",
        "| fewer battery failures per scenario | -3.000",
        "| shorter time to conclude, in seconds | ",
        "## With the coordinator killed",
        "| consort | 87.5 % | 87.5 % | +0.00 | ",
        "![ttc](ttc.svg)",
    ] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    assert!(!text.contains("not drawn"), "{text}");
}

#[test]
fn a_report_handles_a_single_policy_and_empty_results() {
    let single_policy: Vec<TrialRow> =
        rows(&[Treatment::Calm]).into_iter().filter(|row| row.policy == Policy::Consort).collect();
    let text = &report(&heading(), &single_policy, None)[0].text;
    assert!(!text.contains("Comparison of policies") && !text.contains("With the coordinator killed"), "{text}");
    assert!(report(&heading(), &[], None)[0].text.starts_with("# Evaluation: thin"));
    let failed: Vec<TrialRow> = rows(&[Treatment::Calm])
        .into_iter()
        .map(|row| TrialRow { end_state: EndState::TimeoutSim, ttc_s: None, ..row })
        .collect();
    assert!(report(&heading(), &failed, None)[0].text.contains("are too few for a test"));
}
