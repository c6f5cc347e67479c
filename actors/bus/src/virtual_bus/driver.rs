//! The driver of a virtual network: applies operations, and processes events when they are due.

use super::ids::{Incarnation, NodeIndex, QueryPart};
use super::link::LinkModel;
use super::network::Network;
use super::responder::{ReplySink, reply_failed};
use crate::bus::{BusError, Reply};
use async_trait::async_trait;
use consort_protocol::ids::NodeId;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// Time for which a silent node counts as present, unless changed by
/// [`VirtualNetwork::set_lease`](super::VirtualNetwork::set_lease). Equal to the fleet's setting
/// for Zenoh.
pub(super) const LEASE: Duration = Duration::from_secs(2);

/// The network, and the driver task that processes due events.
///
/// At most two of the three locks are held at once, and `network` is taken first.
pub(super) struct Shared {
    network: Mutex<Network>,
    driver: Mutex<Driver>,
    /// Query parts that services have just ended.
    finished: Mutex<Vec<QueryPart>>,
    wake: Arc<Notify>,
    /// Blocked nodes.
    blocked: Mutex<BTreeSet<NodeIndex>>,
    /// Notifies operations that a node is no longer blocked, in the order of their calls: a `watch` channel
    /// wakes its receivers in a random order.
    unblocked: Notify,
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
    /// Creates a network without nodes.
    pub(super) fn new(seed: u64, model: LinkModel) -> Arc<Shared> {
        Arc::new_cyclic(|shared: &Weak<Shared>| Shared {
            network: Mutex::new(Network::new(shared.clone(), seed, model, LEASE, Instant::now())),
            driver: Mutex::new(Driver::default()),
            finished: Mutex::new(Vec::new()),
            wake: Arc::new(Notify::new()),
            blocked: Mutex::default(),
            unblocked: Notify::new(),
        })
    }

    /// Runs an operation on the network at this instant, and ensures that its consequences are
    /// scheduled.
    pub(super) fn with<R>(self: &Arc<Self>, act: impl FnOnce(&mut Network) -> R) -> R {
        let mut network = lock(&self.network);
        network.advance_to(Instant::now());
        let result = act(&mut network);
        if let Some(due) = network.next_due() {
            self.drive(due);
        }
        result
    }

    /// Blocks or unblocks the operations of a node.
    pub(super) fn set_blocked(self: &Arc<Self>, node: &NodeId, blocked: bool) {
        let Some(index) = self.with(|network| network.index(node)) else { return };
        let mut nodes = lock(&self.blocked);
        if blocked {
            nodes.insert(index);
        } else if nodes.remove(&index) {
            self.unblocked.notify_waiters();
        }
    }

    /// Waits until the operations of a node are not blocked.
    pub(super) async fn until_unblocked(&self, node: NodeIndex) {
        loop {
            // A future of `notified` receives the notifications from its creation on.
            let unblocked = self.unblocked.notified();
            if !lock(&self.blocked).contains(&node) {
                return;
            }
            unblocked.await;
        }
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

#[async_trait]
impl ReplySink for Shared {
    fn reply(self: Arc<Self>, incarnation: Incarnation, part: QueryPart, reply: Reply) -> Result<(), BusError> {
        self.with(|network| {
            if !network.is_running(incarnation) {
                return Err(reply_failed("the node has crashed"));
            }
            network.reply(part, reply);
            Ok(())
        })
    }

    async fn until_unblocked(&self, node: NodeIndex) {
        Shared::until_unblocked(self, node).await;
    }

    fn finish(&self, part: QueryPart) {
        lock(&self.finished).push(part);
        self.wake.notify_one();
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
