//! A whole fleet in one process on virtual time.

use consort_actors::bus::{Bus, LinkModel, VirtualBus, VirtualNetwork};
use consort_actors::clock::Clock;
use consort_actors::node::{FleetSettings, HostPart, NodeHandle, NodeSettings, RobotPart};
use consort_protocol::auction::Limits;
use consort_protocol::ensemble::{Ensemble, EnsembleSpec};
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::{EnsembleId, FleetId, MissionId, NodeId, PlaceId, RobotId, TaskType};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::knowledge::{Availability, Worker};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::mission::Domain;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_sim::map::{self, Map};
use consort_sim::world::{Person, RobotBody, SharedWorld, World, WorldSetup};
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::environment::{Edge, Environment, Routes, TopologicalMap};
use consort_skills::library::SkillLibrary;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// A name or another slug that the test itself wrote.
pub fn slug<T: std::str::FromStr<Err: fmt::Debug>>(text: &str) -> T {
    text.parse().expect("a test's own name")
}

/// A robot of the fleet, before the fleet starts.
#[derive(Debug, Clone)]
pub struct Member {
    /// Its name.
    pub name: &'static str,
    /// Where it starts.
    pub place: &'static str,
    /// Metres per second; `None` for an arm.
    pub speed: Option<f64>,
    /// Charge at the start, as a share.
    pub battery: f64,
    /// Its skills.
    pub skills: Vec<&'static str>,
}

impl Member {
    /// A robot with a drawer, as lab samples need one.
    pub fn carrier(name: &'static str, place: &'static str) -> Member {
        let skills = vec!["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];
        Member { name, place, speed: Some(0.6), battery: 0.9, skills }
    }

    /// An arm that takes samples out of drawers.
    pub fn arm(name: &'static str, place: &'static str) -> Member {
        Member { name, place, speed: None, battery: 1.0, skills: vec!["pick_up"] }
    }

    fn body(&self) -> RobotBody {
        let (id, place) = (slug(self.name), slug(self.place));
        match self.speed {
            Some(speed) => {
                let speed = MetresPerSecond::new(speed).expect("a speed");
                RobotBody::carrier(
                    id,
                    place,
                    speed,
                    BatteryShare::new(self.battery).expect("a share"),
                    self.discharge(),
                )
            }
            None => RobotBody::arm(id, place),
        }
    }

    fn discharge(&self) -> SharePerSecond {
        SharePerSecond::new(if self.speed.is_some() { 0.0004 } else { 0.0 }).expect("a rate")
    }

    fn worker(&self, map: &Map) -> Worker {
        let place: PlaceId = slug(self.place);
        Worker {
            skills: self.skills.iter().map(|skill| slug(skill)).collect(),
            pose: map.place(&place).map_or(Pose::default(), |place| place.pose),
            place,
            battery: BatteryShare::new(self.battery).expect("a share"),
            discharge: self.discharge(),
            useful_charge: BatteryShare::new(0.08).expect("a share"),
            speed: self.speed.map(|speed| MetresPerSecond::new(speed).expect("a speed")),
            availability: Availability::Free,
            estimator: "1".to_owned(),
        }
    }
}

/// The fleet.
pub struct Fleet {
    /// What its randomness comes from; name it in every failed assertion.
    pub seed: u64,
    /// Faults are made here.
    pub network: VirtualNetwork,
    /// The world its bodies are in.
    pub world: SharedWorld,
    keys: Keys,
    settings: FleetSettings,
    members: BTreeMap<&'static str, Member>,
    nodes: BTreeMap<String, NodeHandle>,
    client: VirtualBus,
    events: Arc<Mutex<Vec<(Duration, Event)>>>,
    started: Instant,
    lives: u64,
}

impl Fleet {
    /// The hospital with a nurse in each of the rooms named, an arm in the laboratory, and these mobile robots; a station
    /// each for `stations`. World time runs ten times as fast as node time.
    pub async fn hospital(seed: u64, members: Vec<Member>, stations: &[&'static str], rooms: &[&'static str]) -> Fleet {
        let network = VirtualNetwork::new(seed, LinkModel::LAN);
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let mut setup = WorldSetup::new(map, seed);
        let mut all = members;
        all.push(Member::arm("lab-arm", "Laboratory"));
        for member in &all {
            setup = setup.robot(member.body());
        }
        for room in rooms {
            let name = format!("nurse of {room}");
            setup = setup.person(Person {
                name: name.as_str().into(),
                role: slug("nurse"),
                place: slug(room),
                samples: vec![format!("sample of {room}").as_str().into()],
            });
        }
        let world = SharedWorld::new(World::new(setup).expect("the test's own world"));
        let fleet: FleetId = slug("ward");
        let skills: BTreeSet<TaskType> = ["operate_drawer", "pick_up"].into_iter().map(slug).collect();
        let spec = EnsembleSpec::with_any_skill_of(slug::<EnsembleId>("logistics"), skills);
        let settings = FleetSettings {
            fleet: fleet.clone(),
            ensemble: Arc::new(Ensemble::compile(spec).expect("the test's own ensemble")),
            domain: Arc::new(Domain::hospital()),
            limits: Limits::default(),
            terms: LeaseTerms::default(),
            window: Duration::from_millis(200),
            bootstrap_expect: all.len() + stations.len(),
        };
        let keys = Keys::new(&fleet);
        let client = network.bus(slug("client"));
        let events = Arc::new(Mutex::new(vec![]));
        let mut heard = client.subscribe(&keys.write(&Key::Events)).await.expect("a virtual bus");
        let (log, started) = (Arc::clone(&events), Instant::now());
        tokio::spawn(async move {
            while let Some(sample) = heard.recv().await {
                let event: Event = serde_json::from_slice(&sample.payload).expect("an event");
                log.lock().expect("no panic while it is held").push((started.elapsed(), event));
            }
        });
        let mut fleet = Fleet {
            seed,
            network,
            world: world.clone(),
            keys,
            settings,
            members: all.into_iter().map(|member| (member.name, member)).collect(),
            nodes: BTreeMap::new(),
            client,
            events,
            started,
            lives: 0,
        };
        let host = HostPart { world: Box::new(world), speed: 10.0 };
        let mut settings = fleet.node("world", false, None);
        settings.host = Some(host);
        fleet.start(settings).await;
        for station in stations {
            let settings = fleet.node(station, true, None);
            fleet.start(settings).await;
        }
        for name in fleet.members.keys().copied().collect::<Vec<_>>() {
            fleet.start_robot(name).await;
        }
        fleet
    }

    /// Starts a robot's node, for the first time or again.
    pub async fn start_robot(&mut self, name: &'static str) {
        let member = self.members.get(name).expect("a robot of this fleet").clone();
        let robot = self.world.with(|world| {
            let map = world.map();
            let environment = Environment::new().with(Routes::new(&topology(map)).expect("the shipped map is sound"));
            RobotPart {
                worker: member.worker(map),
                estimator: Arc::new(
                    DescriptorRegistry::standard().resolve(environment.clone()).expect("routes are there"),
                ),
                library: Arc::new(SkillLibrary::standard(environment)),
            }
        });
        let settings = self.node(name, true, Some(robot));
        self.start(settings).await;
    }

    fn node(&mut self, name: &str, may_vote: bool, robot: Option<RobotPart>) -> NodeSettings {
        self.lives += 1;
        let stationary = robot.as_ref().is_none_or(|robot| robot.worker.speed.is_none());
        NodeSettings {
            fleet: self.settings.clone(),
            node: slug(name),
            incarnation: self.lives,
            seed: self.seed.wrapping_mul(1_000_003).wrapping_add(self.lives),
            clock: Clock::virtual_at(0),
            may_vote,
            stationary,
            mains_powered: stationary,
            robot,
            host: None,
        }
    }

    async fn start(&mut self, settings: NodeSettings) {
        let bus = Arc::new(self.network.bus(settings.node.clone()));
        let name = settings.node.to_string();
        let node = NodeHandle::start(settings, bus).await.expect("a virtual node starts");
        self.nodes.insert(name, node);
    }

    /// Ends a node as SIGKILL would.
    pub async fn kill(&mut self, name: &str) {
        self.network.crash(&slug(name));
        self.nodes.remove(name).expect("a node that runs").kill().await;
    }

    /// Lets virtual time pass until `done` says so.
    ///
    /// # Panics
    /// When it has not within `limit`; the message tells what was awaited, the seed, and what happened last.
    pub async fn until(&mut self, what: &str, limit: Duration, mut done: impl FnMut(&Fleet) -> bool) {
        let deadline = Instant::now() + limit;
        while !done(self) {
            assert!(
                Instant::now() < deadline,
                "seed {}: {what} has not happened within {limit:?}; the last that did:\n{}",
                self.seed,
                self.tale().lines().rev().take(40).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n")
            );
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Waits until somebody coordinates, and says who.
    pub async fn coordinator(&mut self) -> NodeId {
        self.until("an election", Duration::from_secs(20), |fleet| fleet.coordinating().is_some()).await;
        self.coordinating().expect("just seen")
    }

    /// Who coordinates at this moment.
    pub fn coordinating(&self) -> Option<NodeId> {
        let leads =
            |node: &&NodeHandle| node.replica.as_ref().is_some_and(|replica| replica.leadership().borrow().is_me);
        self.nodes.values().find(leads).map(|node| node.node.clone())
    }

    /// Makes a request as any client would. `None` when nobody answered.
    pub async fn ask(&self, call: ApiCall, payload: &Value) -> Option<Value> {
        let key = self.keys.write(&Key::Api(call));
        let limit = Duration::from_secs(3);
        let mut replies = self.client.query(&key, payload.to_string().into(), limit).await.expect("a virtual bus");
        let payload = replies.recv().await?.payload.expect("an answer");
        Some(serde_json::from_slice(&payload).expect("JSON"))
    }

    /// What is to be seen under a key expression below `view/`.
    pub async fn view(&self, what: &str) -> BTreeMap<String, Value> {
        let key = format!("consort/ward/view/{what}");
        let limit = Duration::from_secs(1);
        let mut replies = self.client.query(&key, vec![].into(), limit).await.expect("a virtual bus");
        let mut views = BTreeMap::new();
        while let Some(reply) = replies.recv().await {
            let payload = reply.payload.expect("a view");
            views.insert(reply.key, serde_json::from_slice(&payload).expect("JSON"));
        }
        views
    }

    /// Asks for lab samples from a room until somebody acknowledges it.
    pub async fn submit(&self, request: &str, room: &str) -> MissionId {
        let asked = json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request });
        for _ in 0..200 {
            if let Some(answer) = self.ask(ApiCall::Submit, &asked).await
                && let Some(mission) = answer["mission"].as_str()
            {
                return slug(mission);
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("seed {}: request {request} was not acknowledged\n{}", self.seed, self.tale());
    }

    /// How a mission stands, in one word, as the ledger of any node that knows it says.
    pub fn state(&self, mission: &MissionId) -> Option<String> {
        let words = self.nodes.values().filter_map(|node| {
            node.replica
                .as_ref()?
                .read(|ledger| Some((ledger.mission(mission)?.progress(), ledger.mission(mission)?.state.word())))
        });
        words
            .max_by_key(|((done, _), word)| (*word != "pending" && *word != "running", *done))
            .map(|(_, word)| word.to_owned())
    }

    /// Waits for the end of a mission and says how it ended.
    pub async fn end_of(&mut self, mission: &MissionId) -> String {
        let over = |state: Option<String>| state.filter(|word| word != "pending" && word != "running");
        self.until(&format!("the end of {mission}"), Duration::from_secs(600), |fleet| {
            over(fleet.state(mission)).is_some()
        })
        .await;
        over(self.state(mission)).expect("just seen")
    }

    /// Who holds a role of a mission.
    pub fn holder(&self, mission: &MissionId, role: &str) -> Option<RobotId> {
        let role = slug(role);
        let coordinator = self.coordinating()?;
        self.nodes[coordinator.as_str()].replica.as_ref()?.read(|ledger| {
            ledger.mission(mission)?.roles.get(&role)?.holder.as_ref().map(|holder| holder.robot.clone())
        })
    }

    /// All that happened, in order.
    pub fn happenings(&self) -> Vec<Happening> {
        self.events.lock().expect("no panic while it is held").iter().map(|(_, event)| event.what.clone()).collect()
    }

    /// Whether something of the kind has happened.
    pub fn happened(&self, what: impl Fn(&Happening) -> bool) -> bool {
        self.events.lock().expect("no panic while it is held").iter().any(|(_, event)| what(&event.what))
    }

    /// How often each task of a mission was begun and ended well, by name.
    pub fn tasks(&self, mission: &MissionId) -> BTreeMap<String, (usize, usize)> {
        let mut counts: BTreeMap<String, (usize, usize)> = BTreeMap::new();
        for what in self.happenings() {
            match what {
                Happening::TaskBegan { mission: of, task, .. } if of == *mission => {
                    counts.entry(task.to_string()).or_default().0 += 1;
                }
                Happening::TaskEnded { mission: of, task, .. } if of == *mission => {
                    counts.entry(task.to_string()).or_default().1 += 1;
                }
                _ => {}
            }
        }
        counts
    }

    /// Everything that happened, a line each, for a person who looks for the reason.
    pub fn tale(&self) -> String {
        let events = self.events.lock().expect("no panic while it is held");
        let line = |(at, event): &(Duration, Event)| {
            let mut what = format!("{:?}", event.what);
            what.truncate(what.char_indices().nth(220).map_or(what.len(), |(index, _)| index));
            format!("{:8.3} {:>8} {what}\n", at.as_secs_f64(), event.node.to_string())
        };
        events.iter().map(line).collect()
    }

    /// How long the fleet has run, in virtual time.
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }
}

/// The places of a map and the ways between them, as estimators know them.
pub fn topology(map: &Map) -> TopologicalMap {
    let places = map.places().iter().map(|place| (place.id.clone(), place.pose)).collect();
    let edges = map.lanes().iter().map(|lane| Edge {
        a: lane.from.clone(),
        b: lane.to.clone(),
        length_m: lane.length.get(),
        one_way: !lane.two_way,
    });
    TopologicalMap { places, edges: edges.collect() }
}
