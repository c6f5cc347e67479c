//! A trial: a whole fleet on virtual time, from the request until the first event decides.

use super::setup::ExperimentSetup;
use super::trial_id::Trial;
use super::trial_observer::{ObserverSettings, TrialObserver, TrialState};
use crate::inspection::current_coordinator;
use crate::paused_runtime;
use consort_bus::clock::Clock;
use consort_bus::{Bus as _, LinkModel, VirtualBus, VirtualNetwork};
use consort_evaluation::calibration::Observation;
use consort_evaluation::design::{Scenario, ScenarioRobot};
use consort_evaluation::outcome::{BatteryFacts, TrialFacts, classify};
use consort_evaluation::policy::{GreedyAllocator, OracleAllocator, Policy, RandomAllocator};
use consort_evaluation::results::{Treatment, TrialRow};
use consort_evaluation::seeds::{derive, generator};
use consort_evaluation::success_estimate::{estimate_success, start_context};
use consort_fleet::autopilot;
use consort_fleet::coordinator::RequestLimits;
use consort_fleet::node::{DriverServerPart, FleetSettings, NodeHandle, NodeSettings, RobotPart};
use consort_protocol::api::SubmitRequest;
use consort_protocol::auction::{Allocator, BidLimits, OptimalAssignment, PromiseTerms};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::knowledge::{Attributes, Availability, RobotKnowledge};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::HistoryLimits;
use consort_protocol::ledger::MissionState;
use consort_protocol::plan::{Division, divide_and_check};
use consort_protocol::pose::Pose;
use consort_protocol::timing::Timing;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
use consort_protocol::versions::VersionRange;
use consort_raft::store::NodeStore;
use consort_skills::actions::RobotBackend;
use consort_world::SharedWorld;
use consort_world::world::{PersonSetup, RobotSetup, SampleHolder, World, WorldEvent, WorldSetup};
use rand::RngExt;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant as WallInstant};
use tokio::time::{Instant, sleep, timeout};

/// The stations that store the ledger.
const STATIONS: [&str; 3] = ["station-1", "station-2", "station-3"];

/// The node that hosts the world.
const HOST: &str = "world";

/// Time limit until the fleet is ready; it takes about 2 s.
const READY_WITHIN: Duration = Duration::from_secs(120);

/// Time after the start of the host until every robot has received the state of its simulated
/// robot: robots query it every 300 ms.
const ROBOTS_READY_AFTER: Duration = Duration::from_millis(600);

/// Longest time between two checks; every observed event causes a check earlier.
const CHECK_INTERVAL: Duration = Duration::from_millis(500);

/// Draws of the oracle: the standard error of a probability is then below 2.5 %.
const DRAWS: u32 = 400;

/// Useful charge of every robot, as in the published scenarios.
const USEFUL_CHARGE: f64 = 0.08;

/// Outcome of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOutcome {
    /// Its row.
    pub row: TrialRow,
    /// Actual and estimated time and energy of its tasks.
    pub observations: Vec<Observation>,
}

/// Runs a trial on a paused runtime of its own, which is dropped afterwards.
pub(super) fn run_trial(setup: &ExperimentSetup, trial: &Trial) -> TrialOutcome {
    let runtime = paused_runtime();
    // Created within the runtime: outside, the clock is that of the machine, and no two runs would
    // be equal.
    let trial_run = async { TrialRun::new(setup, trial).run().await };
    let result = catch_unwind(AssertUnwindSafe(|| runtime.block_on(trial_run)));
    result.unwrap_or_else(|_| panic!("trial {} panicked", name(setup, trial)))
}

fn name(setup: &ExperimentSetup, trial: &Trial) -> String {
    let (mission, code) = (&setup.design.mission.name, &setup.scenarios[trial.scenario].code);
    format!("{mission}/{code}/{}/{}/{}", trial.policy, trial.treatment.as_str(), trial.repetition)
}

struct TrialRun<'s> {
    setup: &'s ExperimentSetup,
    trial: &'s Trial,
    scenario: &'s Scenario,
    parameters: BTreeMap<String, String>,
    /// The same for all policies and treatments.
    seed: u64,
    settings: FleetSettings,
    network: VirtualNetwork,
    world: SharedWorld,
    observer: TrialObserver,
    nodes: BTreeMap<NodeId, NodeHandle>,
    incarnations: u64,
    wall_clock: WallInstant,
}

impl<'s> TrialRun<'s> {
    fn new(setup: &'s ExperimentSetup, trial: &'s Trial) -> TrialRun<'s> {
        let scenario = &setup.scenarios[trial.scenario];
        let design = &setup.design;
        let repetition = trial.repetition.to_string();
        let seed = derive(design.seed, &["trial", &design.mission.name, &scenario.code, &repetition]);
        let parameters = scenario.parameters(&design.mission).expect("the setup is validated");
        let mission = setup.document.instantiate(&parameters, &setup.domain).expect("the setup is validated");
        let division = divide_and_check(&mission).expect("shipped missions can be divided");
        let managed: BTreeSet<RoleId> = mission.managed_roles().cloned().collect();
        let world = world(setup, scenario, derive(seed, &["world"]));
        let robots: BTreeMap<RobotId, ScenarioRobot> =
            scenario.robots.iter().map(|robot| (robot.name.clone(), robot.clone())).collect();
        let mobile_skills = robots.values().map(|robot| (robot.name.clone(), robot.skills.clone()));
        let skills =
            mobile_skills.chain(design.fixed.iter().map(|fixed| (fixed.name.clone(), fixed.skills.clone()))).collect();
        let tasks =
            division.plans.iter().filter(|(role, _)| managed.contains(*role)).flat_map(|(_, plan)| plan.tasks());
        let observer_settings = ObserverSettings {
            world: world.clone(),
            speed: design.world_speed,
            seed: derive(seed, &["drives"]),
            travel: setup.travel.clone(),
            estimator: Arc::clone(&setup.estimator),
            robots,
            skills,
            tasks: tasks.map(|(id, spec)| (id.clone(), spec.clone())).collect(),
        };
        let times = Timing::Lan.parameters();
        let settings = FleetSettings {
            fleet: crate::slug("trial"),
            ensembles: Arc::clone(&setup.ensembles),
            domain: Arc::clone(&setup.domain),
            missions: Arc::default(),
            alarms: Arc::default(),
            devices: Arc::default(),
            limits: BidLimits::default(),
            charging: None,
            promises: PromiseTerms::default(),
            request_limits: RequestLimits::default(),
            history_limits: HistoryLimits::default(),
            allocator: allocator_of_policy(setup, trial, &division, &managed, seed),
            candidates: None,
            lease_terms: LeaseTerms::default(),
            bid_window: times.auction_window,
            stall_timeout: Duration::ZERO,
            bootstrap_expect: STATIONS.len(),
            timing: Timing::Lan,
            voters: STATIONS.len(),
            autopilot_rule: autopilot::decide,
            dead_after: times.dead_after,
            snapshot_every: consort_raft::SNAPSHOT_EVERY,
            log_entries_kept: consort_raft::LOG_ENTRIES_KEPT,
            scoped_knowledge: false,
            map: None,
        };
        let network = VirtualNetwork::new(derive(seed, &["network"]), LinkModel::LAN);
        let observer = TrialObserver::new(observer_settings);
        let (nodes, incarnations, wall_clock) = (BTreeMap::new(), 0, WallInstant::now());
        TrialRun {
            setup,
            trial,
            scenario,
            parameters,
            seed,
            settings,
            network,
            world,
            observer,
            nodes,
            incarnations,
            wall_clock,
        }
    }

    async fn run(mut self) -> TrialOutcome {
        self.start_fleet().await;
        let client = self.network.bus(crate::slug("client"));
        self.start_host().await;
        sleep(ROBOTS_READY_AFTER).await;
        let requested_at_s = self.observer.now_s();
        self.submit(&client).await;
        let (delivered_at_s, killed_at_s) = self.run_until_decided(requested_at_s).await;
        self.into_outcome(requested_at_s, delivered_at_s, killed_at_s)
    }

    /// Starts stations and robots, and waits until a station coordinates and has a record of all
    /// robots.
    async fn start_fleet(&mut self) {
        for station in STATIONS {
            let settings = self.node(station, true, None);
            self.start(settings).await;
        }
        let mut robots = vec![];
        for fixed in &self.setup.design.fixed {
            let place = self.scenario.place(&fixed.place).expect("the setup is validated");
            let worker = self.worker(&place, &fixed.skills, None, 1.0, 0.0);
            robots.push((fixed.name.clone(), worker));
        }
        for robot in &self.scenario.robots {
            let speed = Some(robot.speed_mps);
            let worker = self.worker(&robot.place, &robot.skills, speed, robot.charge, robot.discharge);
            robots.push((robot.name.clone(), worker));
        }
        let names: Vec<NodeId> = robots.iter().map(|(name, _)| NodeId::from(name.clone())).collect();
        for (name, worker) in robots {
            let (estimator, library) = (Arc::clone(&self.setup.estimator), Arc::clone(&self.setup.library));
            let settings =
                self.node(name.as_str(), false, Some(RobotPart { worker, estimator, library, capacity: None }));
            self.start(settings).await;
        }
        let end = Instant::now() + READY_WITHIN;
        loop {
            let has_all_robots = |node: &NodeHandle| {
                names
                    .iter()
                    .all(|name| node.knowledge.is_alive(name) && node.knowledge.read(|base| base.get(name).is_some()))
            };
            if self.coordinator().is_some_and(|coordinator| has_all_robots(&self.nodes[&coordinator])) {
                return;
            }
            assert!(
                Instant::now() < end,
                "the fleet of {} was not ready within {READY_WITHIN:?}",
                name(self.setup, self.trial)
            );
            sleep(Duration::from_millis(20)).await;
        }
    }

    fn worker(
        &self,
        place: &PlaceId,
        skills: &BTreeSet<TaskType>,
        speed: Option<f64>,
        charge: f64,
        discharge: f64,
    ) -> RobotKnowledge {
        let checked = "scenarios are validated";
        RobotKnowledge {
            skills: skills.clone(),
            attributes: Attributes::default(),
            pose: self.setup.map.place(place).map_or(Pose::default(), |place| place.pose),
            place: place.clone(),
            battery: BatteryShare::new(charge).expect(checked),
            discharge: SharePerSecond::new(discharge).expect(checked),
            useful_charge: BatteryShare::new(USEFUL_CHARGE).expect(checked),
            speed: speed.map(|speed| MetresPerSecond::new(speed).expect(checked)),
            availability: Availability::Free,
            estimator: "1".to_owned(),
            charging: None,
        }
    }

    fn node(&mut self, name: &str, may_vote: bool, robot: Option<RobotPart>) -> NodeSettings {
        self.incarnations += 1;
        let seed = derive(self.seed, &["node", name]);
        let stationary = robot.as_ref().is_none_or(|robot| robot.worker.speed.is_none());
        NodeSettings {
            fleet: self.settings.clone(),
            node: crate::slug(name),
            incarnation: self.incarnations,
            seed,
            store: NodeStore::in_memory(seed),
            clock: Clock::virtual_at(0),
            supported_versions: VersionRange::OWN,
            may_vote,
            stationary,
            mains_powered: stationary,
            robot,
            driver_server: None,
            devices: vec![],
            observer: Some(Arc::new(self.observer.clone())),
            record_signer: None,
        }
    }

    async fn start(&mut self, settings: NodeSettings) {
        let name = settings.node.clone();
        let bus = Arc::new(self.network.bus(name.clone()));
        let node = NodeHandle::start(settings, bus).await.expect("a virtual node starts");
        self.nodes.insert(name, node);
    }

    async fn start_host(&mut self) {
        let host = DriverServerPart { world: Box::new(self.world.clone()), speed: self.setup.design.world_speed };
        let settings = NodeSettings { driver_server: Some(host), ..self.node(HOST, false, None) };
        self.observer.start_clock();
        self.start(settings).await;
    }

    fn coordinator(&self) -> Option<NodeId> {
        current_coordinator(self.nodes.values())
    }

    async fn submit(&self, client: &VirtualBus) {
        let key = Keys::new(&self.settings.fleet).write(&Key::Api(ApiCall::Submit));
        let request = self.setup.workload.request(&self.setup.design.mission.name, self.parameters.clone());
        let request = json!(SubmitRequest { request: Some(crate::slug("trial")), ..request });
        for _ in 0..100 {
            let payload = request.to_string().into();
            let mut replies =
                client.query(&key, payload, Duration::from_secs(3)).await.expect("a virtual bus accepts queries");
            while let Some(reply) = replies.recv().await {
                let answer = reply.payload.ok().and_then(|payload| serde_json::from_slice::<Value>(&payload).ok());
                let Some(answer) = answer else { continue };
                assert!(answer.get("error").is_none() || answer.get("retry_after_ms").is_some(), "{request}: {answer}");
                if answer["mission"].is_string() {
                    return;
                }
            }
            sleep(Duration::from_millis(100)).await;
        }
        panic!("the request of {} was not acknowledged", name(self.setup, self.trial));
    }

    /// Advances time until the first event decides. Returns the time of the delivery and the time
    /// of the kill.
    async fn run_until_decided(&mut self, requested_at_s: f64) -> (Option<f64>, Option<f64>) {
        let design = &self.setup.design;
        let (speed, limits) = (design.world_speed, design.limits);
        let kill_at_s = (self.trial.treatment == Treatment::CoordinatorKilled)
            .then(|| requested_at_s + generator(self.seed, &["kill"]).random_range(0.0..=design.kill_within_s));
        let target = design.mission.delivered.as_ref().map(|delivered| self.final_owner(&delivered.to));
        let item = design.mission.delivered.as_ref().map(|delivered| delivered.item.as_str());
        let end_s = requested_at_s + limits.sim_s;
        let (mut delivered_at_s, mut killed_at_s) = (None, None);
        let mut changed = self.observer.changed();
        loop {
            changed.mark_unchanged();
            for entry in self.world.with(World::drain_event_log) {
                match &entry.event {
                    WorldEvent::SampleMoved { sample, to, .. }
                        if item == Some(sample.as_str()) && target.as_ref() == Some(to) =>
                    {
                        delivered_at_s.get_or_insert(entry.time.as_secs());
                    }
                    WorldEvent::Stranded { robot } => {
                        let mut observed = self.observer.state();
                        if observed.held_role_at(robot, entry.time.as_secs()) {
                            observed.depleted.entry(robot.clone()).or_insert(entry.time.as_secs());
                        }
                    }
                    _ => {}
                }
            }
            let now_s = self.observer.now_s();
            let decided = {
                let observed = self.observer.state();
                if target.is_none() && observed.end_state == Some(MissionState::Completed) {
                    delivered_at_s.get_or_insert(now_s);
                }
                observed.unskilled.is_some() || !observed.depleted.is_empty() || observed.end_state.is_some()
            };
            if decided
                || delivered_at_s.is_some()
                || now_s >= end_s
                || self.wall_clock.elapsed().as_secs_f64() >= limits.wall_s
            {
                return (delivered_at_s, killed_at_s);
            }
            if kill_at_s.is_some_and(|kill_at_s| now_s >= kill_at_s)
                && killed_at_s.is_none()
                && let Some(coordinator) = self.coordinator()
            {
                killed_at_s = Some(now_s);
                self.network.crash(&coordinator);
                if let Some(node) = self.nodes.remove(&coordinator) {
                    node.kill().await;
                }
            }
            let next_s = kill_at_s
                .filter(|kill_at_s| killed_at_s.is_none() && *kill_at_s > now_s)
                .map_or(end_s, |kill_at_s| kill_at_s.min(end_s));
            let until_next = Duration::from_secs_f64((next_s - now_s).max(0.0) / speed) + Duration::from_micros(1);
            // Either way the state is checked again.
            let _ = timeout(until_next.min(CHECK_INTERVAL), changed.changed()).await;
        }
    }

    /// Returns the owner of the item after the delivery.
    fn final_owner(&self, to: &str) -> SampleHolder {
        let fixed = self.setup.design.fixed.iter().find(|fixed| fixed.name.as_str() == to);
        match fixed {
            Some(fixed) => SampleHolder::Arm(fixed.name.clone()),
            None => SampleHolder::Table(self.scenario.place(to).expect("the setup is validated")),
        }
    }

    fn into_outcome(self, requested_at_s: f64, delivered_at_s: Option<f64>, killed_at_s: Option<f64>) -> TrialOutcome {
        let ended_at_s = self.observer.now_s();
        // The charges are read at the last moment.
        let last = WorldTime::from_secs(delivered_at_s.unwrap_or(ended_at_s).max(self.world.now().as_secs()));
        self.world.with(|world| drop(world.advance(last)));
        let observed = std::mem::take(&mut *self.observer.state());
        let share = |robot: &RobotId| self.world.telemetry(robot).map_or(0.0, |report| report.battery.get());
        let batteries: Vec<BatteryFacts> = observed
            .ever_assigned
            .iter()
            .map(|robot| BatteryFacts {
                robot: robot.clone(),
                lowest_share: share(robot),
                below_at_s: observed.depleted.get(robot).copied(),
            })
            .collect();
        let lowest_share = batteries.iter().map(|facts| facts.lowest_share).min_by(f64::total_cmp);
        let facts = TrialFacts {
            requested_at_s,
            delivered_at_s,
            unskilled: observed.unskilled.clone(),
            batteries,
            ended_at_s,
            wall_s: self.wall_clock.elapsed().as_secs_f64(),
        };
        let (end_state, ttc_s) = classify(&facts, &self.setup.design.limits);
        let levels = self.scenario.levels.clone();
        let row = TrialRow {
            trial: name(self.setup, self.trial),
            mission: self.setup.design.mission.name.clone(),
            scenario: self.scenario.code.clone(),
            speed: levels.speed,
            charge: levels.charge,
            discharge: levels.discharge,
            location: levels.location,
            skills: levels.skills,
            policy: self.trial.policy,
            treatment: self.trial.treatment,
            repetition: self.trial.repetition,
            end_state,
            ttc_s,
            predicted_s: observed.predicted_s,
            lowest_share,
            last_task: observed.last_task.clone(),
            robots: pairs(&observed.first_holders),
            note: note(&observed, killed_at_s.map(|at| at - requested_at_s)),
        };
        TrialOutcome { row, observations: observed.observations }
    }
}

fn pairs(chosen: &BTreeMap<RoleId, RobotId>) -> String {
    chosen.iter().map(|(role, robot)| format!("{role}={robot}")).collect::<Vec<_>>().join(" ")
}

fn note(observed: &TrialState, killed_after_s: Option<f64>) -> String {
    let mut notes = vec![];
    notes.extend(killed_after_s.map(|after| format!("coordinator killed after {after:.1} s")));
    notes.extend(observed.unskilled.as_ref().map(|(_, robot, skill)| format!("{robot} lacks {skill}")));
    notes.extend(observed.depleted.keys().map(|robot| format!("the battery of {robot} is empty")));
    notes.extend(observed.releases.iter().map(|cause| format!("released {cause}")));
    let end = observed.end_state.as_ref().filter(|end| **end != MissionState::Completed);
    notes.extend(end.map(|end| format!("ended {}", end.as_str())));
    notes.join("; ")
}

fn world(setup: &ExperimentSetup, scenario: &Scenario, seed: u64) -> SharedWorld {
    let checked = "scenarios are validated";
    let world_setup = WorldSetup::new(setup.map.clone(), seed);
    let mut world_setup = world_setup.extended(setup.workload.extensions);
    for robot in &scenario.robots {
        let sim_robot = RobotSetup::carrier(
            robot.name.clone(),
            robot.place.clone(),
            MetresPerSecond::new(robot.speed_mps).expect(checked),
            BatteryShare::new(robot.charge).expect(checked),
            SharePerSecond::new(robot.discharge).expect(checked),
        );
        world_setup = world_setup.robot(RobotSetup { has_drawer: robot.drawer, has_arm: robot.arm, ..sim_robot });
    }
    for fixed in &setup.design.fixed {
        world_setup =
            world_setup.robot(RobotSetup::arm(fixed.name.clone(), scenario.place(&fixed.place).expect(checked)));
    }
    for person in &setup.design.people {
        let place = scenario.place(&person.place).expect(checked);
        world_setup = world_setup.person(PersonSetup {
            samples: person.items.iter().map(|item| item.as_str().into()).collect(),
            ..PersonSetup::new(person.name.as_str(), person.role.clone(), place)
        });
    }
    SharedWorld::new(
        World::new(world_setup).unwrap_or_else(|problems| panic!("scenario {}: {problems}", scenario.code)),
    )
}

/// Returns the allocator of a policy.
fn allocator_of_policy(
    setup: &ExperimentSetup,
    trial: &Trial,
    division: &Division,
    managed: &BTreeSet<RoleId>,
    seed: u64,
) -> Arc<dyn Allocator> {
    let scenario = &setup.scenarios[trial.scenario];
    let fixed = |role: &RoleId| setup.design.fixed.iter().find(|fixed| fixed.role == *role);
    let may_take = |robot: &ScenarioRobot, role: &RoleId| robot.roles.is_empty() || robot.roles.contains(role);
    let candidates = |role: &RoleId| -> BTreeSet<RobotId> {
        match fixed(role) {
            Some(fixed) => [fixed.name.clone()].into(),
            None => {
                scenario.robots.iter().filter(|robot| may_take(robot, role)).map(|robot| robot.name.clone()).collect()
            }
        }
    };
    match trial.policy {
        Policy::Consort => Arc::new(OptimalAssignment),
        Policy::MissionControl => {
            let robots = scenario.robots.iter().map(|robot| (robot.name.clone(), start_context(robot))).collect();
            Arc::new(GreedyAllocator { estimator: Arc::clone(&setup.standard), robots })
        }
        Policy::Random => {
            let candidates = managed.iter().map(|role| (role.clone(), candidates(role))).collect();
            Arc::new(RandomAllocator { candidates, seed: derive(seed, &["dice", trial.policy.as_str()]) })
        }
        Policy::Optimal => {
            let mut estimates = BTreeMap::new();
            for role in managed {
                for robot in candidates(role) {
                    let scenario_robot = scenario.robots.iter().find(|candidate| candidate.name == robot);
                    let estimate = match scenario_robot {
                        Some(scenario_robot) => {
                            let mut rng = generator(seed, &["fate", role.as_str(), robot.as_str()]);
                            let (plan, limits) = (&division.plans[role], &setup.design.limits);
                            estimate_success(
                                plan,
                                scenario_robot,
                                &setup.standard,
                                &setup.travel,
                                limits,
                                DRAWS,
                                &mut rng,
                            )
                        }
                        // A stationary robot on mains power always succeeds in its only role.
                        None => consort_evaluation::policy::SuccessEstimate { success: 1.0, time_s: 0.0 },
                    };
                    estimates.insert((role.clone(), robot), estimate);
                }
            }
            Arc::new(OracleAllocator { estimates })
        }
    }
}
