//! Check of a schedule against its fleet.

use super::alarms::ALARMS;
use super::chaos_fleet::{ChaosFleet, MISSIONS, ROOMS, ROOMS_WITHOUT_NURSE};
use super::control_flow::CONTROL_FLOW_MISSIONS;
use super::person_action::{ALL_ROBOTS, IN_ZONE, MissionAction};
use super::poison::poison_missions;
use super::schedule::{CARRIER_OF, ChaosAction, Schedule, ScheduledAction};
use super::zones::{parts_with_zones, zone_names};
use consort_skills::workload::Workload;

impl Schedule {
    /// Checks that the fleet and the workload contain everything that the schedule names.
    ///
    /// # Errors
    /// A name is unknown, or a number is outside its range.
    pub fn check(&self, composition: &ChaosFleet, workload: &Workload) -> Result<(), ScheduleError> {
        let nodes = composition.nodes();
        let robots: Vec<&str> = composition.carriers.iter().chain(&composition.arms).copied().collect();
        let check_known = |step: &ScheduledAction, name: &str, known: &[&str], extra: &[&str]| {
            let known: Vec<&str> = known.iter().chain(extra).copied().collect();
            if known.contains(&name) || name.starts_with(CARRIER_OF) {
                return Ok(());
            }
            Err(step.invalid(ScheduleProblem::UnknownName { name: name.to_owned(), known: known.join(", ") }))
        };
        for step in &self.steps {
            match &step.action {
                ChaosAction::Submit { room, mission, .. } => {
                    check_known(step, room, &ROOMS, &ROOMS_WITHOUT_NURSE)?;
                    let mut own: Vec<&str> = CONTROL_FLOW_MISSIONS.into_iter().chain(poison_missions()).collect();
                    own.extend(workload.own_missions());
                    check_known(step, mission, &MISSIONS, &own)?;
                }
                ChaosAction::Cancel { .. }
                | ChaosAction::CancelMissions { .. }
                | ChaosAction::ChangeSchedule { .. }
                | ChaosAction::Blackout { .. }
                | ChaosAction::Upgrade { .. }
                | ChaosAction::Hostile { .. } => {}
                ChaosAction::Remove { node } => check_known(step, node, &nodes, &[])?,
                ChaosAction::Crash { node, .. } => check_known(step, node, &nodes, &["coordinator"])?,
                ChaosAction::Pause { node, .. }
                | ChaosAction::Suspend { node, .. }
                | ChaosAction::Block { node, .. }
                | ChaosAction::Leave { node, .. }
                | ChaosAction::WrongDate { node, .. }
                | ChaosAction::SlowDisk { node, .. }
                | ChaosAction::Disk { node, .. } => {
                    check_known(step, node, &nodes, &[])?;
                }
                ChaosAction::Partition { groups, .. } => {
                    groups.iter().flatten().try_for_each(|node| check_known(step, node, &nodes, &["client"]))?;
                }
                ChaosAction::Cut { from, to, .. } => {
                    check_known(step, from, &nodes, &["client", "*"])?;
                    check_known(step, to, &nodes, &["client", "*"])?;
                }
                ChaosAction::Weather { loss, duplication, reordering, .. } => {
                    if ![loss, duplication, reordering].into_iter().all(|share| (0.0..=1.0).contains(share)) {
                        return Err(step.invalid(ScheduleProblem::Share));
                    }
                }
                ChaosAction::Drift { node, rate } => {
                    check_known(step, node, &nodes, &[])?;
                    if !(0.5..=2.0).contains(rate) {
                        return Err(step.invalid(ScheduleProblem::ClockRate));
                    }
                }
                ChaosAction::Closure { part, .. } | ChaosAction::SpeedLimit { part, .. } => {
                    let known: Vec<String> = parts_with_zones().iter().map(ToString::to_string).collect();
                    let known: Vec<&str> = known.iter().map(String::as_str).collect();
                    check_known(step, &part.to_string(), &known, &[])?;
                }
                ChaosAction::Alarm { alarm, .. } => check_known(step, alarm, &ALARMS, &[])?,
                ChaosAction::ChangeMission { change, .. } => match change {
                    MissionAction::Reassign { to: Some(robot), .. } | MissionAction::Pin { robot } => {
                        check_known(step, robot, &robots, &[])?;
                    }
                    MissionAction::Prioritize { .. }
                    | MissionAction::Reassign { to: None, .. }
                    | MissionAction::Unpin => {}
                },
                ChaosAction::Order { robot, .. } => match robot.strip_prefix(IN_ZONE) {
                    Some(zone) => check_known(step, zone, &zone_names(), &[])?,
                    None => check_known(step, robot, &robots, &[ALL_ROBOTS])?,
                },
                ChaosAction::Battery { robot }
                | ChaosAction::Skill { robot, .. }
                | ChaosAction::Revoke { node: robot, .. } => {
                    check_known(step, robot, &robots, &[])?;
                }
            }
        }
        Ok(())
    }
}

impl ScheduledAction {
    fn invalid(&self, problem: ScheduleProblem) -> ScheduleError {
        ScheduleError { at_ms: self.at_ms, problem }
    }
}

/// Schedule that its fleet cannot perform.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("at {at_ms} ms: {problem}")]
pub struct ScheduleError {
    /// Time of the action in milliseconds.
    pub at_ms: u64,
    /// The problem of the action.
    pub problem: ScheduleProblem,
}

/// Problem of a scheduled action.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScheduleProblem {
    /// The fleet has nothing of that name.
    #[error("{name:?} is not known; there are {known}")]
    UnknownName {
        /// The name in the schedule.
        name: String,
        /// The known names, separated by commas.
        known: String,
    },
    /// A share of messages is outside 0 to 1.
    #[error("a share lies between 0 and 1")]
    Share,
    /// A clock rate is outside 0.5 to 2.
    #[error("a clock rate must be from 0.5 to 2")]
    ClockRate,
}
