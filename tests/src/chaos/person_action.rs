//! Actions of people.

use serde::{Deserialize, Serialize};

/// Name that stands for all robots in an order of a person.
pub(super) const ALL_ROBOTS: &str = "*";

/// Prefix of a name that stands for the robots in a zone in an order of a person, as in `zone icu`.
pub(super) const IN_ZONE: &str = "zone ";

/// Change of the orders to robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OrderAction {
    /// They stand still.
    Hold {
        /// Seconds after which the hold ends by itself.
        for_s: u32,
    },
    /// Their holds end.
    Release,
    /// They get no other role, without a time limit.
    BeginMaintenance,
    /// Their maintenance ends.
    EndMaintenance,
}

/// Change of a closure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClosureAction {
    /// No robot enters the place, or drives the lane.
    Close {
        /// Seconds after which the closure ends by itself; no end if absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        for_s: Option<u32>,
    },
    /// The closure ends.
    Open,
}

/// Change of a speed limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpeedLimitAction {
    /// Robots drive slower.
    Set {
        /// The highest allowed speed in metres per second.
        speed_mps: f64,
        /// Seconds after which the limit ends by itself; no end if absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        for_s: Option<u32>,
    },
    /// The limit ends.
    Clear,
}

/// Change of a mission, or of its role of the carrier.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissionAction {
    /// It has another priority.
    Prioritize {
        /// Priority: higher is served first.
        priority: i64,
    },
    /// The role goes to another robot.
    Reassign {
        /// The robot; any but the present one if absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        to: Option<String>,
        /// The other robot may repeat tasks that have ended.
        repeat: bool,
    },
    /// Only this robot gets the role.
    Pin {
        /// The robot.
        robot: String,
    },
    /// Any robot may get the role.
    Unpin,
}

/// Missions that a person cancels at once.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CancelSelection {
    /// Those of these requests that are acknowledged by then.
    Requests(Vec<String>),
    /// All active missions of this name.
    Named(String),
}
