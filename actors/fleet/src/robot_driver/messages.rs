//! Messages between driver clients and driver servers.

use super::state_order::StateStamp;
use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{Goal, GoalId, GoalResult, GoalStatus, PersonRequest, PersonResult, Telemetry};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Command from the driver client of a robot to its driver server. A command without a request is a
/// heartbeat.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriverCommand {
    /// Goal to start or cancel, if any.
    pub request: Option<GoalRequest>,
    /// Goals that may continue, and until when.
    pub permit: Permit,
}

/// Permission to act: the goals of a client that may continue, and until when. The default permits
/// nothing.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Permit {
    /// Goals in progress that the client supervises. A goal that the command starts need not be
    /// listed.
    pub goals: Vec<GoalId>,
    /// Latest state that the client has received.
    pub state: StateStamp,
    /// Time after the sending of that state for which the robot may act, in milliseconds
    /// ([`keep_for`](fn@consort_protocol::lease::keep_for)).
    pub keep_for_ms: u64,
}

/// Request about a goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum GoalRequest {
    /// Start a goal.
    Start {
        /// Id of the goal. A repeated id starts nothing.
        id: GoalId,
        /// The goal.
        goal: Goal,
    },
    /// Cancel a goal.
    Cancel {
        /// Id of the goal.
        id: GoalId,
    },
}

impl GoalRequest {
    /// Returns the id of the goal.
    pub fn goal(&self) -> GoalId {
        match self {
            GoalRequest::Start { id, .. } | GoalRequest::Cancel { id } => *id,
        }
    }
}

/// State of a robot and of its latest goals. Reply to each command; also published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriverState {
    /// The robot.
    pub robot: RobotId,
    /// Position among the states of the server. A client ignores states that arrive late.
    pub stamp: StateStamp,
    /// Telemetry of the robot.
    pub telemetry: Telemetry,
    /// Latest goals, in the order of their ids.
    pub goals: Vec<(GoalId, GoalStatus)>,
    /// Completed goals among them that must not be repeated, with their results.
    pub completed: Vec<(GoalId, Goal, GoalResult)>,
}

impl DriverState {
    /// Returns the latest values of the feedback of the goal in progress; empty without such a goal.
    pub fn feedback(&self) -> BTreeMap<String, Scalar> {
        feedback_of(self.goals.iter().map(|(_, status)| status))
    }
}

/// Returns the values of the feedback of the goal in progress; empty without such a goal. The goals are in the order of
/// their ids.
pub(super) fn feedback_of<'a>(goals: impl DoubleEndedIterator<Item = &'a GoalStatus>) -> BTreeMap<String, Scalar> {
    let values = goals.rev().find_map(|status| match status {
        GoalStatus::Executing(feedback) => Some(feedback.values.clone()),
        _ => None,
    });
    values.unwrap_or_default()
}

/// Command about a person request: send, repeat or cancel it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonCommand {
    /// Id of the request. A repeated id starts nothing.
    pub id: GoalId,
    /// The request; `None` cancels it.
    pub request: Option<PersonRequest>,
}

/// State of a person request, in reply to a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonRequestState {
    /// The person has received the request.
    Requested,
    /// The request has ended.
    Ended(PersonResult),
    /// The request was canceled. Its id is not served again.
    Canceled,
}

/// Published event of a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonEvent {
    /// A request has ended.
    RequestEnded {
        /// Id of the request.
        id: GoalId,
        /// Result of the request.
        result: PersonResult,
    },
    /// The person cancels the mission for which a robot came. Repeated for some intervals.
    CancelMission {
        /// Name of the person.
        by: String,
        /// Role of the person.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
        /// World time of the order in milliseconds. Distinguishes an order from the next.
        at_ms: u64,
    },
}
