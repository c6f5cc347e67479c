//! Access control: the operations that a principal may perform on each key.
//!
//! ```text
//!  link of a neighbour:  common name in its certificate ──▶ grants, enforced by Zenoh
//!  message:              identity of its author, key, operation, payload ──▶ authorize
//! ```
//!
//! Any client can read and query below `view/`, `seen/`, `api/` and `events/`. The links decide
//! which clients may query. A request that changes the fleet is signed for a person, and checked by
//! the node that executes it ([`scope_to_sign`]). Presence tokens (`alive/`) have no content to
//! sign, and are hints.

mod links;
mod rights;

pub use links::{Grant, LinkMessage, common_name, grants, required_scope, scope_to_sign};
pub use rights::{AccessDenied, Operation, authorize};
