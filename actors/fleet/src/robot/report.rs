//! Reports to the coordinator over the bus.

use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::codec;
use consort_protocol::message::{Report, ReportReply};
use std::time::Duration;
use tracing::warn;

/// Sends a report to a coordinator and returns the reply.
pub(crate) async fn send_report(bus: SharedBus, key: &str, report: &Report, limit: Duration) -> Option<ReportReply> {
    let bytes = Bytes::from(codec::encode(report).expect("a report fits a message"));
    let mut replies = bus.query(key, bytes, limit).await.ok()?;
    match codec::decode(&replies.recv().await?.payload.ok()?) {
        Ok(reply) => Some(reply),
        Err(problem) => {
            warn!(%problem, "reply to a report cannot be decoded");
            None
        }
    }
}
