//! The coordinator's side of a lease: when its holder has certainly stopped.

use super::{Epoch, LeaseTerms};
use crate::ids::RobotId;
use crate::mutants::{self, Mutant};
use crate::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The coordinator's side: when each award was last in contact. An award that this coordinator has just met, be it new or
/// another coordinator's, counts as in contact at that moment: it may have been renewed just before.
#[derive(Debug, Clone)]
pub struct LeaseMonitor {
    terms: LeaseTerms,
    contacts: BTreeMap<Epoch, BTreeMap<RobotId, NodeTime>>,
    /// Awards that are about to be taken away, and since when: they are renewed no more, so that their time does run out.
    pub(super) releasing: BTreeMap<(Epoch, RobotId), NodeTime>,
}

/// How long an award is known to have been let go of after it has left the ledger: longer than a report is answered.
const LET_GO_KEPT: Duration = Duration::from_secs(60);

impl LeaseMonitor {
    /// Begins with the coordinator's leadership.
    pub fn new(terms: LeaseTerms) -> Self {
        LeaseMonitor { terms, contacts: BTreeMap::new(), releasing: BTreeMap::new() }
    }

    /// The award stands in the ledger as this coordinator looks at it.
    pub fn track(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        let robots = self.contacts.entry(epoch).or_default();
        if !robots.contains_key(robot) {
            robots.insert(robot.clone(), now);
        }
    }

    /// Asks whether a report of this award may be answered with a renewal at `now`, which then counts as contact. It may
    /// not once the award was let go of: the holder's role may be given to another soon.
    #[must_use]
    pub fn renew(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        let renewed = !self.releasing.contains_key(&(epoch, robot.clone()));
        if renewed {
            self.contacts.entry(epoch).or_default().insert(robot.clone(), now);
        }
        renewed
    }

    /// This award is to be taken away: it is renewed no more. It may be taken once it [is over](Watch::is_over).
    pub fn stop_renewing(&mut self, epoch: Epoch, robot: &RobotId, now: NodeTime) {
        self.releasing.entry((epoch, robot.clone())).or_insert(now);
    }

    /// How long the holder has been out of contact, as far as this coordinator can know; nothing for an award that it has
    /// not met.
    pub fn since_contact(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> Duration {
        let last = self.contacts.get(&epoch).and_then(|robots| robots.get(robot));
        last.map_or(Duration::ZERO, |last| now.since(*last))
    }

    /// Whether the holder has certainly suspended by now, so that its role may go to another.
    pub fn has_expired(&self, epoch: Epoch, robot: &RobotId, now: NodeTime) -> bool {
        let sure = self.terms.lease + self.terms.grace;
        self.since_contact(epoch, robot, now) > if mutants::is_active(Mutant::EarlyRelease) { sure / 3 } else { sure }
    }

    /// Forgets awards that are none of `live`.
    pub fn retain(&mut self, live: &BTreeSet<Epoch>, now: NodeTime) {
        self.contacts.retain(|epoch, _| live.contains(epoch));
        self.releasing.retain(|(epoch, _), since| live.contains(epoch) || now.since(*since) < LET_GO_KEPT);
    }
}
