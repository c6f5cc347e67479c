//! Distributions of numbers in the simulator: durations of goals, results, and values of readings.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Distribution of a number. A number beyond a bound becomes the bound.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Normal distribution.
    Normal(Normal),
    /// Exponential distribution.
    Exponential(Exponential),
}

/// Normal distribution between two bounds, such as `{ mean: 8, deviation: 2, minimum: 4, maximum: 15 }`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Normal {
    /// Mean, from `minimum` to `maximum`.
    pub mean: f64,
    /// Standard deviation: 0 or more.
    pub deviation: f64,
    /// Least number.
    pub minimum: f64,
    /// Greatest number.
    pub maximum: f64,
}

/// Exponential distribution from 0 to a bound, such as `{ mean: 8, maximum: 60 }`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Exponential {
    /// Mean without the bound, above 0.
    pub mean: f64,
    /// Greatest number, not less than the mean.
    pub maximum: f64,
}

/// Duration of a simulated goal in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "allowed are [least, greatest], { normal: { mean, deviation, minimum, maximum } } and \
                 { exponential: { mean, maximum } }"
)]
pub enum SimulatedDuration {
    /// From the first to the second number; uniformly distributed.
    Range([f64; 2]),
    /// With this distribution.
    Distributed(Distribution),
}

impl Distribution {
    /// Returns the least and the greatest number.
    pub(super) fn bounds(&self) -> [f64; 2] {
        match self {
            Distribution::Normal(Normal { minimum, maximum, .. }) => [*minimum, *maximum],
            Distribution::Exponential(Exponential { maximum, .. }) => [0.0, *maximum],
        }
    }

    /// Returns the mean; of a normal distribution, that without the bounds.
    fn mean(&self) -> f64 {
        match self {
            Distribution::Normal(Normal { mean, .. }) => *mean,
            Distribution::Exponential(Exponential { mean, maximum }) => mean * (1.0 - (-maximum / mean).exp()),
        }
    }

    /// Returns the number for two independent numbers that are uniformly distributed from 0 to 1, without 1.
    pub fn number(&self, [first, second]: [f64; 2]) -> f64 {
        let [minimum, maximum] = self.bounds();
        // The logarithm of 0 is infinite.
        let logarithm = (1.0 - first).ln();
        let number = match self {
            // Box and Muller, *A note on the generation of random normal deviates*, 1958.
            Distribution::Normal(Normal { mean, deviation, .. }) => {
                mean + deviation * (-2.0 * logarithm).sqrt() * (std::f64::consts::TAU * second).cos()
            }
            Distribution::Exponential(Exponential { mean, .. }) => -mean * logarithm,
        };
        number.max(minimum).min(maximum)
    }

    /// Returns what is allowed, if the parameters do not fit each other.
    pub(super) fn problem(&self) -> Option<&'static str> {
        match *self {
            Distribution::Normal(Normal { mean, deviation, minimum, maximum }) => {
                let is_valid = (minimum..=maximum).contains(&mean) && deviation >= 0.0;
                let is_finite = [deviation, minimum, maximum].into_iter().all(f64::is_finite);
                let allowed = "allowed are a `mean` from `minimum` to `maximum`, and a `deviation` of 0 or more";
                (!(is_valid && is_finite)).then_some(allowed)
            }
            Distribution::Exponential(Exponential { mean, maximum }) => {
                let is_valid = mean > 0.0 && mean <= maximum && maximum.is_finite();
                (!is_valid).then_some("allowed are a `mean` above 0, and a `maximum` that is not less than the `mean`")
            }
        }
    }
}

impl fmt::Display for Distribution {
    /// The kind and the bounds.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self {
            Distribution::Normal(_) => "normal",
            Distribution::Exponential(_) => "exponential",
        };
        let [minimum, maximum] = self.bounds();
        write!(f, "the {kind} distribution from {minimum} to {maximum}")
    }
}

impl SimulatedDuration {
    /// Returns the mean in seconds.
    pub(super) fn mean_s(&self) -> f64 {
        match self {
            SimulatedDuration::Range([least, greatest]) => f64::midpoint(*least, *greatest),
            SimulatedDuration::Distributed(distribution) => distribution.mean(),
        }
    }

    /// Returns what is allowed, if it is no duration.
    pub(super) fn problem(&self) -> Option<&'static str> {
        match self {
            SimulatedDuration::Range([least, greatest]) => {
                let is_valid = (0.0..=*greatest).contains(least) && greatest.is_finite();
                (!is_valid).then_some("allowed are two numbers of seconds, the second not less than the first")
            }
            SimulatedDuration::Distributed(distribution) => {
                let is_negative = distribution.bounds()[0] < 0.0;
                distribution.problem().or(is_negative.then_some("allowed is a `minimum` of 0 s or more"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORMAL: Distribution =
        Distribution::Normal(Normal { mean: 8.0, deviation: 2.0, minimum: 5.0, maximum: 10.5 });
    const EXPONENTIAL: Distribution = Distribution::Exponential(Exponential { mean: 4.0, maximum: 10.0 });

    /// Returns the numbers for a grid of pairs.
    fn numbers(distribution: &Distribution) -> Vec<f64> {
        let at = |number: u32| (f64::from(number) + 0.5) / 200.0;
        let pairs = (0..200).flat_map(|first| (0..200).map(move |second| [at(first), at(second)]));
        pairs.map(|pair| distribution.number(pair)).collect()
    }

    fn mean(numbers: &[f64]) -> f64 {
        numbers.iter().sum::<f64>() / numbers.len() as f64
    }

    #[test]
    fn a_normal_distribution_has_its_mean_and_deviation() {
        let wide = Distribution::Normal(Normal { mean: 8.0, deviation: 2.0, minimum: -92.0, maximum: 108.0 });
        let drawn = numbers(&wide);
        let squares: Vec<f64> = drawn.iter().map(|number| (number - 8.0).powi(2)).collect();
        assert!((mean(&drawn) - 8.0).abs() < 0.01, "{}", mean(&drawn));
        assert!((mean(&squares).sqrt() - 2.0).abs() < 0.02, "{}", mean(&squares).sqrt());
        assert_eq!(wide.mean(), 8.0);
    }

    #[test]
    fn an_exponential_distribution_has_the_mean_of_its_bounded_numbers() {
        let drawn = numbers(&EXPONENTIAL);
        assert!((mean(&drawn) - EXPONENTIAL.mean()).abs() < 0.01, "{} {}", mean(&drawn), EXPONENTIAL.mean());
        assert!(EXPONENTIAL.mean() < 4.0);
    }

    #[test]
    fn numbers_beyond_a_bound_become_the_bound() {
        for distribution in [NORMAL, EXPONENTIAL] {
            let [minimum, maximum] = distribution.bounds();
            let drawn = numbers(&distribution);
            assert!(drawn.iter().all(|number| (minimum..=maximum).contains(number)), "{distribution}");
            assert!(drawn.contains(&maximum), "{distribution}");
        }
        assert!(numbers(&NORMAL).contains(&5.0));
    }
}
