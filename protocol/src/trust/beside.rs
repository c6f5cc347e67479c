//! A seal that stands beside a message, where the message itself is to stay what anybody's clients read.
//!
//! ```text
//!  beside a publication or an answer:  a seal as in `seal`, with its author's certificate in the place of the payload
//!  beside a question:                  its head alone, unsigned: whose question it is, and its number
//! ```
//!
//! Whoever asks as the fleet's own do says whose question it is, and gets an answer that is signed for this one question; who says
//! nothing gets the bare answer. The certificate is there since people's commands are over before they could ask for it.

use super::seal::{Fingerprint, HEAD, Kind, VERSION, read_head, signed_part};

/// What stands beside a question of this number, which the bearer of this certificate asks.
pub fn write_asker(by: Fingerprint, number: u64) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD);
    bytes.extend_from_slice(&[VERSION, Kind::Question.byte()]);
    bytes.extend_from_slice(&by.0);
    bytes.extend_from_slice(&number.to_be_bytes());
    bytes
}

/// As what an answer is to be sealed, by what stands beside the question. Nothing if nobody says whose question it is.
pub fn read_asker(beside: &[u8]) -> Option<Kind> {
    match read_head(beside) {
        Some(([VERSION, kind], by, number, [])) if kind == Kind::Question.byte() => Some(Kind::Answer(by, number)),
        _ => None,
    }
}

/// What is signed of a message beside which the seal stands; `asked` is the question that it answers, empty for a publication. So a
/// relay cannot change what is asked without that being noticed.
pub fn signed_beside(kind: Kind, by: Fingerprint, number: u64, key: &str, asked: &[u8], payload: &[u8]) -> Vec<u8> {
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
        assert_eq!(read_asker(&write_asker(BY, 9)), Some(Kind::Answer(BY, 9)));
        assert_eq!(read_asker(&[]), None);
        assert_eq!(read_asker(&[write_asker(BY, 9), vec![0]].concat()), None, "there is more");
        let mut answer = write_asker(BY, 9);
        answer[1] = Kind::Answer(BY, 9).byte();
        assert_eq!(read_asker(&answer), None, "that is no question");
        let mut later = write_asker(BY, 9);
        later[0] = VERSION + 1;
        assert_eq!(read_asker(&later), None, "nobody knows what that says");
    }

    #[test]
    fn question_and_answer_are_told_apart_in_what_is_signed() {
        let answer = Kind::Answer(BY, 3);
        let parts = [
            signed_beside(answer, BY, 1, "a", b"", b"bc"),
            signed_beside(answer, BY, 1, "a", b"b", b"c"),
            signed_beside(answer, BY, 1, "a", b"x", b"c"),
            signed_beside(answer, BY, 1, "a", b"b", b"x"),
            signed_beside(answer, BY, 1, "a", b"bc", b""),
            signed_part(answer, BY, 1, "a", b"bc"),
        ];
        assert_eq!(parts.iter().collect::<BTreeSet<_>>().len(), parts.len());
    }

    proptest! {
        #[test]
        fn whatever_stands_beside_a_question_is_read_or_is_nothing(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            if let Some(Kind::Answer(by, number)) = read_asker(&bytes) {
                prop_assert_eq!(write_asker(by, number), bytes);
            }
        }
    }
}
