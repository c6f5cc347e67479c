//! The statistics of an evaluation, as in thesis 4.1.4: paired t-tests on counts per scenario,
//! Welch's t-test on times. Each is accompanied by a permutation test, which makes no assumptions
//! about the distributions, an effect size and a confidence interval.
//!
//! All intervals are two-sided with a level of 95 %. Only functions with a seed use random
//! numbers.

mod describe;
mod effect;
mod permutation;
mod risk;
mod ttest;

pub use describe::Summary;
pub(crate) use describe::{density, quantile};
pub(crate) use effect::{EffectSize, hedges_g, hedges_g_paired};
pub(crate) use permutation::{PermutationTest, permute_paired, permute_two_samples};
pub(crate) use risk::{risk_difference, wilson};
pub use ttest::MeanEstimate;
pub(crate) use ttest::{TTest, paired, welch};

use serde::Serialize;

/// Confidence level of all intervals: the level of the published evaluation.
pub(crate) const CONFIDENCE: f64 = 0.95;

/// Alternative hypothesis of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Alternative {
    /// The two differ.
    TwoSided,
    /// The first is greater.
    Greater,
    /// The first is less.
    Less,
}

/// Confidence interval with a level of 95 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConfidenceInterval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl ConfidenceInterval {
    /// Returns the interval from `middle - reach` to `middle + reach`.
    pub(crate) fn around(middle: f64, reach: f64) -> ConfidenceInterval {
        ConfidenceInterval { low: middle - reach, high: middle + reach }
    }
}

/// A statistic could not be computed. Common for few trials or few successes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum StatsError {
    /// A sample has too few values.
    #[error("{count} values are too few for a test: at least {least} are needed")]
    TooFew {
        /// Number of values.
        count: usize,
        /// Least number of values.
        least: usize,
    },
    /// Two samples for a paired test have different lengths.
    #[error("{first} values cannot be paired with {second}")]
    Unpaired {
        /// Values in the first.
        first: usize,
        /// Values in the second.
        second: usize,
    },
    /// A value is infinite or not a number.
    #[error("a value is not a finite number")]
    NotFinite,
}

/// Returns the mean; 0 for no values.
pub(crate) fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Returns the sample variance (divided by n − 1); 0 for fewer than two values.
pub(crate) fn variance(values: &[f64]) -> f64 {
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

/// Returns first minus second, pair by pair.
fn differences(first: &[f64], second: &[f64]) -> Result<Vec<f64>, StatsError> {
    if first.len() != second.len() {
        return Err(StatsError::Unpaired { first: first.len(), second: second.len() });
    }
    let differences: Vec<f64> = first.iter().zip(second).map(|(a, b)| a - b).collect();
    sample(&differences, 2)?;
    Ok(differences)
}

/// Published samples for the tests of this module.
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
