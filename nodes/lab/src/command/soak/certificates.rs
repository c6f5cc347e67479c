//! Certificates of a closed fleet: of its nodes, and of the person in whose name the clients make requests.

use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::trust::SigningBus;
use consort_bus::zenoh_bus::LinkTrust;
use consort_nodes::certs::CertificateStore;
use consort_nodes::exit::Failure;
use consort_nodes::trust::person_keyring;
use consort_nodes::wiring::link_trust;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{AccessScope, Identity, MissionRights, NodeRole, Principal, ServedName};
use consort_tests::slug;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Days for which the certificates are valid.
const DAYS: u32 = 30;

/// Name of the person.
const PERSON: &str = "soak-client";

/// Certificates of all principals of the fleet, in a folder as `consort cert` writes it.
pub(super) struct Certificates {
    folder: PathBuf,
    keys: Keys,
}

impl Certificates {
    /// Creates an authority in a new folder, and issues the certificates of the person and of the nodes, each with a role.
    /// A host serves all robots and people.
    ///
    /// # Errors
    /// [`Failure`] if there is an authority already, or a file cannot be written.
    pub(super) fn issue<'a>(
        folder: &Path,
        keys: &Keys,
        nodes: impl Iterator<Item = (&'a str, NodeRole)>,
    ) -> Result<Certificates, Failure> {
        let fleet = keys.fleet();
        CertificateStore::create_authority(folder, fleet, DAYS)?;
        let store = CertificateStore::open(folder)?;
        let nodes = nodes.map(|(name, role)| Principal::Node {
            name: slug(name),
            roles: BTreeSet::from([role]),
            serves: (role == NodeRole::Host).then(ServedName::all).into_iter().collect(),
        });
        let person =
            Principal::Person { name: slug(PERSON), scope: AccessScope::Operate, missions: MissionRights::All };
        for principal in nodes.chain([person]) {
            store.issue(&Identity { fleet: fleet.clone(), principal }, &[], DAYS, false)?;
        }
        Ok(Certificates { folder: folder.to_owned(), keys: keys.clone() })
    }

    /// Returns the folder of a node.
    pub(super) fn of_node(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns the credentials of links of the person.
    pub(super) fn link_trust(&self) -> LinkTrust {
        link_trust(&self.folder.join(PERSON), self.keys.fleet())
    }

    /// Wraps a bus of the person, so that requests are signed and messages of nodes verified.
    ///
    /// # Errors
    /// [`Failure`] if the files of the person cannot be read.
    pub(super) async fn signing_bus(&self, bus: SharedBus) -> Result<SharedBus, Failure> {
        let clock = Clock::real();
        let (keyring, files) = person_keyring(&self.folder.join(PERSON), self.keys.fleet(), clock)?;
        let signing = SigningBus::open(bus, self.keys.clone(), Arc::new(keyring), files.revoked, clock).await;
        Ok(Arc::new(signing.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?))
    }
}
