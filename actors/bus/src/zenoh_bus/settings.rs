//! Settings of a Zenoh session.

use crate::bus::{BusError, MESSAGE_MAX};
use crate::trust::TrustFiles;
use consort_protocol::access::{Grant, LinkMessage, grants};
use consort_protocol::ids::FleetId;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// Key, outside all fleets' keys, on which a node replies to link checks; the node's id on the bus
/// follows. With the parameter `back=ID` the reply states whether the node with that id replied to
/// a query in turn.
pub(super) const LINK_CHECK: &str = "consort-link-check";

/// Size limit of what a link sends at a time, in bytes; larger messages are divided. A message of a higher priority
/// waits for it: 65 ms on a link of 1 Mbit/s. Higher saves work on fast links.
const BATCH_BYTES: usize = 8 * 1024;

/// Number of batches in the queue of each priority, the maximum of Zenoh: 128 kB, as much as with Zenoh's own defaults.
const BATCHES: usize = 16;

/// Send buffer of a link, in bytes. What it contains precedes every message of a higher priority. By default Linux
/// grows it up to 4 MB. Measured on a link of 1 Mbit/s while sixty views were sent, a heartbeat returned after 0.5 s
/// (p90); without limits of buffers after more than 2 s. Higher is faster on long links: with a round trip of 50 ms a
/// link sends at most 0.6 MB/s.
const SEND_BUFFER_BYTES: usize = 16 * 1024;

/// Receive buffer of a link, in bytes. Linux adds unsent data to a segment of up to half of the receiver's window,
/// whatever the size of the send buffer.
const RECEIVE_BUFFER_BYTES: usize = 32 * 1024;

/// Leases for which a message may wait for space in the queue of its priority; then the link is closed. A link with a
/// silent neighbour is closed after a single lease. A neighbour that still sends may have a slow link, on which low
/// priorities wait for high ones.
const LEASES_BLOCKED_MAX: u32 = 5;

/// Role of a node towards its neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Relays between its neighbours, and reroutes when a link breaks: the mode of a fleet's nodes.
    #[default]
    Router,
    /// Sends and receives everything through a single router: the mode of command-line tools. It
    /// fails to open if no router can be reached.
    Client,
    /// Sends and receives everything through a single router, and moves to another when that router
    /// fails: the mode of a fleet's nodes that do not relay. It opens even if no router can be reached.
    NodeClient,
    /// Exchanges messages with its direct neighbours, and never relays.
    Peer,
}

impl Mode {
    pub(super) fn name(self) -> &'static str {
        match self {
            Mode::Router => "router",
            Mode::Client | Mode::NodeClient => "client",
            Mode::Peer => "peer",
        }
    }

    pub(super) fn is_client(self) -> bool {
        matches!(self, Mode::Client | Mode::NodeClient)
    }
}

/// Settings of a [`ZenohBus`](super::ZenohBus).
///
/// The defaults are those of a fleet's node: a router on the loopback interface only, without
/// neighbours.
#[derive(Debug, Clone)]
pub struct ZenohSettings {
    /// Role of this node towards its neighbours.
    pub mode: Mode,
    /// Addresses to listen on, such as `tcp/127.0.0.1:7447`; port 0 selects a free port. If empty,
    /// the node does not listen. Clients never listen. Without `link_trust` connections are not
    /// authenticated: every program that reaches these addresses is part of the fleet.
    pub listen: Vec<String>,
    /// Neighbours to connect to, such as `tcp/192.0.2.7:7447`. Unreachable neighbours are retried
    /// for as long as the bus exists. More neighbours cost traffic and prevent partitions of the
    /// fleet: two to four are sufficient. A client connects to the first of them that can be reached.
    pub connect: Vec<String>,
    /// Time for which a silent neighbour counts as present. The value set on *this* node is the
    /// time that *other* nodes wait for it, so the whole fleet needs the same setting. A lower
    /// value detects a silent loss earlier (measured: after 1.5 to 2.0 s with the default of 2 s),
    /// and mistakes a slow link for a loss more often.
    pub lease: Duration,
    /// Largest message received or sent, in bytes, at most [`MESSAGE_MAX`]. A neighbour can make
    /// this node allocate that much memory for each of its messages in transit.
    pub message_max: usize,
    /// Timeout for opening a link.
    pub open_timeout: Duration,
    /// Authentication of links. Addresses are then written `tls/192.0.2.7:7447`.
    pub link_trust: Option<LinkTrust>,
    /// Further settings of Zenoh, as path and JSON5 value (`transport/link/tls/...`). They override
    /// all others.
    pub overrides: Vec<(String, String)>,
}

/// Authentication of links: TLS 1.3, with certificates of the fleet's authority on both sides.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LinkTrust {
    /// Certificates and keys.
    pub files: TrustFiles,
    /// Fleet of the certificates: it determines the keys that links carry, see [`grants`].
    pub fleet: FleetId,
}

impl Default for ZenohSettings {
    fn default() -> Self {
        ZenohSettings {
            mode: Mode::Router,
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            connect: Vec::new(),
            lease: Duration::from_secs(2),
            message_max: MESSAGE_MAX,
            open_timeout: Duration::from_secs(5),
            link_trust: None,
            overrides: Vec::new(),
        }
    }
}

impl ZenohSettings {
    /// Returns the settings as a Zenoh configuration.
    pub(super) fn config(&self) -> Result<zenoh::Config, BusError> {
        let mut config = zenoh::Config::default();
        let overrides = self.overrides.iter().cloned();
        for (path, value) in self.entries()?.into_iter().map(|(path, value)| (path.to_owned(), value)).chain(overrides)
        {
            config.insert_json5(&path, &value).map_err(|problem| BusError::Failed {
                operation: format!("set Zenoh's setting {path} to {value}"),
                problem: problem.to_string(),
            })?;
        }
        Ok(config)
    }

    /// Returns the time that the relay of a client has to respond to a query.
    pub(super) fn response_limit(&self) -> Duration {
        self.lease / 10
    }

    /// Returns the pause before a vanished presence token is reported: zero, except for the client of a
    /// relay. A client changes its relay within 3/10 of the lease and the time to connect.
    pub(super) fn presence_hold(&self) -> Duration {
        if self.mode == Mode::NodeClient { self.lease * 3 / 4 } else { Duration::ZERO }
    }

    /// Returns the settings of a client of a single relay.
    pub(super) fn with_relay(&self, relay: &str) -> ZenohSettings {
        ZenohSettings { connect: vec![relay.to_owned()], ..self.clone() }
    }

    /// Returns the settings of a session without links.
    pub(super) fn without_links(&self) -> ZenohSettings {
        ZenohSettings { mode: Mode::Peer, listen: vec![], connect: vec![], ..self.clone() }
    }

    fn entries(&self) -> Result<Vec<(&'static str, String)>, BusError> {
        let mut entries = self.link_entries()?;
        entries.extend(self.link_trust.iter().flat_map(LinkTrust::entries));
        Ok(entries)
    }

    fn link_entries(&self) -> Result<Vec<(&'static str, String)>, BusError> {
        if self.message_max > MESSAGE_MAX {
            return Err(BusError::Failed {
                operation: "open".to_owned(),
                problem: format!("a message limit of {} bytes exceeds {MESSAGE_MAX}", self.message_max),
            });
        }
        let listen = if self.mode.is_client() { &[] } else { self.listen.as_slice() };
        // A client that waits for a relay that has failed reaches no other.
        let open_timeout = match self.mode {
            Mode::NodeClient => self.open_timeout.min(self.response_limit() * 2),
            Mode::Router | Mode::Client | Mode::Peer => self.open_timeout,
        };
        let lease_ms = self.lease.as_millis();
        Ok(vec![
            ("mode", format!("{:?}", self.mode.name())),
            ("listen/endpoints", format!("{listen:?}")),
            ("listen/timeout_ms", "0".to_owned()),
            ("listen/exit_on_failure", "true".to_owned()),
            ("connect/endpoints", format!("{:?}", self.connect)),
            ("connect/timeout_ms", "{ router: -1, peer: -1, client: 0 }".to_owned()),
            ("connect/exit_on_failure", "{ router: false, peer: false, client: true }".to_owned()),
            ("connect/retry", "{ period_init_ms: 250, period_max_ms: 2000, period_increase_factor: 2 }".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            // Links learned by gossip are not retried after a cut, so no node may depend on them.
            ("scouting/gossip/autoconnect", "{ router: [], peer: [], client: [] }".to_owned()),
            // For a router this delay has no use: connections are polled explicitly.
            ("scouting/delay", if self.mode == Mode::Router { "0" } else { "500" }.to_owned()),
            ("transport/unicast/open_timeout", open_timeout.as_millis().to_string()),
            ("transport/unicast/accept_timeout", self.open_timeout.as_millis().to_string()),
            ("transport/link/tx/lease", lease_ms.to_string()),
            ("transport/unicast/qos/enabled", "true".to_owned()),
            ("transport/link/tx/batch_size", BATCH_BYTES.to_string()),
            ("transport/link/tx/queue/size", queue_sizes()),
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                (self.lease * LEASES_BLOCKED_MAX).as_micros().to_string(),
            ),
            ("transport/link/tcp/so_sndbuf", SEND_BUFFER_BYTES.to_string()),
            ("transport/link/tcp/so_rcvbuf", RECEIVE_BUFFER_BYTES.to_string()),
            ("transport/link/tls/so_sndbuf", SEND_BUFFER_BYTES.to_string()),
            ("transport/link/tls/so_rcvbuf", RECEIVE_BUFFER_BYTES.to_string()),
            ("transport/link/rx/max_message_size", self.message_max.to_string()),
        ])
    }
}

/// Returns the size of the queue of each priority.
fn queue_sizes() -> String {
    let priorities =
        ["control", "real_time", "interactive_high", "interactive_low", "data_high", "data", "data_low", "background"];
    json!(BTreeMap::from(priorities.map(|priority| (priority, BATCHES)))).to_string()
}

impl LinkTrust {
    fn entries(&self) -> Vec<(&'static str, String)> {
        let TrustFiles { authority, certificate, key, revoked: _ } = &self.files;
        let (authority, certificate, key) = (json!(authority), json!(certificate), json!(key));
        let own = [
            ("transport/link/tls/root_ca_certificate", authority),
            ("transport/link/tls/listen_certificate", certificate.clone()),
            ("transport/link/tls/listen_private_key", key.clone()),
            ("transport/link/tls/connect_certificate", certificate),
            ("transport/link/tls/connect_private_key", key),
            ("transport/link/tls/enable_mtls", json!(true)),
            // Addresses of nodes change, so the host name is not verified. The fleet's signature
            // counts, and certificates of persons are not valid for servers.
            ("transport/link/tls/verify_name_on_connect", json!(false)),
            ("transport/link/tls/close_link_on_expiration", json!(true)),
            ("transport/link/protocols", json!(["tls"])),
            ("access_control", access_control(&grants(&self.fleet, &[&format!("{LINK_CHECK}/*")]))),
        ];
        own.into_iter().map(|(path, value)| (path, value.to_string())).collect()
    }
}

/// Builds Zenoh's access control: incoming messages are limited by the certificate at the other
/// end. All outgoing messages are allowed, since a node receives only messages that it was allowed
/// to request.
fn access_control(grants: &[Grant]) -> Value {
    let mut rules = vec![json!({
        "id": "out", "permission": "allow", "flows": ["egress"], "key_exprs": ["**"],
        "messages": messages(&LinkMessage::ALL),
    })];
    let (mut subjects, mut policies) = (Vec::new(), Vec::new());
    for Grant { common_name, permits } in grants {
        let mut own = vec!["out".to_owned()];
        for (number, (passings, keys)) in permits.iter().enumerate() {
            let id = format!("{common_name}-{number}");
            rules.push(json!({
                "id": id, "permission": "allow", "flows": ["ingress"], "key_exprs": keys, "messages": messages(passings),
            }));
            own.push(id);
        }
        subjects.push(json!({ "id": common_name, "cert_common_names": [common_name] }));
        policies.push(json!({ "subjects": [common_name], "rules": own }));
    }
    json!({
        "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
    })
}

fn messages(passings: &[LinkMessage]) -> Vec<&'static str> {
    passings.iter().map(|passing| passing.as_str()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trust::RevokedFiles;

    #[test]
    fn zenoh_accepts_certificates_and_rules_for_every_principal() {
        let files = TrustFiles {
            authority: "certs/ca.pem".into(),
            certificate: "certs/ada.pem".into(),
            key: "certs/ada.key".into(),
            revoked: RevokedFiles::default(),
        };
        let links = Some(LinkTrust { files, fleet: FleetId::new("ward").unwrap() });
        let config = ZenohSettings { link_trust: links, ..Default::default() }.config().unwrap();
        let read = |path: &str| config.get_json(path).unwrap();
        assert_eq!(read("transport/link/tls/root_ca_certificate"), r#""certs/ca.pem""#);
        assert_eq!(read("transport/link/tls/enable_mtls"), "true");
        assert_eq!(read("transport/link/protocols"), r#"["tls"]"#);
        let access: Value = serde_json::from_str(&read("access_control")).unwrap();
        assert_eq!(access["default_permission"], "deny");
        assert_eq!(access["subjects"].as_array().unwrap().len(), 4, "{access}");
    }

    #[test]
    fn zenoh_accepts_every_setting() {
        for mode in [Mode::Router, Mode::Client, Mode::NodeClient, Mode::Peer] {
            let settings = ZenohSettings { mode, connect: vec!["tcp/127.0.0.1:9".to_owned()], ..Default::default() };
            let config = settings.config().unwrap();
            let read = |path: &str| config.get_json(path).unwrap();
            assert_eq!(read("mode"), format!("{:?}", mode.name()));
            assert_eq!(read("connect/endpoints"), r#"["tcp/127.0.0.1:9"]"#);
            let listen = if mode.is_client() { "[]" } else { r#"["tcp/127.0.0.1:0"]"# };
            assert_eq!(read("listen/endpoints"), listen);
            assert_eq!(read("listen/exit_on_failure"), "true");
            assert_eq!(read("scouting/multicast/enabled"), "false");
            assert_eq!(read("transport/link/tx/lease"), "2000");
            assert_eq!(read("transport/unicast/qos/enabled"), "true");
            assert_eq!(read("transport/link/tx/batch_size"), BATCH_BYTES.to_string());
            assert_eq!(read("transport/link/tx/queue/size/real_time"), BATCHES.to_string());
            for protocol in ["tcp", "tls"] {
                let buffer = |way| read(&format!("transport/link/{protocol}/{way}"));
                assert_eq!(buffer("so_sndbuf"), SEND_BUFFER_BYTES.to_string());
                assert_eq!(buffer("so_rcvbuf"), RECEIVE_BUFFER_BYTES.to_string());
            }
            let open_timeout = if mode == Mode::NodeClient { "400" } else { "5000" };
            assert_eq!(read("transport/unicast/open_timeout"), open_timeout);
            assert_eq!(read("transport/link/rx/max_message_size"), MESSAGE_MAX.to_string());
        }
    }

    #[test]
    fn an_unknown_zenoh_setting_is_rejected_by_name() {
        let settings =
            ZenohSettings { overrides: vec![("transport/lnk".to_owned(), "1".to_owned())], ..Default::default() };
        let error = settings.config().unwrap_err().to_string();
        assert!(error.starts_with("the bus failed to set Zenoh's setting transport/lnk to 1: "), "{error}");
    }

    #[test]
    fn the_message_limit_is_bounded() {
        let settings = ZenohSettings { message_max: MESSAGE_MAX + 1, ..Default::default() };
        assert!(settings.config().is_err());
    }
}
