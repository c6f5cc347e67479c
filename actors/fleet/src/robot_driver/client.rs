//! The driver client: a goal tracker that skills use without waiting, and the actor that keeps it
//! up to date.

use super::goal_tracker::GoalTracker;
use super::messages::{DriverState, GoalRequest};
use super::questions::OpenQuestion;
use super::ways::SharedWays;
use crate::shared_exchanges::SharedExchanges;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::tasks::{Forwarded, Tasks};
use consort_bus::{Reply, Sample, SharedBus, Stream};
use consort_protocol::codec;
use consort_protocol::ensemble::ExchangedValue;
use consort_protocol::ids::{ActionName, EnsembleId, PlaceId, RobotId};
use consort_protocol::keys::{DriverCall, Key, Keys};
use consort_protocol::ledger::PersonQuestion;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{MetresPerSecond, NodeTime};
use consort_skills::actions::{Goal, GoalId, GoalResult, GoalStatus, RobotActions, Telemetry};
use consort_skills::environment::SpeedLimits;
use ractor::{Actor, ActorCell, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, warn};

/// Interval of commands while the driver is idle. A guess: well below the 3 s after which a server
/// declares a client timeout, which matters only while a goal is in progress.
const IDLE_INTERVAL: Duration = Duration::from_millis(800);

/// Settings of a driver client.
#[derive(Clone)]
pub struct DriverClientSettings {
    /// The robot.
    pub robot: RobotId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// First goal id: different for each incarnation of the node, so that no id is used twice.
    pub first_goal: u64,
    /// Interval of commands to the server while a goal is in progress or the server does not reply.
    /// An idle driver gets a command only when the last reply is 0.8 s old. Raised: a lost command
    /// is repeated later. Default 300 ms.
    pub heartbeat_interval: Duration,
    /// Time to wait for an answer of people, in seconds, of questions that state none; `None` for no limit.
    pub patience_s: Option<u32>,
    /// Time from the cancel of a goal to its end, by action, for actions that declare it. The permission of such
    /// goals ends before the lease.
    pub cancel_times: BTreeMap<ActionName, Duration>,
}

/// Driver of a robot. Clones share the same goal tracker; each clone has its own copy of the
/// telemetry.
#[derive(Clone)]
pub struct RobotDriver {
    tracker: Arc<Mutex<GoalTracker>>,
    requests: ActorRef<DriverClientMessage>,
    /// Question of its skill to people.
    question: OpenQuestion,
    /// Values of other members of its ensembles.
    exchanges: SharedExchanges,
    clock: Clock,
    /// Way that a skill requests from the devices of the building.
    ways: SharedWays,
    /// Orders of people about the map, for all clones.
    shared_orders: Arc<Mutex<MapOrders>>,
    /// The same as of this clone's last [`refresh`](RobotDriver::refresh).
    orders: MapOrders,
    /// Telemetry as of this clone's last [`refresh`](RobotDriver::refresh), with the closures of people.
    telemetry: Option<Telemetry>,
}

/// Orders of people about the map, for the routes of the robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct MapOrders {
    /// Closed lanes by their ends, and each closed place twice.
    pub(crate) closed: Vec<(PlaceId, PlaceId)>,
    /// Speed limits.
    pub(crate) limits: SpeedLimits,
    /// Average speed of the robot without limits.
    pub(crate) speed: Option<MetresPerSecond>,
}

/// Message for the driver client.
pub(super) enum DriverClientMessage {
    /// Requests wait to be sent.
    SendRequests,
    /// Periodic timer: send a heartbeat and repeat requests without a reply.
    Heartbeat,
    /// The server has published a state.
    State(Forwarded<Sample>),
    /// The server has replied to a command with this request.
    CommandReplied(Option<GoalRequest>, Reply),
}

/// The driver client actor.
struct DriverClient;

/// State of [`DriverClient`].
struct DriverClientState {
    settings: DriverClientSettings,
    driver: RobotDriver,
    /// Time of the latest reply to a command.
    last_reply_at: Option<Instant>,
    tasks: Tasks,
}

impl RobotDriver {
    /// Starts a driver client under a supervisor.
    ///
    /// # Errors
    /// The actor cannot start because the bus is closed.
    pub async fn connect(
        settings: DriverClientSettings,
        supervisor: &ActorCell,
    ) -> Result<RobotDriver, ractor::SpawnErr> {
        let (driver_sender, mut driver_receiver) = tokio::sync::mpsc::unbounded_channel();
        Actor::spawn_linked(None, DriverClient, (settings, driver_sender), supervisor.clone()).await?;
        Ok(driver_receiver.recv().await.expect("the actor hands out its driver before it has started"))
    }

    /// Lets its skills read the values that members of ensembles exchange. Without them all are unknown.
    pub(crate) fn with_exchanges(self, exchanges: SharedExchanges) -> RobotDriver {
        RobotDriver { exchanges, ..self }
    }

    /// Lets its skills request ways from the devices of the building. Without them all ways are free.
    pub(crate) fn with_ways(self, ways: SharedWays) -> RobotDriver {
        RobotDriver { ways, ..self }
    }

    /// Returns the way that a skill requests from the devices of the building.
    pub(crate) fn ways(&self) -> &SharedWays {
        &self.ways
    }

    /// Returns a counter of received states, which notifies its receivers of each new state.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.lock().changes()
    }

    /// Copies the latest telemetry, which [`RobotActions::telemetry`] then returns.
    pub fn refresh(&mut self) {
        let latest = self.lock().telemetry().cloned();
        let orders = self.lock_orders().clone();
        self.orders = orders;
        self.telemetry = latest.map(|mut telemetry| {
            telemetry.closed.extend(self.orders.closed.iter().cloned());
            telemetry
        });
    }

    /// Sets the orders of people about the map. Each clone uses them from its next
    /// [`refresh`](RobotDriver::refresh) on.
    pub(crate) fn set_map_orders(&self, orders: MapOrders) {
        *self.lock_orders() = orders;
    }

    fn lock_orders(&self) -> MutexGuard<'_, MapOrders> {
        // Each write is a single step.
        self.shared_orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the latest readings; `None` before the first state.
    pub(crate) fn readings(&self) -> Option<BTreeMap<String, Scalar>> {
        self.lock().telemetry().map(|telemetry| telemetry.readings.clone())
    }

    /// Returns the latest feedback of the goal in progress; `None` before the first state.
    pub(crate) fn feedback(&self) -> Option<BTreeMap<String, Scalar>> {
        let tracker = self.lock();
        tracker.telemetry().map(|_| tracker.feedback())
    }

    /// Returns the age of the latest telemetry in milliseconds; 0 before the first.
    pub(crate) fn telemetry_age_ms(&self) -> u64 {
        let reported_at = self.lock().last_report_at();
        reported_at.map_or(0, |at| u64::try_from(at.elapsed().as_millis()).unwrap_or(u64::MAX))
    }

    /// Returns the time since the latest state of the driver.
    pub(crate) fn silent_for(&self) -> Duration {
        self.lock().silent_for()
    }

    /// Checks whether a state has arrived and no goal is in progress, including goals of previous
    /// incarnations of the client.
    pub fn is_idle(&self) -> bool {
        self.lock().is_idle()
    }

    /// Returns the time by which the permission of the goals in progress ends before the lease.
    pub(crate) fn stop_lead(&self) -> Duration {
        self.lock().stop_lead()
    }

    /// Lets the robot act until this time of the node's clock; `None` forbids it, as at the start.
    /// The driver server stops the robot at that time, and earlier by its
    /// [lead](consort_protocol::lease::stop_lead) if it may take long to stop. A goal that is sent meanwhile waits.
    pub fn allow_until(&self, until: Option<NodeTime>) {
        self.lock().allow_until(until);
    }

    /// Cancels every goal in progress: the robot stops safely.
    pub fn stop(&self) {
        self.lock().cancel_all();
        self.notify_client();
    }

    /// Returns the question of its skill to people.
    pub(crate) fn question(&self) -> &OpenQuestion {
        &self.question
    }

    /// Returns the id of the next goal.
    pub(crate) fn next_goal(&self) -> GoalId {
        self.lock().next_goal()
    }

    /// Begins an attempt at a task. `first` is the first goal of the task, perhaps of a previous
    /// incarnation of this node.
    pub(crate) fn begin_attempt(&self, first: GoalId) {
        self.lock().begin_attempt(first);
    }

    /// Checks whether no goal of the task with this first goal has moved an item, as far as can be said for
    /// certain.
    pub(crate) fn moved_nothing(&self, first: GoalId) -> bool {
        self.lock().moved_nothing(first)
    }

    fn lock(&self) -> MutexGuard<'_, GoalTracker> {
        // A panic of a skill under the lock leaves no partial write, because each write is a single
        // step.
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn notify_client(&self) {
        // Without its actor the tracker is outdated. The robot's supervisor handles the failure.
        let _ = self.requests.cast(DriverClientMessage::SendRequests);
    }
}

impl RobotActions for RobotDriver {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        let id = self.lock().start_goal(goal);
        self.notify_client();
        id
    }

    fn status(&self, goal: GoalId) -> Option<GoalStatus> {
        self.lock().status(goal).cloned()
    }

    fn cancel(&mut self, goal: GoalId) {
        if self.lock().cancel(goal) {
            self.notify_client();
        }
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    fn closed_by_people(&self) -> &[(PlaceId, PlaceId)] {
        &self.orders.closed
    }

    fn speed(&self) -> Option<MetresPerSecond> {
        self.orders.speed
    }

    fn speed_limits(&self) -> Option<&SpeedLimits> {
        Some(&self.orders.limits)
    }

    fn request_way(&mut self, from: &PlaceId, to: &PlaceId, then: &[PlaceId]) -> bool {
        self.ways.request(from, to, then, self.clock.now())
    }

    fn end_way(&mut self) {
        self.ways.end();
    }

    fn member_value(&self, ensemble: &EnsembleId, robot: &RobotId, value: &ExchangedValue) -> Option<Scalar> {
        self.exchanges.value(ensemble, robot, value, self.clock.now())
    }

    fn ask_person(&mut self, question: &PersonQuestion) -> Option<Result<String, String>> {
        self.question.ask(question)
    }

    fn withdraw_question(&mut self) {
        self.question.withdraw();
    }

    fn take_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        self.lock().claim_completed(goal)
    }
}

/// Returns the first reply without an error, else the last error: servers of other robots receive
/// the command, too.
async fn first_reply(mut replies: Stream<Reply>) -> Option<Reply> {
    let mut error_reply = None;
    while let Some(reply) = replies.recv().await {
        if reply.payload.is_ok() {
            return Some(reply);
        }
        error_reply = Some(reply);
    }
    error_reply
}

#[ractor::async_trait]
impl Actor for DriverClient {
    type Msg = DriverClientMessage;
    type State = DriverClientState;
    type Arguments = (DriverClientSettings, tokio::sync::mpsc::UnboundedSender<RobotDriver>);

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        (settings, driver_sender): Self::Arguments,
    ) -> Result<Self::State, ActorProcessingErr> {
        let tracker = GoalTracker::new(settings.first_goal).with_cancel_times(&settings.cancel_times);
        let driver = RobotDriver {
            tracker: Arc::new(Mutex::new(tracker)),
            requests: myself.clone(),
            question: OpenQuestion::new(settings.patience_s),
            exchanges: SharedExchanges::default(),
            clock: settings.clock,
            ways: SharedWays::default(),
            shared_orders: Arc::default(),
            orders: MapOrders::default(),
            telemetry: None,
        };
        let mut tasks = Tasks::default();
        let state_key = settings.keys.write(&Key::Driver(settings.robot.clone(), DriverCall::State));
        tasks.forward_samples(settings.bus.subscribe(&state_key).await?, &myself, DriverClientMessage::State);
        tasks.send_every(settings.heartbeat_interval, &myself, || DriverClientMessage::Heartbeat);
        myself.cast(DriverClientMessage::Heartbeat)?;
        driver_sender.send(driver.clone())?;
        Ok(DriverClientState { settings, driver, last_reply_at: None, tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            DriverClientMessage::SendRequests => state.send(&myself, false),
            DriverClientMessage::Heartbeat => state.send(&myself, true),
            DriverClientMessage::State(sample) => state.receive_state(&sample.payload),
            DriverClientMessage::CommandReplied(request, reply) => state.handle_reply(request, reply),
        }
        Ok(())
    }
}

impl DriverClientState {
    /// Sends the requests without a reply. On a timer, sends a heartbeat if there is none.
    fn send(&mut self, myself: &ActorRef<DriverClientMessage>, on_timer: bool) {
        let requests = self.driver.lock().pending_requests().to_vec();
        let replied_recently = self.last_reply_at.is_some_and(|at| at.elapsed() < IDLE_INTERVAL);
        if requests.is_empty() && (!on_timer || replied_recently && self.driver.is_idle()) {
            return;
        }
        let commands: Vec<Option<GoalRequest>> =
            if requests.is_empty() { vec![None] } else { requests.into_iter().map(Some).collect() };
        let key = self.settings.keys.write(&Key::Driver(self.settings.robot.clone(), DriverCall::Command));
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.heartbeat_interval, myself.clone());
        let (driver, clock) = (self.driver.clone(), self.settings.clock);
        self.tasks.spawn(async move {
            for request in commands {
                // The permission is that of the instant at which the command is sent.
                let command = driver.lock().command(request, clock.now());
                let bytes = codec::encode(&command).expect("a goal fits a message");
                let Ok(replies) = bus.query(&key, Bytes::from(bytes), limit).await else { return };
                // The next request waits for this reply: a goal must not be canceled before its
                // start.
                let Some(reply) = first_reply(replies).await else { return };
                if to.cast(DriverClientMessage::CommandReplied(command.request, reply)).is_err() {
                    return;
                }
            }
        });
    }

    fn handle_reply(&mut self, request: Option<GoalRequest>, reply: Reply) {
        match reply.payload {
            Ok(payload) => {
                self.last_reply_at = Some(Instant::now());
                if let Some(request) = request {
                    self.driver.lock().confirm(&request);
                }
                self.receive_state(&payload);
            }
            Err(refused) => {
                debug!(robot = %self.settings.robot, problem = refused.0, "driver server refused a command");
            }
        }
    }

    fn receive_state(&mut self, payload: &[u8]) {
        match codec::decode::<DriverState>(payload) {
            Ok(state) if state.robot == self.settings.robot => {
                if self.driver.lock().apply_state(state, self.settings.clock.now()) {
                    self.driver.notify_client();
                }
            }
            Ok(state) => warn!(robot = %self.settings.robot, other = %state.robot, "state of another robot"),
            Err(problem) => warn!(robot = %self.settings.robot, %problem, "state cannot be decoded"),
        }
    }
}
