//! Who said it: certificates, signatures, and a bus on which every message between nodes bears its author's seal.
//!
//! ```text
//!  actors ──▶ SealedBus ── signs what goes out ──▶ bus ──▶ relays ──▶ bus
//!                 ▲ reads only what its author signed, may say (protocol::trust), and says for the first time
//!                 └── Keyring: the fleet's authority, own certificate and key, what was learned of others'
//! ```
//!
//! A seal names a certificate by its fingerprint. Whoever does not know it asks `wire/card/{fingerprint}`, and lets go of what
//! is heard until it is shown: as if it had been lost, which everything on the bus can stand. Of what anybody's clients read the
//! seal stands beside the message, and brings the certificate along.
//!
//! What a seal does not do: hide (links do, by TLS), tell when something was said (a node that starts anew may be shown old
//! messages once; terms, epochs, versions and stamps sort them out), or vouch for what its author says of third ones: what is handed on
//! of them bears their own signature (`notary`).

mod bus;
mod certificates;
mod files;
pub mod issue;
mod keyring;
mod link_revocation;
mod probe;
mod record_signer;
mod rejections;
mod token;

pub use bus::SigningBus;
pub use files::{TrustError, TrustFiles};
pub use keyring::{CertificateError, Keyring, VerifiedCertificate};
pub use probe::ProbeError;
pub use token::{TOKEN_MAX, TokenClaims, TokenError};
