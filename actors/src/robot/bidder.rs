//! A robot prices its own work.

use super::energy_check::pricing_context;
use consort_protocol::auction::{Bid, BidRefusal, BidResponse, CallForBids, RefusalReason, RoleReply};
use consort_protocol::ensemble::Membership;
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::plan::LocalPlan;
use consort_protocol::units::Seconds;
use consort_skills::descriptor::{Estimator, PlanBudget};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Prices plans for one robot.
#[derive(Clone)]
pub struct Bidder {
    robot: RobotId,
    estimator: Arc<Estimator>,
}

/// What the robot knows of itself when it is asked.
#[derive(Debug, Clone)]
pub struct BidContext<'a> {
    /// Its own account.
    pub worker: &'a RobotKnowledge,
    /// The ways that its body has found closed, each by its two ends.
    pub closed_lanes: &'a [(PlaceId, PlaceId)],
    /// How old that is, in milliseconds.
    pub age_ms: u64,
    /// Whether it counts itself a member of the ensemble that was called.
    pub membership: Membership,
}

impl Bidder {
    /// A bidder that prices with this estimator.
    pub fn new(robot: RobotId, estimator: Arc<Estimator>) -> Bidder {
        Bidder { robot, estimator }
    }

    /// Answers every role of a call.
    pub fn respond(&self, call: &CallForBids, circumstance: &BidContext<'_>) -> BidResponse {
        let answer = |(role, plan)| match self.bid(call, role, plan, circumstance) {
            Ok(bid) => RoleReply::Bid(bid),
            Err(reason) => RoleReply::Refusal(BidRefusal { robot: self.robot.clone(), role: role.clone(), reason }),
        };
        BidResponse {
            robot: self.robot.clone(),
            auction: call.auction.clone(),
            replies: call.roles.iter().map(answer).collect(),
        }
    }

    fn bid(
        &self,
        call: &CallForBids,
        role: &RoleId,
        plan: &LocalPlan,
        circumstance: &BidContext<'_>,
    ) -> Result<Bid, RefusalReason> {
        let BidContext { worker, closed_lanes: closed, age_ms, membership } = circumstance;
        match &worker.availability {
            Availability::Free => {}
            Availability::Holding { mission, role, .. } => {
                return Err(RefusalReason::Busy { mission: mission.clone(), role: role.clone() });
            }
            Availability::OutOfService { problem } => {
                return Err(RefusalReason::OutOfService { problem: problem.clone() });
            }
        }
        if !membership.member {
            let why = membership.reason.clone();
            return Err(RefusalReason::NotMember { ensemble: call.ensemble.clone(), why });
        }
        let needed: BTreeSet<&TaskType> = plan.tasks().map(|(_, spec)| &spec.task_type).collect();
        let missing: Vec<TaskType> =
            needed.into_iter().filter(|skill| !worker.skills.contains(*skill)).cloned().collect();
        if !missing.is_empty() {
            return Err(RefusalReason::MissingSkills { skills: missing });
        }
        let budget = self.estimator.budget(plan, &pricing_context(worker, closed));
        let PlanBudget { parts, energy } = budget.map_err(|problem| RefusalReason::NotFeasible {
            task: problem.task.clone(),
            problem: problem.to_string(),
        })?;
        let time = parts.iter().fold(Seconds::ZERO, |sum, part| sum + part.time);
        Ok(Bid {
            robot: self.robot.clone(),
            role: role.clone(),
            time,
            energy,
            remaining: worker.battery.get() - energy,
            useful_charge: worker.useful_charge,
            from: worker.place.clone(),
            age_ms: *age_ms,
            parts,
        })
    }
}
