//! The bus of a whole fleet in one process, on virtual time, with faults.
//!
//! [`VirtualNetwork`] is the network between the nodes; [`VirtualBus`] is a node's endpoint. Every
//! message between two nodes takes a latency drawn from a seeded generator (see [`LinkModel`]). A
//! node's messages to itself take no time, but pass through the same event queue. On a
//! current-thread runtime with paused time, a seed determines the run; [`VirtualNetwork::digest`]
//! verifies it.
//!
//! Simplifications compared with Zenoh:
//! - Every node is linked with every other. Subscriptions and services are known everywhere at
//!   once.
//! - Messages that cross a cut link are lost, however short the cut: nothing is resent. To delay
//!   messages without loss, use [`pause`](VirtualNetwork::pause).
//! - The nearest of several complete services is the node's own, else the service of the node that
//!   joined first.
//! - A healed link works at once; tokens return after one latency.
//! - [`Delivery::Drop`] and [`Delivery::Block`] are equivalent: mailboxes are unbounded, and the
//!   link model loses both.
//!
//! Similarities with Zenoh: a node that falls silent keeps its tokens until a lease has expired.
//! Until then a query to it waits; from then on it receives no more queries. If only its replies
//! are cut, it still receives queries, in vain, and each query runs to its timeout. A crash becomes
//! visible after one latency.

mod faults;
mod link;
mod network;
mod responder;
#[cfg(test)]
mod tests;
mod trace;

pub use link::{LinkModel, NetworkCounters, Traffic, TrafficByKind};

use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, MESSAGE_MAX, Presence, PresenceToken, Query, Reply, Sample,
    ServiceSelection, Stream,
};
use crate::keys;
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

/// Time for which a silent node counts as present, unless changed by [`VirtualNetwork::set_lease`].
/// Equal to the fleet's setting for Zenoh.
pub const LEASE: Duration = Duration::from_secs(2);

/// The network between the nodes of a virtual fleet. Clones share the network.
///
/// Faults may be set at any time and may name nodes that do not exist yet.
#[derive(Clone)]
pub struct VirtualNetwork {
    shared: Arc<Shared>,
}

impl VirtualNetwork {
    /// Creates a network without nodes or faults. All links follow `model`.
    ///
    /// # Panics
    /// If the model is invalid: a share outside 0 to 1, or a minimum latency above the maximum.
    pub fn new(seed: u64, model: LinkModel) -> Self {
        let shared = Arc::new_cyclic(|shared: &Weak<Shared>| Shared {
            network: Mutex::new(Network::new(shared.clone(), seed, model, LEASE, Instant::now())),
            driver: Mutex::new(Driver::default()),
            finished: Mutex::new(Vec::new()),
            wake: Arc::new(Notify::new()),
        });
        VirtualNetwork { shared }
    }

    /// Returns the endpoint of a node. The node is started if it is not running. After a crash it
    /// starts again without any earlier state.
    pub fn bus(&self, node: NodeId) -> VirtualBus {
        let incarnation = self.shared.with(|network| network.start(node.clone()));
        VirtualBus { shared: Arc::clone(&self.shared), node, incarnation }
    }

    /// Sets the model of all links from now on, including links with a model of their own.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model(&self, model: LinkModel) {
        self.shared.with(|network| network.set_model(model));
    }

    /// Sets the model of a single direction of a single link from now on.
    ///
    /// # Panics
    /// As [`VirtualNetwork::new`].
    pub fn set_link_model_between(&self, from: NodeId, to: NodeId, model: LinkModel) {
        self.shared.with(|network| network.set_model_between(from, to, model));
    }

    /// Sets the time for which a node that falls silent from now on counts as present.
    pub fn set_lease(&self, lease: Duration) {
        self.shared.with(|network| network.set_lease(lease));
    }

    /// Partitions the network: only nodes of the same group receive each other's messages. Nodes
    /// without a group form a further group. Replaces an earlier partition; other faults stay.
    pub fn partition(&self, groups: impl IntoIterator<Item = impl IntoIterator<Item = NodeId>>) {
        self.shared.with(|network| network.change_faults(|faults| faults.partition(groups)));
    }

    /// Cuts one direction: `to` receives no more messages from `from`.
    pub fn cut(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.cut(from, to)));
    }

    /// Ends a [`cut`](Self::cut).
    pub fn restore(&self, from: NodeId, to: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.restore(from, to)));
    }

    /// Blocks this node's outgoing messages; it still receives messages.
    pub fn block_outgoing(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_outgoing(node)));
    }

    /// Blocks this node's incoming messages; the other nodes still receive its messages.
    pub fn block_incoming(&self, node: NodeId) {
        self.shared.with(|network| network.change_faults(|faults| faults.block_incoming(node)));
    }

    /// Isolates this node in both directions.
    pub fn isolate(&self, node: NodeId) {
        self.shared.with(|network| {
            network.change_faults(|faults| {
                faults.block_outgoing(node.clone());
                faults.block_incoming(node);
            });
        });
    }

    /// Ends every partition, cut, block and isolation. Link models, pauses and crashes stay.
    pub fn heal(&self) {
        self.shared.with(|network| network.change_faults(faults::Faults::heal));
    }

    /// Holds back all messages to or from a node, including its messages to itself, as if its
    /// process were frozen. Its peers miss it after a lease. The timers of its actors continue.
    pub fn pause(&self, node: &NodeId) {
        self.shared.with(|network| network.pause(node));
    }

    /// Delivers the messages that [`pause`](Self::pause) held back, in their order.
    pub fn resume(&self, node: &NodeId) {
        self.shared.with(|network| network.resume(node));
    }

    /// Crashes a node: its streams end, its declarations vanish, and its bus rejects every
    /// operation. Messages sent earlier still arrive. Its peers notice after one latency, or after
    /// the lease if they are cut off from it.
    pub fn crash(&self, node: &NodeId) {
        self.shared.with(|network| network.crash(node));
    }

    /// Returns the message counters so far.
    pub fn counters(&self) -> NetworkCounters {
        self.shared.with(|network| network.counters)
    }

    /// Returns the traffic of a node so far, over all its restarts.
    pub fn traffic(&self, node: &NodeId) -> TrafficByKind {
        self.shared.with(|network| network.traffic(node))
    }

    /// Returns a digest of all deliveries so far, each with time, endpoints and content. Equal runs
    /// have equal digests.
    pub fn digest(&self) -> u64 {
        self.shared.with(|network| network.trace.digest())
    }
}

/// Endpoint of a node on a [`VirtualNetwork`]. Clones share the endpoint. Dropping it ends nothing;
/// a [crash](VirtualNetwork::crash) does.
#[derive(Clone)]
pub struct VirtualBus {
    shared: Arc<Shared>,
    node: NodeId,
    incarnation: Incarnation,
}

impl VirtualBus {
    /// Returns the node of this endpoint.
    pub fn node(&self) -> &NodeId {
        &self.node
    }

    /// Runs an operation on the network, unless the node has crashed.
    fn act<R>(&self, operation: &str, act: impl FnOnce(&mut Network) -> R) -> Result<R, BusError> {
        self.shared.with(|network| {
            if !network.is_running(self.incarnation) {
                let problem = format!("node {} has crashed", self.node);
                return Err(BusError::Failed { operation: operation.to_owned(), problem });
            }
            Ok(act(network))
        })
    }

    fn serve_with(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let id = self.act("serve", |network| network.serve(self.incarnation, key_expr, complete, mailbox))?;
        Ok(self.stream(receiver, id, Network::stop_serving))
    }

    fn stream<T: 'static>(
        &self,
        receiver: mpsc::UnboundedReceiver<T>,
        id: EntityId,
        end: fn(&mut Network, EntityId),
    ) -> Stream<T> {
        Stream::new(receiver, Box::new(Guard { shared: Arc::downgrade(&self.shared), id, end }))
    }
}

#[async_trait]
impl Bus for VirtualBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        _delivery: Delivery,
    ) -> Result<(), BusError> {
        keys::check_payload_size("publish", &payload, MESSAGE_MAX)?;
        self.act("publish", |network| {
            let valid_key = match network.cached_key(key) {
                Some(valid_key) => valid_key,
                None => keys::single_key(key)?,
            };
            network.publish(
                self.incarnation,
                &valid_key,
                Sample { key: key.to_owned(), payload, encoding, attachment },
            );
            Ok(())
        })?
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let id = self.act("subscribe", |network| network.subscribe(self.incarnation, key_expr, mailbox))?;
        Ok(self.stream(receiver, id, Network::unsubscribe))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (key_expr, parameters) = keys::selector(key_expr)?;
        keys::check_payload_size("query", &payload, MESSAGE_MAX)?;
        let request = QueryRequest { key_expr, parameters: parameters.to_owned(), payload, attachment };
        let (replies, receiver) = mpsc::unbounded_channel();
        let id = self.act("query", |network| network.query(self.incarnation, request, timeout, target, replies))?;
        Ok(self.stream(receiver, id, Network::cancel_query))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.serve_with(key_expr, false)
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.serve_with(key_expr, true)
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        let key = keys::single_key(key)?;
        let id = self.act("announce", |network| network.announce(self.incarnation, key))?;
        Ok(PresenceToken::new(Box::new(Guard {
            shared: Arc::downgrade(&self.shared),
            id,
            end: Network::withdraw_token,
        })))
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mpsc::unbounded_channel();
        let id = self.act("watch", |network| network.watch(self.incarnation, key_expr, mailbox))?;
        Ok(self.stream(receiver, id, Network::stop_watching))
    }

    async fn links(&self) -> Vec<Link> {
        self.act("list its links", |network| {
            let link = |peer: &NodeId| Link { peer: peer.to_string(), kind: "router".to_owned() };
            network.neighbours(self.incarnation.index).map(link).collect()
        })
        .unwrap_or_default()
    }
}

/// Guard that ends a declaration or a query when it is dropped.
struct Guard {
    shared: Weak<Shared>,
    id: EntityId,
    end: fn(&mut Network, EntityId),
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.with(|network| (self.end)(network, self.id));
        }
    }
}

/// The network, and the driver task that processes due events.
///
/// At most two of the three locks are held at once, and `network` is taken first.
struct Shared {
    network: Mutex<Network>,
    driver: Mutex<Driver>,
    /// Query parts that services have just ended.
    finished: Mutex<Vec<QueryPart>>,
    wake: Arc<Notify>,
}

/// The task that waits for the next event.
#[derive(Default)]
struct Driver {
    task: Option<JoinHandle<()>>,
    /// Time of its next scheduled wake-up.
    wakes_at: Option<Instant>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic elsewhere is reported there. The network itself changes in steps that do not panic
    // half-way.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Runs an operation on the network at this instant, and ensures that its consequences are
    /// scheduled.
    fn with<R>(self: &Arc<Self>, act: impl FnOnce(&mut Network) -> R) -> R {
        let mut network = lock(&self.network);
        network.advance_to(Instant::now());
        let result = act(&mut network);
        if let Some(due) = network.next_due() {
            self.drive(due);
        }
        result
    }

    /// Ensures that the driver task wakes at `due`.
    fn drive(self: &Arc<Self>, due: Instant) {
        let mut driver = lock(&self.driver);
        let running = driver.task.as_ref().is_some_and(|task| !task.is_finished());
        if !running {
            // Without a runtime (during its shutdown) time has ended too, and nothing becomes due.
            let Ok(runtime) = tokio::runtime::Handle::try_current() else { return };
            driver.task = Some(runtime.spawn(drive(Arc::downgrade(self), Arc::clone(&self.wake))));
            driver.wakes_at = Some(due);
        } else if driver.wakes_at.is_none_or(|wakes_at| due < wakes_at) {
            driver.wakes_at = Some(due);
            self.wake.notify_one();
        }
    }

    fn finished(&self, part: QueryPart) {
        lock(&self.finished).push(part);
        self.wake.notify_one();
    }

    /// Processes all due events. Returns the time of the next event.
    fn run(&self) -> Option<Instant> {
        let mut network = lock(&self.network);
        network.advance_to(Instant::now());
        loop {
            network.run();
            let finished = std::mem::take(&mut *lock(&self.finished));
            if finished.is_empty() {
                break;
            }
            for part in finished {
                network.finish_part(part);
            }
        }
        let next = network.next_due();
        lock(&self.driver).wakes_at = next;
        next
    }
}

impl Drop for Shared {
    /// Wakes the driver so that it ends.
    fn drop(&mut self) {
        self.wake.notify_one();
    }
}

async fn drive(shared: Weak<Shared>, wake: Arc<Notify>) {
    loop {
        let Some(shared) = shared.upgrade() else { return };
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
