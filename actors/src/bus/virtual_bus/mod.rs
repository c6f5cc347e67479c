//! A whole fleet's bus in one process, on virtual time, with faults.
//!
//! [`VirtualNetwork`] is what lies between the nodes; [`VirtualBus`] is one node's end of it. Every message between two
//! nodes takes a time drawn from a seeded generator (see [`LinkModel`]); a node's messages to itself take none, but
//! travel through the same agenda. On a current-thread runtime with paused time, one seed gives one run
//! ([`VirtualNetwork::digest`] tells whether it did).
//!
//! Where it is simpler than Zenoh:
//! - Every node is linked with every other. Subscriptions and services are known everywhere at once.
//! - What crosses a cut link is lost, however short the cut: nothing is sent again. Use
//!   [`pause`](VirtualNetwork::pause) for what is late and not lost.
//! - Of several complete services the nearest is a node's own, else that of the node which joined first.
//! - A healed link works at once; tokens come back after one latency.
//! - [`Delivery::Drop`] and [`Delivery::Block`] are one: mailboxes have no limit, and the link model loses both.
//!
//! Where it takes after Zenoh: a node that falls silent keeps its tokens until a lease has passed; until then a query
//! to it waits, and from then on it is asked no more. If only its answers are cut it is still asked, in vain, and the
//! query runs to its limit. A crash shows after one latency.

mod faults;
mod link;
mod network;
mod responder;
#[cfg(test)]
mod tests;
mod trace;

pub use link::{LinkModel, NetworkCounters, Traffic, TrafficByKind};

use super::{
    Bus, BusError, Delivery, Encoding, Link, MESSAGE_MAX, Presence, PresenceToken, Query, Reply, Sample,
    ServiceSelection, Stream, keys,
};
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::ids::NodeId;
use network::{EntityId, Incarnation, Network, QueryRequest};
use responder::QueryPart;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;
use tokio::sync::{Notify, mpsc};
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// How long a silent node counts as present, unless [`VirtualNetwork::set_lease`] says otherwise: the fleet's setting
/// for Zenoh.
pub const LEASE: Duration = Duration::from_secs(2);

/// What lies between the nodes of a virtual fleet. Clones are the same network.
///
/// Faults may be set at any time and name nodes that do not exist yet.
#[derive(Clone)]
pub struct VirtualNetwork {
    shared: Arc<Shared>,
}

impl VirtualNetwork {
    /// A network without nodes or faults, whose links all behave as `model` says.
    ///
    /// # Panics
    /// Panics if the model makes no sense: a share outside 0 to 1, or a shortest latency above the longest.
    pub fn new(seed: u64, model: LinkModel) -> Self {
        let shared = Arc::new_cyclic(|home: &Weak<Shared>| Shared {
            network: Mutex::new(Network::new(home.clone(), seed, model, LEASE, Instant::now())),
            driver: Mutex::new(Driver::default()),
            finished: Mutex::new(Vec::new()),
            wake: Arc::new(Notify::new()),
        });
        VirtualNetwork { shared }
    }

    /// A node's end of the network. The node begins to live if it does not already; after a crash it begins anew, and
    /// knows nothing of before.
    pub fn bus(&self, node: NodeId) -> VirtualBus {
        let life = self.shared.with(|network| network.start(node.clone()));
        VirtualBus { shared: Arc::clone(&self.shared), node, life }
    }

    /// Makes all links behave so from now on, those that were given a model of their own too.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model(&self, model: LinkModel) {
        self.shared.with(|network| network.set_model(model));
    }

    /// Makes one direction of one link behave so from now on.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model_between(&self, from: NodeId, to: NodeId, model: LinkModel) {
        self.shared.with(|network| network.set_model_between(from, to, model));
    }

    /// How long a node that falls silent from now on still counts as present.
    pub fn set_lease(&self, lease: Duration) {
        self.shared.with(|network| network.set_lease(lease));
    }

    /// Splits the network: only nodes of one group hear one another. Nodes in no group have a further one together.
    /// An earlier partition ends; other faults stay.
    pub fn partition(&self, groups: impl IntoIterator<Item = impl IntoIterator<Item = NodeId>>) {
        self.shared.with(|network| network.change_faults(|faults| faults.partition(groups)));
    }

    /// Cuts one direction: `to` hears nothing from `from` any more.
    pub fn cut(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.cut(from, to)));
    }

    /// Ends a [`cut`](Self::cut).
    pub fn restore(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.restore(from, to)));
    }

    /// Nobody else hears this node any more; it still hears the others.
    pub fn block_outgoing(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_outgoing(node)));
    }

    /// This node hears nobody else any more; the others still hear it.
    pub fn block_incoming(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_incoming(node)));
    }

    /// Cuts this node off in both directions.
    pub fn isolate(&self, node: NodeId) {
        self.shared.with(|network| {
            network.change_faults(|faults| {
                faults.block_outgoing(node.clone());
                faults.block_incoming(node);
            });
        });
    }

    /// Ends every partition, cut, muting, deafening and isolation. Link models, pauses and crashes stay.
    pub fn heal(&self) {
        self.shared.with(|network| network.change_faults(faults::Faults::heal));
    }

    /// Holds up whatever is under way to or from a node, its messages to itself too, as if its process stood still. Its
    /// peers miss it after a lease. Its actors' timers go on.
    pub fn pause(&self, node: &NodeId) {
        self.shared.with(|network| network.pause(node));
    }

    /// Lets go of what [`pause`](Self::pause) held up, in its order.
    pub fn resume(&self, node: &NodeId) {
        self.shared.with(|network| network.resume(node));
    }

    /// Ends a node's life: its streams end, its declarations vanish, and its bus refuses everything. What it sent
    /// before still arrives. Its peers learn of it after one latency, or after the lease if they cannot hear it.
    pub fn crash(&self, node: &NodeId) {
        self.shared.with(|network| network.crash(node));
    }

    /// What was carried so far.
    pub fn counters(&self) -> NetworkCounters {
        self.shared.with(|network| network.counters)
    }

    /// What a node has put on the wire and taken from it so far, in all its lives.
    pub fn traffic(&self, node: &NodeId) -> TrafficByKind {
        self.shared.with(|network| network.traffic(node))
    }

    /// A digest of all deliveries so far, each with its time, ends and content: equal runs have equal digests.
    pub fn digest(&self) -> u64 {
        self.shared.with(|network| network.trace.digest())
    }
}

/// One node's end of a [`VirtualNetwork`]. Clones are the same end; dropping it ends nothing, a
/// [crash](VirtualNetwork::crash) does.
#[derive(Clone)]
pub struct VirtualBus {
    shared: Arc<Shared>,
    node: NodeId,
    life: Incarnation,
}

impl VirtualBus {
    /// The node whose end this is.
    pub fn node(&self) -> &NodeId {
        &self.node
    }

    /// Acts on the network, unless the node has crashed.
    fn act<R>(&self, what: &str, act: impl FnOnce(&mut Network) -> R) -> Result<R, BusError> {
        self.shared.with(|network| {
            if !network.is_running(self.life) {
                let problem = format!("node {} has crashed", self.node);
                return Err(BusError::Failed { operation: what.to_owned(), problem });
            }
            Ok(act(network))
        })
    }

    fn answer(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let number = self.act("serve", |network| network.serve(self.life, wanted, complete, mailbox))?;
        Ok(self.stream(receiver, number, Network::stop_serving))
    }

    fn stream<T: 'static>(
        &self,
        receiver: mpsc::UnboundedReceiver<T>,
        number: EntityId,
        end: fn(&mut Network, EntityId),
    ) -> Stream<T> {
        Stream::new(receiver, Box::new(Guard { home: Arc::downgrade(&self.shared), number, end }))
    }
}

#[async_trait]
impl Bus for VirtualBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        _delivery: Delivery,
    ) -> Result<(), BusError> {
        keys::check_payload_size("publish", &payload, MESSAGE_MAX)?;
        self.act("publish", |network| {
            let known = match network.cached_key(key) {
                Some(known) => known,
                None => keys::single_key(key)?,
            };
            network.publish(self.life, &known, Sample { key: key.to_owned(), payload, encoding, attachment: beside });
            Ok(())
        })?
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let number = self.act("subscribe", |network| network.subscribe(self.life, wanted, mailbox))?;
        Ok(self.stream(receiver, number, Network::unsubscribe))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (wanted, parameters) = keys::selector(key_expr)?;
        keys::check_payload_size("query", &payload, MESSAGE_MAX)?;
        let question =
            QueryRequest { key_expr: wanted, parameters: parameters.to_owned(), payload, attachment: beside };
        let (replies, receiver) = mpsc::unbounded_channel();
        let number = self.act("query", |network| network.query(self.life, question, limit, whom, replies))?;
        Ok(self.stream(receiver, number, Network::cancel_query))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.answer(key_expr, false)
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.answer(key_expr, true)
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        let key = keys::single_key(key)?;
        let number = self.act("announce", |network| network.announce(self.life, key))?;
        Ok(PresenceToken::new(Box::new(Guard {
            home: Arc::downgrade(&self.shared),
            number,
            end: Network::withdraw_token,
        })))
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        let wanted = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let number = self.act("watch", |network| network.watch(self.life, wanted, mailbox))?;
        Ok(self.stream(receiver, number, Network::stop_watching))
    }

    async fn links(&self) -> Vec<Link> {
        self.act("list its links", |network| {
            let link = |peer: &NodeId| Link { peer: peer.to_string(), kind: "router".to_owned() };
            network.neighbours(self.life.index).map(link).collect()
        })
        .unwrap_or_default()
    }
}

/// Ends a declaration or a query when it is dropped.
struct Guard {
    home: Weak<Shared>,
    number: EntityId,
    end: fn(&mut Network, EntityId),
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Some(shared) = self.home.upgrade() {
            shared.with(|network| (self.end)(network, self.number));
        }
    }
}

/// The network, and the task that carries out what comes due in it.
///
/// Of the three locks at most two are held at once, and `network` is taken first.
struct Shared {
    network: Mutex<Network>,
    driver: Mutex<Driver>,
    /// Parts of queries whose services have just let go of them.
    finished: Mutex<Vec<QueryPart>>,
    wake: Arc<Notify>,
}

/// The task that waits for what is next.
#[derive(Default)]
struct Driver {
    task: Option<JoinHandle<()>>,
    /// When it will look at the agenda by itself.
    wakes_at: Option<Instant>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic elsewhere is reported there; the network itself is changed in steps that do not panic half-way.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Does something with the network at this instant, and sees to it that what follows from it will happen.
    fn with<R>(self: &Arc<Self>, act: impl FnOnce(&mut Network) -> R) -> R {
        let mut network = lock(&self.network);
        network.advance_to(Instant::now());
        let result = act(&mut network);
        if let Some(due) = network.next_due() {
            self.drive(due);
        }
        result
    }

    /// Makes sure that somebody looks at the agenda at `due`.
    fn drive(self: &Arc<Self>, due: Instant) {
        let mut driver = lock(&self.driver);
        let running = driver.task.as_ref().is_some_and(|task| !task.is_finished());
        if !running {
            // Without a runtime (it is shutting down) time has ended too, and nothing comes due any more.
            let Ok(runtime) = tokio::runtime::Handle::try_current() else { return };
            driver.task = Some(runtime.spawn(drive(Arc::downgrade(self), Arc::clone(&self.wake))));
            driver.wakes_at = Some(due);
        } else if driver.wakes_at.is_none_or(|wakes_at| due < wakes_at) {
            driver.wakes_at = Some(due);
            self.wake.notify_one();
        }
    }

    fn finished(&self, leg: QueryPart) {
        lock(&self.finished).push(leg);
        self.wake.notify_one();
    }

    /// Carries out what is due; returns when there is more.
    fn run(&self) -> Option<Instant> {
        let mut network = lock(&self.network);
        network.advance_to(Instant::now());
        loop {
            network.run();
            let finished = std::mem::take(&mut *lock(&self.finished));
            if finished.is_empty() {
                break;
            }
            for leg in finished {
                network.finish_part(leg);
            }
        }
        let next = network.next_due();
        lock(&self.driver).wakes_at = next;
        next
    }
}

impl Drop for Shared {
    /// Lets the driver see that there is nothing left to drive.
    fn drop(&mut self) {
        self.wake.notify_one();
    }
}

async fn drive(home: Weak<Shared>, wake: Arc<Notify>) {
    loop {
        let Some(shared) = home.upgrade() else { return };
        let next = shared.run();
        drop(shared);
        match next {
            Some(due) => tokio::select! {
                biased;
                () = wake.notified() => {}
                () = tokio::time::sleep_until(due) => {}
            },
            None => wake.notified().await,
        }
    }
}
