//! Signature of a request that changes the fleet: an attachment to the query.
//!
//! ```text
//!  envelope as in `envelope`, of the kind query, with a RequestProof as its payload
//! ```
//!
//! Views are answered to every client that a link lets in. A request that changes the fleet needs
//! a person, so it is signed end to end: by the person's own key, or by the node of a dashboard
//! that forwards the person's token. The signature covers the key (and with it the fleet), the
//! number, the proof and the payload ([`signed_request`]).

use super::attachment::signed_attachment;
use super::envelope::{Fingerprint, MessageKind};
use serde::{Deserialize, Serialize};

/// Maximum difference between the time in a request and the clock of the node that executes it, in
/// milliseconds. Kerberos allows the same (RFC 4120, 1.6).
pub const REQUEST_SKEW_MAX_MS: u64 = 300_000;

/// Content of a request's signature.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RequestProof {
    /// Time of signing, in milliseconds since 1970.
    pub signed_at_ms: u64,
    /// Certificate of the signer, in DER.
    pub certificate: Vec<u8>,
    /// Token of the person, if the signer is a node that forwards the request for a person.
    pub token: Option<String>,
}

/// Returns the bytes to sign for a request: `proof` is the encoded [`RequestProof`], `payload` the
/// payload of the query.
pub fn signed_request(by: Fingerprint, number: u64, key: &str, proof: &[u8], payload: &[u8]) -> Vec<u8> {
    signed_attachment(MessageKind::Query, by, number, key, proof, payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proof_and_payload_are_separated_in_the_signed_bytes() {
        let by = Fingerprint([7; 16]);
        assert_ne!(signed_request(by, 1, "a", b"b", b"cd"), signed_request(by, 1, "a", b"bc", b"d"));
        assert_ne!(signed_request(by, 1, "a", b"b", b"c"), signed_request(by, 2, "a", b"b", b"c"));
    }
}
