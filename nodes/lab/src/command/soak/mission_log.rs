//! Log of the missions that the fleet has listed. In a long soak the ledger drops the missions that ended first.

use consort_protocol::ids::MissionId;
use consort_protocol::view::{MissionSummary, MissionsView};
use consort_tests::history::RecordingClient;
use serde::Deserialize as _;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::sleep;

/// Interval at which the missions are listed. The ledger keeps hundreds of ended missions, of which a few end in this time.
const INTERVAL: Duration = Duration::from_secs(10);

/// The log: each mission as it was listed last. Clones share the same missions.
#[derive(Debug, Clone, Default)]
pub(super) struct MissionLog(Arc<Mutex<BTreeMap<MissionId, MissionSummary>>>);

impl MissionLog {
    /// Records the missions for ever.
    pub(super) async fn record(self, client: RecordingClient) {
        loop {
            if let Some(list) = listed(&client).await {
                self.add(&list);
            }
            sleep(INTERVAL).await;
        }
    }

    /// Adds the missions of a list.
    pub(super) fn add(&self, list: &MissionsView) {
        let missions = list.missions.iter().map(|mission| (mission.brief.mission.clone(), mission.clone()));
        self.lock().extend(missions);
    }

    /// Returns all missions that were ever listed.
    pub(super) fn missions(&self) -> MissionsView {
        MissionsView { missions: self.lock().values().cloned().collect() }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<MissionId, MissionSummary>> {
        // Each write is a single step.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the missions that the fleet lists now; `None` without a definite reply.
pub(super) async fn listed(client: &RecordingClient) -> Option<MissionsView> {
    MissionsView::deserialize(client.list().await?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn list(missions: &[(&str, &str)]) -> MissionsView {
        let mission = |(mission, state): &(&str, &str)| json!({ "mission": mission, "detail": state });
        let missions: Vec<_> = missions.iter().map(mission).collect();
        serde_json::from_value(json!({ "missions": missions })).expect("a view")
    }

    #[test]
    fn a_mission_that_the_ledger_has_dropped_stays_in_its_latest_state() {
        let log = MissionLog::default();
        log.add(&list(&[("a-1", "running"), ("a-2", "pending")]));
        log.add(&list(&[("a-1", "completed"), ("a-2", "running")]));
        log.add(&list(&[("a-2", "completed")]));
        assert_eq!(log.missions(), list(&[("a-1", "completed"), ("a-2", "completed")]));
        assert_eq!(log.missions().missions.len(), 2);
    }
}
