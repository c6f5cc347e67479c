//! Notifies the service manager of the node, with systemd's protocol (`Type=notify`): started, link
//! status, watchdog, stopping.
//!
//! Without a manager (`NOTIFY_SOCKET` is not set) nothing is sent. A failed notification does not
//! stop a node: the manager has its own means of detection.

use consort_bus::Bus;
use consort_dashboard::query::{self, QueryTarget};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use sd_notify::NotifyState;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval};
use tracing::warn;

/// Reports that the node is ready: it replies to queries.
pub(crate) fn ready() {
    notify(&[NotifyState::Ready]);
}

/// Reports that the node is stopping: it transfers the leadership and announces its departure.
pub(crate) fn stopping() {
    notify(&[NotifyState::Stopping, NotifyState::Status("transferring leadership and leaving")]);
}

/// Reports a status line for people.
pub(crate) fn status(text: &str) {
    notify(&[NotifyState::Status(text)]);
}

/// Sends watchdog notifications, if the manager requests them (`WatchdogSec=`): after each reply of
/// the node to its own query, sent over the bus like any other query. The manager kills and
/// restarts a node that no longer replies.
pub(crate) async fn run_watchdog(bus: impl Bus, keys: Keys, node: NodeId) {
    let Some(timeout) = sd_notify::watchdog_enabled() else { return };
    // A notification may be late, or fail once, before the watchdog expires.
    let period = timeout / 3;
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        if replies_to_itself(&bus, &keys, &node, period).await {
            notify(&[NotifyState::Watchdog]);
        } else {
            warn!(%node, "no reply to the node's own query within {period:?}: the watchdog is not notified");
        }
    }
}

async fn replies_to_itself(bus: &impl Bus, keys: &Keys, node: &NodeId, limit: Duration) -> bool {
    let query = keys.write(&Key::Seen(node.clone(), Box::new(Key::ViewCoordinator)));
    query::query_once(bus, &query, "", limit, QueryTarget::All).await.is_ok()
}

fn notify(states: &[NotifyState<'_>]) {
    if let Err(problem) = sd_notify::notify(states) {
        warn!(%problem, "the service manager cannot be notified");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use consort_bus::{Encoding, LinkModel, VirtualNetwork};
    use consort_protocol::ids::FleetId;

    #[tokio::test(start_paused = true)]
    async fn a_node_is_alive_as_long_as_it_replies_to_itself() {
        let node = NodeId::new("station-1").unwrap();
        let bus = VirtualNetwork::new(1, LinkModel::LAN).bus(node.clone());
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let limit = Duration::from_secs(1);
        assert!(!replies_to_itself(&bus, &keys, &node, limit).await, "there is no node yet");
        let mut queries = bus.serve(&keys.any_seen(&node)).await.unwrap();
        let answering = tokio::spawn(async move {
            let query = queries.recv().await.expect("it is asked");
            query.replier.reply(&query.key, Bytes::from_static(b"{}"), Encoding::Json).await.unwrap();
            queries
        });
        assert!(replies_to_itself(&bus, &keys, &node, limit).await);
        let _hanging = answering.await.unwrap();
        assert!(!replies_to_itself(&bus, &keys, &node, limit).await, "it receives queries and sends no reply");
    }
}
