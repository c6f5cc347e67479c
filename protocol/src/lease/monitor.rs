//! Coordinator's side of a lease: detects that the holder has certainly stopped.

use super::award::Epoch;
use super::terms::LeaseTerms;
use crate::ids::RobotId;
use crate::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Coordinator's side of all leases: the last contact of each award. An award that this coordinator
/// sees for the first time counts as in contact at that moment, whether it is new or comes from
/// another coordinator: it may have been renewed just before.
#[derive(Debug, Clone)]
pub struct LeaseMonitor {
    terms: LeaseTerms,
    contacts: BTreeMap<Epoch, BTreeMap<RobotId, NodeTime>>,
    /// Awards that are about to be released, and since when. They are no longer renewed, so that
    /// their leases run out.
    pub(super) releasing: BTreeMap<(Epoch, RobotId), NodeTime>,
}

/// Time for which a released award is remembered after it has left the ledger; longer than a report
/// may take to be answered.
const RELEASING_KEPT: Duration = Duration::from_secs(60);

impl LeaseMonitor {
    /// Creates the monitor at the start of a leadership.
    pub fn new(terms: LeaseTerms) -> Self {
        LeaseMonitor { terms, contacts: BTreeMap::new(), releasing: BTreeMap::new() }
    }

    /// Starts to track an award that this coordinator has found in the ledger.
    pub fn track(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        let robots = self.contacts.entry(epoch).or_default();
        if !robots.contains_key(robot) {
            robots.insert(robot.clone(), now);
        }
    }

    /// Renews the award for a report that arrives at `now`, and counts it as contact. Returns false
    /// once the release has begun, since the role may be awarded to another robot soon.
    #[must_use]
    pub fn renew(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        let renewed = !self.releasing.contains_key(&(epoch, robot.clone()));
        if renewed {
            self.contacts.entry(epoch).or_default().insert(robot.clone(), now);
        }
        renewed
    }

    /// Begins the release of this award: it is no longer renewed. The role may be released once the
    /// lease [has expired](LeaseMonitor::has_expired).
    pub fn stop_renewing(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        self.releasing.entry((epoch, robot.clone())).or_insert(now);
    }

    /// Returns the time since the last contact with the holder; zero for an award that is not
    /// tracked.
    pub fn since_contact(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> Duration {
        let last = self.contacts.get(&epoch).and_then(|robots| robots.get(robot));
        last.map_or(Duration::ZERO, |last| now.since(*last))
    }

    /// Checks whether the holder has certainly suspended by now, so that the role may be awarded to
    /// another robot.
    pub fn has_expired(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        self.since_contact(epoch, robot, now) > self.terms.lease + self.terms.grace
    }

    /// Drops awards that are not in `live`.
    pub fn retain(&mut self, live: &BTreeSet<Epoch>, now: NodeTime) {
        self.contacts.retain(|epoch, _| live.contains(epoch));
        self.releasing.retain(|(epoch, _), since| live.contains(epoch) || now.since(*since) < RELEASING_KEPT);
    }
}
