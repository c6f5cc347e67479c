//! State of a virtual network: all declarations, and the messages in transit.
//!
//! ```text
//!   VirtualBus ── publish, query, reply ──▶ Network ──▶ event queue (due, id) ──▶ dispatch ──▶ streams
//! ```
//!
//! Everything that happens is an event in a single queue, ordered by due time and then by id, so
//! that a seed determines the run. Nothing here waits: the driver calls
//! [`Network::run`] when events are due.

mod event_queue;
mod lifecycle;
mod links;
mod pending_query;
mod presence;
mod presence_watch;
mod publication;
mod publications;
mod queries;
mod routing_table;
mod state;

pub(super) use state::Network;
