//! Leader session: state and work of a node from the start to the end of its term as coordinator.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::api::ApiHandler;
use super::change_feed::MissionSnapshot;
use super::last_known_place::{foreign_clusters, last_known_place, last_known_places};
use super::no_leader::busy_reply;
use super::rate_limit::RequestLimiter;
use super::reconcile::{AuctionRound, CoordinatorAction, RoundPhase, SessionState, awards_in_force, pending_actions};
use super::reports::ReportHandler;
use super::stall_detector::{StallDetector, StalledRole};
use crate::autopilot::{ActionResult, Autopilot, perform};
use crate::views::CoordinatorStatus;
use bytes::Bytes;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{BusError, Delivery, Encoding, PresenceToken, Query};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::lease::{Award, Epoch, LeaseMonitor};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, MissionEntry};
use consort_protocol::message::{ActiveMissions, ActivePlan, AwardNotice, AwardReply, Beacon, Report};
use consort_protocol::mission::RoleKind;
use consort_protocol::units::NodeTime;
use consort_protocol::versions::VersionRange;
use consort_raft::LeadershipView;
use ractor::ActorRef;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, error, info, warn};

/// Timeout for the ledger to commit the release of a role or the end of a mission.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(1);

/// Timeout for the ledger to commit its cluster id.
const BOOTSTRAP_TIMEOUT: Duration = Duration::from_secs(2);

/// Delay before the failure of a mission is proposed again.
const FAIL_RETRY_DELAY: Duration = Duration::from_secs(2);

/// State of a single term as coordinator. Dropping it withdraws all declarations and aborts all
/// tasks.
pub(super) struct LeaderSession {
    pub(super) term: u64,
    since: NodeTime,
    /// Start of the session by the node's wall clock, in milliseconds. Distinguishes the sessions
    /// of a term.
    since_wall_ms: u64,
    pub(super) lease_monitor: SharedLeaseMonitor,
    pub(super) rounds: BTreeMap<MissionId, AuctionRound>,
    stall_detector: StallDetector,
    /// Roles to be released because their holders reply but make no progress, once the leases have
    /// expired.
    stalled: BTreeMap<(Epoch, RoleId), String>,
    /// Missions with a proposed failure, with the time of the proposal.
    failing: BTreeMap<MissionId, NodeTime>,
    notified: BTreeMap<(Epoch, RoleId), NodeTime>,
    /// Last published state of each mission, to detect changes.
    pub(super) mission_snapshots: BTreeMap<MissionId, MissionSnapshot>,
    members: BTreeSet<NodeId>,
    /// Members that are free by their own record.
    free: BTreeSet<NodeId>,
    requests: u64,
    request_limiter: RequestLimiter,
    autopilot: Autopilot,
    /// Other clusters with the name of this fleet, each with a node of it.
    foreign: BTreeMap<ClusterId, NodeId>,
    pub(super) tasks: Tasks,
    _token: PresenceToken,
}

/// Leases in force. Reports renew them and `reconcile` ends them, so access is shared.
pub(super) type SharedLeaseMonitor = Arc<Mutex<LeaseMonitor>>;

pub(super) fn lock_monitor(lease_monitor: &SharedLeaseMonitor) -> MutexGuard<'_, LeaseMonitor> {
    // A panic under the lock leaves no partial write, because each write is a single step.
    lease_monitor.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LeaderSession {
    pub(super) async fn start(
        settings: &CoordinatorSettings,
        leadership: &LeadershipView,
        term: u64,
        yielded: Option<Instant>,
        myself: &ActorRef<CoordinatorMessage>,
    ) -> Result<LeaderSession, BusError> {
        let CoordinatorSettings { node, keys, bus, .. } = settings;
        let mut tasks = Tasks::default();
        let report = keys.write(&Key::Report(node.clone()));
        tasks.forward(bus.serve(&report).await?, myself, CoordinatorMessage::Report);
        tasks.forward(
            bus.serve(&keys.write(&Key::ActiveMissions(node.clone()))).await?,
            myself,
            CoordinatorMessage::ActiveMissions,
        );
        let token = bus.announce(&keys.write(&Key::AliveCoordinator(term, node.clone()))).await?;
        let since = settings.clock.now();
        info!(%node, term, "started to coordinate");
        let voters = leadership.voters.values().cloned().collect();
        settings.events.publish(EventKind::Elected { term, voters });
        if settings.replica.cluster().borrow().is_none() {
            let (replica, cluster) = (settings.replica.clone(), ClusterId(settings.cluster_seed));
            let wire = first_version(settings);
            tasks.spawn(async move {
                // On failure this node no longer leads, and the next leader retries.
                match replica.propose(Command::Bootstrap { cluster }, BOOTSTRAP_TIMEOUT).await {
                    Ok(_) => info!(%cluster, "founded the ledger"),
                    Err(problem) => debug!(%cluster, %problem, "did not found the ledger"),
                }
                if let Err(problem) = replica.propose(Command::RaiseWireVersion { wire }, BOOTSTRAP_TIMEOUT).await {
                    debug!(%problem, "wire version was not recorded");
                }
            });
        } else if settings.replica.read(Ledger::wire).is_none() {
            // The founder died before this proposal. Until then, no node has written more than the
            // first version, which every node reads.
            propose(settings, &mut tasks, Command::RaiseWireVersion { wire: codec::FIRST_VERSION });
        }
        // Entries that were in the ledger before this session are not reported as changes.
        let mission_snapshots = settings.replica.read(|ledger| {
            ledger.missions().map(|entry| (entry.id.clone(), MissionSnapshot::of(entry, since))).collect()
        });
        Ok(LeaderSession {
            term,
            since,
            since_wall_ms: settings.clock.wall_ms(),
            lease_monitor: Arc::new(Mutex::new(LeaseMonitor::new(settings.lease_terms))),
            rounds: BTreeMap::new(),
            stall_detector: StallDetector::new(settings.stall_timeout),
            stalled: BTreeMap::new(),
            failing: BTreeMap::new(),
            notified: BTreeMap::new(),
            mission_snapshots,
            members: BTreeSet::new(),
            free: BTreeSet::new(),
            requests: 0,
            request_limiter: RequestLimiter::new(settings.request_limits, since),
            autopilot: Autopilot::new(settings.voters, settings.dead_after, settings.contact_timeout, yielded),
            foreign: BTreeMap::new(),
            tasks,
            _token: token,
        })
    }

    /// Returns the time at which this node last transferred leadership to a better placed node.
    pub(super) fn yielded_at(&self) -> Option<Instant> {
        self.autopilot.last_transfer_at()
    }

    /// Publishes the beacon and performs all periodic work.
    pub(super) async fn tick(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let (cluster, wire) = settings.replica.read(|ledger| (ledger.cluster(), ledger.wire()));
        settings.wire_version.adopt(cluster, wire);
        self.publish_beacon(settings).await;
        self.update_members(settings);
        self.report_foreign_clusters(settings);
        self.start_voter_change(settings, myself);
        self.reconcile(settings, myself);
    }

    /// Publishes the beacon: the node, term and voters of this coordinator.
    pub(super) async fn publish_beacon(&self, settings: &CoordinatorSettings) {
        let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        let cluster = *settings.replica.cluster().borrow();
        let wire = settings.replica.read(Ledger::wire);
        let beacon = Beacon { node: settings.node.clone(), term: self.term, voters, since_ms, cluster, wire };
        publish(settings, &Key::Beacon, &beacon).await;
    }

    /// Reports each other cluster with the name of this fleet, once.
    fn report_foreign_clusters(&mut self, settings: &CoordinatorSettings) {
        let Some(own) = *settings.replica.cluster().borrow() else { return };
        let foreign = foreign_clusters(&settings.knowledge, Some(own));
        for (cluster, node) in &foreign {
            if !self.foreign.contains_key(cluster) {
                error!(%own, foreign = %cluster, %node, "another cluster with this fleet's name was founded separately: \
                    they do not merge. Stop the nodes of either cluster and restart them with empty stores");
                let (cluster, foreign, member) = (own, *cluster, node.clone());
                settings.events.publish(EventKind::Foreign { cluster, foreign, member });
            }
        }
        // A reported cluster is not reported again, although views show it only while its records
        // arrive.
        self.foreign.extend(foreign);
    }

    /// Starts the voter change that is due.
    fn start_voter_change(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let Some(change) = self.autopilot.next_action(&settings.replica, &settings.knowledge) else { return };
        info!(reason = change.reason(), "changing the voters");
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let done = perform(replica, change).await;
            // If the coordinator has stopped, the next coordinator completes a change in progress.
            let _ = to.cast(CoordinatorMessage::VotersChanged(done));
        });
    }

    pub(super) fn handle_voters_changed(&mut self, settings: &CoordinatorSettings, done: ActionResult) {
        match self.autopilot.complete(done) {
            Ok(reason) => {
                let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
                settings.events.publish(EventKind::Voters { voters, reason });
            }
            Err((reason, problem)) => warn!(reason, %problem, "voters were not changed"),
        }
    }

    /// Publishes changes of the ensemble's membership, as far as this coordinator has received
    /// them.
    pub(super) fn update_members(&mut self, settings: &CoordinatorSettings) {
        let now = settings.clock.now();
        let ensemble = settings.ensemble.spec().name.clone();
        let members = live_members(settings, now);
        for member in members.difference(&self.members) {
            settings.events.publish(EventKind::Joined { ensemble: ensemble.clone(), member: member.clone() });
        }
        for member in self.members.difference(&members) {
            let membership =
                settings.knowledge.read(|base| settings.ensemble.membership_of(member, &settings.node, base, now));
            let reason = if membership.member { "judged dead".to_owned() } else { membership.reason };
            settings.events.publish(EventKind::Left { ensemble: ensemble.clone(), member: member.clone(), reason });
        }
        let free = settings.knowledge.read(|base| {
            let is_free = |node: &&NodeId| base.get(node).is_some_and(|stored| stored.record.knowledge.is_free());
            members.iter().filter(is_free).cloned().collect::<BTreeSet<_>>()
        });
        if !free.is_subset(&self.free) {
            // A robot is free: auctions that wait for a robot skip the rest of their backoff.
            for round in self.rounds.values_mut() {
                if let RoundPhase::BackingOff { until, .. } = &mut round.phase {
                    *until = now;
                }
            }
        }
        self.free = free;
        self.members = members;
    }

    /// Compares the ledger with the session, publishes changes and performs the pending actions.
    pub(super) fn reconcile(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let now = settings.clock.now();
        self.publish_changes(settings, now);
        let wall_ms = settings.clock.wall_ms();
        let actions = settings.replica.read(|ledger| {
            let mut lease_monitor = lock_monitor(&self.lease_monitor);
            let awards = awards_in_force(ledger);
            for (epoch, robot) in &awards {
                lease_monitor.track(*epoch, robot, now);
            }
            let epochs = awards.into_iter().map(|(epoch, _)| epoch).collect();
            lease_monitor.retain(&epochs, now);
            self.notified.retain(|(epoch, _), _| epochs.contains(epoch));
            self.stalled.retain(|(epoch, _), _| epochs.contains(epoch));
            self.mission_snapshots.retain(|mission, _| ledger.mission(mission).is_some());
            self.rounds.retain(|mission, round| {
                let entry = ledger.mission(mission).filter(|entry| !entry.state.is_final());
                entry.inspect(|entry| round.follow_branch(entry.branch, now)).is_some()
            });
            self.failing.retain(|mission, _| ledger.mission(mission).is_some_and(|entry| !entry.state.is_final()));
            for StalledRole { role, robot, epoch, cause } in self.stall_detector.check(ledger, now) {
                lease_monitor.stop_renewing(epoch, &robot, now);
                self.stalled.entry((epoch, role)).or_insert(cause);
            }
            let session_state =
                SessionState { lease_monitor: &lease_monitor, rounds: &self.rounds, notified: &self.notified };
            let actions = pending_actions(ledger, &session_state, now, wall_ms);
            for action in &actions {
                if let CoordinatorAction::ReleaseRole { epoch, robot, .. } = action {
                    lease_monitor.stop_renewing(*epoch, robot, now);
                }
            }
            actions
        });
        for action in actions {
            match action {
                CoordinatorAction::CallForBids(mission) => self.call_for_bids(settings, myself, &mission, now),
                CoordinatorAction::NotifyAward { mission, role, robot, epoch } => {
                    self.notify_award(settings, myself, mission, role, robot, epoch, now);
                }
                CoordinatorAction::ReleaseRole { mission, role, robot, epoch, cause } => {
                    let stalled = self.stalled.get(&(epoch, role.clone())).cloned();
                    let (robot_failed, cause) = (stalled.is_some(), stalled.unwrap_or(cause));
                    self.release_role(settings, mission, role, &robot, epoch, cause, robot_failed);
                }
                CoordinatorAction::FailMission { mission, cause } => {
                    if self.failing.get(&mission).is_none_or(|at| now.since(*at) >= FAIL_RETRY_DELAY) {
                        self.failing.insert(mission.clone(), now);
                        let places = settings
                            .replica
                            .read(|ledger| last_known_places(&settings.knowledge, ledger.mission(&mission)));
                        propose(settings, &mut self.tasks, Command::Fail { mission, cause, branch: None, places });
                    }
                }
            }
        }
        self.clear_auctions(settings, myself);
    }

    #[expect(clippy::too_many_arguments, reason = "the parameters name an award and the time")]
    fn notify_award(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: MissionId,
        role: RoleId,
        robot: RobotId,
        epoch: Epoch,
        now: NodeTime,
    ) {
        let award = settings.replica.read(|ledger| {
            let entry = ledger.mission(&mission)?;
            let (plan, holders) = (entry.plan(&role)?.clone(), entry.role_holders());
            Some(Award { mission: mission.clone(), role: role.clone(), robot: robot.clone(), epoch, plan, holders })
        });
        let Some(award) = award else { return };
        self.notified.insert((epoch, role.clone()), now);
        let (to, notified_robot) = (myself.clone(), robot.clone());
        self.notify(settings, &robot, AwardNotice::Awarded(Box::new(award)), move |reply| {
            // If the coordinator has stopped, the next coordinator sends the award notice.
            let _ = to.cast(CoordinatorMessage::NoticeReplied { mission, role, robot: notified_robot, epoch, reply });
        });
    }

    pub(super) fn notify(
        &mut self,
        settings: &CoordinatorSettings,
        robot: &RobotId,
        notice: AwardNotice,
        then: impl FnOnce(AwardReply) + Send + 'static,
    ) {
        let key = settings.keys.write(&Key::Award(robot.clone()));
        let bytes = match codec::encode(&notice) {
            Ok(bytes) => Bytes::from(bytes),
            Err(problem) => return warn!(%robot, %problem, "award notice does not fit a message"),
        };
        let (bus, robot) = (settings.bus.clone(), robot.clone());
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
            match replies.recv().await.map(|reply| reply.payload.map(|bytes| codec::decode(&bytes))) {
                Some(Ok(Ok(reply))) => then(reply),
                other => debug!(%robot, ?other, "award notice got no reply"),
            }
        });
    }

    #[expect(clippy::too_many_arguments, reason = "the parameters name an award and the reason for its end")]
    pub(super) fn release_role(
        &mut self,
        settings: &CoordinatorSettings,
        mission: MissionId,
        role: RoleId,
        robot: &RobotId,
        epoch: Epoch,
        cause: String,
        robot_failed: bool,
    ) {
        let place = last_known_place(&settings.knowledge, robot);
        let command = Command::Release { mission, role, epoch, cause, robot_failed, place };
        propose(settings, &mut self.tasks, command);
    }

    pub(super) async fn handle_report(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(report) = reply::decode_or_refuse::<Report>(&query).await else { return };
        let handler = ReportHandler {
            replica: settings.replica.clone(),
            knowledge: settings.knowledge.clone(),
            leadership_age_max: settings.lease_terms.leadership_age_max(),
            clock: settings.clock,
            lease_monitor: self.lease_monitor.clone(),
        };
        self.tasks.spawn(async move {
            let reply = handler.handle(report).await;
            reply::wire(&query, &query.key, &reply).await;
        });
    }

    pub(super) async fn handle_active_missions(&mut self, settings: &CoordinatorSettings, query: Query) {
        let (parts, too_large) = settings.replica.read(|ledger| {
            ActiveMissions::split(
                ledger.cluster(),
                ledger.active_missions().into_iter().flat_map(unmanaged_plans).collect(),
            )
        });
        for ActivePlan { mission, plan, .. } in too_large {
            warn!(%mission, role = %plan.role, "plan does not fit a message: the role cannot be executed");
        }
        for part in parts {
            reply::wire(&query, &query.key, &part).await;
        }
    }

    pub(super) fn handle_api(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(Key::Api(call)) = settings.keys.read(&query.key) else {
            let asked = query.key.rsplit('/').next().unwrap_or_default();
            let calls = ApiCall::ALL.iter().map(|call| call.as_str()).collect::<Vec<_>>().join(", ");
            let error = format!("no such request: {asked}; there are {calls}");
            self.tasks.spawn(async move { reply::json(&query, &query.key, &json!({ "error": error })).await });
            return;
        };
        if let Err(after) = self.request_limiter.try_acquire(settings.clock.now()) {
            let reply = busy_reply("too many requests per second", after);
            self.tasks.spawn(async move { reply::json(&query, &query.key, &reply).await });
            return;
        }
        self.requests += 1;
        let handler = ApiHandler {
            fleet: settings.keys.fleet().clone(),
            node: settings.node.clone(),
            replica: settings.replica.clone(),
            knowledge: settings.knowledge.clone(),
            domain: Arc::clone(&settings.domain),
            request_prefix: format!(
                "unnamed-{}-{:x}-{}",
                self.term,
                self.since_wall_ms,
                settings.node.as_str().chars().take(20).collect::<String>()
            ),
            at_ms: settings.clock.wall_ms(),
            request_number: self.requests,
            missions_max: settings.request_limits.missions_max,
        };
        self.tasks.spawn(async move {
            let reply = handler.handle(call, &query.payload).await;
            reply::json(&query, &query.key, &reply).await;
        });
    }

    /// Returns the status of this session.
    pub(super) fn status(&self, settings: &CoordinatorSettings) -> CoordinatorStatus {
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        CoordinatorStatus { term: self.term, since_ms, autopilot: self.autopilot.status() }
    }
}

/// Returns the wire version of a newly founded fleet: the newest, unless a known node cannot read
/// it.
fn first_version(settings: &CoordinatorSettings) -> u8 {
    let VersionRange { oldest, newest } = VersionRange::own();
    let read_by_all = settings
        .knowledge
        .read(|base| base.iter().all(|(_, stored)| stored.record.knowledge.supported_versions.contains(newest)));
    if read_by_all { newest } else { oldest }
}

/// Proposes a command in the background. The ledger shows its outcome.
pub(super) fn propose(settings: &CoordinatorSettings, tasks: &mut Tasks, command: Command) {
    let replica = settings.replica.clone();
    tasks.spawn(async move {
        let outcome = replica.propose(command.clone(), RELEASE_TIMEOUT).await;
        if !matches!(outcome, Ok(CommandOutcome::Done)) {
            debug!(?command, ?outcome, "proposal was not applied");
        }
    });
}

/// Returns the members of the ensemble that are alive.
pub(super) fn live_members(settings: &CoordinatorSettings, now: NodeTime) -> BTreeSet<NodeId> {
    let members = settings.knowledge.read(|base| settings.ensemble.members(&settings.node, base, now));
    let own = *settings.replica.cluster().borrow();
    let own_members = settings.knowledge.read(|base| {
        let own_members = |node: &NodeId| {
            let cluster = base.get(node).and_then(|stored| stored.record.knowledge.cluster);
            cluster.is_none() || own.is_none() || cluster == own
        };
        members.into_iter().filter(own_members).collect::<Vec<_>>()
    });
    own_members.into_iter().filter(|node| settings.knowledge.is_alive(node)).collect()
}

fn unmanaged_plans(entry: &MissionEntry) -> Vec<ActivePlan> {
    let roles = entry.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
    roles
        .filter_map(|(id, role)| {
            let (mission, plan) = (entry.id.clone(), entry.plan(id)?.clone());
            let (branch, holders, vacant, signals) =
                (entry.branch, entry.role_holders(), entry.open_roles(), entry.signals_to(id));
            Some(ActivePlan { mission, branch, plan, ended: role.ended.clone(), holders, vacant, signals })
        })
        .collect()
}

pub(super) async fn publish<T: serde::Serialize>(settings: &CoordinatorSettings, key: &Key, message: &T) {
    let bytes = Bytes::from(codec::encode(message).expect("a beacon fits a message"));
    let key = settings.keys.write(key);
    if let Err(problem) = settings.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
        debug!(%problem, key, "not published");
    }
}
