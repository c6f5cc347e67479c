//! Network settings of a node, and its credentials.

use super::read::resolve_path;
use consort_bus::trust::{RevokedFiles, TrustFiles};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// `[bus]`: listening addresses and neighbours of a node.
///
/// Nodes that relay keep a fleet together: two to four configured neighbours for each node suffice when
/// links or nodes fail; fewer save traffic. Without `certs` the fleet is open: every node that reaches
/// the listening address becomes part of the fleet.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BusConfig {
    /// Addresses to listen on. Default: the loopback interface, at a port that the system selects.
    pub listen: Vec<String>,
    /// Neighbours to connect to. Unreachable neighbours are retried for as long as the node runs. A node
    /// that does not relay connects to one of them, which must relay, and moves to another when it fails.
    pub connect: Vec<String>,
    /// Whether the node relays messages for others: `yes`, `no`, or `auto` (default): a node relays,
    /// unless `planned_nodes` of the fleet is 30 or more and the node is a robot on battery power. A
    /// node that does not relay cannot `listen`.
    pub relay: RelaySetting,
    /// The folder with the node's certificate and key, and the fleet's authority, as written by
    /// `consort cert`. Links are then encrypted, both ends prove their identity, and messages
    /// between nodes are signed. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certs: Option<PathBuf>,
}

/// Setting of a node, whether it relays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RelaySetting {
    /// Relays, unless the fleet is large and the node is a robot on battery power.
    #[default]
    Auto,
    /// Relays.
    Yes,
    /// Is a client of its neighbours.
    No,
}

impl BusConfig {
    /// Returns the addresses to listen on.
    pub fn listen_addresses(&self) -> Vec<String> {
        if self.listen.is_empty() { vec![format!("{}/127.0.0.1:0", self.protocol())] } else { self.listen.clone() }
    }

    /// Returns the protocol of the addresses.
    fn protocol(&self) -> &'static str {
        if self.certs.is_some() { "tls" } else { "tcp" }
    }

    /// Resolves paths relative to `folder`, the folder of the file.
    pub(super) fn resolve_paths(&mut self, folder: &Path) {
        resolve_path(&mut self.certs, folder);
    }

    /// Returns the problems of the addresses.
    pub(crate) fn validate(&self) -> Vec<String> {
        let protocol = self.protocol();
        let wrong = |key: &'static str| {
            move |address: &String| {
                let form = format!("an address is written as {protocol}/192.0.2.7:7447");
                endpoint(address, protocol).err().map(|problem| format!("bus.{key}: {address:?}: {problem}; {form}"))
            }
        };
        let listen = self.listen.iter().filter_map(wrong("listen"));
        listen.chain(self.connect.iter().filter_map(wrong("connect"))).collect()
    }
}

/// Returns the files in a folder that `consort cert` has written for a principal.
pub fn trust_files(folder: &Path) -> TrustFiles {
    TrustFiles {
        authority: folder.join("ca.pem"),
        certificate: folder.join("cert.pem"),
        key: folder.join("key.pem"),
        revoked: RevokedFiles { list: Some(folder.join("revoked.pem")), kept: None },
    }
}

/// Checks that a text is an address in Zenoh's notation.
fn endpoint(text: &str, protocol: &str) -> Result<(), &'static str> {
    let (given, rest) = text.split_once('/').ok_or("there is no `/` after the protocol")?;
    match (given, protocol) {
        (given, protocol) if given == protocol => {}
        (_, "tls") => return Err("the protocol is tls for a node that has certificates"),
        ("tls", _) => return Err("the protocol is tls only for a node that has certificates (certs)"),
        _ => return Err("the protocol is tcp"),
    }
    let (host, port) = rest.rsplit_once(':').ok_or("there is no port")?;
    if host.is_empty() {
        return Err("there is no host");
    }
    port.parse::<u16>().map(|_| ()).map_err(|_| "the port is a number from 0 to 65535")
}
