//! Events, commands and settings of the state machine.

use crate::cause::{Cause, CauseTable};
use crate::incoming::{ConnectionState, VehicleState};
use crate::layout::Layout;
use crate::outgoing::{BlockingType, Order, VehicleAction};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;

/// What a goal asks of the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub enum Work {
    /// Drive to a node.
    Drive {
        /// The node.
        to: String,
        /// Highest allowed speed in metres per second.
        speed_max_mps: Option<f64>,
    },
    /// Execute an action.
    Act {
        /// Type of the action.
        kind: String,
        /// What the action excludes.
        blocking: BlockingType,
        /// Parameters, by key.
        parameters: BTreeMap<String, Value>,
        /// True for an instant action; false for an action on the node where the vehicle is.
        is_instant: bool,
    },
}

/// How a goal ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GoalStatus {
    /// The work is done; with the result that the vehicle described.
    Succeeded(String),
    /// The vehicle stopped.
    Canceled,
    /// The work failed.
    Aborted(Cause),
}

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A goal of the node.
    Goal {
        /// Id.
        id: u64,
        /// Fingerprint of the action and its parameters.
        fingerprint: u32,
        /// The work.
        work: Work,
        /// Time for which the vehicle may act.
        keep_for: Duration,
        /// First goal with which an earlier process may have begun the work, so its action may have happened:
        /// the goal itself after a restart of this program, an earlier goal after a restart of the node.
        since: Option<u64>,
    },
    /// A renewed permission.
    Keep {
        /// The goal.
        id: u64,
        /// Time from now.
        keep_for: Duration,
    },
    /// A goal is cancelled.
    Cancel {
        /// The goal.
        id: u64,
    },
    /// The program ends: the vehicle has to stop.
    Shutdown,
    /// A state of the vehicle.
    State(Box<VehicleState>),
    /// The connection of the vehicle to the broker.
    Connection(ConnectionState),
    /// The connection of this program to the broker.
    Broker {
        /// True if it is up.
        is_up: bool,
    },
    /// Time has passed.
    Tick,
}

/// A command for the caller to perform, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Publish an order.
    SendOrder(Order),
    /// Publish instant actions.
    SendInstant(VehicleAction),
    /// Report the end of a goal.
    Result {
        /// The goal.
        goal: u64,
        /// How it ended.
        status: GoalStatus,
    },
    /// Report the progress of a goal.
    Feedback {
        /// The goal.
        goal: u64,
        /// Remaining distance of a drive, in metres.
        distance_remaining_m: Option<f64>,
    },
}

/// Settings of a machine.
#[derive(Debug, Clone)]
pub struct MachineSettings {
    /// Nodes and edges.
    pub layout: Layout,
    /// Map of the nodes.
    pub map: String,
    /// Number of nodes after the last reached node that are released: the base. Later nodes are the
    /// horizon.
    pub release_ahead: usize,
    /// Codes of errors.
    pub causes: CauseTable,
    /// Time after which a message without effect is sent again. More is gentler to the broker, less
    /// is faster after a loss.
    pub retry_after: Duration,
    /// Time for which a goal waits for a vehicle that is not ready.
    pub ready_within: Duration,
    /// Time without a state after which a goal fails.
    pub silence_max: Duration,
    /// Time for which an order of an earlier process may go on without a goal: the longest
    /// permission.
    pub adopt_within: Duration,
    /// Number that differs between processes, for ids of instant actions.
    pub session: u64,
}
