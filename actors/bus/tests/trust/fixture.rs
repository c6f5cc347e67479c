//! A fleet with real certificates on the virtual bus.

use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::trust::issue::{CertificateAuthority, IssuedCertificate, Validity, create_authority};
use consort_bus::trust::{Keyring, RevokedFiles, SigningBus, TrustFiles};
use consort_bus::{Bus, Delivery, Encoding, LinkModel, Sample, SharedBus, Stream, VirtualNetwork};
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::{Beacon, ClusterEnvelope};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

pub(crate) const NOW: Duration = Duration::from_secs(1_800_000_000);
pub(crate) const LONG: Validity =
    Validity { from: Duration::from_secs(1_700_000_000), until: Duration::from_secs(1_900_000_000) };

pub(crate) fn ward() -> FleetId {
    FleetId::new("ward").unwrap()
}

pub(crate) fn keys() -> Keys {
    Keys::new(&ward())
}

/// A folder for a single test, removed at its end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new() -> Folder {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("consort-trust-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Folder(folder)
    }

    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let file = self.0.join(name);
        std::fs::write(&file, text).unwrap();
        file
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// An authority, and a network of nodes with its certificates.
pub(crate) struct Fixture {
    pub(crate) folder: Folder,
    pub(crate) ca: IssuedCertificate,
    pub(crate) network: VirtualNetwork,
}

impl Fixture {
    pub(crate) fn new() -> Fixture {
        let ca = create_authority(&ward(), LONG).unwrap();
        Fixture { folder: Folder::new(), ca, network: VirtualNetwork::new(1, LinkModel::LAN) }
    }

    pub(crate) fn authority(&self) -> CertificateAuthority {
        CertificateAuthority::from_pem(&self.ca.certificate, &self.ca.key).unwrap()
    }

    pub(crate) fn files(&self, name: &str, issued: &IssuedCertificate) -> TrustFiles {
        TrustFiles {
            authority: self.folder.write("ca.pem", &self.ca.certificate),
            certificate: self.folder.write(&format!("{name}.pem"), &issued.certificate),
            key: self.folder.write(&format!("{name}.key"), &issued.key),
            revoked: RevokedFiles::default(),
        }
    }

    pub(crate) fn plain(&self, name: &str) -> SharedBus {
        Arc::new(self.network.bus(NodeId::new(name).unwrap()))
    }

    /// Starts a node with a certificate for `identity`.
    pub(crate) async fn node(&self, name: &str, identity: &str) -> SigningBus {
        self.incarnation(name, identity, 1).await
    }

    pub(crate) async fn incarnation(&self, name: &str, identity: &str, incarnation: u64) -> SigningBus {
        let issued = self.authority().issue(&identity.parse().unwrap(), &[], LONG).unwrap();
        self.with(self.plain(name), self.files(name, &issued), incarnation).await
    }

    pub(crate) async fn with(&self, bus: SharedBus, files: TrustFiles, incarnation: u64) -> SigningBus {
        let keyring = Arc::new(files.open(&ward(), NOW, incarnation).unwrap());
        let clock = Clock::virtual_at(NOW.as_millis() as u64);
        SigningBus::open(bus, keys(), keyring, files.revoked, clock).await.unwrap()
    }
}

pub(crate) async fn publish(bus: &dyn Bus, key: &Key, content: &[u8]) {
    let payload = Bytes::copy_from_slice(content);
    bus.publish(&keys().write(key), payload, Encoding::Wire, Delivery::Block).await.unwrap();
}

/// Returns all received payloads until no more arrive.
pub(crate) async fn received(stream: &mut Stream<Sample>) -> Vec<Bytes> {
    let mut received = Vec::new();
    while let Ok(Some(sample)) = tokio::time::timeout(Duration::from_secs(5), stream.recv()).await {
        received.push(sample.payload);
    }
    received
}

pub(crate) fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

pub(crate) fn beacon(of: &str) -> Vec<u8> {
    let beacon = Beacon { node: node(of), term: 3, voters: BTreeSet::new(), since_ms: 0, cluster: None, wire: None };
    codec::encode(&ClusterEnvelope { cluster: None, payload: codec::encode(&beacon).unwrap() }).unwrap()
}

/// Publishes until a message is received: messages before the certificate is known are lost.
pub(crate) async fn introduce(to: &mut Stream<Sample>, bus: &dyn Bus, key: &Key, content: &[u8]) {
    for _ in 0..10 {
        publish(bus, key, content).await;
        if !received(to).await.is_empty() {
            return;
        }
    }
    panic!("the message was never received");
}

pub(crate) fn event(of: &str, number: u64) -> Vec<u8> {
    serde_json::json!({ "node": of, "sequence": number, "at_ms": 1, "event": "left" }).to_string().into_bytes()
}

pub(crate) async fn publish_with(bus: &dyn Bus, key: &Key, content: &[u8], attachment: &Bytes) {
    let payload = Bytes::copy_from_slice(content);
    let key = keys().write(key);
    bus.publish_with_attachment(&key, payload, attachment.clone(), Encoding::Json, Delivery::Block).await.unwrap();
}

/// Returns a keyring that verifies by the authority alone.
pub(crate) fn verifier(fixture: &Fixture) -> Keyring {
    let issued = fixture.authority().issue(&"consort://ward/node/ada?roles=".parse().unwrap(), &[], LONG).unwrap();
    fixture.files("ada", &issued).open(&ward(), NOW, 1).unwrap()
}
