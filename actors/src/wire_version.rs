//! Which version of the wire a node writes, and what becomes of one whose program does not read its fleet's.

use crate::bus::{BusError, SharedBus};
use crate::tasks::Tasks;
use consort_protocol::codec;
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_protocol::versions::VersionRange;
use std::sync::Arc;
use tokio::sync::watch;
use tracing::{debug, info};

/// The version of the wire that a node writes: the oldest that it reads, until it has heard what the fleet writes. Clones are one.
#[derive(Debug, Clone)]
pub struct WireVersion(Arc<watch::Sender<WrittenVersion>>);

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct WrittenVersion {
    /// In which cluster that was heard.
    cluster: Option<ClusterId>,
    version: u8,
}

impl Default for WireVersion {
    fn default() -> Self {
        WireVersion(Arc::new(watch::Sender::new(WrittenVersion { cluster: None, version: VersionRange::OWN.oldest })))
    }
}

impl WireVersion {
    /// The version.
    pub fn get(&self) -> u8 {
        self.0.borrow().version
    }

    /// Hears whenever it changes.
    pub(crate) fn subscribe(&self) -> watch::Receiver<WrittenVersion> {
        self.0.subscribe()
    }

    /// Takes in what a cluster writes, as its ledger or whoever coordinates says; of one that is being founded nothing is said.
    /// Within a cluster nothing lowers it: whoever says less has not heard of the last step, or was cut off before it.
    pub(crate) fn adopt(&self, cluster: Option<ClusterId>, version: Option<u8>) {
        let Some(version) = version else { return };
        let news = self.0.send_if_modified(|own| {
            let version = if own.cluster == cluster { version.max(own.version) } else { version };
            let before = std::mem::replace(own, WrittenVersion { cluster, version });
            before.version != version
        });
        if news {
            info!(version, "the fleet writes a version of the wire");
        }
    }

    /// Listens to what coordinators of this node's cluster say.
    pub(crate) async fn follow_beacons(self, bus: &SharedBus, keys: &Keys, tasks: &mut Tasks) -> Result<(), BusError> {
        let mut beacons = bus.subscribe(&keys.write(&Key::Beacon)).await?;
        tasks.spawn(async move {
            while let Some(sample) = beacons.recv().await {
                match codec::decode::<Beacon>(&sample.payload) {
                    Ok(beacon) => self.adopt(beacon.cluster, beacon.wire),
                    Err(problem) => debug!(%problem, "a beacon that cannot be read"),
                }
            }
        });
        Ok(())
    }

    /// Waits until the fleet writes what this program does not read, and says what is to be done.
    pub(crate) async fn wait_unsupported(&self) -> String {
        let mut heard = self.0.subscribe();
        let version = heard.wait_for(|own| !VersionRange::OWN.contains(own.version)).await.map(|own| own.version);
        left_behind(version.expect("this is the sender"))
    }
}

fn left_behind(fleet: u8) -> String {
    let release = env!("CARGO_PKG_VERSION");
    let own = VersionRange::OWN;
    let advice = match fleet > own.newest {
        true => "install the release that the others run",
        false => "bring the others to a release between the two, one at a time, and `consort upgrade --finish`, first",
    };
    format!("the fleet writes version {fleet} of the wire, and this program, {release}, reads {own}: {advice}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn whoever_does_not_read_what_the_fleet_writes_is_told_what_to_do() {
        let wire = WireVersion::default();
        assert_eq!(wire.get(), VersionRange::OWN.oldest);
        let (one, other) = (Some(ClusterId(1)), Some(ClusterId(2)));
        wire.adopt(one, Some(VersionRange::OWN.newest));
        assert_eq!(wire.get(), VersionRange::OWN.newest);
        for late in [None, Some(VersionRange::OWN.oldest)] {
            wire.adopt(one, late);
            assert_eq!(wire.get(), VersionRange::OWN.newest, "within a cluster it never goes down");
        }
        wire.adopt(other, Some(VersionRange::OWN.oldest));
        assert_eq!(wire.get(), VersionRange::OWN.oldest, "of another cluster it is another's");
        let waiting = wire.clone();
        let told = tokio::spawn(async move { waiting.wait_unsupported().await });
        wire.adopt(other, Some(VersionRange::OWN.newest + 1));
        let told = told.await.unwrap();
        assert!(told.ends_with(": install the release that the others run"), "{told}");
        assert!(left_behind(0).contains("bring the others to a release between"), "{}", left_behind(0));
    }
}
