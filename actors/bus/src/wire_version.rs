//! The wire version that a node writes, and the check that its program reads the version of its
//! fleet.

use crate::bus::{BusError, SharedBus};
use crate::tasks::Tasks;
use consort_protocol::codec;
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_protocol::versions::VersionRange;
use std::sync::Arc;
use tokio::sync::watch;
use tracing::{debug, info, warn};

/// Wire version that a node writes: the oldest version that it reads, until it receives the version
/// of its fleet. Clones share the value.
#[derive(Debug, Clone)]
pub struct WireVersion {
    written: Arc<watch::Sender<WrittenVersion>>,
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
        WireVersion::starting_at(supported.oldest, supported)
    }

    /// Creates the version of a node that reads `supported` and first writes `version`, as far as
    /// it reads it.
    pub fn starting_at(version: u8, supported: VersionRange) -> WireVersion {
        let version = version.clamp(supported.oldest, supported.newest);
        let first = WrittenVersion { cluster: None, version };
        WireVersion { written: Arc::new(watch::Sender::new(first)), supported }
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
        let changed = self.written.send_if_modified(|own| {
            let version = if own.cluster == cluster { version.max(own.version) } else { version };
            let before = std::mem::replace(own, WrittenVersion { cluster, version });
            before.version != version
        });
        if changed {
            info!(version, "adopted the fleet's wire version");
        }
    }

    /// Adopts the versions that the beacons of this node's cluster contain, except those that
    /// `refuted` rejects: a single voter cannot end the other nodes by an invented version.
    ///
    /// # Errors
    /// [`BusError`] if the bus is closed.
    pub async fn follow_beacons(
        self,
        bus: &SharedBus,
        keys: &Keys,
        tasks: &mut Tasks,
        refuted: impl Fn(u8) -> bool + Send + 'static,
    ) -> Result<(), BusError> {
        let mut beacons = bus.subscribe(&keys.write(&Key::Beacon)).await?;
        tasks.spawn(async move {
            let mut ignored = None;
            while let Some(sample) = beacons.recv().await {
                match codec::decode::<Beacon>(&sample.payload) {
                    Ok(beacon) if beacon.wire.is_some_and(&refuted) => {
                        // Beacons are frequent.
                        if ignored.replace(beacon.wire) != Some(beacon.wire) {
                            warn!(node = %beacon.node, version = beacon.wire, "wire version ignored: most voters cannot read it");
                        }
                    }
                    Ok(beacon) => self.adopt(beacon.cluster, beacon.wire),
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
}
