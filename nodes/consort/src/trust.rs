//! Credentials of nodes and people, from the folders of `consort cert`.

use crate::config::{BusConfig, trust_files};
use crate::exit::Failure;
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::trust::{Keyring, SigningBus, TrustFiles};
use consort_fleet::node::NodeSettings;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{Identity, NodeRole, Principal};
use consort_text::count;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tracing::{info, warn};

/// A node's credentials, if it has certificates.
pub(crate) struct NodeCredentials(Option<(Arc<Keyring>, TrustFiles)>);

impl NodeCredentials {
    /// Reads the files, and checks that they belong to this node and permit its configured roles. The
    /// latest list of revoked certificates is kept in `data_dir`.
    ///
    /// # Errors
    /// [`Failure::Usage`] with the file and the problem.
    pub(crate) fn open(
        bus: &BusConfig,
        data_dir: Option<&Path>,
        node: &NodeSettings,
    ) -> Result<NodeCredentials, Failure> {
        let Some(folder) = &bus.certs else { return Ok(NodeCredentials(None)) };
        let mut files = trust_files(folder);
        files.revoked.kept = data_dir.map(|folder| folder.join("revoked.pem"));
        let now = Duration::from_millis(node.clock.wall_ms());
        let keyring = files.open(&node.fleet.fleet, now, node.incarnation);
        let keyring = keyring.map_err(|problem| Failure::Usage(problem.to_string()))?;
        match unsuitable(keyring.identity(), node) {
            Some(problem) => Err(Failure::Usage(format!("{}: {problem}", files.certificate.display()))),
            None => {
                info!(bearer = %keyring.identity().principal, "links are encrypted, and messages signed");
                Ok(NodeCredentials(Some((Arc::new(keyring), files))))
            }
        }
    }

    /// Returns the keyring for verifying others, if the node has certificates.
    pub(crate) fn keyring(&self) -> Option<Arc<Keyring>> {
        self.0.as_ref().map(|(keyring, _)| Arc::clone(keyring))
    }

    /// Warns if the node serves a dashboard whose visitors cannot change anything.
    pub(crate) fn warn_of_read_only_dashboard(&self) {
        let Some((keyring, files)) = &self.0 else { return };
        if let Principal::Node { name, roles, .. } = &keyring.identity().principal
            && !roles.contains(&NodeRole::Dashboard)
        {
            let roles = roles.iter().map(|role| role.as_str()).chain(["dashboard"]).collect::<Vec<_>>().join(",");
            warn!(
                certificate = %files.certificate.display(),
                "visitors of the dashboard can only read: this node may not forward their requests; \
                 `consort cert node {name} --roles {roles}` permits it"
            );
        }
    }

    /// Returns the bus that signs messages, if there are certificates; the node's settings then get
    /// the signer and verifier of records, too.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the node's certificate cannot be published on the bus.
    pub(crate) async fn signing_bus(
        self,
        bus: SharedBus,
        node: &mut NodeSettings,
    ) -> Result<Option<Arc<SigningBus>>, Failure> {
        let Some((keyring, files)) = self.0 else { return Ok(None) };
        let signing = SigningBus::open(bus, Keys::new(&node.fleet.fleet), keyring, files.revoked, node.clock).await;
        let signing = signing.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
        node.record_signer = Some(signing.record_signer());
        Ok(Some(Arc::new(signing)))
    }
}

/// Returns the reason for which a node with these settings cannot use a certificate, if any.
fn unsuitable(identity: &Identity, node: &NodeSettings) -> Option<String> {
    let roles = match &identity.principal {
        Principal::Node { name, .. } if *name != node.node => {
            return Some(format!("it belongs to node {name}, and this is {}", node.node));
        }
        Principal::Node { roles, .. } => roles,
        person @ Principal::Person { .. } => {
            return Some(format!("it belongs to {person}, and nodes have certificates of their own"));
        }
    };
    if let Some((role, why)) = needed_roles(node).into_iter().find(|(role, _)| !roles.contains(role)) {
        return Some(format!(
            "it does not permit {} to be a {role}, and {why}; `consort cert node {0} --roles …` makes another",
            node.node
        ));
    }
    let robots = node.driver_server.iter().flat_map(|server| server.world.robots());
    let unnamed: Vec<String> =
        robots.filter(|robot| !identity.serves(robot.as_str())).map(|robot| robot.to_string()).collect();
    let (first, more) = (unnamed.first()?, unnamed.len() - 1);
    let more = if more == 0 { String::new() } else { format!(" and {}", count(more, "other", "others")) };
    Some(format!(
        "it does not permit {} to serve {first}{more}; `consort cert node {0} --roles … --serves NAMES` makes another",
        node.node
    ))
}

/// Returns the configured roles of a node, with their reasons.
fn needed_roles(node: &NodeSettings) -> Vec<(NodeRole, &'static str)> {
    let all = [
        (node.robot.is_some(), NodeRole::Robot, "the node has a robot"),
        (node.may_vote, NodeRole::Voter, "may_vote is true"),
        (node.driver_server.is_some(), NodeRole::Host, "the node serves drivers of robots"),
    ];
    all.into_iter().filter(|(needed, ..)| *needed).map(|(_, role, why)| (role, why)).collect()
}

/// Returns a person's keyring.
///
/// # Errors
/// [`Failure::Usage`] with the file and the problem.
pub fn person_keyring(certs: &Path, fleet: &FleetId, clock: Clock) -> Result<(Keyring, TrustFiles), Failure> {
    let files = trust_files(certs);
    let now_ms = clock.wall_ms();
    let keyring = files.open(fleet, Duration::from_millis(now_ms), now_ms);
    Ok((keyring.map_err(|problem| Failure::Usage(problem.to_string()))?, files))
}
