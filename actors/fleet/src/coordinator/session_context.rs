//! Context of a leader session: what its parts share, and the ways in which they act.

use super::confirmed_time::ConfirmedTime;
use super::last_known_place::{last_known_place, last_known_places};
use super::lease_monitor::SharedLeaseMonitor;
use super::message::{AwardedRole, CoordinatorMessage};
use super::open_replies::OpenReplies;
use super::settings::{CoordinatorSettings, NodeParts};
use bytes::Bytes;
use consort_bus::SharedBus;
use consort_bus::tasks::Tasks;
use consort_protocol::cause::CauseClass;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, PlaceId, RobotId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{Branch, Command, CommandOutcome, Ledger};
use consort_protocol::message::{AwardNotice, AwardReply, OrdersNotice};
use consort_protocol::units::NodeTime;
use ractor::ActorRef;
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, warn};

/// Timeout for the ledger to commit the release of a role, the end of a mission or a change of the lease of a charger.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(1);

/// Timeout for the ledger to commit an award.
pub(super) const AWARD_TIMEOUT: Duration = Duration::from_secs(2);

/// Timeout for the reply of a robot to a notice.
const NOTICE_TIMEOUT: Duration = Duration::from_millis(500);

/// Context of a leader session. Dropping it aborts all tasks of the session.
pub(super) struct SessionContext {
    pub(super) settings: CoordinatorSettings,
    /// Mailbox of the coordinator actor.
    pub(super) mailbox: ActorRef<CoordinatorMessage>,
    pub(super) term: u64,
    /// Start of the session.
    pub(super) since: NodeTime,
    pub(super) lease_monitor: SharedLeaseMonitor,
    pub(super) open_replies: OpenReplies,
    pub(super) time: ConfirmedTime,
    /// Time of day that a majority of the voters confirmed at the latest reconciliation, in milliseconds since 1970.
    pub(super) confirmed_ms: Option<u64>,
    pub(super) tasks: Tasks,
}

impl SessionContext {
    pub(super) fn new(
        settings: CoordinatorSettings,
        mailbox: ActorRef<CoordinatorMessage>,
        term: u64,
        tasks: Tasks,
    ) -> SessionContext {
        let NodeParts { node, clock, replica, .. } = &settings.parts;
        let (since, time) = (clock.now(), ConfirmedTime::new(node.clone(), *clock, replica.clone()));
        let lease_monitor = SharedLeaseMonitor::new(settings.lease_terms);
        SessionContext {
            settings,
            mailbox,
            term,
            since,
            lease_monitor,
            open_replies: OpenReplies::default(),
            time,
            confirmed_ms: None,
            tasks,
        }
    }

    /// Returns the time of the node's clock.
    pub(super) fn now(&self) -> NodeTime {
        self.settings.parts.clock.now()
    }

    /// Checks whether the session is old enough for the records of all robots: until then a new coordinator may lack some.
    pub(super) fn has_all_records(&self, now: NodeTime) -> bool {
        let LeaseTerms { lease, grace } = self.settings.lease_terms;
        now.since(self.since) > lease + grace
    }

    /// Reads the node's copy of the ledger.
    pub(super) fn read_ledger<R>(&self, read: impl FnOnce(&Ledger) -> R) -> R {
        self.settings.parts.replica.read(read)
    }

    /// Publishes an event of this node.
    pub(super) fn publish_event(&self, event: EventKind) {
        self.settings.parts.events.publish(event);
    }

    /// Sends the result of a task to the coordinator actor. If the coordinator has stopped, the
    /// next coordinator continues from the ledger.
    pub(super) fn send_result(&mut self, task: impl Future<Output = CoordinatorMessage> + Send + 'static) {
        let mailbox = self.mailbox.clone();
        self.tasks.spawn(async move {
            let _ = mailbox.cast(task.await);
        });
    }

    /// Proposes a command in the background. The ledger shows its outcome.
    pub(super) fn propose(&mut self, command: Command) {
        let command = command.limited();
        let replica = self.settings.parts.replica.clone();
        self.tasks.spawn(async move {
            let outcome = replica.propose(command.clone(), RELEASE_TIMEOUT).await;
            if !matches!(outcome, Ok(CommandOutcome::Done | CommandOutcome::Submitted { .. })) {
                debug!(?command, ?outcome, "proposal was not applied");
            }
        });
    }

    /// Proposes the grant or the end of the lease of a charger or a device in the background. Publishes the event once
    /// the command is committed; a repetition is refused.
    pub(super) fn propose_lease_change(&mut self, command: Command, event: EventKind) {
        let (replica, events) = (self.settings.parts.replica.clone(), self.settings.parts.events.clone());
        self.tasks.spawn(async move {
            match replica.propose(command, RELEASE_TIMEOUT).await {
                Ok(CommandOutcome::Done) => events.publish(event),
                // It is proposed again, if it is still due.
                outcome => debug!(?event, ?outcome, "a lease was not changed"),
            }
        });
    }

    /// Proposes a command that gives a role to a robot, or that promises the role to it. Publishes it once it is committed.
    pub(super) fn propose_award(
        &mut self,
        command: Command,
        (mission, role, robot): (MissionId, RoleId, RobotId),
        is_promised: bool,
    ) {
        let (replica, events) = (self.settings.parts.replica.clone(), self.settings.parts.events.clone());
        self.tasks.spawn(async move {
            match replica.propose(command.limited(), AWARD_TIMEOUT).await {
                Ok(CommandOutcome::Awarded { epoch }) => {
                    let (given, none) = (BTreeMap::from([(role, robot)]), BTreeMap::new());
                    let (holders, promised) = if is_promised { (none, given) } else { (given, none) };
                    events.publish(EventKind::Awarded { mission, holders, promised, epoch, after_ms: None });
                }
                // A later reconciliation proposes it again, if it is still due.
                outcome => debug!(%mission, %role, ?outcome, "role was not awarded"),
            }
        });
    }

    /// Returns the last known places of the robots of a mission.
    pub(super) fn places_of(&self, mission: &MissionId) -> BTreeMap<RobotId, PlaceId> {
        let knowledge = &self.settings.parts.knowledge;
        self.read_ledger(|ledger| last_known_places(knowledge, ledger.mission(mission)))
    }

    /// Proposes the failure of a mission by a cause of a class.
    pub(super) fn fail_mission(
        &mut self,
        mission: MissionId,
        (cause, class): (String, CauseClass),
        branch: Option<Branch>,
    ) {
        let places = self.places_of(&mission);
        self.propose(Command::Fail { mission, cause, branch, places, class });
    }

    /// Proposes the release of a role whose holder was lost, or failed with a cause of this class.
    pub(super) fn release_role(&mut self, awarded: AwardedRole, cause: String, class: Option<CauseClass>) {
        let AwardedRole { mission, role, robot, epoch } = awarded;
        let place = last_known_place(&self.settings.parts.knowledge, &robot);
        let (moved_nothing, gave_way) = (false, false);
        self.propose(Command::Release { mission, role, epoch, cause, class, moved_nothing, place, gave_way });
    }

    /// Notifies a robot of the end of an award.
    pub(super) fn notify(&mut self, robot: RobotId, notice: &AwardNotice) {
        let Some(sending) = self.notice(robot, notice) else { return };
        self.tasks.spawn(async move { drop(sending.await) });
    }

    /// Notifies a robot of its award.
    pub(super) fn notify_award(&mut self, awarded: AwardedRole, notice: &AwardNotice) {
        let Some(sending) = self.notice(awarded.robot.clone(), notice) else { return };
        let mailbox = self.mailbox.clone();
        self.tasks.spawn(async move {
            if let Some(reply) = sending.await {
                // If the coordinator has stopped, the next coordinator sends the award notice.
                let _ = mailbox.cast(CoordinatorMessage::NoticeReplied(awarded, reply));
            }
        });
    }

    /// Notifies a robot of the orders of people.
    pub(super) fn notify_orders(&mut self, robot: RobotId, notice: OrdersNotice) {
        let as_of = notice.as_of;
        let Some(sending) = self.notice(robot.clone(), &AwardNotice::Orders(Box::new(notice))) else { return };
        let mailbox = self.mailbox.clone();
        self.tasks.spawn(async move {
            if sending.await.is_some() {
                // If the coordinator has stopped, the next coordinator sends the orders.
                let _ = mailbox.cast(CoordinatorMessage::OrdersAcknowledged { robot, as_of });
            }
        });
    }

    /// Encodes a notice. Returns the task that sends it and waits for the reply.
    fn notice(
        &self,
        robot: RobotId,
        notice: &AwardNotice,
    ) -> Option<impl Future<Output = Option<AwardReply>> + Send + use<>> {
        let key = self.settings.parts.keys.write(&Key::Award(robot.clone()));
        match codec::encode(notice) {
            Ok(bytes) => Some(send_notice(self.settings.parts.bus.clone(), key, robot, bytes.into())),
            Err(problem) => {
                warn!(%robot, %problem, "award notice does not fit a message");
                None
            }
        }
    }
}

async fn send_notice(bus: SharedBus, key: String, robot: RobotId, notice: Bytes) -> Option<AwardReply> {
    let mut replies = bus.query(&key, notice, NOTICE_TIMEOUT).await.ok()?;
    match replies.recv().await.map(|reply| reply.payload.map(|bytes| codec::decode(&bytes))) {
        Some(Ok(Ok(reply))) => Some(reply),
        other => {
            debug!(%robot, ?other, "award notice got no reply");
            None
        }
    }
}
