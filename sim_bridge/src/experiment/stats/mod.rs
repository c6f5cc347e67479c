//! The statistics of an evaluation, as in thesis 4.1.4: paired t-tests on counts per scenario, Welch's t-test on times;
//! beside each a permutation test, which asks nothing of the distributions, an effect size and an interval.
//!
//! All intervals are two-sided and hold with [`CONFIDENCE`]. Nothing here is random except what takes a seed.

mod describe;
mod effect;
mod permutation;
mod risk;
mod ttest;

pub use describe::{Summary, density, quantile};
pub use effect::{EffectSize, hedges_g, hedges_g_paired};
pub use permutation::{PermutationTest, permute_paired, permute_two_samples};
pub use risk::{risk_difference, wilson};
pub use ttest::{TTest, paired, welch};

use serde::Serialize;

/// How sure an interval is: the level of the published evaluation.
pub const CONFIDENCE: f64 = 0.95;

/// What a test would show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alternative {
    /// That the two differ.
    TwoSided,
    /// That the first is greater.
    Greater,
    /// That the first is less.
    Less,
}

/// Where a figure lies, with [`CONFIDENCE`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConfidenceInterval {
    /// Least.
    pub low: f64,
    /// Greatest.
    pub high: f64,
}

impl ConfidenceInterval {
    /// This far to either side.
    pub fn around(middle: f64, reach: f64) -> ConfidenceInterval {
        ConfidenceInterval { low: middle - reach, high: middle + reach }
    }

    /// Whether it holds a number.
    pub fn contains(&self, number: f64) -> bool {
        (self.low..=self.high).contains(&number)
    }
}

/// Why there is no result. Ordinary when few trials were run, or few succeeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StatsError {
    /// A sample is too small to vary.
    #[error("{count} values are too few for a test: allowed are {least} or more")]
    TooFew {
        /// How many there are.
        count: usize,
        /// How many there must be.
        least: usize,
    },
    /// Two samples that should be paired.
    #[error("{first} values cannot be paired with {second}")]
    Unpaired {
        /// Values in the first.
        first: usize,
        /// Values in the second.
        second: usize,
    },
    /// A value that is infinite or not a number.
    #[error("a value is not a finite number")]
    NotFinite,
}

/// The mean; 0 of nothing.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// The variance of the whole of which these are a sample (divided by n − 1); 0 for fewer than two.
pub fn variance(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return 0.0;
    }
    let middle = mean(values);
    values.iter().map(|value| (value - middle).powi(2)).sum::<f64>() / (values.len() - 1) as f64
}

fn sample(values: &[f64], least: usize) -> Result<(), StatsError> {
    if values.len() < least {
        return Err(StatsError::TooFew { count: values.len(), least });
    }
    if values.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(StatsError::NotFinite) }
}

/// First minus second, pair by pair.
fn differences(first: &[f64], second: &[f64]) -> Result<Vec<f64>, StatsError> {
    if first.len() != second.len() {
        return Err(StatsError::Unpaired { first: first.len(), second: second.len() });
    }
    let differences: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    sample(&differences, 2)?;
    Ok(differences)
}

/// Published samples, for the tests of the other files.
#[cfg(test)]
mod samples {
    /// Hours of sleep gained with each of two drugs by ten patients (Student 1908).
    pub(super) const SLEEP: [[f64; 10]; 2] =
        [[0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0], [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]];

    /// Two samples of unequal spread, of the first worked example for Welch's test in common use.
    pub(super) const UNEQUAL: [[f64; 15]; 2] = [
        [27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7, 21.4],
        [27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 20.5, 24.4],
    ];

    pub(super) fn close(ours: f64, theirs: f64) {
        assert!((ours - theirs).abs() <= 1e-9 * theirs.abs().max(1.0), "{ours}, not {theirs}");
    }
}
