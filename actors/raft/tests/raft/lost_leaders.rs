//! Presence tokens that vanish while their leader works: false alarms. And a leader that shuts down.

use crate::failover::on_wifi;
use crate::support::{Fleet, NAMES, default_settings, keys, on_virtual_time};
use consort_bus::{BusError, Layer, MessageContent, Reply, SharedBus, Stream};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, RaftCall};
use consort_raft::RaftSettings;
use futures::FutureExt as _;
use std::cell::Cell;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::sleep;

/// Withdraws and announces the presence of the leader a thousand times, and asserts that it remains leader.
fn keeps_its_leader(settings: fn(NodeId) -> RaftSettings) {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(7, 5, settings).await;
        let mut tokens = fleet.announce_all().await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        let leadership = fleet.view(&leader).leader_id;
        for flap in 0..1000 {
            tokens.remove(&leader);
            sleep(Duration::from_micros(flap * 7919 % 20_000)).await;
            tokens.insert(leader.clone(), fleet.announce(&leader).await);
            sleep(Duration::from_micros(flap * 6007 % 20_000)).await;
            for name in fleet.replicas.keys() {
                assert_eq!(fleet.view(name).leader_id, leadership, "{name} after flap {flap}");
            }
        }
        // Nor if it never returns.
        tokens.remove(&leader);
        sleep(Duration::from_secs(10)).await;
        assert_eq!(fleet.leader().await, leader);
        assert_eq!(fleet.view(&leader).leader_id, leadership);
    });
}

#[test]
fn a_token_that_flaps_a_thousand_times_causes_no_takeover() {
    keeps_its_leader(default_settings);
    keeps_its_leader(on_wifi);
}

/// Key that some nodes receive no replies on.
#[derive(Default)]
struct Unserved {
    key: String,
    /// Numbers of the nodes, in the order of their starts.
    nodes: BTreeSet<usize>,
}

/// Bus of a node that may find no service on a key, although another node serves it.
struct BlindBus {
    inner: SharedBus,
    number: usize,
    unserved: Arc<Mutex<Unserved>>,
}

impl Layer for BlindBus {
    type QueryState = bool;

    fn inner(&self) -> &SharedBus {
        &self.inner
    }

    fn outgoing_query(&self, key_expr: &str, content: MessageContent) -> Result<(MessageContent, bool), BusError> {
        let unserved = self.unserved.lock().unwrap_or_else(PoisonError::into_inner);
        Ok((content, unserved.key == key_expr && unserved.nodes.contains(&self.number)))
    }

    fn incoming_replies(&self, is_unserved: bool, replies: Stream<Reply>) -> Stream<Reply> {
        if is_unserved { replies.filter_map(|_| None) } else { replies }
    }
}

/// Withdraws the presence of the leader of five nodes, repeatedly, while this number of its voters can no longer query
/// it. Returns whether another leader is elected.
fn is_replaced(blind: usize) -> bool {
    on_virtual_time(async {
        let unserved = Arc::<Mutex<Unserved>>::default();
        let (started, of_layer) = (Cell::new(0), Arc::clone(&unserved));
        let layer = move |inner| {
            let number = started.replace(started.get() + 1);
            Arc::new(BlindBus { inner, number, unserved: Arc::clone(&of_layer) }) as SharedBus
        };
        let fleet = Fleet::bootstrapped_on(3, 5, default_settings, Box::new(layer)).await;
        let mut tokens = fleet.announce_all().await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        let others = (0..NAMES.len()).filter(|number| NAMES[*number] != leader.as_str()).take(blind).collect();
        let key = keys().write(&Key::Raft(fleet.replicas[&leader].id().0, RaftCall::PreVote));
        *unserved.lock().unwrap_or_else(PoisonError::into_inner) = Unserved { key, nodes: others };
        for _ in 0..50 {
            tokens.remove(&leader);
            sleep(Duration::from_millis(70)).await;
            if fleet.leaders() != [leader.clone()] {
                return true;
            }
            tokens.insert(leader.clone(), fleet.announce(&leader).await);
            sleep(Duration::from_millis(33)).await;
        }
        false
    })
}

#[test]
fn voters_that_reach_their_leader_refuse_those_that_have_lost_it() {
    assert!(!is_replaced(2), "a minority has lost the leader");
    assert!(is_replaced(3), "a majority has lost the leader");
}

/// The voters have lost it already, and its disk may be slow.
#[test]
fn a_leader_that_shuts_down_no_longer_counts_itself_leader() {
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(11, 3, default_settings).await;
        let leader = fleet.leader().await;
        // Its core has not ended yet.
        let _ = fleet.replicas[&leader].shutdown().now_or_never();
        assert!(fleet.leaders().is_empty());
        sleep(Duration::from_millis(1)).await;
        assert!(!fleet.view(&leader).is_leader);
    });
}
