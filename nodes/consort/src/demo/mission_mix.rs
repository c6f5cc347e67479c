//! Test of a demo that is kept running: any mix of missions for hours, with missions among them that no robot can do.

use super::fleet::DemoFleet as _;
use super::virtual_fleet::VirtualFleet;
use super::{Args, requested_scenario};
use crate::config::FleetConfig;
use crate::map_loader;
use clap::Parser as _;
use consort_dashboard::query::{QueryError, QueryTarget, query_once};
use consort_protocol::api::SubmitReply;
use consort_protocol::ids::{MissionId, PlaceId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::ledger::MissionState;
use consort_protocol::mission::{TemplateKind, TemplateParameter};
use consort_protocol::view::{CoordinatorView, MissionsView};
use consort_skills::actions::RobotBackend as _;
use consort_skills::extensions::Extensions;
use consort_skills::missions;
use consort_tests::{FAILING_TASKS, failing_domain};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// `consort demo` with a fleet that is kept running. It has 8 world seconds per second.
const DEMO: [&str; 4] = ["demo", "--keep-running", "--robots", "12"];

/// A demo with six robots, and the speed at which it plays nine missions.
const FAST_DEMO: [&str; 4] = ["demo", "--keep-running", "--speed", "24"];

/// Time in which a fast demo plays three hours of world time, in seconds.
const THREE_HOURS_S: u64 = 450;

/// Missions in these three hours.
const THREE_HOURS_MISSIONS: usize = 45;

/// Beginning of the names of the requests for missions that can be completed.
const MIX: &str = "mix-";

const MISSIONS: usize = 100;
const POISON: usize = 10;

/// Time in which the missions are submitted, in seconds.
const SUBMITTED_S: u64 = 600;

/// The same of lab samples.
const SAMPLES_SUBMITTED_S: u64 = 300;

const SAMPLES: usize = 60;

/// Maximum time until there is a coordinator.
const START_MAX: Duration = Duration::from_secs(60);

/// Maximum time after the last request until all missions have ended, in seconds: 40 minutes of world time.
const AFTERWARDS_S: u64 = 300;

/// Maximum time by which missions that no robot can do delay the end of the others. A change of any time changes all later
/// assignments, so a few of the last missions end earlier or later; each takes up to a minute.
const DELAY_MAX: Duration = Duration::from_secs(120);

/// Interval of queries for the states of the missions.
const QUERY_EVERY: Duration = Duration::from_secs(5);

fn extensions() -> Extensions {
    Extensions::default().with_domain("failing.yaml", failing_domain())
}

/// A command line of `consort demo`.
#[derive(clap::Parser)]
struct Command {
    #[command(flatten)]
    args: Args,
}

/// A request in the format of the API, and its time in milliseconds.
type Submission = (u64, Value);

/// Returns random missions of the shipped ones that pass `filter`, with random places.
fn mix(
    filter: fn(&str) -> bool,
    (count, within_s): (usize, u64),
    places: &[PlaceId],
    chance: &mut ChaCha8Rng,
) -> Vec<Submission> {
    let shipped: Vec<_> = missions::shipped().iter().filter(|(name, _)| filter(name)).collect();
    let request = |number: usize| {
        let (name, template) = shipped.choose(chance).expect("there are some");
        let parameter = |(name, parameter): (&String, &TemplateParameter)| {
            // The laboratory is where the arms are.
            let is_chosen = parameter.kind == TemplateKind::Place && name != "laboratory";
            is_chosen.then(|| (name.clone(), places.choose(chance).expect("there are some").to_string()))
        };
        let parameters: BTreeMap<String, String> = template.parameters().iter().filter_map(parameter).collect();
        let at_ms = chance.random_range(0..within_s * 1000);
        (at_ms, json!({ "mission": name, "parameters": parameters, "request": format!("{MIX}{number}") }))
    };
    (0..count).map(request).collect()
}

/// Returns missions that cannot be completed: tasks that always fail, and a person that does not exist.
fn poison(chance: &mut ChaCha8Rng) -> Vec<Submission> {
    let managed = |task: &str| {
        json!({ "mission": "try", "roles": { "r1": { "kind": "managed" } },
            "root": { "task": "it", "type": task, "roles": ["r1"] } })
    };
    let approach = json!({ "task": "approach", "type": "approach_person", "roles": ["r1"],
        "parameters": { "person_role": "doctor" } });
    let go = json!({ "task": "go", "type": "navigation", "roles": ["r1"], "parameters": { "to": "IC Room 6" } });
    let attend =
        json!({ "task": "attend", "type": "attend", "roles": ["doctor"], "parameters": { "at": "IC Room 6" } });
    let nobody = json!({ "mission": "meet",
        "roles": { "r1": { "kind": "managed" }, "doctor": { "kind": "unmanaged" } },
        "root": { "task": "all", "method": "sequential", "tasks": [go, approach, attend] } });
    let kinds: Vec<Value> = FAILING_TASKS.map(managed).into_iter().chain([nobody]).collect();
    let request = |number: usize| {
        let at_ms = chance.random_range(0..SUBMITTED_S * 1000);
        let mission = kinds[number % kinds.len()].clone();
        (at_ms, json!({ "mission": mission, "request": format!("poison-{number}") }))
    };
    (0..POISON).map(request).collect()
}

/// End of the missions of a demo.
struct Outcome {
    /// State of each mission, by the name of its request.
    states: BTreeMap<String, MissionState>,
    /// Time from the start until all missions of the mix had ended, or the time was over.
    mix_ended: Duration,
}

impl Outcome {
    /// Checks that each mission of the mix was completed, and that each other mission failed.
    fn assert_expected(&self, seed: u64, mix: usize) {
        let is_mix = |request: &str| request.starts_with(MIX);
        assert_eq!(self.states.keys().filter(|request| is_mix(request)).count(), mix, "seed {seed}");
        let is_expected = |request: &str, state: &MissionState| match state {
            MissionState::Completed => is_mix(request),
            MissionState::Failed { .. } => !is_mix(request),
            _ => false,
        };
        let unexpected = self.states.iter().filter(|(request, state)| !is_expected(request, state));
        assert_eq!(unexpected.collect::<Vec<_>>(), [], "seed {seed}");
    }
}

/// Submits the missions to a demo. Waits until all have ended, or the time is over. Checks that no robot has a battery that
/// is too low to move.
async fn run(seed: u64, command: &[&str], mut submissions: Vec<Submission>) -> Outcome {
    let seed_flag = format!("--seed={seed}");
    let Command { args } = Command::parse_from(command.iter().copied().chain([seed_flag.as_str()]));
    let extensions = extensions();
    let (scenario, _) = requested_scenario(&args, extensions).unwrap();
    let keys = Keys::new(&scenario.fleet.name);
    let fleet = VirtualFleet::start(&scenario, seed, &args.render, extensions).await.unwrap();
    let bus = fleet.bus();
    let query = async |key: &Key, payload: &str| {
        let limit = Duration::from_secs(2);
        query_once(&*bus, &keys.write(key), payload, limit, QueryTarget::All).await
    };
    let has_coordinator = async || {
        let view = query(&Key::ViewCoordinator, "").await.ok().and_then(|view| CoordinatorView::deserialize(view).ok());
        view.is_some_and(|view| view.node.is_some())
    };
    while !has_coordinator().await {
        assert!(fleet.elapsed() < START_MAX, "seed {seed}: no coordinator after {START_MAX:?}");
        tokio::time::sleep(Duration::from_millis(100)).await; // virtual time
    }
    let begin = fleet.elapsed();
    submissions.sort_by_key(|(at_ms, _)| *at_ms);
    let mut requests = BTreeMap::new();
    let last_ms = submissions.last().expect("some").0;
    for (at_ms, request) in submissions {
        tokio::time::sleep((begin + Duration::from_millis(at_ms)).saturating_sub(fleet.elapsed())).await;
        let reply = loop {
            match query(&Key::Api(ApiCall::Submit), &request.to_string()).await {
                Ok(reply) => break reply,
                // The demo has killed its coordinator.
                Err(QueryError::Retryable(_, after)) => tokio::time::sleep(after).await, // virtual time
                Err(problem) => panic!("seed {seed}: {request}: {problem:?}"),
            }
        };
        let mission: MissionId = SubmitReply::deserialize(reply).unwrap().mission;
        requests.insert(mission, request["request"].as_str().unwrap().to_owned());
    }
    let end = begin + Duration::from_millis(last_ms) + Duration::from_secs(AFTERWARDS_S);
    let mut mix_ended = None;
    let states = loop {
        let view = query(&Key::ViewMissions, "").await.unwrap_or_else(|problem| panic!("seed {seed}: {problem:?}"));
        let missions = MissionsView::deserialize(view).unwrap().missions.into_iter().map(|mission| mission.brief);
        let states: BTreeMap<String, MissionState> = missions
            .filter_map(|mission| Some((requests.get(&mission.mission)?.clone(), mission.status.detail)))
            .collect();
        let running: Vec<&String> =
            requests.values().filter(|request| !states.get(*request).is_some_and(MissionState::is_final)).collect();
        if !running.iter().any(|request| request.starts_with(MIX)) {
            mix_ended.get_or_insert(fleet.elapsed() - begin);
        }
        if running.is_empty() || fleet.elapsed() >= end {
            break states;
        }
        tokio::time::sleep(QUERY_EVERY).await; // virtual time
    };
    let world = fleet.world();
    let robots = scenario.world.robot.iter().map(|robot| &robot.id);
    let stranded: Vec<_> = robots.filter(|robot| world.telemetry(robot).is_none_or(|report| !report.able)).collect();
    assert!(stranded.is_empty(), "seed {seed}: {stranded:?} cannot move; {states:#?}");
    let mix_ended = mix_ended.unwrap_or_else(|| fleet.elapsed() - begin);
    fleet.shut_down().await;
    Outcome { states, mix_ended }
}

fn places() -> Vec<PlaceId> {
    map_loader::load(&FleetConfig::default().map).unwrap().topology.places.into_keys().collect()
}

fn run_to_end(seed: u64, command: &[&str], submissions: Vec<Submission>) -> Outcome {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(run(seed, command, submissions))
}

/// Each of these missions needs the only arm of the laboratory.
#[test]
fn sixty_lab_samples_over_five_minutes_are_completed() {
    let seed = 1;
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let samples = mix(|name| name == "lab-samples", (SAMPLES, SAMPLES_SUBMITTED_S), &places(), &mut chance);
    run_to_end(seed, &DEMO, samples).assert_expected(seed, SAMPLES);
}

/// Without chargers, most robots would have too little charge to move in the end: the missions need more than a full battery
/// of each robot, and three idle hours half of one.
#[test]
fn the_robots_and_missions_of_a_demo_go_on_for_hours() {
    let seed = 1;
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let missions = mix(|_| true, (THREE_HOURS_MISSIONS, THREE_HOURS_S), &places(), &mut chance);
    run_to_end(seed, &FAST_DEMO, missions).assert_expected(seed, THREE_HOURS_MISSIONS);
}

/// All missions are completed, with and without missions among them that no robot can do.
#[test]
fn missions_that_no_robot_can_do_cost_the_others_nothing() {
    let seed = 2;
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mix = mix(|_| true, (MISSIONS, SUBMITTED_S), &places(), &mut chance);
    let poisoned: Vec<Submission> = mix.iter().cloned().chain(poison(&mut chance)).collect();
    let [alone, among] =
        [mix, poisoned].map(|submissions| std::thread::spawn(move || run_to_end(seed, &DEMO, submissions)));
    let [alone, among] = [alone, among].map(|demo| demo.join().unwrap());
    alone.assert_expected(seed, MISSIONS);
    among.assert_expected(seed, MISSIONS);
    let (alone, among) = (alone.mix_ended, among.mix_ended);
    assert!(among <= alone + DELAY_MAX, "seed {seed}: all have ended after {alone:?} alone, {among:?} beside others");
}
