//! Leases of devices: what the coordinator grants and ends, by the records of the robots.
//!
//! Robots get devices in the order in which they ask. A robot that needs several, as a door and a lift behind it, gets
//! them all at once, so no two robots wait for each other. While one of them is in use, robots that have asked later do
//! not get the others, so robots that need one device each do not overtake it for ever.

use super::DeviceReports;
use crate::ids::{DeviceId, RobotId};
use crate::knowledge::DeviceClaims;
use crate::lease::Epoch;
use crate::ledger::{Resource, ResourceLease};
use crate::resource_leases::{
    ANSWER_MAX, EndOfLease, GONE_MAX, LeaseStep, LeaseSteps, REPEAT_INTERVAL, ResourceAction,
};
use crate::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time for which the record of a robot must lack the claim before its lease ends. Raised: others wait longer. The first
/// record of a robot whose node has restarted lacks the claim.
const GIVEN_BACK_AFTER: Duration = Duration::from_secs(2);

/// Time in use after which robots that wait for a device keep no other devices free: a robot in it may be stuck. Raised: a
/// stuck robot delays more others; lowered: robots that need several devices are overtaken at slow ones. A guess: a few
/// rides of a lift.
const WORTH_WAITING_FOR: Duration = Duration::from_secs(120);

/// A robot, as known from its record.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceUser {
    /// The robot.
    pub robot: RobotId,
    /// Devices that it needs, with the leases that it has received. `None` if they are unknown: the robot has no record, as
    /// some time after its loss, or its node has just started.
    pub claims: Option<DeviceClaims>,
    /// False for a robot that is down.
    pub is_alive: bool,
    /// True if people have taken the robot out of service.
    pub is_in_maintenance: bool,
}

impl DeviceUser {
    /// Checks whether the robot claims a device.
    pub fn asks(&self) -> bool {
        self.claims.as_ref().is_some_and(|claims| !claims.is_empty())
    }
}

/// The leases of devices, as a coordinator follows them.
#[derive(Debug, Default)]
pub struct DeviceLeases {
    followed: BTreeMap<Epoch, FollowedLease>,
    /// Robots of the proposed leases, and the times of the proposals.
    proposed: BTreeMap<DeviceId, (RobotId, NodeTime)>,
    /// Robots with claims, and since when this coordinator knows them.
    waiting: BTreeMap<RobotId, NodeTime>,
}

#[derive(Debug)]
struct FollowedLease {
    /// Time since which this coordinator knows it.
    known_since: NodeTime,
    since: NodeTime,
    gone_since: Option<NodeTime>,
    unclaimed_since: Option<NodeTime>,
    steps: LeaseSteps,
    /// True once the device may have opened for the robot: a node of a device that has restarted may report another state.
    was_served: bool,
}

impl DeviceLeases {
    /// Returns the actions that are due. `leases` are those of the ledger, `robots` all robots with a record, and
    /// `reports` those of the devices.
    pub fn due(
        &mut self,
        leases: &BTreeMap<DeviceId, ResourceLease>,
        robots: &[DeviceUser],
        reports: &DeviceReports,
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        let in_force: BTreeSet<Epoch> = leases.values().map(|lease| lease.epoch).collect();
        self.followed.retain(|epoch, _| in_force.contains(epoch));
        self.proposed.retain(|device, (_, at)| !leases.contains_key(device) && now.since(*at) < REPEAT_INTERVAL);
        let users: BTreeMap<&RobotId, &DeviceUser> = robots.iter().map(|user| (&user.robot, user)).collect();
        let mut actions = vec![];
        for (device, lease) in leases {
            let followed = self.followed.entry(lease.epoch).or_insert_with(|| FollowedLease::new(now));
            let user = users.get(&lease.robot).copied();
            // A device without a report may have opened for the robot.
            let is_served = reports.get(device).is_none_or(|report| report.lease == Some(lease.epoch.index));
            let Some(step) = followed.follow(device, lease.epoch, user, is_served, now) else { continue };
            if matches!(step, LeaseStep::End(EndOfLease::NoAnswer)) {
                self.waiting.insert(lease.robot.clone(), now); // behind the others
            }
            actions.push(step.action(Resource::Device(device.clone()), lease));
        }
        actions.extend(self.grant(leases, robots, now));
        actions
    }

    /// Leases the free devices, in the order in which the robots have asked. Robots that use a device come first: they may
    /// need another to leave it.
    fn grant(
        &mut self,
        leases: &BTreeMap<DeviceId, ResourceLease>,
        robots: &[DeviceUser],
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        let asks = |user: &&DeviceUser| user.is_alive && user.asks();
        let asking: BTreeSet<&RobotId> = robots.iter().filter(asks).map(|user| &user.robot).collect();
        self.waiting.retain(|robot, _| asking.contains(robot));
        for robot in asking {
            self.waiting.entry(robot.clone()).or_insert(now);
        }
        let mut taken: BTreeMap<DeviceId, RobotId> =
            leases.iter().map(|(device, lease)| (device.clone(), lease.robot.clone())).collect();
        taken.extend(self.proposed.iter().map(|(device, (robot, _))| (device.clone(), robot.clone())));
        let using: BTreeSet<RobotId> = taken.values().cloned().collect();
        let mut order: Vec<&DeviceUser> = robots.iter().filter(asks).collect();
        order.sort_by_key(|user| {
            (!using.contains(&user.robot), self.waiting.get(&user.robot).copied(), user.robot.clone())
        });
        let is_stuck = |device: &DeviceId| {
            let followed = leases.get(device).and_then(|lease| self.followed.get(&lease.epoch));
            followed.is_some_and(|followed| now.since(followed.known_since) >= WORTH_WAITING_FOR)
        };
        let mut actions = vec![];
        for DeviceUser { robot, claims, .. } in order {
            let Some(claims) = claims else { continue };
            let missing: Vec<DeviceId> = claims.keys().filter(|device| !taken.contains_key(*device)).cloned().collect();
            let is_taken = |device: &&DeviceId| taken.get(*device).is_some_and(|user| user != robot);
            let awaited: Vec<&DeviceId> = claims.keys().filter(is_taken).collect();
            let keeps_free = !using.contains(robot) && !awaited.iter().any(|device| is_stuck(device));
            if awaited.is_empty() || keeps_free {
                taken.extend(missing.iter().map(|device| (device.clone(), robot.clone())));
            }
            if !awaited.is_empty() {
                continue;
            }
            for device in missing {
                self.proposed.insert(device.clone(), (robot.clone(), now));
                actions.push(ResourceAction::Lease { resource: Resource::Device(device), robot: robot.clone() });
            }
        }
        actions
    }
}

impl FollowedLease {
    fn new(now: NodeTime) -> FollowedLease {
        FollowedLease {
            known_since: now,
            since: now,
            gone_since: None,
            unclaimed_since: None,
            steps: LeaseSteps::default(),
            was_served: false,
        }
    }

    /// Follows the record of the robot. A lost robot that may be inside keeps its lease until it returns, or until a
    /// person takes it out of service, also when its record is forgotten.
    fn follow(
        &mut self,
        device: &DeviceId,
        epoch: Epoch,
        user: Option<&DeviceUser>,
        is_served: bool,
        now: NodeTime,
    ) -> Option<LeaseStep> {
        self.was_served |= is_served;
        let known = user.and_then(|user| user.claims.as_ref());
        let Some(claims) = known.filter(|_| user.is_some_and(|user| user.is_alive)) else {
            let since = *self.gone_since.get_or_insert(now);
            let is_removed = user.is_some_and(|user| user.is_in_maintenance);
            let is_inside = |claims: &DeviceClaims| self.was_served && claims.contains_key(device);
            let may_be_inside = known.is_none_or(is_inside) && !is_removed;
            return if now.since(since) >= GONE_MAX && !may_be_inside {
                self.steps.end(EndOfLease::Gone, now)
            } else {
                None
            };
        };
        self.gone_since = None;
        match claims.get(device) {
            None => {
                let since = *self.unclaimed_since.get_or_insert(now);
                if now.since(since) >= GIVEN_BACK_AFTER { self.steps.end(EndOfLease::Done, now) } else { None }
            }
            Some(claim) if claim.lease == Some(epoch.index) => {
                (self.unclaimed_since, self.since) = (None, now);
                None
            }
            // A robot whose node has restarted inside lacks the lease until a notice arrives.
            Some(_) if now.since(self.since) >= ANSWER_MAX && !is_served => self.steps.end(EndOfLease::NoAnswer, now),
            Some(_) => {
                self.unclaimed_since = None;
                self.steps.notify(now)
            }
        }
    }
}
