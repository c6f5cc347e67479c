//! Promises: roles for robots that hold another role, or that cannot start yet.
//!
//! An auction that cannot fill its roles with free robots is cleared again. A role that waits for other roles
//! first may then get a busy robot, after the time that the robot needs for what it holds and has promised. So may a
//! role of a robot that has promises already; otherwise it would never be its turn. The role may be inserted before
//! promised roles (the module `insertion`). The result counts if
//! another role starts at once and takes longer than that time, so that nobody waits for long, or if the mission
//! is under way, or if all its robots have promises. Otherwise the mission waits, and gets the robots that are
//! free first; once it has waited for as long as a promise may be delayed and late, its robots wait for each other.
//!
//! A mission of a higher priority comes before the promised roles of others, and may be promised a robot whose queue is
//! full: the last promise is then released. It may also be promised a robot that only waits in a role of a lower priority.
//!
//! A robot that has to charge before a role can only be promised the role, also if it is free: the award follows when it has
//! charged.
//!
//! A promised role is auctioned again from time to time. It passes to the winner if that costs clearly less than the robot of
//! the promise, or if that robot is late.

use super::bid::{Bid, BidRefusal, BidResponse, RefusalReason, RoleEstimate, RoleReply};
use super::insertion::{Objective, PlannedRole};
use crate::ids::{RobotId, RoleId};
use crate::units::{Energy, Seconds};
use std::collections::{BTreeMap, BTreeSet};

/// Limits of what robots promise. Fleet-wide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PromiseTerms {
    /// Maximum number of roles that are promised to a robot; 0 for none. Default 16.
    pub promises_max: u32,
    /// Maximum time until a robot is free for a role that it promises; `None` for no limit.
    pub horizon: Option<Seconds>,
    /// Maximum time by which a promised role is delayed, by all roles that are inserted before it. Default 600 s.
    pub delay_max: Seconds,
    /// Objective of insertions, and of the choice among bids.
    pub objective: Objective,
    /// Time by which a promised role may be late, although it can start; then it passes to another robot that can begin
    /// within this time. Default 300 s.
    pub late_max: Seconds,
    /// Minimum gain for which a promised role passes to another robot, in seconds of the objective. Default 60 s.
    pub gain_min: Seconds,
    /// Time before the earliest start of a mission from which its roles are promised; 0 for none. Default 0.
    pub ahead: Seconds,
}

impl Default for PromiseTerms {
    fn default() -> Self {
        let seconds = |number| Seconds::new(number).expect("the number is a time");
        PromiseTerms {
            promises_max: 16,
            horizon: None,
            delay_max: seconds(600.0),
            objective: Objective::default(),
            late_max: seconds(300.0),
            gain_min: seconds(60.0),
            ahead: Seconds::ZERO,
        }
    }
}

/// What a robot holds and has promised.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotQueue {
    /// The role that the robot holds, or is about to get, as estimated before its award; `None` without one. It counts only
    /// if the bid of the robot does not state its present role.
    pub held: Option<RoleEstimate>,
    /// Number of promised roles.
    pub promised: u32,
    /// Number of those of missions with at least the priority of the auctioned mission. All others come after its roles.
    pub preceding: u32,
    /// Estimated time of the preceding promised roles.
    pub time: Seconds,
    /// Estimated energy of the preceding promised roles.
    pub energy: Energy,
    /// The robot only waits in a role of a mission with a lower priority, and returns that role for now.
    pub yields: bool,
    /// The role that it holds, otherwise a promised role, as the reason of a refusal.
    pub reason: RefusalReason,
}

impl RobotQueue {
    /// Checks whether the robot can only be promised a role, also one that could start: it would never be its turn otherwise.
    fn serves_in_turn(&self) -> bool {
        self.promised > 0 || self.yields
    }
}

/// Inputs for promises.
#[derive(Debug, Clone)]
pub struct PromiseContext<'a> {
    /// Robots that hold a role or have promised roles.
    pub queues: &'a BTreeMap<RobotId, RobotQueue>,
    /// Robots that can be promised nothing, and the reasons.
    pub unavailable: &'a BTreeMap<RobotId, RefusalReason>,
    /// Roles that can start now: no step of another robot must end first.
    pub startable: &'a BTreeSet<RoleId>,
    /// The robots of the mission may wait for each other: some hold other roles of it, or it has waited for too long.
    pub may_wait: bool,
    /// Limits of promises.
    pub terms: PromiseTerms,
}

impl PromiseContext<'_> {
    /// Returns the replies with the bids of busy robots: each takes the time until its robot has ended what it
    /// holds and has promised, and leaves the charge after that.
    pub(super) fn later(&self, responses: &[BidResponse]) -> Vec<BidResponse> {
        let reply = |reply: &RoleReply| match reply {
            RoleReply::Bid(bid) => self.later_bid(bid),
            RoleReply::Refusal(_) => reply.clone(),
        };
        let response = |response: &BidResponse| BidResponse {
            replies: response.replies.iter().map(reply).collect(),
            ..response.clone()
        };
        responses.iter().map(response).collect()
    }

    fn later_bid(&self, bid: &Bid) -> RoleReply {
        let queue = self.queues.get(&bid.robot);
        let present = bid.present.as_ref();
        let reason = queue.map(|queue| queue.reason.clone()).or_else(|| present.map(RefusalReason::from));
        let is_too_late = self.terms.horizon.is_some_and(|horizon| self.start_of(bid) > horizon);
        let may_promise = !is_too_late && self.may_promise_bid(queue, bid);
        match reason.filter(|_| self.is_later(bid)) {
            // A free robot that has to charge can only be promised the role.
            None if bid.charging_stop().is_none() || !may_promise => RoleReply::Bid(bid.clone()),
            Some(reason) if !may_promise => {
                RoleReply::Refusal(BidRefusal { robot: bid.robot.clone(), role: bid.role.clone(), reason })
            }
            _ => RoleReply::Bid(self.at_its_start(bid)),
        }
    }

    /// Checks whether a robot with this queue may promise a role with its bid. A stop at a charger holds only for the queue that
    /// the robot has considered.
    fn may_promise_bid(&self, queue: Option<&RobotQueue>, bid: &Bid) -> bool {
        let (charges, is_free) = (bid.charging_stop().is_some(), queue.is_none() && bid.present.is_none());
        let may_charge_first = charges && is_free && self.terms.promises_max > 0;
        let holds = !charges || self.plan_of(bid).is_some();
        holds && (may_charge_first || self.may_promise(queue, &bid.role))
    }

    /// Checks whether a robot with this queue may promise a role.
    fn may_promise(&self, queue: Option<&RobotQueue>, role: &RoleId) -> bool {
        let may_be_late = queue.is_some_and(RobotQueue::serves_in_turn) || !self.startable.contains(role);
        may_be_late && queue.map_or(0, |queue| queue.preceding) < self.terms.promises_max
    }

    /// Returns a lower bound of the cost at which a robot may be promised a role, or take it now; `None` if its bid would not
    /// count. `alone` is the bound of a robot without a queue.
    pub(super) fn bound(&self, robot: &RobotId, role: &RoleId, alone: f64) -> Option<f64> {
        let Some(queue) = self.queues.get(robot) else { return Some(alone) };
        let is_later = queue.held.is_some() || !self.startable.contains(role);
        // The end of what it holds is unknown, and with it the place at which it would begin.
        (!is_later || self.may_promise(Some(queue), role)).then_some(0.0)
    }

    /// Returns a later bid with the time from now on, and with the charge that is left after all that its robot has promised.
    fn at_its_start(&self, bid: &Bid) -> Bid {
        let (queue, plan, start) = (self.queues.get(&bid.robot), self.plan_of(bid), self.start_of(bid));
        let promised = plan.map(|plan| plan.energy).or(queue.map(|queue| queue.energy)).unwrap_or(Energy::ZERO);
        let energy = promised + self.unstated(bid).map_or(Energy::ZERO, |held| held.energy);
        let planned = match plan {
            Some(plan) => Some(Box::new(PlannedRole { delay_max: self.terms.delay_max, ..plan.clone() })),
            None => bid.planned.clone().map(|planned| Box::new(PlannedRole::alone(planned.span, start))),
        };
        let charged = bid.charging_stop().map(|stop| stop.remaining.get());
        let (time, remaining) = (start + bid.time, charged.unwrap_or(bid.remaining - energy.get()));
        Bid { time, remaining, present: None, planned, ..bid.clone() }
    }

    /// Returns the cost in seconds by which a bid exceeds another for the same role.
    pub fn gain(&self, from: &Bid, to: &Bid) -> f64 {
        let [from, to] = [from, to].map(|bid| match self.is_later(bid) {
            true => self.at_its_start(bid).cost(self.terms.objective),
            false => bid.cost(self.terms.objective),
        });
        from - to
    }

    /// Returns the held role of the robot if the bid does not state it: the robot did not yet hold it, or has just ended it.
    fn unstated(&self, bid: &Bid) -> Option<RoleEstimate> {
        self.queues.get(&bid.robot)?.held.filter(|_| bid.present.is_none())
    }

    /// Returns the position of the role in the timeline of the robot, unless the robot did not consider all that it holds
    /// and has promised meanwhile.
    fn plan_of<'b>(&self, bid: &'b Bid) -> Option<&'b PlannedRole> {
        let promised = self.queues.get(&bid.robot).map_or(0, |queue| queue.promised);
        let is_complete = |planned: &&PlannedRole| planned.promised == promised && self.unstated(bid).is_none();
        bid.planned.as_deref().filter(is_complete)
    }

    /// Returns the estimated time until the robot has ended what comes before the role.
    fn start_of(&self, bid: &Bid) -> Seconds {
        let queue = self.queues.get(&bid.robot);
        let held = || self.unstated(bid).map_or(Seconds::ZERO, |held| held.time);
        let present = bid.present.as_ref().map_or_else(held, |present| present.time);
        let start = match self.plan_of(bid) {
            Some(planned) => planned.start,
            None => present + queue.map_or(Seconds::ZERO, |queue| queue.time),
        };
        match queue.is_some_and(|queue| queue.yields) {
            true => Seconds::new((start.get() - present.get()).max(0.0)).unwrap_or(start),
            false => start,
        }
    }

    /// Checks whether the bid is for a promise.
    fn is_later(&self, bid: &Bid) -> bool {
        let is_held = self.queues.get(&bid.robot).is_some_and(|queue| queue.held.is_some());
        is_held || bid.present.is_some() || bid.charging_stop().is_some() || !self.startable.contains(&bid.role)
    }

    /// Returns the roles that are promised with these holders, with the times until their robots are free; `None`
    /// if the mission waits instead.
    pub(super) fn promised(
        &self,
        holders: &BTreeMap<RoleId, RobotId>,
        responses: &[BidResponse],
    ) -> Option<BTreeMap<RoleId, Seconds>> {
        let bids = responses.iter().flat_map(|response| &response.replies).filter_map(|reply| match reply {
            RoleReply::Bid(bid) => Some(bid),
            RoleReply::Refusal(_) => None,
        });
        let chosen = bids.filter(|bid| holders.get(&bid.role) == Some(&bid.robot));
        let (later, now): (Vec<&Bid>, Vec<&Bid>) = chosen.partition(|bid| self.is_later(bid));
        let longest =
            now.iter().map(|bid| bid.time).fold(Seconds::ZERO, |one, other| if one > other { one } else { other });
        let charging: BTreeSet<&RobotId> =
            later.iter().filter(|bid| bid.charging_stop().is_some()).map(|bid| &bid.robot).collect();
        let promised: BTreeMap<_, _> = later.into_iter().map(|bid| (bid.role.clone(), self.start_of(bid))).collect();
        let serves_in_turn = |robot: &RobotId| {
            charging.contains(robot) || self.queues.get(robot).is_some_and(RobotQueue::serves_in_turn)
        };
        let is_in_time = !now.is_empty() && promised.values().all(|start| *start <= longest);
        let is_accepted = is_in_time || self.may_wait || holders.values().all(serves_in_turn);
        is_accepted.then_some(promised)
    }
}

#[cfg(test)]
mod tests;
