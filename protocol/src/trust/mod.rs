//! Authorization as pure functions: the identity in a certificate, the operations that a principal
//! may perform on each key, and the envelope that proves the author of a message.
//!
//! ```text
//!  certificate ──▶ Identity ──┐
//!  key, operation, payload ───┴─▶ rights::authorize ──▶ permitted, or the reason
//!  message ──▶ sign ──▶ over any number of relays ──▶ verify: author, and not a repetition
//! ```
//!
//! Nodes relay for each other, so a link authenticates the neighbour and not the author of a
//! message. Only the author's signature identifies the author. Keys and signatures themselves are
//! not in this module (`actors::trust`).
//!
//! Any client can read and query below `view/`, `seen/`, `api/` and `events/`. There the signature
//! is an [attachment](encode_requester) to a message in plain JSON, for clients that verify it. The
//! links decide which clients may query (see [`access`]). Presence tokens (`alive/`) have no
//! content to sign, and are hints.

pub mod access;
mod attachment;
mod envelope;
mod identity;
mod replay_window;
mod rights;

pub use attachment::{decode_requester, encode_requester, signed_attachment};
pub use envelope::{
    ENVELOPE_BYTES, EnvelopeError, Fingerprint, MessageKind, SIGNATURE_BYTES, SignedEnvelope, decode_envelope,
    encode_envelope, signed_part,
};
pub use identity::{AccessScope, Identity, IdentityError, NodeRole, Principal};
pub use replay_window::{Freshness, ReplayWindow};
pub use rights::{AccessDenied, Operation, authorize};
