//! Authentication of messages: certificates, signatures, and a bus on which every message between
//! nodes carries its author's signature.
//!
//! ```text
//!  actors ──▶ SigningBus ── signs outgoing messages ──▶ bus ──▶ relays ──▶ bus
//!                 ▲ delivers only messages that are signed, authorized (protocol::trust) and new
//!                 └── Keyring: the fleet's authority, own certificate and key, received certificates
//! ```
//!
//! An envelope identifies its signer's certificate by fingerprint. A node without that certificate
//! queries `wire/certificate/{fingerprint}`, and drops the signer's messages until the certificate
//! arrives. Every protocol on the bus tolerates such a loss. On keys that clients read, the
//! signature is an attachment of the plain message and includes the certificate. Requests that
//! change the fleet are signed for a person, and verified before they reach an actor (`requests`).
//!
//! Limits of the signatures:
//! - They do not hide content; links do, by TLS.
//! - They do not prove the time of sending. A restarted node may receive old messages once; terms,
//!   epochs, versions and stamps make them harmless.
//! - They do not confirm statements about other nodes. A forwarded record carries its owner's own
//!   signature (`record_signer`).

mod bus;
mod certificates;
mod executed_requests;
mod files;
pub mod issue;
mod keyring;
mod link_revocation;
mod probe;
mod record_signer;
mod rejections;
mod requests;
mod revocation;
mod signature;
mod token;
mod verifier;

pub use bus::SigningBus;
pub use files::{KeyError, KeyringError, RevokedFiles, TrustError, TrustFiles, write_atomically};
pub use keyring::{CertificateError, Keyring, VerifiedCertificate};
pub use probe::ProbeError;
pub use token::{TOKEN_MAX, TokenClaims, TokenError, forwarded_part};
