//! Bids: a robot prices its own work.

use super::energy_check::pricing_context;
use consort_protocol::auction::{Bid, BidRefusal, BidResponse, CallForBids, PresentRole, RefusalReason, RoleReply};
use consort_protocol::ensemble::{Eligibility, Ineligibility, Membership};
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::Award;
use consort_protocol::plan::LocalPlan;
use consort_skills::descriptor::{EstimateContext, Estimator};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Prices plans for a single robot.
#[derive(Clone)]
pub struct Bidder {
    robot: RobotId,
    estimator: Arc<Estimator>,
}

/// State of the robot at the time of a call for bids.
#[derive(Debug, Clone)]
pub struct BidContext<'a> {
    /// The robot's own record.
    pub worker: &'a RobotKnowledge,
    /// Lanes that the driver has found closed, each by its 2 ends.
    pub closed_lanes: &'a [(PlaceId, PlaceId)],
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
        Bidder { robot, estimator }
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
        let BidContext { worker, closed_lanes: closed, age_ms, membership, present } = context;
        // A lack of skills outlasts the present work: a mission that only robots without the skill could join fails,
        // and does not wait for them.
        let needed: BTreeSet<&TaskType> = plan.tasks().map(|(_, spec)| &spec.task_type).collect();
        let missing: Vec<TaskType> =
            needed.into_iter().filter(|skill| !worker.skills.contains(*skill)).cloned().collect();
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
        let context = EstimateContext { place: from.clone(), ..pricing_context(worker, closed) };
        let budget = self.estimator.budget(plan, &context).map_err(|problem| RefusalReason::NotFeasible {
            task: problem.task.clone(),
            problem: problem.to_string(),
        })?;
        let (time, energy) = (budget.time(), budget.energy);
        Ok(Bid {
            robot: self.robot.clone(),
            role: role.clone(),
            time,
            energy,
            remaining: worker.battery.get() - present.map_or(0.0, |present| present.energy) - energy,
            useful_charge: worker.useful_charge,
            from,
            age_ms: *age_ms,
            parts: budget.parts,
            present: present.map(|present| present.role.clone()),
        })
    }
}
