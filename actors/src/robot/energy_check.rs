//! Whether the battery lasts for the rest of a plan, as values: the same reckoning with which the robot bid, done again on
//! the way. What it kept in reserve when it bid is there to be used: a role is given back only if the battery will not last by
//! the likeliest reckoning.

use consort_protocol::auction::BidLimits;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::plan::LocalPlan;
use consort_protocol::units::{BatteryShare, MetresPerSecond};
use consort_skills::descriptor::{EstimateContext, Estimator, PriceError};

/// What would be left at the end may lie this much below the floor before it counts as falling short: a bid that was only
/// just taken is not given back for a small error of an estimate. A share of a full battery; a guess: what a robot of the
/// published evaluation uses in twelve seconds.
const SLACK: f64 = 0.005;

/// What will be left of the battery.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnergyForecast {
    /// Charge at the end of the plan, as a share of a full battery; negative when it would not last.
    pub remaining: f64,
    /// What it should exceed: the greater of the fleet's minimum and the robot's own useful charge, as for bids.
    pub floor: BatteryShare,
}

impl EnergyForecast {
    /// Prices the rest of a plan from where the robot is, with the charge it has, round the ways that it knows to be closed.
    ///
    /// # Errors
    /// [`PriceError`] when a step of it cannot be priced; whoever tries it will learn why.
    pub fn new(
        estimator: &Estimator,
        rest: &LocalPlan,
        worker: &RobotKnowledge,
        closed: &[(PlaceId, PlaceId)],
        limits: &BidLimits,
    ) -> Result<EnergyForecast, PriceError> {
        let context = EstimateContext { pose: Some(worker.pose), ..pricing_context(worker, closed) };
        let energy: f64 = estimator.price(rest, &context)?.iter().map(|part| part.energy).sum();
        let floor = limits.charge_floor(worker.useful_charge);
        Ok(EnergyForecast { remaining: worker.battery.get() - energy, floor })
    }

    /// In words, if the battery will not last.
    pub fn shortfall(&self) -> Option<String> {
        (self.remaining < self.floor.get() - SLACK).then(|| {
            let (left, floor) = (self.remaining * 100.0, self.floor.get() * 100.0);
            format!("the rest of the plan would leave {left:.1} % of the battery, less than {floor:.1} %")
        })
    }
}

/// The robot as its estimator sees it, at the place where it stands or which it passed last; `closed` are the ways that its
/// body has found closed.
pub(super) fn pricing_context(worker: &RobotKnowledge, closed: &[(PlaceId, PlaceId)]) -> EstimateContext {
    // A robot that does not drive has no navigation task to price: its speed plays no part.
    let speed = worker.speed.unwrap_or(MetresPerSecond::new(1.0).expect("1 m/s is a speed"));
    let (place, discharge, closed) = (worker.place.clone(), worker.discharge, closed.to_vec());
    EstimateContext { place, pose: None, speed, discharge, closed }
}
