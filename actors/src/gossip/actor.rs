//! The actor around [`Gossiper`]: its mailbox, its timer and its share of the bus. It decides nothing.
//!
//! ```text
//!  bus streams ─▶ forwarders ─▶ mailbox ─▶ Gossiper ─▶ actions ─┬▶ outbox ─▶ bus
//!                   alarm ────────┘  ▲                          └▶ a task per question asked
//!                                    └──────── answer ─────────────────┘
//! ```
//!
//! Nothing is awaited on the bus within the mailbox: a bus that stalls holds up the outbox, which then drops what does
//! not fit. All of it repeats or is repaired.

use super::gossiper::{Action, Change, Event, Gossiper};
use super::record_signer::{ProofStatus, SharedRecordSigner};
use super::settings::Settings;
use super::shared::SharedKnowledge;
use crate::bus::{BusError, Delivery, Encoding, Presence, PresenceToken, Query, Sample, SharedBus, Stream};
use crate::clock::Clock;
use crate::wire_version::WireVersion;
use bytes::Bytes;
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

/// All that a node's gossip begins with.
pub struct GossipStart {
    /// Who it is, and how often it speaks.
    pub settings: Settings,
    /// What it says of itself.
    pub knowledge: Knowledge,
    /// Where it keeps what it hears: a new one, or that of the actor in whose place it is started.
    pub shared: SharedKnowledge,
    /// How it speaks.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// Where all chance comes from.
    pub rng: ChaCha8Rng,
    /// Which version of the wire it writes.
    pub wire_version: WireVersion,
    /// Who signs what it says of itself and judges what others hand on, where the fleet has certificates.
    pub signer: Option<SharedRecordSigner>,
}

/// Gossip has stopped: nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("gossip has stopped")]
pub struct GossipStopped;

/// The way to a node's gossip.
#[derive(Clone)]
pub struct GossipHandle {
    actor: ActorRef<Message>,
    shared: SharedKnowledge,
}

impl GossipHandle {
    /// What the node says of itself is now this. Others hear of it at once, unless it is what it said already.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn update(&self, knowledge: Knowledge) -> Result<(), GossipStopped> {
        self.update_with(move |own| *own = knowledge)
    }

    /// Changes a part of what the node says of itself. A record beyond 3 KiB is not taken; that is logged.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn update_with(&self, change: impl FnOnce(&mut Knowledge) + Send + 'static) -> Result<(), GossipStopped> {
        self.actor.cast(Message::Change(Box::new(change))).map_err(|_| GossipStopped)
    }

    /// What the node has heard.
    pub fn shared(&self) -> &SharedKnowledge {
        &self.shared
    }

    /// The actor, to link, stop or kill it. Stopped, it tells others that the node leaves; killed, it does not.
    pub fn cell(&self) -> ActorCell {
        self.actor.get_cell()
    }
}

/// The actor which tells others what its node knows and hears what they know. Start it by [`Gossip::start`].
pub struct Gossip;

impl Gossip {
    /// Starts it, linked to a supervisor if there is one: that hears when it fails, as it does when the bus closes.
    ///
    /// # Errors
    /// When the bus refuses a declaration.
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

/// What reaches the mailbox.
#[doc(hidden)]
pub enum Message {
    /// The node's own knowledge changes.
    Change(Change),
    /// A node said something of itself.
    Knowledge(Sample),
    /// A packet of failure detection.
    Packet(Bytes),
    /// A token appeared or vanished.
    Presence(Presence),
    /// A peer compares digests.
    Asked(Query),
    /// A peer answered, refused, or did neither in time.
    Answered(u64, Option<Result<Bytes, String>>),
    /// Something is due.
    Woke,
    /// The fleet writes another version of the wire.
    Raised,
    /// The bus has closed.
    Closed(&'static str),
}

enum Outgoing {
    Publish(String, Bytes),
    Reply(Query, Bytes),
}

/// Messages that may wait for the bus.
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
    /// Ended with the actor, however it ends.
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
        forward(&mut tasks, &myself, records, "records", Message::Knowledge);
        let packets = bus.subscribe(&keys.write(&Key::Swim(node.clone()))).await?;
        forward(&mut tasks, &myself, packets, "packets", |sample: Sample| Message::Packet(sample.payload));
        let questions = bus.serve(&keys.write(&Key::Gossip(node.clone()))).await?;
        forward(&mut tasks, &myself, questions, "questions", Message::Asked);
        let presence = bus.watch(&keys.any_alive_node()).await?;
        forward(&mut tasks, &myself, presence, "tokens", Message::Presence);
        // Announced last: whoever sees the token may ask at once.
        let token = bus.announce(&keys.write(&Key::AliveNode(node))).await?;

        let (outbox, outgoing) = mpsc::channel(OUTBOX);
        tasks.spawn(send(bus.clone(), outgoing, keys.write(&Key::Gossip(settings.node.clone())), shared.clone()));
        let (alarm, alarm_set) = watch::channel(None);
        tasks.spawn(ring(clock, alarm_set, myself.clone()));
        tasks.spawn(tell_of_raises(wire_version.clone(), myself));

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
        let mut asker = None;
        let event = match message {
            Message::Change(change) => Ok(Event::KnowledgeChanged(change)),
            Message::Knowledge(sample) => {
                state.read_statement(&sample).map(|(owner, statement)| Event::Published(owner, statement))
            }
            Message::Packet(bytes) => Ok(Event::Packet(bytes)),
            Message::Presence(presence) => match state.keys.read(&presence.key) {
                Some(Key::AliveNode(node)) => Ok(Event::Token(node, presence.alive)),
                _ => Err(format!("{:?} is no node's token", presence.key)),
            },
            Message::Asked(query) => {
                let exchange = state.read_exchange(&query.payload).map(Event::RequestReceived);
                asker = Some(query);
                exchange
            }
            Message::Answered(round, Some(Ok(bytes))) => {
                state.read_exchange(&bytes).map(|exchange| Event::ReplyReceived(round, Some(exchange)))
            }
            Message::Answered(round, Some(Err(refusal))) => {
                tracing::debug!(%refusal, "a peer would not compare digests");
                Ok(Event::ReplyReceived(round, None))
            }
            Message::Answered(round, None) => Ok(Event::ReplyReceived(round, None)),
            Message::Woke => {
                // It has rung: whatever is due next is to be set again, be it the same instant.
                state.alarm.send_if_modified(|set| set.take().is_none());
                Ok(Event::TimerFired)
            }
            Message::Raised => Ok(Event::VersionRaised { with_proofs: state.wire_version.get() >= Exchange::SINCE }),
            Message::Closed(what) => return Err(format!("the bus brings no more {what}").into()),
        };
        let now = state.clock.now();
        let handled = event.and_then(|event| state.gossiper.handle(event, &mut state.shared.lock(), now));
        match handled {
            Ok(actions) => state.perform(actions, asker, Some(&myself)),
            Err(problem) => state.complain(&problem),
        }
        Ok(())
    }

    async fn post_stop(&self, _: ActorRef<Message>, state: &mut State) -> Result<(), ActorProcessingErr> {
        // The outbox ends with the actor, so this does not go through it.
        for action in state.gossiper.leave() {
            if let Action::Send(to, bytes) = action {
                state.bus.publish(&state.keys.write(&Key::Swim(to)), bytes, Encoding::Wire, Delivery::Drop).await?;
            }
        }
        Ok(())
    }
}

impl State {
    fn perform(&mut self, actions: Vec<Action>, mut asker: Option<Query>, myself: Option<&ActorRef<Message>>) {
        for action in actions {
            match action {
                Action::Publish(statement) => {
                    let key = self.keys.write(&Key::Knowledge(self.settings.node.clone()));
                    self.send(Outgoing::Publish(key, self.encode(statement)));
                }
                Action::Send(to, bytes) => {
                    let key = self.keys.write(&Key::Swim(to));
                    self.send(Outgoing::Publish(key, bytes));
                }
                Action::SendReply(exchange) => {
                    if let Some(query) = asker.take() {
                        self.send(Outgoing::Reply(query, self.encode(exchange)));
                    }
                }
                Action::SendRequest(round, peer, exchange) => {
                    if let Some(myself) = myself {
                        let asked = self.encode(exchange);
                        self.ask(round, &peer, asked, myself.clone());
                    }
                }
            }
        }
        if self.gossiper.take_changed() {
            self.shared.notify_change();
        }
        let due = self.gossiper.next_due();
        self.alarm.send_if_modified(|set| std::mem::replace(set, due) != due);
    }

    fn send(&self, outgoing: Outgoing) {
        if self.outbox.try_send(outgoing).is_err() {
            self.shared.lock().counters.unsent += 1;
        }
    }

    fn ask(&mut self, round: u64, peer: &NodeId, payload: Bytes, myself: ActorRef<Message>) {
        while self.tasks.try_join_next().is_some() {}
        let (bus, key, limit) =
            (self.bus.clone(), self.keys.write(&Key::Gossip(peer.clone())), self.settings.reply_timeout);
        self.tasks.spawn(async move {
            let answer = match bus.query(&key, payload, limit).await {
                Ok(mut replies) => replies.recv().await.map(|reply| reply.payload),
                Err(problem) => Some(Err(problem.to_string())),
            };
            // It fails only when the actor has ended, and this task with it.
            drop(myself.cast(Message::Answered(round, answer)));
        });
    }

    fn encode<T: VersionedMessage>(&self, message: T) -> Bytes {
        let bytes = codec::encode_for_version(self.wire_version.get(), message);
        bytes.expect("records and exchanges are bounded when they are made").into()
    }

    /// What a peer tells, less what it cannot prove that its owners said.
    fn read_exchange(&mut self, bytes: &[u8]) -> Result<Exchange, String> {
        let mut exchange: Exchange = decode(bytes)?;
        let Some(notary) = self.signer.clone() else { return Ok(exchange) };
        // As long as the fleet writes a version without proofs, none can be asked for.
        let with_proofs = self.wire_version.get() >= Exchange::SINCE;
        let known = self.shared.clone();
        exchange.records.retain(|record| {
            // What is not later changes nothing: it need not be judged.
            if known.read(|base| base.get(&record.owner).is_some_and(|heard| heard.record.stamp >= record.stamp)) {
                return false;
            }
            match notary.verify(record) {
                ProofStatus::Valid => true,
                ProofStatus::Unproven => !with_proofs,
                ProofStatus::Forged(problem) => {
                    self.complain(&problem);
                    false
                }
            }
        });
        Ok(exchange)
    }

    /// Who published, and what.
    fn read_statement(&self, sample: &Sample) -> Result<(NodeId, RecordUpdate), String> {
        let statement: RecordUpdate = decode(&sample.payload)?;
        match (self.keys.read(&sample.key), &statement) {
            (Some(Key::Knowledge(node)), RecordUpdate::Record(record)) if node != record.owner => {
                Err(format!("record of {} on key {:?}", record.owner, sample.key))
            }
            (Some(Key::Knowledge(node)), _) => Ok((node, statement)),
            _ => Err(format!("knowledge on key {:?}", sample.key)),
        }
    }

    /// Counts and logs a message that cannot be used: aloud when there are twice as many as the last time.
    fn complain(&self, problem: &str) {
        let count = {
            let mut known = self.shared.lock();
            known.counters.malformed += 1;
            known.counters.malformed
        };
        if count.is_power_of_two() {
            tracing::warn!(node = %self.settings.node, count, problem, "dropped a message");
        } else {
            tracing::debug!(node = %self.settings.node, count, problem, "dropped a message");
        }
    }
}

fn decode<T: VersionedMessage>(bytes: &[u8]) -> Result<T, String> {
    codec::decode_any_version(bytes).map_err(|e| e.to_string())
}

/// Brings what a stream of the bus yields to the mailbox.
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

/// Sends what waits in the outbox, in order.
async fn send(bus: SharedBus, mut outgoing: mpsc::Receiver<Outgoing>, own_key: String, shared: SharedKnowledge) {
    while let Some(message) = outgoing.recv().await {
        let sent: Result<(), BusError> = match message {
            Outgoing::Publish(key, payload) => bus.publish(&key, payload, Encoding::Wire, Delivery::Drop).await,
            Outgoing::Reply(query, payload) => query.replier.reply(&own_key, payload, Encoding::Wire).await,
        };
        if let Err(problem) = sent {
            tracing::debug!(%problem, "not sent");
            shared.lock().counters.unsent += 1;
        }
    }
}

/// Brings word when the fleet writes another version of the wire.
async fn tell_of_raises(wire: WireVersion, to: ActorRef<Message>) {
    let mut versions = wire.subscribe();
    while versions.changed().await.is_ok() && to.cast(Message::Raised).is_ok() {}
}

/// Rings when the time comes that was last set.
async fn ring(clock: Clock, mut set: watch::Receiver<Option<NodeTime>>, whom: ActorRef<Message>) {
    loop {
        let due = *set.borrow_and_update();
        let rung = match due {
            None => false,
            Some(due) => tokio::select! {
                biased;
                changed = set.changed() => match changed {
                    Ok(()) => continue,
                    Err(_) => return,
                },
                () = tokio::time::sleep_until(clock.instant(due)) => true,
            },
        };
        if rung && whom.cast(Message::Woke).is_err() {
            return;
        }
        // What is due has been told; there will be a next time.
        if set.changed().await.is_err() {
            return;
        }
    }
}
