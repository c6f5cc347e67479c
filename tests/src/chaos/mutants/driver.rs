//! Bugs in the messages between a robot and its driver server.

use super::message::encoded;
use bytes::Bytes;
use consort_fleet::robot_driver::{DriverCommand, DriverState, GoalRequest};
use consort_protocol::codec;
use consort_skills::actions::{GoalId, GoalStatus};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// Lets a command be acted on for an hour, so that only the limit of the driver server applies.
pub(super) fn without_time_limit(payload: Bytes) -> Bytes {
    let Ok(mut command) = codec::decode::<DriverCommand>(&payload) else { return payload };
    command.permit.keep_for_ms = 3_600_000;
    encoded(&command)
}

/// Goals that a robot has canceled.
#[derive(Clone, Default)]
pub(super) struct CanceledGoals(Arc<Mutex<BTreeSet<GoalId>>>);

impl CanceledGoals {
    /// Records the goal that a command cancels.
    pub(super) fn observe(&self, payload: &Bytes) {
        if let Ok(DriverCommand { request: Some(GoalRequest::Cancel { id }), .. }) = codec::decode(payload) {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(id);
        }
    }

    /// Lets the canceled goals in a state count as ended.
    pub(super) fn end(&self, payload: Bytes) -> Bytes {
        let Ok(mut state) = codec::decode::<DriverState>(&payload) else { return payload };
        let canceled = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for (id, status) in &mut state.goals {
            if canceled.contains(id) && !status.is_final() {
                *status = GoalStatus::Canceled;
            }
        }
        encoded(&state)
    }
}
