//! The Markdown text of a report.

use super::super::design::MissionPhase;
use super::super::outcome::EndState;
use super::super::policy::Policy;
use super::super::results::{Treatment, TrialRow};
use super::super::stats::{ConfidenceInterval, Summary, risk_difference};
use super::analysis;
use super::analysis::{Comparison, HypothesisTests, PhaseTally, TalliedPhases, TrialTally, tallies};
use super::calibration_gain::CalibrationGain;
use consort_text::count;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

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
    /// The phases of the mission.
    pub phases: Vec<MissionPhase>,
}

/// The content of a report.
pub(super) struct ReportContent<'a> {
    pub(super) header: &'a ReportHeader,
    pub(super) rows: &'a [TrialRow],
    pub(super) tallies: &'a [TrialTally],
    pub(super) phases: &'a [TalliedPhases],
    pub(super) comparisons: &'a [Comparison],
    /// Links to the figures by name, or the reason why a figure is not drawn.
    pub(super) links: &'a BTreeMap<String, String>,
    pub(super) gain: Option<&'a CalibrationGain>,
}

impl ReportContent<'_> {
    /// Returns the report as Markdown.
    pub(super) fn text(&self) -> String {
        let &ReportContent { header, rows, tallies, phases, comparisons, links, gain } = self;
        let mut text = String::new();
        let link = |name: &str| links.get(name).cloned().unwrap_or_default();
        let scenarios: BTreeSet<&str> = rows.iter().map(|row| row.scenario.as_str()).collect();
        let ReportHeader { design, seed, map, travel, world_speed, .. } = header;
        let mut push_line = |line: &str| {
            text.push_str(line);
            text.push('\n');
        };
        push_line(&format!("# Evaluation: {design}\n"));
        push_line(&format!(
            "{} in {} on the map {map}; seed {seed}; drives: {travel}; {world_speed} world seconds per \
             second of the fleet's time. End states and times to conclude as in thesis 4.1.2; confidence level of all intervals: 95 %.\n",
            count(rows.len(), "trial", "trials"),
            count(scenarios.len(), "scenario", "scenarios"),
        ));
        push_line("## End states\n");
        push_line(&ends_table(tallies));
        push_line(&format!("{}\n", link("end-states")));
        push_line(&format!("{}\n", link("successes")));
        if !phases.is_empty() {
            push_line("## Failures by phase\n");
            push_line("A trial fails in the phase of the last task that it began (thesis, Table 4.1).\n");
            push_line(&phases_table(phases));
        }
        push_line("## Time to conclude\n");
        push_line(&times_table(tallies));
        push_line(&format!("{}\n", link("ttc")));
        for (factor, _) in analysis::factors(rows) {
            push_line(&format!("{}\n", link(&format!("ttc-by-{factor}"))));
        }
        if !comparisons.is_empty() {
            push_line("## Comparison of policies\n");
            push_line(
                "Successes and battery failures are counted per scenario and paired; times are those of successful trials. \
                 Each test is one-sided; the interval of the difference is two-sided.\n",
            );
            for comparison in comparisons {
                push_line(&comparison_text(comparison));
            }
        }
        if tallies.iter().any(|tally| tally.treatment == Treatment::CoordinatorKilled) {
            push_line("## With the coordinator killed\n");
            push_line(&fault_table(tallies));
        }
        if let Some(gain) = gain {
            push_line("## Effect of calibration\n");
            push_line(&gain_text(gain));
        }
        text
    }
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

fn percents(interval: &ConfidenceInterval) -> String {
    format!("{:.1} to {:.1} %", interval.low * 100.0, interval.high * 100.0)
}

fn ends_table(tallies: &[TrialTally]) -> String {
    let mut text = "| policy | treatment | trials |".to_owned();
    for state in EndState::ALL {
        let _ = write!(text, " {state} |");
    }
    text.push_str(" success | interval |\n|---|---|---:|---:|---:|---:|---:|---:|---:|---|\n");
    for tally in tallies {
        let _ = write!(text, "| {} | {} | {} |", tally.policy, tally.treatment.as_str(), tally.trials);
        for count in tally.ended {
            let _ = write!(text, " {count} |");
        }
        let share = tally.successes() as f64 / tally.trials.max(1) as f64;
        let interval = tally.success.as_ref().map(percents).unwrap_or_default();
        let _ = writeln!(text, " {} | {interval} |", percent(share));
    }
    text
}

fn phases_table(tallied: &[TalliedPhases]) -> String {
    let mut text =
        "| policy | treatment | phase | executed | failures | share |\n|---|---|---|---:|---:|---:|\n".to_owned();
    for TalliedPhases { policy, treatment, phases } in tallied {
        for PhaseTally { phase, executed, failed } in phases {
            let share = percent(*failed as f64 / (*executed).max(1) as f64);
            let treatment = treatment.as_str();
            let _ = writeln!(text, "| {policy} | {treatment} | {phase} | {executed} | {failed} | {share} |");
        }
    }
    text
}

fn times_table(tallies: &[TrialTally]) -> String {
    let mut text =
        "| policy | treatment | successes | mean, s | sd | median | quartiles |\n|---|---|---:|---:|---:|---:|---|\n"
            .to_owned();
    for tally in tallies {
        let _ = write!(text, "| {} | {} |", tally.policy, tally.treatment.as_str());
        let _ = match Summary::of(&tally.ttc_s) {
            Some(Summary { count, mean, sd, median, q1, q3, .. }) => {
                writeln!(text, " {count} | {mean:.1} | {sd:.1} | {median:.1} | {q1:.1} to {q3:.1} |")
            }
            None => writeln!(text, " 0 | | | | |"),
        };
    }
    text
}

fn p_value(p: f64) -> String {
    if p < 0.0001 { "< 0.0001".to_owned() } else { format!("{p:.4}") }
}

fn comparison_text(comparison: &Comparison) -> String {
    let Comparison { first, second, gain, tests } = comparison;
    let mut text = format!("### {first} against {second}\n\n");
    if let Some((gain, interval)) = gain {
        let points = |share: f64| share * 100.0;
        let _ = writeln!(
            text,
            "Share of successes: {:+.1} points ({:+.1} to {:+.1}, Newcombe).\n",
            points(*gain),
            points(interval.low),
            points(interval.high)
        );
    }
    text.push_str("| hypothesis | difference | t | p | permutation p | effect g |\n|---|---|---:|---:|---:|---|\n");
    for test in tests {
        let _ = writeln!(text, "| {} | {} |", test.hypothesis, test_cells(test));
    }
    text
}

fn test_cells(test: &HypothesisTests) -> String {
    let t = match &test.t {
        Ok(t) => format!(
            "{:.3} ({:.3} to {:.3}) | {:.2} (df {:.1}) | {}",
            t.difference,
            t.interval.low,
            t.interval.high,
            t.t,
            t.degrees_of_freedom,
            p_value(t.p)
        ),
        Err(why) => format!("{why} | | "),
    };
    let permutation = test.permutation.as_ref().map_or(String::new(), |found| p_value(found.p));
    let effect = match &test.effect {
        Ok(effect) => format!("{:.2} ({:.2} to {:.2})", effect.g, effect.interval.low, effect.interval.high),
        Err(_) => String::new(),
    };
    format!("{t} | {permutation} | {effect}")
}

fn fault_table(tallies: &[TrialTally]) -> String {
    let mut text =
        "| policy | success without | success with | difference, points | interval |\n|---|---:|---:|---:|---|\n"
            .to_owned();
    let of =
        |policy: Policy, treatment| tallies.iter().find(|tally| (tally.policy, tally.treatment) == (policy, treatment));
    for killed in tallies.iter().filter(|tally| tally.treatment == Treatment::CoordinatorKilled) {
        let share = |tally: &TrialTally| tally.successes() as f64 / tally.trials.max(1) as f64;
        let calm = of(killed.policy, Treatment::Calm);
        let difference = calm.and_then(|calm| {
            risk_difference((killed.successes(), killed.trials), (calm.successes(), calm.trials)).ok()
        });
        let without = calm.map(|calm| percent(share(calm))).unwrap_or_default();
        let cells = difference.map_or(" | ".to_owned(), |(difference, interval)| {
            let points = |share: f64| share * 100.0;
            format!("{:+.2} | {:+.1} to {:+.1}", points(difference), points(interval.low), points(interval.high))
        });
        let _ = writeln!(text, "| {} | {without} | {} | {cells} |", killed.policy, percent(share(killed)));
    }
    text
}

fn gain_text(gain: &CalibrationGain) -> String {
    let mut text = format!(
        "Calibrated with {}; the other trials were run twice: with uncorrected estimates, and with mean times and, \
         for the battery, the {:.0} % quantile of the observations.\n\n",
        count(gain.trials, "trial", "trials"),
        gain.calibration.quantile * 100.0
    );
    text.push_str("| estimates | trials | success | battery failures | mean TTC, s | error of a drive, s | drives within their energy |\n|---|---:|---:|---:|---:|---:|---:|\n");
    for (name, rows, observed) in
        [("uncorrected", &gain.before, &gain.observed_before), ("calibrated", &gain.after, &gain.observed_after)]
    {
        // All rows have the same policy and treatment: a single tally.
        for tally in tallies(rows) {
            let share = tally.successes() as f64 / tally.trials.max(1) as f64;
            let ttc = Summary::of(&tally.ttc_s).map_or(String::new(), |summary| format!("{:.1}", summary.mean));
            let (error, _) = CalibrationGain::mean_drive_error_s(observed);
            let _ = writeln!(
                text,
                "| {name} | {} | {} | {} | {ttc} | {error:.1} | {} |",
                tally.trials,
                percent(share),
                tally.ended[2],
                percent(CalibrationGain::share_within_budget(observed))
            );
        }
    }
    text.push_str("\n| skill | observations | mean factor | sd | upper quantile |\n|---|---:|---:|---:|---:|\n");
    for (skill, factor) in &gain.calibration.skills {
        let _ = writeln!(
            text,
            "| {skill} | {} | {:.2} | {:.2} | {:.2} |",
            factor.count, factor.mean, factor.sd, factor.upper
        );
    }
    text.push_str("\n| leg | observations | mean factor | sd | upper quantile |\n|---|---:|---:|---:|---:|\n");
    for leg in &gain.calibration.legs {
        let factor = &leg.factor;
        let _ = writeln!(
            text,
            "| {} – {} | {} | {:.2} | {:.2} | {:.2} |",
            leg.from, leg.to, factor.count, factor.mean, factor.sd, factor.upper
        );
    }
    text
}
