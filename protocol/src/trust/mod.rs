//! Who may say what, decided in values: what a certificate says of its bearer, what such a bearer may do on which key, and
//! the envelope by which a message proves who said it.
//!
//! ```text
//!  certificate ──▶ Identity ──┐
//!  key, act, payload ─────────┴─▶ rights::check ──▶ may, or why not
//!  message ──▶ seal ──▶ over any number of relays ──▶ unseal: sealed by whom, and for the first time?
//! ```
//!
//! Nodes relay for each other, so a link says who the neighbour is and nothing of who spoke: that a message bears its
//! author's signature is what makes it its author's. Keys and signatures themselves are not here (`actors::trust`).
//!
//! Below `view/`, `seen/`, `api/` and `events/` clients of any kind read and ask: there the seal stands [beside](write_asker) a
//! message that is plain JSON, for those who look at it; who may ask is decided by the links (see [`access`]). Presence tokens
//! (`alive/`) have no content to be sealed, and are hints.

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
