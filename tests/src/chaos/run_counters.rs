//! What is counted in a run, for the scoreboard.

use super::run::millis;
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::ledger::MissionState;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// What was counted in a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RunCounters {
    /// Simulated milliseconds.
    pub simulated_ms: u64,
    /// Missions that were acknowledged.
    pub acknowledged: usize,
    /// Those of them that were carried out.
    pub completed: usize,
    /// Those that failed with a cause.
    pub failed: usize,
    /// Those that wait for a person to fetch what a lost robot holds.
    pub rescues: usize,
    /// Those that were withdrawn.
    pub canceled: usize,
    /// Those that no ledger has: there must be none.
    pub lost: usize,
    /// From the loss of each leader to the next one's taking over, in milliseconds.
    pub takeovers_ms: Vec<u64>,
    /// From the lifting of all faults until every mission had ended.
    pub converged_ms: Option<u64>,
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
            _ => {}
        }
    }

    pub(super) fn end(&mut self, fleet: &Fleet, acknowledged: &BTreeMap<String, String>) {
        self.simulated_ms = millis(fleet.elapsed());
        self.acknowledged = acknowledged.len();
        for mission in acknowledged.values() {
            match fleet.mission_state(&slug::<MissionId>(mission)) {
                Some(MissionState::Completed) => self.completed += 1,
                Some(MissionState::Failed { .. }) => self.failed += 1,
                Some(MissionState::NeedsRescue { .. }) => self.rescues += 1,
                Some(MissionState::Canceled { .. }) => self.canceled += 1,
                Some(MissionState::Pending | MissionState::Running) => {}
                // While nobody keeps a ledger (a run that a violation has cut short), nothing is known of any mission.
                None => self.lost += usize::from(fleet.ledger(|_| ()).is_some()),
            }
        }
    }
}
