//! A shift: robots of the hospital carry lab samples, many missions at a time, on virtual time.

mod dispatcher;
mod record;
mod work;

pub use work::{CHARGERS, requests_per_hour};

use crate::fleet::{Fleet, NodeOptions, nurse_in};
use crate::percentiles::Percentiles;
use crate::{RobotSpec, paused_runtime, slug};
use consort_evaluation::shift::{ShiftFigures, ShiftJob, ShiftMetrics, ShiftPolicy};
use consort_protocol::auction::Allocator;
use consort_protocol::ids::PlaceId;
use consort_world::world::{PersonSetup, World, WorldEvent};
use dispatcher::Dispatcher;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use record::{CarrierMeters, MissionRecord};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};
use work::{LABORATORY, ShiftRequest, WorkModel};

/// Work of a shift.
#[derive(Debug, Clone, Copy)]
pub struct ShiftSetup {
    /// Number of robots that carry samples.
    pub robots: usize,
    /// Number of arms in the laboratory.
    pub arms: usize,
    /// Number of chargers, at most that of [`CHARGERS`].
    pub chargers: usize,
    /// Number of missions.
    pub missions: usize,
    /// Mean number of requests per hour, as a Poisson process; `None` for all requests at once.
    pub per_hour: Option<f64>,
    /// Rule by which the missions get their carriers.
    pub policy: ShiftPolicy,
    /// World seconds per second of node time.
    pub world_speed: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for ShiftSetup {
    fn default() -> ShiftSetup {
        ShiftSetup {
            robots: 12,
            arms: 1,
            chargers: 0,
            missions: 48,
            per_hour: None,
            policy: ShiftPolicy::Consort,
            world_speed: 1.0,
            seed: 1,
        }
    }
}

const STATIONS: [&str; 3] = ["base-1", "base-2", "base-3"];

/// World time after the last request in which the missions end.
const LIMIT_S: f64 = 24.0 * 3600.0;

/// Interval of measurements, in node time.
const INTERVAL: Duration = Duration::from_secs(1);

/// World time from the request after which a completed mission is late.
const LATE_S: f64 = 1800.0;

/// Runs a shift. `progress` receives the number of missions that have ended.
///
/// # Panics
/// If there are more chargers than [`CHARGERS`].
pub fn run(setup: ShiftSetup, progress: impl Fn(usize)) -> ShiftFigures {
    paused_runtime().block_on(run_on_virtual_time(setup, progress))
}

async fn run_on_virtual_time(setup: ShiftSetup, progress: impl Fn(usize)) -> ShiftFigures {
    let wall = Instant::now();
    let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
    let rooms = work::rooms(setup.chargers);
    let carriers = work::draw_carriers(setup.robots, &rooms, &mut chance);
    let requests = work::draw_requests(&setup, &rooms, &mut chance);
    let dispatcher = dispatcher(&setup, &rooms, &carriers, &requests);
    let fleet = start(&setup, &rooms, &carriers, dispatcher.clone()).await;
    let meters = CarrierMeters::new(&fleet, carriers.iter().map(|carrier| carrier.name.as_str()));
    let mut shift =
        Shift { setup, fleet, record: MissionRecord::default(), meters, stranded: BTreeSet::new(), progress };
    let began = shift.fleet.elapsed();
    for (number, request) in requests.iter().enumerate() {
        shift.pass_until(began + Duration::from_secs_f64(request.at_s / setup.world_speed)).await;
        let mission = shift.fleet.submit(&format!("shift-{number}"), request.room.as_str()).await;
        if let Some(dispatcher) = &dispatcher {
            dispatcher.add(number, mission);
        }
    }
    let end = shift.fleet.elapsed() + Duration::from_secs_f64(LIMIT_S / setup.world_speed);
    while shift.record.ended < setup.missions && shift.fleet.elapsed() < end {
        shift.pass_until((shift.fleet.elapsed() + INTERVAL).min(end)).await;
    }
    shift.figures(began, wall)
}

/// Returns the queues of a policy that assigns carriers in advance.
fn dispatcher(
    setup: &ShiftSetup,
    rooms: &[PlaceId],
    carriers: &[RobotSpec],
    requests: &[ShiftRequest],
) -> Option<Arc<Dispatcher>> {
    let (model, speed) = (WorkModel::new(rooms), setup.world_speed);
    let jobs: Vec<ShiftJob<PlaceId>> = requests.iter().map(|request| model.job(request)).collect();
    let carriers = carriers.iter().map(|carrier| (slug(&carrier.name), slug(&carrier.place))).collect();
    match setup.policy {
        ShiftPolicy::Instantaneous | ShiftPolicy::Consort => None,
        ShiftPolicy::Tessi => Some(Arc::new(Dispatcher::tessi(jobs, carriers, model, speed))),
        ShiftPolicy::Oracle => Some(Arc::new(Dispatcher::oracle(jobs, carriers, model, speed, setup.seed))),
    }
}

async fn start(
    setup: &ShiftSetup,
    rooms: &[PlaceId],
    carriers: &[RobotSpec],
    dispatcher: Option<Arc<Dispatcher>>,
) -> Fleet {
    let arms = (0..setup.arms).map(|number| RobotSpec::arm(&format!("lab-arm-{number}"), LABORATORY));
    let robots = carriers.iter().cloned().chain(arms).collect();
    let nurse = |room: &PlaceId| PersonSetup { endless_samples: true, ..nurse_in(room.as_str()) };
    let people = rooms.iter().map(nurse).collect();
    let policy = setup.policy;
    let allocator = dispatcher.map(|dispatcher| -> Arc<dyn Allocator> { dispatcher });
    let options = NodeOptions {
        world_speed: setup.world_speed,
        charging: work::charging(setup.chargers),
        adjust: Box::new(move |settings| {
            if policy == ShiftPolicy::Instantaneous {
                settings.fleet.promises.promises_max = 0;
            }
            if let Some(allocator) = &allocator {
                settings.fleet.allocator = Arc::clone(allocator);
            }
        }),
        ..NodeOptions::default()
    };
    let mut fleet = Fleet::hospital_with(setup.seed, robots, &STATIONS, people, options).await;
    fleet.wait_for_coordinator().await;
    fleet
}

struct Shift<F> {
    setup: ShiftSetup,
    fleet: Fleet,
    record: MissionRecord,
    meters: CarrierMeters,
    /// Carriers whose battery fell to the charge at which they stop.
    stranded: BTreeSet<String>,
    progress: F,
}

impl<F: Fn(usize)> Shift<F> {
    /// Lets time pass, and observes the fleet. A long shift is observed at intervals: it has too many events to check
    /// all missions after each, or to keep them all.
    async fn pass_until(&mut self, end: Duration) {
        loop {
            self.observe();
            let left = end.saturating_sub(self.fleet.elapsed());
            if left.is_zero() {
                return;
            }
            tokio::time::sleep(left.min(INTERVAL)).await; // virtual time
        }
    }

    fn observe(&mut self) {
        let ended = self.record.ended;
        for (at, entry) in self.fleet.event_log.take() {
            self.record.observe(at, &entry);
        }
        for entry in self.fleet.world.with(World::drain_event_log) {
            if let WorldEvent::Stranded { robot } = entry.event {
                self.stranded.insert(robot.to_string());
            }
        }
        self.meters.measure(&self.fleet);
        if self.record.ended > ended {
            (self.progress)(self.record.ended);
        }
    }

    fn figures(&self, began: Duration, wall: Instant) -> ShiftFigures {
        let speed = self.setup.world_speed;
        let missions = || self.record.missions.values();
        let seconds = |times: &Duration| times.as_secs_f64() * speed;
        let waiting: Vec<f64> = missions().filter_map(|times| Some(seconds(&times.waiting()?))).collect();
        let completion: Vec<f64> = missions().filter_map(|times| Some(seconds(&times.completion()?))).collect();
        let completed = completion.len();
        let last = missions().filter(|times| times.is_completed).filter_map(|times| times.ended).max();
        let all_s = last.map_or(0.0, |last| seconds(&last.saturating_sub(began)));
        let (waiting_s, waiting_p95_s) = mean_and_p95(&waiting);
        let (completion_s, completion_p95_s) = mean_and_p95(&completion);
        let metrics = ShiftMetrics {
            per_hour: if all_s > 0.0 { completed as f64 * 3600.0 / all_s } else { 0.0 },
            waiting_s,
            waiting_p95_s,
            completion_s,
            completion_p95_s,
            distance_m: self.meters.distance_m,
            energy: self.meters.energy,
            messages: self.fleet.network.counters().delivered as f64,
            wall_s: wall.elapsed().as_secs_f64(),
        };
        ShiftFigures {
            seed: self.setup.seed,
            missions: self.setup.missions,
            completed,
            late: completion.iter().filter(|time| **time > LATE_S).count(),
            stranded: self.stranded.len(),
            charge_min: self.meters.charge_min,
            metrics,
        }
    }
}

/// Returns mean and 95th percentile; 0 without values.
fn mean_and_p95(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    (mean, Percentiles::of(values.to_vec()).map_or(0.0, |percentiles| percentiles.p95))
}
