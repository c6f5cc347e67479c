//! One reign: what a node does, and remembers, from taking over until it no longer coordinates.

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
use crate::bus::{BusError, Delivery, Encoding, PresenceToken, Query};
use crate::raft::LeadershipView;
use crate::reply;
use crate::tasks::Tasks;
use crate::views::CoordinatorStatus;
use bytes::Bytes;
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
use ractor::ActorRef;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, error, info, warn};

/// How long the ledger may take to accept that a role or a mission is given up.
const GIVE_UP_LIMIT: Duration = Duration::from_secs(1);

/// How long the ledger may take to accept its identity.
const FOUND_LIMIT: Duration = Duration::from_secs(2);

/// How long to wait before a mission that should have been given up is given up again.
const FAIL_AGAIN: Duration = Duration::from_secs(2);

/// What lasts as long as this node coordinates. Dropping it withdraws all declarations and ends all work under way.
pub(super) struct LeaderSession {
    pub(super) term: u64,
    since: NodeTime,
    /// When this node began to coordinate, by its wall clock in milliseconds: no other reign of its term did then.
    since_wall_ms: u64,
    pub(super) lease_monitor: SharedLeaseMonitor,
    pub(super) rounds: BTreeMap<MissionId, AuctionRound>,
    pace: StallDetector,
    /// Roles to be taken from holders that answer and do not get on, once their leases have run out.
    stalled: BTreeMap<(Epoch, RoleId), String>,
    /// Missions that are being given up, and since when.
    failing: BTreeMap<MissionId, NodeTime>,
    told: BTreeMap<(Epoch, RoleId), NodeTime>,
    /// How missions stood when last looked at, to tell what has changed.
    pub(super) mission_snapshots: BTreeMap<MissionId, MissionSnapshot>,
    members: BTreeSet<NodeId>,
    /// Those of them that say they are free.
    free: BTreeSet<NodeId>,
    requests: u64,
    intake: RequestLimiter,
    autopilot: Autopilot,
    /// Other clusters of this fleet's name, and a node of each.
    foreign: BTreeMap<ClusterId, NodeId>,
    pub(super) tasks: Tasks,
    _token: PresenceToken,
}

/// Which leases run, for those who renew them and those who end them.
pub(super) type SharedLeaseMonitor = Arc<Mutex<LeaseMonitor>>;

pub(super) fn lock_monitor(watch: &SharedLeaseMonitor) -> MutexGuard<'_, LeaseMonitor> {
    // A panic under the lock has not left it half written: writes are single steps.
    watch.lock().unwrap_or_else(PoisonError::into_inner)
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
        info!(%node, term, "coordinates");
        let voters = leadership.voters.values().cloned().collect();
        settings.events.publish(EventKind::Elected { term, voters });
        if settings.replica.cluster().borrow().is_none() {
            let (replica, cluster) = (settings.replica.clone(), ClusterId(settings.cluster_seed));
            let wire = first_version(settings);
            tasks.spawn(async move {
                // Should it fail, this node no longer leads, and the next one does it.
                match replica.propose(Command::Bootstrap { cluster }, FOUND_LIMIT).await {
                    Ok(_) => info!(%cluster, "founded the ledger"),
                    Err(problem) => debug!(%cluster, %problem, "did not found the ledger"),
                }
                if let Err(problem) = replica.propose(Command::RaiseWireVersion { wire }, FOUND_LIMIT).await {
                    debug!(%problem, "did not say which version of the wire the fleet writes");
                }
            });
        } else if settings.replica.read(Ledger::wire).is_none() {
            // Whoever founded it died before it said this; then nobody has written more than what everybody reads.
            propose(settings, &mut tasks, Command::RaiseWireVersion { wire: codec::FIRST_VERSION });
        }
        // What stood in the ledger before this reign is not news.
        let seen = settings.replica.read(|ledger| {
            ledger.missions().map(|entry| (entry.id.clone(), MissionSnapshot::of(entry, since))).collect()
        });
        Ok(LeaderSession {
            term,
            since,
            since_wall_ms: settings.clock.wall_ms(),
            lease_monitor: Arc::new(Mutex::new(LeaseMonitor::new(settings.lease_terms))),
            rounds: BTreeMap::new(),
            pace: StallDetector::new(settings.stall_timeout),
            stalled: BTreeMap::new(),
            failing: BTreeMap::new(),
            told: BTreeMap::new(),
            mission_snapshots: seen,
            members: BTreeSet::new(),
            free: BTreeSet::new(),
            requests: 0,
            intake: RequestLimiter::new(settings.request_limits, since),
            autopilot: Autopilot::new(settings.voters, settings.dead_after, settings.contact_timeout, yielded),
            foreign: BTreeMap::new(),
            tasks,
            _token: token,
        })
    }

    /// When this node last gave the lead away because another was better placed.
    pub(super) fn yielded_at(&self) -> Option<Instant> {
        self.autopilot.last_transfer_at()
    }

    /// Says that this node coordinates, and looks after everything.
    pub(super) async fn tick(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let (cluster, wire) = settings.replica.read(|ledger| (ledger.cluster(), ledger.wire()));
        settings.wire_version.adopt(cluster, wire);
        self.publish_beacon(settings).await;
        self.update_members(settings);
        self.look_abroad(settings);
        self.keep_keepers(settings, myself);
        self.reconcile(settings, myself);
    }

    /// Tells everybody who coordinates.
    pub(super) async fn publish_beacon(&self, settings: &CoordinatorSettings) {
        let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        let cluster = *settings.replica.cluster().borrow();
        let wire = settings.replica.read(Ledger::wire);
        let beacon = Beacon { node: settings.node.clone(), term: self.term, voters, since_ms, cluster, wire };
        publish(settings, &Key::Beacon, &beacon).await;
    }

    /// Says so once when there is another cluster of this fleet's name.
    fn look_abroad(&mut self, settings: &CoordinatorSettings) {
        let Some(own) = *settings.replica.cluster().borrow() else { return };
        let foreign = foreign_clusters(&settings.knowledge, Some(own));
        for (cluster, node) in &foreign {
            if !self.foreign.contains_key(cluster) {
                error!(%own, foreign = %cluster, %node, "another cluster of this fleet's name was founded apart: they do not \
                    merge. Stop the nodes of one of them and start them again with empty stores");
                let (cluster, foreign, member) = (own, *cluster, node.clone());
                settings.events.publish(EventKind::Foreign { cluster, foreign, member });
            }
        }
        // Once told, a cluster stays told of, though it is shown only while it is heard of.
        self.foreign.extend(foreign);
    }

    /// Makes the change of the ledger's keepers that is due.
    fn keep_keepers(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let Some(change) = self.autopilot.next_action(&settings.replica, &settings.knowledge) else { return };
        info!(reason = change.reason(), "changes who keeps the ledger");
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let done = perform(replica, change).await;
            // A coordinator that has stopped leaves a change that was begun to the next one.
            let _ = to.cast(CoordinatorMessage::VotersChanged(done));
        });
    }

    pub(super) fn handle_voters_changed(&mut self, settings: &CoordinatorSettings, done: ActionResult) {
        match self.autopilot.complete(done) {
            Ok(reason) => {
                let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
                settings.events.publish(EventKind::Voters { voters, reason });
            }
            Err((reason, problem)) => warn!(reason, %problem, "who keeps the ledger was not changed"),
        }
    }

    /// Tells who joined and left the ensemble, as far as this coordinator has heard.
    pub(super) fn update_members(&mut self, settings: &CoordinatorSettings) {
        let now = settings.clock.now();
        let ensemble = settings.ensemble.spec().name.clone();
        let members = live_members(settings, now);
        for member in members.difference(&self.members) {
            settings.events.publish(EventKind::Joined { ensemble: ensemble.clone(), member: member.clone() });
        }
        for member in self.members.difference(&members) {
            let verdict =
                settings.knowledge.read(|base| settings.ensemble.membership_of(member, &settings.node, base, now));
            let reason = if verdict.member { "judged dead".to_owned() } else { verdict.reason };
            settings.events.publish(EventKind::Left { ensemble: ensemble.clone(), member: member.clone(), reason });
        }
        let free = settings.knowledge.read(|base| {
            let is_free = |node: &&NodeId| base.get(node).is_some_and(|heard| heard.record.knowledge.is_free());
            members.iter().filter(is_free).cloned().collect::<BTreeSet<_>>()
        });
        if !free.is_subset(&self.free) {
            // Those who wait for a robot need not sit out their back-off.
            for round in self.rounds.values_mut() {
                if let RoundPhase::BackingOff { until, .. } = &mut round.phase {
                    *until = now;
                }
            }
        }
        self.free = free;
        self.members = members;
    }

    /// Looks at the ledger, tells what is new in it, and does what is to be done.
    pub(super) fn reconcile(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let now = settings.clock.now();
        self.publish_changes(settings, now);
        let wall_ms = settings.clock.wall_ms();
        let todo = settings.replica.read(|ledger| {
            let mut watch = lock_monitor(&self.lease_monitor);
            let awards = awards_in_force(ledger);
            for (epoch, robot) in &awards {
                watch.track(*epoch, robot, now);
            }
            let epochs = awards.into_iter().map(|(epoch, _)| epoch).collect();
            watch.retain(&epochs, now);
            self.told.retain(|(epoch, _), _| epochs.contains(epoch));
            self.stalled.retain(|(epoch, _), _| epochs.contains(epoch));
            self.mission_snapshots.retain(|mission, _| ledger.mission(mission).is_some());
            self.rounds.retain(|mission, round| {
                let entry = ledger.mission(mission).filter(|entry| !entry.state.is_final());
                entry.inspect(|entry| round.follow_branch(entry.branch, now)).is_some()
            });
            self.failing.retain(|mission, _| ledger.mission(mission).is_some_and(|entry| !entry.state.is_final()));
            for StalledRole { role, robot, epoch, cause } in self.pace.check(ledger, now) {
                watch.stop_renewing(epoch, &robot, now);
                self.stalled.entry((epoch, role)).or_insert(cause);
            }
            let memory = SessionState { lease_monitor: &watch, rounds: &self.rounds, notified: &self.told };
            let todo = pending_actions(ledger, &memory, now, wall_ms);
            for duty in &todo {
                if let CoordinatorAction::ReleaseRole { epoch, robot, .. } = duty {
                    watch.stop_renewing(*epoch, robot, now);
                }
            }
            todo
        });
        for duty in todo {
            match duty {
                CoordinatorAction::CallForBids(mission) => self.call_for_bids(settings, myself, &mission, now),
                CoordinatorAction::NotifyAward { mission, role, robot, epoch } => {
                    self.tell(settings, myself, mission, role, robot, epoch, now);
                }
                CoordinatorAction::ReleaseRole { mission, role, robot, epoch, cause } => {
                    let stalled = self.stalled.get(&(epoch, role.clone())).cloned();
                    let (blamed, cause) = (stalled.is_some(), stalled.unwrap_or(cause));
                    self.release_role(settings, mission, role, &robot, epoch, cause, blamed);
                }
                CoordinatorAction::FailMission { mission, cause } => {
                    if self.failing.get(&mission).is_none_or(|at| now.since(*at) >= FAIL_AGAIN) {
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

    #[expect(clippy::too_many_arguments, reason = "they name one award and the moment")]
    fn tell(
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
        self.told.insert((epoch, role.clone()), now);
        let (to, who) = (myself.clone(), robot.clone());
        self.notify(settings, &robot, AwardNotice::Awarded(Box::new(award)), move |answer| {
            // A coordinator that has stopped leaves the award to the next one.
            let _ = to.cast(CoordinatorMessage::NoticeReplied { mission, role, robot: who, epoch, reply: answer });
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
            Err(problem) => return warn!(%robot, %problem, "a notice does not fit a message"),
        };
        let (bus, robot) = (settings.bus.clone(), robot.clone());
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
            match replies.recv().await.map(|reply| reply.payload.map(|bytes| codec::decode(&bytes))) {
                Some(Ok(Ok(answer))) => then(answer),
                other => debug!(%robot, ?other, "a notice was not answered"),
            }
        });
    }

    #[expect(clippy::too_many_arguments, reason = "they name one award and why it ends")]
    pub(super) fn release_role(
        &mut self,
        settings: &CoordinatorSettings,
        mission: MissionId,
        role: RoleId,
        robot: &RobotId,
        epoch: Epoch,
        cause: String,
        blamed: bool,
    ) {
        let place = last_known_place(&settings.knowledge, robot);
        let command = Command::Release { mission, role, epoch, cause, robot_failed: blamed, place };
        propose(settings, &mut self.tasks, command);
    }

    pub(super) async fn handle_report(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(report) = reply::decode_or_refuse::<Report>(&query).await else { return };
        let clerk = ReportHandler {
            replica: settings.replica.clone(),
            knowledge: settings.knowledge.clone(),
            leadership_age_max: settings.lease_terms.leadership_age_max(),
            clock: settings.clock,
            lease_monitor: self.lease_monitor.clone(),
        };
        self.tasks.spawn(async move {
            let said = clerk.handle(report).await;
            reply::wire(&query, &query.key, &said).await;
        });
    }

    pub(super) async fn handle_active_missions(&mut self, settings: &CoordinatorSettings, query: Query) {
        let (parts, unfit) = settings.replica.read(|ledger| {
            ActiveMissions::split(ledger.cluster(), ledger.active_missions().into_iter().flat_map(unmanaged).collect())
        });
        for ActivePlan { mission, plan, .. } in unfit {
            warn!(%mission, role = %plan.role, "a plan that fits no message: nobody can act in this role");
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
        if let Err(after) = self.intake.try_acquire(settings.clock.now()) {
            let said = busy_reply("more is asked of the fleet than it takes on", after);
            self.tasks.spawn(async move { reply::json(&query, &query.key, &said).await });
            return;
        }
        self.requests += 1;
        let desk = ApiHandler {
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
            let said = desk.handle(call, &query.payload).await;
            reply::json(&query, &query.key, &said).await;
        });
    }

    /// What this node knows of its own reign.
    pub(super) fn status(&self, settings: &CoordinatorSettings) -> CoordinatorStatus {
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        CoordinatorStatus { term: self.term, since_ms, autopilot: self.autopilot.status() }
    }
}

/// Which version of the wire a fleet writes that is founded now: the newest, unless somebody is known who does not read it.
fn first_version(settings: &CoordinatorSettings) -> u8 {
    let VersionRange { oldest, newest } = VersionRange::OWN;
    let read_by_all = settings
        .knowledge
        .read(|base| base.iter().all(|(_, heard)| heard.record.knowledge.supported_versions.contains(newest)));
    if read_by_all { newest } else { oldest }
}

/// Lets the ledger hear something whose outcome it will show.
pub(super) fn propose(settings: &CoordinatorSettings, tasks: &mut Tasks, command: Command) {
    let replica = settings.replica.clone();
    tasks.spawn(async move {
        let outcome = replica.propose(command.clone(), GIVE_UP_LIMIT).await;
        if !matches!(outcome, Ok(CommandOutcome::Done)) {
            debug!(?command, ?outcome, "not done");
        }
    });
}

/// The members of the ensemble that are believed to be alive.
pub(super) fn live_members(settings: &CoordinatorSettings, now: NodeTime) -> BTreeSet<NodeId> {
    let members = settings.knowledge.read(|base| settings.ensemble.members(&settings.node, base, now));
    let own = *settings.replica.cluster().borrow();
    let ours = settings.knowledge.read(|base| {
        let ours = |node: &NodeId| {
            let its = base.get(node).and_then(|heard| heard.record.knowledge.cluster);
            its.is_none() || own.is_none() || its == own
        };
        members.into_iter().filter(ours).collect::<Vec<_>>()
    });
    ours.into_iter().filter(|node| settings.knowledge.is_alive(node)).collect()
}

fn unmanaged(entry: &MissionEntry) -> Vec<ActivePlan> {
    let roles = entry.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
    roles
        .filter_map(|(id, role)| {
            let (mission, plan) = (entry.id.clone(), entry.plan(id)?.clone());
            let (branch, holders, vacant, told) =
                (entry.branch, entry.role_holders(), entry.open_roles(), entry.signals_to(id));
            Some(ActivePlan { mission, branch, plan, ended: role.ended.clone(), holders, vacant, signals: told })
        })
        .collect()
}

pub(super) async fn publish<T: serde::Serialize>(settings: &CoordinatorSettings, key: &Key, message: &T) {
    let bytes = Bytes::from(codec::encode(message).expect("a sign of life fits a message"));
    let key = settings.keys.write(key);
    if let Err(problem) = settings.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
        debug!(%problem, key, "not published");
    }
}
