//! What nodes and people prove themselves with, from the folders that `consort cert` makes.

use crate::config::{BusConfig, trust_files};
use crate::exit::Failure;
use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_actors::node::NodeSettings;
use consort_actors::trust::{Keyring, SigningBus, TrustFiles};
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{NodeRole, Principal};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tracing::info;

/// What a node proves itself with, if it has certificates.
pub struct NodeCredentials(Option<(Arc<Keyring>, TrustFiles)>);

impl NodeCredentials {
    /// Reads the files, and sees to it that they are this node's and let it be what it is configured to be.
    ///
    /// # Errors
    /// [`Failure::Usage`] names the file and what is wrong with it.
    pub fn open(bus: &BusConfig, node: &NodeSettings) -> Result<NodeCredentials, Failure> {
        let Some(folder) = &bus.certs else { return Ok(NodeCredentials(None)) };
        let files = trust_files(folder);
        let now = Duration::from_millis(node.clock.wall_ms());
        let keyring = files.open(&node.fleet.fleet, now, node.incarnation);
        let keyring = keyring.map_err(|problem| Failure::Usage(problem.to_string()))?;
        let wanted = needed_roles(node);
        let problem = match &keyring.identity().principal {
            Principal::Node { name, .. } if *name != node.node => {
                Some(format!("it is node {name}'s, and this is {}", node.node))
            }
            Principal::Node { roles, .. } => {
                wanted.iter().find(|(role, _)| !roles.contains(role)).map(|(role, why)| {
                    format!(
                        "it does not let {} be a {role}, and {why}; `consort cert node {0} --roles …` makes one",
                        node.node
                    )
                })
            }
            person @ Principal::Person { .. } => {
                Some(format!("it is {person}'s, and nodes have certificates of their own"))
            }
        };
        match problem {
            Some(problem) => Err(Failure::Usage(format!("{}: {problem}", files.certificate.display()))),
            None => {
                info!(bearer = %keyring.identity().principal, "links are encrypted, and messages signed");
                Ok(NodeCredentials(Some((Arc::new(keyring), files))))
            }
        }
    }

    /// What the node judges others by, if it has certificates.
    pub fn keyring(&self) -> Option<Arc<Keyring>> {
        self.0.as_ref().map(|(keyring, _)| Arc::clone(keyring))
    }

    /// The bus on which messages are sealed, if they are; then the node's settings name who signs and judges records, too.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the node's certificate cannot be shown on the bus.
    pub async fn signing_bus(self, bus: SharedBus, node: &mut NodeSettings) -> Result<SharedBus, Failure> {
        let Some((keyring, files)) = self.0 else { return Ok(bus) };
        let sealed = SigningBus::open(bus, Keys::new(&node.fleet.fleet), keyring, files.revoked, node.clock).await;
        let sealed = sealed.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
        node.record_signer = Some(sealed.record_signer());
        Ok(Arc::new(sealed))
    }
}

/// What a node is configured to be, and by what.
fn needed_roles(node: &NodeSettings) -> Vec<(NodeRole, &'static str)> {
    let all = [
        (node.robot.is_some(), NodeRole::Robot, "it is a robot's"),
        (node.may_vote, NodeRole::Voter, "may_vote is true"),
        (node.driver_server.is_some(), NodeRole::Host, "it hosts a world"),
    ];
    all.into_iter().filter(|(needed, ..)| *needed).map(|(_, role, why)| (role, why)).collect()
}

/// What a person proves himself with.
///
/// # Errors
/// [`Failure::Usage`] names the file and what is wrong with it.
pub fn person_keyring(certs: &Path, fleet: &FleetId, clock: Clock) -> Result<(Keyring, TrustFiles), Failure> {
    let files = trust_files(certs);
    let life = clock.wall_ms();
    let keyring = files.open(fleet, Duration::from_millis(life), life);
    Ok((keyring.map_err(|problem| Failure::Usage(problem.to_string()))?, files))
}
