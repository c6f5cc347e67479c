//! Calculation of a calibration from trials: the actual duration of tasks by skill and by leg, and
//! its uncertainty.

use super::stats::{mean, quantile, variance};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_skills::descriptor::{Calibration, LegFactor, TimeFactor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Least number of observations for a factor: with five, the upper quantile lies between the two
/// greatest values.
pub(super) const MIN_OBSERVATIONS: usize = 5;

/// Share of cases in which the battery is to last. Default of `consort lab experiment calibrate`.
pub const DEFAULT_QUANTILE: f64 = 0.9;

/// A task with its estimated and its actual time and energy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// The kind of task.
    pub skill: TaskType,
    /// Start of a drive.
    pub from: Option<PlaceId>,
    /// Destination of a drive.
    pub to: Option<PlaceId>,
    /// Estimated time in seconds.
    pub predicted_s: f64,
    /// Actual time in seconds.
    pub actual_s: f64,
    /// Estimated energy, as a share of a full battery.
    pub predicted_share: f64,
    /// Actual energy, as a share of a full battery.
    pub actual_share: f64,
    /// Energy considered safe: the estimate and the reserve for this task alone.
    pub budget_share: f64,
}

/// Computes the factors from observations. Tasks with an estimated time of zero are ignored.
pub fn calibrate(observations: &[Observation], quantile: f64) -> Calibration {
    let mut skills: BTreeMap<TaskType, Vec<f64>> = BTreeMap::new();
    let (mut to, mut from) = (BTreeMap::<PlaceId, Vec<f64>>::new(), BTreeMap::<PlaceId, Vec<f64>>::new());
    let mut legs: BTreeMap<(PlaceId, PlaceId), Vec<f64>> = BTreeMap::new();
    for observed in observations.iter().filter(|observed| observed.predicted_s > 0.0) {
        let factor = observed.actual_s / observed.predicted_s;
        skills.entry(observed.skill.clone()).or_default().push(factor);
        if let (Some(start), Some(end)) = (&observed.from, &observed.to) {
            to.entry(end.clone()).or_default().push(factor);
            from.entry(start.clone()).or_default().push(factor);
            legs.entry((start.clone(), end.clone())).or_default().push(factor);
        }
    }
    Calibration {
        quantile,
        skills: fit(skills, quantile).collect(),
        to: fit(to, quantile).collect(),
        from: fit(from, quantile).collect(),
        legs: fit(legs, quantile).map(|((from, to), factor)| LegFactor { from, to, factor }).collect(),
        // The batteries of trials follow the declared rates; recordings show those of robots.
        discharge: BTreeMap::new(),
        charging: None,
    }
}

/// Returns the factors with enough observations.
fn fit<K: Ord>(observed: BTreeMap<K, Vec<f64>>, quantile: f64) -> impl Iterator<Item = (K, TimeFactor)> {
    observed.into_iter().filter_map(move |(key, factors)| Some((key, time_factor(&factors, quantile)?)))
}

/// Returns the factor of observations; `None` if they are too few.
fn time_factor(factors: &[f64], share: f64) -> Option<TimeFactor> {
    if factors.len() < MIN_OBSERVATIONS {
        return None;
    }
    let (mean, sd) = (mean(factors), variance(factors).sqrt());
    Some(TimeFactor { count: factors.len(), mean, sd, upper: quantile(factors, share)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn navigation() -> TaskType {
        TaskType::new("navigation").unwrap()
    }

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn drive(from: &str, to: &str, factor: f64) -> Observation {
        Observation {
            skill: navigation(),
            from: Some(place(from)),
            to: Some(place(to)),
            predicted_s: 10.0,
            actual_s: 10.0 * factor,
            predicted_share: 0.01,
            actual_share: 0.01 * factor,
            budget_share: 0.01,
        }
    }

    fn learned() -> Arc<Calibration> {
        let mut observed: Vec<Observation> =
            (0..11).map(|step| drive("A", "B", 1.5 + f64::from(step) / 10.0)).collect();
        observed.extend((0..5).map(|_| drive("C", "B", 1.0)));
        observed.push(drive("A", "C", 9.0));
        Arc::new(calibrate(&observed, 0.9))
    }

    #[test]
    fn a_rare_leg_uses_its_slower_end_or_all_drives() {
        let learned = learned();
        let close = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-9, "{found}, not {wanted}");
        let factor = |from: &str, to: &str| learned.leg_factor(&navigation(), &place(from), &place(to));
        let leg = factor("A", "B").unwrap();
        close(leg.mean, 2.0);
        close(leg.upper, 2.4);
        assert_eq!(leg.count, 11);
        close(factor("C", "B").unwrap().upper, 1.0);
        // Too few drives from A to C: the drives from A are used, including the drive to C.
        close(factor("A", "C").unwrap().mean, 31.0 / 12.0);
        close(factor("X", "Y").unwrap().mean, 36.0 / 17.0);
        assert_eq!(calibrate(&[], 0.9).leg_factor(&navigation(), &place("A"), &place("B")), None);
    }

    #[test]
    fn the_reserve_is_the_quantile_of_a_normal_distribution() {
        use statrs::distribution::{ContinuousCDF, Normal};
        for share in [0.5, 0.6, 0.75, 0.9, 0.925, 0.926, 0.95, 0.99, 0.999, 0.9999] {
            let (found, wanted) = (calibrate(&[], share).margin_sds(), Normal::standard().inverse_cdf(share));
            assert!((found - wanted).abs() < 1e-12, "{share}: {found}, not {wanted}");
        }
    }

    #[test]
    fn a_calibration_is_read_back_unchanged() {
        let learned = learned();
        let text = toml::to_string(&*learned).unwrap();
        assert_eq!(toml::from_str::<Calibration>(&text).unwrap(), *learned);
    }
}
