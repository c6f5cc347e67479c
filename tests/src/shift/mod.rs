//! A shift: robots of the hospital carry lab samples, many missions at a time, on virtual time.

mod dispatcher;
pub(crate) mod record;
pub(crate) mod work;

pub use work::{CHARGERS, requests_per_hour};

use crate::fleet::{Fleet, NodeOptions};
use crate::{RobotSpec, paused_runtime, slug};
use consort_evaluation::shift::{ShiftFigures, ShiftJob, ShiftPolicy};
use consort_fleet::observe::SharedObserver;
use consort_protocol::auction::Allocator;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{PlaceId, RoleId};
use consort_world::world::World;
use dispatcher::Dispatcher;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use record::{RecordedEvents, ShiftRecord};
use std::sync::Arc;
use std::time::{Duration, Instant};
use work::{CARRIER, LABORATORY, ShiftRequest, WorkModel};

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

impl ShiftSetup {
    /// Returns the interval of measurements: a second of world time.
    pub(crate) fn interval(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.world_speed)
    }
}

const STATIONS: [&str; 3] = ["base-1", "base-2", "base-3"];

/// World time after the last request in which the missions end.
const LIMIT_S: f64 = 24.0 * 3600.0;

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
    let record = ShiftRecord::new(&fleet, carriers.iter().map(|carrier| carrier.name.as_str()));
    let mut shift = Shift { interval: setup.interval(), fleet, dispatcher, record, seen: 0, progress };
    let began = shift.fleet.elapsed();
    for (number, request) in requests.iter().enumerate() {
        shift.pass_until(began + Duration::from_secs_f64(request.at_s / setup.world_speed)).await;
        let mission = shift.fleet.submit(&format!("shift-{number}"), request.room.as_str()).await;
        if let Some(dispatcher) = &shift.dispatcher {
            dispatcher.add(number, mission);
        }
    }
    let end = shift.fleet.elapsed() + Duration::from_secs_f64(LIMIT_S / setup.world_speed);
    while shift.record.ended < setup.missions && shift.fleet.elapsed() < end {
        shift.pass_until((shift.fleet.elapsed() + shift.interval).min(end)).await;
    }
    shift.record.figures(&setup, &shift.fleet, began, wall)
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
    let people = work::nurses(rooms);
    let policy = setup.policy;
    let allocator = dispatcher.map(|dispatcher| -> Arc<dyn Allocator> { dispatcher });
    let options = NodeOptions {
        world_speed: setup.world_speed,
        charging: work::charging(setup.chargers),
        adjust: Box::new(move |settings| {
            let observer = settings.observer.take();
            settings.observer = observer.map(|observer| -> SharedObserver { Arc::new(RecordedEvents(observer)) });
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
    interval: Duration,
    fleet: Fleet,
    dispatcher: Option<Arc<Dispatcher>>,
    record: ShiftRecord,
    /// Number of observed entries of the event log.
    seen: usize,
    progress: F,
}

impl<F: Fn(usize)> Shift<F> {
    /// Lets time pass, and observes the fleet at intervals: a long shift has too many events to check all missions
    /// after each, or to keep them all.
    async fn pass_until(&mut self, end: Duration) {
        loop {
            self.observe();
            let left = end.saturating_sub(self.fleet.elapsed());
            if left.is_zero() {
                return;
            }
            tokio::time::sleep(left.min(self.interval)).await; // virtual time
        }
    }

    fn observe(&mut self) {
        let ended = self.record.ended;
        for (at, entry) in self.fleet.event_log.since(self.seen) {
            self.record.observe(at, &entry);
            self.seen += 1;
            let Some(dispatcher) = &self.dispatcher else { continue };
            match entry.event_kind() {
                Some(EventKind::Awarded { mission, holders, .. }) if holders.contains_key(&slug::<RoleId>(CARRIER)) => {
                    dispatcher.note_award(mission);
                }
                Some(EventKind::Mission { mission, state, .. }) if state.is_final() => dispatcher.note_end(mission),
                _ => {}
            }
        }
        self.fleet.event_log.forget_before_latest(0);
        for entry in self.fleet.world.with(World::drain_event_log) {
            self.record.observe_world(&entry.event);
        }
        self.record.measure(&self.fleet);
        if self.record.ended > ended {
            (self.progress)(self.record.ended);
        }
    }
}
