//! A robot's node drives its body: a mirror that skills use without waiting, and the actor that keeps it true.

use super::goal_tracker::GoalTracker;
use super::messages::{DriverCommand, DriverState, GoalRequest};
use crate::bus::{Reply, Sample, SharedBus, Stream};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{BodyCall, Key, Keys};
use consort_skills::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use ractor::{Actor, ActorCell, ActorProcessingErr, ActorRef};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, warn};

/// How long an answer will do for a body at rest. A guess: well below the three seconds after which a host takes a driver for
/// silent, which matters only to a body with something under way.
const REST: Duration = Duration::from_millis(800);

/// How a body is driven.
#[derive(Clone)]
pub struct DriverClientSettings {
    /// Whose body.
    pub robot: RobotId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// Ids of goals begin here: different for each life of the node, so that no id is used twice.
    pub first_goal: u64,
    /// How often the host is told that the driver is there, while the body has something to do or the host does not answer;
    /// a body at rest is asked only when its last answer is 0.8 s old. Raised: a lost command is repeated later. Default 300 ms.
    pub heartbeat_interval: Duration,
}

/// The mirror of a body. Clones drive the same body; each shows the report that it last took in.
#[derive(Clone)]
pub struct RobotDriver {
    mirror: Arc<Mutex<GoalTracker>>,
    orders: ActorRef<DriverClientMessage>,
    /// The report as of this clone's last [`refresh`](Body::refresh).
    seen: Option<Telemetry>,
}

/// To the actor that keeps a mirror true.
pub enum DriverClientMessage {
    /// There are orders to send.
    SendRequests,
    /// Time to say that the driver is there, and to repeat what was not answered.
    Heartbeat,
    /// The host published a state.
    State(Sample),
    /// The host answered a command that carried this order.
    CommandReplied(Option<GoalRequest>, Reply),
}

/// Keeps a mirror true.
pub struct DriverClient;

/// State of [`BodyLink`].
pub struct DriverClientState {
    settings: DriverClientSettings,
    body: RobotDriver,
    /// When a command was last answered.
    answered_at: Option<Instant>,
    tasks: Tasks,
}

impl RobotDriver {
    /// Starts driving a body, under a supervisor.
    ///
    /// # Errors
    /// When the actor cannot start: the bus is closed.
    pub async fn connect(
        settings: DriverClientSettings,
        supervisor: &ActorCell,
    ) -> Result<RobotDriver, ractor::SpawnErr> {
        let (hand_out, mut handed_out) = tokio::sync::mpsc::unbounded_channel();
        Actor::spawn_linked(None, DriverClient, (settings, hand_out), supervisor.clone()).await?;
        Ok(handed_out.recv().await.expect("the actor hands out its body before it has started"))
    }

    /// Counts the states heard from the host; wakes whoever waits for the next.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.lock().changes()
    }

    /// Takes in the latest report of the body, for [`RobotActions::telemetry`] to show.
    pub fn refresh(&mut self) {
        let latest = self.lock().telemetry().cloned();
        self.seen = latest;
    }

    /// How long ago the latest report of the body was heard, in milliseconds; 0 before the first.
    pub fn telemetry_age_ms(&self) -> u64 {
        let heard = self.lock().last_report_at();
        heard.map_or(0, |at| u64::try_from(at.elapsed().as_millis()).unwrap_or(u64::MAX))
    }

    /// How long the body has reported nothing.
    pub fn silent_for(&self) -> Duration {
        self.lock().silent_for()
    }

    /// Whether the body has been heard of and has nothing under way, neither of this life of its driver nor of a former one.
    pub fn is_idle(&self) -> bool {
        self.lock().is_idle()
    }

    /// Cancels every goal under way: the body stops safely.
    pub fn stop(&self) {
        self.lock().cancel_all();
        self.send_orders();
    }

    /// The goal that will be sent next.
    pub fn next_goal(&self) -> GoalId {
        self.lock().next_goal()
    }

    /// An attempt begins at a task whose first goal was this one, perhaps in a former life of this node.
    pub fn begin_attempt(&self, first: GoalId) {
        self.lock().begin_attempt(first);
    }

    fn lock(&self) -> MutexGuard<'_, GoalTracker> {
        // A skill that panicked while it looked at the mirror has not left it half written: writes are single steps.
        self.mirror.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send_orders(&self) {
        // Without its actor the mirror is a picture of the past; the robot's supervisor knows.
        let _ = self.orders.cast(DriverClientMessage::SendRequests);
    }
}

impl RobotActions for RobotDriver {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        let id = self.lock().start_goal(goal);
        self.send_orders();
        id
    }

    fn status(&self, goal: GoalId) -> Option<GoalStatus> {
        self.lock().status(goal).cloned()
    }

    fn cancel(&mut self, goal: GoalId) {
        if self.lock().cancel(goal) {
            self.send_orders();
        }
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        self.seen.as_ref()
    }

    fn take_completed(&mut self, goal: &Goal) -> bool {
        self.lock().claim_completed(goal)
    }
}

/// The first answer that is no refusal, else the last refusal: a command is heard by hosts of other bodies, too.
async fn answer(mut replies: Stream<Reply>) -> Option<Reply> {
    let mut refusal = None;
    while let Some(reply) = replies.recv().await {
        if reply.payload.is_ok() {
            return Some(reply);
        }
        refusal = Some(reply);
    }
    refusal
}

#[ractor::async_trait]
impl Actor for DriverClient {
    type Msg = DriverClientMessage;
    type State = DriverClientState;
    type Arguments = (DriverClientSettings, tokio::sync::mpsc::UnboundedSender<RobotDriver>);

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        (settings, hand_out): Self::Arguments,
    ) -> Result<Self::State, ActorProcessingErr> {
        let body = RobotDriver {
            mirror: Arc::new(Mutex::new(GoalTracker::new(settings.first_goal))),
            orders: myself.clone(),
            seen: None,
        };
        let mut tasks = Tasks::default();
        let state_key = settings.keys.write(&Key::Body(settings.robot.clone(), BodyCall::State));
        tasks.forward(settings.bus.subscribe(&state_key).await?, &myself, DriverClientMessage::State);
        tasks.send_every(settings.heartbeat_interval, &myself, || DriverClientMessage::Heartbeat);
        myself.cast(DriverClientMessage::Heartbeat)?;
        hand_out.send(body.clone())?;
        Ok(DriverClientState { settings, body, answered_at: None, tasks })
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
            DriverClientMessage::State(sample) => state.hear(&sample.payload),
            DriverClientMessage::CommandReplied(order, reply) => state.answered(order, reply),
        }
        Ok(())
    }
}

impl DriverClientState {
    /// Sends the orders that were not answered; on a beat also without any.
    fn send(&mut self, myself: &ActorRef<DriverClientMessage>, beat: bool) {
        let orders = self.body.lock().pending_requests().to_vec();
        let answered_lately = self.answered_at.is_some_and(|at| at.elapsed() < REST);
        if orders.is_empty() && (!beat || answered_lately && self.body.is_idle()) {
            return;
        }
        let commands: Vec<Option<GoalRequest>> =
            if orders.is_empty() { vec![None] } else { orders.into_iter().map(Some).collect() };
        let key = self.settings.keys.write(&Key::Body(self.settings.robot.clone(), BodyCall::Command));
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.heartbeat_interval, myself.clone());
        self.tasks.spawn(async move {
            for order in commands {
                let bytes = codec::encode(&DriverCommand { request: order.clone() }).expect("a goal fits a message");
                let Ok(replies) = bus.query(&key, Bytes::from(bytes), limit).await else { return };
                // What follows waits for this to be answered: a goal must not be canceled before it has begun.
                let Some(reply) = answer(replies).await else { return };
                if to.cast(DriverClientMessage::CommandReplied(order, reply)).is_err() {
                    return;
                }
            }
        });
    }

    fn answered(&mut self, order: Option<GoalRequest>, reply: Reply) {
        match reply.payload {
            Ok(payload) => {
                self.answered_at = Some(Instant::now());
                if let Some(order) = order {
                    self.body.lock().confirm(&order);
                }
                self.hear(&payload);
            }
            Err(problem) => debug!(robot = %self.settings.robot, problem, "the host of the body refused a command"),
        }
    }

    fn hear(&mut self, payload: &[u8]) {
        match codec::decode::<DriverState>(payload) {
            Ok(state) if state.robot == self.settings.robot => {
                if self.body.lock().apply_state(state) {
                    self.body.send_orders();
                }
            }
            Ok(state) => warn!(robot = %self.settings.robot, other = %state.robot, "a state of another body"),
            Err(problem) => warn!(robot = %self.settings.robot, %problem, "a state that cannot be read"),
        }
    }
}
