//! Key performance indicators of the fleet.

use super::FleetModel;
use super::state::{MissionModel, RobotModel};
use serde::Serialize;
use std::collections::BTreeMap;

/// Maximum time step that counts fully: the robots' state during a longer step is unknown.
const STEP_MAX_MS: u64 = 5000;

/// Indicators of the known missions, and of the time since the model was created.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Kpis {
    /// Known missions.
    pub missions: usize,
    /// Completed missions.
    pub completed: usize,
    /// Failed missions, or missions that need intervention.
    pub failed: usize,
    /// Canceled missions.
    pub canceled: usize,
    /// Running missions, or missions that wait for robots.
    pub under_way: usize,
    /// Share of completed missions among those that ended and were not canceled.
    pub success: Option<f64>,
    /// Median time from request to end of completed missions with a known end, in milliseconds.
    pub completion_ms: Option<u64>,
    /// Median time from request to award, in milliseconds.
    pub award_ms: Option<f64>,
    /// Share of the time in which robots in service had a role, since the model was created.
    pub utilisation: Option<f64>,
    /// Robots in service with a role.
    pub busy: usize,
    /// Robots in service.
    pub in_service: usize,
    /// Changes of the coordinator since the model was created.
    pub takeovers: usize,
    /// Duration of the last change, in milliseconds, from the last message of the former
    /// coordinator.
    pub takeover_ms: Option<u64>,
}

/// Time that robots had a role, in robot milliseconds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Utilization {
    busy: u64,
    in_service: u64,
    until_ms: Option<u64>,
}

impl Utilization {
    /// Advances the time.
    pub(super) fn advance(&mut self, robots: &BTreeMap<String, RobotModel>, now_ms: u64) {
        if let Some(until) = self.until_ms {
            let step = now_ms.saturating_sub(until).min(STEP_MAX_MS);
            let (busy, in_service) = counts(robots);
            self.busy += busy as u64 * step;
            self.in_service += in_service as u64 * step;
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
    /// Returns the indicators.
    pub fn kpis(&self) -> Kpis {
        let count = |is: fn(&MissionModel) -> bool| self.missions.values().filter(|mission| is(mission)).count();
        let completed = count(|mission| mission.state == "completed");
        let canceled = count(|mission| mission.state == "canceled");
        let ended = count(|mission| mission.ended);
        let failed = ended - completed - canceled;
        let decided = completed + failed;
        let took = |mission: &MissionModel| Some(mission.ended_ms?.saturating_sub(mission.submitted_ms));
        let completion_times = self.missions.values().filter(|mission| mission.state == "completed").filter_map(took);
        let award_times = self.missions.values().filter_map(|mission| mission.award_after_ms);
        let (busy, in_service) = counts(&self.robots);
        let changes = || self.takeovers.iter().filter(|takeover| takeover.from.is_some());
        Kpis {
            missions: self.missions.len(),
            completed,
            failed,
            canceled,
            under_way: self.missions.len() - ended,
            success: (decided > 0).then(|| completed as f64 / decided as f64),
            completion_ms: median(completion_times.map(|ms| ms as f64).collect()).map(|ms| ms.round() as u64),
            award_ms: median(award_times.collect()),
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
