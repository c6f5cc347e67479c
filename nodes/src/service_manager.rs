//! What a node tells the service manager that has started it, as systemd understands it (`Type=notify`): that it is there,
//! how it is linked, that it still answers, that it stops.
//!
//! Without a manager (`NOTIFY_SOCKET` is not set) nothing is told. A manager that cannot be told is none that a node would
//! stop for: it has its own ways to notice.

use crate::query::{self, QueryTarget};
use consort_actors::bus::Bus;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use sd_notify::NotifyState;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval};
use tracing::warn;

/// The node is there: whoever reaches it gets answers.
pub(crate) fn ready() {
    tell(&[NotifyState::Ready]);
}

/// The node was told to stop, or stops by itself: it hands over and says goodbye.
pub(crate) fn stopping() {
    tell(&[NotifyState::Stopping, NotifyState::Status("hands over and says goodbye")]);
}

/// How the node is, in a line for people.
pub(crate) fn status(text: &str) {
    tell(&[NotifyState::Status(text)]);
}

/// Says again and again that the node lives, if the manager wants to hear it (`WatchdogSec=`): whenever the node has answered
/// a question of its own, asked over the bus as anybody else would ask. One that no longer answers is ended by the manager,
/// and started anew.
pub(crate) async fn run_watchdog(bus: impl Bus, keys: Keys, node: NodeId) {
    let Some(patience) = sd_notify::watchdog_enabled() else { return };
    // A sign may come late, or fail once, before patience ends.
    let period = patience / 3;
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        if answers_itself(&bus, &keys, &node, period).await {
            tell(&[NotifyState::Watchdog]);
        } else {
            warn!(%node, "does not answer itself within {period:?}: the service manager hears no sign of life");
        }
    }
}

async fn answers_itself(bus: &impl Bus, keys: &Keys, node: &NodeId, limit: Duration) -> bool {
    let question = keys.write(&Key::Seen(node.clone(), Box::new(Key::ViewCoordinator)));
    query::query_once(bus, &question, "", limit, QueryTarget::All).await.is_ok()
}

fn tell(states: &[NotifyState<'_>]) {
    if let Err(problem) = sd_notify::notify(states) {
        warn!(%problem, "the service manager cannot be told how this node is");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use consort_actors::bus::{Encoding, LinkModel, VirtualNetwork};
    use consort_protocol::ids::FleetId;

    #[tokio::test(start_paused = true)]
    async fn a_node_lives_for_as_long_as_it_answers_itself() {
        let node = NodeId::new("station-1").unwrap();
        let bus = VirtualNetwork::new(1, LinkModel::LAN).bus(node.clone());
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let limit = Duration::from_secs(1);
        assert!(!answers_itself(&bus, &keys, &node, limit).await, "there is nobody yet");
        let mut questions = bus.serve(&keys.any_seen(&node)).await.unwrap();
        let answering = tokio::spawn(async move {
            let question = questions.recv().await.expect("it is asked");
            question.replier.reply(&question.key, Bytes::from_static(b"{}"), Encoding::Json).await.unwrap();
            questions
        });
        assert!(answers_itself(&bus, &keys, &node, limit).await);
        let _hangs = answering.await.unwrap();
        assert!(!answers_itself(&bus, &keys, &node, limit).await, "it takes questions and answers none");
    }
}
