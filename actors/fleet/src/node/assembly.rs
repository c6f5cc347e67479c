//! Start of a node: its parts start in the order of their dependencies.

use super::error::NodeError;
use super::root::NodeMessage;
use super::settings::{DevicePart, DriverServerPart, FleetSettings, NodeSettings, RobotPart};
use crate::autopilot::{AutopilotSettings, Bootstrap, Decommission, DecommissionReport};
use crate::coordinator::{AuctionSettings, Coordinator, CoordinatorMessage, CoordinatorSettings, NodeParts};
use crate::device_host::DeviceHost;
use crate::ensemble_exchange::EnsembleExchange;
use crate::events::EventPublisher;
use crate::observe::SharedObserver;
use crate::robot::{
    ExecutionSettings, MotionScope, PricingSettings, Robot, RobotCharging, RobotLinks, RobotMessage, RobotSettings,
    RobotStart, TaskTimeout,
};
use crate::robot_driver::{
    CLIENT_TIMEOUT, DriverClientSettings, DriverServer, DriverServerSettings, RobotDriver, SharedWays,
};
use crate::shared_exchanges::SharedExchanges;
use crate::views::Views;
use consort_bus::clock::Clock;
use consort_bus::cluster_membership::{ClusterBus, ClusterMembership};
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::wire_version::WireVersion;
use consort_bus::{Query, RequestAuthority, SharedBus, Stream};
use consort_gossip::{GossipHandle, GossipStart, SharedKnowledge};
use consort_protocol::api::ErrorReply;
use consort_protocol::codec::VersionedMessage;
use consort_protocol::ids::{ClusterId, NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::{Attributes, DOMAINS_MAX, DeviceClaims, DeviceKnowledge, Knowledge};
use consort_protocol::ledger::{Command, Ledger};
use consort_protocol::message::{BootstrapRequest, Exchange, FollowedLeader};
use consort_protocol::timing::TimingParameters;
use consort_protocol::view::DeclarationsView;
use consort_raft::store::CheckpointStore;
use consort_raft::{ApplyObserver, LeadershipView, LogStore, RaftSettings, Replica};
use ractor::{Actor, ActorRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{info, warn};

/// Parts that a node handle needs.
pub(super) struct StartedParts {
    pub(super) decommission_handle: Decommission,
    pub(super) decommissioned: watch::Receiver<Option<DecommissionReport>>,
    pub(super) membership: ClusterMembership,
    pub(super) tasks: Tasks,
}

/// Starts all parts of a node as children of `root`. On an error the caller stops the started parts
/// together with the root.
pub(super) async fn start_parts(
    settings: NodeSettings,
    bus: SharedBus,
    root: &ActorRef<NodeMessage>,
) -> Result<StartedParts, NodeError> {
    let NodeSettings { fleet, node, incarnation, seed, store, clock, record_signer, observer, .. } = settings;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let keys = Keys::new(&fleet.fleet);
    let events = EventPublisher::open(node.clone(), &keys, bus.clone(), clock, observer.clone());
    let replaces_damaged = store.log_store.replaces_damaged();
    let replica = match settings.may_vote {
        true => Some(start_replica(&fleet, &node, bus.clone(), store.log_store, rng.next_u64(), observer).await?),
        false => None,
    };
    let knowledge = Knowledge {
        may_vote: settings.may_vote,
        stationary: settings.stationary,
        mains_powered: settings.mains_powered,
        replica: replica.as_ref().map(|replica| replica.id().0),
        cluster: None,
        leaving: false,
        supported_versions: settings.supported_versions,
        robot: settings.robot.as_ref().map(|robot| fleet.ensembles.published(robot.worker.clone())),
        // Without devices the robot claims none; otherwise it publishes its claims once it knows where it is.
        devices: DeviceKnowledge {
            claims: fleet.devices.is_empty().then(DeviceClaims::new),
            ..DeviceKnowledge::default()
        },
        domains: fleet.domain.files().into_iter().take(DOMAINS_MAX).collect(),
    };
    // Signed records exist since version 2. In a closed fleet nodes reject forwarded records without a
    // signature, so its nodes write no version before.
    let wire_version = match &record_signer {
        Some(_) => WireVersion::at_least(Exchange::SINCE, settings.supported_versions),
        None => WireVersion::new(settings.supported_versions),
    };
    // The conditions of an ensemble that exchanges values are evaluated by its members, from recent records.
    let exchanges_values = fleet.ensembles.iter().any(|ensemble| !ensemble.spec().exchange.is_empty());
    let receives_motion = !fleet.scoped_knowledge || settings.stationary || settings.mains_powered || exchanges_values;
    let start = GossipStart {
        settings: consort_gossip::Settings {
            scoped: fleet.scoped_knowledge,
            receives_motion,
            ..consort_gossip::Settings::new(fleet.fleet.clone(), node.clone(), incarnation).with_timing(fleet.timing)
        },
        knowledge,
        shared: SharedKnowledge::default(),
        bus: bus.clone(),
        clock,
        rng: ChaCha8Rng::from_rng(&mut rng),
        wire_version: wire_version.clone(),
        signer: record_signer,
    };
    let (gossip, _) =
        GossipHandle::start(start, Some(root.get_cell())).await.map_err(|problem| NodeError::from(*problem))?;
    let membership = ClusterMembership::default();
    // Only consensus and gossip cross the border of a cluster, because they detect other clusters.
    let bus = Arc::new(ClusterBus::new(bus, keys.clone(), membership.clone()));
    let exchanges = SharedExchanges::of(&fleet.ensembles, &node);
    let mut assembly = Assembly {
        root: root.clone(),
        times: fleet.timing.parameters(),
        fleet,
        node,
        keys,
        bus,
        clock,
        events,
        replica,
        gossip,
        membership,
        wire_version,
        driver: Arc::default(),
        exchanges,
        tasks: Tasks::default(),
    };
    assembly.publish_cluster();
    assembly.follow_wire_version().await?;
    let coordinator = match assembly.replica.clone() {
        Some(replica) => {
            assembly.follow_ledger_cluster(&replica);
            assembly.follow_ledger_version(&replica);
            if !receives_motion {
                assembly.receive_motion_as_member(&replica);
            }
            assembly.serve_clock().await?;
            assembly.serve_leader(&replica).await?;
            let coordinator = assembly.start_coordinator(&replica, rng.next_u64()).await?;
            assembly.end_with_ledger(&replica);
            let (mobile, on_battery) = (!settings.stationary, !settings.mains_powered);
            let founder = BootstrapRequest { mobile, on_battery, node: assembly.node.clone() };
            assembly.found_ledger(replica, founder, replaces_damaged).await?;
            Some(coordinator)
        }
        None => None,
    };
    assembly.serve_views(coordinator).await?;
    assembly.start_devices(settings.devices, incarnation);
    if let Some(server) = settings.driver_server {
        assembly.start_driver_server(server, rng.next_u64()).await?;
    }
    let attributes = settings.robot.as_ref().map(|part| part.worker.attributes.clone());
    assembly.start_exchange(attributes).await?;
    let robot = match settings.robot {
        Some(part) => Some(assembly.start_robot(part, incarnation, store.checkpoints).await?),
        None => None,
    };
    assembly.serve_decommission_requests(robot).await
}

/// Starts the local copy of the ledger from `log_store`.
async fn start_replica(
    fleet: &FleetSettings,
    node: &NodeId,
    bus: SharedBus,
    log_store: Arc<dyn LogStore>,
    seed: u64,
    observer: Option<SharedObserver>,
) -> Result<Replica<Ledger>, NodeError> {
    let settings = RaftSettings {
        snapshot_every: fleet.snapshot_every,
        log_entries_kept: fleet.log_entries_kept,
        ..RaftSettings::new(fleet.fleet.clone(), node.clone()).with_timing(fleet.timing)
    };
    let applied = observer.map(|observer| {
        let node = node.clone();
        Arc::new(move |at, commands: &[Command]| observer.on_applied(&node, at, commands)) as ApplyObserver<Ledger>
    });
    Ok(Replica::start_observed(settings, bus, log_store, seed, applied).await?)
}

/// Foundation of a node: everything the other parts depend on.
struct Assembly {
    root: ActorRef<NodeMessage>,
    fleet: FleetSettings,
    times: TimingParameters,
    node: NodeId,
    keys: Keys,
    /// Bus that keeps mission traffic within the node's cluster.
    bus: SharedBus,
    clock: Clock,
    events: EventPublisher,
    replica: Option<Replica<Ledger>>,
    gossip: GossipHandle,
    membership: ClusterMembership,
    wire_version: WireVersion,
    /// The driver of the node's robot, once it is connected.
    driver: Arc<OnceLock<RobotDriver>>,
    /// Values that the members of ensembles exchange.
    exchanges: SharedExchanges,
    tasks: Tasks,
}

impl Assembly {
    /// Returns the records received from other nodes.
    fn knowledge(&self) -> SharedKnowledge {
        self.gossip.shared().clone()
    }

    /// Publishes the node's cluster through gossip.
    fn publish_cluster(&mut self) {
        let gossip = self.gossip.clone();
        let publish =
            move |own: Option<ClusterId>| gossip.update_with(move |knowledge| knowledge.cluster = own).is_ok();
        self.tasks.spawn(self.membership.clone().report_changes(publish));
    }

    /// Returns the time of day of this node to coordinators.
    async fn serve_clock(&mut self) -> Result<(), NodeError> {
        let mut readings = self.bus.serve(&self.keys.write(&Key::Clock(self.node.clone()))).await?;
        let clock = self.clock;
        self.tasks.spawn(async move {
            while let Some(query) = readings.recv().await {
                reply::wire(&query, &query.key, &clock.wall_ms()).await;
            }
        });
        Ok(())
    }

    /// Returns the leader that this node follows to robots.
    async fn serve_leader(&mut self, replica: &Replica<Ledger>) -> Result<(), NodeError> {
        let mut queries = self.bus.serve(&self.keys.write(&Key::Leader(self.node.clone()))).await?;
        let leadership = replica.leadership();
        self.tasks.spawn(async move {
            while let Some(query) = queries.recv().await {
                let LeadershipView { leader_id, leader, .. } = leadership.borrow().clone();
                let followed = leader.zip(leader_id).map(|(node, id)| FollowedLeader { node, term: id.term });
                reply::wire(&query, &query.key, &followed).await;
            }
        });
        Ok(())
    }

    /// Follows the wire version of the fleet. The node ends if it cannot read that version.
    async fn follow_wire_version(&mut self) -> Result<(), NodeError> {
        let knowledge = self.knowledge();
        let judge = move |version: u8| knowledge.read(|base| base.wire_version_evidence(version));
        self.wire_version.clone().follow_beacons(&self.bus, &self.keys, &mut self.tasks, judge).await?;
        let (wire_version, root) = (self.wire_version.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let advice = wire_version.wait_unsupported().await;
            // The root may have ended already.
            let _ = root.send_message(NodeMessage::UnsupportedWireVersion(advice));
        });
        Ok(())
    }

    /// Sets the node's cluster to the cluster of its own ledger.
    fn follow_ledger_cluster(&mut self, replica: &Replica<Ledger>) {
        let (mut own, membership) = (replica.cluster(), self.membership.clone());
        self.tasks.spawn(async move {
            loop {
                let cluster = *own.borrow_and_update();
                if let Some(cluster) = cluster {
                    membership.set_from_ledger(cluster);
                }
                if own.changed().await.is_err() {
                    return;
                }
            }
        });
    }

    /// Adopts the wire version of the node's own ledger.
    fn follow_ledger_version(&mut self, replica: &Replica<Ledger>) {
        let (replica, wire_version) = (replica.clone(), self.wire_version.clone());
        self.tasks.spawn(async move {
            let mut applied = replica.applied();
            loop {
                applied.borrow_and_update();
                let (cluster, version) = replica.read(|ledger| (ledger.cluster(), ledger.wire()));
                wire_version.adopt(cluster, version);
                if applied.changed().await.is_err() {
                    return;
                }
            }
        });
    }

    /// Receives the motion of robots while this node is a member of the ledger's cluster, and may have to coordinate.
    fn receive_motion_as_member(&mut self, replica: &Replica<Ledger>) {
        let (mut leadership, member, gossip) = (replica.leadership(), replica.id(), self.gossip.clone());
        self.tasks.spawn(async move {
            let mut receives = false;
            loop {
                let is_member = leadership.borrow_and_update().is_member(member);
                if receives != is_member {
                    receives = is_member;
                    if gossip.receive_motion(receives).is_err() {
                        return;
                    }
                }
                if leadership.changed().await.is_err() {
                    return;
                }
            }
        });
    }

    async fn start_coordinator(
        &self,
        replica: &Replica<Ledger>,
        cluster_seed: u64,
    ) -> Result<ActorRef<CoordinatorMessage>, NodeError> {
        let settings = CoordinatorSettings {
            parts: NodeParts {
                node: self.node.clone(),
                keys: self.keys.clone(),
                bus: self.bus.clone(),
                clock: self.clock,
                replica: replica.clone(),
                knowledge: self.knowledge(),
                wire_version: self.wire_version.clone(),
                events: self.events.clone(),
            },
            auctions: AuctionSettings {
                ensembles: Arc::clone(&self.fleet.ensembles),
                limits: self.fleet.limits,
                promises: self.fleet.promises,
                allocator: Arc::clone(&self.fleet.allocator),
                candidates: self.fleet.candidates.clone(),
                bid_window: self.fleet.bid_window,
            },
            autopilot: AutopilotSettings {
                rule: self.fleet.autopilot_rule,
                target_voters: self.fleet.voters,
                dead_after: self.fleet.dead_after,
                contact_max: self.times.election_max,
            },
            domain: Arc::clone(&self.fleet.domain),
            missions: Arc::clone(&self.fleet.missions),
            alarms: Arc::clone(&self.fleet.alarms),
            devices: Arc::clone(&self.fleet.devices),
            charging: self.fleet.charging.clone(),
            request_limits: self.fleet.request_limits,
            history_limits: self.fleet.history_limits,
            lease_terms: self.fleet.lease_terms,
            stall_timeout: self.fleet.stall_timeout,
            tick_interval: self.times.beacon_interval,
            cluster_seed,
        };
        let (coordinator, _) = Actor::spawn_linked(None, Coordinator, settings, self.root.get_cell()).await?;
        Ok(coordinator)
    }

    /// Ends the node when its copy of the ledger fails.
    fn end_with_ledger(&mut self, replica: &Replica<Ledger>) {
        let (replica, root) = (replica.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let problem = replica.wait_failed().await;
            // The root may have ended already.
            let _ = root.send_message(NodeMessage::LedgerFailed(problem));
        });
    }

    /// Founds the fleet's ledger if there is none and it is this node's turn.
    async fn found_ledger(
        &mut self,
        replica: Replica<Ledger>,
        founder: BootstrapRequest,
        replaces_damaged: bool,
    ) -> Result<(), NodeError> {
        let requests = self.bus.serve(&self.keys.write(&Key::Bootstrap(self.node.clone()))).await?;
        let bootstrap = Bootstrap {
            me: founder,
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica,
            knowledge: self.knowledge(),
            membership: self.membership.clone(),
            replaces_damaged,
            expected_nodes: self.fleet.bootstrap_expect,
            target_voters: self.fleet.voters,
            reply_timeout: self.times.auction_window,
        };
        self.tasks.spawn(bootstrap.run(requests));
        Ok(())
    }

    async fn serve_views(&mut self, coordinator: Option<ActorRef<CoordinatorMessage>>) -> Result<(), NodeError> {
        let views = Views {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            replica: self.replica.clone(),
            coordinator,
            knowledge: self.knowledge(),
            membership: self.membership.clone(),
            ensembles: Arc::clone(&self.fleet.ensembles),
            driver: Arc::clone(&self.driver),
            exchanges: self.exchanges.clone(),
            map: self.fleet.map.clone(),
            charging: self.fleet.charging.as_deref().map(Into::into),
            declared: DeclarationsView::of((*self.fleet.alarms).clone(), self.fleet.domain.zones().clone()),
            devices: Arc::clone(&self.fleet.devices),
            beacon_interval: self.times.beacon_interval,
        };
        Ok(views.serve(&mut self.tasks).await?)
    }

    /// Starts to exchange knowledge with the other members of ensembles.
    async fn start_exchange(&mut self, attributes: Option<Attributes>) -> Result<(), NodeError> {
        let exchange = EnsembleExchange {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            knowledge: self.knowledge(),
            ensembles: Arc::clone(&self.fleet.ensembles),
            attributes,
            driver: Arc::clone(&self.driver),
            exchanges: self.exchanges.clone(),
        };
        Ok(exchange.start(&mut self.tasks).await?)
    }

    /// Starts the drivers of devices. A device is left out if the fleet file does not declare it, or names another host.
    fn start_devices(&mut self, parts: Vec<DevicePart>, incarnation: u64) {
        for DevicePart { device: name, driver } in parts {
            let declared = self.fleet.devices.get(&name).filter(|device| device.host == self.node);
            let Some(device) = declared.cloned() else {
                warn!(device = %name, "the fleet file declares no such device of this node: its driver is not started");
                continue;
            };
            let host = DeviceHost {
                device,
                driver,
                clock: self.clock,
                gossip: self.gossip.clone(),
                knowledge: self.knowledge(),
                replica: self.replica.clone(),
                first_goal: incarnation << 20,
            };
            self.tasks.spawn(host.run());
        }
    }

    /// Starts the driver server.
    async fn start_driver_server(&self, part: DriverServerPart, boot: u64) -> Result<(), NodeError> {
        let server = DriverServerSettings {
            boot,
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            speed: part.speed,
            publish_interval: Duration::from_millis(500),
            client_timeout: CLIENT_TIMEOUT,
        };
        Actor::spawn_linked(None, DriverServer, (server, part.world), self.root.get_cell()).await?;
        Ok(())
    }

    /// Starts the driver client and the robot.
    async fn start_robot(
        &mut self,
        part: RobotPart,
        incarnation: u64,
        checkpoint_store: Arc<dyn CheckpointStore>,
    ) -> Result<ActorRef<RobotMessage>, NodeError> {
        let robot = RobotId::from(self.node.clone());
        let client = DriverClientSettings {
            robot: robot.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            // 20 bits of goal ids per incarnation; incarnations start at least 1 ms apart.
            first_goal: incarnation << 20,
            heartbeat_interval: Duration::from_millis(300),
            patience_s: self.fleet.request_limits.patience_s,
            cancel_times: part.library.cancel_times().clone(),
        };
        let driver = RobotDriver::connect(client, &self.root.get_cell()).await?.with_exchanges(self.exchanges.clone());
        let driver = driver.with_ways(SharedWays::new(Arc::clone(&self.fleet.devices)));
        // A node has a single robot.
        let _ = self.driver.set(driver.clone());
        let token = self.bus.announce(&self.keys.write(&Key::AliveRobot(robot.clone()))).await?;
        self.tasks.spawn(async move {
            std::future::pending::<()>().await;
            drop(token);
        });
        let links = RobotLinks {
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            events: self.events.clone(),
            gossip: self.gossip.clone(),
            knowledge: self.knowledge(),
            checkpoint_store,
        };
        let pricing = PricingSettings {
            ensembles: Arc::clone(&self.fleet.ensembles),
            limits: self.fleet.limits,
            estimator: part.estimator,
        };
        let execution = ExecutionSettings {
            library: part.library,
            task_timeout: TaskTimeout::default(),
            retry_delay: Duration::from_millis(500),
            skill_tick_interval: Duration::from_millis(100),
        };
        let charging = self.fleet.charging.as_ref();
        let motion_scope = match self.fleet.scoped_knowledge {
            true => MotionScope::Apart { shared_places: charging.map(|all| all.places()).unwrap_or_default() },
            false => MotionScope::InRecord,
        };
        let charging = charging.and_then(|settings| RobotCharging::of(settings, &robot, &part.worker, part.capacity));
        let settings = RobotSettings {
            robot,
            incarnation,
            links,
            pricing,
            execution,
            charging,
            motion_scope,
            devices: Some(Arc::clone(&self.fleet.devices)).filter(|devices| !devices.is_empty()),
            lease_terms: self.fleet.lease_terms,
            update_interval: Duration::from_millis(250),
        };
        let start = RobotStart { settings, worker: part.worker, driver };
        let (robot, _) = Actor::spawn_linked(None, Robot, start, self.root.get_cell()).await?;
        Ok(robot)
    }

    /// Starts to accept decommission requests.
    async fn serve_decommission_requests(
        mut self,
        robot: Option<ActorRef<RobotMessage>>,
    ) -> Result<StartedParts, NodeError> {
        let decommission = Decommission {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica: self.replica.clone(),
            gossip: self.gossip.clone(),
            knowledge: self.knowledge(),
            robot,
            terms: self.fleet.lease_terms,
            timing: self.times,
        };
        let (decommissioned_sender, decommissioned) = watch::channel(None);
        let key = self.keys.write(&Key::Leave(self.node));
        let requests = self.bus.serve(&key).await?;
        let requests = DecommissionRequests { key, requests, started_ms: self.clock.wall_ms() };
        self.tasks.spawn(serve_decommission(decommission.clone(), requests, decommissioned_sender));
        Ok(StartedParts {
            decommission_handle: decommission,
            decommissioned,
            membership: self.membership,
            tasks: self.tasks,
        })
    }
}

/// Suggested delay before a rejected request to leave is signed again, in milliseconds.
const RETRY_AFTER_MS: u64 = 1000;

/// Requests to this node to leave the fleet.
struct DecommissionRequests {
    key: String,
    requests: Stream<Query>,
    /// Start of the node, in milliseconds since 1970.
    started_ms: u64,
}

impl DecommissionRequests {
    /// Returns the next request that is to be executed. Rejects the others.
    async fn next(&mut self) -> Option<Query> {
        loop {
            let query = self.requests.recv().await?;
            let rejection = match &query.authority {
                // A key expression that matches several nodes was not checked.
                _ if query.key != self.key => ErrorReply::rejected(format!("a request names one node: {}", self.key)),
                RequestAuthority::Rejected(reply) => reply.clone(),
                RequestAuthority::Unchecked => return Some(query),
                // An earlier start of the node may have executed it.
                RequestAuthority::Verified(requester) if requester.signed_at_ms < self.started_ms => {
                    ErrorReply::retry_after("the request was signed before the node started", RETRY_AFTER_MS)
                }
                RequestAuthority::Verified(requester) => {
                    info!(author = %requester.author, "asked to leave the fleet");
                    return Some(query);
                }
            };
            reply::json(&query, &self.key, &rejection).await;
        }
    }
}

/// Decommissions the node on request, and replies with the result or the error.
async fn serve_decommission(
    decommission: Decommission,
    mut requests: DecommissionRequests,
    decommissioned: watch::Sender<Option<DecommissionReport>>,
) {
    while let Some(query) = requests.next().await {
        match decommission.run().await {
            Ok(report) => {
                reply::json(&query, &query.key, &report).await;
                decommissioned.send_replace(Some(report));
                // The program that runs the node ends it now.
                return;
            }
            Err(problem) => {
                warn!(node = %decommission.node, %problem, "decommission failed: the node keeps running");
                reply::json(&query, &query.key, &ErrorReply::rejected(problem.to_string())).await;
            }
        }
    }
}
