//! Energy check of the remaining plan, as a value. The computation is the same as for the bid and
//! is repeated during execution. The reserve of the bid is available to the plan: the role is
//! released only if the most likely charge at the end is too low.

use consort_protocol::auction::BidLimits;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::plan::LocalPlan;
use consort_protocol::units::{BatteryShare, MetresPerSecond};
use consort_skills::descriptor::{EstimateContext, Estimator, PriceError};
use consort_skills::environment::SpeedLimits;

/// Tolerance below the floor, as a share of a full battery: a bid that was accepted narrowly is not
/// given back because of a small error of the estimate. The value is a guess: the energy that a
/// robot of the published evaluation uses in 12 s.
const SLACK: f64 = 0.005;

/// Predicted charge of the battery.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EnergyForecast {
    /// Charge at the end of the plan, as a share of a full battery; negative if the battery would
    /// not last.
    pub(super) remaining: f64,
    /// Required charge: the maximum of the fleet's minimum and the robot's own useful charge, as
    /// for bids.
    pub(super) floor: BatteryShare,
}

impl EnergyForecast {
    /// Prices the remaining plan in the context of the robot, at its current pose and charge.
    ///
    /// # Errors
    /// [`PriceError`] if a step cannot be priced. The attempt to execute the step then reports the
    /// cause.
    pub(super) fn new(
        estimator: &Estimator,
        rest: &LocalPlan,
        worker: &RobotKnowledge,
        context: &EstimateContext,
        limits: &BidLimits,
    ) -> Result<EnergyForecast, PriceError> {
        let energy: f64 = estimator.price(rest, context)?.iter().map(|part| part.energy).sum();
        let floor = limits.charge_floor(worker.useful_charge);
        Ok(EnergyForecast { remaining: worker.battery.get() - energy, floor })
    }

    /// Returns an error text if the battery will not last.
    pub(super) fn shortfall(&self) -> Option<String> {
        (self.remaining < self.floor.get() - SLACK).then(|| {
            let (left, floor) = (self.remaining * 100.0, self.floor.get() * 100.0);
            format!("the rest of the plan would leave {left:.1} % of the battery, less than {floor:.1} %")
        })
    }
}

/// Returns the estimator's input for the robot at its current or last passed place; `closed`
/// contains the lanes that the driver has found closed, and what people have closed. `limits` are the speed limits of
/// people.
pub(crate) fn pricing_context(
    worker: &RobotKnowledge,
    closed: &[(PlaceId, PlaceId)],
    limits: &SpeedLimits,
) -> EstimateContext {
    // A robot that does not drive has no navigation task to price, so its speed is irrelevant.
    let speed = worker.speed.unwrap_or(MetresPerSecond::new(1.0).expect("1 m/s is a speed"));
    let (place, discharge, attributes) = (worker.place.clone(), worker.discharge, worker.attributes.clone());
    EstimateContext {
        place,
        pose: None,
        speed,
        discharge,
        closed: closed.to_vec(),
        limits: limits.clone(),
        attributes,
        readings: None,
    }
}
