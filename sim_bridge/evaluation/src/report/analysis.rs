//! Statistical tests of the questions of thesis 4.1.1.

use super::super::design::MissionPhase;
use super::super::outcome::EndState;
use super::super::policy::Policy;
use super::super::results::{Treatment, TrialRow};
use super::super::stats::{
    Alternative, ConfidenceInterval, EffectSize, PermutationTest, StatsError, TTest, hedges_g, hedges_g_paired, paired,
    permute_paired, permute_two_samples, risk_difference, welch, wilson,
};
use consort_protocol::ids::TaskId;
use serde::Serialize;
use std::collections::BTreeMap;

/// Number of rearrangements of each permutation test: the standard error of p is then 0.0015 at p =
/// 0.05.
const DRAWS: u32 = 20_000;

/// End states of the trials of a policy under a treatment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialTally {
    /// The policy.
    pub policy: Policy,
    /// The treatment.
    pub treatment: Treatment,
    /// Number of trials.
    pub trials: usize,
    /// Number of trials by end state, in the order of [`EndState::ALL`].
    pub ended: [usize; 5],
    /// Confidence interval of the success rate.
    pub success: Option<ConfidenceInterval>,
    /// Times to conclude, in seconds.
    #[serde(skip)]
    pub ttc_s: Vec<f64>,
}

impl TrialTally {
    /// Returns the number of successes.
    pub fn successes(&self) -> usize {
        self.ended[0]
    }
}

/// Counts the trials by policy and treatment, in the order of their first occurrence.
pub fn tallies(rows: &[TrialRow]) -> Vec<TrialTally> {
    let mut tallies: Vec<TrialTally> = vec![];
    for row in rows {
        let known = tallies.iter().position(|tally| (tally.policy, tally.treatment) == (row.policy, row.treatment));
        let index = known.unwrap_or_else(|| {
            let (policy, treatment) = (row.policy, row.treatment);
            tallies.push(TrialTally { policy, treatment, trials: 0, ended: [0; 5], success: None, ttc_s: vec![] });
            tallies.len() - 1
        });
        let tally = &mut tallies[index];
        tally.trials += 1;
        let state = EndState::ALL.iter().position(|state| *state == row.end_state).unwrap_or(0);
        tally.ended[state] += 1;
        tally.ttc_s.extend(row.ttc_s);
    }
    for tally in &mut tallies {
        tally.success = wilson(tally.ended[0], tally.trials).ok();
    }
    tallies
}

/// Trials that reached a phase, and those that failed in it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct PhaseTally {
    /// The phase.
    pub phase: String,
    /// Number of trials that reached it.
    pub executed: usize,
    /// Number of trials that failed in it.
    pub failed: usize,
}

/// The phases of the trials of a policy under a treatment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct TalliedPhases {
    /// The policy.
    pub policy: Policy,
    /// The treatment.
    pub treatment: Treatment,
    /// The phases in their order; the first is that before the first task.
    pub phases: Vec<PhaseTally>,
}

/// Counts the failures by phase, as in thesis Table 4.1: a trial fails in the phase of the last
/// task that it began. Empty without phases.
pub(crate) fn phases(rows: &[TrialRow], tallies: &[TrialTally], phases: &[MissionPhase]) -> Vec<TalliedPhases> {
    if phases.is_empty() {
        return vec![];
    }
    let of_tally = |tally: &TrialTally| {
        let (policy, treatment) = (tally.policy, tally.treatment);
        let failures = rows
            .iter()
            .filter(|row| (row.policy, row.treatment) == (policy, treatment) && row.end_state != EndState::Success);
        // Index 0 is the phase before the first task.
        let index = |task: &TaskId| phases.iter().position(|phase| phase.tasks.contains(task)).map_or(0, |at| at + 1);
        let mut failed = vec![0; phases.len() + 1];
        for row in failures {
            failed[row.last_task.as_ref().map_or(0, index)] += 1;
        }
        let mut executed = tally.trials;
        let names = std::iter::once("before the first task").chain(phases.iter().map(|phase| phase.name.as_str()));
        let counted = names.zip(failed).map(|(phase, failed)| {
            let tally = PhaseTally { phase: phase.to_owned(), executed, failed };
            executed -= failed;
            tally
        });
        TalliedPhases { policy, treatment, phases: counted.collect() }
    };
    tallies.iter().map(of_tally).collect()
}

/// The tests of a hypothesis: a t-test, a permutation test and the effect size. A test that could
/// not be computed contains the reason.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct HypothesisTests {
    /// The hypothesis, in words.
    pub hypothesis: &'static str,
    /// The t-test: paired for counts per scenario, Welch's for times.
    #[serde(serialize_with = "serialize_result")]
    pub t: Result<TTest, StatsError>,
    /// The permutation test.
    #[serde(serialize_with = "serialize_result")]
    pub permutation: Result<PermutationTest, StatsError>,
    /// The effect size.
    #[serde(serialize_with = "serialize_result")]
    pub effect: Result<EffectSize, StatsError>,
}

fn serialize_result<T: Serialize, S: serde::Serializer>(
    found: &Result<T, StatsError>,
    to: S,
) -> Result<S::Ok, S::Error> {
    match found {
        Ok(value) => value.serialize(to),
        Err(why) => to.collect_str(why),
    }
}

/// Comparison of two policies, on trials without fault injection.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Comparison {
    /// The first policy.
    pub first: Policy,
    /// The second policy.
    pub second: Policy,
    /// Success rate of the first policy minus that of the second, with its confidence interval.
    pub gain: Option<(f64, ConfidenceInterval)>,
    /// Tests for successes, battery failures and times to conclude.
    pub tests: Vec<HypothesisTests>,
}

/// Compares the first policy with each other policy.
pub(crate) fn comparisons(rows: &[TrialRow], seed: u64) -> Vec<Comparison> {
    let calm: Vec<&TrialRow> = rows.iter().filter(|row| row.treatment == Treatment::Calm).collect();
    let mut policies: Vec<Policy> = vec![];
    for row in &calm {
        if !policies.contains(&row.policy) {
            policies.push(row.policy);
        }
    }
    let Some((first, others)) = policies.split_first() else { return vec![] };
    others.iter().map(|second| compare(&calm, *first, *second, seed)).collect()
}

fn compare(rows: &[&TrialRow], first: Policy, second: Policy, seed: u64) -> Comparison {
    let of = |policy| rows.iter().copied().filter(move |row| row.policy == policy);
    let counts = |state| [first, second].map(|policy| per_scenario(of(policy), state));
    let times = [first, second].map(|policy| of(policy).filter_map(|row| row.ttc_s).collect::<Vec<f64>>());
    let paired_tests = |hypothesis, [a, b]: [Vec<f64>; 2], alternative| HypothesisTests {
        hypothesis,
        t: paired(&a, &b, alternative),
        permutation: permute_paired(&a, &b, alternative, DRAWS, seed),
        effect: hedges_g_paired(&a, &b),
    };
    let total = |policy| {
        let successes = of(policy).filter(|row| row.end_state == EndState::Success).count();
        (successes, of(policy).count())
    };
    let [a, b] = times;
    let tests = vec![
        paired_tests("more successes per scenario", counts(EndState::Success), Alternative::Greater),
        paired_tests("fewer battery failures per scenario", counts(EndState::LowBattery), Alternative::Less),
        HypothesisTests {
            hypothesis: "shorter time to conclude, in seconds",
            t: welch(&a, &b, Alternative::Less),
            permutation: permute_two_samples(&a, &b, Alternative::Less, DRAWS, seed),
            effect: hedges_g(&a, &b),
        },
    ];
    Comparison { first, second, gain: risk_difference(total(first), total(second)).ok(), tests }
}

/// Counts the trials with an end state, scenario by scenario.
pub(crate) fn per_scenario<'r>(rows: impl Iterator<Item = &'r TrialRow>, state: EndState) -> Vec<f64> {
    let mut counts: BTreeMap<&str, f64> = BTreeMap::new();
    for row in rows {
        *counts.entry(&row.scenario).or_default() += if row.end_state == state { 1.0 } else { 0.0 };
    }
    counts.into_values().collect()
}

/// The name of a factor, and the function that returns its level in a row.
pub(super) type FactorLevel = (&'static str, fn(&TrialRow) -> &str);

/// Returns the factors with more than a single level in these rows.
pub(super) fn factors(rows: &[TrialRow]) -> Vec<FactorLevel> {
    let all: [FactorLevel; 5] = [
        ("speed", |row| &row.speed),
        ("charge", |row| &row.charge),
        ("discharge", |row| &row.discharge),
        ("location", |row| &row.location),
        ("skills", |row| &row.skills),
    ];
    let has_several_levels =
        |level: &fn(&TrialRow) -> &str| rows.windows(2).any(|two| level(&two[0]) != level(&two[1]));
    all.into_iter().filter(|(_, level)| has_several_levels(level)).collect()
}
