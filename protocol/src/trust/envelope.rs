//! Signed envelope, which proves the author of a message.
//!
//! ```text
//!  1      1     16           8       64         …
//!  version kind  fingerprint  number  signature  payload
//! ```
//!
//! The signature ([`signed_part`]) covers the purpose, version, kind, fingerprint and number, the
//! key that the message is sent on, the query that a reply answers, and the payload. So a relay can
//! neither move a message to another key, nor present a reply as the reply to another query, nor a
//! query as a publication.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// First byte of every signed message.
pub(super) const VERSION: u8 = 1;

/// Size of an Ed25519 signature, in bytes.
pub const SIGNATURE_BYTES: usize = 64;

/// Kind of a refusal, in the header.
const REFUSAL: u8 = 3;

const FINGERPRINT: usize = 16;
pub(super) const HEADER_BYTES: usize = 2 + FINGERPRINT + 8;

/// Bytes that an envelope adds to a message.
pub const ENVELOPE_BYTES: usize = HEADER_BYTES + SIGNATURE_BYTES;

/// Fingerprint of a certificate: the first half of the SHA-256 of its DER. Written as 32
/// hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Fingerprint(pub [u8; FINGERPRINT]);

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Fingerprint({self})")
    }
}

impl FromStr for Fingerprint {
    type Err = FingerprintError;

    fn from_str(text: &str) -> Result<Fingerprint, FingerprintError> {
        let problem = || FingerprintError { text: text.to_owned() };
        let valid =
            text.len() == 2 * FINGERPRINT && text.bytes().all(|c| c.is_ascii_digit() || (b'a'..=b'f').contains(&c));
        let number = valid.then(|| u128::from_str_radix(text, 16).ok()).flatten();
        number.map(|number| Fingerprint(number.to_be_bytes())).ok_or_else(problem)
    }
}

/// Error: a text is not a fingerprint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a fingerprint: it must have {} hexadecimal digits", 2 * FINGERPRINT)]
pub struct FingerprintError {
    text: String,
}

/// Kind of a signed message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageKind {
    /// Publication.
    Publication,
    /// Query.
    Query,
    /// Reply to the query with this number, sent by the principal with this certificate.
    Reply(Fingerprint, u64),
    /// Refusal of that query.
    Refusal(Fingerprint, u64),
}

impl MessageKind {
    /// Returns the kind of a refusal of the same query as this reply.
    #[must_use]
    pub fn as_refusal(self) -> MessageKind {
        match self {
            MessageKind::Reply(requester, query) => MessageKind::Refusal(requester, query),
            other => other,
        }
    }

    pub(super) fn byte(self) -> u8 {
        match self {
            MessageKind::Publication => 0,
            MessageKind::Query => 1,
            MessageKind::Reply(..) => 2,
            MessageKind::Refusal(..) => REFUSAL,
        }
    }
}

/// Signed envelope as decoded; the signature is not verified yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedEnvelope<'a> {
    /// Certificate of the claimed author.
    pub signer: Fingerprint,
    /// Number among all messages of the author; only grows.
    pub number: u64,
    /// Signature over [`signed_part`].
    pub signature: &'a [u8],
    /// Payload of the message.
    pub payload: &'a [u8],
}

/// Error: bytes are not a signed message of the expected kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EnvelopeError {
    /// The bytes are too short: the sender signs nothing.
    #[error("it is not signed")]
    Unsigned,
    /// The envelope has another version.
    #[error("its envelope has version {found}; this node supports version {VERSION}")]
    Version {
        /// Version found.
        found: u8,
    },
    /// The kind differs, such as a query where a reply was expected.
    #[error("it was signed as another kind of message")]
    Kind,
}

/// Checks whether a reply claims to be a refusal. The signature is not verified.
pub fn is_refusal(bytes: &[u8]) -> bool {
    decode_header(bytes).is_some_and(|([_, kind], ..)| kind == REFUSAL)
}

/// Returns the bytes to sign for a message.
pub fn signed_part(kind: MessageKind, by: Fingerprint, number: u64, key: &str, payload: &[u8]) -> Vec<u8> {
    let mut signed = Vec::with_capacity(64 + HEADER_BYTES + key.len() + payload.len());
    signed.extend_from_slice(b"consort seal\0");
    signed.extend_from_slice(&[VERSION, kind.byte()]);
    signed.extend_from_slice(&by.0);
    signed.extend_from_slice(&number.to_be_bytes());
    if let MessageKind::Reply(requester, query) | MessageKind::Refusal(requester, query) = kind {
        signed.extend_from_slice(&requester.0);
        signed.extend_from_slice(&query.to_be_bytes());
    }
    signed.extend_from_slice(&(key.len() as u64).to_be_bytes());
    signed.extend_from_slice(key.as_bytes());
    signed.extend_from_slice(payload);
    signed
}

/// Encodes a signed envelope.
pub fn encode_envelope(kind: MessageKind, envelope: SignedEnvelope<'_>) -> Vec<u8> {
    let SignedEnvelope { signer: by, number, signature, payload } = envelope;
    let mut bytes = Vec::with_capacity(ENVELOPE_BYTES + payload.len());
    bytes.extend_from_slice(&[VERSION, kind.byte()]);
    bytes.extend_from_slice(&by.0);
    bytes.extend_from_slice(&number.to_be_bytes());
    bytes.extend_from_slice(signature);
    bytes.extend_from_slice(payload);
    bytes
}

/// Decodes a signed envelope. The signature is not verified.
///
/// # Errors
/// [`EnvelopeError`]; does not panic for any bytes.
pub fn decode_envelope(kind: MessageKind, bytes: &[u8]) -> Result<SignedEnvelope<'_>, EnvelopeError> {
    let ([version, of_kind], by, number, rest) = decode_header(bytes).ok_or(EnvelopeError::Unsigned)?;
    let (signature, payload) = rest.split_at_checked(SIGNATURE_BYTES).ok_or(EnvelopeError::Unsigned)?;
    match (version, of_kind) {
        (VERSION, of_kind) if of_kind == kind.byte() => Ok(SignedEnvelope { signer: by, number, signature, payload }),
        (VERSION, _) => Err(EnvelopeError::Kind),
        (found, _) => Err(EnvelopeError::Version { found }),
    }
}

/// Splits off version and kind, fingerprint and number; returns them with the remaining bytes.
pub(super) fn decode_header(bytes: &[u8]) -> Option<([u8; 2], Fingerprint, u64, &[u8])> {
    let (first, rest) = bytes.split_first_chunk::<2>()?;
    let (by, rest) = rest.split_first_chunk::<FINGERPRINT>()?;
    let (number, rest) = rest.split_first_chunk::<8>()?;
    Some((*first, Fingerprint(*by), u64::from_be_bytes(*number), rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const BY: Fingerprint = Fingerprint([7; FINGERPRINT]);

    #[test]
    fn a_fingerprint_reads_back() {
        assert_eq!(BY.to_string().parse(), Ok(BY));
        assert!("07".parse::<Fingerprint>().unwrap_err().to_string().contains("32 hexadecimal digits"));
        assert!("+7070707070707070707070707070707".parse::<Fingerprint>().is_err());
    }

    #[test]
    fn an_envelope_of_another_kind_is_rejected() {
        let answer = MessageKind::Reply(BY, 3);
        let bytes = encode_envelope(
            MessageKind::Query,
            SignedEnvelope { signer: BY, number: 9, signature: &[1; SIGNATURE_BYTES], payload: b"?" },
        );
        assert_eq!(bytes.len(), ENVELOPE_BYTES + 1);
        assert_eq!(decode_envelope(MessageKind::Query, &bytes).unwrap().payload, b"?");
        assert_eq!(decode_envelope(answer, &bytes), Err(EnvelopeError::Kind));
        assert_eq!(decode_envelope(answer, &bytes[..ENVELOPE_BYTES - 1]), Err(EnvelopeError::Unsigned));
        assert_eq!(decode_envelope(answer, &[&[9], &bytes[1..]].concat()), Err(EnvelopeError::Version { found: 9 }));
    }

    #[test]
    fn every_signed_field_changes_the_signed_bytes() {
        let parts = [
            signed_part(MessageKind::Publication, BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Query, BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Reply(BY, 1), BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Reply(BY, 2), BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Refusal(BY, 1), BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Publication, BY, 2, "a/b", b"c"),
            signed_part(MessageKind::Publication, Fingerprint([8; FINGERPRINT]), 1, "a/b", b"c"),
            signed_part(MessageKind::Publication, BY, 1, "a/bc", b""),
            signed_part(MessageKind::Publication, BY, 1, "a/", b"bc"),
            signed_part(MessageKind::Publication, BY, 1, "x/b", b"c"),
            signed_part(MessageKind::Publication, BY, 1, "a/b", b"x"),
            signed_part(MessageKind::Reply(Fingerprint([8; FINGERPRINT]), 1), BY, 1, "a/b", b"c"),
        ];
        assert_eq!(parts.iter().collect::<std::collections::BTreeSet<_>>().len(), parts.len());
        // The same key signs tokens and links; their bytes cannot be confused with a message.
        assert!(parts.iter().all(|part| part.starts_with(&[&b"consort seal\0"[..], &[VERSION]].concat())));
    }

    proptest! {
        #[test]
        fn any_bytes_decode_or_are_rejected(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(envelope) = decode_envelope(MessageKind::Publication, &bytes) {
                prop_assert_eq!(encode_envelope(MessageKind::Publication, envelope), bytes);
            }
        }
    }
}
