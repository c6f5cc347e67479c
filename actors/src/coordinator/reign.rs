//! One reign: what a node does, and remembers, from taking over until it no longer coordinates.

use super::actor::{CoordinatorMessage, CoordinatorSettings};
use super::api::Desk;
use super::auctioneer;
use super::duties::{Duty, Phase, Round, awards, back_off, duties, taken};
use super::reports;
use super::view::Window;
use crate::answer;
use crate::autopilot::{Autopilot, Done, perform};
use crate::bus::{BusError, Delivery, Encoding, Query, Token};
use crate::replica::{Leadership, ProposeError};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::auction::{Answer, AuctionId, AuctionRecord, CallForBids, Circumstances, Tender, conclude};
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::{Award, Ending, Epoch, Watch};
use consort_protocol::ledger::{Command, MissionEntry, MissionState, Outcome, RolePhase};
use consort_protocol::message::{AwardAnswer, AwardNotice, Beacon, Changed, LivePlan, Report};
use consort_protocol::mission::RoleKind;
use consort_protocol::units::NodeTime;
use ractor::ActorRef;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tracing::{debug, error, info, warn};
use zenoh_keyexpr::keyexpr;

/// How long the ledger may take to accept an award.
const AWARD_LIMIT: Duration = Duration::from_secs(2);

/// What lasts as long as this node coordinates. Dropping it withdraws all declarations and ends all work under way.
pub(super) struct Reign {
    pub(super) term: u64,
    since: NodeTime,
    watch: Watch,
    rounds: BTreeMap<MissionId, Round>,
    told: BTreeMap<(Epoch, RoleId), NodeTime>,
    /// How missions stood when last looked at, to tell what has changed.
    seen: BTreeMap<MissionId, Seen>,
    members: BTreeSet<NodeId>,
    /// Those of them that say they are free.
    free: BTreeSet<NodeId>,
    requests: u64,
    autopilot: Autopilot,
    /// Other clusters of this fleet's name, and a node of each.
    foreign: BTreeMap<ClusterId, NodeId>,
    tasks: Tasks,
    _token: Token,
}

#[derive(Clone, PartialEq)]
struct Seen {
    state: MissionState,
    done: usize,
    /// When this coordinator first saw the mission.
    since: NodeTime,
}

impl Reign {
    pub(super) async fn begin(
        settings: &CoordinatorSettings,
        leadership: &Leadership,
        term: u64,
        myself: &ActorRef<CoordinatorMessage>,
    ) -> Result<Reign, BusError> {
        let CoordinatorSettings { node, keys, bus, .. } = settings;
        let mut tasks = Tasks::default();
        let report = keys.write(&Key::Report(node.clone()));
        tasks.forward(bus.serve(&report).await?, myself, CoordinatorMessage::Report);
        tasks.forward(bus.serve(&keys.write(&Key::Live(node.clone()))).await?, myself, CoordinatorMessage::Live);
        tasks.forward(bus.serve(&keys.any_api()).await?, myself, CoordinatorMessage::Api);
        tasks.forward(bus.serve(&keys.any_view()).await?, myself, CoordinatorMessage::View);
        let token = bus.announce(&keys.write(&Key::AliveCoordinator(term, node.clone()))).await?;
        let since = settings.clock.now();
        info!(%node, term, "coordinates");
        let voters = leadership.voters.values().cloned().collect();
        settings.events.tell(Happening::Elected { term, voters });
        if settings.replica.cluster().borrow().is_none() {
            let (replica, cluster) = (settings.replica.clone(), ClusterId(settings.cluster_seed));
            tasks.spawn(async move {
                // Should it fail, this node no longer leads, and the next one does it.
                match replica.propose(Command::Found { cluster }, AWARD_LIMIT).await {
                    Ok(_) => info!(%cluster, "founded the ledger"),
                    Err(problem) => debug!(%cluster, %problem, "did not found the ledger"),
                }
            });
        }
        // What stood in the ledger before this reign is not news.
        let seen = settings
            .replica
            .read(|ledger| ledger.missions().map(|entry| (entry.id.clone(), Seen::of(entry, since))).collect());
        Ok(Reign {
            term,
            since,
            watch: Watch::new(settings.terms),
            rounds: BTreeMap::new(),
            told: BTreeMap::new(),
            seen,
            members: BTreeSet::new(),
            free: BTreeSet::new(),
            requests: 0,
            autopilot: Autopilot::new(settings.voters, settings.dead_after, settings.near),
            foreign: BTreeMap::new(),
            tasks,
            _token: token,
        })
    }

    /// A report was answered with a renewal.
    pub(super) fn contact(&mut self, settings: &CoordinatorSettings, epoch: Epoch, robot: &RobotId) {
        self.watch.contact(epoch, robot, settings.clock.now());
    }

    /// Tells everybody who coordinates.
    pub(super) async fn say_so(&self, settings: &CoordinatorSettings) {
        let voters = settings.replica.leadership().borrow().voters.values().cloned().collect();
        let since_ms = u64::try_from(settings.clock.now().since(self.since).as_millis()).unwrap_or(u64::MAX);
        let beacon = Beacon { node: settings.node.clone(), term: self.term, voters, since_ms };
        publish(settings, &Key::Beacon, &beacon).await;
    }

    /// Says so once when there is another cluster of this fleet's name.
    pub(super) fn look_abroad(&mut self, settings: &CoordinatorSettings) {
        let Some(own) = *settings.replica.cluster().borrow() else { return };
        let foreign: BTreeMap<ClusterId, NodeId> = settings.knowledge.read(|base| {
            let its = base.iter().filter_map(|(node, heard)| Some((heard.record.knowledge.cluster?, node.clone())));
            its.filter(|(cluster, _)| *cluster != own).collect()
        });
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
    pub(super) fn keep_keepers(&mut self, settings: &CoordinatorSettings, myself: &ActorRef<CoordinatorMessage>) {
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
                if let Phase::Waiting(until) = &mut round.phase {
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
        let todo = settings.replica.read(|ledger| {
            let awards = awards(ledger);
            for (epoch, robot) in &awards {
                self.watch.meet(*epoch, robot, now);
            }
            let epochs = awards.into_iter().map(|(epoch, _)| epoch).collect();
            self.watch.retain(&epochs);
            self.told.retain(|(epoch, _), _| epochs.contains(epoch));
            self.rounds.retain(|mission, _| ledger.mission(mission).is_some_and(|entry| !entry.state.is_end()));
            duties(ledger, &self.watch, &self.rounds, &self.told, now)
        });
        for duty in todo {
            match duty {
                Duty::Call(mission) => self.call(settings, myself, &mission, now),
                Duty::Tell { mission, role, robot, epoch } => {
                    self.tell(settings, myself, mission, role, robot, epoch, now);
                }
                Duty::GiveUp { mission, role, robot, epoch, cause } => {
                    self.give_up(settings, mission, role, robot, epoch, cause);
                }
            }
        }
    }

    fn follow_missions(&mut self, settings: &CoordinatorSettings, now: NodeTime) {
        let mut changed = false;
        let mut revoked: Vec<(RobotId, Epoch, Ending)> = vec![];
        settings.replica.read(|ledger| {
            for entry in ledger.missions() {
                let known = self.seen.get(&entry.id);
                let since = known.map_or(now, |seen| seen.since);
                let seen = Seen::of(entry, since);
                if known == Some(&seen) {
                    continue;
                }
                changed = true;
                let mission = entry.id.clone();
                if known.is_none() {
                    let parameters = entry.submission.parameters.clone();
                    settings.events.tell(Happening::Submitted { mission: mission.clone(), parameters });
                }
                if known.is_some_and(|known| known.done != seen.done) {
                    let (done, steps) = entry.progress();
                    settings.events.tell(Happening::Progress { mission: mission.clone(), done, steps });
                }
                if known.is_none_or(|known| known.state != seen.state) {
                    settings.events.tell(Happening::Mission { mission: mission.clone(), state: seen.state.clone() });
                    revoked.extend(to_revoke(entry));
                }
                self.seen.insert(mission, seen);
            }
        });
        for (robot, epoch, reason) in revoked {
            self.notify(settings, &robot, AwardNotice::Revoked { epoch, reason }, |_| ());
        }
        if changed {
            let (settings, term) = (settings.clone(), self.term);
            self.tasks.spawn(async move {
                publish(&settings, &Key::Changed, &Changed { node: settings.node.clone(), term }).await;
            });
        }
    }

    fn call(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        mission: &MissionId,
        now: NodeTime,
    ) {
        let number = self.rounds.get(mission).map_or(1, |round| round.number + 1);
        let roles = settings.replica.read(|ledger| {
            let entry = ledger.mission(mission)?;
            let plans = entry.open_roles().into_iter().map(|role| Some((role.clone(), entry.plan(&role)?.clone())));
            plans.collect::<Option<BTreeMap<_, _>>>()
        });
        let Some(roles) = roles.filter(|roles| !roles.is_empty()) else { return };
        let auction = AuctionId { mission: mission.clone(), term: self.term, round: number };
        let call = CallForBids { auction, ensemble: settings.ensemble.spec().name.clone(), roles };
        let expected: BTreeSet<RobotId> = members(settings, now).into_iter().map(RobotId::from).collect();
        settings.events.tell(Happening::Called {
            mission: mission.clone(),
            roles: call.roles.keys().cloned().collect(),
            round: number,
            asked: expected.len(),
        });
        self.rounds.insert(mission.clone(), Round { number, phase: Phase::Calling });
        let (bus, keys, window, to) = (settings.bus.clone(), settings.keys.clone(), settings.window, myself.clone());
        self.tasks.spawn(async move {
            let tenders = auctioneer::collect(bus, keys, call.clone(), expected.clone(), window).await;
            // A coordinator that has stopped needs no bids.
            let _ = to.cast(CoordinatorMessage::Closed { call: Box::new(call), expected, tenders });
        });
    }

    pub(super) fn close(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        call: &CallForBids,
        expected: &BTreeSet<RobotId>,
        tenders: &[Tender],
    ) {
        let mission = &call.auction.mission;
        let current = |round: &Round| round.number == call.auction.round && round.phase == Phase::Calling;
        if !self.rounds.get(mission).is_some_and(current) {
            return; // the mission has ended, or another round has begun
        }
        for bid in tenders.iter().flat_map(|tender| &tender.answers) {
            if let Answer::Bid(bid) = bid {
                settings.events.tell(Happening::Bid { mission: mission.clone(), bid: bid.clone() });
            }
        }
        let taken = settings.replica.read(|ledger| taken(ledger, &self.rounds));
        let circumstances = Circumstances {
            expected,
            taken: &taken,
            limits: &settings.limits,
            window_ms: u64::try_from(settings.window.as_millis()).unwrap_or(u64::MAX),
            at_ms: settings.clock.wall_ms(),
        };
        let conclusion = conclude(call, tenders, &circumstances);
        settings.events.tell(Happening::Closed { mission: mission.clone(), record: conclusion.record.clone() });
        let mission = mission.clone();
        let (phase, command) = match conclusion.holders {
            Some(holders) => {
                let command =
                    Command::Award { mission: mission.clone(), holders: holders.clone(), auction: conclusion.record };
                (Phase::Proposing(holders), Some(command))
            }
            None => {
                let news = settings.replica.read(|ledger| {
                    let known = ledger.mission(&mission).and_then(|entry| entry.auction.as_ref());
                    known.is_none_or(|known| tells_otherwise(known, &conclusion.record))
                });
                let command = news.then(|| Command::Defer { mission: mission.clone(), auction: conclusion.record });
                (Phase::Waiting(settings.clock.now() + back_off(call.auction.round)), command)
            }
        };
        if let Some(round) = self.rounds.get_mut(&mission) {
            round.phase = phase;
        }
        let Some(command) = command else { return };
        let (replica, auction, to) = (settings.replica.clone(), call.auction.clone(), myself.clone());
        self.tasks.spawn(async move {
            let outcome = replica.propose(command, AWARD_LIMIT).await;
            // A coordinator that has stopped leaves the award to the next one: it is in the ledger or it is not.
            let _ = to.cast(CoordinatorMessage::Decided { auction, outcome });
        });
    }

    pub(super) fn decided(
        &mut self,
        settings: &CoordinatorSettings,
        auction: &AuctionId,
        outcome: Result<Outcome, ProposeError>,
    ) {
        let now = settings.clock.now();
        let mission = &auction.mission;
        let Some(round) = self.rounds.get_mut(mission).filter(|round| round.number == auction.round) else { return };
        let Phase::Proposing(holders) = &round.phase else { return };
        match outcome {
            Ok(Outcome::Awarded { epoch }) => {
                let since = self.seen.get(mission).map(|seen| now.since(seen.since).as_secs_f64() * 1000.0);
                let (mission, holders) = (mission.clone(), holders.clone());
                settings.events.tell(Happening::Awarded { mission, holders, epoch, after_ms: since });
                // Should a role of it be released, the rounds begin anew.
                self.rounds.remove(&auction.mission);
            }
            Ok(outcome) => {
                debug!(%mission, ?outcome, "the award no longer fits the ledger");
                round.phase = Phase::Waiting(now + back_off(1));
            }
            Err(problem) => {
                // Whether it will be committed is unknown; the next look at the ledger tells.
                debug!(%mission, %problem, "the award was not committed");
                round.phase = Phase::Waiting(now + back_off(round.number));
            }
        }
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
            let (plan, holders) = (entry.plan(&role)?.clone(), entry.holders());
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

    fn notify(
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

    pub(super) fn give_up(
        &mut self,
        settings: &CoordinatorSettings,
        mission: MissionId,
        role: RoleId,
        robot: RobotId,
        epoch: Epoch,
        cause: String,
    ) {
        let (replica, events) = (settings.replica.clone(), settings.events.clone());
        self.tasks.spawn(async move {
            let released = (mission.clone(), role.clone(), cause.clone());
            if reports::give_up(replica, mission, role, robot, epoch, cause).await {
                let (mission, role, cause) = released;
                events.tell(Happening::Released { mission, role, cause });
            }
        });
    }

    pub(super) async fn report(
        &mut self,
        settings: &CoordinatorSettings,
        myself: &ActorRef<CoordinatorMessage>,
        query: Query,
    ) {
        let Some(report) = answer::read::<Report>(&query).await else { return };
        let (replica, to, age) = (settings.replica.clone(), myself.clone(), settings.terms.leadership_age_max());
        self.tasks.spawn(async move {
            let said = reports::answer(replica, report, age, to).await;
            answer::wire(&query, &query.key, &said).await;
        });
    }

    pub(super) async fn live(&mut self, settings: &CoordinatorSettings, query: Query) {
        let plans: Vec<LivePlan> =
            settings.replica.read(|ledger| ledger.live().into_iter().flat_map(unmanaged).collect());
        // An empty answer is one too; many plans take several.
        let chunks: Vec<&[LivePlan]> = if plans.is_empty() { vec![&[]] } else { plans.chunks(8).collect() };
        for chunk in chunks {
            answer::wire(&query, &query.key, &chunk.to_vec()).await;
        }
    }

    pub(super) fn api(&mut self, settings: &CoordinatorSettings, query: Query) {
        let Some(Key::Api(call)) = settings.keys.read(&query.key) else {
            self.tasks.spawn(async move { answer::refuse(&query, "no such request").await });
            return;
        };
        self.requests += 1;
        let desk = Desk {
            replica: settings.replica.clone(),
            domain: Arc::clone(&settings.domain),
            request_prefix: format!(
                "unnamed-{}-{}",
                self.term,
                settings.node.as_str().chars().take(20).collect::<String>()
            ),
            at_ms: settings.clock.wall_ms(),
            number: self.requests,
        };
        self.tasks.spawn(async move {
            let said = desk.serve(call, &query.payload).await;
            answer::json(&query, &query.key, &said).await;
        });
    }

    pub(super) async fn view(&mut self, settings: &CoordinatorSettings, query: &Query) {
        let leadership = settings.replica.leadership().borrow().clone();
        let window = Window {
            keys: &settings.keys,
            node: &settings.node,
            leadership: &leadership,
            since: self.since,
            now: settings.clock.now(),
            knowledge: &settings.knowledge,
            ensemble: &settings.ensemble,
            replica: &settings.replica,
            autopilot: self.autopilot.show(),
        };
        let Ok(asked) = keyexpr::new(query.key.as_str()) else { return };
        for (key, value) in window.all() {
            if keyexpr::new(key.as_str()).is_ok_and(|key| asked.intersects(key)) {
                answer::json(query, &key, &value).await;
            }
        }
    }
}

impl Seen {
    fn of(entry: &MissionEntry, since: NodeTime) -> Seen {
        Seen { state: entry.state.clone(), done: entry.progress().0, since }
    }
}

/// The members of the ensemble that are believed to be alive.
fn members(settings: &CoordinatorSettings, now: NodeTime) -> BTreeSet<NodeId> {
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

/// Whether a record says anything that the former one did not, times and counters aside.
fn tells_otherwise(known: &AuctionRecord, record: &AuctionRecord) -> bool {
    let gist = |record: &AuctionRecord| {
        let verdicts = record
            .entries
            .iter()
            .map(|entry| (entry.role.clone(), entry.robot.clone(), std::mem::discriminant(&entry.verdict)));
        (record.failure.clone(), verdicts.collect::<Vec<_>>())
    };
    gist(known) != gist(record)
}

fn to_revoke(entry: &MissionEntry) -> Vec<(RobotId, Epoch, Ending)> {
    let reason = match entry.state {
        MissionState::Canceled { .. } => Ending::Canceled,
        MissionState::Failed { .. } => Ending::Failed,
        MissionState::Completed | MissionState::Pending | MissionState::Running => return vec![],
    };
    let held = entry.roles.values().filter(|role| matches!(role.phase, RolePhase::Awarded | RolePhase::Active));
    held.filter_map(|role| role.holder.as_ref()).map(|holder| (holder.robot.clone(), holder.epoch, reason)).collect()
}

fn unmanaged(entry: &MissionEntry) -> Vec<LivePlan> {
    let roles = entry.roles.iter().filter(|(_, role)| role.kind == RoleKind::Unmanaged);
    roles
        .filter_map(|(id, role)| {
            let (mission, plan) = (entry.id.clone(), entry.plan(id)?.clone());
            Some(LivePlan { mission, plan, ended: role.ended.clone(), holders: entry.holders() })
        })
        .collect()
}

async fn publish<T: serde::Serialize>(settings: &CoordinatorSettings, key: &Key, message: &T) {
    let bytes = Bytes::from(codec::encode(message).expect("a sign of life fits a message"));
    let key = settings.keys.write(key);
    if let Err(problem) = settings.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
        debug!(%problem, key, "not published");
    }
}
