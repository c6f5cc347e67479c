//! The certificates of a virtual fleet that is closed. All of them follow from its seed, and none is in a file.

use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_actors::node::NodeSettings;
use consort_actors::trust::issue::{Authorising, Draw, Issued, Validity, found_drawn};
use consort_actors::trust::{Keyring, SealedBus};
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::Keys;
use consort_protocol::trust::{Bearer, Identity, NodeRole};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// From 1970 to 2049: stories begin at the one end, chaos in between.
const LONG: Validity = Validity { from: Duration::ZERO, until: Duration::from_secs(2_493_072_000) };

/// An authority, and what it issues.
pub struct Papers {
    seed: u64,
    fleet: FleetId,
    authority: Issued,
    issuer: Authorising,
}

impl Papers {
    /// The authority that follows from a seed.
    pub fn new(fleet: FleetId, seed: u64) -> Papers {
        let authority = found_drawn(&fleet, LONG, draw(seed, "authority")).expect("a certificate can be made");
        let issuer = Authorising::read(&authority.certificate, &authority.key).expect("what was just made");
        Papers { seed, fleet, authority, issuer }
    }

    /// What a node of these roles proves itself with, in this life of it.
    pub fn of(&self, node: &NodeId, roles: BTreeSet<NodeRole>, life: u64) -> Keyring {
        let bearer = Bearer::Node { name: node.clone(), roles };
        let identity = Identity { fleet: self.fleet.clone(), bearer };
        let drawn = draw(self.seed, node.as_str());
        let issued = self.issuer.issue_drawn(&identity, LONG, drawn).expect("a certificate can be made");
        let keyring = Keyring::of(self.fleet.clone(), &self.authority.certificate, &issued, Duration::ZERO, life);
        keyring.expect("what was just made")
    }

    /// A node's end of the network, on which what it says is sealed.
    pub async fn sealed(&self, bus: SharedBus, keyring: Keyring, clock: Clock) -> Arc<SealedBus> {
        let keys = Keys::new(&self.fleet);
        let sealed = SealedBus::open(bus, keys, Arc::new(keyring), None, clock).await;
        Arc::new(sealed.expect("a virtual bus"))
    }

    /// What a node's certificate must let it be.
    pub(crate) fn roles(settings: &NodeSettings) -> BTreeSet<NodeRole> {
        let roles = [
            (settings.robot.is_some(), NodeRole::Robot),
            (settings.may_vote, NodeRole::Voter),
            (settings.host.is_some(), NodeRole::Host),
        ];
        roles.into_iter().filter_map(|(needed, role)| needed.then_some(role)).collect()
    }
}

/// What somebody's key and certificate are drawn from.
fn draw(seed: u64, name: &str) -> Draw {
    let mut from = [0; 32];
    from[..8].copy_from_slice(&seed.to_be_bytes());
    for (place, byte) in name.bytes().enumerate() {
        from[8 + place % 24] ^= byte;
    }
    let mut chance = ChaCha8Rng::from_seed(from);
    let (mut key, mut serial) = ([0; 32], [0; 16]);
    chance.fill_bytes(&mut key);
    chance.fill_bytes(&mut serial);
    Draw { key, serial }
}
