//! Record of an auction, for display.

use super::bid::{AuctionId, BidPart, RefusalReason, RoleEstimate, ViabilityError, list};
use super::insertion::PlannedRole;
use crate::bounds::{self, ELEMENTS_MAX, TEXT_BYTES_MAX, limit_text};
use crate::codec::{self, encoded_size};
use crate::ids::{RobotId, RoleId, TaskType};
use crate::units::{Energy, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Replies and decision of an auction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionRecord {
    /// Round of the auction.
    pub auction: AuctionId,
    /// Time on the coordinator's wall clock, in milliseconds, for display.
    pub at_ms: u64,
    /// Replies, in the order of roles and robots.
    pub entries: Vec<AuctionEntry>,
    /// Number of replies omitted to bound the size of the record.
    pub omitted: u32,
    /// Robot chosen for each role.
    pub chosen: BTreeMap<RoleId, RobotId>,
    /// Roles that are promised to the chosen robots and not awarded yet, with the estimated time until each begins: its
    /// robot is free, and what it waits for has ended.
    #[serde(default)]
    pub promised: BTreeMap<RoleId, Seconds>,
    /// Reason, if no roles were assigned.
    pub failure: Option<String>,
    /// Position of each assigned role in the timeline of its robot, if its bid states it.
    #[serde(default)]
    pub planned: BTreeMap<RoleId, PlannedRole>,
}

impl AuctionRecord {
    /// Maximum number of replies in a record.
    const ENTRIES_MAX: usize = 256;

    /// Approximate maximum size of the parts of all bids in a record, in bytes: the ledger stores a
    /// record for each mission. Enough for about ten bids of a dozen steps.
    pub(super) const PARTS_BYTES_MAX: usize = 8 * 1024;

    /// Maximum number of replies that did not win, of each role in the ledger. Raised: people can compare more robots, and the
    /// ledger is larger. A guess: more robots than a person compares.
    const RIVALS_MAX: usize = 8;

    /// Maximum number of robots named together in the ledger as not asked. Raised: people can look up more robots, and the ledger
    /// of a large fleet is larger. A guess: the robots of a site.
    const NOT_ASKED_MAX: usize = 64;

    /// Maximum size of a record in bytes, encoded: the award contains the record and its holders,
    /// and must fit a message.
    pub(crate) const BYTES_MAX: usize = codec::MESSAGE_BYTES_MAX / 2;

    /// Creates the record of an auction without replies.
    pub fn empty(auction: AuctionId) -> AuctionRecord {
        AuctionRecord {
            auction,
            at_ms: 0,
            entries: vec![],
            omitted: 0,
            chosen: BTreeMap::new(),
            promised: BTreeMap::new(),
            failure: None,
            planned: BTreeMap::new(),
        }
    }

    fn entry(&self, role: &RoleId, robot: &RobotId) -> Option<&AuctionEntry> {
        self.entries.iter().find(|entry| entry.role == *role && entry.robot == *robot)
    }

    /// Returns the estimate of a robot's bid for a role: no energy without a bid, and no time without its parts.
    pub fn estimate_of(&self, role: &RoleId, robot: &RobotId) -> RoleEstimate {
        let entry = self.entry(role, robot);
        let energy = match entry.map(|entry| &entry.verdict) {
            Some(BidVerdict::Viable { energy, .. } | BidVerdict::Unviable { energy, .. }) => Energy::of_share(*energy),
            Some(BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. }) | None => Energy::ZERO,
        };
        RoleEstimate { time: entry.into_iter().flat_map(|entry| &entry.parts).map(|part| part.time).sum(), energy }
    }

    /// Returns the duration of each step of a robot's bid for a role in seconds, as far as the record contains them.
    pub(crate) fn durations_s(&self, role: &RoleId, robot: &RobotId) -> Vec<f64> {
        self.entry(role, robot).map(|entry| durations_s(&entry.parts)).unwrap_or_default()
    }

    /// Adds the robots that were not asked.
    pub fn add_not_asked(&mut self, entries: Vec<AuctionEntry>) {
        if !entries.is_empty() {
            self.entries.extend(entries);
            self.limit();
        }
    }

    /// Returns the record as the ledger keeps it: of each role the chosen bid and the 8 best other replies, bids before refusals.
    /// Of the robots that were not asked it keeps the first 64 for each role and reason. An auction without a result is
    /// repeated, so it keeps no parts of bids. With `keeps_busy` all busy robots are kept: a mission that holds robots may wait for
    /// missions that wait for its own.
    #[must_use]
    pub fn for_ledger(mut self, keeps_busy: bool) -> AuctionRecord {
        let kept = self.kept_in_ledger(keeps_busy);
        let mut dropped = self.entries.len() - kept.len();
        let mut index = 0..;
        self.entries.retain(|_| index.next().is_some_and(|index| kept.contains(&index)));
        for entry in self.entries.iter_mut().filter(|entry| !(keeps_busy && entry.is_busy())) {
            if let BidVerdict::NotAsked { others, .. } = &mut entry.verdict
                && let Some(first) = others.iter().nth(Self::NOT_ASKED_MAX - 1).cloned()
            {
                dropped += others.split_off(&first).len();
            }
        }
        self.omitted = self.omitted.saturating_add(u32::try_from(dropped).unwrap_or(u32::MAX));
        if self.chosen.is_empty() {
            self.entries.iter_mut().for_each(|entry| entry.parts = vec![]);
        }
        self
    }

    /// Returns the indices of the entries that the ledger keeps.
    fn kept_in_ledger(&self, keeps_busy: bool) -> BTreeSet<usize> {
        let place = |entry: &AuctionEntry| match &entry.verdict {
            BidVerdict::Viable { time, .. } => (0, time.get()),
            BidVerdict::Unviable { time, .. } => (1, time.get()),
            BidVerdict::Refused { reason: RefusalReason::Busy { .. } } => (2, 0.0),
            BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. } => (3, 0.0),
        };
        let mut ranked: Vec<(usize, &AuctionEntry)> = self.entries.iter().enumerate().collect();
        ranked.sort_by(|(_, one), (_, other)| {
            let (one, other) = (place(one), place(other));
            one.0.cmp(&other.0).then(one.1.total_cmp(&other.1))
        });
        let mut rivals: BTreeMap<&RoleId, usize> = BTreeMap::new();
        let kept = ranked.into_iter().filter(|(_, entry)| {
            let is_group = matches!(entry.verdict, BidVerdict::NotAsked { .. });
            let is_chosen = self.chosen.get(&entry.role) == Some(&entry.robot);
            if is_chosen || is_group || (keeps_busy && entry.is_busy()) {
                return true;
            }
            let others = rivals.entry(&entry.role).or_default();
            *others += 1;
            *others <= Self::RIVALS_MAX
        });
        kept.map(|(index, _)| index).collect()
    }

    /// Shortens the texts of the record, and omits replies that do not fit [`Self::BYTES_MAX`]:
    /// refusals before bids, since people look for robots that could do the work, and these before the
    /// chosen bids, which the award needs.
    pub(crate) fn limit(&mut self) {
        if let Some(failure) = &mut self.failure {
            limit_text(failure, TEXT_BYTES_MAX);
        }
        for entry in &mut self.entries {
            if let BidVerdict::Refused { reason } = &mut entry.verdict {
                reason.limit_text();
            }
        }
        if self.entries.len() <= Self::ENTRIES_MAX && encoded_size(self) <= Self::BYTES_MAX {
            return;
        }
        let mut entries = std::mem::take(&mut self.entries);
        // The numbers before the entries may grow to their full width.
        let mut room = Self::BYTES_MAX.saturating_sub(encoded_size(self).saturating_add(8));
        let count = entries.len();
        entries.sort_by_key(|entry| {
            let is_chosen = self.chosen.get(&entry.role) == Some(&entry.robot);
            (!is_chosen, matches!(entry.verdict, BidVerdict::Refused { .. } | BidVerdict::NotAsked { .. }))
        });
        entries.truncate(Self::ENTRIES_MAX);
        entries.retain(|entry| {
            let left = room.checked_sub(encoded_size(entry));
            room = left.unwrap_or(room);
            left.is_some()
        });
        let omitted = u32::try_from(count - entries.len()).unwrap_or(u32::MAX);
        self.omitted = self.omitted.saturating_add(omitted);
        self.entries = entries;
    }
}

/// Returns the duration of each step in seconds, by its index; 0 for steps that are not contained.
pub(super) fn durations_s(parts: &[BidPart]) -> Vec<f64> {
    let steps = parts.iter().filter(|part| (part.step as usize) < ELEMENTS_MAX);
    let mut durations_s = vec![];
    for part in steps {
        let index = part.step as usize;
        durations_s.resize(durations_s.len().max(index + 1), 0.0);
        durations_s[index] = part.time.get();
    }
    durations_s
}

/// Reply of a robot for a role, with its verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuctionEntry {
    /// Role.
    pub role: RoleId,
    /// Robot that replied.
    pub robot: RobotId,
    /// Verdict on the reply.
    pub verdict: BidVerdict,
    /// Cost of each step of the bid. Empty if there is no bid or no room for it: the winners' parts
    /// are kept first, then those of the fastest bids.
    #[serde(default)]
    pub parts: Vec<BidPart>,
}

impl AuctionEntry {
    /// Returns the robots of the entry: one, or all that were not asked for the same reason.
    pub fn robots(&self) -> impl Iterator<Item = &RobotId> {
        let others = match &self.verdict {
            BidVerdict::NotAsked { others, .. } => Some(others),
            BidVerdict::Viable { .. } | BidVerdict::Unviable { .. } | BidVerdict::Refused { .. } => None,
        };
        std::iter::once(&self.robot).chain(others.into_iter().flatten())
    }

    /// Checks whether the robots got no offer, or refused, because they are busy.
    pub fn is_busy(&self) -> bool {
        matches!(
            self.verdict,
            BidVerdict::Refused { reason: RefusalReason::Busy { .. } }
                | BidVerdict::NotAsked { reason: NotAskedReason::Busy, .. }
        )
    }
}

/// Verdict on a robot's reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BidVerdict {
    /// The bid is within the limits.
    Viable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
    },
    /// The bid is outside the limits.
    Unviable {
        /// Time for the plan.
        time: Seconds,
        /// Charge used, as a share.
        energy: f64,
        /// Charge left, as a share.
        remaining: f64,
        /// Limit that is violated.
        why: ViabilityError,
    },
    /// The robot refused.
    Refused {
        /// Reason of the refusal.
        reason: RefusalReason,
    },
    /// The robot was not asked, nor were others, for the same reason.
    NotAsked {
        /// Reason, from the records of the robots and from the ledger.
        reason: NotAskedReason,
        /// Lower bound of the costs of all these robots, in seconds of the objective; 0 if they would refuse.
        cost_min: f64,
        /// The other robots.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        others: BTreeSet<RobotId>,
    },
}

/// Reason for which the coordinator did not ask a robot.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum NotAskedReason {
    /// Its bid could not have changed the result.
    #[error("by its record its bid could not have changed the result")]
    NotNeeded,
    /// It lacks skills that the role needs.
    #[error("by its record it lacks {}", list(.skills))]
    MissingSkills {
        /// Missing skills, in the order of their names.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        skills: Vec<TaskType>,
    },
    /// It holds or has promised other roles, or carries an item of another mission.
    #[error("it is busy with other missions")]
    Busy,
    /// It is out of service.
    #[error("by its record it is out of service")]
    OutOfService,
    /// It does not meet the condition of the role on its robot.
    #[error("by its record it does not meet the condition of the role")]
    NotEligible,
    /// The tasks of the role cannot be estimated from its place.
    #[error("by its record it cannot do the tasks of the role from its place")]
    NotFeasible,
    /// The order of a person gives the role to another robot.
    #[error("by the order of a person another robot gets the role")]
    Restricted,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn role(name: &str) -> RoleId {
        RoleId::new(name).unwrap()
    }

    fn robot(number: usize) -> RobotId {
        RobotId::new(format!("robot-{number:03}")).unwrap()
    }

    fn entry(of: &str, number: usize, verdict: BidVerdict) -> AuctionEntry {
        let skill = TaskType::new("navigation").unwrap();
        let part = BidPart { step: 0, label: "go".to_owned(), skill, time: Seconds::ZERO, energy: 0.1 };
        AuctionEntry { role: role(of), robot: robot(number), verdict, parts: vec![part] }
    }

    fn viable(time: usize) -> BidVerdict {
        BidVerdict::Viable { time: Seconds::new(time as f64).unwrap(), energy: 0.1, remaining: 0.5 }
    }

    fn busy() -> BidVerdict {
        let (mission, role) = ("m-7".parse().unwrap(), role("r1"));
        BidVerdict::Refused { reason: RefusalReason::Busy { mission, role } }
    }

    /// Returns the record of two roles: 100 robots bid for the first, the later the faster, and are busy for the second.
    fn record() -> AuctionRecord {
        let auction = AuctionId { mission: "m-1".parse().unwrap(), term: 1, round: 1 };
        let entries = (0..100).map(|number| entry("r1", number, viable(200 - number)));
        let entries = entries.chain((0..100).map(|number| entry("r2", number, busy()))).collect();
        AuctionRecord { entries, ..AuctionRecord::empty(auction) }
    }

    fn robots_of(record: &AuctionRecord, of: &str) -> Vec<RobotId> {
        record.entries.iter().filter(|entry| entry.role == role(of)).map(|entry| entry.robot.clone()).collect()
    }

    #[test]
    fn the_ledger_keeps_the_winner_and_eight_rivals_of_each_role() {
        let chosen = BTreeMap::from([(role("r1"), robot(3))]);
        let kept = AuctionRecord { chosen, ..record() }.for_ledger(false);
        let fastest: Vec<RobotId> = [3].into_iter().chain(92..100).map(robot).collect();
        assert_eq!(robots_of(&kept, "r1"), fastest);
        assert_eq!(robots_of(&kept, "r2"), (0..8).map(robot).collect::<Vec<_>>());
        assert_eq!(kept.omitted, 200 - 17);
        assert!(kept.entries.iter().all(|entry| !entry.parts.is_empty()));
        assert_eq!(kept.clone().for_ledger(false), kept);
    }

    #[test]
    fn the_ledger_keeps_all_reasons_for_which_robots_were_not_asked() {
        let group = |reason| {
            let others = (1..100).map(robot).collect();
            AuctionEntry { parts: vec![], ..entry("r1", 0, BidVerdict::NotAsked { reason, cost_min: 0.0, others }) }
        };
        let full =
            AuctionRecord { entries: vec![group(NotAskedReason::NotNeeded), group(NotAskedReason::Busy)], ..record() };
        for (keeps_busy, of_busy) in [(false, 64), (true, 100)] {
            let kept = full.clone().for_ledger(keeps_busy);
            let robots: Vec<usize> = kept.entries.iter().map(|entry| entry.robots().count()).collect();
            assert_eq!(robots, [64, of_busy]);
            assert_eq!(kept.omitted as usize, 200 - 64 - of_busy);
            assert_eq!(kept.clone().for_ledger(keeps_busy), kept);
        }
    }

    #[test]
    fn an_auction_without_a_result_keeps_no_parts_and_all_busy_robots_on_request() {
        let kept = record().for_ledger(true);
        assert_eq!((robots_of(&kept, "r1").len(), robots_of(&kept, "r2").len(), kept.omitted), (8, 100, 92));
        assert!(kept.entries.iter().all(|entry| entry.parts.is_empty()));
        assert!(encoded_size(&record().for_ledger(false)) < 2048);
    }
}
