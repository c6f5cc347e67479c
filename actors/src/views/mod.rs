//! What people see of a fleet. Any node answers, from its own copy of the ledger and from what it has heard.
//!
//! ```text
//!  client ── get view/** ──▶ the nearest node ── from its knowledge, its copy of the ledger, its map
//!                               │
//!                               ├─ seen/{keeper}/** ──▶ a keeper of the ledger, if it keeps none itself
//!                               └─ wire/world ────────▶ the host of bodies
//! ```
//!
//! All nodes declare `view/**` as complete, so that whoever asks as Zenoh does by itself gets one answer, from the nearest;
//! each says whose it is and how old. A node that Zenoh asks beside itself answers too, and of two nodes' answers those of one are
//! given: see `bus`. `seen/{node}/**` has the same views as this one node draws them by itself.
//!
//! Views are drawn when somebody asks, and cost nothing otherwise. The requests that change nothing (`get`, `list`, `explain`
//! and `help`) are answered here too.

mod api;
mod cluster_status;
mod draw;
mod health;
mod mission;

pub use cluster_status::CoordinatorStatus;

use crate::api_types::call_help;
use crate::bus::{BusError, Query, Sample, SharedBus, Stream};
use crate::clock::Clock;
use crate::cluster_membership::ClusterMembership;
use crate::coordinator::CoordinatorMessage;
use crate::gossip::SharedKnowledge;
use crate::raft::{RaftId, Replica};
use crate::reply;
use crate::tasks::Tasks;
use bytes::Bytes;
use cluster_status::ClusterStatus;
use consort_protocol::codec;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::message::Beacon;
use consort_protocol::units::NodeTime;
use draw::ViewContext;
use ractor::ActorRef;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use zenoh_keyexpr::keyexpr;

/// How long a keeper of the ledger may take to answer for a node that keeps none. One that is gone is noticed earlier.
const KEEPER_LIMIT: Duration = Duration::from_millis(400);

/// So many keepers are asked, one after the other.
const KEEPERS_ASKED: usize = 3;

/// How long the host of bodies may take to say how its world looks.
const WORLD_LIMIT: Duration = Duration::from_millis(400);

/// How long this node's own coordinator may take to say how it stands.
const SHOW_LIMIT: Duration = Duration::from_millis(100);

/// A coordinator that has been silent for so many of its beats no longer counts as one.
const BEATS_MISSED: u32 = 4;

/// What a node needs to answer those who look.
#[derive(Clone)]
pub(crate) struct Views {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) clock: Clock,
    /// Its copy of the ledger, if it has one.
    pub(crate) replica: Option<Replica<Ledger>>,
    /// Its own coordinator, if it may be one.
    pub(crate) coordinator: Option<ActorRef<CoordinatorMessage>>,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) membership: ClusterMembership,
    pub(crate) ensemble: Arc<Ensemble>,
    /// The fleet's map, to show.
    pub(crate) map: Option<Arc<Value>>,
    /// How often a coordinator says that it is there.
    pub(crate) beacon_interval: Duration,
}

/// The last word of a coordinator, and when it was heard.
type Word = Arc<Mutex<Option<(Beacon, NodeTime)>>>;

impl Views {
    /// Begins to answer, for as long as `tasks` lives.
    pub(crate) async fn serve(self, tasks: &mut Tasks) -> Result<(), BusError> {
        let (bus, keys) = (self.bus.clone(), self.keys.clone());
        let word = Word::default();
        tasks.spawn(follow(bus.subscribe(&keys.write(&Key::Beacon)).await?, Arc::clone(&word), self.clock));
        let looks = ViewService { views: Arc::new(self), word };
        tasks.spawn(looks.clone().serve(bus.serve_complete(&keys.any_view()).await?, Service::Views));
        tasks.spawn(looks.clone().serve(bus.serve_complete(&keys.any_help()).await?, Service::Help));
        for call in ApiCall::ALL.iter().copied().filter(|call| call.is_read_only()) {
            let questions = bus.serve_complete(&keys.write(&Key::Api(call))).await?;
            tasks.spawn(looks.clone().serve(questions, Service::Request(call)));
        }
        let questions = bus.serve(&keys.any_seen(&looks.views.node)).await?;
        tasks.spawn(looks.serve(questions, Service::Seen));
        Ok(())
    }
}

/// What somebody has asked for: one expression may match several.
#[derive(Debug, Clone, Copy)]
enum Service {
    /// Views, whoever has them.
    Views,
    /// Views as this node has them.
    Seen,
    /// A request that changes nothing.
    Request(ApiCall),
    /// Help on requests.
    Help,
}

/// Listens to whoever coordinates.
async fn follow(mut beacons: Stream<Sample>, word: Word, clock: Clock) {
    while let Some(sample) = beacons.recv().await {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { continue };
        let mut word = word.lock().unwrap_or_else(PoisonError::into_inner);
        if beacon.supersedes(word.as_ref().map(|(known, _)| known)) {
            *word = Some((beacon, clock.now()));
        }
    }
}

/// Answers questions.
#[derive(Clone)]
struct ViewService {
    views: Arc<Views>,
    word: Word,
}

impl ViewService {
    async fn serve(self, mut questions: Stream<Query>, service: Service) {
        let mut answers = JoinSet::new();
        while let Some(query) = questions.recv().await {
            while answers.try_join_next().is_some() {}
            answers.spawn(self.clone().answer(query, service));
        }
    }

    async fn answer(self, query: Query, service: Service) {
        let Ok(asked) = keyexpr::new(query.key.as_str()) else { return };
        let answers = match service {
            Service::Views => self.requested_views(asked).await,
            Service::Seen => {
                let seen = |key: &Key| Key::Seen(self.views.node.clone(), Box::new(key.clone()));
                let own = self.own(&|key: &Key| self.is_asked(asked, &seen(key))).await;
                own.into_iter().map(|(key, value)| (seen(&key), value)).collect()
            }
            Service::Request(call) => vec![(Key::Api(call), self.answer_request(call, &query.payload).await)],
            Service::Help => {
                let keys = ApiCall::ALL.iter().map(|call| (Key::Help(*call), *call));
                let asked = keys.filter(|(key, _)| self.is_asked(asked, key));
                asked.map(|(key, call)| (key, call_help(call))).collect()
            }
        };
        for (key, value) in answers {
            reply::json(&query, &self.views.keys.write(&key), &value).await;
        }
    }

    fn is_asked(&self, asked: &keyexpr, key: &Key) -> bool {
        keyexpr::new(self.views.keys.write(key).as_str()).is_ok_and(|key| asked.intersects(key))
    }

    /// What this node draws by itself.
    async fn own(&self, wanted: &impl Fn(&Key) -> bool) -> Vec<(Key, Value)> {
        self.context().await.draw(wanted)
    }

    /// What is asked for, with the help of a keeper of the ledger and of the host of bodies where this node is neither.
    async fn requested_views(&self, asked: &keyexpr) -> Vec<(Key, Value)> {
        let wanted = |key: &Key| self.is_asked(asked, key);
        let window = self.context().await;
        let mut views = window.draw(&wanted);
        let missions = self.views.keys.write(&Key::ViewMissions).replace("/missions", "/mission/*");
        let asks_ledger = wanted(&Key::ViewMissions)
            || wanted(&Key::ViewAuctions)
            || wanted(&Key::ViewHealth)
            || keyexpr::new(missions.as_str()).is_ok_and(|missions| missions.intersects(asked));
        if asks_ledger && !window.status.has_ledger {
            match self.of_keeper(asked, &window.status).await {
                Some(theirs) => {
                    for (key, value) in theirs.into_iter().filter(|(key, _)| is_of_ledger(key) && wanted(key)) {
                        views.retain(|(own, _)| *own != key);
                        views.push((key, value));
                    }
                }
                None => {
                    let why = json!({ "error": "no keeper of the ledger answers", "retry_after_ms": 300 });
                    for key in [Key::ViewMissions, Key::ViewAuctions].into_iter().filter(&wanted) {
                        views.push((key, window.with_provenance(why.clone())));
                    }
                }
            }
        }
        if wanted(&Key::ViewWorld)
            && let Some(world) = self.world().await
        {
            views.push((Key::ViewWorld, window.with_provenance(world)));
        }
        views
    }

    /// The views of a keeper of the ledger: the coordinator's, else those of any other.
    async fn of_keeper(&self, asked: &keyexpr, standing: &ClusterStatus) -> Option<Vec<(Key, Value)>> {
        let Views { keys, bus, knowledge, node, .. } = &*self.views;
        let only_health = asked.as_str() == keys.write(&Key::ViewHealth);
        let coordinator = standing.coordinator.iter();
        let others = standing.voters.iter().filter(|voter| Some(*voter) != standing.coordinator.as_ref());
        let keepers = coordinator.chain(others).filter(|keeper| *keeper != node && knowledge.is_alive(keeper));
        for keeper in keepers.take(KEEPERS_ASKED) {
            let any = keys.any_seen(keeper);
            let seen = match (keys.any_view().strip_suffix("**"), any.strip_suffix("**")) {
                (Some(views), Some(seen)) => asked.as_str().strip_prefix(views).map(|view| format!("{seen}{view}")),
                _ => None,
            };
            let Ok(mut replies) = bus.query(&seen.unwrap_or(any), Bytes::new(), KEEPER_LIMIT).await else { continue };
            let mut views = vec![];
            while let Some(reply) = replies.recv().await {
                let value = reply.payload.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
                if let (Some(Key::Seen(_, view)), Some(value)) = (keys.read(&reply.key), value) {
                    views.push((*view, value));
                }
            }
            // One that has lost its place among the keepers has no missions to show.
            let shows = |key: &Key| is_of_ledger(key) && (only_health || *key != Key::ViewHealth);
            if views.iter().any(|(key, _)| shows(key)) {
                return Some(views);
            }
        }
        None
    }

    async fn world(&self) -> Option<Value> {
        let key = self.views.keys.write(&Key::World);
        let mut replies = self.views.bus.query(&key, Bytes::new(), WORLD_LIMIT).await.ok()?;
        serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()
    }

    async fn context(&self) -> ViewContext<'_> {
        let shown = match &self.views.coordinator {
            Some(coordinator) => {
                let (to, said) = oneshot::channel();
                // One that does not coordinate drops the question.
                match coordinator.cast(CoordinatorMessage::QueryStatus(to)) {
                    Ok(()) => tokio::time::timeout(SHOW_LIMIT, said).await.ok().and_then(Result::ok),
                    Err(_) => None,
                }
            }
            None => None,
        };
        let now = self.views.clock.now();
        ViewContext { views: &self.views, status: self.standing(shown, now), now }
    }

    fn standing(&self, shown: Option<CoordinatorStatus>, now: NodeTime) -> ClusterStatus {
        let Views { node, knowledge, replica, beacon_interval: beat, .. } = &*self.views;
        let word = self.word.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let leadership = replica.as_ref().map(|replica| replica.leadership().borrow().clone()).unwrap_or_default();
        let heard = word.as_ref().map(|(beacon, at)| (beacon, now.since(*at)));
        let millis = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        let own_id = replica.as_ref().map(Replica::id);
        let is_member = |id: &RaftId| leadership.voters.contains_key(id) || leadership.learners.contains_key(id);
        // One that was replaced while it was away does not know it; the coordinator's word says so.
        let is_named = heard.is_none_or(|(beacon, _)| {
            beacon.voters.contains(node) || leadership.learners.values().any(|observer| observer == node)
        });
        // What a leader has committed in its own term stands behind all that was committed before: a copy that has that
        // lacks nothing, and one that was started anew may lack anything.
        let has_all = heard.zip(replica.as_ref()).is_some_and(|((beacon, _), replica)| {
            let applied = *replica.applied().borrow();
            applied.term >= beacon.term
        });
        let is_keeper = own_id.as_ref().is_some_and(is_member) && is_named;
        let keeps_ledger = shown.is_some() || is_keeper && has_all;
        let mut standing = ClusterStatus {
            has_ledger: keeps_ledger,
            observers: leadership.learners.values().cloned().collect(),
            quorum_age_ms: replica.as_ref().and_then(Replica::quorum_ack_age).map(millis),
            ..ClusterStatus::default()
        };
        match (shown, heard) {
            (Some(shown), _) => {
                standing.coordinator = Some(node.clone());
                (standing.term, standing.since_ms, standing.age_ms) = (shown.term, Some(shown.since_ms), Some(0));
                standing.autopilot = Some(shown.autopilot);
            }
            (None, Some((beacon, age))) => {
                let there = beacon.node != *node && knowledge.is_alive(&beacon.node) && age < *beat * BEATS_MISSED;
                standing.term = beacon.term;
                standing.age_ms = Some(millis(age));
                if there {
                    standing.coordinator = Some(beacon.node.clone());
                    standing.since_ms = Some(beacon.since_ms.saturating_add(millis(age)));
                }
            }
            (None, None) => standing.term = leadership.term,
        }
        let of_word = || heard.map(|(beacon, _)| beacon.voters.iter().cloned().collect()).unwrap_or_default();
        standing.voters = if keeps_ledger { leadership.voters.values().cloned().collect() } else { of_word() };
        // A node that came back with an empty store is another member than the voter of its name.
        standing.voters_lost = knowledge.read(|base| {
            let has = |node: &NodeId| base.get(node).map(|heard| heard.record.knowledge.replica);
            if keeps_ledger {
                let lost = leadership.voters.iter().filter(|(id, voter)| has(voter) != Some(Some(id.0)));
                lost.map(|(_, voter)| voter.clone()).collect::<Vec<_>>()
            } else {
                standing.voters.iter().filter(|voter| has(voter).is_none()).cloned().collect()
            }
        });
        standing.voters_lost.sort();
        standing.voters_lost.dedup();
        standing
    }
}

/// Whether a view shows the ledger.
fn is_of_ledger(key: &Key) -> bool {
    matches!(key, Key::ViewMissions | Key::ViewMission(_) | Key::ViewAuctions | Key::ViewHealth)
}
