//! Measurements of fleets by size, on the virtual bus.
//!
//! ```text
//!  start, first coordinator, records everywhere, backlog ─▶ computing time ─▶ views ─▶ auctions
//!  the same start and backlog ─▶ traffic ─▶ auctions ─▶ end of the backlog ─▶ a robot joins
//!    ─▶ a tenth of the robots is lost ─▶ takeovers
//! ```
//!
//! The fleet is a hospital with three stations and a number of robots; the host of the world is a
//! node as well. Robots that move drive between neighbouring places without end, without a mission.
//!
//! The **backlog** is missions that any robot has the skill for, and that wait for a robot that is not in the fleet. So each
//! robot that becomes free wakes some of them, and none of them takes a robot from the measured missions.
//!
//! **Traffic** is the size of keys, payloads and attachments, and [`FRAME_BYTES`] per message, once
//! for each receiver.
//!
//! **Computing time** is measured in another fleet, whose coordinator and one of whose robots run on tokio
//! runtimes of their own, in the same thread: their time is that of the thread while their runtime runs. The
//! clocks of all runtimes advance together, by a millisecond at a time, which is the resolution of tokio's timers
//! anyway. The computing time of the network is not included.

mod commits;
mod figures;
mod runtimes;
mod traffic;

pub use commits::{CommitFigures, CommitSetup, measure_commits};
pub use figures::{KindFigures, ScaleFigures};
pub use traffic::FRAME_BYTES;

use crate::fleet::NodeOptions;
use crate::percentiles::Percentiles;
use crate::{Fleet, RobotSpec, paused_runtime, slug};
use consort_fleet::coordinator::RequestLimits;
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, PlaceId, RobotId};
use consort_protocol::keys::{ApiCall, KeyKind};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{Ledger, MissionEntry};
use consort_skills::actions::{FollowWaypoints, Goal, GoalId, RobotBackend as _, Waypoint};
use consort_skills::environment::TopologicalMap;
use consort_skills::extensions::Extensions;
use consort_world::map::shipped;
use procfs_core::FromRead as _;
use procfs_core::process::Status;
use runtimes::Runtimes;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::time::{sleep, sleep_until};
use traffic::Readings;

/// Duration of the measurement of traffic and computing time.
const MEASURED: Duration = Duration::from_secs(30);

/// Limit for the start of the fleet.
const START_LIMIT: Duration = Duration::from_secs(600);

/// Limit for each later step.
const STEP_LIMIT: Duration = Duration::from_secs(120);

/// Number of views.
const VIEWS: usize = 20;

/// Number of takeovers.
const TAKEOVERS: usize = 10;

/// Time between two restarts of stations, for elections and changes of voters.
const RECOVERY: Duration = Duration::from_secs(15);

/// Number of observations that are kept.
const OBSERVATIONS_KEPT: usize = 1000;

/// Number of legs in a goal of a moving robot.
const LEGS: usize = 40;

/// Number of robots from which on the fleet has the settings of a large fleet, as with `planned_nodes`.
const LARGE_FLEET: usize = 30;

/// Ordered before the arm: the first voter by name creates the cluster.
const STATIONS: [&str; 3] = ["base-1", "base-2", "base-3"];

/// The robot with a runtime of its own, which also leaves and joins.
const SAMPLE: &str = "robot-0000";

/// Size and load of a fleet to measure.
#[derive(Debug, Clone, Copy)]
pub struct ScaleSetup {
    /// Number of robots.
    pub robots: usize,
    /// Robots drive.
    pub moving: bool,
    /// Number of auctions, in sequence.
    pub missions: usize,
    /// Number of other missions that wait meanwhile.
    pub backlog: usize,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Domains of the nodes and the simulator.
    pub extensions: Extensions,
}

/// Measures a fleet. `progress` receives each step of the measurement.
pub fn measure(setup: ScaleSetup, progress: impl Fn(&str)) -> ScaleFigures {
    let wall = Instant::now();
    progress("computing time");
    let computing = measure_computing(setup);
    let figures = paused_runtime().block_on(measure_messages(setup, computing, &progress));
    ScaleFigures { memory_mb: memory_mb(), wall_s: wall.elapsed().as_secs_f64(), ..figures }
}

/// Measures messages, and times that contain no computing time.
async fn measure_messages(setup: ScaleSetup, computing: Computing, progress: &impl Fn(&str)) -> ScaleFigures {
    let began = tokio::time::Instant::now();
    progress("starts");
    let (mut fleet, coordinator) = start(setup, BTreeMap::new()).await;
    let start_s = began.elapsed().as_secs_f64();
    let nodes: Vec<NodeId> = fleet.running().iter().map(|name| slug(name)).collect();
    if setup.moving {
        drive(&fleet, setup).await;
    }
    progress("backlog");
    let backlog = request_backlog(&mut fleet, setup.backlog).await;

    progress("traffic");
    let before = Readings::of(&fleet, &nodes);
    let_run(&fleet, MEASURED).await;
    let rates = Readings::of(&fleet, &nodes).rates_since(&before, MEASURED);
    let records = nodes.iter().map(|node| known(&fleet, node)).sum::<usize>() as f64 / nodes.len() as f64;

    progress("auctions");
    let bids_before = Readings::of(&fleet, &nodes).messages_of(KeyKind::Bid);
    auctions(&mut fleet, setup.missions, || Duration::ZERO).await;
    let bid_messages = Readings::of(&fleet, &nodes).messages_of(KeyKind::Bid) - bids_before;
    for mission in &backlog {
        cancel(&fleet, mission).await;
    }

    progress("join");
    let (join_bytes, join_s) = join(&mut fleet, nodes.len()).await;
    progress("loss");
    let (loss_detected_s, loss_messages_per_s) = lose_a_tenth(&mut fleet, &coordinator).await;
    progress("takeovers");
    let takeover_ms = takeovers(&mut fleet).await;

    let robots = rates.mean(|node| fleet.is_robot(node));
    let stations = rates.mean(|node| STATIONS.contains(&node.as_str()) && *node != coordinator);
    let of_coordinator = rates.mean(|node| *node == coordinator);
    ScaleFigures {
        robots: setup.robots,
        moving: setup.moving,
        missions: setup.missions,
        backlog: setup.backlog,
        robot_received_bytes_per_s: robots.received_bytes,
        robot_received_messages_per_s: robots.received_messages,
        robot_sent_bytes_per_s: robots.sent_bytes,
        robot_sent_messages_per_s: robots.sent_messages,
        robot_cpu_percent: computing.robot_percent,
        robot_received_by_kind: robots.by_kind,
        station_received_bytes_per_s: stations.received_bytes,
        station_received_messages_per_s: stations.received_messages,
        coordinator_received_bytes_per_s: of_coordinator.received_bytes,
        coordinator_received_messages_per_s: of_coordinator.received_messages,
        coordinator_sent_bytes_per_s: of_coordinator.sent_bytes,
        coordinator_sent_messages_per_s: of_coordinator.sent_messages,
        coordinator_cpu_percent: computing.coordinator_percent,
        records_per_node: records,
        messages_per_auction: bid_messages as f64 / setup.missions.max(1) as f64,
        auction_ms: computing.latencies.auction_ms,
        commit_ms: computing.latencies.commit_ms,
        view_ms: computing.view_ms,
        takeover_ms,
        start_s,
        join_bytes,
        join_s,
        loss_detected_s,
        loss_messages_per_s,
        trace: format!("{:016x}", fleet.network.digest()),
        memory_mb: None,
        wall_s: 0.0,
        virtual_s: (computing.elapsed + began.elapsed()).as_secs_f64(),
    }
}

/// Computing times, in percent of a core, and latencies with them.
struct Computing {
    coordinator_percent: f64,
    robot_percent: f64,
    view_ms: Option<Percentiles>,
    latencies: Latencies,
    /// Duration on virtual time.
    elapsed: Duration,
}

/// Measures computing times, and latencies with them, in a fleet of its own: the offsets between its runtimes are
/// random, so messages are not repeated exactly.
fn measure_computing(setup: ScaleSetup) -> Computing {
    let runtimes = Runtimes::new();
    let (coordinator, robot) = (runtimes.separate(), runtimes.separate());
    runtimes.block_on(async {
        let began = tokio::time::Instant::now();
        let handles =
            BTreeMap::from([(STATIONS[0].to_owned(), coordinator.handle()), (SAMPLE.to_owned(), robot.handle())]);
        let (mut fleet, _) = start(setup, handles).await;
        if setup.moving {
            drive(&fleet, setup).await;
        }
        request_backlog(&mut fleet, setup.backlog).await;
        let before = [coordinator.cpu(), robot.cpu()];
        let_run(&fleet, MEASURED).await;
        let percent = |now: Duration, before: Duration| (now - before).as_secs_f64() / MEASURED.as_secs_f64() * 100.0;
        let coordinator_percent = percent(coordinator.cpu(), before[0]);
        let robot_percent = percent(robot.cpu(), before[1]);
        let view_ms = draw_views(&fleet, || coordinator.cpu()).await;
        let latencies = auctions(&mut fleet, setup.missions, || coordinator.cpu()).await;
        Computing { coordinator_percent, robot_percent, view_ms, latencies, elapsed: began.elapsed() }
    })
}

/// Returns the names of the robots and the places at which they start.
fn robots(setup: ScaleSetup, topology: &TopologicalMap) -> impl Iterator<Item = (String, &PlaceId)> {
    (0..setup.robots).map(|number| format!("robot-{number:04}")).zip(topology.places.keys().cycle())
}

/// Starts the fleet, and waits until all nodes know each other. Returns it with its coordinator.
async fn start(setup: ScaleSetup, runtimes: BTreeMap<String, Handle>) -> (Fleet, NodeId) {
    let topology = shipped("hospital").expect("it is shipped").topology();
    let members = robots(setup, &topology).map(|(name, place)| RobotSpec::carrier(&name, place.as_str()));
    let is_large = setup.robots >= LARGE_FLEET;
    let has_backlog = setup.backlog > 0;
    let adjust = Box::new(move |settings: &mut NodeSettings| {
        settings.fleet.scoped_knowledge = is_large;
        if has_backlog {
            settings.fleet.request_limits =
                RequestLimits { missions_max: 0, requests_per_s: 0, ..RequestLimits::default() };
        }
    });
    let extensions = setup.extensions;
    let options = NodeOptions { adjust, runtimes, world_speed: 1.0, extensions, ..NodeOptions::default() };
    let mut fleet = Fleet::hospital_with(setup.seed, members.collect(), &STATIONS, vec![], options).await;
    let coordinator = fleet.wait_for_coordinator().await;
    assert_eq!(coordinator.as_str(), STATIONS[0], "the first voter by name creates the cluster");
    let nodes = fleet.running().len();
    // A check counts all records, so there are few.
    while !everybody_knows(&fleet, nodes) {
        assert!(fleet.elapsed() < START_LIMIT, "not all {nodes} nodes know each other after {START_LIMIT:?}");
        sleep(Duration::from_millis(500)).await;
    }
    (fleet, coordinator)
}

/// Returns the number of nodes of which a node has a record, itself included.
fn known(fleet: &Fleet, node: &NodeId) -> usize {
    fleet.knowledge(node.as_str()).read(|knowledge| knowledge.iter().count())
}

fn everybody_knows(fleet: &Fleet, nodes: usize) -> bool {
    fleet.running().iter().all(|node| known(fleet, &slug(node)) >= nodes)
}

/// Sends each robot to a neighbouring place and back, many times, and waits until they drive.
async fn drive(fleet: &Fleet, setup: ScaleSetup) {
    let topology = fleet.world.with(|world| world.map().topology());
    let mut world = fleet.world.clone();
    for (number, (robot, at)) in robots(setup, &topology).enumerate() {
        let neighbours = topology.edges.iter().filter_map(|edge| match (edge.a == *at, edge.b == *at, edge.one_way) {
            (true, _, false) => Some(&edge.b),
            (_, true, false) => Some(&edge.a),
            _ => None,
        });
        let Some(neighbour) = neighbours.min() else { continue };
        let legs = [neighbour, at].into_iter().cycle().take(LEGS);
        let waypoints = legs.map(|place| Waypoint { pose: topology.places[place], place: Some(place.clone()) });
        let goal = Goal::from(FollowWaypoints { waypoints: waypoints.collect() });
        world.start(&slug(&robot), GoalId(number as u64 + 1), goal);
    }
    // The robots set off, and their knowledge changes from then on.
    sleep(Duration::from_secs(5)).await;
}

/// Requests missions that wait for a robot that is not in the fleet, and waits until each has been auctioned. Returns them.
async fn request_backlog(fleet: &mut Fleet, missions: usize) -> Vec<MissionId> {
    let mut backlog = vec![];
    if missions == 0 {
        return backlog;
    }
    // Until then a new coordinator may lack records, and calls all robots for each mission.
    let LeaseTerms { lease, grace } = LeaseTerms::default();
    let_run(fleet, lease + grace).await;
    for number in 0..missions {
        let mut request = visit(number, &slug("Dock"));
        request["request"] = json!(format!("waits-{number}"));
        request["mission"]["roles"]["visitor"]["eligible"] = json!(r#"robot.name == "absent""#);
        backlog.push(submit(fleet, &request).await);
        fleet.event_log.forget_before_latest(OBSERVATIONS_KEPT);
    }
    let waits = |entry: &MissionEntry| entry.auction.as_ref().is_some_and(|auction| auction.failure.is_some());
    let count = |ledger: &Ledger| ledger.active_missions().into_iter().filter(|entry| waits(entry)).count();
    fleet.wait_until("that the backlog waits", STEP_LIMIT, |fleet| fleet.ledger(count) == Some(missions)).await;
    backlog
}

/// Lets the fleet run. Auctions of a backlog cause many events with long lists, so old ones are forgotten.
async fn let_run(fleet: &Fleet, duration: Duration) {
    let end = tokio::time::Instant::now() + duration;
    while tokio::time::Instant::now() < end {
        sleep_until(end.min(tokio::time::Instant::now() + Duration::from_secs(1))).await;
        fleet.event_log.forget_before_latest(OBSERVATIONS_KEPT);
    }
}

/// Queries the view of the fleet several times. `cpu` returns the computing time of the coordinator, which draws it.
async fn draw_views(fleet: &Fleet, cpu: impl Fn() -> Duration) -> Option<Percentiles> {
    let mut times = vec![];
    for _ in 0..VIEWS {
        let before = cpu();
        fleet.view_of(STATIONS[0], "fleet").await;
        times.push((cpu() - before).as_secs_f64() * 1000.0);
    }
    Percentiles::of(times)
}

/// Latencies of auctions and of commits.
struct Latencies {
    auction_ms: Option<Percentiles>,
    commit_ms: Option<Percentiles>,
}

/// Requests missions for a single robot in sequence, and cancels each when it has been awarded. `cpu` returns
/// the computing time of the coordinator.
async fn auctions(fleet: &mut Fleet, missions: usize, cpu: impl Fn() -> Duration) -> Latencies {
    let places: Vec<PlaceId> = fleet.world.with(|world| world.map().topology().places.into_keys().collect());
    let (mut auction_ms, mut commit_ms) = (vec![], vec![]);
    for (number, place) in (0..missions).zip(places.iter().cycle()) {
        let seen = fleet.event_log.len();
        let (asked_at, cpu_before) = (fleet.elapsed(), cpu());
        let mission = submit(fleet, &visit(number, place)).await;
        let committed = fleet.elapsed() - asked_at + (cpu() - cpu_before);
        commit_ms.push(committed.as_secs_f64() * 1000.0);
        let award = |fleet: &Fleet| {
            fleet.event_log.find_since(seen, |event| match event {
                EventKind::Awarded { mission: awarded, after_ms, .. } if *awarded == mission => Some(*after_ms),
                _ => None,
            })
        };
        fleet.wait_until("the award", STEP_LIMIT, |fleet| award(fleet).is_some()).await;
        let computing = (cpu() - cpu_before).as_secs_f64() * 1000.0;
        auction_ms.extend(award(fleet).flatten().map(|after_ms| after_ms + computing));
        cancel(fleet, &mission).await;
        fleet.wait_for_end(&mission).await;
    }
    Latencies { auction_ms: Percentiles::of(auction_ms), commit_ms: Percentiles::of(commit_ms) }
}

/// Requests a mission.
async fn submit(fleet: &Fleet, request: &Value) -> MissionId {
    let reply = fleet.request_answered(ApiCall::Submit, request).await;
    slug(reply["mission"].as_str().unwrap_or_else(|| panic!("refused: {reply}")))
}

/// Cancels a mission, and forgets old events: there are many missions.
async fn cancel(fleet: &Fleet, mission: &MissionId) {
    fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission })).await;
    fleet.event_log.forget_before_latest(OBSERVATIONS_KEPT);
}

/// Returns the request for a mission of a single robot.
fn visit(number: usize, place: &PlaceId) -> Value {
    json!({
        "request": format!("visit-{number}"),
        "parameters": { "place": place },
        "mission": {
            "mission": "visit",
            "parameters": { "place": { "kind": "place" } },
            "roles": { "visitor": { "kind": "managed" } },
            "root": { "task": "go", "type": "navigation", "roles": ["visitor"], "parameters": { "to": "${place}" } },
        },
    })
}

/// Kills a robot and starts it with an empty store. Returns the bytes that it receives until it
/// knows all nodes, and the time that this takes in seconds.
async fn join(fleet: &mut Fleet, nodes: usize) -> (u64, f64) {
    let sample: NodeId = slug(SAMPLE);
    fleet.kill(SAMPLE).await;
    // The others find out meanwhile.
    sleep(RECOVERY).await;
    let (before, began) = (fleet.network.traffic(&sample).total(), tokio::time::Instant::now());
    fleet.start_robot(SAMPLE).await;
    fleet.wait_until("that a newcomer knows all", STEP_LIMIT, |fleet| known(fleet, &sample) >= nodes).await;
    let after = fleet.network.traffic(&sample).total();
    let frames = (after.messages_received - before.messages_received) * FRAME_BYTES;
    (after.received - before.received + frames, began.elapsed().as_secs_f64())
}

/// Kills a tenth of the robots at once. Returns the seconds until the coordinator counts none of
/// them as alive, and the messages that the mean node receives per second until then.
async fn lose_a_tenth(fleet: &mut Fleet, coordinator: &NodeId) -> (f64, f64) {
    let robots: Vec<RobotId> = fleet.world.with(|world| world.robots());
    let mobile = robots.iter().map(RobotId::as_str).filter(|name| name.starts_with("robot-") && *name != SAMPLE);
    let count = (robots.len() / 10).max(1);
    let lost: Vec<NodeId> = mobile.take(count).map(slug).collect();
    for node in &lost {
        fleet.kill(node.as_str()).await;
    }
    let rest: Vec<NodeId> = fleet.running().iter().map(|name| slug(name)).collect();
    let (before, began) = (Readings::of(fleet, &rest), tokio::time::Instant::now());
    fleet
        .wait_until("that lost robots are noticed", STEP_LIMIT, |fleet| {
            let knowledge = fleet.knowledge(coordinator.as_str());
            lost.iter().all(|node| !knowledge.is_alive(node))
        })
        .await;
    let took = began.elapsed();
    let rates = Readings::of(fleet, &rest).rates_since(&before, took);
    (took.as_secs_f64(), rates.mean(|_| true).received_messages)
}

/// Kills the coordinator several times, and starts it again each time. Measures from the kill to the
/// election of the next.
async fn takeovers(fleet: &mut Fleet) -> Option<Percentiles> {
    let mut took = vec![];
    for _ in 0..TAKEOVERS {
        let (killed_at, seen) = (fleet.elapsed(), fleet.event_log.len());
        let killed = fleet.kill_coordinator().await;
        let elected = |fleet: &Fleet| {
            let events = fleet.event_log.since(seen);
            events.iter().find_map(|(at, entry)| match entry.event_kind()? {
                EventKind::Elected { .. } if *entry.node() != killed => Some(*at),
                _ => None,
            })
        };
        fleet.wait_until("the next coordinator", STEP_LIMIT, |fleet| elected(fleet).is_some()).await;
        took.extend(elected(fleet).map(|at| (at - killed_at).as_secs_f64() * 1000.0));
        sleep(RECOVERY).await;
        fleet.restart(killed.as_str()).await;
        sleep(RECOVERY).await;
    }
    Percentiles::of(took)
}

/// Returns the most memory that the process had so far, in MB; `None` if the system does not tell.
fn memory_mb() -> Option<f64> {
    Some(status()?.vmhwm? as f64 * 1.024 / 1000.0)
}

/// Returns the memory that the process has now, in kB; `None` if the system does not tell.
fn resident_kb() -> Option<f64> {
    Some(status()?.vmrss? as f64 * 1.024)
}

fn status() -> Option<Status> {
    Status::from_read(std::fs::File::open("/proc/self/status").ok()?).ok()
}
