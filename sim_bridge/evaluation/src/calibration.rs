//! Calibration of estimates from trials: the actual duration of tasks by skill and by leg, and its
//! uncertainty.
//!
//! A factor is the ratio of actual to estimated duration. A calibrated descriptor multiplies its
//! estimates of time and energy by the mean factor, and uses its standard deviation as the
//! uncertainty. The robot then keeps a reserve: a bid is viable only if the battery lasts for an
//! upper quantile of the energy of the whole plan, not only for the mean. A leg with too few drives
//! uses all drives to or from the same place, and failing that all drives.

use super::stats::{mean, quantile, variance};
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::Seconds;
use consort_skills::descriptor::{
    DescriptorRegistry, Estimate, EstimateContext, EstimateError, FixedDuration, NavigationDescriptor, STEP_DURATION_S,
    SkillDescriptor,
};
use consort_skills::environment::Environment;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Least number of observations for a factor: with five, the upper quantile lies between the two
/// greatest values.
pub const MIN_OBSERVATIONS: usize = 5;

/// Share of cases in which the battery is to last. Default of `consort-lab experiment calibrate`.
pub const DEFAULT_QUANTILE: f64 = 0.9;

/// The only skill with tasks that drive from place to place.
const NAVIGATION: &str = "navigation";

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

/// Ratio of actual to estimated duration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TimeFactor {
    /// Number of observations.
    pub count: usize,
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub sd: f64,
    /// Their upper quantile.
    pub upper: f64,
}

impl TimeFactor {
    fn of(factors: &[f64], share: f64) -> Option<TimeFactor> {
        if factors.len() < MIN_OBSERVATIONS {
            return None;
        }
        let (mean, sd) = (mean(factors), variance(factors).sqrt());
        Some(TimeFactor { count: factors.len(), mean, sd, upper: quantile(factors, share)? })
    }
}

/// The factor of drives between two places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LegFactor {
    /// Start of the drives.
    pub from: PlaceId,
    /// Destination of the drives.
    pub to: PlaceId,
    /// The factor.
    pub factor: TimeFactor,
}

/// Factors computed from observations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Share of cases for which the upper quantiles hold, and in which the battery is to last: 0.5
    /// to below 1.
    pub quantile: f64,
    /// Factors by skill.
    #[serde(default)]
    pub skills: BTreeMap<TaskType, TimeFactor>,
    /// Factors of drives to a place.
    #[serde(default)]
    pub to: BTreeMap<PlaceId, TimeFactor>,
    /// Factors of drives from a place.
    #[serde(default)]
    pub from: BTreeMap<PlaceId, TimeFactor>,
    /// Factors of drives between two places.
    #[serde(default)]
    pub legs: Vec<LegFactor>,
}

impl Calibration {
    /// Computes the factors from observations. Tasks with an estimated time of zero are ignored.
    pub fn of(observations: &[Observation], quantile: f64) -> Calibration {
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
        fn fit<K: Ord>(observed: BTreeMap<K, Vec<f64>>, quantile: f64) -> impl Iterator<Item = (K, TimeFactor)> {
            observed.into_iter().filter_map(move |(key, factors)| Some((key, TimeFactor::of(&factors, quantile)?)))
        }
        Calibration {
            quantile,
            skills: fit(skills, quantile).collect(),
            to: fit(to, quantile).collect(),
            from: fit(from, quantile).collect(),
            legs: fit(legs, quantile).map(|((from, to), factor)| LegFactor { from, to, factor }).collect(),
        }
    }

    /// Returns the factor of a drive; `None` without any observed drives.
    pub fn leg_factor(&self, from: &PlaceId, to: &PlaceId) -> Option<TimeFactor> {
        let leg = self.legs.iter().find(|leg| leg.from == *from && leg.to == *to).map(|leg| leg.factor);
        // Of the two ends the slower determines the factor.
        let ends = [self.to.get(to), self.from.get(from)].into_iter().flatten();
        let end = ends.max_by(|a, b| a.mean.total_cmp(&b.mean)).copied();
        leg.or(end).or_else(|| self.skill(NAVIGATION))
    }

    fn skill(&self, name: &str) -> Option<TimeFactor> {
        self.skills.iter().find(|(skill, _)| skill.as_str() == name).map(|(_, factor)| *factor)
    }

    /// Returns the distance of the quantile from the mean in standard deviations, for plans with
    /// normally distributed energy.
    pub fn margin_sds(&self) -> f64 {
        use statrs::distribution::{ContinuousCDF, Normal};
        Normal::standard().inverse_cdf(self.quantile.clamp(0.5, 0.9999))
    }

    /// Returns the standard descriptors with these factors, and with a reserve for the quantile.
    pub fn descriptors(self: &Arc<Calibration>) -> DescriptorRegistry {
        let name = |name: &str| TaskType::new(name).expect("the name of a skill is valid");
        let drives = Calibrated { inner: NavigationDescriptor::new(name(NAVIGATION)), calibration: Arc::clone(self) };
        let registry = DescriptorRegistry::standard().with(drives).with_energy_margin(self.margin_sds());
        // Tasks with a given duration are not corrected.
        let fixed = self.skills.keys().filter(|skill| ![NAVIGATION, "wait"].contains(&skill.as_str()));
        let time = Seconds::new(STEP_DURATION_S).expect("two seconds are a valid duration");
        fixed.fold(registry, |registry, skill| {
            registry.with(Calibrated { inner: FixedDuration::new(skill.clone(), time), calibration: Arc::clone(self) })
        })
    }
}

/// A descriptor with estimates corrected by a calibration.
#[derive(Debug, Clone)]
pub struct Calibrated<D> {
    /// The corrected descriptor.
    pub inner: D,
    /// The calibration.
    pub calibration: Arc<Calibration>,
}

impl<D: SkillDescriptor> SkillDescriptor for Calibrated<D> {
    fn task_type(&self) -> &TaskType {
        self.inner.task_type()
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        self.inner.required_descriptors()
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        let uncorrected = self.inner.estimate(task, context, environment)?;
        let factor = if self.task_type().as_str() == NAVIGATION {
            self.calibration.leg_factor(&context.place, &uncorrected.ends_at)
        } else {
            self.calibration.skill(self.task_type().as_str())
        };
        let Some(factor) = factor else { return Ok(uncorrected) };
        let time = Seconds::new(uncorrected.time.get() * factor.mean).unwrap_or(uncorrected.time);
        let (energy, energy_sd) = (uncorrected.energy * factor.mean, uncorrected.energy * factor.sd);
        Ok(Estimate { time, energy, energy_sd, ends_at: uncorrected.ends_at })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{MetresPerSecond, SharePerSecond};
    use consort_skills::environment::{Edge, Routes, TopologicalMap};

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn drive(from: &str, to: &str, factor: f64) -> Observation {
        Observation {
            skill: TaskType::new(NAVIGATION).unwrap(),
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
        Arc::new(Calibration::of(&observed, 0.9))
    }

    #[test]
    fn a_rare_leg_uses_its_slower_end_or_all_drives() {
        let learned = learned();
        let close = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-9, "{found}, not {wanted}");
        let leg = learned.leg_factor(&place("A"), &place("B")).unwrap();
        close(leg.mean, 2.0);
        close(leg.upper, 2.4);
        assert_eq!(leg.count, 11);
        close(learned.leg_factor(&place("C"), &place("B")).unwrap().upper, 1.0);
        // Too few drives from A to C: the drives from A are used, including the drive to C.
        close(learned.leg_factor(&place("A"), &place("C")).unwrap().mean, 31.0 / 12.0);
        close(learned.leg_factor(&place("X"), &place("Y")).unwrap().mean, 36.0 / 17.0);
        assert_eq!(Calibration::of(&[], 0.9).leg_factor(&place("A"), &place("B")), None);
    }

    #[test]
    fn estimates_use_the_mean_and_the_reserve_uses_the_quantile() {
        let map = TopologicalMap {
            places: ["A", "B"].map(|name| (place(name), Pose::default())).into(),
            edges: vec![Edge { a: place("A"), b: place("B"), length_m: 10.0, one_way: false }],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let estimator = learned().descriptors().resolve(environment).unwrap();
        let context = EstimateContext {
            place: place("A"),
            pose: None,
            speed: MetresPerSecond::new(0.5).unwrap(),
            discharge: SharePerSecond::new(0.001).unwrap(),
            closed: vec![],
        };
        let mut task = TaskSpec::of(TaskType::new(NAVIGATION).unwrap(), vec!["r1".parse().unwrap()]);
        task.parameters.insert("to".to_owned(), "B".to_owned());
        let estimate = estimator.estimate(&task, &context).unwrap();
        let close =
            |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-6, "{found}, not {wanted}: {estimate:?}");
        close(estimate.time.get(), 40.0);
        close(estimate.energy, 0.04);
        // The standard deviation of 1.5, 1.6, … 2.5, and the 90 % quantile of a normal
        // distribution.
        close(estimate.energy_sd, 0.02 * 0.11_f64.sqrt());
        close(estimator.margin_sds(), 1.281_552);
    }

    #[test]
    fn a_calibration_is_read_back_unchanged() {
        let learned = learned();
        let text = toml::to_string(&*learned).unwrap();
        assert_eq!(toml::from_str::<Calibration>(&text).unwrap(), *learned);
    }
}
