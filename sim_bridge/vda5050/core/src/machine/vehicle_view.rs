//! What is known about a vehicle.

use crate::incoming::{ConnectionState, VehicleState};
use std::time::Duration;

/// The latest messages of a vehicle.
#[derive(Debug, Default)]
pub(super) struct VehicleView {
    is_broker_up: bool,
    connection: Option<ConnectionState>,
    state: Option<VehicleState>,
    state_at: Duration,
    requested_at: Option<Duration>,
    /// True after a change of the connection: the vehicle may have restarted, and may count from the
    /// beginning.
    accepts_any: bool,
}

impl VehicleView {
    /// Stores a state. Late and repeated states are ignored: neither number nor time have grown.
    pub(super) fn take_state(&mut self, state: VehicleState, now: Duration) {
        let is_late = |last: &VehicleState| state.header_id <= last.header_id && state.timestamp <= last.timestamp;
        if !self.accepts_any && self.state.as_ref().is_some_and(is_late) {
            return;
        }
        self.accepts_any = false;
        // A vehicle that reports a state is connected; its connection message may be lost.
        if self.connection == Some(ConnectionState::Broken) {
            self.connection = None;
        }
        self.state = Some(state);
        self.state_at = now;
    }

    pub(super) fn take_connection(&mut self, connection: ConnectionState) {
        self.accepts_any = true;
        self.connection = Some(connection);
    }

    pub(super) fn take_broker(&mut self, is_up: bool) {
        self.is_broker_up = is_up;
        self.requested_at = None;
    }

    pub(super) fn is_broker_up(&self) -> bool {
        self.is_broker_up
    }

    pub(super) fn state(&self) -> Option<&VehicleState> {
        self.state.as_ref()
    }

    /// Returns the arrival of the latest state.
    pub(super) fn state_at(&self) -> Duration {
        self.state_at
    }

    /// Returns the latest state if it arrived after a time.
    pub(super) fn state_after(&self, time: Duration) -> Option<&VehicleState> {
        self.state.as_ref().filter(|_| self.state_at > time)
    }

    /// Returns the latest state of a vehicle that can receive an order.
    pub(super) fn ready_state(&self) -> Option<&VehicleState> {
        let is_there = matches!(self.connection, None | Some(ConnectionState::Online));
        self.state.as_ref().filter(|_| is_there && self.is_broker_up)
    }

    /// Returns why there is no ready state.
    pub(super) fn problem(&self) -> &'static str {
        match (self.is_broker_up, self.connection) {
            (false, _) => "no connection to the broker",
            (true, Some(ConnectionState::Offline)) => "it is offline",
            (true, Some(ConnectionState::Hibernating)) => "it hibernates",
            (true, Some(ConnectionState::Broken)) => "the broker has lost its connection",
            (true, _) => "it has not reported its state",
        }
    }

    /// Checks whether a state may be requested again, and marks it as requested.
    pub(super) fn is_request_due(&mut self, now: Duration, interval: Duration) -> bool {
        let is_due = self.requested_at.is_none_or(|at| now.saturating_sub(at) >= interval);
        if is_due && self.is_broker_up {
            self.requested_at = Some(now);
        }
        is_due && self.is_broker_up
    }
}
