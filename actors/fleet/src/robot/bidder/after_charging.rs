//! Bids for the time after a stop at a charger.

use super::{Bidder, EstimatedTravel};
use crate::robot::charging::BeforeStop;
use consort_protocol::auction::{Bid, PlannedRole, PromisedRole, RoleSpan, TimelineStart, end_of_promised};
use consort_protocol::units::Energy;
use consort_skills::descriptor::{EstimateContext, PlanBudget};

/// Bid of a robot whose charge does not suffice for the role.
pub(super) struct ShortBid<'a> {
    pub(super) bid: &'a Bid,
    /// Roles that the robot has promised, in their order.
    pub(super) own: &'a [&'a PromisedRole],
    pub(super) start: TimelineStart<'a>,
    /// Charge when the robot is free, as a share of a full battery.
    pub(super) charge: f64,
    /// The robot at the place where it is free.
    pub(super) free: &'a EstimateContext,
}

impl Bidder {
    /// Returns the bid for the time after a stop at a charger, which follows all promised roles except for those of a lower
    /// priority. `budget_from` returns the budget of the role from a place on.
    pub(super) fn after_charging(
        &self,
        ShortBid { bid, own, start, charge, free }: ShortBid<'_>,
        budget_from: impl Fn(&EstimateContext) -> Option<PlanBudget>,
    ) -> Option<Bid> {
        let chargers = self.chargers.as_ref()?;
        let travel = EstimatedTravel { estimator: &self.estimator, context: free };
        let end = end_of_promised(start, own, &travel)?;
        let context = EstimateContext { place: end.place, ..free.clone() };
        let (charge, useful_charge) = (charge - end.energy.get(), bid.useful_charge);
        let before = BeforeStop { charge, useful_charge, context: &context };
        let (stop, budget) = chargers.plan_stop(before, &self.estimator, budget_from)?;
        let time = stop.time + budget.time();
        let energy = Energy::of_share(charge - stop.remaining.get());
        let span = RoleSpan { from: Some(stop.charger.clone()), to: Some(budget.ends_at.clone()), time, energy };
        let charged = end.time + stop.time;
        let begin = if start.release > charged { start.release } else { charged };
        let planned = PlannedRole {
            before: end.before,
            delay: time,
            delayed: end.delayed,
            promised: u32::try_from(own.len()).unwrap_or(u32::MAX),
            energy: end.energy,
            charging: Some(stop.clone()),
            ..PlannedRole::alone(span, begin)
        };
        // Now the role cannot be awarded: it would leave no more than the reserve, or no way to a charger.
        let floor = chargers.floor(useful_charge).get();
        Some(Bid {
            time: budget.time(),
            energy: budget.energy,
            remaining: bid.remaining.min(floor),
            from: stop.charger,
            parts: budget.parts,
            planned: Some(Box::new(planned)),
            ..bid.clone()
        })
    }
}
