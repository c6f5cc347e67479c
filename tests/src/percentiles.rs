//! Percentiles of measured values.

use serde::Serialize;

/// Percentiles of a measured value, each of them a measured value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
}

impl Percentiles {
    /// Returns the percentiles of values, by nearest rank; `None` without values.
    pub fn of(mut values: Vec<f64>) -> Option<Percentiles> {
        if values.is_empty() {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let at = |per_mille: usize| values[(values.len() * per_mille).div_ceil(1000).max(1) - 1];
        Some(Percentiles { p50: at(500), p95: at(950), p99: at(990), p999: at(999) })
    }

    /// Returns the percentiles of times in milliseconds.
    pub fn of_ms(times: &[u64]) -> Option<Percentiles> {
        Percentiles::of(times.iter().map(|time| *time as f64).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_measured_values() {
        assert_eq!(Percentiles::of_ms(&[]), None);
        assert_eq!(Percentiles::of_ms(&[7]), Some(Percentiles { p50: 7.0, p95: 7.0, p99: 7.0, p999: 7.0 }));
        let many = Percentiles::of_ms(&(1..=200).collect::<Vec<_>>());
        assert_eq!(many, Some(Percentiles { p50: 100.0, p95: 190.0, p99: 198.0, p999: 200.0 }));
    }
}
