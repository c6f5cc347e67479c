//! The reserve of bids: after a role the robot must be able to reach a charger.

use super::{ChargingSettings, RobotCharging};
use crate::robot::own_tasks::nearest;
use consort_protocol::auction::{BidLimits, RefusalReason};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::units::BatteryShare;
use consort_skills::descriptor::{EstimateContext, Estimator};
use std::collections::BTreeSet;

/// Chargers, one of which a robot must be able to reach after a role. On arrival it must have more charge than the limits
/// of bids require.
#[derive(Debug, Clone)]
pub struct ChargerReserve {
    chargers: BTreeSet<PlaceId>,
    limits: BidLimits,
}

impl ChargerReserve {
    /// Returns the reserve of a robot with this record. Returns `None` for a robot that does not charge by itself.
    pub fn of(
        settings: &ChargingSettings,
        limits: BidLimits,
        robot: &RobotId,
        worker: &RobotKnowledge,
    ) -> Option<ChargerReserve> {
        let charging = RobotCharging::of(settings, robot, worker, None)?;
        Some(ChargerReserve::new(charging.usable, limits))
    }

    /// Creates the reserve of a robot that may use these chargers.
    pub(crate) fn new(chargers: BTreeSet<PlaceId>, limits: BidLimits) -> ChargerReserve {
        ChargerReserve { chargers, limits }
    }

    /// Checks whether a robot can reach a charger with this charge, from the place of `end`. A charge within
    /// the limit of bids passes: the coordinator rejects such a bid in any case.
    ///
    /// # Errors
    /// [`RefusalReason::ChargerOutOfReach`] with the nearest charger.
    pub(crate) fn check(
        &self,
        remaining: f64,
        useful_charge: BatteryShare,
        estimator: &Estimator,
        end: &EstimateContext,
    ) -> Result<(), RefusalReason> {
        let reserve = self.limits.charge_floor(useful_charge).get();
        if remaining <= reserve {
            return Ok(());
        }
        let Some(drive) = nearest(estimator, end, &self.chargers).into_iter().next() else {
            let problem = format!("there is no way to a charger from {}", end.place);
            return Err(RefusalReason::ChargerOutOfReach { charger: None, problem });
        };
        let left = remaining - drive.energy;
        if left > reserve {
            return Ok(());
        }
        let (left, reserve) = (left * 100.0, reserve * 100.0);
        let problem = format!("{left:.1} % charge left at {} is not above the reserve of {reserve:.1} %", drive.to);
        Err(RefusalReason::ChargerOutOfReach { charger: Some(drive.to), problem })
    }
}
