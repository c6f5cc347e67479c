//! The auctioneer: sends a call for bids and collects the responses.

use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::auction::{BidResponse, CallForBids};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::Keys;
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{debug, warn};

/// Calls all robots, and returns once every expected robot has replied or the bid window closes.
/// Responses of unexpected robots count too: their gossip records may not have arrived here yet.
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
    let mut missing = expected;
    let mut responses = vec![];
    while let Some(reply) = replies.recv().await {
        match reply.payload.map(|payload| codec::decode::<BidResponse>(&payload)) {
            Ok(Ok(response)) => {
                missing.remove(&response.robot);
                responses.push(response);
            }
            Ok(Err(problem)) => warn!(key = reply.key, %problem, "bid response cannot be decoded"),
            Err(refused) => debug!(key = reply.key, problem = refused.0, "no bid response"),
        }
        if missing.is_empty() {
            break;
        }
    }
    responses.sort_by(|a, b| a.robot.cmp(&b.robot));
    responses
}
