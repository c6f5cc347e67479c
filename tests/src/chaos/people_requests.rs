//! What people request in a schedule, and what of it they end when all faults have ended.

use super::person_action::{CancelSelection, ClosureAction, IN_ZONE, MissionAction, SpeedLimitAction};
use super::schedule::{ChaosAction, Schedule, ScheduledAction};
use consort_protocol::api::AlarmAction;
use consort_protocol::ledger::MapPart;
use std::collections::{BTreeMap, BTreeSet};

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
