//! A hostile node: it has one valid certificate of the fleet, and attacks the other nodes.
//!
//! It replays and moves messages that it has received, publishes and queries in the name of others,
//! lies about epochs, terms and versions, refuses and answers queries of others (or refuses all of
//! them), makes requests with its own and with captured signatures, sends texts of great length (as a
//! robot, in its refusals to bid), and floods. In a fleet with the settings of a large one it also states the motion of other
//! robots. Signed messages are attempted with its own key, and without one.
//!
//! Well-formed forgeries of every kind, and its bids, are in [`forgeries`].

mod forgeries;

use self::forgeries::{Sources, answer_clock_readings};
use super::generate::is_large;
use crate::{Fleet, StolenKey, report_of_all_steps, signals_sent, slug};
use bytes::Bytes;
use consort_bus::{BusError, Delivery, Encoding, Query, Sample, ServiceSelection, SharedBus, Stream};
use consort_fleet::robot_driver::PersonRequestState;
use consort_gossip::{SharedKnowledge, packet_about};
use consort_protocol::auction::{BidRefusal, BidResponse, CallForBids, RefusalReason, RoleReply};
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId};
use consort_protocol::keys::{ApiCall, DriverCall, Key, Keys};
use consort_protocol::knowledge::{Motion, MotionUpdate, RobotKnowledge};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Ledger, MissionEntry};
use consort_protocol::message::{Beacon, ClusterEnvelope, SignalHistory};
use consort_protocol::trust::NodeRole;
use consort_raft::Replica;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::task::JoinSet;

/// Name of the hostile node. The ids of its requests begin with it.
pub(super) const HOSTILE: &str = "mallory";

/// Number of captured messages that it keeps.
const CAPTURED_MAX: usize = 256;

/// Number of publications in a flood.
const FLOOD: usize = 300;

/// Length of an oversized text, in bytes. Messages between nodes have at most 64 KiB.
const LONG_TEXT: usize = 100_000;

/// Length of all reasons in a message of refusals, in bytes.
const LONG_REASON: usize = 60_000;

/// Keys of queries that it answers and refuses.
const ATTACKED_QUERIES: [&str; 10] = [
    "wire/bid/*",
    "wire/award/*",
    "wire/report/*",
    "wire/leader/*",
    "wire/people/ask",
    "wire/signal_history/*/*",
    "wire/raft/*/*",
    "wire/bootstrap/*",
    "wire/driver/*/command",
    "wire/certificate/**",
];

/// A hostile node in action, until it is dropped.
pub(super) struct HostileNode {
    _attacks: JoinSet<()>,
}

/// State shared by the attacks.
struct Attacker {
    /// Bus that signs with its key.
    signing: SharedBus,
    /// Signing bus with the envelopes of the fleet's cluster.
    in_cluster: SharedBus,
    /// Bus without signatures.
    plain: SharedBus,
    keys: Keys,
    victims: Vec<NodeId>,
    cluster: Option<ClusterId>,
    /// Every query of others is refused at once.
    refuses_all: bool,
    captured: Mutex<VecDeque<Sample>>,
    /// Requests of people that it has relayed.
    requests: Mutex<VecDeque<(String, Bytes, Bytes)>>,
    chance: Mutex<ChaCha8Rng>,
}

impl HostileNode {
    /// Starts the attacks of a node with the certificate of this role, or of none.
    pub(super) async fn start(fleet: &Fleet, role: Option<NodeRole>, seed: u64, date_ms: u64) -> Option<HostileNode> {
        let key = StolenKey::of(fleet, HOSTILE, role, date_ms).await?;
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let signer = key.signing.record_signer();
        let attacker = Arc::new(Attacker {
            refuses_all: chance.random_bool(0.5),
            in_cluster: key.in_cluster(fleet),
            signing: key.signing,
            plain: key.plain,
            keys: fleet.keys().clone(),
            victims: fleet.nodes.keys().map(|node| slug(node)).collect(),
            cluster: fleet.ledger(|ledger| ledger.cluster()).flatten(),
            captured: Mutex::default(),
            requests: Mutex::default(),
            chance: Mutex::new(chance),
        });
        let mut attacks = JoinSet::new();
        attacks.spawn(Arc::clone(&attacker).capture());
        attacks.spawn(Arc::clone(&attacker).capture_requests());
        for key in ATTACKED_QUERIES {
            for bus in [&attacker.signing, &attacker.plain] {
                let queries = bus.serve(&below(&attacker.keys, key)).await.expect("a virtual bus");
                attacks.spawn(Arc::clone(&attacker).answer(queries));
            }
        }
        for bus in [&attacker.signing, &attacker.plain] {
            let readings = bus.serve(&below(&attacker.keys, "wire/clock/*")).await.expect("a virtual bus");
            attacks.spawn(answer_clock_readings(readings, seed));
        }
        let calls = attacker.in_cluster.serve(&attacker.keys.any_bid()).await.expect("a virtual bus");
        attacks.spawn(Arc::clone(&attacker).bid(calls, seed));
        let base = fleet.nodes.values().next().map(|node| node.knowledge.clone());
        attacks.spawn(Arc::clone(&attacker).lie_about_members(base.clone(), seed, date_ms));
        if is_large(fleet.seed) {
            attacks.spawn(Arc::clone(&attacker).forge_motion(base.clone(), seed));
        }
        let replicas: Vec<_> = fleet.nodes.values().filter_map(|node| node.replica.clone()).collect();
        let sources = Sources { replicas: replicas.clone(), known: base, world: fleet.world.clone(), signer };
        attacks.spawn(Arc::clone(&attacker).forge(sources, seed));
        attacks.spawn(attacker.attack(replicas));
        Some(HostileNode { _attacks: attacks })
    }
}

impl Attacker {
    fn draw<T>(&self, draw: impl FnOnce(&mut ChaCha8Rng) -> T) -> T {
        draw(&mut self.chance.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn victim(&self) -> NodeId {
        self.draw(|chance| self.victims.choose(chance).expect("a fleet has nodes").clone())
    }

    /// Keeps the latest publications of others.
    async fn capture(self: Arc<Self>) {
        let Ok(mut samples) = self.plain.subscribe(&self.below("**")).await else { return };
        while let Some(sample) = samples.recv().await {
            push_bounded(&self.captured, sample);
        }
    }

    /// Keeps the latest requests of people. They expect other nodes to answer, too.
    async fn capture_requests(self: Arc<Self>) {
        let Ok(mut queries) = self.plain.serve(&self.below("api/*")).await else { return };
        while let Some(Query { key, payload, attachment, .. }) = queries.recv().await {
            push_bounded(&self.requests, (key, payload, attachment));
        }
    }

    /// Answers the queries of other nodes for others: claims that people have done what was asked, refuses
    /// them, returns the query itself, returns a long text, or nothing.
    async fn answer(self: Arc<Self>, mut queries: Stream<Query>) {
        while let Some(query) = queries.recv().await {
            let key = query.key.replace('*', self.victim().as_str());
            // A failed attempt is no failure of the run.
            let _ = match self.draw(|chance| chance.random_range(0..6)) {
                _ if self.refuses_all => query.replier.refuse("no").await,
                // A person of others has done what was asked.
                _ if key.ends_with("wire/people/ask") => {
                    let done = wire(&PersonRequestState::Ended(Ok(BTreeMap::new())));
                    query.replier.reply(&key, done, Encoding::Wire).await
                }
                0 => query.replier.refuse("no").await,
                1 => query.replier.refuse(&"no ".repeat(LONG_TEXT / 3)).await,
                2 => query.replier.reply(&key, query.payload.clone(), Encoding::Wire).await,
                3 => query.replier.reply(&key, vec![0x7f; LONG_TEXT].into(), Encoding::Wire).await,
                4 => self.refuse_at_length(&query).await,
                _ => Ok(()),
            };
        }
    }

    /// Replies to a call for bids as a robot of its own name, with a long reason for each role.
    async fn refuse_at_length(&self, query: &Query) -> Result<(), BusError> {
        let call = codec::decode(&query.payload).and_then(|ClusterEnvelope { payload, .. }| codec::decode(&payload));
        let Ok::<CallForBids, _>(CallForBids { auction, roles, .. }) = call else { return Ok(()) };
        let robot: RobotId = slug(HOSTILE);
        let refusal = |role| {
            let reason = RefusalReason::OutOfService { problem: "no route; ".repeat(LONG_REASON / 10 / roles.len()) };
            RoleReply::Refusal(BidRefusal { robot: robot.clone(), role, reason })
        };
        let replies = roles.keys().cloned().map(refusal).collect();
        let response = wire(&BidResponse { robot: robot.clone(), auction, replies });
        query.replier.reply(&self.keys.write(&Key::Bid(robot)), response, Encoding::Wire).await
    }

    async fn attack(self: Arc<Self>, replicas: Vec<Replica<Ledger>>) {
        loop {
            match self.draw(|chance| chance.random_range(0..8)) {
                0 | 1 => self.replay().await,
                2 => self.pose_as_coordinator().await,
                3 => self.send_garbage().await,
                4 | 5 => self.take_part_in_a_mission(&replicas).await,
                6 => self.request(&replicas).await,
                _ => self.flood().await,
            }
            let pause = self.draw(|chance| Duration::from_millis(chance.random_range(20..600)));
            tokio::time::sleep(pause).await; // virtual time
        }
    }

    /// Declares members down or restarted, in their own names and in its own, by random numbers of its own.
    async fn lie_about_members(self: Arc<Self>, known: Option<SharedKnowledge>, seed: u64, date_ms: u64) {
        let (Some(known), mut chance) = (known, ChaCha8Rng::seed_from_u64(seed ^ 0x11e5)) else { return };
        let member = |chance: &mut ChaCha8Rng| {
            let node = self.victims.choose(chance).expect("a fleet has nodes").clone();
            let incarnation = known.read(|base| base.get(&node).map(|stored| stored.record.stamp.incarnation));
            (node, incarnation.unwrap_or_default())
        };
        loop {
            let (about, to) = (member(&mut chance), member(&mut chance));
            let from = if chance.random_bool(0.5) { about.clone() } else { (slug(HOSTILE), date_ms) };
            if about.0 != to.0 {
                let is_restarted = chance.random_bool(0.3);
                let about = if is_restarted { (about.0, about.1 + 1) } else { about };
                let key = self.keys.write(&Key::Swim(to.0.clone()));
                self.publish(&self.signing, &key, packet_about(from, about, is_restarted, to), Bytes::new()).await;
            }
            let pause = Duration::from_millis(chance.random_range(50..500));
            tokio::time::sleep(pause).await; // virtual time
        }
    }

    /// States the motion of robots, in their names, under the current version of their records and under later ones: at
    /// a place with its own name. It draws random numbers of its own.
    async fn forge_motion(self: Arc<Self>, known: Option<SharedKnowledge>, seed: u64) {
        let (Some(known), mut chance) = (known, ChaCha8Rng::seed_from_u64(seed ^ 0x0710)) else { return };
        loop {
            let node = self.victims.choose(&mut chance).expect("a fleet has nodes").clone();
            let stored = known.read(|base| {
                let stored = base.get(&node)?;
                Some((stored.record.stamp, stored.knowledge().robot.clone()?))
            });
            if let Some((mut stamp, robot)) = stored {
                stamp.version += chance.random_range(0..3);
                let motion = Motion::of(&RobotKnowledge { place: slug(HOSTILE), ..robot });
                let number = if chance.random_bool(0.5) { u64::MAX } else { chance.random_range(1..100) };
                let update = wire(&MotionUpdate { stamp, number, motion: Some(motion) });
                let key = self.keys.write(&Key::Motion(node));
                for bus in [&self.signing, &self.in_cluster, &self.plain] {
                    self.publish(bus, &key, update.clone(), Bytes::new()).await;
                }
            }
            let pause = Duration::from_millis(chance.random_range(50..500));
            tokio::time::sleep(pause).await; // virtual time
        }
    }

    async fn publish(&self, bus: &SharedBus, key: &str, payload: Bytes, attachment: Bytes) {
        // Too large a payload is refused by the own bus.
        let _ = bus.publish_with_attachment(key, payload, attachment, Encoding::Wire, Delivery::Drop).await;
    }

    async fn query(&self, bus: &SharedBus, key: &str, payload: Bytes, attachment: Bytes) {
        let timeout = Duration::from_millis(300);
        let replies = bus.query_with(key, payload, attachment, timeout, ServiceSelection::All).await;
        let Ok(mut replies) = replies else { return };
        while replies.recv().await.is_some() {}
    }

    /// Repeats a message of another node: on its key or on another, as publication or as query,
    /// unchanged or with a signature of its own.
    async fn replay(&self) {
        let sample = {
            let captured = self.captured.lock().unwrap_or_else(PoisonError::into_inner);
            self.draw(|chance| captured.iter().collect::<Vec<_>>().choose(chance).map(|sample| Sample::clone(sample)))
        };
        let Some(Sample { key, payload, attachment, .. }) = sample else { return };
        let moved = self.victims.iter().find(|node| key.contains(node.as_str())).map(|node| {
            let other = self.victim();
            key.replace(node.as_str(), other.as_str())
        });
        let key = if self.draw(|chance| chance.random_bool(0.5)) { moved.unwrap_or(key) } else { key };
        match self.draw(|chance| chance.random_range(0..3)) {
            0 => self.publish(&self.plain, &key, payload, attachment).await,
            1 => self.publish(&self.signing, &key, payload, Bytes::new()).await,
            _ => self.query(&self.plain, &key, payload, attachment).await,
        }
    }

    /// Announces coordinators of later terms and other versions, in its own name and in others'.
    async fn pose_as_coordinator(&self) {
        let node = if self.draw(|chance| chance.random_bool(0.5)) { slug(HOSTILE) } else { self.victim() };
        let term = self.draw(|chance| *[1, 1_000, u64::MAX].choose(chance).expect("three"));
        let beacon =
            Beacon { voters: [node.clone()].into(), node, term, since_ms: 0, cluster: self.cluster, wire: Some(200) };
        self.publish(&self.in_cluster, &self.keys.write(&Key::Beacon), wire(&beacon), Bytes::new()).await;
    }

    /// Sends bytes without meaning on keys of another node.
    async fn send_garbage(&self) {
        let victim = self.victim();
        let robot = RobotId::from(victim.clone());
        let keys = [
            Key::Knowledge(victim.clone()),
            Key::Swim(victim.clone()),
            Key::Events(victim.clone()),
            Key::Driver(robot.clone(), DriverCall::State),
            Key::Driver(robot.clone(), DriverCall::Command),
            Key::Bid(robot.clone()),
            Key::Award(robot),
            Key::Gossip(victim),
        ];
        let key = self.draw(|chance| self.keys.write(keys.choose(chance).expect("some keys")));
        let length = self.draw(|chance| *[0, 1, 300, 60_000].choose(chance).expect("four"));
        let bytes = self.draw(|chance| (0..length).map(|_| chance.random()).collect::<Vec<u8>>());
        for bus in [&self.signing, &self.in_cluster, &self.plain] {
            self.publish(bus, &key, bytes.clone().into(), Bytes::new()).await;
            self.query(bus, &key, bytes.clone().into(), Bytes::new()).await;
        }
    }

    /// Reports the end of steps, and sends the signals, of a role of others. In a role that it has won it may do both.
    async fn take_part_in_a_mission(&self, replicas: &[Replica<Ledger>]) {
        let missions: Vec<MissionEntry> = latest(replicas, |ledger| ledger.missions().cloned().collect());
        let Some(entry) = self.draw(|chance| missions.choose(chance).cloned()) else { return };
        for (role, state) in &entry.roles {
            if state.holder.as_ref().is_some_and(|holder| holder.robot.as_str() == HOSTILE) {
                continue;
            }
            let Some(plan) = entry.plan(role) else { continue };
            let Some(report) = report_of_all_steps(slug(HOSTILE), &entry, role) else { continue };
            let key = self.keys.write(&Key::Report(self.victim()));
            self.query(&self.in_cluster, &key, wire(&report), Bytes::new()).await;
            let later = Epoch { index: report.epoch.index + 1, ..report.epoch };
            let epoch = self.draw(|chance| *[report.epoch, later, MAX_EPOCH].choose(chance).expect("three"));
            for signal in signals_sent(plan) {
                let key = self.keys.write(&Key::Signal(entry.id.clone(), signal.to.clone()));
                let history = SignalHistory { mission: entry.id.clone(), epoch, signals: [signal.clone()].into() };
                self.publish(&self.in_cluster, &key, wire(&history), Bytes::new()).await;
            }
        }
    }

    /// Makes requests that only people may make, with its own signature and with captured ones.
    async fn request(&self, replicas: &[Replica<Ledger>]) {
        let missions: Vec<MissionId> =
            latest(replicas, |ledger| ledger.missions().map(|entry| entry.id.clone()).collect());
        let mission = self.draw(|chance| missions.choose(chance).cloned());
        let number: u32 = self.draw(|chance| chance.random());
        let submit = json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" },
            "request": format!("{HOSTILE}-{number}") });
        let change = json!({ "mission": mission, "by": HOSTILE });
        let attacks = [
            (Key::Api(ApiCall::Submit), submit),
            (Key::Api(ApiCall::Cancel), change.clone()),
            (Key::Api(ApiCall::Resolve), change),
            (Key::Leave(self.victim()), json!({})),
        ];
        let (key, payload) = self.draw(|chance| attacks.choose(chance).expect("four").clone());
        let (key, payload) = (self.keys.write(&key), Bytes::from(payload.to_string()));
        let captured = {
            let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
            self.draw(|chance| requests.iter().collect::<Vec<_>>().choose(chance).map(|request| (*request).clone()))
        };
        self.query(&self.signing, &key, payload.clone(), Bytes::new()).await;
        if let Some((captured_key, captured_payload, attachment)) = captured {
            self.query(&self.plain, &key, payload, attachment.clone()).await;
            self.query(&self.plain, &captured_key, captured_payload, attachment).await;
        }
    }

    /// Publishes much at once on a key that its certificate permits.
    async fn flood(&self) {
        let key = self.keys.write(&Key::Swim(slug(HOSTILE)));
        for number in 0..FLOOD {
            self.publish(&self.signing, &key, number.to_be_bytes().to_vec().into(), Bytes::new()).await;
        }
    }

    fn below(&self, key: &str) -> String {
        below(&self.keys, key)
    }
}

/// Largest epoch.
const MAX_EPOCH: Epoch = Epoch { term: u64::MAX, index: u64::MAX };

/// Returns a key expression below the fleet's prefix.
fn below(keys: &Keys, key: &str) -> String {
    let prefix = keys.write(&Key::Beacon).replace("/wire/beacon", "");
    format!("{prefix}/{key}")
}

fn wire<T: Serialize>(message: &T) -> Bytes {
    codec::encode(message).expect("a small message").into()
}

fn push_bounded<T>(queue: &Mutex<VecDeque<T>>, item: T) {
    let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
    queue.push_back(item);
    if queue.len() > CAPTURED_MAX {
        queue.pop_front();
    }
}

/// Reads the replica that has applied most of the ledger: the attacker knows everything.
fn latest<T: Default>(replicas: &[Replica<Ledger>], read: impl FnOnce(&Ledger) -> T) -> T {
    let replica = replicas.iter().max_by_key(|replica| replica.applied().borrow().index);
    replica.map(|replica| replica.read(read)).unwrap_or_default()
}
