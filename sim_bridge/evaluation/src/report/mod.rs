//! The report of an evaluation: Markdown, figures, and the statistics as JSON. It depends on the
//! rows alone, so it can be created again at any time.

mod analysis;
mod calibration_gain;
mod figures;
mod markdown;

pub use analysis::{Comparison, HypothesisTests, TrialTally, comparisons, per_scenario, tallies};
pub use calibration_gain::CalibrationGain;

use super::outcome::EndState;
use super::policy::Policy;
use super::results::{Treatment, TrialRow};
use std::collections::BTreeMap;

/// Origin of the rows, for the head of a report.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportHeader {
    /// The design's name.
    pub design: String,
    /// Its seed.
    pub seed: u64,
    /// The map.
    pub map: String,
    /// The travel model, in words.
    pub travel: String,
    /// World seconds per second of the fleet's time.
    pub world_speed: f64,
}

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
pub fn report(heading: &ReportHeader, rows: &[TrialRow], gain: Option<&CalibrationGain>) -> Vec<ReportFile> {
    let tallies = tallies(rows);
    let comparisons = comparisons(rows, heading.seed);
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
    let statistics = serde_json::json!({ "tallies": tallies, "comparisons": comparisons });
    let text = serde_json::to_string_pretty(&statistics).expect("statistics are plain data") + "\n";
    files.push(ReportFile { name: "statistics.json".to_owned(), text });
    let text = markdown::text(heading, rows, &tallies, &comparisons, &links, gain);
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
mod tests;
