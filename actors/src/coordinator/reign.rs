//! One reign: what a node does, and remembers, from taking over until it no longer coordinates.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::api::Desk;
use super::duties::{Duty, Memory, Phase, Round, awards, duties};
use super::intake::Intake;
use super::interregnum::busy;
use super::news::Seen;
use super::pace::{Pace, Stalled};
use super::reports::Clerk;
use super::whereabouts::{foreign, place, places};
use crate::answer;
use crate::autopilot::{Autopilot, Done, perform};
use crate::bus::{BusError, Delivery, Encoding, Query, Token};
use crate::replica::Leadership;
use crate::tasks::Tasks;
use crate::views::Shown;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::lease::{Award, Epoch, Watch};
use consort_protocol::ledger::{Command, Ledger, MissionEntry, Outcome};
use consort_protocol::message::{AwardAnswer, AwardNotice, Beacon, Live, LivePlan, Report};
use consort_protocol::mission::RoleKind;
use consort_protocol::units::NodeTime;
use consort_protocol::versions::Versions;
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
pub(super) struct Reign {
    pub(super) term: u64,
    since: NodeTime,
    /// When this node began to coordinate, by its wall clock in milliseconds: no other reign of its term did then.
    since_wall_ms: u64,
    pub(super) watch: SharedWatch,
    pub(super) rounds: BTreeMap<MissionId, Round>,
    pace: Pace,
    /// Roles to be taken from holders that answer and do not get on, once their leases have run out.
    stalled: BTreeMap<(Epoch, RoleId), String>,
    /// Missions that are being given up, and since when.
    failing: BTreeMap<MissionId, NodeTime>,
    told: BTreeMap<(Epoch, RoleId), NodeTime>,
    /// How missions stood when last looked at, to tell what has changed.
    pub(super) seen: BTreeMap<MissionId, Seen>,
    members: BTreeSet<NodeId>,
    /// Those of them that say they are free.
    free: BTreeSet<NodeId>,
    requests: u64,
    intake: Intake,
    autopilot: Autopilot,
    /// Other clusters of this fleet's name, and a node of each.
    foreign: BTreeMap<ClusterId, NodeId>,
    pub(super) tasks: Tasks,
    _token: Token,
}

/// Which leases run, for those who renew them and those who end them.
pub(super) type SharedWatch = Arc<Mutex<Watch>>;

pub(super) fn lock(watch: &SharedWatch) -> MutexGuard<'_, Watch> {
    // A panic under the lock has not left it half written: writes are single steps.
    watch.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Reign {
    pub(super) async fn begin(
        settings: &CoordinatorSettings,
        leadership: &Leadership,
        term: u64,
        yielded: Option<Instant>,
        myself: &ActorRef<CoordinatorMessage>,
    ) -> Result<Reign, BusError> {
        let CoordinatorSettings { node, keys, bus, .. } = settings;
        let mut tasks = Tasks::default();
        let report = keys.write(&Key::Report(node.clone()));
        tasks.forward(bus.serve(&report).await?, myself, CoordinatorMessage::Report);
        tasks.forward(bus.serve(&keys.write(&Key::Live(node.clone()))).await?, myself, CoordinatorMessage::Live);
        let token = bus.announce(&keys.write(&Key::AliveCoordinator(term, node.clone()))).await?;
        let since = settings.clock.now();
        info!(%node, term, "coordinates");
        let voters = leadership.voters.values().cloned().collect();
        settings.events.tell(Happening::Elected { term, voters });
        if settings.replica.cluster().borrow().is_none() {
            let (replica, cluster) = (settings.replica.clone(), ClusterId(settings.cluster_seed));
            let wire = first_version(settings);
            tasks.spawn(async move {
                // Should it fail, this node no longer leads, and the next one does it.
                match replica.propose(Command::Found { cluster }, FOUND_LIMIT).await {
                    Ok(_) => info!(%cluster, "founded the ledger"),
                    Err(problem) => debug!(%cluster, %problem, "did not found the ledger"),
                }
                if let Err(problem) = replica.propose(Command::Raise { wire }, FOUND_LIMIT).await {
                    debug!(%problem, "did not say which version of the wire the fleet writes");
                }
            });
        } else if settings.replica.read(Ledger::wire).is_none() {
            // Whoever founded it died before it said this; then nobody has written more than what everybody reads.
            propose(settings, &mut tasks, Command::Raise { wire: codec::FIRST });
        }
        // What stood in the ledger before this reign is not news.
        let seen = settings
            .replica
            .read(|ledger| ledger.missions().map(|entry| (entry.id.clone(), Seen::of(entry, since))).collect());
        Ok(Reign {
            term,
            since,
            since_wall_ms: settings.clock.wall_ms(),
            watch: Arc::new(Mutex::new(Watch::new(settings.terms))),
            rounds: BTreeMap::new(),
            pace: Pace::new(settings.stall_after),
            stalled: BTreeMap::new(),
            failing: BTreeMap::new(),
            told: BTreeMap::new(),
            seen,
            members: BTreeSet::new(),
            free: BTreeSet::new(),
            requests: 0,
            intake: Intake::new(settings.intake, since),
            autopilot: Autopilot::new(settings.voters, settings.dead_after, settings.near, yielded),
            foreign: BTreeMap::new(),
            tasks,
            _token: token,
        })
    }

    /// When this node last gave the lead away because another was better placed.
    pub(super) fn yielded(&self) -> Option<Instant> {
        self.autopilot.yielded()
    }

    /// Says that this node coordinates, and looks after everything.
    pub(super) async fn beat(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let (cluster, wire) = settings.replica.read(|ledger| (ledger.cluster(), ledger.wire()));
        settings.wire.hear(cluster, wire);
        self.say_so(settings).await;
        self.follow_members(settings);
        self.look_abroad(settings);
        self.keep_keepers(settings, myself);
        self.attend(settings, myself);
    }

    /// Tells everybody who coordinates.
    pub(super) async fn say_so(&self, settings: &CoordinatorSettings) {
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
        let foreign = foreign(&settings.knowledge, Some(own));
        for (cluster, node) in &foreign {
            if !self.foreign.contains_key(cluster) {
                error!(%own, foreign = %cluster, %node, "another cluster of this fleet's name was founded apart: they do not \
                    merge. Stop the nodes of one of them and start them again with empty stores");
                let (cluster, foreign, member) = (own, *cluster, node.clone());
                settings.events.tell(Happening::Foreign { cluster, foreign, member });
            }
        }
        // Once told, a cluster stays told of, though it is shown only while it is heard of.
        self.foreign.extend(foreign);
    }

    /// Makes the change of the ledger's keepers that is due.
    fn keep_keepers(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let Some(change) = self.autopilot.next(&settings.replica, &settings.knowledge) else { return };
        info!(reason = change.reason(), "changes who keeps the ledger");
        let (replica, to) = (settings.replica.clone(), myself.clone());
        self.tasks.spawn(async move {
            let done = perform(replica, change).await;
            // A coordinator that has stopped leaves a change that was begun to the next one.
            let _ = to.cast(CoordinatorMessage::Keepers(done));
        });
    }

    pub(super) fn keepers_changed(&mut self, settings: &CoordinatorSettings, done: Done) {
        match self.autopilot.done(done) {
            Ok(reason) => {
                let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
                settings.events.tell(Happening::Voters { voters, reason });
            }
            Err((reason, problem)) => warn!(reason, %problem, "who keeps the ledger was not changed"),
        }
    }

    /// Tells who joined and left the ensemble, as far as this coordinator has heard.
    pub(super) fn follow_members(&mut self, settings: &CoordinatorSettings) {
        let now = settings.clock.now();
        let ensemble = settings.ensemble.spec().name.clone();
        let members = members(settings, now);
        for member in members.difference(&self.members) {
            settings.events.tell(Happening::Joined { ensemble: ensemble.clone(), member: member.clone() });
        }
        for member in self.members.difference(&members) {
            let verdict = settings.knowledge.read(|base| settings.ensemble.judge(member, &settings.node, base, now));
            let reason = if verdict.member { "judged dead".to_owned() } else { verdict.reason };
            settings.events.tell(Happening::Left { ensemble: ensemble.clone(), member: member.clone(), reason });
        }
        let free = settings.knowledge.read(|base| {
            let is_free = |node: &&NodeId| base.get(node).is_some_and(|heard| heard.record.knowledge.is_free());
            members.iter().filter(is_free).cloned().collect::<BTreeSet<_>>()
        });
        if !free.is_subset(&self.free) {
            // Those who wait for a robot need not sit out their back-off.
            for round in self.rounds.values_mut() {
                if let Phase::Waiting { until, .. } = &mut round.phase {
                    *until = now;
                }
            }
        }
        self.free = free;
        self.members = members;
    }

    /// Looks at the ledger, tells what is new in it, and does what is to be done.
    pub(super) fn attend(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
        let now = settings.clock.now();
        self.follow_missions(settings, now);
        let wall_ms = settings.clock.wall_ms();
        let todo = settings.replica.read(|ledger| {
            let mut watch = lock(&self.watch);
            let awards = awards(ledger);
            for (epoch, robot) in &awards {
                watch.meet(*epoch, robot, now);
            }
            let epochs = awards.into_iter().map(|(epoch, _)| epoch).collect();
            watch.retain(&epochs, now);
            self.told.retain(|(epoch, _), _| epochs.contains(epoch));
            self.stalled.retain(|(epoch, _), _| epochs.contains(epoch));
            self.seen.retain(|mission, _| ledger.mission(mission).is_some());
            self.rounds.retain(|mission, round| {
                let entry = ledger.mission(mission).filter(|entry| !entry.state.is_end());
                entry.inspect(|entry| round.heed(entry.branch, now)).is_some()
            });
            self.failing.retain(|mission, _| ledger.mission(mission).is_some_and(|entry| !entry.state.is_end()));
            for Stalled { role, robot, epoch, cause } in self.pace.look(ledger, now) {
                watch.let_go(epoch, &robot, now);
                self.stalled.entry((epoch, role)).or_insert(cause);
            }
            let memory = Memory { watch: &watch, rounds: &self.rounds, told: &self.told };
            let todo = duties(ledger, &memory, now, wall_ms);
            for duty in &todo {
                if let Duty::GiveUp { epoch, robot, .. } = duty {
                    watch.let_go(*epoch, robot, now);
                }
            }
            todo
        });
        for duty in todo {
            match duty {
                Duty::Call(mission) => self.call(settings, myself, &mission, now),
                Duty::Tell { mission, role, robot, epoch } => {
                    self.tell(settings, myself, mission, role, robot, epoch, now);
                }
                Duty::GiveUp { mission, role, robot, epoch, cause } => {
                    let stalled = self.stalled.get(&(epoch, role.clone())).cloned();
                    let (blamed, cause) = (stalled.is_some(), stalled.unwrap_or(cause));
                    self.give_up(settings, mission, role, &robot, epoch, cause, blamed);
                }
                Duty::Fail { mission, cause } => {
                    if self.failing.get(&mission).is_none_or(|at| now.since(*at) >= FAIL_AGAIN) {
                        self.failing.insert(mission.clone(), now);
                        let places =
                            settings.replica.read(|ledger| places(&settings.knowledge, ledger.mission(&mission)));
                        propose(settings, &mut self.tasks, Command::Fail { mission, cause, branch: None, places });
                    }
                }
            }
        }
        self.settle(settings, myself);
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
            let (plan, holders) = (entry.plan(&role)?.clone(), entry.holdings());
            Some(Award { mission: mission.clone(), role: role.clone(), robot: robot.clone(), epoch, plan, holders })
        });
        let Some(award) = award else { return };
        self.told.insert((epoch, role.clone()), now);
        let (to, who) = (myself.clone(), robot.clone());
        self.notify(settings, &robot, AwardNotice::Awarded(Box::new(award)), move |answer| {
            // A coordinator that has stopped leaves the award to the next one.
            let _ = to.cast(CoordinatorMessage::Noticed { mission, role, robot: who, epoch, answer });
        });
    }

    pub(super) fn notify(
        &mut self,
        settings: &CoordinatorSettings,
        robot: &RobotId,
        notice: AwardNotice,
        then: impl FnOnce(AwardAnswer) + Send + 'static,
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
    pub(super) fn give_up(
        &mut self,
        settings: &CoordinatorSettings,
        mission: MissionId,
        role: RoleId,
        robot: &RobotId,
        epoch: Epoch,
        cause: String,
        blamed: bool,
    ) {
        let place = place(&settings.knowledge, robot);
        let command = Command::Release { mission, role, epoch, cause, blamed, place };
        propose(settings, &mut self.tasks, command);
    }

    pub(super) async fn report(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(report) = answer::read::<Report>(&query).await else { return };
        let clerk = Clerk {
            replica: settings.replica.clone(),
            knowledge: settings.knowledge.clone(),
            leadership_age_max: settings.terms.leadership_age_max(),
            clock: settings.clock,
            watch: self.watch.clone(),
        };
        self.tasks.spawn(async move {
            let said = clerk.answer(report).await;
            answer::wire(&query, &query.key, &said).await;
        });
    }

    pub(super) async fn live(&mut self, settings: &CoordinatorSettings, query: Query) {
        let (parts, unfit) = settings
            .replica
            .read(|ledger| Live::parts(ledger.cluster(), ledger.live().into_iter().flat_map(unmanaged).collect()));
        for LivePlan { mission, plan, .. } in unfit {
            warn!(%mission, role = %plan.role, "a plan that fits no message: nobody can act in this role");
        }
        for part in parts {
            answer::wire(&query, &query.key, &part).await;
        }
    }

    pub(super) fn api(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(Key::Api(call)) = settings.keys.read(&query.key) else {
            let asked = query.key.rsplit('/').next().unwrap_or_default();
            let calls = ApiCall::ALL.iter().map(|call| call.word()).collect::<Vec<_>>().join(", ");
            let error = format!("no such request: {asked}; there are {calls}");
            self.tasks.spawn(async move { answer::json(&query, &query.key, &json!({ "error": error })).await });
            return;
        };
        if let Err(after) = self.intake.take(settings.clock.now()) {
            let said = busy("more is asked of the fleet than it takes on", after);
            self.tasks.spawn(async move { answer::json(&query, &query.key, &said).await });
            return;
        }
        self.requests += 1;
        let desk = Desk {
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
            number: self.requests,
            missions_max: settings.intake.missions,
        };
        self.tasks.spawn(async move {
            let said = desk.serve(call, &query.payload).await;
            answer::json(&query, &query.key, &said).await;
        });
    }

    /// What this node knows of its own reign.
    pub(super) fn show(&self, settings: &CoordinatorSettings) -> Shown {
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        Shown { term: self.term, since_ms, autopilot: self.autopilot.show() }
    }
}

/// Which version of the wire a fleet writes that is founded now: the newest, unless somebody is known who does not read it.
fn first_version(settings: &CoordinatorSettings) -> u8 {
    let Versions { oldest, newest } = Versions::OWN;
    let read_by_all =
        settings.knowledge.read(|base| base.iter().all(|(_, heard)| heard.record.knowledge.speaks.hold(newest)));
    if read_by_all { newest } else { oldest }
}

/// Lets the ledger hear something whose outcome it will show.
pub(super) fn propose(settings: &CoordinatorSettings, tasks: &mut Tasks, command: Command) {
    let replica = settings.replica.clone();
    tasks.spawn(async move {
        let outcome = replica.propose(command.clone(), GIVE_UP_LIMIT).await;
        if !matches!(outcome, Ok(Outcome::Done)) {
            debug!(?command, ?outcome, "not done");
        }
    });
}

/// The members of the ensemble that are believed to be alive.
pub(super) fn members(settings: &CoordinatorSettings, now: NodeTime) -> BTreeSet<NodeId> {
    let members = settings.knowledge.read(|base| settings.ensemble.members(&settings.node, base, now));
    let own = *settings.replica.cluster().borrow();
    let ours = settings.knowledge.read(|base| {
        let ours = |node: &NodeId| {
            let its = base.get(node).and_then(|heard| heard.record.knowledge.cluster);
            its.is_none() || own.is_none() || its == own
        };
        members.into_iter().filter(ours).collect::<Vec<_>>()
    });
    ours.into_iter().filter(|node| settings.knowledge.alive(node)).collect()
}

fn unmanaged(entry: &MissionEntry) -> Vec<LivePlan> {
    let roles = entry.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
    roles
        .filter_map(|(id, role)| {
            let (mission, plan) = (entry.id.clone(), entry.plan(id)?.clone());
            let (branch, holders, vacant, told) = (entry.branch, entry.holdings(), entry.open_roles(), entry.told(id));
            Some(LivePlan { mission, branch, plan, ended: role.ended.clone(), holders, vacant, told })
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
