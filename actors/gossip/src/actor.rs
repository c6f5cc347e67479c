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

use super::gossiper::{Action, Change, Event, Gossiper};
use super::settings::Settings;
use super::shared::SharedKnowledge;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::record_signer::{ProofStatus, SharedRecordSigner};
use consort_bus::wire_version::WireVersion;
use consort_bus::{BusError, Delivery, Encoding, Presence, PresenceToken, Query, Sample, SharedBus, Stream};
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::Knowledge;
use consort_protocol::message::{Exchange, RecordUpdate};
use consort_protocol::units::NodeTime;
use ractor::concurrency::JoinHandle;
use ractor::{Actor, ActorCell, ActorProcessingErr, ActorRef, SpawnErr, async_trait};
use rand_chacha::ChaCha8Rng;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;

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

/// Gossip has stopped. Nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("gossip has stopped")]
pub struct GossipStopped;

/// Handle of a node's gossip.
#[derive(Clone)]
pub struct GossipHandle {
    actor: ActorRef<Message>,
    shared: SharedKnowledge,
}

impl GossipHandle {
    /// Replaces the node's knowledge. It is published at once, unless it is unchanged.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn update(&self, knowledge: Knowledge) -> Result<(), GossipStopped> {
        self.update_with(move |own| *own = knowledge)
    }

    /// Changes a part of the node's knowledge. A record larger than 3 KiB is rejected and logged.
    ///
    /// # Errors
    /// [`GossipStopped`].
    pub fn update_with(&self, change: impl FnOnce(&mut Knowledge) + Send + 'static) -> Result<(), GossipStopped> {
        self.actor.cast(Message::ChangeKnowledge(Box::new(change))).map_err(|_| GossipStopped)
    }

    /// Returns the knowledge received from all nodes.
    pub fn shared(&self) -> &SharedKnowledge {
        &self.shared
    }

    /// Returns the actor, to link, stop or kill it. A stopped actor announces that the node leaves;
    /// a killed actor does not.
    pub fn cell(&self) -> ActorCell {
        self.actor.get_cell()
    }
}

/// Actor that publishes its node's knowledge and receives the knowledge of other nodes. Start it by
/// [`Gossip::start`].
pub struct Gossip;

impl Gossip {
    /// Starts the actor, linked to a supervisor if given. The supervisor is notified of a failure,
    /// for example when the bus closes.
    ///
    /// # Errors
    /// If the bus rejects a declaration.
    pub async fn start(
        start: GossipStart,
        supervisor: Option<ActorCell>,
    ) -> Result<(GossipHandle, JoinHandle<()>), Box<SpawnErr>> {
        let shared = start.shared.clone();
        let (actor, end) = match supervisor {
            Some(supervisor) => Actor::spawn_linked(None, Gossip, start, supervisor).await?,
            None => Actor::spawn(None, Gossip, start).await?,
        };
        Ok((GossipHandle { actor, shared }, end))
    }
}

/// Message to the actor.
#[doc(hidden)]
pub enum Message {
    /// The node's own knowledge changes.
    ChangeKnowledge(Change),
    /// A node published its record.
    RecordReceived(Sample),
    /// A packet of failure detection.
    Packet(Bytes),
    /// A token appeared or vanished.
    Presence(Presence),
    /// A peer compares digests.
    RequestReceived(Query),
    /// A peer replied, refused, or did neither in time.
    ReplyReceived(u64, Option<Result<Bytes, String>>),
    /// A timer has expired.
    TimerFired,
    /// The fleet writes another wire version.
    VersionRaised,
    /// The bus has closed.
    Closed(&'static str),
}

enum Outgoing {
    Publish(String, Bytes),
    Reply(Query, Bytes),
}

/// Capacity of the outbox, in messages.
const OUTBOX: usize = 1024;

#[doc(hidden)]
pub struct State {
    settings: Settings,
    keys: Keys,
    bus: SharedBus,
    clock: Clock,
    wire_version: WireVersion,
    signer: Option<SharedRecordSigner>,
    gossiper: Gossiper,
    shared: SharedKnowledge,
    outbox: mpsc::Sender<Outgoing>,
    alarm: watch::Sender<Option<NodeTime>>,
    /// Aborted when the actor ends for any reason.
    tasks: JoinSet<()>,
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
        forward(&mut tasks, &myself, records, "records", Message::RecordReceived);
        let packets = bus.subscribe(&keys.write(&Key::Swim(node.clone()))).await?;
        forward(&mut tasks, &myself, packets, "packets", |sample: Sample| Message::Packet(sample.payload));
        let queries = bus.serve(&keys.write(&Key::Gossip(node.clone()))).await?;
        forward(&mut tasks, &myself, queries, "queries", Message::RequestReceived);
        let presence = bus.watch(&keys.any_alive_node()).await?;
        forward(&mut tasks, &myself, presence, "tokens", Message::Presence);
        // Announced last: other nodes may query as soon as they receive the token.
        let token = bus.announce(&keys.write(&Key::AliveNode(node))).await?;

        let (outbox, outgoing) = mpsc::channel(OUTBOX);
        tasks.spawn(send(bus.clone(), outgoing, keys.write(&Key::Gossip(settings.node.clone())), shared.clone()));
        let (alarm, alarm_set) = watch::channel(None);
        tasks.spawn(run_alarm(clock, alarm_set, myself.clone()));
        tasks.spawn(forward_version_changes(wire_version.clone(), myself));

        let now = clock.now();
        let (gossiper, actions) =
            Gossiper::new(settings.clone(), knowledge, signer.clone(), rng, &mut shared.lock(), now);
        let mut state = State {
            settings,
            keys,
            bus,
            clock,
            wire_version,
            signer,
            gossiper,
            shared,
            outbox,
            alarm,
            tasks,
            _token: token,
        };
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
        let event = match message {
            Message::ChangeKnowledge(change) => Ok(Event::KnowledgeChanged(change)),
            Message::RecordReceived(sample) => {
                state.read_update(&sample).map(|(owner, update)| Event::Published(owner, update))
            }
            Message::Packet(bytes) => Ok(Event::Packet(bytes)),
            Message::Presence(presence) => match state.keys.read(&presence.key) {
                Some(Key::AliveNode(node)) => Ok(Event::Token(node, presence.alive)),
                _ => Err(format!("key {:?} is not a node's presence token", presence.key)),
            },
            Message::RequestReceived(query) => {
                let exchange = state.read_exchange(&query.payload).map(Event::RequestReceived);
                requester = Some(query);
                exchange
            }
            Message::ReplyReceived(round, Some(Ok(bytes))) => {
                state.read_exchange(&bytes).map(|exchange| Event::ReplyReceived(round, Some(exchange)))
            }
            Message::ReplyReceived(round, Some(Err(refusal))) => {
                tracing::debug!(%refusal, "a peer refused to compare digests");
                Ok(Event::ReplyReceived(round, None))
            }
            Message::ReplyReceived(round, None) => Ok(Event::ReplyReceived(round, None)),
            Message::TimerFired => {
                // The alarm has fired: the next due time must be set again, even if it is the same.
                state.alarm.send_if_modified(|alarm| alarm.take().is_none());
                Ok(Event::TimerFired)
            }
            Message::VersionRaised => {
                Ok(Event::VersionRaised { with_proofs: state.wire_version.get() >= Exchange::SINCE })
            }
            Message::Closed(what) => return Err(format!("the bus closed the stream of {what}").into()),
        };
        let now = state.clock.now();
        let handled = event.and_then(|event| state.gossiper.handle(event, &mut state.shared.lock(), now));
        match handled {
            Ok(actions) => state.perform(actions, requester, Some(&myself)),
            Err(problem) => state.count_malformed(&problem),
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
                Action::Publish(update) => {
                    let key = self.keys.write(&Key::Knowledge(self.settings.node.clone()));
                    self.send(Outgoing::Publish(key, self.encode(update)));
                }
                Action::Send(to, bytes) => {
                    let key = self.keys.write(&Key::Swim(to));
                    self.send(Outgoing::Publish(key, bytes));
                }
                Action::SendReply(exchange) => {
                    if let Some(query) = requester.take() {
                        self.send(Outgoing::Reply(query, self.encode(exchange)));
                    }
                }
                Action::SendRequest(round, peer, exchange) => {
                    if let Some(myself) = myself {
                        let request = self.encode(exchange);
                        self.send_request(round, &peer, request, myself.clone());
                    }
                }
            }
        }
        if self.gossiper.take_changed() {
            self.shared.notify_change();
        }
        let due = self.gossiper.next_due();
        self.alarm.send_if_modified(|alarm| std::mem::replace(alarm, due) != due);
    }

    fn send(&self, outgoing: Outgoing) {
        if self.outbox.try_send(outgoing).is_err() {
            self.shared.lock().counters.unsent += 1;
        }
    }

    fn send_request(&mut self, round: u64, peer: &NodeId, payload: Bytes, myself: ActorRef<Message>) {
        while self.tasks.try_join_next().is_some() {}
        let (bus, key, limit) =
            (self.bus.clone(), self.keys.write(&Key::Gossip(peer.clone())), self.settings.reply_timeout);
        self.tasks.spawn(async move {
            let reply = match bus.query(&key, payload, limit).await {
                Ok(mut replies) => replies.recv().await.map(|reply| reply.payload),
                Err(problem) => Some(Err(problem.to_string())),
            };
            // This fails only after the end of the actor, which also ends this task.
            drop(myself.cast(Message::ReplyReceived(round, reply)));
        });
    }

    fn encode<T: VersionedMessage>(&self, message: T) -> Bytes {
        let bytes = codec::encode_for_version(self.wire_version.get(), message);
        bytes.expect("the size of records and exchanges is limited on creation").into()
    }

    /// Decodes a peer's exchange and removes the records without a valid proof of their owner.
    fn read_exchange(&mut self, bytes: &[u8]) -> Result<Exchange, String> {
        let mut exchange: Exchange = decode(bytes)?;
        let Some(signer) = self.signer.clone() else { return Ok(exchange) };
        // While the fleet writes a version without proofs, proofs cannot be required.
        let with_proofs = self.wire_version.get() >= Exchange::SINCE;
        let known = self.shared.clone();
        exchange.records.retain(|record| {
            // An older record changes nothing, so it is not verified.
            if known.read(|base| base.get(&record.owner).is_some_and(|stored| stored.record.stamp >= record.stamp)) {
                return false;
            }
            match signer.verify(record) {
                ProofStatus::Valid => true,
                ProofStatus::Unproven => !with_proofs,
                ProofStatus::Forged(problem) => {
                    self.count_malformed(&problem);
                    false
                }
            }
        });
        Ok(exchange)
    }

    /// Decodes a published record update, and returns its owner.
    fn read_update(&self, sample: &Sample) -> Result<(NodeId, RecordUpdate), String> {
        let update: RecordUpdate = decode(&sample.payload)?;
        match (self.keys.read(&sample.key), &update) {
            (Some(Key::Knowledge(node)), RecordUpdate::Record(record)) if node != record.owner => {
                Err(format!("record of {} on key {:?}", record.owner, sample.key))
            }
            (Some(Key::Knowledge(node)), _) => Ok((node, update)),
            _ => Err(format!("knowledge on key {:?}", sample.key)),
        }
    }

    /// Counts and logs an unusable message: as a warning when the count has doubled since the last
    /// warning.
    fn count_malformed(&self, problem: &str) {
        let count = {
            let mut known = self.shared.lock();
            known.counters.malformed += 1;
            known.counters.malformed
        };
        if count.is_power_of_two() {
            tracing::warn!(node = %self.settings.node, count, problem, "dropped a malformed message");
        } else {
            tracing::debug!(node = %self.settings.node, count, problem, "dropped a malformed message");
        }
    }
}

fn decode<T: VersionedMessage>(bytes: &[u8]) -> Result<T, String> {
    codec::decode_any_version(bytes).map_err(|e| e.to_string())
}

/// Forwards the items of a bus stream to the mailbox.
fn forward<T: Send + 'static>(
    tasks: &mut JoinSet<()>,
    to: &ActorRef<Message>,
    mut stream: Stream<T>,
    what: &'static str,
    wrap: impl Fn(T) -> Message + Send + 'static,
) {
    let to = to.clone();
    tasks.spawn(async move {
        while let Some(item) = stream.recv().await {
            if to.cast(wrap(item)).is_err() {
                return;
            }
        }
        drop(to.cast(Message::Closed(what)));
    });
}

/// Sends the messages in the outbox, in order.
async fn send(bus: SharedBus, mut outgoing: mpsc::Receiver<Outgoing>, own_key: String, shared: SharedKnowledge) {
    while let Some(message) = outgoing.recv().await {
        let sent: Result<(), BusError> = match message {
            Outgoing::Publish(key, payload) => bus.publish(&key, payload, Encoding::Wire, Delivery::Drop).await,
            Outgoing::Reply(query, payload) => query.replier.reply(&own_key, payload, Encoding::Wire).await,
        };
        if let Err(problem) = sent {
            tracing::debug!(%problem, "failed to send a message");
            shared.lock().counters.unsent += 1;
        }
    }
}

/// Notifies the actor when the fleet writes another wire version.
async fn forward_version_changes(wire: WireVersion, to: ActorRef<Message>) {
    let mut versions = wire.subscribe();
    while versions.changed().await.is_ok() && to.cast(Message::VersionRaised).is_ok() {}
}

/// Sends `TimerFired` at the time that was set last.
async fn run_alarm(clock: Clock, mut alarm: watch::Receiver<Option<NodeTime>>, actor: ActorRef<Message>) {
    loop {
        let due = *alarm.borrow_and_update();
        let expired = match due {
            None => false,
            Some(due) => tokio::select! {
                biased;
                changed = alarm.changed() => match changed {
                    Ok(()) => continue,
                    Err(_) => return,
                },
                () = tokio::time::sleep_until(clock.instant(due)) => true,
            },
        };
        if expired && actor.cast(Message::TimerFired).is_err() {
            return;
        }
        // The due time has been reported; a later change sets the next time.
        if alarm.changed().await.is_err() {
            return;
        }
    }
}
