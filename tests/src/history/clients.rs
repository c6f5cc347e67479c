//! Clients that record their calls.

use super::{CLIENT, ClientCall, History, MAYBE_REPEATED};
use consort_bus::{ServiceSelection, SharedBus};
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::watch;

/// Timeout of a call.
const CALL_TIMEOUT: Duration = Duration::from_secs(3);

/// Timeout of a request to leave: a node hands over its vote and its role first.
const LEAVE_TIMEOUT: Duration = Duration::from_secs(60);

/// Interval between two requests to upgrade.
const UPGRADE_INTERVAL: Duration = Duration::from_secs(2);

/// Delay before a request is repeated.
const RETRY_INTERVAL: Duration = Duration::from_millis(700);

/// Text of the refusal of a new mission, because as many as allowed are active.
const FULL: &str = "missions are active, the maximum of this fleet";

/// Members of the replies to orders of people, each to another order.
const ORDERED: [&str; 6] = ["robots", "closures", "speed_limits", "alarms", "priority", "phase"];

/// Missions of acknowledged requests, by request.
pub type Acknowledged = watch::Sender<BTreeMap<String, String>>;

/// Kind of reader: what it reads, and from where.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reader {
    /// A mission or all missions, linearizable, from the nearest node.
    Nearest,
    /// All missions, linearizable, through every node.
    EveryNode,
    /// All missions, from the copy of every node.
    EveryCopy,
}

impl Reader {
    /// All kinds.
    pub const ALL: [Reader; 3] = [Reader::Nearest, Reader::EveryNode, Reader::EveryCopy];
}

/// Client that records its calls in a history.
#[derive(Clone)]
pub struct RecordingClient {
    /// Its bus. In a closed fleet it signs the requests of a person.
    pub bus: SharedBus,
    /// Keys of the fleet.
    pub keys: Keys,
    /// History of its calls.
    pub history: History,
}

impl RecordingClient {
    /// Submits a mission, again and again until it is acknowledged.
    pub async fn submit(&self, request: &Value) -> MissionId {
        loop {
            if let Some(mission) = self.submit_new(request).await {
                return mission;
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    /// Submits a mission, again and again until it is acknowledged. Returns `None` if the fleet refuses the request because
    /// it may be a repetition of a request that the ledger has forgotten.
    pub async fn submit_new(&self, request: &Value) -> Option<MissionId> {
        let name = request.get("request").and_then(Value::as_str).map(str::to_owned);
        let call = ClientCall::Submit { request: name };
        loop {
            let replies = self.change(ApiCall::Submit, &call, request).await;
            let missions = replies.iter().filter_map(|reply| reply["mission"].as_str());
            if let Some(mission) = missions.filter_map(|mission| mission.parse().ok()).next() {
                return Some(mission);
            }
            let mut errors = replies.iter().filter_map(|reply| reply["error"].as_str());
            if errors.any(|error| error.contains(MAYBE_REPEATED)) {
                return None;
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    /// Cancels a mission, again and again until there is any reply: the mission may have ended by
    /// itself.
    pub async fn cancel(&self, mission: &MissionId) {
        let call = ClientCall::Cancel { mission: mission.clone() };
        let request = json!({ "mission": mission, "by": CLIENT });
        while self.change(ApiCall::Cancel, &call, &request).await.is_empty() {
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    /// Returns the reply to a linearizable list of all missions, if there is a definite one. The read is
    /// not recorded.
    pub async fn list(&self) -> Option<Value> {
        let mut list = None;
        let each = |reply: Value| list = reply.get("missions").is_some().then_some(reply);
        let (key, request) = (Key::Api(ApiCall::List), json!({ "linearizable": true }));
        self.query_each(&key, &request, ServiceSelection::Nearest, CALL_TIMEOUT, each).await;
        list
    }

    /// Makes a node leave the fleet. The reply is not recorded.
    pub async fn leave(&self, node: &NodeId) {
        self.query_each(&Key::Leave(node.clone()), &json!({}), ServiceSelection::All, LEAVE_TIMEOUT, drop).await;
    }

    /// Changes a schedule, again and again until there is a definite reply, and returns it. The reply is not recorded, and
    /// a schedule counts as a request that may create missions at any time.
    pub async fn change_schedule(&self, request: &Value) -> Value {
        if request["action"] == "add" {
            self.history.record_unknown(ClientCall::Submit { request: None }, self.history.invoke());
        }
        loop {
            let mut definite = None;
            let each = |reply: Value| {
                if definite.is_none() && reply.get("retry_after_ms").is_none() {
                    definite = Some(reply);
                }
            };
            self.query_each(&Key::Api(ApiCall::Schedule), request, ServiceSelection::All, CALL_TIMEOUT, each).await;
            if let Some(reply) = definite {
                return reply;
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    /// Sends the request of a person, again and again until there is a definite reply. Each attempt names another person, so
    /// the audit trail shows which were executed. Returns the person of the acknowledged attempt; `None` if the request is
    /// refused, or cancels missions: such a request has an entry in the log only if it finds missions.
    pub async fn order(&self, call: ApiCall, mut request: Value, person: &str) -> Option<String> {
        for attempt in 1.. {
            let by = format!("{person}, attempt {attempt}");
            request["by"] = json!(by);
            let (mut is_acknowledged, mut is_definite) = (false, false);
            let each = |reply: Value| {
                is_acknowledged |= ORDERED.iter().any(|member| reply.get(member).is_some());
                is_definite |= reply.get("retry_after_ms").is_none();
            };
            self.query_each(&Key::Api(call), &request, ServiceSelection::All, CALL_TIMEOUT, each).await;
            if is_definite {
                return is_acknowledged.then_some(by);
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
        None
    }

    /// Raises the wire version of the fleet, again and again until it is `newest`.
    pub async fn upgrade(&self, newest: u8) {
        let (key, mut wire) = (Key::Api(ApiCall::Upgrade), None);
        for finish in [false, true].into_iter().cycle() {
            let each = |reply: Value| wire = reply["wire"].as_u64().or(wire);
            self.query_each(&key, &json!({ "finish": finish }), ServiceSelection::All, CALL_TIMEOUT, each).await;
            if wire == Some(u64::from(newest)) {
                return;
            }
            tokio::time::sleep(UPGRADE_INTERVAL).await;
        }
    }

    /// Resolves the missions that need intervention, as a person would. Robots that hold an item
    /// receive no other work until then.
    pub async fn resolve_all(&self) {
        let mut replies = vec![];
        let each = |value| replies.push(value);
        self.query_each(&Key::Api(ApiCall::List), &Value::Null, ServiceSelection::Nearest, CALL_TIMEOUT, each).await;
        let mut held: Vec<MissionId> = vec![];
        for mission in replies.iter().filter_map(|reply| reply["missions"].as_array()).flatten() {
            if mission["state"] == "needs_intervention" {
                held.extend(mission["mission"].as_str().and_then(|id| id.parse().ok()));
            }
        }
        for mission in held {
            let request = json!({ "mission": mission, "by": CLIENT });
            self.change(ApiCall::Resolve, &ClientCall::Resolve { mission }, &request).await;
        }
    }

    /// Reads missions at random times, for ever.
    pub async fn read(self, reader: Reader, acknowledged: Acknowledged, seed: u64) {
        let mut chance = ChaCha8Rng::seed_from_u64(seed ^ (0x5ead + reader as u64));
        loop {
            let pause_ms = match reader {
                Reader::Nearest => 500..3_000,
                Reader::EveryNode => 4_000..12_000,
                Reader::EveryCopy => 3_000..9_000,
            };
            tokio::time::sleep(Duration::from_millis(chance.random_range(pause_ms))).await;
            let linearizable = reader != Reader::EveryCopy;
            let target = if reader == Reader::Nearest { ServiceSelection::Nearest } else { ServiceSelection::All };
            match pick(&mut chance, &acknowledged).filter(|_| reader == Reader::Nearest) {
                Some(mission) => self.record_read(ClientCall::Get { mission }, target).await,
                None => self.record_read(ClientCall::List { linearizable }, target).await,
            }
        }
    }

    /// Sends a request that changes something to all nodes, and records the first definite reply.
    async fn change(&self, call: ApiCall, recorded: &ClientCall, request: &Value) -> Vec<Value> {
        let (invoked, mut is_recorded, mut replies) = (self.history.invoke(), false, vec![]);
        let each = |value: Value| {
            if value["error"].as_str().is_some_and(|error| error.contains(FULL)) {
                self.history.count_refusal();
            }
            if let Some(reply) = recorded.parse(&value).filter(|_| !is_recorded) {
                self.history.record(recorded.clone(), invoked, reply);
                is_recorded = true;
            }
            replies.push(value);
        };
        self.query_each(&Key::Api(call), request, ServiceSelection::All, CALL_TIMEOUT, each).await;
        if !is_recorded {
            self.history.record_unknown(recorded.clone(), invoked);
        }
        replies
    }

    /// Records each definite reply as a read of its own.
    async fn record_read(&self, read: ClientCall, target: ServiceSelection) {
        let (call, payload) = match &read {
            ClientCall::Get { mission } => (ApiCall::Get, json!({ "mission": mission, "linearizable": true })),
            ClientCall::List { linearizable } => (ApiCall::List, json!({ "linearizable": linearizable })),
            other => unreachable!("{other:?} is no read"),
        };
        let invoked = self.history.invoke();
        let record = |value: Value| {
            if let Some(reply) = read.parse(&value) {
                self.history.record(read.clone(), invoked, reply);
            }
        };
        self.query_each(&Key::Api(call), &payload, target, CALL_TIMEOUT, record).await;
    }

    /// Calls `each` with every reply as it arrives.
    async fn query_each(
        &self,
        key: &Key,
        payload: &Value,
        target: ServiceSelection,
        timeout: Duration,
        mut each: impl FnMut(Value),
    ) {
        let (key, payload) = (self.keys.write(key), payload.to_string().into());
        let Ok(mut replies) = self.bus.query_with(&key, payload, vec![].into(), timeout, target).await else {
            return;
        };
        while let Some(reply) = replies.recv().await {
            if let Ok(payload) = reply.payload {
                each(serde_json::from_slice(&payload).unwrap_or(Value::Null));
            }
        }
    }
}

/// Draws an acknowledged mission to read, or `None` to read all missions.
fn pick(chance: &mut ChaCha8Rng, acknowledged: &Acknowledged) -> Option<MissionId> {
    let known: Vec<String> = acknowledged.borrow().values().cloned().collect();
    match chance.random_range(0..=known.len()) {
        0 => None,
        number => known[number - 1].parse().ok(),
    }
}
