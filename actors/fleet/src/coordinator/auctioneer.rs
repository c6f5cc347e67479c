//! The auctioneer: sends a call for bids and collects the responses.

use super::ensemble_members::live_members;
use super::message::{CollectedBids, CoordinatorMessage};
use super::session_context::SessionContext;
use bytes::Bytes;
use consort_bus::{Reply, SharedBus};
use consort_protocol::auction::{AuctionId, BidResponse, CallForBids, Invitation, PromiseTerms, Timelines};
use consort_protocol::codec;
use consort_protocol::ids::{NodeId, RobotId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{debug, warn};

/// Returns the call for bids for roles of a mission, and the robots that are expected to reply.
pub(super) fn call_for_roles(
    roles: &BTreeSet<RoleId>,
    auction: AuctionId,
    context: &SessionContext,
    now: NodeTime,
) -> Option<(CallForBids, Invitation)> {
    let settings = &context.settings;
    let robots = |nodes: BTreeSet<NodeId>| nodes.into_iter().map(RobotId::from).collect();
    let members = live_members(settings, now).into_iter().map(|(name, nodes)| (name, robots(nodes))).collect();
    let PromiseTerms { objective, delay_max, .. } = settings.auctions.promises;
    let wall_ms = settings.parts.clock.wall_ms();
    context.read_ledger(|ledger| {
        let entry = ledger.mission(&auction.mission)?;
        let call = entry.call_for_roles(roles, auction)?;
        let invitation = Invitation::of(&call.ensembles, &members);
        let promised = ledger.promised_roles(&call, delay_max, &invitation.robots, wall_ms);
        let may_start = entry.submission.may_start(context.confirmed_ms);
        let startable = call.roles.keys().filter(|role| may_start && entry.can_proceed(role)).cloned().collect();
        let until = |deadline_ms: u64| Seconds::new(deadline_ms.saturating_sub(wall_ms) as f64 / 1000.0).ok();
        let ends_within = entry.submission.deadline_ms.and_then(until);
        let releases = entry.releases(wall_ms).into_iter().filter(|(role, _)| call.roles.contains_key(role)).collect();
        let timelines = Timelines { objective, promised, startable, ends_within, releases };
        Some((CallForBids { timelines, ..call }, invitation))
    })
}

/// Sends a call for bids, after the reply to the request for the mission. The session gets the bids as
/// a message.
pub(super) fn send_call(mut bids: CollectedBids, context: &mut SessionContext) {
    let (bus, keys) = (context.settings.parts.bus.clone(), context.settings.parts.keys.clone());
    let window = context.settings.auctions.bid_window;
    let mission = &bids.call.auction.mission;
    let request = context.read_ledger(|ledger| Some(ledger.mission(mission)?.submission.request.clone()));
    let open_replies = context.open_replies.clone();
    context.send_result(async move {
        if let Some(request) = request {
            open_replies.wait_sent(&request).await;
        }
        let latest = collect_bids(bus, keys, &bids, window).await;
        bids.responses.extend(latest);
        bids.responses.sort_by(|a, b| a.robot.cmp(&b.robot));
        CoordinatorMessage::BidsCollected(Box::new(bids))
    });
}

async fn collect_bids(bus: SharedBus, keys: Keys, bids: &CollectedBids, window: Duration) -> Vec<BidResponse> {
    let bytes = match codec::encode(&bids.call) {
        Ok(bytes) => Bytes::from(bytes),
        Err(problem) => {
            warn!(mission = %bids.call.auction.mission, %problem, "the call for bids does not fit a message");
            return vec![];
        }
    };
    match &bids.called {
        None => call_all(bus, keys, bytes, bids.invitation.robots.clone(), window).await,
        Some(robots) => call_each(bus, keys, bytes, robots, window).await,
    }
}

/// Calls all robots, and returns once every expected robot has replied or the bid window closes.
/// Responses of unexpected robots count too: their gossip records may not have arrived here yet.
async fn call_all(
    bus: SharedBus,
    keys: Keys,
    call: Bytes,
    expected: BTreeSet<RobotId>,
    window: Duration,
) -> Vec<BidResponse> {
    let mut replies = match bus.query(&keys.any_bid(), call, window).await {
        Ok(replies) => replies,
        Err(problem) => {
            warn!(%problem, "the call for bids was not sent");
            return vec![];
        }
    };
    let mut missing = expected;
    let mut responses = vec![];
    while let Some(reply) = replies.recv().await {
        if let Some(response) = response_of(reply) {
            missing.remove(&response.robot);
            responses.push(response);
        }
        if missing.is_empty() {
            break;
        }
    }
    responses
}

/// Calls these robots, and returns once every robot has replied or the bid window closes.
async fn call_each(
    bus: SharedBus,
    keys: Keys,
    call: Bytes,
    robots: &BTreeSet<RobotId>,
    window: Duration,
) -> Vec<BidResponse> {
    let mut queries = vec![];
    for robot in robots {
        match bus.query(&keys.write(&Key::Bid(robot.clone())), call.clone(), window).await {
            Ok(replies) => queries.push(replies),
            Err(problem) => warn!(%robot, %problem, "the call for bids was not sent"),
        }
    }
    // All queries are under way, so the last one ends with the window.
    let mut responses = vec![];
    for mut replies in queries {
        responses.extend(replies.recv().await.and_then(response_of));
    }
    responses
}

fn response_of(reply: Reply) -> Option<BidResponse> {
    match reply.payload.map(|payload| codec::decode::<BidResponse>(&payload)) {
        Ok(Ok(response)) => return Some(response),
        Ok(Err(problem)) => warn!(key = reply.key, %problem, "bid response cannot be decoded"),
        Err(refused) => debug!(key = reply.key, problem = refused.0, "no bid response"),
    }
    None
}
