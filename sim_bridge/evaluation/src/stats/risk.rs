//! Success rates: confidence intervals of a rate and of the difference of two rates.

use super::effect::z;
use super::{ConfidenceInterval, StatsError};

/// Returns the confidence interval of a success rate: the score interval (Wilson 1927).
///
/// # Errors
/// [`StatsError::TooFew`] for no trials.
pub(crate) fn wilson(successes: usize, trials: usize) -> Result<ConfidenceInterval, StatsError> {
    if trials == 0 {
        return Err(StatsError::TooFew { count: 0, least: 1 });
    }
    let (x, n, z) = (successes.min(trials) as f64, trials as f64, z());
    let middle = 2.0 * x + z * z;
    let reach = z * (z * z + 4.0 * x * (1.0 - x / n)).sqrt();
    let below = 2.0 * (n + z * z);
    Ok(ConfidenceInterval { low: ((middle - reach) / below).max(0.0), high: ((middle + reach) / below).min(1.0) })
}

/// Returns the difference of two success rates, first minus second, with its confidence interval:
/// the score interval of Newcombe 1998 (method 10). It assumes independent trials; the paired test
/// per scenario does not.
///
/// # Errors
/// [`StatsError::TooFew`] for no trials.
pub(crate) fn risk_difference(
    first: (usize, usize),
    second: (usize, usize),
) -> Result<(f64, ConfidenceInterval), StatsError> {
    let share = |(successes, trials): (usize, usize)| successes as f64 / trials as f64;
    let (first_interval, second_interval) = (wilson(first.0, first.1)?, wilson(second.0, second.1)?);
    let (p, q) = (share(first), share(second));
    let low = p - q - ((p - first_interval.low).powi(2) + (second_interval.high - q).powi(2)).sqrt();
    let high = p - q + ((first_interval.high - p).powi(2) + (q - second_interval.low).powi(2)).sqrt();
    Ok((p - q, ConfidenceInterval { low, high }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(ours: ConfidenceInterval, low: f64, high: f64) {
        assert!((ours.low - low).abs() < 5e-5 && (ours.high - high).abs() < 5e-5, "{ours:?}, not {low} to {high}");
    }

    #[test]
    fn intervals_agree_with_newcombes_tables() {
        // Newcombe 1998, Statistics in Medicine 17: 857 table I, method 3; 873 table II, method 10.
        near(wilson(81, 263).unwrap(), 0.2553, 0.3662);
        near(wilson(15, 148).unwrap(), 0.0624, 0.1605);
        near(wilson(0, 20).unwrap(), 0.0, 0.1611);
        let (difference, interval) = risk_difference((56, 70), (48, 80)).unwrap();
        assert!((difference - 0.2).abs() < 1e-12);
        near(interval, 0.0524, 0.3339);
        near(risk_difference((9, 10), (3, 10)).unwrap().1, 0.1705, 0.8090);
        near(risk_difference((10, 10), (0, 20)).unwrap().1, 0.6791, 1.0);
    }

    #[test]
    fn no_trials_give_an_error() {
        assert!(risk_difference((0, 0), (1, 2)).is_err());
    }
}
