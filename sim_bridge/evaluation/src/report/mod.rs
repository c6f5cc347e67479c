//! The report of an evaluation: Markdown, figures, and the statistics as JSON. It depends on the
//! rows alone, so it can be created again at any time.

mod analysis;
mod calibration_gain;
mod figures;
mod markdown;

pub use analysis::{TrialTally, tallies};
use analysis::{comparisons, per_scenario, phases};
pub use calibration_gain::CalibrationGain;
pub use markdown::ReportHeader;

use super::outcome::EndState;
use super::policy::Policy;
use super::results::{Treatment, TrialRow};
use std::collections::BTreeMap;

/// A file of a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReportFile {
    /// Its name.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// Creates the files of a report on rows of a design: `report.md`, its figures, `statistics.json`.
/// With `gain` the report contains the effect of calibration. A figure that cannot be drawn is left
/// out, with the reason in the report.
pub fn report(header: &ReportHeader, rows: &[TrialRow], gain: Option<&CalibrationGain>) -> Vec<ReportFile> {
    let tallies = tallies(rows);
    let phases = phases(rows, &tallies, &header.phases);
    let comparisons = comparisons(rows, header.seed);
    let mut files = vec![];
    let mut links: BTreeMap<String, String> = BTreeMap::new();
    for (name, figure) in figures_of(rows) {
        let link = match figure {
            Ok(text) => {
                let file = format!("{name}.svg");
                files.push(ReportFile { name: file.clone(), text });
                format!("![{name}]({file})")
            }
            Err(problem) => format!("(not drawn: {problem})"),
        };
        links.insert(name, link);
    }
    let statistics = serde_json::json!({ "tallies": tallies, "phases": phases, "comparisons": comparisons });
    let text = serde_json::to_string_pretty(&statistics).expect("statistics are plain data") + "\n";
    files.push(ReportFile { name: "statistics.json".to_owned(), text });
    let content = markdown::ReportContent {
        header,
        rows,
        tallies: &tallies,
        phases: &phases,
        comparisons: &comparisons,
        links: &links,
        gain,
    };
    let text = content.text();
    files.insert(0, ReportFile { name: "report.md".to_owned(), text });
    files
}

/// Draws all figures; returns them with their names.
fn figures_of(rows: &[TrialRow]) -> Vec<(String, figures::Figure)> {
    let mut series: Vec<(Policy, Treatment)> = vec![];
    for row in rows {
        if !series.contains(&(row.policy, row.treatment)) {
            series.push((row.policy, row.treatment));
        }
    }
    let Some(first_treatment) = series.first().map(|(_, treatment)| *treatment) else { return vec![] };
    let has_several_treatments = series.iter().any(|(_, treatment)| *treatment != first_treatment);
    let name = |policy: Policy, treatment: Treatment| {
        if has_several_treatments { format!("{policy}, {}", treatment.as_str()) } else { policy.to_string() }
    };
    let of = |of: (Policy, Treatment)| rows.iter().filter(move |row| (row.policy, row.treatment) == of);

    let panels: Vec<_> = series.iter().map(|key| (name(key.0, key.1), end_state_counts(of(*key)))).collect();
    // The effect of a kill is in a separate table; with all treatments the violins could not be
    // distinguished.
    series.retain(|(_, treatment)| *treatment == first_treatment);
    let successes: Vec<_> =
        series.iter().map(|key| (name(key.0, key.1), per_scenario(of(*key), EndState::Success))).collect();
    let times = |key: &(Policy, Treatment)| of(*key).filter_map(|row| row.ttc_s).collect::<Vec<f64>>();
    let ttc: Vec<_> = series.iter().map(|key| (name(key.0, key.1), times(key))).collect();
    let mut figures = vec![
        ("end-states".to_owned(), figures::stacked(&panels)),
        ("successes".to_owned(), figures::violins("Successes per scenario", "successes", &successes, 0.5)),
        ("ttc".to_owned(), figures::violins("Time to conclude", "seconds", &ttc, 1.0)),
    ];
    let names: Vec<String> = series.iter().map(|(policy, treatment)| name(*policy, *treatment)).collect();
    for (factor, level) in analysis::factors(rows) {
        let mut levels: Vec<&str> = rows.iter().map(level).collect();
        levels.sort_unstable();
        levels.dedup();
        let group = |wanted: &str| {
            let times = |key: &(Policy, Treatment)| {
                of(*key).filter(|row| level(row) == wanted).filter_map(|row| row.ttc_s).collect::<Vec<f64>>()
            };
            (wanted.to_owned(), series.iter().map(times).collect::<Vec<_>>())
        };
        let groups: Vec<_> = levels.into_iter().map(group).collect();
        let title = format!("Time to conclude by {factor}");
        figures.push((format!("ttc-by-{factor}"), figures::boxes(&title, "seconds", &names, &groups)));
    }
    figures
}

/// Counts the trials of each scenario by end state.
fn end_state_counts<'r>(rows: impl Iterator<Item = &'r TrialRow>) -> Vec<[usize; 5]> {
    let mut scenarios: BTreeMap<&str, [usize; 5]> = BTreeMap::new();
    for row in rows {
        let state = EndState::ALL.iter().position(|state| *state == row.end_state).unwrap_or(0);
        scenarios.entry(&row.scenario).or_default()[state] += 1;
    }
    scenarios.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::super::design::MissionPhase;
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
            last_task: Some(if good { "unload" } else { "drive" }.parse().unwrap()),
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

    fn phase(task: &str) -> MissionPhase {
        MissionPhase { name: format!("{task}_phase"), tasks: [task.parse().unwrap()].into() }
    }

    fn heading() -> ReportHeader {
        ReportHeader {
            design: "thin".to_owned(),
            seed: 7,
            map: "hospital".to_owned(),
            travel: "kinematic".to_owned(),
            world_speed: 20.0,
            phases: ["drive", "unload"].map(phase).into(),
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
    fn failures_are_counted_in_the_phase_of_the_last_task() {
        let mut rows = rows(&[Treatment::Calm]);
        rows.retain(|row| row.policy == Policy::Consort);
        // 6 of 48 trials fail in the first phase; one of them now fails before any task, and one in
        // the second phase.
        let failed = |row: &&mut TrialRow| row.end_state != EndState::Success;
        for (row, task) in rows.iter_mut().filter(failed).zip([None, Some("unload")]) {
            row.last_task = task.map(|task| task.parse().unwrap());
        }
        let files = report(&heading(), &rows, None);
        let table = "| consort | calm | before the first task | 48 | 1 | 2.1 % |\n\
                     | consort | calm | drive_phase | 47 | 4 | 8.5 % |\n\
                     | consort | calm | unload_phase | 43 | 1 | 2.3 % |\n";
        assert!(files[0].text.contains(table), "{}", files[0].text);
        let statistics: serde_json::Value = serde_json::from_str(&files.last().unwrap().text).unwrap();
        assert_eq!(
            statistics["phases"][0]["phases"][1],
            serde_json::json!({ "phase": "drive_phase", "executed": 47, "failed": 4 })
        );
        let without = report(&ReportHeader { phases: vec![], ..heading() }, &rows, None);
        assert!(!without[0].text.contains("Failures by phase"), "{}", without[0].text);
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
}
