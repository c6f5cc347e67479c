//! Leases of chargers: what the coordinator grants and ends, by the records of the robots.
//!
//! ```text
//!  record of a robot                       coordinator                     ledger
//!  Waiting or Bound ──────▶ queue, less charge first ── charger is free ──▶ lease
//!                   ◀────── notice, repeated until the record has the lease ◀─┘
//!  Bound, Connected ──────▶ the robot comes, or uses the charger
//!  no claim, no record, late, no answer ──────────────────────────────────▶ end of the lease
//! ```
//!
//! The records renew a lease: the ledger gets an entry for the grant and one for the end. A new coordinator finds the
//! leases in the ledger and follows them from then on, so it keeps those that are in use.
//!
//! A lease orders the robots that use the same charger, and does not exclude them. The claims in their records do, since
//! they reach the robots without a coordinator, too. A claim with a lease prevails over a claim without, and a later lease
//! over an earlier one.

mod queue;
#[cfg(test)]
mod tests;

pub use queue::ChargerQueue;

use crate::ids::{PlaceId, RobotId};
use crate::knowledge::{ChargerClaim, Charging};
use crate::lease::Epoch;
use crate::ledger::{Resource, ResourceLease};
use crate::resource_leases::{
    ANSWER_MAX, EndOfLease, GONE_MAX, LeaseStep, LeaseSteps, REPEAT_INTERVAL, ResourceAction,
};
use crate::units::{BatteryShare, NodeTime, Seconds};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time that a robot has to come to its charger, in addition to a multiple of its estimate. A guess: other robots and
/// doors delay it.
const ARRIVAL_SLACK: Duration = Duration::from_secs(60);

/// Multiple of the estimated drive after which a robot is late.
const ARRIVAL_FACTOR: u32 = 4;

/// Longest estimate that counts: a robot states it itself.
const DRIVE_MAX: Duration = Duration::from_secs(60 * 60);

/// Time for which a robot gets no further lease of a charger after it was late or did not answer. Raised: the others
/// have more time to use it. As long as a robot avoids a place that it could not reach.
const PASSED_OVER_FOR: Duration = Duration::from_secs(60);

/// A robot, as known from its record.
#[derive(Debug, Clone, PartialEq)]
pub struct ChargerUser {
    /// The robot.
    pub robot: RobotId,
    /// Its current or last place.
    pub place: PlaceId,
    /// Its charge.
    pub battery: BatteryShare,
    /// Its charging; `None` for a robot that is down.
    pub charging: Option<Charging>,
    /// False for a robot that is down.
    pub is_alive: bool,
}

impl ChargerUser {
    /// Returns the chargers that the robot would use, or uses.
    pub fn wishes(&self) -> impl Iterator<Item = &PlaceId> {
        let (waits_for, claim) = match &self.charging {
            Some(Charging::Waiting { chargers }) => (Some(chargers), None),
            Some(Charging::Bound(claim) | Charging::Connected(claim)) => (None, Some(&claim.charger)),
            Some(Charging::Leaving { .. }) | None => (None, None),
        };
        waits_for.into_iter().flatten().chain(claim)
    }

    /// Returns its claim to a charger.
    fn claim_to(&self, charger: &PlaceId) -> Option<&ChargerClaim> {
        self.charging.as_ref()?.claim().filter(|claim| claim.charger == *charger)
    }

    fn is_connected_to(&self, charger: &PlaceId) -> bool {
        matches!(&self.charging, Some(Charging::Connected(claim)) if claim.charger == *charger)
    }
}

/// The leases of chargers, as a coordinator follows them.
#[derive(Debug, Default)]
pub struct ChargerLeases {
    followed: BTreeMap<Epoch, FollowedLease>,
    /// Robots of the proposed leases, and the times of the proposals.
    proposed: BTreeMap<PlaceId, (RobotId, NodeTime)>,
    /// Robots that get no lease of a charger, and since when.
    passed_over: BTreeMap<(PlaceId, RobotId), NodeTime>,
    queue: ChargerQueue,
}

#[derive(Debug)]
struct FollowedLease {
    phase: LeasePhase,
    /// Start of the phase, or of the session.
    since: NodeTime,
    gone_since: Option<NodeTime>,
    steps: LeaseSteps,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LeasePhase {
    /// The record of the robot has no claim with this lease, as far as this coordinator has seen.
    Offered,
    /// The robot is on its way.
    Coming,
    /// The robot is connected.
    InUse,
}

impl ChargerLeases {
    /// Returns the actions that are due. `leases` are those of the ledger, and `robots` all robots with a record.
    pub fn due(
        &mut self,
        leases: &BTreeMap<PlaceId, ResourceLease>,
        robots: &[ChargerUser],
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        self.forget(leases, now);
        let mut actions = self.follow(leases, robots, now);
        self.queue.update(robots);
        actions.extend(self.grant(leases, robots, now));
        actions
    }

    fn forget(&mut self, leases: &BTreeMap<PlaceId, ResourceLease>, now: NodeTime) {
        let in_force: BTreeSet<Epoch> = leases.values().map(|lease| lease.epoch).collect();
        self.followed.retain(|epoch, _| in_force.contains(epoch));
        self.proposed.retain(|charger, (_, at)| !leases.contains_key(charger) && now.since(*at) < REPEAT_INTERVAL);
        self.passed_over.retain(|_, since| now.since(*since) < PASSED_OVER_FOR);
    }

    fn follow(
        &mut self,
        leases: &BTreeMap<PlaceId, ResourceLease>,
        robots: &[ChargerUser],
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        let alive = robots.iter().filter(|user| user.is_alive);
        let alive: BTreeMap<&RobotId, &ChargerUser> = alive.map(|user| (&user.robot, user)).collect();
        let mut actions = vec![];
        for (charger, lease) in leases {
            let followed = self.followed.entry(lease.epoch).or_insert_with(|| FollowedLease::new(now));
            let user = alive.get(&lease.robot).copied();
            let Some(step) = followed.follow(charger, lease.epoch, user, now) else { continue };
            if matches!(step, LeaseStep::End(EndOfLease::Late | EndOfLease::NoAnswer)) {
                self.passed_over.insert((charger.clone(), lease.robot.clone()), now);
            }
            actions.push(step.action(Resource::Charger(charger.clone()), lease));
        }
        actions
    }

    /// Leases the free chargers to the robots that need them most.
    fn grant(
        &mut self,
        leases: &BTreeMap<PlaceId, ResourceLease>,
        robots: &[ChargerUser],
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        let proposed = self.proposed.values().map(|(robot, _)| robot.clone());
        let mut served: BTreeSet<RobotId> = leases.values().map(|lease| lease.robot.clone()).chain(proposed).collect();
        let wished: BTreeSet<&PlaceId> =
            robots.iter().filter(|user| user.is_alive).flat_map(ChargerUser::wishes).collect();
        let mut actions = vec![];
        for charger in wished {
            if leases.contains_key(charger) || self.proposed.contains_key(charger) {
                continue;
            }
            let Some(robot) = self.next_user(charger, robots, &served) else { continue };
            served.insert(robot.clone());
            self.proposed.insert(charger.clone(), (robot.clone(), now));
            actions.push(ResourceAction::Lease { resource: Resource::Charger(charger.clone()), robot });
        }
        actions
    }

    /// Returns the robot that gets a free charger: the robot that is connected to it, else the first of the queue, unless
    /// another robot stands there.
    fn next_user(&self, charger: &PlaceId, robots: &[ChargerUser], served: &BTreeSet<RobotId>) -> Option<RobotId> {
        let is_passed_over = |robot: &RobotId| self.passed_over.contains_key(&(charger.clone(), robot.clone()));
        if let Some(user) = robots.iter().find(|user| user.is_alive && user.is_connected_to(charger)) {
            return (!served.contains(&user.robot) && !is_passed_over(&user.robot)).then(|| user.robot.clone());
        }
        let users: BTreeMap<&RobotId, &ChargerUser> = robots.iter().map(|user| (&user.robot, user)).collect();
        let may_have = |robot: &&RobotId| {
            let wishes = users.get(*robot).is_some_and(|user| user.wishes().any(|wish| wish == charger));
            let is_blocked = robots.iter().any(|user| user.robot != **robot && user.place == *charger);
            wishes && !is_passed_over(robot) && !is_blocked && !served.contains(*robot)
        };
        self.queue.robots().find(may_have).cloned()
    }
}

impl FollowedLease {
    fn new(now: NodeTime) -> FollowedLease {
        FollowedLease { phase: LeasePhase::Offered, since: now, gone_since: None, steps: LeaseSteps::default() }
    }

    /// Follows the record of the robot; `None` if it is gone.
    fn follow(
        &mut self,
        charger: &PlaceId,
        epoch: Epoch,
        user: Option<&ChargerUser>,
        now: NodeTime,
    ) -> Option<LeaseStep> {
        let Some(user) = user else {
            let since = *self.gone_since.get_or_insert(now);
            return if now.since(since) >= GONE_MAX { self.steps.end(EndOfLease::Gone, now) } else { None };
        };
        self.gone_since = None;
        let claim = user.claim_to(charger).filter(|claim| claim.lease == Some(epoch.index));
        let phase = match claim {
            None if self.phase == LeasePhase::Offered => LeasePhase::Offered,
            None => return self.steps.end(EndOfLease::Done, now),
            Some(_) if user.is_connected_to(charger) => LeasePhase::InUse,
            Some(_) => LeasePhase::Coming,
        };
        if phase != self.phase {
            (self.phase, self.since) = (phase, now);
        }
        let age = now.since(self.since);
        match phase {
            LeasePhase::Offered if age >= ANSWER_MAX => self.steps.end(EndOfLease::NoAnswer, now),
            LeasePhase::Offered => self.steps.notify(now),
            LeasePhase::Coming if age >= arrival_max(claim.and_then(|claim| claim.drive_s)) => {
                self.steps.end(EndOfLease::Late, now)
            }
            LeasePhase::Coming | LeasePhase::InUse => None,
        }
    }
}

/// Returns the time within which a robot with this estimate must come.
fn arrival_max(drive: Option<Seconds>) -> Duration {
    let drive = drive.map_or(0.0, Seconds::get).min(DRIVE_MAX.as_secs_f64());
    ARRIVAL_SLACK + ARRIVAL_FACTOR * Duration::from_secs_f64(drive)
}
