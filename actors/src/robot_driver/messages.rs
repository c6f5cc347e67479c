//! What drivers and hosts say to one another.

use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, Goal, GoalId, GoalStatus, PersonRequest, Telemetry};
use serde::{Deserialize, Serialize};

/// From the node that drives a body to its host. Without an order it only says that the driver is there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriverCommand {
    /// What to do, if anything.
    pub request: Option<GoalRequest>,
}

/// Something for a body to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum GoalRequest {
    /// Begin a goal.
    Start {
        /// Its id: a repeated one starts nothing.
        id: GoalId,
        /// The goal.
        goal: Goal,
    },
    /// End a goal early.
    Cancel {
        /// Which.
        id: GoalId,
    },
}

impl GoalRequest {
    /// The goal that it is about.
    pub fn goal(&self) -> GoalId {
        match self {
            GoalRequest::Start { id, .. } | GoalRequest::Cancel { id } => *id,
        }
    }
}

/// How a body is and what has become of its latest goals. Answer to each command; also published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriverState {
    /// Whose.
    pub robot: RobotId,
    /// Grows with each state of the same host, so that an overtaken one is not believed.
    pub sequence: u64,
    /// The body's report.
    pub telemetry: Telemetry,
    /// The latest goals, in the order of their ids.
    pub goals: Vec<(GoalId, GoalStatus)>,
    /// Those of them that were done and must not be done again, and what they asked for.
    pub completed: Vec<(GoalId, Goal)>,
}

/// Someone who acts for an unmanaged role is asked, told again, or dismissed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonCommand {
    /// The ask's id: a repeated one asks nothing new.
    pub id: GoalId,
    /// What is asked; `None` dismisses.
    pub request: Option<PersonRequest>,
}

/// Answer to an ask.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonRequestState {
    /// They have been asked.
    Requested,
    /// They have ended.
    Ended(Result<(), ActionError>),
    /// They were told that it is no longer wanted: under this id it is not asked again.
    Canceled,
}

/// Published when a person has something to say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonEvent {
    /// They have ended what they were asked to do.
    RequestEnded {
        /// The ask.
        id: GoalId,
        /// What came of it.
        result: Result<(), ActionError>,
    },
    /// They call off the mission for which a robot came to them. Repeated for some beats.
    CancelMission {
        /// Who says so.
        by: String,
        /// The role they play.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
        /// Tells one such word from the next: milliseconds of world time.
        at_ms: u64,
    },
}
