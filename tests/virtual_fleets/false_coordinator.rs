//! A node with the stolen key of a voter claims to coordinate a fleet with certificates: in beacons, in replies to the
//! robots, and by orders. The robots obey the true coordinator alone.

use crate::closed::{ROOM, SEEDS, SOON, closed, replies, stolen, wire};
use crate::support::{released, request};
use bytes::Bytes;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::{EndReason, Epoch};
use consort_protocol::message::{AwardNotice, Beacon, FollowedLeader, OrderNotice, OrdersNotice, Report, ReportReply};
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;

const NAME: &str = "dill";
const ROBOTS: [&str; 2] = ["gorse", "lab-arm"];

/// Longer than a robot keeps the orders of a former cluster.
const LONG: Duration = Duration::from_secs(15);

/// A place on the only way to the room, and its position.
const GATE: &str = "IC Corridor 6";
const GATE_Y_M: f64 = 31.0;

/// Limit for an order to show in the record of its robot.
const ORDER_SHOWN: Duration = Duration::from_secs(5);

struct FalseCoordinator {
    bus: SharedBus,
    keys: Keys,
    node: NodeId,
    /// Term of its first beacon. Each later beacon states the next, up to the last.
    term: u64,
    /// Voters and cluster that its beacons state.
    voters: BTreeSet<NodeId>,
    cluster: Option<ClusterId>,
    /// Position in the ledger that its orders state.
    as_of: Epoch,
    /// Number of refused notices, and of reports that it received.
    refused: AtomicU64,
    reports: AtomicU64,
}

impl FalseCoordinator {
    /// Takes the key of `name`, and names itself as the only voter of the fleet's cluster, in the last term.
    async fn of(fleet: &Fleet, name: &str) -> FalseCoordinator {
        let bus = stolen(fleet, name, NodeRole::Voter).await.in_cluster(fleet);
        let (node, keys, cluster) = (slug(name), fleet.keys().clone(), cluster_of(fleet));
        let as_of = Epoch { term: u64::MAX, index: u64::MAX };
        let (refused, reports) = (AtomicU64::new(0), AtomicU64::new(0));
        let (term, voters) = (u64::MAX, [slug(name)].into());
        FalseCoordinator { bus, keys, node, term, voters, cluster, as_of, refused, reports }
    }

    /// Names voters that do not exist, too.
    fn with_invented_voters(mut self, count: usize) -> FalseCoordinator {
        self.voters.extend((0..count).map(|number| slug::<NodeId>(&format!("invented-{number}"))));
        self
    }

    /// Claims to coordinate, in beacons and in its own statement as a voter.
    fn claim(self: &Arc<Self>, tasks: &mut JoinSet<()>) {
        tasks.spawn(Arc::clone(self).publish_beacons());
        tasks.spawn(Arc::clone(self).state_that_it_leads());
    }

    async fn publish_beacons(self: Arc<Self>) {
        let (key, cluster, mut term) = (self.keys.write(&Key::Beacon), self.cluster, self.term);
        loop {
            let (node, voters) = (self.node.clone(), self.voters.clone());
            let beacon = Beacon { node, term, voters, since_ms: 0, cluster, wire: None };
            term = term.saturating_add(1);
            let sent = self.bus.publish(&key, wire(&beacon), Encoding::Wire, Delivery::Block).await;
            sent.expect("its key permits beacons");
            tokio::time::sleep(Duration::from_millis(300)).await; // virtual time
        }
    }

    async fn state_that_it_leads(self: Arc<Self>) {
        let key = self.keys.write(&Key::Leader(self.node.clone()));
        let mut queries = self.bus.serve(&key).await.expect("a network");
        while let Some(query) = queries.recv().await {
            let leader = Some(FollowedLeader { node: self.node.clone(), term: u64::MAX });
            let _ = query.replier.reply(&key, wire(&leader), Encoding::Wire).await;
        }
    }

    /// Keeps the queries to all voters open without a reply, so that those to voters that do not exist are late.
    async fn delay_statements(self: Arc<Self>) {
        let every = self.keys.write(&Key::Leader(self.node.clone())).replace(self.node.as_str(), "*");
        let mut queries = self.bus.serve(&every).await.expect("a network");
        let mut open = vec![];
        while let Some(query) = queries.recv().await {
            open.push(query);
        }
    }

    /// Waits for two beacons of a node: the robots have received the first when it sends the second.
    async fn wait_for_beacons_of(&self, node: &NodeId) {
        let mut beacons = self.bus.subscribe(&self.keys.write(&Key::Beacon)).await.expect("a network");
        let mut received = 0;
        while received < 2 {
            let sample = tokio::time::timeout(SOON, beacons.recv()).await.expect("a beacon").expect("a network");
            let beacon: Beacon = codec::decode(&sample.payload).expect("a beacon");
            received += u32::from(beacon.node == *node);
        }
    }

    /// Orders the robots again and again what `hold` states.
    async fn order(self: Arc<Self>, hold: Option<OrderNotice>) {
        let as_of = self.as_of;
        let orders = wire(&AwardNotice::Orders(Box::new(OrdersNotice { as_of, hold, ..OrdersNotice::default() })));
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

    /// Holds the robots again and again.
    async fn hold(self: Arc<Self>) {
        self.order(Some(OrderNotice { text: "held by it".to_owned(), remaining_ms: None })).await;
    }

    /// Replies to each report that the mission was canceled.
    async fn end_roles(self: Arc<Self>) {
        let key = self.keys.write(&Key::Report(self.node.clone()));
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

/// Checks whether the records of the robots show them free.
fn are_free(fleet: &Fleet) -> bool {
    ROBOTS.iter().all(|robot| is_free(fleet, robot))
}

/// Lets a false coordinator hold idle robots. Returns the number of refused notices.
async fn assert_holds_nothing(fleet: &mut Fleet, attacker: &Arc<FalseCoordinator>) -> u64 {
    let mut orders = JoinSet::new();
    orders.spawn(Arc::clone(attacker).hold());
    fleet.assert_never("a hold by the false coordinator", LONG, |fleet| !are_free(fleet)).await;
    orders.shutdown().await;
    attacker.refused.load(Ordering::Relaxed)
}

/// Holds a robot as people do.
async fn hold_gorse(fleet: &mut Fleet) {
    request(fleet, ApiCall::Hold, &json!({ "robots": ["gorse"], "for_s": 600, "by": "Nia" })).await;
    fleet.wait_until("the hold by people", ORDER_SHOWN, |fleet| !is_free(fleet, "gorse")).await;
}

/// Releases the robot as people do.
async fn release_gorse(fleet: &mut Fleet) {
    request(fleet, ApiCall::Release, &json!({ "robots": ["gorse"], "by": "Nia" })).await;
    fleet.wait_until("the release by people", ORDER_SHOWN, |fleet| is_free(fleet, "gorse")).await;
}

/// Lets a false coordinator, whose beacons state `cluster`, hold and release idle robots, while people do so, too.
async fn assert_only_people_hold(mut fleet: Fleet, cluster: Option<ClusterId>) {
    let seed = fleet.seed;
    fleet.wait_for_audit_trail().await;
    fleet.wait_until("free robots", SOON, are_free).await;
    let attacker = Arc::new(FalseCoordinator { cluster, ..FalseCoordinator::of(&fleet, NAME).await });
    let (mut claims, mut orders) = (JoinSet::new(), JoinSet::new());
    attacker.claim(&mut claims);
    let refused_holds = assert_holds_nothing(&mut fleet, &attacker).await;

    hold_gorse(&mut fleet).await;
    orders.spawn(Arc::clone(&attacker).order(None));
    fleet.assert_never("a release by the false coordinator", LONG, |fleet| is_free(fleet, "gorse")).await;
    release_gorse(&mut fleet).await;
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

/// Robots that have no orders get no notice from the next coordinator, so none of them polls before the attack.
#[test]
fn the_key_of_a_former_coordinator_holds_no_robot() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.kill_coordinator().await.as_str(), "aster", "seed {seed}");
        let next = fleet.wait_for_coordinator().await;
        fleet.wait_until("free robots", SOON, are_free).await;
        let aster = FalseCoordinator::of(&fleet, "aster").await;
        aster.wait_for_beacons_of(&next).await;
        // A position of its own leader session.
        let attacker = Arc::new(FalseCoordinator { as_of: Epoch::default(), ..aster });
        let mut claims = JoinSet::new();
        attacker.claim(&mut claims);
        let refused = assert_holds_nothing(&mut fleet, &attacker).await;
        assert!(refused > 10, "seed {seed}: {refused}");
        hold_gorse(&mut fleet).await;
        release_gorse(&mut fleet).await;
        claims.shutdown().await;
    });
}

/// The voters that it names cannot be late: they have no record.
#[test]
fn a_false_coordinator_with_invented_voters_prevents_no_order() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        fleet.wait_for_audit_trail().await;
        fleet.wait_until("free robots", SOON, are_free).await;
        let attacker = Arc::new(FalseCoordinator::of(&fleet, NAME).await.with_invented_voters(15));
        let mut claims = JoinSet::new();
        attacker.claim(&mut claims);
        claims.spawn(Arc::clone(&attacker).delay_statements());
        assert_holds_nothing(&mut fleet, &attacker).await;
        hold_gorse(&mut fleet).await;
        release_gorse(&mut fleet).await;
        claims.shutdown().await;
    });
}

/// Asserts that a mission completes although a false coordinator replies to each report that the mission was canceled, and
/// revokes the role of the carrier.
async fn assert_ends_no_role(fleet: &mut Fleet, attacker: &Arc<FalseCoordinator>) {
    let seed = fleet.seed;
    let mut claims = JoinSet::new();
    attacker.claim(&mut claims);
    claims.spawn(Arc::clone(attacker).end_roles());
    let mission = fleet.submit("a", ROOM).await;
    let held = |fleet: &Fleet| fleet.ledger(|ledger| ledger.held_by(&slug("gorse")).map(|(.., epoch)| epoch)).flatten();
    fleet.wait_until("an award", SOON, |fleet| held(fleet).is_some()).await;
    claims.spawn(Arc::clone(attacker).revoke("gorse", held(fleet).expect("an award")));
    fleet.assert_completes(&mission).await;
    fleet.assert_each_task_once(&mission);
    fleet.assert_sample_delivered(ROOM);
    let ended = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Canceled, .. });
    assert_eq!(fleet.event_log.count(ended), 0, "seed {seed}\n{}", fleet.event_log_text());
    assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
    assert!(attacker.refused.load(Ordering::Relaxed) > 10, "seed {seed}: no notice was refused");
    claims.shutdown().await;
}

/// The voters contradict it before its notices and its replies to reports count.
#[test]
fn a_false_coordinator_ends_no_role() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        let attacker = Arc::new(FalseCoordinator::of(&fleet, NAME).await);
        assert_ends_no_role(&mut fleet, &attacker).await;
        assert!(attacker.reports.load(Ordering::Relaxed) > 0, "seed {seed}: no robot reported to it");
    });
}

/// Robots ignore a beacon with more voters than a fleet has.
#[test]
fn a_false_coordinator_with_too_many_voters_ends_no_role() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        let attacker = Arc::new(FalseCoordinator::of(&fleet, NAME).await.with_invented_voters(30));
        assert_ends_no_role(&mut fleet, &attacker).await;
    });
}

/// It never replies to the reports of robots, which follow it at first.
#[test]
fn a_false_coordinator_of_rising_terms_takes_no_role() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed_without_fern(seed).await;
        let attacker = Arc::new(FalseCoordinator { term: 1_000, ..FalseCoordinator::of(&fleet, NAME).await });
        let mut claims = JoinSet::new();
        attacker.claim(&mut claims);
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        claims.shutdown().await;
    });
}

/// Lets `gorse` drive to the room while no voter states its leader.
async fn under_way_without_statements(seed: u64) -> (Fleet, MissionId) {
    let mut fleet = closed_without_fern(seed).await;
    for node in ["basil", "clove", "gorse", "lab-arm"] {
        fleet.network.block_queries(slug(node), &fleet.keys().write(&Key::Leader(slug(node))));
    }
    fleet.wait_for_audit_trail().await;
    let mission = fleet.submit("a", ROOM).await;
    let start = fleet.position("gorse");
    fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
    (fleet, mission)
}

/// A hold that the voters can neither confirm nor contradict still stops the robot.
#[test]
fn a_robot_that_reaches_no_voter_but_the_coordinator_is_held() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way_without_statements(seed).await;
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

/// So does a closure keep it out.
#[test]
fn a_robot_that_reaches_no_voter_but_the_coordinator_heeds_a_closure() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way_without_statements(seed).await;
        request(&fleet, ApiCall::Close, &json!({ "places": [GATE], "by": "Nia" })).await;
        let has_entered = |fleet: &Fleet| fleet.position("gorse").1 > GATE_Y_M - 0.3;
        fleet.assert_never("an entry", LONG, has_entered).await;
        request(&fleet, ApiCall::Open, &json!({ "places": [GATE], "by": "Nia" })).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
    });
}
