//! Views of a fleet for people. Any node replies, from its own copy of the ledger and from the
//! records it has received.
//!
//! ```text
//!  client ── get view/** ──▶ the nearest node ── from its knowledge, its copy of the ledger, its map
//!                               │
//!                               ├─ seen/{voter}/** ───▶ a voter of the ledger, if it has no copy itself
//!                               ├─ seen/{robot}/robot/{robot} ─▶ the node of each requested robot, for its driver's values
//!                               ├─ seen/{member}/ensemble/{ensemble} ─▶ a member, for the values that members exchange
//!                               └─ wire/world ────────▶ the driver server
//! ```
//!
//! All nodes declare `view/**` as complete, so a client with Zenoh's default target gets a single
//! reply, from the nearest node. Each reply contains its source and its age. A node that Zenoh
//! queries in addition replies too; the client then gets the replies of only 1 of these nodes: see
//! `bus`. The parameters `since`, `limit` and `after` of a selector request a part of a list:
//! [`list_parts`]. `seen/{node}/**` serves the same views, computed by that node alone. With the payload
//! `{"linearizable": true}` it serves a single view of the ledger, after a majority has confirmed that
//! the node leads. For a mission that its copy of the ledger lacks, it replies with an error.
//!
//! Views are computed on request and cost nothing otherwise. The read-only requests (`get`, `list`,
//! `explain` and `help`) are also served here.

mod api;
mod cluster_status;
mod draw;
mod health;
mod ledger_part;
mod linearizable;
mod list_parts;
mod mission;

use crate::api_help::call_help;
use crate::coordinator::{CoordinatorMessage, CoordinatorStatus};
use crate::followed_coordinator::{LastBeacon, follow_beacons};
use crate::robot_driver::RobotDriver;
use crate::shared_exchanges::SharedExchanges;
use api::unknown_mission;
use bytes::Bytes;
use cluster_status::ClusterStatus;
use consort_bus::clock::Clock;
use consort_bus::cluster_membership::ClusterMembership;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{BusError, Query, SharedBus, Stream};
use consort_gossip::SharedKnowledge;
use consort_protocol::api::{ErrorReply, ReadOptions};
use consort_protocol::devices::Devices;
use consort_protocol::ensemble::Ensembles;
use consort_protocol::ids::{EnsembleId, MissionId, NodeId, RobotId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::units::NodeTime;
use consort_protocol::view::{ChargingView, DeclarationsView, MapView, RobotView};
use consort_raft::{RaftId, Replica};
use draw::{Copies, DriverValues, ViewContext, json, millis};
use ledger_part::{copy_ledger_part, has_part_of_ledger, is_of_ledger, shows_ledger};
use list_parts::{ListParts, PartRequest};
use ractor::ActorRef;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use zenoh_keyexpr::keyexpr;

/// Timeout for a voter to reply on behalf of a node without a ledger. A failed voter is detected
/// earlier.
const VOTER_TIMEOUT: Duration = Duration::from_millis(400);

/// Maximum number of voters that are queried in sequence.
const VOTERS_QUERIED_MAX: usize = 3;

/// Timeout for the driver server to return the state of its world.
const WORLD_TIMEOUT: Duration = Duration::from_millis(400);

/// Timeout for the node of a robot to return the values of the robot's driver.
const DRIVER_VALUES_TIMEOUT: Duration = Duration::from_millis(400);

/// Timeout for a member of an ensemble to return the values that members exchange.
const MEMBER_TIMEOUT: Duration = Duration::from_millis(400);

/// Maximum number of members that are queried in sequence.
const MEMBERS_QUERIED_MAX: usize = 3;

/// Timeout for this node's own coordinator to return its status.
const STATUS_TIMEOUT: Duration = Duration::from_millis(100);

/// Suggested delay of a retry in milliseconds if no voter replies, or none confirms a read.
const RETRY_AFTER_MS: u64 = 300;

/// Number of missed beacons after which a coordinator no longer counts as active.
const MISSED_BEACONS_MAX: u32 = 4;

/// Inputs of the views of a node.
#[derive(Clone)]
pub(crate) struct Views {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) clock: Clock,
    /// The node's copy of the ledger, if any.
    pub(crate) replica: Option<Replica<Ledger>>,
    /// The node's own coordinator actor, if it may coordinate.
    pub(crate) coordinator: Option<ActorRef<CoordinatorMessage>>,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) membership: ClusterMembership,
    pub(crate) ensembles: Arc<Ensembles>,
    /// The driver of the node's robot, once it is connected.
    pub(crate) driver: Arc<OnceLock<RobotDriver>>,
    /// Values that the members of ensembles exchange.
    pub(crate) exchanges: SharedExchanges,
    /// The fleet's map, to be served.
    pub(crate) map: Option<Arc<MapView>>,
    /// Charging by the robots themselves.
    pub(crate) charging: Option<ChargingView>,
    /// Devices of the building.
    pub(crate) devices: Arc<Devices>,
    /// Names that people may use in orders.
    pub(crate) declared: DeclarationsView,
    /// Interval of a coordinator's beacons.
    pub(crate) beacon_interval: Duration,
}

impl Views {
    /// Returns the nodes that have robots.
    fn robot_nodes(&self) -> Vec<NodeId> {
        self.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, stored)| stored.record.knowledge.robot.is_some());
            robots.map(|(node, _)| node.clone()).collect()
        })
    }

    /// Serves views and read-only requests for as long as `tasks` lives.
    pub(crate) async fn serve(self, tasks: &mut Tasks) -> Result<(), BusError> {
        let (bus, keys) = (self.bus.clone(), self.keys.clone());
        let latest_beacon = LastBeacon::default();
        tasks.spawn(follow_beacons(
            bus.subscribe(&keys.write(&Key::Beacon)).await?,
            Arc::clone(&latest_beacon),
            self.clock,
        ));
        let parts = Arc::new(Mutex::new(ListParts::new(&self.node, self.clock.wall_ms())));
        let service = ViewService { views: Arc::new(self), latest_beacon, parts };
        tasks.spawn(service.clone().serve(bus.serve_complete(&keys.any_view()).await?, Service::Views));
        tasks.spawn(service.clone().serve(bus.serve_complete(&keys.any_help()).await?, Service::Help));
        for call in ApiCall::ALL.iter().copied().filter(|call| call.is_read_only()) {
            let queries = bus.serve_complete(&keys.write(&Key::Api(call))).await?;
            tasks.spawn(service.clone().serve(queries, Service::Request(call)));
        }
        let queries = bus.serve(&keys.any_seen(&service.views.node)).await?;
        tasks.spawn(service.serve(queries, Service::Seen));
        Ok(())
    }
}

/// Kind of query. A key expression may match several views.
#[derive(Debug, Clone, Copy)]
enum Service {
    /// Views from any source.
    Views,
    /// Views computed by this node alone.
    Seen,
    /// A read-only request.
    Request(ApiCall),
    /// Help on requests.
    Help,
}

/// Server of queries.
#[derive(Clone)]
struct ViewService {
    views: Arc<Views>,
    latest_beacon: LastBeacon,
    parts: Arc<Mutex<ListParts>>,
}

impl ViewService {
    async fn serve(self, mut queries: Stream<Query>, service: Service) {
        let mut replies = JoinSet::new();
        while let Some(query) = queries.recv().await {
            while replies.try_join_next().is_some() {}
            replies.spawn(self.clone().reply_to(query, service));
        }
    }

    async fn reply_to(self, query: Query, service: Service) {
        let Ok(requested) = keyexpr::new(query.key.as_str()) else { return };
        let replies = match service {
            Service::Views => self.requested_views(requested).await,
            Service::Seen => self.seen_views(requested, &query.payload).await,
            Service::Request(call) => vec![(Key::Api(call), self.answer_request(call, &query.payload).await)],
            Service::Help => {
                let keys = ApiCall::ALL.iter().map(|call| (Key::Help(*call), *call));
                let requested = keys.filter(|(key, _)| self.is_requested(requested, key));
                requested.map(|(key, call)| (key, json(call_help(call)))).collect()
            }
        };
        let part = PartRequest::parse(&query.parameters);
        for (key, mut value) in replies {
            if let Some(part) = &part {
                // Each change of the versions is complete before the next operation that may panic.
                self.parts.lock().unwrap_or_else(PoisonError::into_inner).select(&key, &mut value, part);
            }
            reply::json(&query, &self.views.keys.write(&key), &value).await;
        }
    }

    fn is_requested(&self, requested: &keyexpr, key: &Key) -> bool {
        keyexpr::new(self.views.keys.write(key).as_str()).is_ok_and(|key| requested.intersects(key))
    }

    /// Returns the mission of a request for the view of a single mission.
    fn named_mission(&self, requested: &keyexpr) -> Option<MissionId> {
        let key = match self.views.keys.read(requested.as_str())? {
            Key::Seen(_, view) => *view,
            key => key,
        };
        if let Key::ViewMission(mission) = key { Some(mission) } else { None }
    }

    /// Returns the other nodes whose robots are requested, if they are alive. A key expression that covers
    /// other views too requests no robot, so `view/**` stays a query to a single node.
    fn requested_robots(&self, requested: &keyexpr) -> Vec<NodeId> {
        let any_robot = self.views.keys.any_robot_view();
        if !keyexpr::new(any_robot.as_str()).is_ok_and(|robots| robots.includes(requested)) {
            return vec![];
        }
        let is_asked = |node: &NodeId| {
            *node != self.views.node
                && self.is_requested(requested, &Key::ViewRobot(RobotId::from(node.clone())))
                && self.views.knowledge.is_alive(node)
        };
        self.views.robot_nodes().into_iter().filter(is_asked).collect()
    }

    /// Returns the values of the drivers of the robots of other nodes that reply. The nodes are queried at once.
    async fn driver_values_from(&self, nodes: Vec<NodeId>) -> BTreeMap<NodeId, DriverValues> {
        let mut queries = JoinSet::new();
        for node in nodes {
            let service = self.clone();
            queries.spawn(async move { service.driver_values_of(node).await });
        }
        queries.join_all().await.into_iter().flatten().collect()
    }

    /// Returns the values of the driver of the robot of another node.
    async fn driver_values_of(&self, node: NodeId) -> Option<(NodeId, DriverValues)> {
        let view = Key::ViewRobot(RobotId::from(node.clone()));
        let key = self.views.keys.write(&Key::Seen(node.clone(), Box::new(view)));
        let mut replies = self.views.bus.query(&key, Bytes::new(), DRIVER_VALUES_TIMEOUT).await.ok()?;
        let view: RobotView = serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()?;
        Some((node, DriverValues { readings: view.readings, feedback: view.feedback }))
    }

    /// Returns the requested views of this node alone.
    async fn seen_views(&self, requested: &keyexpr, payload: &[u8]) -> Vec<(Key, Value)> {
        let seen = |key: &Key| Key::Seen(self.views.node.clone(), Box::new(key.clone()));
        let is_linearizable = serde_json::from_slice(payload).is_ok_and(|ReadOptions { linearizable }| linearizable);
        if is_linearizable {
            let Some(Key::Seen(node, key)) = self.views.keys.read(requested.as_str()) else { return vec![] };
            let view = self.own_linearizable_view(&key).await;
            return vec![(Key::Seen(node, key), view.unwrap_or_else(|error| error))];
        }
        let single = match self.views.keys.read(requested.as_str()) {
            Some(Key::Seen(node, view)) if node == self.views.node => Some(*view),
            _ => None,
        };
        // A single key is compared: matching a key expression with a thousand keys takes milliseconds.
        let wanted = |key: &Key| match &single {
            Some(single) => single == key,
            None => self.is_requested(requested, &seen(key)),
        };
        let (context, named) = (self.context().await, self.named_mission(requested));
        let mut own_views = context.draw(&wanted, named.as_ref());
        if let Some(mission) = named
            && own_views.is_empty()
            && context.status.has_ledger
        {
            let error = unknown_mission(&mission, &self.views.node);
            own_views.push((Key::ViewMission(mission), error));
        }
        own_views.into_iter().map(|(key, value)| (seen(&key), value)).collect()
    }

    /// Returns the requested views. A voter, the robots' nodes and the driver server contribute what this node lacks.
    async fn requested_views(&self, requested: &keyexpr) -> Vec<(Key, Value)> {
        let single = self.views.keys.read(requested.as_str());
        let wanted = |key: &Key| match &single {
            Some(single) => single == key,
            None => self.is_requested(requested, key),
        };
        let mut context = self.context().await;
        context.received_values = self.driver_values_from(self.requested_robots(requested)).await;
        let named = self.named_mission(requested);
        let mut views = context.draw(&wanted, named.as_ref());
        let missions = self.views.keys.write(&Key::ViewMissions).replace("/missions", "/mission/*");
        let needs_ledger = wanted(&Key::ViewMissions)
            || wanted(&Key::ViewRequests)
            || wanted(&Key::ViewSchedules)
            || wanted(&Key::ViewAudit)
            || wanted(&Key::ViewAuctions)
            || wanted(&Key::ViewHealth)
            || views.iter().any(|(key, _)| has_part_of_ledger(key))
            || keyexpr::new(missions.as_str()).is_ok_and(|missions| missions.intersects(requested));
        let lacks_ledger = needs_ledger && !context.status.has_ledger;
        let lacks_motion =
            !self.views.knowledge.receives_motion() && views.iter().any(|(key, _)| self.shows_motion(key));
        if lacks_ledger || lacks_motion {
            let is_lacking = |key: &Key| {
                let of_ledger = is_of_ledger(key) || has_part_of_ledger(key);
                wanted(key) && (lacks_ledger && of_ledger || lacks_motion && self.shows_motion(key))
            };
            let only_health = requested.as_str() == self.views.keys.write(&Key::ViewHealth);
            let is_shown = |key: &Key, view: &Value| match key {
                Key::ViewHealth => only_health,
                key => shows_ledger(key, view) || !lacks_ledger && !has_part_of_ledger(key) && is_lacking(key),
            };
            match self.query_voter(requested, &context.status, &is_shown).await {
                Some(voter_views) => {
                    let is_usable = |key: &Key, view: &Value| {
                        if has_part_of_ledger(key) { shows_ledger(key, view) } else { view.get("error").is_none() }
                    };
                    let contributes = |(key, view): &(Key, Value)| is_lacking(key) && is_usable(key, view);
                    for (key, mut value) in voter_views.into_iter().filter(contributes) {
                        let own = views.iter().position(|(own, _)| *own == key);
                        let is_current = !lacks_motion || !self.shows_motion(&key);
                        if let Some(own) = own.filter(|_| has_part_of_ledger(&key) && is_current) {
                            copy_ledger_part(&key, &value, &mut views[own].1);
                            continue;
                        }
                        if let Some(own) = own {
                            keep_driver_values(&views.remove(own).1, &mut value);
                        }
                        views.push((key, value));
                    }
                }
                None if !lacks_ledger => {}
                None => {
                    let error = ErrorReply::retry_after("no voter of the ledger replies", RETRY_AFTER_MS);
                    let named = named.map(Key::ViewMission);
                    for key in
                        [Key::ViewMissions, Key::ViewRequests, Key::ViewSchedules, Key::ViewAudit, Key::ViewAuctions]
                            .into_iter()
                            .chain(named)
                            .filter(&wanted)
                    {
                        views.push((key, context.with_provenance(&error)));
                    }
                }
            }
        }
        if let Some(Key::ViewEnsemble(name)) = self.views.keys.read(requested.as_str())
            && views.is_empty()
        {
            let view = match self.query_member(&name, &context).await {
                Some(view) => view,
                None => context.with_provenance(ErrorReply::rejected(format!(
                    "no values are exchanged in {name}: it lists none, or no member replies"
                ))),
            };
            views.push((Key::ViewEnsemble(name), view));
        }
        if wanted(&Key::ViewWorld)
            && let Some(world) = self.world().await
        {
            views.push((Key::ViewWorld, context.with_provenance(world)));
        }
        views
    }

    /// Checks whether a view contains places, poses or charges of other robots.
    fn shows_motion(&self, key: &Key) -> bool {
        match key {
            Key::ViewFleet | Key::ViewEnsembles => true,
            Key::ViewRobot(robot) => NodeId::from(robot.clone()) != self.views.node,
            _ => false,
        }
    }

    /// Returns the views that this node lacks from the coordinator, else from any other voter. A voter has what this
    /// node lacks if `is_shown` is true for any of its views: a former voter has no ledger.
    async fn query_voter(
        &self,
        requested: &keyexpr,
        status: &ClusterStatus,
        is_shown: &(impl Fn(&Key, &Value) -> bool + Sync),
    ) -> Option<Vec<(Key, Value)>> {
        let Views { keys, bus, knowledge, node, .. } = &*self.views;
        let coordinator = status.coordinator.iter();
        let others = status.voters.iter().filter(|voter| Some(*voter) != status.coordinator.as_ref());
        let voters = coordinator.chain(others).filter(|voter| *voter != node && knowledge.is_alive(voter));
        for voter in voters.take(VOTERS_QUERIED_MAX) {
            let any = keys.any_seen(voter);
            let seen = match (keys.any_view().strip_suffix("**"), any.strip_suffix("**")) {
                (Some(views), Some(seen)) => requested.as_str().strip_prefix(views).map(|view| format!("{seen}{view}")),
                _ => None,
            };
            let Ok(mut replies) = bus.query(&seen.unwrap_or(any), Bytes::new(), VOTER_TIMEOUT).await else { continue };
            let mut views = vec![];
            while let Some(reply) = replies.recv().await {
                let value = reply.payload.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
                if let (Some(Key::Seen(_, view)), Some(value)) = (keys.read(&reply.key), value) {
                    views.push((*view, value));
                }
            }
            if views.iter().any(|(key, view)| is_shown(key, view)) {
                return Some(views);
            }
        }
        None
    }

    /// Returns the values that the members of an ensemble exchange, from a member.
    async fn query_member(&self, name: &EnsembleId, context: &ViewContext<'_>) -> Option<Value> {
        let Views { keys, bus, knowledge, node, ensembles, clock, .. } = &*self.views;
        let ensemble = ensembles.get(name).filter(|ensemble| !ensemble.spec().exchange.is_empty())?;
        let coordinator = context.status.coordinator.as_ref().unwrap_or(node);
        let members = knowledge.read(|base| ensemble.members(coordinator, base, clock.now()));
        for member in members.into_iter().filter(|member| knowledge.is_alive(member)).take(MEMBERS_QUERIED_MAX) {
            let key = keys.write(&Key::Seen(member, Box::new(Key::ViewEnsemble(name.clone()))));
            let Ok(mut replies) = bus.query(&key, Bytes::new(), MEMBER_TIMEOUT).await else { continue };
            let view = replies.recv().await.and_then(|reply| serde_json::from_slice(&reply.payload.ok()?).ok());
            if view.is_some() {
                return view;
            }
        }
        None
    }

    async fn world(&self) -> Option<Map<String, Value>> {
        let key = self.views.keys.write(&Key::World);
        let mut replies = self.views.bus.query(&key, Bytes::new(), WORLD_TIMEOUT).await.ok()?;
        serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()
    }

    async fn context(&self) -> ViewContext<'_> {
        let coordinator_status = match &self.views.coordinator {
            Some(coordinator) => {
                let (to, status) = oneshot::channel();
                // An inactive coordinator drops the query.
                match coordinator.cast(CoordinatorMessage::QueryStatus(to)) {
                    Ok(()) => tokio::time::timeout(STATUS_TIMEOUT, status).await.ok().and_then(Result::ok),
                    Err(_) => None,
                }
            }
            None => None,
        };
        let now = self.views.clock.now();
        ViewContext {
            views: &self.views,
            status: self.status(coordinator_status, now),
            linearizable: false,
            received_values: BTreeMap::new(),
            copies: Copies::default(),
            now,
        }
    }

    fn status(&self, coordinator_status: Option<CoordinatorStatus>, now: NodeTime) -> ClusterStatus {
        let Views { node, knowledge, replica, beacon_interval, .. } = &*self.views;
        let latest_beacon = self.latest_beacon.lock().unwrap_or_else(PoisonError::into_inner).latest().cloned();
        let leadership = replica.as_ref().map(|replica| replica.leadership().borrow().clone()).unwrap_or_default();
        let last_beacon = latest_beacon.as_ref().map(|(beacon, at)| (beacon, now.since(*at)));
        let own_id = replica.as_ref().map(Replica::id);
        let is_member = |id: &RaftId| leadership.voters.contains_key(id) || leadership.learners.contains_key(id);
        // A voter that was replaced while it was away does not know it; the beacon shows it.
        let is_listed = last_beacon.is_none_or(|(beacon, _)| {
            beacon.voters.contains(node) || leadership.learners.values().any(|learner| learner == node)
        });
        // An entry that a leader commits in its own term follows all entries committed before. A
        // copy with such an entry is complete; a restarted copy may lack any entry.
        let is_complete = last_beacon.zip(replica.as_ref()).is_some_and(|((beacon, _), replica)| {
            let applied = *replica.applied().borrow();
            applied.term >= beacon.term
        });
        let is_current_member = own_id.as_ref().is_some_and(is_member) && is_listed;
        let has_ledger = coordinator_status.is_some() || is_current_member && is_complete;
        let mut status = ClusterStatus {
            has_ledger,
            learners: leadership.learners.values().cloned().collect(),
            quorum_age_ms: replica.as_ref().and_then(Replica::quorum_ack_age).map(millis),
            ..ClusterStatus::default()
        };
        match (coordinator_status, last_beacon) {
            (Some(coordinator_status), _) => {
                status.coordinator = Some(node.clone());
                (status.term, status.since_ms, status.age_ms) =
                    (coordinator_status.term, Some(coordinator_status.since_ms), Some(0));
                status.autopilot = Some(coordinator_status.autopilot);
            }
            (None, Some((beacon, age))) => {
                let is_active = beacon.node != *node
                    && knowledge.is_alive(&beacon.node)
                    && age < *beacon_interval * MISSED_BEACONS_MAX;
                status.term = beacon.term;
                status.age_ms = Some(millis(age));
                if is_active {
                    status.coordinator = Some(beacon.node.clone());
                    status.since_ms = Some(beacon.since_ms.saturating_add(millis(age)));
                }
            }
            (None, None) => status.term = leadership.term,
        }
        let from_beacon = || last_beacon.map(|(beacon, _)| beacon.voters.iter().cloned().collect()).unwrap_or_default();
        status.voters = if has_ledger { leadership.voters.values().cloned().collect() } else { from_beacon() };
        // A node that came back with an empty store is not the same member as the voter of its
        // name.
        status.voters_lost = knowledge.read(|base| {
            let known_replica = |node: &NodeId| base.get(node).map(|stored| stored.record.knowledge.replica);
            if has_ledger {
                let lost = leadership.voters.iter().filter(|(id, voter)| known_replica(voter) != Some(Some(id.0)));
                lost.map(|(_, voter)| voter.clone()).collect::<Vec<_>>()
            } else {
                status.voters.iter().filter(|voter| known_replica(voter).is_none()).cloned().collect()
            }
        });
        status.voters_lost.sort();
        status.voters_lost.dedup();
        status
    }
}

/// Copies the values of the driver to the view that a voter has computed. A voter does not receive these values;
/// `own` is the view of this node.
fn keep_driver_values(own: &Value, of_voter: &mut Value) {
    for field in ["readings", "feedback"] {
        if let (Some(value), Some(view)) = (own.get(field), of_voter.as_object_mut()) {
            view.insert(field.to_owned(), value.clone());
        }
    }
}
