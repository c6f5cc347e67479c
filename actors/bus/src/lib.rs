//! The message bus of the nodes, with its implementations and layers.
//!
//! - [`Bus`] is the trait that actors use. [`ZenohBus`] implements it on Zenoh, [`VirtualBus`] in
//!   one process on virtual time with injected faults.
//! - [`trust`] signs and verifies messages, [`cluster_membership`] drops messages of other
//!   clusters, [`MeteredBus`] counts: each is a layer over another bus.
//! - [`clock`], [`tasks`], [`reply`] and [`wire_version`] are shared by all actors of a node.

mod author;
mod boot_instant;
mod bus;
pub mod clock;
pub mod cluster_membership;
mod keys;
mod layer;
mod mailbox;
mod metered;
mod open_queries;
mod outbox;
pub mod record_signer;
pub mod reply;
pub mod tasks;
pub mod trust;
pub mod virtual_bus;
pub mod wire_version;
pub mod zenoh_bus;

pub use author::Author;
pub use boot_instant::{BootInstant, suspended};
pub use bus::*;
pub use layer::{Layer, MessageContent};
pub use metered::{Direction, Meter, MeteredBus};
pub use outbox::Outbox;
pub use virtual_bus::{LinkModel, Traffic, TrafficByKind, VirtualBus, VirtualNetwork};
pub use zenoh_bus::{ZenohBus, ZenohSettings};
