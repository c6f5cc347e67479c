//! Counters of a run, for the scoreboard.

use super::coverage::Coverage;
use super::dates::millis;
use crate::{Fleet, Observation, slug};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::ledger::MissionState;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Counters of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RunCounters {
    /// Simulated milliseconds.
    pub simulated_ms: u64,
    /// Acknowledged missions.
    pub acknowledged: usize,
    /// Acknowledged missions that completed.
    pub completed: usize,
    /// Acknowledged missions that failed with a cause.
    pub failed: usize,
    /// Their causes.
    pub causes: Vec<String>,
    /// Missions that wait for a person to fetch an item from a lost robot.
    pub needs_intervention: usize,
    /// Canceled missions.
    pub canceled: usize,
    /// Roles that were promised to a robot.
    pub promised: usize,
    /// Roles that auctions have promised after a stop at a charger.
    pub charging_stops: usize,
    /// Acknowledged missions that no ledger contains: must be 0.
    pub lost: usize,
    /// Durations from the loss of each leader to the takeover by the next, in milliseconds.
    pub takeovers_ms: Vec<u64>,
    /// Calls of clients with a definite reply, all checked for linearizability.
    pub client_replies: usize,
    /// Duration from the end of all faults to the end of every mission.
    pub converged_ms: Option<u64>,
    /// Counts of what the limits and faults are meant to cause.
    pub coverage: Coverage,
    #[serde(skip)]
    leading: BTreeSet<NodeId>,
    #[serde(skip)]
    leaderless_since: Option<Duration>,
}

impl RunCounters {
    pub(super) fn observe(&mut self, at: Duration, entry: &Observation) {
        match entry {
            Observation::LeadershipChanged { node, leading_as: Some(_), .. } => {
                self.leading.insert(node.clone());
                if let Some(since) = self.leaderless_since.take() {
                    self.takeovers_ms.push(millis(at.saturating_sub(since)));
                }
            }
            Observation::LeadershipChanged { node, leading_as: None, .. }
            | Observation::TestAction { node, action: "killed" }
                if self.leading.remove(node) && self.leading.is_empty() =>
            {
                self.leaderless_since = Some(at);
            }
            Observation::Published(event) => match &event.kind {
                EventKind::Awarded { promised, .. } => self.promised += promised.len(),
                EventKind::Closed { record, .. } => {
                    let has_stop =
                        |role: &RoleId| record.planned.get(role).is_some_and(|planned| planned.charging.is_some());
                    self.charging_stops += record.promised.keys().filter(|role| has_stop(role)).count();
                }
                _ => {}
            },
            _ => {}
        }
    }

    /// Counts the outcomes at the end of a run. `forgotten` returns the outcome of a mission that the ledger has forgotten.
    pub(super) fn end<'a>(
        &mut self,
        fleet: &Fleet,
        acknowledged: &BTreeMap<String, String>,
        forgotten: impl Fn(&MissionId) -> Option<&'a MissionState>,
    ) {
        self.simulated_ms = millis(fleet.elapsed());
        self.acknowledged = acknowledged.len();
        for mission in acknowledged.values() {
            let mission: MissionId = slug(mission);
            match fleet.mission_state(&mission).or_else(|| forgotten(&mission).cloned()) {
                Some(MissionState::Completed) => self.completed += 1,
                Some(MissionState::Failed { cause, .. }) => {
                    self.failed += 1;
                    self.causes.push(cause);
                }
                Some(MissionState::NeedsIntervention { .. }) => self.needs_intervention += 1,
                Some(MissionState::Canceled { .. }) => self.canceled += 1,
                Some(MissionState::Pending | MissionState::Running) => {}
                // Without a coordinator (in a run that a violation has cut short) the missions are
                // unknown.
                None => self.lost += usize::from(fleet.ledger(|_| ()).is_some()),
            }
        }
    }
}
