//! A node put together: its parts are started in an order in which each finds those that it needs.

use super::handle::NodeError;
use super::root::NodeMessage;
use super::settings::{FleetSettings, HostPart, NodeSettings, RobotPart};
use crate::allegiance::{Allegiance, ClusterBus};
use crate::answer;
use crate::attendant::{Attendant, AttendantSettings};
use crate::autopilot::{Bootstrap, Farewell, Leaver};
use crate::body::{Body, BodyLinkSettings, Host, HostSettings, SILENCE};
use crate::bus::{Query, SharedBus, Stream};
use crate::clock::Clock;
use crate::coordinator::{Coordinator, CoordinatorMessage, CoordinatorSettings};
use crate::events::Events;
use crate::gossip::{self, Gossip, GossipHandle, SharedKnowledge};
use crate::observe::SharedObserver;
use crate::replica::{Applied, Journal, Replica, ReplicaSettings};
use crate::robot::{Patience, Robot, RobotMessage, RobotSettings};
use crate::store::Notebook;
use crate::tasks::Tasks;
use crate::timing::Times;
use crate::views::Views;
use crate::wire::Wire;
use consort_protocol::ids::{ClusterId, NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::ledger::{Command, Ledger};
use consort_protocol::message::Founder;
use consort_protocol::versions::Versions;
use ractor::{Actor, ActorRef};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tracing::warn;

/// What a handle needs of a node that was put together.
pub(super) struct Assembled {
    pub(super) leaver: Leaver,
    pub(super) left: watch::Receiver<Option<Farewell>>,
    pub(super) allegiance: Allegiance,
    pub(super) tasks: Tasks,
}

/// Starts all parts of a node, as children of `root`. If one does not start, whoever asked ends the others with the root.
pub(super) async fn assemble(
    settings: NodeSettings,
    bus: SharedBus,
    root: &ActorRef<NodeMessage>,
) -> Result<Assembled, NodeError> {
    let NodeSettings { fleet, node, incarnation, seed, store, clock, notary, observer, .. } = settings;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let keys = Keys::new(&fleet.fleet);
    let events = Events::open(node.clone(), &keys, bus.clone(), clock, observer.clone());
    let replica = match settings.may_vote {
        true => Some(keep_ledger(&fleet, &node, bus.clone(), store.journal, rng.next_u64(), observer).await?),
        false => None,
    };
    let knowledge = Knowledge {
        may_vote: settings.may_vote,
        stationary: settings.stationary,
        mains_powered: settings.mains_powered,
        replica: replica.as_ref().map(|replica| replica.id().0),
        cluster: None,
        leaving: false,
        speaks: Versions::OWN,
        worker: settings.robot.as_ref().map(|robot| robot.worker.clone()),
    };
    let wire = Wire::default();
    let start = gossip::Start {
        settings: gossip::Settings::new(fleet.fleet.clone(), node.clone(), incarnation).with_timing(fleet.timing),
        knowledge,
        shared: SharedKnowledge::default(),
        bus: bus.clone(),
        clock,
        rng: ChaCha8Rng::from_rng(&mut rng),
        wire: wire.clone(),
        notary,
    };
    let (gossip, _) = Gossip::start(start, Some(root.get_cell())).await.map_err(|problem| NodeError::from(*problem))?;
    let allegiance = Allegiance::default();
    // Consensus and gossip cross the borders of clusters, to find out about them; nothing else does.
    let bus = Arc::new(ClusterBus::new(bus, keys.clone(), allegiance.clone()));
    let mut assembly = Assembly {
        root: root.clone(),
        times: fleet.timing.times(),
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
            let me = Founder { mobile, on_battery, node: assembly.node.clone() };
            assembly.found_ledger(replica, me).await?;
            Some(coordinator)
        }
        None => None,
    };
    assembly.open_views(coordinator).await?;
    if let Some(host) = settings.host {
        assembly.start_host(host).await?;
    }
    let robot = match settings.robot {
        Some(part) => Some(assembly.start_robot(part, incarnation, store.notebook).await?),
        None => None,
    };
    assembly.finish(robot).await
}

/// Takes part in keeping the ledger, with what `journal` holds.
async fn keep_ledger(
    fleet: &FleetSettings,
    node: &NodeId,
    bus: SharedBus,
    journal: Arc<dyn Journal>,
    seed: u64,
    observer: Option<SharedObserver>,
) -> Result<Replica<Ledger>, NodeError> {
    let settings = ReplicaSettings::new(fleet.fleet.clone(), node.clone()).with_timing(fleet.timing);
    let applied = observer.map(|observer| {
        let node = node.clone();
        Arc::new(move |at, commands: &[Command]| observer.applied(&node, at, commands)) as Applied<Ledger>
    });
    Ok(Replica::start_observed(settings, bus, journal, seed, applied).await?)
}

/// A node of which the foundations stand: what all other parts are wired to.
struct Assembly {
    root: ActorRef<NodeMessage>,
    fleet: FleetSettings,
    times: Times,
    node: NodeId,
    keys: Keys,
    /// On which what concerns missions stays within the node's cluster.
    bus: SharedBus,
    clock: Clock,
    events: Events,
    replica: Option<Replica<Ledger>>,
    gossip: GossipHandle,
    allegiance: Allegiance,
    wire: Wire,
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
        self.tasks.spawn(self.allegiance.clone().follow(tell));
    }

    /// The node writes the version of the wire that its fleet writes, and ends if it cannot read that.
    async fn follow_wire(&mut self) -> Result<(), NodeError> {
        self.wire.clone().follow(&self.bus, &self.keys, &mut self.tasks).await?;
        let (wire, root) = (self.wire.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let advice = wire.left_behind().await;
            // A root that has gone needs not be told.
            let _ = root.send_message(NodeMessage::LeftBehind(advice));
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
                    allegiance.keep(cluster);
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
            wire: self.wire.clone(),
            events: self.events.clone(),
            ensemble: Arc::clone(&self.fleet.ensemble),
            domain: Arc::clone(&self.fleet.domain),
            limits: self.fleet.limits,
            intake: self.fleet.intake,
            choice: Arc::clone(&self.fleet.choice),
            terms: self.fleet.terms,
            window: self.fleet.window,
            stall_after: self.fleet.stall_after,
            beat: self.times.beacon,
            cluster_seed,
            voters: self.fleet.voters,
            dead_after: self.fleet.dead_after,
            near: self.times.election_max,
        };
        let (coordinator, _) = Actor::spawn_linked(None, Coordinator, settings, self.root.get_cell()).await?;
        Ok(coordinator)
    }

    /// The node ends when its copy of the ledger can no longer be kept.
    fn end_with(&mut self, replica: &Replica<Ledger>) {
        let (watched, root) = (replica.clone(), self.root.clone());
        self.tasks.spawn(async move {
            let problem = watched.failed().await;
            // A root that has gone needs not be told.
            let _ = root.send_message(NodeMessage::LedgerFailed(problem));
        });
    }

    /// Founds the fleet's ledger when it is this node's turn, if there is none.
    async fn found_ledger(&mut self, replica: Replica<Ledger>, me: Founder) -> Result<(), NodeError> {
        let asked = self.bus.serve(&self.keys.write(&Key::Found(self.node.clone()))).await?;
        let bootstrap = Bootstrap {
            me,
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica,
            knowledge: self.knowledge(),
            allegiance: self.allegiance.clone(),
            expect: self.fleet.bootstrap_expect,
            target: self.fleet.voters,
            answers_within: self.times.window,
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
            allegiance: self.allegiance.clone(),
            ensemble: Arc::clone(&self.fleet.ensemble),
            map: self.fleet.map.clone(),
            beat: self.times.beacon,
        };
        Ok(views.open(&mut self.tasks).await?)
    }

    /// Hosts bodies, and speaks for the people beside them.
    async fn start_host(&self, part: HostPart) -> Result<(), NodeError> {
        let host = HostSettings {
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            clock: self.clock,
            speed: part.speed,
            beat: Duration::from_millis(500),
            silence: SILENCE,
        };
        Actor::spawn_linked(None, Host, (host, part.world), self.root.get_cell()).await?;
        let attendant = AttendantSettings {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            events: self.events.clone(),
            beat: Duration::from_secs(1),
        };
        Actor::spawn_linked(None, Attendant, attendant, self.root.get_cell()).await?;
        Ok(())
    }

    /// Drives a body, and bids.
    async fn start_robot(
        &mut self,
        part: RobotPart,
        incarnation: u64,
        notebook: Arc<dyn Notebook>,
    ) -> Result<ActorRef<RobotMessage>, NodeError> {
        let robot = RobotId::from(self.node.clone());
        let link = BodyLinkSettings {
            robot: robot.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            // Twenty bits of goals in each life; a life begins at least a millisecond after the former.
            first_goal: incarnation << 20,
            beat: Duration::from_millis(300),
        };
        let body = Body::link(link, &self.root.get_cell()).await?;
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
            terms: self.fleet.terms,
            estimator: part.estimator,
            library: part.library,
            body,
            notebook,
            patience: Patience::default(),
            pause: Duration::from_millis(500),
            beat: Duration::from_millis(250),
            tick: Duration::from_millis(100),
        };
        let (robot, _) = Actor::spawn_linked(None, Robot, settings, self.root.get_cell()).await?;
        Ok(robot)
    }

    /// The node is ready to be told to leave.
    async fn finish(mut self, robot: Option<ActorRef<RobotMessage>>) -> Result<Assembled, NodeError> {
        let leaver = Leaver {
            node: self.node.clone(),
            keys: self.keys.clone(),
            bus: self.bus.clone(),
            replica: self.replica.clone(),
            gossip: self.gossip.clone(),
            knowledge: self.knowledge(),
            robot,
            terms: self.fleet.terms,
            times: self.times,
        };
        let (leave, left) = watch::channel(None);
        let asked = self.bus.serve(&self.keys.write(&Key::Leave(self.node))).await?;
        self.tasks.spawn(leave_when_asked(leaver.clone(), asked, leave));
        Ok(Assembled { leaver, left, allegiance: self.allegiance, tasks: self.tasks })
    }
}

/// Leaves for good when somebody asks for it, and answers once it has, or why it has not.
async fn leave_when_asked(leaver: Leaver, mut asked: Stream<Query>, left: watch::Sender<Option<Farewell>>) {
    while let Some(query) = asked.recv().await {
        match leaver.for_good().await {
            Ok(farewell) => {
                answer::json(&query, &query.key, &farewell).await;
                left.send_replace(Some(farewell));
                // Whoever runs the node ends it now.
                return;
            }
            Err(problem) => {
                warn!(node = %leaver.node, %problem, "stays");
                answer::json(&query, &query.key, &serde_json::json!({ "error": problem.to_string() })).await;
            }
        }
    }
}
