//! Leader session: state and work of a node from the start to the end of its term as coordinator.

use super::actions::{CoordinatorAction, SessionState};
use super::auctions::Auctions;
use super::battery_swaps::BatterySwaps;
use super::beacons::Beacons;
use super::change_feed::ChangeFeed;
use super::ensemble_members::EnsembleMembers;
use super::held_roles::HeldRoles;
use super::message::{AwardedRole, CollectedBids, CoordinatorMessage};
use super::people::People;
use super::promises::{recorded_charges, unfit_robots};
use super::reauctions::{self, Reauctions};
use super::reconcile::{pending_actions, stop_renewing_released, track_awards, track_new_awards};
use super::reports::{ReportHandler, serve_reports};
use super::requests::Requests;
use super::resource_leases::ResourceDelivery;
use super::robot_orders::OrderDelivery;
use super::schedules::Schedules;
use super::scope::Scope;
use super::session_context::SessionContext;
use super::settings::{AuctionSettings, CoordinatorSettings, NodeParts};
use super::status::CoordinatorStatus;
use crate::autopilot::{ActionResult, Autopilot, perform};
use crate::robot_driver::PersonRequestState;
use bytes::Bytes;
use consort_bus::tasks::Tasks;
use consort_bus::{Author, BusError, PresenceToken, Query, Sample, SharedBus};
use consort_protocol::auction::{AuctionId, PromiseTerms};
use consort_protocol::cause::CauseClass;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{Key, PeopleCall};
use consort_protocol::lease::{DeclineReason, Epoch};
use consort_protocol::ledger::{
    ChangeCursor, Command, CommandOutcome, HistoryLimits, Ledger, MissionChanges, TaskQuestion,
};
use consort_protocol::message::AwardReply;
use consort_protocol::units::NodeTime;
use consort_protocol::versions::VersionRange;
use consort_raft::{LeadershipView, ProposeError};
use consort_skills::actions::GoalId;
use ractor::ActorRef;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Timeout for the ledger to commit its cluster id.
const BOOTSTRAP_TIMEOUT: Duration = Duration::from_secs(2);

/// Timeout for a voter to return the time of its clock. A late reply would make its clock appear slow.
const CLOCK_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum number of requests that wait for the clocks of the voters.
const EARLY_REQUESTS_MAX: usize = 64;

/// Delay before the failure of a mission is proposed again.
const FAIL_RETRY_DELAY: Duration = Duration::from_secs(2);

/// State of a single term as coordinator. Its end withdraws all declarations and aborts all tasks,
/// except a voter change.
pub(super) struct LeaderSession {
    context: SessionContext,
    auctions: Auctions,
    reauctions: Reauctions,
    held_roles: HeldRoles,
    changes: ChangeFeed,
    /// Position among the changes of the ledger.
    cursor: ChangeCursor,
    /// Position of the ledger when its changes were last read.
    followed: Epoch,
    members: EnsembleMembers,
    requests: Requests,
    autopilot: Autopilot,
    beacons: Beacons,
    /// Requests that arrived before the clocks of a majority were known.
    early_requests: Vec<Query>,
    people: People,
    orders: OrderDelivery,
    resources: ResourceDelivery,
    schedules: Schedules,
    swaps: BatterySwaps,
    /// The voter change in progress.
    voter_change: Tasks,
    /// Missions with a proposed failure, with the time of the proposal.
    failing: BTreeMap<MissionId, NodeTime>,
    _token: PresenceToken,
}

impl LeaderSession {
    /// Starts the session of the term in which this node leads. `yielded` is the time at which the
    /// node last transferred leadership to a better placed node.
    pub(super) async fn start(
        settings: &CoordinatorSettings,
        leadership: &LeadershipView,
        yielded: Option<Instant>,
        mailbox: &ActorRef<CoordinatorMessage>,
    ) -> Result<LeaderSession, BusError> {
        let (NodeParts { node, keys, bus, .. }, term) = (&settings.parts, leadership.term);
        let mut tasks = Tasks::default();
        let reports = bus.serve(&keys.write(&Key::Report(node.clone()))).await?;
        let of_people = bus.subscribe(&keys.write(&Key::People(PeopleCall::Done))).await?;
        tasks.forward_samples(of_people, mailbox, CoordinatorMessage::PersonEvent);
        let token = bus.announce(&keys.write(&Key::AliveCoordinator(term, node.clone()))).await?;
        let mut context = SessionContext::new(settings.clone(), mailbox.clone(), term, tasks);
        context.tasks.spawn(serve_reports(reports, ReportHandler::new(&context)));
        info!(%node, term, "started to coordinate");
        let voters = leadership.voters.values().cloned().collect();
        context.publish_event(EventKind::Elected { term, voters });
        found_ledger(&mut context);
        Ok(LeaderSession {
            auctions: Auctions::default(),
            reauctions: Reauctions::default(),
            held_roles: HeldRoles::new(settings.stall_timeout),
            changes: ChangeFeed::new(&context),
            cursor: ChangeCursor::default(),
            followed: Epoch::default(),
            members: EnsembleMembers::default(),
            requests: Requests::new(&context),
            people: People::new(&context),
            orders: OrderDelivery::new(&context),
            resources: ResourceDelivery::default(),
            schedules: Schedules::default(),
            swaps: BatterySwaps::default(),
            autopilot: Autopilot::new(settings.autopilot, yielded),
            beacons: Beacons::new(&settings.parts, term),
            early_requests: vec![],
            voter_change: Tasks::default(),
            failing: BTreeMap::new(),
            context,
            _token: token,
        })
    }

    /// Returns the term of this session.
    pub(super) fn term(&self) -> u64 {
        self.context.term
    }

    /// Returns the time at which this node last transferred leadership to a better placed node.
    pub(super) fn yielded_at(&self) -> Option<Instant> {
        self.autopilot.last_transfer_at()
    }

    /// Ends the session. Returns the voter change in progress: a transfer of leadership ends the
    /// session before it is complete.
    pub(super) fn end(self) -> Tasks {
        self.voter_change
    }

    /// Publishes the first beacon and performs all pending actions.
    pub(super) async fn begin(&mut self) {
        self.beacons.publish().await;
        let interval = self.context.settings.tick_interval;
        self.context.tasks.spawn(self.beacons.clone().publish_at_intervals(interval));
        self.update_members();
        self.read_clocks();
        self.reconcile();
    }

    /// Performs all periodic work.
    pub(super) fn tick(&mut self) {
        let (cluster, wire) = self.context.read_ledger(|ledger| (ledger.cluster(), ledger.wire()));
        self.context.settings.parts.wire_version.adopt(cluster, wire);
        self.update_members();
        self.members.report_foreign_clusters(&self.context);
        self.start_voter_change();
        // Without the time, a submission is answered with a time to retry.
        self.handle_early_requests();
        self.read_clocks();
        self.reconcile();
        self.auction_again();
        let (now, confirmed_ms) = (self.context.now(), self.confirmed_ms());
        self.people.tick(&mut self.context, now, confirmed_ms);
    }

    /// Reads the clocks of the other voters, if that is due.
    fn read_clocks(&mut self) {
        let (now, is_confirmed) = (self.context.now(), self.confirmed_ms().is_some());
        if !self.context.time.clocks().begin_reading(is_confirmed, now) {
            return;
        }
        let (voters, NodeParts { node, keys, bus, .. }) = (self.voters::<Vec<_>>(), &self.context.settings.parts);
        for voter in voters.into_iter().filter(|voter| voter != node) {
            let (key, bus) = (keys.write(&Key::Clock(voter.clone())), bus.clone());
            let mailbox = self.context.mailbox.clone();
            self.context.tasks.spawn(async move {
                if let Some(wall_ms) = read_clock(&bus, &key).await {
                    // The actor ends with the node.
                    let _ = mailbox.cast(CoordinatorMessage::ClockRead { voter, wall_ms });
                }
            });
        }
    }

    pub(super) fn record_clock(&mut self, voter: NodeId, wall_ms: u64) {
        self.context.time.clocks().record(voter, wall_ms, self.context.now());
        if self.confirmed_ms().is_some() {
            self.handle_early_requests();
        }
    }

    fn handle_early_requests(&mut self) {
        let time_ms = self.confirmed_ms();
        for query in std::mem::take(&mut self.early_requests) {
            self.requests.handle(query, time_ms, &mut self.context);
        }
    }

    /// Returns the time of day, in milliseconds since 1970, that a majority of the voters confirms.
    fn confirmed_ms(&self) -> Option<u64> {
        self.context.time.now_ms()
    }

    fn voters<C: FromIterator<NodeId>>(&self) -> C {
        self.context.settings.parts.replica.leadership().borrow().voters.values().cloned().collect()
    }

    fn since_ms(&self) -> u64 {
        let elapsed = self.context.now().since(self.context.since);
        u64::try_from(elapsed.as_millis()).unwrap_or(u64::MAX)
    }

    fn update_members(&mut self) {
        let now = self.context.now();
        let freed = self.members.update(&self.context, now);
        if freed.is_empty() {
            return;
        }
        match self.context.settings.auctions.asks_candidates(self.members.count()) {
            true => self.auctions.wake(&freed, &self.context, now),
            false => self.auctions.wake_all(now),
        }
        self.reauctions.shorten_intervals();
    }

    /// Starts the voter change that is due.
    fn start_voter_change(&mut self) {
        let NodeParts { replica, knowledge, .. } = &self.context.settings.parts;
        let Some(change) = self.autopilot.next_action(replica, knowledge) else { return };
        info!(reason = change.reason(), "changing the voters");
        let (replica, mailbox, term) = (replica.clone(), self.context.mailbox.clone(), self.context.term);
        self.voter_change.spawn(async move {
            let result = perform(replica, change).await;
            // The actor ends with the node.
            let _ = mailbox.cast(CoordinatorMessage::VotersChanged { term, result });
        });
    }

    pub(super) async fn handle_voters_changed(&mut self, done: ActionResult) {
        match self.autopilot.complete(done) {
            Ok(reason) => self.context.publish_event(EventKind::Voters { voters: self.voters(), reason }),
            Err((reason, problem)) => warn!(reason, %problem, "voters were not changed"),
        }
        // A node in decommission waits for a beacon without its name among the voters.
        self.beacons.publish().await;
    }

    /// Compares the ledger with the session, publishes changes and performs the pending actions of all missions.
    fn reconcile(&mut self) {
        let changes = self.read_changes();
        self.reconcile_missions(&changes, Examined::All);
    }

    /// Does the same for the missions that commits have changed. Several commits cost a single comparison: the later
    /// messages find no new entry.
    pub(super) fn follow_ledger(&mut self) {
        if *self.context.settings.parts.replica.applied().borrow() != self.followed {
            let changes = self.read_changes();
            self.reconcile_missions(&changes, Examined::Changed);
        }
    }

    /// Returns the missions that have changed since the last call.
    fn read_changes(&mut self) -> MissionChanges {
        let LeaderSession { context, cursor, followed, .. } = self;
        *followed = *context.settings.parts.replica.applied().borrow();
        context.read_ledger(|ledger| ledger.changes_since(cursor))
    }

    fn reconcile_missions(&mut self, changes: &MissionChanges, examined: Examined) {
        let now = self.context.now();
        let confirmed_ms = self.confirmed_ms();
        self.orders.follow(&mut self.context, now, confirmed_ms);
        self.resources.follow(&mut self.context, now, confirmed_ms);
        let robots = self.changes.publish(&mut self.context, changes, now);
        let scope = match (examined, changes) {
            (Examined::Changed, MissionChanges::These(missions)) => Scope::Changed { missions, robots: &robots },
            (Examined::All, _) | (_, MissionChanges::All) => Scope::All,
        };
        for action in self.pending_actions(scope, now) {
            self.perform(action, now);
        }
        self.auctions.clear(&mut self.context);
        self.people.follow(&mut self.context, (changes, scope), now, confirmed_ms);
        self.submit_occurrences(now, confirmed_ms);
        self.swaps.follow(&mut self.context, now, confirmed_ms);
    }

    /// Calls for bids for a promised role, if that is due.
    fn auction_again(&mut self) {
        let (now, confirmed_ms) = (self.context.now(), self.confirmed_ms());
        let LeaderSession { context, auctions, reauctions, .. } = self;
        let terms = context.settings.auctions.promises;
        let due = context.read_ledger(|ledger| reauctions.due(ledger, auctions.rounds(), &terms, now, confirmed_ms));
        if let Some(reauction) = due {
            reauctions::call_again(reauction, auctions.rounds(), context, now);
        }
    }

    /// Proposes the occurrences of schedules that are due.
    fn submit_occurrences(&mut self, now: NodeTime, confirmed_ms: Option<u64>) {
        let (Some(now_ms), LeaderSession { context, schedules, .. }) = (confirmed_ms, self) else { return };
        let missions_max = context.settings.request_limits.missions_max;
        let commands = context.read_ledger(|ledger| {
            let has_room = missions_max == 0 || !ledger.has_active(missions_max);
            schedules.due(ledger, now, now_ms, has_room)
        });
        for command in commands {
            context.propose(command);
        }
    }

    fn pending_actions(&mut self, scope: Scope<'_>, now: NodeTime) -> Vec<CoordinatorAction> {
        let confirmed_ms = self.confirmed_ms();
        let LeaderSession { context, auctions, held_roles, failing, .. } = self;
        context.confirmed_ms = confirmed_ms;
        context.read_ledger(|ledger| {
            let mut lease_monitor = context.lease_monitor.lock();
            match scope {
                Scope::All => {
                    let epochs = track_awards(ledger, &mut lease_monitor, now);
                    auctions.follow(ledger, now);
                    failing.retain(|mission, _| ledger.mission(mission).is_some_and(|entry| !entry.state.is_final()));
                    held_roles.follow(ledger, &epochs, &mut lease_monitor, now);
                }
                Scope::Changed { missions, .. } => {
                    track_new_awards(scope, ledger, &mut lease_monitor, now);
                    auctions.follow_changed(missions, ledger, now);
                }
            }
            let (rounds, notified) = (auctions.rounds(), held_roles.notified());
            let NodeParts { knowledge, .. } = &context.settings.parts;
            let unfit = &unfit_robots(ledger, scope, knowledge, context.has_all_records(now));
            let AuctionSettings { promises, limits, .. } = &context.settings.auctions;
            let charges = &recorded_charges(ledger, scope, knowledge, limits);
            let PromiseTerms { promises_max, ahead, .. } = *promises;
            let state =
                SessionState { lease_monitor: &lease_monitor, rounds, notified, unfit, charges, promises_max, ahead };
            let actions = pending_actions(ledger, &state, scope, now, confirmed_ms);
            stop_renewing_released(&actions, &mut lease_monitor, now);
            actions
        })
    }

    fn perform(&mut self, action: CoordinatorAction, now: NodeTime) {
        match action {
            CoordinatorAction::CallForBids(mission) => {
                let session_age = now.since(self.context.since);
                let was_found = self.changes.time_known(&mission, now) == Some(session_age);
                self.auctions.call_or_hold_back(&mission, was_found, &mut self.context, now);
            }
            CoordinatorAction::NotifyAward(awarded) => self.held_roles.notify_award(awarded, &mut self.context, now),
            CoordinatorAction::AwardPromised(promised) => {
                self.held_roles.award_promised(promised, &mut self.context, now);
            }
            CoordinatorAction::ReleaseRole(awarded, cause) => {
                self.held_roles.release(awarded, cause, &mut self.context, now);
            }
            CoordinatorAction::AskToGiveWay { awarded, to, for_now } => {
                self.held_roles.ask_to_give_way(awarded, (to, for_now), &mut self.context, now);
            }
            CoordinatorAction::AskToReturn { awarded, order } => {
                self.held_roles.ask_to_return(awarded, &order, &mut self.context, now);
            }
            CoordinatorAction::FailMission { mission, cause, class } => {
                self.fail_mission(mission, (cause, class), now);
            }
        }
    }

    fn fail_mission(&mut self, mission: MissionId, cause: (String, CauseClass), now: NodeTime) {
        if self.failing.get(&mission).is_none_or(|at| now.since(*at) >= FAIL_RETRY_DELAY) {
            self.failing.insert(mission.clone(), now);
            self.context.fail_mission(mission, cause, None);
        }
    }

    pub(super) fn close_bidding(&mut self, bids: CollectedBids) {
        match bids.again.clone() {
            Some(reauction) => {
                let LeaderSession { auctions, reauctions, context, .. } = self;
                reauctions::conclude(bids, &reauction, auctions.rounds(), reauctions, context);
            }
            None => self.auctions.close_bidding(bids, &mut self.context),
        }
    }

    pub(super) fn handle_auction_recorded(
        &mut self,
        auction: &AuctionId,
        outcome: Result<CommandOutcome, ProposeError>,
    ) {
        let now = self.context.now();
        let time_known = self.changes.time_known(&auction.mission, now);
        self.auctions.handle_recorded(auction, outcome, time_known, &self.context);
        let mut changes = self.read_changes();
        if let MissionChanges::These(missions) = &mut changes {
            missions.insert(auction.mission.clone()); // the end of its round is no change of the ledger
        }
        self.reconcile_missions(&changes, Examined::Changed);
    }

    /// Handles the reply of a robot to an award notice: a declined role is released. A robot that has not yet
    /// learned the end of its former role gets the notice again.
    pub(super) fn handle_notice_reply(&mut self, awarded: AwardedRole, reply: AwardReply) {
        if let AwardReply::Declined(DeclineReason::Busy { mission, role }) = &reply {
            let holds = |ledger: &Ledger| {
                ledger.held_by(&awarded.robot).is_some_and(|(held, id, _)| held.id == *mission && id == role)
            };
            if !self.context.read_ledger(holds) {
                return;
            }
        }
        if let AwardReply::Declined(why) = reply {
            let cause = format!("{} declined: {why}", awarded.robot);
            self.context.release_role(awarded, cause, None);
        }
    }

    pub(super) fn acknowledge_orders(&mut self, robot: &RobotId, as_of: Epoch) {
        self.orders.acknowledge(robot, as_of);
    }

    /// Proposes the question of a robot, or its withdrawal. Until the time of day is confirmed, the robot
    /// repeats its question.
    pub(super) fn handle_question(&mut self, mission: MissionId, role: RoleId, epoch: Epoch, question: TaskQuestion) {
        if let Some(asked_ms) = self.confirmed_ms() {
            self.context.propose(Command::SetQuestion { mission, role, epoch, question, asked_ms });
        }
    }

    pub(super) fn handle_person_event(&mut self, sample: &Sample) {
        let confirmed_ms = self.confirmed_ms();
        self.people.handle_event(&mut self.context, sample, confirmed_ms);
    }

    pub(super) fn handle_person_reply(&mut self, id: GoalId, request: PersonRequestState, author: &Author) {
        let confirmed_ms = self.confirmed_ms();
        self.people.handle_reply(&mut self.context, id, request, author, confirmed_ms);
    }

    pub(super) fn handle_api(&mut self, query: Query) {
        let time_ms = self.confirmed_ms();
        if time_ms.is_none() && self.early_requests.len() < EARLY_REQUESTS_MAX {
            self.early_requests.push(query);
            return;
        }
        self.requests.handle(query, time_ms, &mut self.context);
    }

    /// Returns the status of this session.
    pub(super) fn status(&self) -> CoordinatorStatus {
        CoordinatorStatus { term: self.context.term, since_ms: self.since_ms(), autopilot: self.autopilot.status() }
    }
}

/// Missions that a reconciliation examines.
#[derive(Clone, Copy)]
enum Examined {
    /// All, since time has passed.
    All,
    /// Those that have changed.
    Changed,
}

/// Returns the time of a voter's clock, in milliseconds since 1970; `None` without a reply.
async fn read_clock(bus: &SharedBus, key: &str) -> Option<u64> {
    let mut replies = bus.query(key, Bytes::new(), CLOCK_TIMEOUT).await.ok()?;
    codec::decode(&replies.recv().await?.payload.ok()?).ok()
}

/// Records the cluster id and the wire version in a new ledger, and the limits of the history in a ledger
/// with others.
fn found_ledger(context: &mut SessionContext) {
    let (replica, limits) = (context.settings.parts.replica.clone(), context.settings.history_limits);
    if replica.cluster().borrow().is_none() {
        let (cluster, wire) = (ClusterId(context.settings.cluster_seed), first_version(&context.settings.parts));
        context.tasks.spawn(async move {
            // On failure this node no longer leads, and the next leader retries.
            match replica.propose(Command::Bootstrap { cluster }, BOOTSTRAP_TIMEOUT).await {
                Ok(_) => info!(%cluster, "founded the ledger"),
                Err(problem) => debug!(%cluster, %problem, "did not found the ledger"),
            }
            if let Err(problem) = replica.propose(Command::first_wire_version(wire), BOOTSTRAP_TIMEOUT).await {
                debug!(%problem, "wire version was not recorded");
            }
            if let Some(command) = replica.read(|ledger| change_of_limits(ledger, limits))
                && let Err(problem) = replica.propose(command, BOOTSTRAP_TIMEOUT).await
            {
                debug!(%problem, "limits of the history were not recorded");
            }
        });
    } else if replica.read(Ledger::wire).is_none() {
        // The founder died before this proposal. Until then, each node has written the oldest version
        // that it writes, which every node reads.
        context.propose(Command::first_wire_version(codec::FIRST_VERSION));
    } else if let Some(command) = replica.read(|ledger| change_of_limits(ledger, limits)) {
        context.propose(command);
    }
}

/// Returns the command that changes the limits of a ledger's history to those of this fleet. `None` if
/// they are the same, or if the ledger has no history.
fn change_of_limits(ledger: &Ledger, limits: HistoryLimits) -> Option<Command> {
    let in_force = ledger.history_limits()?;
    (in_force != limits).then_some(Command::SetHistoryLimits(limits))
}

/// Returns the wire version of a newly founded fleet: the newest, unless a known node cannot read
/// it.
fn first_version(parts: &NodeParts) -> u8 {
    let VersionRange { oldest, newest } = parts.wire_version.supported();
    let read_by_all = parts
        .knowledge
        .read(|base| base.iter().all(|(_, stored)| stored.record.knowledge.supported_versions.contains(newest)));
    if read_by_all { newest } else { oldest }
}
