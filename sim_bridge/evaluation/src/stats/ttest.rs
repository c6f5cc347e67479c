//! Student's t-test for pairs, Welch's t-test for two samples.

use super::{Alternative, CONFIDENCE, ConfidenceInterval, StatsError, differences, mean, sample, variance};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Result of a t-test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct TTest {
    /// Mean of the first minus mean of the second.
    pub difference: f64,
    /// Confidence interval of that difference.
    pub interval: ConfidenceInterval,
    /// The statistic; infinite if all pairs have the same nonzero difference.
    pub t: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: f64,
    /// Probability of a statistic at least as extreme without any difference.
    pub p: f64,
    /// The alternative hypothesis.
    pub alternative: Alternative,
}

/// Mean of a sample with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanEstimate {
    /// The mean; 0 for no values.
    pub mean: f64,
    /// Its confidence interval by Student's t-distribution; `None` for fewer than two values.
    pub interval: Option<ConfidenceInterval>,
}

impl MeanEstimate {
    /// Estimates the mean of the values' distribution.
    pub fn of(values: &[f64]) -> MeanEstimate {
        let zeros = vec![0.0; values.len()];
        let interval = paired(values, &zeros, Alternative::TwoSided).ok().map(|test| test.interval);
        MeanEstimate { mean: mean(values), interval }
    }
}

/// Tests pairs with Student's t-test: whether the mean of first minus second is 0. The thesis uses
/// it for successes and battery failures, with a pair for each scenario.
///
/// # Errors
/// [`StatsError`] for fewer than two pairs.
pub(crate) fn paired(first: &[f64], second: &[f64], alternative: Alternative) -> Result<TTest, StatsError> {
    let differences = differences(first, second)?;
    let count = differences.len() as f64;
    Ok(test(mean(&differences), (variance(&differences) / count).sqrt(), count - 1.0, alternative))
}

/// Tests with Welch's t-test whether two samples have the same mean, with unknown and possibly
/// unequal variances (Welch 1947). The thesis uses it for the time to conclude.
///
/// # Errors
/// [`StatsError`] for samples of fewer than two values.
pub(crate) fn welch(first: &[f64], second: &[f64], alternative: Alternative) -> Result<TTest, StatsError> {
    sample(first, 2)?;
    sample(second, 2)?;
    let part = |values: &[f64]| variance(values) / values.len() as f64;
    let (a, b) = (part(first), part(second));
    let degrees_of_freedom = |part: f64, values: &[f64]| part.powi(2) / (values.len() - 1) as f64;
    let denominator = degrees_of_freedom(a, first) + degrees_of_freedom(b, second);
    // Samples without any variance give no estimate: any number of degrees of freedom works.
    let degrees_of_freedom =
        if denominator > 0.0 { (a + b).powi(2) / denominator } else { (first.len() + second.len() - 2) as f64 };
    Ok(test(mean(first) - mean(second), (a + b).sqrt(), degrees_of_freedom, alternative))
}

fn test(difference: f64, error: f64, degrees_of_freedom: f64, alternative: Alternative) -> TTest {
    // No difference is no evidence, for any alternative hypothesis.
    let t = if difference == 0.0 { 0.0 } else { difference / error };
    let student = StudentsT::new(0.0, 1.0, degrees_of_freedom).expect("at least one degree of freedom");
    let p = match alternative {
        Alternative::TwoSided => (2.0 * student.sf(t.abs())).min(1.0),
        Alternative::Greater => student.sf(t),
        Alternative::Less => student.cdf(t),
    };
    let reach = student.inverse_cdf(0.5 + CONFIDENCE / 2.0) * error;
    TTest { difference, interval: ConfidenceInterval::around(difference, reach), t, degrees_of_freedom, p, alternative }
}

#[cfg(test)]
mod tests {
    use super::super::samples::{SLEEP, UNEQUAL, close};
    use super::*;

    // The expected figures are those of scipy 1.17 (ttest_rel, ttest_ind with equal_var=False).

    #[test]
    fn a_mean_has_the_interval_of_the_t_distribution() {
        // scipy 1.17: t.interval(0.95, 9, loc=mean, scale=sem)
        let differences: Vec<f64> = SLEEP[0].iter().zip(&SLEEP[1]).map(|(one, other)| one - other).collect();
        let estimate = MeanEstimate::of(&differences);
        close(estimate.mean, -1.58);
        close(estimate.interval.unwrap().low, -2.459885763276983);
        assert_eq!(MeanEstimate::of(&[7.0]), MeanEstimate { mean: 7.0, interval: None });
    }

    #[test]
    fn the_paired_test_agrees_with_scipy() {
        let found = paired(&SLEEP[0], &SLEEP[1], Alternative::TwoSided).unwrap();
        close(found.t, -4.062127683382037);
        close(found.p, 0.002832890197384273);
        close(found.degrees_of_freedom, 9.0);
        close(found.difference, -1.58);
        close(found.interval.low, -2.459885763276983);
        close(found.interval.high, -0.7001142367230175);
        close(paired(&SLEEP[1], &SLEEP[0], Alternative::Greater).unwrap().p, 0.0014164450986921364);
        close(paired(&SLEEP[0], &SLEEP[1], Alternative::Less).unwrap().p, 0.0014164450986921364);
    }

    #[test]
    fn welchs_test_agrees_with_scipy() {
        let found = welch(&UNEQUAL[0], &UNEQUAL[1], Alternative::TwoSided).unwrap();
        close(found.t, -2.455356398286006);
        close(found.p, 0.021378001462866992);
        close(found.degrees_of_freedom, 24.988529290231416);
        close(found.interval.low, -3.984096267140929);
        close(found.interval.high, -0.3492370661924069);
        close(welch(&UNEQUAL[0], &UNEQUAL[1], Alternative::Less).unwrap().p, 0.010689000731433496);
        close(welch(&UNEQUAL[0], &UNEQUAL[1], Alternative::Greater).unwrap().p, 0.9893109992685665);
    }

    #[test]
    fn samples_without_variance_are_valid() {
        let no_difference = paired(&[3.0; 4], &[3.0; 4], Alternative::TwoSided).unwrap();
        assert_eq!((no_difference.t, no_difference.p), (0.0, 1.0));
        let constant_difference = paired(&[3.0; 4], &[2.0; 4], Alternative::Greater).unwrap();
        assert_eq!(
            (constant_difference.t, constant_difference.p, constant_difference.interval),
            (f64::INFINITY, 0.0, ConfidenceInterval::around(1.0, 0.0))
        );
        assert_eq!(welch(&[3.0; 4], &[2.0; 3], Alternative::TwoSided).unwrap().p, 0.0);
    }

    #[test]
    fn invalid_samples_are_reported() {
        let few = welch(&[1.0], &[1.0, 2.0], Alternative::Less).unwrap_err();
        assert_eq!(few.to_string(), "1 values are too few for a test: at least 2 are needed");
        let unpaired = paired(&[1.0], &[1.0, 2.0], Alternative::Less).unwrap_err();
        assert_eq!(unpaired, StatsError::Unpaired { first: 1, second: 2 });
        assert_eq!(welch(&[1.0, f64::NAN], &[1.0, 2.0], Alternative::Less).unwrap_err(), StatsError::NotFinite);
    }
}
