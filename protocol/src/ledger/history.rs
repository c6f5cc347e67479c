//! History of ended missions, in the order of their ends, since wire version 3.
//!
//! The latest ended missions are kept whole. Of each ended mission a [`Tombstone`] is kept longer,
//! so that a repeated request is not executed again, and a client that waits for the mission learns
//! its outcome. The history has no clock: it counts time by the submissions that follow an end.
//!
//! A tombstone is forgotten when a submission arrives long after its end, or when the tombstones exceed
//! their size ([`HistoryLimits`]). After that, a request whose id contains an earlier time of creation
//! is rejected, since it may be a repetition.

use super::command_error::CommandError;
use super::entry::{MissionEntry, MissionState};
use super::history_limits::HistoryLimits;
use super::shared_map::SharedMap;
use super::shared_queue::SharedQueue;
use crate::ids::{MissionId, RequestId};
use crate::trust::REQUEST_SKEW_MAX_MS;
use consort_text::shorten;
use serde::{Deserialize, Serialize};

/// Wire version since which the ledger has a history.
pub(super) const HISTORY_SINCE: u8 = 3;

/// Maximum length of a cause in a tombstone, in bytes.
const CAUSE_MAX: usize = 200;

/// Remainder of an ended mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tombstone {
    /// Number among all missions ever submitted, from 1.
    pub number: u64,
    /// Request that created the mission.
    pub request: RequestId,
    /// Outcome. A long cause is shortened.
    pub state: MissionState,
    /// Time of submission, in milliseconds since 1970 on the accepting coordinator's wall clock.
    pub submitted_ms: u64,
    /// Time of the first submission after the end; `None` until then.
    ended_ms: Option<u64>,
}

impl Tombstone {
    fn of(entry: &MissionEntry) -> Tombstone {
        Tombstone {
            number: entry.number,
            request: entry.submission.request.clone(),
            state: in_brief(&entry.state),
            submitted_ms: entry.submission.at_ms,
            ended_ms: None,
        }
    }

    /// Returns the latest time at which the request may have been created: the time of submission, or the time in
    /// its id if the client's clock was ahead of the coordinator's by no more than [`REQUEST_SKEW_MAX_MS`].
    fn latest_creation_ms(&self) -> u64 {
        let created_ms = self.request.created_ms().unwrap_or(self.submitted_ms);
        created_ms.clamp(self.submitted_ms, self.submitted_ms.saturating_add(REQUEST_SKEW_MAX_MS))
    }

    /// Returns the approximate size in a snapshot, which [`HistoryLimits`] limits: ids of the request and the mission are stored
    /// more than once.
    fn bytes(&self, mission: &MissionId) -> u64 {
        let text = match &self.state {
            MissionState::Failed { cause: text, .. } | MissionState::Canceled { by: text } => text.len(),
            _ => 0,
        };
        (text + 2 * self.request.as_str().len() + 3 * mission.as_str().len() + 32) as u64
    }
}

fn in_brief(state: &MissionState) -> MissionState {
    match state {
        MissionState::Failed { cause, class } => {
            MissionState::Failed { cause: shorten(cause, CAUSE_MAX).into_owned(), class: *class }
        }
        MissionState::Canceled { by } => MissionState::Canceled { by: shorten(by, CAUSE_MAX).into_owned() },
        other => other.clone(),
    }
}

/// Ended missions, by the order of their ends.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct History {
    tombstones: SharedMap<MissionId, Tombstone>,
    /// All missions with a tombstone, earliest end first.
    order: SharedQueue<MissionId>,
    /// Number of missions at the end of `order` that are kept whole.
    whole: u64,
    /// Size of all tombstones.
    bytes: u64,
    /// Latest time at which the request of a forgotten mission may have been created.
    forgotten_ms: Option<u64>,
    limits: HistoryLimits,
}

impl History {
    /// Creates the history of a ledger without a record of the ends: missions in the order of
    /// submission.
    pub(super) fn of<'a>(missions: impl Iterator<Item = &'a MissionEntry>) -> History {
        let mut ended: Vec<&MissionEntry> = missions.filter(|entry| entry.state.has_ended()).collect();
        ended.sort_by_key(|entry| entry.number);
        let mut history = History::default();
        ended.into_iter().for_each(|entry| history.push(entry));
        history
    }

    /// Returns the limits in force.
    pub(super) fn limits(&self) -> HistoryLimits {
        self.limits
    }

    /// Changes the limits. They take effect with the next mission that ends or is submitted.
    pub(super) fn set_limits(&mut self, limits: HistoryLimits) {
        self.limits = limits.bounded();
    }

    /// Adds a mission that has just ended.
    pub(super) fn push(&mut self, entry: &MissionEntry) {
        let tombstone = Tombstone::of(entry);
        self.bytes += tombstone.bytes(&entry.id);
        self.tombstones.insert(entry.id.clone(), tombstone);
        self.order.push_back(entry.id.clone());
        self.whole += 1;
    }

    /// Returns the number of ended missions that are kept whole.
    pub(super) fn whole(&self) -> usize {
        usize::try_from(self.whole).unwrap_or(usize::MAX)
    }

    /// Returns the earliest ended mission that is no longer kept whole, if there are too many.
    pub(super) fn pop_whole(&mut self) -> Option<MissionId> {
        let first =
            self.order.len().checked_sub(self.whole()).filter(|_| self.whole > u64::from(self.limits.missions_max))?;
        self.whole -= 1;
        self.order.get(first).cloned()
    }

    /// Forgets tombstones beyond the size limit, and returns their requests.
    pub(super) fn forget_over_size(&mut self) -> Vec<RequestId> {
        self.forget_while(|history, _| history.bytes > history.limits.outcome_bytes_max)
    }

    /// Forgets the tombstones that are too old at the time of a submission, and returns their
    /// requests. Missions that have ended since the previous submission count as ended now.
    pub(super) fn advance(&mut self, at_ms: u64) -> Vec<RequestId> {
        for mission in self.order.iter().rev() {
            match self.tombstones.get_mut(mission) {
                Some(tombstone) if tombstone.ended_ms.is_none() => tombstone.ended_ms = Some(at_ms),
                _ => break,
            }
        }
        let age_max_ms = self.limits.outcome_age_max_ms;
        let is_old = |ended_ms: u64| at_ms.saturating_sub(ended_ms) >= age_max_ms;
        self.forget_while(|_, tombstone| tombstone.ended_ms.is_some_and(is_old))
    }

    /// Forgets the earliest tombstones that `condition` holds for, except those of missions that are
    /// kept whole.
    fn forget_while(&mut self, condition: impl Fn(&History, &Tombstone) -> bool) -> Vec<RequestId> {
        let mut requests = vec![];
        while self.order.len() > self.whole()
            && let Some(mission) = self.order.front()
            && self.tombstones.get(mission).is_none_or(|tombstone| condition(self, tombstone))
        {
            let Some(mission) = self.order.pop_front() else { break };
            let Some(tombstone) = self.tombstones.remove(&mission) else { continue };
            self.bytes = self.bytes.saturating_sub(tombstone.bytes(&mission));
            self.forgotten_ms = self.forgotten_ms.max(Some(tombstone.latest_creation_ms()));
            requests.push(tombstone.request);
        }
        requests
    }

    /// Returns the ended missions that are remembered, latest end first.
    pub(super) fn latest_ended(&self) -> impl Iterator<Item = (&MissionId, &Tombstone)> {
        self.order.iter().rev().filter_map(|mission| Some((mission, self.tombstones.get(mission)?)))
    }

    pub(super) fn tombstone(&self, mission: &MissionId) -> Option<&Tombstone> {
        self.tombstones.get(mission)
    }

    /// Checks that an unknown request, which arrives at `at_ms`, is certainly new: its id contains no time of
    /// creation, or a time after that of every forgotten request. If a forgotten request was created long after
    /// `at_ms`, a clock was wrong, and nothing is checked.
    pub(super) fn check_remembered(&self, request: &RequestId, at_ms: u64) -> Result<(), CommandError> {
        let latest_ms = at_ms.saturating_add(REQUEST_SKEW_MAX_MS);
        match (request.created_ms(), self.forgotten_ms.filter(|since_ms| *since_ms <= latest_ms)) {
            (Some(created_ms), Some(since_ms)) if created_ms <= since_ms => {
                Err(CommandError::RequestForgotten { request: request.clone(), created_ms, since_ms })
            }
            _ => Ok(()),
        }
    }
}
