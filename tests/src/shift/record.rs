//! What happens in a shift: the times of its missions, and the way and charge of its carriers.

use crate::{Fleet, Observation, slug};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::ledger::MissionState;
use consort_protocol::pose::Pose;
use consort_skills::actions::RobotBackend as _;
use std::collections::BTreeMap;
use std::time::Duration;

/// Times of a mission on the clock of the fleet.
#[derive(Debug, Default)]
pub(super) struct MissionTimes {
    pub(super) submitted: Option<Duration>,
    pub(super) started: Option<Duration>,
    pub(super) ended: Option<Duration>,
    pub(super) is_completed: bool,
}

impl MissionTimes {
    /// Returns the time from the request to the first task.
    pub(super) fn waiting(&self) -> Option<Duration> {
        Some(self.started?.saturating_sub(self.submitted?))
    }

    /// Returns the time from the request to the completion.
    pub(super) fn completion(&self) -> Option<Duration> {
        let ended = self.ended.filter(|_| self.is_completed)?;
        Some(ended.saturating_sub(self.submitted?))
    }
}

/// Observed missions.
#[derive(Debug, Default)]
pub(super) struct MissionRecord {
    pub(super) missions: BTreeMap<MissionId, MissionTimes>,
    /// Number of missions that have ended.
    pub(super) ended: usize,
}

impl MissionRecord {
    pub(super) fn observe(&mut self, at: Duration, entry: &Observation) {
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

    fn times(&mut self, mission: &MissionId) -> &mut MissionTimes {
        self.missions.entry(mission.clone()).or_default()
    }
}

/// Measured carrier.
#[derive(Debug)]
struct CarrierMeter {
    robot: RobotId,
    pose: Pose,
    battery: f64,
}

/// Way and charge of all carriers, measured at intervals. A corner between two measurements is cut.
#[derive(Debug)]
pub(super) struct CarrierMeters {
    carriers: Vec<CarrierMeter>,
    pub(super) distance_m: f64,
    /// Discharge in full batteries.
    pub(super) energy: f64,
    pub(super) charge_min: f64,
}

impl CarrierMeters {
    pub(super) fn new<'a>(fleet: &Fleet, carriers: impl Iterator<Item = &'a str>) -> CarrierMeters {
        let meter = |name: &str| {
            let robot: RobotId = slug(name);
            let telemetry = fleet.world.telemetry(&robot).expect("a robot of this world");
            CarrierMeter { robot, pose: telemetry.pose, battery: telemetry.battery.get() }
        };
        let carriers: Vec<CarrierMeter> = carriers.map(meter).collect();
        let charge_min = carriers.iter().map(|carrier| carrier.battery).fold(1.0, f64::min);
        CarrierMeters { carriers, distance_m: 0.0, energy: 0.0, charge_min }
    }

    pub(super) fn measure(&mut self, fleet: &Fleet) {
        for carrier in &mut self.carriers {
            let Some(telemetry) = fleet.world.telemetry(&carrier.robot) else { continue };
            let (pose, battery) = (telemetry.pose, telemetry.battery.get());
            self.distance_m += (pose.x - carrier.pose.x).hypot(pose.y - carrier.pose.y);
            self.energy += (carrier.battery - battery).max(0.0);
            self.charge_min = self.charge_min.min(battery);
            (carrier.pose, carrier.battery) = (pose, battery);
        }
    }
}
