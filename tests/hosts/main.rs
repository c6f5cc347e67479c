//! Hosts of their own: network namespaces, cables that are cut, packets that get lost, networks that fall apart.
//!
//! Each test starts itself again inside namespaces that it makes (`lab`); where that is not allowed it is skipped, and says
//! why. Loss is made by nftables (`nft`), cables are virtual Ethernet pairs, the switch is a bridge.

#[expect(dead_code, reason = "the benches use the rest")]
mod lab;
mod link_failures;
mod multi_hop;
mod packet_loss;
mod partition;
mod shipped_topology;
mod story;
#[path = "../processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests of processes use the rest")]
mod support;
mod topologies;
