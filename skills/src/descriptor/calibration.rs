//! Calibration of a robot's estimates: factors by skill and by leg, as a file contains them.
//!
//! A factor is the ratio of actual to estimated duration. A calibrated descriptor multiplies its
//! estimates of time and energy by the mean factor, and uses its standard deviation as the
//! uncertainty. The robot then keeps a reserve: a bid is viable only if the battery lasts for an
//! upper quantile of the energy of the whole plan, not only for the mean. A leg with too few drives
//! uses all drives to or from the same place, and failing that all drives of the same skill. The
//! [destination](SkillDescriptor::destination) of a descriptor says whether its tasks are drives.
//!
//! The ratio of actual to estimated discharge rate of a skill multiplies its energy, too. The measured charging of
//! batteries is not part of the estimates of tasks: robots forecast their stops at chargers with it.
//!
//! The evaluation computes the factors from trials, and what concerns batteries from recordings; this module only
//! applies them.

use super::estimate::{Estimate, EstimateContext, EstimateError, SkillDescriptor};
use super::registry::DescriptorRegistry;
use crate::environment::Environment;
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ids::{PlaceId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{Seconds, SharePerSecond};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

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
    fn is_sound(&self) -> bool {
        let above = |number: f64| number.is_finite() && number > 0.0;
        above(self.mean) && above(self.upper) && self.sd.is_finite() && self.sd >= 0.0
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

/// Charging of batteries, as measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuredCharging {
    /// Share of a full battery that a battery gains per second at its full power, above 0. Robots forecast with it where
    /// the power of a charger or their capacity is unknown.
    pub share_per_s: SharePerSecond,
    /// Charging curve, as in `charging.curve` of a fleet file: robots forecast with this one instead. Default: full power
    /// up to the end.
    #[serde(default, skip_serializing_if = "ChargingCurve::is_empty")]
    pub curve: ChargingCurve,
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
    /// Ratios of actual to estimated discharge rate, by skill. They multiply the energy beside the factors of durations.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub discharge: BTreeMap<TaskType, f64>,
    /// Measured charging. Default: not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charging: Option<MeasuredCharging>,
}

impl Calibration {
    /// Returns every value of the file that is out of range, as text.
    pub fn validation_errors(&self) -> Vec<String> {
        let skills = self.skills.iter().map(|(skill, factor)| (format!("skills.{skill}"), factor));
        let to = self.to.iter().map(|(place, factor)| (format!("to.{:?}", place.as_str()), factor));
        let from = self.from.iter().map(|(place, factor)| (format!("from.{:?}", place.as_str()), factor));
        let legs = self.legs.iter().map(|leg| (format!("legs, {} to {}", leg.from, leg.to), &leg.factor));
        let wrong = skills.chain(to).chain(from).chain(legs).filter(|(_, factor)| !factor.is_sound());
        let mut errors: Vec<String> = wrong
            .map(|(key, TimeFactor { mean, sd, upper, .. })| {
                let allowed = "allowed are a mean and an upper quantile above 0, and a deviation of 0 or more";
                format!("{key}: mean {mean}, sd {sd}, upper {upper}; {allowed}")
            })
            .collect();
        let rates = self.discharge.iter().filter(|(_, ratio)| !(ratio.is_finite() && **ratio > 0.0));
        errors.extend(rates.map(|(skill, ratio)| format!("discharge.{skill} is {ratio}, allowed is a number above 0")));
        if self.charging.as_ref().is_some_and(|charging| charging.share_per_s.get() <= 0.0) {
            errors.push("charging.share_per_s is 0, allowed is a rate above 0".to_owned());
        }
        if !(0.5..1.0).contains(&self.quantile) {
            errors.push(format!("quantile is {}, allowed is 0.5 to below 1", self.quantile));
        }
        errors
    }

    /// Returns the factor of a drive in a task of this skill; `None` without observed drives.
    pub fn leg_factor(&self, skill: &TaskType, from: &PlaceId, to: &PlaceId) -> Option<TimeFactor> {
        let leg = self.legs.iter().find(|leg| leg.from == *from && leg.to == *to).map(|leg| leg.factor);
        // Of the two ends the slower determines the factor.
        let ends = [self.to.get(to), self.from.get(from)].into_iter().flatten();
        let end = ends.max_by(|a, b| a.mean.total_cmp(&b.mean)).copied();
        leg.or(end).or_else(|| self.skills.get(skill).copied())
    }

    /// Returns the distance of the quantile from the mean in standard deviations, for plans with
    /// normally distributed energy.
    pub fn margin_sds(&self) -> f64 {
        upper_normal_quantile(self.quantile.clamp(0.5, 0.9999))
    }

    /// Returns these descriptors with the factors, and with a reserve for the quantile.
    pub fn correct(self: &Arc<Calibration>, descriptors: DescriptorRegistry) -> DescriptorRegistry {
        let correct = |descriptor: Box<dyn SkillDescriptor>| -> Box<dyn SkillDescriptor> {
            let task_type = descriptor.task_type();
            let is_observed = descriptor.destination().is_some() || self.skills.contains_key(task_type);
            // The duration of tasks with a given duration is not corrected.
            let corrects_time = is_observed && !descriptor.is_given();
            match corrects_time || self.discharge.contains_key(task_type) {
                true => {
                    let calibration = Arc::clone(self);
                    Box::new(Calibrated { inner: descriptor, calibration, corrects_time })
                }
                false => descriptor,
            }
        };
        descriptors.map(correct).with_energy_margin(self.margin_sds())
    }
}

/// A descriptor with estimates corrected by a calibration.
struct Calibrated {
    inner: Box<dyn SkillDescriptor>,
    calibration: Arc<Calibration>,
    /// The factors of durations hold.
    corrects_time: bool,
}

impl SkillDescriptor for Calibrated {
    fn task_type(&self) -> &TaskType {
        self.inner.task_type()
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        self.inner.required_descriptors()
    }

    fn destination(&self) -> Option<&str> {
        self.inner.destination()
    }

    fn discharge_multiple(&self) -> Option<f64> {
        self.inner.discharge_multiple()
    }

    fn grows_with_drives(&self) -> bool {
        self.inner.grows_with_drives()
    }

    fn estimate(
        &self,
        task: &TaskSpec,
        context: &EstimateContext,
        environment: &Environment,
    ) -> Result<Estimate, EstimateError> {
        let estimated = self.inner.estimate(task, context, environment)?;
        let discharge = self.calibration.discharge.get(self.task_type()).copied().unwrap_or(1.0);
        let uncorrected = Estimate { energy: estimated.energy * discharge, ..estimated };
        let factor = match self.destination() {
            Some(_) => self.calibration.leg_factor(self.task_type(), &context.place, &uncorrected.ends_at),
            None => self.calibration.skills.get(self.task_type()).copied(),
        };
        let Some(factor) = factor.filter(|_| self.corrects_time) else { return Ok(uncorrected) };
        let time = Seconds::new(uncorrected.time.get() * factor.mean).unwrap_or(uncorrected.time);
        let (energy, energy_sd) = (uncorrected.energy * factor.mean, uncorrected.energy * factor.sd);
        Ok(Estimate { time, energy, energy_sd, ends_at: uncorrected.ends_at })
    }
}

/// Numerator and denominator for shares up to 0.925, highest power first.
const CENTRE: ([f64; 8], [f64; 8]) = (
    [
        2509.0809287301227,
        33430.57558358813,
        67265.7709270087,
        45921.95393154987,
        13731.69376550946,
        1971.5909503065513,
        133.14166789178438,
        3.3871328727963665,
    ],
    [
        5226.495278852854,
        28729.085735721943,
        39307.89580009271,
        21213.794301586597,
        5394.196021424751,
        687.1870074920579,
        42.31333070160091,
        1.0,
    ],
);

/// Numerator and denominator for larger shares, highest power first.
const TAIL: ([f64; 8], [f64; 8]) = (
    [
        0.0007745450142783414,
        0.022723844989269184,
        0.2417807251774506,
        1.2704582524523684,
        3.6478483247632045,
        5.769497221460691,
        4.630337846156546,
        1.4234371107496835,
    ],
    [
        1.0507500716444169e-09,
        0.0005475938084995345,
        0.015198666563616457,
        0.14810397642748008,
        0.6897673349851,
        1.6763848301838038,
        2.053191626637759,
        1.0,
    ],
);

/// Returns the quantile of the standard normal distribution for a share of 0.5 to 0.9999, by
/// algorithm AS 241 (Wichura, *The percentage points of the normal distribution*, Applied
/// Statistics 37, 1988). Its relative error is about 1e-16.
fn upper_normal_quantile(share: f64) -> f64 {
    let polynomial = |coefficients: &[f64], at: f64| coefficients.iter().fold(0.0, |sum, next| sum * at + next);
    let offset = share - 0.5;
    if offset <= 0.425 {
        let at = 0.180625 - offset * offset;
        return offset * polynomial(&CENTRE.0, at) / polynomial(&CENTRE.1, at);
    }
    let at = (-(1.0 - share).ln()).sqrt() - 1.6;
    polynomial(&TAIL.0, at) / polynomial(&TAIL.1, at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain_file::DomainFile;
    use crate::environment::{Edge, Routes, TopologicalMap};
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{MetresPerSecond, SharePerSecond};

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn skill(name: &str) -> TaskType {
        TaskType::new(name).unwrap()
    }

    fn factor(mean: f64) -> TimeFactor {
        TimeFactor { count: 11, mean, sd: 0.11_f64.sqrt(), upper: mean + 0.4 }
    }

    /// Returns factors of 2 for drives from A to B, and 3 for all drives from A; for others 1.5, and 4 with an item.
    fn learned() -> Arc<Calibration> {
        Arc::new(Calibration {
            quantile: 0.9,
            skills: [(skill("navigation"), factor(1.5)), (skill("carry"), factor(4.0))].into(),
            to: [(place("B"), factor(1.0))].into(),
            from: [(place("A"), factor(3.0))].into(),
            legs: vec![LegFactor { from: place("A"), to: place("B"), factor: factor(2.0) }],
            discharge: BTreeMap::new(),
            charging: None,
        })
    }

    #[test]
    fn a_leg_without_a_factor_uses_its_slower_end_or_all_drives() {
        let of = |calibration: &Calibration, name, from, to| {
            calibration.leg_factor(&skill(name), &place(from), &place(to)).map(|factor| factor.mean)
        };
        let mean = |from, to| of(&learned(), "navigation", from, to).unwrap();
        assert_eq!([mean("A", "B"), mean("A", "C"), mean("C", "B"), mean("X", "Y")], [2.0, 3.0, 1.0, 1.5]);
        assert_eq!(of(&learned(), "carry", "X", "Y"), Some(4.0), "all drives of the same skill");
        let slower_end = Calibration { legs: vec![], ..(*learned()).clone() };
        assert_eq!(of(&slower_end, "navigation", "A", "B"), Some(3.0));
        let none = Calibration { skills: BTreeMap::new(), ..(*learned()).clone() };
        assert_eq!(of(&none, "navigation", "X", "Y"), None);
    }

    #[test]
    fn estimates_use_the_mean_and_the_reserve_uses_the_quantile() {
        let map = TopologicalMap {
            places: ["A", "B"].map(|name| (place(name), Pose::default())).into(),
            edges: vec![Edge { a: place("A"), b: place("B"), length_m: 10.0, one_way: false }],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let vans = serde_json::json!({
            "domain": "vans",
            "actions": { "drive": { "parameters": { "to": { "type": "place" } } } },
            "tasks": {
                "haul": {
                    "parameters": { "to": { "type": "place" } },
                    "action": "drive",
                    "estimate": { "time_s": "travel_s.to", "ends_at": "to" },
                },
            },
        });
        let vans = DomainFile::check(serde_json::from_value(vans).unwrap(), &BTreeMap::new(), &[]).unwrap();
        let descriptors = vans.extend_descriptors(DescriptorRegistry::standard());
        let estimator = learned().correct(descriptors).resolve(environment).unwrap();
        let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap());
        let context = EstimateContext::at(place("A"), speed, discharge);
        let task = |name: &str| {
            let parameters = [("to".to_owned(), "B".to_owned())].into();
            TaskSpec { parameters, ..TaskSpec::of(skill(name), vec!["r1".parse().unwrap()]) }
        };
        let estimate = estimator.estimate(&task("navigation"), &context).unwrap();
        let close =
            |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-6, "{found}, not {wanted}: {estimate:?}");
        close(estimate.time.get(), 40.0);
        close(estimate.energy, 0.04);
        // The standard deviation of 1.5, 1.6, … 2.5, and the 90 % quantile of a normal
        // distribution.
        close(estimate.energy_sd, 0.02 * 0.11_f64.sqrt());
        close(estimator.margin_sds(), 1.281_552);
        assert_eq!(estimator.estimate(&task("carry"), &context).unwrap(), estimate, "it is a drive, too");
        let rates = Calibration { discharge: [(skill("navigation"), 1.5)].into(), ..(*learned()).clone() };
        let measured = Arc::new(rates).correct(DescriptorRegistry::standard()).resolve(estimator.environment().clone());
        let measured = measured.unwrap().estimate(&task("navigation"), &context).unwrap();
        assert_eq!(measured.time, estimate.time);
        assert!((measured.energy - 0.06).abs() < 1e-9, "{measured:?}");
        assert_eq!(estimator.estimate(&task("haul"), &context).unwrap(), estimate, "as is a drive of a domain file");
        let destination = |name| estimator.destination(&task(name));
        let drives = ["navigation", "carry", "disinfect", "follow_path"].map(|name| destination(name).is_some());
        assert_eq!(drives, [true, true, false, false]);
        assert_eq!(destination("carry"), Some(place("B")));
    }

    #[test]
    fn the_multiple_of_a_type_with_its_own_energy_is_unknown() {
        let garden = serde_json::json!({
            "domain": "garden",
            "actions": { "dig": { "discharge": 3.0 } },
            "tasks": {
                "dig": { "action": "dig", "estimate": { "time_s": "20.0" } },
                "weigh": { "action": "dig", "estimate": { "time_s": "20.0", "energy": "0.01" } },
            },
        });
        let garden = DomainFile::check(serde_json::from_value(garden).unwrap(), &BTreeMap::new(), &[]).unwrap();
        let multiples = garden.extend_descriptors(DescriptorRegistry::standard()).discharge_multiples();
        let multiple = |name| multiples.get(&skill(name)).copied();
        assert_eq!(["dig", "weigh", "navigation"].map(multiple), [Some(3.0), None, Some(1.0)]);
    }

    #[test]
    fn a_value_out_of_range_is_reported_with_its_key() {
        assert_eq!(learned().validation_errors(), [""; 0]);
        let mut wrong = (*learned()).clone();
        (wrong.quantile, wrong.legs[0].factor.sd) = (1.0, f64::NAN);
        let share_per_s = SharePerSecond::new(0.0).unwrap();
        wrong.charging = Some(MeasuredCharging { share_per_s, curve: ChargingCurve::default() });
        assert_eq!(
            wrong.validation_errors(),
            [
                "legs, A to B: mean 2, sd NaN, upper 2.4; allowed are a mean and an upper quantile above 0, and a \
                 deviation of 0 or more",
                "charging.share_per_s is 0, allowed is a rate above 0",
                "quantile is 1, allowed is 0.5 to below 1",
            ]
        );
    }
}
