//! Fleets whose nodes have certificates and sign their messages, and the effect of an attacker with
//! the key of a robot.

use crate::support::{audited_changes, released, request, task_began};
use bytes::Bytes;
use consort_bus::Bus as _;
use consort_bus::{Delivery, Encoding, ServiceSelection, SharedBus};
use consort_fleet::robot_driver::{PersonCommand, PersonEvent, PersonRequestState};
use consort_gossip::packet_about;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::keys::{ApiCall, DriverCall, Key, Keys, PeopleCall};
use consort_protocol::knowledge::{Availability, Digest, DigestScope, KnowledgeBase, Record, RecordStamp};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{
    AlarmNotice, AwardNotice, Beacon, ClusterEnvelope, Exchange, OrderNotice, OrdersNotice, RecordUpdate, ReportReply,
    SignalHistory,
};
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, StolenKey, for_each_seed, report_of_all_steps, signals_sent, slug};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub(crate) const SEEDS: [u64; 3] = [51, 52, 53];
pub(crate) const ROOM: &str = "IC Room 6";
pub(crate) const SOON: Duration = Duration::from_secs(60);

/// `fern` is far away and `gorse` near, so that `gorse` carries. Tests with an attacker do not
/// start the node of `fern`.
pub(crate) async fn closed(seed: u64, fern: RobotSpec) -> Fleet {
    let robots = vec![fern, RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::closed_hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the first coordinator");
    fleet
}

/// Returns the buses of an attacker with the key of a node that the test does not start.
pub(crate) async fn stolen(fleet: &Fleet, name: &str, role: NodeRole) -> StolenKey {
    StolenKey::of(fleet, name, Some(role), 0).await.expect("a closed fleet")
}

/// Returns the messages that nodes rejected.
fn refused(fleet: &Fleet) -> BTreeSet<String> {
    fleet.signing_buses.values().flat_map(|bus| bus.rejections()).collect()
}

#[test]
fn a_closed_fleet_completes_a_mission_after_a_takeover() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet
            .wait_until("the first task", SOON, |fleet| {
                fleet.has_event(|what| matches!(what, EventKind::TaskBegan { .. }))
            })
            .await;
        fleet.kill("aster").await;
        fleet.wait_for_coordinator().await;
        fleet.start_station("aster").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(refused(&fleet), BTreeSet::new(), "seed {seed}: friends are taken for foes");
    });
}

pub(crate) fn wire<T: Serialize>(message: &T) -> Bytes {
    codec::encode(message).expect("a message").into()
}

fn within<T: Serialize>(message: &T) -> Bytes {
    wire(&ClusterEnvelope { cluster: None, payload: wire(message).to_vec() })
}

/// Attacker with the key of a robot, at the robot's place in the network.
struct Compromised {
    /// The signing bus of a node, and the plain bus below it.
    sealed: SharedBus,
    plain: SharedBus,
    keys: Keys,
    /// Number of replayed, redirected, forged, answered and refused messages.
    did: [AtomicU64; 5],
}

impl Compromised {
    async fn publish(&self, bus: &SharedBus, key: &str, payload: Bytes, beside: Bytes) {
        bus.publish_with_attachment(key, payload, beside, Encoding::Wire, Delivery::Block).await.expect("a network");
    }

    /// Replays every received message, on the same key and on the keys of other nodes.
    async fn repeats(self: Arc<Self>) {
        let mut samples = self.plain.subscribe("consort/ward/**").await.expect("a network");
        let mut replayed: BTreeSet<Bytes> = BTreeSet::new();
        while let Some(sample) = samples.recv().await {
            let what: Bytes = [sample.key.as_bytes(), &sample.payload[..], &sample.attachment[..]].concat().into();
            if !replayed.insert(what) {
                continue;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
            self.publish(&self.plain, &sample.key, sample.payload.clone(), sample.attachment.clone()).await;
            self.did[0].fetch_add(1, Ordering::Relaxed);
            let moved = ["gorse", "lab-arm", "aster", "basil"].windows(2).find_map(|pair| {
                let moved = sample.key.replace(pair[0], pair[1]);
                (moved != sample.key).then_some(moved)
            });
            if let Some(moved) = moved {
                replayed.insert([moved.as_bytes(), &sample.payload[..], &sample.attachment[..]].concat().into());
                self.publish(&self.plain, &moved, sample.payload, sample.attachment).await;
                self.did[1].fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Publishes messages of other nodes, signed with its own key.
    async fn claims(self: Arc<Self>) {
        let node = |name: &str| NodeId::new(name).expect("a name");
        let still = RecordUpdate::Refresh {
            stamp: RecordStamp { incarnation: u64::MAX, version: u64::MAX },
            since: 1,
            proof: None,
        };
        let still = Bytes::from(codec::encode_for_version(2, still).expect("a message"));
        for round in 0.. {
            let term = 1_000_000 + round;
            for name in ["fern", "basil"] {
                let beacon = Beacon {
                    node: node(name),
                    term,
                    voters: [node("fern")].into(),
                    since_ms: 0,
                    cluster: None,
                    wire: Some(200),
                };
                let event =
                    format!(r#"{{"node": "{name}", "sequence": 1, "at_ms": 1, "event": "elected", "term": {term}}}"#);
                let body = Key::Driver("gorse".parse().expect("a name"), DriverCall::State);
                for (key, payload) in [
                    (Key::Beacon, within(&beacon)),
                    (Key::Knowledge(node("gorse")), still.clone()),
                    (Key::Events(node("basil")), event.into()),
                    (body, Bytes::from_static(b"anywhere")),
                ] {
                    self.publish(&self.sealed, &self.keys.write(&key), payload, Bytes::new()).await;
                    self.did[2].fetch_add(1, Ordering::Relaxed);
                }
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }

    /// Refuses the queries of other nodes at once, signed and unsigned.
    async fn refuses(self: Arc<Self>, key: &'static str, bare: bool) {
        let bus = if bare { &self.plain } else { &self.sealed };
        let mut queries = bus.serve(&format!("consort/ward/{key}")).await.expect("a network");
        while let Some(query) = queries.recv().await {
            let _ = query.replier.refuse("no").await;
            self.did[4].fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Answers queries for other nodes by returning the query, signed and unsigned, and repeats the
    /// query to its target.
    async fn answers(self: Arc<Self>, key: &'static str, bare: bool) {
        let bus = if bare { &self.plain } else { &self.sealed };
        let mut queries = bus.serve(&format!("consort/ward/{key}")).await.expect("a network");
        let mut again: BTreeSet<Bytes> = BTreeSet::new();
        while let Some(query) = queries.recv().await {
            let on = query.key.replace('*', "gorse");
            let _ = query.replier.reply(&on, query.payload.clone(), Encoding::Wire).await;
            self.did[3].fetch_add(1, Ordering::Relaxed);
            if bare && again.insert(query.payload.clone()) {
                drop(self.plain.query(&on, query.payload, Duration::from_secs(1)).await);
            }
        }
    }
}

#[test]
fn the_key_of_a_robot_gives_no_power_over_other_nodes() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing: sealed, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let fern = Arc::new(Compromised { sealed, plain, keys: fleet.keys().clone(), did: Default::default() });
        let mut tasks = tokio::task::JoinSet::new();
        tasks.spawn(Arc::clone(&fern).repeats());
        tasks.spawn(Arc::clone(&fern).claims());
        for key in ["wire/bid/*", "wire/award/*", "wire/report/*", "wire/raft/*/*", "wire/driver/*/command"] {
            tasks.spawn(Arc::clone(&fern).answers(key, false));
            tasks.spawn(Arc::clone(&fern).answers(key, true));
            tasks.spawn(Arc::clone(&fern).refuses(key, false));
            tasks.spawn(Arc::clone(&fern).refuses(key, true));
        }
        let elected = |what: &EventKind| matches!(what, EventKind::Elected { .. });
        let before = fleet.event_log.count(elected);
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(
            fleet.holder(&mission, "r1").map(|robot| robot.to_string()),
            Some("gorse".to_owned()),
            "seed {seed}"
        );
        assert_eq!(
            fleet.event_log.count(elected),
            before,
            "seed {seed}: the coordinator is unchanged\n{}",
            fleet.event_log_text()
        );
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}");
        let did = fern.did.each_ref().map(|count| count.load(Ordering::Relaxed));
        assert!(
            did.iter().all(|count| *count > 10),
            "seed {seed}: repeated, moved, claimed, answered, refused: {did:?}"
        );
        let refusals = refused(&fleet);
        for reason in [
            "node fern (robot) may not publish on wire/beacon",
            "node fern (robot) may not publish on wire/knowledge/gorse",
            "node fern (robot) may not publish on wire/driver/gorse/state",
            "node fern (robot) may not reply on wire/report/aster",
            "node fern (robot) may not reply on wire/driver/gorse/command",
        ] {
            assert!(refusals.contains(reason), "seed {seed}: {reason}: {refusals:#?}");
        }
        let raft = refusals.iter().any(|refusal| refusal.starts_with("node fern (robot) may not reply on wire/raft/"));
        assert!(raft, "seed {seed}: {refusals:#?}");
        tasks.shutdown().await;
    });
}

/// Returns the replies to a request, as text.
pub(crate) async fn replies(bus: &SharedBus, key: &str, payload: Bytes, attachment: Bytes) -> Vec<String> {
    let asked = bus.query_with(key, payload, attachment, Duration::from_secs(3), ServiceSelection::All).await;
    let (mut replies, mut all) = (asked.expect("a network"), vec![]);
    while let Some(reply) = replies.recv().await {
        all.push(
            reply.payload.map_or_else(|refusal| refusal.to_string(), |text| String::from_utf8_lossy(&text).into()),
        );
    }
    all
}

/// Returns a request for a schedule with no occurrence during a test.
fn yearly(schedule: &str) -> Value {
    let submit = json!({ "mission": "lab-samples", "parameters": { "room": ROOM } });
    json!({ "schedule": schedule, "action": "add", "cron": "0 12 1 6 *", "submit": submit })
}

#[test]
fn the_key_of_a_robot_changes_neither_missions_nor_nodes() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let sealed: SharedBus = signing;
        // The robot relays a person's requests, and keeps them.
        let mut relayed = plain.serve("consort/ward/api/*").await.expect("a network");
        let mission = fleet.submit("a", ROOM).await;
        let signed = relayed.recv().await.expect("a request");
        assert!(!signed.attachment.is_empty(), "seed {seed}");

        let keys = fleet.keys().clone();
        let order = json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "stolen" });
        let cancel = json!({ "mission": mission, "by": "fern" });
        let attacks = [
            (keys.write(&Key::Api(ApiCall::Submit)), order),
            (keys.write(&Key::Api(ApiCall::Cancel)), cancel.clone()),
            (keys.write(&Key::Api(ApiCall::CancelMissions)), json!({ "missions": [mission] })),
            (keys.write(&Key::Api(ApiCall::CancelMissions)), json!({ "missions": { "where": "true" } })),
            (keys.write(&Key::Api(ApiCall::Priority)), json!({ "mission": mission, "priority": 1 })),
            (keys.write(&Key::Api(ApiCall::Reassign)), json!({ "mission": mission, "role": "r1" })),
            (keys.write(&Key::Api(ApiCall::Resolve)), cancel),
            (keys.write(&Key::Api(ApiCall::Answer)), json!({ "request": format!("{mission}.1"), "answer": "done" })),
            (keys.write(&Key::Api(ApiCall::Schedule)), yearly("stolen")),
            (keys.write(&Key::Api(ApiCall::Hold)), json!({ "robots": "all" })),
            (keys.write(&Key::Api(ApiCall::Release)), json!({ "robots": "all" })),
            (
                keys.write(&Key::Api(ApiCall::Maintenance)),
                json!({ "robots": "all", "action": "begin", "reason": "stolen" }),
            ),
            (keys.write(&Key::Api(ApiCall::Close)), json!({ "places": ["Dock"], "reason": "stolen" })),
            (keys.write(&Key::Api(ApiCall::Open)), json!({ "places": ["Dock"] })),
            (keys.write(&Key::Api(ApiCall::Limit)), json!({ "places": ["Dock"], "action": "set", "speed_mps": 0.1 })),
            (keys.write(&Key::Api(ApiCall::Limit)), json!({ "places": ["Dock"], "action": "clear" })),
            (keys.write(&Key::Api(ApiCall::Alarm)), json!({ "action": "raise", "alarm": "freeze" })),
            (keys.write(&Key::Api(ApiCall::Alarm)), json!({ "action": "clear" })),
            (keys.write(&Key::Api(ApiCall::Backup)), json!({})),
            (keys.write(&Key::Api(ApiCall::Upgrade)), json!({ "finish": true })),
            (keys.write(&Key::Leave("clove".parse().expect("a name"))), json!({})),
            ("consort/ward/api/leave/*".to_owned(), json!({})),
            ("consort/ward/api/**".to_owned(), json!({})),
            (signed.key.clone(), json!({ "mission": "lab-samples", "parameters": { "room": ROOM }, "request": "b" })),
        ];
        for (key, payload) in &attacks {
            let payload = Bytes::from(payload.to_string());
            for (bus, attachment) in
                [(&sealed, Bytes::new()), (&plain, Bytes::new()), (&plain, signed.attachment.clone())]
            {
                for reply in replies(bus, key, payload.clone(), attachment).await {
                    let only_refused = reply.contains("\"error\"") || key.ends_with("**");
                    assert!(only_refused, "seed {seed}: {key} was answered with {reply}");
                }
            }
        }
        let again = replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await;
        assert_eq!(again, [] as [String; 0], "seed {seed}: a repeated request is not answered");
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        let submitted = fleet.event_log.count(|what| matches!(what, EventKind::Submitted { .. }));
        assert_eq!(submitted, 1, "seed {seed}\n{}", fleet.event_log_text());
        let left = fleet.event_log.count(|what| matches!(what, EventKind::Left { .. }));
        assert_eq!(left, 0, "seed {seed}: a node left\n{}", fleet.event_log_text());
    });
}

/// The next coordinator has not seen the request before, but the ledger has.
#[test]
fn a_copy_of_a_cancelation_cancels_nothing_at_the_next_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let StolenKey { signing: _signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let mission = fleet.submit("a", ROOM).await;
        let mut relayed = plain.serve("consort/ward/api/cancel_missions").await.expect("a network");
        let cancel = json!({ "missions": { "where": "true" }, "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::CancelMissions, &cancel).await;
        let by_signer = json!({ "canceled": { "by": "Nia, according to client" } });
        assert_eq!(reply["missions"], json!({ mission.as_str(): by_signer }), "seed {seed}: {reply}");
        let signed = relayed.recv().await.expect("a request");
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        let later = fleet.submit("b", ROOM).await;
        for reply in replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await {
            assert!(!reply.contains("canceled"), "seed {seed}: {reply}");
        }
        fleet.assert_completes(&later).await;
    });
}

/// The ledger keeps no ids of changes of schedules: a coordinator executes only those that were signed
/// after its session began.
#[test]
fn a_copy_of_a_pause_pauses_nothing_at_the_next_coordinator() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let StolenKey { signing: _signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let change = |action: &str| json!({ "schedule": "rounds", "action": action, "by": "Nia" });
        request(&fleet, ApiCall::Schedule, &yearly("rounds")).await;
        let mut relayed = plain.serve("consort/ward/api/schedule").await.expect("a network");
        // A node that has received the request would drop a copy of it.
        for other in ["basil", "clove", "gorse", "lab-arm"] {
            fleet.network.block_queries(slug(other), "consort/ward/api/schedule");
        }
        request(&fleet, ApiCall::Schedule, &change("pause")).await;
        fleet.network.heal();
        let signed = relayed.recv().await.expect("a request");
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        // The person resumes it with a request that is signed after the takeover.
        request(&fleet, ApiCall::Schedule, &change("resume")).await;
        let copied = replies(&plain, &signed.key, signed.payload.clone(), signed.attachment.clone()).await;
        let is_paused = |ledger: &Ledger| ledger.schedule(&slug("rounds")).map(|entry| entry.pause.is_some());
        assert_eq!(fleet.ledger(is_paused).flatten(), Some(false), "seed {seed}: {copied:?}");
        let is_put_off = |reply: &String| reply.contains("signed before") && reply.contains("retry_after_ms");
        assert!(copied.iter().any(is_put_off), "seed {seed}: {copied:?}");
    });
}

#[test]
fn a_signed_alarm_names_the_signer_and_the_key_of_a_robot_does_not_clear_it() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        let start = fleet.position("gorse");
        fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
        let raise = json!({ "action": "raise", "alarm": "freeze", "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Alarm, &raise).await;
        assert_eq!(reply["alarms"][0]["order"]["by"], "Nia, according to client", "seed {seed}: {reply}");
        fleet.wait_for_rest("gorse").await;
        let place = fleet.position("gorse");
        let StolenKey { signing, plain } = stolen(&fleet, "fern", NodeRole::Robot).await;
        let sealed: SharedBus = signing;
        let key = fleet.keys().write(&Key::Api(ApiCall::Alarm));
        let clear = json!({ "action": "clear" });
        for bus in [&sealed, &plain] {
            for reply in replies(bus, &key, Bytes::from(clear.to_string()), Bytes::new()).await {
                assert!(reply.contains("\"error\""), "seed {seed}: {reply}");
            }
        }
        fleet.assert_never("a move", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        assert_eq!(fleet.ledger(|ledger| ledger.alarms().count()), Some(1), "seed {seed}");
        fleet.request_answered(ApiCall::Alarm, &clear).await;
        fleet.assert_completes(&mission).await;
    });
}

#[test]
fn a_signed_hold_stops_a_robot_and_names_the_signer() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        fleet.wait_for_audit_trail().await;
        let mission = fleet.submit("a", ROOM).await;
        let start = fleet.position("gorse");
        fleet.wait_until("a move", SOON, |fleet| fleet.position("gorse") != start).await;
        let payload = json!({ "robots": ["gorse"], "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Hold, &payload).await;
        assert_eq!(reply["robots"]["gorse"]["hold"]["by"], "Nia, according to client", "seed {seed}: {reply}");
        fleet.wait_for_rest("gorse").await;
        let place = fleet.position("gorse");
        fleet.assert_never("a move", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        fleet.request_answered(ApiCall::Release, &payload).await;
        fleet.assert_completes(&mission).await;
        let (signer, mission) = ("Nia, according to client", mission.as_str());
        let expected = json!([["client", "submit", mission], [signer, "hold", "gorse"], [signer, "release", "gorse"]]);
        assert_eq!(json!(audited_changes(&fleet).await), expected, "seed {seed}");
        assert_eq!(refused(&fleet), BTreeSet::new(), "seed {seed}: friends are taken for foes");
    });
}

/// A client that repeats a request, for lack of a reply, signs it again.
#[test]
fn a_hold_that_is_signed_twice_is_executed_once() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock")).await;
        fleet.wait_for_audit_trail().await;
        let is_known = |fleet: &Fleet| fleet.knowledge_of("aster", &slug("gorse")).is_some();
        fleet.wait_until("the record of the robot", SOON, is_known).await;
        let hold = json!({ "robots": ["gorse"], "by": "Nia", "request": "order-7" });
        let first = request(&fleet, ApiCall::Hold, &hold).await;
        let from = fleet.elapsed();
        let is_later = |fleet: &Fleet| fleet.elapsed() >= from + Duration::from_secs(2);
        fleet.wait_until("another time of the request", SOON, is_later).await;
        assert_eq!(request(&fleet, ApiCall::Hold, &hold).await, first, "seed {seed}: its end is the same");
        let expected = json!([["Nia, according to client", "hold", "gorse"]]);
        assert_eq!(json!(audited_changes(&fleet).await), expected, "seed {seed}");
    });
}

/// Returns the record of a robot in the knowledge base of a node.
fn known_record(fleet: &Fleet, at: &str, of: &str) -> Option<Record> {
    let entry = |base: &KnowledgeBase| base.get(&of.parse().expect("a name")).map(|entry| entry.record.clone());
    fleet.knowledge(at).read(entry)
}

fn record(fleet: &Fleet, at: &str, of: &str) -> Record {
    known_record(fleet, at, of).expect("it is known")
}

#[test]
fn a_relaying_node_can_neither_change_nor_forge_records() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let sealed = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let signed = |record: Option<Record>| {
            record.is_some_and(|record| record.proof.is_some() && record.knowledge.cluster.is_some())
        };
        fleet
            .wait_until("records are signed", SOON, |fleet| {
                ["lab-arm", "gorse"].iter().all(|of| signed(known_record(fleet, "gorse", of)))
            })
            .await;

        let original = record(&fleet, "gorse", "lab-arm");
        let later = RecordStamp { incarnation: u64::MAX, version: 7 };
        let mut broken = original.clone();
        broken.stamp = later;
        broken.knowledge.robot.as_mut().expect("a robot").availability =
            Availability::OutOfService { problem: "says fern".to_owned() };
        let by_fern = Record { proof: Some(sealed.record_signer().sign(&broken)), ..broken.clone() };
        let renewed = Record { stamp: later, ..original.clone() };
        let unsigned = Record { proof: None, ..broken.clone() };
        let malformed = |fleet: &Fleet| fleet.knowledge("gorse").counters().malformed;
        let before = malformed(&fleet);
        let key = fleet.keys().write(&Key::Gossip("gorse".parse().expect("a name")));
        let hand_over = async |digest: Digest, records: Vec<Record>| {
            let exchange = Exchange { sums: vec![], scope: DigestScope::ALL, digest, records };
            let bytes = codec::encode_for_version(2, exchange).expect("a message");
            let mut answers = sealed.query(&key, bytes.into(), Duration::from_secs(1)).await.expect("a network");
            answers.recv().await.is_some_and(|answer| answer.payload.is_ok())
        };
        // A node whose certificate is not known yet must repeat the query.
        while !hand_over(Digest::new(), vec![]).await {}
        for record in [broken, by_fern, renewed, unsigned] {
            assert!(hand_over(Digest::new(), vec![record]).await, "seed {seed}: the rest of it is answered");
        }
        // And that gorse itself has published a version that cannot be exceeded.
        let own = Digest::from([("gorse".parse().expect("a name"), later)]);
        assert!(!hand_over(own, vec![]).await, "seed {seed}: what cannot be is not answered");
        fleet.wait_until("gorse has counted them", SOON, |fleet| malformed(fleet) == before + 4).await;
        for of in ["lab-arm", "gorse"] {
            let known = record(&fleet, "gorse", of);
            assert!(known.stamp.incarnation < 100, "seed {seed}: {known:?}");
        }
        assert_eq!(record(&fleet, "gorse", "lab-arm").knowledge, original.knowledge, "seed {seed}");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
    });
}

/// A robot's key declares no other node down or restarted: neither in the name of that node, nor as its own
/// verdict.
#[test]
fn the_key_of_a_robot_declares_no_other_node_down() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let sealed = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let nodes = ["aster", "basil", "clove", "gorse", "lab-arm"];
        let all_know = |fleet: &Fleet| {
            let knows = |at: &str| nodes.iter().all(|of| known_record(fleet, at, of).is_some());
            nodes.iter().all(|at| knows(at))
        };
        fleet.wait_until("all nodes know each other", SOON, all_know).await;
        let identity = |of: &str| -> (NodeId, u64) { (slug(of), record(&fleet, "aster", of).stamp.incarnation) };
        // With the time since when: it changes with every verdict and every suspicion.
        let statuses = |fleet: &Fleet| nodes.map(|at| nodes.map(|of| fleet.knowledge(at).status(&slug(of))));
        let before = statuses(&fleet);
        for _ in 0..20 {
            for to in nodes {
                let key = fleet.keys().write(&Key::Swim(slug(to)));
                for about in nodes.into_iter().filter(|about| *about != to) {
                    let (now, later) = (identity(about), (slug(about), identity(about).1 + 1));
                    for from in [now.clone(), (slug("fern"), 1_000)] {
                        for (about, is_alive) in [(now.clone(), false), (later.clone(), true)] {
                            let packet = packet_about(from.clone(), about, is_alive, identity(to));
                            let sent = sealed.publish(&key, packet, Encoding::Wire, Delivery::Drop).await;
                            sent.expect("its key permits packets");
                        }
                    }
                }
            }
            tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
        }
        assert_eq!(statuses(&fleet), before, "seed {seed}\n{}", fleet.event_log_text());
        let malformed = nodes.map(|node| fleet.knowledge(node).counters().malformed);
        assert!(malformed.iter().all(|count| *count > 0), "seed {seed}: {malformed:?}");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
    });
}

/// A node that was out of reach is a member again when it returns, whatever incarnation a robot's key has
/// stated in its name meanwhile.
#[test]
fn the_key_of_a_robot_keeps_no_other_node_out() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let sealed = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let others = ["aster", "basil", "gorse", "lab-arm"];
        let all_hold =
            |fleet: &Fleet, is_alive| others.iter().all(|at| fleet.knowledge(at).is_alive(&slug("clove")) == is_alive);
        fleet.wait_until("clove is a member", SOON, |fleet| all_hold(fleet, true)).await;
        let identity = |of: &str| -> (NodeId, u64) { (slug(of), record(&fleet, "aster", of).stamp.incarnation) };
        let (clove, identities) = (identity("clove"), others.map(identity));
        fleet.network.isolate(slug("clove"));
        fleet.wait_until("clove is down", SOON, |fleet| all_hold(fleet, false)).await;
        for ahead in [1, 1_000, u64::MAX / 2] {
            for to in &identities {
                let (key, about) = (fleet.keys().write(&Key::Swim(to.0.clone())), (clove.0.clone(), clove.1 + ahead));
                let packet = packet_about((slug("fern"), 1_000), about, true, to.clone());
                let sent = sealed.publish(&key, packet, Encoding::Wire, Delivery::Drop).await;
                sent.expect("its key permits packets");
            }
        }
        let is_believed = |fleet: &Fleet| !all_hold(fleet, false);
        fleet.assert_never("belief in a claim", Duration::from_millis(500), is_believed).await;
        fleet.network.heal();
        fleet.wait_until("clove is a member again", SOON, |fleet| all_hold(fleet, true)).await;
    });
}

/// Attacks the roles of other robots and people in a mission: ends their steps and sends their
/// signals, under their award and under later ones. Returns the number of accepted reports.
async fn take_part_in(fleet: &Fleet, bus: &SharedBus, mission: &MissionId) -> usize {
    let (keys, mut accepted) = (fleet.keys(), 0);
    let Some(entry) = fleet.ledger(|ledger| ledger.mission(mission).cloned()).flatten() else { return accepted };
    for role in entry.roles.keys() {
        let Some(plan) = entry.plan(role) else { continue };
        let report = report_of_all_steps("fern".parse().expect("a name"), &entry, role).expect("it has a plan");
        for to in ["aster", "basil", "clove"] {
            let key = keys.write(&Key::Report(to.parse().expect("a name")));
            let mut replies = bus.query(&key, wire(&report), Duration::from_millis(100)).await.expect("a network");
            while let Some(reply) = replies.recv().await {
                let reply = reply.payload.ok().and_then(|bytes| codec::decode::<ReportReply>(&bytes).ok());
                accepted += usize::from(matches!(reply, Some(ReportReply::Renewed { .. })));
            }
        }
        let award = report.epoch;
        for signal in signals_sent(plan) {
            for epoch in [award, Epoch { index: award.index + 1, ..award }, Epoch { term: u64::MAX, index: u64::MAX }] {
                let to = keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
                let history = SignalHistory { mission: mission.clone(), epoch, signals: [signal.clone()].into() };
                bus.publish(&to, wire(&history), Encoding::Wire, Delivery::Block).await.expect("a network");
            }
        }
    }
    accepted
}

#[test]
fn the_key_of_a_robot_takes_no_part_in_missions_of_others() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let mission = fleet.submit("a", ROOM).await;
        let bus = stolen(&fleet, "fern", NodeRole::Robot).await.in_cluster(&fleet);
        let is_final = |ledger: &Ledger| ledger.mission(&mission).is_some_and(|entry| entry.state.is_final());
        while !fleet.ledger(is_final).unwrap_or(false) {
            let accepted = take_part_in(&fleet, &bus, &mission).await;
            assert_eq!(accepted, 0, "seed {seed}: a report for a role of others was accepted");
            let asked = fleet.ledger(|ledger| {
                ledger.missions().flat_map(|entry| entry.open_questions()).map(|(_, asked)| asked.number).max()
            });
            assert_eq!(asked.flatten(), None, "seed {seed}: a question in the name of the holder was asked");
            tokio::time::sleep(Duration::from_millis(500)).await; // virtual time
        }
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        // Signals under older awards are reported; those of the holder are not among them.
        let stale = |what: &EventKind| matches!(what, EventKind::StaleSignal { epoch, .. } if epoch.term > 0);
        assert_eq!(fleet.event_log.count(stale), 0, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
    });
}

#[test]
fn the_key_of_a_voter_pins_no_node_to_a_term_or_a_version() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let name: NodeId = "dill".parse().expect("a name");
        let sealed = stolen(&fleet, "dill", NodeRole::Voter).await.signing;
        let cluster = fleet.ledger(|ledger| ledger.cluster()).flatten();
        let mission = fleet.submit("a", ROOM).await;
        let key = fleet.keys().write(&Key::Beacon);
        let mut attack = tokio::task::JoinSet::new();
        attack.spawn(async move {
            for term in (0..u64::MAX).rev() {
                let beacon = Beacon {
                    node: name.clone(),
                    term,
                    voters: [name.clone()].into(),
                    since_ms: 0,
                    cluster,
                    wire: Some(200),
                };
                let payload = wire(&ClusterEnvelope { cluster, payload: wire(&beacon).to_vec() });
                sealed.publish(&key, payload, Encoding::Wire, Delivery::Block).await.expect("a network");
                tokio::time::sleep(Duration::from_millis(300)).await; // virtual time
            }
        });
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        attack.shutdown().await;
    });
}

/// Its key permits replies to and refusals of every request of consensus.
#[test]
fn the_key_of_a_voter_replies_to_no_request_of_consensus_for_another() {
    for_each_seed([51, 52], async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing: sealed, plain } = stolen(&fleet, "dill", NodeRole::Voter).await;
        let dill = Arc::new(Compromised { sealed, plain, keys: fleet.keys().clone(), did: Default::default() });
        let mut tasks = tokio::task::JoinSet::new();
        tasks.spawn(Arc::clone(&dill).refuses("wire/raft/*/*", false));
        tasks.spawn(Arc::clone(&dill).answers("wire/raft/*/*", false));
        let elected = |what: &EventKind| matches!(what, EventKind::Elected { .. });
        let before = fleet.event_log.count(elected);
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.event_log.count(elected), before, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}");
        let did = dill.did.each_ref().map(|count| count.load(Ordering::Relaxed));
        assert!(did[3] > 10 && did[4] > 10, "seed {seed}: replies, refusals: {did:?}");
        tasks.shutdown().await;
    });
}

#[test]
fn the_key_of_a_voter_that_does_not_lead_holds_no_robot() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let mission = fleet.submit("a", ROOM).await;
        let bus = stolen(&fleet, "dill", NodeRole::Voter).await.in_cluster(&fleet);
        let hold = Some(OrderNotice { text: "held by dill".to_owned(), remaining_ms: None });
        let alarm = hold.clone().map(|order| AlarmNotice { order, places: BTreeSet::new(), closes: BTreeSet::new() });
        let orders = OrdersNotice { as_of: Epoch { term: u64::MAX, index: 1 }, hold, alarm, ..OrdersNotice::default() };
        let payload = wire(&AwardNotice::Orders(Box::new(orders)));
        for robot in ["gorse", "lab-arm"] {
            let key = fleet.keys().write(&Key::Award(robot.parse().expect("a name")));
            // A node without a record knows no certificates, so it cannot verify the refusal.
            let verified = replies(&bus, &key, payload.clone(), Bytes::new()).await;
            assert_eq!(verified, [] as [String; 0], "seed {seed}");
        }
        // A held robot would keep its role and wait for ever.
        fleet.assert_completes(&mission).await;
    });
}

/// Answers each request to a person: it is done. Counts the requests.
async fn answer_for_people(bus: SharedBus, keys: Keys, answered: Arc<AtomicU64>) {
    let ended_key = keys.write(&Key::People(PeopleCall::Done));
    let mut queries = bus.serve(&keys.write(&Key::People(PeopleCall::Ask))).await.expect("a network");
    while let Some(query) = queries.recv().await {
        let command: PersonCommand = codec::decode(&query.payload).expect("a command of the coordinator");
        let reply = wire(&PersonRequestState::Ended(Ok(BTreeMap::new())));
        let _ = query.replier.reply(&query.key, reply, Encoding::Wire).await;
        let ended = wire(&PersonEvent::RequestEnded { id: command.id, result: Ok(BTreeMap::new()) });
        bus.publish(&ended_key, ended, Encoding::Wire, Delivery::Block).await.expect("a network");
        answered.fetch_add(1, Ordering::Relaxed);
    }
}

/// Cancels the mission of `gorse` in the name of a nurse.
async fn cancel_for_people(bus: SharedBus, keys: Keys) {
    let key = keys.write(&Key::People(PeopleCall::Done));
    for at_ms in 0.. {
        let (by, role, robot) = ("Nia".to_owned(), slug("nurse"), slug("gorse"));
        let cancel = wire(&PersonEvent::CancelMission { by, role, robot, at_ms });
        bus.publish(&key, cancel, Encoding::Wire, Delivery::Block).await.expect("a network");
        tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
    }
}

/// The nurse does not receive the request, so only the false driver servers answer it.
#[test]
fn a_driver_server_answers_only_for_its_people() {
    for_each_seed([51, 52], async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let keys = fleet.keys().clone();
        fleet.network.block_queries(slug("world"), &keys.write(&Key::People(PeopleCall::Ask)));
        let (answered, mut attack) = (Arc::<AtomicU64>::default(), tokio::task::JoinSet::new());
        let other: SharedBus = stolen(&fleet, "mallory", NodeRole::Host).await.signing;
        attack.spawn(answer_for_people(Arc::clone(&other), keys.clone(), Arc::clone(&answered)));
        attack.spawn(cancel_for_people(other, keys.clone()));
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("a request to the nurse", SOON, |fleet| fleet.has_event(task_began("deposit"))).await;
        let deposited =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "deposit");
        let is_over = |fleet: &Fleet| fleet.mission_state(&mission).is_some_and(|state| state.is_final());
        let is_believed = |fleet: &Fleet| fleet.has_event(deposited) || is_over(fleet);
        fleet.assert_never("the end of the request or the mission", Duration::from_secs(5), is_believed).await;
        let count = answered.load(Ordering::Relaxed);
        assert!(count > 2, "seed {seed}: {count} answers by mallory");
        // With a certificate that names the role `nurse`, the same messages count.
        let own: SharedBus = stolen(&fleet, "nurse", NodeRole::Host).await.signing;
        attack.spawn(answer_for_people(Arc::clone(&own), keys.clone(), Arc::default()));
        fleet.wait_until("the answer", SOON, |fleet| fleet.has_event(deposited)).await;
        attack.spawn(cancel_for_people(own, keys));
        let end = format!("{:?}", fleet.wait_for_end(&mission).await);
        assert!(end.contains("Nia, according to nurse"), "seed {seed}: {end}");
        attack.shutdown().await;
    });
}
