//! Clients that wait for the end of a mission.

use crate::support::{fleet_of, received_of, request};
use consort_bus::SharedBus;
use consort_dashboard::query::{QueryError, QueryTarget, RETRY_DELAY, query_once};
use consort_fleet::node::NodeSettings;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key, KeyKind};
use consort_protocol::ledger::{Ledger, MissionState};
use consort_protocol::view::MissionView;
use consort_tests::{Fleet, for_each_seed, slug};
use serde::Deserialize as _;
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

const SOON: Duration = Duration::from_secs(60);

/// Reads a mission from the nearest node until the mission has ended, as `consort submit --wait` does. Publishes the node that
/// made each reply.
async fn wait_for_end(
    bus: SharedBus,
    key: String,
    mission: MissionId,
    replied: watch::Sender<Option<String>>,
) -> MissionState {
    let query = json!({ "mission": mission }).to_string();
    loop {
        match query_once(&*bus, &key, &query, Duration::from_secs(3), QueryTarget::Nearest).await {
            Ok(reply) => {
                let view = MissionView::deserialize(&reply).expect("a mission");
                replied.send_replace(reply["seen_by"].as_str().map(str::to_owned));
                if view.brief.status.detail.is_final() {
                    return view.brief.status.detail;
                }
                tokio::time::sleep(Duration::from_millis(500)).await;
            }
            Err(QueryError::Retryable(..) | QueryError::NoReply) => tokio::time::sleep(RETRY_DELAY).await,
            Err(QueryError::Rejected(problem)) => panic!("the client gives up: {problem}"),
        }
    }
}

/// The fleet keeps no ended mission whole, only its outcome. The node that answers the client, which also coordinates, dies
/// with a query of the client.
#[test]
fn a_client_that_waits_sees_the_end_although_its_node_dies() {
    for_each_seed([181, 182, 183], async |seed| {
        let keep_none = |settings: &mut NodeSettings| settings.fleet.history_limits.missions_max = 0;
        let mut fleet = fleet_of(seed, vec![], &[], keep_none).await;
        // It has no copy of the ledger, and would pass the reads on.
        fleet.kill("world").await;
        let missions_max = |ledger: &Ledger| ledger.history_limits().map(|limits| limits.missions_max);
        fleet.wait_until("the limit of the history", SOON, |fleet| fleet.ledger(missions_max) == Some(Some(0))).await;
        let submit = json!({
            "mission": "lab-samples", "parameters": { "room": "IC Room 6" }, "request": "a", "deadline_s": 20,
        });
        let reply = request(&fleet, ApiCall::Submit, &submit).await;
        let mission: MissionId = slug(reply["mission"].as_str().expect("a mission"));

        let (replied, mut node) = watch::channel(None);
        let (bus, key) = (Arc::clone(&fleet.requests), fleet.keys().write(&Key::Api(ApiCall::Get)));
        let waiting = tokio::spawn(wait_for_end(bus, key, mission.clone(), replied));
        let first = node.wait_for(Option::is_some).await.expect("the mission has not ended").clone();
        let first = first.expect("checked before");
        assert_eq!(fleet.coordinating(), Some(slug(&first)), "seed {seed}: the node that replies");
        let queries = received_of(&fleet, &first, KeyKind::People);
        let has_query = |fleet: &Fleet| received_of(fleet, &first, KeyKind::People) > queries;
        fleet.wait_until("the next query", SOON, has_query).await;
        fleet.kill(&first).await;

        let end = tokio::time::timeout(3 * SOON, waiting).await.expect("the client sees the end");
        let end = end.expect("the client does not give up");
        let MissionState::Failed { cause, .. } = &end else { panic!("seed {seed}: {end:?}") };
        assert!(cause.starts_with("its deadline passed"), "seed {seed}: {cause}");
        assert_ne!(*node.borrow(), Some(first), "seed {seed}: another node has replied");
        let is_kept = |ledger: &Ledger| ledger.mission(&mission).is_some();
        assert_eq!(fleet.ledger(is_kept), Some(false), "seed {seed}: only the outcome is kept");
    });
}
