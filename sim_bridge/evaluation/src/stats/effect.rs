//! Effect sizes: differences in units of the standard deviation.

use super::{CONFIDENCE, ConfidenceInterval, StatsError, differences, mean, sample, variance};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};
use statrs::function::gamma::ln_gamma;

/// A standardised difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct EffectSize {
    /// Cohen's d: the difference of the means divided by the pooled standard deviation (for pairs,
    /// by that of the differences).
    pub d: f64,
    /// Hedges' g: d without the bias of small samples.
    pub g: f64,
    /// Confidence interval of g, from its large-sample variance (Hedges and Olkin 1985).
    pub interval: ConfidenceInterval,
}

/// Returns the effect size of two samples.
///
/// # Errors
/// [`StatsError`] for samples of fewer than two values.
pub(crate) fn hedges_g(first: &[f64], second: &[f64]) -> Result<EffectSize, StatsError> {
    sample(first, 2)?;
    sample(second, 2)?;
    let (n, m) = (first.len() as f64, second.len() as f64);
    let pooled = ((n - 1.0) * variance(first) + (m - 1.0) * variance(second)) / (n + m - 2.0);
    let d = standardised(mean(first) - mean(second), pooled);
    let g = d * unbias(n + m - 2.0);
    Ok(effect(d, g, (n + m) / (n * m) + g * g / (2.0 * (n + m))))
}

/// Returns the effect size of pairs: d is that of the differences (often written d_z).
///
/// # Errors
/// [`StatsError`] for fewer than two pairs.
pub(crate) fn hedges_g_paired(first: &[f64], second: &[f64]) -> Result<EffectSize, StatsError> {
    let differences = differences(first, second)?;
    let count = differences.len() as f64;
    let d = standardised(mean(&differences), variance(&differences));
    let g = d * unbias(count - 1.0);
    Ok(effect(d, g, 1.0 / count + g * g / (2.0 * count)))
}

fn standardised(difference: f64, variance: f64) -> f64 {
    if difference == 0.0 { 0.0 } else { difference / variance.sqrt() }
}

fn effect(d: f64, g: f64, variance: f64) -> EffectSize {
    EffectSize { d, g, interval: ConfidenceInterval::around(g, z() * variance.sqrt()) }
}

/// Returns the half width of the interval in standard errors.
pub(super) fn z() -> f64 {
    Normal::standard().inverse_cdf(0.5 + CONFIDENCE / 2.0)
}

/// Hedges' exact correction for m degrees of freedom; 0 for fewer than two, where it is undefined.
fn unbias(m: f64) -> f64 {
    if m < 2.0 { 0.0 } else { (ln_gamma(m / 2.0) - ln_gamma((m - 1.0) / 2.0)).exp() / (m / 2.0).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::super::samples::{SLEEP, UNEQUAL, close};
    use super::*;

    #[test]
    fn effect_sizes_agree_with_numpy_and_scipy() {
        // d, g and J computed with numpy and scipy's gammaln.
        let found = hedges_g(&UNEQUAL[0], &UNEQUAL[1]).unwrap();
        close(found.d, -0.8965693907039232);
        close(found.g, -0.8723011535920734);
        let found = hedges_g_paired(&SLEEP[1], &SLEEP[0]).unwrap();
        close(found.d, 1.2845575625910546);
        close(found.g, 1.173924903514205);
    }

    #[test]
    fn the_interval_agrees_with_borensteins_example() {
        // Borenstein et al. 2009, chapter 4: means 103 and 100, spread 5.5 and 4.5, 50 each: g
        // 0.5924, SE 0.2044.
        let sample = |mean: f64, sd: f64| {
            let reach = sd * (49.0_f64 / 50.0).sqrt();
            [mean - reach, mean + reach].repeat(25)
        };
        let found = hedges_g(&sample(103.0, 5.5), &sample(100.0, 4.5)).unwrap();
        assert!((found.g - 0.5924).abs() < 5e-4, "{found:?}");
        assert!(((found.interval.high - found.g) / 1.959_964 - 0.2044).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn equal_samples_have_no_effect() {
        assert_eq!(hedges_g(&[1.0; 3], &[1.0; 3]).unwrap().g, 0.0);
    }
}
