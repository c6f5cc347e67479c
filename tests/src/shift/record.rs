//! What happens in a shift: the times of its missions, and the way and charge of its carriers.

use super::ShiftSetup;
use crate::percentiles::Percentiles;
use crate::{Fleet, Observation, slug};
use consort_evaluation::shift::{ShiftFigures, ShiftMetrics};
use consort_fleet::observe::{Observer, SharedObserver};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, MissionState};
use consort_protocol::pose::Pose;
use consort_skills::actions::RobotBackend as _;
use consort_world::world::WorldEvent;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

/// World time from the request after which a completed mission is late.
const LATE_S: f64 = 1800.0;

/// Passes the events that a shift observes. To copy all events and all entries of the log would take much of
/// the time of a long run.
pub(super) struct RecordedEvents(pub(super) SharedObserver);

impl Observer for RecordedEvents {
    fn on_event(&self, event: &Event) {
        let is_recorded = matches!(
            event.kind,
            EventKind::Submitted { .. }
                | EventKind::Awarded { .. }
                | EventKind::TaskBegan { .. }
                | EventKind::Mission { .. }
        );
        if is_recorded {
            self.0.on_event(event);
        }
    }

    fn on_applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}

/// Times of a mission on the clock of the fleet.
#[derive(Debug, Default)]
struct MissionTimes {
    submitted: Option<Duration>,
    started: Option<Duration>,
    ended: Option<Duration>,
    is_completed: bool,
}

impl MissionTimes {
    /// Returns the time from the request to the first task.
    fn waiting(&self) -> Option<Duration> {
        Some(self.started?.saturating_sub(self.submitted?))
    }

    /// Returns the time from the request to the completion.
    fn completion(&self) -> Option<Duration> {
        let ended = self.ended.filter(|_| self.is_completed)?;
        Some(ended.saturating_sub(self.submitted?))
    }
}

/// Measured carrier.
#[derive(Debug)]
struct Carrier {
    robot: RobotId,
    pose: Pose,
    battery: f64,
}

/// Observed shift.
#[derive(Debug)]
pub(crate) struct ShiftRecord {
    missions: BTreeMap<MissionId, MissionTimes>,
    /// Number of missions that have ended.
    pub(crate) ended: usize,
    carriers: Vec<Carrier>,
    /// Carriers whose battery fell to the charge at which they stop.
    stranded: BTreeSet<RobotId>,
    distance_m: f64,
    /// Discharge in full batteries.
    energy: f64,
    charge_min: f64,
}

impl ShiftRecord {
    /// Begins to record a fleet with these carriers.
    pub(crate) fn new<'a>(fleet: &Fleet, carriers: impl Iterator<Item = &'a str>) -> ShiftRecord {
        let carrier = |name: &str| {
            let robot: RobotId = slug(name);
            let telemetry = fleet.world.telemetry(&robot).expect("a robot of this world");
            Carrier { robot, pose: telemetry.pose, battery: telemetry.battery.get() }
        };
        let carriers: Vec<Carrier> = carriers.map(carrier).collect();
        let charge_min = carriers.iter().map(|carrier| carrier.battery).fold(1.0, f64::min);
        ShiftRecord {
            missions: BTreeMap::new(),
            ended: 0,
            carriers,
            stranded: BTreeSet::new(),
            distance_m: 0.0,
            energy: 0.0,
            charge_min,
        }
    }

    pub(crate) fn observe(&mut self, at: Duration, entry: &Observation) {
        match entry.event_kind() {
            Some(EventKind::Submitted { mission, .. }) => {
                self.times(mission).submitted.get_or_insert(at);
            }
            Some(EventKind::TaskBegan { mission, .. }) => {
                self.times(mission).started.get_or_insert(at);
            }
            Some(EventKind::Mission { mission, state, .. }) if state.is_final() => {
                let times = self.times(mission);
                if times.ended.is_none() {
                    times.ended = Some(at);
                    times.is_completed = *state == MissionState::Completed;
                    self.ended += 1;
                }
            }
            _ => {}
        }
    }

    pub(crate) fn observe_world(&mut self, event: &WorldEvent) {
        if let WorldEvent::Stranded { robot } = event {
            self.stranded.insert(robot.clone());
        }
    }

    /// Measures way and charge since the last measurement. A corner between two measurements is cut.
    pub(crate) fn measure(&mut self, fleet: &Fleet) {
        for carrier in &mut self.carriers {
            let Some(telemetry) = fleet.world.telemetry(&carrier.robot) else { continue };
            let (pose, battery) = (telemetry.pose, telemetry.battery.get());
            self.distance_m += (pose.x - carrier.pose.x).hypot(pose.y - carrier.pose.y);
            self.energy += (carrier.battery - battery).max(0.0);
            self.charge_min = self.charge_min.min(battery);
            (carrier.pose, carrier.battery) = (pose, battery);
        }
    }

    /// Returns the figures of a shift that began at `began` on the clock of the fleet.
    pub(crate) fn figures(&self, setup: &ShiftSetup, fleet: &Fleet, began: Duration, wall: Instant) -> ShiftFigures {
        let seconds = |times: Duration| times.as_secs_f64() * setup.world_speed;
        let missions = || self.missions.values();
        let waiting: Vec<f64> = missions().filter_map(|times| Some(seconds(times.waiting()?))).collect();
        let completion: Vec<f64> = missions().filter_map(|times| Some(seconds(times.completion()?))).collect();
        let completed = completion.len();
        let late = completion.iter().filter(|time| **time > LATE_S).count();
        let last = missions().filter(|times| times.is_completed).filter_map(|times| times.ended).max();
        let all_s = last.map_or(0.0, |last| seconds(last.saturating_sub(began)));
        let (waiting_s, waiting_p95_s) = mean_and_p95(waiting);
        let (completion_s, completion_p95_s) = mean_and_p95(completion);
        let metrics = ShiftMetrics {
            per_hour: if all_s > 0.0 { completed as f64 * 3600.0 / all_s } else { 0.0 },
            waiting_s,
            waiting_p95_s,
            completion_s,
            completion_p95_s,
            distance_m: self.distance_m,
            energy: self.energy,
            messages: fleet.network.counters().delivered as f64,
            wall_s: wall.elapsed().as_secs_f64(),
        };
        ShiftFigures {
            seed: setup.seed,
            missions: setup.missions,
            completed,
            late,
            stranded: self.stranded.len(),
            charge_min: self.charge_min,
            metrics,
        }
    }

    fn times(&mut self, mission: &MissionId) -> &mut MissionTimes {
        self.missions.entry(mission.clone()).or_default()
    }
}

/// Returns mean and 95th percentile; 0 without values.
fn mean_and_p95(values: Vec<f64>) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    (mean, Percentiles::of(values).map_or(0.0, |percentiles| percentiles.p95))
}
