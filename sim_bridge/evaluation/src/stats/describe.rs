//! Summary statistics and density of a sample.

use super::{mean, variance};
use serde::Serialize;
use std::f64::consts::PI;

/// Summary statistics of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// Number of values.
    pub count: usize,
    /// Their mean.
    pub mean: f64,
    /// Their sample standard deviation.
    pub sd: f64,
    /// The least.
    pub min: f64,
    /// First quartile.
    pub q1: f64,
    /// Median.
    pub median: f64,
    /// Third quartile.
    pub q3: f64,
    /// The greatest.
    pub max: f64,
}

impl Summary {
    /// Returns `None` for no values.
    pub fn of(values: &[f64]) -> Option<Summary> {
        let sorted = sorted(values);
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        let [q1, median, q3] = [0.25, 0.5, 0.75].map(|share| of_sorted(&sorted, share));
        let (mean, sd) = (mean(values), variance(values).sqrt());
        Some(Summary { count: values.len(), mean, sd, min, q1, median, q3, max })
    }

    /// Returns the ends of the whiskers: the outermost values within 1.5 interquartile ranges of
    /// the box (Tukey 1977).
    pub(crate) fn whiskers(&self, values: &[f64]) -> (f64, f64) {
        let reach = 1.5 * (self.q3 - self.q1);
        let within = values.iter().copied().filter(|value| (self.q1 - reach..=self.q3 + reach).contains(value));
        within.fold((self.q1, self.q3), |(low, high), value| (low.min(value), high.max(value)))
    }
}

/// Returns the quantile `share` of the values, interpolated linearly (type 7 of Hyndman and Fan
/// 1996, as in numpy and R). `None` for no values.
pub(crate) fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let sorted = sorted(values);
    if sorted.is_empty() { None } else { Some(of_sorted(&sorted, share)) }
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

fn of_sorted(sorted: &[f64], share: f64) -> f64 {
    let at = share.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let (below, part) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * part
}

/// Returns the density of a sample at each point: Gaussian kernels by Scott's rule, but at least
/// `width_min` wide (for integers, which would otherwise give spikes). All 0 for no values.
pub(crate) fn density(values: &[f64], points: &[f64], width_min: f64) -> Vec<f64> {
    if values.is_empty() {
        return vec![0.0; points.len()];
    }
    let count = values.len() as f64;
    let width = (variance(values).sqrt() * count.powf(-0.2)).max(width_min).max(f64::MIN_POSITIVE);
    let kernel = |point: f64, value: f64| (-((point - value) / width).powi(2) / 2.0).exp();
    let scale = 1.0 / (count * width * (2.0 * PI).sqrt());
    points.iter().map(|point| values.iter().map(|value| kernel(*point, *value)).sum::<f64>() * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::super::samples::{UNEQUAL, close};
    use super::*;

    #[test]
    fn quartiles_and_density_agree_with_numpy_and_scipy() {
        let summary = Summary::of(&UNEQUAL[0]).unwrap();
        assert_eq!((summary.q1, summary.median, summary.q3), (19.0, 21.0, 22.25));
        // scipy 1.17: gaussian_kde(sample).evaluate([20.0])
        assert!((density(&UNEQUAL[0], &[20.0], 0.0)[0] - 0.12313843).abs() < 1e-7);
        close(quantile(&[1.0, 2.0, 4.0], 0.9).unwrap(), 3.6);
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn whiskers_exclude_outliers() {
        let values = [1.0, 2.0, 3.0, 4.0, 100.0];
        assert_eq!(Summary::of(&values).unwrap().whiskers(&values), (1.0, 4.0));
    }

    #[test]
    fn a_constant_sample_has_a_density_of_the_least_width() {
        let shape = density(&[5.0; 9], &[4.0, 5.0], 0.5);
        close(shape[1], 1.0 / (0.5 * (2.0 * PI).sqrt()));
        assert!(shape[0] < shape[1]);
        assert_eq!(density(&[], &[1.0], 1.0), [0.0]);
    }
}
