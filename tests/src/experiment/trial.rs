//! One trial: a whole fleet on virtual time, from the request until the first event decides.

use super::runner::Trial;
use super::setup::ExperimentSetup;
use super::trial_observer::{ObserverSettings, TrialObserver, TrialState};
use crate::inspection::current_coordinator;
use consort_actors::bus::{Bus as _, LinkModel, VirtualBus, VirtualNetwork};
use consort_actors::clock::Clock;
use consort_actors::coordinator::RequestLimits;
use consort_actors::node::{DriverServerPart, FleetSettings, NodeHandle, NodeSettings, RobotPart};
use consort_actors::store::NodeStore;
use consort_actors::timing::Timing;
use consort_protocol::auction::{Allocator, BidLimits, OptimalAssignment};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::MissionState;
use consort_protocol::plan::{Division, divide_and_check};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
use consort_sim::experiment::calibration::Observation;
use consort_sim::experiment::design::{Scenario, ScenarioRobot};
use consort_sim::experiment::outcome::{BatteryFacts, TrialFacts, classify};
use consort_sim::experiment::policy::{GreedyAllocator, OracleAllocator, Policy, RandomAllocator};
use consort_sim::experiment::results::{Treatment, TrialRow};
use consort_sim::experiment::seeds::{derive, generator};
use consort_sim::experiment::success_estimate::{estimate_success, start_context};
use consort_sim::world::{PersonSetup, RobotSetup, SampleHolder, SharedWorld, World, WorldEvent, WorldSetup};
use consort_skills::actions::RobotBackend;
use rand::RngExt;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant as WallInstant};
use tokio::time::{Instant, sleep, timeout};

/// The stations that keep the ledger.
const STATIONS: [&str; 3] = ["station-1", "station-2", "station-3"];

/// The node that hosts the world.
const HOST: &str = "world";

/// How long a fleet may take to be ready; it takes about two seconds.
const READY_WITHIN: Duration = Duration::from_secs(120);

/// How long after the host's start every robot has heard of its body: they ask every 300 ms.
const BODIES_KNOWN_AFTER: Duration = Duration::from_millis(600);

/// How long to wait at most before looking again; whatever is told wakes sooner.
const LOOK: Duration = Duration::from_millis(500);

/// Draws with which the oracle reckons: the standard error of a share is then below 2.5 %.
const DRAWS: u32 = 400;

/// The charge below which a robot counts itself of no further use, as in the published scenarios.
const USEFUL_CHARGE: f64 = 0.08;

/// What came of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOutcome {
    /// Its row.
    pub row: TrialRow,
    /// What was learned of estimates.
    pub observations: Vec<Observation>,
}

/// Carries a trial out, on a paused runtime of its own of which nothing is left afterwards.
pub(super) fn run_trial(stage: &ExperimentSetup, trial: &Trial) -> TrialOutcome {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime without I/O");
    // Made within the runtime: outside of it the clock is the machine's, and no run would be like another.
    let play = async { Play::new(stage, trial).through().await };
    let played = catch_unwind(AssertUnwindSafe(|| runtime.block_on(play)));
    played.unwrap_or_else(|_| panic!("trial {} panicked", name(stage, trial)))
}

fn name(stage: &ExperimentSetup, trial: &Trial) -> String {
    let (mission, code) = (&stage.design.mission.name, &stage.scenarios[trial.scenario].code);
    format!("{mission}/{code}/{}/{}/{}", trial.policy, trial.treatment.as_str(), trial.repetition)
}

struct Play<'s> {
    stage: &'s ExperimentSetup,
    trial: &'s Trial,
    scenario: &'s Scenario,
    parameters: BTreeMap<String, String>,
    /// The same for all policies and treatments.
    seed: u64,
    settings: FleetSettings,
    network: VirtualNetwork,
    world: SharedWorld,
    watcher: TrialObserver,
    nodes: BTreeMap<NodeId, NodeHandle>,
    lives: u64,
    wall: WallInstant,
}

impl<'s> Play<'s> {
    fn new(stage: &'s ExperimentSetup, trial: &'s Trial) -> Play<'s> {
        let scenario = &stage.scenarios[trial.scenario];
        let design = &stage.design;
        let repetition = trial.repetition.to_string();
        let seed = derive(design.seed, &["trial", &design.mission.name, &scenario.code, &repetition]);
        let parameters = scenario.parameters(&design.mission).expect("the stage was checked");
        let mission = stage.template.instantiate(&parameters, &stage.domain).expect("the stage was checked");
        let division = divide_and_check(&mission).expect("shipped missions can be divided");
        let managed: BTreeSet<RoleId> = mission.managed_roles().cloned().collect();
        let world = world(stage, scenario, derive(seed, &["world"]));
        let robots: BTreeMap<RobotId, ScenarioRobot> =
            scenario.robots.iter().map(|robot| (robot.name.clone(), robot.clone())).collect();
        let able = robots.values().map(|robot| (robot.name.clone(), robot.skills.clone()));
        let skills = able.chain(design.fixed.iter().map(|fixed| (fixed.name.clone(), fixed.skills.clone()))).collect();
        let tasks =
            division.plans.iter().filter(|(role, _)| managed.contains(*role)).flat_map(|(_, plan)| plan.tasks());
        let brief = ObserverSettings {
            world: world.clone(),
            speed: design.world_speed,
            seed: derive(seed, &["drives"]),
            travel: stage.travel.clone(),
            estimator: Arc::clone(&stage.estimator),
            robots,
            skills,
            tasks: tasks.map(|(id, spec)| (id.clone(), spec.clone())).collect(),
        };
        let times = Timing::Lan.parameters();
        let settings = FleetSettings {
            fleet: crate::slug("trial"),
            ensemble: Arc::clone(&stage.ensemble),
            domain: Arc::clone(&stage.domain),
            limits: BidLimits::default(),
            request_limits: RequestLimits::default(),
            allocator: choice(stage, trial, &division, &managed, seed),
            lease_terms: LeaseTerms::default(),
            bid_window: times.auction_window,
            stall_timeout: Duration::ZERO,
            bootstrap_expect: STATIONS.len(),
            timing: Timing::Lan,
            voters: STATIONS.len(),
            dead_after: times.dead_after,
            map: None,
        };
        let network = VirtualNetwork::new(derive(seed, &["network"]), LinkModel::LAN);
        let watcher = TrialObserver::new(brief);
        let (nodes, lives, wall) = (BTreeMap::new(), 0, WallInstant::now());
        Play { stage, trial, scenario, parameters, seed, settings, network, world, watcher, nodes, lives, wall }
    }

    async fn through(mut self) -> TrialOutcome {
        self.gather().await;
        let client = self.network.bus(crate::slug("client"));
        self.start_host().await;
        sleep(BODIES_KNOWN_AFTER).await;
        let requested_at_s = self.watcher.now_s();
        self.submit(&client).await;
        let (delivered_at_s, killed_at_s) = self.watch(requested_at_s).await;
        self.conclude(requested_at_s, delivered_at_s, killed_at_s)
    }

    /// Starts stations and robots, and waits until one station coordinates and knows them all.
    async fn gather(&mut self) {
        for station in STATIONS {
            let settings = self.node(station, true, None);
            self.start(settings).await;
        }
        let mut robots = vec![];
        for fixed in &self.stage.design.fixed {
            let place = self.scenario.place(&fixed.place).expect("the stage was checked");
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
            let (estimator, library) = (Arc::clone(&self.stage.estimator), Arc::clone(&self.stage.library));
            let settings = self.node(name.as_str(), false, Some(RobotPart { worker, estimator, library }));
            self.start(settings).await;
        }
        let end = Instant::now() + READY_WITHIN;
        loop {
            let known = |node: &NodeHandle| {
                names
                    .iter()
                    .all(|name| node.knowledge.is_alive(name) && node.knowledge.read(|base| base.get(name).is_some()))
            };
            if self.coordinator().is_some_and(|coordinator| known(&self.nodes[&coordinator])) {
                return;
            }
            assert!(Instant::now() < end, "the fleet of {} was not ready in time", name(self.stage, self.trial));
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
        let checked = "scenarios are checked";
        RobotKnowledge {
            skills: skills.clone(),
            pose: self.stage.map.place(place).map_or(Pose::default(), |place| place.pose),
            place: place.clone(),
            battery: BatteryShare::new(charge).expect(checked),
            discharge: SharePerSecond::new(discharge).expect(checked),
            useful_charge: BatteryShare::new(USEFUL_CHARGE).expect(checked),
            speed: speed.map(|speed| MetresPerSecond::new(speed).expect(checked)),
            availability: Availability::Free,
            estimator: "1".to_owned(),
        }
    }

    fn node(&mut self, name: &str, may_vote: bool, robot: Option<RobotPart>) -> NodeSettings {
        self.lives += 1;
        let seed = derive(self.seed, &["node", name]);
        let stationary = robot.as_ref().is_none_or(|robot| robot.worker.speed.is_none());
        NodeSettings {
            fleet: self.settings.clone(),
            node: crate::slug(name),
            incarnation: self.lives,
            seed,
            store: NodeStore::in_memory(seed),
            clock: Clock::virtual_at(0),
            may_vote,
            stationary,
            mains_powered: stationary,
            robot,
            driver_server: None,
            observer: Some(Arc::new(self.watcher.clone())),
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
        let host = DriverServerPart { world: Box::new(self.world.clone()), speed: self.stage.design.world_speed };
        let settings = NodeSettings { driver_server: Some(host), ..self.node(HOST, false, None) };
        self.watcher.start_clock();
        self.start(settings).await;
    }

    fn coordinator(&self) -> Option<NodeId> {
        current_coordinator(self.nodes.values())
    }

    async fn submit(&self, client: &VirtualBus) {
        let key = Keys::new(&self.settings.fleet).write(&Key::Api(ApiCall::Submit));
        let asked =
            json!({ "mission": self.stage.design.mission.name, "parameters": self.parameters, "request": "trial" });
        for _ in 0..100 {
            let payload = asked.to_string().into();
            let mut replies = client.query(&key, payload, Duration::from_secs(3)).await.expect("a virtual bus");
            while let Some(reply) = replies.recv().await {
                let said = reply.payload.ok().and_then(|payload| serde_json::from_slice::<Value>(&payload).ok());
                let Some(said) = said else { continue };
                assert!(said.get("error").is_none() || said.get("retry_after_ms").is_some(), "{asked}: {said}");
                if said["mission"].is_string() {
                    return;
                }
            }
            sleep(Duration::from_millis(100)).await;
        }
        panic!("the request of {} was not acknowledged", name(self.stage, self.trial));
    }

    /// Lets time pass until the first event decides. When what was asked for reached its destination, and when the
    /// coordinator was killed.
    async fn watch(&mut self, requested_at_s: f64) -> (Option<f64>, Option<f64>) {
        let design = &self.stage.design;
        let (speed, limits) = (design.world_speed, design.limits);
        let due_s = (self.trial.treatment == Treatment::CoordinatorKilled)
            .then(|| requested_at_s + generator(self.seed, &["kill"]).random_range(0.0..=design.kill_within_s));
        let target = design.mission.delivered.as_ref().map(|delivered| self.keeper(&delivered.to));
        let item = design.mission.delivered.as_ref().map(|delivered| delivered.item.as_str());
        let end_s = requested_at_s + limits.sim_s;
        let (mut delivered_at_s, mut killed_at_s) = (None, None);
        let mut changed = self.watcher.changed();
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
                        let mut seen = self.watcher.state();
                        if seen.held_role_at(robot, entry.time.as_secs()) {
                            seen.depleted.entry(robot.clone()).or_insert(entry.time.as_secs());
                        }
                    }
                    _ => {}
                }
            }
            let now_s = self.watcher.now_s();
            let over = {
                let seen = self.watcher.state();
                if target.is_none() && seen.end_state == Some(MissionState::Completed) {
                    delivered_at_s.get_or_insert(now_s);
                }
                seen.unskilled.is_some() || !seen.depleted.is_empty() || seen.end_state.is_some()
            };
            if over || delivered_at_s.is_some() || now_s >= end_s || self.wall.elapsed().as_secs_f64() >= limits.wall_s
            {
                return (delivered_at_s, killed_at_s);
            }
            if due_s.is_some_and(|due_s| now_s >= due_s)
                && killed_at_s.is_none()
                && let Some(coordinator) = self.coordinator()
            {
                killed_at_s = Some(now_s);
                self.network.crash(&coordinator);
                if let Some(node) = self.nodes.remove(&coordinator) {
                    node.kill().await;
                }
            }
            let next_s =
                due_s.filter(|due_s| killed_at_s.is_none() && *due_s > now_s).map_or(end_s, |due_s| due_s.min(end_s));
            let ahead = Duration::from_secs_f64((next_s - now_s).max(0.0) / speed) + Duration::from_micros(1);
            // Whether it ends by news or by time, it is time to look.
            let _ = timeout(ahead.min(LOOK), changed.changed()).await;
        }
    }

    /// Who or what has what was delivered.
    fn keeper(&self, to: &str) -> SampleHolder {
        let fixed = self.stage.design.fixed.iter().find(|fixed| fixed.name.as_str() == to);
        match fixed {
            Some(fixed) => SampleHolder::Arm(fixed.name.clone()),
            None => SampleHolder::Table(self.scenario.place(to).expect("the stage was checked")),
        }
    }

    fn conclude(self, requested_at_s: f64, delivered_at_s: Option<f64>, killed_at_s: Option<f64>) -> TrialOutcome {
        let ended_at_s = self.watcher.now_s();
        // The charges are those of the last moment.
        let last = WorldTime::from_secs(delivered_at_s.unwrap_or(ended_at_s).max(self.world.now().as_secs()));
        self.world.with(|world| drop(world.advance(last)));
        let seen = std::mem::take(&mut *self.watcher.state());
        let share = |robot: &RobotId| self.world.telemetry(robot).map_or(0.0, |report| report.battery.get());
        let batteries: Vec<BatteryFacts> = seen
            .ever_assigned
            .iter()
            .map(|robot| BatteryFacts {
                robot: robot.clone(),
                lowest_share: share(robot),
                below_at_s: seen.depleted.get(robot).copied(),
            })
            .collect();
        let lowest_share = batteries.iter().map(|facts| facts.lowest_share).min_by(f64::total_cmp);
        let facts = TrialFacts {
            requested_at_s,
            delivered_at_s,
            unskilled: seen.unskilled.clone(),
            batteries,
            ended_at_s,
            wall_s: self.wall.elapsed().as_secs_f64(),
        };
        let (end_state, ttc_s) = classify(&facts, &self.stage.design.limits);
        let levels = self.scenario.levels.clone();
        let row = TrialRow {
            trial: name(self.stage, self.trial),
            mission: self.stage.design.mission.name.clone(),
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
            predicted_s: seen.predicted_s,
            lowest_share,
            robots: pairs(&seen.first_holders),
            note: note(&seen, killed_at_s.map(|at| at - requested_at_s)),
        };
        TrialOutcome { row, observations: seen.observations }
    }
}

fn pairs(chosen: &BTreeMap<RoleId, RobotId>) -> String {
    chosen.iter().map(|(role, robot)| format!("{role}={robot}")).collect::<Vec<_>>().join(" ")
}

fn note(seen: &TrialState, killed_after_s: Option<f64>) -> String {
    let mut notes = vec![];
    notes.extend(killed_after_s.map(|after| format!("coordinator killed after {after:.1} s")));
    notes.extend(seen.unskilled.as_ref().map(|(_, robot, skill)| format!("{robot} lacks {skill}")));
    notes.extend(seen.depleted.keys().map(|robot| format!("the battery of {robot} is empty")));
    notes.extend(seen.releases.iter().map(|cause| format!("released {cause}")));
    let end = seen.end_state.as_ref().filter(|end| **end != MissionState::Completed);
    notes.extend(end.map(|end| format!("ended {}", end.as_str())));
    notes.join("; ")
}

fn world(stage: &ExperimentSetup, scenario: &Scenario, seed: u64) -> SharedWorld {
    let checked = "scenarios are checked";
    let mut setup = WorldSetup::new(stage.map.clone(), seed);
    for robot in &scenario.robots {
        let body = RobotSetup::carrier(
            robot.name.clone(),
            robot.place.clone(),
            MetresPerSecond::new(robot.speed_mps).expect(checked),
            BatteryShare::new(robot.charge).expect(checked),
            SharePerSecond::new(robot.discharge).expect(checked),
        );
        setup = setup.robot(RobotSetup { has_drawer: robot.drawer, has_arm: robot.arm, ..body });
    }
    for fixed in &stage.design.fixed {
        setup = setup.robot(RobotSetup::arm(fixed.name.clone(), scenario.place(&fixed.place).expect(checked)));
    }
    for person in &stage.design.people {
        setup = setup.person(PersonSetup {
            name: person.name.as_str().into(),
            role: person.role.clone(),
            place: scenario.place(&person.place).expect(checked),
            samples: person.items.iter().map(|item| item.as_str().into()).collect(),
            mood: vec![],
        });
    }
    SharedWorld::new(World::new(setup).unwrap_or_else(|problems| panic!("scenario {}: {problems}", scenario.code)))
}

/// The rule of a policy.
fn choice(
    stage: &ExperimentSetup,
    trial: &Trial,
    division: &Division,
    managed: &BTreeSet<RoleId>,
    seed: u64,
) -> Arc<dyn Allocator> {
    let scenario = &stage.scenarios[trial.scenario];
    let fixed = |role: &RoleId| stage.design.fixed.iter().find(|fixed| fixed.role == *role);
    let may = |robot: &ScenarioRobot, role: &RoleId| robot.roles.is_empty() || robot.roles.contains(role);
    let candidates = |role: &RoleId| -> BTreeSet<RobotId> {
        match fixed(role) {
            Some(fixed) => [fixed.name.clone()].into(),
            None => scenario.robots.iter().filter(|robot| may(robot, role)).map(|robot| robot.name.clone()).collect(),
        }
    };
    match trial.policy {
        Policy::Consort => Arc::new(OptimalAssignment),
        Policy::MissionControl => {
            let robots = scenario.robots.iter().map(|robot| (robot.name.clone(), start_context(robot))).collect();
            Arc::new(GreedyAllocator { estimator: Arc::clone(&stage.standard), robots })
        }
        Policy::Random => {
            let candidates = managed.iter().map(|role| (role.clone(), candidates(role))).collect();
            Arc::new(RandomAllocator { candidates, seed: derive(seed, &["dice", trial.policy.as_str()]) })
        }
        Policy::Optimal => {
            let mut prospects = BTreeMap::new();
            for role in managed {
                for robot in candidates(role) {
                    let known = scenario.robots.iter().find(|known| known.name == robot);
                    let fate = match known {
                        Some(known) => {
                            let mut rng = generator(seed, &["fate", role.as_str(), robot.as_str()]);
                            let (plan, limits) = (&division.plans[role], &stage.design.limits);
                            estimate_success(plan, known, &stage.standard, &stage.travel, limits, DRAWS, &mut rng)
                        }
                        // Whoever is meant for one role on mains power does it.
                        None => consort_sim::experiment::policy::SuccessEstimate { success: 1.0, time_s: 0.0 },
                    };
                    prospects.insert((role.clone(), robot), fate);
                }
            }
            Arc::new(OracleAllocator { estimates: prospects })
        }
    }
}
