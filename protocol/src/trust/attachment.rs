//! A seal that stands beside a message, where the message itself is to stay what anybody's clients read.
//!
//! ```text
//!  beside a publication or an answer:  a seal as in `seal`, with its author's certificate in the place of the payload
//!  beside a question:                  its head alone, unsigned: whose question it is, and its number
//! ```
//!
//! Whoever asks as the fleet's own do says whose question it is, and gets an answer that is signed for this one question; who says
//! nothing gets the bare answer. The certificate is there since people's commands are over before they could ask for it.

use super::envelope::{Fingerprint, HEADER_BYTES, MessageKind, VERSION, decode_header, signed_part};

/// What stands beside a question of this number, which the bearer of this certificate asks.
pub fn encode_requester(by: Fingerprint, number: u64) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES);
    bytes.extend_from_slice(&[VERSION, MessageKind::Query.byte()]);
    bytes.extend_from_slice(&by.0);
    bytes.extend_from_slice(&number.to_be_bytes());
    bytes
}

/// As what an answer is to be sealed, by what stands beside the question. Nothing if nobody says whose question it is.
pub fn decode_requester(beside: &[u8]) -> Option<MessageKind> {
    match decode_header(beside) {
        Some(([VERSION, kind], by, number, [])) if kind == MessageKind::Query.byte() => {
            Some(MessageKind::Reply(by, number))
        }
        _ => None,
    }
}

/// What is signed of a message beside which the seal stands; `asked` is the question that it answers, empty for a publication. So a
/// relay cannot change what is asked without that being noticed.
pub fn signed_attachment(
    kind: MessageKind,
    by: Fingerprint,
    number: u64,
    key: &str,
    asked: &[u8],
    payload: &[u8],
) -> Vec<u8> {
    let length = (asked.len() as u64).to_be_bytes();
    signed_part(kind, by, number, key, &[&length, asked, payload].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    const BY: Fingerprint = Fingerprint([7; 16]);

    #[test]
    fn whose_question_it_is_reads_back() {
        assert_eq!(decode_requester(&encode_requester(BY, 9)), Some(MessageKind::Reply(BY, 9)));
        assert_eq!(decode_requester(&[]), None);
        assert_eq!(decode_requester(&[encode_requester(BY, 9), vec![0]].concat()), None, "there is more");
        let mut answer = encode_requester(BY, 9);
        answer[1] = MessageKind::Reply(BY, 9).byte();
        assert_eq!(decode_requester(&answer), None, "that is no question");
        let mut later = encode_requester(BY, 9);
        later[0] = VERSION + 1;
        assert_eq!(decode_requester(&later), None, "nobody knows what that says");
    }

    #[test]
    fn question_and_answer_are_told_apart_in_what_is_signed() {
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
        fn whatever_stands_beside_a_question_is_read_or_is_nothing(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            if let Some(MessageKind::Reply(by, number)) = decode_requester(&bytes) {
                prop_assert_eq!(encode_requester(by, number), bytes);
            }
        }
    }
}
