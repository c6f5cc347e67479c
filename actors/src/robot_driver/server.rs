//! The host's side: an actor that lets a [`BodyHost`]'s time pass and carries commands to it.

use super::messages::{DriverCommand, DriverState, GoalRequest, PersonCommand, PersonEvent, PersonRequestState};
use crate::bus::{Delivery, Encoding, Query, SharedBus};
use crate::clock::Clock;
use crate::reply;
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{BodyCall, Key, Keys, PeopleCall};
use consort_protocol::units::{NodeTime, WorldTime};
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, GoalId, GoalStatus, RobotBackend};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tracing::{info, warn};

/// Latest goals of each body that its states tell of.
const GOALS_TOLD: usize = 8;

/// How often a word is repeated that nobody answers, once a beat: it may be lost on the way.
const WORDS_REPEATED: u32 = 5;

/// Longest time that a host rests while something is due; then it looks again.
const REST_MAX: Duration = Duration::from_secs(3600);

/// How bodies are hosted.
pub struct DriverServerSettings {
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// World seconds that pass in one second of node time.
    pub speed: f64,
    /// How often states are published while nothing changes. Default 500 ms.
    pub publish_interval: Duration,
    /// A body whose driver has been silent for this long stops where it is, and an ask that nobody has repeated for as long
    /// is withdrawn: longer than some beats of an attendant. Default 3 s.
    pub client_timeout: Duration,
}

/// To a host.
pub enum DriverServerMessage {
    /// A driver's command.
    Command(Query),
    /// An attendant's ask.
    PersonRequest(Query),
    /// Somebody looks at the world.
    WorldView(Query),
    /// Something is due in the world.
    WorldEventDue,
    /// Time to publish states.
    Tick,
}

/// Hosts bodies.
pub struct DriverServer;

/// State of [`Host`].
pub struct DriverServerState {
    settings: DriverServerSettings,
    world: Box<dyn RobotBackend>,
    started: NodeTime,
    /// World time when the host started.
    origin: WorldTime,
    bodies: BTreeMap<RobotId, BodyEntry>,
    /// The asks that have not ended, and when they were last made.
    asks: BTreeMap<GoalId, NodeTime>,
    /// What people said that nobody answers, and how often it is still to be repeated.
    words: Vec<(PersonEvent, u32)>,
    number: u64,
    /// What the earliest wake-up under way is for.
    armed: Option<WorldTime>,
    tasks: Tasks,
}

/// How long to rest until something is due in so many seconds of node time: a little longer rather than shorter, since an
/// early wake-up would find nothing due and ask again, and never longer than [`REST_MAX`], however far off it is.
fn rest(seconds: f64) -> Duration {
    match Duration::try_from_secs_f64(seconds.max(0.0)) {
        Ok(ahead) if ahead < REST_MAX => ahead + Duration::from_micros(1),
        Ok(_) | Err(_) => REST_MAX,
    }
}

#[derive(Default)]
struct BodyEntry {
    goals: VecDeque<GoalId>,
    /// When its driver was last heard; `None` before the first time, and once it was found silent.
    driver: Option<NodeTime>,
}

impl BodyEntry {
    fn remember(&mut self, goal: GoalId) {
        self.goals.push_back(goal);
        while self.goals.len() > GOALS_TOLD {
            self.goals.pop_front();
        }
    }
}

#[ractor::async_trait]
impl Actor for DriverServer {
    type Msg = DriverServerMessage;
    type State = DriverServerState;
    type Arguments = (DriverServerSettings, Box<dyn RobotBackend>);

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        (settings, world): Self::Arguments,
    ) -> Result<Self::State, ActorProcessingErr> {
        let mut tasks = Tasks::default();
        tasks.forward(
            settings.bus.serve(&settings.keys.any_body_command()).await?,
            &myself,
            DriverServerMessage::Command,
        );
        if world.serves_people() {
            let ask = settings.keys.write(&Key::People(PeopleCall::Ask));
            tasks.forward(settings.bus.serve(&ask).await?, &myself, DriverServerMessage::PersonRequest);
            let view = settings.keys.write(&Key::World);
            tasks.forward(settings.bus.serve(&view).await?, &myself, DriverServerMessage::WorldView);
        }
        tasks.send_every(settings.publish_interval, &myself, || DriverServerMessage::Tick);
        let (now, mut bodies) = (settings.clock.now(), BTreeMap::new());
        for robot in world.robots() {
            // Bodies may be at work for those who drove them through a former host.
            let mut entry = BodyEntry::default();
            world.goals(&robot).into_iter().for_each(|goal| entry.remember(goal));
            entry.driver = (!entry.goals.is_empty()).then_some(now);
            bodies.insert(robot, entry);
        }
        // People may be asked for attendants who speak to a former host, or who are gone.
        let asks = world.open_person_requests().into_iter().map(|ask| (ask, now)).collect();
        let (started, origin, number) = (settings.clock.now(), world.now(), settings.clock.wall_ms() << 16);
        Ok(DriverServerState {
            settings,
            world,
            started,
            origin,
            bodies,
            asks,
            words: vec![],
            number,
            armed: None,
            tasks,
        })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        let changed = state.advance();
        match message {
            DriverServerMessage::Command(query) => state.command(query).await,
            DriverServerMessage::PersonRequest(query) => state.ask(query).await,
            DriverServerMessage::WorldView(query) => {
                let report = state.world.report();
                reply::json(&query, &state.settings.keys.write(&Key::World), &report).await;
            }
            DriverServerMessage::WorldEventDue => state.armed = None,
            DriverServerMessage::Tick => {
                state.stop_the_undriven();
                state.withdraw_the_unrepeated();
                state.publish_all().await;
            }
        }
        state.tell(changed).await;
        let after = state.advance();
        state.tell(after).await;
        state.wake_when_due(&myself);
        Ok(())
    }
}

impl DriverServerState {
    fn world_now(&self) -> WorldTime {
        let elapsed = self.settings.clock.now().since(self.started).as_secs_f64();
        WorldTime::from_secs(self.origin.as_secs() + elapsed * self.settings.speed)
    }

    fn advance(&mut self) -> Vec<BackendEvent> {
        let now = self.world_now();
        self.world.advance(now)
    }

    fn wake_when_due(&mut self, myself: &ActorRef<DriverServerMessage>) {
        let Some(due) = self.world.next_due() else { return };
        if self.armed.is_some_and(|armed| armed <= due) {
            return;
        }
        let ahead = (due.as_secs() - self.world_now().as_secs()) / self.settings.speed;
        self.tasks.send_after(rest(ahead), myself, DriverServerMessage::WorldEventDue);
        self.armed = Some(due);
    }

    async fn command(&mut self, query: Query) {
        let Some(Key::Body(robot, BodyCall::Command)) = self.settings.keys.read(&query.key) else {
            return reply::refuse(&query, "not a command to a body").await;
        };
        let Some(command) = reply::decode_or_refuse::<DriverCommand>(&query).await else { return };
        let now = self.settings.clock.now();
        let Some(entry) = self.bodies.get_mut(&robot) else {
            let here: Vec<_> = self.bodies.keys().map(RobotId::as_str).collect();
            return reply::refuse(&query, &format!("no body of {robot} here; here are {}", here.join(", "))).await;
        };
        entry.driver = Some(now);
        match command.request {
            Some(GoalRequest::Start { id, goal }) if !entry.goals.contains(&id) => {
                entry.remember(id);
                self.world.start(&robot, id, goal);
            }
            // Called off before it was heard of: it must not begin when the order to begin it arrives late.
            Some(GoalRequest::Cancel { id }) if !entry.goals.contains(&id) => entry.remember(id),
            Some(GoalRequest::Cancel { id }) => self.world.cancel(&robot, id),
            Some(GoalRequest::Start { .. }) | None => {}
        }
        // Refusals and cancellations show at once.
        let events = self.advance();
        if let Some(state) = self.state_of(&robot) {
            reply::wire(&query, &query.key, &state).await;
        }
        self.tell(events).await;
    }

    async fn ask(&mut self, query: Query) {
        let Some(ask) = reply::decode_or_refuse::<PersonCommand>(&query).await else { return };
        match ask.request {
            Some(what) => {
                self.world.request_person(ask.id, what);
                self.asks.insert(ask.id, self.settings.clock.now());
            }
            None => self.world.cancel_person_request(ask.id),
        }
        let events = self.advance();
        self.tell(events).await;
        // The world knows what a former host was answered, too.
        let said = match self.world.person_result(ask.id) {
            Some(result) => PersonRequestState::Ended(result),
            None if self.world.was_person_request_canceled(ask.id) => PersonRequestState::Canceled,
            None => PersonRequestState::Requested,
        };
        reply::wire(&query, &query.key, &said).await;
    }

    /// A robot without its driver stands still: nobody would notice if it went wrong.
    fn stop_the_undriven(&mut self) {
        let now = self.settings.clock.now();
        for (robot, entry) in &mut self.bodies {
            if entry.driver.is_some_and(|heard| now.since(heard) > self.settings.client_timeout) {
                entry.driver = None;
                let running =
                    entry.goals.iter().filter(|id| self.world.status(robot, **id).is_some_and(|s| !s.is_final()));
                for id in running.copied().collect::<Vec<_>>() {
                    info!(%robot, "driver silent: stopped");
                    self.world.cancel(robot, id);
                }
            }
        }
    }

    /// What nobody repeats is wanted by nobody: the attendant who asked is gone, and the mission may be over. An attendant
    /// who comes to want it again is told that it was withdrawn, and asks anew.
    fn withdraw_the_unrepeated(&mut self) {
        let (now, open) = (self.settings.clock.now(), self.world.open_person_requests());
        self.asks.retain(|ask, _| open.contains(ask));
        for (ask, _) in self.asks.iter().filter(|(_, made)| now.since(**made) > self.settings.client_timeout) {
            info!(ask = ask.0, "nobody repeats it: withdrawn");
            self.world.cancel_person_request(*ask);
        }
    }

    async fn tell(&mut self, events: Vec<BackendEvent>) {
        let mut moved: Vec<RobotId> = vec![];
        for event in events {
            match event {
                BackendEvent::GoalEnded { robot, .. } => moved.push(robot),
                BackendEvent::Stranded { robot } => {
                    warn!(%robot, "battery empty: stands where it is");
                    moved.push(robot);
                }
                BackendEvent::MissionCanceled { by, role, robot } => {
                    info!(by, %robot, "calls the mission off");
                    let said_ms = (self.world.now().as_secs() * 1000.0) as u64;
                    let word = PersonEvent::CancelMission { by, role, robot, at_ms: said_ms };
                    self.speak(&word).await;
                    self.words.push((word, WORDS_REPEATED));
                }
                BackendEvent::PersonRequestEnded { ask, result } => {
                    self.speak(&PersonEvent::RequestEnded { id: ask, result }).await;
                }
            }
        }
        moved.dedup();
        for robot in moved {
            self.publish_state(&robot).await;
        }
    }

    /// Says for people what they have to say.
    async fn speak(&self, word: &PersonEvent) {
        let key = self.settings.keys.write(&Key::People(PeopleCall::Done));
        self.publish(&key, word).await;
    }

    async fn publish_all(&mut self) {
        for (word, left) in std::mem::take(&mut self.words) {
            self.speak(&word).await;
            if left > 1 {
                self.words.push((word, left - 1));
            }
        }
        for robot in self.bodies.keys().cloned().collect::<Vec<_>>() {
            self.publish_state(&robot).await;
        }
    }

    async fn publish_state(&mut self, robot: &RobotId) {
        if let Some(state) = self.state_of(robot) {
            let key = self.settings.keys.write(&Key::Body(robot.clone(), BodyCall::State));
            self.publish(&key, &state).await;
        }
    }

    async fn publish<T: Serialize>(&self, key: &str, message: &T) {
        let bytes = Bytes::from(codec::encode(message).expect("a state fits a message"));
        if let Err(problem) = self.settings.bus.publish(key, bytes, Encoding::Wire, Delivery::Drop).await {
            warn!(%problem, "a state was not published");
        }
    }

    fn state_of(&mut self, robot: &RobotId) -> Option<DriverState> {
        let telemetry = self.world.telemetry(robot)?;
        let entry = self.bodies.get(robot)?;
        let status = |id: &GoalId| {
            let lost = || ActionError { code: ErrorCode::Unknown, message: format!("goal {} is not known here", id.0) };
            (*id, self.world.status(robot, *id).unwrap_or_else(|| GoalStatus::Aborted(lost())))
        };
        let goals: Vec<(GoalId, GoalStatus)> = entry.goals.iter().map(status).collect();
        let succeeded = goals.iter().filter(|(_, status)| *status == GoalStatus::Succeeded);
        let done = succeeded.filter_map(|(id, _)| Some((*id, self.world.goal(robot, *id)?)));
        let done = done.filter(|(_, goal)| !goal.is_repeatable()).collect();
        self.number += 1;
        Some(DriverState { robot: robot.clone(), sequence: self.number, telemetry, goals, completed: done })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn however_far_off_something_is_the_host_only_rests() {
        assert_eq!(rest(2.5), Duration::from_micros(2_500_001));
        assert_eq!(rest(-1.0), Duration::from_micros(1), "what is overdue");
        for far in [3600.0, 1e19, 1e20, f64::MAX, f64::INFINITY, f64::NAN] {
            assert!(rest(far) <= REST_MAX, "{far} s");
        }
        assert_eq!(rest(1e300), REST_MAX);
    }
}
