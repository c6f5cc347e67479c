//! A node put together: its parts are started in an order in which each finds those that it needs.

use super::handle::NodeError;
use super::root::NodeMessage;
use super::settings::{DriverServerPart, FleetSettings, NodeSettings, RobotPart};
use crate::autopilot::{Bootstrap, Decommission, DecommissionReport};
use crate::bus::{Query, SharedBus, Stream};
use crate::clock::Clock;
use crate::cluster_membership::{ClusterBus, ClusterMembership};
use crate::coordinator::{Coordinator, CoordinatorMessage, CoordinatorSettings};
use crate::events::EventPublisher;
use crate::gossip::{self, Gossip, GossipHandle, SharedKnowledge};
use crate::human_task_proxy::{HumanTaskProxy, HumanTaskProxySettings};
use crate::observe::SharedObserver;
use crate::raft::{ApplyObserver, LogStore, RaftSettings, Replica};
use crate::reply;
use crate::robot::{Robot, RobotMessage, RobotSettings, TaskTimeout};
use crate::robot_driver::{CLIENT_TIMEOUT, DriverClientSettings, DriverServer, DriverServerSettings, RobotDriver};
use crate::store::CheckpointStore;
use crate::tasks::Tasks;
use crate::timing::TimingParameters;
use crate::views::Views;
use crate::wire_version::WireVersion;
use consort_protocol::ids::{ClusterId, NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::ledger::{Command, Ledger};
use consort_protocol::message::BootstrapRequest;
use consort_protocol::versions::VersionRange;
use ractor::{Actor, ActorRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tracing::warn;

/// What a handle needs of a node that was put together.
pub(super) struct StartedParts {
    pub(super) decommission_handle: Decommission,
    pub(super) decommissioned: watch::Receiver<Option<DecommissionReport>>,
    pub(super) membership: ClusterMembership,
    pub(super) tasks: Tasks,
}

/// Starts all parts of a node, as children of `root`. If one does not start, whoever asked ends the others with the root.
pub(super) async fn start_parts(
    settings: NodeSettings,
    bus: SharedBus,
    root: &ActorRef<NodeMessage>,
) -> Result<StartedParts, NodeError> {
    let NodeSettings { fleet, node, incarnation, seed, store, clock, record_signer: notary, observer, .. } = settings;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let keys = Keys::new(&fleet.fleet);
    let events = EventPublisher::open(node.clone(), &keys, bus.clone(), clock, observer.clone());
    let replica = match settings.may_vote {
        true => Some(keep_ledger(&fleet, &node, bus.clone(), store.log_store, rng.next_u64(), observer).await?),
        false => None,
    };
    let knowledge = Knowledge {
        may_vote: settings.may_vote,
        stationary: settings.stationary,
        mains_powered: settings.mains_powered,
        replica: replica.as_ref().map(|replica| replica.id().0),
        cluster: None,
        leaving: false,
        supported_versions: VersionRange::OWN,
        robot: settings.robot.as_ref().map(|robot| robot.worker.clone()),
    };
    let wire = WireVersion::default();
    let start = gossip::GossipStart {
        settings: gossip::Settings::new(fleet.fleet.clone(), node.clone(), incarnation).with_timing(fleet.timing),
        knowledge,
        shared: SharedKnowledge::default(),
        bus: bus.clone(),
        clock,
        rng: ChaCha8Rng::from_rng(&mut rng),
        wire_version: wire.clone(),
        signer: notary,
    };
    let (gossip, _) = Gossip::start(start, Some(root.get_cell())).await.map_err(|problem| NodeError::from(*problem))?;
    let allegiance = ClusterMembership::default();
    // Consensus and gossip cross the borders of clusters, to find out about them; nothing else does.
    let bus = Arc::new(ClusterBus::new(bus, keys.clone(), allegiance.clone()));
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
        allegiance,
        wire,
        tasks: Tasks::default(),
    };
    assembly.tell_cluster();
    assembly.follow_wire().await?;
    let coordinator = match assembly.replica.clone() {
        Some(replica) => {
            assembly.keep_to_cluster_of(&replica);
            let coordinator = assembly.start_coordinator(&replica, rng.next_u64()).await?;
            assembly.end_with(&replica);
            let (mobile, on_battery) = (!settings.stationary, !settings.mains_powered);
            let me = BootstrapRequest { mobile, on_battery, node: assembly.node.clone() };
            assembly.found_ledger(replica, me).await?;
            Some(coordinator)
        }
        None => None,
    };
    assembly.open_views(coordinator).await?;
    if let Some(host) = settings.driver_server {
        assembly.start_host(host).await?;
    }
    let robot = match settings.robot {
        Some(part) => Some(assembly.start_robot(part, incarnation, store.checkpoints).await?),
        None => None,
    };
    assembly.finish(robot).await
}

/// Takes part in keeping the ledger, with what `journal` holds.
async fn keep_ledger(
    fleet: &FleetSettings,
    node: &NodeId,
    bus: SharedBus,
    journal: Arc<dyn LogStore>,
    seed: u64,
    observer: Option<SharedObserver>,
) -> Result<Replica<Ledger>, NodeError> {
    let settings = RaftSettings::new(fleet.fleet.clone(), node.clone()).with_timing(fleet.timing);
    let applied = observer.map(|observer| {
        let node = node.clone();
        Arc::new(move |at, commands: &[Command]| observer.on_applied(&node, at, commands)) as ApplyObserver<Ledger>
    });
    Ok(Replica::start_observed(settings, bus, journal, seed, applied).await?)
}

/// A node of which the foundations stand: what all other parts are wired to.
struct Assembly {
    root: ActorRef<NodeMessage>,
    fleet: FleetSettings,
    times: TimingParameters,
    node: NodeId,
    keys: Keys,
    /// On which what concerns missions stays within the node's cluster.
    bus: SharedBus,
    clock: Clock,
    events: EventPublisher,
    replica: Option<Replica<Ledger>>,
    gossip: GossipHandle,
    allegiance: ClusterMembership,
    wire: WireVersion,
    tasks: Tasks,
}

impl Assembly {
    /// What the node has heard.
    fn knowledge(&self) -> SharedKnowledge {
        self.gossip.shared().clone()
    }

    /// Lets others know to which cluster the node belongs.
    fn tell_cluster(&mut self) {
        let gossip = self.gossip.clone();
        let tell = move |own: Option<ClusterId>| gossip.update_with(move |knowledge| knowledge.cluster = own).is_ok();
        self.tasks.spawn(self.allegiance.clone().report_changes(tell));
    }

    /// The node writes the version of the wire that its fleet writes, and ends if it cannot read that.
    async fn follow_wire(&mut self) -> Result<(), NodeError> {
        self.wire.clone().follow_beacons(&self.bus, &self.keys, &mut self.tasks).await?;
        let (wire, root) = (self.wire.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let advice = wire.wait_unsupported().await;
            // A root that has gone needs not be told.
            let _ = root.send_message(NodeMessage::UnsupportedWireVersion(advice));
        });
        Ok(())
    }

    /// The node belongs to the cluster of its own ledger.
    fn keep_to_cluster_of(&mut self, replica: &Replica<Ledger>) {
        let (mut own, allegiance) = (replica.cluster(), self.allegiance.clone());
        self.tasks.spawn(async move {
            loop {
                let cluster = *own.borrow_and_update();
                if let Some(cluster) = cluster {
                    allegiance.set_from_ledger(cluster);
                }
                if own.changed().await.is_err() {
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
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            replica: replica.clone(),
            knowledge: self.knowledge(),
            wire_version: self.wire.clone(),
            events: self.events.clone(),
            ensemble: Arc::clone(&self.fleet.ensemble),
            domain: Arc::clone(&self.fleet.domain),
            limits: self.fleet.limits,
            request_limits: self.fleet.request_limits,
            allocator: Arc::clone(&self.fleet.allocator),
            lease_terms: self.fleet.lease_terms,
            bid_window: self.fleet.bid_window,
            stall_timeout: self.fleet.stall_timeout,
            tick_interval: self.times.beacon_interval,
            cluster_seed,
            voters: self.fleet.voters,
            dead_after: self.fleet.dead_after,
            contact_timeout: self.times.election_max,
        };
        let (coordinator, _) = Actor::spawn_linked(None, Coordinator, settings, self.root.get_cell()).await?;
        Ok(coordinator)
    }

    /// The node ends when its copy of the ledger can no longer be kept.
    fn end_with(&mut self, replica: &Replica<Ledger>) {
        let (watched, root) = (replica.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let problem = watched.wait_failed().await;
            // A root that has gone needs not be told.
            let _ = root.send_message(NodeMessage::LedgerFailed(problem));
        });
    }

    /// Founds the fleet's ledger when it is this node's turn, if there is none.
    async fn found_ledger(&mut self, replica: Replica<Ledger>, me: BootstrapRequest) -> Result<(), NodeError> {
        let asked = self.bus.serve(&self.keys.write(&Key::Bootstrap(self.node.clone()))).await?;
        let bootstrap = Bootstrap {
            me,
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica,
            knowledge: self.knowledge(),
            membership: self.allegiance.clone(),
            expected_nodes: self.fleet.bootstrap_expect,
            target_voters: self.fleet.voters,
            reply_timeout: self.times.auction_window,
        };
        self.tasks.spawn(bootstrap.run(asked));
        Ok(())
    }

    async fn open_views(&mut self, coordinator: Option<ActorRef<CoordinatorMessage>>) -> Result<(), NodeError> {
        let views = Views {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            replica: self.replica.clone(),
            coordinator,
            knowledge: self.knowledge(),
            membership: self.allegiance.clone(),
            ensemble: Arc::clone(&self.fleet.ensemble),
            map: self.fleet.map.clone(),
            beacon_interval: self.times.beacon_interval,
        };
        Ok(views.serve(&mut self.tasks).await?)
    }

    /// Hosts bodies, and speaks for the people beside them.
    async fn start_host(&self, part: DriverServerPart) -> Result<(), NodeError> {
        let host = DriverServerSettings {
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            speed: part.speed,
            publish_interval: Duration::from_millis(500),
            client_timeout: CLIENT_TIMEOUT,
        };
        Actor::spawn_linked(None, DriverServer, (host, part.world), self.root.get_cell()).await?;
        let attendant = HumanTaskProxySettings {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            events: self.events.clone(),
            tick_interval: Duration::from_secs(1),
        };
        Actor::spawn_linked(None, HumanTaskProxy, attendant, self.root.get_cell()).await?;
        Ok(())
    }

    /// Drives a body, and bids.
    async fn start_robot(
        &mut self,
        part: RobotPart,
        incarnation: u64,
        notebook: Arc<dyn CheckpointStore>,
    ) -> Result<ActorRef<RobotMessage>, NodeError> {
        let robot = RobotId::from(self.node.clone());
        let link = DriverClientSettings {
            robot: robot.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            // Twenty bits of goals in each life; a life begins at least a millisecond after the former.
            first_goal: incarnation << 20,
            heartbeat_interval: Duration::from_millis(300),
        };
        let body = RobotDriver::connect(link, &self.root.get_cell()).await?;
        let token = self.bus.announce(&self.keys.write(&Key::AliveRobot(robot.clone()))).await?;
        self.tasks.spawn(async move {
            std::future::pending::<()>().await;
            drop(token);
        });
        let settings = RobotSettings {
            robot,
            incarnation,
            worker: part.worker,
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            events: self.events.clone(),
            knowledge: self.knowledge(),
            gossip: self.gossip.clone(),
            ensemble: Arc::clone(&self.fleet.ensemble),
            limits: self.fleet.limits,
            lease_terms: self.fleet.lease_terms,
            estimator: part.estimator,
            library: part.library,
            driver: body,
            checkpoint_store: notebook,
            task_timeout: TaskTimeout::default(),
            retry_delay: Duration::from_millis(500),
            update_interval: Duration::from_millis(250),
            skill_tick_interval: Duration::from_millis(100),
        };
        let (robot, _) = Actor::spawn_linked(None, Robot, settings, self.root.get_cell()).await?;
        Ok(robot)
    }

    /// The node is ready to be told to leave.
    async fn finish(mut self, robot: Option<ActorRef<RobotMessage>>) -> Result<StartedParts, NodeError> {
        let leaver = Decommission {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica: self.replica.clone(),
            gossip: self.gossip.clone(),
            knowledge: self.knowledge(),
            robot,
            terms: self.fleet.lease_terms,
            times: self.times,
        };
        let (leave, left) = watch::channel(None);
        let asked = self.bus.serve(&self.keys.write(&Key::Leave(self.node))).await?;
        self.tasks.spawn(leave_when_asked(leaver.clone(), asked, leave));
        Ok(StartedParts {
            decommission_handle: leaver,
            decommissioned: left,
            membership: self.allegiance,
            tasks: self.tasks,
        })
    }
}

/// Leaves for good when somebody asks for it, and answers once it has, or why it has not.
async fn leave_when_asked(
    leaver: Decommission,
    mut asked: Stream<Query>,
    left: watch::Sender<Option<DecommissionReport>>,
) {
    while let Some(query) = asked.recv().await {
        match leaver.run().await {
            Ok(farewell) => {
                reply::json(&query, &query.key, &farewell).await;
                left.send_replace(Some(farewell));
                // Whoever runs the node ends it now.
                return;
            }
            Err(problem) => {
                warn!(node = %leaver.node, %problem, "stays");
                reply::json(&query, &query.key, &serde_json::json!({ "error": problem.to_string() })).await;
            }
        }
    }
}
