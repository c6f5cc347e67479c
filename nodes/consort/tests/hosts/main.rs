//! Tests on separate hosts: network namespaces, cut cables, packet loss and partitions.
//!
//! Each test restarts itself inside its own namespaces (`lab`); where that is not allowed it is
//! skipped. nftables (`nft`) drops packets, `tc` limits rates, virtual Ethernet pairs are the cables,
//! and a bridge is the switch.

#[expect(dead_code, reason = "the benches use the rest")]
mod lab;
mod link_failures;
mod multi_hop;
mod packet_loss;
mod partition;
mod relays;
mod scenario;
mod shipped_topology;
#[path = "../../../../tests/support/slots.rs"]
mod slots;
mod slow_links;
#[path = "../processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests of processes use the rest")]
mod support;
mod topologies;
