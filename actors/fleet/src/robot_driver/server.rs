//! The driver server: an actor that advances a [`RobotBackend`] in time and passes commands to it.

use super::goal_table::{CommandEffect, GoalTable};
use super::messages::{DriverCommand, DriverState, PersonCommand, PersonEvent, PersonRequestState};
use super::state_order::StateStamp;
use consort_bus::clock::Clock;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{Outbox, Query, SharedBus};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{DriverCall, Key, Keys, PeopleCall};
use consort_protocol::units::{NodeTime, WorldTime};
use consort_skills::actions::{ActionError, BackendEvent, ErrorCode, GoalId, GoalStatus, RobotBackend};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use tracing::{debug, info, warn};

/// Number of repetitions of an event without a reply, 1 per publish interval: the event may be
/// lost.
const EVENT_REPETITIONS: u32 = 5;

/// Number of states and events that wait for the bus. Further ones are dropped: they are repeated.
const OUTBOX_CAPACITY: usize = 256;

/// Maximum sleep while an event is due; then the actor checks again.
const SLEEP_MAX: Duration = Duration::from_secs(3600);

/// Settings of a driver server.
pub struct DriverServerSettings {
    /// Random number of this start of the server: clients recognise late states by it.
    pub boot: u64,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// World seconds per second of node time.
    pub speed: f64,
    /// Interval of published states without changes. Default 500 ms.
    pub publish_interval: Duration,
    /// Client timeout: a robot stops when no command has permitted its goal for this long, and a
    /// person request that was not repeated for this long is canceled. Longer than several
    /// intervals of a coordinator. Default 3 s.
    pub client_timeout: Duration,
}

/// Message for the driver server.
pub enum DriverServerMessage {
    /// Command of a driver client.
    Command(Query),
    /// Command of a coordinator about a person.
    PersonRequest(Query),
    /// Query for the state of the world or, with the name of a robot as its payload, for the readings of
    /// the robot's range sensors.
    WorldView(Query),
    /// A world event is due.
    WorldEventDue,
    /// The permission of a goal may have run out.
    StopDue,
    /// Periodic timer: publish all states.
    Tick,
}

/// The driver server actor. It must stop robots in time, so it never waits for the bus.
pub struct DriverServer;

/// State of [`DriverServer`].
pub struct DriverServerState {
    settings: DriverServerSettings,
    world: Box<dyn RobotBackend>,
    started: NodeTime,
    /// World time at the start of the server.
    origin: WorldTime,
    goals: GoalTable,
    /// Person requests in progress, with the time of the latest repetition.
    person_requests: BTreeMap<GoalId, NodeTime>,
    /// Events of people without a reply, with the number of repetitions left.
    repeated_events: Vec<(PersonEvent, u32)>,
    /// Position of the latest state.
    stamp: StateStamp,
    /// World time of the earliest scheduled wake-up.
    next_wake: Option<WorldTime>,
    outbox: Outbox,
    tasks: Tasks,
}

/// Returns the sleep until an event that is due in `seconds` of node time. It is slightly too long
/// rather than too short, because an early wake-up would find nothing due and sleep again. It never
/// exceeds [`SLEEP_MAX`].
fn sleep_for(seconds: f64) -> Duration {
    match Duration::try_from_secs_f64(seconds.max(0.0)) {
        Ok(ahead) if ahead < SLEEP_MAX => ahead + Duration::from_micros(1),
        Ok(_) | Err(_) => SLEEP_MAX,
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
        let (outbox, sending) = Outbox::new(settings.bus.clone(), OUTBOX_CAPACITY, || ());
        tasks.spawn(sending);
        tasks.forward_queries(
            settings.bus.serve(&settings.keys.any_driver_command()).await?,
            &myself,
            DriverServerMessage::Command,
        );
        if world.serves_people() {
            let person_key = settings.keys.write(&Key::People(PeopleCall::Ask));
            tasks.forward_queries(settings.bus.serve(&person_key).await?, &myself, DriverServerMessage::PersonRequest);
            let view = settings.keys.write(&Key::World);
            tasks.forward_queries(settings.bus.serve(&view).await?, &myself, DriverServerMessage::WorldView);
        }
        tasks.send_every(settings.publish_interval, &myself, || DriverServerMessage::Tick);
        let (now, mut goals) = (settings.clock.now(), GoalTable::new(settings.client_timeout));
        for robot in world.robots() {
            let in_progress = world.goals(&robot);
            goals.add_robot(robot, in_progress, now);
        }
        // People may still work on requests from coordinators that used a previous server, or that are
        // gone.
        let person_requests = world.open_person_requests().into_iter().map(|ask| (ask, now)).collect();
        let (started, origin) = (settings.clock.now(), world.now());
        let stamp = StateStamp { boot: settings.boot, sequence: 0 };
        Ok(DriverServerState {
            settings,
            world,
            started,
            origin,
            goals,
            person_requests,
            repeated_events: vec![],
            stamp,
            next_wake: None,
            outbox,
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
        state.stop_unpermitted_goals();
        match message {
            DriverServerMessage::Command(query) => state.handle_command(query),
            DriverServerMessage::PersonRequest(query) => state.handle_person_command(query),
            DriverServerMessage::WorldView(query) => {
                let robot = str::from_utf8(&query.payload).ok().and_then(|name| RobotId::new(name).ok());
                let report = match robot {
                    Some(robot) => state.world.range_readings(&robot),
                    None => state.world.report(),
                };
                let key = state.settings.keys.write(&Key::World);
                state.tasks.spawn(async move { reply::json(&query, &key, &report).await });
            }
            DriverServerMessage::WorldEventDue => state.next_wake = None,
            DriverServerMessage::StopDue => {}
            DriverServerMessage::Tick => {
                state.cancel_unrepeated_requests();
                state.publish_all();
            }
        }
        state.publish_events(changed);
        let after = state.advance();
        state.publish_events(after);
        state.wake_when_due(&myself);
        state.wake_for_next_stop(&myself);
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
        if self.next_wake.is_some_and(|next_wake| next_wake <= due) {
            return;
        }
        let ahead = (due.as_secs() - self.world_now().as_secs()) / self.settings.speed;
        self.tasks.send_after(sleep_for(ahead), myself, DriverServerMessage::WorldEventDue);
        self.next_wake = Some(due);
    }

    fn handle_command(&mut self, query: Query) {
        let Some(Key::Driver(robot, DriverCall::Command)) = self.settings.keys.read(&query.key) else {
            return reply::refuse_in(&mut self.tasks, query, "not a command to a driver".to_owned());
        };
        let Some((query, command)) = reply::decode_or_refuse_in::<DriverCommand>(&mut self.tasks, query) else {
            return;
        };
        let now = self.settings.clock.now();
        let effect = match self.goals.receive(&robot, command, now) {
            Ok(effect) => effect,
            Err(problem) => return reply::refuse_in(&mut self.tasks, query, problem.to_string()),
        };
        for (id, stop_at) in self.goals.stop_times(&robot) {
            if let Some(stop_at) = stop_at {
                self.world.permit(&robot, id, stop_at.since(now));
            }
        }
        match effect {
            CommandEffect::Start(id, goal) => self.world.start(&robot, id, goal),
            CommandEffect::Cancel(id) => self.world.cancel(&robot, id),
            CommandEffect::None => {}
        }
        // Rejections and cancellations take effect at once.
        let events = self.advance();
        if let Some(state) = self.state_of(&robot) {
            let key = query.key.clone();
            reply::wire_in(&mut self.tasks, query, key, state);
        }
        self.publish_events(events);
    }

    fn handle_person_command(&mut self, query: Query) {
        let Some((query, command)) = reply::decode_or_refuse_in::<PersonCommand>(&mut self.tasks, query) else {
            return;
        };
        match command.request {
            Some(request) => {
                self.world.request_person(command.id, request);
                self.person_requests.insert(command.id, self.settings.clock.now());
            }
            None => self.world.cancel_person_request(command.id),
        }
        let events = self.advance();
        self.publish_events(events);
        // The world also contains the results that a previous server returned.
        let reply = match self.world.person_result(command.id) {
            Some(result) => PersonRequestState::Ended(result),
            None if self.world.was_person_request_canceled(command.id) => PersonRequestState::Canceled,
            None => PersonRequestState::Requested,
        };
        let key = query.key.clone();
        reply::wire_in(&mut self.tasks, query, key, reply);
    }

    /// Cancels the goals that are no longer permitted: their robots stop.
    fn stop_unpermitted_goals(&mut self) {
        for (robot, id) in self.goals.take_expired(self.settings.clock.now()) {
            if self.world.status(&robot, id).is_some_and(|status| !status.is_final()) {
                info!(%robot, goal = id.0, "permission of a goal has run out: robot stopped");
                self.world.cancel(&robot, id);
            }
        }
    }

    fn wake_for_next_stop(&mut self, myself: &ActorRef<DriverServerMessage>) {
        let Some(stop) = self.goals.schedule_wake() else { return };
        let ahead = self.settings.clock.instant(stop).saturating_duration_since(Instant::now());
        self.tasks.send_after(sleep_for(ahead.as_secs_f64()), myself, DriverServerMessage::StopDue);
    }

    /// Cancels each person request that is no longer repeated: its coordinator is gone, and the
    /// mission may be over. A coordinator that still needs the request gets the state `Canceled` and sends a new
    /// request.
    fn cancel_unrepeated_requests(&mut self) {
        let (now, open) = (self.settings.clock.now(), self.world.open_person_requests());
        self.person_requests.retain(|ask, _| open.contains(ask));
        for (ask, _) in self
            .person_requests
            .iter()
            .filter(|(_, repeated_at)| now.since(**repeated_at) > self.settings.client_timeout)
        {
            info!(ask = ask.0, "person request no longer repeated: canceled");
            self.world.cancel_person_request(*ask);
        }
    }

    fn publish_events(&mut self, events: Vec<BackendEvent>) {
        let mut changed_robots: Vec<RobotId> = vec![];
        for event in events {
            match event {
                BackendEvent::GoalEnded { robot, goal, .. } => {
                    self.goals.end(&robot, goal);
                    changed_robots.push(robot);
                }
                BackendEvent::Stranded { robot } => {
                    warn!(%robot, "battery empty: robot stopped");
                    changed_robots.push(robot);
                }
                BackendEvent::MissionCanceled { by, role, robot } => {
                    info!(by, %robot, "a person cancels the mission");
                    let at_ms = (self.world.now().as_secs() * 1000.0) as u64;
                    let event = PersonEvent::CancelMission { by, role, robot, at_ms };
                    self.publish_person_event(&event);
                    self.repeated_events.push((event, EVENT_REPETITIONS));
                }
                BackendEvent::PersonRequestEnded { request: ask, result } => {
                    self.publish_person_event(&PersonEvent::RequestEnded { id: ask, result });
                }
            }
        }
        changed_robots.dedup();
        for robot in changed_robots {
            self.publish_state(&robot);
        }
    }

    /// Publishes the event of a person.
    fn publish_person_event(&self, event: &PersonEvent) {
        let key = self.settings.keys.write(&Key::People(PeopleCall::Done));
        self.publish(key, event);
    }

    fn publish_all(&mut self) {
        for (event, left) in std::mem::take(&mut self.repeated_events) {
            self.publish_person_event(&event);
            if left > 1 {
                self.repeated_events.push((event, left - 1));
            }
        }
        for robot in self.goals.robots().cloned().collect::<Vec<_>>() {
            self.publish_state(&robot);
        }
    }

    fn publish_state(&mut self, robot: &RobotId) {
        if let Some(state) = self.state_of(robot) {
            let key = self.settings.keys.write(&Key::Driver(robot.clone(), DriverCall::State));
            self.publish(key, &state);
        }
    }

    fn publish<T: Serialize>(&self, key: String, message: &T) {
        let bytes = codec::encode(message).expect("a state fits a message");
        if !self.outbox.publish(key, bytes.into()) {
            // Frequent while the bus is blocked.
            debug!("the outbox is full: a state was not published");
        }
    }

    fn state_of(&mut self, robot: &RobotId) -> Option<DriverState> {
        let telemetry = self.world.telemetry(robot)?;
        let status = |id: GoalId| {
            let unknown_goal = || ActionError::new(ErrorCode::Unknown, format!("goal {} is unknown here", id.0));
            let status = self.world.status(robot, id).unwrap_or_else(|| GoalStatus::Aborted(unknown_goal()));
            (id, status.within_limits())
        };
        let goals: Vec<(GoalId, GoalStatus)> = self.goals.goals(robot)?.map(status).collect();
        let completed = |(id, status): &(GoalId, GoalStatus)| match status {
            GoalStatus::Succeeded(result) => Some((*id, self.world.goal(robot, *id)?, result.clone())),
            _ => None,
        };
        let done = goals.iter().filter_map(completed).filter(|(_, goal, _)| !goal.repeatable).collect();
        self.stamp.sequence += 1;
        self.goals.record_state(self.stamp, self.settings.clock.now());
        Some(DriverState { robot: robot.clone(), stamp: self.stamp, telemetry, goals, completed: done })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sleep_is_bounded_for_any_due_time() {
        assert_eq!(sleep_for(2.5), Duration::from_micros(2_500_001));
        assert_eq!(sleep_for(-1.0), Duration::from_micros(1), "an overdue event");
        for far in [3600.0, 1e19, 1e20, f64::MAX, f64::INFINITY, f64::NAN] {
            assert!(sleep_for(far) <= SLEEP_MAX, "{far} s");
        }
        assert_eq!(sleep_for(1e300), SLEEP_MAX);
    }
}
