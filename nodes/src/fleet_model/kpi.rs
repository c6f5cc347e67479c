//! Figures: how well the fleet does, as far as the picture knows.

use super::FleetModel;
use super::state::{MissionModel, RobotModel};
use serde::Serialize;
use std::collections::BTreeMap;

/// Longest stretch of time that is counted as one: after a longer one nobody knows what the robots did meanwhile.
const STRETCH_MAX_MS: u64 = 5000;

/// Figures of the missions that are known, and of the time since the picture was begun.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Kpis {
    /// Missions known.
    pub missions: usize,
    /// Carried out.
    pub completed: usize,
    /// Given up, or waiting for a rescue.
    pub failed: usize,
    /// Withdrawn.
    pub canceled: usize,
    /// Under way or waiting for robots.
    pub under_way: usize,
    /// Share of the missions carried out, of those that ended and were not withdrawn.
    pub success: Option<f64>,
    /// Median time from request to end of the missions carried out, in milliseconds, of those whose end was seen.
    pub conclude_ms: Option<u64>,
    /// Median time from request to award, in milliseconds.
    pub award_ms: Option<f64>,
    /// Share of the time that robots in service had a role, since the picture was begun.
    pub utilisation: Option<f64>,
    /// Robots in service that have a role now.
    pub busy: usize,
    /// Robots in service.
    pub in_service: usize,
    /// Changes of the coordinator since the picture was begun.
    pub takeovers: usize,
    /// How long the last of them took, in milliseconds, from the former one's last word.
    pub takeover_ms: Option<u64>,
}

/// How much of their time robots had a role, in robot milliseconds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Utilization {
    busy: u64,
    in_service: u64,
    until_ms: Option<u64>,
}

impl Utilization {
    /// Time has passed.
    pub(super) fn advance(&mut self, robots: &BTreeMap<String, RobotModel>, now_ms: u64) {
        if let Some(until) = self.until_ms {
            let stretch = now_ms.saturating_sub(until).min(STRETCH_MAX_MS);
            let (busy, in_service) = counts(robots);
            self.busy += busy as u64 * stretch;
            self.in_service += in_service as u64 * stretch;
        }
        self.until_ms = Some(now_ms);
    }

    fn share(self) -> Option<f64> {
        (self.in_service > 0).then(|| (self.busy as f64 / self.in_service as f64 * 1000.0).round() / 1000.0)
    }
}

fn counts(robots: &BTreeMap<String, RobotModel>) -> (usize, usize) {
    let in_service = |robot: &&RobotModel| robot.alive && robot.availability != "out_of_service";
    let busy = |robot: &&RobotModel| matches!(robot.availability.as_str(), "holding" | "suspended");
    let all = || robots.values().filter(in_service);
    (all().filter(busy).count(), all().count())
}

impl FleetModel {
    /// The figures.
    pub fn kpis(&self) -> Kpis {
        let count = |is: fn(&MissionModel) -> bool| self.missions.values().filter(|mission| is(mission)).count();
        let completed = count(|mission| mission.state == "completed");
        let canceled = count(|mission| mission.state == "canceled");
        let ended = count(|mission| mission.ended);
        let failed = ended - completed - canceled;
        let judged = completed + failed;
        let took = |mission: &MissionModel| Some(mission.ended_ms?.saturating_sub(mission.submitted_ms));
        let concluded = self.missions.values().filter(|mission| mission.state == "completed").filter_map(took);
        let awarded = self.missions.values().filter_map(|mission| mission.award_after_ms);
        let (busy, in_service) = counts(&self.robots);
        let changes = || self.takeovers.iter().filter(|takeover| takeover.from.is_some());
        Kpis {
            missions: self.missions.len(),
            completed,
            failed,
            canceled,
            under_way: self.missions.len() - ended,
            success: (judged > 0).then(|| completed as f64 / judged as f64),
            conclude_ms: median(concluded.map(|ms| ms as f64).collect()).map(|ms| ms.round() as u64),
            award_ms: median(awarded.collect()),
            utilisation: self.utilization.share(),
            busy,
            in_service,
            takeovers: changes().count(),
            takeover_ms: changes().next_back().and_then(|takeover| takeover.gap_ms),
        }
    }
}

fn median(mut numbers: Vec<f64>) -> Option<f64> {
    numbers.sort_by(f64::total_cmp);
    let middle = numbers.len() / 2;
    match numbers.len() {
        0 => None,
        odd if odd % 2 == 1 => Some(numbers[middle]),
        _ => Some(f64::midpoint(numbers[middle - 1], numbers[middle])),
    }
}
