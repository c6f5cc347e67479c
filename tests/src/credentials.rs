//! Certificates of a closed virtual fleet. All of them derive from its seed; none is stored in a
//! file.

use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::trust::issue::{
    CertificateAuthority, IssuedCertificate, KeyMaterial, RevokedCertificate, Validity, create_authority_from,
};
use consort_bus::trust::{Keyring, RevokedFiles, SigningBus};
use consort_fleet::node::NodeSettings;
use consort_protocol::ids::{FleetId, NodeId, PersonId};
use consort_protocol::keys::Keys;
use consort_protocol::trust::{AccessScope, Identity, MissionRights, NodeRole, Principal, ServedName};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// 1970 to 2049. Most tests begin at the start of this range, chaos runs in between.
const LONG: Validity = Validity { from: Duration::ZERO, until: Duration::from_secs(2_493_072_000) };

/// Signatures of the messages of a closed fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signatures {
    /// The signatures of production.
    Ed25519,
    /// Hashes, which take a hundredth of the time.
    Simulated,
}

/// A certificate authority and its issuer.
pub struct Credentials {
    seed: u64,
    signatures: Signatures,
    fleet: FleetId,
    authority: IssuedCertificate,
    issuer: CertificateAuthority,
    /// File with the list of revoked certificates, which all nodes read. It exists once there is a list.
    revoked: PathBuf,
    /// All entries of the list.
    revocations: Mutex<Vec<RevokedCertificate>>,
}

impl Drop for Credentials {
    fn drop(&mut self) {
        // Usually there is none.
        let _ = fs::remove_file(&self.revoked);
    }
}

impl Credentials {
    /// Derives the authority from a seed.
    pub fn new(fleet: FleetId, seed: u64, signatures: Signatures) -> Credentials {
        let authority =
            create_authority_from(&fleet, LONG, draw(seed, "authority")).expect("a certificate can be made");
        let issuer = CertificateAuthority::from_pem(&authority.certificate, &authority.key)
            .expect("the certificate just created");
        Credentials { seed, signatures, fleet, authority, issuer, revoked: new_list(), revocations: Mutex::default() }
    }

    /// Revokes the certificate of a principal, at a time since 1970, unless it is revoked. Nodes read the list within
    /// seconds.
    pub fn revoke(&self, name: &str, since: Duration) {
        let mut serial = draw(self.seed, name).serial.to_vec();
        serial[0] &= 0x7f; // as in the certificate
        let mut revocations = self.revocations.lock().unwrap_or_else(PoisonError::into_inner);
        if revocations.iter().any(|revoked| revoked.serial == serial) {
            return;
        }
        revocations.push(RevokedCertificate { serial, since });
        let number = revocations.len() as u64;
        let list = self.issuer.revocation_list(&revocations, number, LONG).expect("a list can be made");
        fs::write(&self.revoked, list).expect("a file in the folder for temporary files");
    }

    /// Returns the keyring of a node with these roles, for an incarnation of the node. A host serves
    /// everything.
    pub fn keyring_of(&self, node: &NodeId, roles: BTreeSet<NodeRole>, life: u64) -> Keyring {
        self.keyring_serving(node, roles, ServedName::all(), life)
    }

    /// Returns the keyring of a node with these roles that serves these names as a host.
    pub fn keyring_serving(&self, node: &NodeId, roles: BTreeSet<NodeRole>, names: ServedName, life: u64) -> Keyring {
        let serves = roles.contains(&NodeRole::Host).then_some(names).into_iter().collect();
        self.keyring(Principal::Node { name: node.clone(), roles, serves }, node.as_str(), life)
    }

    /// Returns the keyring of a person with this scope.
    pub fn keyring_of_person(&self, name: &str, scope: AccessScope) -> Keyring {
        let person = PersonId::new(name).expect("a name");
        let principal = Principal::Person { name: person, scope, missions: MissionRights::All };
        self.keyring(principal, &format!("person {name}"), 0)
    }

    fn keyring(&self, principal: Principal, material: &str, life: u64) -> Keyring {
        let identity = Identity { fleet: self.fleet.clone(), principal };
        let drawn = draw(self.seed, material);
        let issued = self.issuer.issue_from(&identity, LONG, drawn).expect("a certificate can be made");
        let keyring =
            Keyring::from_issued(self.fleet.clone(), &self.authority.certificate, &issued, Duration::ZERO, life);
        let keyring = keyring.expect("the certificate just created");
        match self.signatures {
            Signatures::Ed25519 => keyring,
            Signatures::Simulated => keyring.with_simulated_signatures(),
        }
    }

    /// Wraps the bus of a node in a bus that signs outgoing messages.
    pub async fn signing_bus(&self, bus: SharedBus, keyring: Keyring, clock: Clock) -> Arc<SigningBus> {
        let keys = Keys::new(&self.fleet);
        let revoked = RevokedFiles { list: Some(self.revoked.clone()), kept: None };
        let signing = SigningBus::open(bus, keys, Arc::new(keyring), revoked, clock).await;
        Arc::new(signing.expect("a virtual bus"))
    }

    /// Returns the roles that the certificate of a node must contain.
    pub(crate) fn roles(settings: &NodeSettings) -> BTreeSet<NodeRole> {
        let roles = [
            (settings.robot.is_some(), NodeRole::Robot),
            (settings.may_vote, NodeRole::Voter),
            (settings.driver_server.is_some(), NodeRole::Host),
        ];
        roles.into_iter().filter_map(|(needed, role)| needed.then_some(role)).collect()
    }
}

/// Returns the path of a list that no other fleet uses.
fn new_list() -> PathBuf {
    static LISTS: AtomicU64 = AtomicU64::new(0);
    let name = format!("consort-revoked-{}-{}.pem", std::process::id(), LISTS.fetch_add(1, Ordering::Relaxed));
    std::env::temp_dir().join(name)
}

/// Derives the key and the serial number of a certificate.
fn draw(seed: u64, name: &str) -> KeyMaterial {
    let mut from = [0; 32];
    from[..8].copy_from_slice(&seed.to_be_bytes());
    for (place, byte) in name.bytes().enumerate() {
        from[8 + place % 24] ^= byte;
    }
    let mut chance = ChaCha8Rng::from_seed(from);
    let (mut key, mut serial) = ([0; 32], [0; 16]);
    chance.fill_bytes(&mut key);
    chance.fill_bytes(&mut serial);
    KeyMaterial { key, serial }
}
