//! A whole fleet in a single process on virtual time.

use crate::charging_setup::ChargingSetup;
use crate::credentials::{Credentials, Signatures};
use crate::event_log::{EventLog, Observation};
use crate::robot_spec::{ESTIMATOR_VERSION, RobotSpec};
use crate::slug;
use crate::ward::{logistics, ward};
use consort_bus::clock::Clock;
use consort_bus::record_signer::SharedRecordSigner;
use consort_bus::trust::SigningBus;
use consort_bus::{LinkModel, SharedBus, VirtualBus, VirtualNetwork};
use consort_fleet::coordinator::CandidateSettings;
use consort_fleet::node::{DriverServerPart, FleetSettings, NodeHandle, NodeSettings, RobotPart};
use consort_protocol::ensemble::EnsembleSpec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{NodeId, PlaceId};
use consort_protocol::keys::Keys;
use consort_protocol::trust::AccessScope;
use consort_protocol::versions::VersionRange;
use consort_raft::store::NodeStore;
use consort_skills::descriptor::DescriptorRegistry;
use consort_skills::domain_file::DomainFile;
use consort_skills::environment::{Environment, Routes};
use consort_skills::extensions::Extensions;
use consort_world::SharedWorld;
use consort_world::map;
use consort_world::world::{LoggedEvent, PersonSetup, RobotSetup, World, WorldSetup};
use futures::FutureExt as _;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::task::AbortHandle;
use tokio::time::Instant;

/// The fleet.
pub struct Fleet {
    /// Source of all randomness. Every failed assertion must name it.
    pub seed: u64,
    /// The network; tests inject network faults here.
    pub network: VirtualNetwork,
    /// The simulated world with the robots.
    pub world: SharedWorld,
    /// Everything that happened.
    pub event_log: EventLog,
    pub(crate) keys: Keys,
    settings: FleetSettings,
    /// World seconds per second of node time.
    speed: f64,
    members: BTreeMap<String, RobotSpec>,
    pub(crate) nodes: BTreeMap<String, NodeHandle>,
    /// Network endpoint of a client.
    pub client: VirtualBus,
    /// Bus of the same client that signs its requests as a person, in a closed fleet.
    pub requests: SharedBus,
    /// World events drained so far.
    pub(crate) journal: Vec<LoggedEvent>,
    lives: u64,
    /// Stores of the latest incarnation of each node.
    stores: BTreeMap<String, NodeStore>,
    options: NodeOptions,
    /// Tasks that record the leadership views of nodes.
    followers: BTreeMap<String, AbortHandle>,
    /// Nodes with a disk that cannot be written; each may end by itself.
    pub(crate) unwritable: BTreeSet<String>,
    /// Nodes that a person has asked to leave the fleet during a run of chaos.
    pub(crate) asked_to_leave: BTreeSet<NodeId>,
    /// Certificates of the nodes, if the fleet is closed.
    pub credentials: Option<Credentials>,
    /// Signing buses of the nodes of a closed fleet.
    pub signing_buses: BTreeMap<String, Arc<SigningBus>>,
}

/// Changes the settings of a node before each start.
pub(crate) type AdjustNode = Box<dyn FnMut(&mut NodeSettings)>;

/// Wraps the bus of a node before each start; the settings are those of the node.
pub(crate) type WrapBus = Box<dyn FnMut(&NodeSettings, SharedBus) -> SharedBus>;

/// Wraps the signer of a node's records before each start.
pub(crate) type WrapSigner = Box<dyn FnMut(SharedRecordSigner) -> SharedRecordSigner>;

/// Options of all nodes of a fleet.
pub(crate) struct NodeOptions {
    pub(crate) adjust: AdjustNode,
    pub(crate) wrap_bus: WrapBus,
    /// Wraps the bus below the signatures.
    pub(crate) wrap_network: WrapBus,
    /// Wraps the signer of records, if nodes have certificates.
    pub(crate) wrap_signer: WrapSigner,
    /// Nodes have certificates and sign their messages in this way; an open fleet has none.
    pub(crate) signatures: Option<Signatures>,
    /// Date at which the client's clock starts, in milliseconds since 1970.
    pub(crate) date_ms: u64,
    /// World seconds per second of node time.
    pub(crate) world_speed: f64,
    /// Domain files and skills in addition to the standard domain.
    pub(crate) extensions: Extensions,
    /// Ensembles of the hospital.
    pub(crate) ensembles: Vec<EnsembleSpec>,
    /// Chargers and batteries of the hospital.
    pub(crate) charging: Option<ChargingSetup>,
    /// Runtimes of their own, by node.
    pub(crate) runtimes: BTreeMap<String, Handle>,
    /// Number of robots that an auction asks first.
    pub(crate) candidates: usize,
}

/// Domain, ensembles and people of a hospital.
pub struct DomainSetup {
    /// Actions, readings and tasks of its robots in addition to the standard domain.
    pub domain: DomainFile,
    /// Its ensembles.
    pub ensembles: Vec<EnsembleSpec>,
    /// Rooms with a nurse.
    pub rooms: &'static [&'static str],
    /// Nodes have certificates and sign their messages.
    pub closed: bool,
}

impl Default for NodeOptions {
    fn default() -> NodeOptions {
        NodeOptions {
            adjust: Box::new(|_| ()),
            wrap_bus: Box::new(|_, bus| bus),
            wrap_network: Box::new(|_, bus| bus),
            wrap_signer: Box::new(|signer| signer),
            signatures: None,
            date_ms: 0,
            world_speed: 10.0,
            extensions: Extensions::default(),
            ensembles: vec![logistics(&["operate_drawer", "pick_up"])],
            charging: None,
            runtimes: BTreeMap::new(),
            candidates: CandidateSettings::DEFAULT_COUNT,
        }
    }
}

/// Initial state of a fleet.
pub(crate) struct FleetSetup {
    pub(crate) seed: u64,
    /// Nodes of the robots; the simulated robots are in the world.
    pub(crate) members: Vec<RobotSpec>,
    pub(crate) stations: Vec<String>,
    pub(crate) world: SharedWorld,
    /// World seconds per second of node time.
    pub(crate) speed: f64,
    /// Ensembles of the fleet.
    pub(crate) ensembles: Vec<EnsembleSpec>,
    pub(crate) options: NodeOptions,
}

/// Returns the choice of the robots that auctions ask in a large fleet.
fn candidates(world: &SharedWorld, options: &NodeOptions) -> CandidateSettings {
    let routes = world.with(|world| Routes::shortest(&world.map().topology(), &world.map().passages()));
    let environment = Environment::new().with(routes.expect("the map of a world is sound"));
    let estimator = options.extensions.descriptors(DescriptorRegistry::standard()).resolve(environment);
    CandidateSettings {
        count: options.candidates,
        estimator: Arc::new(estimator.expect("routes are there")),
        estimator_version: ESTIMATOR_VERSION.to_owned(),
    }
}

/// Returns a nurse that waits in a room with one sample; both are named after the room.
pub(crate) fn nurse_in(room: &str) -> PersonSetup {
    PersonSetup {
        samples: vec![format!("sample of {room}").as_str().into()],
        ..PersonSetup::new(&format!("nurse of {room}"), slug("nurse"), slug(room))
    }
}

/// Returns such a nurse for each room.
pub(crate) fn nurses_in(rooms: &[&str]) -> Vec<PersonSetup> {
    rooms.iter().map(|room| nurse_in(room)).collect()
}

impl Fleet {
    /// Starts the hospital with a nurse in each named room, an arm in the laboratory, these mobile
    /// robots, and a station per name in `stations`. World time runs ten times as fast as node
    /// time.
    ///
    /// The first voters are at most five, an odd number: the arm and the stations before the mobile
    /// robots, ordered by name. The first voter by name creates the cluster and is usually the
    /// first coordinator.
    pub async fn hospital(seed: u64, members: Vec<RobotSpec>, stations: &[&str], rooms: &[&str]) -> Fleet {
        Fleet::adjusted_hospital(seed, members, stations, rooms, Box::new(|_| ())).await
    }

    /// Starts the same hospital with changed node settings.
    pub async fn adjusted_hospital(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        rooms: &[&str],
        adjust: AdjustNode,
    ) -> Fleet {
        let options = NodeOptions { adjust, ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, nurses_in(rooms), options).await
    }

    /// Starts the same hospital with a layer over the bus of each node.
    pub async fn hospital_with_layer(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        rooms: &[&str],
        wrap_bus: WrapBus,
    ) -> Fleet {
        let options = NodeOptions { wrap_bus, ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, nurses_in(rooms), options).await
    }

    /// Starts the same hospital with certificates; nodes sign their messages.
    pub async fn closed_hospital(seed: u64, members: Vec<RobotSpec>, stations: &[&str], rooms: &[&str]) -> Fleet {
        Fleet::adjusted_closed_hospital(seed, members, stations, rooms, Box::new(|_| ())).await
    }

    /// Starts the same closed hospital with changed node settings.
    pub async fn adjusted_closed_hospital(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        rooms: &[&str],
        adjust: AdjustNode,
    ) -> Fleet {
        let options = NodeOptions { adjust, signatures: Some(Signatures::Ed25519), ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, nurses_in(rooms), options).await
    }

    /// Starts the same hospital, whose robots have the actions, readings and tasks of a domain, too.
    pub async fn hospital_of_domain(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        domain: DomainFile,
    ) -> Fleet {
        let extensions = Extensions::default().with_domain("domain.yaml", domain);
        let options = NodeOptions { extensions, ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, vec![], options).await
    }

    /// Starts the same hospital with this domain, these ensembles and these nurses.
    pub async fn hospital_of_domain_setup(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        setup: DomainSetup,
    ) -> Fleet {
        let DomainSetup { domain, ensembles, rooms, closed } = setup;
        let extensions = Extensions::default().with_domain("domain.yaml", domain);
        let signatures = closed.then_some(Signatures::Ed25519);
        let options = NodeOptions { extensions, signatures, ensembles, ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, nurses_in(rooms), options).await
    }

    /// Starts the same hospital with chargers, and with changed node settings.
    pub async fn hospital_with_chargers(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        charging: ChargingSetup,
        adjust: AdjustNode,
    ) -> Fleet {
        let options = NodeOptions { adjust, charging: Some(charging), ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, vec![], options).await
    }

    /// Starts the same hospital with chargers and this domain, and with changed node settings.
    pub async fn hospital_with_charging_domain(
        seed: u64,
        members: Vec<RobotSpec>,
        stations: &[&str],
        (charging, domain): (ChargingSetup, DomainFile),
        adjust: AdjustNode,
    ) -> Fleet {
        let extensions = Extensions::default().with_domain("domain.yaml", domain);
        let options = NodeOptions { adjust, extensions, charging: Some(charging), ..NodeOptions::default() };
        Fleet::hospital_with(seed, members, stations, vec![], options).await
    }

    /// Starts the hospital, open or closed.
    pub(crate) async fn hospital_with(
        seed: u64,
        mut members: Vec<RobotSpec>,
        stations: &[&str],
        people: Vec<PersonSetup>,
        options: NodeOptions,
    ) -> Fleet {
        if members.iter().all(|member| member.speed.is_some()) {
            members.push(RobotSpec::arm("lab-arm", "Laboratory"));
        }
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let mut setup = WorldSetup::new(map, seed).extended(options.extensions);
        let charging = options.charging.as_ref();
        for member in &members {
            let capacity = charging.map(|charging| charging.capacity);
            setup = setup.robot(RobotSetup { capacity, ..member.robot_body() });
        }
        if let Some(charging) = charging {
            let chargers = charging.settings.chargers.iter();
            setup.chargers = chargers.map(|charger| (charger.place.clone(), Some(charging.power))).collect();
        }
        setup = people.into_iter().fold(setup, WorldSetup::person);
        let world = SharedWorld::new(World::new(setup).expect("a valid world"));
        let stations = stations.iter().map(|station| (*station).to_owned()).collect();
        let ensembles = options.ensembles.clone();
        let speed = options.world_speed;
        Fleet::from_setup(FleetSetup { seed, members, stations, world, speed, ensembles, options }).await
    }

    /// Starts a fleet for the robots of an existing world.
    pub(crate) async fn from_setup(staging: FleetSetup) -> Fleet {
        let FleetSetup { seed, members, stations, world, speed, ensembles, options } = staging;
        let network = VirtualNetwork::new(seed, LinkModel::LAN);
        let present = members.iter().filter(|member| !member.starts_later).count();
        let mut settings = ward(ensembles, present + stations.len());
        let places = world.with(|world| world.map().topology().places);
        let task_types = options.extensions.domain().with_places(places.into_keys());
        settings.charging = options.charging.as_ref().map(|charging| Arc::new(charging.settings.clone()));
        settings.candidates = Some(candidates(&world, &options));
        settings.domain = Arc::new(task_types.with_ensembles(settings.ensembles.names().cloned()));
        let client = network.bus(slug("client"));
        let credentials =
            options.signatures.map(|signatures| Credentials::new(settings.fleet.clone(), seed, signatures));
        let requests: SharedBus = match &credentials {
            None => Arc::new(client.clone()),
            Some(credentials) => {
                let keyring = credentials.keyring_of_person("client", AccessScope::Operate);
                credentials.signing_bus(Arc::new(client.clone()), keyring, Clock::virtual_at(options.date_ms)).await
            }
        };
        let mut fleet = Fleet {
            seed,
            network,
            world,
            event_log: EventLog::new(),
            keys: Keys::new(&settings.fleet),
            settings,
            speed,
            members: members.into_iter().map(|member| (member.name.clone(), member)).collect(),
            nodes: BTreeMap::new(),
            client,
            requests,
            journal: vec![],
            lives: 0,
            stores: BTreeMap::new(),
            options,
            followers: BTreeMap::new(),
            unwritable: BTreeSet::new(),
            asked_to_leave: BTreeSet::new(),
            credentials,
            signing_buses: BTreeMap::new(),
        };
        fleet.start_world().await;
        for station in &stations {
            fleet.start_station(station).await;
        }
        let present = fleet.members.values().filter(|member| !member.starts_later).map(|member| member.name.clone());
        for parse_name in present.collect::<Vec<_>>() {
            fleet.start_robot(&parse_name).await;
        }
        fleet
    }

    /// Starts or restarts the node that hosts the simulated robots and the people. The world itself
    /// continues in any case.
    pub async fn start_world(&mut self) {
        let host = DriverServerPart { world: Box::new(self.world.clone()), speed: self.speed };
        let settings = NodeSettings { driver_server: Some(host), ..self.node("world", false, None) };
        self.start(settings).await;
    }

    /// Starts or restarts the node of a station with an empty store.
    pub async fn start_station(&mut self, name: &str) {
        self.stores.remove(name);
        self.restart(name).await;
    }

    /// Starts or restarts the node of a robot with an empty store.
    pub async fn start_robot(&mut self, name: &str) {
        self.stores.remove(name);
        self.restart(name).await;
    }

    /// Restarts the node of a robot or station with the store of its previous incarnation.
    pub async fn restart(&mut self, name: &str) {
        let Some(member) = self.members.get(name).cloned() else {
            let settings = self.node(name, true, None);
            return self.start(settings).await;
        };
        let robot = self.world.with(|world| {
            let map = world.map();
            let environment = map.environment().expect("the shipped map is sound");
            let extensions = self.options.extensions;
            let mut library = extensions.library(environment.clone()).expect("its names are unique");
            let descriptors = extensions.descriptors(DescriptorRegistry::standard());
            if let Some(train) = member.customize_library {
                train(&mut library);
            }
            RobotPart {
                worker: member.worker(map),
                estimator: Arc::new(descriptors.resolve(environment).expect("routes are there")),
                library: Arc::new(library),
                capacity: self.options.charging.as_ref().map(|charging| charging.capacity),
            }
        });
        let settings = self.node(name, true, Some(robot));
        let clock = settings.clock.drifting(member.clock_rate);
        self.start(NodeSettings { clock, ..settings }).await;
    }

    fn node(&mut self, name: &str, may_vote: bool, robot: Option<RobotPart>) -> NodeSettings {
        self.lives += 1;
        let seed = self.seed.wrapping_mul(1_000_003).wrapping_add(self.lives);
        let stationary = robot.as_ref().is_none_or(|robot| robot.worker.speed.is_none());
        NodeSettings {
            fleet: self.settings.clone(),
            node: slug(name),
            incarnation: self.lives,
            seed,
            store: self.stores.entry(name.to_owned()).or_insert_with(|| NodeStore::in_memory(seed)).clone(),
            clock: Clock::virtual_at(0),
            supported_versions: VersionRange::OWN,
            may_vote,
            stationary,
            mains_powered: stationary,
            robot,
            driver_server: None,
            devices: vec![],
            observer: Some(Arc::new(self.event_log.clone())),
            record_signer: None,
        }
    }

    async fn start(&mut self, mut settings: NodeSettings) {
        (self.options.adjust)(&mut settings);
        let mut bus: SharedBus = Arc::new(self.network.bus(settings.node.clone()));
        bus = (self.options.wrap_network)(&settings, bus);
        let name = settings.node.to_string();
        if let Some(credentials) = &self.credentials {
            let keyring = credentials.keyring_of(&settings.node, Credentials::roles(&settings), settings.incarnation);
            let signing = credentials.signing_bus(bus, keyring, settings.clock).await;
            settings.record_signer = Some((self.options.wrap_signer)(signing.record_signer()));
            self.signing_buses.insert(name.clone(), Arc::clone(&signing));
            bus = signing;
        }
        let bus = (self.options.wrap_bus)(&settings, bus);
        let node = NodeHandle::start(settings, bus);
        let node = match self.options.runtimes.get(&name) {
            None => node.await,
            Some(runtime) => runtime.spawn(node).await.expect("no panic of a node that starts"),
        };
        let node = node.expect("a virtual node starts");
        self.nodes.insert(name, node);
    }

    /// Records the leadership view of a node from now on, until the node ends.
    pub(crate) fn record_leadership(&mut self, name: &str) {
        let Some(replica) = self.nodes.get(name).and_then(|node| node.replica.as_ref()) else { return };
        let (mut leadership, event_log, node) = (replica.leadership(), self.event_log.clone(), slug::<NodeId>(name));
        let follower = tokio::spawn(async move {
            let mut reported = None;
            loop {
                let (term, leads) = {
                    let now = leadership.borrow_and_update();
                    (now.term, now.leader_id.filter(|_| now.is_leader))
                };
                if reported != Some((term, leads)) {
                    reported = Some((term, leads));
                    event_log.add(Observation::LeadershipChanged { node: node.clone(), term, leading_as: leads });
                }
                if leadership.changed().await.is_err() {
                    return;
                }
            }
        });
        self.followers.insert(name.to_owned(), follower.abort_handle());
    }

    /// Returns the nodes that have ended by themselves.
    pub(crate) fn ended_nodes(&self) -> impl Iterator<Item = NodeId> {
        self.nodes.iter().filter(|(_, node)| node.has_ended()).map(|(name, _)| slug(name))
    }

    /// Checks whether a node belongs to a robot.
    pub(crate) fn is_robot(&self, node: &NodeId) -> bool {
        self.members.contains_key(node.as_str())
    }

    /// Returns the places of the chargers that robots use by themselves.
    pub(crate) fn chargers(&self) -> impl Iterator<Item = &PlaceId> {
        let chargers = self.options.charging.iter().flat_map(|charging| &charging.settings.chargers);
        chargers.map(|charger| &charger.place)
    }

    /// Returns the key expressions of the fleet.
    pub fn keys(&self) -> &Keys {
        &self.keys
    }

    /// Returns the stored checkpoint of a robot.
    pub async fn checkpoint(&self, name: &str) -> Option<Vec<u8>> {
        self.stores[name].checkpoints.read().await.expect("a checkpoint store in memory")
    }

    /// Overwrites the checkpoint while the robot is not running.
    pub async fn overwrite_checkpoint(&self, name: &str, page: Vec<u8>) {
        self.stores[name].checkpoints.write(Some(page)).await.expect("a checkpoint store in memory");
    }

    /// Ends a node as SIGKILL does.
    pub async fn kill(&mut self, name: &str) {
        self.gone(name, "killed");
        self.nodes.remove(name).expect("a node that runs").kill().await;
    }

    /// Ends a node as SIGTERM does: it may come back.
    pub async fn stop(&mut self, name: &str) {
        let node = self.nodes.remove(name).expect("a node that runs");
        node.stop().await;
        self.gone(name, "stopped");
    }

    /// Decommissions a node as `consort leave` does, and shuts it down afterwards. Returns its
    /// reply.
    pub async fn leave(&mut self, name: &str) -> Value {
        let reply = self.request_leave(name).await;
        let mut node = self.nodes.remove(name).expect("a node that runs");
        node.ended_or_decommissioned().await.unwrap_or_else(|problem| panic!("seed {}: {problem}; {reply}", self.seed));
        node.shut_down().await;
        self.gone(name, "left");
        reply
    }

    /// Shuts a node down if it has been decommissioned by now. Returns whether it was.
    pub(crate) async fn finish_decommission(&mut self, name: &str) -> bool {
        let node = self.nodes.get_mut(name).filter(|node| !node.has_ended());
        if !node.is_some_and(|node| matches!(node.ended_or_decommissioned().now_or_never(), Some(Ok(_)))) {
            return false;
        }
        self.nodes.remove(name).expect("checked before").shut_down().await;
        self.gone(name, "left");
        true
    }

    fn gone(&mut self, name: &str, what: &'static str) {
        self.event_log.add(Observation::TestAction { node: slug(name), action: what });
        if let Some(follower) = self.followers.remove(name) {
            follower.abort();
        }
        self.network.crash(&slug(name));
    }

    /// Kills the coordinator and returns its id.
    pub async fn kill_coordinator(&mut self) -> NodeId {
        let coordinator = self.wait_for_coordinator().await;
        self.kill(coordinator.as_str()).await;
        coordinator
    }

    /// Isolates nodes as a group: they reach only each other until the network is healed.
    pub fn cut_off(&self, names: &[&str]) {
        for name in names {
            self.event_log.add(Observation::TestAction { node: slug(name), action: "cut off" });
        }
        self.network.partition([names.iter().map(|name| slug(name)).collect::<Vec<NodeId>>()]);
    }

    /// Ends all network faults.
    pub fn heal(&self) {
        self.network.heal();
        self.event_log.add(Observation::TestAction { node: slug("client"), action: "all faults healed" });
    }

    /// Lets virtual time pass until `done` returns true. It checks after every event and every ten
    /// milliseconds.
    ///
    /// # Panics
    /// If `done` stays false for `limit`. The message contains the condition, the seed and the last
    /// events.
    pub async fn wait_until(&mut self, what: &str, limit: Duration, mut done: impl FnMut(&Fleet) -> bool) {
        let deadline = Instant::now() + limit;
        let mut grown = self.event_log.subscribe_len();
        loop {
            grown.mark_unchanged();
            let news = self.world.with(World::drain_event_log);
            self.journal.extend(news);
            if done(self) {
                return;
            }
            assert!(
                Instant::now() < deadline,
                "seed {}: {what} has not happened within {limit:?}; the last that did:\n{}",
                self.seed,
                self.event_log_text()
                    .lines()
                    .rev()
                    .take(60)
                    .collect::<Vec<_>>()
                    .into_iter()
                    .rev()
                    .collect::<Vec<_>>()
                    .join("\n")
            );
            // Both results, an event or a timeout, call for the next check.
            let _ = tokio::time::timeout(Duration::from_millis(10), grown.changed()).await;
        }
    }

    /// Lets virtual time pass: at most `at_most`, and at most 50 ms.
    pub(crate) async fn step(&mut self, at_most: Duration) {
        tokio::time::sleep(at_most.min(Duration::from_millis(50))).await;
        let news = self.world.with(World::drain_event_log);
        self.journal.extend(news);
    }

    /// Lets virtual time pass and asserts that `must_not` never returns true.
    ///
    /// # Panics
    /// If it does.
    pub async fn assert_never(&mut self, what: &str, during: Duration, mut must_not: impl FnMut(&Fleet) -> bool) {
        let end = Instant::now() + during;
        let mut broken = false;
        self.wait_until(&format!("{during:?} without {what}"), during + Duration::from_secs(1), |fleet| {
            broken |= must_not(fleet);
            broken || Instant::now() >= end
        })
        .await;
        assert!(!broken, "seed {}: {what} happened\n{}", self.seed, self.event_log_text());
    }

    /// Waits until a new event of the kind happens after this call.
    pub async fn wait_for_next(&mut self, what: &str, limit: Duration, is: impl Fn(&EventKind) -> bool) {
        let before = self.event_log.count(&is);
        self.wait_until(what, limit, |fleet| fleet.event_log.count(&is) > before).await;
    }

    /// Returns the virtual run time of the fleet.
    pub fn elapsed(&self) -> Duration {
        self.event_log.elapsed()
    }

    /// Formats the whole event log for debugging, with a line per entry.
    pub fn event_log_text(&self) -> String {
        self.event_log.to_text()
    }
}
