//! A node with the stolen key of a voter claims to coordinate a fleet with certificates: in beacons, in replies to the
//! robots, and by orders. The robots obey the true coordinator alone.

use crate::closed::{ROOM, SEEDS, SOON, closed, replies, stolen, wire};
use crate::support::{released, request};
use bytes::Bytes;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::ClusterId;
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::{EndReason, Epoch};
use consort_protocol::message::{AwardNotice, Beacon, FollowedLeader, OrderNotice, OrdersNotice, Report, ReportReply};
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;

const NAME: &str = "dill";
const ROBOTS: [&str; 2] = ["gorse", "lab-arm"];

/// Longer than a robot keeps the orders of a former cluster.
const LONG: Duration = Duration::from_secs(15);

/// Limit for an order to show in the record of its robot.
const ORDER_SHOWN: Duration = Duration::from_secs(5);

struct FalseCoordinator {
    bus: SharedBus,
    keys: Keys,
    /// Cluster that its beacons state.
    cluster: Option<ClusterId>,
    /// Number of refused notices, and of reports that it received.
    refused: AtomicU64,
    reports: AtomicU64,
}

impl FalseCoordinator {
    async fn new(fleet: &Fleet, cluster: Option<ClusterId>) -> Arc<FalseCoordinator> {
        let bus = stolen(fleet, NAME, NodeRole::Voter).await.in_cluster(fleet);
        let (refused, reports) = (AtomicU64::new(0), AtomicU64::new(0));
        Arc::new(FalseCoordinator { bus, keys: fleet.keys().clone(), cluster, refused, reports })
    }

    /// Claims to coordinate, in beacons and in its own statement as a voter.
    fn claim(self: &Arc<Self>, tasks: &mut JoinSet<()>) {
        tasks.spawn(Arc::clone(self).publish_beacons());
        tasks.spawn(Arc::clone(self).state_that_it_leads());
    }

    async fn publish_beacons(self: Arc<Self>) {
        let (key, cluster) = (self.keys.write(&Key::Beacon), self.cluster);
        loop {
            let voters = [slug(NAME)].into();
            let beacon = Beacon { node: slug(NAME), term: u64::MAX, voters, since_ms: 0, cluster, wire: None };
            let sent = self.bus.publish(&key, wire(&beacon), Encoding::Wire, Delivery::Block).await;
            sent.expect("its key permits beacons");
            tokio::time::sleep(Duration::from_millis(300)).await; // virtual time
        }
    }

    async fn state_that_it_leads(self: Arc<Self>) {
        let key = self.keys.write(&Key::Leader(slug(NAME)));
        let mut queries = self.bus.serve(&key).await.expect("a network");
        while let Some(query) = queries.recv().await {
            let leader = Some(FollowedLeader { node: slug(NAME), term: u64::MAX });
            let _ = query.replier.reply(&key, wire(&leader), Encoding::Wire).await;
        }
    }

    /// Orders the robots again and again what `hold` states, as of the last position of any ledger.
    async fn order(self: Arc<Self>, hold: Option<OrderNotice>) {
        let as_of = Epoch { term: u64::MAX, index: u64::MAX };
        let orders = wire(&AwardNotice::Orders(OrdersNotice { as_of, hold, ..OrdersNotice::default() }));
        loop {
            for robot in ROBOTS {
                self.notify(robot, &orders).await;
            }
            tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
        }
    }

    /// Revokes the role of a robot again and again.
    async fn revoke(self: Arc<Self>, robot: &'static str, epoch: Epoch) {
        let notice = wire(&AwardNotice::Revoked { epoch, reason: EndReason::Canceled });
        loop {
            self.notify(robot, &notice).await;
            tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
        }
    }

    /// Sends a notice, and counts the refusal.
    async fn notify(&self, robot: &str, notice: &Bytes) {
        let key = self.keys.write(&Key::Award(slug(robot)));
        let replies = replies(&self.bus, &key, notice.clone(), Bytes::new()).await;
        let refused = replies.iter().filter(|reply| reply.contains("is not the coordinator of")).count();
        self.refused.fetch_add(refused as u64, Ordering::Relaxed);
    }

    /// Replies to each report that the mission was canceled.
    async fn end_roles(self: Arc<Self>) {
        let key = self.keys.write(&Key::Report(slug(NAME)));
        let mut queries = self.bus.serve(&key).await.expect("a network");
        while let Some(query) = queries.recv().await {
            let report: Report = codec::decode(&query.payload).expect("a report");
            let ended = ReportReply::Ended { epoch: report.epoch, reason: EndReason::Canceled, current: None };
            let _ = query.replier.reply(&key, wire(&ended), Encoding::Wire).await;
            self.reports.fetch_add(1, Ordering::Relaxed);
        }
    }
}

async fn closed_without_fern(seed: u64) -> Fleet {
    closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await
}

fn cluster_of(fleet: &Fleet) -> Option<ClusterId> {
    fleet.ledger(|ledger| ledger.cluster()).flatten()
}

/// Checks whether the record of a robot shows it free.
fn is_free(fleet: &Fleet, robot: &str) -> bool {
    fleet.knowledge_of("basil", &slug(robot)).is_some_and(|worker| worker.availability == Availability::Free)
}

/// Lets a false coordinator, whose beacons state `cluster`, hold and release idle robots, while people do so, too.
async fn assert_only_people_hold(mut fleet: Fleet, cluster: Option<ClusterId>) {
    let seed = fleet.seed;
    fleet.wait_for_audit_trail().await;
    fleet.wait_until("free robots", SOON, |fleet| ROBOTS.iter().all(|robot| is_free(fleet, robot))).await;
    let attacker = FalseCoordinator::new(&fleet, cluster).await;
    let (mut claims, mut orders) = (JoinSet::new(), JoinSet::new());
    attacker.claim(&mut claims);
    let hold = OrderNotice { text: "held by dill".to_owned(), remaining_ms: None };
    orders.spawn(Arc::clone(&attacker).order(Some(hold)));
    let is_held_by_it = |fleet: &Fleet| ROBOTS.iter().any(|robot| !is_free(fleet, robot));
    fleet.assert_never("a hold by the false coordinator", LONG, is_held_by_it).await;
    let refused_holds = attacker.refused.load(Ordering::Relaxed);
    orders.shutdown().await;

    request(&fleet, ApiCall::Hold, &json!({ "robots": ["gorse"], "for_s": 600, "by": "Nia" })).await;
    fleet.wait_until("the hold by people", ORDER_SHOWN, |fleet| !is_free(fleet, "gorse")).await;
    orders.spawn(Arc::clone(&attacker).order(None));
    fleet.assert_never("a release by the false coordinator", LONG, |fleet| is_free(fleet, "gorse")).await;
    request(&fleet, ApiCall::Release, &json!({ "robots": ["gorse"], "by": "Nia" })).await;
    fleet.wait_until("the release by people", ORDER_SHOWN, |fleet| is_free(fleet, "gorse")).await;
    let refused_releases = attacker.refused.load(Ordering::Relaxed) - refused_holds;
    assert!(refused_holds > 10 && refused_releases > 10, "seed {seed}: {refused_holds}, {refused_releases}");

    orders.shutdown().await;
    claims.shutdown().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.assert_completes(&mission).await;
    fleet.assert_sample_delivered(ROOM);
}

#[test]
fn a_false_coordinator_of_a_late_term_neither_holds_nor_releases() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = closed_without_fern(seed).await;
        let cluster = cluster_of(&fleet);
        assert_only_people_hold(fleet, cluster).await;
    });
}

#[test]
fn a_false_coordinator_of_an_invented_cluster_neither_holds_nor_releases() {
    for_each_seed(SEEDS, async |seed| {
        let fleet = closed_without_fern(seed).await;
        assert_only_people_hold(fleet, Some(ClusterId(7))).await;
    });
}

/// The voters contradict it before its notices and its replies to reports count.
#[test]
fn a_false_coordinator_ends_no_role() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        let attacker = FalseCoordinator::new(&fleet, cluster_of(&fleet)).await;
        let mut claims = JoinSet::new();
        attacker.claim(&mut claims);
        claims.spawn(Arc::clone(&attacker).end_roles());
        let mission = fleet.submit("a", ROOM).await;
        let held =
            |fleet: &Fleet| fleet.ledger(|ledger| ledger.held_by(&slug("gorse")).map(|(.., epoch)| epoch)).flatten();
        fleet.wait_until("an award", SOON, |fleet| held(fleet).is_some()).await;
        claims.spawn(Arc::clone(&attacker).revoke("gorse", held(&fleet).expect("an award")));
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        let ended = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Canceled, .. });
        assert_eq!(fleet.event_log.count(ended), 0, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        assert!(attacker.reports.load(Ordering::Relaxed) > 0, "seed {seed}: no robot reported to it");
        assert!(attacker.refused.load(Ordering::Relaxed) > 10, "seed {seed}: no notice was refused");
        claims.shutdown().await;
    });
}

/// A hold that the voters can neither confirm nor contradict still stops the robot.
#[test]
fn a_robot_that_reaches_no_voter_but_the_coordinator_is_held() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        for node in ["basil", "clove", "gorse", "lab-arm"] {
            fleet.network.block_queries(slug(node), &fleet.keys().write(&Key::Leader(slug(node))));
        }
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        let start = fleet.position("gorse");
        fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
        request(&fleet, ApiCall::Hold, &json!({ "robots": ["gorse"], "for_s": 600, "by": "Nia" })).await;
        fleet.wait_for_rest("gorse").await;
        let place = fleet.position("gorse");
        fleet.assert_never("a move", LONG, |fleet| fleet.position("gorse") != place).await;
        request(&fleet, ApiCall::Release, &json!({ "robots": ["gorse"], "by": "Nia" })).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
    });
}
