//! What people request in a schedule, and what of it they end when all faults have ended.

use super::schedule::{ChaosAction, Schedule, ScheduledAction};
use consort_protocol::api::AlarmAction;
use consort_protocol::ledger::MapPart;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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

impl Schedule {
    /// Checks whether people give orders to robots.
    pub(super) fn has_orders(&self) -> bool {
        self.steps.iter().any(|step| matches!(step.action, ChaosAction::Order { .. }))
    }

    /// Checks whether people raise alarms.
    pub(super) fn has_alarms(&self) -> bool {
        self.steps.iter().any(|step| matches!(step.action, ChaosAction::Alarm { change: AlarmAction::Raise, .. }))
    }

    /// Returns the zones, places and lanes in which people limit the speed.
    pub(super) fn limited_parts(&self) -> BTreeSet<MapPart> {
        let of = |step: &ScheduledAction| match &step.action {
            ChaosAction::SpeedLimit { part, change: SpeedLimitAction::Set { .. } } => Some(part.clone()),
            _ => None,
        };
        self.steps.iter().filter_map(of).collect()
    }

    /// Returns the requests with missions whose role of the carrier people reassign or pin.
    pub(super) fn restricted_requests(&self) -> BTreeSet<String> {
        let of = |step: &ScheduledAction| match &step.action {
            ChaosAction::ChangeMission {
                request,
                change: MissionAction::Reassign { .. } | MissionAction::Pin { .. },
            } => Some(request.clone()),
            _ => None,
        };
        self.steps.iter().filter_map(of).collect()
    }

    /// Returns what people cancel at once, by the numbers of the actions.
    pub(super) fn cancelations(&self) -> BTreeMap<usize, CancelSelection> {
        let of = |(number, step): (usize, &ScheduledAction)| match &step.action {
            ChaosAction::CancelMissions { selection } => Some((number, selection.clone())),
            _ => None,
        };
        self.steps.iter().enumerate().filter_map(of).collect()
    }

    /// Checks whether people name zones.
    pub(super) fn names_zones(&self) -> bool {
        self.steps.iter().any(|step| match &step.action {
            ChaosAction::Order { robot, .. } => robot.starts_with(IN_ZONE),
            ChaosAction::Closure { part, .. } | ChaosAction::SpeedLimit { part, .. } => {
                matches!(part, MapPart::Zone(_))
            }
            _ => false,
        })
    }

    /// Returns the zones, places and lanes that a person closes.
    pub(super) fn closed_parts(&self) -> BTreeSet<MapPart> {
        let of = |step: &ScheduledAction| match &step.action {
            ChaosAction::Closure { part, change: ClosureAction::Close { .. } } => Some(part.clone()),
            _ => None,
        };
        self.steps.iter().filter_map(of).collect()
    }
}
