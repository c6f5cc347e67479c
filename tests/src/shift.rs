//! A shift: robots of the hospital carry lab samples, many missions at a time, on virtual time.

use crate::fleet::{Fleet, NodeOptions, nurse_in};
use crate::percentiles::Percentiles;
use crate::{RobotSpec, paused_runtime};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use consort_skills::environment::TopologicalMap;
use consort_world::map::shipped;
use consort_world::world::PersonSetup;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Work of a shift.
#[derive(Debug, Clone, Copy)]
pub struct ShiftSetup {
    /// Number of robots that carry samples.
    pub robots: usize,
    /// Number of arms in the laboratory.
    pub arms: usize,
    /// Number of missions.
    pub missions: usize,
    /// Mean number of requests per hour, as a Poisson process; `None` for all requests at once.
    pub per_hour: Option<f64>,
    /// Maximum number of roles that are promised to a robot.
    pub promises: u32,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Figures of a shift. Times are in seconds of world time.
#[derive(Debug, Clone, Serialize)]
pub struct ShiftFigures {
    /// Number of robots that carry samples.
    pub robots: usize,
    /// Number of arms.
    pub arms: usize,
    /// Maximum number of roles that are promised to a robot.
    pub promises: u32,
    /// Number of missions.
    pub missions: usize,
    /// Number of completed missions.
    pub completed: usize,
    /// Time from the first request to the last completion.
    pub all_s: f64,
    /// Completed missions per hour, from the first request to the last completion.
    pub per_hour: f64,
    /// Time from the request of a mission to its completion.
    pub mission_s: Option<Percentiles>,
    /// Time from the request of a mission to its first task.
    pub start_s: Option<Percentiles>,
    /// Number of messages on the network, once for each receiver.
    pub messages: u64,
    /// Duration of the run.
    pub wall_s: f64,
}

const STATIONS: [&str; 3] = ["base-1", "base-2", "base-3"];

/// Time after the last request in which the missions end.
const LIMIT: Duration = Duration::from_secs(24 * 3600);

/// Runs a shift. `progress` receives the number of missions that have ended.
pub fn run(setup: ShiftSetup, progress: impl Fn(usize)) -> ShiftFigures {
    paused_runtime().block_on(run_on_virtual_time(setup, progress))
}

async fn run_on_virtual_time(setup: ShiftSetup, progress: impl Fn(usize)) -> ShiftFigures {
    let wall = Instant::now();
    let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
    let places = places();
    let mut fleet = start(setup, &places, &mut chance).await;
    let began = fleet.elapsed();
    let mut missions: Vec<MissionId> = vec![];
    let mut at = Duration::ZERO;
    for number in 0..setup.missions {
        if let Some(per_hour) = setup.per_hour.filter(|_| number > 0) {
            // The times between the events of a Poisson process are exponential.
            let uniform: f64 = chance.random_range(f64::MIN_POSITIVE..1.0);
            at += Duration::from_secs_f64(-uniform.ln() * 3600.0 / per_hour);
            tokio::time::sleep((began + at).saturating_sub(fleet.elapsed())).await; // virtual time
        }
        let room = places.choose(&mut chance).expect("the hospital has rooms");
        missions.push(fleet.submit(&format!("shift-{number}"), room).await);
    }
    let has_ended =
        |fleet: &Fleet, mission: &MissionId| fleet.mission_state(mission).is_some_and(|state| state.is_final());
    fleet
        .wait_until("all missions to end", LIMIT, |fleet| {
            let ended = missions.iter().filter(|mission| has_ended(fleet, mission)).count();
            progress(ended);
            ended == missions.len()
        })
        .await;
    figures(&fleet, setup, &missions, began, wall)
}

/// Returns the rooms of the hospital.
fn places() -> Vec<String> {
    let TopologicalMap { places, .. } = shipped("hospital").expect("it is shipped").topology();
    let rooms = places.into_keys().map(|place| place.to_string());
    rooms.filter(|place| place.starts_with("IC Room") || place.starts_with("PC Room")).collect()
}

async fn start(setup: ShiftSetup, places: &[String], chance: &mut ChaCha8Rng) -> Fleet {
    let carrier = |number: usize| {
        let place = places.choose(chance).expect("the hospital has rooms");
        RobotSpec::carrier(&format!("robot-{number:02}"), place).with_charge(1.0)
    };
    let carriers: Vec<RobotSpec> = (0..setup.robots).map(carrier).collect();
    let arms = (0..setup.arms).map(|number| RobotSpec::arm(&format!("lab-arm-{number}"), "Laboratory"));
    let robots = carriers.into_iter().chain(arms).collect();
    let nurse = |room: &String| PersonSetup { endless_samples: true, ..nurse_in(room) };
    let people = places.iter().map(nurse).collect();
    let options = NodeOptions {
        world_speed: 1.0,
        adjust: Box::new(move |settings| settings.fleet.promises.promises_max = setup.promises),
        ..NodeOptions::default()
    };
    let mut fleet = Fleet::hospital_with(setup.seed, robots, &STATIONS, people, options).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn figures(fleet: &Fleet, setup: ShiftSetup, missions: &[MissionId], began: Duration, wall: Instant) -> ShiftFigures {
    let mut submitted: BTreeMap<MissionId, Duration> = BTreeMap::new();
    let mut started: BTreeMap<MissionId, Duration> = BTreeMap::new();
    let mut completed: BTreeMap<MissionId, Duration> = BTreeMap::new();
    for (at, entry) in fleet.event_log.since(0) {
        let (times, mission) = match entry.event_kind() {
            Some(EventKind::Submitted { mission, .. }) => (&mut submitted, mission),
            Some(EventKind::TaskBegan { mission, .. }) => (&mut started, mission),
            Some(EventKind::Mission { mission, state: MissionState::Completed, .. }) => (&mut completed, mission),
            _ => continue,
        };
        times.entry(mission.clone()).or_insert(at);
    }
    let since_request = |times: &BTreeMap<MissionId, Duration>| {
        let time = |mission: &MissionId| {
            let (at, from) = (times.get(mission)?, submitted.get(mission)?);
            Some(at.saturating_sub(*from).as_secs_f64())
        };
        Percentiles::of(missions.iter().filter_map(time).collect())
    };
    let all_s = completed.values().max().map_or(0.0, |last| last.saturating_sub(began).as_secs_f64());
    ShiftFigures {
        robots: setup.robots,
        arms: setup.arms,
        promises: setup.promises,
        missions: missions.len(),
        completed: completed.len(),
        all_s,
        per_hour: if all_s > 0.0 { completed.len() as f64 * 3600.0 / all_s } else { 0.0 },
        mission_s: since_request(&completed),
        start_s: since_request(&started),
        messages: fleet.network.counters().delivered,
        wall_s: wall.elapsed().as_secs_f64(),
    }
}
