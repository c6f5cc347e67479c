//! Events, commands and settings of the executor.

use crate::identity::Version;
use crate::incoming::Position;
use crate::outgoing::VehicleAction;
use crate::received::{ReceivedNode, ReceivedOrder};
use std::collections::BTreeSet;

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub enum ExecutorEvent {
    /// An order, or an update of the order.
    Order(ReceivedOrder),
    /// Instant actions.
    InstantActions(Vec<VehicleAction>),
    /// A message of fleet control was refused, with the problem.
    Refused(String),
    /// Position and charge of the robot.
    Condition(RobotCondition),
    /// The activity has ended: the drive or the action that the latest command began.
    Ended(ActivityEnd),
}

/// Position and charge of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotCondition {
    /// Position.
    pub position: Position,
    /// Charge as a share of a full battery.
    pub charge: f64,
    /// True while the robot charges.
    pub is_charging: bool,
}

/// How an activity ended. The robot stands still.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ActivityEnd {
    /// It is done; with the result of an action, or an empty text.
    Done(String),
    /// The robot was stopped.
    Stopped,
    /// It failed, with the cause.
    Failed(String),
}

/// A command for the caller to perform, in the order given. The robot has a single activity at a time.
#[derive(Debug, Clone, PartialEq)]
pub enum ExecutorCommand {
    /// Drive to a node, not faster than this speed in metres per second.
    Drive(ReceivedNode, Option<f64>),
    /// Execute an action.
    Act(VehicleAction),
    /// Stop the robot; the activity ends.
    Stop,
    /// Publish the state.
    PublishState,
    /// Publish the factsheet.
    PublishFactsheet,
}

/// Settings of an executor.
#[derive(Debug, Clone)]
pub struct ExecutorSettings {
    /// Version of the protocol.
    pub version: Version,
    /// Map of the robot.
    pub map: String,
    /// Name of the series, in the factsheet.
    pub series: String,
    /// Types of actions that the robot executes, beside those of the protocol.
    pub actions: BTreeSet<String>,
    /// Highest speed in metres per second.
    pub speed_max_mps: f64,
    /// Distance from the centre to the outermost part, in metres.
    pub radius_m: f64,
}

/// Why a vehicle rejects a message. The names of errors differ between the versions; before version 3.0
/// they are few.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rejection {
    Malformed,
    Busy,
    StartOutOfRange,
    UnknownMap,
    UnsupportedAction,
    OutdatedUpdate,
    UnequalRepetition,
    UpdateAfterCancel,
    NoContinuation,
    NothingToCancel,
    InstantAction,
}

impl Rejection {
    pub(super) fn kind(self, version: Version) -> &'static str {
        let (old, new) = match self {
            Rejection::Malformed => ("validationError", "VALIDATION_FAILURE"),
            Rejection::Busy => ("orderError", "OTHER_ORDER_ACTIVE"),
            Rejection::StartOutOfRange => ("noRouteError", "START_NODE_OUT_OF_RANGE"),
            Rejection::UnknownMap => ("orderError", "UNKNOWN_MAP_ID"),
            Rejection::UnsupportedAction => ("orderError", "INVALID_ORDER_ACTION"),
            Rejection::OutdatedUpdate => ("orderUpdateError", "OUTDATED_ORDER_UPDATE"),
            Rejection::UnequalRepetition => ("orderUpdateError", "SAME_ORDER_UPDATE_ID"),
            Rejection::UpdateAfterCancel => ("orderUpdateError", "ORDER_UPDATE_FOLLOWING_CANCEL"),
            Rejection::NoContinuation => ("orderUpdateError", "VALIDATION_FAILURE"),
            Rejection::NothingToCancel => ("noOrderToCancel", "NO_ORDER_TO_CANCEL"),
            Rejection::InstantAction => ("instantActionError", "INVALID_INSTANT_ACTION"),
        };
        if version == Version::V3_0 { new } else { old }
    }
}
