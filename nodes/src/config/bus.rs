//! Where a node is on the network.

use serde::{Deserialize, Serialize};

/// `[bus]`: where a node listens and whom it is linked with.
///
/// Every node relays for its neighbours. Two to four configured neighbours for each node keep a fleet together when links
/// or nodes fail; fewer save traffic. Zenoh does not authenticate: whoever reaches the listening address is part of the
/// fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BusConfig {
    /// Addresses to listen on. Default: the loopback interface, at a port that the system gives.
    pub listen: Vec<String>,
    /// Neighbours to connect to. Those out of reach are tried again for as long as the node lives.
    pub connect: Vec<String>,
}

impl Default for BusConfig {
    fn default() -> Self {
        BusConfig { listen: vec!["tcp/127.0.0.1:0".to_owned()], connect: vec![] }
    }
}

impl BusConfig {
    pub(super) fn problems(&self) -> Vec<String> {
        let wrong = |key: &'static str| {
            move |address: &String| {
                let form = "an address is written as tcp/192.0.2.7:7447";
                endpoint(address).err().map(|problem| format!("bus.{key}: {address:?}: {problem}; {form}"))
            }
        };
        let listen = self.listen.iter().filter_map(wrong("listen"));
        listen.chain(self.connect.iter().filter_map(wrong("connect"))).collect()
    }
}

/// Whether a text is an address as Zenoh writes it.
fn endpoint(text: &str) -> Result<(), &'static str> {
    let (protocol, rest) = text.split_once('/').ok_or("there is no `/` after the protocol")?;
    if protocol != "tcp" {
        return Err("the protocol is tcp");
    }
    let (host, port) = rest.rsplit_once(':').ok_or("there is no port")?;
    if host.is_empty() {
        return Err("there is no host");
    }
    port.parse::<u16>().map(|_| ()).map_err(|_| "the port is a number from 0 to 65535")
}
