//! Limits of texts, lists and maps that other nodes send, enforced where they are decoded.
//!
//! A text for people is shortened, since the message counts all the same: a robot with a long cause
//! must be able to release its role. A list or map that is too long makes its message malformed, and
//! so does a long text in a signed record.

use consort_text::shorten;
use serde::de::{Deserialize, Deserializer, Error};

/// Maximum size of a text for people, in bytes: a few sentences. Raised: fewer texts are shortened,
/// and fewer replies fit the record of an auction.
pub(crate) const TEXT_BYTES_MAX: usize = 512;

/// Maximum size of a text in a signed record, in bytes. The owner shortens it to less.
const SIGNED_TEXT_BYTES_MAX: usize = 4096;

/// Maximum number of steps, signals or skills in a message. More do not fit the largest mission.
pub(crate) const ELEMENTS_MAX: usize = 16 * 1024;

/// Shortens a text to at most `bytes_max` bytes.
pub(crate) fn limit_text(text: &mut String, bytes_max: usize) {
    if text.len() > bytes_max {
        *text = shorten(text, bytes_max).into_owned();
    }
}

/// Decodes a text for people, and shortens it to [`TEXT_BYTES_MAX`].
pub(crate) fn text<'de, D: Deserializer<'de>>(source: D) -> Result<String, D::Error> {
    let mut text = String::deserialize(source)?;
    limit_text(&mut text, TEXT_BYTES_MAX);
    Ok(text)
}

/// Decodes a text that is part of a signature, and is therefore not shortened.
pub(crate) fn signed_text<'de, D: Deserializer<'de>>(source: D) -> Result<String, D::Error> {
    let text = String::deserialize(source)?;
    match text.len() {
        size if size > SIGNED_TEXT_BYTES_MAX => {
            Err(D::Error::custom(format_args!("a text of {size} bytes; at most {SIGNED_TEXT_BYTES_MAX} are allowed")))
        }
        _ => Ok(text),
    }
}

/// Decodes a list, set or map of at most `MAX` elements.
pub(crate) fn collection<'de, D, C, const MAX: usize>(source: D) -> Result<C, D::Error>
where
    D: Deserializer<'de>,
    C: Deserialize<'de>,
    for<'a> &'a C: IntoIterator,
{
    let elements = C::deserialize(source)?;
    match (&elements).into_iter().count() {
        size if size > MAX => Err(D::Error::custom(format_args!("{size} elements; at most {MAX} are allowed"))),
        _ => Ok(elements),
    }
}

#[cfg(test)]
mod tests {
    use crate::auction::{AuctionId, BidRefusal, BidResponse, RefusalReason, RoleReply};
    use crate::codec::{self, CodecError};
    use crate::ids::{MissionId, RobotId, RoleId};
    use crate::knowledge::Availability;
    use crate::message::{FailureKind, TaskFailure};

    fn response(roles: usize) -> BidResponse {
        let robot = RobotId::new("ada").unwrap();
        let refusal = |role| {
            let (robot, role) = (robot.clone(), RoleId::new(format!("r{role}")).unwrap());
            RoleReply::Refusal(BidRefusal { robot, role, reason: RefusalReason::Silent { window_ms: 1 } })
        };
        let auction = AuctionId { mission: MissionId::new("m-1").unwrap(), term: 1, round: 1 };
        BidResponse { robot: robot.clone(), auction, replies: (0..roles).map(refusal).collect() }
    }

    #[test]
    fn a_long_text_of_another_node_is_shortened() {
        let failure = |cause: &str| TaskFailure::new(FailureKind::Task, cause);
        let sent = failure(&"no route; ".repeat(6000));
        let received: TaskFailure = codec::decode(&codec::encode(&sent).unwrap()).unwrap();
        assert!(received.cause.len() <= super::TEXT_BYTES_MAX && received.cause.ends_with('…'));
        let short = failure("no route");
        assert_eq!(codec::decode::<TaskFailure>(&codec::encode(&short).unwrap()).unwrap(), short);
    }

    #[test]
    fn a_message_with_too_many_elements_is_malformed() {
        let bytes = codec::encode(&response(64)).unwrap();
        assert_eq!(codec::decode::<BidResponse>(&bytes).unwrap(), response(64));
        let error = codec::decode::<BidResponse>(&codec::encode(&response(65)).unwrap()).unwrap_err();
        assert!(error.to_string().contains("65 elements; at most 64 are allowed"), "{error}");
    }

    #[test]
    fn a_long_text_in_a_signed_record_is_malformed() {
        let state = |size| Availability::OutOfService { problem: "x".repeat(size) };
        let read = |size| codec::decode::<Availability>(&codec::encode(&state(size)).unwrap());
        assert_eq!(read(4096).unwrap(), state(4096));
        assert!(matches!(read(4097), Err(CodecError::Malformed(_))));
    }
}
