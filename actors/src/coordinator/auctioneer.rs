//! Asking for bids and collecting the answers.

use crate::bus::SharedBus;
use bytes::Bytes;
use consort_protocol::auction::{BidResponse, CallForBids};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::Keys;
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{debug, warn};

/// Asks all robots, and returns as soon as every expected one has answered, else when the window closes. Answers of
/// robots that were not expected count too: gossip about them may not have come this far yet.
pub(super) async fn collect_bids(
    bus: SharedBus,
    keys: Keys,
    call: CallForBids,
    expected: BTreeSet<RobotId>,
    window: Duration,
) -> Vec<BidResponse> {
    let bytes = match codec::encode(&call) {
        Ok(bytes) => Bytes::from(bytes),
        Err(problem) => {
            warn!(mission = %call.auction.mission, %problem, "the call for bids does not fit a message");
            return vec![];
        }
    };
    let mut replies = match bus.query(&keys.any_bid(), bytes, window).await {
        Ok(replies) => replies,
        Err(problem) => {
            warn!(%problem, "the call for bids was not sent");
            return vec![];
        }
    };
    let mut waiting = expected;
    let mut tenders = vec![];
    while let Some(reply) = replies.recv().await {
        match reply.payload.map(|payload| codec::decode::<BidResponse>(&payload)) {
            Ok(Ok(tender)) => {
                waiting.remove(&tender.robot);
                tenders.push(tender);
            }
            Ok(Err(problem)) => warn!(key = reply.key, %problem, "a tender that cannot be read"),
            Err(problem) => debug!(key = reply.key, problem, "no tender"),
        }
        if waiting.is_empty() {
            break;
        }
    }
    tenders.sort_by(|a, b| a.robot.cmp(&b.robot));
    tenders
}
