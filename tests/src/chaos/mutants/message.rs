//! Encoding of the messages that injected bugs change.

use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::message::{ClusterEnvelope, Report};
use serde::Serialize;

/// Decodes a report in its envelope.
pub(super) fn decode_report(payload: &[u8]) -> Option<Report> {
    let envelope: ClusterEnvelope = codec::decode(payload).ok()?;
    codec::decode(&envelope.payload).ok()
}

pub(super) fn encoded<T: Serialize>(message: &T) -> Bytes {
    codec::encode(message).expect("a changed message fits a message").into()
}
