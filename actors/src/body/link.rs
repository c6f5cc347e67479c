//! A robot's node drives its body: a local mirror that skills use without waiting, and the actor that keeps it true.

use super::wire::{BodyCommand, BodyState, Order};
use crate::bus::{Reply, Sample, SharedBus};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{BodyCall, Key, Keys};
use consort_skills::actions::{ActionError, ErrorCode, Goal, GoalId, GoalStatus, RobotActions, Telemetry};
use ractor::{Actor, ActorCell, ActorProcessingErr, ActorRef};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Final states of goals that are remembered.
const REMEMBERED: usize = 32;

/// How long an answer will do for a body at rest. A guess: well below the three seconds after which a host takes a driver for
/// silent, which matters only to a body with something under way.
const REST: Duration = Duration::from_millis(800);

/// How a body is driven.
#[derive(Clone)]
pub struct BodyLinkSettings {
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
    pub beat: Duration,
}

/// The mirror of a body. Clones drive the same body; each shows the report that it last took in.
#[derive(Clone)]
pub struct Body {
    mirror: Arc<Mutex<Mirror>>,
    orders: ActorRef<BodyLinkMessage>,
    /// The report as of this clone's last [`refresh`](Body::refresh).
    seen: Option<Telemetry>,
}

struct Mirror {
    next: u64,
    telemetry: Option<Telemetry>,
    /// When it was heard.
    heard_at: Option<Instant>,
    /// Since when there is a mirror.
    since: Instant,
    number: u64,
    goals: BTreeMap<GoalId, GoalStatus>,
    /// Goals that were done and must not be done again, those of former lives of this node included.
    done: BTreeMap<GoalId, Goal>,
    attempt: Attempt,
    /// Orders that the host has not answered, in the order given.
    unanswered: Vec<Order>,
    changed: watch::Sender<u64>,
}

/// An attempt at a task: what earlier attempts at it have done is not done again.
#[derive(Default)]
struct Attempt {
    /// The goals of earlier attempts, and of none but them, lie in between.
    earlier: std::ops::Range<u64>,
    /// Those of them that this attempt has come upon.
    claimed: BTreeSet<GoalId>,
}

/// To the actor that keeps a mirror true.
pub enum BodyLinkMessage {
    /// There are orders to send.
    Orders,
    /// Time to say that the driver is there, and to repeat what was not answered.
    Beat,
    /// The host published a state.
    State(Sample),
    /// The host answered a command that carried this order.
    Answered(Option<Order>, Reply),
}

/// Keeps a mirror true.
pub struct BodyLink;

/// State of [`BodyLink`].
pub struct BodyLinkState {
    settings: BodyLinkSettings,
    body: Body,
    /// When a command was last answered.
    answered_at: Option<Instant>,
    tasks: Tasks,
}

impl Body {
    /// Starts driving a body, under a supervisor.
    ///
    /// # Errors
    /// When the actor cannot start: the bus is closed.
    pub async fn link(settings: BodyLinkSettings, supervisor: &ActorCell) -> Result<Body, ractor::SpawnErr> {
        let (hand_out, mut handed_out) = tokio::sync::mpsc::unbounded_channel();
        Actor::spawn_linked(None, BodyLink, (settings, hand_out), supervisor.clone()).await?;
        Ok(handed_out.recv().await.expect("the actor hands out its body before it has started"))
    }

    /// Counts the states heard from the host; wakes whoever waits for the next.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.lock().changed.subscribe()
    }

    /// Takes in the latest report of the body, for [`RobotActions::telemetry`] to show.
    pub fn refresh(&mut self) {
        let latest = self.lock().telemetry.clone();
        self.seen = latest;
    }

    /// How long ago the latest report of the body was heard, in milliseconds; 0 before the first.
    pub fn telemetry_age_ms(&self) -> u64 {
        let heard = self.lock().heard_at;
        heard.map_or(0, |at| u64::try_from(at.elapsed().as_millis()).unwrap_or(u64::MAX))
    }

    /// How long the body has reported nothing.
    pub fn silent_for(&self) -> Duration {
        let mirror = self.lock();
        mirror.heard_at.unwrap_or(mirror.since).elapsed()
    }

    /// Whether the body has been heard of and has nothing under way, neither of this life of its driver nor of a former one.
    pub fn is_at_rest(&self) -> bool {
        let mirror = self.lock();
        mirror.telemetry.is_some() && mirror.goals.values().all(GoalStatus::is_final)
    }

    /// Cancels every goal under way: the body stops safely.
    pub fn stop(&self) {
        let mut mirror = self.lock();
        let running: Vec<GoalId> = mirror.goals.iter().filter(|(_, s)| !s.is_final()).map(|(id, _)| *id).collect();
        for id in running {
            mirror.call_off(id);
        }
        drop(mirror);
        self.send_orders();
    }

    /// The goal that will be sent next.
    pub fn next_goal(&self) -> GoalId {
        GoalId(self.lock().next)
    }

    /// An attempt begins at a task whose first goal was this one, perhaps in a former life of this node.
    pub fn begin_attempt(&self, first: GoalId) {
        let mut mirror = self.lock();
        mirror.attempt = Attempt { earlier: first.0..mirror.next, claimed: BTreeSet::new() };
    }

    fn lock(&self) -> MutexGuard<'_, Mirror> {
        // A skill that panicked while it looked at the mirror has not left it half written: writes are single steps.
        self.mirror.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send_orders(&self) {
        // Without its actor the mirror is a picture of the past; the robot's supervisor knows.
        let _ = self.orders.cast(BodyLinkMessage::Orders);
    }
}

impl RobotActions for Body {
    fn send_goal(&mut self, goal: Goal) -> GoalId {
        let mut mirror = self.lock();
        let id = GoalId(mirror.next);
        mirror.next += 1;
        mirror.goals.insert(id, GoalStatus::Sent);
        while mirror.goals.len() > REMEMBERED {
            mirror.goals.pop_first();
        }
        mirror.unanswered.push(Order::Start { id, goal });
        drop(mirror);
        self.send_orders();
        id
    }

    fn status(&self, goal: GoalId) -> Option<GoalStatus> {
        self.lock().goals.get(&goal).cloned()
    }

    fn cancel(&mut self, goal: GoalId) {
        let mut mirror = self.lock();
        if mirror.goals.get(&goal).is_none_or(GoalStatus::is_final) {
            return;
        }
        mirror.call_off(goal);
        drop(mirror);
        self.send_orders();
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        self.seen.as_ref()
    }

    fn has_done(&mut self, goal: &Goal) -> bool {
        self.lock().claim(goal)
    }
}

impl Mirror {
    /// Nothing was heard yet; ids of goals begin with `next`.
    fn new(next: u64) -> Mirror {
        Mirror {
            next,
            telemetry: None,
            heard_at: None,
            since: Instant::now(),
            number: 0,
            goals: BTreeMap::new(),
            done: BTreeMap::new(),
            attempt: Attempt::default(),
            unanswered: vec![],
            changed: watch::Sender::new(0),
        }
    }

    /// Orders a goal to end. If the order to begin it was not answered, it is not repeated: the host may hear of the goal
    /// only now, long after it ceased to be wanted.
    fn call_off(&mut self, goal: GoalId) {
        self.unanswered.retain(|order| !matches!(order, Order::Start { id, .. } if *id == goal));
        let cancel = Order::Cancel { id: goal };
        if !self.unanswered.contains(&cancel) {
            self.unanswered.push(cancel);
        }
    }

    /// Whether an earlier attempt has done this goal and the present one has not come upon that yet.
    fn claim(&mut self, goal: &Goal) -> bool {
        let Attempt { earlier, claimed } = &mut self.attempt;
        let mut done = self.done.iter().filter(|(id, done)| earlier.contains(&id.0) && *done == goal);
        let found = done.find(|(id, _)| !claimed.contains(id)).map(|(id, _)| *id);
        if let Some(id) = found {
            info!(?goal, "was done already by an earlier attempt");
            claimed.insert(id);
        }
        found.is_some()
    }

    /// Takes in what the host reports. True if there is something to order at once.
    fn take(&mut self, state: BodyState) -> bool {
        if state.number <= self.number && self.number - state.number < 1 << 32 {
            return false; // overtaken by a later one; a number far below is a host that started anew
        }
        self.number = state.number;
        self.telemetry = Some(state.telemetry);
        self.heard_at = Some(Instant::now());
        self.done.extend(state.done);
        while self.done.len() > REMEMBERED {
            self.done.pop_first();
        }
        let told: BTreeSet<GoalId> = state.goals.iter().map(|(id, _)| *id).collect();
        let mut strangers = false;
        for (id, status) in state.goals {
            match self.goals.get_mut(&id) {
                Some(known) if known.is_final() => {}
                Some(known) => *known = status,
                // A former life of this node set it going, and nobody watches over it any more.
                None if !status.is_final() => {
                    self.goals.insert(id, status);
                    self.call_off(id);
                    strangers = true;
                }
                None => {}
            }
        }
        // A host tells of what is under way: one that has started anew knows nothing of it.
        let unanswered: BTreeSet<GoalId> = self.unanswered.iter().map(Order::goal).collect();
        let known = |id: &GoalId| told.contains(id) || unanswered.contains(id);
        for (id, status) in self.goals.iter_mut().filter(|(id, status)| !status.is_final() && !known(id)) {
            let message = format!("the host of the body no longer knows of goal {}", id.0);
            *status = GoalStatus::Aborted(ActionError { code: ErrorCode::Unknown, message });
        }
        self.changed.send_modify(|count| *count += 1);
        strangers
    }
}

#[ractor::async_trait]
impl Actor for BodyLink {
    type Msg = BodyLinkMessage;
    type State = BodyLinkState;
    type Arguments = (BodyLinkSettings, tokio::sync::mpsc::UnboundedSender<Body>);

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        (settings, hand_out): Self::Arguments,
    ) -> Result<Self::State, ActorProcessingErr> {
        let body =
            Body { mirror: Arc::new(Mutex::new(Mirror::new(settings.first_goal))), orders: myself.clone(), seen: None };
        let mut tasks = Tasks::default();
        let state_key = settings.keys.write(&Key::Body(settings.robot.clone(), BodyCall::State));
        tasks.forward(settings.bus.subscribe(&state_key).await?, &myself, BodyLinkMessage::State);
        tasks.beat(settings.beat, &myself, || BodyLinkMessage::Beat);
        myself.cast(BodyLinkMessage::Beat)?;
        hand_out.send(body.clone())?;
        Ok(BodyLinkState { settings, body, answered_at: None, tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            BodyLinkMessage::Orders => state.send(&myself, false),
            BodyLinkMessage::Beat => state.send(&myself, true),
            BodyLinkMessage::State(sample) => state.hear(&sample.payload),
            BodyLinkMessage::Answered(order, reply) => state.answered(order, reply),
        }
        Ok(())
    }
}

impl BodyLinkState {
    /// Sends the orders that were not answered; on a beat also without any.
    fn send(&mut self, myself: &ActorRef<BodyLinkMessage>, beat: bool) {
        let orders = self.body.lock().unanswered.clone();
        let answered_lately = self.answered_at.is_some_and(|at| at.elapsed() < REST);
        if orders.is_empty() && (!beat || answered_lately && self.body.is_at_rest()) {
            return;
        }
        let commands: Vec<Option<Order>> =
            if orders.is_empty() { vec![None] } else { orders.into_iter().map(Some).collect() };
        let key = self.settings.keys.write(&Key::Body(self.settings.robot.clone(), BodyCall::Command));
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.beat, myself.clone());
        self.tasks.spawn(async move {
            for order in commands {
                let bytes = codec::encode(&BodyCommand { order: order.clone() }).expect("a goal fits a message");
                let Ok(mut replies) = bus.query(&key, Bytes::from(bytes), limit).await else { return };
                // What follows waits for this to be answered: a goal must not be canceled before it has begun.
                let Some(reply) = replies.recv().await else { return };
                if to.cast(BodyLinkMessage::Answered(order, reply)).is_err() {
                    return;
                }
            }
        });
    }

    fn answered(&mut self, order: Option<Order>, reply: Reply) {
        match reply.payload {
            Ok(payload) => {
                self.answered_at = Some(Instant::now());
                if let Some(order) = order {
                    self.body.lock().unanswered.retain(|waiting| *waiting != order);
                }
                self.hear(&payload);
            }
            Err(problem) => debug!(robot = %self.settings.robot, problem, "the host of the body refused a command"),
        }
    }

    fn hear(&mut self, payload: &[u8]) {
        match codec::decode::<BodyState>(payload) {
            Ok(state) if state.robot == self.settings.robot => {
                if self.body.lock().take(state) {
                    self.body.send_orders();
                }
            }
            Ok(state) => warn!(robot = %self.settings.robot, other = %state.robot, "a state of another body"),
            Err(problem) => warn!(robot = %self.settings.robot, %problem, "a state that cannot be read"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, Seconds, WorldTime};
    use consort_skills::actions::Feedback;

    fn executing() -> GoalStatus {
        let distance_remaining = consort_protocol::units::Metres::ZERO;
        GoalStatus::Executing(Feedback { distance_remaining, time_remaining: Seconds::ZERO })
    }

    fn state(number: u64, goals: &[(u64, GoalStatus)]) -> BodyState {
        let telemetry = Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::default(),
            place: "Dock".parse().unwrap(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
        };
        let goals = goals.iter().map(|(id, status)| (GoalId(*id), status.clone())).collect();
        BodyState { robot: "ada".parse().unwrap(), number, telemetry, goals, done: vec![] }
    }

    #[test]
    fn what_an_earlier_attempt_at_the_task_has_done_is_done_once_for_each_time() {
        let mut mirror = Mirror::new(100);
        let pick_up = |from: &str| Goal::PickUp { from: from.parse().unwrap() };
        // Goal 5 is of a task that has ended; 6 and 7 are of a former life, and 101 of this one.
        let done = [(5, "amber"), (6, "birch"), (7, "amber"), (101, "amber")];
        let done = done.map(|(id, from)| (GoalId(id), pick_up(from)));
        mirror.take(BodyState { done: done.to_vec(), ..state(1, &[]) });
        assert!(!mirror.claim(&pick_up("amber")), "nothing was begun");
        let attempt = |next: u64| Attempt { earlier: 6..next, claimed: BTreeSet::new() };
        mirror.attempt = attempt(100);
        assert!(!mirror.claim(&pick_up("clove")));
        assert_eq!([(); 2].map(|()| mirror.claim(&pick_up("amber"))), [true, false]);
        assert_eq!([(); 2].map(|()| mirror.claim(&pick_up("birch"))), [true, false]);
        mirror.attempt = attempt(102);
        assert_eq!([(); 3].map(|()| mirror.claim(&pick_up("amber"))), [true, true, false], "the third attempt");
    }

    #[test]
    fn what_a_former_life_set_going_is_called_off() {
        let mut mirror = Mirror::new(100);
        assert!(mirror.take(state(1, &[(6, GoalStatus::Succeeded), (7, executing())])));
        assert_eq!(mirror.unanswered, [Order::Cancel { id: GoalId(7) }]);
        assert!(!mirror.goals[&GoalId(7)].is_final());
        mirror.unanswered.clear();
        assert!(!mirror.take(state(2, &[(6, GoalStatus::Succeeded), (7, GoalStatus::Canceled)])));
        assert!(mirror.goals.values().all(GoalStatus::is_final));
    }

    #[test]
    fn a_host_that_started_anew_has_lost_what_was_under_way_and_not_what_it_has_yet_to_hear_of() {
        let mut mirror = Mirror::new(100);
        mirror.goals = BTreeMap::from([(GoalId(100), executing()), (GoalId(101), GoalStatus::Sent)]);
        mirror.unanswered = vec![Order::Start { id: GoalId(101), goal: Goal::Wait { time: Seconds::ZERO } }];
        assert!(!mirror.take(state(1, &[(100, executing())])));
        assert_eq!(mirror.goals[&GoalId(100)], executing());
        assert!(!mirror.take(state(2, &[])));
        assert!(matches!(&mirror.goals[&GoalId(100)], GoalStatus::Aborted(error) if error.code == ErrorCode::Unknown));
        assert_eq!(mirror.goals[&GoalId(101)], GoalStatus::Sent);
    }
}
