//! Failures of goals.

use consort_protocol::cause::CauseClass;
use serde::{Deserialize, Serialize};

/// A goal failed. The robot stands still where it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {message}")]
pub struct ActionError {
    /// Code, for programs.
    pub code: ErrorCode,
    /// Class of the failure.
    pub class: CauseClass,
    /// True if the goal has certainly moved no item.
    pub moved_nothing: bool,
    /// Message, for people. It names the objects involved.
    pub message: String,
}

impl ActionError {
    /// Creates the error of a goal that began, with the class of the code. It may have moved an item.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> ActionError {
        ActionError { code, class: code.class(), moved_nothing: false, message: message.into() }
    }

    /// Creates the error of a goal that did not begin, or certainly moved no item.
    pub fn rejected(code: ErrorCode, message: impl Into<String>) -> ActionError {
        ActionError { moved_nothing: true, ..ActionError::new(code, message) }
    }
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
    /// A container is in the wrong state: closed, open, full or empty.
    ContainerState,
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

impl ErrorCode {
    /// All codes.
    pub const ALL: [ErrorCode; 12] = [
        ErrorCode::Unknown,
        ErrorCode::NoRoute,
        ErrorCode::Blocked,
        ErrorCode::OutOfReach,
        ErrorCode::NotAuthenticated,
        ErrorCode::ContainerState,
        ErrorCode::TooHeavy,
        ErrorCode::BatteryLow,
        ErrorCode::Busy,
        ErrorCode::TimedOut,
        ErrorCode::Charger,
        ErrorCode::Failed,
    ];

    /// Returns the code as in messages.
    pub fn as_str(self) -> &'static str {
        match self {
            ErrorCode::Unknown => "unknown",
            ErrorCode::NoRoute => "no_route",
            ErrorCode::Blocked => "blocked",
            ErrorCode::OutOfReach => "out_of_reach",
            ErrorCode::NotAuthenticated => "not_authenticated",
            ErrorCode::ContainerState => "container_state",
            ErrorCode::TooHeavy => "too_heavy",
            ErrorCode::BatteryLow => "battery_low",
            ErrorCode::Busy => "busy",
            ErrorCode::TimedOut => "timed_out",
            ErrorCode::Charger => "charger",
            ErrorCode::Failed => "failed",
        }
    }

    /// Returns the class of the failures of standard actions with this code.
    pub fn class(self) -> CauseClass {
        match self {
            ErrorCode::NotAuthenticated => CauseClass::Task,
            ErrorCode::Busy => CauseClass::Transient,
            ErrorCode::TooHeavy => CauseClass::Precondition,
            ErrorCode::Unknown
            | ErrorCode::NoRoute
            | ErrorCode::Blocked
            | ErrorCode::OutOfReach
            | ErrorCode::ContainerState
            | ErrorCode::BatteryLow
            | ErrorCode::TimedOut
            | ErrorCode::Charger
            | ErrorCode::Failed => CauseClass::Robot,
        }
    }
}

impl std::fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.as_str().replace('_', " "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_are_those_of_messages() {
        for code in ErrorCode::ALL {
            assert_eq!(serde_json::to_value(code).unwrap(), code.as_str());
        }
        assert_eq!(ErrorCode::OutOfReach.to_string(), "out of reach");
    }
}
