//! Authentication as pure functions: the identity in a certificate, and the envelope that proves
//! the author of a message.
//!
//! ```text
//!  certificate ──▶ Identity ──▶ access::authorize ──▶ permitted, or the reason
//!  message ──▶ sign ──▶ over any number of relays ──▶ verify: author, and not a repetition
//! ```
//!
//! Nodes relay for each other, so a link authenticates the neighbour and not the author of a
//! message. Only the author's signature identifies the author. Keys and signatures themselves are
//! not in this module (`actors/bus/src/trust`).
//!
//! Any client can read and query below `view/`, `seen/`, `api/` and `events/`. There the signature
//! is an [attachment](encode_requester) to a message in plain JSON, for clients that verify it. A
//! request that changes the fleet is [signed](RequestProof) for a person.

mod attachment;
mod envelope;
mod identity;
mod mission_rights;
mod replay_window;
mod request_proof;
mod served_name;

pub use attachment::{decode_requester, encode_requester, signed_attachment};
pub use envelope::{
    ENVELOPE_BYTES, EnvelopeError, Fingerprint, FingerprintError, MessageKind, SIGNATURE_BYTES, SignedEnvelope,
    decode_envelope, encode_envelope, is_refusal, signed_part,
};
pub use identity::{AccessScope, Identity, IdentityError, NodeRole, Principal};
pub use mission_rights::{MissionNotPermitted, MissionRights, MissionRightsError};
pub use replay_window::{Freshness, ReplayWindow};
pub use request_proof::{REQUEST_SKEW_MAX_MS, RequestProof, signed_request};
pub use served_name::ServedName;
