//! A node: everything that runs in one process of a fleet (or in one place of a virtual one), started in order and
//! watched over together.
//!
//! Each node gossips; each that may vote keeps a copy of the ledger and is ready to coordinate; a robot's node drives a
//! body and bids; one node hosts bodies and attends to people. If any of these actors fails, the node stops: what it
//! promised is in the ledger, and its supervisor (a service manager, a test) starts it anew.

use crate::allegiance::{Allegiance, ClusterBus};
use crate::answer;
use crate::attendant::{Attendant, AttendantSettings};
use crate::autopilot::{Bootstrap, Farewell, LeaveError, Leaver};
use crate::body::{Body, BodyLinkSettings, Host, HostSettings, SILENCE};
use crate::bus::{BusError, Query, SharedBus, Stream};
use crate::clock::Clock;
use crate::coordinator::{Coordinator, CoordinatorSettings, IntakeLimits};
use crate::events::Events;
use crate::gossip::{self, Gossip, GossipHandle, SharedKnowledge};
use crate::observe::SharedObserver;
use crate::replica::{Applied, Replica, ReplicaSettings, StartError};
use crate::robot::{Patience, Robot, RobotMessage, RobotSettings};
use crate::store::{Notebook, Store};
use crate::tasks::Tasks;
use crate::timing::Timing;
use crate::views::Views;
use consort_protocol::auction::{Choice, Limits};
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::{FleetId, NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::{Knowledge, Worker};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{Command, Ledger};
use consort_protocol::message::Founder;
use consort_protocol::mission::Domain;
use consort_skills::actions::BodyHost;
use consort_skills::descriptor::Estimator;
use consort_skills::library::SkillLibrary;
use ractor::{Actor, ActorProcessingErr, ActorRef, SpawnErr, SupervisionEvent};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tracing::{error, warn};

/// What all nodes of a fleet agree on.
#[derive(Clone)]
pub struct FleetSettings {
    /// Its name.
    pub fleet: FleetId,
    /// Whose members are asked for bids.
    pub ensemble: Arc<Ensemble>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// What bids must keep to.
    pub limits: Limits,
    /// What is taken on of all that is asked for.
    pub intake: IntakeLimits,
    /// The rule by which roles are given to robots: [`Exact`](consort_protocol::auction::Exact), but for evaluations.
    pub choice: Arc<dyn Choice>,
    /// How long awards last.
    pub terms: LeaseTerms,
    /// How long an auction waits for a member that does not answer.
    pub window: Duration,
    /// After how long a held role none of whose steps ends, although it waits for nobody, is taken from its holder; zero for
    /// never.
    pub stall_after: Duration,
    /// Nodes that may vote and must have met, and agree on one of them, before it founds the fleet's ledger. If it is not more
    /// than half of all, parts of the fleet that do not hear each other may found one each.
    pub bootstrap_expect: usize,
    /// How fast it notices and reacts.
    pub timing: Timing,
    /// Voters that the autopilot aims at: odd, up to [`crate::autopilot::VOTERS_MAX`].
    pub voters: usize,
    /// How long a voter must be gone until the autopilot replaces it.
    pub dead_after: Duration,
    /// Its map, as it is shown on `view/map`; nothing is decided by it.
    pub map: Option<Arc<Value>>,
}

/// What one node is.
pub struct NodeSettings {
    /// The fleet's settings.
    pub fleet: FleetSettings,
    /// Its name.
    pub node: NodeId,
    /// Which life of the node this is: larger than in any former one.
    pub incarnation: u64,
    /// Where all its chance comes from.
    pub seed: u64,
    /// What it remembers of former lives.
    pub store: Store,
    /// Its clock.
    pub clock: Clock,
    /// Whether it keeps a copy of the ledger and may coordinate.
    pub may_vote: bool,
    /// Whether it stays where it is.
    pub stationary: bool,
    /// Whether it lives on mains power.
    pub mains_powered: bool,
    /// Its robot, if it has one.
    pub robot: Option<RobotPart>,
    /// The bodies and people it hosts, if it does.
    pub host: Option<HostPart>,
    /// Is told what happens on it, in place; none as a rule.
    pub observer: Option<SharedObserver>,
}

/// A robot's part of a node.
pub struct RobotPart {
    /// What it says of itself before its body has reported.
    pub worker: Worker,
    /// Prices its work.
    pub estimator: Arc<Estimator>,
    /// Carries its work out.
    pub library: Arc<SkillLibrary>,
}

/// A host's part of a node.
pub struct HostPart {
    /// The bodies.
    pub world: Box<dyn BodyHost>,
    /// World seconds that pass in one second of node time.
    pub speed: f64,
}

/// Why a node did not start. Nothing of it runs.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The bus is closed, or a key was refused.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The copy of the ledger could not be taken up.
    #[error(transparent)]
    Ledger(#[from] StartError),
    /// An actor could not start.
    #[error("an actor could not start: {0}")]
    Actor(String),
}

impl From<SpawnErr> for NodeError {
    fn from(problem: SpawnErr) -> NodeError {
        NodeError::Actor(problem.to_string())
    }
}

/// A node that runs. Dropping it leaves it running; see [`kill`](NodeHandle::kill), [`stop`](NodeHandle::stop) and
/// [`leave`](NodeHandle::leave).
pub struct NodeHandle {
    /// Its name.
    pub node: NodeId,
    root: ActorRef<NodeMessage>,
    ended: JoinHandle<()>,
    cause: Arc<OnceLock<String>>,
    /// Its copy of the ledger, if it keeps one.
    pub replica: Option<Replica<Ledger>>,
    /// What it has heard.
    pub knowledge: SharedKnowledge,
    /// Which cluster it belongs to.
    pub allegiance: Allegiance,
    /// How it leaves.
    pub leaver: Leaver,
    left: watch::Receiver<Option<Farewell>>,
    tasks: Tasks,
}

impl NodeHandle {
    /// Starts everything that the settings name.
    ///
    /// # Errors
    /// [`NodeError`]; nothing of the node runs then.
    pub async fn start(settings: NodeSettings, bus: SharedBus) -> Result<NodeHandle, NodeError> {
        let cause = Arc::<OnceLock<String>>::default();
        let (root, ended) = Actor::spawn(None, Root { cause: Arc::clone(&cause) }, settings.node.clone()).await?;
        match assemble(settings, bus, &root).await {
            Ok(Assembled { leaver, left, allegiance, tasks }) => Ok(NodeHandle {
                node: leaver.node.clone(),
                root,
                ended,
                cause,
                replica: leaver.replica.clone(),
                knowledge: leaver.knowledge.clone(),
                allegiance,
                leaver,
                left,
                tasks,
            }),
            Err(problem) => {
                root.kill();
                Err(problem)
            }
        }
    }

    /// Ends the node as a crash would: nothing is said to anybody.
    pub async fn kill(mut self) {
        self.tasks = Tasks::default();
        self.leaver.replica = None;
        for child in self.root.get_children() {
            child.kill();
        }
        self.root.kill();
        // It ends in one way or the other; how is of no interest.
        let _ = self.ended.await;
    }

    /// Ends the node for a while: if it coordinates it hands over first, and others are told that it leaves. Its vote, and
    /// its robot's role, wait in its store.
    pub async fn stop(self) {
        self.leaver.step_down().await;
        self.end().await;
    }

    /// Ends the node for good: its robot gives its role back, and its vote is taken over by another or removed.
    ///
    /// # Errors
    /// [`LeaveError`], and the node, which runs on.
    pub async fn leave(self) -> Result<Farewell, (LeaveError, Box<NodeHandle>)> {
        match self.leaver.for_good().await {
            Ok(farewell) => {
                self.end().await;
                Ok(farewell)
            }
            Err(problem) => Err((problem, Box::new(self))),
        }
    }

    /// Waits until the node has left for good because somebody asked it to on `api/leave/{node}`, and is to be
    /// [ended](Self::end); or until it has ended by itself, and says why as [`ended`](Self::ended) does.
    ///
    /// # Errors
    /// Why it ended by itself.
    pub async fn ended_or_left(&mut self) -> Result<Farewell, String> {
        let mut left = self.left.clone();
        tokio::select! {
            cause = self.ended() => Err(cause),
            Ok(farewell) = left.wait_for(Option::is_some) => Ok(farewell.clone().expect("it was waited for")),
        }
    }

    /// Ends the node without handing anything over; others are told that it leaves.
    pub async fn end(mut self) {
        self.tasks = Tasks::default();
        self.leaver.replica = None;
        for child in self.root.get_children() {
            child.stop(None);
        }
        if let Some(replica) = self.replica.take() {
            replica.shutdown().await;
        }
        self.root.stop(None);
        // See above.
        let _ = self.ended.await;
    }

    /// Whether the node has ended by itself: an actor of it failed.
    pub fn has_ended(&self) -> bool {
        self.ended.is_finished()
    }

    /// Waits until the node has ended by itself, and says why: an actor of it failed, or its copy of the ledger did.
    pub async fn ended(&mut self) -> String {
        // See above.
        let _ = (&mut self.ended).await;
        self.cause.get().cloned().unwrap_or_else(|| "nobody said why".to_owned())
    }
}

/// Watches over a node's actors.
struct Root {
    /// Why the node ended by itself, once it has.
    cause: Arc<OnceLock<String>>,
}

enum NodeMessage {
    /// The copy of the ledger can no longer be kept, and why.
    LedgerFailed(String),
}

impl Root {
    fn end(&self, myself: &ActorRef<NodeMessage>, cause: String) {
        for child in myself.get_children() {
            child.kill();
        }
        myself.stop(Some(cause.clone()));
        // The first cause is the one that counts.
        let _ = self.cause.set(cause);
    }
}

#[ractor::async_trait]
impl Actor for Root {
    type Msg = NodeMessage;
    type State = NodeId;
    type Arguments = NodeId;

    async fn pre_start(&self, _: ActorRef<NodeMessage>, node: NodeId) -> Result<NodeId, ActorProcessingErr> {
        Ok(node)
    }

    async fn handle(
        &self,
        myself: ActorRef<NodeMessage>,
        message: NodeMessage,
        node: &mut NodeId,
    ) -> Result<(), ActorProcessingErr> {
        let NodeMessage::LedgerFailed(problem) = message;
        error!(%node, %problem, "the copy of the ledger can no longer be kept: the node stops");
        self.end(&myself, format!("its copy of the ledger can no longer be kept: {problem}"));
        Ok(())
    }

    async fn handle_supervisor_evt(
        &self,
        myself: ActorRef<NodeMessage>,
        event: SupervisionEvent,
        node: &mut NodeId,
    ) -> Result<(), ActorProcessingErr> {
        if let SupervisionEvent::ActorFailed(who, problem) = event {
            error!(%node, actor = %who.get_id(), %problem, "an actor failed: the node stops");
            self.end(&myself, format!("an actor of it failed, as the log says: {problem}"));
        }
        Ok(())
    }
}

struct Assembled {
    leaver: Leaver,
    left: watch::Receiver<Option<Farewell>>,
    allegiance: Allegiance,
    tasks: Tasks,
}

async fn assemble(
    settings: NodeSettings,
    bus: SharedBus,
    root: &ActorRef<NodeMessage>,
) -> Result<Assembled, NodeError> {
    let NodeSettings { fleet, node, incarnation, seed, store, clock, observer, .. } = settings;
    let keys = Keys::new(&fleet.fleet);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut tasks = Tasks::default();
    let events = Events::open(node.clone(), &keys, bus.clone(), clock, observer.clone());

    let replica = if settings.may_vote {
        let replica_settings = ReplicaSettings::new(fleet.fleet.clone(), node.clone()).with_timing(fleet.timing);
        let applied = observer.map(|observer| {
            let node = node.clone();
            Arc::new(move |at, commands: &[Command]| observer.applied(&node, at, commands)) as Applied<Ledger>
        });
        let (bus, seed) = (bus.clone(), rng.next_u64());
        Some(Replica::start_observed(replica_settings, bus, store.journal, seed, applied).await?)
    } else {
        None
    };

    let knowledge = Knowledge {
        may_vote: settings.may_vote,
        stationary: settings.stationary,
        mains_powered: settings.mains_powered,
        replica: replica.as_ref().map(|replica| replica.id().0),
        cluster: None,
        leaving: false,
        worker: settings.robot.as_ref().map(|robot| robot.worker.clone()),
    };
    let shared = SharedKnowledge::default();
    let start = gossip::Start {
        settings: gossip::Settings::new(fleet.fleet.clone(), node.clone(), incarnation).with_timing(fleet.timing),
        knowledge,
        shared: shared.clone(),
        bus: bus.clone(),
        clock,
        rng: ChaCha8Rng::from_rng(&mut rng),
    };
    let supervisor = root.get_cell();
    let (gossip, _) =
        Gossip::start(start, Some(supervisor.clone())).await.map_err(|problem| NodeError::from(*problem))?;

    let allegiance = Allegiance::default();
    // Consensus and gossip cross the borders of clusters, to find out about them; nothing else does.
    let bus: SharedBus = Arc::new(ClusterBus::new(bus, keys.clone(), allegiance.clone()));
    let told = gossip.clone();
    tasks.spawn(
        allegiance.clone().follow(move |own| told.update_with(move |knowledge| knowledge.cluster = own).is_ok()),
    );
    let times = fleet.timing.times();

    let mut own_coordinator = None;
    if let Some(replica) = &replica {
        let (mut own, sworn) = (replica.cluster(), allegiance.clone());
        tasks.spawn(async move {
            loop {
                let cluster = *own.borrow_and_update();
                if let Some(cluster) = cluster {
                    sworn.keep(cluster);
                }
                if own.changed().await.is_err() {
                    return;
                }
            }
        });
        let coordinator = CoordinatorSettings {
            node: node.clone(),
            keys: keys.clone(),
            bus: bus.clone(),
            clock,
            replica: replica.clone(),
            knowledge: shared.clone(),
            events: events.clone(),
            ensemble: Arc::clone(&fleet.ensemble),
            domain: Arc::clone(&fleet.domain),
            limits: fleet.limits,
            intake: fleet.intake,
            choice: Arc::clone(&fleet.choice),
            terms: fleet.terms,
            window: fleet.window,
            stall_after: fleet.stall_after,
            beat: times.beacon,
            cluster_seed: rng.next_u64(),
            voters: fleet.voters,
            dead_after: fleet.dead_after,
            near: times.election_max,
        };
        let (started, _) = Actor::spawn_linked(None, Coordinator, coordinator, supervisor.clone()).await?;
        own_coordinator = Some(started);
        let (watched, root) = (replica.clone(), root.clone());
        tasks.spawn(async move {
            let problem = watched.failed().await;
            // A root that has gone needs not be told.
            let _ = root.send_message(NodeMessage::LedgerFailed(problem));
        });
        let asked = bus.serve(&keys.write(&Key::Found(node.clone()))).await?;
        let bootstrap = Bootstrap {
            me: Founder { mobile: !settings.stationary, on_battery: !settings.mains_powered, node: node.clone() },
            keys: keys.clone(),
            bus: bus.clone(),
            replica: replica.clone(),
            knowledge: shared.clone(),
            allegiance: allegiance.clone(),
            expect: fleet.bootstrap_expect,
            target: fleet.voters,
            answers_within: times.window,
        };
        tasks.spawn(bootstrap.run(asked));
    }

    let views = Views {
        node: node.clone(),
        keys: keys.clone(),
        bus: bus.clone(),
        clock,
        replica: replica.clone(),
        coordinator: own_coordinator,
        knowledge: shared.clone(),
        allegiance: allegiance.clone(),
        ensemble: Arc::clone(&fleet.ensemble),
        map: fleet.map.clone(),
        beat: times.beacon,
    };
    views.open(&mut tasks).await?;

    if let Some(host) = settings.host {
        let host_settings = HostSettings {
            keys: keys.clone(),
            bus: bus.clone(),
            clock,
            speed: host.speed,
            beat: Duration::from_millis(500),
            silence: SILENCE,
        };
        Actor::spawn_linked(None, Host, (host_settings, host.world), supervisor.clone()).await?;
        let attendant = AttendantSettings {
            node: node.clone(),
            keys: keys.clone(),
            bus: bus.clone(),
            events: events.clone(),
            beat: Duration::from_secs(1),
        };
        Actor::spawn_linked(None, Attendant, attendant, supervisor.clone()).await?;
    }

    let mut robot = None;
    if let Some(part) = settings.robot {
        let started = start_robot(
            part,
            RobotId::from(node.clone()),
            incarnation,
            &fleet,
            &keys,
            bus.clone(),
            clock,
            events,
            gossip.clone(),
            store.notebook,
            &supervisor,
            &mut tasks,
        )
        .await?;
        robot = Some(started);
    }
    let leaver = Leaver {
        node: node.clone(),
        keys: keys.clone(),
        bus: bus.clone(),
        replica,
        gossip,
        knowledge: shared,
        robot,
        terms: fleet.terms,
        times,
    };
    let (leave, left) = watch::channel(None);
    let asked = bus.serve(&keys.write(&Key::Leave(node))).await?;
    tasks.spawn(leave_when_asked(leaver.clone(), asked, leave));
    Ok(Assembled { leaver, left, allegiance, tasks })
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

#[expect(clippy::too_many_arguments, reason = "the parts of a node that a robot is wired to, once")]
async fn start_robot(
    part: RobotPart,
    robot: RobotId,
    incarnation: u64,
    fleet: &FleetSettings,
    keys: &Keys,
    bus: SharedBus,
    clock: Clock,
    events: Events,
    gossip: GossipHandle,
    notebook: Arc<dyn Notebook>,
    supervisor: &ractor::ActorCell,
    tasks: &mut Tasks,
) -> Result<ActorRef<RobotMessage>, NodeError> {
    let link = BodyLinkSettings {
        robot: robot.clone(),
        keys: keys.clone(),
        bus: bus.clone(),
        // Twenty bits of goals in each life; a life begins at least a millisecond after the former.
        first_goal: incarnation << 20,
        beat: Duration::from_millis(300),
    };
    let body = Body::link(link, supervisor).await?;
    let token = bus.announce(&keys.write(&Key::AliveRobot(robot.clone()))).await?;
    tasks.spawn(async move {
        std::future::pending::<()>().await;
        drop(token);
    });
    let settings = RobotSettings {
        robot,
        incarnation,
        worker: part.worker,
        keys: keys.clone(),
        bus,
        clock,
        events,
        knowledge: gossip.shared().clone(),
        gossip,
        ensemble: Arc::clone(&fleet.ensemble),
        limits: fleet.limits,
        terms: fleet.terms,
        estimator: part.estimator,
        library: part.library,
        body,
        notebook,
        patience: Patience::default(),
        pause: Duration::from_millis(500),
        beat: Duration::from_millis(250),
        tick: Duration::from_millis(100),
    };
    let (robot, _) = Actor::spawn_linked(None, Robot, settings, supervisor.clone()).await?;
    Ok(robot)
}
