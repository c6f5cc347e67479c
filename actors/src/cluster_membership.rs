//! Which cluster a node belongs to, and a bus that keeps clusters apart.
//!
//! Two fleets of one name that were founded apart must not merge: their ledgers promise different things under the same
//! names. Each ledger has a [`ClusterId`], drawn by its founder. A node belongs to the cluster of its own ledger. One
//! without a ledger belongs to the first whose coordinator it hears, for as long as it hears of it; it ignores beacons,
//! awards, calls, signals and questions of every other.
//!
//! Nobody has to think of that: [`ClusterBus`] puts the cluster around whatever concerns missions, and lets in what is its own.

use crate::bus::{BusError, Layer, MessageContent, Query, Reply, Sample, SharedBus, Stream, refuse_in_background};
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::Keys;
use consort_protocol::message::ClusterEnvelope;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, info};

/// How long a node without a ledger stays with a cluster of which it hears nothing. A guess: several times what the longest
/// election takes, and as long as gossip remembers a node that has gone.
pub const MEMBERSHIP_TIMEOUT: Duration = Duration::from_secs(30);

/// A node's cluster. Clones are one.
#[derive(Debug, Clone)]
pub struct ClusterMembership(Arc<watch::Sender<Sworn>>);

#[derive(Debug, Clone, Copy, PartialEq)]
enum Sworn {
    No,
    /// To the first cluster heard, which was heard last at that instant.
    Heard(ClusterId, Instant),
    /// By its own ledger.
    Kept(ClusterId),
}

impl Sworn {
    fn cluster(self) -> Option<ClusterId> {
        match self {
            Sworn::Heard(cluster, at) => (at.elapsed() < MEMBERSHIP_TIMEOUT).then_some(cluster),
            Sworn::Kept(cluster) => Some(cluster),
            Sworn::No => None,
        }
    }
}

impl Default for ClusterMembership {
    fn default() -> Self {
        ClusterMembership(Arc::new(watch::Sender::new(Sworn::No)))
    }
}

impl ClusterMembership {
    /// The cluster that this node belongs to at present.
    pub fn cluster(&self) -> Option<ClusterId> {
        self.0.borrow().cluster()
    }

    /// The node's own ledger says so; it prevails over what was heard.
    pub fn set_from_ledger(&self, cluster: ClusterId) {
        self.0.send_replace(Sworn::Kept(cluster));
    }

    /// Whether a message of this cluster is for this node; a node that belongs nowhere joins.
    fn admits(&self, cluster: ClusterId) -> bool {
        let mut admitted = false;
        self.0.send_if_modified(|sworn| {
            let before = sworn.cluster();
            admitted = before.is_none_or(|own| own == cluster);
            if admitted && !matches!(sworn, Sworn::Kept(_)) {
                *sworn = Sworn::Heard(cluster, Instant::now());
            }
            before.is_none()
        });
        admitted
    }

    /// Tells the cluster of this node, now and whenever it changes; looks at it now and then, since it may be forgotten.
    pub(crate) async fn report_changes(self, mut tell: impl FnMut(Option<ClusterId>) -> bool) {
        let mut changes = self.0.subscribe();
        let mut told = None;
        loop {
            let own = changes.borrow_and_update().cluster();
            if own != told {
                info!(cluster = own.map(tracing::field::display), "belongs to a cluster");
                told = own;
                if !tell(own) {
                    return;
                }
            }
            let looked = tokio::time::timeout(MEMBERSHIP_TIMEOUT / 6, changes.changed()).await;
            if let Ok(Err(_)) = looked {
                return;
            }
        }
    }
}

/// A bus on which whatever concerns missions stays within the node's cluster. Everything else passes as it is.
pub struct ClusterBus {
    bus: SharedBus,
    keys: Keys,
    allegiance: ClusterMembership,
}

impl ClusterBus {
    /// Keeps what passes on `bus` within the cluster of `allegiance`.
    pub fn new(bus: SharedBus, keys: Keys, allegiance: ClusterMembership) -> ClusterBus {
        ClusterBus { bus, keys, allegiance }
    }

    fn wrap(&self, key: &str, payload: Bytes) -> Result<Bytes, BusError> {
        if !self.keys.is_cluster_scoped(key) {
            return Ok(payload);
        }
        let within = ClusterEnvelope { cluster: self.allegiance.cluster(), payload: payload.to_vec() };
        codec::encode(&within).map(Bytes::from).map_err(|problem| BusError::Failed {
            operation: format!("say something on {key}"),
            problem: problem.to_string(),
        })
    }
}

/// What is in a message, if it is for this node.
fn unwrap(allegiance: &ClusterMembership, payload: &[u8]) -> Result<Bytes, String> {
    let ClusterEnvelope { cluster, payload } = codec::decode(payload).map_err(|problem| problem.to_string())?;
    match cluster {
        Some(cluster) if !allegiance.admits(cluster) => {
            let own = allegiance.cluster().map_or("none".to_owned(), |own| own.to_string());
            Err(format!("it is of cluster {cluster}, where this node belongs to {own}: they do not merge"))
        }
        _ => Ok(payload.into()),
    }
}

impl Layer for ClusterBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, said: MessageContent) -> Result<MessageContent, BusError> {
        Ok(MessageContent { payload: self.wrap(key, said.payload)?, ..said })
    }

    fn incoming_publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        if !self.keys.is_cluster_scoped(key_expr) {
            return samples;
        }
        let allegiance = self.allegiance.clone();
        samples.filter_map(move |sample| match unwrap(&allegiance, &sample.payload) {
            Ok(payload) => Some(Sample { payload, ..sample }),
            Err(problem) => {
                debug!(%problem, "not heard");
                None
            }
        })
    }

    fn outgoing_query(&self, key_expr: &str, said: MessageContent) -> Result<(MessageContent, ()), BusError> {
        Ok((MessageContent { payload: self.wrap(key_expr, said.payload)?, ..said }, ()))
    }

    /// Whoever answered let the question in, and so is of this cluster.
    fn incoming_replies(&self, (): (), replies: Stream<Reply>) -> Stream<Reply> {
        replies
    }

    fn incoming_queries(&self, key_expr: &str, incoming_queries: Stream<Query>) -> Stream<Query> {
        if !self.keys.is_cluster_scoped(key_expr) {
            return incoming_queries;
        }
        let allegiance = self.allegiance.clone();
        incoming_queries.filter_map(move |query| match unwrap(&allegiance, &query.payload) {
            Ok(payload) => Some(Query { payload, ..query }),
            Err(problem) => {
                debug!(key = query.key, %problem, "not answered");
                refuse_in_background(query, problem);
                None
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::{Bus, Delivery, Encoding, LinkModel, VirtualNetwork};
    use consort_protocol::ids::{FleetId, NodeId};
    use consort_protocol::keys::Key;

    const ONE: ClusterId = ClusterId(1);
    const OTHER: ClusterId = ClusterId(2);

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_node_joins_the_first_it_hears_until_it_hears_no_more_of_it() {
        let allegiance = ClusterMembership::default();
        assert_eq!(allegiance.cluster(), None);
        assert!(allegiance.admits(ONE) && !allegiance.admits(OTHER));
        tokio::time::advance(MEMBERSHIP_TIMEOUT / 2).await;
        assert!(allegiance.admits(ONE));
        tokio::time::advance(MEMBERSHIP_TIMEOUT * 2 / 3).await;
        assert_eq!(allegiance.cluster(), Some(ONE));
        tokio::time::advance(MEMBERSHIP_TIMEOUT).await;
        assert_eq!(allegiance.cluster(), None);
        assert!(allegiance.admits(OTHER));
        allegiance.set_from_ledger(ONE);
        tokio::time::advance(MEMBERSHIP_TIMEOUT * 2).await;
        assert!(allegiance.admits(ONE) && !allegiance.admits(OTHER));
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn what_concerns_missions_stays_within_a_cluster_and_all_else_passes() {
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let end = |name: &str, cluster| {
            let allegiance = ClusterMembership::default();
            allegiance.set_from_ledger(cluster);
            let bus: SharedBus = Arc::new(network.bus(NodeId::new(name).unwrap()));
            ClusterBus::new(bus, keys.clone(), allegiance)
        };
        let (ada, bob, cyd) = (end("ada", ONE), end("bob", ONE), end("cyd", OTHER));
        for key in [keys.write(&Key::Beacon), keys.write(&Key::Events(NodeId::new("ada").unwrap()))] {
            let (mut at_bob, mut at_cyd) = (bob.subscribe(&key).await.unwrap(), cyd.subscribe(&key).await.unwrap());
            ada.publish(&key, Bytes::from_static(b"here"), Encoding::Wire, Delivery::Drop).await.unwrap();
            assert_eq!(at_bob.recv().await.unwrap().payload, "here");
            tokio::time::sleep(Duration::from_secs(1)).await;
            assert_eq!(at_cyd.try_recv().is_some(), key.ends_with("events/ada"), "{key}");
        }
        let key = keys.write(&Key::ActiveMissions(NodeId::new("bob").unwrap()));
        let mut asked = bob.serve(&key).await.unwrap();
        tokio::spawn(async move {
            while let Some(query) = asked.recv().await {
                query.replier.reply(&query.key, query.payload.clone(), Encoding::Wire).await.unwrap();
            }
        });
        let ask = async |who: &ClusterBus| {
            let mut replies = who.query(&key, Bytes::from_static(b"?"), Duration::from_secs(1)).await.unwrap();
            replies.recv().await.unwrap().payload
        };
        assert_eq!(ask(&ada).await, Ok(Bytes::from_static(b"?")));
        assert!(ask(&cyd).await.unwrap_err().contains("they do not merge"));
    }
}
