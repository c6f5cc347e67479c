//! The wire version that a node writes, and the check that its program reads the version of its
//! fleet.

use crate::bus::{BusError, SharedBus};
use crate::tasks::Tasks;
use consort_protocol::codec;
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_protocol::versions::{VersionEvidence, VersionRange};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Wire version that a node writes: the oldest version that it writes, until it receives the version
/// of its fleet. Clones share the value.
#[derive(Debug, Clone)]
pub struct WireVersion {
    written: Arc<watch::Sender<WrittenVersion>>,
    /// Oldest version that the node writes.
    oldest: u8,
    supported: VersionRange,
}

/// A wire version, and the cluster that it was received from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WrittenVersion {
    /// Cluster that announced this version.
    cluster: Option<ClusterId>,
    version: u8,
}

impl Default for WireVersion {
    fn default() -> Self {
        WireVersion::new(VersionRange::OWN)
    }
}

impl WireVersion {
    /// Creates the version of a node that reads `supported`.
    pub fn new(supported: VersionRange) -> WireVersion {
        WireVersion::at_least(supported.oldest, supported)
    }

    /// Creates the version of a node that reads `supported` and writes no version before `oldest`,
    /// as far as it reads it, even if its fleet does.
    pub fn at_least(oldest: u8, supported: VersionRange) -> WireVersion {
        let oldest = oldest.clamp(supported.oldest, supported.newest);
        let first = WrittenVersion { cluster: None, version: oldest };
        WireVersion { written: Arc::new(watch::Sender::new(first)), oldest, supported }
    }

    /// Returns the versions that the node reads.
    pub fn supported(&self) -> VersionRange {
        self.supported
    }

    /// Returns the version to write.
    pub fn get(&self) -> u8 {
        self.written.borrow().version
    }

    /// Subscribes to changes of the version.
    pub fn subscribe(&self) -> watch::Receiver<WrittenVersion> {
        self.written.subscribe()
    }

    /// Adopts the version that a cluster writes, as stated by its ledger or its coordinator. `None`
    /// (a cluster without a version yet) changes nothing. Within a cluster the version never
    /// decreases: a lower version comes from a node that has not received the last increase, for
    /// example after a partition.
    pub fn adopt(&self, cluster: Option<ClusterId>, version: Option<u8>) {
        let Some(version) = version else { return };
        // A version that the node cannot read is adopted as it is, since it ends the node.
        let version = if self.supported.contains(version) { version.max(self.oldest) } else { version };
        let changed = self.written.send_if_modified(|own| {
            let version = if own.cluster == cluster { version.max(own.version) } else { version };
            let before = std::mem::replace(own, WrittenVersion { cluster, version });
            before.version != version
        });
        if changed {
            info!(version, "adopted the fleet's wire version");
        }
    }

    /// Adopts the versions that the beacons of this node's cluster contain. `judge` states what is
    /// known of a version. A single voter cannot end the other nodes by an invented version: a version
    /// that most voters cannot read is ignored, and a version that this program cannot read is adopted
    /// only if 2 voters can read it, or if beacons repeat it for 30 s and no beacon
    /// contains a version that this program reads.
    ///
    /// # Errors
    /// [`BusError`] if the bus is closed.
    pub async fn follow_beacons(
        self,
        bus: &SharedBus,
        keys: &Keys,
        tasks: &mut Tasks,
        judge: impl Fn(u8) -> VersionEvidence + Send + 'static,
    ) -> Result<(), BusError> {
        let mut beacons = bus.subscribe(&keys.write(&Key::Beacon)).await?;
        tasks.spawn(async move {
            let mut filter = BeaconFilter::new(self.supported);
            while let Some(sample) = beacons.recv().await {
                match codec::decode::<Beacon>(&sample.payload) {
                    Ok(beacon) if filter.accepts(&beacon, &judge, Instant::now()) => {
                        self.adopt(beacon.cluster, beacon.wire);
                    }
                    Ok(_) => {}
                    Err(problem) => debug!(%problem, "dropped a malformed beacon"),
                }
            }
        });
        Ok(())
    }

    /// Waits until the fleet writes a version that this program cannot read. Returns advice for the
    /// operator.
    pub async fn wait_unsupported(&self) -> String {
        let mut versions = self.written.subscribe();
        let version = versions.wait_for(|own| !self.supported.contains(own.version)).await.map(|own| own.version);
        unsupported_advice(version.expect("this is the sender"), self.supported)
    }
}

/// Time for which beacons must repeat a version that this program cannot read, if too few voters are
/// known to confirm it. A coordinator that writes another version is heard within this time.
const CONFIRMATION_TIME: Duration = Duration::from_secs(30);

/// Decides which beacons contain a version to be adopted.
#[derive(Debug)]
struct BeaconFilter {
    supported: VersionRange,
    /// The version that was ignored last, for the log: beacons are frequent.
    ignored: Option<u8>,
    /// Version that this program cannot read and that waits for confirmation, with the time at which
    /// it was first received.
    unconfirmed: Option<(Option<ClusterId>, u8, Instant)>,
}

impl BeaconFilter {
    fn new(supported: VersionRange) -> BeaconFilter {
        BeaconFilter { supported, ignored: None, unconfirmed: None }
    }

    fn accepts(&mut self, beacon: &Beacon, judge: impl Fn(u8) -> VersionEvidence, now: Instant) -> bool {
        let Some(version) = beacon.wire else { return true };
        let evidence = judge(version);
        let is_readable = self.supported.contains(version);
        if is_readable && evidence != VersionEvidence::Refuted {
            self.unconfirmed = None;
        }
        match (evidence, is_readable) {
            (VersionEvidence::Confirmed, _) | (VersionEvidence::Unknown, true) => true,
            (VersionEvidence::Refuted, _) => {
                if self.ignored.replace(version) != Some(version) {
                    warn!(node = %beacon.node, version, "wire version ignored: most voters cannot read it");
                }
                false
            }
            (VersionEvidence::Unknown, false) => {
                let same =
                    |(cluster, unconfirmed, _): &(_, u8, _)| *cluster == beacon.cluster && *unconfirmed == version;
                let known = self.unconfirmed.filter(same);
                if known.is_none() {
                    warn!(node = %beacon.node, version, "wire version not supported; waits for its confirmation");
                }
                let (.., since) = *self.unconfirmed.insert(known.unwrap_or((beacon.cluster, version, now)));
                now.duration_since(since) >= CONFIRMATION_TIME
            }
        }
    }
}

fn unsupported_advice(fleet: u8, own: VersionRange) -> String {
    let release = env!("CARGO_PKG_VERSION");
    let advice = match fleet > own.newest {
        true => "install the release that the other nodes run",
        false => {
            "first bring the other nodes, one at a time, to a release between the two, and run `consort upgrade --finish`"
        }
    };
    format!("the fleet writes wire version {fleet}, but this program, {release}, reads {own}: {advice}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::codec::VersionedMessage as _;
    use consort_protocol::ids::NodeId;
    use consort_protocol::message::Exchange;
    use std::collections::BTreeSet;

    #[tokio::test]
    async fn a_node_with_an_unsupported_version_gets_advice() {
        let wire = WireVersion::default();
        assert_eq!(wire.get(), VersionRange::OWN.oldest);
        let (one, other) = (Some(ClusterId(1)), Some(ClusterId(2)));
        wire.adopt(one, Some(VersionRange::OWN.newest));
        assert_eq!(wire.get(), VersionRange::OWN.newest);
        for lower in [None, Some(VersionRange::OWN.oldest)] {
            wire.adopt(one, lower);
            assert_eq!(wire.get(), VersionRange::OWN.newest, "the version never decreases within a cluster");
        }
        wire.adopt(other, Some(VersionRange::OWN.oldest));
        assert_eq!(wire.get(), VersionRange::OWN.oldest, "another cluster has its own version");
        let waiting_version = wire.clone();
        let advice = tokio::spawn(async move { waiting_version.wait_unsupported().await });
        wire.adopt(other, Some(VersionRange::OWN.newest + 1));
        let advice = advice.await.unwrap();
        assert!(advice.ends_with(": install the release that the other nodes run"), "{advice}");
        assert!(
            unsupported_advice(0, VersionRange::OWN)
                .contains("bring the other nodes, one at a time, to a release between"),
            "{}",
            unsupported_advice(0, VersionRange::OWN)
        );
    }

    #[test]
    fn a_node_that_signs_records_returns_to_no_version_without_signatures() {
        let wire = WireVersion::at_least(Exchange::SINCE, VersionRange::OWN);
        assert_eq!(wire.get(), Exchange::SINCE);
        // A beacon of a hostile voter, which names another cluster.
        wire.adopt(Some(ClusterId(1)), Some(VersionRange::OWN.newest));
        wire.adopt(Some(ClusterId(2)), Some(Exchange::SINCE - 1));
        assert_eq!(wire.get(), Exchange::SINCE);
        wire.adopt(Some(ClusterId(1)), Some(VersionRange::OWN.newest));
        assert_eq!(wire.get(), VersionRange::OWN.newest);
        let unsupported = VersionRange::OWN.oldest - 1;
        wire.adopt(Some(ClusterId(3)), Some(unsupported));
        assert_eq!(wire.get(), unsupported);
    }

    #[test]
    fn a_beacon_alone_ends_no_node() {
        let node = NodeId::new("basil").unwrap();
        let beacon = |wire| Beacon {
            node: node.clone(),
            term: 1,
            voters: BTreeSet::new(),
            since_ms: 0,
            cluster: Some(ClusterId(1)),
            wire,
        };
        let (own, unknown) = (VersionRange::OWN.newest, VersionRange::OWN.newest + 1);
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut filter = BeaconFilter::new(VersionRange::OWN);
        let mut accepts = |wire, evidence, seconds| filter.accepts(&beacon(Some(wire)), |_| evidence, at(seconds));
        assert!(accepts(own, VersionEvidence::Unknown, 0));
        assert!(accepts(unknown, VersionEvidence::Confirmed, 0));
        assert!(!accepts(unknown, VersionEvidence::Refuted, 0));
        // Another coordinator still writes a version that the program reads.
        assert!(!accepts(unknown, VersionEvidence::Unknown, 1));
        assert!(accepts(own, VersionEvidence::Unknown, 20));
        assert!(!accepts(unknown, VersionEvidence::Unknown, 31));
        // A beacon that the voters refute contradicts nothing.
        assert!(!accepts(own, VersionEvidence::Refuted, 40));
        assert!(!accepts(unknown, VersionEvidence::Unknown, 60));
        assert!(accepts(unknown, VersionEvidence::Unknown, 61));
    }
}
