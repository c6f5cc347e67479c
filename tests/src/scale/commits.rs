//! Measurements of commits by the number of missions in the ledger.
//!
//! Some missions have ended. Others wait for the time at which they may start, so there are no auctions. Then missions are
//! requested and canceled, one after the other. The coordinator runs on a runtime of its own, which measures its computing
//! time. A fleet with more missions than a ledger accepts writes an early wire version, with which there is no limit.

use super::runtimes::Runtimes;
use super::{OBSERVATIONS_KEPT, STATIONS, cancel, memory_mb, resident_kb, submit, visit};
use crate::fleet::NodeOptions;
use crate::percentiles::Percentiles;
use crate::{Fleet, RobotSpec, slug};
use consort_fleet::coordinator::RequestLimits;
use consort_fleet::node::NodeSettings;
use consort_protocol::ids::{MissionId, PlaceId};
use consort_protocol::ledger::{Ledger, MissionEntry};
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tokio::time::sleep;

/// Number of missions that are requested and canceled.
const MEASURED: usize = 200;

/// Most missions that may wait in a ledger with limits while others are measured.
const LIMITED_MAX: usize = 1000;

/// Duration of the measurement without commits.
const IDLE: Duration = Duration::from_secs(10);

/// Number of entries after which a voter takes a snapshot: several times during the measurement.
const SNAPSHOT_EVERY: u64 = 100;

/// Load of the ledger.
#[derive(Debug, Clone, Copy)]
pub struct CommitSetup {
    /// Number of missions that wait meanwhile.
    pub missions: usize,
    /// Number of missions that have ended before.
    pub history: usize,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Figures of commits. Times are in milliseconds, percentages of a core are of virtual time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CommitFigures {
    /// Number of missions that wait.
    pub missions: usize,
    /// Number of missions that had ended before.
    pub history: usize,
    /// Number of measured commits.
    pub commits: usize,
    /// From a request of a client to the acknowledgement, with the coordinator's computing time, also across snapshots.
    pub commit_ms: Option<Percentiles>,
    /// Computing time of the coordinator for a commit and what follows, without snapshots: the median.
    pub coordinator_ms: Option<f64>,
    /// Computing time of the coordinator without commits, in percent of a core.
    pub idle_percent: f64,
    /// Time to copy the ledger for a snapshot, while it is locked.
    pub copy_ms: f64,
    /// Encoded size of a waiting mission, in bytes: the mean.
    pub mission_bytes: f64,
    /// Memory of the process for a waiting mission, in kB for each voter: the ledger, the log and the rest of the node. Too low
    /// if the process has measured another fleet before, whose memory is used again.
    pub mission_memory_kb: Option<f64>,
    /// Most memory of the process so far, in MB.
    pub memory_mb: Option<f64>,
    /// Duration of the measurement in seconds.
    pub wall_s: f64,
}

/// Measures commits. `progress` receives each step of the measurement.
pub fn measure_commits(setup: CommitSetup, progress: impl Fn(&str)) -> CommitFigures {
    let wall = Instant::now();
    let runtimes = Runtimes::new();
    let coordinator = runtimes.separate();
    let handles = BTreeMap::from([(STATIONS[0].to_owned(), coordinator.handle())]);
    let figures = runtimes.block_on(async {
        progress("starts");
        let adjust = move |settings: &mut NodeSettings| {
            settings.fleet.request_limits =
                RequestLimits { missions_max: 0, requests_per_s: 0, ..RequestLimits::default() };
            settings.fleet.snapshot_every = SNAPSHOT_EVERY;
            if setup.missions > LIMITED_MAX {
                settings.supported_versions = settings.supported_versions.up_to(2);
            }
        };
        let options =
            NodeOptions { adjust: Box::new(adjust), runtimes: handles, world_speed: 1.0, ..NodeOptions::default() };
        let robots = vec![RobotSpec::carrier("robot-0000", "Dock")];
        let mut fleet = Fleet::hospital_with(setup.seed, robots, &STATIONS, vec![], options).await;
        let leader = fleet.wait_for_coordinator().await;
        assert_eq!(leader.as_str(), STATIONS[0], "the first voter by name creates the cluster");

        progress("history");
        for number in 0..setup.history {
            let mission = request(&fleet, number).await;
            cancel(&fleet, &mission).await;
        }
        progress("missions");
        let memory_before = resident_kb();
        let first_measured = setup.history + setup.missions;
        for number in setup.history..first_measured {
            request(&fleet, number).await;
        }
        let voted = (setup.missions * STATIONS.len()) as f64;
        let mission_memory_kb = resident_kb().zip(memory_before).filter(|_| setup.missions > 0);
        let mission_memory_kb = mission_memory_kb.map(|(now, before)| (now - before) / voted);
        progress("idle");
        let before = coordinator.cpu();
        sleep(IDLE).await;
        let idle = coordinator.cpu() - before;

        progress("commits");
        let (mut commit_ms, mut coordinator_ms) = (vec![], vec![]);
        let mut add = |fleet: &Fleet, (at, cpu): (Duration, Duration)| {
            let computing = coordinator.cpu() - cpu;
            coordinator_ms.push(computing.as_secs_f64() * 1000.0);
            commit_ms.push((fleet.elapsed() - at + computing).as_secs_f64() * 1000.0);
        };
        for number in first_measured..first_measured + MEASURED {
            let began = (fleet.elapsed(), coordinator.cpu());
            let mission = request(&fleet, number).await;
            add(&fleet, began);
            let began = (fleet.elapsed(), coordinator.cpu());
            cancel(&fleet, &mission).await;
            add(&fleet, began);
        }
        let (copy_ms, mission_bytes) = fleet.ledger(sizes).expect("there is a coordinator");
        CommitFigures {
            missions: setup.missions,
            history: setup.history,
            commits: commit_ms.len(),
            commit_ms: Percentiles::of(commit_ms),
            coordinator_ms: Percentiles::of(coordinator_ms).map(|percentiles| percentiles.p50),
            idle_percent: idle.as_secs_f64() / IDLE.as_secs_f64() * 100.0,
            copy_ms,
            mission_bytes,
            mission_memory_kb,
            memory_mb: None,
            wall_s: 0.0,
        }
    });
    CommitFigures { memory_mb: memory_mb(), wall_s: wall.elapsed().as_secs_f64(), ..figures }
}

/// Requests a mission that may start tomorrow.
async fn request(fleet: &Fleet, number: usize) -> MissionId {
    let mut request = visit(number, &slug::<PlaceId>("Dock"));
    request["not_before"] = json!(86_400);
    let mission = submit(fleet, &request).await;
    fleet.event_log.forget_before_latest(OBSERVATIONS_KEPT);
    mission
}

/// Returns the time to copy the ledger in milliseconds, and the mean encoded size of an active mission in bytes.
fn sizes(ledger: &Ledger) -> (f64, f64) {
    let began = Instant::now();
    let copy = ledger.clone();
    let copy_ms = began.elapsed().as_secs_f64() * 1000.0;
    let missions = copy.active_missions();
    let bytes: usize = missions.iter().copied().map(MissionEntry::encoded_bytes).sum();
    (copy_ms, bytes as f64 / missions.len().max(1) as f64)
}
