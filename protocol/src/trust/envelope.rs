//! The envelope by which a message proves who said it.
//!
//! ```text
//!  1      1     16           8       64         …
//!  version kind  fingerprint  number  signature  payload
//! ```
//!
//! What is signed ([`signed_part`]) is the purpose, version, kind, fingerprint and number, the key that it is said on, for
//! an answer the question that it answers, and the payload. So a relay can neither put a message on another key, nor pass an
//! answer off as one to another question, nor a question as a publication.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// First byte of every sealed message.
pub(super) const VERSION: u8 = 1;

/// Bytes of an Ed25519 signature.
pub const SIGNATURE_BYTES: usize = 64;

const FINGERPRINT: usize = 16;
pub(super) const HEADER_BYTES: usize = 2 + FINGERPRINT + 8;

/// How many bytes a seal adds to a message.
pub const ENVELOPE_BYTES: usize = HEADER_BYTES + SIGNATURE_BYTES;

/// Which certificate: the first half of the SHA-256 of its DER. Written as 32 hexadecimal digits.
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
    type Err = String;

    fn from_str(text: &str) -> Result<Fingerprint, String> {
        let problem = || format!("{text:?} is no fingerprint: one is {} hexadecimal digits", 2 * FINGERPRINT);
        let right =
            text.len() == 2 * FINGERPRINT && text.bytes().all(|c| c.is_ascii_digit() || (b'a'..=b'f').contains(&c));
        let number = right.then(|| u128::from_str_radix(text, 16).ok()).flatten();
        number.map(|number| Fingerprint(number.to_be_bytes())).ok_or_else(problem)
    }
}

/// What a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageKind {
    /// It is said to whoever listens.
    Publication,
    /// It asks.
    Query,
    /// It answers the question of this number, which the bearer of this certificate asked.
    Reply(Fingerprint, u64),
}

impl MessageKind {
    pub(super) fn byte(self) -> u8 {
        match self {
            MessageKind::Publication => 0,
            MessageKind::Query => 1,
            MessageKind::Reply(..) => 2,
        }
    }
}

/// A message as it was sealed; whether the signature is right is not said by its being one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedEnvelope<'a> {
    /// By the bearer of which certificate it claims to be.
    pub signer: Fingerprint,
    /// Its number among all messages of its author, which only grow.
    pub number: u64,
    /// Over [`signed_part`].
    pub signature: &'a [u8],
    /// The message.
    pub payload: &'a [u8],
}

/// Why bytes are not a sealed message of the kind expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EnvelopeError {
    /// Too short to be one: it comes from somebody who seals nothing.
    #[error("it bears no seal")]
    Unsigned,
    /// Sealed in another way.
    #[error("its seal is of version {found}, where this node knows {VERSION}")]
    Version {
        /// The version found.
        found: u8,
    },
    /// A question where an answer was expected, or the like.
    #[error("it was sealed as another kind of message")]
    Kind,
}

/// What is signed of a message.
pub fn signed_part(kind: MessageKind, by: Fingerprint, number: u64, key: &str, payload: &[u8]) -> Vec<u8> {
    let mut signed = Vec::with_capacity(64 + HEADER_BYTES + key.len() + payload.len());
    signed.extend_from_slice(b"consort seal\0");
    signed.extend_from_slice(&[VERSION, kind.byte()]);
    signed.extend_from_slice(&by.0);
    signed.extend_from_slice(&number.to_be_bytes());
    if let MessageKind::Reply(asker, question) = kind {
        signed.extend_from_slice(&asker.0);
        signed.extend_from_slice(&question.to_be_bytes());
    }
    signed.extend_from_slice(&(key.len() as u64).to_be_bytes());
    signed.extend_from_slice(key.as_bytes());
    signed.extend_from_slice(payload);
    signed
}

/// The sealed message as bytes.
pub fn encode_envelope(kind: MessageKind, sealed: SignedEnvelope<'_>) -> Vec<u8> {
    let SignedEnvelope { signer: by, number, signature, payload } = sealed;
    let mut bytes = Vec::with_capacity(ENVELOPE_BYTES + payload.len());
    bytes.extend_from_slice(&[VERSION, kind.byte()]);
    bytes.extend_from_slice(&by.0);
    bytes.extend_from_slice(&number.to_be_bytes());
    bytes.extend_from_slice(signature);
    bytes.extend_from_slice(payload);
    bytes
}

/// The sealed message that bytes are.
///
/// # Errors
/// [`SealError`]; whatever the bytes are, this does not panic.
pub fn decode_envelope(kind: MessageKind, bytes: &[u8]) -> Result<SignedEnvelope<'_>, EnvelopeError> {
    let ([version, of_kind], by, number, rest) = decode_header(bytes).ok_or(EnvelopeError::Unsigned)?;
    let (signature, payload) = rest.split_at_checked(SIGNATURE_BYTES).ok_or(EnvelopeError::Unsigned)?;
    match (version, of_kind) {
        (VERSION, of_kind) if of_kind == kind.byte() => Ok(SignedEnvelope { signer: by, number, signature, payload }),
        (VERSION, _) => Err(EnvelopeError::Kind),
        (found, _) => Err(EnvelopeError::Version { found }),
    }
}

/// Version and kind, fingerprint and number, and whatever follows.
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
        assert!("07".parse::<Fingerprint>().unwrap_err().contains("32 hexadecimal digits"));
        assert!("+7070707070707070707070707070707".parse::<Fingerprint>().is_err());
    }

    #[test]
    fn one_kind_is_not_taken_for_another() {
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
    fn whatever_differs_is_signed_differently() {
        let parts = [
            signed_part(MessageKind::Publication, BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Query, BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Reply(BY, 1), BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Reply(BY, 2), BY, 1, "a/b", b"c"),
            signed_part(MessageKind::Publication, BY, 2, "a/b", b"c"),
            signed_part(MessageKind::Publication, Fingerprint([8; FINGERPRINT]), 1, "a/b", b"c"),
            signed_part(MessageKind::Publication, BY, 1, "a/bc", b""),
            signed_part(MessageKind::Publication, BY, 1, "a/", b"bc"),
            signed_part(MessageKind::Publication, BY, 1, "x/b", b"c"),
            signed_part(MessageKind::Publication, BY, 1, "a/b", b"x"),
            signed_part(MessageKind::Reply(Fingerprint([8; FINGERPRINT]), 1), BY, 1, "a/b", b"c"),
        ];
        assert_eq!(parts.iter().collect::<std::collections::BTreeSet<_>>().len(), parts.len());
        // The same key signs tokens and links: none of these is taken for a message.
        assert!(parts.iter().all(|part| part.starts_with(&[&b"consort seal\0"[..], &[VERSION]].concat())));
    }

    proptest! {
        #[test]
        fn whatever_is_heard_is_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(sealed) = decode_envelope(MessageKind::Publication, &bytes) {
                prop_assert_eq!(encode_envelope(MessageKind::Publication, sealed), bytes);
            }
        }
    }
}
