//! The reserve of bids: after a role the robot must be able to reach a charger. Otherwise it plans a stop before the role.

use super::{ChargingForecast, ChargingSettings, RobotCharging};
use crate::robot::own_tasks::{Drive, dock_at, nearest};
use consort_protocol::auction::{BidLimits, ChargingStop, RefusalReason, StopLimits, StopOption, plan_stop};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::units::BatteryShare;
use consort_skills::descriptor::{EstimateContext, Estimator, PlanBudget};
use std::collections::BTreeSet;

/// Chargers, one of which a robot must be able to reach after a role. On arrival it must have more charge than the limits
/// of bids require.
#[derive(Debug, Clone)]
pub struct ChargerReserve {
    chargers: BTreeSet<PlaceId>,
    limits: BidLimits,
    /// Forecast of the charging, and the charge up to which the robot charges at most; `None` for a robot that plans no stops.
    stops: Option<(ChargingForecast, BatteryShare)>,
}

/// State of a robot before a stop at a charger.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BeforeStop<'a> {
    pub(crate) charge: f64,
    pub(crate) useful_charge: BatteryShare,
    pub(crate) context: &'a EstimateContext,
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

    /// Plans stops with this forecast, up to a charge; none if the forecast does not know the gains, since each charger would be
    /// priced in vain.
    pub(in crate::robot) fn with_stops(self, forecast: ChargingForecast, until: BatteryShare) -> ChargerReserve {
        ChargerReserve { stops: forecast.is_known().then_some((forecast, until)), ..self }
    }

    /// Returns the charge that the robot must always exceed.
    pub(crate) fn floor(&self, useful_charge: BatteryShare) -> BatteryShare {
        self.limits.charge_floor(useful_charge)
    }

    /// Returns the stop with which a role ends first, with the budget of the role from the charger on. `budget_from` returns
    /// the budget of the role from a place on.
    pub(crate) fn plan_stop(
        &self,
        before: BeforeStop<'_>,
        estimator: &Estimator,
        budget_from: impl Fn(&EstimateContext) -> Option<PlanBudget>,
    ) -> Option<(ChargingStop, PlanBudget)> {
        let BeforeStop { charge, useful_charge, context } = before;
        let (forecast, until) = self.stops.as_ref()?;
        let at = |place: PlaceId| EstimateContext { place, pose: None, ..context.clone() };
        let role_from = |context: &EstimateContext| {
            let budget = budget_from(context)?;
            let onward = nearest(estimator, &at(budget.ends_at.clone()), &self.chargers).into_iter().next()?;
            Some((budget, onward))
        };
        let option = |drive: Drive| {
            let there = at(drive.to.clone());
            let dock = estimator.estimate(&dock_at(&drive.to), &there).ok()?;
            let (budget, onward) = role_from(&there)?;
            let option = StopOption {
                charger: drive.to,
                way_time: drive.time + dock.time,
                way_energy: drive.energy + dock.energy,
                role_time: budget.time(),
                role_energy: budget.energy,
                onward_energy: onward.energy,
            };
            Some((option, budget))
        };
        let drives = nearest(estimator, context, &self.chargers);
        let (options, budgets): (Vec<StopOption>, Vec<PlanBudget>) = drives.into_iter().filter_map(option).unzip();
        let floor = self.floor(useful_charge);
        let needed = |(budget, onward): (PlanBudget, Drive)| floor.get() + budget.energy + onward.energy;
        let needed_here = role_from(context).map_or(f64::INFINITY, needed);
        let limits = StopLimits { charge, floor, needed_here, until: *until };
        let stop = plan_stop(limits, &options, |charger, from, to| forecast.known_time(charger, from, to))?;
        let mut both = options.iter().zip(budgets);
        let budget = both.find_map(|(option, budget)| (option.charger == stop.charger).then_some(budget))?;
        Some((stop, budget))
    }

    /// Creates the reserve of a robot that may use these chargers.
    pub(crate) fn new(chargers: BTreeSet<PlaceId>, limits: BidLimits) -> ChargerReserve {
        ChargerReserve { chargers, limits, stops: None }
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
        let reserve = self.floor(useful_charge).get();
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
