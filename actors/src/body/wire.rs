//! What drivers and hosts say to one another.

use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, Goal, GoalId, GoalStatus, PersonAsk, Telemetry};
use serde::{Deserialize, Serialize};

/// From the node that drives a body to its host. Without an order it only says that the driver is there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyCommand {
    /// What to do, if anything.
    pub order: Option<Order>,
}

/// Something for a body to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Order {
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

impl Order {
    /// The goal that it is about.
    pub fn goal(&self) -> GoalId {
        match self {
            Order::Start { id, .. } | Order::Cancel { id } => *id,
        }
    }
}

/// How a body is and what has become of its latest goals. Answer to each command; also published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyState {
    /// Whose.
    pub robot: RobotId,
    /// Grows with each state of the same host, so that an overtaken one is not believed.
    pub number: u64,
    /// The body's report.
    pub telemetry: Telemetry,
    /// The latest goals, in the order of their ids.
    pub goals: Vec<(GoalId, GoalStatus)>,
    /// Those of them that were done and must not be done again, and what they asked for.
    pub done: Vec<(GoalId, Goal)>,
}

/// Someone who acts for an unmanaged role is asked, told again, or dismissed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PeopleAsk {
    /// The ask's id: a repeated one asks nothing new.
    pub id: GoalId,
    /// What is asked; `None` dismisses.
    pub ask: Option<PersonAsk>,
}

/// Answer to an ask.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonState {
    /// They have been asked.
    Asked,
    /// They have ended.
    Ended(Result<(), ActionError>),
    /// They were told that it is no longer wanted: under this id it is not asked again.
    Dismissed,
}

/// Published when a person has something to say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum PersonWord {
    /// They have ended what they were asked to do.
    Done {
        /// The ask.
        id: GoalId,
        /// What came of it.
        result: Result<(), ActionError>,
    },
    /// They call off the mission for which a robot came to them. Repeated for some beats.
    CallOff {
        /// Who says so.
        by: String,
        /// The role they play.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
        /// Tells one such word from the next: milliseconds of world time.
        said_ms: u64,
    },
}
