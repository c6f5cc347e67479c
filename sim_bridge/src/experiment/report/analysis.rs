//! The questions of thesis 4.1.1, asked of rows.

use super::super::outcome::EndState;
use super::super::policy::Policy;
use super::super::results::{Treatment, TrialRow};
use super::super::stats::{
    Alternative, ConfidenceInterval, EffectSize, PermutationTest, StatsError, TTest, hedges_g, hedges_g_paired, paired,
    permute_paired, permute_two_samples, risk_difference, welch, wilson,
};
use serde::Serialize;
use std::collections::BTreeMap;

/// Rearrangements of each permutation test: the standard error of its p is then 0.0015 where it is 0.05.
const DRAWS: u32 = 20_000;

/// How trials of one policy under one treatment ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialTally {
    /// The policy.
    pub policy: Policy,
    /// The treatment.
    pub treatment: Treatment,
    /// How many trials.
    pub trials: usize,
    /// How many ended in each state, in the order of [`EndState::ALL`].
    pub ended: [usize; 5],
    /// Where the share of successes lies.
    pub success: Option<ConfidenceInterval>,
    /// Times to conclude, in seconds.
    #[serde(skip)]
    pub ttc_s: Vec<f64>,
}

impl TrialTally {
    /// How many succeeded.
    pub fn successes(&self) -> usize {
        self.ended[0]
    }
}

/// Trials by policy and treatment, in the order in which these first come up.
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

/// One question: a t-test, a permutation test beside it, and how large the effect is. What cannot be told says why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HypothesisTests {
    /// What is asked, in words.
    pub asked: &'static str,
    /// The t-test: paired for counts per scenario, Welch's for times.
    #[serde(serialize_with = "told")]
    pub t: Result<TTest, StatsError>,
    /// The permutation test.
    #[serde(serialize_with = "told")]
    pub permutation: Result<PermutationTest, StatsError>,
    /// The effect size.
    #[serde(serialize_with = "told")]
    pub effect: Result<EffectSize, StatsError>,
}

fn told<T: Serialize, S: serde::Serializer>(found: &Result<T, StatsError>, to: S) -> Result<S::Ok, S::Error> {
    match found {
        Ok(value) => value.serialize(to),
        Err(why) => to.collect_str(why),
    }
}

/// One policy against another, calm trials alone.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The one.
    pub first: Policy,
    /// The other.
    pub second: Policy,
    /// Share of successes of the one minus that of the other, and where that lies.
    pub gain: Option<(f64, ConfidenceInterval)>,
    /// Successes, battery failures, times to conclude.
    pub questions: Vec<HypothesisTests>,
}

/// The first policy against each other one.
pub fn comparisons(rows: &[TrialRow], seed: u64) -> Vec<Comparison> {
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
    let in_pairs = |asked, [a, b]: [Vec<f64>; 2], alternative| HypothesisTests {
        asked,
        t: paired(&a, &b, alternative),
        permutation: permute_paired(&a, &b, alternative, DRAWS, seed),
        effect: hedges_g_paired(&a, &b),
    };
    let total = |policy| {
        let successes = of(policy).filter(|row| row.end_state == EndState::Success).count();
        (successes, of(policy).count())
    };
    let [a, b] = times;
    let questions = vec![
        in_pairs("more successes per scenario", counts(EndState::Success), Alternative::Greater),
        in_pairs("fewer battery failures per scenario", counts(EndState::LowBattery), Alternative::Less),
        HypothesisTests {
            asked: "shorter time to conclude, in seconds",
            t: welch(&a, &b, Alternative::Less),
            permutation: permute_two_samples(&a, &b, Alternative::Less, DRAWS, seed),
            effect: hedges_g(&a, &b),
        },
    ];
    Comparison { first, second, gain: risk_difference(total(first), total(second)).ok(), questions }
}

/// How many trials ended in a state, scenario by scenario.
pub fn per_scenario<'r>(rows: impl Iterator<Item = &'r TrialRow>, state: EndState) -> Vec<f64> {
    let mut counts: BTreeMap<&str, f64> = BTreeMap::new();
    for row in rows {
        *counts.entry(&row.scenario).or_default() += if row.end_state == state { 1.0 } else { 0.0 };
    }
    counts.into_values().collect()
}

/// A factor's name, and how to read a row's level of it.
pub(super) type FactorLevel = (&'static str, fn(&TrialRow) -> &str);

/// The factors with more than one level in these rows.
pub(super) fn factors(rows: &[TrialRow]) -> Vec<FactorLevel> {
    let all: [FactorLevel; 5] = [
        ("speed", |row| &row.speed),
        ("charge", |row| &row.charge),
        ("discharge", |row| &row.discharge),
        ("location", |row| &row.location),
        ("skills", |row| &row.skills),
    ];
    let varies = |level: &fn(&TrialRow) -> &str| rows.windows(2).any(|two| level(&two[0]) != level(&two[1]));
    all.into_iter().filter(|(_, level)| varies(level)).collect()
}
