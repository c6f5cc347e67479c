//! What trials teach about estimates: how long tasks really take, by skill and by leg, with how much uncertainty.
//!
//! A factor is how many times as long as estimated something took. A calibrated descriptor multiplies its estimates of time and
//! energy by the mean factor and says, by its standard deviation, how far off they still may be. The robot then keeps a
//! reserve: a bid is viable only if the battery lasts for an upper quantile of what the whole plan takes, and not just for the
//! mean. Legs that were driven too rarely are judged by all drives to or from the same place, and failing that by all drives.

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

/// Fewer observations than this say nothing by themselves: with five, the upper quantile lies between the two largest.
pub const MIN_OBSERVATIONS: usize = 5;

/// The share of cases in which the battery is to last. Default of `consort experiment calibrate`.
pub const DEFAULT_QUANTILE: f64 = 0.9;

/// The one skill whose tasks lead from place to place.
const NAVIGATION: &str = "navigation";

/// One task, as it was estimated and as it came to pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// The kind of task.
    pub skill: TaskType,
    /// Where a drive began.
    pub from: Option<PlaceId>,
    /// Where it led.
    pub to: Option<PlaceId>,
    /// Estimated time in seconds.
    pub predicted_s: f64,
    /// What it took.
    pub actual_s: f64,
    /// Estimated energy, as a share of a full battery.
    pub predicted_share: f64,
    /// What was used, as a share of a full battery.
    pub actual_share: f64,
    /// The energy with which it was reckoned to be safe: the estimate, and the reserve for this task alone.
    pub budget_share: f64,
}

/// How many times as long as estimated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TimeFactor {
    /// How many observations it comes from.
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

/// A factor of drives between two places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LegFactor {
    /// Where they begin.
    pub from: PlaceId,
    /// Where they lead.
    pub to: PlaceId,
    /// The factor.
    pub factor: TimeFactor,
}

/// What was learned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// The share of cases that upper quantiles hold for, and in which the battery is to last: 0.5 to below 1.
    pub quantile: f64,
    /// By skill.
    #[serde(default)]
    pub skills: BTreeMap<TaskType, TimeFactor>,
    /// Drives that lead to a place.
    #[serde(default)]
    pub to: BTreeMap<PlaceId, TimeFactor>,
    /// Drives that begin at a place.
    #[serde(default)]
    pub from: BTreeMap<PlaceId, TimeFactor>,
    /// Drives between two places.
    #[serde(default)]
    pub legs: Vec<LegFactor>,
}

impl Calibration {
    /// What observations teach. Tasks that were estimated to take no time teach nothing.
    pub fn of(observations: &[Observation], quantile: f64) -> Calibration {
        let mut skills: BTreeMap<TaskType, Vec<f64>> = BTreeMap::new();
        let (mut to, mut from) = (BTreeMap::<PlaceId, Vec<f64>>::new(), BTreeMap::<PlaceId, Vec<f64>>::new());
        let mut legs: BTreeMap<(PlaceId, PlaceId), Vec<f64>> = BTreeMap::new();
        for seen in observations.iter().filter(|seen| seen.predicted_s > 0.0) {
            let factor = seen.actual_s / seen.predicted_s;
            skills.entry(seen.skill.clone()).or_default().push(factor);
            if let (Some(start), Some(end)) = (&seen.from, &seen.to) {
                to.entry(end.clone()).or_default().push(factor);
                from.entry(start.clone()).or_default().push(factor);
                legs.entry((start.clone(), end.clone())).or_default().push(factor);
            }
        }
        fn fit<K: Ord>(seen: BTreeMap<K, Vec<f64>>, quantile: f64) -> impl Iterator<Item = (K, TimeFactor)> {
            seen.into_iter().filter_map(move |(key, factors)| Some((key, TimeFactor::of(&factors, quantile)?)))
        }
        Calibration {
            quantile,
            skills: fit(skills, quantile).collect(),
            to: fit(to, quantile).collect(),
            from: fit(from, quantile).collect(),
            legs: fit(legs, quantile).map(|((from, to), factor)| LegFactor { from, to, factor }).collect(),
        }
    }

    /// What is known of a drive; `None` if no drives were seen at all.
    pub fn leg_factor(&self, from: &PlaceId, to: &PlaceId) -> Option<TimeFactor> {
        let leg = self.legs.iter().find(|leg| leg.from == *from && leg.to == *to).map(|leg| leg.factor);
        // Of the two ends the slower makes itself felt.
        let ends = [self.to.get(to), self.from.get(from)].into_iter().flatten();
        let end = ends.max_by(|a, b| a.mean.total_cmp(&b.mean)).copied();
        leg.or(end).or_else(|| self.skill(NAVIGATION))
    }

    fn skill(&self, name: &str) -> Option<TimeFactor> {
        self.skills.iter().find(|(skill, _)| skill.as_str() == name).map(|(_, factor)| *factor)
    }

    /// How many standard deviations above the mean the quantile lies, where a plan takes a normal amount of energy.
    pub fn margin_sds(&self) -> f64 {
        use statrs::distribution::{ContinuousCDF, Normal};
        Normal::standard().inverse_cdf(self.quantile.clamp(0.5, 0.9999))
    }

    /// The standard descriptors with what was learned, and with a reserve for the quantile.
    pub fn descriptors(self: &Arc<Calibration>) -> DescriptorRegistry {
        let name = |name: &str| TaskType::new(name).expect("a skill's own name");
        let drives = Calibrated { inner: NavigationDescriptor::new(name(NAVIGATION)), calibration: Arc::clone(self) };
        let registry = DescriptorRegistry::standard().with(drives).with_energy_margin(self.margin_sds());
        // Tasks of stated length are left as they are stated.
        let fixed = self.skills.keys().filter(|skill| ![NAVIGATION, "wait"].contains(&skill.as_str()));
        let time = Seconds::new(STEP_DURATION_S).expect("two seconds are a duration");
        fixed.fold(registry, |registry, skill| {
            registry.with(Calibrated { inner: FixedDuration::new(skill.clone(), time), calibration: Arc::clone(self) })
        })
    }
}

/// A descriptor whose estimates are corrected by what was learned.
#[derive(Debug, Clone)]
pub struct Calibrated<D> {
    /// The descriptor.
    pub inner: D,
    /// What was learned.
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
        let plain = self.inner.estimate(task, context, environment)?;
        let factor = if self.task_type().as_str() == NAVIGATION {
            self.calibration.leg_factor(&context.place, &plain.ends_at)
        } else {
            self.calibration.skill(self.task_type().as_str())
        };
        let Some(factor) = factor else { return Ok(plain) };
        let time = Seconds::new(plain.time.get() * factor.mean).unwrap_or(plain.time);
        let (energy, energy_sd) = (plain.energy * factor.mean, plain.energy * factor.sd);
        Ok(Estimate { time, energy, energy_sd, ends_at: plain.ends_at })
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
        let mut seen: Vec<Observation> = (0..11).map(|step| drive("A", "B", 1.5 + f64::from(step) / 10.0)).collect();
        seen.extend((0..5).map(|_| drive("C", "B", 1.0)));
        seen.push(drive("A", "C", 9.0));
        Arc::new(Calibration::of(&seen, 0.9))
    }

    #[test]
    fn a_leg_is_judged_by_itself_then_by_its_slower_end_then_by_all_drives() {
        let learned = learned();
        let close = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-9, "{found}, not {wanted}");
        let leg = learned.leg_factor(&place("A"), &place("B")).unwrap();
        close(leg.mean, 2.0);
        close(leg.upper, 2.4);
        assert_eq!(leg.count, 11);
        close(learned.leg_factor(&place("C"), &place("B")).unwrap().upper, 1.0);
        // Too few drives from A to C: those from A count, with the one to C among them.
        close(learned.leg_factor(&place("A"), &place("C")).unwrap().mean, 31.0 / 12.0);
        close(learned.leg_factor(&place("X"), &place("Y")).unwrap().mean, 36.0 / 17.0);
        assert_eq!(Calibration::of(&[], 0.9).leg_factor(&place("A"), &place("B")), None);
    }

    #[test]
    fn time_and_energy_are_corrected_by_the_mean_and_the_reserve_is_for_the_quantile() {
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
        // The standard deviation of 1.5, 1.6, … 2.5, and the 90 % quantile of a normal distribution.
        close(estimate.energy_sd, 0.02 * 0.11_f64.sqrt());
        close(estimator.margin_sds(), 1.281_552);
    }

    #[test]
    fn what_was_learned_reads_back() {
        let learned = learned();
        let text = toml::to_string(&*learned).unwrap();
        assert_eq!(toml::from_str::<Calibration>(&text).unwrap(), *learned);
    }
}
