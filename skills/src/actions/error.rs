//! Failures of goals.

use serde::{Deserialize, Serialize};

/// A goal failed. The robot stands still where it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {message}")]
pub struct ActionError {
    /// Code, for programs.
    pub code: ErrorCode,
    /// Message, for people. It names the objects involved.
    pub message: String,
}

/// Kinds of failure that skills may treat differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The robot, person or place is unknown here.
    Unknown,
    /// There is no route.
    NoRoute,
    /// There is a route, but an obstacle blocks it: [`Telemetry::closed`](super::Telemetry::closed)
    /// contains the lane.
    Blocked,
    /// The other robot, person or object is not close enough.
    OutOfReach,
    /// The person is not the required person, or declined.
    NotAuthenticated,
    /// The drawer is in the wrong state: closed, open, full or empty.
    DrawerState,
    /// The object exceeds the payload of the arm.
    TooHeavy,
    /// The battery is too low to move.
    BatteryLow,
    /// The robot executes another goal.
    Busy,
    /// The goal exceeded its time limit.
    TimedOut,
    /// The place is not a charger, or the charger does not work.
    Charger,
    /// The action was performed without success.
    Failed,
}

impl std::fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ErrorCode::Unknown => "unknown",
            ErrorCode::NoRoute => "no route",
            ErrorCode::Blocked => "blocked",
            ErrorCode::OutOfReach => "out of reach",
            ErrorCode::NotAuthenticated => "not authenticated",
            ErrorCode::DrawerState => "drawer state",
            ErrorCode::TooHeavy => "too heavy",
            ErrorCode::BatteryLow => "battery low",
            ErrorCode::Busy => "busy",
            ErrorCode::TimedOut => "timed out",
            ErrorCode::Charger => "charger",
            ErrorCode::Failed => "failed",
        })
    }
}
