//! The actor around [`Gossiper`]: its mailbox, its timer and its declarations on the bus. It makes
//! no decisions.
//!
//! ```text
//!  bus streams ─▶ forwarders ─▶ mailbox ─▶ Gossiper ─▶ actions ─┬▶ outbox ─▶ bus
//!                   alarm ────────┘  ▲                          └▶ a task per request
//!                                    └──────── reply ─────────────────┘
//! ```
//!
//! The mailbox never waits for the bus. If the bus stalls, the outbox fills and then drops further
//! messages. All of them are repeated or repaired.

use super::alarm::Alarm;
use super::gossiper::{Action, Change, Event, Gossiper, GossiperStart};
use super::inbox::Inbox;
use super::outbox::Outbox;
use super::settings::Settings;
use super::shared::SharedKnowledge;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::record_signer::SharedRecordSigner;
use consort_bus::tasks::{Forwarded, forward_queries, forward_samples};
use consort_bus::wire_version::WireVersion;
use consort_bus::{Delivery, Encoding, Presence, PresenceToken, Query, Sample, SharedBus};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::{Knowledge, Motion};
use ractor::{Actor, ActorProcessingErr, ActorRef, async_trait};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::task::{AbortHandle, JoinSet};

/// Initial state of a node's gossip.
pub struct GossipStart {
    /// Identity and intervals.
    pub settings: Settings,
    /// Knowledge to publish.
    pub knowledge: Knowledge,
    /// Storage for received knowledge: new, or taken over from a failed actor.
    pub shared: SharedKnowledge,
    /// Bus to use.
    pub bus: SharedBus,
    /// Clock of the node.
    pub clock: Clock,
    /// Source of all randomness.
    pub rng: ChaCha8Rng,
    /// Wire version to write.
    pub wire_version: WireVersion,
    /// Signer of the own record and verifier of forwarded records, if the fleet has certificates.
    pub signer: Option<SharedRecordSigner>,
}

/// Actor that publishes its node's knowledge and receives the knowledge of other nodes.
pub(super) struct Gossip;

/// Message to the actor.
pub(super) enum Message {
    /// The node's own knowledge changes.
    ChangeKnowledge(Change),
    /// The node's robot moves, or its charge changes.
    MoveRobot(Motion),
    /// The node receives the motion of robots from now on, or no longer.
    ReceiveMotion(bool),
    /// A node published the motion of its robot.
    MotionReceived(Forwarded<Sample>),
    /// A node published its record.
    RecordReceived(Forwarded<Sample>),
    /// A packet of failure detection.
    Packet(Forwarded<Sample>),
    /// A token appeared or vanished.
    Presence(Forwarded<Presence>),
    /// A peer compares digests.
    RequestReceived(Query),
    /// A peer replied; `None` if it refused, or did not reply in time.
    ReplyReceived(u64, Option<Bytes>),
    /// A timer has expired.
    TimerFired,
    /// The fleet writes another wire version.
    VersionRaised,
    /// The bus has closed.
    Closed(&'static str),
}

/// State of the actor.
pub(super) struct State {
    keys: Keys,
    bus: SharedBus,
    clock: Clock,
    reply_timeout: Duration,
    gossiper: Gossiper,
    shared: SharedKnowledge,
    inbox: Inbox,
    outbox: Outbox,
    alarm: Alarm,
    /// Aborted when the actor ends for any reason.
    tasks: JoinSet<()>,
    /// Task that receives the motion of robots.
    motion: Option<AbortHandle>,
    _token: PresenceToken,
}

#[async_trait]
impl Actor for Gossip {
    type Msg = Message;
    type State = State;
    type Arguments = GossipStart;

    async fn pre_start(&self, myself: ActorRef<Message>, start: GossipStart) -> Result<State, ActorProcessingErr> {
        let GossipStart { settings, knowledge, shared, bus, clock, rng, wire_version, signer } = start;
        let keys = Keys::new(&settings.fleet);
        let mut tasks = JoinSet::new();
        let node = settings.node.clone();

        let records = bus.subscribe(&keys.any_knowledge()).await?;
        forward(&mut tasks, &myself, "records", forward_samples(records, myself.clone(), Message::RecordReceived));
        let packets = bus.subscribe(&keys.write(&Key::Swim(node.clone()))).await?;
        forward(&mut tasks, &myself, "packets", forward_samples(packets, myself.clone(), Message::Packet));
        let queries = bus.serve(&keys.write(&Key::Gossip(node.clone()))).await?;
        forward(&mut tasks, &myself, "queries", forward_queries(queries, myself.clone(), Message::RequestReceived));
        let presence = bus.watch(&keys.any_alive_node()).await?;
        forward(&mut tasks, &myself, "tokens", forward_samples(presence, myself.clone(), Message::Presence));
        // Announced last: other nodes may query as soon as they receive the token.
        let token = bus.announce(&keys.write(&Key::AliveNode(node))).await?;

        let (outbox, sending) =
            Outbox::new(settings.node.clone(), keys.clone(), wire_version.clone(), shared.clone(), bus.clone());
        tasks.spawn(sending);
        let to = myself.clone();
        let (alarm, running) = Alarm::new(clock, move || to.cast(Message::TimerFired).is_ok());
        tasks.spawn(running);
        tasks.spawn(forward_version_changes(wire_version, myself.clone()));

        let (now, reply_timeout, receives_motion) = (clock.now(), settings.reply_timeout, settings.receives_motion);
        let inbox =
            Inbox { node: settings.node.clone(), keys: keys.clone(), signer: signer.clone(), shared: shared.clone() };
        let start = GossiperStart { settings, knowledge, signer, rng };
        let (gossiper, actions) = Gossiper::new(start, &mut shared.lock(), now);
        let mut state = State {
            keys,
            bus,
            clock,
            reply_timeout,
            gossiper,
            shared,
            inbox,
            outbox,
            alarm,
            tasks,
            motion: None,
            _token: token,
        };
        state.receive_motion(receives_motion, &myself);
        state.perform(actions, None, None);
        Ok(state)
    }

    async fn handle(
        &self,
        myself: ActorRef<Message>,
        message: Message,
        state: &mut State,
    ) -> Result<(), ActorProcessingErr> {
        let mut requester = None;
        let inbox = &state.inbox;
        let event = match message {
            Message::ChangeKnowledge(change) => Ok(Event::KnowledgeChanged(change)),
            Message::MoveRobot(motion) => Ok(Event::MotionChanged(motion)),
            Message::ReceiveMotion(receives) => {
                state.receive_motion(receives, &myself);
                return Ok(());
            }
            Message::MotionReceived(sample) => inbox.read_motion(&sample),
            Message::RecordReceived(sample) => inbox.read_update(&sample),
            Message::Packet(sample) => inbox.read_packet(sample.into_inner()),
            Message::Presence(presence) => inbox.read_presence(presence.into_inner()),
            Message::RequestReceived(query) => {
                let exchange = inbox.read_exchange(&query.payload).map(Event::RequestReceived);
                requester = Some(query);
                exchange
            }
            Message::ReplyReceived(round, Some(bytes)) => {
                inbox.read_exchange(&bytes).map(|exchange| Event::ReplyReceived(round, Some(exchange)))
            }
            Message::ReplyReceived(round, None) => Ok(Event::ReplyReceived(round, None)),
            Message::TimerFired => {
                state.alarm.reset();
                Ok(Event::TimerFired)
            }
            Message::VersionRaised => Ok(Event::VersionRaised),
            Message::Closed(what) => return Err(format!("the bus closed the stream of {what}").into()),
        };
        let now = state.clock.now();
        let handled = event.and_then(|event| Ok(state.gossiper.handle(event, &mut state.shared.lock(), now)?));
        match handled {
            Ok(actions) => state.perform(actions, requester, Some(&myself)),
            Err(problem) => state.inbox.count_malformed(&problem),
        }
        Ok(())
    }

    async fn post_stop(&self, _: ActorRef<Message>, state: &mut State) -> Result<(), ActorProcessingErr> {
        // The outbox ends with the actor, so these messages do not pass through it.
        for action in state.gossiper.leave() {
            if let Action::Send(to, bytes) = action {
                state.bus.publish(&state.keys.write(&Key::Swim(to)), bytes, Encoding::Wire, Delivery::Drop).await?;
            }
        }
        Ok(())
    }
}

impl State {
    fn perform(&mut self, actions: Vec<Action>, mut requester: Option<Query>, myself: Option<&ActorRef<Message>>) {
        for action in actions {
            match action {
                Action::Publish(update) => self.outbox.publish(update),
                Action::PublishMotion(update) => self.outbox.publish_motion(&update),
                Action::Send(to, bytes) => self.outbox.send(to, bytes),
                Action::SendReply(exchange) => {
                    if let Some(query) = requester.take() {
                        self.outbox.reply(query, exchange);
                    }
                }
                Action::SendRequest(round, peer, exchange) => {
                    if let Some(myself) = myself {
                        let request = self.outbox.encode(exchange);
                        self.send_request(round, &peer, request, myself.clone());
                    }
                }
            }
        }
        if self.gossiper.take_changed() {
            self.shared.notify_change();
        }
        self.alarm.set(self.gossiper.next_due());
    }

    /// Subscribes to the motion of robots, or ends the subscription.
    fn receive_motion(&mut self, receives: bool, myself: &ActorRef<Message>) {
        if receives == self.motion.is_some() {
            return;
        }
        self.shared.lock().receives_motion = receives;
        if let Some(task) = self.motion.take() {
            return task.abort();
        }
        let (bus, key, to) = (self.bus.clone(), self.keys.any_motion(), myself.clone());
        self.motion = Some(self.tasks.spawn(async move {
            if let Ok(samples) = bus.subscribe(&key).await {
                forward_samples(samples, to.clone(), Message::MotionReceived).await;
            }
            // The bus is closed.
            drop(to.cast(Message::Closed("motion")));
        }));
    }

    fn send_request(&mut self, round: u64, peer: &NodeId, payload: Bytes, myself: ActorRef<Message>) {
        while self.tasks.try_join_next().is_some() {}
        let (bus, key, limit) = (self.bus.clone(), self.keys.write(&Key::Gossip(peer.clone())), self.reply_timeout);
        self.tasks.spawn(async move {
            let reply = request_exchange(&bus, &key, payload, limit).await;
            // This fails only after the end of the actor, which also ends this task.
            drop(myself.cast(Message::ReplyReceived(round, reply)));
        });
    }
}

/// Queries a peer. Returns `None` if the peer refuses, or does not reply in time.
async fn request_exchange(bus: &SharedBus, key: &str, payload: Bytes, limit: Duration) -> Option<Bytes> {
    let refusal = match bus.query(key, payload, limit).await {
        Ok(mut replies) => match replies.recv().await?.payload {
            Ok(bytes) => return Some(bytes),
            Err(refused) => refused.to_string(),
        },
        Err(problem) => problem.to_string(),
    };
    tracing::debug!(%refusal, "a peer refused to compare digests");
    None
}

/// Runs the forwarding of a bus stream to the mailbox, and notifies the actor of its end.
fn forward(
    tasks: &mut JoinSet<()>,
    to: &ActorRef<Message>,
    what: &'static str,
    forwarding: impl Future<Output = ()> + Send + 'static,
) {
    let to = to.clone();
    tasks.spawn(async move {
        forwarding.await;
        drop(to.cast(Message::Closed(what)));
    });
}

/// Notifies the actor when the fleet writes another wire version.
async fn forward_version_changes(wire: WireVersion, to: ActorRef<Message>) {
    let mut versions = wire.subscribe();
    while versions.changed().await.is_ok() && to.cast(Message::VersionRaised).is_ok() {}
}
