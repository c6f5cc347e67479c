//! A robot with a revoked certificate gets no role by an auction that began after the nodes have read the list.
//!
//! A role that it held goes to another robot, or its mission would not end: `liveness`.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::auction::AuctionId;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{NodeId, RobotId, RoleId};
use consort_protocol::ledger::Command;
use std::collections::BTreeMap;
use std::time::Duration;

/// Time in which all nodes use a new list of revoked certificates: they read it every 2 s.
const LIMIT: Duration = Duration::from_secs(3);

#[derive(Default)]
pub(super) struct Revoked {
    /// Robots with a revoked certificate, and since when.
    robots: BTreeMap<RobotId, Duration>,
    /// Terms of the leaders.
    terms: BTreeMap<NodeId, u64>,
    /// Beginnings of the auctions.
    auctions: BTreeMap<AuctionId, Duration>,
    /// Index of the last entry of the log that was checked.
    index: u64,
}

impl Revoked {
    /// Checks the holders that an auction has chosen. The award may be committed long after the auction, with a later
    /// leader, so the beginning of the auction counts.
    fn check(&self, auction: &AuctionId, holders: &BTreeMap<RoleId, RobotId>) -> Result<(), InvariantViolation> {
        let Some(began) = self.auctions.get(auction) else { return Ok(()) };
        for (role, robot) in holders {
            if let Some(since) = self.robots.get(robot).filter(|since| *began > **since + LIMIT) {
                let late_s = began.saturating_sub(*since).as_secs_f64();
                let mission = &auction.mission;
                return Err(format!(
                    "{robot} gets {role} of {mission} in an auction that began {late_s:.3} s after its certificate was revoked"
                )
                .into());
            }
        }
        Ok(())
    }
}

impl Invariant for Revoked {
    fn name(&self) -> &'static str {
        "revoked"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::CertificateRevoked { node, .. } => {
                self.robots.entry(node.clone().into()).or_insert(at);
            }
            Observation::LeadershipChanged { node, term, leading_as: Some(_) } => {
                self.terms.insert(node.clone(), *term);
            }
            Observation::Published(event) => {
                if let EventKind::BidsRequested { mission, round, .. } = &event.kind
                    && let Some(term) = self.terms.get(&event.node)
                {
                    let auction = AuctionId { mission: mission.clone(), term: *term, round: *round };
                    self.auctions.entry(auction).or_insert(at);
                }
            }
            Observation::EntryApplied { at, commands, .. } if at.index > self.index => {
                self.index = at.index;
                commands.iter().try_for_each(|command| match command {
                    Command::Award { holders, auction, .. } => self.check(&auction.auction, holders),
                    _ => Ok(()),
                })?;
            }
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    #[test]
    fn an_award_to_a_robot_that_was_revoked_before_the_auction_is_found() {
        let auction = |round| AuctionId { mission: slug("rest-1"), term: 1, round };
        let holders = |robot: &str| BTreeMap::from([(slug("r1"), slug(robot))]);
        let mut state = Revoked::default();
        state.robots.insert(slug("garnet"), Duration::from_secs(10));
        state.auctions.insert(auction(1), Duration::from_secs(12));
        state.auctions.insert(auction(2), Duration::from_secs(20));
        assert_eq!(state.check(&auction(1), &holders("garnet")), Ok(()), "some nodes have not read the list");
        assert_eq!(state.check(&auction(2), &holders("hazel")), Ok(()));
        let violation = state.check(&auction(2), &holders("garnet")).unwrap_err().0;
        assert!(
            violation.starts_with("garnet gets r1 of rest-1 in an auction that began 10.000 s after"),
            "{violation}"
        );
    }
}
