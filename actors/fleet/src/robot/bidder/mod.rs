//! Bids: a robot prices its own work.

mod after_charging;

use super::charging::ChargerReserve;
use super::energy_check::pricing_context;
use super::own_tasks::drive_to;
use after_charging::ShortBid;
use consort_protocol::auction::{
    Bid, BidLimits, BidRefusal, BidResponse, CallForBids, PlannedRole, PresentRole, PromisedRole, RefusalReason,
    RoleInsertion, RoleReply, RoleSpan, TimelineStart, ViabilityError, insert_role,
};
use consort_protocol::ensemble::{Eligibility, Ineligibility, Membership};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::Award;
use consort_protocol::plan::{LocalPlan, Step, StepAction};
use consort_protocol::scalar::Scalar;
use consort_protocol::timeline::Travel;
use consort_protocol::units::{Energy, Seconds};
use consort_skills::descriptor::{EstimateContext, EstimateError, Estimator, PlanBudget, PriceError};
use consort_skills::environment::{RouteError, SpeedLimits};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Maximum number of closures in a refusal: a message must have room for all of them.
const CLOSURES_NAMED: usize = 3;

/// Prices plans for a single robot.
#[derive(Clone)]
pub struct Bidder {
    robot: RobotId,
    estimator: Arc<Estimator>,
    chargers: Option<ChargerReserve>,
}

/// State of the robot at the time of a call for bids.
#[derive(Debug, Clone)]
pub struct BidContext<'a> {
    /// The robot's own record.
    pub worker: &'a RobotKnowledge,
    /// Closed lanes, each by its 2 ends; a place twice is a closed place.
    pub closed_lanes: &'a [(PlaceId, PlaceId)],
    /// The lanes among them that people have not closed.
    pub found_closed: &'a [(PlaceId, PlaceId)],
    /// The closures of people, as text.
    pub closures: &'a [&'a str],
    /// Speed limits of people.
    pub speed_limits: SpeedLimits,
    /// Latest readings of the driver, by name; `None` if conditions on them do not count.
    pub readings: Option<&'a BTreeMap<String, Scalar>>,
    /// Age of that information in milliseconds.
    pub age_ms: u64,
    /// Membership of the robot in any of the called ensembles, by its own evaluation.
    pub membership: Membership,
    /// The role that the robot holds, if it can bid for a later one.
    pub present: Option<PresentWork>,
}

/// The role that a robot holds, and the state in which it ends.
#[derive(Debug, Clone)]
pub struct PresentWork {
    role: PresentRole,
    /// Charge that its remaining tasks need, as a share of a full battery.
    energy: f64,
    ends_at: PlaceId,
}

impl PresentWork {
    /// Returns the work of a robot that ends its role at a place, and needs no charge for it.
    pub fn ending_at(role: PresentRole, ends_at: PlaceId) -> PresentWork {
        PresentWork { role, energy: 0.0, ends_at }
    }

    /// Estimates the rest of a role. Returns `None` if it cannot be estimated.
    pub(super) fn of(award: &Award, rest: &LocalPlan, estimator: &Estimator, now: &EstimateContext) -> Option<Self> {
        let budget = estimator.budget(rest, now).ok()?;
        let (mission, role, time) = (award.mission.clone(), award.role.clone(), budget.time());
        Some(PresentWork { role: PresentRole { mission, role, time }, energy: budget.energy, ends_at: budget.ends_at })
    }
}

impl Bidder {
    /// Creates a bidder that prices with this estimator.
    pub fn new(robot: RobotId, estimator: Arc<Estimator>) -> Bidder {
        Bidder { robot, estimator, chargers: None }
    }

    /// Refuses roles after which none of the chargers could be reached.
    #[must_use]
    pub fn with_chargers(self, chargers: Option<ChargerReserve>) -> Bidder {
        Bidder { chargers, ..self }
    }

    /// Returns a bid or a refusal for every role of a call.
    pub fn respond(&self, call: &CallForBids, context: &BidContext<'_>) -> BidResponse {
        let reply = |(role, plan)| match self.bid(call, role, plan, context) {
            Ok(bid) => RoleReply::Bid(bid),
            Err(reason) => RoleReply::Refusal(BidRefusal { robot: self.robot.clone(), role: role.clone(), reason }),
        };
        BidResponse {
            robot: self.robot.clone(),
            auction: call.auction.clone(),
            replies: call.roles.iter().map(reply).collect(),
        }
    }

    fn bid(
        &self,
        call: &CallForBids,
        role: &RoleId,
        plan: &LocalPlan,
        context: &BidContext<'_>,
    ) -> Result<Bid, RefusalReason> {
        let BidContext {
            worker,
            closed_lanes,
            found_closed,
            closures,
            speed_limits,
            readings,
            age_ms,
            membership,
            present,
        } = context;
        // A lack of skills outlasts the present work: a mission that only robots without the skill could join fails,
        // and does not wait for them.
        let missing = plan.skills_missing_in(&worker.skills);
        if !missing.is_empty() {
            return Err(RefusalReason::MissingSkills { skills: missing });
        }
        let present = match &worker.availability {
            Availability::Free => None,
            Availability::Holding { mission, role, .. } => {
                let busy = || RefusalReason::Busy { mission: mission.clone(), role: role.clone() };
                let other = present.as_ref().filter(|_| *mission != call.auction.mission);
                Some(other.ok_or_else(busy)?)
            }
            Availability::OutOfService { problem } => {
                return Err(RefusalReason::OutOfService { problem: problem.clone() });
            }
        };
        if !membership.member {
            return Err(RefusalReason::NotMember { why: membership.reason.clone() });
        }
        if let Some(condition) = call.eligible.get(role) {
            let eligible = Eligibility::check_text(condition, &self.robot, worker);
            eligible.map_err(|Ineligibility { why, permanent }| RefusalReason::NotEligible { why, permanent })?;
        }
        let from = present.map_or_else(|| worker.place.clone(), |present| present.ends_at.clone());
        let readings = readings.cloned();
        let free = EstimateContext { place: from, readings, ..pricing_context(worker, closed_lanes, speed_limits) };
        let budget_from = |context: &EstimateContext| {
            self.estimator.budget(plan, context).map_err(|problem| {
                // What people have closed may be open later. A problem that is left without their closures counts.
                let open = EstimateContext { closed: found_closed.to_vec(), ..context.clone() };
                match self.estimator.budget(plan, &open) {
                    Ok(_) => refusal_while_closed(&problem, closures),
                    Err(problem) => refusal_of(&problem),
                }
            })
        };
        let budget = budget_from(&free)?;
        let own = self.own_promises(call);
        let start = TimelineStart {
            place: &free.place,
            time: present.map_or(Seconds::ZERO, |present| present.role.time),
            discharge: free.discharge,
            // A promised role before which the robot charges may be able to start.
            comes_first: present.is_none()
                && call.timelines.startable.contains(role)
                && !own.iter().any(|promised| promised.charges),
            ends_within: call.timelines.ends_within,
            release: call.timelines.releases.get(role).copied().unwrap_or(Seconds::ZERO),
        };
        let span = role_span(plan, &budget, &self.estimator, &free.place);
        let RoleInsertion { from, ends_at, planned } = self.insert(call, span, start, &free);
        let context = EstimateContext { place: from.clone(), ..free.clone() };
        let budget = if planned.promised > 0 { budget_from(&context)? } else { budget };
        let (time, energy) = (budget.time(), budget.energy);
        let charge = worker.battery.get() - present.map_or(0.0, |present| present.energy);
        let remaining = charge - energy;
        let checked = match &self.chargers {
            Some(chargers) => {
                let left = remaining - planned.energy.get();
                let end = EstimateContext { place: ends_at.unwrap_or(budget.ends_at), ..context };
                let is_low = left <= chargers.floor(worker.useful_charge).get();
                let checked = chargers.check(left, worker.useful_charge, &self.estimator, &end);
                (!is_low).then_some(checked.map_err(|reason| without_charger(reason, closures)))
            }
            None => Some(Ok(())),
        };
        let bid = Bid {
            robot: self.robot.clone(),
            role: role.clone(),
            time,
            energy,
            remaining,
            useful_charge: worker.useful_charge,
            from,
            age_ms: *age_ms,
            parts: budget.parts,
            present: present.map(|present| present.role.clone()),
            planned: Some(Box::new(planned)),
        };
        if checked == Some(Ok(())) {
            return Ok(bid);
        }
        let budget_from = |context: &EstimateContext| budget_from(context).ok();
        match self.after_charging(ShortBid { bid: &bid, own: &own, start, charge, free: &free }, budget_from) {
            Some(later) => Ok(later),
            None => checked.unwrap_or(Ok(())).map(|()| bid),
        }
    }

    /// Returns the roles that the robot has promised, in their order.
    fn own_promises<'c>(&self, call: &'c CallForBids) -> Vec<&'c PromisedRole> {
        call.timelines.promised.iter().filter(|promised| promised.robot == self.robot).collect()
    }

    /// Inserts a role in the timeline of the robot. Without known promises, or without a way to all of them, the
    /// role stands alone.
    fn insert(
        &self,
        call: &CallForBids,
        span: RoleSpan,
        start: TimelineStart<'_>,
        free: &EstimateContext,
    ) -> RoleInsertion {
        let own = self.own_promises(call);
        let travel = EstimatedTravel { estimator: &self.estimator, context: free };
        let insert = || insert_role(start, &own, span.clone(), call.timelines.objective, &travel);
        (!own.is_empty()).then(insert).flatten().unwrap_or_else(|| RoleInsertion {
            from: start.place.clone(),
            ends_at: None,
            planned: PlannedRole::alone(span, start.begin()),
        })
    }
}

/// Returns the places, the time and the energy of a plan without its first drive. The robot begins at `free`.
fn role_span(plan: &LocalPlan, budget: &PlanBudget, estimator: &Estimator, free: &PlaceId) -> RoleSpan {
    let destination = |step: &Step| match &step.action {
        StepAction::Task { spec, .. } => estimator.destination(spec),
        StepAction::Send(_) | StepAction::Wait(_) => None,
    };
    let drive = plan.steps.iter().zip(&budget.parts).find_map(|(step, part)| Some((destination(step)?, part)));
    let (from, drive) = drive.unzip();
    let (drive_time, drive_energy) = drive.map_or((0.0, 0.0), |part| (part.time.get(), part.energy));
    let to = Some(budget.ends_at.clone()).filter(|end| from.is_some() || end != free);
    let time = Seconds::new((budget.time().get() - drive_time).max(0.0)).unwrap_or(Seconds::ZERO);
    RoleSpan { from, to, time, energy: Energy::of_share(budget.energy - drive_energy) }
}

/// Durations of drives by the estimator of a robot.
struct EstimatedTravel<'a> {
    estimator: &'a Estimator,
    context: &'a EstimateContext,
}

impl Travel<PlaceId> for EstimatedTravel<'_> {
    fn seconds(&self, from: &PlaceId, to: &PlaceId) -> f64 {
        if from == to {
            return 0.0;
        }
        let context = EstimateContext { place: from.clone(), pose: None, ..self.context.clone() };
        let estimate = self.estimator.estimate(&drive_to(to), &context);
        estimate.map_or(f64::INFINITY, |estimate| estimate.time.get())
    }
}

/// Checks whether only the charge keeps the robot from a role.
pub(super) fn lacks_charge(reply: &RoleReply, limits: &BidLimits) -> bool {
    match reply {
        RoleReply::Bid(bid) => matches!(bid.check_viable(limits), Err(ViabilityError::LowCharge { .. })),
        RoleReply::Refusal(refusal) => {
            matches!(refusal.reason, RefusalReason::ChargerOutOfReach { charger: Some(_), .. })
        }
    }
}

/// Checks whether the robot bids for the time after a stop at a charger.
pub(super) fn plans_stop(reply: &RoleReply) -> bool {
    matches!(reply, RoleReply::Bid(bid) if bid.charging_stop().is_some())
}

/// Returns the refusal of a plan that can be priced without the closures of people.
fn refusal_while_closed(problem: &PriceError, closures: &[&str]) -> RefusalReason {
    // The closure of the destination comes first.
    let is_own = |closure: &&str| match &problem.source {
        EstimateError::Route(RouteError::Closed { to, .. }) => closure.starts_with(to.as_str()),
        _ => false,
    };
    let (own, other): (Vec<&str>, Vec<&str>) = closures.iter().copied().partition(is_own);
    let why = with_closures(problem.to_string(), own.into_iter().chain(other));
    RefusalReason::NotEligible { why, permanent: false }
}

/// Adds the closures to the refusal of a robot that could reach no charger at all.
fn without_charger(reason: RefusalReason, closures: &[&str]) -> RefusalReason {
    match reason {
        RefusalReason::ChargerOutOfReach { charger: None, problem } => {
            let problem = with_closures(problem, closures.iter().copied());
            RefusalReason::ChargerOutOfReach { charger: None, problem }
        }
        reason => reason,
    }
}

fn with_closures<'a>(problem: String, closures: impl Iterator<Item = &'a str>) -> String {
    closures.take(CLOSURES_NAMED).fold(problem, |text, closure| format!("{text}; {closure}"))
}

/// Returns the refusal of a plan that cannot be priced. The robot may get a role later whose condition on its readings
/// is false or unknown now.
fn refusal_of(problem: &PriceError) -> RefusalReason {
    match &problem.source {
        EstimateError::Requirement { may_change: true, .. } => {
            RefusalReason::NotEligible { why: problem.to_string(), permanent: false }
        }
        _ => RefusalReason::NotFeasible { task: problem.task.clone(), problem: problem.to_string() },
    }
}

#[cfg(test)]
mod tests;
