//! Charging curve: batteries take less power the fuller they are.

use crate::units::{BatteryShare, Seconds, SharePerSecond};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A step of a charging curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CurveStep {
    /// Charge from which on it holds, as a share.
    pub above: BatteryShare,
    /// Share of its full power with which a battery charges from there on, above 0 to 1.
    pub power: f64,
}

/// Error: the steps are not a charging curve.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// A battery with this power would charge for ever, or faster than with its full power.
    #[error("power is {0}, allowed is above 0 to 1")]
    Power(f64),
    /// The steps are not in the order of their charges.
    #[error("above is {}, allowed is more than {}, that of the step before", .0.get(), .1.get())]
    Order(BatteryShare, BatteryShare),
}

/// Charging curve of the batteries of a fleet: full power up to the first step, and that of the latest step from there on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Vec<CurveStep>")]
#[schemars(with = "Vec<CurveStep>")]
pub struct ChargingCurve(Vec<CurveStep>);

impl TryFrom<Vec<CurveStep>> for ChargingCurve {
    type Error = CurveError;

    fn try_from(steps: Vec<CurveStep>) -> Result<ChargingCurve, CurveError> {
        let is_share = |power: f64| power > 0.0 && power <= 1.0;
        if let Some(step) = steps.iter().find(|step| !is_share(step.power)) {
            return Err(CurveError::Power(step.power));
        }
        let mut pairs = steps.windows(2).map(|pair| (pair[0].above, pair[1].above));
        match pairs.find(|(before, above)| above <= before) {
            Some((before, above)) => Err(CurveError::Order(above, before)),
            None => Ok(ChargingCurve(steps)),
        }
    }
}

impl ChargingCurve {
    /// Checks whether batteries always charge with their full power.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the share of the full power at this charge.
    pub fn power_at(&self, charge: f64) -> f64 {
        self.0.iter().rev().find(|step| step.above.get() <= charge).map_or(1.0, |step| step.power)
    }

    /// Returns the share of the full power just below this charge.
    pub fn power_below(&self, charge: f64) -> f64 {
        self.0.iter().rev().find(|step| step.above.get() < charge).map_or(1.0, |step| step.power)
    }

    /// Returns the charge at which the next step begins; `None` after the last.
    pub fn next_step(&self, charge: f64) -> Option<f64> {
        self.0.iter().map(|step| step.above.get()).find(|above| *above > charge)
    }

    /// Returns the charge below this one at which a step begins; `None` up to the first.
    pub fn step_below(&self, charge: f64) -> Option<f64> {
        self.0.iter().rev().map(|step| step.above.get()).find(|above| *above < charge)
    }

    /// Returns the forecast of the time in which a battery charges, with this gain at its full power.
    pub fn time(&self, from: f64, to: f64, full: SharePerSecond) -> Seconds {
        let (mut at, mut time) = (from, 0.0);
        while at < to {
            let end = self.next_step(at).map_or(to, |step| step.min(to));
            time += (end - at) / (self.power_at(at) * full.get());
            at = end;
        }
        Seconds::new(time.min(f64::MAX)).expect("a finite time of 0 or more")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(steps: &[(f64, f64)]) -> Result<ChargingCurve, CurveError> {
        let step = |(above, power): &(f64, f64)| CurveStep { above: BatteryShare::new(*above).unwrap(), power: *power };
        steps.iter().map(step).collect::<Vec<_>>().try_into()
    }

    #[test]
    fn a_battery_charges_more_slowly_from_each_step_on() {
        let curve = curve(&[(0.8, 0.5), (0.9, 0.25)]).unwrap();
        assert_eq!([0.0, 0.79, 0.8, 0.9, 1.0].map(|charge| curve.power_at(charge)), [1.0, 1.0, 0.5, 0.25, 0.25]);
        assert_eq!([0.0, 0.8, 0.9].map(|charge| curve.next_step(charge)), [Some(0.8), Some(0.9), None]);
        assert_eq!([0.8, 0.81, 0.9].map(|charge| curve.power_below(charge)), [1.0, 0.5, 0.5]);
        assert_eq!([0.8, 0.9, 1.0].map(|charge| curve.step_below(charge)), [None, Some(0.8), Some(0.9)]);
        let full = SharePerSecond::new(0.01).unwrap();
        let time = |from, to| curve.time(from, to, full).get();
        assert!((time(0.7, 1.0) - (10.0 + 20.0 + 40.0)).abs() < 1e-9, "{}", time(0.7, 1.0));
        assert!((time(0.85, 0.9) - 10.0).abs() < 1e-9, "{}", time(0.85, 0.9));
        assert_eq!(time(0.9, 0.9), 0.0);
        assert_eq!(curve.time(0.5, 0.9, SharePerSecond::new(0.0).unwrap()).get(), f64::MAX);
    }

    #[test]
    fn steps_that_are_no_curve_are_rejected() {
        let share = |share| BatteryShare::new(share).unwrap();
        assert_eq!(curve(&[(0.8, 0.0)]), Err(CurveError::Power(0.0)));
        assert_eq!(curve(&[(0.8, 1.1)]), Err(CurveError::Power(1.1)));
        assert!(curve(&[(0.8, f64::NAN)]).is_err());
        let order = curve(&[(0.8, 0.5), (0.8, 0.2)]).unwrap_err();
        assert_eq!(order, CurveError::Order(share(0.8), share(0.8)));
        assert_eq!(order.to_string(), "above is 0.8, allowed is more than 0.8, that of the step before");
        assert_eq!(curve(&[]), Ok(ChargingCurve::default()));
    }
}
