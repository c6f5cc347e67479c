//! The bus of a whole fleet in one process, on virtual time, with faults.
//!
//! [`VirtualNetwork`] is the network between the nodes; [`VirtualBus`] is a node's endpoint. Every
//! message between two nodes takes a latency drawn from a seeded generator (see [`LinkModel`]). A
//! node's messages to itself take no time, but pass through the same event queue. On a
//! current-thread runtime with paused time, a seed determines the run; [`VirtualNetwork::digest`]
//! verifies it.
//!
//! Simplifications compared with Zenoh:
//! - Every node is linked with every other. Subscriptions and services are known everywhere at
//!   once.
//! - Messages that cross a cut link are lost, however short the cut: nothing is resent. To delay
//!   messages without loss, use [`pause`](VirtualNetwork::pause).
//! - The nearest of several complete services is the node's own, else the service of the node that
//!   joined first.
//! - A healed link works at once; tokens return after one latency.
//! - [`Delivery::Drop`](crate::Delivery::Drop) and [`Delivery::Block`](crate::Delivery::Block) are
//!   equivalent: mailboxes drop messages rather than wait, and the link model loses both.
//!
//! Similarities with Zenoh: a node that falls silent keeps its tokens until a lease has expired.
//! Until then a query to it waits; from then on it receives no more queries. If only its replies
//! are cut, it still receives queries, in vain, and each query runs to its timeout. A crash becomes
//! visible after one latency.

mod driver;
mod endpoint;
mod faults;
mod ids;
mod link;
mod network;
mod responder;
#[cfg(test)]
mod tests;
mod trace;
mod virtual_network;

pub use endpoint::VirtualBus;
pub use link::{LinkModel, NetworkCounters};
pub use link::{Traffic, TrafficByKind};
pub use virtual_network::VirtualNetwork;
