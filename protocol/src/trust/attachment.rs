//! Signature as an attachment to a message, where the payload must remain readable for any client.
//!
//! ```text
//!  attachment to a publication or a reply:  an envelope as in `envelope`, with the author's certificate as its payload
//!  attachment to a query:                   only the header, unsigned: the requester and the number of the query;
//!                                           with a signature if the query changes the fleet (`request_proof`)
//! ```
//!
//! A requester that attaches its identity, as the fleet's own nodes do, gets a reply that is signed
//! for this query. Any other requester gets the plain reply. The attachment contains the
//! certificate, since a short-lived command ends before it could query for the certificate.

use super::envelope::{Fingerprint, HEADER_BYTES, MessageKind, SIGNATURE_BYTES, VERSION, decode_header, signed_part};

/// Encodes the attachment of a query: the certificate of the requester and the number of the query.
pub fn encode_requester(by: Fingerprint, number: u64) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES);
    bytes.extend_from_slice(&[VERSION, MessageKind::Query.byte()]);
    bytes.extend_from_slice(&by.0);
    bytes.extend_from_slice(&number.to_be_bytes());
    bytes
}

/// Decodes the attachment of a query into the kind of its reply. `None` if the attachment names no
/// requester.
pub fn decode_requester(attachment: &[u8]) -> Option<MessageKind> {
    match decode_header(attachment) {
        Some(([VERSION, kind], by, number, rest))
            if kind == MessageKind::Query.byte() && (rest.is_empty() || rest.len() >= SIGNATURE_BYTES) =>
        {
            Some(MessageKind::Reply(by, number))
        }
        _ => None,
    }
}

/// Returns the bytes to sign for a message with an attachment. `query` is the payload of the query
/// that a reply answers; empty for a publication. So a relay cannot change a query without
/// detection.
pub fn signed_attachment(
    kind: MessageKind,
    by: Fingerprint,
    number: u64,
    key: &str,
    query: &[u8],
    payload: &[u8],
) -> Vec<u8> {
    let length = (query.len() as u64).to_be_bytes();
    signed_part(kind, by, number, key, &[&length, query, payload].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    const BY: Fingerprint = Fingerprint([7; 16]);

    #[test]
    fn the_attachment_of_a_query_reads_back() {
        assert_eq!(decode_requester(&encode_requester(BY, 9)), Some(MessageKind::Reply(BY, 9)));
        assert_eq!(decode_requester(&[]), None);
        assert_eq!(decode_requester(&[encode_requester(BY, 9), vec![0]].concat()), None, "there are extra bytes");
        let mut answer = encode_requester(BY, 9);
        answer[1] = MessageKind::Reply(BY, 9).byte();
        assert_eq!(decode_requester(&answer), None, "the kind is not a query");
        let mut later = encode_requester(BY, 9);
        later[0] = VERSION + 1;
        assert_eq!(decode_requester(&later), None, "the version is unknown");
    }

    #[test]
    fn query_and_reply_are_separated_in_the_signed_bytes() {
        let answer = MessageKind::Reply(BY, 3);
        let parts = [
            signed_attachment(answer, BY, 1, "a", b"", b"bc"),
            signed_attachment(answer, BY, 1, "a", b"b", b"c"),
            signed_attachment(answer, BY, 1, "a", b"x", b"c"),
            signed_attachment(answer, BY, 1, "a", b"b", b"x"),
            signed_attachment(answer, BY, 1, "a", b"bc", b""),
            signed_part(answer, BY, 1, "a", b"bc"),
        ];
        assert_eq!(parts.iter().collect::<BTreeSet<_>>().len(), parts.len());
    }

    proptest! {
        #[test]
        fn any_attachment_of_a_query_decodes_or_is_none(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            if let Some(MessageKind::Reply(by, number)) = decode_requester(&bytes) {
                prop_assert_eq!(encode_requester(by, number), bytes);
            }
        }
    }
}
