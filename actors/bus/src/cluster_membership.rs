//! A node's cluster membership, and a bus layer that keeps clusters apart.
//!
//! Two fleets with the same name that were founded separately must not merge: their ledgers hold
//! different commitments under the same names. Each ledger has a [`ClusterId`], drawn by its
//! founder. A node with a ledger belongs to the cluster of that ledger. A node without a ledger
//! joins the cluster of the first coordinator that it receives a message from, and stays while such
//! messages arrive. It ignores beacons, awards, calls, signals and queries of all other clusters.
//!
//! [`ClusterBus`] applies this to every message about missions: it adds the cluster to outgoing
//! messages and drops incoming messages of other clusters. Actors need no code for it.

use crate::bus::{BusError, Query, Sample, SharedBus, Stream};
use crate::layer::{Layer, MessageContent, refuse_in_background};
use bytes::Bytes;
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::Keys;
use consort_protocol::message::ClusterEnvelope;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, info};

/// Time after the last contact at which a node without a ledger leaves its cluster. A guess:
/// several times the longest election, and as long as gossip keeps the record of a node that is
/// down.
const MEMBERSHIP_TIMEOUT: Duration = Duration::from_secs(30);

/// Cluster of a node. Clones share the value.
#[derive(Debug, Clone)]
pub struct ClusterMembership(Arc<watch::Sender<Membership>>);

#[derive(Debug, Clone, Copy, PartialEq)]
enum Membership {
    None,
    /// Joined by contact, with the instant of the last contact.
    ByContact(ClusterId, Instant),
    /// Fixed by the node's own ledger.
    ByLedger(ClusterId),
}

impl Membership {
    fn cluster(self) -> Option<ClusterId> {
        match self {
            Membership::ByContact(cluster, at) => (at.elapsed() < MEMBERSHIP_TIMEOUT).then_some(cluster),
            Membership::ByLedger(cluster) => Some(cluster),
            Membership::None => None,
        }
    }
}

impl Default for ClusterMembership {
    fn default() -> Self {
        ClusterMembership(Arc::new(watch::Sender::new(Membership::None)))
    }
}

impl ClusterMembership {
    /// Returns the cluster that this node belongs to at present.
    pub fn cluster(&self) -> Option<ClusterId> {
        self.0.borrow().cluster()
    }

    /// Sets the cluster of the node's own ledger. It replaces a membership by contact.
    pub fn set_from_ledger(&self, cluster: ClusterId) {
        self.0.send_replace(Membership::ByLedger(cluster));
    }

    /// Checks whether a message of this cluster is for this node. A node without a cluster joins
    /// it.
    fn admits(&self, cluster: ClusterId) -> bool {
        let mut admitted = false;
        self.0.send_if_modified(|membership| {
            let before = membership.cluster();
            admitted = before.is_none_or(|own| own == cluster);
            if admitted && !matches!(membership, Membership::ByLedger(_)) {
                *membership = Membership::ByContact(cluster, Instant::now());
            }
            before.is_none()
        });
        admitted
    }

    /// Passes the node's cluster to `report`, immediately and on every change, until `report`
    /// returns false. It also polls, since a membership by contact expires without an event.
    pub async fn report_changes(self, mut report: impl FnMut(Option<ClusterId>) -> bool) {
        let mut changes = self.0.subscribe();
        let mut reported = None;
        loop {
            let own = changes.borrow_and_update().cluster();
            if own != reported {
                info!(cluster = own.map(tracing::field::display), "cluster membership changed");
                reported = own;
                if !report(own) {
                    return;
                }
            }
            let timed = tokio::time::timeout(MEMBERSHIP_TIMEOUT / 6, changes.changed()).await;
            if let Ok(Err(_)) = timed {
                return;
            }
        }
    }
}

/// Bus that restricts messages about missions to the node's cluster. Other messages pass unchanged.
pub struct ClusterBus {
    bus: SharedBus,
    keys: Keys,
    membership: ClusterMembership,
}

impl ClusterBus {
    /// Creates a layer over `bus` for the cluster of `membership`.
    pub fn new(bus: SharedBus, keys: Keys, membership: ClusterMembership) -> ClusterBus {
        ClusterBus { bus, keys, membership }
    }

    fn wrap(&self, key: &str, payload: Bytes) -> Result<Bytes, BusError> {
        if !self.keys.is_cluster_scoped(key) {
            return Ok(payload);
        }
        let envelope = ClusterEnvelope { cluster: self.membership.cluster(), payload: payload.to_vec() };
        codec::encode(&envelope).map(Bytes::from).map_err(|problem| BusError::Failed {
            operation: format!("publish on {key}"),
            problem: problem.to_string(),
        })
    }
}

/// The message is not for this node.
#[derive(Debug, thiserror::Error)]
enum EnvelopeError {
    /// The envelope cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Expected while two clusters have the same name.
    #[error(
        "message of cluster {cluster} rejected: this node belongs to cluster {}",
        own.map_or("none".to_owned(), |own| own.to_string())
    )]
    OtherCluster { cluster: ClusterId, own: Option<ClusterId> },
}

/// Returns the content of a message if it is for this node.
fn open_envelope(membership: &ClusterMembership, payload: &[u8]) -> Result<Bytes, EnvelopeError> {
    let ClusterEnvelope { cluster, payload } = codec::decode(payload)?;
    match cluster {
        Some(cluster) if !membership.admits(cluster) => {
            Err(EnvelopeError::OtherCluster { cluster, own: membership.cluster() })
        }
        _ => Ok(payload.into()),
    }
}

impl Layer for ClusterBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, content: MessageContent) -> Result<MessageContent, BusError> {
        Ok(MessageContent { payload: self.wrap(key, content.payload)?, ..content })
    }

    fn incoming_publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        if !self.keys.is_cluster_scoped(key_expr) {
            return samples;
        }
        let membership = self.membership.clone();
        samples.filter_map(move |sample| match open_envelope(&membership, &sample.payload) {
            Ok(payload) => Some(Sample { payload, ..sample }),
            Err(problem) => {
                debug!(%problem, "dropped a publication of another cluster");
                None
            }
        })
    }

    // A service replies only to queries of its own cluster, so the replies need no check.
    fn outgoing_query(&self, key_expr: &str, content: MessageContent) -> Result<(MessageContent, ()), BusError> {
        Ok((MessageContent { payload: self.wrap(key_expr, content.payload)?, ..content }, ()))
    }

    fn incoming_queries(&self, key_expr: &str, incoming_queries: Stream<Query>) -> Stream<Query> {
        if !self.keys.is_cluster_scoped(key_expr) {
            return incoming_queries;
        }
        let membership = self.membership.clone();
        incoming_queries.filter_map(move |query| match open_envelope(&membership, &query.payload) {
            Ok(payload) => Some(Query { payload, ..query }),
            Err(problem) => {
                debug!(key = query.key, %problem, "refused a query of another cluster");
                refuse_in_background(query, problem.to_string());
                None
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::{Bus, Delivery, Encoding};
    use crate::virtual_bus::{LinkModel, VirtualNetwork};
    use consort_protocol::ids::{FleetId, NodeId};
    use consort_protocol::keys::Key;

    const OWN: ClusterId = ClusterId(1);
    const OTHER: ClusterId = ClusterId(2);

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_node_joins_the_first_cluster_until_contact_is_lost() {
        let membership = ClusterMembership::default();
        assert_eq!(membership.cluster(), None);
        assert!(membership.admits(OWN) && !membership.admits(OTHER));
        tokio::time::advance(MEMBERSHIP_TIMEOUT / 2).await;
        assert!(membership.admits(OWN));
        tokio::time::advance(MEMBERSHIP_TIMEOUT * 2 / 3).await;
        assert_eq!(membership.cluster(), Some(OWN));
        tokio::time::advance(MEMBERSHIP_TIMEOUT).await;
        assert_eq!(membership.cluster(), None);
        assert!(membership.admits(OTHER));
        membership.set_from_ledger(OWN);
        tokio::time::advance(MEMBERSHIP_TIMEOUT * 2).await;
        assert!(membership.admits(OWN) && !membership.admits(OTHER));
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn mission_messages_stay_within_their_cluster() {
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let end = |name: &str, cluster| {
            let membership = ClusterMembership::default();
            membership.set_from_ledger(cluster);
            let bus: SharedBus = Arc::new(network.bus(NodeId::new(name).unwrap()));
            ClusterBus::new(bus, keys.clone(), membership)
        };
        let (ada, bob, cyd) = (end("ada", OWN), end("bob", OWN), end("cyd", OTHER));
        for key in [keys.write(&Key::Beacon), keys.write(&Key::Events(NodeId::new("ada").unwrap()))] {
            let (mut at_bob, mut at_cyd) = (bob.subscribe(&key).await.unwrap(), cyd.subscribe(&key).await.unwrap());
            ada.publish(&key, Bytes::from_static(b"here"), Encoding::Wire, Delivery::Drop).await.unwrap();
            assert_eq!(at_bob.recv().await.unwrap().payload, "here");
            tokio::time::sleep(Duration::from_secs(1)).await;
            assert_eq!(at_cyd.try_recv().is_some(), key.ends_with("events/ada"), "{key}");
        }
        let key = keys.write(&Key::Report(NodeId::new("bob").unwrap()));
        let mut queries = bob.serve(&key).await.unwrap();
        tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
            }
        });
        let query = async |bus: &ClusterBus| {
            let mut replies = bus.query(&key, Bytes::from_static(b"?"), Duration::from_secs(1)).await.unwrap();
            replies.recv().await.unwrap().payload
        };
        assert_eq!(query(&ada).await, Ok(Bytes::from_static(b"?")));
        assert!(query(&cyd).await.unwrap_err().0.contains("this node belongs to cluster"));
    }
}
